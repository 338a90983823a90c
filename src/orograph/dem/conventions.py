"""netCDF conventions (CF 1.11) for grids in files and in xarray: evenly spaced axes, their units; depths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.units import metres_per

TOLERANCE = 0.1
"""Tolerance in samples for a coordinate's deviation from its even place, in addition to float32 rounding."""

ACROSS = {
    "x", "lon", "long", "longitude", "easting", "east", "e", "projection_x_coordinate", "rlon", "grid_longitude",
}  # fmt: skip
"""Names, and CF standard names, of axes along the rows."""

DOWN = {"y", "lat", "latitude", "northing", "north", "n", "projection_y_coordinate", "rlat", "grid_latitude"}
"""Names, and CF standard names, of axes down the columns."""

ROTATED = {"rlon", "rlat", "grid_longitude", "grid_latitude"}
"""Names of the axes of a rotated pole, whose degrees are not longitude and latitude."""


def even_axis(values: NDArray[Any]) -> tuple[float, float]:
    """First coordinate and step of an axis; the step of a single coordinate is 1.

    Every coordinate is compared with its place on the line from the first to the last, because small errors in steps
    add up.

    Raises:
        ValueError: they are not evenly spaced; the message says where.
    """
    at = np.asarray(values, np.float64).ravel()
    if not np.isfinite(at).all():
        index = int(np.argmin(np.isfinite(at)))
        raise ValueError(f"number {index} is {at[index]:g}")
    if at.size == 1:
        return float(at[0]), 1.0
    step = float(at[-1] - at[0]) / (at.size - 1)
    rounding = np.finfo(values.dtype).eps * np.abs(at).max() if values.dtype.kind == "f" else 0.0
    off = np.abs(at - (at[0] + step * np.arange(at.size)))
    if step == 0 or off.max() > TOLERANCE * abs(step) + rounding:
        worst = int(np.argmax(off)) if step else 1
        raise ValueError(f"number {worst} is {at[worst]:.9g}, which an even spacing would have at "
                         f"{at[0] + step * worst:.9g}")  # fmt: skip
    return float(at[0]), step


def metres_of_axes(units: Mapping[str, str]) -> float:
    """Metres per unit of axes without a CRS; 1 if they have no unit, or degrees.

    Args:
        units: the unit of each axis by its name, "" if it says none.

    Raises:
        ValueError: the unit is neither a length nor degrees; the message names it.
    """
    for name, unit in units.items():
        metres = metres_per(unit) if unit.strip() else 1.0
        if metres is None and not unit.strip().lower().startswith("degree"):
            raise ValueError(f"{name!r} is in {unit.strip()!r}")
        if metres not in (None, 1.0):
            return float(metres)
    return 1.0


def is_depth(attributes: Mapping[str, Any]) -> bool:
    """Whether a variable's attributes (CF) call it a depth, which grows downwards."""
    called = str(attributes.get("standard_name", "")).strip().lower()
    depth = called == "depth" or called.startswith("depth_below_") or "_depth_below_" in called
    return depth or str(attributes.get("positive", "")).strip().lower() == "down"
