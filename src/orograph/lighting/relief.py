"""The slope of the ground at the scale of a pixel: what light falls on.

Heights are averaged over the footprint of a pixel before they are differentiated: gradients of box means, interpolated
between two levels (trilinear, Williams 1983), so that relief neither sparkles where samples are smaller than pixels nor
shows facets where they are larger (gradients at the samples by central differences, blended bilinearly between them).
The mean of gradients is the gradient of means, so this is the exact prefilter of a surface's slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lighting.normal import central
from orograph.parallel import map_ordered
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]


@inlined
def finest(ints, floats, x, y, least):
    """The finest window (see ``Tables``) that holds a point and whose samples are more than ``least`` apart."""
    chosen = 0  # the outermost window holds every point
    for w in range(ints.shape[0] - 1, 0, -1):
        if floats[w, 0] > least and floats[w, 1] <= x <= floats[w, 2] and floats[w, 3] <= y <= floats[w, 4]:
            chosen = w
            break
    return chosen


@leaf
def _beside_gaps(pool, base, rows, cols, u, v, short_u, short_v):
    """``slope_at`` beside borders and missing samples: each sample's slope of what is there, then between them."""
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

    ``base`` and ``cols`` are uint64: indices without a sign need no care for those below 0.
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
def slope_at(pool, ints, floats, w, x, y):
    """The slope of window ``w`` along columns and rows at (x, y) in sample coordinates: metres per block of it."""
    base, rows, cols = ints[w, 0], ints[w, 1], ints[w, 2]
    blocks = 1.0 / floats[w, 0]
    u, v = (x + 0.5) * blocks - 0.5 - floats[w, 5], (y + 0.5) * blocks - 0.5 - floats[w, 6]
    across = down = np.nan
    if 1.0 <= u < cols - 3.0 and 1.0 <= v < rows - 3.0:
        across, down = slope_inside(pool, np.uint64(base), np.uint64(cols), u, v)
    if across + down != across + down:
        across, down = _beside_gaps(pool, base, rows, cols, u, v, floats[w, 7], floats[w, 8])
    return across, down


@kernel
def _gradients(pool, ints, floats, points, footprint, out, first, last):
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
                w = finest(ints, floats, x, y, least)
                across, down = slope_at(pool, ints, floats, w, x, y)
                gx += share * across / floats[w, 0]
                gy += share * down / floats[w, 0]
            least *= 2.0
        out[k, 0], out[k, 1] = gx, gy


STRIP = 1 << 22
"""Samples that are read at a time."""


@dataclass(frozen=True, slots=True)
class Tables:
    """Nested windows of rasters of box means, as kernels take them.

    Attributes:
        windows: what is to be read, outermost first.
        ints: (W, 4): samples before a window's first, rows, cols, level.
        floats: (W, 9): 2^level, then the west, east, north and south limits of the window in sample coordinates, its
            first column and row, and by how much of a block the middles of its last column and row are nearer than a
            block's (at the terrain's border).
    """

    windows: ClipStack
    ints: NDArray[np.int64]
    floats: Array

    @classmethod
    def over(cls, terrain: Terrain, rectangles: Sequence[Rectangle]) -> Tables:
        """Of ``rectangles`` (outermost first) and the levels between them that filtering needs."""
        wanted: list[Rectangle] = []
        # A window that covers all the terrain hides those around it; pixels larger than its samples want them.
        for level in range(terrain.levels - 1, rectangles[0].level, -1):
            wanted.append(Rectangle.whole(level, terrain.mean_shape(level)))
        for r, finer in zip(rectangles, [*rectangles[1:], None]):
            wanted.append(r)
            # Between two windows that are several levels apart lie levels that a pixel may want: cover the finer one.
            if finer is None:
                break
            for level in range(r.level - 1, finer.level, -1):
                k, f = level - finer.level, finer
                wanted.append(Rectangle(level, f.row0 >> k, -(-f.row1 >> k), f.col0 >> k, -(-f.col1 >> k)))
        clipped = ClipStack(r.cut(terrain.mean_shape(r.level)) for r in wanted)
        ints, floats = np.zeros((len(clipped), 4), np.int64), np.zeros((len(clipped), 9))
        base = 0
        for k, r in enumerate(clipped):
            s = 2.0**r.level
            ints[k] = base, r.row1 - r.row0, r.col1 - r.col0, r.level
            rows, cols = terrain.mean_shape(r.level)
            # Differences reach one block out, unless the terrain ends there; the outermost takes whatever comes.
            west, north = (f * s + s if f and k else -np.inf for f in (r.col0, r.row0))
            east = r.col1 * s - s if r.col1 < cols and k else np.inf
            south = r.row1 * s - s if r.row1 < rows and k else np.inf
            short_u = (cols - terrain.grid.cols / s) / 2 if r.col1 == cols else 0.0
            short_v = (rows - terrain.grid.rows / s) / 2 if r.row1 == rows else 0.0
            floats[k] = s, west, east, north, south, r.col0, r.row0, short_u, short_v
            base += r.samples
        return cls(clipped, ints, floats)


@dataclass(frozen=True, slots=True)
class Relief:
    """Box means of the heights over nested windows; ``gradient`` looks them up.

    Attributes:
        pool: float32, all windows, flat. ints, floats: see ``Tables``.
    """

    pool: NDArray[np.float32]
    ints: NDArray[np.int64]
    floats: Array

    @classmethod
    def load(cls, terrain: Terrain, rectangles: Sequence[Rectangle], jobs: int | None = None) -> Relief:
        """Read the means over ``rectangles`` (outermost first) and the levels between them that filtering needs."""
        tables = Tables.over(terrain, rectangles)
        pool = np.empty(sum(r.samples for r in tables.windows), np.float32)
        strips = [
            (r, int(base), row, min(row + max(STRIP // (r.col1 - r.col0), 1), r.row1))
            for r, (base, *_) in zip(tables.windows, tables.ints, strict=True)
            for row in range(r.row0, r.row1, max(STRIP // (r.col1 - r.col0), 1))
        ]

        def read(strip: tuple[Rectangle, int, int, int]) -> None:
            r, base, row0, row1 = strip
            begin = base + (row0 - r.row0) * (r.col1 - r.col0)
            values = terrain.read_mean(r.level, row0, row1, r.col0, r.col1)
            pool[begin : begin + values.size] = values.ravel()

        for _ in map_ordered(read, strips, jobs):
            pass
        return cls(pool, tables.ints, tables.floats)

    def gradient(self, points: Array, footprint: Array) -> Array:
        """Slope at points (n, 3) in sample coordinates, averaged over a footprint (n,) in samples.

        Returns:
            (n, 2) float64: metres of height per sample along columns and along rows; NaN where the point is NaN.
        """
        out = np.empty((len(points), 2))
        _gradients(self.pool, self.ints, self.floats, points, footprint, out, 0, len(points))
        return out
