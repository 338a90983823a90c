"""Monotony: a diamond's error is no less than those of its children, which may belong to two parents each.

``close`` makes errors so that are there; ``ascend`` makes local errors or sums, marks what covers holes and closes them
in one pass over an octave, so that a row's entries stay in the processor's cache. Arrays are windows of an octave as in
``octaves``; metres, float32.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf, linked
from orograph.error.holes import mark_row
from orograph.error.octaves import WEDGIE, midpoints
from orograph.error.wedgies import edge_sums, square_sums


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


@linked
def _close_edges(below, i, e, scratch):
    """Close the edge diamonds of row i; ``scratch``: float32 (3, width of ``below``)."""
    width = len(e)
    y = 2 * i
    j_end = (below.shape[1] - 1) >> 1  # to where all children of a row's diamonds are there
    inside = i > 0 and y + 1 < below.shape[0]
    odd = 1 - (i & 1)
    if inside:
        above, under = below[y - 1], below[y + 1]
        both, children = scratch[0], scratch[1]
        # All entries of the row, those that are no diamonds too: the compiler makes vectors of what is without gaps.
        for x in range(np.uint64(2 * j_end)):
            larger = max(above[x], under[x])
            both[x] = larger if x & np.uint64(1) else np.float32(0.0)
        for u in range(np.uint64(j_end)):
            children[u] = max(both[np.uint64(2) * u], both[np.uint64(2) * u + np.uint64(1)])
        for u in range(np.uint64(max(j_end - 1, 0))):
            j = u + np.uint64(1)
            own = e[j]
            largest = max(own, max(children[u], children[j]))
            e[j] = largest if j & np.uint64(1) == np.uint64(odd) else own
    at = odd
    while at < width:
        if inside and 0 < at < j_end:
            at = j_end + (j_end + odd & 1)
            continue
        column = 2 * at
        nw, ne = value(below, y - 1, column - 1), value(below, y - 1, column + 1)
        sw, se = value(below, y + 1, column - 1), value(below, y + 1, column + 1)
        e[at] = _largest(e[at], nw, ne, sw, se)
        at += 2


@linked
def _close_squares(errors, i, scratch):
    """Close the square diamonds of row i, whose edge diamonds are closed."""
    height, width = errors.shape
    e, above = errors[i], errors[i - 1]
    below = errors[i + 1] if i + 1 < height else above
    edges = scratch[2]
    for u in range(np.uint64(max(width - 2, 0))):
        j, east = u + np.uint64(1), u + np.uint64(2)
        edges[u] = max(max(above[j], below[j]), max(e[u], e[east]))
    for u in range(np.uint64(max(width - 2, 0))):
        j = u + np.uint64(1)
        own = e[j]
        largest = max(own, edges[u])
        e[j] = own if u & np.uint64(1) else largest
    if width & 1 == 0:
        last = width - 1
        e[last] = _largest(e[last], above[last], below[last], e[last - 1], e[last - 1])


@kernel
def close(below, k, errors):
    """Make errors monotonic: each no less than its children's.

    Args:
        below: float32, the closed errors of the octave below, in a window that begins at the same sample.
        errors: float32 (height, width), changed in place.
    """
    height, width = errors.shape
    scratch = np.empty((3, max(width, below.shape[1])), np.float32)
    for i in range(height):
        if k:
            _close_edges(below, i, errors[i], scratch)
        if i & 1 == 0 and i:
            _close_squares(errors, i - 1, scratch)
    if height & 1 == 0:
        _close_squares(errors, height - 1, scratch)


@kernel
def ascend(z, at, kind, sums_below, below, found, seen, sums, errors):
    """Everything about an octave's MIDPOINT or WEDGIE errors.

    Args:
        z, at (row0, col0, k, rows, cols), kind: as for ``octaves.midpoints``.
        sums_below, sums: as for ``wedgies`` (nothing for MIDPOINT).
        below: float32, the closed errors of the octave below.
        found, seen: of ``holes.states``; without entries if all is whole.
        errors: float32 with z's shape, 0 before: the result.
    """
    row0, col0, k, rows, cols = at
    height, width = errors.shape
    with_holes = len(found) > 0
    scratch = np.empty((3, max(width, below.shape[1])), np.float32)
    recent = np.zeros((3, 2, width if kind == WEDGIE else 0), np.float32)  # edge diamonds of rows i − 2, i − 1, i
    for i in range(height + 1):
        if i < height:
            e = errors[i]
            midpoints(z, row0, col0, k, rows, cols, kind, i, e)
            if kind == WEDGIE:
                edge_sums(sums_below, row0, col0, k, rows, cols, i, height, e, recent[i % 3])
            if with_holes:
                mark_row(found[i], seen[i], 1 - (i & 1), e)
            if k:
                _close_edges(below, i, e, scratch)
        elif kind == WEDGIE:
            recent[i % 3] = 0
        if i and i & 1 == 0:
            row = i - 1
            if kind == WEDGIE:
                north, here, south = recent[(i - 2) % 3], recent[row % 3], recent[i % 3]
                square_sums(row0, col0, k, rows, cols, row, north, here, south, sums, errors[row], scratch)
            if with_holes:
                mark_row(found[row], seen[row], 1, errors[row])
            _close_squares(errors, row, scratch)
