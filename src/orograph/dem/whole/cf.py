"""Parts of the netCDF conventions (CF 1.11) that GDAL ignores in a variable that it has opened.

- Axes (§2.8, §4): GDAL compares a few coordinates with an absolute tolerance of 0.001, which is several samples of a
  fine grid in degrees. Here, all are compared.
- Units of axes without a CRS (§4).
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

from affine import Affine
from numpy.typing import NDArray

from orograph.dem.conventions import ACROSS, DOWN, even_axis, is_depth, metres_of_axes
from orograph.dem.whole.files import here, main_file
from orograph.errors import ReadError
from orograph.geo.grid import compose

_USUAL = ("x", "y", "lon", "lat", "longitude", "latitude", "easting", "northing")


def is_depth_of(dataset: Any, band: int) -> bool:
    """Whether a netCDF variable is declared as a depth."""
    return dataset.driver == "netCDF" and is_depth(dataset.tags(band))


def refuse_uneven(dataset: Any) -> None:
    """Raise ReadError if the coordinates along an axis of a netCDF variable are not evenly spaced."""
    for axis in _axes(dataset):
        try:
            even_axis(axis.values)
        except ValueError as error:
            raise ReadError(
                f"Its coordinates {axis.name!r} are not evenly spaced: {error}.", path=dataset.name,
                remedy="Resample it to a regular grid first (in Python: xarray's interp).",
            ) from None  # fmt: skip


def transform_of(dataset: Any) -> Affine:
    """The geotransform of a netCDF variable that names no CRS (in metres) or is in degrees.

    GDAL recognises axes by their standard names only. Axes that are only named x and y, longitude and latitude… are
    read here; for them GDAL counts rows from the last to the first.

    Raises:
        ReadError: their unit is neither a length nor degrees.
    """
    transform = Affine(*dataset.transform[:6])
    if dataset.crs is not None and not transform.is_identity:
        return transform
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
    """Metres in the unit of axes that have no CRS."""
    try:
        return metres_of_axes({axis.name: axis.unit for axis in axes})
    except ValueError as error:
        raise ReadError(
            f"It declares no CRS for its coordinates: {error}.", path=dataset.name,
            remedy="Add a CRS, or use coordinates in metres or degrees.",
        ) from None  # fmt: skip


class _Axis(NamedTuple):
    """The coordinates along the rows, or down the columns."""

    name: str
    down: bool
    unit: str
    values: NDArray[Any]


def _axes(dataset: Any) -> list[_Axis]:
    """The coordinate variables of the last two dimensions: those declared as such, or with a usual name."""
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
    """A variable of one dimension that fits the raster; None if there is none of that name."""
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
