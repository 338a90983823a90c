"""A triangulation that grows, point by point: half-edges in flat arrays, exact tests, Delaunay by flips.

Half-edge 3t + k runs from corner k of triangle t to its next one; ``twin`` is the same edge in the triangle beside it,
−1 at the outline. Vertices are samples of a window, so orientation and circle tests are exact in int64 for windows of
up to 2^14 samples a side. If four vertices lie on a circle, both diagonals are Delaunay: then the one from the vertex
of lowest ``precedence`` is used, as if each vertex were lowered on the paraboloid by an infinitesimal amount, the first
ones by far the most (Edelsbrunner & Mücke 1990). So the triangulation of the vertices is unique, whatever their order.
Vertices with columns + rows even come first. In a cell they are the ends of the surface's own diagonal
(docs/architecture.md), so that a TIN of all samples is the surface itself. Fixed edges are never flipped: the
triangulation is constrained Delaunay (``constraints``).

Sources: Guibas & Stolfi 1985 (incremental insertion), Lawson 1977 (flips).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf

MOST_SAMPLES = 1 << 14
"""Samples along the side of a window: beyond, circle tests could overflow."""

VERTICES, TRIANGLES, FREE = range(3)
"""Counts: vertices; slots of triangles in use or free; the first free slot, −1: none (linked by ``twin[3t]``)."""


class Mesh(NamedTuple):
    """A triangulation of a window.

    Attributes:
        x, y: (v,) int32, column and row of the vertices in the window. z: (v,) float64, metres.
        out: (v,) int32, a half-edge that starts at the vertex.
        corner, twin: (3t,) int32; corner[3t] is −1 if slot t is free. fixed: (3t,) uint8, never flipped.
        live: (t,) uint8, 1 on ground that exists; borders between live and other triangles are fixed.
        at: (rows, cols) int32, the vertex at a sample, −1: none.
        counts: (3,) int64.
    """

    x: NDArray[np.int32]
    y: NDArray[np.int32]
    z: NDArray[np.float64]
    out: NDArray[np.int32]
    corner: NDArray[np.int32]
    twin: NDArray[np.int32]
    fixed: NDArray[np.uint8]
    live: NDArray[np.uint8]
    at: NDArray[np.int32]
    counts: NDArray[np.int64]


def new_mesh(rows: int, cols: int) -> Mesh:
    """Room for a triangulation of all samples of a window; unused pages take no memory."""
    vertices, edges = rows * cols, 6 * rows * cols
    return Mesh(
        np.empty(vertices, np.int32), np.empty(vertices, np.int32), np.empty(vertices), np.empty(vertices, np.int32),
        np.empty(edges, np.int32), np.empty(edges, np.int32), np.empty(edges, np.uint8),
        np.empty(edges // 3, np.uint8), np.full((rows, cols), -1, np.int32), np.array([0, 0, -1]),
    )  # fmt: skip


@inlined
def after(h):
    """The next half-edge of the same triangle."""
    return h - 2 if h % 3 == 2 else h + 1


@inlined
def before(h):
    """The half-edge before it in the same triangle."""
    return h + 2 if h % 3 == 0 else h - 1


@inlined
def turn_of(m, a, b, c):
    """Twice the signed area of three vertices in (column, row)."""
    ax, ay = np.int64(m.x[a]), np.int64(m.y[a])
    return (m.x[b] - ax) * (m.y[c] - ay) - (m.y[b] - ay) * (m.x[c] - ax)


@inlined
def side_of(m, a, b, x, y):
    """Twice the signed area of two vertices and a sample."""
    ax, ay = np.int64(m.x[a]), np.int64(m.y[a])
    return (m.x[b] - ax) * (y - ay) - (m.y[b] - ay) * (x - ax)


@inlined
def in_circle(m, a, b, c, d):
    """Positive if d lies inside the circle through a, b, c (in positive orientation), 0 on it."""
    dx, dy = np.int64(m.x[d]), np.int64(m.y[d])
    ax, ay, bx, by, cx, cy = m.x[a] - dx, m.y[a] - dy, m.x[b] - dx, m.y[b] - dy, m.x[c] - dx, m.y[c] - dy
    aa, bb, cc = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    return ax * (by * cc - bb * cy) - ay * (bx * cc - bb * cx) + aa * (bx * cy - by * cx)


@inlined
def link(m, h, g):
    """Make two half-edges the two sides of one edge (g −1: the outline)."""
    m.twin[h] = g
    if g >= 0:
        m.twin[g] = h


@inlined
def put(m, t, a, b, c):
    """Make slot t a triangle; its half-edges are not yet linked."""
    h = 3 * t
    m.corner[h], m.corner[h + 1], m.corner[h + 2] = a, b, c
    m.out[a], m.out[b], m.out[c] = h, h + 1, h + 2
    m.fixed[h], m.fixed[h + 1], m.fixed[h + 2] = 0, 0, 0


@inlined
def new_triangle(m):
    """A slot for a triangle."""
    t = m.counts[FREE]
    if t >= 0:
        m.counts[FREE] = m.twin[3 * t]
        return t
    t = m.counts[TRIANGLES]
    m.counts[TRIANGLES] = t + 1
    return t


@leaf
def free_triangle(m, t):
    """Give a slot back."""
    m.corner[3 * t] = -1
    m.twin[3 * t] = m.counts[FREE]
    m.counts[FREE] = t


@inlined
def new_vertex(m, x, y, z):
    """A vertex at a sample, in no triangle yet."""
    v = m.counts[VERTICES]
    m.counts[VERTICES] = v + 1
    m.x[v], m.y[v], m.z[v], m.at[y, x] = x, y, z, v
    return v


@inlined
def flip(m, h):
    """Flip the edge of h and its twin to the other diagonal of their two triangles.

    h: a → b becomes a → d, with d the far corner; then ``after(h)`` is d → v, v the corner of h's triangle.
    """
    g = m.twin[h]
    hn, gn = after(h), after(g)
    v, d, a, b = m.corner[before(h)], m.corner[before(g)], m.corner[h], m.corner[g]
    m.fixed[h], m.fixed[g] = m.fixed[gn], m.fixed[hn]
    outer = m.twin[hn]
    link(m, h, m.twin[gn])
    link(m, g, outer)
    link(m, hn, gn)
    m.fixed[hn], m.fixed[gn] = 0, 0
    m.corner[hn], m.corner[gn] = d, v
    m.out[a], m.out[d], m.out[v], m.out[b] = h, hn, before(h), g


@leaf
def precedence(m, v):
    """The order of vertices that decides ties: columns + rows even before odd, then by rows, then by columns."""
    x, y = np.int64(m.x[v]), np.int64(m.y[v])
    return (((x + y) & 1) << 40) + (y << 20) + x


@inlined
def should_flip(m, h):
    """Whether an edge is not Delaunay, or the other diagonal of four vertices on a circle is preferred."""
    g = m.twin[h]
    if g < 0 or m.fixed[h]:
        return False
    a, b, c, d = m.corner[h], m.corner[after(h)], m.corner[before(h)], m.corner[before(g)]
    inside = in_circle(m, a, b, c, d)
    if inside != 0:
        return inside > 0
    return min(precedence(m, c), precedence(m, d)) < min(precedence(m, a), precedence(m, b))


@inlined
def legalise(m, stack, count):
    """Flip edges, given by the half-edges opposite to a new vertex, until all are Delaunay."""
    while count:
        count -= 1
        h = stack[count]
        if should_flip(m, h):
            far = before(m.twin[h])
            flip(m, h)
            stack[count], stack[count + 1] = h, far
            count += 2


@inlined
def insert(m, t, x, y, z, stack):
    """Add a vertex at a sample in triangle t, or on one of its edges, and restore Delaunay. Returns the vertex.

    All triangles that changed are those around it.
    """
    v = new_vertex(m, x, y, z)
    count = 0
    for k in range(3):
        h = 3 * t + k
        if side_of(m, m.corner[h], m.corner[after(h)], x, y) == 0:
            count = split_edge(m, h, v, stack)
            break
    legalise(m, stack, count or split_triangle(m, t, v, stack))
    return v


@inlined
def split_triangle(m, t, v, stack):
    """Put a vertex into a triangle. Returns the number of half-edges on the stack."""
    a, b, c = m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2]
    bc, ca, bc_fixed, ca_fixed = m.twin[3 * t + 1], m.twin[3 * t + 2], m.fixed[3 * t + 1], m.fixed[3 * t + 2]
    ab_fixed = m.fixed[3 * t]
    t1, t2 = new_triangle(m), new_triangle(m)
    put(m, t, a, b, v)
    put(m, t1, b, c, v)
    put(m, t2, c, a, v)
    m.fixed[3 * t], m.fixed[3 * t1], m.fixed[3 * t2] = ab_fixed, bc_fixed, ca_fixed
    m.live[t1] = m.live[t2] = m.live[t]
    link(m, 3 * t1, bc)
    link(m, 3 * t2, ca)
    link(m, 3 * t + 1, 3 * t1 + 2)
    link(m, 3 * t1 + 1, 3 * t2 + 2)
    link(m, 3 * t2 + 1, 3 * t + 2)
    stack[0], stack[1], stack[2] = 3 * t, 3 * t1, 3 * t2
    return 3


@leaf
def split_edge(m, h, v, stack):
    """Put a vertex on an edge; its halves are fixed if it is. Returns the number of half-edges on the stack."""
    g, fixed = m.twin[h], m.fixed[h]
    count, halves = split_side(m, h, v, stack, 0)
    if g < 0:
        return count
    count, others = split_side(m, g, v, stack, count)
    link(m, h, others)
    link(m, g, halves)
    m.fixed[g], m.fixed[others], m.fixed[h], m.fixed[halves] = fixed, fixed, fixed, fixed
    return count


@leaf
def split_side(m, h, v, stack, count):
    """Split the triangle of h: a → b by a vertex on it: h becomes a → v; returns the half-edge v → b as well."""
    hn, hp = after(h), before(h)
    b, c, outer, outer_fixed, fixed = m.corner[hn], m.corner[hp], m.twin[hn], m.fixed[hn], m.fixed[h]
    t = new_triangle(m)
    put(m, t, v, b, c)
    m.live[t] = m.live[h // 3]
    m.corner[hn] = v
    m.out[v], m.out[c], m.out[m.corner[h]] = hn, hp, h
    link(m, 3 * t + 1, outer)
    m.fixed[3 * t + 1] = outer_fixed
    link(m, 3 * t + 2, hn)
    m.fixed[hn], m.fixed[3 * t] = 0, fixed
    m.twin[h], m.twin[3 * t] = -1, -1
    stack[count], stack[count + 1] = 3 * t + 1, hp
    return count + 2, 3 * t


@leaf
def locate(m, t, x, y):
    """A triangle that holds a sample, by a walk from triangle t (Devillers et al. 2002).

    If the walk goes in circles, which it may with fixed edges, all triangles are tried.
    """
    for _ in range(4 * MOST_SAMPLES):
        moved = False
        for k in range(3):
            h = 3 * t + k
            if m.twin[h] >= 0 and side_of(m, m.corner[h], m.corner[after(h)], x, y) < 0:
                t, moved = m.twin[h] // 3, True
                break
        if not moved:
            return t
    for u in range(m.counts[TRIANGLES]):
        if m.corner[3 * u] >= 0:
            a, b, c = m.corner[3 * u], m.corner[3 * u + 1], m.corner[3 * u + 2]
            if side_of(m, a, b, x, y) >= 0 and side_of(m, b, c, x, y) >= 0 and side_of(m, c, a, x, y) >= 0:
                return u
    return -1


@leaf
def begin(m, heights):
    """Two triangles over the window."""
    rows, cols = heights.shape
    for x, y in ((0, 0), (cols - 1, 0), (cols - 1, rows - 1), (0, rows - 1)):
        new_vertex(m, x, y, heights[y, x])
    m.counts[TRIANGLES] = 2
    m.live[:2] = 1
    put(m, 0, 0, 1, 2)
    put(m, 1, 0, 2, 3)
    m.twin[:6] = -1
    link(m, 2, 3)


@kernel
def make_delaunay(m):
    """Flip all edges that may be until the triangulation is constrained Delaunay (Lawson 1977)."""
    again = True
    while again:
        again = False
        for h in range(3 * m.counts[TRIANGLES]):
            if should_flip(m, h):
                flip(m, h)
                again = True
