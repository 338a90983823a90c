"""Schedulers and clients that are killed over bakes and films, and two clients of one store: the bytes of one process,
and one that wins."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest
from test_worker_kills import files, terrain  # noqa: F401 (a fixture)

import orograph
from orograph.errors import StoreError, UsageError
from orograph.lighting.context import Options
from orograph.store import clusters

pytestmark = pytest.mark.stress

NAMES, OPTIONS = ["sky-view-factor", "aperture"], Options(azimuths=8)
FILM = {"size": (240, 150), "orbit": True, "seconds": 3.0, "fps": 8, "progress": False}

HOST = """
import time
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        time.sleep(600)
"""

CLIENT = """
import sys
import orograph
from orograph.lighting.context import Options
what, path, address = sys.argv[1:]
if what == "bake":
    orograph.bake(path, ["sky-view-factor", "aperture"], Options(azimuths=8), dask=address, progress=False).close()
else:
    orograph.movie(sys.argv[2].replace("film", "hills.oro", 1), path + "/%03d.png", dask=address, size=(240, 150),
                   orbit=True, seconds=3.0, fps=8, progress=False)
"""


@contextlib.contextmanager
def hosted(folder):
    """A scheduler with two workers in processes of their own: its address, and its process."""
    pytest.importorskip("distributed")
    script = folder / "host.py"
    script.write_text(HOST)
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def works(terrain, folder):  # noqa: F811
    """A bake and a film: what is done with a cluster, and the bytes that come of it."""
    (whole := folder / "whole").mkdir()
    shutil.copytree(terrain, whole / "hills.oro")
    orograph.bake(whole / "hills.oro", NAMES, OPTIONS, jobs=1, progress=False).close()
    orograph.movie(terrain, whole / "film/%03d.png", **FILM)
    (own := folder / "own").mkdir()
    shutil.copytree(terrain, own / "hills.oro")

    def bake(address):
        orograph.bake(own / "hills.oro", NAMES, OPTIONS, dask=address, progress=False).close()

    def film(address):
        orograph.movie(terrain, own / "film/%03d.png", dask=address, **FILM)

    return {"bake": (bake, own / "hills.oro", whole / "hills.oro"), "film": (film, own / "film", whole / "film")}


@pytest.mark.parametrize("what", ["bake", "film"])
def test_schedulers_that_are_killed(terrain, tmp_path, what, monkeypatch):  # noqa: F811
    monkeypatch.setattr(clusters, "SILENCE", 2.0)
    work, made, expected = works(terrain, tmp_path)[what]
    rng, kills = random.Random(3), 0
    for _ in range(6):
        with hosted(tmp_path) as (address, process):
            killer = subprocess.Popen(
                [
                    sys.executable,
                    "-c",
                    f"import os, time; time.sleep({rng.uniform(0.5, 6.0)}); os.killpg({process.pid}, 9)",
                ]
            )
            try:
                work(address)
                break
            except (StoreError, UsageError):
                kills += 1
            finally:
                killer.kill()
                killer.wait()
    else:
        with hosted(tmp_path) as (address, _):
            work(address)
    assert kills and files(made) == files(expected)


@pytest.mark.parametrize("what", ["bake", "film"])
def test_clients_that_are_killed(terrain, tmp_path, what):  # noqa: F811
    _, made, expected = works(terrain, tmp_path)[what]
    script = tmp_path / "client.py"
    script.write_text(CLIENT)
    shutil.copytree(terrain, tmp_path / "own/hills2.oro")
    if what == "film":
        script.write_text(CLIENT.replace('sys.argv[2].replace("film", "hills.oro", 1)', repr(str(terrain))))
    rng, kills = random.Random(4), 0
    with hosted(tmp_path) as (address, _):
        for trial in range(10):
            client = subprocess.Popen([sys.executable, str(script), what, str(made), address])
            try:
                assert client.wait(rng.uniform(2.0, 5.0 + trial)) == 0
                break
            except subprocess.TimeoutExpired:
                client.kill()
                client.wait()
                kills += 1
        else:
            subprocess.run([sys.executable, str(script), what, str(made), address], check=True)
    assert kills and files(made) == files(expected)


@pytest.mark.parametrize("what", ["build", "bake", "film"])
def test_of_two_clients_one_wins(terrain, tmp_path, what):  # noqa: F811
    """The second comes while the first is stopped in its middle, and is told who is at work."""
    own = tmp_path / "own"
    own.mkdir()
    shutil.copytree(terrain, own / "hills.oro")
    commands = {
        "build": ["build", str(own / "dem.tif"), "-o", str(own / "dem.oro"), "--workers", "2"],
        "bake": ["bake", str(own / "hills.oro"), "--products", "sky-view-factor", "--workers", "2"],
        "film": ["movie", str(own / "hills.oro"), "--orbit", "--size", "240x150", "-o", str(own / "f/%03d.png"),
                 "--workers", "2"],
    }  # fmt: skip
    if what == "build":
        orograph.export(terrain, own / "dem.tif", progress=False)
    lock = {"build": ".dem.oro.lock", "bake": ".hills.oro.lock", "film": "f/..film.lock"}[what]
    command = [sys.executable, "-m", "orograph", "-q", *commands[what]]
    first = subprocess.Popen(command)
    locked = own / lock
    while first.poll() is None and not (locked.exists() or list(own.glob("f/.*.lock"))):
        time.sleep(0.02)
    first.send_signal(signal.SIGSTOP)
    try:
        assert first.poll() is None
        second = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert second.returncode == 4 and str(first.pid) in second.stderr, second.stderr
    finally:
        first.send_signal(signal.SIGCONT)
    assert first.wait(300) == 0
    if what != "film":
        with orograph.open(own / ("dem.oro" if what == "build" else "hills.oro")) as store:
            assert store.check() == []
