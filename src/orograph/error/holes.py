"""Where the surface has holes: whether the unit triangles under a diamond exist, none of them, or some.

A unit triangle (half a cell of the raster) with a missing corner is a hole. What a diamond's two triangles cover is
known from their children, as bits that are or-ed upwards; arrays are windows of an octave as in ``octaves``. A diamond
over existing triangles and holes is *mixed*: no bound of its error means anything until it is split. One over no
existing triangle is *empty*.

At the border of a raster that is not 2^n + 1 samples wide the squeeze moves a diamond's triangles off the ground that
their descendants cover. They stay within their boxes, though: those of a square diamond in its own region, half an edge
diamond in the region of the square on that side, whose state counts there as well.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf
from orograph.error.octaves import children_of_square, entry

NONE, WHOLE, HOLE, MIXED = 0, 1, 2, 3
"""Nothing (beyond the raster), existing triangles only, holes only, both."""


@leaf
def _unit(z, ai, aj, bi, bj, ci, cj):
    """The state of a unit triangle by its corners, which may lie beyond the window."""
    height, width = z.shape
    if min(ai, bi, ci) < 0 or min(aj, bj, cj) < 0 or max(ai, bi, ci) >= height or max(aj, bj, cj) >= width:
        return NONE
    total = z[ai, aj] + z[bi, bj] + z[ci, cj]
    return WHOLE if total == total else HOLE


@leaf
def _two_units(z, i, j, di, dj, pi, pj):
    """The state of half a finest edge diamond: the unit triangles of its centre, its apex (pi, pj) and either end."""
    return _unit(z, i, j, i - di, j - dj, pi, pj) | _unit(z, i, j, i + di, j + dj, pi, pj)


@inlined
def _sum(total):
    """The state of a unit triangle by the sum of its heights."""
    return WHOLE if total == total else HOLE


@kernel
def states(z, below, k, squares, found, i_end, j_end, squeezed_row, squeezed_col):
    """What octave k's diamonds cover.

    Args:
        z: the full-resolution window (used for k = 0).
        below: uint8 (2, height, width), ``squares`` of the octave below (nothing for k = 0).
        squares: uint8 (2, height // 2, width // 2), the result for the first and second triangles of square diamonds;
            entry [:, i >> 1, j >> 1] belongs to the diamond (i, j). WHOLE before.
        found: uint8 (height, width), the result for all diamonds. WHOLE before, and left so where there are none.
        i_end, j_end: diamonds i < i_end, j < j_end are known to be WHOLE (0 if nothing is known).
        squeezed_row, squeezed_col: whether the last row, column of entries lies beyond the raster's last samples.
    """
    height, width = found.shape
    edges = np.full((2, height, width), np.uint8(WHOLE))
    for i in range(height):
        across = 1 - (i & 1)
        down = i & 1
        inside_row = 0 < i < height - 1
        for j in range(across if i >= i_end else j_end + (j_end + across & 1), width, 2):
            inside = inside_row and 0 < j < width - 1
            if k and inside:
                nw, ne, sw, se = below[1, i - 1, j - 1], below[1, i - 1, j], below[0, i, j - 1], below[0, i, j]
            elif k:
                nw, ne = entry(below, 1, i - 1, j - 1), entry(below, 1, i - 1, j)
                sw, se = entry(below, 0, i, j - 1), entry(below, 0, i, j)
            if k:
                one = nw | (ne if across else sw)
                two = se | (sw if across else ne)
            elif inside:
                a, b = z[i, j] + z[i - down, j - across], z[i, j] + z[i + down, j + across]
                p, q = z[i - across, j - down], z[i + across, j + down]
                one = np.uint8(_sum(a + p) | _sum(b + p))
                two = np.uint8(_sum(a + q) | _sum(b + q))
            else:
                one = np.uint8(_two_units(z, i, j, down, across, i - across, j - down))
                two = np.uint8(_two_units(z, i, j, down, across, i + across, j + down))
            edges[0, i, j] = one
            edges[1, i, j] = two
            found[i, j] = one | two
    for i in range(1, height, 2):
        for j in range(1 if i >= i_end else j_end | 1, width, 2):
            inside = i + 1 < height and j + 1 < width
            south = edges[0, i + 1, j] if inside else entry(edges, 0, i + 1, j)
            east = edges[0, i, j + 1] if inside else entry(edges, 0, i, j + 1)
            falling = (i >> 1) + (j >> 1) & 1 == 0
            a, b, c, d = children_of_square(edges[1, i - 1, j], south, edges[1, i, j - 1], east, falling)
            squares[0, i >> 1, j >> 1] = a | b
            squares[1, i >> 1, j >> 1] = c | d
            found[i, j] = a | b | c | d
    if squeezed_row:
        for j in range(width):
            _add_squares(found, height - 1, j)
    if squeezed_col:
        for i in range(height):
            _add_squares(found, i, width - 1)


@leaf
def _add_squares(found, i, j):
    """Add the states of the squares on both sides of an edge diamond; does nothing to others."""
    if i + j & 1 == 0:
        return
    di, dj = 1 - (i & 1), 1 - (j & 1)
    if i >= di and j >= dj:
        found[i, j] |= found[i - di, j - dj]
    if i + di < found.shape[0] and j + dj < found.shape[1]:
        found[i, j] |= found[i + di, j + dj]


@kernel
def mark(found, errors):
    """Give mixed diamonds an infinite error and empty ones 0."""
    height, width = errors.shape
    for i in range(height):
        for j in range(width):
            if found[i, j] == MIXED:
                errors[i, j] = np.inf
            elif found[i, j] != WHOLE:
                errors[i, j] = 0.0
