"""Sections beside the block, as in ExoVis (Tory & Swindells 2003): walls that stand around the terrain, beyond its
borders, and show the ground's profile through its middle, parallel to them, filled with the data's colours.

Walls are seen from the terrain's side only: those between it and the eye are not there. Lines on them are heights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geo.grid import Grid
from orograph.geovis.data.signs import INK
from orograph.geovis.data.standing import Kind, Things, longer
from orograph.geovis.data.standing_marks import ACROSS, MARKS, Face, marks_on
from orograph.geovis.data.standing_sections import Filling, of_marks
from orograph.geovis.keys import Legend

Array = NDArray[np.float64]
Colors = NDArray[np.float32]
Ground = Callable[[Array, Array], Array]
Paint = Callable[[Array, Array], Colors]

COLUMNS = 480
"""Of a section."""

GAP, BEHIND = 0.09, 1e-4
"""How far walls stand off the border, and how far behind each other their layers lie, parts of the longer side."""

PLAIN, BACK, RULE = (0.33, 0.30, 0.26), (0.83, 0.82, 0.78), (0.45, 0.45, 0.43)
"""Linear colours of ground without data, of the wall above it, and of lines of height."""

OVER = 0.08
"""Of the heights' range, how far walls reach above the highest."""


def plain(x: Array, y: Array) -> Colors:
    """The colour of ground without data."""
    return np.tile(np.asarray(PLAIN, np.float32), (len(x), 1))


def walls(
    grid: Grid, span: tuple[float, float], step: float, ground: Ground, paint: Paint, filling: Filling | None = None,
    stretch: float = 1.0,
) -> Things:  # fmt: skip
    """The walls, and where the two sections run on the ground.

    Args:
        span: the least and the greatest height. step: metres between lines of height.
        ground: heights (n,) at places (n,), NaN where there are none. paint: linear colours (n, 3) there.
        filling: a volume's sections along ``middle_lines(grid, COLUMNS)``, shown over and in the ground.
        stretch: of heights in the picture.
    """
    low, high = span
    top = high + OVER * (high - low)
    right, bottom = grid.cols - 1.0, grid.rows - 1.0
    gap_x, gap_y = (GAP * longer(grid) / s for s in grid.spacing)
    part = np.linspace(0.0, 1.0, COLUMNS + 1)
    found = []
    # Sections along a row and along a column through the middle; of each the two walls, by their row or column.
    for number, (along_row, places) in enumerate(((True, (-gap_y, bottom + gap_y)), (False, (-gap_x, right + gap_x)))):
        u, v = part * (right if along_row else bottom), np.full(len(part), (bottom if along_row else right) / 2)
        x, y = grid.xy(*((u, v) if along_row else (v, u)))
        heights = ground(x, y)
        level = (heights[1:] + heights[:-1]) / 2
        colors = paint((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2)
        found.append(_trace(x, y, heights, longer(grid) / 2200))
        for place in places:
            out = math.copysign(1.0, place) * BEHIND * longer(grid) / grid.spacing[1 if along_row else 0]

            def at(layer: int, place: float = place, out: float = out, u: Array = u, row: bool = along_row) -> Array:
                """(m, 2) places along the wall, of one of its layers."""
                w = np.full(len(u), place + layer * out)
                return np.stack(grid.xy(*((u, w) if row else (w, u))), 1)

            middle = np.array(grid.xy(np.array([right / 2]), np.array([bottom / 2])))[:, 0]
            known = np.isfinite(level)
            thick = (0.012 if filling is None else 0.005) * (top - low)
            found.append(_panels(at(0), np.full(COLUMNS, low), level, colors, middle, known))
            found.append(_panels(at(1), level, level + thick, np.asarray(INK), middle, known))
            if filling is not None:
                found.append(_filled(at(-1), filling, number, middle))
                if filling.sign in MARKS:
                    found.append(_marked(at(-2), filling, number, middle, longer(grid), stretch))
            ends = at(2 if filling is None else -5)[[0, -1]]
            for height in np.arange(math.ceil(low / step), math.floor(top / step) + 1) * step:
                rule = np.array([height])
                found.append(_panels(ends, rule - thick / 4, rule + thick / 4, np.asarray(RULE), middle))
            found.append(_panels(at(3)[[0, -1]], np.array([low]), np.array([top]), np.asarray(BACK), middle))
    if filling is not None:
        found.append(Things.plain(filling.legend))
    return Things.joined([*found, _note(step)])


def _filled(line: Array, filling: Filling, number: int, middle: Array) -> Things:
    """A section's cells on a wall along a line (m, 2)."""
    cut = filling.cuts[number]
    start, end = line[cut.column], line[cut.column + 1]
    way, inward = line[-1] - line[0], middle - line[0]
    if way[0] * inward[1] - way[1] * inward[0] < 0:
        start, end = end, start
    made = _made(Kind.PANEL, start, np.column_stack([cut.low, end, cut.top]), 0.0, filling.rgb[number])
    return made.but(values=cut.values)


def _marked(line: Array, filling: Filling, number: int, middle: Array, longest: float, stretch: float) -> Things:
    """Signs of uncertainty on a section's cells, on the seen side of a wall along a line (m, 2)."""
    cut = filling.cuts[number]
    face = Face(line[:-1], line[1:], cut.column, cut.low, cut.top, filling.u[number], cut.values)
    found = marks_on(face, filling.sign, longest / ACROSS, stretch)
    way, inward = line[-1] - line[0], middle - line[0]
    if way[0] * inward[1] - way[1] * inward[0] < 0:
        found = found._replace(start=found.end, end=found.start)
    return of_marks(found, BEHIND * longest, Kind.PANEL)


def _panels(line: Array, low: Array, top: Array, rgb: Colors | Array, middle: Array, known: Any = None) -> Things:
    """Upright rectangles over the pieces of a line (m, 2), from ``low`` to ``top``, whose seen side is the middle's."""
    start, end = line[:-1], line[1:]
    way, inward = line[-1] - line[0], middle - line[0]
    if way[0] * inward[1] - way[1] * inward[0] < 0:
        start, end = end, start
    chosen = slice(None) if known is None else known
    ends = np.column_stack([low, end, top])[chosen]
    return _made(Kind.PANEL, start[chosen], ends, 0.0, np.broadcast_to(rgb, (len(low), 3))[chosen])


def _trace(x: Array, y: Array, heights: Array, radius: float) -> Things:
    """A line on the ground."""
    known = np.isfinite(heights[1:]) & np.isfinite(heights[:-1])
    none = np.full(len(x) - 1, np.nan)
    ends = np.column_stack([none, x[1:], y[1:], none])[known]
    return _made(Kind.TUBE, np.stack([x, y], 1)[:-1][known], ends, radius, np.tile(INK, (int(known.sum()), 1)))


def _note(step: float) -> Things:
    """No thing, but what the legend says of walls."""
    return Things.plain(Legend(note=f"walls: sections through the middle, lines every {step:g} m"))


def _made(kind: Kind, place: Array, ends: Array, radius: float, rgb: Any) -> Things:
    n = len(place)
    return Things(
        np.full(n, kind, np.int8), place[:, 0].copy(), place[:, 1].copy(), np.zeros(n), np.full(n, radius),
        np.full(n, 2 * radius), np.asarray(rgb, np.float32).reshape(n, 3), np.full(n, np.nan), Legend(), ends,
    )  # fmt: skip
