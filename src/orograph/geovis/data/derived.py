"""Data for display: the values read, a statistic of their members, or the probability of exceeding a value.

Of data with standard deviations instead of members a probability is 1 − Φ((value − datum) / σ).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.field import Field, Values
from orograph.geovis.data.reading import read
from orograph.geovis.data.sampling import Positions
from orograph.geovis.data.statistics import exceedance, words_of
from orograph.geovis.data.units import ratio


def read_data(given: Dataset, grid: Grid) -> Field:
    """The values of data over a terrain with this grid, as they are shown.

    Raises:
        ReadError, UsageError: as ``reading.read``; a statistic is asked for of one member.
    """
    found = read(given, grid)
    return _derived(found, given, grid) if given.derived else found


def deviations(given: Dataset, field: Field, grid: Grid) -> tuple[Field, Values] | None:
    """How uncertain data are that were read: standard deviations (or half widths) (rows, cols) in the data's unit, and
    the field on whose grid they are; None where nothing is given.

    Raises:
        ReadError: one is negative, or their unit measures another thing than the data's. Others: as ``reading.read``.
    """
    doubt = given.uncertainty
    if doubt is None:
        return None
    if doubt.of_members:
        return field, field.uncertainty(doubt.source)
    other = read(doubt, grid)
    found, unit = other.mean, given.unit or field.unit
    name = doubt.source if isinstance(doubt.source, str) else "the uncertainty"
    if (found < 0).any():
        raise ReadError(
            f"A standard deviation cannot be negative, but the lowest is {float(np.nanmin(found)):g}.",
            path=name, remedy="Choose another band, or correct it.",
        )  # fmt: skip
    factor = ratio(other.unit, unit)
    if factor is None:
        raise ReadError(
            f"A standard deviation in {other.unit} cannot be that of data in {unit}.", path=name,
            remedy="Choose another band; or say in what unit the data are: unit=.",
        )  # fmt: skip
    return other, found if factor == 1 else found * np.float32(factor)


def _derived(field: Field, given: Dataset, grid: Grid) -> Field:
    """A field whose data are a statistic or a probability, as a dataset requests."""
    name, unit, count = given.name or field.name, given.unit or field.unit, len(field.values)
    if given.exceeds is None:
        asked = given.value or "mean"
        _several(count, field.name, "value")
        chosen = field.chosen.replace("mean of", f"{words_of(asked)} of", 1)
        called = name if asked == "mean" else f"{name}, {asked}"
        return replace(field, name=called, statistic=asked, chosen=chosen)
    called = f"P({name} > {given.exceeds:g}{f' {unit}' if unit else ''})"
    if given.uncertainty is not None and not given.uncertainty.of_members:
        found, chosen = _normal(field, given, grid), ", ".join(filter(None, ("normal law", field.chosen)))
    else:
        _several(count, field.name, "exceeds")
        found, chosen = exceedance(field.values, given.exceeds), field.chosen.replace("mean of", "part of", 1)
    return replace(field, values=found[None], name=called, unit="", limit_unit=unit, chosen=chosen)


def _several(count: int, name: str, key: str) -> None:
    if count < 2:
        raise UsageError(
            f"{key}= needs several members or times, but {name} has one.",
            remedy="Choose several: band=all, time=T12, or member=all"
            + ("; or give its uncertainty: `uncertainty`." if key == "exceeds" else "."),
        )


def _normal(field: Field, given: Dataset, grid: Grid) -> Values:
    """Probabilities of being above a limit, of data with standard deviations."""
    from scipy.special import ndtr

    doubt = deviations(given, field, grid)
    assert doubt is not None
    other, sigmas = doubt
    sigma = Positions.of(field.grid, other).values(sigmas).astype(np.float64)
    limit = float(given.exceeds if given.exceeds is not None else 0.0)
    mean = field.mean.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(sigma > 0, ndtr((mean - limit) / sigma), mean > limit)
    return np.where(np.isfinite(mean) & np.isfinite(sigma), found, np.nan).astype(np.float32)
