"""BDAM measured: its triangles compared with other methods', its size, how triangles are halved, and its promise.

    python bench/bdam.py [--data FOLDER] [--part PART] [--count 10] [--terrain NAME] [--method bdam]

*table*: ``bdam``, ``triangle-patches`` and ``soar`` on the five terrains of ``bench/promise.py``, at 1 pixel over
``--count`` random views: triangles and patches (means); the largest error anywhere on the visible surface (by the
referee, in half of the views); processor ms to select (medians of second selections; for ``bdam``, patches are unpacked
before); processor seconds to make in memory what each needs besides heights, and its bytes per sample, compressed as in
a store.

*halving*: for every level of the hierarchy, the ratio of its triangles to those of the patches below, how many vertices
the legs of diamonds lock, and the largest error.

*marks*: bits per vertex in a store (its mark, and its share of errors and spheres), and the largest distance between
stored vertices and their samples; for comparison, the vertices as in the paper, quantised in the box of their diamond
(a byte for the column, a byte for the row, 16 bits for the height) and compressed (Zstandard, byte planes apart), with
the largest error of their heights.

*cache*: vertices that miss a cache (first in, first out) per triangle, for the TINs of the diamonds that six views at 2
pixels draw: as triangulated, as drawn (Tipsify), and in meshoptimizer's order.

*promise*: the referee on random views of more terrains (voids, oblong, 1 m, 90 m), at tolerances of 0.5 to 8 pixels:
the largest error relative to the tolerance, and every defect of a mesh, for ``--method``.

*geomorph*: ``bdam`` without and with geomorphs at 1 pixel: triangles, patches that are between two TINs, ms of a second
selection, and the largest jump of the surface, over random places, while the tolerance grows in steps of a thousandth.

The views are those of ``bench/promise.py``.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numcodecs import Zstd
from numpy.typing import NDArray

import promise
from orograph import verify
from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.hierarchy import diamonds
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.lod.vertex_cache import CACHE, misses, reordered
from orograph.store.build import build
from orograph.store.memory import MemoryTerrain
from orograph.store.tin_diamonds import Workplace, tins_of
from orograph.store.tins import stored_levels
from orograph.viewpoint import Camera

PARTS = ("table", "halving", "marks", "cache", "promise", "geomorph")

METHODS = ("triangle-patches", "soar", "bdam,legs=8", "bdam", "bdam,legs=32")

MORE = {
    "fortbragg 1 m": "fortbragg-1m-dem-ortho/elevation_2016.tif",
    "winnipeg 1s": "winnipeg-1s-isce3/winnipeg_dem.tif",
    "everest 90 m": "osgearth-srtm90m-volcano-voids/mt_everest_90m.tif",
}
"""Terrains for the promise in addition to those of ``promise``."""


def bytes_of(terrain: MemoryTerrain, text: str, method: Any) -> float:
    """Bytes per sample of what a method needs besides heights."""
    with tempfile.TemporaryDirectory() as folder:
        legs = method.legs if text.startswith("bdam") else None
        made = build(
            Dem(terrain.heights, terrain.grid), Path(folder) / "a.oro", tins=legs, progress=False, keep_source=False
        )  # fmt: skip
        groups = {"bdam": ["tins"], "triangle-patches": ["diamonds", "patches"], "soar": ["diamonds"]}
        found = sum(
            file.stat().st_size
            for group in groups[text.partition(",")[0]]
            for file in (Path(folder) / "a.oro" / group).rglob("*")
            if file.is_file()
        )
        made.close()
    rows, cols = terrain.grid.shape
    return found / (rows * cols)


def table(data: Path, count: int, only: str | None) -> None:
    """Compare the methods."""
    print(
        f"{'':18} {'triangles':>10} {'patches':>8} {'largest px':>10} {'ms':>6} {'build s':>8} {'bytes a sample':>15}"
    )
    for name in promise.TERRAINS:
        if only not in (None, name) or (terrain := promise.terrain_of(name, data)) is None:
            continue
        views = [view for _, view in promise.views(terrain, count, 1)]
        print(f"{name}, {terrain.grid.cols} x {terrain.grid.rows}")
        terrain.tiles(0)
        small = MemoryTerrain(terrain.heights[:65, :65].copy(), promise_grid(terrain), "compiles")
        for text in METHODS:
            chosen(text).make(small).select(Camera.over(terrain.grid, views[0]), Goal(1.0)).tessellation()
        for text in METHODS:
            fresh = MemoryTerrain(terrain.heights, terrain.grid, name)
            began = time.process_time()
            method = chosen(text).make(fresh)
            built = time.process_time() - began
            triangles, patches, times, largest = [], [], [], 0.0
            for number, view in enumerate(views):
                camera = Camera.over(terrain.grid, view)
                found = method.select(camera, Goal(1.0))
                began = time.process_time()
                found = method.select(camera, Goal(1.0))
                times.append(1e3 * (time.process_time() - began))
                triangles.append(found.stats["triangles"])
                patches.append(found.stats.get("patches", 0))
                if number % 2 == 0:
                    largest = max(largest, verify.judge_mesh(found.tessellation(), terrain, view).largest)
            print(
                f"  {text:16} {statistics.mean(triangles):10,.0f} {statistics.mean(patches):8,.0f} {largest:10.3f} "
                f"{statistics.median(times):6.1f} {built:8.1f} {bytes_of(terrain, text, method):15.2f}",
                flush=True,
            )


def promise_grid(terrain: MemoryTerrain) -> Any:
    """The grid of the first 65 × 65 samples."""
    return Grid((65, 65), terrain.grid.transform, terrain.grid.crs)


def halving(data: Path, only: str | None) -> None:
    """Print a row for each level."""
    for name in promise.TERRAINS:
        if only not in (None, name) or (terrain := promise.terrain_of(name, data)) is None:
            continue
        for text in ("bdam,legs=4", "bdam,legs=8", "bdam", "bdam,legs=32"):
            method = chosen(text).make(terrain)
            print(f"{name}, {text}")
            for f in method.tins.figures:  # type: ignore[attr-defined]
                if f.diamonds:
                    print(
                        f"  octave {f.octave:2} {'edges' if f.kind else 'squares':8} {f.diamonds:7,} diamonds "
                        f"{f.triangles:10,} triangles {f.triangles / max(f.below, 1):6.3f} of those below  "
                        f"{100 * f.legs / max(f.vertices, 1):5.1f} % of vertices on legs  {f.error:9.3f} m",
                        flush=True,
                    )


def diamonds_of(terrain: Any, tins: Any) -> Iterator[tuple[int, int]]:
    """The diamonds that have TINs, (row, col)."""
    for level in stored_levels(terrain.grid.shape, tins.legs):
        shape = terrain.diamond_shape(level)
        errors, radii = tins.read(level, 0, shape[0], 0, shape[1])
        for i, j in zip(*(index.tolist() for index in np.nonzero((errors >= 0) & (radii >= 0)))):
            at = i << level, j << level
            if diamonds.is_diamond(*at, terrain.n) and diamonds.octave(*at) >= tins.legs.bit_length() - 1:
                last = level == terrain.levels - 1
                if last or diamonds.octave(*at) == level:
                    yield at


def quantised(vertices: NDArray[np.float64]) -> tuple[NDArray[np.uint8], float]:
    """A diamond's vertices quantised in their box: bytes (4, v), and the largest error of a height, metres."""
    low, extent = vertices.min(0), np.ptp(vertices, 0)
    places = (vertices[:, :2] - low[:2]) / 2.0 ** max(0.0, np.ceil(np.log2((extent[:2].max() + 1) / 256)))
    step = max(extent[2], 1e-9) / 65535
    heights = np.round((vertices[:, 2] - low[2]) / step).astype(np.uint16)
    off = np.abs(low[2] + heights * step - vertices[:, 2]).max()
    return np.stack([*places.T, heights >> 8, heights & 255]).astype(np.uint8), float(off)


def stored_marks(data: Path, only: str | None) -> None:
    """Measure the size of stored vertices."""
    print(
        f"{'':18} {'vertices':>10} {'marks, bits':>11} {'all':>6} {'off, m':>7} {'quantised, bits':>15} {'off, m':>7}"
    )
    for name in promise.TERRAINS:
        if only not in (None, name) or (terrain := promise.terrain_of(name, data)) is None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            dem = Dem(terrain.heights, terrain.grid)
            made = build(dem, Path(folder) / "a.oro", tins=16, progress=False, keep_source=False)
            bits = [
                8 * sum(file.stat().st_size for file in (Path(folder) / "a.oro/tins").glob(what) if file.is_file())
                for what in ("octave-*/**/*", "**/*")
            ]
            tins, workplace, coded, off, worst = made.derived("tins", legs=16), Workplace(), [], 0.0, 0.0
            for at in diamonds_of(made, tins):
                vertices, *corners = tins_of(made, tins, *at, workplace)
                used = vertices[np.unique(np.concatenate(corners))]
                col, row = used[:, :2].astype(int).T
                off = max(off, float(np.abs(used[:, 2] - terrain.heights[row, col]).max()))
                found, far = quantised(used)
                coded.append(found)
                worst = max(worst, far)
            made.close()
        count = sum(found.shape[1] for found in coded)
        runs = (np.concatenate(coded[k : k + 64], 1) for k in range(0, len(coded), 64))
        bits.append(8 * sum(len(Zstd(9).encode(run.tobytes())) for run in runs))
        marks, everything, packed = (b / count for b in bits)
        print(
            f"{name:18} {count:10,} {marks:11.2f} {everything:6.2f} {off:7.3f} {packed:15.1f} {worst:7.4f}", flush=True
        )


def in_cache(data: Path, only: str | None) -> None:
    """Compare orders of triangles."""
    import meshoptimizer

    for name in promise.TERRAINS:
        if only not in (None, name) or (terrain := promise.terrain_of(name, data)) is None:
            continue
        method: Any = chosen("bdam").make(terrain)
        workplace, count, missed = Workplace(), 0, np.zeros((2, 3))
        for _, view in promise.views(terrain, 6, 1):
            method.select(Camera.over(terrain.grid, view), Goal(2.0))
        for at in method._kept:
            for corners in tins_of(terrain, method.tins, *at, workplace)[1:]:
                used, places = np.unique(corners, return_inverse=True)
                plainly, many = places.reshape(-1, 3).astype(np.int32), len(used)
                theirs = np.zeros(plainly.size, np.uint32)
                meshoptimizer.optimize_vertex_cache(theirs, plainly.astype(np.uint32).ravel(), plainly.size, many)
                orders = plainly, reordered(plainly, many, CACHE), theirs.reshape(-1, 3).astype(np.int32)
                missed += [[misses(order, many, size) for order in orders] for size in (16, 32)]
                count += len(plainly)
        for size, row in zip((16, 32), missed / count):
            print(
                f"{name:18} {count:8,} triangles  cache of {size}  " + " ".join(f"{one:6.3f}" for one in row),
                flush=True,
            )


def kept(data: Path, count: int, only: str | None, text: str) -> None:
    """Judge views by the referee."""
    from orograph.dem.mosaic import Mosaic
    from orograph.store import terrain as in_memory

    rng, total, broken = np.random.default_rng(0), 0, 0
    for name in (*promise.TERRAINS, *MORE):
        if only not in (None, name):
            continue
        terrain: Any
        if name in MORE:
            path = data / MORE[name]
            terrain = in_memory(Mosaic.open([path])) if path.exists() else None
        else:
            terrain = promise.terrain_of(name, data)
        if terrain is None:
            continue
        worst, defects, largest_mesh = 0.0, 0, 0
        method = chosen(text).make(terrain)
        for number, (_, view) in enumerate(promise.views(terrain, count, 5)):
            tolerance = 0.5 * 2.0 ** (number % 5) if number < 5 else float(0.5 * 16 ** rng.uniform())
            found = method.select(Camera.over(terrain.grid, view), Goal(tolerance))
            report = verify.judge_mesh(found.tessellation(), terrain, view)
            worst, defects = max(worst, report.largest / tolerance), defects + sum(report.defects.values())
            largest_mesh = max(largest_mesh, found.stats["triangles"])
            broken += report.largest > tolerance
            total += 1
        print(
            f"{name:18} {terrain.grid.cols:5} x {terrain.grid.rows:5}  {count} views  largest error "
            f"{worst:.3f} of the tolerance  {defects} defects  up to {largest_mesh:,} triangles",
            flush=True,
        )
    print(f"{total} views, the promise broken in {broken}")


def heights_of(mesh: Any, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights of a mesh at places (n, 2), as column and row; NaN outside the mesh."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    found = np.full(len(places), np.nan)
    for n, (x, y) in enumerate(places.tolist()):
        v = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
        w = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
        inside = np.flatnonzero((v >= 0) & (w >= 0) & (v + w <= 1))[:1]
        for t in inside:
            found[n] = a[t, 2] + v[t] * (b[t, 2] - a[t, 2]) + w[t] * (c[t, 2] - a[t, 2])
    return found


def growing(data: Path, count: int, only: str | None) -> None:
    """Measure geomorphs."""
    print(f"{'':20} {'triangles':>10} {'grow':>6} {'ms':>6} {'largest px':>10} {'jump px':>8}")
    for name in promise.TERRAINS:
        if only not in (None, name) or (terrain := promise.terrain_of(name, data)) is None:
            continue
        print(f"{name}, {terrain.grid.cols} x {terrain.grid.rows}")
        made = [chosen(text).make(terrain) for text in ("bdam", "bdam,geomorph=yes")]
        views = [view for _, view in promise.views(terrain, count, 1)]
        rows, cols = terrain.grid.shape
        places = np.random.default_rng(1).uniform(0, 1, (100, 2)) * (cols - 1, rows - 1)
        for method in made:
            triangles, shares, times, largest, jump = [], [], [], 0.0, 0.0
            for number, view in enumerate(views):
                camera = Camera.over(terrain.grid, view)
                found: Any = method.select(camera, Goal(1.0))
                began = time.process_time()
                found = method.select(camera, Goal(1.0))
                times.append(1e3 * (time.process_time() - began))
                triangles.append(found.stats["triangles"])
                shares.append(sum(one.coarse is not None for one in found.batches) / max(len(found.batches), 1))
                if number % 2 == 0:
                    largest = max(largest, verify.judge_mesh(found.tessellation(), terrain, view).largest)
                last = None
                for k in range(6 if number < 4 else 0):
                    mesh = method.select(camera, Goal(1.001**k)).tessellation()
                    up = heights_of(mesh, places)
                    screen, depth = view.project(np.stack([*terrain.grid.xy(*places.T), up], 1))
                    screen[~(depth > view.near)] = np.nan
                    if last is not None:
                        jump = max(jump, float(np.nanmax(np.hypot(*(screen - last).T), initial=0.0)))
                    last = screen
            print(
                f"  {'geomorphs' if method.options.geomorph else 'none':18} {statistics.mean(triangles):10,.0f} "
                f"{statistics.mean(shares):6.2f} {statistics.median(times):6.1f} {largest:10.3f} {jump:8.3f}",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--part", choices=PARTS, action="append")
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--terrain")
    parser.add_argument("--method", default="bdam")
    given = parser.parse_args()
    for part in given.part or PARTS:
        print(f"\n{part}")
        if part == "table":
            table(given.data, given.count, given.terrain)
        elif part == "halving":
            halving(given.data, given.terrain)
        elif part == "cache":
            in_cache(given.data, given.terrain)
        elif part == "marks":
            stored_marks(given.data, given.terrain)
        elif part == "geomorph":
            growing(given.data, given.count, given.terrain)
        else:
            kept(given.data, given.count, given.terrain, given.method)


if __name__ == "__main__":
    main()
