"""Time budgets on a smooth flight: how well each method keeps them, and how fine its meshes are for the time.

    python bench/budgets.py [HEIGHTS.npy | DEM | --size 4097] [--cell 30] [--frames 100] [--ms 5 …] [--method M …]

The flight is that of ``bench/roam.py``. Every method with a time goal is given each ``--ms`` as its budget. The table
has the median and the 95th percentile of a frame's time (processor time of its one thread, ms), and the medians of the
triangles and of the tolerance that a frame reports, pixels. *At best* is the tolerance at which the same method, given
that tolerance as its goal, takes the same median time on a flight; it is found by bisection, to 5 %. The first ten
frames are left out, because they compile and learn how long a pass takes.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orograph.errors import UsageError
from orograph.lod.budget import FINEST
from orograph.lod.method import Goal, Method, Resources
from orograph.lod.registry import chosen, method_of, names
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import Camera, View
from roam import flight, load
from synthetic import synthetic

FIRST = 10
"""Frames that are left out."""

NEAR = 1.05
"""Precision of the bisection for the tolerance at best, as a factor."""


def frames(method: Method, views: Sequence[View], goal: Goal) -> np.ndarray:
    """Milliseconds, triangles and reported tolerance of the frames that count, (n, 3)."""
    rows = []
    for view in views:
        camera = Camera.over(method.terrain.grid, view)
        began = time.thread_time()
        if hasattr(method, "mesh"):
            mesh, _ = method.mesh(camera, goal)
            count, reached = mesh.triangles, mesh.tolerance if mesh.within or method.info.incremental else None
        else:
            selection = method.select(camera, goal)
            count, reached = selection.stats["triangles"], selection.stats["tolerance"]
        took = (time.thread_time() - began) * 1e3
        rows.append((took, count, math.nan if reached is None else reached))
    return np.array(rows[FIRST:])


def make(text: str, t: MemoryTerrain) -> Method:
    return chosen(text).make(t, Resources(jobs=1))


def at_best(text: str, t: MemoryTerrain, views: Sequence[View], ms: float) -> float:
    """The finest tolerance whose median time is at most ``ms``."""
    method = make(text, t)

    def takes(tolerance: float) -> float:
        return float(np.median(frames(method, views, Goal(tolerance))[:, 0]))

    low, high = FINEST, 1.0
    while takes(high) > ms and high < 1024.0:
        low, high = high, 2.0 * high
    if high == 1.0:
        while high > FINEST and takes(high / 2.0) <= ms:
            high /= 2.0
        low = high / 2.0
    while high / low > NEAR:
        middle = math.sqrt(low * high)
        if takes(middle) <= ms:
            high = middle
        else:
            low = middle
    return high


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("heights", nargs="?", help="default: a synthetic terrain")
    parser.add_argument("--size", type=int, default=4097, help="its samples along a side")
    parser.add_argument("--cell", type=float, default=30.0)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--speed", type=float, default=100.0)
    parser.add_argument("--ms", type=float, action="append", help="budgets; default: 5, 10, 20 and 50")
    parser.add_argument("--method", action="append", help="default: all with a time goal")
    parser.add_argument("--no-best", action="store_true", help="skip *at best*")
    given = parser.parse_args()
    t = load(given.heights, given.cell) if given.heights else synthetic(given.size, cell=given.cell)
    views = flight(t, FIRST + given.frames, given.speed)
    few = views[: FIRST + max(given.frames // 5, 5)]
    print(f"{Path(t.name).name}, {given.frames} frames, {given.speed:.0f} m/s")
    print(f"{'':28s} {'asked':>6s} {'median':>8s} {'95th':>8s} {'triangles':>10s} {'px':>8s} {'at best':>8s}")
    for text in given.method or [name for name in names() if "seconds" in method_of(name).info.goals]:
        for ms in given.ms or (5.0, 10.0, 20.0, 50.0):
            try:
                method = make(text, t)
            except UsageError as error:
                print(f"{text:28s} left out: {error}")
                break
            found = frames(method, views, Goal(seconds=ms / 1e3))
            taken, count = np.median(found[:, :2], axis=0)
            reported = found[~np.isnan(found[:, 2]), 2]  # (clipmaps promise nothing)
            reached = np.median(reported) if len(reported) else math.nan
            best = "" if given.no_best else f"{at_best(text, t, few, ms):8.2f}"
            print(
                f"{text:28s} {ms:6.0f} {taken:8.2f} {np.quantile(found[:, 0], 0.95):8.2f} {count:10,.0f} "
                f"{reached:8.2f} {best}",
                flush=True,
            )


if __name__ == "__main__":
    main()
