"""Vertical dimensions: what the levels of a variable count, and where they lie.

What a dimension is follows from CF's attributes (section 4.3: ``standard_name``, ``units``, ``positive``), from GRIB's
level types, else from its name. Heights of pressures without a geopotential are those of the ICAO standard atmosphere
(1993, below 11 km: h = 44 330.77 m (1 − (p / 1013.25 hPa)^0.190 263); above it isothermal).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PRESSURES = {"pa": 0.01, "hpa": 1.0, "kpa": 10.0, "mbar": 1.0, "mb": 1.0, "millibar": 1.0, "millibars": 1.0,
             "pascal": 0.01}  # fmt: skip
"""hPa of units of pressure."""

LENGTHS = {"m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0, "km": 1000.0, "cm": 0.01, "mm": 0.001,
           "ft": 0.3048, "feet": 0.3048, "": 1.0}  # fmt: skip
"""Metres of units of length."""

KINDS = {
    "air_pressure": "pressure", "depth": "depth", "height": "above", "altitude": "height",
    "height_above_reference_ellipsoid": "height", "height_above_mean_sea_level": "height",
    "height_above_geopotential_datum": "height", "geopotential_height": "height",
}  # fmt: skip
"""What CF's standard names count."""

NAMES = {
    "plev": "pressure", "pressure": "pressure", "pressure_level": "pressure", "isobaricinhpa": "pressure",
    "isobaric": "pressure", "depth": "depth", "depthbelowlandlayer": "depth", "heightaboveground": "above",
    "agl": "above", "height": "height", "altitude": "height", "alt": "height", "elevation": "height", "z": "height",
}  # fmt: skip
"""What dimensions count by their names."""

GRIB = {"ISBL": ("pressure", 0.01), "HTGL": ("above", 1.0), "HTMSL": ("height", 1.0), "DBLL": ("depth", 1.0)}
"""What GRIB's level types count (of GDAL's short names), and hPa or metres of their units."""

GRAVITY, EARTH = 9.80665, 6_356_766.0
"""m/s², and the radius of the Earth, metres, that turn geopotential into heights (ICAO 1993)."""

GEOPOTENTIALS = ("z", "zg", "gh", "geopotential", "geopotential_height", "hgt")
"""Names of a variable that may be geopotential."""


class Axis(NamedTuple):
    """What a vertical dimension counts.

    Attributes:
        kind: see ``dataset.Vertical``. factor: hPa or metres of its unit; negative where it counts downwards from the
            heights' zero. unit: as it is written.
    """

    kind: str
    factor: float
    unit: str


class Levels(NamedTuple):
    """The levels of a variable.

    Attributes:
        values: (n,) as the source has them. axis: what they count.
    """

    values: Array
    axis: Axis

    @property
    def places(self) -> Array:
        """(n,) hPa or metres."""
        return self.values * self.axis.factor


def axis_of(name: str, about: Mapping[str, Any], asked: str | None = None) -> Axis | None:
    """What a dimension counts; None: it is not vertical.

    Args:
        about: its attributes. asked: what the user says that it is.
    """
    standard = str(about.get("standard_name", "")).lower()
    unit = str(about.get("units", "")).strip()
    low = unit.lower()
    down = str(about.get("positive", "")).lower() == "down"
    kind = asked or KINDS.get(standard) or ("pressure" if low in PRESSURES else None)
    if kind is None and low in LENGTHS:
        kind = NAMES.get(name.lower()) or ("depth" if down else None)
    if kind is None:
        return None
    if kind == "pressure":
        return Axis(kind, PRESSURES.get(low, 1.0), unit or "hPa")
    factor = LENGTHS.get(low, 1.0)
    return Axis(kind, -factor if down and kind == "height" else factor, unit or "m")


def levels_of(file: Any, asked: str | None = None) -> Levels | None:
    """The levels of a raster's bands, one for each band, NaN where it has none; None: no band has one."""
    tags = file.tags()
    extra = re.findall(r"[^{},\s]+", tags.get("NETCDF_DIM_EXTRA", ""))
    for name in [one for one in extra if one not in ("time", "member", "number", "realization")]:
        about = {key.partition("#")[2]: value for key, value in tags.items() if key.startswith(f"{name}#")}
        axis = axis_of(name, about, asked if len(extra) == 1 else None) or axis_of(name, about)
        if axis is not None:
            own = [file.tags(band).get(f"NETCDF_DIM_{name}", "nan") for band in range(1, file.count + 1)]
            return Levels(np.array(own, np.float64), axis)
    kinds, values = set(), []
    for band in range(1, file.count + 1):
        short = re.fullmatch(r"([\d.]+)-(\w+)", file.tags(band).get("GRIB_SHORT_NAME", ""))
        known = short is not None and short[2] in GRIB
        values.append(float(short[1]) if short is not None and known else math.nan)
        if short is not None and known:
            kinds.add(short[2])
    if len(kinds) != 1:
        return None
    kind, factor = GRIB[kinds.pop()]
    return Levels(np.array(values), Axis(asked or kind, factor, "Pa" if kind == "pressure" else "m"))


def vertical_dimension(array: Any, asked: str | None = None) -> tuple[str, Axis] | None:
    """The vertical dimension of a DataArray, and what it counts; None: it has none."""
    for name in array.dims:
        about = array.coords[name].attrs if name in array.coords else {}
        lateral = str(about.get("axis", "")).upper() in ("X", "Y", "T") or str(name) in ("time", "x", "y")
        axis = None if lateral or name not in array.coords else axis_of(str(name), about)
        if axis is not None:
            return str(name), axis if asked is None else axis_of(str(name), about, asked) or axis
    return None


def standard_heights(pressure: Array) -> Array:
    """Heights above sea level, metres, of pressures in hPa in the ICAO standard atmosphere."""
    low = 44_330.77 * (1 - (np.maximum(pressure, 226.32) / 1013.25) ** 0.190263)
    return np.asarray(low + np.where(pressure < 226.32, 6341.62 * np.log(226.32 / np.minimum(pressure, 226.32)), 0.0))


def geometric(geopotential: Array) -> Array:
    """Heights, metres, of geopotential heights."""
    return np.asarray(EARTH * geopotential / (EARTH - geopotential))
