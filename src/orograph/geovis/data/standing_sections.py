"""Sections through volumes: curtains where a line runs, in the ground or over it, and what fills ExoVis' walls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import BELOW, Dataset
from orograph.geovis.data.features import read_features
from orograph.geovis.data.shapes import read_shapes
from orograph.geovis.data.standing import Kind, Things, longer
from orograph.geovis.data.standing_colors import Caption, Colored, colors_of
from orograph.geovis.data.standing_lines import pieces
from orograph.geovis.data.standing_marks import ACROSS, BEFORE, MARKS, Face, Marks, marks_on
from orograph.geovis.data.volume import Cells, Volume, cells, read_volume
from orograph.geovis.keys import Legend

Array = NDArray[np.float64]
Ground = Callable[[Array, Array], Array]

STYLES = ("curtains", "walls")

COLUMNS, ROWS = 360, 120
"""Cells of a section along the terrain's longer side, and from its lowest to its highest place."""


def curtains(dataset: Dataset, grid: Grid, ground: Ground, stretch: float = 1.0, marked: bool = False) -> Things:
    """Curtains through a volume, along the dataset's lines.

    Args:
        ground: heights (n,) at places (n,), NaN where there are none. stretch: of heights in the picture.
        marked: whether uncertainty has usually signs of its own.

    Raises:
        ReadError, UsageError: the volume or the line cannot be read, or do not meet the terrain.
    """
    volume = read_volume(dataset, grid)
    start, end = _pieces(dataset, grid)
    cut = section(volume, grid, start, end, ground)
    if not len(cut.low):
        raise ReadError("No value of the volume is over the line.", path=volume.fields[0].name,
                        remedy="Choose another line: along=.")  # fmt: skip
    n, of = len(cut.low), cut.column
    rgb, legend, u, sign = _colors(dataset, volume, cut, marked)
    through = BELOW if dataset.hidden is None and volume.kind == "depth" else dataset.through
    made = Things.plain(legend).but(
        kind=np.full(n, Kind.SECTION, np.int8), x=start[of, 0], y=start[of, 1], lift=np.zeros(n), radius=np.zeros(n),
        height=np.zeros(n), rgb=rgb, values=cut.values, ends=np.column_stack([cut.low, end[of], cut.top]),
        hidden=np.full(n, through),
    )  # fmt: skip
    if sign not in MARKS:
        return made
    found = marks_on(Face(start, end, of, cut.low, cut.top, u, cut.values), sign, longer(grid) / ACROSS, stretch)
    both = (of_marks(found, gap * BEFORE * longer(grid), Kind.SECTION) for gap in (1, -1))
    return Things.joined([made, *(one.but(hidden=np.full(len(one), through)) for one in both)])


def of_marks(found: Marks, gap: float, kind: Kind) -> Things:
    """Signs as things, each layer ``gap`` to the left of the one behind it."""
    n = len(found.low)
    start, end = found.before(gap)
    return Things.plain(Legend()).but(
        kind=np.full(n, kind, np.int8), x=start[:, 0], y=start[:, 1], lift=np.zeros(n), radius=np.zeros(n),
        height=np.zeros(n), rgb=found.rgb, values=found.values, ends=np.column_stack([found.low, end, found.top]),
    )  # fmt: skip


class Filling:
    """What fills the walls around the block: a volume, in one scale of colours for all sections.

    Args:
        lines: (pieces + 1, 2) places of each section. marked: as of ``curtains``.

    Attributes:
        cuts: the sections. rgb, u: of their cells, colours and uncertainties along their scale. sign: of these.
    """

    def __init__(
        self, dataset: Dataset, grid: Grid, ground: Ground, lines: list[Array], marked: bool = False
    ) -> None:  # fmt: skip
        volume = read_volume(dataset, grid)
        self.cuts = [section(volume, grid, line[:-1], line[1:], ground) for line in lines]
        low, top, column, values = (np.concatenate([cut[k] for cut in self.cuts]) for k in range(4))
        doubts = [cut.sigma for cut in self.cuts if cut.sigma is not None]
        joined = Cells(low, top, column, values, np.concatenate(doubts) if doubts else None)
        if not len(joined.low):
            raise ReadError("No value of the volume is over the terrain's middle.", path=volume.fields[0].name)
        rgb, self.legend, u, self.sign = _colors(dataset, volume, joined, marked)
        borders = np.cumsum([len(cut.low) for cut in self.cuts])[:-1]
        self.rgb, self.u = np.split(rgb, borders), np.split(u, borders)
        self.span = float(joined.low.min()), float(joined.top.max())


def section(volume: Volume, grid: Grid, start: Array, end: Array, ground: Ground) -> Cells:
    """Cells over the pieces of a line, (n, 2) each, that are over the terrain."""
    x, y = ((start + end) / 2).T
    col, row = grid.index(x, y)
    here = (col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1)
    base = ground(x, y)
    levels, values, sigma = volume.profiles(grid, x, y, base)
    return cells(volume, (np.where(here, levels, np.nan), values, sigma), base, ROWS)


def _colors(dataset: Dataset, volume: Volume, cut: Cells, marked: bool) -> Colored:
    field = volume.fields[0]
    of = "probability" if dataset.exceeds is not None else ""
    shown = dataset.but(range=dataset.range or (0.0, 1.0), uncertainty=None) if of else dataset
    unit = field.unit if of or dataset.unit is None else dataset.unit
    chosen = field.chosen.rpartition(" at ")[0] if " at " in field.chosen else ""
    note = ", ".join(filter(None, [chosen, volume.note]))
    return colors_of(shown, cut.values, cut.sigma, Caption(field.name, unit, note), marked)


def _pieces(dataset: Dataset, grid: Grid) -> tuple[Array, Array]:
    """The pieces of the lines that curtains stand along: where they begin and end, (n, 2) in the terrain's CRS."""
    step = longer(grid) / COLUMNS
    if dataset.along is None:
        lines = middle_lines(grid, COLUMNS)
        return np.concatenate([one[:-1] for one in lines]), np.concatenate([one[1:] for one in lines])
    source = dataset.along
    if isinstance(source, str) and not source.strip("0123456789.:-+eE"):
        source = _typed(source)
    found = read_features(Dataset(source, geometry="lines"), grid)
    shapes = read_shapes(Dataset(source), replace(found, columns={}), grid, 0.25 * max(grid.spacing))
    at, _ = pieces(shapes, step)
    return at[:, :2], at[:, 3:5]


def middle_lines(grid: Grid, count: int) -> list[Array]:
    """The row and the column through a terrain's middle: (count + 1, 2) places of each."""
    part = np.linspace(0.0, 1.0, count + 1)
    right, bottom = grid.cols - 1.0, grid.rows - 1.0
    across, down = np.full(count + 1, bottom / 2), np.full(count + 1, right / 2)
    return [np.stack(grid.xy(part * right, across), 1), np.stack(grid.xy(down, part * bottom), 1)]


def _typed(text: str) -> dict[str, object]:
    """A line of numbers, as GeoJSON."""
    numbers = [float(part) for part in text.split(":")]
    if len(numbers) < 4 or len(numbers) % 2:
        raise UsageError(f"A line must be lon:lat:lon:lat…, not {text!r}.", remedy="Give at least two points: along=.")
    places = [list(pair) for pair in zip(numbers[::2], numbers[1::2])]
    return {"type": "LineString", "coordinates": places}
