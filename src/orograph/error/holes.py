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

from orograph._numba import inlined, kernel, leaf, linked
from orograph.error.wedgies import children_of_square, entry

NONE, WHOLE, HOLE, MIXED = 0, 1, 2, 3
"""Nothing (beyond the raster), existing triangles only, holes only, both."""

RUN = 32
"""Entries of a row, an even number, that are looked at together: where all around them is whole, not at all."""


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


@linked
def _dirty_samples(z, dirty):
    """Mark the runs of samples in which one is missing: ``dirty[i + 1, j // RUN + 1]``."""
    for i in range(z.shape[0]):
        row = z[i]
        for run in range(dirty.shape[1] - 2):
            begin = np.uint64(run * RUN)
            missing = 0
            for j in range(np.uint64(max(min(RUN, len(row) - run * RUN), 0))):
                missing += row[begin + j] != row[begin + j]
            dirty[i + 1, run + 1] = missing > 0


@linked
def _dirty_squares(below, dirty):
    """Mark the runs of square diamonds of which one is not WHOLE."""
    for i in range(below.shape[1]):
        one, two = below[0, i], below[1, i]
        for run in range(dirty.shape[1] - 2):
            begin = np.uint64(run * RUN)
            other = 0
            for j in range(np.uint64(max(min(RUN, len(one) - run * RUN), 0))):
                other |= (one[begin + j] ^ WHOLE) | (two[begin + j] ^ WHOLE)
            dirty[i + 1, run + 1] = other > 0


@inlined
def _near(above, here, under, found):
    """``found[run + 1]``: whether a run or one beside it is marked in one of three rows."""
    for run in range(np.uint64(len(found) - 2)):
        middle, right = run + np.uint64(1), run + np.uint64(2)
        west, east = above[run] | here[run] | under[run], above[right] | here[right] | under[right]
        found[middle] = west | above[middle] | here[middle] | under[middle] | east


@leaf
def _next(seen, begin):
    """The next columns [begin, end) in runs to be ``seen``, from a column on; nothing if end ≤ begin."""
    run = begin // RUN
    while run < len(seen) - 2 and not seen[run + 1]:
        run += 1
    end = run
    while end < len(seen) - 2 and seen[end + 1]:
        end += 1
    return max(begin, run * RUN), end * RUN


@leaf
def _any_edge(z, below, k, i, j):
    """The states of the halves of any edge diamond of the window."""
    across, down = 1 - (i & 1), i & 1
    if k == 0:
        one = _two_units(z, i, j, down, across, i - across, j - down)
        two = _two_units(z, i, j, down, across, i + across, j + down)
        return np.uint8(one), np.uint8(two)
    nw, ne = entry(below, 1, i - 1, j - 1), entry(below, 1, i - 1, j)
    sw, se = entry(below, 0, i, j - 1), entry(below, 0, i, j)
    return nw | (ne if across else sw), se | (sw if across else ne)


# Within a run all entries are gone through, those that are no diamonds too: the compiler makes vectors of what is
# without gaps.


@leaf
def _finest_inside(above, here, under, across, begin, end, one, two, found):
    """``states`` of the finest edge diamonds in [begin, end) of a row, inside the window, by the samples around."""
    for u in range(np.uint64(max(end - begin, 0))):
        j = np.uint64(begin) + u
        m, before, after, own = here[j], here[j - np.uint64(1)], here[j + np.uint64(1)], found[j]
        north, south = m + above[j], m + under[j]
        nw, ne, sw, se = north + before, north + after, south + before, south + after
        upper_left, upper_right = np.uint8(1 + (nw != nw)), np.uint8(1 + (ne != ne))  # WHOLE or HOLE
        lower_left, lower_right = np.uint8(1 + (sw != sw)), np.uint8(1 + (se != se))
        first = upper_left | (upper_right if across else lower_left)
        second = lower_right | (lower_left if across else upper_right)
        one[j], two[j] = first, second
        found[j] = first | second if j & np.uint64(1) == np.uint64(across) else own


@leaf
def _edges_inside(north, south, across, begin, end, one, two, found):
    """``states`` of the edge diamonds in [begin, end) of a row, inside the window, from the squares below them."""
    for u in range(np.uint64(max(end - begin, 0))):
        j = np.uint64(begin) + u
        nw, ne, sw, se, own = north[j - np.uint64(1)], north[j], south[j - np.uint64(1)], south[j], found[j]
        first = nw | (ne if across else sw)
        second = se | (sw if across else ne)
        one[j], two[j] = first, second
        found[j] = first | second if j & np.uint64(1) == np.uint64(across) else own


@leaf
def _squares_inside(to_north, to_south, to_west, to_east, parity, begin, end, scratch, one, two, found):
    """``states`` of the square diamonds in [begin, end) of a row, inside the window, from the edges on their sides.

    Args:
        begin: odd. end: even.
        parity: of half the row's number.
        scratch: uint8 (2, > end − begin), odd entries 0.
    """
    first_row, second_row = scratch[0], scratch[1]
    for u in range(np.uint64(max(end - begin, 0))):
        j = np.uint64(begin) + u
        falling = np.uint64(parity) + (j >> np.uint64(1)) & np.uint64(1) == 0
        north, south, west, east = to_north[j], to_south[j], to_west[j - np.uint64(1)], to_east[j + np.uint64(1)]
        own = found[j]
        a, b, c, d = children_of_square(north, south, west, east, falling)
        first, second = a | b, c | d
        square = u & np.uint64(1) == 0
        first_row[u] = first if square else np.uint8(0)
        second_row[u] = second if square else np.uint8(0)
        found[j] = first | second if square else own
    for u in range(np.uint64(max(end - begin + 1, 0) >> 1)):
        j, at = np.uint64(2) * u, np.uint64(begin >> 1) + u
        one[at] = first_row[j] | first_row[j + np.uint64(1)]
        two[at] = second_row[j] | second_row[j + np.uint64(1)]


@linked
def _edges(z, below, k, i, first, seen, edges, found):
    """``states`` of the edge diamonds of row i from column ``first`` on, in the runs to be ``seen`` and on the rim."""
    height, width = found.shape
    across = 1 - (i & 1)
    inside = 0 < i < height - 1
    first += first + across & 1  # an edge diamond's column
    if not inside:
        seen[first // RUN + 1 : -1] = 1
    one, two, all_of_it = edges[i % 3, 0], edges[i % 3, 1], found[i]
    if inside and k:
        north, south = below[1, i - 1], below[0, i]
        begin, end = _next(seen, first)
        while begin < end:
            _edges_inside(north, south, across, max(begin, 1), min(end, width - 1), one, two, all_of_it)
            begin, end = _next(seen, end)
    elif inside:
        above, here, under = z[i - 1], z[i], z[i + 1]
        begin, end = _next(seen, first)
        while begin < end:
            _finest_inside(above, here, under, across, max(begin, 1), min(end, width - 1), one, two, all_of_it)
            begin, end = _next(seen, end)
    last = width - 1 - (width - 1 + across & 1)
    if inside and first > 0:
        first = max(first, last)
    for j in range(first, width, max(last, 1) if inside else 2):
        first_half, second_half = _any_edge(z, below, k, i, j)
        one[j], two[j], all_of_it[j] = first_half, second_half, first_half | second_half
        seen[j // RUN + 1] = 1


@linked
def _squares(edges, i, first, seen, scratch, squares, found):
    """``states`` of the square diamonds of row i from column ``first`` on, in the runs to be ``seen``."""
    height, width = found.shape
    inside = i + 1 < height
    to_north, to_south = edges[(i - 1) % 3, 1], edges[(i + 1) % 3, 0]
    to_west, to_east, all_of_it = edges[i % 3, 1], edges[i % 3, 0], found[i]
    one, two = squares[0, i >> 1], squares[1, i >> 1]
    begin, end = _next(seen, first)
    while begin < end:
        j, last = begin | 1, min(end, width - 1)
        if inside:
            _squares_inside(to_north, to_south, to_west, to_east, i >> 1, j, last, scratch, one, two, all_of_it)
            j = max(j, width - 1 | 1)
        while j < min(end, width):
            south = to_south[j] if inside else np.uint8(NONE)
            east = to_east[j + 1] if j + 1 < width else np.uint8(NONE)
            falling = (i >> 1) + (j >> 1) & 1 == 0
            a, b, c, d = children_of_square(to_north[j], south, to_west[j - 1], east, falling)
            one[j >> 1], two[j >> 1], all_of_it[j] = a | b, c | d, a | b | c | d
            j += 2
        begin, end = _next(seen, end)


@kernel
def states(z, below, k, squares, found, seen, i_end, j_end, squeezed_row, squeezed_col):
    """What octave k's diamonds cover.

    Args:
        z: the full-resolution window (used for k = 0).
        below: uint8 (2, height, width), ``squares`` of the octave below (nothing for k = 0).
        squares: uint8 (2, height // 2, width // 2), the result for the first and second triangles of square diamonds;
            entry [:, i >> 1, j >> 1] belongs to the diamond (i, j). WHOLE before.
        found: uint8 (height, width), the result for all diamonds. WHOLE before, and left so where there are none.
        seen: uint8 (height, ⌈width / RUN⌉ + 2), 0 before; becomes 1 at [i, 1 + j // RUN] where anything else may be.
        i_end, j_end: diamonds i < i_end, j < j_end are known to be WHOLE (0 if nothing is known).
        squeezed_row, squeezed_col: whether the last row, column of entries lies beyond the raster's last samples.
    """
    height, width = found.shape
    dirty = np.zeros((max(height, z.shape[0] if k == 0 else below.shape[1]) + 2, seen.shape[1]), np.uint8)
    if k:
        _dirty_squares(below, dirty)
    else:
        _dirty_samples(z, dirty)
    edges = np.empty((3, 2, width), np.uint8)  # edge diamonds of rows i − 2, i − 1, i
    near, scratch = np.empty(seen.shape[1], np.uint8), np.zeros((2, width + 1), np.uint8)
    for i in range(0 if j_end < width else max(i_end - 1, 0), height):  # what is known before is not even gone through
        one, two = edges[i % 3, 0], edges[i % 3, 1]
        for j in range(np.uint64(width)):
            one[j] = WHOLE
            two[j] = WHOLE
        _near(dirty[i], dirty[i + 1], dirty[i + 2], seen[i])
        _edges(z, below, k, i, 0 if i >= i_end else j_end, seen[i], edges, found)
        if i & 1 and i + 1 < height:
            continue
        row = i - 1 + (i & 1)  # the square diamonds whose edge diamonds are all known now
        if row > 0:
            here = seen[row]
            _near(seen[row - 1], here, seen[min(row + 1, height - 1)], near)
            for run in range(np.uint64(1), np.uint64(len(near) - 1)):
                here[run] = near[run]
            _squares(edges, row, 1 if row >= i_end else j_end | 1, here, scratch, squares, found)
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


@linked
def mark_row(found, seen, first, e):
    """Give mixed diamonds of a row an infinite error and empty ones 0.

    Args:
        found, seen: the row's, of ``states``.
        first: 0 for the diamonds in even columns, 1 for those in odd ones.
        e: float32, the row's errors.
    """
    for run in range(len(seen) - 2):
        if seen[run + 1]:
            begin, end = np.uint64(run * RUN), np.uint64(min(run * RUN + RUN, len(e)))
            for u in range(end - begin):
                j = begin + u
                own, state = e[j], found[j]
                other = np.float32(np.inf) if state == MIXED else np.float32(0.0)
                e[j] = own if state == WHOLE or j & np.uint64(1) != np.uint64(first) else other


@kernel
def mark(found, seen, errors):
    """``mark_row`` for all diamonds of a window."""
    for i in range(len(found)):
        mark_row(found[i], seen[i], 0, errors[i])
        mark_row(found[i], seen[i], 1, errors[i])
