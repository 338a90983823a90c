"""Lines that stand in space with a value: tubes along tracks, and curtains above the ground beneath them.

A tube lies on the ground, or runs at the heights that its track has (z, metres, stretched as the ground is). A curtain
stands on the ground, of one height. Both have the colours of their values; ``variable="z"`` takes the track's heights
for values.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.features import Features
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.shapes import Shapes, read_shapes
from orograph.geovis.data.standing import Kind, Things, longer
from orograph.geovis.data.standing_colors import Caption, colors_of
from orograph.geovis.data.standing_marks import BEFORE, MARKS, Face, Marks, marks_on
from orograph.geovis.keys import Legend

Array = NDArray[np.float64]

STYLES = {"tubes": Kind.TUBE, "curtains": Kind.WALL}

ACROSS = {"tubes": 130, "curtains": 24}
"""How many, of their diameter or height, go along the terrain's longer side, where no size is given."""

PIECES = 900
"""Pieces, along the terrain's longer side, of what follows the ground; none is shorter than a sample."""

SUNK = 0.3
"""Of its height, how deep a curtain goes into the ground, which bends between the ends of a piece."""


def things_of_lines(dataset: Dataset, features: Features, grid: Grid, priority: Priority) -> Things:
    """What stands for lines.

    Raises:
        UsageError: lines have no such style or sign. Others: as ``shapes.read_shapes``.
    """
    style = str(dataset.style)
    if style not in STYLES or features.kind != "lines":
        raise UsageError(
            f"There is no style {style} of {features.kind}.", path=features.name,
            remedy=f"Lines have {', '.join(STYLES)}, and what is painted; see the manual.",
        )  # fmt: skip
    by_height = dataset.variable == "z" and "z" not in features.columns
    shapes = read_shapes(dataset.but(variable=None) if by_height else dataset, features, grid, 0.25 * max(grid.spacing))
    step = max(*grid.spacing, longer(grid) / PIECES)
    at, owner = pieces(shapes, step if style == "curtains" or not np.isfinite(shapes.z).any() else np.inf)
    if by_height:
        if not np.isfinite(shapes.z).any():
            raise UsageError("Its lines have no heights (z).", path=features.name, remedy="Name an attribute.")
        values, name, classes = at[:, [2, 5]].mean(1), "z", None
    else:
        values, name, classes = shapes.values[owner], shapes.name, shapes.classes
    known = np.isfinite(values)
    at, owner, values = at[known], owner[known], values[known]
    sigma = None if shapes.sigma is None else shapes.sigma[owner]
    caption = Caption(name, dataset.unit or ("m" if by_height else ""), ", ".join(shapes.notes), classes)
    marked = priority.uncertainty if style == "curtains" else None
    rgb, legend, u, sign = colors_of(dataset, values, sigma, caption, marked, priority)
    size = dataset.size if dataset.size is not None else longer(grid) / ACROSS[style]
    full, tube = np.ones(len(at)), style == "tubes"
    level = at[:, [2, 5]] if tube else np.full((len(at), 2), np.nan)
    lift = np.where(np.isfinite(level[:, 0]), 0.0, size / 2) if tube else -SUNK * size * full
    made = Things(
        np.full(len(at), STYLES[style], np.int8), at[:, 0], at[:, 1], lift, size / 2 * full,
        (size if tube else (1 + SUNK) * size) * full, rgb, values, legend,
        np.column_stack([level[:, 0], at[:, 3:5], level[:, 1]]),
    )  # fmt: skip
    if sign not in MARKS:
        return made
    each = np.arange(len(at))
    face = Face(at[:, :2], at[:, 3:5], each, np.zeros(len(at)), size * full, u, values)
    return Things.joined([made, *_marks(marks_on(face, sign, size, 1.0), BEFORE * longer(grid))])


def _marks(found: Marks, gap: float) -> list[Things]:
    """Signs on both sides of curtains, at heights above the ground."""
    n, sides = len(found.low), []
    none = np.full(n, np.nan)
    for out in (gap, -gap):
        start, end = found.before(out)
        sides.append(Things(
            np.full(n, Kind.WALL, np.int8), start[:, 0], start[:, 1], found.low, np.zeros(n), found.top - found.low,
            found.rgb, found.values, Legend(), np.column_stack([none, end, none]),
        ))  # fmt: skip
    return sides


def pieces(shapes: Shapes, step: float) -> tuple[Array, NDArray[np.int64]]:
    """Pieces of lines no longer than ``step``: (n, 6) x, y, z of both ends, and their features (n,)."""
    found, owners = [], []
    for k, owner in enumerate(shapes.owner):
        part = slice(shapes.first[k], shapes.first[k + 1])
        line = np.stack([shapes.x[part], shapes.y[part], shapes.z[part]], 1)
        if len(line) < 2:
            continue
        long = np.hypot(*np.diff(line[:, :2], axis=0).T)
        count = np.maximum(1, np.ceil(long / step)).astype(int)
        of = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)) / count[of]
        start = line[of] + (line[of + 1] - line[of]) * share[:, None]
        found.append(np.column_stack([start, np.concatenate([start[1:], line[-1:]])]))
        owners.append(np.full(len(of), owner))
    if not found:
        return np.empty((0, 6)), np.empty(0, np.int64)
    return np.concatenate(found), np.concatenate(owners)
