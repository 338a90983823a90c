"""The overlay of two triangulations of one region: all edges of both, and the heights that either has everywhere.

A vertex of it is one of either mesh, or the crossing of an edge of each. Triangle by triangle of one mesh is cut by
those of the other (Sutherland & Hodgman 1974); the convex pieces are made triangles as fans. Vertices of the meshes are
integers, so on which side of an edge one lies is told exactly, and for a crossing too: with a, b the signed areas at
the ends of the edge that it is on, it divides that as a : −b, and what else is linear along the edge has the sign of a
determinant of areas. Crossings are named by the two edges, so all pieces around one have the same vertex: no
T-junction, whatever is rounded. Its place and heights are rounded once, by rules that ask only for the edge itself,
so that regions which touch agree on the edge that they share. Samples, metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf

MOST = 16
"""Corners of a piece, which two triangles make, at most (six, and room)."""

CORNER, CROSSING = 3, 6
"""A corner of a piece is a corner of the triangle that is cut (0 … 2), of the one that cuts (3 … 5), or the crossing of
edge i of the one with edge j of the other (6 + 3 i + j). Its edges are of the one (0 … 2) or the other (3 … 5)."""


class Flat(NamedTuple):
    """A triangulation in the plane.

    Attributes:
        x, y: int64 (v,). z: float64 (v,). corners: int32 (t, 3), which turn positively in (x, y).
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    z: NDArray[np.float64]
    corners: NDArray[np.int32]


@inlined
def _area(m, a, b, x, y):
    """Twice the signed area of a place and an edge: positive to its left."""
    return (m.x[b] - m.x[a]) * (y - m.y[a]) - (m.y[b] - m.y[a]) * (x - m.x[a])


@inlined
def _ordered(m, a, b):
    """The ends of an edge, as whoever has it orders them."""
    return (a, b) if m.y[a] < m.y[b] or (m.y[a] == m.y[b] and m.x[a] < m.x[b]) else (b, a)


@inlined
def _between(m, a, b, part):
    """The height of an edge from a to b, which are ordered."""
    return m.z[a] + part * (m.z[b] - m.z[a])


@leaf
def height_in(m, t, x, y):
    """The height of a triangle at a place in it; on an edge that is the edge's own."""
    for k in range(3):
        a, b = _ordered(m, m.corners[t, k], m.corners[t, (k + 1) % 3])
        if _area(m, a, b, x, y) == 0:
            long = max(abs(m.x[b] - m.x[a]), abs(m.y[b] - m.y[a]))
            gone = max(abs(x - m.x[a]), abs(y - m.y[a]))
            return _between(m, a, b, gone / long)
    a, b, c = m.corners[t, 0], m.corners[t, 1], m.corners[t, 2]
    whole = np.float64(_area(m, a, b, m.x[c], m.y[c]))
    u, v = _area(m, c, a, x, y) / whole, _area(m, a, b, x, y) / whole
    return m.z[a] + u * (m.z[b] - m.z[a]) + v * (m.z[c] - m.z[a])


@inlined
def _side(code, j, areas, beside):
    """On which side of edge j of the cutting triangle a corner of a piece is.

    Args:
        areas: int64 (3, 3), [j, i] of edge j and corner i of the one that is cut. beside: > 0.
    """
    if code < CORNER:
        return areas[j, code]
    if code < CROSSING:
        k = code - CORNER
        return np.int64(0) if k == j or k == (j + 1) % 3 else beside
    i, k = (code - CROSSING) // 3, (code - CROSSING) % 3
    n = (i + 1) % 3
    a, b = areas[k, i], areas[k, n]
    found = areas[j, n] * a - areas[j, i] * b
    return found if a > b else -found


@inlined
def _new(edge, j, backs):
    """The corner where an edge of a piece crosses edge j of the cutting triangle.

    Args:
        backs: int64 (3, 3), [i, k] of edge i of the triangle that is cut and corner k of the other.
    """
    if edge >= 3:
        k = edge - 3  # (two edges of one triangle: their corner)
        return np.int64(CORNER + (j if (k + 1) % 3 == j else k))
    n = (j + 1) % 3
    if backs[edge, j] == 0:
        return np.int64(CORNER + j)
    if backs[edge, n] == 0:
        return np.int64(CORNER + n)
    return np.int64(CROSSING + 3 * edge + j)


@leaf
def cut(areas, backs, beside, codes, edges, others, more):
    """Cut a triangle by another one; how many corners the piece has (in ``codes``; fewer than 3: there is none).

    Args:
        areas, backs, beside: see ``_side``, ``_new``. codes, edges, others, more: int64 (MOST,) to work in.
    """
    count = np.int64(3)
    for k in range(3):
        codes[k] = edges[k] = k
    for j in range(3):
        size = np.int64(0)
        for k in range(count):
            n = k + 1 if k + 1 < count else 0
            here, following = _side(codes[k], j, areas, beside), _side(codes[n], j, areas, beside)
            if here >= 0:
                others[size], more[size] = codes[k], edges[k] if following >= 0 or here > 0 else j + 3
                size += 1
            if (here > 0 and following < 0) or (here < 0 and following > 0):
                others[size], more[size] = _new(edges[k], j, backs), j + 3 if here > 0 else edges[k]
                size += 1
        for k in range(size):
            codes[k], edges[k] = others[k], more[k]
        count = size
        if count < 3:
            return count
    return count


@leaf
def vertex_of(key, table, keys, count):
    """(the number of the vertex of a key, whether it is new)."""
    size = np.uint64(len(table) - 1)
    at = (np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(24) & size
    while table[at] >= 0:
        if keys[table[at]] == key:
            return np.int64(table[at]), False
        at = (at + np.uint64(1)) & size
    table[at] = count
    keys[count] = key
    return np.int64(count), True


@leaf
def box_of(m, t, box):
    """Write the least and largest x and y of a triangle."""
    a, b, c = m.corners[t, 0], m.corners[t, 1], m.corners[t, 2]
    box[0], box[1] = min(m.x[a], min(m.x[b], m.x[c])), max(m.x[a], max(m.x[b], m.x[c]))
    box[2], box[3] = min(m.y[a], min(m.y[b], m.y[c])), max(m.y[a], max(m.y[b], m.y[c]))


@leaf
def name_of(fine, coarse, same, f, t, code):
    """What the corner of a piece of triangles f and t is, whichever piece has it: a number."""
    if code < CORNER:
        return np.int64(fine.corners[f, code])
    if code < CROSSING:
        u = np.int64(coarse.corners[t, code - CORNER])
        return same[u] if same[u] >= 0 else u | 1 << 20
    i, j = (code - CROSSING) // 3, (code - CROSSING) % 3
    p, q = _ordered(fine, np.int64(fine.corners[f, i]), np.int64(fine.corners[f, (i + 1) % 3]))
    u, v = _ordered(coarse, np.int64(coarse.corners[t, j]), np.int64(coarse.corners[t, (j + 1) % 3]))
    return 1 << 62 | p << 45 | q << 30 | u << 15 | v


@leaf
def place_of(fine, coarse, f, t, code, fraction, vertex):
    """Write where the corner of a piece is, and both heights there."""
    if code < CORNER:
        p = fine.corners[f, code]
        vertex[0], vertex[1], vertex[2] = fine.x[p], fine.y[p], fine.z[p]
        vertex[3] = height_in(coarse, t, fine.x[p], fine.y[p])
    elif code < CROSSING:
        u = coarse.corners[t, code - CORNER]
        vertex[0], vertex[1], vertex[3] = coarse.x[u], coarse.y[u], coarse.z[u]
        vertex[2] = height_in(fine, f, coarse.x[u], coarse.y[u])
    else:
        i, j = (code - CROSSING) // 3, (code - CROSSING) % 3
        p, q = _ordered(fine, fine.corners[f, i], fine.corners[f, (i + 1) % 3])
        u, v = _ordered(coarse, coarse.corners[t, j], coarse.corners[t, (j + 1) % 3])
        at, end = _area(coarse, u, v, fine.x[p], fine.y[p]), _area(coarse, u, v, fine.x[q], fine.y[q])
        part = at / np.float64(at - end)
        vertex[0] = np.rint((fine.x[p] + part * (fine.x[q] - fine.x[p])) * fraction) / fraction
        vertex[1] = np.rint((fine.y[p] + part * (fine.y[q] - fine.y[p])) * fraction) / fraction
        vertex[2] = _between(fine, p, q, part)
        at, end = _area(fine, p, q, coarse.x[u], coarse.y[u]), _area(fine, p, q, coarse.x[v], coarse.y[v])
        vertex[3] = _between(coarse, u, v, at / np.float64(at - end))


@kernel
def overlay(fine, coarse, fraction, table, keys, vertices, triangles):
    """The overlay of two triangulations of one region.

    Args:
        fine, coarse: ``Flat``, of fewer than 2^15 vertices each. fraction: crossings are moved to multiples of 1 over
            it. table: int32 (2^m,), −1. keys: int64 (2^(m−1),).
        vertices: float64 (2^(m−1), 4), filled: x, y, the heights of ``fine`` and of ``coarse``.
        triangles: int32 (2^m, 3), filled.

    Returns: vertices and triangles; −1, −1 if there was no room.
    """
    count, made = np.int64(0), np.int64(0)
    areas, backs = np.empty((3, 3), np.int64), np.empty((3, 3), np.int64)
    codes, edges = np.empty(MOST, np.int64), np.empty(MOST, np.int64)
    others, more = np.empty(MOST, np.int64), np.empty(MOST, np.int64)
    same = np.full(len(coarse.x), -1, np.int64)  # the vertex of the fine mesh at one of the coarse
    order = np.argsort(fine.y << 32 | fine.x)
    places = (fine.y << 32 | fine.x)[order]
    for v in range(len(coarse.x)):
        at = np.searchsorted(places, coarse.y[v] << 32 | coarse.x[v])
        if at < len(places) and places[at] == coarse.y[v] << 32 | coarse.x[v]:
            same[v] = order[at]
    boxes, box = np.empty((len(coarse.corners), 4), np.int64), np.empty(4, np.int64)
    for t in range(len(coarse.corners)):
        box_of(coarse, t, boxes[t])
    for f in range(len(fine.corners)):
        box_of(fine, f, box)
        for t in range(len(coarse.corners)):
            if boxes[t, 0] >= box[1] or boxes[t, 1] <= box[0] or boxes[t, 2] >= box[3] or boxes[t, 3] <= box[2]:
                continue
            for j in range(3):
                u, v = coarse.corners[t, j], coarse.corners[t, (j + 1) % 3]
                p, q = fine.corners[f, j], fine.corners[f, (j + 1) % 3]
                for i in range(3):
                    areas[j, i] = _area(coarse, u, v, fine.x[fine.corners[f, i]], fine.y[fine.corners[f, i]])
                    backs[j, i] = _area(fine, p, q, coarse.x[coarse.corners[t, i]], coarse.y[coarse.corners[t, i]])
            a, b, c = coarse.corners[t, 0], coarse.corners[t, 1], coarse.corners[t, 2]
            size = cut(areas, backs, _area(coarse, a, b, coarse.x[c], coarse.y[c]), codes, edges, others, more)
            if size < 3:
                continue
            if count + size > len(keys) or made + size > len(triangles):
                return np.int64(-1), np.int64(-1)
            for k in range(size):
                others[k], new = vertex_of(name_of(fine, coarse, same, f, t, codes[k]), table, keys, count)
                if new:
                    place_of(fine, coarse, f, t, codes[k], fraction, vertices[count])
                    count += 1
            for k in range(1, size - 1):
                triangles[made, 0], triangles[made, 1], triangles[made, 2] = others[0], others[k], others[k + 1]
                made += 1
    return count, made


def overlaid(fine: Flat, coarse: Flat, fraction: float) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The overlay of two triangulations of one region, of fewer than 2^15 vertices each.

    Args:
        fraction: a power of two; crossings are moved to multiples of 1 over it.

    Returns: (v, 4) x, y, the heights of ``fine`` and of ``coarse``; (t, 3), which turn positively.
    """
    exponent = max(10, int(8 * (len(fine.x) + len(coarse.x))).bit_length())
    while True:
        size = 1 << exponent
        vertices, triangles = np.empty((size >> 1, 4)), np.empty((size, 3), np.int32)
        table, keys = np.full(size, -1, np.int32), np.empty(size >> 1, np.int64)
        count, made = overlay(fine, coarse, fraction, table, keys, vertices, triangles)
        if count >= 0:
            return vertices[:count].copy(), triangles[:made].copy()
        exponent += 1
