"""Points with values: stations, quakes, samples; of tables (CSV), of columns in memory, of features.

Places are longitude and latitude where a table's columns are called so; else they are in the terrain's CRS, or in the
features'. What is no number is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.handles import locate, stamped
from orograph.dem.tables import DEGREES, EAST, NORTH, number, places_in, read_texts
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.features import Features, classes_in, has_features, read_features
from orograph.geovis.data.shared import reading_once
from orograph.geovis.data.times import seconds_of
from orograph.geovis.placement import extent

Array = NDArray[np.float64]
Texts = NDArray[np.object_]

LENGTHS = {"": 1.0, "m": 1.0, "km": 1000.0, "ft": 0.3048}
"""Metres of units of heights and depths."""

WHEN = ("time", "timestamp", "datetime", "date")
"""Attributes that say when, where none is named."""

TABLES = (".csv", ".tsv", ".txt")


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Values at places.

    Attributes:
        x, y: (n,) in the terrain's CRS, of those on the terrain. values: (n,). sigma: (n,) standard deviations;
            None: unknown.
        level: (n,) how high they are, metres, as ``Dataset.height``, ``above`` or ``depth`` say; (n, 2) of intervals;
            None: they are on the ground.
        name: what they are. classes: the names of values 0, 1, …; None: they are numbers.
        seconds: (n,) when each happened, since 1970, UTC, NaN: unknown; None: nothing says it, or no time is
            asked for.
        ages: (n,) how long ago that is, from 0 (now) to 1 (no longer seen); None: that does not matter.
        group: (n,) which borehole each belongs to, numbered from 0, as ``Dataset.group`` says; None: it says nothing.
    """

    x: Array
    y: Array
    values: Array
    sigma: Array | None
    name: str
    classes: tuple[str, ...] | None = None
    level: Array | None = None
    group: NDArray[np.int64] | None = None
    seconds: Array | None = None
    ages: Array | None = None

    def some(self, which: NDArray[Any]) -> Points:
        """Some of the points."""
        chosen: dict[str, Any] = {
            f.name: part[which] for f in fields(self)
            if f.name not in ("name", "classes") and (part := getattr(self, f.name)) is not None
        }  # fmt: skip
        return replace(self, **chosen)


def is_points(given: Dataset, grid: Grid) -> bool:
    """Whether a dataset is points: a table, or features of that kind."""
    if is_table(given.source):
        return True
    return has_features(given.source) and read_features(given, grid).kind == "points"


def when_of(given: Dataset, texts: Mapping[str, Any], name: str) -> str | None:
    """The attribute that says when; None: there is none.

    Raises:
        UsageError: the one that is named is not there.
    """
    when = given.when or next((k for k in texts if k.lower() in WHEN), None)
    if when is not None and when not in texts:
        raise UsageError(f"There is no attribute {when!r}.", path=name, remedy="Choose one: when=NAME.")
    return when


def seconds_in(given: Dataset, grid: Grid) -> Array | None:
    """(n,) when the points of a source happened, seconds since 1970, UTC, NaN where unknown; None: nothing says it."""
    found = read_features(given, grid) if has_features(given.source) else None
    _, texts, _, name = columns_of(given.source) if found is None else columns_of_features(found)
    when = when_of(given, texts, name)
    return None if when is None else seconds_of(texts[when], name, when)


def is_table(source: Any) -> bool:
    """Whether a dataset's source is a table of points, by its looks."""
    if isinstance(source, str):
        return Path(source).suffix.lower() in TABLES
    if hasattr(source, "data_vars"):  # (a Dataset of xarray's is a mapping, too)
        return False
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
    columns, texts, crs, name = columns_of(given.source) if found is None else columns_of_features(found)
    east, north = places_in(columns, name, "the terrain's CRS")
    if crs is None and east.lower() in DEGREES:
        crs = "EPSG:4326"
    numbers = {k: v for k, v in columns.items() if k not in (east, north) and np.isfinite(v).any()}
    level, used = level_of(given, numbers, name)
    group = None
    if given.group is not None:
        if given.group not in texts:
            raise UsageError(f"There is no attribute {given.group!r}.", path=name, remedy="Choose one: group=NAME.")
        group = np.unique(texts[given.group].astype(str), return_inverse=True)[1]
        used |= {given.group}
    if given.variable is None and given.uncertainty is None and not used >= set(numbers):
        numbers = {k: v for k, v in numbers.items() if k not in used}
    bare = not numbers and given.variable is None and given.uncertainty is None
    if bare:
        numbers = {"place": np.zeros(len(columns[east]))}
    classes = None
    if given.variable in texts and given.variable not in numbers:
        numbers[str(given.variable)], classes = classes_in(texts[str(given.variable)], str(given.variable), name)
    value = attribute_of(given.variable, numbers, name)
    doubt = given.uncertainty
    sigma = None if doubt is None else attribute_of(doubt.source, numbers, name)
    if sigma is not None and (numbers[sigma] < 0).any():
        raise ReadError(
            f"{sigma} is a standard deviation, which cannot be negative.", path=name, remedy="Choose another."
        )
    x, y = _moved(columns[east], columns[north], crs, grid)
    known = np.isfinite(numbers[value])
    if level is not None:
        known &= np.isfinite(level.reshape(len(level), -1)).all(1)
    here = known & _within(grid, x, y)
    if not here.any():
        raise _none_here(value, known, columns[east], columns[north], (crs, grid), name)
    when = when_of(given, texts, name) if given.time is not None else None
    seconds = None if when is None else seconds_of(texts[when], name, when)[here]
    spread = None if sigma is None else numbers[sigma][here]
    alike = (given.name or (Path(name).stem if isinstance(given.source, str) else name),) if bare else None
    return Points(x[here], y[here], numbers[value][here], spread, value.replace("_", " "), alike or classes,
                  None if level is None else level[here], None if group is None else group[here], seconds)  # fmt: skip


def _moved(x: Array, y: Array, crs: Any, grid: Grid) -> tuple[Array, Array]:
    """Places (n,) in the terrain's CRS, NaN where that has none."""
    if crs is None or grid.crs is None:
        return x, y
    from orograph.geo.transform import transformer

    x, y = transformer(crs, grid.crs)(x, y)
    return np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan)  # inf where the CRS ends


def _within(grid: Grid, x: Array, y: Array) -> NDArray[np.bool_]:
    """Which places (n,) lie among the terrain's samples."""
    col, row = grid.index(x, y)
    with np.errstate(invalid="ignore"):
        return np.asarray((col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1))


def _none_here(value: str, known: NDArray[np.bool_], x: Array, y: Array, crs: tuple[Any, Grid], name: str) -> ReadError:
    """Why no point is left: none has a value, or none of those lies on the terrain.

    Args:
        known: which points have a value. x, y: of all, as given. crs: theirs (None: the terrain's), and the terrain.
    """
    known = known & np.isfinite(x) & np.isfinite(y)
    count = len(x)
    if not known.any():
        return ReadError(
            f"None of its {count} points has a place and a number as {value}." if count else "It holds no points.",
            path=name, remedy="Choose another attribute, or name a file that has points.",
        )  # fmt: skip
    own, grid = crs
    west, east, south, north = (float(f(v[known])) for v in (x, y) for f in (np.min, np.max))
    called = "" if own is None else f" in {CRS.from_user_input(own).name}"
    exchanged = _within(grid, *_moved(y[known], x[known], own, grid)).any()
    remedy = "Their coordinates seem to be exchanged: longitude (or x) is east." if exchanged else (
        "Give data of the same area.")  # fmt: skip
    return ReadError(
        f"None of its {count} points lies on the terrain: they lie within {west:.8g} to {east:.8g}, {south:.8g} to "
        f"{north:.8g}{called}, and the terrain covers {extent(grid)}.", path=name, remedy=remedy,
    )  # fmt: skip


def level_of(given: Dataset, numbers: Mapping[str, Array], name: str) -> tuple[Array | None, set[str]]:
    """How high points are, in metres, (n,), or (n, 2) of intervals, and which attributes say so."""
    option = given.leveled
    if option is None:
        return None, set()
    told, _, unit = str(getattr(given, option)).partition(":")
    if unit not in LENGTHS:
        raise UsageError(
            f"{unit!r} is not a unit of {option}=; the units are {', '.join(filter(None, LENGTHS))}.", path=name
        )
    names = [attribute_of(part, numbers, name, option) for part in told.split("+")]
    if len(names) > 2:
        raise UsageError(f"{option}= names one attribute, or the two ends of an interval (from+to).", path=name)
    level = np.stack([numbers[one] for one in names], 1) * LENGTHS[unit]
    return level if len(names) == 2 else level[:, 0], set(names)


def attribute_of(asked: Any, numbers: Mapping[str, Array], name: str, option: str = "variable") -> str:
    if asked is None and len(numbers) == 1:
        return next(iter(numbers))
    if asked in numbers:
        return str(asked)
    what = "There are several attributes" if asked is None else f"There is no attribute {asked!r} of numbers"
    raise UsageError(f"{what}: {', '.join(numbers) or 'none'}.", path=name, remedy=f"Choose one: {option}=NAME.")


def columns_of(source: Any) -> tuple[dict[str, Array], dict[str, Texts], Any, str]:
    """Columns of a table by name, as numbers and as texts, their CRS (None: not known), and the source's name."""
    if isinstance(source, str):
        written: dict[str, Any] = dict(reading_once("table", stamped(locate(source)), lambda: read_texts(source)))
    else:
        keys = list(source) if isinstance(source, Mapping) else list(source.columns)
        written = {str(k): np.atleast_1d(np.asarray(source[k])).tolist() for k in keys}
        if len({len(column) for column in written.values()}) > 1:
            raise UsageError("The columns of a table of points must be equally long.")
    columns = {k: np.array([number(v) for v in values]) for k, values in written.items()}
    texts = {k: np.array(["" if v is None or v != v else str(v) for v in values], object)
             for k, values in written.items()}  # fmt: skip
    return columns, texts, None, source if isinstance(source, str) else "points"


def columns_of_features(found: Features) -> tuple[dict[str, Array], dict[str, Texts], Any, str]:
    """Of features, as ``columns_of`` has it: a row for each place."""
    if found.kind != "points":
        raise UsageError(f"It holds {found.kind}, not points.", path=found.name)
    places = np.concatenate([np.concatenate(own) for own in found.parts])
    of = np.repeat(np.arange(len(found)), [sum(map(len, own)) for own in found.parts])
    places_too = (*EAST, *NORTH)
    about = {k: v[of] for k, v in found.columns.items() if k.lower() not in places_too}
    columns = {k: v for k, v in about.items() if v.dtype != object}
    texts = {k: np.array([str(one) for one in v.tolist()], object) for k, v in about.items()}
    if np.isfinite(places[:, 2]).any() and "z" not in columns:
        columns["z"] = places[:, 2]
    return {**columns, "x": places[:, 0], "y": places[:, 1]}, texts, found.crs, found.name
