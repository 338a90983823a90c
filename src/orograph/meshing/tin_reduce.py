"""Removal of unnecessary vertices from a TIN: those whose hole can be triangulated within the bound.

Greedy insertion leaves vertices that later ones made superfluous, and Delaunay triangles that do not follow the ground.
For a vertex with d neighbours, all triangulations of the polygon around it are compared by dynamic programming over its
sides (Klincsek 1980, *Minimal triangulations of polygonal domains*): only triangles and diagonals within the bound
count, and the triangulation with the smallest sum of squared deviations is used, a data-dependent one (Dyn, Levin &
Rippa 1990). Positive triangles on a simple polygon cannot overlap, so only their orientation is tested. If there is
such a triangulation, the vertex is removed, and its neighbours are tried again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.triangulation.deviation import squares_within, worst_crossing
from orograph.triangulation.mesh import (
    VERTICES,
    after,
    before,
    free_triangle,
    link,
    new_triangle,
    put,
    turn_of,
)

MOST = 14
"""Maximum neighbours of a vertex that may be removed."""


class Polygon(NamedTuple):
    """The neighbours of a vertex, and tables of the polygons between any two of them.

    Attributes:
        ring: (MOST,) int32, vertices in order. outer: (MOST,) int32, the half-edge beyond the side from each to the
            next. fixed: (MOST,) uint8, of that side.
        cost: (MOST, MOST) float64, smallest sum of squares between corners i and j; inf: none is within the bound.
        third: (MOST, MOST) int32, the corner of the triangle on i–j then.
        side: (MOST, MOST) int32, the half-edge from j to i once it is made.
        stack: (2 · MOST,) int32.
    """

    ring: NDArray[np.int32]
    outer: NDArray[np.int32]
    fixed: NDArray[np.uint8]
    cost: NDArray[np.float64]
    third: NDArray[np.int32]
    side: NDArray[np.int32]
    stack: NDArray[np.int32]


@leaf
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


@leaf
def triangulate(m, heights, p, d, limit, surface):
    """Fill the tables of the polygon of d corners. Returns the lowest cost; inf: it cannot be within the limit."""
    for i in range(d - 1):
        p.cost[i, i + 1] = 0.0
    for length in range(2, d):
        for i in range(d - length):
            j = i + length
            best, third = np.inf, -1
            if surface and length < d - 1 and worst_crossing(heights, m, p.ring[i], p.ring[j])[0] > limit:
                p.cost[i, j] = np.inf
                continue
            for k in range(i + 1, j):
                parts = p.cost[i, k] + p.cost[k, j]
                if parts >= best or turn_of(m, p.ring[i], p.ring[k], p.ring[j]) <= 0:
                    continue
                squares = squares_within(heights, m, p.ring[i], p.ring[k], p.ring[j], limit, best)
                if parts + squares < best:
                    best, third = parts + squares, k
            p.cost[i, j], p.third[i, j] = best, third
    return p.cost[0, d - 1]


@leaf
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


@leaf
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
        np.empty(MOST, np.int32), np.empty(MOST, np.int32), np.empty(MOST, np.uint8), np.empty((MOST, MOST)),
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
        if d == 0 or not triangulate(m, heights, p, d, limit, surface) < np.inf:
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
