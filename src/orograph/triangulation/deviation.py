"""The deviation of a triangle or an edge of a TIN from the surface: exact vertical extremes, metres.

On a triangle, the deviation of two piecewise linear surfaces is extreme at the samples in it, at its corners (which are
samples), and where its edges cross the surface's own edges: grid lines and the diagonals of cells. The latter lie on
the lines x + y even and x − y even, because the diagonal of a cell joins its (even, even) to its (odd, odd) corner.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orograph._lanes import (
    LANES,
    counted,
    first_of,
    largest_of,
    load,
    one_of,
    size,
    some,
    spread,
    sum_of,
    where,
)
from orograph._numba import inlined, leaf
from orograph.triangulation.mesh import turn_of

FUZZ = 1e-6
"""Tolerance for rounding, cells: ends of rows are fractions with denominators below 2^14, so it is safe."""


class Facet(NamedTuple):
    """A triangle of a mesh, its corners from the upper one to the lower one.

    Attributes:
        x0, y0, x1, y1, x2, y2: columns (float64) and rows (int64). z0: the upper corner's height.
        across, down: slopes of its plane along rows and columns. det: twice its signed area.
        long, upper, lower: columns per row of the sides from corner 0 to 2, 0 to 1 and 1 to 2.
    """

    x0: float
    y0: Any
    x1: float
    y1: Any
    x2: float
    y2: Any
    z0: float
    across: float
    down: float
    det: float
    long: float
    upper: float
    lower: float


@inlined
def facet_of(m, a, b, c):
    """The triangle of three vertices."""
    if m.y[b] < m.y[a]:
        a, b = b, a
    if m.y[c] < m.y[a]:
        a, c = c, a
    if m.y[c] < m.y[b]:
        b, c = c, b
    x0, y0, x1, y1, x2, y2 = (
        np.float64(m.x[a]), np.int64(m.y[a]), np.float64(m.x[b]), np.int64(m.y[b]), np.float64(m.x[c]), np.int64(m.y[c])
    )  # fmt: skip
    z0, z1, z2 = m.z[a], m.z[b], m.z[c]
    det = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    across = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / det
    down = ((x1 - x0) * (z2 - z0) - (x2 - x0) * (z1 - z0)) / det
    long, upper, lower = (x2 - x0) / (y2 - y0), (x1 - x0) / (y1 - y0), (x2 - x1) / (y2 - y1)
    return Facet(x0, y0, x1, y1, x2, y2, z0, across, down, det, long, upper, lower)


@inlined
def rows_of(f):
    """The rows of a triangle, half-open, without those of a lone corner."""
    return f.y0 + (f.y0 < f.y1), f.y2 + (f.y1 == f.y2)


@inlined
def ends_of(f, y):
    """Where the sides of a triangle cross row y, from left to right (columns)."""
    far = f.x0 + (y - f.y0) * f.long
    near = f.x0 + (y - f.y0) * f.upper if y < f.y1 else f.x1 if y == f.y1 else f.x1 + (y - f.y1) * f.lower
    return (far - FUZZ, near + FUZZ) if f.det > 0 else (near - FUZZ, far + FUZZ)


@inlined
def plane_of(f, y):
    """The height of a triangle's plane at column 0 of row y."""
    return f.z0 + f.down * (y - f.y0) - f.across * f.x0


@inlined
def samples_of(low, high):
    """The first sample between two columns that are not negative, and the one after the last."""
    return np.int64(np.ceil(low)), np.int64(high) + 1


@inlined
def is_empty(m, a, b, c):
    """Whether a triangle has no samples but its corners (Pick's theorem), or no area."""
    return abs(turn_of(m, a, b, c)) <= 1


@inlined
def first_lane(f, cols):
    """The column of the first of eight lanes that hold a triangle's samples; negative if it is too wide."""
    left = np.int64(min(f.x0, f.x1, f.x2))
    fits = cols >= LANES and max(f.x0, f.x1, f.x2) - left < LANES
    return min(left, cols - LANES) if fits else np.int64(-1)


@inlined
def worst_sample(heights, m, a, b, c):
    """The largest deviation at the samples of a triangle other than its corners; and where."""
    if is_empty(m, a, b, c):
        return 0.0, np.int64(m.x[a]), np.int64(m.y[a])
    f = facet_of(m, a, b, c)
    left = first_lane(f, heights.shape[1])
    return worst_of_wide(heights, f) if left < 0 else worst_of_narrow(heights, f, left)


@leaf
def worst_of_wide(heights, f):
    """``worst_sample`` of any triangle."""
    largest, at_x, at_y = 0.0, np.int64(f.x0), f.y0
    top, bottom = rows_of(f)
    for y in range(top, bottom):
        plane = plane_of(f, y)
        first, end = samples_of(*ends_of(f, y))
        for x in range(first, end):
            off = abs(plane + f.across * x - heights[y, x])
            if off > largest:
                largest, at_x, at_y = off, np.int64(x), np.int64(y)
    return largest, at_x, at_y


@inlined
def worst_of_narrow(heights, f, left):
    """``worst_sample`` of a triangle whose samples lie in the eight columns from ``left`` on."""
    x = counted() + left
    slope = x * f.across
    largest, at_y = spread(0.0), spread(f.y0)
    top, bottom = rows_of(f)
    for y in range(top, bottom):
        low, high = ends_of(f, y)
        off = size(slope + plane_of(f, y) - load(heights, y * heights.shape[1] + left))
        larger = (x >= low) & (x <= high) & (off > largest)
        largest, at_y = where(larger, off, largest), where(larger, spread(y), at_y)
    worst = largest_of(largest)
    k = first_of(largest == worst)
    return worst, left + k, one_of(at_y, k)


@inlined
def squares_within(heights, m, a, b, c, limit, most):
    """The sum of squared deviations at the samples of a triangle.

    inf if one exceeds the limit, or the sum reaches ``most``.
    """
    if is_empty(m, a, b, c):
        return 0.0
    f = facet_of(m, a, b, c)
    left = first_lane(f, heights.shape[1])
    if left < 0:
        return squares_of_wide(heights, f, limit, most)
    squares = squares_of_narrow(heights, f, left, limit)
    return squares if squares < most else np.inf


@leaf
def squares_of_wide(heights, f, limit, most):
    """``squares_within`` of any triangle."""
    squares = 0.0
    top, bottom = rows_of(f)
    for y in range(top, bottom):
        plane = plane_of(f, y)
        first, end = samples_of(*ends_of(f, y))
        for x in range(first, end):
            off = abs(plane + f.across * x - heights[y, x])
            squares += off * off
            if off > limit or squares >= most:
                return np.inf
    return squares


@inlined
def squares_of_narrow(heights, f, left, limit):
    """``squares_within``, however large, of a triangle whose samples lie in the eight columns from ``left`` on."""
    x = counted() + left
    slope, squares = x * f.across, spread(0.0)
    top, bottom = rows_of(f)
    for y in range(top, bottom):
        low, high = ends_of(f, y)
        off = slope + plane_of(f, y) - load(heights, y * heights.shape[1] + left)
        off = where((x >= low) & (x <= high), size(off), 0.0)
        if some(off > limit):
            return np.inf
        squares += off * off
    return sum_of(squares)


@inlined
def between(low, high, f, z):
    """The deviation of the height z from the surface at a fraction of the way between two samples."""
    return abs(low + f * (high - low) - z)


@inlined
def worst_crossing(heights, m, a, b):
    """The largest deviation where an edge crosses edges of the surface.

    Also returns the two samples whose edge it crosses there, the nearer first.
    """
    x, y, none = np.int64(m.x[a]), np.int64(m.y[a]), np.int64(0)
    dx, dy = np.int64(m.x[b]) - x, np.int64(m.y[b]) - y
    if dx * dx + dy * dy <= 2 and (dx == 0 or dy == 0 or (x + y) & 1 == 0):  # an edge of the surface itself
        return -1.0, none, none, none, none
    return worst_between(heights, x, y, dx, dy, m.z[a], m.z[b] - m.z[a])


@leaf
def worst_between(heights, x0, y0, dx, dy, z0, dz):
    """``worst_crossing`` of a segment from a sample to (dx, dy, dz) from it."""
    largest = -1.0
    near_x = near_y = far_x = far_y = np.int64(0)
    for way in range(4):  # x, y, x + y, x − y: the numbers of the crossed lines
        s0 = x0 if way == 0 else y0 if way == 1 else x0 + y0 if way == 2 else x0 - y0
        ds = dx if way == 0 else dy if way == 1 else dx + dy if way == 2 else dx - dy
        step = 1 if way < 2 else 2
        low, high = min(s0, s0 + ds), max(s0, s0 + ds)
        line = low + 1 if way < 2 else low + 2 - (low & 1)
        while line < high:
            t = (line - s0) / ds
            if way == 0:
                x, y = np.float64(line), y0 + t * dy
                i, j = line, np.int64(np.floor(y))
                p, q, f = i, j + 1, y - j
            else:
                x = x0 + t * dx
                i = np.int64(np.floor(x))
                f = x - i
                j = line if way == 1 else line - i if way == 2 else i - line
                p, q = i + 1, j if way == 1 else j - 1 if way == 2 else j + 1
            line += step
            if f < FUZZ or f > 1 - FUZZ:
                continue  # a sample, which the triangles check
            off = between(np.float64(heights[j, i]), np.float64(heights[q, p]), f, z0 + t * dz)
            if off > largest:
                largest = off
                if f < 0.5:
                    near_x, near_y, far_x, far_y = i, j, p, q
                else:
                    near_x, near_y, far_x, far_y = p, q, i, j
    return largest, near_x, near_y, far_x, far_y
