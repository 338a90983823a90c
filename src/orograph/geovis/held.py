"""Images and rasters in memory as files in GDAL's memory, so that layers are always files.

Arrays, DataArrays, and datasets without a file of their own. A file is there as long as its ``Held`` is.
"""

from __future__ import annotations

import sys
import uuid
import weakref
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.dem.arrays import affine_of
from orograph.dem.datasets import file_of, is_dataset
from orograph.dem.header import parsed_crs
from orograph.errors import UsageError


class Held:
    """A file in GDAL's memory. ``path``: its name there."""

    def __init__(self, name: str) -> None:
        from rasterio.io import MemoryFile

        self._file = MemoryFile(filename=f"{uuid.uuid4().hex}/{name.replace('/', '-')}.tif")
        self.path = str(self._file.name)
        weakref.finalize(self, self._file.close)

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process has the same file, in its own memory."""
        self._file.seek(0)
        return _again, (self.path, self._file.read())


class _Copy(Held):
    """A file of another process."""

    def __init__(self, path: str, data: bytes) -> None:
        from rasterio.io import MemoryFile

        self._file = MemoryFile(data, filename=path.removeprefix("/vsimem/"))
        self.path = path


_copies: dict[str, Held] = {}
"""Those of other processes, by their paths, as long as this one runs: their names are not free again."""


def _again(path: str, data: bytes) -> Held:
    if path not in _copies:
        _copies[path] = _Copy(path, data)
    return _copies[path]


def held(given: Any, transform: Any = None, crs: Any = None) -> tuple[str, Held | None]:
    """The path of an image or a raster that is no path, and what keeps it there.

    Args:
        given: an array (rows, cols), or of colours (rows, cols, 3 or 4) or (3 or 4, rows, cols): bytes, or numbers from
            0 to 1; an ``xarray.DataArray`` of such, or what becomes one by ``to_xarray()`` (a map of light); an open
            rasterio dataset. What a mask hides, and NaN, is clear.
        transform, crs: where an array lies; without them it spans the terrain.

    Raises:
        UsageError: it is none of these.
    """
    if is_dataset(given):
        path = file_of(given)
        if path is not None:
            return path, None
        from rasterio.shutil import copy

        kept = Held(str(given.name).rpartition("/")[2].partition(".")[0] or "dataset")
        copy(given, kept.path, driver="GTiff")
        return kept.path, kept
    name = "array"
    if hasattr(given, "to_xarray"):  # a map of light, a viewshed, a difference
        given = given.to_xarray()
    xarray = sys.modules.get("xarray")
    if xarray is not None and isinstance(given, xarray.DataArray):
        from orograph.dem.dataarray import place_of

        name = str(given.name or name)
        given, found, own = place_of(given)
        transform = found if transform is None else transform
        crs = own if crs is None else crs
    bands, clear = _bands(given)
    shape = (bands.shape[1], bands.shape[2])
    place = None if transform is None else affine_of(transform, None, crs, shape, [])
    kept = Held(name)
    _write(kept.path, bands, clear, place, None if crs is None else parsed_crs(crs).to_wkt())
    return kept.path, kept


def _write(path: str, bands: NDArray[Any], clear: NDArray[np.bool_] | None, place: Affine | None, crs: Any) -> None:
    import warnings

    import rasterio
    from rasterio.enums import ColorInterp
    from rasterio.errors import NotGeoreferencedWarning

    count, rows, cols = bands.shape
    profile: dict[str, Any] = {
        "driver": "GTiff", "width": cols, "height": rows, "count": count, "dtype": bands.dtype.name, "tiled": True,
    }  # fmt: skip
    if bands.dtype.kind == "f":
        profile["nodata"] = float("nan")
    with warnings.catch_warnings(), rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile, **({} if place is None else {"transform": place, "crs": crs})) as out:
            if count > 2:
                out.colorinterp = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha][:count]
            out.write(bands)
            if clear is not None and count != 4:
                out.write_mask(~clear)


def _bands(given: Any) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """An array as bands (1, 3 or 4, rows, cols) of a type that GeoTIFFs have, and where a mask hides all of it."""
    raw = np.ma.getdata(given) if isinstance(given, np.ma.MaskedArray) else np.asarray(given)
    hidden = np.ma.getmaskarray(given) if isinstance(given, np.ma.MaskedArray) else None
    if raw.dtype.kind not in "iufb" or raw.ndim not in (2, 3) or 0 in raw.shape:
        raise UsageError(
            "A layer must be a path, an open dataset, or array (rows, cols) or (rows, cols, 3 or 4) of real numbers, "
            f"not {type(given).__name__} of {raw.dtype}, {raw.shape}."
        )
    if raw.ndim == 2:
        raw, hidden = raw[None], None if hidden is None else hidden[None]
    elif raw.shape[2] in (1, 3, 4):
        raw, hidden = np.moveaxis(raw, 2, 0), None if hidden is None else np.moveaxis(hidden, 2, 0)
    elif raw.shape[0] not in (1, 3, 4):
        raise UsageError(f"An image has 1, 3 or 4 bands; this array has the shape {raw.shape}.")
    clear: NDArray[np.bool_] | None = None if hidden is None else np.asarray(hidden.any(0))
    if raw.dtype.kind == "f" and len(raw) > 2:
        known = np.isfinite(raw)
        if known.any() and raw[known].min() >= 0 and raw[known].max() <= 1:
            gone = ~known.all(0)
            clear = gone if clear is None else clear | gone
            raw = np.round(np.where(known, raw, 0) * 255).astype(np.uint8)
    if raw.dtype.kind == "f":
        raw = raw.astype(np.float32 if raw.dtype.itemsize <= 4 else np.float64)
    elif raw.dtype.kind == "b":
        raw = raw.astype(np.uint8)
    elif raw.dtype.itemsize == 8:
        raw = raw.astype(np.float64)
    if clear is not None and len(raw) == 4:
        raw = raw.copy()
        raw[3][clear] = 0
    return np.ascontiguousarray(raw, raw.dtype.newbyteorder("=")), clear
