"""The TINs of one diamond: two patches of the hierarchy whose vertices are chosen among the samples of a lattice.

A *window* is the part of a lattice of every ``step``-th sample that holds the diamond's region, cut by the raster's
last row and column, which belong to every lattice. Which of its samples are vertices is all that makes a TIN: they are
triangulated in a fixed order, constrained Delaunay, so that whoever triangulates them gets the same triangles. The five
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

from orograph._numba import inlined, kernel, leaf
from orograph.triangulation.deviation import FUZZ, span, worst_crossing, worst_sample
from orograph.triangulation.heap import NOWHERE, Queue, sift, take_out
from orograph.triangulation.mesh import (
    TRIANGLES,
    VERTICES,
    Mesh,
    after,
    before,
    fix_edge,
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


class Window(NamedTuple):
    """Where a diamond is.

    Attributes:
        cx, cy: its vertex. s: its extent along an axis. shape: 0 a square, 1 an edge (``hierarchy.diamonds.kind``).
        axis: which way its hypotenuse runs (``hierarchy.triangles.axis``).
        width, height: the window's last column and row. step: between samples of the lattice.
        sparse: how many steps apart samples on the hypotenuse may be vertices. first_i, first_j: the lattice's row and
            column, counted from the raster's, of the window's first.
    """

    cx: int
    cy: int
    s: int
    shape: int
    axis: int
    width: int
    height: int
    step: int
    sparse: int
    first_i: int
    first_j: int


class Work(NamedTuple):
    """Arrays that one thread works in.

    Attributes:
        mesh: of the triangulation. queue: its triangles. ids: (rows, cols) int32, the vertex at a sample of the window,
            −1: none. extras: (16, 3) int64, column, row and vertex of ends that are not on the lattice. stack: of flips.
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


@inlined
def place(index, step, last):
    """The column or row of a line of the lattice."""
    return min(index * step, last)


@inlined
def line_at(at, step, last):
    """The line of the lattice at a column or row, −1: none."""
    if at % step == 0:
        return at // step
    return last // step + 1 if at == last else np.int64(-1)


@leaf
def region_corner(w, k):
    """The corners of a diamond: the ends of its hypotenuse (k = 0, 1), the apexes of its patches (2, 3)."""
    s, sign = w.s, 1 - 2 * (k & 1)
    if w.shape == 1:
        along = (w.axis == 2) == (k < 2)
        return (w.cx + sign * s, w.cy) if along else (w.cx, w.cy + sign * s)
    falling = (w.axis == 3) == (k < 2)
    return (w.cx + sign * s, w.cy + sign * s) if falling else (w.cx + sign * s, w.cy - sign * s)


@leaf
def clipped(w, edge):
    """An edge of a diamond on the raster: column and row where it begins, its direction, first and last step.

    Edge 0 is the hypotenuse, 1 … 4 are the legs. The first step is after the last if none of it is on the raster.
    """
    a = 0 if edge == 0 else (edge - 1) & 1
    b = 1 if edge == 0 else 2 + ((edge - 1) >> 1)
    ax, ay = region_corner(w, a)
    bx, by = region_corner(w, b)
    long = max(abs(bx - ax), abs(by - ay))
    dx, dy = (bx - ax) // long, (by - ay) // long
    low, high = np.int64(0), np.int64(long)
    for way in range(2):
        at, d, last = (ax, dx, w.width) if way == 0 else (ay, dy, w.height)
        if d == 0:
            if at < 0 or at > last:
                high = np.int64(-1)
        elif d > 0:
            low, high = max(low, -at), min(high, last - at)
        else:
            low, high = max(low, at - last), min(high, at)
    return ax, ay, dx, dy, low, high


@inlined
def in_region(w, x, y):
    """Whether a sample is in the closed region of a diamond (of a square one all of the window is)."""
    return w.shape == 0 or abs(x - w.cx) + abs(y - w.cy) <= w.s


@leaf
def across(w, x, y, times):
    """On which side of the hypotenuse a place is, given so many times: negative on that of top triangle 0, 0 on it."""
    dx, dy = x - times * w.cx, y - times * w.cy
    if w.axis == 0:
        return dx
    if w.axis == 2:
        return dy
    return dy - dx if w.axis == 3 else dx + dy


@leaf
def on_leg(w, x, y):
    """Whether a sample in the region lies on a leg."""
    if w.shape == 1:
        return abs(x - w.cx) + abs(y - w.cy) == w.s
    return abs(x - w.cx) == w.s or abs(y - w.cy) == w.s


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


@kernel
def legs_of(w, source, ratio, bit, marks):
    """Mark the vertices on a diamond's legs: those on the hypotenuses of its children.

    Args:
        source: uint8, the marks of the children's lattice, all of the raster; ratio: steps of it along one of this one;
            bit: of their kind, 0: all samples are vertices.
    """
    rows, cols = marks.shape
    last_i, last_j = source.shape[0] - 1, source.shape[1] - 1
    for i in range(rows):
        y = place(i, w.step, w.height)
        for j in range(cols):
            x = place(j, w.step, w.width)
            if in_region(w, x, y) and on_leg(w, x, y):
                corner = x == w.cx or y == w.cy if w.shape == 1 else abs(x - w.cx) == w.s and abs(y - w.cy) == w.s
                given = source[min((w.first_i + i) * ratio, last_i), min((w.first_j + j) * ratio, last_j)] & bit
                marks[i, j] = bit == 0 or corner or given != 0


@kernel
def look(heights, row0, rows, cols, s, fill, metric):
    """Samples that are there and that are missing in the regions of edge diamonds, and the squared radii around them.

    Args:
        heights: (h, w) float32, rows of the raster from row0 on, all columns. rows, cols: (d,) of the diamonds, s: their
            extent. fill: (d,) heights of vertices that are missing. metric: (4,) metres of a column's step (x, y) and a
            row's.

    Returns: (d, 2) int64 counts, (d,) float64.
    """
    count, found = np.zeros((len(rows), 2), np.int64), np.zeros(len(rows))
    high, wide = heights.shape
    for d in range(len(rows)):
        last = row0 + high - 1
        cy, cx = min(rows[d], last), min(cols[d], wide - 1)
        z = np.float64(heights[cy - row0, cx])
        if np.isnan(z):
            z = fill[d]
        for y in range(max(rows[d] - s, row0), min(rows[d] + s, last) + 1):
            reach = s - abs(y - rows[d])
            for x in range(max(cols[d] - reach, 0), min(cols[d] + reach, wide - 1) + 1):
                off = heights[y - row0, x] - z
                if np.isnan(off):
                    count[d, 1] += 1
                    continue
                count[d, 0] += 1
                u, v = x - cx, y - cy
                east, north = metric[0] * u + metric[2] * v, metric[1] * u + metric[3] * v
                found[d] = max(found[d], east * east + north * north + off * off)
    return count, found


@leaf
def worst(w, m, heights, free, t):
    """The sample of the lattice that may be inserted and is farthest from a triangle: how far, its row and column."""
    a, b, c = m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2]
    if m.y[b] < m.y[a]:
        a, b = b, a
    if m.y[c] < m.y[a]:
        a, c = c, a
    if m.y[c] < m.y[b]:
        b, c = c, b
    x0, y0, x1, y1, x2, y2 = (
        np.float64(m.x[a]), np.int64(m.y[a]), np.float64(m.x[b]), np.int64(m.y[b]), np.float64(m.x[c]), np.int64(m.y[c])
    )  # fmt: skip
    z0, z1, z2 = m.z[a], m.z[b], m.z[c]
    det = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    across_, down = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / det, ((x1 - x0) * (z2 - z0) - (x2 - x0) * (z1 - z0)) / det
    largest, at_i, at_j = -1.0, np.int64(0), np.int64(0)
    rows, cols = heights.shape
    i = (y0 + w.step - 1) // w.step
    while i < rows and place(i, w.step, w.height) <= y2:
        y = place(i, w.step, w.height)
        far = span(y, x0, y0, x2, y2)
        near = span(y, x0, y0, x1, y1) if (y < y1 or y1 == y2) and y1 != y0 else span(y, x1, y1, x2, y2) if y1 != y2 else x1
        low, high = min(near, far) - FUZZ, max(near, far) + FUZZ
        plane = z0 + down * (y - y0) - across_ * x0
        j = np.int64(np.ceil(max(low, 0.0) / w.step))
        if j >= cols:
            j = cols - 1
        while j < cols:
            x = place(j, w.step, w.width)
            if x > high:
                break
            if free[i, j] and x >= low:
                off = abs(plane + across_ * x - heights[i, j])
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
    q.error[t], q.x[t], q.y[t] = off, j, i
    if q.place[t] == NOWHERE:
        q.heap[q.size[0]] = t
        q.place[t] = q.size[0]
        q.size[0] += 1
    sift(q, q.place[t])


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
            largest = max(largest, worst_sample(heights, m, m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2])[0])
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
