"""Fields of light under a picture: baked layers in nested windows, each about as fine as the pixels that see it.

A field has one or four values per sample: a share of the sky, or a cap (direction east, north, up, and the cosine of
its radius, side by side in memory, because they are always used together). A hit is looked up bilinearly in the window
whose samples are closest in size to the pixel's footprint. Samples represent blocks of 2^k × 2^k samples of the
terrain, where k is the window's level, and lie in their middles; coordinates are (column, row) of the terrain's
samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lighting.aperture_kernels import illuminate
from orograph.lighting.relief import Windows, finest, slope_at, slope_inside
from orograph.parallel import map_ordered
from orograph.store.layers import LayerBand, StoredLayer
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]
Values = NDArray[np.float32]

PIXELS = math.sqrt(2.0)
"""Spacing of samples in windows as fine as the pixels: between half this number of pixels and this number."""
SQRT_HALF = math.sqrt(0.5)
_STRIP = 256
"""Rows that a thread decodes at a time."""


@kernel
def _decode_caps(east, north, up, radius, vectors, cosines, out):
    """Codes (rows, cols) by tables of components and of the radius' cosine, interleaved."""
    for i in range(len(out)):
        for j in range(out.shape[1]):
            out[i, j, 0] = vectors[east[i, j]]
            out[i, j, 1] = vectors[north[i, j]]
            out[i, j, 2] = vectors[up[i, j]]
            out[i, j, 3] = cosines[radius[i, j]]


@kernel
def _decode(codes, table, out):
    """Codes (rows, cols) by a table."""
    for i in range(len(out)):
        for j in range(codes.shape[1]):
            out[i, j, 0] = table[codes[i, j]]


def _table(band: LayerBand, cosine: bool = False) -> Values:
    values = band.decode(np.arange(2**band.bits, dtype=band.dtype))
    return np.cos(np.radians(values)) if cosine else values


@dataclass(frozen=True, slots=True)
class LightField:
    """Values over nested windows.

    Attributes:
        windows: with pool (samples, 1 or 4); NaN where missing.
    """

    windows: Windows

    @classmethod
    def load(
        cls, layer: StoredLayer, terrain: Terrain, rectangles: Sequence[Rectangle], jobs: int | None = None
    ) -> LightField:
        """Read a layer of one band, or one of caps, over ``rectangles`` (outermost first; see ``raycast.select``)."""
        wanted, windows = Windows.over(terrain, rectangles, len(layer.bands))
        pool, caps = windows.pool, len(layer.bands) == 4
        first, radius = _table(layer.bands[0]), _table(layer.bands[-1], cosine=caps)
        work = [
            (r, int(base), row, min(row + _STRIP, r.row1 - r.row0))
            for r, base in zip(wanted, windows.base)
            for row in range(0, r.row1 - r.row0, _STRIP)
        ]

        def read(item: tuple[Rectangle, int, int, int]) -> None:
            r, base, row, end = item
            cols = r.col1 - r.col0
            out = pool[base + row * cols : base + end * cols].reshape(end - row, cols, -1)
            codes = layer.planes(r.level, r.row0 + row, r.row0 + end, r.col0, r.col1)
            if caps:
                _decode_caps(*codes, first, radius, out)
            else:
                _decode(*codes, first, out)

        for _ in map_ordered(read, work, jobs):
            pass
        return cls(windows)

    @classmethod
    def of(cls, values: Values, level: int, row0: int, col0: int) -> LightField:
        """One window: values (rows, cols) or (rows, cols, 4), samples of ``level``, the first (row0, col0)."""
        rows, cols = values.shape[:2]
        pool = np.ascontiguousarray(values.reshape(rows * cols, -1), np.float32)
        return cls(Windows.one(pool, (rows, cols), level, (row0, col0)))

    def values(self, points: Array, footprint: Array) -> Values:
        """Values (n, 1 or 4) at points (n, 2 or 3), seen with a footprint (n,) in samples; NaN where missing."""
        out = np.empty((len(points), self.windows.pool.shape[1]), np.float32)
        _look_up(self.windows, points, footprint, out)
        return out


@inlined
def _place(windows, x, y, footprint):
    """The position of a point in the pool: the four samples around it, and the fractions between them."""
    w = finest(windows, x, y, SQRT_HALF * footprint)
    blocks = 1.0 / windows.size[w]
    rows, cols = windows.rows[w], windows.cols[w]
    u, v = (x + 0.5) * blocks - 0.5 - windows.col0[w], (y + 0.5) * blocks - 0.5 - windows.row0[w]
    j = min(max(np.int64(u), 0), max(cols - 2, 0))
    i = min(max(np.int64(v), 0), max(rows - 2, 0))
    f, g = min(max(u - j, 0.0), 1.0), min(max(v - i, 0.0), 1.0)
    a = windows.base[w] + i * cols + j
    right, down = (1 if cols > 1 else 0), (cols if rows > 1 else 0)
    return a, a + right, a + down, a + down + right, f, g


@inlined
def _window(windows, x, y, least):
    """``finest``'s window at a point, and the box of points (west, east, north, south) for which it stays the same.

    It does so while ``least`` is the same. The box is empty if a finer window would qualify but ends elsewhere.
    """
    w = finest(windows, x, y, least)
    finer = False
    for other in range(w + 1, len(windows.size)):
        finer = finer or windows.size[other] > least
    if finer:
        return w, np.inf, -np.inf, np.inf, -np.inf
    if w == 0:
        return w, -np.inf, np.inf, -np.inf, np.inf
    return w, windows.west[w], windows.east[w], windows.north[w], windows.south[w]


@inlined
def _axes(windows, w):
    """For a window: blocks per sample, the position of its first sample, and its base and columns as unsigned indices.

    Compilers do not need to handle negative unsigned indices.
    """
    per, u0, v0 = 1.0 / windows.size[w], 0.5 + windows.col0[w], 0.5 + windows.row0[w]
    return per, u0, v0, np.uint64(windows.base[w]), np.uint64(windows.cols[w])


@inlined
def _slope(windows, w, x, y, inside):
    """``relief.slope_at``; ``inside``: the window's ``_axes``, and its last column and row minus two."""
    per, u0, v0, base, cols, end_u, end_v = inside
    u, v = (x + 0.5) * per - u0, (y + 0.5) * per - v0
    across = down = np.nan
    if 1.0 <= u < end_u and 1.0 <= v < end_v:
        across, down = slope_inside(windows.pool, base, cols, u, v)
    if across + down != across + down:
        across, down = slope_at(windows, w, x, y)
    return across, down


@kernel
def _look_up(windows, points, footprint, out):
    pool = windows.pool
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if x != x:
            out[k] = np.nan
            continue
        a, b, c, d, f, g = _place(windows, x, y, footprint[k])
        for m in range(pool.shape[1]):
            top = pool[a, m] * (1.0 - f) + pool[b, m] * f
            low = pool[c, m] * (1.0 - f) + pool[d, m] * f
            out[k, m] = top * (1.0 - g) + low * g


@leaf
def light_caps(field, means, points, width, to_world, stretch, height, lights, bounce, linear, out):
    """Light through the caps of a field on hits (n,) of a picture.

    The slope is that over the pixel's footprint, interpolated between two levels, because a switch from one level to
    the next would be visible. Caps come from the level nearest to the footprint, because they differ less between
    levels.

    Args:
        field, means: windows of caps, and of mean heights.
        points: (n, 3) sample coordinates, true heights; NaN rows are passed over. width: (n,) footprint in samples.
        to_world: (2, 2) turns metres per sample into metres per metre; ``stretch`` multiplies slopes.
        height: the factor by which true heights are stretched, for lamps.
        lights: ``LightTables``. linear: (2, 2) metres east and north per column and row.
        bounce: (3,) light from ground in place of hidden sky.
        out: (n, 3) float32, irradiance.
    """
    pool = field.pool
    # Neighbours mostly use the same windows; finding them for each hit would take longer than interpolating.
    least, most = np.inf, -np.inf  # footprints
    west, east, north, south = np.inf, -np.inf, np.inf, -np.inf  # and the places for which those were found
    fine, coarse, size = 0, 0, 1.0
    per, u0, v0, last_u, last_v = 1.0, 0.0, 0.0, 0.0, 0.0  # caps
    base, cols, right, below = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    per1, u1, v1, base1, cols1 = 1.0, 0.0, 0.0, np.uint64(0), np.uint64(0)  # the finer slopes
    per2, u2, v2, base2, cols2 = 1.0, 0.0, 0.0, np.uint64(0), np.uint64(0)  # the coarser
    end_u1 = end_v1 = end_u2 = end_v2 = 0.0
    for k in range(len(points)):
        x, y, footprint = points[k, 0], points[k, 1], width[k]
        if x != x:
            continue
        if not (least <= footprint < most and west <= x <= east and north <= y <= south):
            size = 1.0
            while 2.0 * size <= footprint:
                size *= 2.0
            if footprint < PIXELS * size:
                least, most, nearest = (size if size > 1.0 else 0.0), PIXELS * size, 0.75 * size
            else:
                least, most, nearest = PIXELS * size, 2.0 * size, 1.5 * size
            w, west, east, north, south = _window(field, x, y, nearest)
            per, u0, v0, base, cols = _axes(field, w)
            last_u, last_v = max(field.cols[w] - 2.0, 0.0), max(field.rows[w] - 2.0, 0.0)
            right = np.uint64(1 if field.cols[w] > 1 else 0)
            below = cols if field.rows[w] > 1 else np.uint64(0)
            fine, x0, x1, y0, y1 = _window(means, x, y, 0.75 * size)
            west, east, north, south = max(west, x0), min(east, x1), max(north, y0), min(south, y1)
            per1, u1, v1, base1, cols1 = _axes(means, fine)
            end_u1, end_v1 = means.cols[fine] - 3.0, means.rows[fine] - 3.0
            coarse, x0, x1, y0, y1 = _window(means, x, y, 1.5 * size)
            west, east, north, south = max(west, x0), min(east, x1), max(north, y0), min(south, y1)
            per2, u2, v2, base2, cols2 = _axes(means, coarse)
            end_u2, end_v2 = means.cols[coarse] - 3.0, means.rows[coarse] - 3.0
        u, v = max((x + 0.5) * per - u0, 0.0), max((y + 0.5) * per - v0, 0.0)
        j, i = np.int64(min(u, last_u)), np.int64(min(v, last_v))
        f, g = min(u - j, 1.0), min(v - i, 1.0)
        a = base + np.uint64(i) * cols + np.uint64(j)
        b, c, d = a + right, a + below, a + below + right
        wa, wb, wc, wd = (1.0 - f) * (1.0 - g), f * (1.0 - g), (1.0 - f) * g, f * g
        ce = wa * pool[a, 0] + wb * pool[b, 0] + wc * pool[c, 0] + wd * pool[d, 0]
        cn = wa * pool[a, 1] + wb * pool[b, 1] + wc * pool[c, 1] + wd * pool[d, 1]
        cu = wa * pool[a, 2] + wb * pool[b, 2] + wc * pool[c, 2] + wd * pool[d, 2]
        rim = wa * pool[a, 3] + wb * pool[b, 3] + wc * pool[c, 3] + wd * pool[d, 3]
        square = ce * ce + cn * cn + cu * cu
        if not square > 0.0 or rim != rim:
            ce, cn, cu, rim = 0.0, 0.0, 1.0, 0.0
        else:
            length = 1.0 / np.sqrt(square)
            ce, cn, cu = ce * length, cn * length, cu * length
        # The slope between two levels, as ``Relief.gradient`` has it; the logarithm that says how far is a parabola,
        # within 0.008.
        inside = per1, u1, v1, base1, cols1, end_u1, end_v1
        across, down = _slope(means, fine, x, y, inside)
        across, down = across * per1, down * per1
        if footprint > size:
            t = footprint / size - 1.0
            part = t * (1.34 - 0.34 * t)
            inside = per2, u2, v2, base2, cols2, end_u2, end_v2
            further, steeper = _slope(means, coarse, x, y, inside)
            across = across * (1.0 - part) + further * per2 * part
            down = down * (1.0 - part) + steeper * per2 * part
        p = (to_world[0, 0] * across + to_world[0, 1] * down) * stretch
        q = (to_world[1, 0] * across + to_world[1, 1] * down) * stretch
        up = 1.0 / np.sqrt(1.0 + p * p + q * q)
        px, py = linear[0, 0] * x + linear[0, 1] * y, linear[1, 0] * x + linear[1, 1] * y
        normal, place = (-p * up, -q * up, up), (px, py, points[k, 2] * height)
        illuminate((ce, cn, cu), rim, normal, place, lights, False, out, k)
        hidden = rim * rim  # 1 − sin² of the radius
        for m in range(3):
            out[k, m] += hidden * bounce[m]
