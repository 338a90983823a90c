"""The search for the best views compared with brute force: the same cameras and pieces, one ray for every pair.

    python bench/best_view.py [DEM.tif] [--side SAMPLES] [--pieces N]

Brute force casts a ray from every piece to every camera (``raycast.Caster``, which also draws pictures, on the exact
surface) and multiplies by the quality that the search computes without rays. Both use one thread, and are compiled
before they are timed. Times are processor time; of the search, the median of ``RUNS``. Without a DEM, the terrain is a
fractal.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

import orograph
from orograph.raycast.caster import Caster
from orograph.touring.best_cameras import cameras
from orograph.touring.best_kernels import qualities
from orograph.touring.best_search import Search
from orograph.touring.best_target import Target, read_target

HEIGHTS = (2.0, 5.0, 10.0, 20.0, 35.0, 50.0, 75.0, 100.0, 150.0, 200.0)
RUNS = 7
PITCHES = (3.0, 6.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0)


def brute(search: Search, heights: np.ndarray, target: Target, eyes: np.ndarray, index: np.ndarray) -> np.ndarray:
    """The score of each camera, (m,)."""
    caster = Caster.of(heights, jobs=1)
    start = np.column_stack([index, target.points[:, 2] + 1e-3])
    out, q = np.empty(len(eyes)), np.empty(len(target.points))
    for m, eye in enumerate(eyes):
        qualities(search._cameras, m, search._pieces, q)
        t, _ = caster.cast(start, np.column_stack([eye[:2] - index, eye[2] - start[:, 2]]), 0.0, 1.0)
        out[m] = target.weight @ np.where((q > 0) & np.isnan(t), q, 0.0)
    return out


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--side", type=int, default=1025)
    parser.add_argument("--pieces", type=int, default=1000)
    parser.add_argument("--part", type=float, default=0.15, help="side of the target, as a fraction of the terrain's")
    given = parser.parse_args()
    dem = given.dem or orograph.synth(size=given.side, seed=7)
    terrain = orograph.terrain(dem, progress=False)
    rows, cols = terrain.grid.shape
    side = given.part * min(rows, cols)
    ring = [
        [float(v) for v in terrain.grid.xy(cols / 2 + side * x, rows / 2 + side * y)]
        for x, y in ((-0.5, -0.5), (0.5, -0.4), (0.4, 0.5), (-0.5, 0.3), (-0.5, -0.5))
    ]
    area = {"type": "Polygon", "coordinates": [ring], "crs": {"properties": {"name": terrain.grid.crs.to_wkt()}}}
    target = read_target(terrain, area, given.pieces)
    measured(terrain, target, "orbits", pitches=PITCHES)
    measured(
        terrain,
        target,
        "near the ground",
        pitches=(),
        above=HEIGHTS,
        distances=[1.5 * target.radius * f for f in (1, 1.5, 2, 3, 4)],
    )


def measured(terrain: Any, target: Target, called: str, **allowed: Any) -> None:
    """Search, cast all rays, and print both times."""
    seconds: dict[int, list[float]] = {1: [], 3: []}
    for _ in range(RUNS + 1):  # the first run compiles the kernels
        for k, spent in seconds.items():
            begin = time.process_time()
            cams = cameras(terrain, target, (1280, 720), azimuths=144, **allowed)
            search = Search(terrain, target, cams, jobs=1)
            found = search.views(k, 20.0)
            spent.append(time.process_time() - begin)
            if k == 1:
                best, looks = found[0], search.looks
    ours, ours3 = (statistics.median(spent[1:]) for spent in seconds.values())
    col, row = terrain.grid.index(target.points[:, 0], target.points[:, 1])
    eyes = np.column_stack([*terrain.grid.index(cams.eyes[:, 0], cams.eyes[:, 1]), cams.eyes[:, 2]])
    rows, cols = terrain.grid.shape
    heights = terrain.read(0, 0, rows, 0, cols)
    begin = time.process_time()
    scores = brute(search, heights, target, eyes, np.column_stack([col, row]))
    theirs = time.process_time() - begin
    pairs = len(cams) * len(target.points)
    print(f"{terrain.name}, {called}: {rows} × {cols} samples, {len(cams)} cameras, {len(target.points)} pieces")
    print(f"brute force  {theirs:8.2f} s  {pairs} rays, best score {scores.max():.6f}")
    print(
        f"one view     {ours:8.3f} s  {looks} lines ({100 * looks / pairs:.2f} %), score {best.score:.6f}, "
        f"{theirs / ours:.0f} times faster; brute force gives that camera {scores[best.camera]:.6f}, "
        f"{100 * (1 - scores[best.camera] / scores.max()):.3f} % below its best"
    )
    print(f"three views  {ours3:8.3f} s  {search.looks} lines, together {sum(f.gain for f in found):.4f}")


if __name__ == "__main__":
    main()
