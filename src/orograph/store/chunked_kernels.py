"""Meshes of chunks as a walk over the binary tree of right triangles: written, and read back.

A chunk is a square of 2^p samples a side, cut along the hypotenuse of its central diamond into two right triangles.
The walk visits them depth first: the two halves of a split triangle come before what follows it. It records one code
per triangle. A vertex is new where the first of the two triangles at its hypotenuse is split.

*Codes*: ``DROPPED``, no ground; ``DRAWN``; ``SPLIT``, the next coarser level lacks the vertex; ``KEPT``, it has it.
*Levels* of a vertex: 0, its diamond has no ground; 1, no level has it; 2 + l, the levels 0 … l have it; 255, all.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel

DROPPED, DRAWN, SPLIT, KEPT = 0, 1, 2, 3


@inlined
def slot(slots, key):
    """The slot of a key in the hash table, or the free one where it belongs."""
    size = np.uint64(len(slots) - 1)
    at = (np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20) & size
    while slots[at, 0] != -1 and slots[at, 0] != key:
        at = (at + np.uint64(1)) & size
    return at


@inlined
def level_of(levels, places, row, col):
    """The levels of a vertex (see above); ``places``: (k, 3) the offset of each octave's table, and its shape."""
    both = row | col
    k = 0
    while k < len(places) - 1 and (both >> k) & 1 == 0:
        k += 1
    i, j = row >> k, col >> k
    if i >= places[k, 1] or j >= places[k, 2]:
        return 0
    return np.int64(levels[places[k, 0] + i * places[k, 2] + j])


@kernel
def write_walk(levels, places, corners, level, codes, found, known, slots):
    """Walk over a chunk's mesh.

    Args:
        levels, places: of all vertices (``level_of``). corners: (4, 2) int64, row and column: the apex of the first
            triangle, an end of the hypotenuse, the other triangle's apex, the other end. level: the chunk's.
        codes: (c,) uint8. found: (v, 2) int64, rows and columns of vertices but the corners. known: (v,) uint8, their
            levels. slots: (s, 2) int64, all −1, s a power of two. All are written to.

    Returns: the numbers of codes and vertices; the first is −1 if there is no room.
    """
    stack = np.empty((128, 6), np.int64)
    for k in range(2):
        a, b, c = (0, 1, 3) if k == 1 else (2, 3, 1)
        stack[k, 0], stack[k, 1] = corners[a, 0], corners[a, 1]
        stack[k, 2], stack[k, 3] = corners[b, 0], corners[b, 1]
        stack[k, 4], stack[k, 5] = corners[c, 0], corners[c, 1]
    top, count, vertices = 2, 0, 0
    while top:
        top -= 1
        ar, ac, lr, lc, rr, rc = stack[top]
        if count == len(codes) or vertices == len(found) or 2 * vertices >= len(slots):
            return -1, 0
        here = 1
        if max(abs(lr - rr), abs(lc - rc)) > 1:
            br, bc = (lr + rr) >> 1, (lc + rc) >> 1
            here = level_of(levels, places, br, bc)
            if here >= level + 2:
                key = br << 32 | bc
                at = slot(slots, key)
                if slots[at, 0] == -1:
                    slots[at, 0] = key
                    found[vertices, 0], found[vertices, 1], known[vertices] = br, bc, here
                    vertices += 1
                codes[count] = KEPT if here >= level + 3 else SPLIT
                count += 1
                _push(stack, top, br, bc, rr, rc, ar, ac)
                _push(stack, top + 1, br, bc, ar, ac, lr, lc)
                top += 2
                continue
        codes[count] = DRAWN if here else DROPPED
        count += 1
    return count, vertices


@inlined
def _push(stack, top, ar, ac, lr, lc, rr, rc):
    stack[top, 0], stack[top, 1], stack[top, 2] = ar, ac, lr
    stack[top, 3], stack[top, 4], stack[top, 5] = lc, rr, rc


@kernel
def read_walk(codes, heights, corners, coarse, last_row, last_col, places, vertices, targets, triangles, slots):
    """Rebuild the mesh that was walked over.

    Args:
        codes, corners: as written. heights: (v,) float32, of the corners and the vertices. coarse: (4,) of the corners
            in the next coarser level. last_row, last_col: of the raster; vertices beyond are moved onto it.
        places: (v, 2) int64, rows and columns, not squeezed. vertices: (v, 3) float64, column, row, metres. targets:
            (v,) float64, metres in the mesh of the next coarser level. triangles: (t, 3) int32, those that have an area
            and three heights. slots: (s, 2) int64, all −1. All are written to.

    Returns: the number of triangles.
    """
    for k in range(4):
        _put(places, vertices, k, corners[k, 0], corners[k, 1], heights, last_row, last_col)
        targets[k] = coarse[k]
    stack = np.empty((128, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 2, 3, 1
    stack[1, 0], stack[1, 1], stack[1, 2] = 0, 1, 3
    top, count, made = 2, 4, 0
    for n in range(len(codes)):
        top -= 1
        a, e, f = stack[top]
        code = codes[n]
        if code >= SPLIT:
            lr, lc, rr, rc = places[e, 0], places[e, 1], places[f, 0], places[f, 1]
            row, col = (lr + rr) >> 1, (lc + rc) >> 1
            at = slot(slots, row << 32 | col)
            if slots[at, 0] == -1:
                slots[at, 0], slots[at, 1] = row << 32 | col, count
                _put(places, vertices, count, row, col, heights, last_row, last_col)
                own = np.float64(heights[count])
                targets[count] = own
                if code == SPLIT:
                    targets[count] = middle(lr, lc, rr, rc, targets[e], targets[f], own, last_row, last_col)
                count += 1
            b = slots[at, 1]
            stack[top, 0], stack[top, 1], stack[top, 2] = b, f, a
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = b, a, e
            top += 2
        elif code == DRAWN and not np.isnan(heights[a] + heights[e] + heights[f]):
            u, v = vertices[e, 0] - vertices[a, 0], vertices[e, 1] - vertices[a, 1]
            x, y = vertices[f, 0] - vertices[a, 0], vertices[f, 1] - vertices[a, 1]
            if u * y != v * x:
                triangles[made, 0], triangles[made, 1], triangles[made, 2] = a, e, f
                made += 1
    return made


@inlined
def _put(places, vertices, at, row, col, heights, last_row, last_col):
    places[at, 0], places[at, 1] = row, col
    vertices[at, 0], vertices[at, 1] = min(col, last_col), min(row, last_row)
    vertices[at, 2] = heights[at]


@kernel
def middle(lr, lc, rr, rc, left, right, own, last_row, last_col):
    """The height of a vertex on the edge between two others, any of which may be squeezed onto the raster's border.

    It is its own height if squeezing takes it off their edge.
    """
    if max(lr, rr) <= last_row and max(lc, rc) <= last_col:
        return (left + right) / 2
    if lr == rr:
        return _between(lc, rc, left, right, own, last_col)
    if lc == rc:
        return _between(lr, rr, left, right, own, last_row)
    return own


@inlined
def _between(a, b, left, right, own, last):
    at, a, b = min((a + b) >> 1, last), min(a, last), min(b, last)
    return own if a == b else left + (right - left) * (at - a) / (b - a)


@kernel
def lowest(at, heights, known, line, ends, level, reach, result):
    """Find how low a side's skirt has to reach at each of its vertices, so that no neighbour's edge lies below it.

    Args:
        at: (v,) int64, the vertices' positions along the side, rising, in samples from its first corner; they include
            both corners. heights, known: (v,) their heights and levels. line: (s,) float32, full resolution
            along the side; beyond the raster, its last sample is repeated. ends: (reach, 2) heights of the corners
            in the meshes of the levels above. level: the chunk's. reach: the number of levels above.
        result: (v,) float32, written to; NaN where nothing is known.
    """
    count, last = len(at), len(line) - 1
    mesh, bits = np.empty(count), at & -at
    order = np.argsort(-bits, kind="mergesort")
    for v in range(count):
        result[v] = heights[v]
    for m in range(reach):
        mesh[0], mesh[count - 1] = ends[m, 0], ends[m, 1]
        for v in order:
            if v == 0 or v == count - 1:
                continue
            mesh[v] = heights[v]
            if known[v] < level + 3 + m:
                a, b = at[v] - bits[v], at[v] + bits[v]
                left, right = mesh[np.searchsorted(at, a)], mesh[np.searchsorted(at, b)]
                mesh[v] = _between(a, b, left, right, mesh[v], last)
        for v in range(count):
            result[v] = np.fmin(result[v], np.float32(mesh[v]))
    own = result.copy()
    for v in range(count - 1):
        low = np.fmin(own[v], own[v + 1])
        for t in range(min(at[v], last), min(at[v + 1], last) + 1):
            low = np.fmin(low, line[t])
        result[v], result[v + 1] = np.fmin(result[v], low), np.fmin(result[v + 1], low)
