"""What the conventions of netCDF (CF 1.11) say of a variable that GDAL has open, and GDAL passes over.

- Axes (§2.8, §4): GDAL compares a few coordinates with an absolute tolerance of 0.001, which is several samples of a
  fine grid in degrees. Here all are compared.
- Units of axes where there is no CRS (§4).
- Missing data (§2.5.1): ``missing_value`` beside ``_FillValue``, and the valid range. GDAL turns what lies beyond it
  into 0 where no fill value is declared; datasets are opened so that it does not (``handles.open_dataset``).
"""

from __future__ import annotations

import re
import warnings
from typing import Any, NamedTuple

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.dem.even import ACROSS, DOWN, even_axis, is_depth, metres_in
from orograph.dem.whole.files import here, main_file
from orograph.errors import ReadError
from orograph.geo.grid import compose

KEEP_RANGE = {"HONOUR_VALID_RANGE": "NO"}
"""How GDAL opens a netCDF file without putting 0 where numbers are beyond the valid range."""

_USUAL = ("x", "y", "lon", "lat", "longitude", "latitude", "easting", "northing")
_LIMITS = ("valid_range", "valid_min", "valid_max")


class Valid(NamedTuple):
    """Which stored numbers are heights, besides what the nodata value says.

    Attributes:
        others: further numbers that mean "missing".
        low, high: the valid range, both ends included.
    """

    others: tuple[float, ...] = ()
    low: float = -np.inf
    high: float = np.inf

    def outside(self, raw: NDArray[Any]) -> NDArray[np.bool_]:
        """Where stored numbers are none of heights."""
        from orograph.dem.missing import is_nodata

        beyond: NDArray[np.bool_] = (raw < self.low) | (raw > self.high)
        for number in self.others:
            beyond |= is_nodata(raw, number)
        return beyond


def is_limited(dataset: Any) -> bool:
    """Whether a dataset is netCDF with a valid range."""
    return dataset.driver == "netCDF" and any(key.rpartition("#")[2] in _LIMITS for key in dataset.tags())


def valid_of(dataset: Any, band: int) -> Valid | None:
    """What a netCDF variable says of its missing data besides its nodata value; None: nothing."""
    if dataset.driver != "netCDF":
        return None
    tags = dataset.tags(band)
    span = _numbers(tags.get("valid_range", ""))
    low = next(iter(_numbers(tags.get("valid_min", ""))), span[0] if len(span) == 2 else -np.inf)
    high = next(iter(_numbers(tags.get("valid_max", ""))), span[1] if len(span) == 2 else np.inf)
    declared = dataset.nodatavals[band - 1]
    others = tuple(number for number in _numbers(tags.get("missing_value", "")) if number != declared)
    found = Valid(others, low, high)
    return None if found == Valid() else found


def is_depth_of(dataset: Any, band: int) -> bool:
    """Whether a netCDF variable calls itself a depth."""
    return dataset.driver == "netCDF" and is_depth(dataset.tags(band))


def refuse_uneven(dataset: Any) -> None:
    """Raise ReadError if the coordinates along an axis of a netCDF variable are not evenly spaced."""
    for axis in _axes(dataset):
        try:
            even_axis(axis.values)
        except ValueError as error:
            raise ReadError(
                f"Its coordinates {axis.name!r} are not evenly spaced: {error}.", path=dataset.name,
                remedy="Resample it to an even grid first (in Python: xarray's interp).",
            ) from None  # fmt: skip


def transform_of(dataset: Any) -> Affine:
    """The geotransform of a netCDF variable in metres where it names no CRS, or in degrees.

    GDAL knows axes by their standard names alone. Those that are only called x and y, longitude and latitude… are read
    here; it then counts rows from the last to the first.

    Raises:
        ReadError: their unit is neither a length nor degrees.
    """
    transform = Affine(*dataset.transform[:6])
    axes = _axes(dataset)
    if transform.is_identity:
        across = next((axis for axis in axes if not axis.down and axis.values.size == dataset.width), None)
        down = next((axis for axis in axes if axis.down and axis.values.size == dataset.height), None)
        if across is None or down is None or dataset.gcps[0] or 1 in dataset.shape:
            return transform
        (x0, dx), (y0, dy) = even_axis(across.values), even_axis(down.values[::-1])
        transform = Affine(dx, 0, x0 - dx / 2, 0, dy, y0 - dy / 2)
    return compose(Affine.scale(_metres(dataset, axes)), transform) if dataset.crs is None else transform


def _metres(dataset: Any, axes: list[_Axis]) -> float:
    """Metres in the unit of the axes; 1 if they are in degrees."""
    for axis in axes:
        metres = metres_in(axis.unit)
        if metres is None and not axis.unit.lower().startswith("degree"):
            raise ReadError(
                f"Its coordinates {axis.name!r} are in {axis.unit!r}, and it names no CRS.", path=dataset.name,
                remedy="Write it with a CRS, or with coordinates in metres or degrees.",
            )  # fmt: skip
        if metres not in (None, 1.0):
            return float(metres)
    return 1.0


class _Axis(NamedTuple):
    """The coordinates along the rows, or down the columns."""

    name: str
    down: bool
    unit: str
    values: NDArray[Any]


def _axes(dataset: Any) -> list[_Axis]:
    """The coordinate variables of the last two dimensions: those that say so, or have a usual name."""
    if dataset.driver != "netCDF" or not here(main_file(dataset)):
        return []
    tags = dataset.tags()
    found = []
    for name in sorted(({key.partition("#")[0] for key in tags} - {"NC_GLOBAL"}) | set(_USUAL)):
        called = {name.lower(), str(tags.get(f"{name}#standard_name", "")).lower()}
        axis = str(tags.get(f"{name}#axis", "")).upper()
        down = bool(called & DOWN) or axis == "Y"
        if not down and not called & ACROSS and axis != "X":
            continue
        values = _values(dataset, name)
        if values is not None:
            found.append(_Axis(name, down, str(tags.get(f"{name}#units", "")).strip(), values))
    return found


def _values(dataset: Any, name: str) -> NDArray[Any] | None:
    """A variable of one dimension that fits the raster; None: there is none of that name."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(f'NETCDF:"{main_file(dataset)}":{name}') as axis:
                fits = axis.height == 1 and axis.width in dataset.shape
                values: NDArray[Any] | None = axis.read(1)[0] if fits else None
    except RasterioError:
        return None
    return values


def _numbers(text: str) -> list[float]:
    """The numbers of an attribute: "5", "{0,300}"."""
    try:
        return [float(number) for number in re.split(r"[{},\s]+", text) if number]
    except ValueError:
        return []
