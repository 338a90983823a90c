"""ROAM's nested sums of local errors (Duchaineau et al. 1997, sec. 6), row by row of an octave.

The sum of a triangle is its own local error plus the larger of its two children's sums; a diamond's ``wedgie`` is the
larger one of its two triangles, of which the upper or left one is called the first. Arrays are windows of an octave as
in ``octaves``; metres, rounded up to float32.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf, linked
from orograph.error.octaves import inner, round_up


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


@linked
def edge_sums(below, row0, col0, k, rows, cols, i, height, e, row):
    """The sums of the edge diamonds of row i.

    Args:
        below: float32 (2, height, width): the sums of the square diamonds of the octave below (nothing for k = 0), of
            their first triangles and of their second ones; entry [:, i >> 1, j >> 1] belongs to the diamond (i, j).
        row0, col0: the window's first sample. rows, cols: of the raster. height: rows of the window.
        e: float32 (width,), the row's local errors, which become the larger ones of the diamonds' two sums.
        row: float32 (2, width), the result.
    """
    s = np.int64(1) << k
    width = len(e)
    j_end = inner(col0, k, cols, width)
    inside = 0 < i < inner(row0, k, rows, height)
    first, second = row[0], row[1]
    odd = 1 - (i & 1)
    if k == 0:
        for x in range(width):
            first[x] = second[x] = e[x]
        return
    # All entries of the row, those that are no diamonds too: the compiler makes vectors of what is without gaps, and
    # of few arrays.
    begin, count = np.uint64(1), np.uint64(j_end - 1 if inside else 0)
    north, south = below[1, max(i - 1, 0)], below[0, min(i, below.shape[1] - 1)]
    for u in range(count):
        j = begin + u
        one, two = north[j], south[u]
        first[j] = round_up(np.float64(e[j]) + max(north[u], one if odd else two))
    for u in range(count):
        j = begin + u
        one, two = south[u], north[j]
        second[j] = round_up(np.float64(e[j]) + max(south[j], one if odd else two))
    for u in range(count):
        j = begin + u
        local, larger = e[j], max(first[j], second[j])
        e[j] = larger if j & np.uint64(1) == np.uint64(odd) else local
    x = odd
    while x < width:
        if inside and 0 < x < j_end:
            x = j_end + (j_end + odd & 1)
            continue
        nw, ne = entry(below, 1, i - 1, x - 1), entry(below, 1, i - 1, x)
        sw, se = entry(below, 0, i, x - 1), entry(below, 0, i, x)
        one = max(nw, ne if odd else sw)
        two = max(se, sw if odd else ne)
        if row0 + (i + 1) * s >= rows or col0 + (x + 1) * s >= cols:
            one = two = max(one, two)  # squeezed: children need not lie in their parent
        local = np.float64(e[x])
        first[x] = round_up(local + one)
        second[x] = round_up(local + two)
        e[x] = max(first[x], second[x])
        x += 2


@linked
def square_sums(row0, col0, k, rows, cols, i, north, here, south, sums, e, scratch):
    """The sums of the square diamonds of row i, from those of the edge diamonds on their sides.

    Args:
        north, here, south: ``row`` of ``edge_sums`` for the rows i − 1, i and i + 1.
        sums: float32 (2, height // 2, width // 2), where the result belongs, as ``below`` of the next octave.
        e: as there. scratch: float32 (2, width).
    """
    s = np.int64(1) << k
    width = len(e)
    one, two = sums[0, i >> 1], sums[1, i >> 1]
    to_north, to_south, to_west, to_east = north[1], south[0], here[1], here[0]
    parity = i >> 1
    inside = np.uint64((width - 1) >> 1)
    p, q = scratch[0], scratch[1]
    for u in range(np.uint64(2) * inside):  # as in ``edge_sums``
        j, east = u + np.uint64(1), u + np.uint64(2)
        a, b = to_east[east], to_west[u]
        side = a if np.uint64(parity) + (j >> np.uint64(1)) & np.uint64(1) == 0 else b
        larger = round_up(np.float64(e[j]) + max(to_north[j], side))
        p[u] = np.float32(0.0) if u & np.uint64(1) else larger
    for u in range(np.uint64(2) * inside):
        j, east = u + np.uint64(1), u + np.uint64(2)
        a, b = to_west[u], to_east[east]
        side = a if np.uint64(parity) + (j >> np.uint64(1)) & np.uint64(1) == 0 else b
        larger = round_up(np.float64(e[j]) + max(side, to_south[j]))
        q[u] = np.float32(0.0) if u & np.uint64(1) else larger
    for u in range(np.uint64(2) * inside):
        j = u + np.uint64(1)
        local, larger = e[j], max(p[u], q[u])
        e[j] = local if u & np.uint64(1) else larger
    for u in range(inside):
        j = np.uint64(2) * u
        one[u] = max(p[j], p[j + np.uint64(1)])
    for u in range(inside):
        j = np.uint64(2) * u
        two[u] = max(q[j], q[j + np.uint64(1)])
    if width & 1 == 0:  # the last one has no eastern neighbour
        x = width - 1
        y = x >> 1
        a, b, c, d = children_of_square(to_north[x], to_south[x], to_west[x - 1], np.float32(0), parity + y & 1 == 0)
        one[y] = round_up(np.float64(e[x]) + max(a, b))
        two[y] = round_up(np.float64(e[x]) + max(c, d))
        e[x] = max(one[y], two[y])
    squeezed = row0 + (i + 1) * s >= rows
    for y in range(0 if squeezed else inner(col0, k, cols, width) >> 1, width >> 1):
        if squeezed or col0 + (2 * y + 2) * s >= cols:
            one[y] = two[y] = e[2 * y + 1]  # children need not lie in their parent
