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

RUN = 32
"""Entries of a row that are looked at together: what is whole all around is not gone through (an even number)."""


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


@kernel
def _dirty_samples(z, dirty):
    """Mark the runs of samples in which one is missing: ``dirty[i, 1 + j // RUN]``."""
    for i in range(z.shape[0]):
        row = z[i]
        for run in range(dirty.shape[1] - 2):
            begin = np.uint64(run * RUN)
            missing = 0
            for j in range(np.uint64(max(min(RUN, len(row) - run * RUN), 0))):
                missing += row[begin + j] != row[begin + j]
            dirty[i, run + 1] = missing > 0


@kernel
def _dirty_squares(below, dirty):
    """Mark the runs of square diamonds of which one is not WHOLE."""
    for i in range(below.shape[1]):
        one, two = below[0, i], below[1, i]
        for run in range(dirty.shape[1] - 2):
            begin = np.uint64(run * RUN)
            other = 0
            for j in range(np.uint64(max(min(RUN, len(one) - run * RUN), 0))):
                other |= (one[begin + j] ^ WHOLE) | (two[begin + j] ^ WHOLE)
            dirty[i, run + 1] = other > 0


@inlined
def _near(dirty, i, run):
    """Whether a run of row i or one of the runs beside it is dirty."""
    return dirty[i, run] | dirty[i, run + 1] | dirty[i, run + 2]


@inlined
def _sum(total):
    """The state of a unit triangle by the sum of its heights."""
    return WHOLE if total == total else HOLE


@inlined
def _finest_inside(z, i, across, begin, end, edges, found):
    """``states`` of the finest edge diamonds [begin, end) of row i, inside the window."""
    above, here, under = z[i - 1], z[i], z[i + 1]
    one, two, all_of_it = edges[i % 3, 0], edges[i % 3, 1], found[i]
    for u in range(np.uint64((end - begin + 1) >> 1)):
        j = np.uint64(begin) + np.uint64(2) * u
        m = here[j]
        north, south, west, east = m + above[j], m + under[j], here[j - np.uint64(1)], here[j + np.uint64(1)]
        nw, ne, sw, se = north + west, north + east, south + west, south + east
        upper_left = np.uint8(1 + (nw != nw))  # WHOLE or HOLE
        upper_right, lower_left = np.uint8(1 + (ne != ne)), np.uint8(1 + (sw != sw))
        lower_right = np.uint8(1 + (se != se))
        first = upper_left | (upper_right if across else lower_left)
        second = lower_right | (lower_left if across else upper_right)
        one[j], two[j], all_of_it[j] = first, second, first | second


@inlined
def _edges_inside(below, i, across, begin, end, edges, found):
    """``states`` of the edge diamonds [begin, end) of row i, inside the window, from the squares below them."""
    north, south = below[1, i - 1], below[0, i]
    one, two, all_of_it = edges[i % 3, 0], edges[i % 3, 1], found[i]
    for u in range(np.uint64((end - begin + 1) >> 1)):
        j = np.uint64(begin) + np.uint64(2) * u
        nw, ne, sw, se = north[j - np.uint64(1)], north[j], south[j - np.uint64(1)], south[j]
        first = nw | (ne if across else sw)
        second = se | (sw if across else ne)
        one[j], two[j], all_of_it[j] = first, second, first | second


@inlined
def _squares_inside(edges, i, begin, end, squares, found):
    """``states`` of the square diamonds [begin, end) of row i, inside the window, from the edges on their sides."""
    to_north, to_south = edges[(i - 1) % 3, 1], edges[(i + 1) % 3, 0]
    to_west, to_east = edges[i % 3, 1], edges[i % 3, 0]
    one, two, all_of_it = squares[0, i >> 1], squares[1, i >> 1], found[i]
    for u in range(np.uint64((end - begin + 1) >> 1)):
        j = np.uint64(begin) + np.uint64(2) * u
        falling = np.uint64(i >> 1) + (j >> np.uint64(1)) & np.uint64(1) == 0
        north, south, west, east = to_north[j], to_south[j], to_west[j - np.uint64(1)], to_east[j + np.uint64(1)]
        a, b, c, d = children_of_square(north, south, west, east, falling)
        one[j >> np.uint64(1)], two[j >> np.uint64(1)] = a | b, c | d
        all_of_it[j] = a | b | c | d


@kernel
def _squares(edges, i, first, done, squares, found):
    """``states`` of the square diamonds of row i from column ``first`` on, where a run nearby was looked at."""
    height, width = found.shape
    for run in range(first // RUN, done.shape[1] - 2):
        if not (_near(done, i, run) | done[i - 1, run + 1] | done[i + 1, run + 1]):
            continue
        begin, end = max(first, run * RUN + 1), min(run * RUN + RUN, width)
        if i + 1 < height and end < width:
            _squares_inside(edges, i, begin, end, squares, found)
            continue
        for j in range(begin, end, 2):
            south = edges[(i + 1) % 3, 0, j] if i + 1 < height else np.uint8(NONE)
            east = edges[i % 3, 0, j + 1] if j + 1 < width else np.uint8(NONE)
            falling = (i >> 1) + (j >> 1) & 1 == 0
            north, west = edges[(i - 1) % 3, 1, j], edges[i % 3, 1, j - 1]
            a, b, c, d = children_of_square(north, south, west, east, falling)
            squares[0, i >> 1, j >> 1] = a | b
            squares[1, i >> 1, j >> 1] = c | d
            found[i, j] = a | b | c | d


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
    runs = (width + RUN - 1) // RUN
    dirty = np.zeros((max(height, z.shape[0] if k == 0 else below.shape[1]) + 1, runs + 2), np.uint8)
    if k:
        _dirty_squares(below, dirty)
    else:
        _dirty_samples(z, dirty)
    edges = np.empty((3, 2, width), np.uint8)  # edge diamonds of rows i − 2, i − 1, i
    done = np.zeros((height + 1, runs + 2), np.uint8)  # runs whose edge diamonds were looked at
    for i in range(height):
        edges[i % 3] = WHOLE
        across = 1 - (i & 1)
        down = i & 1
        inside_row = 0 < i < height - 1
        first = across if i >= i_end else j_end + (j_end + across & 1)
        for run in range(first // RUN, runs):
            begin, end = run * RUN, min(run * RUN + RUN, width)
            if inside_row and begin > 0 and end < width:
                if _near(dirty, i - 1, run) | _near(dirty, i, run) | _near(dirty, i + 1, run):
                    done[i, run + 1] = 1
                    if k:
                        _edges_inside(below, i, across, max(first, begin + across), end, edges, found)
                    else:
                        _finest_inside(z, i, across, max(first, begin + across), end, edges, found)
                continue
            done[i, run + 1] = 1
            for j in range(max(first, begin + across), end, 2):
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
                edges[i % 3, 0, j] = one
                edges[i % 3, 1, j] = two
                found[i, j] = one | two
        if i and i & 1 == 0:
            _squares(edges, i - 1, 1 if i - 1 >= i_end else j_end | 1, done, squares, found)
    if height & 1 == 0:
        _squares(edges, height - 1, 1 if height - 1 >= i_end else j_end | 1, done, squares, found)
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
        row, e = found[i], errors[i]
        for begin in range(0, width, RUN):
            first, count = np.uint64(begin), np.uint64(min(RUN, width - begin))
            other = 0
            for j in range(count):
                other |= row[first + j] ^ WHOLE
            if other == 0:
                continue
            for j in range(begin, min(begin + RUN, width)):
                if row[j] == MIXED:
                    e[j] = np.inf
                elif row[j] != WHOLE:
                    e[j] = 0.0
