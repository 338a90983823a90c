"""The TINs of one diamond: two patches of the hierarchy whose vertices are chosen among the samples of a lattice.

A TIN is stored as the set of samples in a diamond's window (``tin_windows``) that are vertices. They are triangulated
in a fixed order, constrained Delaunay, so the same vertices always give the same triangles. The five
edges of a diamond are constraints: the four legs of its patches, and the hypotenuse that they share. Where one leaves
the raster it ends in a vertex, on the lattice or not. (A square diamond's legs are the borders of its window.)

``tin_greedy`` chooses the vertices. Heights are metres; columns and rows are samples from the window's first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf
from orograph.store.tin_windows import across, clipped, in_region, is_whole, line_at, on_leg, place, region_corner
from orograph.triangulation.constraints import fix_edge
from orograph.triangulation.mesh import (
    TRIANGLES,
    VERTICES,
    Mesh,
    insert,
    link,
    locate,
    make_delaunay,
    new_triangle,
    new_vertex,
    put,
)

EXTRAS = 16
"""Room for ends of edges that lie off the lattice."""


class Work(NamedTuple):
    """Arrays that one thread works in.

    Attributes:
        mesh: the triangulation. errors: (2c,) float64, a tournament tree: entry i is the larger of 2i and 2i + 1; the
            last c are the triangles' errors. sample: (t,) int32, the number of each triangle's worst sample.
        candidates: (rows, cols) float32, heights of samples that may become vertices, NaN for others. ids: (rows, cols)
            int32, the vertex at a sample of the window, −1: none. extras: (16, 3) int64, column, row and vertex of ends
            off the lattice. stack: for flips. star: (t,) int32, triangles to examine.
    """

    mesh: Mesh
    errors: NDArray[np.float64]
    sample: NDArray[np.int32]
    candidates: NDArray[np.float32]
    ids: NDArray[np.int32]
    extras: NDArray[np.int64]
    stack: NDArray[np.int32]
    star: NDArray[np.int32]


def new_work(vertices: int, side: int) -> Work:
    """Allocate room for so many vertices in windows of so many samples a side."""
    slots = 2 * vertices
    nowhere = np.lib.stride_tricks.as_strided(np.zeros(1, np.int32), (1 << 14, 1 << 14), (0, 0))
    mesh = Mesh(
        np.empty(vertices, np.int32), np.empty(vertices, np.int32), np.empty(vertices), np.empty(vertices, np.int32),
        np.empty(3 * slots, np.int32), np.empty(3 * slots, np.int32), np.empty(3 * slots, np.uint8),
        np.empty(slots, np.uint8), nowhere, np.array([0, 0, -1]),
    )  # fmt: skip
    return Work(
        mesh, np.empty(4 << slots.bit_length()), np.empty(slots, np.int32), np.empty((side, side), np.float32),
        np.empty((side, side), np.int32), np.empty((EXTRAS, 3), np.int64), np.empty(6 * slots, np.int32),
        np.empty(slots, np.int32),
    )  # fmt: skip


@leaf
def find(w, work, x, y):
    """The vertex at a sample, −1: none."""
    i, j = line_at(y, w.step, w.height), line_at(x, w.step, w.width)
    if i >= 0 and j >= 0:
        return np.int64(work.ids[i, j])
    for k in range(EXTRAS):
        if work.extras[k, 0] == x and work.extras[k, 1] == y:
            return work.extras[k, 2]
    return np.int64(-1)


@leaf
def note(w, work, x, y, v):
    """Record the vertex at a sample."""
    i, j = line_at(y, w.step, w.height), line_at(x, w.step, w.width)
    if i >= 0 and j >= 0:
        work.ids[i, j] = v
        return
    k = 0
    while work.extras[k, 0] >= 0:
        k += 1
    work.extras[k, 0], work.extras[k, 1], work.extras[k, 2] = x, y, v


@leaf
def height_at(w, heights, ends, x, y):
    """The height of a sample of the lattice, or of the end of an edge.

    Args:
        ends: (5, 2) float32, heights of the ends of edges on the raster.
    """
    i, j = line_at(y, w.step, w.height), line_at(x, w.step, w.width)
    if i >= 0 and j >= 0:
        return np.float64(heights[i, j])
    for edge in range(5):
        ax, ay, dx, dy, low, high = clipped(w, edge)
        for k in range(2):
            t = low if k == 0 else high
            if low <= high and ax + t * dx == x and ay + t * dy == y:
                return np.float64(ends[edge, k])
    return np.nan  # (a corner of the window, outside the region)


@leaf
def add(w, work, heights, ends, x, y, t):
    """Make a sample a vertex unless it is one; return a triangle near by."""
    if find(w, work, x, y) >= 0:
        return t
    v = insert(work.mesh, locate(work.mesh, t, x, y), x, y, height_at(w, heights, ends, x, y), work.stack)
    note(w, work, x, y, v)
    return work.mesh.out[v] // 3


@leaf
def start(w, work, heights, ends):
    """Begin with two triangles over the window."""
    m = work.mesh
    m.counts[0], m.counts[1], m.counts[2] = 0, 2, -1
    for k in range(4):
        x, y = w.width * ((k == 1) | (k == 2)), w.height * (k >> 1)
        note(w, work, x, y, new_vertex(m, x, y, height_at(w, heights, ends, x, y)))
    m.live[0] = m.live[1] = 0
    put(m, 0, 0, 1, 2)
    put(m, 1, 0, 2, 3)
    for h in range(6):
        m.twin[h] = -1
    link(m, 2, 3)


@kernel
def fix(w, work, edge):
    """Force a diamond's edge into the triangulation, from vertex to vertex; return whether that was possible."""
    ax, ay, dx, dy, low, high = clipped(w, edge)
    if low >= high:
        return True
    a = find(w, work, ax + low * dx, ay + low * dy)
    t = (low // w.step + 1) * w.step
    good = True
    while low < high:
        low = min(t, high)
        t += w.step
        b = find(w, work, ax + low * dx, ay + low * dy)
        if b >= 0:
            good = good and fixed(work.mesh, a, b)
            a = b
    return good


@kernel
def fixed(m, a, b):
    """``fix_edge``, compiled separately."""
    return fix_edge(m, a, b)


@leaf
def next_on(w, marks, x, y, dx, dy, k, last):
    """The next vertex on a leg that begins at a sample, in steps of the lattice along it; beyond the last: none."""
    i, j = y // w.step, x // w.step
    k += 1
    while k < last and not marks[i + k * dy, j + k * dx]:
        k += 1
    return k


@leaf
def vertex_on(w, m, heights, x, y, dx, dy, k):
    """Add a vertex ``k`` steps along a leg."""
    x, y = x + k * dx * w.step, y + k * dy * w.step
    return new_vertex(m, x, y, np.float64(heights[y // w.step, x // w.step]))


@leaf
def start_whole(w, work, heights, marks):
    """Triangulate the vertices on the legs of an uncut diamond.

    From each apex the legs are joined step by step, up to the hypotenuse; then edges are flipped.
    """
    m = work.mesh
    m.counts[0], m.counts[1], m.counts[2] = 0, 0, -1
    for k in range(4):
        x, y = region_corner(w, k)
        new_vertex(m, x, y, np.float64(heights[y // w.step, x // w.step]))
    other = np.int64(-1)
    for apex in range(2, 4):
        x, y = region_corner(w, apex)
        live = 1 if across(w, x, y, 1) < 0 else 2
        end_u, end_v = 0, 1
        ux, uy = region_corner(w, 0)
        vx, vy = region_corner(w, 1)
        if (ux - x) * (vy - y) - (uy - y) * (vx - x) < 0:
            end_u, end_v, ux, uy, vx, vy = 1, 0, vx, vy, ux, uy
        long = max(abs(ux - x), abs(uy - y))
        last = long // w.step
        ux, uy, vx, vy = (ux - x) // long, (uy - y) // long, (vx - x) // long, (vy - y) // long
        u, v, h = np.int64(apex), np.int64(apex), np.int64(-1)
        at_u = next_on(w, marks, x, y, ux, uy, 0, last)
        at_v = next_on(w, marks, x, y, vx, vy, 0, last)
        while at_u <= last or at_v <= last:
            along_u = u == v or (v != apex and at_u <= at_v)
            if along_u:
                new = end_u if at_u == last else vertex_on(w, m, heights, x, y, ux, uy, at_u)
                at_u = next_on(w, marks, x, y, ux, uy, at_u, last)
            else:
                new = end_v if at_v == last else vertex_on(w, m, heights, x, y, vx, vy, at_v)
                at_v = next_on(w, marks, x, y, vx, vy, at_v, last)
            if u != v:
                t = new_triangle(m)
                put(m, t, v, u, new)
                m.live[t] = live
                m.twin[3 * t], m.twin[3 * t + 1], m.twin[3 * t + 2] = -1, -1, -1
                m.fixed[3 * t + 1 if along_u else 3 * t + 2] = 1
                if h >= 0:
                    link(m, 3 * t, h)
                h = 3 * t + 2 if along_u else 3 * t + 1
            if along_u:
                u = np.int64(new)
            else:
                v = np.int64(new)
        m.fixed[h] = 1
        if other >= 0:
            link(m, h, other)
        other = h
    make_delaunay(m)


@kernel
def start_cut(w, work, heights, ends, marks):
    """Triangulate the vertices on a diamond that the raster cuts, and the corners of its window.

    Returns: whether its edges could be forced.
    """
    m = work.mesh
    rows, cols = heights.shape
    work.ids[:rows, :cols] = -1
    work.extras[:] = -1
    start(w, work, heights, ends)
    t, step = np.int64(0), coarsest(rows, cols)
    first = step
    while step:
        for i in range(0, rows, step):
            for j in range(0, cols, step):
                if marks[i, j] and (step == first or (i | j) & step):
                    x, y = place(j, w.step, w.width), place(i, w.step, w.height)
                    if in_region(w, x, y):
                        t = add(w, work, heights, ends, x, y, t)
        step >>= 1
    for edge in range(1 if w.shape == 0 else 5):
        ax, ay, dx, dy, low, high = clipped(w, edge)
        if low <= high:
            t = add(w, work, heights, ends, ax + low * dx, ay + low * dy, t)
            t = add(w, work, heights, ends, ax + high * dx, ay + high * dy, t)
    good = True
    for edge in range(1 if w.shape == 0 else 5):
        good = fix(w, work, edge) and good
    make_delaunay(m)
    for u in range(m.counts[TRIANGLES]):
        a, b, c = m.corner[3 * u], m.corner[3 * u + 1], m.corner[3 * u + 2]
        x3, y3 = np.int64(m.x[a]) + m.x[b] + m.x[c], np.int64(m.y[a]) + m.y[b] + m.y[c]
        inside = w.shape == 0 or abs(x3 - 3 * w.cx) + abs(y3 - 3 * w.cy) < 3 * w.s
        m.live[u] = 0 if not inside else 1 if across(w, x3, y3, 3) < 0 else 2
    return good


@inlined
def coarsest(rows, cols):
    """The step of the first vertices: coarse ones come first, so that few triangles are crossed and flipped."""
    step = 1
    while 2 * step < max(rows, cols):
        step *= 2
    return step


@leaf
def add_inner(w, work, heights, marks):
    """Add the marked samples of an uncut diamond that are not on its legs."""
    m = work.mesh
    rows, cols = heights.shape
    t, step = np.int64(0), coarsest(rows, cols)
    first = step
    while step:
        for i in range(0, rows, step):
            for j in range(0, cols, step):
                if marks[i, j] and (step == first or (i | j) & step):
                    x, y = j * w.step, i * w.step
                    if in_region(w, x, y) and not on_leg(w, x, y):
                        v = insert(m, locate(m, t, x, y), x, y, np.float64(heights[i, j]), work.stack)
                        t = np.int64(m.out[v]) // 3
        step >>= 1


@kernel
def triangulate(w, work, heights, ends, marks):
    """Triangulate the marked samples.

    ``work.mesh.live`` is 1 for triangles on one side of the hypotenuse, 2 on the other, 0 outside the patches.

    Args:
        w, work: ``Window``, ``Work``. heights: (rows, cols) float32 of the window's samples. ends: see ``height_at``.
        marks: (rows, cols), not 0: a vertex.

    Returns: the number of triangles, −1 if edges conflict, which is a fault.
    """
    if is_whole(w):
        start_whole(w, work, heights, marks)
        add_inner(w, work, heights, marks)
    elif not start_cut(w, work, heights, ends, marks):
        return -1
    count = 0
    for t in range(work.mesh.counts[TRIANGLES]):
        count += work.mesh.live[t] > 0
    return count


@kernel
def patches(m):
    """The vertices (v, 3) float64 of both patches, in the window, and their triangles (t, 3) and (u, 3) int32."""
    count = np.zeros(3, np.int64)
    for t in range(m.counts[TRIANGLES]):
        count[m.live[t]] += 1
    first, second = np.empty((count[1], 3), np.int32), np.empty((count[2], 3), np.int32)
    count[:] = 0
    for t in range(m.counts[TRIANGLES]):
        side = m.live[t]
        for k in range(3):
            if side == 1:
                first[count[1], k] = m.corner[3 * t + k]
            elif side == 2:
                second[count[2], k] = m.corner[3 * t + k]
        count[side] += 1
    size = m.counts[VERTICES]
    vertices = np.empty((size, 3))
    for v in range(size):
        vertices[v, 0], vertices[v, 1], vertices[v, 2] = m.x[v], m.y[v], m.z[v]
    return vertices, first, second
