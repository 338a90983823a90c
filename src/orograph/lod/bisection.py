"""Triangles as the methods with queues keep them, and their halves.

A triangle is three keys ``row << 32 | col`` of the padded square (left end and right end of the hypotenuse, apex) and
four heights (theirs, and that of the hypotenuse's middle; NaN where missing), in rows of two arrays. Metres.
"""

from __future__ import annotations

from orograph._numba import inlined


@inlined
def halve(corners, heights, t, half_corners, half_heights, first):
    """Write the halves of triangle t as rows ``first`` and ``first + 1``, but for the heights of their middles."""
    m = (corners[t, 0] + corners[t, 1]) >> 1
    for half in range(2):
        at = first + half
        half_corners[at, 0] = corners[t, 2] if half == 0 else corners[t, 1]
        half_corners[at, 1] = corners[t, 0] if half == 0 else corners[t, 2]
        half_corners[at, 2] = m
        half_heights[at, 0] = heights[t, 2] if half == 0 else heights[t, 1]
        half_heights[at, 1] = heights[t, 0] if half == 0 else heights[t, 2]
        half_heights[at, 2] = heights[t, 3]


@inlined
def copy_triangle(corners, heights, t, to_corners, to_heights, to):
    """Copy triangle t to row ``to`` of other arrays."""
    for k in range(3):
        to_corners[to, k], to_heights[to, k] = corners[t, k], heights[t, k]
    to_heights[to, 3] = heights[t, 3]


@inlined
def squeezed(corners, t, edge):
    """(row, column) of the left end, right end and apex of triangle t on the raster."""
    er, ec = min(corners[t, 0] >> 32, edge[0]), min(corners[t, 0] & 0xFFFFFFFF, edge[1])
    xr, xc = min(corners[t, 1] >> 32, edge[0]), min(corners[t, 1] & 0xFFFFFFFF, edge[1])
    ar, ac = min(corners[t, 2] >> 32, edge[0]), min(corners[t, 2] & 0xFFFFFFFF, edge[1])
    return er, ec, xr, xc, ar, ac


@inlined
def is_inside(corners, t, edge):
    """Whether triangle t lies on the raster as it is."""
    e, x, a = corners[t, 0], corners[t, 1], corners[t, 2]
    rows = max(e >> 32, max(x >> 32, a >> 32)) <= edge[0]
    return rows and max(e & 0xFFFFFFFF, max(x & 0xFFFFFFFF, a & 0xFFFFFFFF)) <= edge[1]


@inlined
def has_area(er, ec, xr, xc, ar, ac):
    """Whether a triangle is not squeezed to a line."""
    return (xc - ec) * (ar - er) != (ac - ec) * (xr - er)


@inlined
def has_heights(heights, t):
    """Whether no corner of triangle t is missing."""
    total = heights[t, 0] + heights[t, 1] + heights[t, 2]
    return total == total
