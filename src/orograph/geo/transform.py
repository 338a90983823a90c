"""Transforming positions between coordinate reference systems, horizontally, in (x, y) = (longitude, latitude)
order."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geo.operations import same_body

Array = NDArray[np.float64]


def crs_of(text: Any) -> CRS:
    """A CRS from anything pyproj understands.

    Raises:
        UsageError: it does not.
    """
    try:
        return CRS.from_user_input(text)
    except CRSError as error:
        raise UsageError(f"{text!r} is not a coordinate reference system: {error}") from error


def transformer(source: Any, target: Any) -> Callable[[ArrayLike, ArrayLike], tuple[Array, Array]]:
    """A function (x, y) → (x, y) from CRS ``source`` to CRS ``target``; positions outside become inf, as PROJ has it.

    Raises:
        UsageError: one is None or unknown, or no operation between them exists (other planet, local CRS).
    """
    if source is None or target is None:
        raise UsageError("Positions cannot be transformed: the terrain has no CRS. Give `assume_crs`.")
    a, b = crs_of(source), crs_of(target)
    if a == b:
        return lambda x, y: (np.asarray(x, np.float64), np.asarray(y, np.float64))
    if not same_body(a, b):
        raise UsageError(
            f"There is no transformation from {a.name} to {b.name}: they belong to different celestial bodies."
        )
    try:
        operation = Transformer.from_crs(a, b, always_xy=True)
    except ProjError as error:
        raise UsageError(f"There is no transformation from {a.name} to {b.name}: {error}") from error

    def move(x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        u, v = operation.transform(np.asarray(x, np.float64), np.asarray(y, np.float64))
        return np.asarray(u), np.asarray(v)

    return move


def place(grid: Grid, lon: float, lat: float) -> tuple[float, float]:
    """A longitude and a latitude (WGS 84, degrees) in a grid's CRS.

    Raises:
        UsageError: the grid has no CRS, the place cannot be transformed to it, or its two numbers seem to be swapped.
    """
    move = transformer("EPSG:4326", grid.crs)

    def inside(lon: float, lat: float) -> bool:
        x, y = (float(v) for v in move(lon, lat))
        return not far_outside(grid, x, y, 0.0)

    x, y = (float(v) for v in move(lon, lat))
    if far_outside(grid, x, y) and inside(lat, lon):
        raise UsageError(
            f"Longitude {lon:g}, latitude {lat:g} lies far outside the terrain, and {lat:g}, {lon:g} within it: "
            "were the two swapped?",
            remedy=f"Give the longitude first: {lat:g},{lon:g}.",
        )
    if not (math.isfinite(x) and math.isfinite(y)):
        raise UsageError(
            f"Longitude {lon:g}, latitude {lat:g} cannot be transformed to the terrain's CRS.",
            remedy="Longitude comes first." if abs(lat) > 90 >= abs(lon) else "",
        )
    return x, y


def far_outside(grid: Grid, x: float, y: float, beyond: float = 1.0) -> bool:
    """Whether a place in the grid's CRS lies more than ``beyond`` of its width or height outside of it (or nowhere)."""
    if not (math.isfinite(x) and math.isfinite(y)):
        return True
    col, row = grid.index(x, y)
    across, down = (float(col) + 0.5) / grid.cols, (float(row) + 0.5) / grid.rows
    return not (-beyond <= across <= 1 + beyond and -beyond <= down <= 1 + beyond)
