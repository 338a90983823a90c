"""Greedy insertion: the samples farthest from the TIN become vertices, until none exceeds the bound.

Each triangle knows its worst sample, and after an insertion only the triangles around the new vertex are assessed again
(Garland & Heckbert 1995, *Fast polygonal approximation of terrains and height fields*, §4.3, algorithm III). The paper
always inserts the worst sample of all. Here the bound falls by halves to the requested one, and all triangles above it
take their worst samples, those around the last new vertex first: next to the same vertices, without a heap and close
together in memory. For a bound on the surface, a second run also checks the crossings of edges with the
surface's edges, and inserts the nearer sample of the edge with the worst crossing. In a Delaunay triangulation an edge
of the surface between two vertices is an edge of the TIN, so one of the two samples is free.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.triangulation.deviation import worst_crossing, worst_sample
from orograph.triangulation.mesh import TRIANGLES, after, before, insert, locate

RATIO = 2.0
"""Of two bounds on the way to the requested one."""


class Worst(NamedTuple):
    """The worst samples of triangles.

    Attributes:
        error: (t,) float64, metres; 0 if no sample may become a vertex. x, y: (t,) int32, the sample with that error.
        todo: (t,) int32, a stack of triangles. waiting: (t,) uint8, whether a triangle is on it.
    """

    error: NDArray[np.float64]
    x: NDArray[np.int32]
    y: NDArray[np.int32]
    todo: NDArray[np.int32]
    waiting: NDArray[np.uint8]


def room_for(rows: int, cols: int) -> Worst:
    """Room for all triangles of a window; unused pages take no memory."""
    room = 2 * rows * cols
    return Worst(
        np.empty(room), np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32),
        np.zeros(room, np.uint8),
    )  # fmt: skip


@inlined
def is_free(m, x, y):
    """Whether a sample may become a vertex: it is not one yet, and not on the window's border, which others share."""
    rows, cols = m.at.shape
    return m.at[y, x] < 0 and 0 < x < cols - 1 and 0 < y < rows - 1


@inlined
def assess(m, heights, w, t, limit, surface):
    """Find the worst error of a triangle."""
    w.error[t] = 0.0
    if not m.live[t]:
        return
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
    w.error[t], w.x[t], w.y[t] = error, x, y


@inlined
def push(w, t, level, count):
    """Put a triangle on the stack if it exceeds the level and is not there yet. Returns the number on the stack."""
    if w.error[t] <= level or w.waiting[t]:
        return count
    w.todo[count], w.waiting[t] = t, 1
    return count + 1


@inlined
def refine_to(m, heights, w, level, limit, surface, stack):
    """Insert samples until every triangle is within a level that is not below the limit."""
    count = 0
    for t in range(m.counts[TRIANGLES]):
        count = push(w, t, level, count)
    while count:
        count -= 1
        t = int(w.todo[count])
        w.waiting[t] = 0
        if w.error[t] <= level:
            continue
        x, y = np.int64(w.x[t]), np.int64(w.y[t])
        first = 3 * t
        free = not surface or is_free(m, x, y)  # if not, a sample beyond the triangle was inserted since
        if free:
            if surface:
                t = locate(m, t, x, y)
            first = int(m.out[insert(m, t, x, y, np.float64(heights[y, x]), stack)])
        h = first
        while True:
            assess(m, heights, w, h // 3, limit, surface)
            count = push(w, h // 3, level, count)
            h = int(m.twin[before(h)])
            if h == first or not free:
                break


@kernel
def refine(m, heights, w, limit, surface):
    """Insert samples until every triangle is within the limit.

    Args:
        m: a constrained Delaunay triangulation. heights: (rows, cols) float32 of its window.
        w: room for its triangles. limit: metres. surface: whether the bound is on the surface, or only at samples.
    """
    stack = np.empty(3 * len(w.todo) // 2 + 16, np.int32)
    largest = 0.0
    for t in range(m.counts[TRIANGLES]):
        assess(m, heights, w, t, limit, surface)
        largest = max(largest, w.error[t])
    level = limit
    while level * RATIO < largest:
        level *= RATIO
    while level >= limit:
        refine_to(m, heights, w, level, limit, surface, stack)
        level /= RATIO


@kernel
def missed(m, heights, limit):
    """The obstacles where the bound on the surface is not kept.

    Returns:
        (n, 2) int64, columns and rows of samples on the border of the window that must become vertices: ends of an edge
        of the surface whose crossing exceeds the limit and whose other end is already a vertex. And (k, 4), edges of
        the surface both of whose ends are vertices, which are blocked by fixed edges that cross them; and parts of
        break lines that exceed the limit: a line keeps it as a whole, but not in parts if a sample on it is a vertex.
    """
    samples = np.empty((2 * (m.at.shape[0] + m.at.shape[1]), 2), np.int64)
    edges = np.empty((16, 4), np.int64)
    count, size = 0, 0
    for h in range(3 * m.counts[TRIANGLES]):
        if not m.live[h // 3] or m.twin[h] < h:
            continue
        a, b = m.corner[h], m.corner[after(h)]
        if m.fixed[h] and (m.x[b], m.y[b]) < (m.x[a], m.y[a]):
            a, b = b, a  # as ``tin_lines`` orders its edges, for the same rounding
        off, near_x, near_y, far_x, far_y = worst_crossing(heights, m, a, b)
        if off <= limit:
            continue
        if m.fixed[h]:
            near_x, near_y, far_x, far_y = np.int64(m.x[a]), np.int64(m.y[a]), np.int64(m.x[b]), np.int64(m.y[b])
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
