"""The deviation of a triangle or an edge of a TIN from the surface: exact vertical extremes, metres.

On a triangle, the deviation of two piecewise linear surfaces is extreme at the samples in it, at its corners (which are
samples), and where its edges cross the surface's own edges: grid lines and the diagonals of cells. The latter lie on
the lines x + y even and x − y even, because the diagonal of a cell joins its (even, even) to its (odd, odd) corner.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orograph._numba import inlined, leaf

FUZZ = 1e-6
"""Tolerance for rounding, cells: ends of rows are fractions with denominators below 2^14, so it is safe."""


@inlined
def span(y, x0, y0, x1, y1):
    """The x at which a side of a triangle crosses row y."""
    return x0 + (y - y0) * ((x1 - x0) / (y1 - y0))


class Facet(NamedTuple):
    """A triangle of a mesh, its corners from the upper one to the lower one.

    Attributes:
        x0, y0, x1, y1, x2, y2: columns (float64) and rows (int64). z0: the upper corner's height.
        across, down: slopes of its plane along rows and columns. det: twice its signed area.
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


@leaf
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
    return Facet(x0, y0, x1, y1, x2, y2, z0, across, down, det)


@inlined
def row_of(f, y):
    """The first and the last sample of a triangle in row y, and its plane's height at column 0 there."""
    far = span(y, f.x0, f.y0, f.x2, f.y2)
    near = span(y, f.x0, f.y0, f.x1, f.y1) if y < f.y1 or f.y1 == f.y2 else span(y, f.x1, f.y1, f.x2, f.y2)
    first, last = np.int64(np.ceil(min(near, far) - FUZZ)), np.int64(np.floor(max(near, far) + FUZZ))
    return first, last, f.z0 + f.down * (y - f.y0) - f.across * f.x0


@leaf
def worst_sample(heights, m, a, b, c):
    """The largest deviation at the samples of a triangle, including its outline; and where."""
    f = facet_of(m, a, b, c)
    if abs(f.det) == 1 or f.y0 == f.y2:  # no other samples (Pick's theorem)
        return 0.0, np.int64(f.x0), f.y0
    largest, at_x, at_y = -1.0, np.int64(0), np.int64(0)
    for y in range(f.y0, f.y2 + 1):
        first, last, plane = row_of(f, y)
        for x in range(first, last + 1):
            off = abs(plane + f.across * x - heights[y, x])
            if off > largest:
                largest, at_x, at_y = off, np.int64(x), np.int64(y)
    return largest, at_x, at_y


@leaf
def squares_within(heights, m, a, b, c, limit, most):
    """The sum of squared deviations at the samples of a triangle.

    inf if one exceeds the limit, or the sum reaches ``most``.
    """
    f = facet_of(m, a, b, c)
    squares = 0.0
    if abs(f.det) == 1 or f.y0 == f.y2:
        return squares
    for y in range(f.y0, f.y2 + 1):
        first, last, plane = row_of(f, y)
        for x in range(first, last + 1):
            off = abs(plane + f.across * x - heights[y, x])
            squares += off * off
            if off > limit or squares >= most:
                return np.inf
    return squares


@inlined
def between(low, high, f, z):
    """The deviation of the height z from the surface at a fraction of the way between two samples."""
    return abs(low + f * (high - low) - z)


@leaf
def worst_crossing(heights, m, a, b):
    """The largest deviation where an edge crosses edges of the surface.

    Also returns the two samples whose edge it crosses there, the nearer first.
    """
    x, y = np.int64(m.x[a]), np.int64(m.y[a])
    return worst_between(heights, x, y, np.int64(m.x[b]) - x, np.int64(m.y[b]) - y, m.z[a], m.z[b] - m.z[a])


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
