"""Points with values: stations, quakes, samples; of tables (CSV), of columns in memory, of features.

Places are longitude and latitude where a table's columns are called so; else they are in the terrain's CRS, or in the
features'. What is no number is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.tables import DEGREES, EAST, NORTH, number, places_in, read_table
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.features import Features, has_features, read_features

Array = NDArray[np.float64]

TABLES = (".csv", ".tsv", ".txt")


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Values at places.

    Attributes:
        x, y: (n,) in the terrain's CRS, of those on the terrain. values: (n,). sigma: (n,) standard deviations;
            None: unknown.
        level: (n,) how high they float, metres, as ``Dataset.height`` or ``above`` say; None: they are on the ground.
        name: what they are. classes: where they have no attribute, the name of all of them.
    """

    x: Array
    y: Array
    values: Array
    sigma: Array | None
    name: str
    classes: tuple[str, ...] | None = None
    level: Array | None = None


def is_table(source: Any) -> bool:
    """Whether a dataset's source is a table of points, by its looks."""
    if isinstance(source, str):
        return Path(source).suffix.lower() in TABLES
    return isinstance(source, Mapping) or hasattr(source, "columns")


def read_points(given: Dataset, grid: Grid, found: Features | None = None) -> Points:
    """The points of a dataset that lie on a terrain with this grid, and have a value.

    Args:
        found: its features, if they were read already.

    Raises:
        ReadError: the file cannot be read, or none of its points lies on the terrain.
        UsageError: it is not clear which attribute is meant.
    """
    if found is None and has_features(given.source):
        found = read_features(given, grid)
    columns, crs, name = _columns(given.source) if found is None else _of_features(found)
    east, north = places_in(columns, name, "the terrain's CRS")
    if crs is None and east.lower() in DEGREES:
        crs = "EPSG:4326"
    numbers = {k: v for k, v in columns.items() if k not in (east, north) and np.isfinite(v).any()}
    afloat = given.height if given.height is not None else given.above
    level = (
        None
        if afloat is None
        else numbers[_attribute(afloat, numbers, name, "height" if given.height is not None else "above")]
    )
    if level is not None and given.variable is None and given.uncertainty is None and len(numbers) > 1:
        numbers = {k: v for k, v in numbers.items() if k != afloat}
    bare = not numbers and given.variable is None and given.uncertainty is None
    if bare:
        numbers = {"place": np.zeros(len(columns[east]))}
    value = _attribute(given.variable, numbers, name)
    doubt = given.uncertainty
    sigma = None if doubt is None else _attribute(doubt.source, numbers, name)
    if sigma is not None and (numbers[sigma] < 0).any():
        raise ReadError(f"{sigma} is a standard deviation, never negative.", path=name, remedy="Name another.")
    x, y = columns[east], columns[north]
    if crs is not None and grid.crs is not None:
        from orograph.geo.transform import transformer

        x, y = transformer(crs, grid.crs)(x, y)
        x, y = (np.where(np.isfinite(v), v, np.nan) for v in (x, y))  # inf where the CRS ends
    col, row = grid.index(x, y)
    with np.errstate(invalid="ignore"):
        here = (col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1) & np.isfinite(numbers[value])
    if level is not None:
        here &= np.isfinite(level)
    if not here.any():
        raise ReadError(
            f"None of its {len(x)} points lies on the terrain and has a {value}.", path=name,
            remedy="Name data of the same area.",
        )  # fmt: skip
    spread = None if sigma is None else np.nan_to_num(numbers[sigma][here])
    alike = (given.name or (Path(name).stem if isinstance(given.source, str) else name),) if bare else None
    return Points(x[here], y[here], numbers[value][here], spread, value.replace("_", " "), alike,
                  None if level is None else level[here])  # fmt: skip


def _attribute(asked: Any, numbers: Mapping[str, Array], name: str, option: str = "variable") -> str:
    if asked is None and len(numbers) == 1:
        return next(iter(numbers))
    if asked in numbers:
        return str(asked)
    what = "There are several attributes" if asked is None else f"There is no attribute {asked!r} of numbers"
    raise UsageError(f"{what}: {', '.join(numbers) or 'none'}.", path=name, remedy=f"Choose one: {option}=NAME.")


def _columns(source: Any) -> tuple[dict[str, Array], Any, str]:
    """Columns of numbers of a table by name, their CRS (None: not known), and what the source is called."""
    if not isinstance(source, str):
        keys = list(source) if isinstance(source, Mapping) else list(source.columns)
        columns = {str(k): np.array([number(v) for v in np.atleast_1d(np.asarray(source[k]))]) for k in keys}
        if len({len(column) for column in columns.values()}) > 1:
            raise UsageError("The columns of a table of points are equally long.")
        return columns, None, "points"
    return read_table(source), None, source


def _of_features(found: Features) -> tuple[dict[str, Array], Any, str]:
    """Of features, as ``_columns`` has it: a row for each place; attributes that are no numbers are missing."""
    if found.kind != "points":
        raise UsageError(f"It holds {found.kind}, not points.", path=found.name)
    places = np.concatenate([np.concatenate(own) for own in found.parts])
    of = np.repeat(np.arange(len(found)), [sum(map(len, own)) for own in found.parts])
    places_too = (*EAST, *NORTH)
    columns = {k: v[of] for k, v in found.columns.items() if v.dtype != object and k.lower() not in places_too}
    if np.isfinite(places[:, 2]).any() and "z" not in columns:
        columns["z"] = places[:, 2]
    return {**columns, "x": places[:, 0], "y": places[:, 1]}, found.crs, found.name
