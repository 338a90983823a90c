"""Values of rasters over a terrain: which bands are meant, what they are, their mean and how they differ.

A file's bands are the members of an ensemble, the times of a series, or different things, as the user says; GDAL's
metadata tell times (GRIB's valid time, CF's ``time`` dimension) and units. Larger windows than ``MOST`` samples are
averaged as they are read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.fills import are_codes
from orograph.dem.handles import HANDLES, cause_of, locate
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, compose
from orograph.geovis.data.attribute_table import Named, named_beside
from orograph.geovis.data.choosing import chosen_bands, is_level, picked, time_words, wants_members
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.listing import array_of, subdataset, times_in
from orograph.geovis.data.statistics import statistic
from orograph.geovis.data.times import matches, neighbours
from orograph.geovis.data.vertical import vertical_dimension
from orograph.geovis.keys import written_unit
from orograph.geovis.placement import Lattice, Placement, extent, grid_of

Values = NDArray[np.float32]

MOST = 1 << 22
"""Samples of a window that are held of each band."""

PROBE = 512
"""Side of the reduced window that says whether a raster holds codes."""

HELD = 1 << 27
"""Samples of all bands together."""

HOT = 150.0
"""Degrees Celsius that no air or ground has: values above it are kelvin, whatever the file says."""


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Values of one thing over a terrain.

    Attributes:
        values: (members, rows, cols) float32, NaN where there are none. grid: of rows and columns, in their own CRS.
        name, unit: what they are. chosen: what was chosen of several, in words. warnings: full sentences.
        statistic: what is shown of members ("mean", "p90"…: see ``statistics``).
        tags, palette, named: of classes (``classes``), what the source, or a file beside it, says of their names and
            colours. coded: whether its numbers seem to be codes of classes although nothing says so.
    """

    values: Values
    grid: Grid
    name: str
    unit: str
    chosen: str = ""
    warnings: tuple[str, ...] = ()
    statistic: str = "mean"
    tags: Mapping[str, Any] = field(default_factory=dict)
    palette: Mapping[int, Any] | None = None
    named: Named | None = None
    coded: bool = False

    @property
    def classified(self) -> bool:
        """Whether its numbers stand for names, as the source says or as they seem to."""
        said = self.palette is not None or self.named is not None or "flag_meanings" in self.tags
        return said or self.coded

    @property
    def mean(self) -> Values:
        """(rows, cols): of the members that are known at a sample."""
        return np.asarray(self.values[0]) if len(self.values) == 1 else statistic(self.values, "mean")

    @property
    def shown(self) -> Values:
        """(rows, cols): what is shown of the members."""
        return self.mean if self.statistic == "mean" else statistic(self.values, self.statistic)

    def uncertainty(self, measure: str) -> Values:
        """(rows, cols): how members differ, "spread" or "ci90" (see ``dataset.Measure``).

        Raises:
            UsageError: there are fewer than two members.
        """
        if len(self.values) < 2:
            raise UsageError(
                f"The {measure} is of members, but {self.name} has only one.",
                remedy="Choose several: band=all, time=T12, or member=all.",
            )
        few = np.isfinite(self.values).sum(0) < 2
        values = np.where(few, 0, self.values).astype(np.float64)
        if measure == "spread":
            found = np.nanstd(values, axis=0, ddof=1)
        else:
            low, high = np.nanquantile(values, [0.05, 0.95], axis=0)
            found = (high - low) / 2
        return np.where(few, np.nan, found).astype(np.float32)


def read(given: Dataset | Uncertainty, grid: Grid) -> Field:
    """The values of data over a terrain with this grid. At a moment between two times of a series they are linear in
    time; of classes, those of the nearer time.

    Raises:
        ReadError: the file is missing or broken, or lies beside the terrain, or has no valid value there.
        UsageError: what was chosen is not there, or it is not clear what is meant.
    """
    around = None if given.time is None else neighbours(times_in(given), given.time)
    if around is not None:
        found = _between(given, grid, *around)
    elif isinstance(given.source, str):
        found = _of_file(given, grid)
    else:
        found = _of_array(given, grid)
    if not np.isfinite(found.values).any():
        raise ReadError(
            "None of its values over the terrain is valid (all are nodata).", path=found.name,
            remedy="Name data that cover it, or another band.",
        )  # fmt: skip
    return found


def _between(given: Dataset | Uncertainty, grid: Grid, before: str, after: str, part: float) -> Field:
    """Values at a moment between two times."""
    first, last = (read(replace(given, time=time), grid) for time in (before, after))
    classes = has_classes(given, first)
    moment, way = str(given.time).replace("T", " "), "nearest" if classes else "linear"
    if classes:
        values = (first if part < 0.5 else last).values
    else:
        values = np.asarray(first.values + (last.values - first.values) * np.float32(part), np.float32)
    words = f"at {moment}, {way} between {before.replace('T', ' ')} and {after.replace('T', ' ')}"
    return replace(first, values=values, chosen=words)


def has_classes(given: Dataset | Uncertainty, found: Field) -> bool:
    """Whether values stand for names, which have nothing between them."""
    return found.classified or getattr(given, "style", None) == "classes"


def _of_file(given: Dataset | Uncertainty, grid: Grid) -> Field:
    from rasterio.errors import RasterioError

    location = subdataset(locate(given.source), given.variable, given.source)
    told: list[str] = []
    with HANDLES.borrow(location) as file:
        bands, chosen = chosen_bands(file, given)
        placement = Placement.of(grid, _in_degrees(file, grid_of(file)), given.source, told)
        window = _window(placement, given.source)
        row0, row1, col0, col1 = window
        step = _step(row1 - row0, col1 - col0, len(bands))
        rows, cols = -(-(row1 - row0) // step), -(-(col1 - col0) // step)
        place = Affine.scale((col1 - col0) / cols, (row1 - row0) / rows)
        own = Grid(
            (rows, cols),
            compose(compose(placement.image.transform, Affine.translation(col0, row0)), place),
            placement.image.crs,
        )
        from rasterio.enums import Resampling
        from rasterio.windows import Window

        where = Window(col0, row0, col1 - col0, row1 - row0)
        coloured = file.colorinterp[bands[0] - 1].name == "palette"
        named = named_beside(location, bands[0])
        said_so = coloured or named is not None or "flag_meanings" in file.tags(bands[0])
        style = given.style if isinstance(given, Dataset) else "continuous"
        coded = style is None and not said_so and _coded(file, bands, where)
        classes = style == "classes" or (style is None and (said_so or coded))
        way = Resampling.nearest if step == 1 else Resampling.mode if classes else Resampling.average
        values = np.empty((len(bands), rows, cols), np.float32)
        try:
            for i, band in enumerate(bands):
                read = file.read(band, window=where, out_shape=(rows, cols), resampling=way, masked=True)
                scale, offset = file.scales[band - 1], file.offsets[band - 1]
                values[i] = np.ma.filled(read.astype(np.float64) * scale + offset, np.nan)
        except (RasterioError, OSError) as error:
            raise ReadError(f"Its values cannot be read: {cause_of(error)}", path=given.source) from None
        tags = file.tags(bands[0])
        unit = (file.units[bands[0] - 1] or tags.get("GRIB_UNIT") or tags.get("units") or "").strip()
        said = tags.get("long_name") or tags.get("GRIB_COMMENT") or ""
        described = "" if len(bands) > 1 else _description(file.descriptions[bands[0] - 1])
        name = re.sub(r"\s*\[.*?\]\s*$", "", said) or (given.variable or described or Path(given.source).stem).replace(
            "_", " "
        )
        chosen = "" if chosen == file.descriptions[bands[0] - 1] and (said or described) else chosen
        palette = file.colormap(bands[0]) if coloured else None
    values[~np.isfinite(values)] = np.nan
    if coded:
        told.append(
            f"{name} holds a few whole numbers in patches, which are shown as classes. (The style continuous shows "
            "them as numbers.)"
        )
    return _in_units(Field(values, own, name, written_unit(unit), chosen, tuple(told), tags=tags, palette=palette,
                           named=named, coded=coded))  # fmt: skip


def _description(told: str | None) -> str:
    """A band's description, unless it only counts bands, as "Band 1" and "Layer_1" do."""
    told = (told or "").strip()
    return "" if re.fullmatch(r"(?i)(band|layer|b|channel)?[ _.-]*\d*", told) else told


def _coded(file: Any, bands: list[int], where: Any) -> bool:
    """Whether the one band that is meant seems to hold codes of classes: integers without a unit, as ``are_codes``."""
    at = bands[0] - 1
    plain = file.scales[at] == 1 and file.offsets[at] == 0 and not (file.units[at] or file.tags(bands[0]).get("units"))
    if len(bands) > 1 or np.dtype(file.dtypes[at]).kind not in "iu" or not plain:
        return False
    shape = min(PROBE, int(where.height)), min(PROBE, int(where.width))
    probe = file.read(bands[0], window=where, out_shape=shape, masked=True)
    values = np.ma.filled(probe.astype(np.float32), np.nan)
    return are_codes(np.unique(values[np.isfinite(values)]), [values])


def _in_degrees(file: Any, found: Grid) -> Grid:
    """A raster's grid, in WGS 84 where its coordinates say degrees north (CF) and no CRS is told."""
    said = any(str(value).lower().startswith("degrees_north") for key, value in file.tags().items() if "#units" in key)
    return replace(found, crs=CRS.from_epsg(4326)) if found.crs is None and said else found


def _in_units(field: Field) -> Field:
    """The same in the unit that it says: GRIB's tables call temperatures in kelvin degrees Celsius."""
    known = field.values[np.isfinite(field.values)]
    if field.unit != "°C" or not len(known) or float(known.min()) <= HOT:
        return field
    return replace(field, values=field.values - np.float32(273.15))


def _step(rows: int, cols: int, bands: int) -> int:
    """Pixels along the side of a sample, so that neither a band nor all of them are too many."""
    most = min(MOST, max(HELD // bands, 1))
    return max(1, math.ceil(math.sqrt(rows * cols / most)))


def _window(placement: Placement, name: str) -> tuple[int, int, int, int]:
    """Pixels of a raster around the terrain, with a margin; all columns where it goes once around the body.

    Raises:
        ReadError: the terrain lies beside it.
    """
    bounds = Lattice.over(placement).bounds()
    rows, cols = placement.image.shape
    if bounds is not None:
        u0, u1, v0, v1 = bounds
        row0, row1 = max(0, math.floor(v0) - 2), min(rows, math.ceil(v1) + 2)
        col0, col1 = (0, cols) if placement.cyclic else (max(0, math.floor(u0) - 2), min(cols, math.ceil(u1) + 2))
        if v1 > 0 and v0 < rows and (placement.cyclic or (u1 > 0 and u0 < cols)):
            return row0, row1, col0, col1
    raise ReadError(
        f"The data do not overlap the terrain: they cover {extent(placement.image)}, and the terrain "
        f"{extent(placement.grid)}.",
        path=name,
        remedy="Name data of the same area, or fix their georeference (gdal_edit.py).",
    )


def members_in(given: Dataset, grid: Grid, asked: str) -> list[int]:
    """The numbers, from 1, of the members or bands of a raster that are asked for: ``all``, ``3``, ``1-6``.

    Raises:
        UsageError: there are none such. Others: as ``read``.
    """
    if isinstance(given.source, str):
        with HANDLES.borrow(subdataset(locate(given.source), given.variable, given.source)) as file:
            return picked(range(1, file.count + 1), asked, given.source)
    count = len(read(replace(given, member="all", uncertainty=None), grid).values)
    return picked(range(1, count + 1), asked, "the data")


def _of_array(given: Dataset | Uncertainty, grid: Grid) -> Field:
    """Of a DataArray, of an array that spans the terrain, or of a field that is there already."""
    if isinstance(given.source, Field):
        return given.source
    one = array_of(given)
    if one is not None:
        return _of_dataarray(replace(given, source=one), grid)
    array = np.ma.asarray(given.source)
    if array.dtype.kind not in "biuf":
        raise UsageError(f"Data must be real numbers, not {array.dtype}.")
    raw = np.ma.filled(array.astype(np.float32), np.nan)
    if raw.ndim == 2:
        raw = raw[None]
    if raw.ndim != 3:
        raise UsageError(f"Data must have the shape (rows, cols) or (members, rows, cols), not {raw.shape}.")
    fit = Affine.scale(grid.cols / raw.shape[2], grid.rows / raw.shape[1])
    values, words = _members(raw, given, "the array")
    return Field(values, Grid(raw.shape[1:], compose(grid.transform, fit), grid.crs), "data", "", words)


def _members(values: Values, given: Dataset | Uncertainty, name: str) -> tuple[Values, str]:
    """Of (members, rows, cols) those that are meant, and in words which they are."""
    asked = given.member if given.member is not None else given.band
    if asked is not None:
        values = values[[i - 1 for i in picked(range(1, len(values) + 1), str(asked), name)]]
    elif given.time is None and not wants_members(given):
        values = values[:1]
    if len(values) == 1 and given.member is not None:
        return values, f"member {given.member}"
    return values, f"mean of {len(values)}" if len(values) > 1 else ""


MEMBERS = ("member", "realization", "realisation", "number", "ensemble", "ens")


def _of_dataarray(given: Dataset | Uncertainty, grid: Grid) -> Field:
    from orograph.dem.dataarray import place_of

    array = given.source
    words: list[str] = []
    if given.time is not None:
        if "time" not in array.coords:
            raise UsageError("The DataArray has no coordinate time.", remedy="Omit time.")
        times = np.atleast_1d(array.coords["time"].values).astype("datetime64[m]").astype(str)
        keep = [i for i, time in enumerate(times) if matches(time, given.time)]
        if not keep:
            raise UsageError(f"It has no time {given.time}; its times go from {times[0]} to {times[-1]}.")
        array = array.isel(time=keep) if "time" in array.dims else array
        words.append(time_words(given.time, [times[i] for i in keep]))
    if given.level is not None:
        found = vertical_dimension(array, getattr(given, "vertical", None))
        levels = np.empty(0) if found is None else np.asarray(array.coords[found[0]].values, np.float64)
        at = [i for i, value in enumerate(levels) if is_level(value, given.level)]
        if found is None or not at:
            known = ", ".join(f"{v:g}" for v in levels) or "none"
            raise UsageError(f"It has no level {given.level}; its levels are: {known}.")
        array = array.isel({found[0]: at[0]})
        words.append(f"at {float(given.level):g} {written_unit(found[1].unit)}")
    lead = [d for d in array.dims if str(d).lower() in MEMBERS or d == "time"]
    axes = [d for d in array.dims if d not in lead]
    if len(axes) != 2:
        raise UsageError(
            f"A DataArray must have rows and columns, and optionally time and member, not {dict(array.sizes)}.",
            remedy="Choose one level: level=; style curtains or walls shows all.",
        )
    stacked = array.transpose(*lead, *axes)
    _, transform, crs = place_of(stacked.isel(dict.fromkeys(lead, 0)))
    values = np.asarray(stacked.transpose(*lead, *_rows_first(stacked, axes)).to_numpy(), np.float32)
    values = values.reshape(-1, *values.shape[-2:])
    values, mean = _members(values, given, str(array.name))
    words = [mean, *words] if mean else words
    if transform is None:
        transform, crs = (
            compose(grid.transform, Affine.scale(grid.cols / values.shape[2], grid.rows / values.shape[1])), grid.crs
        )  # fmt: skip
    unit = str(array.attrs.get("units", ""))
    name = str(array.attrs.get("long_name") or array.name or "data").replace("_", " ")
    own = Grid(values.shape[1:], transform, crs)
    return _in_units(Field(values, own, name, written_unit(unit), " ".join(words), tags=array.attrs))


def _rows_first(array: Any, axes: list[Any]) -> tuple[Any, Any]:
    from orograph.dem.dataarray import axes_of

    flat = array.isel({d: 0 for d in array.dims if d not in axes})
    return axes_of(flat)
