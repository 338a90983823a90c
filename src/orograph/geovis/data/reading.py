"""Values of rasters over a terrain: which bands are meant, what they are, their mean and how they differ.

A file's bands are the members of an ensemble, the times of a series, or different things, as the user says; GDAL's
metadata tell times (GRIB's valid time, CF's ``time`` dimension) and units. Large windows are
averaged as they are read (``field``).
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS

from orograph.dem.fills import are_codes
from orograph.dem.handles import HANDLES, cause_of, locate, stamped
from orograph.errors import ReadError
from orograph.geo.grid import Grid, compose
from orograph.geovis.data.array_reading import read_array
from orograph.geovis.data.attribute_table import named_beside
from orograph.geovis.data.choosing import chosen_bands, picked
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.field import Field, Values, in_units, step_of, window_of
from orograph.geovis.data.listing import subdataset, times_in
from orograph.geovis.data.shared import reading_once
from orograph.geovis.data.times import neighbours
from orograph.geovis.data.units import fixed_unit
from orograph.geovis.keys import written_unit
from orograph.geovis.placement import Placement, grid_of

PROBE = 512
"""Side of the reduced window that says whether a raster holds codes."""


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
        found = read_array(given, grid)
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
        window = window_of(placement, given.source)
        row0, row1, col0, col1 = window
        step = step_of(row1 - row0, col1 - col0, len(bands))
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

        def band_of(band: int) -> Values:
            read = file.read(band, window=where, out_shape=(rows, cols), resampling=way, masked=True)
            scale, offset = file.scales[band - 1], file.offsets[band - 1]
            found = np.ma.filled(read.astype(np.float64) * scale + offset, np.nan).astype(np.float32)
            found[~np.isfinite(found)] = np.nan
            return found

        state = stamped(location), window, (rows, cols), way.name
        try:
            parts = [reading_once("band", (*state, band), partial(band_of, band)) for band in bands]
        except (RasterioError, OSError) as error:
            raise ReadError(f"Its values cannot be read: {cause_of(error)}", path=given.source) from None
        tags = file.tags(bands[0])
        unit = (file.units[bands[0] - 1] or tags.get("GRIB_UNIT") or tags.get("units") or "").strip()
        driver = file.driver
        fixed = "" if unit else fixed_unit(driver, file.descriptions[bands[0] - 1])
        said = tags.get("long_name") or tags.get("GRIB_COMMENT") or ""
        described = "" if len(bands) > 1 else _description(file.descriptions[bands[0] - 1])
        name = re.sub(r"\s*\[.*?\]\s*$", "", said) or (given.variable or described or Path(given.source).stem).replace(
            "_", " "
        )
        chosen = "" if chosen == file.descriptions[bands[0] - 1] and (said or described) else chosen
        palette = file.colormap(bands[0]) if coloured else None
    if fixed:
        chosen = ", ".join(filter(None, (chosen, f"in {fixed} by the {driver} standard")))
    values = parts[0][None] if len(parts) == 1 else np.stack(parts)
    if coded:
        told.append(
            f"{name} holds a few whole numbers in patches, which are shown as classes. (The style continuous shows "
            "them as numbers.)"
        )
    return in_units(Field(values, own, name, written_unit(unit or fixed), chosen, tuple(told), tags=tags,
                          palette=palette, named=named, coded=coded))  # fmt: skip


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
