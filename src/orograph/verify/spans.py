"""Triangles row by row: those of a band, from west to east, and the span of each in a row of samples.

A band's triangles are found by counting, kept as a table of integers (``strips``) with their planes, and sorted by
their position in a strip. Heights are metres, float64; everything else is integers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.verify.strips import BEND, C0, C1, C2, R0, R1, R2, ceiling, compare, extent, order, sides

Ints = NDArray[np.int64]


class Corners(NamedTuple):
    """The triangles of a mesh.

    Attributes:
        triangles: (m, 3) int32.
        vertices: (n, 3) float64, column, row, height.
        x, y: (n,) int64, columns and rows in ticks.
        shift: 2^shift ticks to a cell.
    """

    triangles: NDArray[np.int32]
    vertices: NDArray[np.float64]
    x: NDArray[np.int64]
    y: NDArray[np.int64]
    shift: int


def bucket(corners: Corners, signs: NDArray[np.int8], size: int, bands: int) -> tuple[Ints, Ints]:
    """The triangles with area that touch each band of ``size`` rows or the row below it.

    Returns:
        (start (bands + 1,), members): band b's are ``members[start[b]:start[b + 1]]``, ordered by the cell of their
        first corner, by row, then column.
    """
    top, left, bottom = np.empty((3, len(corners.triangles)), np.int64)
    find_cells(corners, top, left, bottom)
    order = _by(top, _by(left, np.flatnonzero(signs)))
    first, last = np.maximum(top - 1, 0) // size, bottom // size
    begun, ended = (np.bincount(band[order] + k, minlength=bands + 1) for k, band in enumerate((first, last)))
    start = np.zeros(bands + 1, np.int64)
    np.cumsum(np.cumsum(begun - ended)[:bands], out=start[1:])
    members = np.empty(start[-1], np.int64)
    distribute(order, first, last, start[:-1].copy(), members)
    return start, members


@leaf
def find_cells(corners, top, left, bottom):
    """Fill in the row and column of the cell of each triangle's first corner, and the row of its last."""
    triangles, shift = corners.triangles, corners.shift
    for t in range(triangles.shape[0]):
        top[t], left[t], bottom[t] = np.int64(1) << 62, 0, 0
        for k in range(3):
            row, column = corners.y[triangles[t, k]] >> shift, corners.x[triangles[t, k]] >> shift
            if row < top[t] or (row == top[t] and column < left[t]):
                top[t], left[t] = row, column
            bottom[t] = max(bottom[t], row)


def _by(values: Ints, indices: Ints) -> Ints:
    """Indices sorted by their values, which are small, in a stable order."""
    start, result = np.zeros(values.max(initial=0) + 2, np.int64), np.empty_like(indices)
    start[1:] = np.cumsum(np.bincount(values[indices], minlength=len(start) - 1))
    distribute(indices, values, values, start, result)
    return result


@leaf
def distribute(indices, first, last, fill, result):
    """Put each index i into the groups first[i] … last[i]; ``fill`` is where the next one of each group goes."""
    for i in indices:
        for group in range(first[i], last[i] + 1):
            result[fill[group]] = i
            fill[group] += 1


@inlined
def west_of(table, k, j, y0, y1):
    """Whether triangle k's west side lies west of j's in the middle of the strip [y0, y1]."""
    kn, kstep, kd, _, _, _ = sides(table, k, y0, y1)
    jn, jstep, jd, _, _, _ = sides(table, j, y0, y1)
    return compare(2 * kn + kstep, kd, 2 * jn + jstep, jd) < 0.0


GAPS = (1050113, 262913, 65921, 16577, 4193, 1073, 281, 77, 23, 8, 1)
"""Gaps of Shellsort, 4^k + 3·2^(k−1) + 1: O(n^4/3) steps (Sedgewick 1986). NumPy's sorts take a second to compile."""


@leaf
def sort_by(keys, items, count):
    """Shellsort of the first ``count`` keys, together with their items."""
    for gap in GAPS:
        for i in range(gap, count):
            key, item, j = keys[i], items[i], i
            while j >= gap and keys[j - gap] > key:
                keys[j], items[j] = keys[j - gap], items[j - gap]
                j -= gap
            keys[j], items[j] = key, item


@leaf
def sort_west_to_east(table, active, begin, end, y0, y1):
    """Insertion sort of ``active[begin:end]``, exact; fast if the order is nearly right."""
    for i in range(begin + 1, end):
        k, j = active[i], i
        while j > begin and west_of(table, k, active[j - 1], y0, y1):
            active[j] = active[j - 1]
            j -= 1
        active[j] = k


@leaf
def tabulate(corners, members, table, planes):
    """Fill the table of the members' triangles (``strips``), (k, 7) int64, and that of their planes, (k, 5) float64.

    A plane is the height at the first corner, its slopes along columns and rows, and the column and row of that corner.
    """
    triangles, x, y, vertices = corners.triangles, corners.x, corners.y, corners.vertices
    for k in range(members.shape[0]):
        t = members[k]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        order(x, y, a, b, c, table, k)
        if x[b] == table[k, C0] and y[b] == table[k, R0]:
            a, b = b, a
        elif x[c] == table[k, C0] and y[c] == table[k, R0]:
            a, c = c, a
        bx, by = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
        cx, cy = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1]
        bz, cz = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        area = bx * cy - cx * by
        planes[k, 0] = vertices[a, 2]
        planes[k, 1], planes[k, 2] = (bz * cy - cz * by) / area, (cz * bx - bz * cx) / area
        planes[k, 3], planes[k, 4] = vertices[a, 0], vertices[a, 1]


@leaf
def span_row(table, planes, k, row, shift, west, lowest, highest):
    """Update the mesh's extremes at the samples of a row that triangle k spans."""
    wn, wd, en, ed = extent(table, k, row << shift)
    first = max((ceiling(wn, wd) + (1 << shift) - 1) >> shift, west)
    last = min((en // ed) >> shift, west + lowest.shape[0] - 1)
    base = planes[k, 0] + planes[k, 2] * (row - planes[k, 4])
    slope, from_column = planes[k, 1], planes[k, 3]
    for c in range(first, last + 1):
        z = base + slope * (c - from_column)
        if z < lowest[c - west]:
            lowest[c - west] = z
        if z > highest[c - west]:
            highest[c - west] = z


@leaf
def find_junctions(table, k, y, line, junctions):
    """Flag the vertices of a row of ticks that lie inside an edge of triangle k."""
    r0, r1, r2 = table[k, R0], table[k, R1], table[k, R2]
    if r0 < y < r2:
        wn, wd, en, ed = extent(table, k, y)
        bend = table[k, BEND] if y == r1 else 0
        if bend >= 0 and wn % wd == 0:
            flag_between(line, wn // wd - 1, wn // wd + 1, junctions)
        if bend <= 0 and en % ed == 0:
            flag_between(line, en // ed - 1, en // ed + 1, junctions)
    elif r0 == r1 == y:
        flag_between(line, table[k, C0], table[k, C1], junctions)
    elif r1 == r2 == y:
        flag_between(line, table[k, C1], table[k, C2], junctions)


class Line(NamedTuple):
    """The vertices on a row of ticks.

    Attributes:
        x: (n,) int64, the columns in ticks of all vertices. order: their indices, from west to east within a row.
        before: (w + 1,) int64: the row's vertices in the window's cell j are ``order[before[j]:before[j + 1]]``.
        west: the window's first column.
        shift: 2^shift ticks to a cell.
    """

    x: NDArray[np.int64]
    order: NDArray[np.int64]
    before: NDArray[np.int64]
    west: int
    shift: int


@leaf
def flag_between(line, a, b, flags):
    """Flag the vertices of a row of ticks strictly between two columns in ticks."""
    first = max((a >> line.shift) - line.west, 0)
    last = min((b >> line.shift) - line.west, line.before.shape[0] - 2)
    if first <= last:
        for i in range(line.before[first], line.before[last + 1]):
            if a < line.x[line.order[i]] < b:
                flags[line.order[i]] = 1
