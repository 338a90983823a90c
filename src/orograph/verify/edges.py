"""The edges of a mesh: how many triangles share each, which belong to only one, and which of those overlap.

Edges are gathered by their lower vertex (a counting sort), so that only the few edges of a vertex are compared. An edge
with one triangle is *open*. If triangles do not overlap, the ground directly beyond an open edge is covered iff another
open edge lies on the same line, runs the other way and shares some of its length: a T-junction, or a seam between
vertices that should be one. This is decided with integers only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.verify.spans import GAPS

Ints = NDArray[np.int64]


@kernel
def survey(corners, turn):
    """(signs (m,) int8, used (n,) uint8).

    signs: 1 for triangles of correct orientation, −1 for reversed ones, 0 for those without area. used: 1 for vertices
    of triangles with area.
    """
    triangles, x, y = corners.triangles, corners.x, corners.y
    signs = np.empty(triangles.shape[0], np.int8)
    used = np.zeros(x.shape[0], np.uint8)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        area = ((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])) * turn
        signs[t] = 1 if area > 0 else (-1 if area < 0 else 0)
        if area != 0:
            used[a], used[b], used[c] = 1, 1, 1
    return signs, used


@leaf
def sort(values, begin, end):
    """Shellsort of ``values[begin:end]``; an insertion sort if there are only a few."""
    for k in range(0 if end - begin > 24 else len(GAPS) - 1, len(GAPS)):
        gap = GAPS[k]
        for i in range(begin + gap, end):
            value, j = values[i], i
            while j >= begin + gap and values[j - gap] > value:
                values[j] = values[j - gap]
                j -= gap
            values[j] = value


@kernel
def classify_edges(triangles, count):
    """Find edges with more than two triangles, and those with one.

    Returns:
        (crowded, open): indices 3·triangle + corner of an edge from that corner to the next; for crowded edges only the
        first.
    """
    m = triangles.shape[0]
    start = np.zeros(count + 1, np.int64)
    for t in range(m):
        for k in range(3):
            i, j = triangles[t, k], triangles[t, (k + 1) % 3]
            start[min(i, j) + 1] += 1
    for i in range(count):
        start[i + 1] += start[i]
    other = np.empty(3 * m, np.int64)
    fill = start.copy()
    for t in range(m):
        for k in range(3):
            i, j = triangles[t, k], triangles[t, (k + 1) % 3]
            low = min(i, j)
            other[fill[low]] = (np.int64(max(i, j)) << 32) | (3 * t + k)
            fill[low] += 1
    crowded, alone = np.empty(3 * m, np.int64), np.empty(3 * m, np.int64)
    n_crowded, n_alone = 0, 0
    for v in range(count):
        begin, end = start[v], start[v + 1]
        sort(other, begin, end)
        i = begin
        while i < end:
            j = i + 1
            while j < end and other[j] >> 32 == other[i] >> 32:
                j += 1
            if j - i == 1:
                alone[n_alone] = other[i] & 0xFFFFFFFF
                n_alone += 1
            elif j - i > 2:
                crowded[n_crowded] = other[i] & 0xFFFFFFFF
                n_crowded += 1
            i = j
    return crowded[:n_crowded].copy(), alone[:n_alone].copy()


def lie_on_others(edges: Ints) -> NDArray[np.bool_]:
    """Which of the edges (n, 4: column, row of beginning and end, in ticks) share length with an opposite one.

    Edges are sorted by line: primitive direction and offset from the origin; along a line they are intervals of the
    integer parameter p = position · direction. An interval [p, q] meets one of the opposite set iff among those that
    begin before q the farthest end lies beyond p.
    """
    meets = np.zeros(len(edges), bool)
    if len(edges) == 0:
        return meets
    dx, dy = edges[:, 2] - edges[:, 0], edges[:, 3] - edges[:, 1]
    forward = (dx > 0) | ((dx == 0) & (dy > 0))
    sign = np.where(forward, 1, -1)
    length = np.gcd(dx, dy)
    ux, uy = sign * dx // length, sign * dy // length
    offset = edges[:, 0] * uy - edges[:, 1] * ux
    _, line = np.unique(np.stack([ux, uy, offset], -1), axis=0, return_inverse=True)
    line = line.reshape(-1)
    p, q = (edges[:, 0] * ux + edges[:, 1] * uy), (edges[:, 2] * ux + edges[:, 3] * uy)
    low, high = np.minimum(p, q), np.maximum(p, q)
    for mine, theirs in ((forward, ~forward), (~forward, forward)):
        them = np.flatnonzero(theirs)
        me = np.flatnonzero(mine)
        if len(them) == 0 or len(me) == 0:
            continue
        them = them[np.lexsort((low[them], line[them]))]
        # One order over all lines: parameters are shifted so that lines do not overlap. Ranks keep the numbers small.
        values = np.unique(np.concatenate([low, high]))
        span = len(values) + 1
        begins = line[them] * span + np.searchsorted(values, low[them])
        ends = np.maximum.accumulate(line[them] * span + np.searchsorted(values, high[them]))
        before = np.searchsorted(begins, line[me] * span + np.searchsorted(values, high[me]), "left") - 1
        farthest = np.where(before >= 0, ends[np.maximum(before, 0)], -1)
        meets[me] = farthest > line[me] * span + np.searchsorted(values, low[me])
    return meets
