"""The full-resolution surface by rows: which unit triangles exist, which samples lie on one, and what is in view.

A unit is half a cell; in each cell, bit 0 is the upper one and bit 1 the lower one (``strips``). Metres; indices are
rows and columns of the raster.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.verify.frustum import place, polygon_in_view
from orograph.verify.strips import corners


class Ground(NamedTuple):
    """A window of the terrain.

    Attributes:
        heights: (h, w) float32, the samples [top, top + h) × [west, west + w).
        rows, columns: of the whole raster.
    """

    heights: NDArray[np.float32]
    top: int
    west: int
    rows: int
    columns: int


@leaf
def existing_units(ground, row, units):
    """The units that exist in each cell of the window below a row: bit 0, bit 1.

    ``units`` is shifted by one cell, and its first and last entries stay 0. Returns the number of missing units.
    """
    heights, i, west, missing = ground.heights, row - ground.top, ground.west, 0
    for j in range(heights.shape[1] - 1):
        a, b, c, d = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
        whole = a + b + c + d
        if whole == whole:
            units[j + 1] = 3
            continue
        bits = 0
        if (row + west + j) & 1 == 0:
            upper, lower = a + b + d, a + c + d
        else:
            upper, lower = a + b + c, b + c + d
        if upper == upper:
            bits |= 1
        else:
            missing += 1
        if lower == lower:
            bits |= 2
        else:
            missing += 1
        units[j + 1] = bits
    return missing


@inlined
def on_surface(over, under, j, odd):
    """Whether a sample lies on a unit triangle, given those of the strips above and below its row.

    A sample with an odd sum of column and row is a corner of one unit in each of its four cells, the one on its side.
    """
    if odd:
        return ((under[j] | under[j + 1]) & 1) | ((over[j] | over[j + 1]) & 2) != 0
    return (under[j] | under[j + 1] | over[j] | over[j + 1]) != 0


@inlined
def exists(ground, column, row, half):
    """Whether all three corners of a unit triangle exist."""
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    heights, top, west = ground.heights, ground.top, ground.west
    z = heights[r0 - top, c0 - west] + heights[r1 - top, c1 - west] + heights[r2 - top, c2 - west]
    return z == z


@leaf
def unit_in_view(ground, column, row, half, lens, points, scratch):
    """Whether an existing unit triangle reaches into the frustum."""
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    for k in range(3):
        c, r = (c0, r0) if k == 0 else ((c1, r1) if k == 1 else (c2, r2))
        height = np.float64(ground.heights[r - ground.top, c - ground.west])
        points[k, 0], points[k, 1], points[k, 2] = place(lens, c, r, height)
    return polygon_in_view(lens, points, 3, scratch)
