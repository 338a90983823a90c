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
* ``wedgie``: the nested sum of Duchaineau et al. 1997, sec. 6: of each top triangle, its own local error plus the
  larger of its two children's sums; a diamond has the larger of its two triangles'.
* ``exact``: the largest deviation of any full-resolution sample (``deviation``).

All are then made monotonic: no less than the children's (``close``). Heights and errors in metres; arithmetic in
float64; results are rounded up to float32.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf
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
    d = split_distance(ay, ax, a, by, bx, b, py, px, p, qy, qx, q, my, mx, m, kind == MIDPOINT)
    return d if d == d else 0.0


@kernel
def _rim_errors(fine, z, row0, col0, k, rows, cols, kind, errors):
    """``local_errors`` on the rim."""
    height, width = z.shape
    i_end, j_end = inner(row0, k, rows, height), inner(col0, k, cols, width)
    for i in range(height):
        all_of_them = i == 0 or i >= i_end
        for j in range(width):
            if not all_of_them and 0 < j < j_end:
                continue
            if (i | j) & 1:
                errors[i, j] = round_up(_on_rim(fine, z, row0, col0, k, rows, cols, i, j, kind))


@inlined
def _off_middle(a, m, b):
    """Distance of a height m from the middle of a and b, rounded up; 0 if one is missing."""
    d = abs(m - 0.5 * (np.float64(a) + np.float64(b)))
    return round_up(d if d == d else 0.0)


@kernel
def midpoints(z, row0, col0, k, rows, cols, kind, errors):
    """The local error of every diamond of an octave. MIDPOINT, WEDGIE and EXACT differ in squeezed diamonds only.

    Args:
        z: float32, the window's heights at the octave's spacing. rows, cols: of the raster.
        errors: the result, float32 with z's shape; entries that are no diamonds of this octave are not touched.
    """
    height, width = z.shape
    i_end, j_end = inner(row0, k, rows, height), inner(col0, k, cols, width)
    for i in range(1, i_end):
        above, here, below, e = z[i - 1], z[i], z[i + 1], errors[i]
        # Two neighbours at a time, the unused entries too: stores without gaps are what the compiler makes vectors of.
        for u in range(j_end >> 1):
            j = 2 * u + 1
            if i & 1 == 0:
                e[j] = _off_middle(here[j - 1], here[j], here[j + 1])
                e[j + 1] = 0.0
            else:
                falling = (i >> 1) + u & 1 == 0
                nw, ne, sw, se = above[j - 1], above[j + 1], below[j - 1], below[j + 1]
                e[j] = _off_middle(nw if falling else ne, here[j], se if falling else sw)
                e[j + 1] = _off_middle(ne, here[j + 1], se)
    _rim_errors(z, z, row0, col0, k, rows, cols, kind, errors)


@kernel
def deviations(fine, z, row0, col0, k, rows, cols, errors):
    """The deviation of the samples inside every diamond of an octave (``deviation``).

    Args:
        fine: float32, the full-resolution samples of the window. z: its heights at the octave's spacing.
        errors: as in ``midpoints``.
    """
    if k == 0:  # the centre is the only sample inside
        midpoints(z, row0, col0, k, rows, cols, EXACT, errors)
        return
    s = np.int64(1) << k
    height, width = z.shape
    i_end, j_end = inner(row0, k, rows, height), inner(col0, k, cols, width)
    _rim_errors(fine, z, row0, col0, k, rows, cols, EXACT, errors)
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


# ---- ROAM's nested sums: one for each of a diamond's two triangles, first the upper or left one ----------------------


@inlined
def children_of_square(north, south, west, east, falling):
    """The values of a square diamond's four children (two halves each), as they belong to its first, second triangle.

    Args:
        north, south, west, east: the value of that half of the child on this side which lies within the square.
    """
    a = east if falling else west
    b = west if falling else east
    return north, a, b, south


@leaf
def entry(values, which, i, j):
    """An entry of an array of halves (2, height, width); 0 beyond it."""
    if i < 0 or j < 0 or i >= values.shape[1] or j >= values.shape[2]:
        return values.dtype.type(0)
    return values[which, i, j]


@kernel
def _edge_sums(below, row0, col0, k, rows, cols, i, errors, row):
    """The sums of the edge diamonds of row i, into ``row`` (2, width); ``errors`` become the larger ones."""
    s = np.int64(1) << k
    height, width = errors.shape
    j_end = inner(col0, k, cols, width)
    inside = 0 < i < inner(row0, k, rows, height)
    first, second, e = row[0], row[1], errors[i]
    odd = 1 - (i & 1)
    if k == 0:
        for j in range(width):
            first[j] = second[j] = e[j]
        return
    for j in range(odd, width, 2):
        if inside and 0 < j < j_end:
            nw, ne, sw, se = below[1, i - 1, j - 1], below[1, i - 1, j], below[0, i, j - 1], below[0, i, j]
        else:
            nw, ne = entry(below, 1, i - 1, j - 1), entry(below, 1, i - 1, j)
            sw, se = entry(below, 0, i, j - 1), entry(below, 0, i, j)
        one = max(nw, ne if odd else sw)
        two = max(se, sw if odd else ne)
        if row0 + (i + 1) * s >= rows or col0 + (j + 1) * s >= cols:
            one = two = max(one, two)  # squeezed: children need not lie in their parent
        local = np.float64(e[j])
        first[j] = round_up(local + one)
        second[j] = round_up(local + two)
        e[j] = max(first[j], second[j])


@kernel
def _square_sums(row0, col0, k, rows, cols, i, north, here, south, sums, errors):
    """The sums of the square diamonds of row i, from those of the edge diamonds on their sides."""
    s = np.int64(1) << k
    width = errors.shape[1]
    one, two, e = sums[0, i >> 1], sums[1, i >> 1], errors[i]
    to_north, to_south, to_west, to_east = north[1], south[0], here[1], here[0]
    parity = i >> 1
    for u in range((width - 1) >> 1):
        j = 2 * u + 1
        falling = parity + u & 1 == 0
        a, b, c, d = children_of_square(to_north[j], to_south[j], to_west[j - 1], to_east[j + 1], falling)
        local = np.float64(e[j])
        first, second = round_up(local + max(a, b)), round_up(local + max(c, d))
        one[u] = first
        two[u] = second
        e[j] = max(first, second)
    if width & 1 == 0:  # the last one has no eastern neighbour
        j = width - 1
        u = j >> 1
        a, b, c, d = children_of_square(to_north[j], to_south[j], to_west[j - 1], np.float32(0), parity + u & 1 == 0)
        one[u] = round_up(np.float64(e[j]) + max(a, b))
        two[u] = round_up(np.float64(e[j]) + max(c, d))
        e[j] = max(one[u], two[u])
    squeezed = row0 + (i + 1) * s >= rows
    for u in range(0 if squeezed else inner(col0, k, cols, width) >> 1, width >> 1):
        if squeezed or col0 + (2 * u + 2) * s >= cols:
            one[u] = two[u] = e[2 * u + 1]  # children need not lie in their parent


@kernel
def wedgie_sums(below, row0, col0, k, rows, cols, sums, errors):
    """ROAM's nested sums of the diamonds of octave k.

    Args:
        below: float32 (2, height, width): the sums of the square diamonds of the octave below (nothing for k = 0).
        row0, col0: the window's first sample. rows, cols: of the raster.
        sums: float32 (2, height // 2, width // 2), the result for this octave's square diamonds: of their first
            triangles and of their second ones. Entry [:, i >> 1, j >> 1] belongs to the diamond (i, j).
        errors: float32 (height, width); in: local errors; out: the larger of a diamond's two sums.
    """
    height, width = errors.shape
    recent = np.zeros((3, 2, width), np.float32)  # edge diamonds of rows i − 2, i − 1, i
    for i in range(height + 1):
        if i < height:
            _edge_sums(below, row0, col0, k, rows, cols, i, errors, recent[i % 3])
        else:
            recent[i % 3] = 0
        if i and i & 1 == 0:
            north, here, south = recent[(i - 2) % 3], recent[(i - 1) % 3], recent[i % 3]
            _square_sums(row0, col0, k, rows, cols, i - 1, north, here, south, sums, errors)


# ---- monotony -------------------------------------------------------------------------------------------------------


@inlined
def _largest(e, a, b, c, d):
    """The largest of five errors."""
    return max(e, max(max(a, b), max(c, d)))


@leaf
def value(values, i, j):
    """An entry of a window, 0 beyond it."""
    if i < 0 or j < 0 or i >= values.shape[0] or j >= values.shape[1]:
        return values.dtype.type(0)
    return values[i, j]


@kernel
def close(below, k, errors):
    """Make errors monotonic: each no less than its children's.

    Args:
        below: float32, the closed errors of the octave below, in a window that begins at the same sample.
        errors: float32 (height, width), changed in place.
    """
    height, width = errors.shape
    if k:
        for i in range(height):
            inside = i > 0 and 2 * i + 1 < below.shape[0]
            for j in range(1 - (i & 1), width, 2):
                y = 2 * i
                x = 2 * j
                if inside and j > 0 and x + 1 < below.shape[1]:
                    nw, ne, sw, se = below[y - 1, x - 1], below[y - 1, x + 1], below[y + 1, x - 1], below[y + 1, x + 1]
                else:
                    nw, ne = value(below, y - 1, x - 1), value(below, y - 1, x + 1)
                    sw, se = value(below, y + 1, x - 1), value(below, y + 1, x + 1)
                errors[i, j] = _largest(errors[i, j], nw, ne, sw, se)
    for i in range(1, height, 2):
        for j in range(1, width, 2):
            if i + 1 < height and j + 1 < width:
                north, south, west, east = errors[i - 1, j], errors[i + 1, j], errors[i, j - 1], errors[i, j + 1]
            else:
                north, south = errors[i - 1, j], value(errors, i + 1, j)
                west, east = errors[i, j - 1], value(errors, i, j + 1)
            errors[i, j] = _largest(errors[i, j], north, south, west, east)
