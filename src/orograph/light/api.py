"""Maps of light in Python: the products on arrays, Dems, terrains and xarray, in one call each.

>>> from orograph import light
>>> light.slope(np.zeros((3, 3)), cell=30.0)                                # doctest: +SKIP
>>> light.sky_view_factor(orograph.read("dem.tif"), azimuths=32).save("sky.tif")  # doctest: +SKIP

What comes back is what was given: an array for an array, a DataArray for a DataArray; for a Dem, a Terrain or files a
``Map``, whose grid is the terrain's. Heights in degrees or feet are brought to a metric CRS first, as everywhere.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.light.products import MEMORY, Context, Options, compute, product
from orograph.light.raster import Band, write
from orograph.light.sun import sun_of
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    import xarray as xr

    from orograph.dem import Dem

Values = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Map:
    """A product on a terrain's grid.

    Attributes:
        values: (bands, rows, cols) float32 in the bands' units, NaN where missing.
        grid: where they lie.
        bands: their names and units.
    """

    values: Values
    grid: Grid
    bands: tuple[Band, ...]

    def save(self, path: str | os.PathLike[str], *, byte: bool = False) -> None:
        """Write a Cloud Optimized GeoTIFF, float32 or 8-bit (see ``raster.write``)."""
        smooth = "nearest" if any(b.name in ("aspect", "code") for b in self.bands) else "average"
        write(path, self.grid, self.bands, [(0, 0, 0, self.values)], byte=byte, overviews=smooth)

    def to_xarray(self) -> xr.DataArray:
        """A DataArray with the dimensions (band,) y, x; one band has no dimension of its own."""
        import xarray as xr

        grid, first = self.grid, self.bands[0]
        if grid.transform.b or grid.transform.d:
            raise UsageError("A rotated grid has no coordinates along its rows and columns.")
        x, _ = grid.xy(np.arange(grid.cols), 0)
        _, y = grid.xy(0, np.arange(grid.rows))
        coords: dict[str, Any] = {"y": y, "x": x}
        if grid.crs is not None:
            coords["spatial_ref"] = ((), 0, {"crs_wkt": grid.crs.to_wkt(), "spatial_ref": grid.crs.to_wkt()})
        attrs = {"units": first.unit, "long_name": first.doc}
        if len(self.bands) == 1:
            return xr.DataArray(self.values[0], coords, ("y", "x"), first.name, attrs)
        coords["band"] = [b.name for b in self.bands]
        return xr.DataArray(self.values, coords, ("band", "y", "x"), None, attrs)


def make(
    data: Any,
    name: str,
    *,
    cell: float | tuple[float, float] | ArrayLike | None = None,
    jobs: int | None = None,
    max_memory: int = MEMORY,
    progress: Progress = SILENT,
    **options: Any,
) -> Any:
    """A product, by its name on the command line.

    Args:
        data: heights: an array (rows, cols), metres, NaN where missing; a DataArray; a Dem; a Terrain; or the path of a
            DEM file or a store.
        name: "slope", "sky-view-factor"…: ``products.names()``.
        cell: for arrays, which need it: metres between samples, along both axes or as (along rows, along columns), rows
            running south; or the (2, 2) linear part of a geotransform.
        options: those of ``products.Options``: azimuths, radius, lights, curvature…; others go into its ``more``. The
            ``sun`` is (azimuth, altitude), a datetime with its zone, or a ``Sun``.

    Returns:
        for an array (rows, cols) float32, or (bands, rows, cols) of products of several bands; for a DataArray a
        DataArray; else a ``Map``.

    Raises:
        UsageError: there is no such product, an option is wrong, or an array comes without ``cell``.
        ReadError: the data do not say what is needed of them.
    """
    wanted = product(name)
    fields = set(Options.__dataclass_fields__) - {"more"}
    known = {k: v for k, v in options.items() if k in fields and k != "sun"}
    chosen = Options(**known, more={k: v for k, v in options.items() if k not in fields})
    is_xarray = "xarray" in sys.modules and isinstance(data, sys.modules["xarray"].DataArray)
    is_array = isinstance(data, np.ndarray | list | tuple)
    if is_array:
        if cell is None:
            raise UsageError("An array does not say how far its samples are apart.", remedy="Give cell=…, in metres.")
        from orograph.light.arrays import terrain_of

        terrain: Terrain = terrain_of(data, _linear(cell))
    else:
        if cell is not None:
            raise UsageError("The cell size is for plain arrays; other data say it themselves.")
        terrain = _terrain(data, is_xarray, max_memory, jobs, progress)
    if options.get("sun") is not None:
        sun = sun_of(options["sun"], terrain.grid)
        more = chosen.more if isinstance(options["sun"], tuple) else {"diameter": sun.diameter, **chosen.more}
        chosen = replace(chosen, sun=(sun.azimuth, sun.altitude), more=more)
    values = compute(Context(terrain, chosen, jobs=jobs, max_memory=max_memory, progress=progress), name)
    if is_array:
        return values[0] if len(values) == 1 else values
    made = Map(values, terrain.grid, wanted.described(chosen))
    return _like(made.to_xarray(), data) if is_xarray else made


def _linear(cell: float | tuple[float, float] | ArrayLike) -> NDArray[np.float64]:
    size = np.asarray(cell, np.float64)
    if size.shape == (2, 2):
        return size
    if size.shape not in ((), (2,)) or not (size > 0).all():
        raise UsageError(f"A cell is one or two positive numbers of metres, or a 2 × 2 matrix, not {cell!r}.")
    x, y = np.broadcast_to(size, 2)
    return np.array([[x, 0.0], [0.0, -y]])


def _terrain(data: Any, is_xarray: bool, max_memory: int, jobs: int | None, progress: Progress) -> Terrain:
    if isinstance(data, Terrain):
        return data
    from orograph import store

    if is_xarray:
        from orograph.dem.accessor import from_xarray

        return store.terrain(from_xarray(data), progress)
    if isinstance(data, str | os.PathLike):
        from orograph.store.detect import is_store

        if is_store(data):
            return store.open(data, cache_bytes=min(64 << 20, max_memory // 16), jobs=jobs)
        from orograph.dem.mosaic import Mosaic

        return store.terrain(Mosaic.open(data, progress=progress), progress)
    dem: Dem = data
    if not hasattr(dem, "heights") or not hasattr(dem, "grid"):
        raise UsageError(f"Heights are an array, a DataArray, a Dem, a Terrain or a path, not {type(data).__name__}.")
    return store.terrain(dem, progress)


def _like(made: xr.DataArray, given: xr.DataArray) -> xr.DataArray:
    """With the names of the given dimensions, and their order where the coordinates are the same."""
    y, x = given.dims[-2:]
    made = made.rename({k: v for k, v in (("y", y), ("x", x)) if k != v})
    for dim in (y, x):
        ours, theirs = made[dim].values, np.asarray(given[dim].values, np.float64)
        if len(ours) == len(theirs) and len(ours) > 1 and (ours[1] - ours[0]) * (theirs[1] - theirs[0]) < 0:
            made = made.isel({dim: slice(None, None, -1)})
    return made


def normals(data: Any, **options: Any) -> Any:
    """Unit normals, three bands: east, north, up. Arguments and result: ``make``."""
    return make(data, "normal", **options)


def slope(data: Any, **options: Any) -> Any:
    """Steepness, degrees. Arguments and result: ``make``."""
    return make(data, "slope", **options)


def aspect(data: Any, **options: Any) -> Any:
    """The azimuth in which the ground falls, degrees clockwise from north, NaN where level. Arguments: ``make``."""
    return make(data, "aspect", **options)


def hillshade(
    data: Any,
    azimuth: float = 315.0,
    altitude: float = 45.0,
    *,
    lights: Sequence[tuple[float, float, float]] = (),
    **options: Any,
) -> Any:
    """Lambert's cosine in [0, 1], under one light or the weighted mean of several (azimuth, altitude, weight)."""
    return make(data, "hillshade", sun=(azimuth, altitude), lights=tuple(lights), **options)


def horizons(data: Any, azimuths: int = 32, **options: Any) -> Any:
    """Elevation of the horizon, degrees, one band per azimuth. Further: ``radius``, ``curvature``; ``make``."""
    return make(data, "horizon", azimuths=azimuths, **options)


def sky_view_factor(data: Any, azimuths: int = 32, *, horizontal: bool = False, **options: Any) -> Any:
    """Share of a uniform sky's light on the inclined ground (Dozier & Frew 1990), or on a horizontal surface there."""
    return make(data, "sky-view-horizontal" if horizontal else "sky-view-factor", azimuths=azimuths, **options)


def visible_sky(data: Any, azimuths: int = 32, **options: Any) -> Any:
    """Share of the hemisphere's solid angle that is sky. Further arguments: ``radius``, ``curvature``; ``make``."""
    return make(data, "visible-sky", azimuths=azimuths, **options)


def openness(
    data: Any, azimuths: int = 8, *, radius: float | None = None, negative: bool = False, **options: Any
) -> Any:
    """Positive or negative openness, degrees (Yokoyama et al. 2002). Arguments and result: ``make``."""
    name = "openness-negative" if negative else "openness"
    return make(data, name, azimuths=azimuths, radius=radius, **options)
