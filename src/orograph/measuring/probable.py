"""Measures of an uncertain terrain: the probability of each outcome, by Monte Carlo over draws of its heights' error.

Each draw is a terrain that might be the true one (``height_error``); a probability is the part of the draws in which
something holds. Its standard error is sqrt(p (1 − p) / n) for n draws, at most 1 / (2 sqrt(n)): 0.035 for 200 draws,
0.016 for 1000. Slopes and contours are computed block by block with all draws of a block, viewsheds and floods draw by
draw with counts per sample; results depend on the seed, not on threads, blocks or memory.

*Probable* is Fisher's word (1994): a viewshed whose values are probabilities of being seen. (His *fuzzy* viewshed
grades how clearly a thing is seen.)
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of, scratch
from orograph.geo.grid import Grid, compose
from orograph.lighting.normal import gradient
from orograph.lighting.raster import Band, rectangles, write
from orograph.measuring.height_error import Drawn, ErrorField, HeightError, around, takes_error
from orograph.measuring.viewshed import viewshed
from orograph.parallel import map_ordered, threads_for
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.several import Numbers, numbers
from orograph.store.opening import takes_terrain
from orograph.store.terrain import TILE, Terrain

if TYPE_CHECKING:
    from orograph.geovis.data.dataset import Dataset

Array = NDArray[np.float64]
Values = NDArray[np.float32]
Window = tuple[int, int, int, int]
Blocks = Iterator[tuple[int, int, Values]]

DRAWS = 200
MOST_DRAWS = 65_535
MEMORY = 1 << 30
PROBABILITY = "probability"


@dataclass(frozen=True)
class Probable:
    """A measure of an uncertain terrain, computed on demand.

    Attributes:
        measure: its kind: "viewshed", "slope", "contours", "flood".
        grid: of the result. bands: what it holds.
        error: of the heights. draws, seed: of the Monte Carlo; 0 draws: the result is a closed form.
        tags: other metadata for a file.
    """

    measure: str
    grid: Grid
    bands: tuple[Band, ...]
    error: HeightError
    draws: int
    seed: int
    tags: dict[str, str]
    _made: Callable[[Progress], Blocks] = field(repr=False)
    _jobs: int = field(default=1, repr=False)

    @property
    def standard_error(self) -> float:
        """The largest standard error of a probability for this number of draws."""
        return 0.5 / math.sqrt(self.draws) if self.draws else 0.0

    def blocks(self, progress: Progress | bool | None = None) -> Blocks:
        """Block by block: (first row, first column, values (bands, rows, cols) float32), once each."""
        return self._made(reporting(progress))

    def values(self, progress: Progress | bool | None = None) -> Values:
        """All of it in memory: (bands, rows, cols) float32, NaN where the height is unknown."""
        out = np.empty((len(self.bands), *self.grid.shape), np.float32)
        for row, col, values in self.blocks(progress):
            out[:, row : row + values.shape[1], col : col + values.shape[2]] = values
        return out

    def save(self, path: str | os.PathLike[str], progress: Progress | bool | None = None) -> dict[str, Any]:
        """Write a Cloud Optimized GeoTIFF of float32; returns the summary (``Tally``).

        Raises:
            OutputError: it cannot be written.
        """
        tally = Tally(self)
        blocks = ((0, row, col, values) for row, col, values in tally.over(self.blocks(progress)))
        tags = {"software": "orograph", "measure": self.measure, **self.error.tags, **self.tags}
        tags |= {"draws": str(self.draws), "seed": str(self.seed)} if self.draws else {"draws": "none: a closed form"}
        write(path, self.grid, self.bands, blocks, tags=tags, jobs=self._jobs, progress=reporting(progress))
        return tally.result()

    def data(self, band: int = 1, progress: Progress | bool | None = None, **looks: Any) -> Dataset:
        """A band as data to show on the terrain, with its legend; computed now.

        Args:
            band: from 1. looks: keys of a ``Dataset`` (``style``, ``colormap``…).
        """
        from orograph.geovis.data.dataset import Dataset
        from orograph.geovis.data.field import Field

        about = self.bands[band - 1]
        return Dataset(Field(self.values(progress)[band - 1][None], self.grid, about.name, about.unit),
                       **{**looks_of(about), **looks})  # fmt: skip


def looks_of(band: Band) -> dict[str, Any]:
    """The default style of a band."""
    if band.name.startswith(PROBABILITY):
        return {"name": f"P({band.name[len(PROBABILITY) + 4 :]})", "range": (0.0, 1.0), "colormap": "YlGnBu"}
    return {"name": band.name.capitalize()}


class Tally:
    """Sums over blocks as they pass by."""

    def __init__(self, found: Probable) -> None:
        self.found = found
        self.cell = found.grid.cell_area
        self.known = np.zeros(len(found.bands), np.int64)
        self.total = np.zeros(len(found.bands))

    def over(self, blocks: Blocks) -> Blocks:
        """The same blocks, summed."""
        for row, col, values in blocks:
            self.known += np.isfinite(values).sum((1, 2))
            self.total += np.nansum(values, (1, 2), dtype=np.float64)
            yield row, col, values

    def result(self) -> dict[str, Any]:
        """The number of known samples, the mean of each band, and for a probability the expected area on the
        grid, m²."""
        means = self.total / np.maximum(self.known, 1)
        tags: dict[str, Any] = {
            "samples": int(self.known[0]),
            "means": {band.name: float(mean) for band, mean in zip(self.found.bands, means)},
            "draws": self.found.draws, "standard_error": self.found.standard_error,
        }  # fmt: skip
        first = self.found.bands[0].name
        if first.startswith(PROBABILITY):
            tags["expected_grid_m2"] = float(self.total[0] * self.cell)
        return tags


@takes_error
@takes_terrain
def probable_viewshed(
    terrain: Terrain, /, point: ArrayLike, error: HeightError, eye: float = 1.7, target: float = 0.0, *,
    draws: int = DRAWS, seed: int = 1, max_memory: Amount = MEMORY, jobs: int | None = None, **options: Any,
) -> Probable:  # fmt: skip
    """The probability that each sample is visible from a point.

    In each draw the eye stands on the ground of that draw.

    Args:
        point, eye, target: as for ``viewshed``, with its ``options`` radius, lonlat…
        error: of the heights. draws, seed: of the Monte Carlo.

    Raises:
        UsageError: as ``viewshed``; there are fewer than 1 or more than 65,535 draws. ReadError: see ``ErrorField``.
    """
    check_draws(draws)
    max_memory = bytes_of(max_memory)
    options = {**options, "max_memory": max_memory, "jobs": jobs}
    shed = viewshed(terrain, point, eye, target, **options)
    errors = ErrorField(terrain, error, seed, max_memory=max_memory, jobs=jobs)
    band = Band("probability of being seen", "", "the part of the draws in which the sample is seen from the eye")

    def made(progress: Progress) -> Blocks:
        counts = Counts(shed.grid.shape, max_memory)
        with progress.task("Looking at draws", total=draws) as task:
            for draw in range(draws):
                one = viewshed(Drawn(terrain, errors, draw), point, eye, target, **options)
                for row, col, values in one.blocks():
                    counts.add(row, col, values > 0)
                task.advance()
        known = known_from(terrain, shed.row, shed.col)
        for row, col, part in counts.parts():
            values = np.where(known(row, col, part.shape), part / np.float32(draws), np.nan)
            values[shed.beyond(row, col, part.shape)] = np.nan
            yield row, col, values.astype(np.float32)[None]

    tags = {"eye": f"{shed.point[0]:.10g}, {shed.point[1]:.10g}", "eye_height": f"{eye:g} m",
            "target_height": f"{target:g} m"}  # fmt: skip
    return Probable("viewshed", shed.grid, (band,), error, draws, seed, tags, made, threads_for(jobs))


@takes_error
@takes_terrain
def slope(
    terrain: Terrain, error: HeightError, exceeds: Numbers = (), *, draws: int = DRAWS, seed: int = 1,
    max_memory: Amount = MEMORY, jobs: int | None = None,
) -> Probable:  # fmt: skip
    """Mean and standard deviation of the slope at each sample, degrees, and the probability that it exceeds limits.

    The slope is that of ``orograph light --product slope``: central differences on the grid.

    Args:
        exceeds: degrees, a band for each. error, draws, seed: as for ``probable_viewshed``.

    Raises:
        UsageError: a limit is not from 0 to 90 degrees; there are too few or too many draws (at least 2).
    """
    check_draws(draws, 2)
    max_memory = bytes_of(max_memory)
    exceeds = numbers(exceeds, "exceeds")
    for limit in exceeds:
        if not 0 <= limit < 90:
            raise UsageError(f"A slope to exceed must be from 0 to 90 degrees, not {limit:g}.")
    errors = ErrorField(terrain, error, seed, max_memory=max_memory, jobs=jobs)
    linear = terrain.grid.linear
    bands = (
        Band("mean slope", "°", "the mean slope of the draws, degrees", (0.0, 90.0)),
        Band("standard deviation of the slope", "°", "of the slopes of the draws, n − 1, degrees", (0.0, 90.0)),
        *(Band(f"{PROBABILITY} of slope > {limit:g}°", "", "the part of the draws whose slope is more")
          for limit in exceeds),
    )  # fmt: skip

    def look(window: Window) -> Values:
        heights, inner = around(terrain, *window)
        r0, c0 = window[0] - inner[0].start, window[2] - inner[1].start
        frame = (r0, r0 + heights.shape[0], c0, c0 + heights.shape[1])
        mean, squares = np.zeros((2, window[1] - window[0], window[3] - window[2]))
        over = np.zeros((len(exceeds), *mean.shape), np.int64)
        for draw in range(draws):
            drawn = (heights + errors.window(draw, *frame)).astype(np.float32)
            east, north = gradient(drawn, linear, 1)
            slope = np.degrees(np.arctan(np.hypot(east[inner].astype(np.float64), north[inner])))
            step = slope - mean  # Welford 1962
            mean += step / (draw + 1)
            squares += step * (slope - mean)
            for k, limit in enumerate(exceeds):
                over[k] += slope > limit
        made = np.stack([mean, np.sqrt(squares / (draws - 1)), *(over / draws)])
        made[:, np.isnan(heights[inner])] = np.nan
        return made.astype(np.float32)

    return _by_blocks("slope", terrain.grid, terrain.grid.shape, bands, error, draws, seed, {}, look, jobs)


@takes_error
@takes_terrain
def contours(
    terrain: Terrain, error: HeightError, levels: Numbers = (), *, interval: float | None = None,
    draws: int = DRAWS, seed: int = 1, max_memory: Amount = MEMORY, jobs: int | None = None,
) -> Probable:  # fmt: skip
    """The probability that a contour line passes through each cell: bands of contours instead of lines.

    Args:
        levels: heights of the lines, metres; interval: or their spacing, counted from 0. error, draws, seed: as for
            ``probable_viewshed``.

    Returns:
        values at the cells' middles: one row and one column fewer than samples.

    Raises:
        UsageError: there are neither levels nor an interval, or both; the terrain has one row or column.
    """
    check_draws(draws)
    max_memory = bytes_of(max_memory)
    levels = numbers(levels, "levels")
    if bool(levels) == (interval is not None):
        raise UsageError("Contours need levels or an interval: give one of the two.")
    if interval is not None and not (interval > 0 and math.isfinite(interval)):
        raise UsageError(f"An interval must be a number of metres above 0, not {interval:g}.")
    if min(terrain.grid.shape) < 2:
        raise UsageError("A terrain of one row or column of samples has no cells for contours to pass through.")
    errors = ErrorField(terrain, error, seed, max_memory=max_memory, jobs=jobs)
    rows, cols = terrain.grid.rows - 1, terrain.grid.cols - 1
    where = f"every {interval:g} m" if interval is not None else "at " + ", ".join(f"{v:g}" for v in levels) + " m"
    band = Band(f"{PROBABILITY} of a contour {where}", "", "the part of the draws in which one passes through the cell")
    steps = np.sort(np.asarray(levels, np.float64))

    def number(heights: Array) -> Array:
        """How many lines lie below a height."""
        return np.ceil(heights / interval) if interval is not None else np.searchsorted(steps, heights).astype(float)

    def look(window: Window) -> Values:
        row0, row1, col0, col1 = window
        frame = (row0, row1 + 1, col0, col1 + 1)
        heights = terrain.read(0, *frame)
        count = np.zeros((row1 - row0, col1 - col0), np.int64)
        for draw in range(draws):
            below = number(heights + errors.window(draw, *frame))
            corners = (below[:-1, :-1], below[:-1, 1:], below[1:, :-1], below[1:, 1:])
            with np.errstate(invalid="ignore"):
                low = np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3]))
                high = np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3]))
                count += low < high
        missing = np.isnan(heights)
        hole = missing[:-1, :-1] | missing[:-1, 1:] | missing[1:, :-1] | missing[1:, 1:]
        return np.where(hole, np.nan, count / draws).astype(np.float32)[None]

    from affine import Affine

    grid = Grid((rows, cols), compose(terrain.grid.transform, Affine.translation(0.5, 0.5)), terrain.grid.crs)
    tags = {"contours": where}
    return _by_blocks("contours", grid, (rows, cols), (band,), error, draws, seed, tags, look, jobs)


class Counts:
    """How often something was true at each sample, in up to 65,535 draws; large counts go to a scratch file."""

    def __init__(self, shape: tuple[int, int], max_memory: int) -> None:
        size = 2 * shape[0] * shape[1]
        self._release: Callable[[], None] | None = None
        if 3 * size > max_memory:
            space, self._release = scratch(size)
            self.values = space.view(np.uint16).reshape(shape)
        else:
            self.values = np.zeros(shape, np.uint16)
        self._added = 0

    def add(self, row: int, col: int, holds: NDArray[np.bool_]) -> None:
        self.values[row : row + holds.shape[0], col : col + holds.shape[1]] += holds
        self._added += 1
        if self._release is not None and self._added % 64 == 0:
            self._release()

    def parts(self) -> Iterator[tuple[int, int, NDArray[np.uint16]]]:
        """Counts, block by block."""
        for row0, row1, col0, col1 in rectangles((self.values.shape[0], self.values.shape[1]), TILE, 16 * TILE):
            yield row0, col0, self.values[row0:row1, col0:col1]
            if self._release is not None:
                self._release()


def known_from(terrain: Terrain, row: int, col: int) -> Callable[[int, int, tuple[int, ...]], NDArray[np.bool_]]:
    """Tells where heights are known, for blocks of the part of a terrain that begins at (row, col)."""

    def known(first_row: int, first_col: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        r, c = row + first_row, col + first_col
        return ~np.isnan(terrain.read(0, r, r + shape[0], c, c + shape[1]))

    return known


def _by_blocks(
    measure: str, grid: Grid, shape: tuple[int, int], bands: tuple[Band, ...], error: HeightError, draws: int,
    seed: int, tags: dict[str, str], look: Callable[[Window], Values], jobs: int | None,
) -> Probable:  # fmt: skip
    """The function applied to each block."""

    def made(progress: Progress) -> Blocks:
        windows = list(rectangles(shape, TILE, TILE))
        with progress.task("Drawing terrains", total=len(windows)) as task:
            for window, values in zip(windows, map_ordered(look, windows, jobs)):
                yield window[0], window[2], values
                task.advance()

    return Probable(measure, grid, bands, error, draws, seed, tags, made, threads_for(jobs))


def check_draws(draws: int, least: int = 1) -> None:
    if not least <= draws <= MOST_DRAWS:
        raise UsageError(f"The number of draws must be from {least} to {MOST_DRAWS:,}, not {draws}.")
