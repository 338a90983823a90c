"""The CPU rasteriser compared with the ray caster and Embree: the same surface and picture, in one process.

    python bench/raster.py [--size 1581] [--data ../shared/data] [--repeat 5] [--jobs 2]

Prints one row per view of a fractal with about 5 million triangles, and of the Big Tujunga (resampled to as many, if
the data is there). Times are the best of several. *Set-up* projects the mesh and sorts it by tiles; *picture* draws all
pixel centres; the last columns are 16 positions in each pixel at a depth edge, tile by tile. The ray caster draws the
same pixels from its pyramids. Embree (one thread: its binding holds the GIL) intersects the same triangles with
single-precision rays; its rays and its scene are made beforehand.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from embree import fractal, scene
from orograph.geo.grid import Grid
from orograph.parallel import for_each
from orograph.raycast.caster import Caster
from orograph.rendering.cpu.raster import MeshSurface
from orograph.rendering.gbuffer import Surface
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.viewpoint import Camera, View

WIDTH, HEIGHT, SAMPLES = 1920, 1080, 16
AREA = (0, HEIGHT, 0, WIDTH)
Array = NDArray[np.float64]
Heights = NDArray[np.float32]


def best(work: Callable[[], object], repeat: int, jobs: int = 1) -> float:
    """Seconds: processor time of one thread, wall time of several."""
    clock, times = time.thread_time if jobs == 1 else time.perf_counter, []
    for _ in range(repeat):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)


def tujunga(data: Path, size: int) -> tuple[Heights, float] | None:
    """The Big Tujunga's largest square, resampled to ``size`` samples a side, and their spacing in metres."""
    path = data / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif"
    if not path.exists():
        return None
    from scipy.ndimage import zoom

    from orograph.dem.mosaic import Mosaic

    mosaic = Mosaic.open([path])
    side = min(mosaic.grid.shape)
    heights = np.nan_to_num(mosaic.read(0, side, 0, side), nan=float(np.nanmin(mosaic.read(0, side, 0, side))))
    return zoom(heights, size / side, order=1)[:size, :size].astype(np.float32), mosaic.grid.spacing[0] * side / size


def triangles(heights: Heights) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and triangles of the full resolution, cells cut from (even, even) to (odd, odd) corners."""
    rows, cols = heights.shape
    y, x = np.mgrid[:rows, :cols]
    index = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    nw, ne, sw, se = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    even = ((y + x)[:-1, :-1] % 2 == 0)[..., None]
    one = np.where(even, np.stack([nw, ne, se], -1), np.stack([nw, ne, sw], -1))
    other = np.where(even, np.stack([nw, se, sw], -1), np.stack([ne, se, sw], -1))
    return np.stack([x, y, heights], -1).reshape(-1, 3).astype(np.float64), np.stack([one, other], 2).reshape(-1, 3)


def views(heights: Heights, spacing: float) -> dict[str, View]:
    n = len(heights)
    side = n * spacing

    def at(x: float, y: float, above: float) -> tuple[float, float, float]:
        return x * side, -y * side, float(heights[int(y * n), int(x * n)]) + above

    size = {"width": WIDTH, "height": HEIGHT}
    middle = (side / 2, -side / 2, float(heights.mean()))
    return {
        "overview": View((side / 2, -1.25 * side, 0.65 * side), middle, **size),
        "low flight": View(at(0.3, 0.2, 300.0), at(0.75, 0.75, 0.0), **size),
        "mountain side": View(at(0.5, 0.5, 1500.0), at(0.7, 0.65, 0.0), **size),
        "plan": View((side / 2, -side / 2, 2.0 * side), middle, projection="plan", fov_y=27, **size),
    }


def edge_positions(depth: Array, side: int) -> list[tuple[Array, Array]]:
    """``SAMPLES`` positions in every pixel at a depth edge, by squares of pixels."""
    far = np.nan_to_num(depth, nan=1e9)
    edges = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        step = np.abs(np.diff(far, axis=axis)) > 0.01 * np.minimum(*_pairs(far, axis))
        edges |= np.insert(step, 0, False, axis) | np.insert(step, far.shape[axis] - 1, False, axis)
    offsets = np.random.default_rng(0).random((SAMPLES, 2))
    out = []
    for top in range(0, HEIGHT, side):
        for left in range(0, WIDTH, side):
            rows, cols = np.nonzero(edges[top : top + side, left : left + side])
            px, py = (cols + left)[:, None] + offsets[:, 0], (rows + top)[:, None] + offsets[:, 1]
            if len(rows):
                out.append((px.ravel(), py.ravel()))
    return out


def ask(surface: Surface, positions: list[tuple[Array, Array]], jobs: int) -> None:
    for_each(lambda some: surface.at(*some), positions, jobs)


def _pairs(a: Array, axis: int) -> tuple[Array, Array]:
    return (a[:, 1:], a[:, :-1]) if axis == 1 else (a[1:], a[:-1])


def compare(name: str, heights: Heights, spacing: float, repeat: int, jobs: int) -> None:
    n = len(heights)
    g = Grid(heights.shape, Affine(spacing, 0, 0, 0, -spacing, 0))
    vertices, tri = triangles(heights)
    try:
        embree, _mesh = scene(heights, spacing)
    except ImportError:
        embree = None
    caster = Caster.of(heights, jobs)
    print(f"\n{name}: {n} × {n} samples, {len(tri) / 1e6:.2f} million triangles, {WIDTH} × {HEIGHT}, {jobs} threads\n")
    print("| view | shown | set-up ms | picture ms | Mtriangles/s | caster ms | Embree ms (1 thread) | caster / raster "
          "| Embree / raster | positions | raster ms | caster ms | same depth |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    for view_name, view in views(heights, spacing).items():
        p = Projection.of(Camera.over(g, view))
        mesh, rays = MeshSurface(vertices, tri, p, jobs), RaySurface(caster, p)
        setup = best(partial(MeshSurface, vertices, tri, p, jobs), repeat, jobs)
        picture, cast = best(partial(mesh.draw, AREA), repeat, jobs), best(partial(rays.draw, AREA), repeat, jobs)
        theirs = np.nan
        if embree is not None:
            o, d = p.rays(*(a.ravel() + 0.5 for a in np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))))
            o, d = ((v * [spacing, spacing, 1]).astype(np.float32) for v in (o, d))
            theirs = best(partial(embree.run, o, d, query="DISTANCE"), 2)
        mine, other = mesh.draw(AREA).depth, rays.draw(AREA).depth
        same = np.isclose(mine, other, rtol=1e-9, atol=0, equal_nan=True).mean()
        positions = edge_positions(mine, mesh.side)
        count = sum(len(px) for px, _ in positions)
        edges = [best(partial(ask, s, positions, jobs), repeat, jobs) for s in (mesh, rays)]
        print(
            f"| {view_name} | {np.isfinite(mine).mean():.0%} | {setup * 1e3:.0f} | {picture * 1e3:.0f} "
            f"| {len(tri) / (setup + picture) / 1e6:.1f} | {cast * 1e3:.0f} | {theirs * 1e3:.0f} "
            f"| {cast / (setup + picture):.2f} | {theirs / (setup + picture):.2f} | {count:,} | {edges[0] * 1e3:.0f} "
            f"| {edges[1] * 1e3:.0f} | {same:.4%} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1581, help="samples along a side")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data", help="open data")
    parser.add_argument("--repeat", type=int, default=5, help="runs; the best counts")
    parser.add_argument("--jobs", type=int, default=2, help="threads")
    given = parser.parse_args()
    compare("Fractal", fractal(given.size), 30.0, given.repeat, given.jobs)
    found = tujunga(given.data, given.size)
    if found is not None:
        compare("Big Tujunga", *found, given.repeat, given.jobs)


if __name__ == "__main__":
    main()
