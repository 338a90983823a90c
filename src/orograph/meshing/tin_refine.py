"""Greedy insertion: the sample farthest from the TIN becomes a vertex, until none exceeds the bound.

Each triangle knows its worst sample; a heap of triangles gives the worst of all; after an insertion only the triangles
around the new vertex are assessed again (Garland & Heckbert 1995, *Fast polygonal approximation of terrains and height
fields*, §4.3, algorithm III). For a bound on the surface, a second run also checks the crossings of edges with the
surface's edges, and inserts the nearer sample of the edge with the worst crossing. In a Delaunay triangulation an edge
of the surface between two vertices is an edge of the TIN, so one of the two samples is free.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel, leaf
from orograph.triangulation.deviation import worst_crossing, worst_sample
from orograph.triangulation.heap import put_in, take_out
from orograph.triangulation.mesh import TRIANGLES, after, before, insert, locate


@leaf
def is_free(m, x, y):
    """Whether a sample may become a vertex: it is not one yet, and not on the window's border, which others share."""
    rows, cols = m.at.shape
    return m.at[y, x] < 0 and 0 < x < cols - 1 and 0 < y < rows - 1


@leaf
def assess(m, heights, q, t, limit, surface):
    """Find the worst error of a triangle, and put the triangle into the heap if it exceeds the limit."""
    h = 3 * t
    error, x, y = worst_sample(heights, m, m.corner[h], m.corner[h + 1], m.corner[h + 2])
    if surface:
        for k in range(3):
            # each edge is checked from one side, which does not depend on the slots of its triangles
            if not m.fixed[h + k] and m.corner[h + k] < m.corner[h + (k + 1) % 3]:
                off, near_x, near_y, far_x, far_y = worst_crossing(
                    heights, m, m.corner[h + k], m.corner[h + (k + 1) % 3]
                )
                if off > error and off > limit:
                    if not is_free(m, near_x, near_y):
                        near_x, near_y = far_x, far_y
                    if is_free(m, near_x, near_y):
                        error, x, y = off, near_x, near_y
    if error <= limit:
        take_out(q, t)
        return
    put_in(q, t, error, x, y)


@kernel
def refine(m, heights, q, limit, surface):
    """Insert samples until every triangle is within the limit.

    Args:
        m: a constrained Delaunay triangulation. heights: (rows, cols) float32 of its window.
        q: an empty heap. limit: metres. surface: whether the bound is on the surface, or only at samples.
    """
    stack = np.empty(3 * len(q.heap) // 2 + 16, np.int32)
    for t in range(m.counts[TRIANGLES]):
        if m.live[t]:
            assess(m, heights, q, t, limit, surface)
    while q.size[0]:
        t = q.heap[0]
        x, y = np.int64(q.x[t]), np.int64(q.y[t])
        if surface:
            if not is_free(m, x, y):  # a sample beyond the triangle that was inserted since
                assess(m, heights, q, t, limit, surface)
                continue
            t = locate(m, t, x, y)
        v = insert(m, t, x, y, np.float64(heights[y, x]), stack)
        first = m.out[v]
        h = first
        while True:
            if m.live[h // 3]:
                assess(m, heights, q, h // 3, limit, surface)
            h = m.twin[before(h)]
            if h == first:
                break


@kernel
def missed(m, heights, limit):
    """The obstacles where the bound on the surface is not kept.

    Returns:
        (n, 2) int64, columns and rows of samples on the border of the window that must become vertices: ends of an edge
        of the surface whose crossing exceeds the limit and whose other end is already a vertex. And (k, 4), edges of
        the surface both of whose ends are vertices, which are blocked by fixed edges that cross them.
    """
    samples = np.empty((2 * (m.at.shape[0] + m.at.shape[1]), 2), np.int64)
    edges = np.empty((16, 4), np.int64)
    count, size = 0, 0
    for h in range(3 * m.counts[TRIANGLES]):
        if not m.live[h // 3] or m.fixed[h] or m.twin[h] < h:
            continue
        off, near_x, near_y, far_x, far_y = worst_crossing(heights, m, m.corner[h], m.corner[after(h)])
        if off <= limit:
            continue
        if m.at[near_y, near_x] >= 0 and m.at[far_y, far_x] >= 0:
            if size == len(edges):
                edges = np.concatenate((edges, np.empty_like(edges)))
            edges[size, 0], edges[size, 1], edges[size, 2], edges[size, 3] = near_x, near_y, far_x, far_y
            size += 1
        for k in range(2):
            x, y = (near_x, near_y) if k == 0 else (far_x, far_y)
            if m.at[y, x] == -1:
                m.at[y, x] = -2
                samples[count, 0], samples[count, 1] = x, y
                count += 1
    return samples[:count].copy(), edges[:size].copy()
