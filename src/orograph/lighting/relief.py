"""The slope of the ground at the scale of a pixel, for light.

Heights are averaged over the footprint of a pixel before they are differentiated: gradients of box means, interpolated
between two levels (trilinear, Williams 1983), so that relief neither sparkles where samples are smaller than pixels nor
shows facets where they are larger (gradients at the samples by central differences, blended bilinearly between them).
The mean of gradients is the gradient of means, so this is the exact prefilter of a surface's slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._numba import inlined, kernel, leaf
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lighting.normal import central
from orograph.parallel import map_ordered
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]


class Windows(NamedTuple):
    """Rasters of nested windows as kernels take them, outermost first.

    Attributes:
        pool: all their samples, one window after the other, row by row.
        base, rows, cols: (W,) samples before a window's first; its shape.
        size: (W,) 2^level, the side of a block that a sample stands for.
        west, east, north, south: (W,) the window's limits in sample coordinates.
        col0, row0: (W,) its first column and row.
        short_u, short_v: (W,) how much nearer the middles of its last column and row are, as a part of a block (at the
            terrain's border).
    """

    pool: NDArray[np.float32]
    base: NDArray[np.int64]
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    size: Array
    west: Array
    east: Array
    north: Array
    south: Array
    col0: Array
    row0: Array
    short_u: Array
    short_v: Array

    @classmethod
    def of(cls, pool: NDArray[np.float32], shapes: Sequence[tuple[int, int]], places: ArrayLike) -> Windows:
        """Room for windows of these (rows, cols); ``places`` (W, 9): their size and the fields after it."""
        rows, cols = np.array(shapes, np.int64).reshape(-1, 2).T
        base = np.concatenate([[0], np.cumsum(rows * cols)[:-1]])
        return cls(pool, base, rows.copy(), cols.copy(), *np.array(places, np.float64).reshape(-1, 9).T.copy())

    @classmethod
    def one(
        cls, pool: NDArray[np.float32], shape: tuple[int, int], level: int = 0, first: Sequence[int] = (0, 0)
    ) -> Windows:
        """One window (rows, cols) of ``level``, which begins with the sample (row, col) ``first``."""
        row0, col0 = first
        return cls.of(pool, [shape], (2.0**level, -np.inf, np.inf, -np.inf, np.inf, col0, row0, 0.0, 0.0))

    @classmethod
    def over(cls, terrain: Terrain, rectangles: Sequence[Rectangle], *channels: int) -> tuple[ClipStack, Windows]:
        """The windows to read, and room for them: ``rectangles`` (outermost first), and levels between for filters."""
        wanted: list[Rectangle] = []
        # A window that covers the whole terrain hides those around it, which pixels larger than its samples need.
        for level in range(terrain.levels - 1, rectangles[0].level, -1):
            wanted.append(Rectangle.whole(level, terrain.mean_shape(level)))
        for r, finer in zip(rectangles, [*rectangles[1:], None]):
            wanted.append(r)
            # A pixel may need levels between two windows: let them cover the finer one.
            if finer is None:
                break
            for level in range(r.level - 1, finer.level, -1):
                k, f = level - finer.level, finer
                wanted.append(Rectangle(level, f.row0 >> k, -(-f.row1 >> k), f.col0 >> k, -(-f.col1 >> k)))
        clipped = ClipStack(r.cut(terrain.mean_shape(r.level)) for r in wanted)
        places = []
        for k, r in enumerate(clipped):
            s = 2.0**r.level
            rows, cols = terrain.mean_shape(r.level)
            # Differences reach one block outside, unless the terrain ends there; the outermost window takes any point.
            west, north = (f * s + s if f and k else -np.inf for f in (r.col0, r.row0))
            east = r.col1 * s - s if r.col1 < cols and k else np.inf
            south = r.row1 * s - s if r.row1 < rows and k else np.inf
            short_u = (cols - terrain.grid.cols / s) / 2 if r.col1 == cols else 0.0
            short_v = (rows - terrain.grid.rows / s) / 2 if r.row1 == rows else 0.0
            places.append((s, west, east, north, south, r.col0, r.row0, short_u, short_v))
        pool = np.empty((sum(r.samples for r in clipped), *channels), np.float32)
        return clipped, cls.of(pool, [(r.row1 - r.row0, r.col1 - r.col0) for r in clipped], places)


@inlined
def finest(windows, x, y, least):
    """The finest window that holds a point and whose samples are more than ``least`` apart."""
    chosen = 0  # the outermost window holds every point
    for w in range(len(windows.size) - 1, 0, -1):
        if (
            windows.size[w] > least
            and windows.west[w] <= x <= windows.east[w]
            and windows.north[w] <= y <= windows.south[w]
        ):
            chosen = w
            break
    return chosen


@leaf
def _beside_gaps(pool, base, rows, cols, u, v, short_u, short_v):
    """``slope_at`` beside borders and missing samples: slopes from existing neighbours, then interpolated."""
    j0 = min(max(np.int64(np.floor(u)), 0), max(cols - 2, 0))
    i0 = min(max(np.int64(np.floor(v)), 0), max(rows - 2, 0))
    fu, fv = min(max(u - j0, 0.0), 1.0), min(max(v - i0, 0.0), 1.0)
    gu = gv = weight = 0.0
    nan = np.nan
    for i in range(i0, min(i0 + 2, rows)):
        wv = fv if i > i0 else 1.0 - fv
        for j in range(j0, min(j0 + 2, cols)):
            w = wv * (fu if j > j0 else 1.0 - fu)
            here = np.float64(pool[base + i * cols + j])
            if here != here or w == 0.0:
                continue
            last_u = short_u if j == cols - 1 else 0.0
            last_v = short_v if i == rows - 1 else 0.0
            west, east, north, south = nan, nan, nan, nan
            if j > 0:
                west = np.float64(pool[base + i * cols + j - 1])
            if j + 1 < cols:
                east = np.float64(pool[base + i * cols + j + 1])
            if i > 0:
                north = np.float64(pool[base + (i - 1) * cols + j])
            if i + 1 < rows:
                south = np.float64(pool[base + (i + 1) * cols + j])
            gu += w * central(west, here, east, 1.0 - last_u, 1.0 - (short_u if j + 1 == cols - 1 else 0.0))
            gv += w * central(north, here, south, 1.0 - last_v, 1.0 - (short_v if i + 1 == rows - 1 else 0.0))
            weight += w
    if weight > 0.0:
        return gu / weight, gv / weight
    return 0.0, 0.0


@inlined
def slope_inside(pool, base, cols, u, v):
    """``slope_at`` away from borders, at (u, v) in a window's columns and rows; NaN if one of 12 samples is missing.

    ``base`` and ``cols`` are uint64, because unsigned indices need no handling of negative values.
    """
    j, i = np.int64(u), np.int64(v)
    f, g = u - j, v - i
    one, two = np.uint64(1), np.uint64(2)
    b = base + np.uint64(i) * cols + np.uint64(j)
    a, c = b - cols, b + cols
    d = c + cols
    b0, b1, c0, c1 = pool[b], pool[b + one], pool[c], pool[c + one]
    west = (1.0 - g) * (b1 - pool[b - one]) + g * (c1 - pool[c - one])
    east = (1.0 - g) * (pool[b + two] - b0) + g * (pool[c + two] - c0)
    north = (1.0 - f) * (c0 - pool[a]) + f * (c1 - pool[a + one])
    south = (1.0 - f) * (pool[d] - b0) + f * (pool[d + one] - b1)
    return 0.5 * ((1.0 - f) * west + f * east), 0.5 * ((1.0 - g) * north + g * south)


@inlined
def slope_at(windows, w, x, y):
    """The slope of window ``w`` along columns and rows at (x, y) in sample coordinates: metres per block of it."""
    pool, base, rows, cols = windows.pool, windows.base[w], windows.rows[w], windows.cols[w]
    blocks = 1.0 / windows.size[w]
    u, v = (x + 0.5) * blocks - 0.5 - windows.col0[w], (y + 0.5) * blocks - 0.5 - windows.row0[w]
    across = down = np.nan
    if 1.0 <= u < cols - 3.0 and 1.0 <= v < rows - 3.0:
        across, down = slope_inside(pool, np.uint64(base), np.uint64(cols), u, v)
    if across + down != across + down:
        across, down = _beside_gaps(pool, base, rows, cols, u, v, windows.short_u[w], windows.short_v[w])
    return across, down


@kernel
def _gradients(windows, points, footprint, out, first, last):
    """Points [first, last): (n, 3) sample coordinates, footprint (n,) in samples; out (n, 2): metres per sample."""
    for k in range(first, last):
        x, y = points[k, 0], points[k, 1]
        if x != x:
            out[k, 0] = out[k, 1] = np.nan
            continue
        level = np.log2(max(footprint[k], 1.0))
        whole = np.floor(level)
        part = level - whole
        gx = gy = 0.0
        least = 0.75 * 2.0**whole
        for step in range(2):
            share = part if step == 1 else 1.0 - part
            if share != 0.0:
                w = finest(windows, x, y, least)
                across, down = slope_at(windows, w, x, y)
                gx += share * across / windows.size[w]
                gy += share * down / windows.size[w]
            least *= 2.0
        out[k, 0], out[k, 1] = gx, gy


STRIP = 1 << 22
"""Samples that are read at a time."""


@dataclass(frozen=True, slots=True)
class Relief:
    """Box means of the heights over nested windows; ``gradient`` looks them up.

    Attributes:
        windows: of means, metres.
    """

    windows: Windows

    @classmethod
    def load(cls, terrain: Terrain, rectangles: Sequence[Rectangle], jobs: int | None = None) -> Relief:
        """Read the means over ``rectangles`` (outermost first) and the levels between them that filtering needs."""
        wanted, windows = Windows.over(terrain, rectangles)
        strips = [
            (r, int(base), row, min(row + max(STRIP // (r.col1 - r.col0), 1), r.row1))
            for r, base in zip(wanted, windows.base, strict=True)
            for row in range(r.row0, r.row1, max(STRIP // (r.col1 - r.col0), 1))
        ]

        def read(strip: tuple[Rectangle, int, int, int]) -> None:
            r, base, row0, row1 = strip
            begin = base + (row0 - r.row0) * (r.col1 - r.col0)
            values = terrain.read_mean(r.level, row0, row1, r.col0, r.col1)
            windows.pool[begin : begin + values.size] = values.ravel()

        for _ in map_ordered(read, strips, jobs):
            pass
        return cls(windows)

    def gradient(self, points: Array, footprint: Array) -> Array:
        """Slope at points (n, 3) in sample coordinates, averaged over a footprint (n,) in samples.

        Returns:
            (n, 2) float64: metres of height per sample along columns and along rows; NaN where the point is NaN.
        """
        out = np.empty((len(points), 2))
        _gradients(self.windows, points, footprint, out, 0, len(points))
        return out
