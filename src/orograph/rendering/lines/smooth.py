"""The smooth surface through the samples that contour lines follow where samples are larger than pixels.

The ground is triangles between samples; its isolines bend at every edge, which shows as soon as a cell covers some
pixels, the more so as light there is smooth. So near by lines are those of a surface that passes through the samples,
has at each the slope that light falls on (central differences, ``lighting.relief``), and no bend between cells: a
bicubically blended Coons patch over every cell, with cubic Hermite curves along its edges, across which its slope
changes linearly, just as the light's does. What the two directions say of the twist in a corner is blended as Gregory
(1974) has it, so that four heights and four slopes are all a cell needs. Quadratic surfaces are reproduced. Beside
missing samples lines are the triangles'. Beside level ground, such as the sea, the surface would dip and rise again and
scallop the shore. So a shore is straight from sample to sample of the level ground, through cells of which one corner
is land (of the sea, at height 0) and along others; the surface leaves it on both sides with the slope of the light, and
over level ground goes no deeper than hides the line.
Source: Gregory, J. A. (1974). Smooth interpolation without twist constraints.
*Computer Aided Geometric Design*, Academic Press.

Heights in metres, positions and slopes by sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.lighting.normal import central
from orograph.lighting.relief import Relief, Windows, finest

Array = NDArray[np.float64]

SMALL = 0.35, 0.7
"""Samples that a pixel covers up to which heights are the smooth surface's, and from which on they are the ground's."""

SHORE = 0.3
"""Samples inland from the shore within which heights follow it, less and less."""

CLEAR = 0.15, 6.0
"""Samples and pixels (the larger) from the shore up to which the surface goes down over level ground."""

STEPS, FAR = 3, 1.5
"""Steps from where a ray meets triangles to where it meets the smooth surface, and how far that may be, samples."""


@leaf
def blended(h, a, b, f, g):
    """Height at (f, g), 0 to 1, in a cell: of heights h, slopes a along columns and b along rows at its corners.

    (The first digit of a name counts columns, the second rows.)
    """
    (h00, h10, h01, h11), (a00, a10, a01, a11), (b00, b10, b01, b11) = h, a, b
    p, q = 1.0 - f, 1.0 - g
    f1, g1 = f * f * (3.0 - 2.0 * f), g * g * (3.0 - 2.0 * g)
    f0, g0 = 1.0 - f1, 1.0 - g1
    u0, u1, v0, v1 = f * p * p, -f * f * p, g * q * q, -g * g * q
    height = g0 * (f0 * h00 + f1 * h10) + g1 * (f0 * h01 + f1 * h11)
    height += u0 * (q * a00 + g * a01) + u1 * (q * a10 + g * a11)
    height += v0 * (p * b00 + f * b10) + v1 * (p * b01 + f * b11)
    # The twists: of a along the rows, of b along the columns.
    west, east, north, south = a01 - a00, a11 - a10, b10 - b00, b11 - b01
    height -= u0 * v0 * (f * west + g * north) / max(f + g, 1e-9)
    height -= u1 * v0 * (p * east + g * north) / max(p + g, 1e-9)
    height -= u0 * v1 * (f * west + q * south) / max(f + q, 1e-9)
    height -= u1 * v1 * (p * east + q * south) / max(p + q, 1e-9)
    return height


@leaf
def _slope(pool, base, rows, cols, i, j):
    """Slopes along columns and rows at a sample: central differences, beside borders and missing samples of what is
    there, as ``relief.slope_at`` has them."""
    at, nan = base + i * cols + j, np.nan
    here = np.float64(pool[at])
    west = np.float64(pool[at - 1]) if j > 0 else nan
    east = np.float64(pool[at + 1]) if j + 1 < cols else nan
    north = np.float64(pool[at - cols]) if i > 0 else nan
    south = np.float64(pool[at + cols]) if i + 1 < rows else nan
    return central(west, here, east, 1.0, 1.0), central(north, here, south, 1.0, 1.0)


@leaf
def _to_shore(a, b, f, g):
    """How far (f, g) in a level cell lies from its shore, samples: from edges beyond which both samples differ, and
    corners beyond which one does, as slopes a and b at the corners tell; inf: there is none."""
    (a00, a10, a01, a11), (b00, b10, b01, b11) = a, b
    p, q, far = 1.0 - f, 1.0 - g, np.inf
    far = f if a00 != 0.0 and a01 != 0.0 else far
    far = min(far, p) if a10 != 0.0 and a11 != 0.0 else far
    far = min(far, g) if b00 != 0.0 and b10 != 0.0 else far
    far = min(far, q) if b01 != 0.0 and b11 != 0.0 else far
    far = min(far, np.sqrt(f * f + g * g)) if a00 != 0.0 or b00 != 0.0 else far
    far = min(far, np.sqrt(p * p + g * g)) if a10 != 0.0 or b10 != 0.0 else far
    far = min(far, np.sqrt(f * f + q * q)) if a01 != 0.0 or b01 != 0.0 else far
    return min(far, np.sqrt(p * p + q * q)) if a11 != 0.0 or b11 != 0.0 else far


@leaf
def _from_shore(h00, h10, h01, h11, f, g):
    """How far (f, g) in a cell lies from the shore, samples, negative at sea: the chord between two samples of the sea
    (height 0) beside land; NaN where none cuts the cell or bounds it."""
    if min(min(h00, h10), min(h01, h11)) != 0.0:
        return np.nan
    west, east, north, south = h00 + h01, h10 + h11, h00 + h10, h01 + h11
    u, v = f if east > 0.0 else 1.0 - f, g if south > 0.0 else 1.0 - g
    across, down = min(west, east) == 0.0, min(north, south) == 0.0  # whether a side has no land
    if across and down:
        return np.sqrt(0.5) * (u + v - 1.0) if west + east > 0.0 else np.nan
    if across and min(h00, h01) + min(h10, h11) > 0.0:
        return u
    return v if down and min(h00, h10) + min(h01, h11) > 0.0 else np.nan


@leaf
def _cell(pool, base, rows, cols, x, y, footprint):
    """Height of the smooth surface at (x, y) of samples (rows, cols), and the slope that light has there; NaN beside
    missing samples. ``footprint``: of a pixel, samples."""
    i = min(max(np.int64(np.floor(y)), 0), rows - 2)
    j = min(max(np.int64(np.floor(x)), 0), cols - 2)
    at = base + i * cols + j
    h00, h10 = np.float64(pool[at]), np.float64(pool[at + 1])
    h01, h11 = np.float64(pool[at + cols]), np.float64(pool[at + cols + 1])
    a00, b00 = _slope(pool, base, rows, cols, i, j)
    a10, b10 = _slope(pool, base, rows, cols, i, j + 1)
    a01, b01 = _slope(pool, base, rows, cols, i + 1, j)
    a11, b11 = _slope(pool, base, rows, cols, i + 1, j + 1)
    f, g = min(max(x - j, 0.0), 1.0), min(max(y - i, 0.0), 1.0)
    a, b = (a00, a10, a01, a11), (b00, b10, b01, b11)
    height = blended((h00, h10, h01, h11), a, b, f, g)
    across = (1.0 - g) * ((1.0 - f) * a00 + f * a10) + g * ((1.0 - f) * a01 + f * a11)
    down = (1.0 - g) * ((1.0 - f) * b00 + f * b10) + g * ((1.0 - f) * b01 + f * b11)
    steep, clear = np.sqrt(across * across + down * down), max(CLEAR[0], CLEAR[1] * footprint)
    if h00 == h10 and h00 == h01 and h00 == h11:
        dip = min(_to_shore(a, b, f, g), clear) * steep
        return h00 + dip if height > h00 else h00 - dip, across, down
    inland = _from_shore(h00, h10, h01, h11, f, g)
    if inland == inland:
        rise = max(inland, -clear) * steep
        t = min(max(inland / SHORE, 0.0), 1.0)
        height = rise + t * t * (3.0 - 2.0 * t) * (height - rise)
        height = max(height, 0.5 * rise * (1.0 - inland)) if inland > 0.0 else height
    return height, across, down


@kernel
def _smooth(windows, points, footprint, rays, heights):
    """Move ``heights`` (n,) to the smooth surface, see ``smoothed``."""
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if not footprint[k] < SMALL[1] or heights[k] != heights[k]:
            continue
        w = finest(windows, x, y, 0.75)
        if windows.size[w] != 1.0:
            continue
        pool, base, rows, cols = windows.pool, windows.base[w], windows.rows[w], windows.cols[w]
        x, y = x - windows.col0[w], y - windows.row0[w]
        above, across, down = _cell(pool, base, rows, cols, x, y, footprint[k])
        if above != above:
            continue
        smooth = above
        if len(rays) > 0:
            u, v, drop = rays[k, 0], rays[k, 1], rays[k, 2]
            gone = 0.0
            for _ in range(STEPS):  # Newton's method
                facing = drop - across * u - down * v
                gone += (above - heights[k] - gone * drop) / facing if facing < 0.0 else np.inf
                if not abs(gone) * np.sqrt(u * u + v * v) < FAR:
                    break
                smooth = heights[k] + gone * drop
                above, across, down = _cell(pool, base, rows, cols, x + gone * u, y + gone * v, footprint[k])
                if above != above:
                    break
        t = min(max((footprint[k] - SMALL[0]) / (SMALL[1] - SMALL[0]), 0.0), 1.0)
        t = t * t * (3.0 - 2.0 * t)
        heights[k] = smooth + t * (heights[k] - smooth)


NO_RAYS = np.zeros((0, 3))


def smoothed(relief: Relief, points: Array, footprint: Array, heights: Array, rays: Array = NO_RAYS) -> Array:
    """Heights (n,) that contour lines are of, metres: those of the smooth surface where pixels cover so little of a
    sample that bends would be seen, elsewhere those given.

    Args:
        relief: of the terrain. points: (n, 3) sample coordinates (and heights, which are not looked at).
        footprint: (n,) of a pixel, samples. heights: (n,) of the ground there.
        rays: (n, 3) directions by which the ground was met at its heights, columns, rows and metres: then heights are
            those at which they meet the smooth surface; else those above or below the points.
    """
    out = np.array(heights, np.float64)
    _smooth(relief.windows, points, footprint, rays, out)
    return out


def interpolated(samples: NDArray[np.float32], x: Array, y: Array) -> Array:
    """Heights (n,) of the smooth surface at columns and rows (n,) of samples (rows, cols); at the border slopes are
    one-sided; NaN beside missing samples."""
    rows, cols = samples.shape
    relief = Relief(Windows.one(np.ascontiguousarray(samples, np.float32).ravel(), (rows, cols)))
    inner = np.stack([x, y, np.zeros(len(x))], -1)
    none = np.full(len(x), -1e38)
    found = smoothed(relief, inner, np.zeros(len(x)), none)
    return np.where(found == none, np.nan, found)
