"""The edges that a TIN of a tile must have: the tile's border and the outlines of holes, simplified in one dimension.

A border's vertices depend only on its own samples, and so do an outline's, so that tiles on both sides find the same
vertices independently. An outline is a chain of unit edges with ground on one side only (docs/architecture.md, *The
surface*); its samples are vertices where it turns, and each straight part between is a run, like each border between
two such samples. A run keeps the fewest samples with which the
polyline between them is within the bound of all others (Imai & Iri 1988, *Polygonal approximations of a curve*, for
vertical distances; all shortcuts from a sample are found in one sweep with a cone of slopes). Runs lie along grid lines
or the surface's diagonals, so the bound at the samples also holds between them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf

EAST, SOUTH, SOUTH_EAST, SOUTH_WEST = range(4)
"""Edges of the surface by the sample they start at (of its western end, for SOUTH_WEST the eastern one)."""

BITS = np.array([1, 2, 4, 8], np.uint8)
"""A bit for each kind of edge."""

Window = tuple[int, int, int, int]
"""First row, last row, first column, last column, the last ones included."""

STRAIGHT = (0, 0x11, 0x22, 0x44, 0x88)
"""``turns``' marks of samples at which no outline, or a single one, passes without a turn."""


@kernel
def unit_triangles(heights):
    """Which unit triangles of cells exist: (rows − 1, cols − 1, 2) bool, first those on the cell's northern side.

    The first sample is an (even, even) one, or an (odd, odd) one.
    """
    rows, cols = heights.shape
    units = np.empty((rows - 1, cols - 1, 2), np.bool_)
    for i in range(rows - 1):
        for j in range(cols - 1):
            nw, ne = not np.isnan(heights[i, j]), not np.isnan(heights[i, j + 1])
            sw, se = not np.isnan(heights[i + 1, j]), not np.isnan(heights[i + 1, j + 1])
            main = (i + j) & 1 == 0
            units[i, j, 0] = nw and ne and (se if main else sw)
            units[i, j, 1] = sw and se and (nw if main else ne)
    return units


@kernel
def edges_of(units):
    """Edges of the surface, as bits 1 << kind of the samples they start at: those of ground, and those of outlines.

    Both (rows, cols) uint8: edges of one existing unit triangle or two, and of one.
    """
    rows, cols = units.shape[0] + 1, units.shape[1] + 1
    ground, outline = np.zeros((rows, cols), np.uint8), np.zeros((rows, cols), np.uint8)
    for i in range(rows):
        for j in range(cols):
            odd = (i + j) & 1
            for kind in range(4):
                count = 0
                if kind == EAST and j < cols - 1:
                    count = (i < rows - 1 and units[i, j, 0]) + (i > 0 and units[i - 1, j, 1])
                elif kind == SOUTH and i < rows - 1:
                    count = (j < cols - 1 and units[i, j, 1 - odd]) + (j > 0 and units[i, j - 1, 1 - odd])
                elif kind == SOUTH_EAST and i < rows - 1 and j < cols - 1 and not odd:
                    count = np.int64(units[i, j, 0]) + units[i, j, 1]
                elif kind == SOUTH_WEST and i < rows - 1 and j > 0 and not odd:
                    count = np.int64(units[i, j - 1, 0]) + units[i, j - 1, 1]
                ground[i, j] |= (count > 0) << kind
                outline[i, j] |= (count == 1) << kind
    return ground, outline


@kernel
def turns(outline):
    """Outlines at each sample, (rows, cols) uint8: bits 1 << kind of edges that start there, 16 << kind that end."""
    rows, cols = outline.shape
    marks = outline.copy()
    for i in range(rows):
        for j in range(cols):
            if outline[i, j]:
                for kind in range(4):
                    if outline[i, j] >> kind & 1:
                        dx, dy = way_of(kind)
                        marks[i + dy, j + dx] |= 16 << kind
    return marks


@leaf
def way_of(kind):
    """Columns and rows from the start of an edge to its end."""
    return 0 if kind == SOUTH else -1 if kind == SOUTH_WEST else 1, 0 if kind == EAST else 1


def constraints(
    heights: NDArray[np.float32], units: NDArray[np.bool_], inner: Window, limit: float, extra: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The vertices and edges that the TIN of a tile must have.

    Args:
        heights: (rows, cols) float32 of the tile and one sample around it, NaN beyond the raster; its first sample is
            an (even, even) or (odd, odd) one of the raster.
        units: its ``unit_triangles``. inner: the tile in ``heights``.
        limit: maximum error of a run, metres.
        extra: (n, 2) columns and rows in the tile of samples on runs that must also be vertices.

    Returns:
        (n, 2) columns and rows of vertices in the tile, and (m, 4): column, row, column, row of the ends of edges.
    """
    ground, outline = edges_of(units)
    marks = turns(outline)
    row0, row1, col0, col1 = inner
    forced = ~np.isin(marks, STRAIGHT)
    must = np.zeros_like(outline)
    tile = must[row0 : row1 + 1, col0 : col1 + 1]
    tile[:] = outline[row0 : row1 + 1, col0 : col1 + 1]
    tile[:, -1] &= BITS[SOUTH] | BITS[SOUTH_WEST]
    tile[-1] &= BITS[EAST]
    tile[:, 0] &= ~BITS[SOUTH_WEST]
    touched = marks | marks >> 4
    for row in (row0, row1):
        must[row, col0:col1] |= ground[row, col0:col1] & BITS[EAST]
        forced[row, col0 : col1 + 1] |= touched[row, col0 : col1 + 1] & (15 ^ BITS[EAST]) > 0
    for col in (col0, col1):
        must[row0:row1, col] |= ground[row0:row1, col] & BITS[SOUTH]
        forced[row0 : row1 + 1, col] |= touched[row0 : row1 + 1, col] & (15 ^ BITS[SOUTH]) > 0
    forced[[row0, row0, row1, row1], [col0, col1, col0, col1]] = True
    forced[extra[:, 1] + row0, extra[:, 0] + col0] = True
    edges = runs(heights, must, forced, limit)
    edges -= np.array([col0, row0, col0, row0])
    points = np.unique(edges.reshape(-1, 2), axis=0)
    return points, edges


@kernel
def runs(heights, must, forced, limit):
    """Cut the required edges (bits, as ``edges_of``) into runs, simplify these, and list the result: (m, 4) int64."""
    rows, cols = heights.shape
    edges = np.empty((16, 4), np.int64)
    count = 0
    line, cost, origin = np.empty(rows + cols), np.empty(rows + cols, np.int64), np.empty(rows + cols, np.int64)
    for row in range(rows):
        for col in range(cols):
            if not must[row, col]:
                continue
            for kind in range(4):
                if not must[row, col] >> kind & 1:
                    continue
                dx, dy = way_of(kind)
                x, y = col - dx, row - dy
                if not forced[row, col] and 0 <= x < cols and y >= 0 and must[y, x] >> kind & 1:
                    continue
                size, x, y = 1, col, row
                line[0] = heights[row, col]
                while must[y, x] >> kind & 1 and (size == 1 or not forced[y, x]):
                    x, y = x + dx, y + dy
                    line[size] = heights[y, x]
                    size += 1
                simplify(line, size, limit, cost, origin)
                while count + size > len(edges):
                    larger = np.empty((2 * len(edges), 4), np.int64)
                    for e in range(count):
                        for k in range(4):
                            larger[e, k] = edges[e, k]
                    edges = larger
                end = size - 1
                while end > 0:
                    start = origin[end]
                    edges[count, 0], edges[count, 1] = col + start * dx, row + start * dy
                    edges[count, 2], edges[count, 3] = col + end * dx, row + end * dy
                    count += 1
                    end = start
    return edges[:count].copy()


@leaf
def simplify(line, size, limit, cost, origin):
    """The fewest samples of a line, from first to last, between which all others are within the limit.

    To list them, follow ``origin`` from the last one.
    """
    for i in range(size):
        cost[i] = size
    cost[0] = 0
    for i in range(size - 1):
        low, high = -np.inf, np.inf
        for j in range(i + 1, size):
            slope = (line[j] - line[i]) / (j - i)
            if low <= slope <= high and cost[i] + 1 < cost[j]:
                cost[j], origin[j] = cost[i] + 1, i
            low = max(low, (line[j] - limit - line[i]) / (j - i))
            high = min(high, (line[j] + limit - line[i]) / (j - i))
            if low > high:
                break
