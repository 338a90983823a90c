"""Exact geometry of triangles over a grid, strip by strip.

All vertices lie at integer rows, so none lies *inside* the strip between two neighbouring rows: a triangle that meets
the open strip crosses all of it, as a trapezoid between two of its edges. Whether trapezoids overlap, touch or leave a
gap is then a matter of their four ends, fractions that are compared by multiplying them out in int64; nothing is
rounded. A side of a trapezoid is (n, dx, d): its column is n/d at the strip's upper row and (n + dx)/d at its lower,
d > 0. With rasters of up to 2^20 samples a side no product exceeds 2^62.

*Unit triangles* are those of the full-resolution surface: each cell is cut along the diagonal that joins its
(even, even) to its (odd, odd) corner. Unit 0 of a cell is the one at its upper side, unit 1 the one at its lower side.
"""

from __future__ import annotations

from orograph._numba import inlined, leaf

LONGEST = 1 << 20
"""The largest raster side for which products of fractions fit into int64."""

C0, R0, C1, R1, C2, R2, BEND = range(7)
"""Columns of a table of triangles: corners ordered by (row, column), and where the middle one bulges: −1 west, 1 east
of the edge from the first to the last."""


@leaf
def order(columns, rows, a, b, c, into, k):
    """Write row k of a table of triangles from its three vertices."""
    if rows[b] < rows[a] or (rows[b] == rows[a] and columns[b] < columns[a]):
        a, b = b, a
    if rows[c] < rows[a] or (rows[c] == rows[a] and columns[c] < columns[a]):
        a, c = c, a
    if rows[c] < rows[b] or (rows[c] == rows[b] and columns[c] < columns[b]):
        b, c = c, b
    c0, r0, c1, r1, c2, r2 = columns[a], rows[a], columns[b], rows[b], columns[c], rows[c]
    into[k, C0], into[k, R0], into[k, C1], into[k, R1], into[k, C2], into[k, R2] = c0, r0, c1, r1, c2, r2
    into[k, BEND] = -1 if (c1 - c0) * (r2 - r0) - (c2 - c0) * (r1 - r0) < 0 else 1


@inlined
def sides(table, k, row):
    """West and east side (n, dx, d, n, dx, d) of triangle k in the strip below ``row``, which it must meet."""
    c0, r0, c1, r1, c2, r2 = table[k, C0], table[k, R0], table[k, C1], table[k, R1], table[k, C2], table[k, R2]
    ldx, ld = c2 - c0, r2 - r0
    ln = c0 * ld + ldx * (row - r0)
    if row < r1:
        sdx, sd = c1 - c0, r1 - r0
        sn = c0 * sd + sdx * (row - r0)
    else:
        sdx, sd = c2 - c1, r2 - r1
        sn = c1 * sd + sdx * (row - r1)
    if table[k, BEND] < 0:
        return sn, sdx, sd, ln, ldx, ld
    return ln, ldx, ld, sn, sdx, sd


@inlined
def extent(table, k, row):
    """Where triangle k meets a row that it touches: west and east end (n, d, n, d)."""
    if row < table[k, R2]:
        wn, _, wd, en, _, ed = sides(table, k, row)
        return wn, wd, en, ed
    if table[k, R1] == row:
        return table[k, C1], 1, table[k, C2], 1
    return table[k, C2], 1, table[k, C2], 1


@inlined
def ceiling(n, d):
    """The least integer not below n/d."""
    return -((-n) // d)


@inlined
def unit(column, row, half):
    """The columns of a unit triangle's sides: west at the cell's upper and lower row, east at both."""
    if (column + row) & 1 == 0:
        if half == 0:
            return column, column + 1, column + 1, column + 1
        return column, column, column, column + 1
    if half == 0:
        return column, column, column + 1, column
    return column + 1, column, column + 1, column + 1


@inlined
def meets_unit(wn, wdx, wd, en, edx, ed, column, row, half):
    """Whether a trapezoid and a unit triangle of the same strip share some area.

    They do not iff one lies west of the other at both rows: their sides are straight, and neither is a mere line.
    """
    u0, u1, v0, v1 = unit(column, row, half)
    if en <= u0 * ed and en + edx <= u1 * ed:
        return False
    return not (v0 * wd <= wn and v1 * wd <= wn + wdx)


@inlined
def corners(column, row, half):
    """The three samples (column, row) × 3 of a unit triangle."""
    if (column + row) & 1 == 0:
        if half == 0:
            return column, row, column + 1, row, column + 1, row + 1
        return column, row, column, row + 1, column + 1, row + 1
    if half == 0:
        return column, row, column + 1, row, column, row + 1
    return column + 1, row, column, row + 1, column + 1, row + 1
