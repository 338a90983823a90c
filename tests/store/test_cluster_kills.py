"""Builds whose workers, or all of whose processes, are killed at random moments, make the same bytes when run again."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest
from killed_workers import KILLS, killed, until_done
from test_clusters import SIZES, written
from test_in_parts import files

from orograph import store

pytestmark = pytest.mark.stress


def test_killed_workers(tmp_path):
    dem = written(tmp_path / "a.tif")
    store.build(dem, tmp_path / "whole", **SIZES).close()
    with killed(5) as (client, kills):
        for trial in range(40):
            target = tmp_path / f"s{trial}"
            until_done(lambda at=target: store.build(dem, at, dask=client, resume=True, **SIZES).close())
            assert files(target) == files(tmp_path / "whole")
            if kills[0] >= KILLS:
                break
    print(f"{kills[0]} kills, {trial + 1} times from beginning to end")
    assert kills[0] >= KILLS


def test_killed_builds(tmp_path):
    pytest.importorskip("distributed")
    dem = written(tmp_path / "a.tif")
    store.build(dem, tmp_path / "whole", **SIZES).close()
    script = tmp_path / "build_once.py"
    script.write_text(
        "from orograph import store\nif __name__ == '__main__':\n"
        f"    options = {SIZES | {'workers': 2, 'resume': True, 'progress': False}!r}\n"
        f"    store.build({dem!r}, {str(tmp_path / 's')!r}, **options).close()\n"
    )
    began = time.monotonic()
    subprocess.run([sys.executable, str(script)], check=True)
    whole = time.monotonic() - began
    shutil.rmtree(tmp_path / "s")
    rng, kills = random.Random(6), 0
    for _ in range(40):
        child = subprocess.Popen([sys.executable, str(script)])
        try:
            status = child.wait(rng.uniform(0.2, 1.0) * whole)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
            kills += 1
            assert not (tmp_path / "s").exists() or store.open(tmp_path / "s").check() == []
            continue
        assert status == 0
        break
    else:
        store.build(dem, tmp_path / "s", resume=True, **SIZES).close()
    assert kills
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_workers_say_nothing_of_ctrl_c(tmp_path):
    pytest.importorskip("distributed")
    dem = written(tmp_path / "a.tif")
    command = [sys.executable, "-m", "orograph", "build", dem, "-o", str(tmp_path / "s"), "--workers", "2"]
    for seconds in (4.0, 5.0, 6.0):
        child = subprocess.Popen([*command, "--overwrite"], stderr=subprocess.PIPE, text=True, start_new_session=True)
        time.sleep(seconds)
        os.killpg(child.pid, signal.SIGINT)  # as a terminal does: all processes of the command
        _, said = child.communicate(timeout=60)
        assert child.returncode in (0, 130) and "Traceback" not in said
