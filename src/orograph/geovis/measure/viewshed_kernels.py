"""The loops of a viewshed: apparent heights, their maximum pyramid, and the walk from a target to the eye.

Apparent heights (see ``viewshed``) are integers, multiples of a *quantum* of at most 2⁻¹⁶ m counted from the eye's
ground, so that half the memory of float64 holds them to 8 micrometres; ``MISSING`` stands for none. A node of level
L ≥ 1 of the pyramid covers 2^L × 2^L cells and holds the highest of their corners.

The walk goes from node to node as ``raycast.traverse`` and ``raycast.skyline`` do: a node whose maximum lies under the
line of sight is passed whole, a level is climbed at a parent's border, and in cells that stay the ground is compared
with the line wherever it crosses an edge, which for a triangulated surface is exact.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf

MISSING = np.int32(-(2**31))
FAR = np.int32(-(2**31) + 1)
"""The lowest apparent height there is: ground far under the horizon is no lower than this."""

INF = np.inf


@kernel
def lower(heights, base, scale, bend, a, b, c, x, y, ratio, rx, ry, out):
    """Apparent heights of a window of samples.

    Args:
        heights: (rows, cols) float32, NaN where missing.
        base: metres that become 0; scale: 1 / quantum; bend: per metre.
        a, b, c: metres² of a step (dx, dy) in samples: a dx² + 2 b dx dy + c dy².
        x, y: the window's first sample, counted from the eye.
        ratio: (m, n) true squared distance by that one, on nodes rx, ry samples apart from the window's lattice.
        rx, ry: (start, step) of the lattice in samples of the window.
        out: (rows, cols) int32.
    """
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
            value = np.floor((np.float64(z) - base - drop) * scale + 0.5)
            out[i, j] = np.int32(min(max(value, np.float64(FAR)), 2.0**31 - 1))


@kernel
def first_level(z, out, row0, row1):
    """Node rows [row0, row1) of level 1: the 3 × 3 samples of 2 × 2 cells."""
    rows, cols = z.shape
    for i in range(row0, row1):
        for j in range(out.shape[1]):
            m = MISSING
            for r in range(2 * i, min(2 * i + 3, rows)):
                for c in range(2 * j, min(2 * j + 3, cols)):
                    m = max(m, z[r, c])
            out[i, j] = m


@kernel
def next_level(fine, out):
    """The level above: the largest of up to four children."""
    rows, cols = fine.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            r, c = min(2 * i + 1, rows - 1), min(2 * j + 1, cols - 1)
            out[i, j] = max(max(fine[2 * i, 2 * j], fine[2 * i, c]), max(fine[r, 2 * j], fine[r, c]))


@inlined
def over(target, eye, ground, t, least, stop):
    """The target's height, raised (inf with ``stop``) where ``ground`` at t is over its line to the eye."""
    if ground - (target + t * (eye - target)) > least and t < 1.0 - 1e-12:
        return INF if stop else eye + (ground - eye) / (1.0 - t)
    return target


@leaf
def walk(z, maxima, offset, per_row, cx, cy, x, y, target, ox, oy, eye, least, stop):
    """How high a target at sample (x, y) must be to be seen by an eye at (ox, oy).

    Args:
        z: (rows, cols) int32 apparent heights; maxima, offset, per_row: their pyramid.
        cx, cy: the first cell of the line.
        target, eye: apparent heights in quanta, float64; ``least`` too.
        stop: return inf at the first ground above the line.

    Returns:
        the target's height, raised until no ground stands above the line.
    """
    nr, nc = z.shape[0] - 1, z.shape[1] - 1
    top = per_row.shape[0] - 1
    dx, dy = ox - x, oy - y
    ix = 1.0 / dx if dx != 0.0 else 0.0
    iy = 1.0 / dy if dy != 0.0 else 0.0
    right, down = dx > 0.0, dy > 0.0
    t = 0.0
    level = 0
    while True:
        jx, jy = cx >> level, cy >> level
        tx = INF if dx == 0.0 else ((((jx + 1) << level) if right else (jx << level)) - x) * ix
        ty = INF if dy == 0.0 else ((((jy + 1) << level) if down else (jy << level)) - y) * iy
        te = max(min(min(tx, ty), 1.0), t)
        line = min(target + t * (eye - target), target + te * (eye - target))
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
                        target = over(target, eye, base0 + u0 * p0 + v0 * q0, t, least, stop)
                    if g1 >= 0.0:
                        target = over(target, eye, base0 + u1 * p0 + v1 * q0, te, least, stop)
                if has1:
                    if g0 <= 0.0:
                        target = over(target, eye, base1 + u0 * p1 + v0 * q1, t, least, stop)
                    if g1 <= 0.0:
                        target = over(target, eye, base1 + u1 * p1 + v1 * q1, te, least, stop)
                if g0 * g1 < 0.0 and (has0 or has1):
                    f = g0 / (g0 - g1)
                    u, v = u0 + f * (u1 - u0), v0 + f * (v1 - v0)
                    ground = base0 + u * p0 + v * q0 if has0 else base1 + u * p1 + v * q1
                    target = over(target, eye, ground, t + f * (te - t), least, stop)
                if target == INF:
                    return target
        if te >= 1.0:
            return target
        t = te
        if tx <= ty:
            climb = ((jx & 1) == 1) == right
            cx = ((jx + 1) << level) if right else (jx << level) - 1
            if cx < 0 or cx >= nc:
                return target
            cy = min(max(np.int64(np.floor(y + t * dy)), jy << level), min(((jy + 1) << level), nr) - 1)
        else:
            climb = ((jy & 1) == 1) == down
            cy = ((jy + 1) << level) if down else (jy << level) - 1
            if cy < 0 or cy >= nr:
                return target
            cx = min(max(np.int64(np.floor(x + t * dx)), jx << level), min(((jx + 1) << level), nc) - 1)
        if climb and level < top:
            level += 1


@kernel
def look(z, maxima, offset, per_row, ox, oy, eye, height, least, stop, row0, row1, col0, col1, out):
    """Look at samples [row0, row1) × [col0, col1) from an eye at (ox, oy).

    Args:
        height: of targets above the ground, in quanta.
        out: (rows, cols) float32 of the block: with ``stop`` 1 (seen) or 0; without it how many quanta above the ground
            a target must be to be seen; NaN where the ground is missing.
    """
    nr, nc = z.shape[0] - 1, z.shape[1] - 1
    for i in range(row0, row1):
        for j in range(col0, col1):
            if z[i, j] == MISSING:
                out[i - row0, j - col0] = np.nan
                continue
            begin = np.float64(z[i, j]) + height
            x, y = np.float64(j), np.float64(i)
            dx, dy = ox - x, oy - y
            found = begin
            if dx != 0.0 or dy != 0.0:
                cx = min(max(j if dx >= 0.0 else j - 1, 0), nc - 1)
                cy = min(max(i if dy >= 0.0 else i - 1, 0), nr - 1)
                found = walk(z, maxima, offset, per_row, cx, cy, x, y, found, ox, oy, eye, least, stop)
                # Along a row or a column of samples the ground may be on either side of the line.
                if dx == 0.0 and j > 0 and found < INF:
                    found = walk(z, maxima, offset, per_row, j - 1, cy, x, y, found, ox, oy, eye, least, stop)
                if dy == 0.0 and i > 0 and found < INF:
                    found = walk(z, maxima, offset, per_row, cx, i - 1, x, y, found, ox, oy, eye, least, stop)
            if stop:
                out[i - row0, j - col0] = 0.0 if found == INF else 1.0
            else:
                out[i - row0, j - col0] = found - begin
