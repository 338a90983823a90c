"""Convert a DEM's heights to another vertical datum, only on request and with a given geoid grid.

The conversion is that of ``orograph.geo.vertical``; here each sample gets its longitude and latitude. They are those of
the DEM's own geodetic datum: between that and the geoid grid's a geoid changes by millimetres (a datum shift is some
100 m, over which geoids slope by a few centimetres per kilometre at most).
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from orograph.dem.projection import geodetic_base
from orograph.dem.raster import Dem
from orograph.errors import ReadError, UsageError
from orograph.geo.vertical import ELLIPSOIDAL, Geoid, known_datum

_ROWS = 256  # converted at once


def to_ellipsoidal(dem: Dem, geoid: Geoid | str | os.PathLike[str]) -> Dem:
    """Convert heights above a geoid to heights above the ellipsoid (dem.vertical None is assumed to be that geoid).

    Args:
        geoid: the geoid grid, or its file.

    Raises:
        UsageError: the heights are already ellipsoidal, or above another geoid.
        ReadError: the grid is missing or does not cover the DEM, or the DEM has no CRS.
    """
    grid = geoid if isinstance(geoid, Geoid) else Geoid.open(geoid)
    found = None if dem.vertical is None else known_datum(dem.vertical)
    if found == ELLIPSOIDAL:
        raise UsageError(f"The heights of {dem.name} are already ellipsoidal.")
    if found not in (None, grid.datum):
        raise UsageError(
            f"The heights of {dem.name} are {dem.vertical!r}, but the geoid grid {grid.path} is of {grid.datum!r}.",
            remedy="Give the grid of that datum.",
        )
    return _converted(dem, grid, 1.0, grid.ellipsoidal_datum)


def to_orthometric(dem: Dem, geoid: Geoid | str | os.PathLike[str]) -> Dem:
    """Convert heights above the ellipsoid to heights above a geoid (dem.vertical None is assumed to be the ellipsoid).

    Raises:
        UsageError: the heights are declared to have another datum.
        ReadError: as ``to_ellipsoidal``.
    """
    grid = geoid if isinstance(geoid, Geoid) else Geoid.open(geoid)
    if dem.vertical is not None and known_datum(dem.vertical) != ELLIPSOIDAL:
        raise UsageError(f"The heights of {dem.name} are {dem.vertical!r}, not above the ellipsoid.")
    return _converted(dem, grid, -1.0, grid.datum)


def _converted(dem: Dem, geoid: Geoid, sign: float, vertical: str) -> Dem:
    crs = dem.grid.crs
    if crs is None or crs.geodetic_crs is None:
        raise ReadError(
            f"{dem.name} has no CRS, so its longitudes and latitudes are unknown.", remedy="Give it one: assume_crs."
        )
    there = Transformer.from_crs(crs, geodetic_base(crs), always_xy=True, allow_ballpark=False)
    heights: NDArray[np.float32] = np.empty_like(dem.heights)
    cols = np.arange(dem.grid.cols)
    for row in range(0, dem.grid.rows, _ROWS):
        some = slice(row, min(row + _ROWS, dem.grid.rows))
        x, y = dem.grid.xy(cols[None, :], np.arange(some.start, some.stop)[:, None])
        lon, lat = there.transform(x, y)
        part = dem.heights[some].astype(np.float64)
        known = np.isfinite(part)
        undulation = geoid.undulation(np.where(known, lon, np.nan), np.where(known, lat, np.nan))
        heights[some] = (part + sign * undulation).astype(np.float32)
    return Dem(heights, dem.grid, vertical, dem.name, dem.attribution)
