"""Apparent heights of what an eye may see, and their pyramid of maxima, for the lines of sight of ``viewshed``.

Apparent heights, r and the quadratic form: see ``viewshed``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orograph.folders import scratch
from orograph.lighting.raster import rectangles
from orograph.measuring.places import Places
from orograph.parallel import map_ordered
from orograph.progress import Progress
from orograph.store.terrain import TILE

if TYPE_CHECKING:
    from orograph.measuring.viewshed_kernels import Pyramid

Array = NDArray[np.float64]

LATTICE = 17
"""Places along each side of the window where distances are geodesic."""
EXTREMES = 0.01, 100.0
"""Limits of r, beyond which a projection is unsuitable."""
FINEST = 16
"""Apparent heights are multiples of 2^−16 m, or of more if their range would exceed 31 bits."""


@dataclass
class Scene:
    """Apparent heights of a window, whose first sample is even, as the kernels take them."""

    row: int
    col: int
    x: float
    y: float
    pyramid: Pyramid
    form: Array
    ratio: Array
    rx: tuple[float, float]
    ry: tuple[float, float]
    jobs: int
    release: Callable[[], None] | None

    def distance2(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Squared true distances (metres²) of a window's samples from the eye."""
        dx, dy = np.meshgrid(np.arange(col0, col1) - self.x, np.arange(row0, row1) - self.y)
        a, b, c = self.form[0, 0], self.form[0, 1], self.form[1, 1]
        return np.asarray(self.ratios(row0, row1, col0, col1) * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))

    def ratios(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """r: true squared distance by the quadratic form's, at a window's samples."""
        fx, fy = (np.arange(col0, col1) - self.rx[0]) / self.rx[1], (np.arange(row0, row1) - self.ry[0]) / self.ry[1]
        kx, ky = (np.clip(np.floor(f), 0, LATTICE - 2).astype(int) for f in (fx, fy))
        rows = self.ratio[ky] + (fy - ky)[:, None] * (self.ratio[ky + 1] - self.ratio[ky])
        return np.asarray(rows[:, kx] + (fx - kx) * (rows[:, kx + 1] - rows[:, kx]))


def form_of(places: Places, point: Array) -> Array:
    """(2, 2): true metres² of a step in samples (columns, rows), by the metric at a point (2,)."""
    return np.asarray(places.linear.T @ places.metric(point[None])[0] @ places.linear)


def ratios(places: Places, point: Array, x: float, y: float, cols: Array, rows: Array) -> Array:
    """(rows, cols): squared geodesic distance from the eye by the quadratic form, on a lattice of samples."""
    u, v = (a.ravel() for a in np.meshgrid(cols, rows))
    form = form_of(places, point)
    step = np.stack([u - x, v - y])
    squared = np.einsum("in,ij,jn->n", step, form, step)
    if places.geod is None:
        return np.ones((len(rows), len(cols)))
    at = np.stack(places.grid.xy(u, v), axis=-1)
    there, here = places.geodetic(at, strict=False), places.geodetic(point[None])[0]
    _, _, metres = places.geod.inv(np.full(len(u), here[0]), np.full(len(u), here[1]), there[:, 0], there[:, 1])
    # Very near, the form is accurate enough; where the projection does not reach, there is nothing better.
    form_only = (squared < 1e4) | ~np.isfinite(metres)
    out: Array = np.where(form_only, 1.0, np.where(form_only, 1.0, metres) ** 2 / np.where(form_only, 1.0, squared))
    return np.clip(out.reshape(len(rows), len(cols)), *EXTREMES)


def window_within(places: Places, point: Array, x: float, y: float, radius: float | None) -> tuple[int, int, int, int]:
    """Samples (row0, row1, col0, col1) within the radius, and a few more."""
    rows, cols = places.grid.shape
    if radius is None:
        return 0, rows, 0, cols
    ratio = ratios(places, point, x, y, np.linspace(0, cols - 1, LATTICE), np.linspace(0, rows - 1, LATTICE))
    inverse = np.linalg.inv(form_of(places, point))
    reach = radius / math.sqrt(float(ratio.min())) * np.sqrt(np.diag(inverse)) * 1.001
    return (
        max(math.floor(y - reach[1]), 0), min(math.ceil(y + reach[1]) + 1, rows),
        max(math.floor(x - reach[0]), 0), min(math.ceil(x + reach[0]) + 1, cols),
    )  # fmt: skip


def scene_of(
    places: Places, point: Array, at: tuple[float, float], ground: float, eye: float, bend: float,
    frame: tuple[int, int, int, int], max_memory: int, jobs: int, progress: Progress,
) -> tuple[Scene, float, bool]:  # fmt: skip
    """Apparent heights and their pyramid; the quantum; whether they are on disk."""
    from orograph.measuring.viewshed_kernels import Eye, Pyramid, Ratio, first_level, lower, next_level

    terrain = places.terrain
    row0, row1, col0, col1 = frame
    rows, cols = row1 - row0, col1 - col0
    lattice_x, lattice_y = np.linspace(0, cols - 1, LATTICE), np.linspace(0, rows - 1, LATTICE)
    ratio = ratios(places, point, *at, lattice_x + col0, lattice_y + row0)
    form = form_of(places, point)
    corners = np.array([[c - at[0], r - at[1]] for c in (col0, col1 - 1) for r in (row0, row1 - 1)])
    farthest = float(ratio.max() * np.einsum("ni,ij,nj->n", corners, form, corners).max())
    low, high = terrain.height_range
    reach = (high - low + eye + 0.5 * bend * farthest + 1.0) / math.sqrt(float(ratio.min()))
    quantum = 2.0 ** max(-FINEST, math.ceil(math.log2(reach)) - 30)
    shapes: list[tuple[int, int]] = []
    nodes = rows - 1, cols - 1
    while max(nodes) > 1 or not shapes:
        nodes = -(-nodes[0] // 2), -(-nodes[1] // 2)
        shapes.append(nodes)
    sizes = [r * c for r, c in shapes]
    total = 4 * (rows * cols + sum(sizes))
    on_disk = 3 * total > max_memory
    release: Callable[[], None] | None = None
    if on_disk:
        space, release = scratch(total)
        pool = space.view(np.int32)
    else:
        pool = np.empty(total // 4, np.int32)
    z = pool[: rows * cols].reshape(rows, cols)
    maxima = pool[rows * cols :]
    offset = np.concatenate([[-1, 0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    per_row = np.array([cols - 1, *(c for _, c in shapes)], np.int64)
    rx, ry = (0.0, (cols - 1) / (LATTICE - 1)), (0.0, (rows - 1) / (LATTICE - 1))

    seen_from = Eye(ground + eye, 1.0 / quantum, bend, form)

    def fill(window: tuple[int, int, int, int]) -> None:
        a, b, c, d = window
        part = np.ascontiguousarray(terrain.read(0, row0 + a, row0 + b, col0 + c, col0 + d))
        lattice = Ratio(ratio, (rx[0] - c, rx[1]), (ry[0] - a, ry[1]))
        lower(part, seen_from, col0 + c - at[0], row0 + a - at[1], lattice, z[a:b, c:d])

    windows = list(rectangles((rows, cols), TILE, 16 * TILE))
    with progress.task("Reading heights", total=len(windows)) as task:
        for k, _ in enumerate(map_ordered(fill, windows, jobs)):
            task.advance()
            if release is not None and k % 16 == 15:
                release()
    levels = [maxima[o : o + s].reshape(shape) for o, s, shape in zip(offset[1:], sizes, shapes)]
    for fine, coarse in pairwise([z, *levels]):
        kernel = first_level if fine is z else next_level
        strips = [(r, min(r + TILE, len(coarse))) for r in range(0, len(coarse), TILE)]
        for _ in map_ordered(lambda s: kernel(fine, coarse, *s), strips, jobs):  # noqa: B023 (used at once)
            if release is not None:
                release()
    pyramid = Pyramid(z, maxima, offset, per_row)
    scene = Scene(row0, col0, at[0] - col0, at[1] - row0, pyramid, form, ratio, rx, ry, jobs, release)
    return scene, quantum, on_disk
