"""What was read of a raster: values of one thing over a terrain, and the part of a raster that is read for it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.attribute_table import Named
from orograph.geovis.data.shared import reading_once
from orograph.geovis.data.statistics import statistic
from orograph.geovis.placement import Lattice, Placement, extent

Values = NDArray[np.float32]

MOST = 1 << 22
"""Samples of a window that are held of each band."""

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
        limit_unit: of a probability, the unit of the value that is exceeded.
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
    limit_unit: str = ""
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


def in_units(field: Field) -> Field:
    """The same in the unit that it says: GRIB's tables call temperatures in kelvin degrees Celsius."""
    known = field.values[np.isfinite(field.values)]
    if field.unit != "°C" or not len(known) or float(known.min()) <= HOT:
        return field
    return replace(field, values=field.values - np.float32(273.15))


def step_of(rows: int, cols: int, bands: int) -> int:
    """Pixels along the side of a sample, so that neither a band nor all of them are too many."""
    most = min(MOST, max(HELD // bands, 1))
    return max(1, math.ceil(math.sqrt(rows * cols / most)))


def lattice_of(placement: Placement) -> Lattice:
    """Where nodes over a terrain lie in a raster; this is what takes time of a reprojection."""
    return reading_once("lattice", (placement.grid, placement.image), lambda: Lattice.over(placement))


def window_of(placement: Placement, name: str) -> tuple[int, int, int, int]:
    """Pixels of a raster around the terrain, with a margin; all columns where it goes once around the body.

    Raises:
        ReadError: the terrain lies beside it.
    """
    bounds = lattice_of(placement).bounds()
    rows, cols = placement.image.shape
    if bounds is not None:
        u0, u1, v0, v1 = bounds
        row0, row1 = max(0, math.floor(v0) - 2), min(rows, math.ceil(v1) + 2)
        col0, col1 = (0, cols) if placement.cyclic else (max(0, math.floor(u0) - 2), min(cols, math.ceil(u1) + 2))
        if v1 > 0 and v0 < rows and (placement.cyclic or (u1 > 0 and u0 < cols)):
            return row0, row1, col0, col1
    remedy = "Name data of the same area, or fix their georeference (gdal_edit.py)."
    if placement.undeclared:
        remedy = "They name no CRS, so that of the terrain was assumed: declare their own (gdal_edit.py -a_srs)."
    raise ReadError(
        f"The data do not overlap the terrain: they cover {extent(placement.image)}, and the terrain "
        f"{extent(placement.grid)}.",
        path=name,
        remedy=remedy,
    )
