"""TINs compared with their peers: triangles, true errors, and samples per second, on one core.

    python bench/tin.py [DEM … | --size 1025] [--max-error 2 20] [--side 512]

For each bound: the TIN that keeps it on the surface, and the one that keeps it at samples; pydelatin with the same
bound; and quadric simplification (meshoptimizer, fast-simplification; Garland & Heckbert 1997) to as many triangles as
the TIN on the surface has. The referee (``verify.judge_mesh``) measures all errors, in vertical metres: on the surface,
and at samples. Times are processor seconds of one thread; of the TIN
and pydelatin the least of three. Only the TIN is run on rasters with missing samples, because
its peers do not support them. Without a DEM, the terrain is synthetic (``orograph synth --seed 7``).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from orograph import verify
from orograph.meshing.tin import SIDE, tin
from orograph.store.memory import MemoryTerrain
from orograph.tessellation import Tessellation, turn
from roam import load
from synthetic import synthetic

Row = tuple[str, Tessellation, float]


def timed(work: Callable[[], Any], tries: int = 1) -> tuple[Any, float]:
    """The result, and the least time of some tries."""
    least = float("inf")
    for _ in range(tries):
        began = time.process_time()
        made = work()
        least = min(least, time.process_time() - began)
    return made, least


def oriented(terrain: MemoryTerrain, vertices: np.ndarray, triangles: np.ndarray, free: bool = False) -> Tessellation:
    """A peer's mesh with its triangles oriented alike and without those of no area."""
    x, y = vertices[:, 0], vertices[:, 1]
    a, b, c = triangles.T
    area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    triangles = np.where((area * turn(terrain.grid) < 0)[:, None], triangles[:, ::-1], triangles)[area != 0]
    return Tessellation(
        np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(triangles, np.int32), None, {"geomorph": free}
    )


def full(heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All samples as float32 (column, row, height), and the triangles of the surface."""
    rows, cols = heights.shape
    y, x = np.mgrid[:rows, :cols]
    vertices = np.stack([x, y, heights], -1).reshape(-1, 3).astype(np.float32)
    nw = (y * cols + x)[:-1, :-1]
    main = ((x + y)[:-1, :-1] & 1) == 0
    ne, sw, se = nw + 1, nw + cols, nw + cols + 1
    first = np.stack([nw, ne, np.where(main, se, sw)], -1)
    second = np.stack([np.where(main, nw, ne), se, sw], -1)
    return vertices, np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


def delatin(terrain: MemoryTerrain, limit: float) -> Row:
    from pydelatin import Delatin

    heights = np.ascontiguousarray(terrain.heights)
    made, seconds = timed(lambda: Delatin(heights, max_error=limit), 3)
    vertices = np.array(made.vertices, np.float64)
    vertices[:, 1] = heights.shape[0] - 1 - vertices[:, 1]
    return "pydelatin", oriented(terrain, vertices, np.array(made.triangles)), seconds


def quadrics(terrain: MemoryTerrain, goal: int) -> list[Row]:
    """Both peers; positions are metres for them, columns and rows for the referee."""
    import fast_simplification
    import meshoptimizer

    vertices, triangles = full(terrain.heights)
    cell = abs(terrain.grid.transform.a)
    metres = vertices * np.array([cell, cell, 1], np.float32)
    corners = np.ascontiguousarray(triangles.reshape(-1), np.uint32)
    kept = np.empty_like(corners)

    def optimise() -> int:
        return int(
            meshoptimizer.simplify(
                kept, corners, metres, target_index_count=3 * goal, target_error=1.0,
            )
        )  # fmt: skip

    count, seconds = timed(optimise)
    rows = [("meshoptimizer", oriented(terrain, vertices, kept[:count].reshape(-1, 3).astype(np.int32)), seconds)]
    (points, faces), seconds = timed(
        lambda: fast_simplification.simplify(metres, triangles.astype(np.int32), target_count=goal)
    )
    points = points.astype(np.float64) / [cell, cell, 1]
    points[:, :2] = np.round(points[:, :2] * 1024) / 1024  # as fine as the referee's count
    points[:, :2] = np.clip(points[:, :2], 0, np.array(terrain.grid.shape[::-1]) - 1)
    return [*rows, ("fast-simplification", oriented(terrain, points, faces, free=True), seconds)]


def table(terrain: MemoryTerrain, limit: float, side: int) -> None:
    rows: list[Row] = []
    for bound in ("surface", "samples"):
        mesh, seconds = timed(lambda bound=bound: tin(terrain, limit, bound=bound, jobs=1, side=side), 3)
        rows.append((f"TIN, {bound}", mesh, seconds))
    if not np.isnan(terrain.heights).any():
        rows += [delatin(terrain, limit), *quadrics(terrain, len(rows[0][1].triangles))]
    print(f"\n{terrain.name}, {terrain.heights.shape}, {limit:g} m")
    print(f"  {'':20} {'triangles':>10} {'surface m':>10} {'samples m':>10} {'defects':>8} {'s':>7} {'Msample/s':>10}")
    for name, mesh, seconds in rows:
        report = verify.judge_mesh(mesh, terrain, verify.level_view(terrain))
        print(
            f"  {name:20} {len(mesh.triangles):10,} {report.largest:10.2f} {report.largest_at_samples:10.2f} "
            f"{sum(report.defects.values()):8,} {seconds:7.2f} {terrain.heights.size / 1e6 / seconds:10.2f}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dem", nargs="*")
    parser.add_argument("--size", type=int, default=1025)
    parser.add_argument("--max-error", type=float, nargs="+", default=[2.0, 20.0])
    parser.add_argument("--side", type=int, default=SIDE)
    options = parser.parse_args()
    warm = synthetic(65)
    for bound in ("surface", "samples"):
        tin(warm, 1.0, bound=bound)
    for terrain in [load(path, 30.0) for path in options.dem] or [synthetic(options.size)]:
        for limit in options.max_error:
            table(terrain, limit, options.side)


if __name__ == "__main__":
    main()
