"""Where a raster's samples lie: ``Grid(shape, transform, crs)``, frozen, travelling with every array.

A grid counts *samples* (points at which a height is known), not areas: sample (col, row) lies at
``transform * (col + 0.5, row + 0.5)``, as GDAL has it for pixel-is-area rasters; readers bring pixel-is-point files to
that convention.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from orograph._named import named


def wkt_of(crs: CRS | None) -> str | None:
    """A CRS as WKT 2, the very text where it was made of one, so that what is written says what was read; None of none.

    PROJ's own text changes when it is read and written again: the datum ensemble of EPSG:3857 is lost.
    """
    if crs is None:
        return None
    return str(crs.srs) if re.match(r"[A-Z]+CRS\[", crs.srs) else str(crs.to_wkt())


NAMELESS = ("unknown", "unnamed", "undefined", "undetermined", "none")
"""How names of CRSs begin that files give for want of one."""


def name_of(crs: CRS) -> str | None:
    """What a CRS is called; one without a name (in USGS DEMs: NAD27 / UTM zone 10N) as the registered CRS that it
    equals; None: it equals none."""
    name = str(crs.name or "").strip()
    if name and not name.lower().startswith(NAMELESS):
        return name
    code = crs.to_authority()
    return None if code is None else str(CRS.from_authority(*code).name)


def compose(*maps: Affine) -> Affine:
    """The affine map that applies ``maps`` from the last to the first, as matrices are multiplied.

    Written out because affine 3 deprecates its ``*`` for ``@``, which affine 2 does not have.
    """
    a, b, c, d, e, f = maps[0][:6]
    for other in maps[1:]:
        g, h, i, j, k, m = other[:6]
        a, b, c, d, e, f = (
            a * g + b * j,
            a * h + b * k,
            a * i + b * m + c,
            d * g + e * j,
            d * h + e * k,
            d * i + e * m + f,
        )
    return Affine(a, b, c, d, e, f)


def apply(transform: Affine, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The points to which an affine map takes points (x, y): two float64 arrays of the broadcast shape."""
    a, b, c, d, e, f = transform[:6]
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    return a * x + b * y + c, d * x + e * y + f


@named("A grid")
@dataclass(frozen=True, slots=True)
class Grid:
    """The placement of a raster of samples.

    Attributes:
        shape: (rows, cols).
        transform: affine map from (col, row) *corner* coordinates to CRS coordinates (GDAL's convention).
        crs: the coordinate reference system, or None if unknown; it may be given as pyproj takes it ("EPSG:32611").
        samples: affine map from *sample* indices (col, row) to CRS coordinates: ``transform`` moved by half a cell.
        inverse: of ``samples``.
    """

    shape: tuple[int, int]
    transform: Affine
    crs: CRS | None = None
    samples: Affine = field(init=False, repr=False, compare=False)
    inverse: Affine = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        rows, cols = self.shape
        if rows < 1 or cols < 1:
            raise ValueError(f"a grid needs at least one row and one column, not {self.shape}")
        if not all(math.isfinite(v) for v in self.transform[:6]) or self.transform.determinant == 0:
            raise ValueError(f"the geotransform {tuple(self.transform[:6])} is degenerate")
        given: Any = self.crs
        if given is not None and not isinstance(given, CRS):
            object.__setattr__(self, "crs", CRS.from_user_input(given))
        # Kept, as cameras ask for them in every frame and affine takes its time.
        object.__setattr__(self, "samples", compose(self.transform, Affine.translation(0.5, 0.5)))
        object.__setattr__(self, "inverse", ~self.samples)

    @property
    def crs_name(self) -> str:
        """What its CRS is called, for people."""
        return "no CRS" if self.crs is None else name_of(self.crs) or str(self.crs.name)

    @property
    def rows(self) -> int:
        return self.shape[0]

    @property
    def cols(self) -> int:
        return self.shape[1]

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance between neighbouring samples along a row and along a column, in CRS units."""
        a, b, _, d, e, _ = self.transform[:6]
        return math.hypot(a, d), math.hypot(b, e)

    @property
    def linear(self) -> NDArray[np.float64]:
        """(2, 2): what one column and one row (the matrix's columns) are in CRS coordinates."""
        a, b, _, d, e, _ = self.samples[:6]
        return np.array([[a, b], [d, e]])

    @property
    def cell_area(self) -> float:
        """The area of a cell, in squared CRS units."""
        return abs(self.samples.determinant)

    def xy(self, col: ArrayLike, row: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """CRS coordinates of sample positions (fractions allowed), float64, of the broadcast shape."""
        return apply(self.samples, col, row)

    def index(self, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sample positions (col, row), fractional, of CRS coordinates: the inverse of ``xy``."""
        return apply(self.inverse, x, y)

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Grid:
        """The grid of samples ``[row0, row1) × [col0, col1)`` of this one (may reach beyond it)."""
        return Grid((row1 - row0, col1 - col0), compose(self.transform, Affine.translation(col0, row0)), self.crs)

    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) of the sample *areas* in CRS coordinates, whatever the rotation."""
        xs, ys = apply(self.transform, [0, self.cols, 0, self.cols], [0, 0, self.rows, self.rows])
        return float(xs.min()), float(ys.min()), float(xs.max()), float(ys.max())
