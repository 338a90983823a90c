"""Exact geometry of triangles over a grid, strip by strip.

Vertices lie at whole *ticks*: a sample spacing has 2^shift of them, so that all numbers here are integers. The rows of
ticks with a sample or a vertex cut the terrain into strips. No vertex lies *inside* a strip: a triangle that meets the
open strip crosses all of it, as a trapezoid between two of its edges. Whether trapezoids overlap, touch or leave a gap
then depends on their four ends, fractions that are compared exactly. A side of a trapezoid is (n, step, d): its
column in ticks is n/d at the strip's upper row and (n + step)/d at its lower, d > 0. With 2^30 ticks a side no number
here exceeds 2^62.

*Unit triangles* are those of the full-resolution surface: each cell is cut along the diagonal that joins its
(even, even) to its (odd, odd) corner. Unit 0 of a cell is the one at its upper side, unit 1 the one at its lower side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._numba import inlined, leaf

LONGEST = 1 << 30
"""Maximum ticks along a side for which the fractions' numbers fit into int64."""

C0, R0, C1, R1, C2, R2, BEND = range(7)
"""Columns of a table of triangles: corners in ticks, ordered by (row, column), and where the middle one bulges: −1
west, 1 east of the edge from the first to the last."""


class Strip(NamedTuple):
    """A strip: rows [y0, y1] in ticks, in the cells below sample row ``row``; 2^shift ticks to a cell."""

    row: int
    y0: int
    y1: int
    shift: int


@leaf
def compare(n1, d1, n2, d2):
    """A number with the sign of n1/d1 − n2/d2; both d positive.

    The difference n1·d2 − n2·d1 in int64 is correct modulo 2^64. In float64 it is correct to 2^41; if that shows that
    it does not fit into int64, the sign is taken from there.
    """
    near = np.float64(n1) * np.float64(d2) - np.float64(n2) * np.float64(d1)
    if abs(near) > 2.0**62:
        return near
    return np.float64(n1 * d2 - n2 * d1)


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
def sides(table, k, y0, y1):
    """West and east side (n, step, d, n, step, d) of triangle k in the strip [y0, y1], which it must meet."""
    c0, r0, c1, r1, c2, r2 = table[k, C0], table[k, R0], table[k, C1], table[k, R1], table[k, C2], table[k, R2]
    ldx, ld = c2 - c0, r2 - r0
    ln = c0 * ld + ldx * (y0 - r0)
    if y0 < r1:
        sdx, sd = c1 - c0, r1 - r0
        sn = c0 * sd + sdx * (y0 - r0)
    else:
        sdx, sd = c2 - c1, r2 - r1
        sn = c1 * sd + sdx * (y0 - r1)
    if table[k, BEND] < 0:
        return sn, sdx * (y1 - y0), sd, ln, ldx * (y1 - y0), ld
    return ln, ldx * (y1 - y0), ld, sn, sdx * (y1 - y0), sd


@inlined
def extent(table, k, y):
    """The extent of triangle k on a row of ticks that it touches: west and east end (n, d, n, d)."""
    if y < table[k, R2]:
        wn, _, wd, en, _, ed = sides(table, k, y, y)
        return wn, wd, en, ed
    if table[k, R1] == y:
        return table[k, C1], 1, table[k, C2], 1
    return table[k, C2], 1, table[k, C2], 1


@inlined
def ceiling(n, d):
    """The smallest integer not below n/d."""
    return -((-n) // d)


@inlined
def unit(column, half, strip):
    """The part of a unit triangle in a strip: ticks of its west side at the strip's two rows, and of its east side."""
    size = 1 << strip.shift
    west, east = column << strip.shift, (column + 1) << strip.shift
    upper, lower = strip.y0 - (strip.row << strip.shift), strip.y1 - (strip.row << strip.shift)
    if (column + strip.row) & 1 == 0:
        if half == 0:
            return west + upper, west + lower, east, east
        return west, west, west + upper, west + lower
    if half == 0:
        return west, west, west + size - upper, west + size - lower
    return west + size - upper, west + size - lower, east, east


@inlined
def meets_unit(wn, wstep, wd, en, estep, ed, column, half, strip):
    """Whether a trapezoid and a unit triangle share some area in a strip.

    They do not iff one lies west of the other at both rows: their sides are straight, and both have an area.
    """
    u0, u1, v0, v1 = unit(column, half, strip)
    if compare(en, ed, u0, 1) <= 0.0 and compare(en + estep, ed, u1, 1) <= 0.0:
        return False
    return not (compare(v0, 1, wn, wd) <= 0.0 and compare(v1, 1, wn + wstep, wd) <= 0.0)


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
