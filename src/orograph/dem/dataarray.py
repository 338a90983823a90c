"""A DataArray of heights as a Dem.

The CRS and the place come from rioxarray's or CF's conventions: the coordinates along the last two dimensions, evenly
spaced, and a ``spatial_ref`` coordinate (or ``crs`` in the attributes); the nodata value from ``_FillValue`` (xarray
has turned it into NaN already where it decoded the file). Units: the ``units`` attribute, metres if there is none.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from orograph.dem.arrays import heights_of, metres_of, number_of
from orograph.dem.conventions import ACROSS, DOWN, ROTATED, even_axis, is_depth, metres_of_axes
from orograph.dem.header import settled_vertical
from orograph.dem.raster import Dem
from orograph.dem.units import metres_per
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, compose

HEIGHTS = {
    "elevation", "height", "altitude", "dem", "dtm", "dsm", "z", "topo", "topography", "orog", "orography", "hgt",
    "surface_altitude", "height_above_reference_ellipsoid", "height_above_geopotential_datum",
    "height_above_mean_sea_level", "band_data",
}  # fmt: skip
"""Names, and CF standard names, of variables that hold heights."""

STRIP = 1 << 22
"""Samples of an array converted at once."""


def axes_of(array: xr.DataArray) -> tuple[Any, Any]:
    """The dimensions down the columns and along the rows: the last two, in reverse order if their names say so.

    The name of a dimension, or its coordinate's ``axis`` or ``standard_name`` (CF), says what it is.
    """

    def says(dim: Any, names: set[str], axis: str) -> bool:
        attributes = array.coords[dim].attrs if dim in array.coords else {}
        called = {str(dim).lower(), str(attributes.get("standard_name", "")).lower()}
        return bool(called & names) or str(attributes.get("axis", "")).upper() == axis

    first, second = array.dims[-2:]
    turned = says(first, ACROSS, "X") and says(second, DOWN, "Y")
    return (second, first) if turned else (first, second)


def from_xarray(
    array: xr.DataArray, *, crs: str | CRS | None = None, name: str | None = None, nodata: float | str | None = None,
    vertical_unit: str | None = None, assume_vertical: str | None = None,
) -> Dem:  # fmt: skip
    """A Dem of a two-dimensional DataArray (further dimensions of length 1 are dropped).

    Args:
        array: heights with evenly spaced coordinates along its last two dimensions: rows and columns, or columns and
            rows if so named (``axes_of``).
        crs: the CRS, if the array has none. Without one, coordinates named longitude and latitude, or in degrees, are
            assumed to be WGS 84, with a warning.
        name: its name. Default: the array's own name, else that of its file.
        nodata: the stored number that means "missing", or "none"; None: as declared.
        vertical_unit: the unit of the heights; None: as declared, or metres.
        assume_vertical: their vertical datum.

    Raises:
        ReadError: coordinates that are missing or uneven, values that are not real numbers, or a unit not of length.
        UsageError: more than two dimensions longer than 1, or an option makes no sense.
    """
    called = name or str(array.name or _file_name(array) or "terrain")
    lead = [d for d in array.dims if array.sizes[d] == 1 and str(d).lower() not in ACROSS | DOWN]
    lead = lead[: max(0, array.ndim - 2)]
    if array.ndim - len(lead) != 2:
        raise UsageError(
            f"{called} has the dimensions {dict(array.sizes)}, but must have two.",
            remedy="Select one layer with .isel().",
        )
    array = array.isel(dict.fromkeys(lead, 0))
    array = array.transpose(*axes_of(array))
    unit = str(array.attrs.get("units", "m")) or "m"
    factor = metres_per(unit) if vertical_unit is None else metres_of(vertical_unit)
    if factor is None:
        raise ReadError(f"The unit of {called} is {unit!r}, which is not a length.", remedy="Set attrs['units'].")
    if is_depth(array.attrs):
        warnings.warn(f"The numbers of {called} are depths and become heights below 0.", stacklevel=2)
        factor = -factor
    known = _known_crs(array, crs, called)
    unit_of_axes = 1.0 if known is not None else _axes_metres(array, called)
    y_dim, x_dim = array.dims
    (x0, dx), (y0, dy) = (np.array(_axis(array, dim, called)) * unit_of_axes for dim in (x_dim, y_dim))
    stored = decoded(array)
    heights = _heights(stored, called, factor, _declared(stored) if nodata is None else number_of(nodata))
    if dy > 0:
        heights, y0, dy = heights[::-1], y0 + dy * (heights.shape[0] - 1), -dy
    if dx < 0:
        heights, x0, dx = heights[:, ::-1], x0 + dx * (heights.shape[1] - 1), -dx
    transform = Affine(dx, 0, x0 - dx / 2, 0, dy, y0 - dy / 2)
    grid = Grid((heights.shape[0], heights.shape[1]), transform, known)
    return Dem(np.ascontiguousarray(heights), grid, settled_vertical(None, assume_vertical, []), called)


def _known_crs(array: xr.DataArray, crs: str | CRS | None, called: str) -> CRS | None:
    """The CRS that is given or that an array has, or WGS 84 if its coordinates are in degrees."""
    known = _crs_of(array, crs)
    if known is not None or not _in_degrees(array):
        return known
    y_dim, x_dim = array.dims
    warnings.warn(
        f"{called} has no CRS; its coordinates {x_dim}, {y_dim} are assumed to be degrees of WGS 84 (otherwise give "
        "crs=…).", stacklevel=3,
    )  # fmt: skip
    return CRS.from_epsg(4326)


def _axes_metres(array: xr.DataArray, called: str) -> float:
    """Metres per unit of the coordinates of an array without a CRS."""
    attributes = {str(dim): array.coords[dim].attrs if dim in array.coords else {} for dim in array.dims}
    names = {name.lower() for dim, attrs in attributes.items() for name in (dim, str(attrs.get("standard_name", "")))}
    units = {dim: str(attrs.get("units", "")) for dim, attrs in attributes.items()}
    try:
        if names & ROTATED:
            raise ValueError("they are of a rotated pole")
        return metres_of_axes(units)
    except ValueError as error:
        raise ReadError(f"{called} has no CRS, and its coordinates are unclear: {error}.",
                        remedy="Give the CRS: crs=…") from None  # fmt: skip


def decoded(array: xr.DataArray) -> xr.DataArray:
    """An array with CF decoding applied if xarray has not done so.

    It is scaled, and NaN where values are missing or out of the valid range.
    """
    array = _within_range(array)
    attrs = array.attrs
    packed = attrs.get("scale_factor", 1) != 1 or attrs.get("add_offset", 0) != 0 or "missing_value" in attrs
    if not packed or array.dtype.kind not in "iuf":
        return array
    flat = xr.decode_cf(xr.Dataset({"heights": array.variable}), decode_times=False, decode_coords=False)
    return xr.DataArray(flat["heights"].variable)


def _within_range(array: xr.DataArray) -> xr.DataArray:
    """An array with NaN beyond its valid range, which refers to packed numbers."""
    attrs, was = array.attrs, array.encoding
    low, high = attrs.get("valid_range", (attrs.get("valid_min", -np.inf), attrs.get("valid_max", np.inf)))
    if (low, high) == (-np.inf, np.inf):
        return array
    scale = 1.0
    if not {"scale_factor", "add_offset"} & set(attrs) and {"scale_factor", "add_offset"} & set(was):
        scale, offset = was.get("scale_factor", 1.0), was.get("add_offset", 0.0)
        low, high = sorted((low * scale + offset, high * scale + offset))
        low, high = low - abs(scale) / 2, high + abs(scale) / 2  # (decoded numbers are rounded)
    return array.where((array >= low) & (array <= high))


def _declared(array: xr.DataArray) -> float | None:
    """The number that an array declares to mean "missing", if any."""
    fill = array.attrs.get("_FillValue")
    return None if fill is None or not np.isfinite(fill) else float(fill)


def _heights(array: xr.DataArray, called: str, factor: float, nodata: float | None) -> NDArray[np.float32]:
    """The heights of an array (rows, cols), metres; a lazy one is computed in strips, chunk by chunk of its rows."""
    whole = np.empty(array.shape, np.float32)
    rows = array.chunks[0] if array.chunks else (max(1, STRIP // max(1, array.shape[1])),) * array.shape[0]
    row = 0
    for height in rows:
        if row >= array.shape[0]:
            break
        part = array[row : row + height]
        whole[row : row + height] = heights_of(part.to_numpy(), called, nodata=nodata, factor=factor)
        row += height
    return whole


def from_dataset(dataset: xr.Dataset, *, crs: str | CRS | None = None, name: str | None = None) -> Dem:
    """A Dem of the one variable of a Dataset that holds heights (``heights_in``); arguments as for ``from_xarray``."""
    return from_xarray(heights_in(dataset), crs=crs, name=name)


def heights_in(dataset: xr.Dataset) -> xr.DataArray:
    """The variable of a Dataset that holds heights.

    It is the only two-dimensional one or, if there are several, the one that is declared as heights by its
    ``standard_name`` (CF) or its name.

    Raises:
        UsageError: there is none, or the choice is ambiguous.
    """
    flat = {str(k): v for k, v in dataset.data_vars.items() if sum(n != 1 for n in v.shape) == 2}
    named = {k: v for k, v in flat.items()
            if {k.lower(), str(v.attrs.get("standard_name", "")).lower()} & HEIGHTS}  # fmt: skip
    found = flat if len(flat) == 1 else named
    if len(found) != 1:
        there = ", ".join(flat) or "none"
        raise UsageError(
            f"A Dataset of {len(flat)} variables with rows and columns ({there}) does not say which holds heights.",
            remedy="Take it: dataset['name']." if flat else "Give a DataArray of two dimensions.",
        )
    (array,) = found.values()
    mapping = dataset.variables.get(array.attrs.get("grid_mapping", array.encoding.get("grid_mapping")))
    if mapping is not None and "spatial_ref" not in array.coords:
        array = array.assign_coords(spatial_ref=((), 0, mapping.attrs))
    return array


def place_of(array: xr.DataArray) -> tuple[NDArray[Any], Affine | None, CRS | None]:
    """The values of an image or a raster and their place, from its coordinates; None, None if it has none.

    Values are (rows, cols) or (rows, cols, bands).
    """
    flat, transform, crs = located(array)
    return flat.to_numpy(), transform, crs


def located(array: xr.DataArray) -> tuple[xr.DataArray, Affine | None, CRS | None]:
    """As ``place_of``, but without reading the values; rows and columns come first."""
    axes = [d for d in array.dims if str(d).lower() in ACROSS | DOWN or _says_axis(array, d)]
    if len(axes) != 2:
        axes = list(array.dims[-2:]) if array.sizes[array.dims[-1]] > 4 or array.ndim == 2 else list(array.dims[:2])
    flat = array.transpose(*axes, ...)
    y, x = axes_of(flat.isel({d: 0 for d in flat.dims if d not in axes}))
    flat = array.transpose(y, x, ...)
    if x not in array.coords or y not in array.coords:
        return flat, None, None
    called = str(array.name or "the layer")
    (x0, dx), (y0, dy) = _axis(array, x, called), _axis(array, y, called)
    crs = _crs_of(array, None)
    plane = flat.isel({d: 0 for d in flat.dims if d not in (x, y)})
    if crs is None and _in_degrees(plane):
        crs = CRS.from_epsg(4326)
    unit = 1.0 if crs is not None else _axes_metres(plane, called)
    return flat, compose(Affine.scale(unit), Affine(dx, 0, x0 - dx / 2, 0, dy, y0 - dy / 2)), crs


def _says_axis(array: xr.DataArray, dim: Any) -> bool:
    return dim in array.coords and str(array.coords[dim].attrs.get("axis", "")).upper() in ("X", "Y")


def says_crs(array: xr.DataArray) -> bool:
    """Whether an array has a CRS."""
    return _crs_of(array, None) is not None


def _file_name(array: xr.DataArray) -> str:
    """The stem of the file that an array was read from, if it is known."""
    source = array.encoding.get("source")
    return Path(source).stem if isinstance(source, str) else ""


def _axis(array: xr.DataArray, dim: Any, called: str) -> tuple[float, float]:
    """First coordinate and step along a dimension."""
    if dim not in array.coords:
        raise ReadError(f"{called} has no coordinates along {dim!r}.", remedy="Assign them, in the units of its CRS.")
    try:
        return even_axis(np.asarray(array.coords[dim].values))
    except (ValueError, TypeError) as error:
        raise ReadError(
            f"The coordinates of {called} along {dim!r} are not evenly spaced: {error}.",
            remedy="Resample it first (interp).",
        ) from None


def _in_degrees(array: xr.DataArray) -> bool:
    """Whether the coordinates fit the globe, and are named longitude and latitude or are in degrees."""
    y_dim, x_dim = array.dims

    def says(dim: Any, names: set[str], most: float) -> bool:
        values, attributes = array.coords[dim], array.coords[dim].attrs
        called = {str(dim).lower(), str(attributes.get("standard_name", "")).lower()}
        degrees = str(attributes.get("units", "")).lower().startswith("degree")
        return bool(np.abs(values).max() <= most and (called & names or degrees))

    if {str(dim).lower() for dim in array.dims} & ROTATED:
        return False
    return says(x_dim, {"lon", "long", "longitude"}, 360.5) and says(y_dim, {"lat", "latitude"}, 90.5)


def _crs_of(array: xr.DataArray, given: str | CRS | None) -> CRS | None:
    found: Any = given
    if found is None and "spatial_ref" in array.coords:
        attributes = array.coords["spatial_ref"].attrs
        found = attributes.get("crs_wkt") or attributes.get("spatial_ref")
    if found is None:
        found = array.attrs.get("crs")
    try:
        return None if found is None else CRS.from_user_input(found)
    except CRSError:
        raise ReadError(f"The CRS {found!r} is not known to PROJ.", remedy="Give another: crs=…") from None
