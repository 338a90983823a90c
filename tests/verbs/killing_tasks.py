"""Bakes light and draws a film by tasks, in processes that are killed at random moments (run as a script).

Arguments: folder, kills. Processes are forks of this one, which has everything compiled: a trial costs what tasks cost.
Each does tasks as a worker does, with nothing but what lies in files, and is killed with whatever it is at; then the
same is run again. What comes out in the end has to have the bytes of one process that nobody kills.
"""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import sys
import time
from pathlib import Path

import numpy as np
from affine import Affine
from pyproj import CRS

import orograph
from orograph import store
from orograph.geo.grid import Grid
from orograph.lighting import bake as baking
from orograph.lighting.bake_state import BakeState
from orograph.lighting.context import Options
from orograph.store.source import ArraySource

NAMES, OPTIONS = ["sky-view-factor", "aperture"], Options(azimuths=8)
FILM = {"size": (160, 100), "orbit": True, "seconds": 3.0, "fps": 10, "progress": False, "jobs": 1}


def terrain(target):
    y, x = np.mgrid[:300, :380]
    heights = (300 * np.sin(x / 21) * np.cos(y / 17) + 20 * np.sin(x / 2.3 + y / 3.1)).astype(np.float32)
    heights[90:140, 200:300] = np.nan
    grid = Grid(heights.shape, Affine(20, 0, 500_000, 0, -20, 4_000_000), CRS.from_epsg(32611))
    store.build(ArraySource(heights, grid, "hills"), target, shard=64, chunk=16, jobs=1, progress=False).close()


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class Alone:
    """A cluster of this process alone: each task by a state of its own."""

    def __init__(self, recipe):
        self.recipe = recipe

    def run(self, stage, progress):
        spots = list(stage.tasks())
        random.shuffle(spots)
        for spot in spots:
            own = BakeState(self.recipe).stage(stage.name, stage.number)
            if own.found(spot) is None:
                own.make(spot)
        for spot in stage.tasks():
            stage.add(spot, stage.found(spot, proof=False))
        stage.finish()


@contextlib.contextmanager
def alone(recipe, *_):
    yield Alone(recipe)


def killed(work, kills, rng):
    """Run ``work`` in a fork, again and again, killed sooner or later ``kills`` times at most; how often it was."""
    count, longest = 0, 0.4
    while True:
        pid = os.fork()
        if pid == 0:
            try:
                work()
                os._exit(0)
            except BaseException as error:
                print(f"{type(error).__name__}: {error}", file=sys.stderr)
                os._exit(1)
        if count < kills:
            time.sleep(rng.uniform(0.0, longest))
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if status == 0:
            return count
        assert status == -signal.SIGKILL, status
        count += 1
        longest *= 1.02  # the same moment must not come for ever


def main(folder, least):
    rng = random.Random(9)
    ground = folder / "hills.oro"
    terrain(ground)
    shutil.copytree(ground, folder / "whole.oro")
    orograph.bake(folder / "whole.oro", NAMES, OPTIONS, jobs=1, progress=False).close()
    expected = files(folder / "whole.oro")
    baking.on_workers = alone
    how = {"workers": 1, "progress": False}
    shutil.copytree(ground, folder / "warm.oro")
    orograph.bake(folder / "warm.oro", NAMES, OPTIONS, **how).close()
    assert files(folder / "warm.oro") == expected
    total, trial = 0, 0
    while total < least:
        target = folder / f"{trial}.oro"
        shutil.copytree(ground, target)
        total += killed(lambda at=target: orograph.bake(at, NAMES, OPTIONS, **how).close(), least - total, rng)
        assert files(target) == expected, "a bake"
        shutil.rmtree(target)
        trial += 1
    print("bake", total, trial, flush=True)
    orograph.movie(ground, folder / "whole" / "%03d.png", **FILM)
    frames = files(folder / "whole")
    total, trial = 0, 0
    while total < least:
        out = folder / f"film{trial}"
        total += killed(lambda at=out: orograph.movie(ground, at / "%03d.png", part=(1, 1), **FILM), least - total, rng)
        orograph.movie(ground, out / "%03d.png", finish=True, **FILM)
        left = {name: data for name, data in files(out).items() if not name.endswith(".part")}
        assert left == frames, "a film"
        trial += 1
    print("film", total, trial, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
