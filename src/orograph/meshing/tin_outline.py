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

Window = tuple[int, int, int, int]
"""First row, last row, first column, last column, the last ones included."""


def unit_triangles(heights: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which unit triangles of cells exist: (rows − 1, cols − 1, 2), first those on the cell's northern side.

    The first sample is an (even, even) one, or an (odd, odd) one.
    """
    valid = ~np.isnan(heights)
    nw, ne, sw, se = valid[:-1, :-1], valid[:-1, 1:], valid[1:, :-1], valid[1:, 1:]
    rows, cols = nw.shape
    main = (np.add.outer(np.arange(rows), np.arange(cols)) & 1) == 0
    return np.stack([nw & ne & np.where(main, se, sw), sw & se & np.where(main, nw, ne)], -1)


def edge_counts(units: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """How many existing unit triangles lie on each edge: (rows, cols, 4) by sample and kind of edge."""
    rows, cols = units.shape[0] + 1, units.shape[1] + 1
    counts = np.zeros((rows, cols, 4), np.uint8)
    main = (np.add.outer(np.arange(rows - 1), np.arange(cols - 1)) & 1) == 0
    first, second = units[..., 0], units[..., 1]
    west, east = np.where(main, second, first), np.where(main, first, second)
    counts[:-1, :-1, EAST] += first
    counts[1:, :-1, EAST] += second
    counts[:-1, :-1, SOUTH] += west
    counts[:-1, 1:, SOUTH] += east
    both = first.astype(np.uint8) + second
    counts[:-1, :-1, SOUTH_EAST] = np.where(main, both, 0)
    counts[:-1, 1:, SOUTH_WEST] = np.where(main, 0, both)
    return counts


def constraints(
    heights: NDArray[np.float32], inner: Window, limit: float, extra: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The vertices and edges that the TIN of a tile must have.

    Args:
        heights: (rows, cols) float32 of the tile and one sample around it, NaN beyond the raster; its first sample is
            an (even, even) or (odd, odd) one of the raster.
        inner: the tile in ``heights``.
        limit: maximum error of a run, metres.
        extra: (n, 2) columns and rows in the tile of samples on runs that must also be vertices.

    Returns:
        (n, 2) columns and rows of vertices in the tile, and (m, 4): column, row, column, row of the ends of edges.
    """
    counts = edge_counts(unit_triangles(heights))
    row0, row1, col0, col1 = inner
    outline = counts == 1
    forced = corners(outline)
    must = np.zeros(counts.shape, bool)
    tile = must[row0 : row1 + 1, col0 : col1 + 1]
    tile[:] = outline[row0 : row1 + 1, col0 : col1 + 1]
    tile[:, -1, [EAST, SOUTH_EAST]] = tile[-1, :, [SOUTH, SOUTH_EAST, SOUTH_WEST]] = tile[:, 0, SOUTH_WEST] = False
    touched = np.stack([outline[..., k] | reached(outline, k) for k in range(4)], -1)
    for row in (row0, row1):
        must[row, col0:col1, EAST] = counts[row, col0:col1, EAST] > 0
        forced[row, col0 : col1 + 1] |= touched[row, col0 : col1 + 1][:, [SOUTH, SOUTH_EAST, SOUTH_WEST]].any(-1)
    for col in (col0, col1):
        must[row0:row1, col, SOUTH] = counts[row0:row1, col, SOUTH] > 0
        forced[row0 : row1 + 1, col] |= touched[row0 : row1 + 1, col][:, [EAST, SOUTH_EAST, SOUTH_WEST]].any(-1)
    forced[[row0, row0, row1, row1], [col0, col1, col0, col1]] = True
    forced[extra[:, 1] + row0, extra[:, 0] + col0] = True
    edges = runs(heights, must, forced, limit)
    edges -= np.array([col0, row0, col0, row0])
    points = np.unique(edges.reshape(-1, 2), axis=0)
    return points, edges


def reached(outline: NDArray[np.bool_], kind: int) -> NDArray[np.bool_]:
    """Whether an edge of that kind ends at each sample."""
    ends = np.zeros(outline.shape[:2], bool)
    edges = outline[..., kind]
    if kind == EAST:
        ends[:, 1:] = edges[:, :-1]
    elif kind == SOUTH:
        ends[1:] = edges[:-1]
    elif kind == SOUTH_EAST:
        ends[1:, 1:] = edges[:-1, :-1]
    else:
        ends[1:, :-1] = edges[:-1, 1:]
    return ends


def corners(outline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples on outlines where these do not continue straight."""
    starts = outline.sum(-1)
    ends = sum(reached(outline, k).astype(np.int64) for k in range(4))
    straight = np.zeros(outline.shape[:2], bool)
    for k in range(4):
        straight |= outline[..., k] & reached(outline, k)
    found: NDArray[np.bool_] = (starts + ends > 0) & ~(straight & (starts + ends == 2))
    return found


@kernel
def runs(heights, must, forced, limit):
    """Cut the required edges into runs, simplify these, and list the result: (m, 4) int64."""
    rows, cols = heights.shape
    edges = np.empty((16, 4), np.int64)
    count = 0
    line, cost, origin = np.empty(rows + cols), np.empty(rows + cols, np.int64), np.empty(rows + cols, np.int64)
    for row in range(rows):
        for col in range(cols):
            for kind in range(4):
                if not must[row, col, kind]:
                    continue
                dx = 0 if kind == 1 else -1 if kind == 3 else 1
                dy = 0 if kind == 0 else 1
                x, y = col - dx, row - dy
                if not forced[row, col] and 0 <= x < cols and y >= 0 and must[y, x, kind]:
                    continue
                size, x, y = 1, col, row
                line[0] = heights[row, col]
                while must[y, x, kind] and (size == 1 or not forced[y, x]):
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
