"""Triangles row by row: those of a band, from west to east, and what each spans of a row of samples.

A band's triangles are found by counting, kept as a table of integers (``strips``) with their planes, and sorted by
where they lie in the strip below a row. Heights are metres, float64; everything else is integers.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf
from orograph.verify.strips import BEND, C0, C1, C2, R0, R1, R2, ceiling, extent, order, sides


@kernel
def bucket(triangles, columns, rows, signs, size, bands):
    """The triangles with area that touch each band of ``size`` rows or the row below it, by their upper row and column.

    Returns:
        (start (bands + 1,), members): band b's are ``members[start[b]:start[b + 1]]``, ordered by the row, then the
        column of their first corner.
    """
    m = triangles.shape[0]
    last_row, last_col = 0, 0
    for i in range(rows.shape[0]):
        last_row, last_col = max(last_row, rows[i]), max(last_col, columns[i])
    top, left, bottom = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m, np.int64)
    for t in range(m):
        top[t], left[t], bottom[t] = np.int64(1) << 62, 0, 0
        for k in range(3):
            v = triangles[t, k]
            if rows[v] < top[t] or (rows[v] == top[t] and columns[v] < left[t]):
                top[t], left[t] = rows[v], columns[v]
            bottom[t] = max(bottom[t], rows[v])
    by_column = np.empty(m, np.int64)
    place_at = np.zeros(last_col + 2, np.int64)
    for t in range(m):
        place_at[left[t] + 1] += 1
    for i in range(last_col + 1):
        place_at[i + 1] += place_at[i]
    for t in range(m):
        by_column[place_at[left[t]]] = t
        place_at[left[t]] += 1
    by_row = np.empty(m, np.int64)
    place_at = np.zeros(last_row + 2, np.int64)
    for t in range(m):
        place_at[top[t] + 1] += 1
    for i in range(last_row + 1):
        place_at[i + 1] += place_at[i]
    for i in range(m):
        t = by_column[i]
        by_row[place_at[top[t]]] = t
        place_at[top[t]] += 1
    start = np.zeros(bands + 1, np.int64)
    for t in range(m):
        if signs[t] != 0:
            for b in range(max(top[t] - 1, 0) // size, bottom[t] // size + 1):
                start[b + 1] += 1
    for b in range(bands):
        start[b + 1] += start[b]
    fill = start.copy()
    members = np.empty(start[bands], np.int64)
    for i in range(m):
        t = by_row[i]
        if signs[t] != 0:
            for b in range(max(top[t] - 1, 0) // size, bottom[t] // size + 1):
                members[fill[b]] = t
                fill[b] += 1
    return start, members


@inlined
def west_of(table, k, j, row):
    """Whether triangle k's west side lies west of j's in the middle of the strip below ``row``."""
    kn, kdx, kd, _, _, _ = sides(table, k, row)
    jn, jdx, jd, _, _, _ = sides(table, j, row)
    return (2 * kn + kdx) * jd < (2 * jn + jdx) * kd


@leaf
def sort_west_to_east(table, active, begin, end, row):
    """Insertion sort of ``active[begin:end]``, exact; quick where the order is nearly right."""
    for i in range(begin + 1, end):
        k, j = active[i], i
        while j > begin and west_of(table, k, active[j - 1], row):
            active[j] = active[j - 1]
            j -= 1
        active[j] = k


@kernel
def ordered(triangles, members, columns, lines, vertices):
    """The members as a table of triangles (``strips``), and their planes (k, 3) float64: the height at the first corner
    and its slopes along columns and rows."""
    count = members.shape[0]
    table, planes = np.empty((count, 7), np.int64), np.empty((count, 3), np.float64)
    for k in range(count):
        t = members[k]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        order(columns, lines, a, b, c, table, k)
        if columns[b] == table[k, C0] and lines[b] == table[k, R0]:
            a, b = b, a
        elif columns[c] == table[k, C0] and lines[c] == table[k, R0]:
            a, c = c, a
        bx, by, cx, cy = columns[b] - columns[a], lines[b] - lines[a], columns[c] - columns[a], lines[c] - lines[a]
        bz, cz = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        area = np.float64(bx * cy - cx * by)
        planes[k, 0] = vertices[a, 2]
        planes[k, 1], planes[k, 2] = (bz * cy - cz * by) / area, (cz * bx - bz * cx) / area
    return table, planes


@leaf
def span_row(table, planes, k, row, west, lowest, highest):
    """Lower and raise the mesh's extremes at the samples of a row that triangle k spans."""
    wn, wd, en, ed = extent(table, k, row)
    first, last = ceiling(wn, wd), en // ed
    base = planes[k, 0] + planes[k, 2] * (row - table[k, R0])
    slope, from_column = planes[k, 1], table[k, C0]
    for c in range(first, last + 1):
        z = base + slope * (c - from_column)
        if z < lowest[c - west]:
            lowest[c - west] = z
        if z > highest[c - west]:
            highest[c - west] = z


@leaf
def find_junctions(table, k, row, west, vertex_at, before, junctions):
    """Flag the vertices of a row that lie inside an edge of triangle k; ``before`` counts vertices by column."""
    r0, r1, r2 = table[k, R0], table[k, R1], table[k, R2]
    if r0 < row < r2:
        wn, wd, en, ed = extent(table, k, row)
        bend = table[k, BEND] if row == r1 else 0
        if bend >= 0 and wn % wd == 0 and vertex_at[wn // wd - west] >= 0:
            junctions[vertex_at[wn // wd - west]] = 1
        if bend <= 0 and en % ed == 0 and vertex_at[en // ed - west] >= 0:
            junctions[vertex_at[en // ed - west]] = 1
    elif r0 == r1 == row or r1 == r2 == row:
        a, b = (table[k, C0], table[k, C1]) if r0 == r1 else (table[k, C1], table[k, C2])
        if before[b - west] > before[a + 1 - west]:
            for c in range(a + 1 - west, b - west):
                if vertex_at[c] >= 0:
                    junctions[vertex_at[c]] = 1
