"""The loops of a viewshed: apparent heights, their maximum pyramid, and the walk along a line of sight.

Apparent heights (see ``viewshed``) are integers, multiples of a *quantum* of at most 2⁻¹⁶ m counted from the eye, so
that half the memory of float64 holds them to 8 micrometres; ``MISSING`` stands for none. A node of level
L ≥ 1 of the pyramid covers 2^L × 2^L cells and holds the highest of their corners.

The walk goes from node to node as in ``raycast.traverse`` and ``raycast.skyline``: a node whose maximum lies under the
line of sight is skipped, the walk goes up a level at a parent's border, and in the remaining cells the ground is
compared with the line wherever it crosses an edge, which is exact for a triangulated surface.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf

MISSING = np.int32(-(2**31))
FAR = np.int32(-(2**31) + 1)
"""The lowest apparent height: ground far below the horizon is clamped to it."""

INF = np.inf


class Pyramid(NamedTuple):
    """Apparent heights and the maxima over their cells.

    Attributes:
        z: (rows, cols) int32 (or float32), ``MISSING`` in holes. maxima: of all levels, flat.
        offset, per_row: (levels + 1,) where each level's nodes begin, and how many there are in a row.
    """

    z: NDArray[Any]
    maxima: NDArray[Any]
    offset: NDArray[np.int64]
    per_row: NDArray[np.int64]


class Eye(NamedTuple):
    """The eye to which apparent heights refer.

    Attributes:
        height: metres. scale: 1 / quantum. bend: per metre. form: (2, 2), the true metres² of a step in samples.
    """

    height: float
    scale: float
    bend: float
    form: NDArray[np.float64]


class Ratio(NamedTuple):
    """True squared distance over that of the eye's form, on a lattice of (start, step) in x and in y, in samples."""

    values: NDArray[np.float64]
    x: tuple[float, float]
    y: tuple[float, float]


@kernel
def lower(heights, eye, x, y, lattice, out):
    """Apparent heights of a window of samples.

    Args:
        heights: (rows, cols) float32, NaN where missing.
        eye: ``Eye``. x, y: the window's first sample, counted from there. lattice: ``Ratio``, in the window's samples.
        out: (rows, cols) int32.
    """
    base, scale, bend, form = eye
    a, b, c = form[0, 0], form[0, 1], form[1, 1]
    ratio, rx, ry = lattice
    rows, cols = heights.shape
    for i in range(rows):
        fy = (i - ry[0]) / ry[1]
        ky = min(max(np.int64(np.floor(fy)), 0), ratio.shape[0] - 2)
        fy -= ky
        for j in range(cols):
            z = heights[i, j]
            if z != z:
                out[i, j] = MISSING
                continue
            dx, dy = x + j, y + i
            fx = (j - rx[0]) / rx[1]
            kx = min(max(np.int64(np.floor(fx)), 0), ratio.shape[1] - 2)
            fx -= kx
            r = (1.0 - fy) * ((1.0 - fx) * ratio[ky, kx] + fx * ratio[ky, kx + 1]) + fy * (
                (1.0 - fx) * ratio[ky + 1, kx] + fx * ratio[ky + 1, kx + 1]
            )
            drop = 0.5 * bend * r * (a * dx * dx + 2.0 * b * dx * dy + c * dy * dy)
            value = np.floor((np.float64(z) - base - drop) * scale / np.sqrt(r) + 0.5)
            out[i, j] = np.int32(min(max(value, np.float64(FAR)), 2.0**31 - 1))


@kernel
def first_level(z, out, row0, row1):
    """Node rows [row0, row1) of level 1: the 3 × 3 samples of 2 × 2 cells."""
    rows, cols = z.shape
    highest = np.empty(cols + 1, z.dtype)  # of three rows; the last column twice
    for i in range(row0, row1):
        a, b, c = 2 * i, 2 * i + 1, min(2 * i + 2, rows - 1)
        for j in range(cols):
            highest[j] = max(max(z[a, j], z[b, j]), z[c, j])
        highest[cols] = highest[cols - 1]
        for j in range(out.shape[1]):
            out[i, j] = max(max(highest[2 * j], highest[2 * j + 1]), highest[2 * j + 2])


@kernel
def next_level(fine, out, row0, row1):
    """Node rows [row0, row1) of the level above: the largest of up to four children."""
    rows, cols = fine.shape
    for i in range(row0, row1):
        for j in range(out.shape[1]):
            r, c = min(2 * i + 1, rows - 1), min(2 * j + 1, cols - 1)
            out[i, j] = max(max(fine[2 * i, 2 * j], fine[2 * i, c]), max(fine[r, 2 * j], fine[r, c]))


@inlined
def over(h0, h1, ground, t, last, least, most):
    """(h1, last): the end's height, raised if ``ground`` at t is above the line by ``least``; inf above ``most``."""
    if ground - (h0 + t * (h1 - h0)) > least and t > 1e-12 and t < 1.0 - 1e-12:
        raised = h0 + (ground - h0) / t
        return (INF if raised > most else raised), t
    return h1, last


@leaf
def walk(pyramid, cx, cy, start, end, least, most):
    """The height that the end of a line needs for the line to clear the ground.

    Args:
        pyramid: ``Pyramid``. cx, cy: the first cell of the line.
        start, end: of the line, (column, row, apparent height in quanta), float64. least: quanta.
        most: end with inf where the height exceeds this; −inf: at the first ground above the line.

    Returns:
        (h1, t): the end's height, raised until no ground is above the line, and the place of the ground that raised it
        last (−1: none).
    """
    z, maxima, offset, per_row = pyramid
    (x, y, h0), (x1, y1, h1) = start, end
    nr, nc = z.shape[0] - 1, z.shape[1] - 1
    top = per_row.shape[0] - 1
    dx, dy = x1 - x, y1 - y
    ix = 1.0 / dx if dx != 0.0 else 0.0
    iy = 1.0 / dy if dy != 0.0 else 0.0
    right, down = dx > 0.0, dy > 0.0
    t, last = 0.0, -1.0
    level = 0
    while True:
        jx, jy = cx >> level, cy >> level
        tx = INF if dx == 0.0 else ((((jx + 1) << level) if right else (jx << level)) - x) * ix
        ty = INF if dy == 0.0 else ((((jy + 1) << level) if down else (jy << level)) - y) * iy
        te = max(min(min(tx, ty), 1.0), t)
        line = min(h0 + t * (h1 - h0), h0 + te * (h1 - h0))
        if level >= 1:
            if maxima[offset[level] + jy * per_row[level] + jx] > line:
                level -= 1
                continue
        else:
            ia, ib, ic, id_ = z[cy, cx], z[cy, cx + 1], z[cy + 1, cx], z[cy + 1, cx + 1]
            if max(max(ia, ib), max(ic, id_)) > line:
                a, b, c, d = np.float64(ia), np.float64(ib), np.float64(ic), np.float64(id_)
                u0, v0 = x + t * dx - cx, y + t * dy - cy
                u1, v1 = x + te * dx - cx, y + te * dy - cy
                if ((cx + cy) & 1) == 0:
                    g0, g1 = u0 - v0, u1 - v1
                    # Triangle a b d (g ≥ 0), then a c d.
                    has0 = ia != MISSING and ib != MISSING and id_ != MISSING
                    has1 = ia != MISSING and ic != MISSING and id_ != MISSING
                    base0, p0, q0, base1, p1, q1 = a, b - a, d - b, a, d - c, c - a
                else:
                    g0, g1 = 1.0 - u0 - v0, 1.0 - u1 - v1
                    # Triangle a b c (g ≥ 0), then b c d.
                    has0 = ia != MISSING and ib != MISSING and ic != MISSING
                    has1 = ib != MISSING and ic != MISSING and id_ != MISSING
                    base0, p0, q0, base1, p1, q1 = a, b - a, c - a, b + c - d, d - c, d - b
                if has0:
                    if g0 >= 0.0:
                        h1, last = over(h0, h1, base0 + u0 * p0 + v0 * q0, t, last, least, most)
                    if g1 >= 0.0:
                        h1, last = over(h0, h1, base0 + u1 * p0 + v1 * q0, te, last, least, most)
                if has1:
                    if g0 <= 0.0:
                        h1, last = over(h0, h1, base1 + u0 * p1 + v0 * q1, t, last, least, most)
                    if g1 <= 0.0:
                        h1, last = over(h0, h1, base1 + u1 * p1 + v1 * q1, te, last, least, most)
                if g0 * g1 < 0.0 and (has0 or has1):
                    f = g0 / (g0 - g1)
                    u, v = u0 + f * (u1 - u0), v0 + f * (v1 - v0)
                    ground = base0 + u * p0 + v * q0 if has0 else base1 + u * p1 + v * q1
                    h1, last = over(h0, h1, ground, t + f * (te - t), last, least, most)
                if h1 == INF:
                    return h1, last
        if te >= 1.0:
            return h1, last
        t = te
        if tx <= ty:
            climb = ((jx & 1) == 1) == right
            cx = ((jx + 1) << level) if right else (jx << level) - 1
            if cx < 0 or cx >= nc:
                return h1, last
            cy = min(max(np.int64(np.floor(y + t * dy)), jy << level), min(((jy + 1) << level), nr) - 1)
        else:
            climb = ((jy & 1) == 1) == down
            cy = ((jy + 1) << level) if down else (jy << level) - 1
            if cy < 0 or cy >= nr:
                return h1, last
            cx = min(max(np.int64(np.floor(x + t * dx)), jx << level), min(((jx + 1) << level), nc) - 1)
        if climb and level < top:
            level += 1


@inlined
def first_cell(position, step, cells):
    """The cell, along one axis, that a line enters from a position."""
    c = np.int64(np.floor(position))
    if step < 0.0 and position == c:
        c -= 1
    return min(max(c, 0), cells - 1)


@leaf
def along(pyramid, start, end, least, most):
    """``walk`` from its first cell; a line along a row or a column of samples has ground on either side."""
    (x, y, _), (x1, y1, _) = start, end
    dx, dy = x1 - x, y1 - y
    rows, cols = pyramid.z.shape
    cx, cy = first_cell(x, dx, cols - 1), first_cell(y, dy, rows - 1)
    h1, at = walk(pyramid, cx, cy, start, end, least, most)
    if dx == 0.0 and x == np.floor(x) and x > 0.0 and h1 < INF:
        h1, other = walk(pyramid, np.int64(x) - 1, cy, start, (x1, y1, h1), least, most)
        at = other if other >= 0.0 else at
    if dy == 0.0 and y == np.floor(y) and y > 0.0 and h1 < INF:
        h1, other = walk(pyramid, cx, np.int64(y) - 1, start, (x1, y1, h1), least, most)
        at = other if other >= 0.0 else at
    return h1, at


@leaf
def ground_at(z, x, y):
    """Apparent height of the surface at a place, −inf in a hole."""
    cx, cy = min(np.int64(x), z.shape[1] - 2), min(np.int64(y), z.shape[0] - 2)
    ia, ib, ic, id_ = z[cy, cx], z[cy, cx + 1], z[cy + 1, cx], z[cy + 1, cx + 1]
    if ia == MISSING or ib == MISSING or ic == MISSING or id_ == MISSING:
        return -INF  # not worth more, because it is only a guess
    a, b, c, d = np.float64(ia), np.float64(ib), np.float64(ic), np.float64(id_)
    u, v = x - cx, y - cy
    if ((cx + cy) & 1) == 0:
        return a + u * (b - a) + v * (d - b) if u >= v else a + v * (c - a) + u * (d - c)
    return a + u * (b - a) + v * (c - a) if u + v <= 1.0 else d + (1.0 - u) * (c - d) + (1.0 - v) * (b - d)


@kernel
def look(pyramid, ox, oy, height, stretch, least, stop, window, out):
    """Compute the samples of a window, [row0, row1) × [col0, col1), as seen from an eye at (ox, oy).

    Whether a sample is visible is found from the sample towards the eye (an obstruction is usually near it); the height
    that it needs, from the eye outward (everything hidden behind a ridge is skipped). The ground that hid the sample
    before or the one above probably hides this one too, so the ground at that distance from the eye is tested first.

    Args:
        height: of targets above the ground, in quanta.
        stretch: (rows, cols) of the block: true metres per apparent metre.
        out: (rows, cols) float32 of the block: with ``stop`` 1 (seen) or 0; without it how many quanta above the ground
            a target must be to be seen; NaN where the ground is missing.
    """
    z = pyramid.z
    row0, row1, col0, col1 = window
    eye = 0.0
    # The distance from the eye to the ground that hides the samples above, shifted by one.
    before = np.full(col1 - col0 + 1, INF)
    for i in range(row0, row1):
        for j in range(col0, col1):
            k = j - col0 + 1
            if z[i, j] == MISSING:
                out[i - row0, j - col0] = np.nan
                continue
            true = stretch[i - row0, j - col0]
            target = np.float64(z[i, j]) + height / true
            x, y = np.float64(j), np.float64(i)
            far = np.hypot(x - ox, y - oy)
            raised = target
            hides = INF
            for guess in range(2):
                s = before[k - 1 + guess]
                if s < far - 1e-6 and s > 1e-6:
                    t = s / far
                    ground = ground_at(z, ox + t * (x - ox), oy + t * (y - oy))
                    if ground - (eye + t * (raised - eye)) > least:
                        raised, hides = eye + (ground - eye) / t, s
            if (raised == target or not stop) and far > 0.0:
                if stop:
                    h1, at = along(pyramid, (x, y, target), (ox, oy, eye), least, -INF)
                    if at >= 0.0:
                        raised, hides = INF, (1.0 - at) * far
                else:
                    h1, at = along(pyramid, (ox, oy, eye), (x, y, raised), least, INF)
                    if at >= 0.0:
                        raised, hides = h1, at * far
            before[k] = hides
            if stop:
                out[i - row0, j - col0] = 1.0 if raised == target else 0.0
            else:
                out[i - row0, j - col0] = (raised - target) * true
