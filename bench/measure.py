"""Measuring: picks, profiles, areas and viewsheds on a terrain in memory and on a store, and their peak memory.

Run: ``python bench/measure.py [DEM or STORE] [--size 4097] [--radius 30000] [--large]``. Without a path, the terrain is
a fractal with a spacing of 30 m. Viewsheds are reported in samples per second (each has its own line of sight),
compared with a plain loop: the same lines walked cell by cell without a pyramid. ``--large`` computes the viewshed of
the whole terrain with a scratch file in a separate process (with 256 MiB of memory) and prints its peak memory.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from horizon import fractal
from orograph import measuring, store
from orograph.measuring import viewshed_kernels
from orograph.scene import camera
from orograph.store import Terrain
from orograph.store.prepare import prepare


def timed(work: Callable[[], Any], repeat: int = 3) -> float:
    """The least of ``repeat`` times, seconds; the first call is not counted."""
    work()
    best = np.inf
    for _ in range(repeat):
        began = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - began)
    return best


def places(terrain: Terrain) -> None:
    rng = np.random.default_rng(0)
    view = camera.around(terrain, (1280, 720), azimuth=200, pitch=35, distance=None)
    pixels = np.column_stack([rng.uniform(0, 1280, 100), rng.uniform(300, 720, 100)])
    found: list[Any] = []

    def picks() -> None:
        found[:] = [measuring.pick(terrain, view, tuple(p)) for p in pixels]

    seconds = timed(picks)
    print(f"  pick      {10 * seconds:8.2f} ms each ({sum(h is not None for h in found)} of 100 rays hit)")
    rows, cols = terrain.grid.shape
    line = np.stack(terrain.grid.xy([0.03 * cols, 0.97 * cols], [0.1 * rows, 0.9 * rows]), axis=-1)
    made = measuring.profile(terrain, line)
    seconds = timed(lambda: measuring.profile(terrain, line))
    print(f"  profile   {1e3 * seconds:8.1f} ms, {len(made.heights):,} places, {made.length / 1000:.1f} km")
    a = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.stack(terrain.grid.xy(cols / 2 + 0.45 * cols * np.cos(a), rows / 2 + 0.45 * rows * np.sin(a)), axis=-1)
    for jobs in (1, 2):
        seconds = timed(lambda: measuring.area(terrain, ring, jobs=jobs), 2)  # noqa: B023
        samples = 0.45**2 * np.pi * rows * cols
        print(f"  area      {seconds:8.2f} s, {samples / seconds / 1e6:.0f} M samples/s, {jobs} thread(s)")


def sheds(terrain: Terrain, radius: float | None) -> None:
    rows, cols = terrain.grid.shape
    for eye in (1.7, 100.0):
        point = terrain.grid.xy(0.5 * cols + 0.3, 0.5 * rows + 0.7)
        for heights in (False, True):
            for jobs in (1, 2):
                shed = measuring.viewshed(terrain, point, eye, radius=radius, heights=heights, jobs=jobs)
                shed.values()
                began = time.perf_counter()
                values = shed.values()
                seconds = time.perf_counter() - began
                known = np.isfinite(values).sum()
                seen = (values <= 0 if heights else values > 0).sum() / known
                what = "heights needed" if heights else "seen or not"
                rate = known / seconds / 1e6
                print(
                    f"  viewshed  eye {eye:5.1f} m, {what:14s} {jobs} thread(s): {rate:5.2f} M samples/s"
                    f" ({seen:.1%} of {known:,} seen)"
                )
        plain(terrain, point, eye, radius)


def plain(terrain: Terrain, point: Any, eye: float, radius: float | None) -> None:
    """Walk the same lines without the pyramid, on every 16th row."""
    shed = measuring.viewshed(terrain, point, eye, radius=radius, jobs=1)
    s = shed._scene
    rows, cols = shed.grid.shape
    # No ray passes above a pyramid of one level that is infinitely high.
    maxima = np.full(1 << 22, np.int32(2**31 - 1))
    offset, per_row = np.array([-1], np.int64), np.array([cols], np.int64)
    pyramid = viewshed_kernels.Pyramid(s.pyramid.z, maxima, offset, per_row)
    lines = range(0, rows, max(16, rows // 32))
    out = np.empty((1, cols), np.float32)
    dr, dc = shed.row - s.row, shed.col - s.col

    def work() -> None:
        for r in lines:
            window = r + dr, r + dr + 1, dc, dc + cols
            viewshed_kernels.look(pyramid, s.x, s.y, 0.0, np.ones((1, cols)), 4.0, True, window, out)

    seconds = timed(work, 1)
    print(f"  {'':38s} without the pyramid: {len(lines) * cols / seconds / 1e6:5.2f} M samples/s on one thread")


LARGE = """
import json, sys, time
from orograph import store
from orograph.cli.memory import peak_memory
from orograph import measuring
terrain = store.open(sys.argv[1], cache_bytes=16 << 20)
rows, cols = terrain.grid.shape
began = time.perf_counter()
shed = measuring.viewshed(terrain, terrain.grid.xy(cols / 2, rows / 2), 100.0, max_memory=256 << 20)
saved = shed.save(sys.argv[2])
print(json.dumps([time.perf_counter() - began, shed.on_disk, saved, peak_memory()]))
"""


def large(path: Path, folder: Path) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", LARGE, str(path), str(folder / "seen.tif")], capture_output=True, text=True, check=True
    )
    seconds, on_disk, saved, peak = json.loads(ran.stdout)
    print(
        f"  viewshed of all of it, eye 100 m: {seconds:.1f} s for {saved['samples']:,} samples, "
        f"{'scratch file' if on_disk else 'in memory'}, {peak >> 20} MiB at most (mapped file included)"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", nargs="?")
    parser.add_argument("--size", type=int, default=4097)
    parser.add_argument("--radius", type=float, default=30_000.0)
    parser.add_argument("--large", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.path:
            terrains = [prepare([args.path])]
        else:
            from affine import Affine
            from pyproj import CRS

            from orograph.geo import Grid

            transform = Affine(30, 0, 400_000, 0, -30, 4_000_000)
            grid = Grid((args.size, args.size), transform, CRS.from_epsg(32611))
            heights = fractal(args.size) / 8
            terrains = [store.MemoryTerrain(heights, grid, "fractal, in memory")]
            terrains.append(store.build(store.ArraySource(heights, grid, "fractal, a store"), folder / "f.oro"))
        for terrain in terrains:
            print(f"{terrain.name}: {terrain.grid.cols} × {terrain.grid.rows} samples")
            places(terrain)
        sheds(terrains[0], args.radius)
        if args.large:
            large(Path(args.path) if args.path else folder / "f.oro", folder)


if __name__ == "__main__":
    main()
