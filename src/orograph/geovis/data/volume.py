"""Gridded volumes: a variable with a vertical dimension over a terrain, read level by level; its profiles at places.

Between levels values are linear in height; beyond the outermost they reach half a layer, as samples of rasters do
half a cell. Heights of pressure levels come from a geopotential in the same source, else from the standard atmosphere.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.derived import deviations, read_data
from orograph.geovis.data.field import Field, Values
from orograph.geovis.data.listing import array_of, levels_in, variables_in
from orograph.geovis.data.reading import read
from orograph.geovis.data.sampling import values_at
from orograph.geovis.data.vertical import GEOPOTENTIALS, GRAVITY, geometric, standard_heights

Array = NDArray[np.float64]


class Volume(NamedTuple):
    """Values at levels over a terrain.

    Attributes:
        fields: of each level. sigma: standard deviations (rows, cols) of each, and their field; None: unknown.
        kind: what levels count, see ``dataset.Vertical``. places: (levels,) hPa or metres.
        heights: of pressure levels, a field of heights each; None: they follow from the places.
        note: what the heights are, in words.
    """

    fields: list[Field]
    sigma: list[tuple[Field, Values]] | None
    kind: str
    places: Array
    heights: list[Field] | None
    note: str

    def profiles(self, grid: Grid, x: Array, y: Array, ground: Array) -> tuple[Array, Array, Array | None]:
        """Heights, values and standard deviations, (levels, n) each, at places in a terrain's CRS, from below.

        Args:
            ground: (n,) heights of the ground there.
        """
        values = np.stack([values_at(one.shown, one, grid, x, y) for one in self.fields])
        sigma = None
        if self.sigma is not None:
            sigma = np.stack([values_at(found, one, grid, x, y) for one, found in self.sigma])
        if self.heights is not None:
            levels = np.stack([values_at(one.shown, one, grid, x, y) for one in self.heights])
        else:
            flat = standard_heights(self.places) if self.kind == "pressure" else self.places
            turn = -1.0 if self.kind == "depth" else 1.0
            base = ground if self.kind in ("above", "depth") else np.zeros(len(x))
            levels = turn * flat[:, None] + base[None]
        order = np.argsort(np.nan_to_num(levels), axis=0, kind="stable")
        turned = [np.take_along_axis(one, order, 0) for one in (levels, values)]
        return turned[0], turned[1], None if sigma is None else np.take_along_axis(sigma, order, 0)


def read_volume(given: Dataset, grid: Grid) -> Volume:
    """A variable at all its levels.

    Raises:
        UsageError: it has no vertical dimension, or one level. Others: as ``reading.read``.
    """
    if given.level is not None:
        raise UsageError(f"{given.style} shows all levels.", path=_name(given), remedy="Leave out level=.")
    levels = levels_in(given)
    if levels is None or len(levels.values) < 2:
        what = "no known vertical dimension" if levels is None else "one level"
        raise UsageError(
            f"It has {what}, but {given.style} shows a volume.", path=_name(given),
            remedy="Declare its levels: vertical=height, above, depth or pressure; or choose another style.",
        )  # fmt: skip
    kind = levels.axis.kind
    each = [given.but(level=float(value), uncertainty=_at_level(given, float(value))) for value in levels.values]
    fields = [read_data(one, grid) for one in each]
    found = [deviations(one, field, grid) for one, field in zip(each, fields)]
    sigma = [one for one in found if one is not None]
    heights, note = None, {"height": "", "above": "above the ground", "depth": "below the ground"}.get(kind, "")
    if kind == "pressure":
        heights = _geopotential(given, each, grid)
        note = "heights of the standard atmosphere" if heights is None else "heights by geopotential"
    return Volume(fields, sigma or None, kind, levels.places, heights, note)


def _at_level(given: Dataset, value: float) -> Any:
    """The uncertainty of a level: a raster's own level, else as it is."""
    from dataclasses import replace

    doubt = given.uncertainty
    if doubt is None or doubt.of_members:
        return doubt
    own = Dataset(doubt.source, variable=doubt.variable, vertical=given.vertical)
    return doubt if levels_in(own) is None else replace(doubt, level=value)


def _geopotential(given: Dataset, each: list[Dataset], grid: Grid) -> list[Field] | None:
    """Fields of heights at pressure levels, of a source that has geopotential; None: it has none."""
    if array_of(given) is given.source:  # (a bare DataArray has no other variable)
        return None
    for name in [one for one in variables_in(given) if one.lower() in GEOPOTENTIALS]:
        try:
            found = [
                read(one.but(variable=name, value=None, exceeds=None, uncertainty=None, unit=None), grid)
                for one in each
            ]  # fmt: skip
        except OrographError:  # (another variable of that name)
            continue
        # Heights in metres are below 1e5, of any planet's weather; geopotential in m²/s² is ten times that.
        by = GRAVITY if "s" in found[0].unit.replace("hPa", "") else 1.0
        return [Field(geometric(one.mean.astype(np.float64) / by)[None].astype(np.float32), one.grid, "height", "m")
                for one in found]  # fmt: skip
    return None


def _name(given: Dataset) -> str:
    return given.source if isinstance(given.source, str) else "the data"


class Cells(NamedTuple):
    """A section cut into cells, of one height each.

    Attributes:
        low, top: (n,) heights. column: (n,) the piece of the line that each is over. values, sigma: (n,).
    """

    low: Array
    top: Array
    column: NDArray[np.int64]
    values: Array
    sigma: Array | None


def cells(volume: Volume, profiles: tuple[Array, Array, Array | None], ground: Array, rows: int) -> Cells:
    """Cells of a section.

    Args:
        profiles: as ``Volume.profiles`` has them. ground: (n,) heights. rows: cells from the lowest to the highest.
    """
    levels, values, sigma = profiles
    half = np.diff(levels, axis=0) / 2
    low, high = levels[0] - half[0], levels[-1] + half[-1]
    if volume.kind == "depth":
        high = np.fmin(high, ground)
    elif volume.kind in ("pressure", "above"):
        low = np.where(np.isfinite(ground), np.maximum(low, ground), low)
    span = float(np.nanmin(low)), float(np.nanmax(high))
    if not (math.isfinite(span[0]) and span[1] > span[0]):
        none = np.empty(0)
        return Cells(none, none, none.astype(np.int64), none, None if sigma is None else none)
    edges = np.linspace(*span, rows + 1)
    bottom = np.maximum(edges[:-1, None], low[None])
    top = np.minimum(edges[1:, None], high[None])
    there = top > bottom
    middle = np.where(there, (top + bottom) / 2, np.nan)
    shown = _between(levels, values, middle)
    known = there & np.isfinite(shown)
    own = None if sigma is None else _between(levels, sigma, middle)[known]
    return Cells(bottom[known], top[known], np.nonzero(known)[1], shown[known], own)


def _between(levels: Array, values: Array, at: Array) -> Array:
    """Values (levels, n) at heights (rows, n), linear between levels and constant beyond the outermost."""
    above = (at[:, None, :] >= levels[None]).sum(1)
    k = np.clip(above - 1, 0, len(levels) - 2)
    low, high = (np.take_along_axis(levels, k + more, 0) for more in (0, 1))
    part = np.clip((at - low) / np.where(high > low, high - low, 1.0), 0, 1)
    first, last = (np.take_along_axis(values, k + more, 0) for more in (0, 1))
    return np.asarray(first * (1 - part) + last * part)
