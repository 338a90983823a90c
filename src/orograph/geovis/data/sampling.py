"""Values of data between their samples: where an image's texels, or single places, lie in the data's grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.geo.grid import Grid, apply
from orograph.geovis.data.field import Field, Values, lattice_of
from orograph.geovis.placement import Placement, between

STRIP = 128
"""Rows that are interpolated at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """Where the samples of one grid lie in another's, to ``placement.TOLERANCE`` of its samples.

    Attributes:
        c, r: (rows, cols) columns and rows between samples. cyclic: whether the last column meets the first.
    """

    c: NDArray[np.float64]
    r: NDArray[np.float64]
    cyclic: bool

    @classmethod
    def of(cls, over: Grid, field: Field) -> Positions:
        """Of the samples of ``over`` in a field."""
        placement = Placement.of(over, field.grid, field.name, [])
        lattice = lattice_of(placement)
        c, r = np.empty(over.shape), np.empty(over.shape)
        cols = np.arange(over.cols, dtype=np.float64)
        for row in range(0, over.rows, STRIP):
            rows = np.arange(row, min(row + STRIP, over.rows), dtype=np.float64)
            nodes = apply(lattice.index, *over.xy(*np.meshgrid(cols, rows)))
            c[row : row + len(rows)] = between(lattice.u, *nodes) - 0.5
            r[row : row + len(rows)] = between(lattice.v, *nodes) - 0.5
        return cls(c, r, placement.cyclic)

    def values(self, values: Values) -> Values:
        """Values (rows, cols) of that field there, bilinear; NaN farther than half a sample outside it."""
        out = np.empty(self.c.shape, np.float32)
        for row in range(0, len(out), STRIP):
            part = slice(row, row + STRIP)
            out[part] = bilinear(values, self.c[part], self.r[part], self.cyclic)
        return out

    def nearest(self, values: Values) -> Values:
        """Of values (rows, cols) of that field the nearest; NaN farther than half a sample outside it."""
        rows, cols = values.shape
        r, c = np.floor(self.r + 0.5), np.floor(self.c + 0.5)
        inside = (r >= 0) & (r < rows) & ((c >= 0) & (c < cols) | self.cyclic)
        i, j = np.where(inside, r, 0).astype(np.int64), np.where(inside, c, 0).astype(np.int64) % cols
        return np.where(inside, values[i, j], np.nan).astype(np.float32)


def values_at(
    values: Values, field: Field, grid: Grid, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:  # fmt: skip
    """Values (n,) of a field at places in the CRS of a terrain with this grid, as ``Positions`` has them."""
    placement = Placement.of(grid, field.grid, field.name, [])
    u, v = placement.pixels(x, y)
    return bilinear(values, u - 0.5, v - 0.5, placement.cyclic).astype(np.float64)


def bilinear(values: Values, c: NDArray[np.float64], r: NDArray[np.float64], cyclic: bool = False) -> Values:
    """Values (rows, cols) at columns and rows between samples, any shape; NaN farther than half a sample outside, and
    where the nearest sample is missing."""
    rows, cols = values.shape
    inside = (r >= -0.5) & (r <= rows - 0.5) & ((c >= -0.5) & (c <= cols - 0.5) | cyclic)
    c, r = np.where(inside, c, 0.0), np.where(inside, r, 0.0)
    c0, r0 = np.floor(c).astype(np.int64), np.floor(r).astype(np.int64)
    total, weights = np.zeros(c.shape), np.zeros(c.shape)
    for dr in (0, 1):
        for dc in (0, 1):
            i = np.clip(r0 + dr, 0, rows - 1)
            j = (c0 + dc) % cols if cyclic else np.clip(c0 + dc, 0, cols - 1)
            weight = np.abs(1 - dr - (r - r0)) * np.abs(1 - dc - (c - c0))
            value = values[i, j]
            known = np.isfinite(value)
            total += np.where(known, value, 0) * weight
            weights += np.where(known, weight, 0)
    i = np.clip(np.rint(r), 0, rows - 1).astype(np.int64)
    j = np.rint(c).astype(np.int64) % cols if cyclic else np.clip(np.rint(c), 0, cols - 1).astype(np.int64)
    good = inside & np.isfinite(values[i, j]) & (weights > 0)
    return np.where(good, total / np.maximum(weights, 1e-9), np.nan).astype(np.float32)
