"""ROAM on a smooth flight: changes per frame, their cost, and the gain from each of the paper's increments.

    python bench/roam.py [HEIGHTS.npy | DEM | --size 4097] [--cell 30] [--frames 60] [--speed 100] [--queues]

The eye flies 300 m above the ground at ``--speed`` m/s, 60 frames a second, turning by a few degrees a second. Times
are of the method (``Roam.mesh``), in ms of its thread's processor time, so that other load counts little. The first
frames, which compile and build the mesh, are left out. Without a terrain, it is the synthetic one of ``orograph synth
--seed 7``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine

from orograph.geo.grid import Grid
from orograph.lod.method import Goal
from orograph.lod.queues import heap_pop, heap_push
from orograph.lod.roam import Roam, mesh, queues
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import Camera, View
from synthetic import synthetic

RATE = 60.0
TURN = 2.0
CHANGES = 60
"""New triangles per frame of the flights over meshes of different sizes."""


def load(path: str, cell: float) -> MemoryTerrain:
    """A terrain in memory from an array or a raster; cells in degrees become squares, as at the equator."""
    if path.endswith(".npy"):
        z = np.load(path)
    else:
        import rasterio

        with rasterio.open(path) as file:
            z = file.read(1).astype(np.float32)
            z[z == np.float32(file.nodata if file.nodata is not None else np.nan)] = np.nan
            cell = abs(file.transform.a) * (111_320 if file.crs is not None and file.crs.is_geographic else 1)
    return MemoryTerrain(z, Grid(z.shape, Affine(cell, 0, 0, 0, -cell, 0)), Path(path).name)


def flight(t: MemoryTerrain, frames: int, speed: float, turn: float = TURN) -> list[View]:
    """300 m above smoothed ground, from the middle of the southern third, in a wide left turn (°/s)."""
    rows, cols = t.grid.shape
    cell = t.grid.spacing[0]
    x, y = t.grid.xy(cols * 0.5, rows * 0.7)
    eye, heading, views, height = np.array([float(x), float(y)]), np.pi / 2, [], None
    for _ in range(frames):
        c, r = (int(v) for v in t.grid.index(*eye))
        reach = max(2, int(300 / cell))
        around = t.heights[max(r - reach, 0) : r + reach, max(c - reach, 0) : c + reach]
        ground = float(np.nanmean(around))
        height = ground + 300 if height is None else height + 0.02 * (ground + 300 - height)
        ahead = np.array([np.cos(heading), np.sin(heading)])
        views.append(View((*eye, height), (*(eye + 2000 * ahead), height - 400), fov_y=50, width=1920, height=1080))
        eye = eye + ahead * speed / RATE
        heading += np.radians(turn) / RATE
    return views


def fly(method: Roam, views: list[View], scratch: bool = False, **goal: Any) -> dict[str, float]:
    """Means over all frames but the first three; times are medians."""
    found: dict[str, list[float]] = {}
    for k, view in enumerate(views):
        if scratch:
            method.restart()
        began = time.thread_time()
        made, _ = method.mesh(Camera.over(method.terrain.grid, view), Goal(**goal))
        ms = (time.thread_time() - began) * 1e3
        if k < 3:
            continue
        n = max(made.triangles, 1)
        entry = {"triangles": n, "ms": ms, "changed": 100 * made.stats["changed"] / n, **{
            name: made.stats[name] for name in ("splits", "merges", "recomputed")}}  # fmt: skip
        for name, value in entry.items():
            found.setdefault(name, []).append(value)
    return {name: float(np.median(values) if name == "ms" else np.mean(values)) for name, values in found.items()}


def row(name: str, f: dict[str, float], base: float | None = None) -> None:
    ratio = "" if base is None else f"{f['ms'] / base:7.1f}×"
    print(
        f"{name:34s} {f['triangles']:9,.0f} {f['changed']:7.2f} {f['splits']:8.0f} {f['merges']:8.0f} "
        f"{f['recomputed']:10,.0f} {f['ms']:8.2f} {ratio}"
    )


def rate_of_queues() -> None:
    """Rate of priority changes and pops: the buckets, and a binary heap that drops stale entries when popped."""
    from orograph._numba import kernel

    @kernel
    def with_buckets(nodes: Any, heads: Any, occupied: Any, who: Any, p: Any) -> None:
        for k in range(len(who)):
            queues.enqueue(nodes, heads, occupied, 0, who[k], p[k])
            if k & 7 == 7:
                i = np.int64(heads[0, queues.highest(occupied, 0)])
                queues.dequeue(nodes, heads, occupied, 0, i)

    @kernel
    def with_heap(valid: Any, priorities: Any, codes: Any, slots: Any, who: Any, p: Any) -> None:
        size = 0
        for k in range(len(who)):
            heap_push(priorities, codes, slots, size, p[k], k, who[k])
            valid[who[k]] = k
            size += 1
            if k & 7 == 7:
                while size:
                    code, i = codes[0], slots[0]
                    heap_pop(priorities, codes, slots, size)
                    size -= 1
                    if valid[i] == code:
                        valid[i] = -1
                        break

    rng = np.random.default_rng(0)
    count, changes = 200_000, 2_000_000
    who = rng.integers(0, count, changes)
    start = rng.lognormal(-1, 1, count)
    p = (start[who] * rng.uniform(0.98, 1.02, changes)).astype(np.float32)  # priorities drift
    nodes = np.zeros(count, mesh.NODE)
    nodes["bucket"] = -1
    heads, occupied = np.full((2, queues.BUCKETS), -1, np.int32), np.zeros((2, queues.BUCKETS // 64), np.uint64)
    heap = np.zeros(count, np.int64), np.zeros(changes), np.zeros(changes, np.int64), np.zeros(changes, np.int64)
    runs: dict[str, Callable[[int], None]] = {
        "buckets": lambda n: with_buckets(nodes, heads, occupied, who[:n], p[:n]),
        "binary heap": lambda n: with_heap(*heap, who[:n], p[:n]),
    }
    for name, run in runs.items():
        run(8)
        began = time.thread_time()
        run(changes)
        print(f"{name:12s} {(time.thread_time() - began) / changes * 1e9:6.0f} ns per change, a pop after every eighth")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("heights", nargs="?", help="default: a synthetic terrain")
    parser.add_argument("--size", type=int, default=4097, help="its samples along a side")
    parser.add_argument("--cell", type=float, default=30.0)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--speed", type=float, default=100.0)
    parser.add_argument("--queues", action="store_true", help="only measure the queues")
    given = parser.parse_args()
    if given.queues:
        rate_of_queues()
        return
    t = load(given.heights, given.cell) if given.heights else synthetic(given.size, cell=given.cell)
    views = flight(t, given.frames, given.speed)
    print(f"{t!r}, {given.frames} frames, {given.speed:.0f} m/s")
    print(f"{'':34s} {'triangles':>9s} {'% new':>7s} {'splits':>8s} {'merges':>8s} {'recomputed':>10s} {'ms':>8s}")
    whole = Roam(t)
    base = fly(whole, views, tolerance=1.0)
    row("tolerance 1 px", base)
    for tolerance in (0.5, 2.0, 4.0):
        row(f"tolerance {tolerance} px", fly(Roam(t), views, tolerance=tolerance))
    for tolerance in (1.0, 4.0):
        row(f"tolerance {tolerance} px, wedgie", fly(Roam(t, metric="wedgie"), views, tolerance=tolerance))
    for factor in (0.0, 0.25, 4.0):
        row(
            f"{factor * given.speed:.0f} m/s",
            fly(Roam(t), flight(t, given.frames, factor * given.speed), tolerance=1.0),
        )
    print("as many changes in a frame, whatever the mesh: the camera the slower the larger the mesh")
    for tolerance in (4.0, 1.0, 0.5, 0.15):
        first = fly(Roam(t), flight(t, 20, given.speed), tolerance=tolerance)
        pace = CHANGES / max(first["changed"] / 100 * first["triangles"], 1.0)
        slower = flight(t, given.frames, pace * given.speed, pace * TURN)
        row(f"tolerance {tolerance} px, {pace:.2f} × the pace", fly(Roam(t), slower, tolerance=tolerance))
    row("budget of triangles", fly(Roam(t), views, triangles=int(base["triangles"])))
    print("ablation, as ratios of the time of a frame")
    row("all of it", base, base["ms"])
    row("no deferral", fly(Roam(t, deferral=False), views, tolerance=1.0), base["ms"])
    row("strips rebuilt", fly(Roam(t, strips="rebuilt"), views, tolerance=1.0), base["ms"])
    row("no strips (a list)", fly(Roam(t, strips=None), views, tolerance=1.0), base["ms"])
    row("no incremental splits and merges", fly(whole, views[:8], scratch=True, tolerance=1.0), base["ms"])


if __name__ == "__main__":
    main()
