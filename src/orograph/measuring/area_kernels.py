"""The loop over a tile's triangles for an area: each is clipped by the polygon, and its exact part summed.

Clipping is Sutherland & Hodgman's (1974, *Reentrant polygon clipping*, CACM 17), with the triangle as the convex window
and a ring of the polygon as subject: a ring that is not convex leaves edges on the window's border that run back and
forth and enclose nothing, so that the signed area and centroid of the result are correct. To keep rings short they are
cut to the tile first, then to each row of cells; cells that no edge touches are inside or outside according to their
middle. Sample coordinates: x columns, y rows.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel, leaf

SUMS = 8
PLAN, MISSING, SURFACE, FLAT, SURFACE_GRID, HEIGHT, ABOVE, BELOW = range(SUMS)
"""Sums of areas in cells: ground and holes in plan; the ground's true surface, and that of level ground at height 0 in
its place and that of the holes; the ground's surface on the grid; and ground times height, height above the level, and
height below it."""
ROOM = 32
"""A cut multiplies points by at most 1.5, and there are at most eight cuts in sequence."""


@leaf
def cut(src, n, a, b, c, out):
    """Clip a polygon of n points (x, y) to a x + b y + c ≥ 0; returns how many points are in ``out``."""
    m = 0
    for k in range(n):
        x0, y0 = src[k, 0], src[k, 1]
        j = k + 1 if k + 1 < n else 0
        x1, y1 = src[j, 0], src[j, 1]
        d0, d1 = a * x0 + b * y0 + c, a * x1 + b * y1 + c
        if d0 >= 0.0:
            out[m, 0], out[m, 1] = x0, y0
            m += 1
        if (d0 > 0.0 and d1 < 0.0) or (d0 < 0.0 and d1 > 0.0):
            f = d0 / (d0 - d1)
            x, y = x0 + f * (x1 - x0), y0 + f * (y1 - y0)
            if a == 0.0 and abs(b) == 1.0:  # exactly on the border, for later steps
                y = -c / b
            elif b == 0.0 and abs(a) == 1.0:
                x = -c / a
            out[m, 0], out[m, 1] = x, y
            m += 1
    return m


@leaf
def moments(poly, n, x0, y0):
    """Signed area of a polygon, and its first moments about (x0, y0)."""
    area = mx = my = 0.0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        ax, ay = poly[k, 0] - x0, poly[k, 1] - y0
        bx, by = poly[j, 0] - x0, poly[j, 1] - y0
        w = 0.5 * (ax * by - bx * ay)
        area += w
        mx += w * (ax + bx) / 3.0
        my += w * (ay + by) / 3.0
    return area, mx, my


@leaf
def clip_box(ring, n, west, north, east, south, one, two):
    """Cut a ring to a rectangle, in ``two``; returns the number of points."""
    n = cut(ring, n, 1.0, 0.0, -west, one)
    n = cut(one, n, -1.0, 0.0, east, two)
    n = cut(two, n, 0.0, 1.0, -north, one)
    return cut(one, n, 0.0, -1.0, south, two)


@kernel
def clip_ring(ring, west, north, east, south, one, two):
    """Cut a ring (n, 2) to a rectangle; ``one`` and ``two`` (``ROOM`` · n, 2) are room; the ring is in ``two``.

    Returns the number of its points. (A kernel that returned an array could not be interrupted.)
    """
    return clip_box(ring, len(ring), west, north, east, south, one, two)


@leaf
def sides(cells, ring, n, row, col0):
    """Mark the cells of a row that a ring's edges touch (``cells[0]``); count windings about middles (``cells[1]``)."""
    middle = row + 0.5
    m = cells.shape[1]
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        x0, y0, x1, y1 = ring[k, 0], ring[k, 1], ring[j, 0], ring[j, 1]
        low, high = max(min(y0, y1), row), min(max(y0, y1), row + 1.0)
        if low > high:
            continue
        if y0 == y1:
            a, b = min(x0, x1), max(x0, x1)
        else:
            xa, xb = x0 + (low - y0) / (y1 - y0) * (x1 - x0), x0 + (high - y0) / (y1 - y0) * (x1 - x0)
            a, b = min(xa, xb), max(xa, xb)
        first, last = np.int64(np.floor(a - 1e-9)) - col0, np.int64(np.floor(b + 1e-9)) - col0
        for c in range(max(first, 0), min(last, m - 1) + 1):
            cells[0, c] = 1
        if (y0 <= middle) != (y1 <= middle):
            x = x0 + (middle - y0) / (y1 - y0) * (x1 - x0)
            turn = 1 if y1 > y0 else -1
            # Cells whose middle is to the left of the edge.
            upto = min(np.int64(np.ceil(x - 0.5)) - col0, m)
            if upto > 0:
                cells[1, upto - 1] += turn  # summed up from the right


@leaf
def facet(a, b, c, d, even, half):
    """(base, p, q): base + p u + q v is the height on a triangle; corners a (0, 0), b (1, 0), c (0, 1), d (1, 1)."""
    if even:
        return (a, b - a, d - b) if half == 0 else (a, d - c, c - a)
    return (a, b - a, c - a) if half == 0 else (b + c - d, d - c, d - b)


@leaf
def diagonal(x, y, even, half):
    """The half-plane (a, b, c): a x + b y + c ≥ 0 of a triangle of the cell at (x, y), beside those of the cell."""
    if even:
        return (1.0, -1.0, y - x) if half == 0 else (-1.0, 1.0, x - y)
    return (-1.0, -1.0, x + y + 1.0) if half == 0 else (1.0, 1.0, -x - y - 1.0)


@leaf
def box(out, x, y):
    """The four corners of a cell, positive in (x, y); returns 4."""
    for k in range(4):
        out[k, 0], out[k, 1] = x + (k == 1 or k == 2), y + (k >= 2)
    return 4


@leaf
def blend(metrics, k, fx, fy):
    """An entry of the metric at a place in the tile (0 to 1 each way), bilinear between the lattice's nodes."""
    fx *= metrics.shape[1] - 1
    fy *= metrics.shape[0] - 1
    i, j = min(np.int64(fy), metrics.shape[0] - 2), min(np.int64(fx), metrics.shape[1] - 2)
    fx -= j
    fy -= i
    north = metrics[i, j, k] + fx * (metrics[i, j + 1, k] - metrics[i, j, k])
    south = metrics[i + 1, j, k] + fx * (metrics[i + 1, j + 1, k] - metrics[i + 1, j, k])
    return north + fy * (south - north)


@leaf
def stretched(z, p, q, inverse, g0, g1, g2, radius):
    """(True, grid) metres² of surface on a grid metre², of a facet at height z that rises p, q per sample."""
    east, north = p * inverse[0, 0] + q * inverse[1, 0], p * inverse[0, 1] + q * inverse[1, 1]
    # The first fundamental form f² G + g gᵀ: its determinant is f⁴ |G| (1 + gᵀ G⁻¹ g / f²).
    det = g0 * g2 - g1 * g1
    f2 = (1.0 + z / radius) ** 2
    steep = (g2 * east * east - 2.0 * g1 * east * north + g0 * north * north) / det
    return f2 * np.sqrt(det * (1.0 + steep / f2)), np.sqrt(1.0 + east * east + north * north)


@kernel
def measure(heights, row0, col0, rings, counts, level, metrics, radius, inverse, sums):
    """Sum over the triangles of a tile.

    Args:
        heights: (rows, cols) float32, NaN where missing; first sample (row0, col0), both even.
        rings: (k, n, 2) the polygon's rings cut to the tile, outer ones of positive area in (x, y); counts (k,).
        level: height that volumes are counted from; NaN: none are.
        metrics: (m, n, 3) metric (G00, G01, G11) on a lattice over the tile, its corners included.
        radius: of the body; inverse: (2, 2) columns and rows per metre east and north.
        sums: (SUMS,) see ``PLAN``.
    """
    nr, nc = heights.shape[0] - 1, heights.shape[1] - 1
    size = 4
    for k in range(len(counts)):
        size = max(size, counts[k])
    room = ROOM * size
    one, two = np.empty((room, 2)), np.empty((room, 2))
    bands = np.empty((len(counts), room, 2))
    lengths = np.empty(len(counts), np.int64)
    cells = np.zeros((2, nc), np.int64)
    volumes = level == level
    for i in range(nr):
        r = row0 + i
        cells[:] = 0
        for k in range(len(counts)):
            n = cut(rings[k], counts[k], 0.0, 1.0, -np.float64(r), one)
            lengths[k] = cut(one, n, 0.0, -1.0, r + 1.0, bands[k])
            sides(cells, rings[k], counts[k], np.float64(r), col0)
        winding = 0
        for j in range(nc - 1, -1, -1):
            winding += cells[1, j]
            edge = cells[0, j] == 1
            if winding == 0 and not edge:
                continue
            a, b = np.float64(heights[i, j]), np.float64(heights[i, j + 1])
            c, d = np.float64(heights[i + 1, j]), np.float64(heights[i + 1, j + 1])
            x, y = np.float64(col0 + j), np.float64(r)
            even = ((r + col0 + j) & 1) == 0
            fx, fy = (j + 0.5) / nc, (i + 0.5) / nr
            g0, g1, g2 = blend(metrics, 0, fx, fy), blend(metrics, 1, fx, fy), blend(metrics, 2, fx, fy)
            for half in range(2):
                base, p, q = facet(a, b, c, d, even, half)
                hole = not (base == base and p == p and q == q)
                sx, sy, sc = diagonal(x, y, even, half)
                area = mx = my = above = 0.0
                parts = len(counts)
                if not edge:
                    parts = 1 if volumes else 0
                    if not volumes:  # the whole triangle: a half, its centroid a third and two thirds into the cell
                        area = 0.5
                        mx = 1.0 / 6.0 if even == (half == 1) else 1.0 / 3.0
                        my = 1.0 / 6.0 if half == 0 else 1.0 / 3.0
                for k in range(parts):
                    if edge:
                        n = clip_box(bands[k], lengths[k], x, y, x + 1.0, y + 1.0, one, two)
                    else:
                        n = box(two, x, y)
                    n = cut(two, n, sx, sy, sc, one)
                    w, wx, wy = moments(one, n, x, y)
                    area += w
                    mx += wx
                    my += wy
                    if volumes and not hole:
                        n = cut(one, n, p, q, base - level - p * x - q * y, two)
                        w, wx, wy = moments(two, n, x, y)
                        above += w * (base - level) + p * wx + q * wy
                if area <= 1e-15:
                    continue
                sums[FLAT] += area * np.sqrt(g0 * g2 - g1 * g1)
                if hole:
                    sums[MISSING] += area
                    continue
                volume = base * area + p * mx + q * my
                true, grid = stretched(volume / area, p, q, inverse, g0, g1, g2, radius)
                sums[PLAN] += area
                sums[HEIGHT] += volume
                sums[SURFACE] += area * true
                sums[SURFACE_GRID] += area * grid
                if volumes:
                    sums[ABOVE] += above
                    sums[BELOW] += above - (volume - level * area)
