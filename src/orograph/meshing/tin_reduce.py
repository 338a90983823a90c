"""Removal of unnecessary vertices from a TIN: those whose hole can be triangulated within the bound.

Greedy insertion leaves vertices that later ones made superfluous, and Delaunay triangles that do not follow the ground.
For a vertex with d neighbours, all triangulations of the polygon around it are compared by dynamic programming over its
sides (Klincsek 1980, *Minimal triangulations of polygonal domains*): only triangles and diagonals within the bound
count, and the triangulation with the smallest sum of squared deviations is used, a data-dependent one (Dyn, Levin &
Rippa 1990). Positive triangles on a simple polygon cannot overlap, so only their orientation is tested. If there is
such a triangulation, the vertex is removed, and its neighbours are tried again. One in three has no triangle within the
bound over it: that is tested first, without looking at samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.triangulation.deviation import squares_within, worst_crossing
from orograph.triangulation.mesh import (
    VERTICES,
    after,
    before,
    free_triangle,
    link,
    new_triangle,
    put,
)

MOST = 14
"""Maximum neighbours of a vertex that may be removed."""

ROUNDING = 1e-9
"""Metres within which the limit is left to the samples' own test."""


class Polygon(NamedTuple):
    """The neighbours of a vertex, and tables of the polygons between any two of them.

    Attributes:
        ring: (MOST,) int32, vertices in order. outer: (MOST,) int32, the half-edge beyond the side from each to the
            next. fixed: (MOST,) uint8, of that side.
        x, y, z: (MOST,) float64, the ring's places relative to the vertex. turn: (MOST, MOST) float64, twice the signed
            area of the vertex and two corners.
        cost: (MOST, MOST) float64, smallest sum of squares between corners i and j; inf: none is within the bound.
        third: (MOST, MOST) int32, the corner of the triangle on i–j then.
        side: (MOST, MOST) int32, the half-edge from j to i once it is made.
        stack: (2 · MOST,) int32.
    """

    ring: NDArray[np.int32]
    outer: NDArray[np.int32]
    fixed: NDArray[np.uint8]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    turn: NDArray[np.float64]
    cost: NDArray[np.float64]
    third: NDArray[np.int32]
    side: NDArray[np.int32]
    stack: NDArray[np.int32]


@inlined
def gather(m, p, v):
    """Collect the ring of a vertex. Returns its size; 0: the vertex must stay."""
    h = m.out[v]
    first, d = h, 0
    while True:
        if d == MOST or m.fixed[h] or m.twin[h] < 0:
            return 0
        side = after(h)
        p.ring[d], p.outer[d], p.fixed[d] = m.corner[side], m.twin[side], m.fixed[side]
        d += 1
        h = m.twin[before(h)]
        if h < 0:
            return 0
        if h == first:
            return d


@inlined
def measure(m, p, v, d):
    """Place the polygon's corners relative to the vertex within."""
    for i in range(d):
        u = p.ring[i]
        p.x[i], p.y[i], p.z[i] = m.x[u] - m.x[v], m.y[u] - m.y[v], m.z[u] - m.z[v]
    for i in range(d):
        for j in range(i):
            p.turn[j, i] = p.x[j] * p.y[i] - p.y[j] * p.x[i]
            p.turn[i, j] = -p.turn[j, i]


@inlined
def may_be(p, i, k, j, limit):
    """Whether three corners turn positively and, if they are around the vertex, are within the limit of it."""
    a, b, c = p.turn[k, j], p.turn[j, i], p.turn[i, k]
    area = a + b + c
    if area <= 0.0:
        return False
    return a < 0.0 or b < 0.0 or c < 0.0 or abs(a * p.z[i] + b * p.z[k] + c * p.z[j]) <= limit * area


@inlined
def may_go(p, d, limit):
    """Whether a triangle of three corners around the vertex is within the limit of it."""
    for i in range(d):
        for k in range(i + 1, d):
            if p.turn[i, k] >= 0.0:
                for j in range(k + 1, d):
                    if p.turn[k, j] >= 0.0 and p.turn[j, i] >= 0.0 and may_be(p, i, k, j, limit):
                        return True
    return False


@inlined
def triangulate(m, heights, p, d, limit, surface):
    """Fill the tables of the polygon of d corners. Returns the lowest cost; inf: it cannot be within the limit."""
    near = limit + ROUNDING
    if not may_go(p, d, near):
        return np.inf
    for i in range(d - 1):
        p.cost[i, i + 1] = 0.0
    for length in range(2, d):
        for i in range(d - length):
            j = i + length
            best = np.inf
            for k in range(i + 1, j):
                parts = p.cost[i, k] + p.cost[k, j]
                if parts < best and may_be(p, i, k, j, near):
                    squares = squares_within(heights, m, p.ring[i], p.ring[k], p.ring[j], limit, best)
                    if parts + squares < best:
                        best, p.third[i, j] = parts + squares, k
            inside = surface and best < np.inf and length < d - 1
            if inside and worst_crossing(heights, m, p.ring[i], p.ring[j])[0] > limit:
                best = np.inf
            p.cost[i, j] = best
    return p.cost[0, d - 1]


@inlined
def replace(m, p, v, d):
    """Replace the triangles around v by the best triangulation of the polygon."""
    h = m.out[v]
    for _ in range(d):
        following = m.twin[before(h)]
        free_triangle(m, h // 3)
        h = following
    for i in range(d):
        p.side[i, (i + 1) % d] = p.outer[i]
    count = 1
    p.stack[0], p.stack[1] = 0, d - 1
    while count:
        count -= 1
        i, j = p.stack[2 * count], p.stack[2 * count + 1]
        k = p.third[i, j]
        t = new_triangle(m)
        put(m, t, p.ring[i], p.ring[k], p.ring[j])
        # the slots are those that became free, which were live
        # sides i → k, k → j are made later unless they belong to the polygon; j → i was made before
        if i == 0 and j == d - 1:
            join(m, 3 * t + 2, p.outer[d - 1], p.fixed[d - 1])
        else:
            join(m, 3 * t + 2, p.side[i, j], 0)
        for n in range(2):
            a, b = (i, k) if n == 0 else (k, j)
            if b == a + 1:
                join(m, 3 * t + n, p.outer[a], p.fixed[a])
            else:
                p.side[a, b] = 3 * t + n
                p.stack[2 * count], p.stack[2 * count + 1] = a, b
                count += 1


@inlined
def join(m, h, g, fixed):
    """Link two half-edges of an edge, and mark it fixed or not."""
    link(m, h, g)
    m.fixed[h] = fixed


@kernel
def reduce(m, heights, order, locked, limit, surface):
    """Remove all unnecessary vertices.

    Args:
        m: the triangulation. order: (v,) int32, vertices in the order of trying; overwritten. locked: (v,) uint8, which
            stay.
        limit, surface: as ``refine``.

    Returns:
        the number of removed vertices; ``m.out`` is −1 for them.
    """
    p = Polygon(
        np.empty(MOST, np.int32), np.empty(MOST, np.int32), np.empty(MOST, np.uint8),
        np.empty(MOST), np.empty(MOST), np.empty(MOST), np.empty((MOST, MOST)), np.empty((MOST, MOST)),
        np.empty((MOST, MOST), np.int32), np.empty((MOST, MOST), np.int32), np.empty(2 * MOST, np.int32),
    )  # fmt: skip
    vertices = m.counts[VERTICES]
    waiting = np.ones(vertices, np.uint8)
    queue = order
    head, count, gone = 0, vertices, 0
    while count:
        v = queue[head % vertices]
        head, count = head + 1, count - 1
        waiting[v] = 0
        if locked[v] or m.out[v] < 0 or not m.live[m.out[v] // 3]:
            continue
        d = gather(m, p, v)
        if d == 0:
            continue
        measure(m, p, v, d)
        if not triangulate(m, heights, p, d, limit, surface) < np.inf:
            continue
        replace(m, p, v, d)
        m.out[v] = -1
        m.at[m.y[v], m.x[v]] = -1
        gone += 1
        for i in range(d):
            u = p.ring[i]
            if not waiting[u]:
                waiting[u] = 1
                queue[(head + count) % vertices] = u
                count += 1
    return gone
