"""Pictures of the same data, one for each time or member, beside or after each other: they share their scales."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.geo.grid import Grid
from orograph.geovis.data.bivariate import classes_of
from orograph.geovis.data.dataset import MEASURES, Breaks, Dataset, Uncertainty
from orograph.geovis.data.derived import deviations, read_data
from orograph.geovis.data.field import Field
from orograph.geovis.data.listing import levels_in
from orograph.geovis.data.painting import FLOWS, as_shown, image_grid
from orograph.geovis.data.reading import read
from orograph.geovis.data.sampling import Positions
from orograph.geovis.data.scales import Shared, doubted, shared_breaks
from orograph.geovis.data.vectors import read_vectors

LOOKED_AT = 512
"""Places along the terrain's longer side whose values make the scale of all pictures."""


class OneScale(NamedTuple):
    """The scale of values and that of uncertainties that pictures share."""

    span: tuple[float, float]
    breaks: Breaks | tuple[float, ...]
    doubt: tuple[float, float] | None

    @classmethod
    def of(cls, whole: Dataset, ones: Sequence[Dataset], grid: Grid) -> OneScale:
        """From the least to the greatest value of all (a probability: from 0 to 1, in classes of equal steps), or as
        ``whole`` says; quantiles and natural breaks are those of all values; uncertainties go from 0 to the 98th
        percentile of all."""
        values: list[NDArray[Any]] = []
        sigmas: list[NDArray[Any]] = []
        over = image_grid(grid, LOOKED_AT)
        for one in ones:
            for part in _parts(one):
                field = read_vectors(part, grid)[0] if one.style in FLOWS else read_data(part, grid)
                values.append(Positions.of(over, field).values(field.shown).ravel())
                found = deviations(part, field, grid)
                if found is not None:
                    sigmas.append(Positions.of(over, found[0]).values(found[1]).ravel())
        pooled = np.concatenate(values)
        span = whole.range or ((0.0, 1.0) if whole.exceeds is not None else Shared(ends_of(pooled)))
        breaks = shared_breaks(pooled, classes_of(whole), as_shown(whole.but(uncertainty=None)).breaks, span)
        asked = whole.uncertainty.range if isinstance(whole.uncertainty, Uncertainty) else None
        doubt = asked or (doubted(np.concatenate(sigmas)) if sigmas else None)
        return cls(span, breaks, doubt)

    def over(self, one: Dataset) -> Dataset:
        """Data that are shown on this scale."""
        doubt = one.uncertainty
        if isinstance(doubt, Uncertainty) and self.doubt is not None:
            doubt = replace(doubt, range=self.doubt)
        return one.but(range=self.span, breaks=self.breaks, uncertainty=doubt)


def _parts(one: Dataset) -> list[Dataset]:
    """Data as they are read: a volume by its levels."""
    if one.style not in ("curtains", "walls"):
        return [one]
    levels = levels_in(one)
    return [one] if levels is None else [one.but(level=float(value)) for value in levels.values]


def doubt_of(whole: Dataset, one: Dataset, grid: Grid) -> Uncertainty | None:
    """The uncertainty of each picture: as given; of members their own where a picture (``one``) has several, else how
    all that the data choose differ, which is the same in every picture."""
    doubt: Uncertainty | None = whole.uncertainty
    if doubt is None or not doubt.of_members or len(read(one, grid).values) > 1:
        return doubt
    field = read(whole, grid)
    found = Field(
        field.uncertainty(doubt.source)[None], field.grid,
        f"± {MEASURES[doubt.source]} of all {len(field.values)}", field.unit,
    )  # fmt: skip
    return replace(doubt, source=found)


def ends_of(values: NDArray[Any]) -> tuple[float, float]:
    """The least and the greatest value, which never coincide."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return (low, high) if low < high else (low - 0.5, low + 0.5)
