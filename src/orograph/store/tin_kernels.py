"""The TINs of one diamond: two patches of the hierarchy whose vertices are chosen among the samples of a lattice.

Which samples of a diamond's window (``tin_windows``) are vertices is all that makes a TIN: they are triangulated in a
fixed order, constrained Delaunay, so that whoever triangulates them gets the same triangles. The five
edges of a diamond are constraints: the four legs of its patches, and the hypotenuse that they share. Where one leaves
the raster it ends in a vertex, on the lattice or not. (A square diamond's legs are the borders of its window.)

``simplify`` chooses: the vertices on the legs are given and stay, those on the hypotenuse lie on it, and samples are
inserted greedily, the one that is farthest off first, until there are as many triangles as are wanted. Heights are
metres; columns and rows are samples from the window's first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.store.tin_windows import across, clipped, in_region, line_at, on_leg, place
from orograph.triangulation.constraints import fix_edge
from orograph.triangulation.deviation import FUZZ, facet_of, span, worst_crossing, worst_sample
from orograph.triangulation.heap import NOWHERE, Queue, put_in, take_out
from orograph.triangulation.mesh import (
    TRIANGLES,
    VERTICES,
    Mesh,
    after,
    before,
    insert,
    link,
    locate,
    make_delaunay,
    new_vertex,
    put,
    turn_of,
)

EXTRAS = 16
"""Room for ends of edges that are not on the lattice."""


class Work(NamedTuple):
    """Arrays that one thread works in.

    Attributes:
        mesh: of the triangulation. queue: its triangles. ids: (rows, cols) int32, the vertex at a sample of the window,
            −1: none. extras: (16, 3) int64, column, row and vertex of ends beside the lattice. stack: of flips.
    """

    mesh: Mesh
    queue: Queue
    ids: NDArray[np.int32]
    extras: NDArray[np.int64]
    stack: NDArray[np.int32]


def new_work(vertices: int, side: int) -> Work:
    """Room for so many vertices in windows of so many samples a side."""
    slots = 2 * vertices
    nowhere = np.lib.stride_tricks.as_strided(np.zeros(1, np.int32), (1 << 14, 1 << 14), (0, 0))
    mesh = Mesh(
        np.empty(vertices, np.int32), np.empty(vertices, np.int32), np.empty(vertices), np.empty(vertices, np.int32),
        np.empty(3 * slots, np.int32), np.empty(3 * slots, np.int32), np.empty(3 * slots, np.uint8),
        np.empty(slots, np.uint8), nowhere, np.array([0, 0, -1]),
    )  # fmt: skip
    queue = Queue(
        np.empty(slots), np.empty(slots, np.int32), np.empty(slots, np.int32), np.empty(slots, np.int32),
        np.full(slots, NOWHERE, np.int32), np.zeros(1, np.int64),
    )  # fmt: skip
    return Work(
        mesh, queue, np.empty((side, side), np.int32), np.empty((EXTRAS, 3), np.int64), np.empty(6 * slots, np.int32)
    )


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
    """Remember the vertex at a sample."""
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
        ends: (5, 2) float32, heights where edges begin and end on the raster.
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
    return np.nan  # (a corner of the window, beside the region)


@leaf
def add(w, work, heights, ends, x, y, t):
    """Make a sample a vertex unless it is one; a triangle near by."""
    if find(w, work, x, y) >= 0:
        return t
    v = insert(work.mesh, locate(work.mesh, t, x, y), x, y, height_at(w, heights, ends, x, y), work.stack)
    note(w, work, x, y, v)
    return work.mesh.out[v] // 3


@leaf
def start(w, work, heights, ends):
    """Two triangles over the window."""
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
    """Make a diamond's edge edges of the triangulation, from vertex to vertex; whether that could be."""
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
    """``fix_edge``, compiled by itself."""
    return fix_edge(m, a, b)


@kernel
def triangulate(w, work, heights, ends, marks):
    """The TINs whose vertices on the lattice are marked.

    In ``work.mesh.live`` triangles of the patch on one side of the hypotenuse are 1, of the other 2, beside them 0.

    Args:
        w, work: ``Window``, ``Work``. heights: (rows, cols) float32 of the window's samples. ends: see ``height_at``.
        marks: (rows, cols), not 0: a vertex.

    Returns: the number of triangles, −1 if edges are in each other's way, which is a fault.
    """
    m = work.mesh
    rows, cols = heights.shape
    work.ids[:rows, :cols] = -1
    work.extras[:] = -1
    start(w, work, heights, ends)
    t = np.int64(0)
    first = 1
    while 2 * first < max(rows, cols):
        first *= 2
    step = first
    while step:  # coarse ones first, so that few triangles are passed and flipped on the way
        for i in range(0, rows, step):
            for j in range(0, cols, step):
                if marks[i, j] and (step == first or (i | j) & step):
                    x, y = place(j, w.step, w.width), place(i, w.step, w.height)
                    if in_region(w, x, y):
                        t = add(w, work, heights, ends, x, y, t)
        step >>= 1
    good = True
    for edge in range(1 if w.shape == 0 else 5):
        ax, ay, dx, dy, low, high = clipped(w, edge)
        if low <= high:
            t = add(w, work, heights, ends, ax + low * dx, ay + low * dy, t)
            t = add(w, work, heights, ends, ax + high * dx, ay + high * dy, t)
    for edge in range(1 if w.shape == 0 else 5):
        good = fix(w, work, edge) and good
    make_delaunay(m)
    count = 0
    for u in range(m.counts[TRIANGLES]):
        a, b, c = m.corner[3 * u], m.corner[3 * u + 1], m.corner[3 * u + 2]
        x3, y3 = np.int64(m.x[a]) + m.x[b] + m.x[c], np.int64(m.y[a]) + m.y[b] + m.y[c]
        inside = w.shape == 0 or abs(x3 - 3 * w.cx) + abs(y3 - 3 * w.cy) < 3 * w.s
        m.live[u] = 0 if not inside else 1 if across(w, x3, y3, 3) < 0 else 2
        count += inside
    return count if good else -1


@leaf
def worst(w, m, heights, free, t):
    """The sample of the lattice that may be inserted and is farthest from a triangle: how far, its row and column."""
    a, b, c = m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2]
    x0, y0, x1, y1, x2, y2, z0, right, down, _ = facet_of(m, a, b, c)
    largest, at_i, at_j = -1.0, np.int64(0), np.int64(0)
    rows, cols = heights.shape
    i = (y0 + w.step - 1) // w.step
    while i < rows and place(i, w.step, w.height) <= y2:
        y = place(i, w.step, w.height)
        far = span(y, x0, y0, x2, y2)
        near = x1
        if y < y1 or (y1 == y2 and y1 != y0):
            near = span(y, x0, y0, x1, y1)
        elif y1 != y2:
            near = span(y, x1, y1, x2, y2)
        low, high = min(near, far) - FUZZ, max(near, far) + FUZZ
        plane = z0 + down * (y - y0) - right * x0
        j = np.int64(np.ceil(max(low, 0.0) / w.step))
        if j >= cols:
            j = cols - 1
        while j < cols:
            x = place(j, w.step, w.width)
            if x > high:
                break
            if free[i, j] and x >= low:
                off = abs(plane + right * x - heights[i, j])
                if off > largest:
                    largest, at_i, at_j = off, i, j
            j += 1
        i += 1
    return largest, at_i, at_j


@leaf
def assess(w, work, heights, free, t, limit):
    """Find the worst of a triangle, and put it into the heap if that is over the limit."""
    q = work.queue
    off, i, j = worst(w, work.mesh, heights, free, t)
    if off <= limit:
        take_out(q, t)
        return
    put_in(q, t, off, j, i)


@kernel
def simplify(w, work, heights, ends, marks, wanted, limit):
    """Mark more samples until there are as many triangles as are wanted, or all samples are within the limit.

    Args:
        w, work, heights, ends: as ``triangulate``. marks: uint8, the vertices on the legs; more are set here.
        wanted: triangles of a diamond of which nothing is beyond the raster. limit: metres.

    Returns: the number of triangles, −1 at a fault.
    """
    rows, cols = heights.shape
    m, q = work.mesh, work.queue
    free = np.zeros((rows, cols), np.uint8)
    for i in range(rows):
        y = place(i, w.step, w.height)
        for j in range(cols):
            x = place(j, w.step, w.width)
            if in_region(w, x, y) and not on_leg(w, x, y):
                sparse = (w.first_i + i) % w.sparse == 0 and (w.first_j + j) % w.sparse == 0
                free[i, j] = across(w, x, y, 1) != 0 or sparse
    count = triangulate(w, work, heights, ends, marks)
    if count < 0:
        return count
    q.size[0] = 0
    q.place[:] = NOWHERE
    area = np.int64(0)
    for t in range(m.counts[TRIANGLES]):
        if m.live[t]:
            assess(w, work, heights, free, t, limit)
            area += turn_of(m, m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2])
    wanted = np.int64(np.ceil(wanted * (area / ((8 if w.shape == 0 else 4) * w.s * w.s))))
    while q.size[0] and count < wanted and m.counts[VERTICES] + 4 < len(m.x):
        t = q.heap[0]
        i, j = q.y[t], q.x[t]
        before_ = m.counts[TRIANGLES]
        v = insert(m, t, place(j, w.step, w.width), place(i, w.step, w.height), np.float64(heights[i, j]), work.stack)
        marks[i, j], free[i, j] = 1, 0
        count += m.counts[TRIANGLES] - before_
        first = m.out[v]
        h = first
        while m.twin[before(h)] >= 0:  # to the outline, or once around
            h = m.twin[before(h)]
            if h == first:
                break
        first = h
        while True:
            if m.live[h // 3]:
                assess(w, work, heights, free, h // 3, limit)
            h = m.twin[h]
            if h < 0:
                break
            h = after(h)
            if h == first:
                break
    return count


@kernel
def deviation(m, heights):
    """The largest deviation of the patches from the surface: at samples, and where edges cross the surface's edges.

    Args:
        heights: float32 of all samples of the window, row by row.
    """
    largest = 0.0
    for t in range(m.counts[TRIANGLES]):
        if m.live[t]:
            off = worst_sample(heights, m, m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2])[0]
            largest = max(largest, off)
            for k in range(3):
                h = 3 * t + k
                if m.twin[h] < h or not m.live[m.twin[h] // 3]:
                    largest = max(largest, worst_crossing(heights, m, m.corner[h], m.corner[after(h)])[0])
    return largest


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


@kernel
def sizes(m):
    """The triangles of both patches, and those that full resolution has in their place."""
    first, second, area = 0, 0, np.int64(0)
    for t in range(m.counts[TRIANGLES]):
        if m.live[t]:
            first += m.live[t] == 1
            second += m.live[t] == 2
            area += turn_of(m, m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2])
    return first, second, area
