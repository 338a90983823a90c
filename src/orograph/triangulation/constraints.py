"""Edges that a triangulation must have: found, forced by flips, and fixed.

Sloan 1993, *A fast algorithm for generating constrained Delaunay triangulations*.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf, linked
from orograph.triangulation.mesh import TRIANGLES, after, before, flip, turn_of


@leaf
def edge_between(m, a, b):
    """The half-edge a → b, or its twin's if only that exists; −1 if the two vertices share no edge."""
    first = m.out[a]
    h = first
    while True:  # counter-clockwise
        if m.corner[after(h)] == b:
            return h
        back = before(h)
        if m.corner[back] == b:
            return back
        h = m.twin[back]
        if h == first or h < 0:
            break
    h = first
    while h >= 0:  # clockwise, for vertices of the outline
        g = m.twin[h]
        if g < 0:
            return -1
        h = after(g)
        if m.corner[after(h)] == b:
            return h
        if h == first:
            return -1
    return -1


@leaf
def first_crossed(m, a, b):
    """The half-edge opposite to vertex a which the segment a–b crosses; −1 if there is none."""
    h = m.out[a]
    while m.twin[h] >= 0:  # to the outline, or once around
        h = after(m.twin[h])
        if h == m.out[a]:
            break
    first = h
    while h >= 0:
        p, q = m.corner[after(h)], m.corner[before(h)]
        if turn_of(m, a, b, p) < 0 and turn_of(m, a, b, q) > 0 and turn_of(m, a, p, q) > 0:
            ahead = (m.x[b] - m.x[a]) * np.int64(m.x[p] + m.x[q] - 2 * m.x[a]) + (m.y[b] - m.y[a]) * np.int64(
                m.y[p] + m.y[q] - 2 * m.y[a]
            )
            if ahead > 0 or turn_of(m, p, q, b) < 0:
                return after(h)
        h = m.twin[before(h)]
        if h == first:
            break
    return -1


@linked
def fix_edge(m, a, b):
    """Make a–b an edge and fix it; no vertex may lie between. Returns False if another fixed edge is in the way."""
    h = edge_between(m, a, b)
    if h < 0:
        crossed = np.empty((m.counts[TRIANGLES], 2), np.int32)
        count = 0
        h = first_crossed(m, a, b)
        while h >= 0 and m.corner[before(m.twin[h])] != b:
            crossed[count, 0], crossed[count, 1] = m.corner[h], m.corner[after(h)]
            count += 1
            g = m.twin[h]
            apex = m.corner[before(g)]
            h = after(g) if turn_of(m, a, b, apex) > 0 else before(g)
            if turn_of(m, a, b, m.corner[h]) == 0 or turn_of(m, a, b, m.corner[after(h)]) == 0:
                return False
        if h < 0:
            return False
        crossed[count, 0], crossed[count, 1] = m.corner[h], m.corner[after(h)]
        if not force_edge(m, a, b, crossed, count + 1):
            return False
        h = edge_between(m, a, b)
    m.fixed[h] = 1
    if m.twin[h] >= 0:
        m.fixed[m.twin[h]] = 1
    return True


@linked
def force_edge(m, a, b, crossed, count):
    """Flip the edges that cross a–b until none does (Sloan 1993, §3)."""
    head, room = 0, len(crossed)
    for _ in range(1 + 64 * count * count):
        if count == 0:
            return True
        p, q = crossed[head % room, 0], crossed[head % room, 1]
        head, count = head + 1, count - 1
        h = edge_between(m, p, q)
        if m.fixed[h]:
            return False
        c, d = m.corner[before(h)], m.corner[before(m.twin[h])]
        p, q = m.corner[h], m.corner[after(h)]
        convex = turn_of(m, c, d, q) * turn_of(m, c, d, p) < 0 and turn_of(m, p, d, c) > 0 and turn_of(m, d, q, c) > 0
        if convex:
            flip(m, h)
            p, q = c, d
            across = turn_of(m, a, b, c) * turn_of(m, a, b, d) < 0 and turn_of(m, c, d, a) * turn_of(m, c, d, b) < 0
            if not across:
                continue
        crossed[(head + count) % room, 0], crossed[(head + count) % room, 1] = p, q
        count += 1
    return False
