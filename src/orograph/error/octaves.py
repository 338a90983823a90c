"""Errors of the diamonds of one octave, from the heights at its spacing and the octave below.

An octave holds the diamonds whose vertex is a multiple of s = 2^k samples and of no more: the *square* ones (row/s and
col/s odd) and the *edge* ones (exactly one odd). The children of a square diamond are the edge diamonds on its four
sides, those of an edge diamond the square diamonds of the octave below around it: within an octave edges come first,
and the octave below is complete before.

Arrays are windows of level k: entry (i, j) belongs to sample (row0 + i·s, col0 + j·s), where row0 and col0 are
multiples of 4·s, so that the parities of i and j tell what a diamond is. Rows 0 < i < ``inner`` and columns likewise
are wholly inside window and raster and take a fast path without branches; the others are on the *rim*. Neighbours
beyond the window are treated as absent, as beyond the square's border; whoever works on a part of a raster gives it a
margin and drops it afterwards.

* ``midpoint``: height of the vertex above the middle of the hypotenuse (Lindstrom & Pascucci 2001, Blow 2000).
* ``wedgie``: the nested sum of Duchaineau et al. 1997, sec. 6, of local errors (``wedgies``).
* ``exact``: the largest deviation of any full-resolution sample (``deviation``).

All are then made monotonic: no less than the children's (``monotony``). Heights and errors in metres; arithmetic in
float64; results are rounded up to float32.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf, linked
from orograph.error.deviation import edge_across, edge_along, split_distance, square, triangle

MIDPOINT, WEDGIE, EXACT = 0, 1, 2


@inlined
def round_up(value):
    """float32, not less than the float64 ``value`` ≥ 0."""
    return np.float32(value * (1.0 + 2.0**-23))


@inlined
def inner(first, k, side, count):
    """The end of a window's entries, along one axis, whose diamonds lie inside the raster and the window.

    Args:
        first: sample of entry 0. side: samples of the raster. count: entries of the window.
    """
    return max(min((side - 1 - first) >> k, count - 1), 1)


@leaf
def corners(i, j):
    """Entries of a diamond's corners: the ends of its hypotenuse, then its apexes, first the upper or left one."""
    if i & 1 == 0:
        return i, j - 1, i, j + 1, i - 1, j, i + 1, j
    if j & 1 == 0:
        return i - 1, j, i + 1, j, i, j - 1, i, j + 1
    if (i >> 1) + (j >> 1) & 1 == 0:  # cut from north-west to south-east
        return i - 1, j - 1, i + 1, j + 1, i - 1, j + 1, i + 1, j - 1
    return i - 1, j + 1, i + 1, j - 1, i - 1, j - 1, i + 1, j + 1


@leaf
def _height(z, i, j):
    """Height of an entry: NaN before the window, the last one beyond its end (there the border squeezes)."""
    if i < 0 or j < 0:
        return np.nan
    return np.float64(z[min(i, z.shape[0] - 1), min(j, z.shape[1] - 1)])


@leaf
def _on_rim(fine, z, row0, col0, k, rows, cols, i, j, kind):
    """The local error (MIDPOINT, WEDGIE) or deviation (EXACT) of any diamond, squeezed or not."""
    s = np.int64(1) << k
    y = np.int64(rows - 1)
    x = np.int64(cols - 1)
    cut_north = (i == 0 and row0 > 0) or (i + 1 >= z.shape[0] and row0 + (i + 1) * s <= y)
    cut_west = (j == 0 and col0 > 0) or (j + 1 >= z.shape[1] and col0 + (j + 1) * s <= x)
    if cut_north or cut_west:
        return 0.0  # the window ends in the diamond, the raster does not: it is in the margin
    ai, aj, bi, bj, pi, pj, qi, qj = corners(i, j)
    ay, ax, a = min(row0 + ai * s, y), min(col0 + aj * s, x), _height(z, ai, aj)
    by, bx, b = min(row0 + bi * s, y), min(col0 + bj * s, x), _height(z, bi, bj)
    py, px, p = min(row0 + pi * s, y), min(col0 + pj * s, x), _height(z, pi, pj)
    qy, qx, q = min(row0 + qi * s, y), min(col0 + qj * s, x), _height(z, qi, qj)
    if kind == EXACT:
        # An apex that is not there (the square's border) makes its triangle's heights NaN: no distance.
        one = triangle(fine, row0, col0, ay, ax, a, by, bx, b, py, px, p)
        two = triangle(fine, row0, col0, ay, ax, a, by, bx, b, qy, qx, q)
        return max(one, two)
    my, mx = min(row0 + i * s, y), min(col0 + j * s, x)
    m = np.float64(z[i, j])
    d = split_distance((ay, ax, a), (by, bx, b), (py, px, p), (qy, qx, q), (my, mx, m), kind == MIDPOINT)
    return d if d == d else 0.0


@linked
def _rim_row(fine, z, row0, col0, k, rows, cols, kind, i, errors):
    """The errors of row i on the rim; ``errors`` is that row."""
    height, width = z.shape
    inside = 0 < i < inner(row0, k, rows, height)
    j_end = inner(col0, k, cols, width)
    j = 0
    while j < width:
        if inside and 0 < j < j_end:
            j = j_end
            continue
        if (i | j) & 1:
            errors[j] = round_up(_on_rim(fine, z, row0, col0, k, rows, cols, i, j, kind))
        j += 1


@inlined
def _off_middle(a, m, b):
    """Distance of a height m from the middle of a and b, rounded up; 0 if one is missing."""
    d = abs(m - 0.5 * (np.float64(a) + np.float64(b)))
    return round_up(d if d == d else 0.0)


@linked
def midpoints(z, row0, col0, k, rows, cols, kind, i, errors):
    """The local error of the diamonds of row i. MIDPOINT, WEDGIE and EXACT differ in squeezed diamonds only.

    Args:
        z: float32, the window's heights at the octave's spacing. rows, cols: of the raster.
        errors: float32, the result for the row; what is no diamond of this octave becomes 0 or stays.
    """
    height, width = z.shape
    j_end = inner(col0, k, cols, width)
    if 0 < i < inner(row0, k, rows, height):
        above, here, below = z[i - 1], z[i], z[i + 1]
        # All entries of the row, those that are no diamonds too: the compiler makes vectors of what is without gaps.
        if i & 1 == 0:
            for u in range(np.uint64(j_end - 1)):
                d = _off_middle(here[u], here[u + np.uint64(1)], here[u + np.uint64(2)])
                errors[u + np.uint64(1)] = np.float32(0.0) if u & np.uint64(1) else d
        else:
            for u in range(np.uint64(j_end - 1)):
                j, east = u + np.uint64(1), u + np.uint64(2)
                nw, north, ne = above[u], above[j], above[east]
                sw, south, se = below[u], below[j], below[east]
                falling = np.uint64(i >> 1) + (j >> np.uint64(1)) & np.uint64(1) == 0
                edge = u & np.uint64(1)
                a, b = nw if falling else ne, se if falling else sw
                errors[j] = _off_middle(north if edge else a, here[j], south if edge else b)
    _rim_row(z, z, row0, col0, k, rows, cols, kind, i, errors)


@kernel
def deviations(fine, z, row0, col0, k, rows, cols, errors):
    """The deviation of the samples inside every diamond of an octave (``deviation``).

    Args:
        fine: float32, the full-resolution samples of the window. z: its heights at the octave's spacing.
        errors: float32 with z's shape, the result; entries that are no diamonds of this octave are 0 or untouched.
    """
    if k == 0:  # the centre is the only sample inside
        for i in range(z.shape[0]):
            midpoints(z, row0, col0, k, rows, cols, EXACT, i, errors[i])
        return
    s = np.int64(1) << k
    height, width = z.shape
    i_end, j_end = inner(row0, k, rows, height), inner(col0, k, cols, width)
    for i in range(height):
        _rim_row(fine, z, row0, col0, k, rows, cols, EXACT, i, errors[i])
    for i in range(1, i_end):
        if i & 1 == 0:
            for j in range(1, j_end, 2):
                errors[i, j] = round_up(edge_across(fine, i * s, j * s, s))
            continue
        for j in range(2, j_end, 2):
            errors[i, j] = round_up(edge_along(fine, i * s, j * s, s))
        for j in range(1, j_end, 2):
            errors[i, j] = round_up(square(fine, i * s, j * s, s, (i >> 1) + (j >> 1) & 1 == 0))


@inlined
def _vertex(coarse, i, j, s, last_row, last_col):
    """Row, column and height of a squeezed vertex."""
    height = np.float64(coarse[min(i, coarse.shape[0] - 1), min(j, coarse.shape[1] - 1)])
    return min(i * s, last_row), min(j * s, last_col), height


@kernel
def overlap(z, row0, col0, coarse, k, rows, cols, i0, j0, raw):
    """The deviation of a block's samples from the coarse triangles of octave k's diamonds that overlap it.

    Args:
        z: the block, its first sample (row0, col0).
        coarse: the raster's heights at octave k's spacing.
        i0, j0: the entry that ``raw[0, 0]`` belongs to.
        raw: float32, the result.
    """
    s = np.int64(1) << k
    y = np.int64(rows - 1)
    x = np.int64(cols - 1)
    for di in range(raw.shape[0]):
        for dj in range(raw.shape[1]):
            i, j = i0 + di, j0 + dj
            if not (i | j) & 1:
                continue
            ai, aj, bi, bj, pi, pj, qi, qj = corners(i, j)
            worst = 0.0
            ay, ax, a = _vertex(coarse, ai, aj, s, y, x)
            by, bx, b = _vertex(coarse, bi, bj, s, y, x)
            if pi >= 0 and pj >= 0:
                py, px, p = _vertex(coarse, pi, pj, s, y, x)
                worst = max(worst, triangle(z, row0, col0, ay, ax, a, by, bx, b, py, px, p))
            if qi >= 0 and qj >= 0:
                qy, qx, q = _vertex(coarse, qi, qj, s, y, x)
                worst = max(worst, triangle(z, row0, col0, ay, ax, a, by, bx, b, qy, qx, q))
            raw[di, dj] = round_up(worst)
