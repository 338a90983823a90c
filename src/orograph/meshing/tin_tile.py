"""The TIN of one tile: its outlines, greedy insertion within them, and removal of unnecessary vertices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.meshing.tin_outline import Window, constraints, unit_triangles
from orograph.meshing.tin_reduce import reduce
from orograph.meshing.tin_refine import missed, refine, room_for
from orograph.triangulation.constraints import fix_edge
from orograph.triangulation.deviation import worst_crossing, worst_sample
from orograph.triangulation.mesh import (
    TRIANGLES,
    VERTICES,
    begin,
    insert,
    locate,
    make_delaunay,
    new_mesh,
)

NONE = np.empty((0, 2), np.int64)
"""No samples."""

NO_LINES = np.empty((0, 4), np.int64)
"""No edges."""

ROUNDING = 1e-9
"""Metres by which outlines stay below the bound, so that adjacent planes do not exceed it by rounding."""

LEAST_ERROR = 1e-7
"""Metres: a smaller bound counts as this one."""

BORDER = 0.7
"""The part of a bound on the surface that outlines keep. With coarser outlines it often cannot be kept, and tiles
are made again."""


class Tile(NamedTuple):
    """The TIN of a tile.

    Attributes:
        places: (v, 2) int32, columns and rows of its vertices in the tile. heights: (v,) float64, metres.
        triangles: (t, 3) int32, turning positively in (column, row).
        largest, at_samples: its largest error on the surface, and at samples, metres.
        missed: (n, 2) int64, columns and rows of samples on the tile's border that the bound on the surface requires.
        blocked: (n, 4) int64, edges (column, row, column, row) that it requires, and that break lines cross. If there
            are any, ``places`` are the vertices so far, and the rest is empty.
    """

    places: NDArray[np.int32]
    heights: NDArray[np.float64]
    triangles: NDArray[np.int32]
    largest: float
    at_samples: float
    missed: NDArray[np.int64] = NONE
    blocked: NDArray[np.int64] = NO_LINES


def tin_of_tile(
    heights: NDArray[np.float32], inner: Window, limit: float, surface: bool,
    extra: NDArray[np.int64] = NONE, start: NDArray[np.int64] = NONE, lines: NDArray[np.int64] = NO_LINES,
) -> Tile:  # fmt: skip
    """The TIN of a tile.

    Args:
        heights, inner, extra: as ``tin_outline.constraints``.
        limit: metres. surface: whether the bound is on the surface, or only at samples.
        start: (n, 2) columns and rows of vertices to begin with: those from an earlier round.
        lines: (n, 4) column, row, column, row of the ends of more edges that it must have (``tin_lines``); an edge
            without length is a vertex.
    """
    row0, row1, col0, col1 = inner
    window = np.ascontiguousarray(heights[row0 : row1 + 1, col0 : col1 + 1])
    limit = max(limit, LEAST_ERROR)
    around = unit_triangles(heights)
    units = around[row0:row1, col0:col1]
    if not units.any():
        return unfinished(NONE.astype(np.int32))
    m, w = new_mesh(*window.shape), room_for(*window.shape)
    points, edges = constraints(heights, around, inner, (BORDER if surface else 1.0) * limit - ROUNDING, extra)
    points = np.concatenate([points, lines.reshape(-1, 2)])
    begin(m, window)
    insert_all(m, window, points[in_order(points)])
    if not fix_all(m, np.concatenate([edges, lines[(lines[:, :2] != lines[:, 2:]).any(-1)]])):
        raise AssertionError("two edges that the TIN must have cross")
    make_delaunay(m)
    locked = int(m.counts[VERTICES])
    inside = (start > 0).all(-1) & (start[:, 0] < col1 - col0) & (start[:, 1] < row1 - row0)
    insert_all(m, window, start[inside][in_order(start[inside])])
    find_live(m, units, (row0 + col0) & 1)
    refine(m, window, w, limit, False)
    if surface:
        refine(m, window, w, limit, True)
        lacking, blocked = missed(m, window, limit)
        if len(lacking) or len(blocked):
            return unfinished(compact(m)[0], lacking, blocked)
    stay = np.zeros(m.counts[VERTICES], np.uint8)
    stay[:locked] = 1
    order = np.lexsort((m.x[: len(stay)], m.y[: len(stay)])).astype(np.int32)
    reduce(m, window, order, stay, limit, surface)
    places, z, triangles = compact(m)
    largest, at_samples = deviations(m, window)
    return Tile(places, z, triangles, largest, at_samples)


def unfinished(places: NDArray[np.int32], *why: NDArray[np.int64]) -> Tile:
    """A tile without triangles (yet)."""
    return Tile(places, np.empty(0), np.empty((0, 3), np.int32), 0.0, 0.0, *why)


def in_order(points: NDArray[np.int64]) -> NDArray[np.intp]:
    """Coarse ones first, so that few triangles are crossed and flipped."""
    both = points[:, 0] | points[:, 1]
    return np.lexsort((points[:, 0], points[:, 1], -(both & -both)))


@kernel
def insert_all(m, window, points):
    """Insert samples, some of which may already be vertices."""
    stack = np.empty(6 * len(points) + 64, np.int32)
    t = 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if m.at[y, x] < 0:
            t = locate(m, t, x, y)
            v = insert(m, t, x, y, np.float64(window[y, x]), stack)
            t = m.out[v] // 3


@kernel
def fix_all(m, edges):
    """Fix edges between vertices. Returns False if two of them cross."""
    for i in range(len(edges)):
        x, y, dx, dy = edges[i, 0], edges[i, 1], edges[i, 2] - edges[i, 0], edges[i, 3] - edges[i, 1]
        steps = max(np.gcd(dx, dy), 1)
        a = np.int64(m.at[y, x])
        for k in range(1, steps + 1):
            b = np.int64(m.at[y + k * dy // steps, x + k * dx // steps])
            if b >= 0:  # a vertex on the way splits the edge
                if not fix_edge(m, a, b):
                    return False
                a = b
    return True


@kernel
def find_live(m, units, parity):
    """Which triangles are on existing ground.

    The unit triangle at their centroid decides, because no triangle crosses an outline.
    """
    rows, cols = units.shape[0], units.shape[1]
    for t in range(m.counts[TRIANGLES]):
        a, b, c = m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2]
        x3, y3 = m.x[a] + m.x[b] + m.x[c], m.y[a] + m.y[b] + m.y[c]
        col, row = min(x3 // 3, cols - 1), min(y3 // 3, rows - 1)
        u, v = x3 - 3 * col, y3 - 3 * row
        north = v < u if ((row + col + parity) & 1) == 0 else u + v < 3
        m.live[t] = units[row, col, 0 if north else 1]


@kernel
def compact(m):
    """The vertices of live triangles, and these triangles, renumbered."""
    size, count = 0, 0
    number = np.full(m.counts[VERTICES], -1, np.int32)
    for t in range(m.counts[TRIANGLES]):
        if m.live[t] and m.corner[3 * t] >= 0:
            size += 1
            for k in range(3):
                v = m.corner[3 * t + k]
                if number[v] < 0:
                    number[v] = count
                    count += 1
    places, heights, triangles = np.empty((count, 2), np.int32), np.empty(count), np.empty((size, 3), np.int32)
    for v in range(len(number)):
        if number[v] >= 0:
            places[number[v], 0], places[number[v], 1], heights[number[v]] = m.x[v], m.y[v], m.z[v]
    size = 0
    for t in range(m.counts[TRIANGLES]):
        if m.live[t] and m.corner[3 * t] >= 0:
            for k in range(3):
                triangles[size, k] = number[m.corner[3 * t + k]]
            size += 1
    return places, heights, triangles


@kernel
def deviations(m, window):
    """The largest deviation on the surface, and at samples."""
    surface, samples = 0.0, 0.0
    for t in range(m.counts[TRIANGLES]):
        if m.live[t] and m.corner[3 * t] >= 0:
            a, b, c = m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2]
            samples = max(samples, worst_sample(window, m, a, b, c)[0])
            for k in range(3):
                h = 3 * t + k
                if m.twin[h] < h:
                    surface = max(surface, worst_crossing(window, m, m.corner[h], m.corner[3 * t + (k + 1) % 3])[0])
    return max(surface, samples), samples
