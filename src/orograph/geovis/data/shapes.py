"""Lines and polygons over a terrain: cut to its surroundings, transformed to its CRS, with a value for each feature.

An edge that is straight in the data's CRS is bent in the terrain's: it is halved until what lies between is off by less
than a tolerance. Longitudes go on across the antimeridian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.features import MOST_CLASSES, Features, classes_in
from orograph.geovis.data.reach import Reach
from orograph.geovis.data.shape_kernels import crossed

Array = NDArray[np.float64]

HALVINGS = 14
"""Of an edge, at most."""

COMPARED = 4_000_000
"""Pairs of edges of a polygon that are compared for crossings."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Lines or polygons in the terrain's CRS.

    Attributes:
        kind: "lines" or "polygons". x, y, z: (n,) of all lines or rings (closed); z as the data have it, NaN where
            they have none. first: (parts + 1,) where each begins. owner: (parts,) its feature, rising.
        values: (features,), NaN where one has none; of classes their numbers. sigma: (features,); None: unknown.
        classes: names, where the attribute is a text; None: it is a number. name: of the attribute.
        notes: what a reader must know, in words.
    """

    kind: str
    x: Array
    y: Array
    z: Array
    first: NDArray[np.int64]
    owner: NDArray[np.int64]
    values: Array
    sigma: Array | None
    classes: tuple[str, ...] | None
    name: str
    notes: tuple[str, ...]


def read_shapes(given: Dataset, found: Features, grid: Grid, tolerance: float) -> Shapes:
    """The lines or polygons of a dataset that lie on a terrain with this grid.

    Args:
        tolerance: units of the terrain's CRS that edges may be off by.

    Raises:
        ReadError: none lies on the terrain and has a value; an uncertainty is negative.
        UsageError: it is not clear which attribute is meant; there are too many classes.
    """
    reach = Reach.of(grid, found.crs, found.name)
    closed = found.kind == "polygons"
    parts, owner = [], []
    for i, own in enumerate(found.parts):
        for part in own:
            if closed and (part[0, :2] != part[-1, :2]).any():
                part = np.concatenate([part, part[:1]])
            part = reach.unwrapped(part)
            near = [cut_ring(part, reach.low, reach.high)] if closed else cut_line(part, reach.low, reach.high)
            near = [one for one in near if len(one) > (3 if closed else 1)]
            parts += near
            owner += [i] * len(near)
    x, y, z, first = _projected(parts, reach, tolerance)
    col, row = grid.index(x, y)
    on = (col >= -0.5) & (row >= -0.5) & (col <= grid.cols - 0.5) & (row <= grid.rows - 0.5)
    around = closed and len(x) and (col.min() < 0 < col.max()) and (row.min() < 0 < row.max())
    if not (on.any() or around):
        raise ReadError(
            f"None of its {len(found)} {found.kind} lies on the terrain.", path=found.name,
            remedy="Give data of the same area, and check that they declare their CRS.",
        )  # fmt: skip
    values, classes, name = _values(given, found)
    here = np.unique(np.asarray(owner))
    if not np.isfinite(values[here]).any():
        raise ReadError(f"None of its {found.kind} on the terrain has a {name}.", path=found.name)
    sigma = _sigma(given, found)
    made = Shapes(found.kind, x, y, z, first, np.asarray(owner, np.int64), values, sigma, classes, name, ())
    return replace(made, notes=_notes(made, here))


def _notes(made: Shapes, here: NDArray[np.int64]) -> tuple[str, ...]:
    count, lacking = len(here), int((~np.isfinite(made.values[here])).sum())
    one = {"lines": "line", "polygons": "polygon"}[made.kind]
    notes = [f"{count} {made.kind if count != 1 else one}"]
    if lacking:
        notes.append(f"{lacking} without a value")
    if made.kind == "polygons":
        begin = np.searchsorted(made.owner, here, side="left")
        end = np.searchsorted(made.owner, here, side="right")
        bad = sum(
            bool(crossed(made.x, made.y, made.first[a : b + 1], COMPARED)) for a, b in zip(begin, end)
        )  # fmt: skip
        if bad:
            notes.append(f"{bad} cross{'es' if bad == 1 else ''} {'itself' if bad == 1 else 'themselves'} (what lies "
                         "twice inside is left out)")  # fmt: skip
    return tuple(notes)


def _values(given: Dataset, found: Features) -> tuple[Array, tuple[str, ...] | None, str]:
    """Values of the features, the names of their classes if they are such, and what they are."""
    numbers = [k for k, v in found.columns.items() if v.dtype != object and np.isfinite(v).any()]
    asked = given.variable
    if asked is None and not numbers and len(found.columns) == 1:
        asked = next((k for k, v in found.columns.items() if v.dtype == object and len(set(v)) <= MOST_CLASSES), None)
    if asked is None and not numbers:
        return np.zeros(len(found)), (given.name or _stem(found.name),), given.name or _stem(found.name)
    if asked is None and len(numbers) == 1:
        asked = numbers[0]
    if asked not in found.columns:
        what = "There are several attributes" if asked is None else f"There is no attribute {asked!r}"
        raise UsageError(
            f"{what}: {', '.join(found.columns) or 'none'}.", path=found.name, remedy="Choose one: variable=NAME."
        )
    column = found.columns[asked]
    name = str(asked).replace("_", " ")
    if column.dtype != object:
        return column.astype(np.float64), None, name
    values, classes = classes_in(column, asked, found.name)
    return values, classes, name


def _stem(name: str) -> str:
    return Path(name).stem.replace("_", " ")


def _sigma(given: Dataset, found: Features) -> Array | None:
    if given.uncertainty is None:
        return None
    asked = given.uncertainty.source
    column = found.columns.get(asked) if isinstance(asked, str) else None
    if column is None or column.dtype == object:
        known = [k for k, v in found.columns.items() if v.dtype != object]
        raise UsageError(
            f"The uncertainty of {found.kind} is an attribute of numbers, not {asked!r}; there are "
            f"{', '.join(known) or 'none'}.", path=found.name,
        )  # fmt: skip
    if (column < 0).any():
        raise ReadError(
            f"{asked} is a standard deviation, which cannot be negative.", path=found.name, remedy="Choose another."
        )
    return np.asarray(column, np.float64)


def _projected(
    parts: list[Array], reach: Reach, tolerance: float
) -> tuple[Array, Array, Array, NDArray[np.int64]]:  # fmt: skip
    """All parts (n, 3) in the terrain's CRS: x, y, z and where each part begins."""
    if not parts:
        return np.empty(0), np.empty(0), np.empty(0), np.zeros(1, np.int64)
    at = np.concatenate(parts)
    part = np.repeat(np.arange(len(parts)), [len(one) for one in parts])
    xy = np.stack(reach.move(at[:, 0], at[:, 1]), 1)
    for _ in range(HALVINGS):
        within = part[1:] == part[:-1]
        off = np.zeros(len(within), bool)
        for share in (0.5, 0.25):
            between = at[:-1] + (at[1:] - at[:-1]) * share
            true = np.stack(reach.move(between[:, 0], between[:, 1]), 1)
            with np.errstate(invalid="ignore"):
                away = np.abs(true - (xy[:-1] + (xy[1:] - xy[:-1]) * share)).max(1)
                off |= within & (away > tolerance)
        if not off.any():
            break
        more = np.flatnonzero(off)
        middle = (at[more] + at[more + 1]) / 2
        at = np.insert(at, more + 1, middle, axis=0)
        part = np.insert(part, more + 1, part[more])
        xy = np.insert(xy, more + 1, np.stack(reach.move(middle[:, 0], middle[:, 1]), 1), axis=0)
    good = np.isfinite(xy).all(1)
    xy, z, part = xy[good], at[good, 2], part[good]
    first = np.searchsorted(part, np.arange(len(parts) + 1))
    return xy[:, 0].copy(), xy[:, 1].copy(), z, first.astype(np.int64)


def cut_ring(ring: Array, low: Array, high: Array) -> Array:
    """A closed ring (n, 3) within a box; along its border where it leaves it (Sutherland & Hodgman 1974)."""
    for axis in (0, 1):
        for bound, sign in ((low[axis], 1.0), (high[axis], -1.0)):
            away = sign * (ring[:, axis] - bound)
            inside = away >= 0
            if inside.all():
                continue
            if not inside.any():
                return ring[:0]
            a, b = ring[:-1], ring[1:]
            cuts = inside[:-1] != inside[1:]
            share = np.divide(away[:-1], away[:-1] - away[1:], out=np.zeros(len(a)), where=cuts)
            both = np.stack([a, a + (b - a) * share[:, None]], 1).reshape(-1, ring.shape[1])
            ring = both[np.stack([inside[:-1], cuts], 1).ravel()]
            ring = np.concatenate([ring, ring[:1]])
    return ring


def cut_line(line: Array, low: Array, high: Array) -> list[Array]:
    """The pieces of a line (n, 3) within a box (Liang & Barsky 1984)."""
    if (line[:, :2] >= low).all() and (line[:, :2] <= high).all():
        return [line]
    a, step = line[:-1], np.diff(line, axis=0)
    enter, leave = np.zeros(len(a)), np.ones(len(a))
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in (0, 1):
            t = np.stack([(bound[axis] - a[:, axis]) / step[:, axis] for bound in (low, high)])
            still = step[:, axis] == 0
            away = still & ((a[:, axis] < low[axis]) | (a[:, axis] > high[axis]))
            enter = np.where(away, np.inf, np.where(still, enter, np.maximum(enter, t.min(0))))
            leave = np.where(still, leave, np.minimum(leave, t.max(0)))
    pieces: list[list[Any]] = []
    last = -2
    for i in np.flatnonzero(enter < leave).tolist():
        here = a[i] + step[i] * enter[i] if enter[i] > 0 else a[i]
        there = a[i] + step[i] * leave[i] if leave[i] < 1 else line[i + 1]
        if pieces and enter[i] == 0 and last == i - 1:
            pieces[-1].append(there)
        else:
            pieces.append([here, there])
        last = i if leave[i] == 1 else -2
    return [np.array(one) for one in pieces]
