"""Schedulers and clients that are killed over builds, bakes and films: run again, the bytes are those of one thread."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from cluster_works import work
from test_worker_kills import files, terrain  # noqa: F401 (a fixture)

import orograph
from orograph.errors import OrographError
from orograph.store import clusters

pytestmark = pytest.mark.stress

SCHEDULERS, CLIENTS = 8, 34
"""Kills, of each kind of work."""

HOST = """
import time
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        time.sleep(3600)
"""


@contextlib.contextmanager
def hosted(folder):
    """A scheduler with two workers in processes of their own: its address, and what kills all of them."""
    pytest.importorskip("distributed")
    script = folder / "host.py"
    script.write_text(HOST)
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, start_new_session=True)

    def kill():
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), kill
    finally:
        kill()
        process.wait()


@pytest.fixture
def ground(terrain, tmp_path):  # noqa: F811
    """A folder with a raster and a store of it."""
    folder = tmp_path / "ground"
    folder.mkdir()
    shutil.move(terrain, folder / "hills.oro")
    orograph.export(folder / "hills.oro", folder / "dem.tif", progress=False)
    return folder


WORKS = pytest.mark.parametrize("what", ["build", "bake", "film"])


@contextlib.contextmanager
def killed_meanwhile(kill, rng, done):
    """Kill at a random time: two of three times after some more tasks were done, otherwise at once. Gives what says
    whether it was done."""
    ended, fell = threading.Event(), threading.Event()
    wanted = len(done) + (rng.randint(1, 6) if rng.random() < 2 / 3 else 0)
    pause = rng.uniform(0.0, 1.0)

    def killer():
        while len(done) < wanted:
            if ended.wait(0.02):
                return
        if not ended.wait(pause):
            fell.set()
            kill()

    thread = threading.Thread(target=killer)
    thread.start()
    try:
        yield fell
    finally:
        ended.set()
        thread.join()


@WORKS
def test_schedulers_that_are_killed(ground, tmp_path, what, monkeypatch):
    monkeypatch.setattr(clusters, "SILENCE", 10.0)
    work(what, ground, tmp_path / "one")
    done, hear = [], clusters._Round._hear

    def heard(self, found):
        done.append(found.seconds)
        hear(self, found)

    monkeypatch.setattr(clusters._Round, "_hear", heard)
    rng, kills, halfway, trial = random.Random(3), 0, 0, 0
    while kills < SCHEDULERS:
        target, finished = tmp_path / f"{trial}", False
        while not finished:
            with hosted(tmp_path) as (address, kill), contextlib.ExitStack() as stack:
                before = len(done)
                fell = stack.enter_context(killed_meanwhile(kill, rng, done)) if kills < SCHEDULERS else None
                try:
                    work(what, ground, target, address)
                    finished = True
                except OrographError as error:
                    if fell is None or not fell.is_set():  # nobody killed it
                        if isinstance(error.__cause__, TimeoutError):  # a busy machine: it answers late
                            continue
                        raise
                    kills, halfway = kills + 1, halfway + (len(done) > before)
        assert files(target) == files(tmp_path / "one")
        trial += 1
    assert halfway >= SCHEDULERS // 3
    print(f"{what}: {kills} schedulers, {halfway} of them after tasks, {trial} times from beginning to end")


@WORKS
def test_clients_that_are_killed(ground, tmp_path, what):
    work(what, ground, tmp_path / "one")
    script = Path(__file__).with_name("cluster_works.py")
    rng, kills, trial = random.Random(4), 0, 0
    with hosted(tmp_path) as (address, _):
        while kills < CLIENTS:
            target, finished = tmp_path / f"{trial}", False
            while not finished:
                client = subprocess.Popen([sys.executable, str(script), what, str(ground), str(target), address])
                try:
                    assert client.wait(rng.uniform(2.0, 6.0) if kills < CLIENTS else 300) == 0
                    finished = True
                except subprocess.TimeoutExpired:
                    client.kill()
                    client.wait()
                    kills += 1
            assert files(target) == files(tmp_path / "one")
            trial += 1
    print(f"{what}: {kills} clients, {trial} times from beginning to end")
