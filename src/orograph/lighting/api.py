"""Maps of light in Python: the products on arrays, Dems, terrains and xarray, in one call each.

>>> from orograph import lighting
>>> lighting.slope(np.zeros((3, 3)), cell=30.0)                                # doctest: +SKIP
>>> lighting.sky_view_factor(orograph.read("dem.tif"), azimuths=32).save("sky.tif")  # doctest: +SKIP

The result has the type of the input: an array for an array, a DataArray for a DataArray; for a Dem, a Terrain or files
a ``Map`` on the terrain's grid. Heights in degrees or feet are first converted to a metric CRS, as everywhere.

A DataArray keeps its dimensions, in their order, and its scalar coordinates; if its coordinates were degrees, the
map's are metres, along ``y`` and ``x``. Its attributes are the map's own (units, long_name). Lazy arrays (Dask) are
computed: horizons need the whole terrain.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._named import answering
from orograph.cards import extent_rows, one_line
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.geo.grid import Grid
from orograph.lighting.context import MEMORY, Context, Options
from orograph.lighting.maps import write_map
from orograph.lighting.products import compute, described, product
from orograph.lighting.raster import Band, write
from orograph.lighting.rho import Rho
from orograph.lighting.sun import Given, Sun, sun_of
from orograph.output import check_folder
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.several import words
from orograph.store.given import READING, check_apart, is_array_like, is_rows, the_heights
from orograph.store.opening import terrain as terrain_given
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    import xarray as xr

Values = NDArray[np.float32]


@dataclass(frozen=True, slots=True, repr=False)
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

    def __repr__(self) -> str:
        return one_line("Map", ", ".join(band.name for band in self.bands), extent_rows(self.grid))

    def plot(self, ax: Any = None, band: int = 0, **options: Any) -> Any:
        """Draw a band on matplotlib's axes, where it lies in its CRS, with a colour bar.

        Args:
            ax: the axes; None: new ones. band: which, from 0.
            options: for ``Axes.imshow`` (``cmap``, ``vmin``…).

        Returns: the ``AxesImage``.
        """
        try:
            from matplotlib import pyplot
        except ImportError as error:
            raise UsageError(
                "Plots need matplotlib, which is not installed.", remedy="pip install matplotlib"
            ) from error
        if self.grid.transform.b or self.grid.transform.d:
            raise UsageError("A rotated grid has no coordinates along its rows and columns.")
        if ax is None:
            _, ax = pyplot.subplots(layout="constrained")
        west, south, east, north = self.grid.bounds()
        image = ax.imshow(self.values[band], extent=(west, east, south, north), **{"cmap": "gray", **options})
        about = self.bands[band]
        ax.figure.colorbar(
            image,
            ax=ax,
            label=f"{about.name} ({about.unit})" if about.unit not in ("", "1") else about.name,
            shrink=0.8,
        )
        return image

    def save(self, path: str | os.PathLike[str], *, byte: bool = False) -> None:
        """Write a Cloud Optimized GeoTIFF, float32 or 8-bit (see ``raster.write``).

        Raises:
            UsageError: the ending is not .tif or .tiff. OutputError: it cannot be written.
        """
        if Path(path).suffix.lower() not in (".tif", ".tiff"):
            raise UsageError(
                "A map is saved as a GeoTIFF.", path=path, remedy="Use .tif; its method plot() draws it.",
            )  # fmt: skip
        smooth = "nearest" if any(b.name in ("aspect", "code") for b in self.bands) else "average"
        write(path, self.grid, self.bands, [(0, 0, 0, self.values)], byte=byte, overviews=smooth)

    def to_xarray(self) -> xr.DataArray:
        """A DataArray with the dimensions (band,) y, x; one band has no dimension of its own."""
        from orograph.dem.labelled import laid_out

        first = self.bands[0]
        attrs = {"units": first.unit, "long_name": first.doc}
        if len(self.bands) == 1:
            return laid_out(self.values[0], self.grid, first.name, attrs)
        return laid_out(self.values, self.grid, None, attrs).assign_coords(band=[band.name for band in self.bands])


@answering
def make(
    data: Any,
    products: str | Sequence[str] = "",
    *,
    cell: float | tuple[float, float] | ArrayLike | None = None,
    jobs: int | None = None,
    max_memory: Amount = MEMORY,
    output: str | os.PathLike[str] | None = None,
    byte: bool = False,
    resume: bool = False,
    progress: Progress | bool | None = None,
    **options: Any,
) -> Any:
    """A product, by its name on the command line.

    Args:
        data: heights: an array (rows, cols), metres, NaN where missing, or whatever else ``orograph.terrain`` takes: a
            path, a list of them, a Dem, a Terrain, a DataArray, an open rasterio dataset…
        products: "slope", "sky-view-factor"…: ``lighting.products.names()``; one must be given. Several, in a sequence
            or a text ("slope,aspect"), become bands of one result.
        cell: for arrays, which need it: metres between samples, along both axes or as (along rows, along columns), rows
            running south; or the (2, 2) linear part of a geotransform.
        jobs: threads; None: all processors. max_memory: bytes the process should stay within.
        output: write this GeoTIFF (.tif) instead, block by block, so that maps larger than memory work.
        byte: of the file: 8-bit values for display, not float32 in physical units. resume: keep finished work in
            ``OUTPUT.partial``, and go on from there after an interruption.
        progress: gets progress reports; None: bars in terminals and notebooks, and Python's warnings; False: silent.
        options: how the data are read, as for ``orograph.terrain`` (``crs``, ``band``, ``transform``…: an array with
            its place gives a ``Map``); and those of ``products.Options``: azimuths, radius, lights, curvature…, and of
            its ``more``. The ``sun`` is (azimuth, altitude), a datetime with its zone, or a ``Sun``.

    Returns:
        for an array (rows, cols) float32, or (bands, rows, cols) of products of several bands; for a DataArray a
        DataArray; else a ``Map``. With ``output`` its path.

    Raises:
        UsageError: there is no such product, an option is wrong, or an array comes without ``cell``.
        ReadError: the data lack something that is needed. OutputError: the file cannot be written.
    """
    progress, max_memory = reporting(progress), bytes_of(max_memory)
    reading = {k: options.pop(k) for k in READING if k in options}
    chosen = Options.of(**{k: v for k, v in options.items() if k != "sun"})
    names = words(products) or ("",)
    wanted = [product(each) for each in names]
    check_output(output, data, byte=byte, resume=resume)
    data = the_heights(data)
    is_xarray = "xarray" in sys.modules and isinstance(data, sys.modules["xarray"].DataArray)
    is_array = not is_xarray and not reading and (is_rows(data) or is_array_like(data))
    if is_array:
        if cell is None:
            raise UsageError(
                "An array does not define the distance between its samples.",
                remedy="Give cell=…, in metres; or spacing=, or transform= and crs=, for a Map with its place.",
            )
        from orograph.lighting.arrays import terrain_of

        terrain: Terrain = terrain_of(data, _linear(cell))
    else:
        if cell is not None:
            raise UsageError("The cell size applies to plain arrays only; other data have their own.")
        terrain = terrain_given(data, progress, max_memory=max_memory, jobs=jobs, called="light", **reading)
    sun = Sun()
    if options.get("sun") is not None:
        sun = sun_of(options["sun"], terrain.grid)
        more = chosen.more if isinstance(options["sun"], tuple) else {"diameter": sun.diameter, **chosen.more}
        chosen = replace(chosen, sun=(sun.azimuth, sun.altitude), more=more)
    if output is not None:
        write_map(output, terrain, names, chosen, sun, byte=byte, resume=resume, jobs=jobs, max_memory=max_memory,
                  progress=progress)  # fmt: skip
        return Path(output)
    values = compute(Context(terrain, chosen, jobs=jobs, max_memory=max_memory, progress=progress), *names)
    if is_array:
        return values[0] if len(values) == 1 else values
    made = Map(values, terrain.grid, tuple(described(wanted, chosen)))
    return _like(made.to_xarray(), data) if is_xarray else made


def check_output(output: str | os.PathLike[str] | None, data: Any, **how: bool) -> None:
    """Raise UsageError or OutputError if a map cannot be written there.

    Args:
        how: ``byte`` and ``resume``.
    """
    if output is None:
        given = [f"`{name}`" for name, value in how.items() if value]
        if given:
            raise UsageError(f"{given[0]} is about a file.", remedy="Give `output`, or save the map (`byte=True`).")
        return
    if Path(output).suffix.lower() not in (".tif", ".tiff"):
        raise UsageError("A map is saved as a GeoTIFF.", path=output, remedy="Use .tif.")
    check_folder(Path(output))
    check_apart(output, data)


def _linear(cell: float | tuple[float, float] | ArrayLike) -> NDArray[np.float64]:
    try:
        size = np.asarray(cell, np.float64)
    except (TypeError, ValueError):
        size = np.empty(0)
    if size.shape == (2, 2):
        return size
    if size.shape not in ((), (2,)) or not (size > 0).all():
        raise UsageError(f"A cell must be one or two positive numbers of metres, or a 2 × 2 matrix, not {cell!r}.")
    x, y = np.broadcast_to(size, 2)
    return np.array([[x, 0.0], [0.0, -y]])


def _like(made: xr.DataArray, given: xr.DataArray) -> xr.DataArray:
    """Add the scalar coordinates of the input; on the same grid also its dimensions, in their order."""
    from orograph.dem.dataarray import axes_of

    scalars = {k: v.variable for k, v in given.coords.items() if v.ndim == 0 and k not in ("spatial_ref", "band")}
    made = made.assign_coords({k: v for k, v in scalars.items() if k not in made.coords})
    y, x = axes_of(given)
    for ours, theirs in (("y", y), ("x", x)):
        values = np.asarray(given[theirs].values, np.float64)
        if len(values) != made.sizes[ours]:
            return made
        if len(values) > 1 and (values[-1] - values[0]) * float(made[ours][-1] - made[ours][0]) < 0:
            made = made.isel({ours: slice(None, None, -1)})
        # Coordinates may be float32: compare them to a hundredth of a cell.
        apart = np.abs(made[ours].values - values).max()
        if (len(values) > 1 and apart > 0.01 * abs(values[1] - values[0])) or (len(values) == 1 and apart > 1e-3):
            return made
    made = made.rename({k: v for k, v in (("y", y), ("x", x)) if k != v})
    return made.transpose(..., *[d for d in given.dims if d in (y, x)])


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
    sun: Given | None = None,
    **options: Any,
) -> Any:
    """Lambert's cosine in [0, 1], under one light or the weighted mean of several (azimuth, altitude, weight).

    ``sun``, if given, in place of azimuth and altitude: as for ``shadows``.
    """
    return make(data, "hillshade", sun=(azimuth, altitude) if sun is None else sun, lights=tuple(lights), **options)


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


def ambient_occlusion(
    data: Any, radius: float | None = None, *, rho: Rho = "step", method: str = "horizon", **options: Any
) -> Any:
    """Share of ambient light that reaches the ground, out of the hemisphere around its normal.

    Args:
        radius: metres beyond which nothing occludes; None: unlimited (a step only).
        rho: how much an occluder at a distance lets through: "step", "linear" or a function of metres
        (``lighting.rho``).
        method: "horizon" (of ``azimuths``), "rays", "shadow-maps" (``rays`` each) or "cone-tracing" (``cones``).
        data, options: and the result: ``make``.
    """
    return make(data, "ambient-occlusion", radius=radius, rho=rho, method=method, **options)


def apertures(data: Any, azimuths: int = 32, *, method: str = "horizon", **options: Any) -> Any:
    """The visible sky as one cap, four bands: its direction (east, north, up) and radius in degrees.

    ``method``: "horizon" or "rays". Further arguments and result: ``make``.
    """
    return make(data, "aperture", azimuths=azimuths, method=method, **options)


def shadows(data: Any, sun: Given, **options: Any) -> Any:
    """The visible part of the sun's disc, and a code (``lighting.shadow``): two bands.

    Args:
        sun: (azimuth, altitude) in degrees; a datetime with its zone, or such a time as text: the real sun over the
            terrain's middle, refraction included; or a ``Sun``, with a diameter of its own.
        data, options: and the result: ``make``. Further: ``strips``, ``diameter``, ``curvature``.
    """
    return make(data, "shadow", sun=sun, **options)


def insolation(data: Any, date: str, azimuths: int = 64, **options: Any) -> Any:
    """Energy of sun and sky on the ground under a clear sky, Wh/m²: direct, diffuse, global.

    Args:
        date: "2026", "2026-06" or "2026-06-21", in mean solar time.
        data, options: and the result: ``make``. Further: ``step`` (minutes), ``turbidity`` (Linke's).

    Raises:
        UsageError: also if the data have no place on Earth, as plain arrays do not.
    """
    return make(data, "insolation", date=date, azimuths=azimuths, **options)


def sunshine(data: Any, date: str, azimuths: int = 64, **options: Any) -> Any:
    """Hours of direct sun on the ground, under a clear sky.

    Args:
        date: "2026", "2026-06" or "2026-06-21", in mean solar time.
        data, options: and the result: ``make``. Further: ``step`` (minutes).

    Raises:
        UsageError: also if the data have no place on Earth, as plain arrays do not.
    """
    return make(data, "sunshine", date=date, azimuths=azimuths, **options)
