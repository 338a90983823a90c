"""Where a raster's samples lie: ``Grid(shape, transform, crs)``, frozen, travelling with every array.

A grid counts *samples* (points at which a height is known), not areas: sample (col, row) lies at
``transform * (col + 0.5, row + 0.5)``, as GDAL has it for pixel-is-area rasters; readers bring pixel-is-point files to
that convention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS


@dataclass(frozen=True, slots=True)
class Grid:
    """The placement of a raster of samples.

    Attributes:
        shape: (rows, cols).
        transform: affine map from (col, row) *corner* coordinates to CRS coordinates (GDAL's convention).
        crs: the coordinate reference system, or None if unknown.
    """

    shape: tuple[int, int]
    transform: Affine
    crs: CRS | None = None

    def __post_init__(self) -> None:
        rows, cols = self.shape
        if rows < 1 or cols < 1:
            raise ValueError(f"a grid needs at least one row and one column, not {self.shape}")
        if not all(math.isfinite(v) for v in self.transform[:6]) or self.transform.determinant == 0:
            raise ValueError(f"the geotransform {tuple(self.transform[:6])} is degenerate")

    @property
    def rows(self) -> int:
        return self.shape[0]

    @property
    def cols(self) -> int:
        return self.shape[1]

    @property
    def samples(self) -> Affine:
        """Affine map from *sample* indices (col, row) to CRS coordinates: ``transform`` moved by half a cell."""
        return self.transform * Affine.translation(0.5, 0.5)

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance between neighbouring samples along a row and along a column, in CRS units."""
        a, b, _, d, e, _ = self.transform[:6]
        return math.hypot(a, d), math.hypot(b, e)

    def xy(self, col: ArrayLike, row: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """CRS coordinates of sample positions (fractions allowed), float64, of the broadcast shape."""
        a, b, c, d, e, f = self.samples[:6]
        col, row = np.asarray(col, np.float64), np.asarray(row, np.float64)
        return a * col + b * row + c, d * col + e * row + f

    def index(self, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sample positions (col, row), fractional, of CRS coordinates: the inverse of ``xy``."""
        a, b, c, d, e, f = (~self.samples)[:6]
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        return a * x + b * y + c, d * x + e * y + f

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Grid:
        """The grid of samples ``[row0, row1) × [col0, col1)`` of this one (may reach beyond it)."""
        return Grid((row1 - row0, col1 - col0), self.transform * Affine.translation(col0, row0), self.crs)

    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) of the sample *areas* in CRS coordinates, whatever the rotation."""
        corners = [self.transform * p for p in ((0, 0), (self.cols, 0), (0, self.rows), (self.cols, self.rows))]
        xs, ys = [p[0] for p in corners], [p[1] for p in corners]
        return min(xs), min(ys), max(xs), max(ys)
