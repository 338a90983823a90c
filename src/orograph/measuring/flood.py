"""Floods: which ground lies below a water level and is connected to the water's source.

The surface below a level is a set of pieces. Two samples are in one piece exactly if a path along edges of the
triangulated surface connects them below the level (for a surface that is linear on triangles), so water flows from
sample to sample along edges. For an uncertain terrain the probability of being flooded is found by Monte Carlo
(``probable``), draw by draw; without sources it is Φ((level − z) / σ), without draws.

A draw computes only the tiles that may have ground below the level, judged by each tile's lowest height; each sample
takes a byte, and two for its counts. What takes more than a third of the allowed memory goes to a scratch file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of, scratch
from orograph.lighting.raster import Band, rectangles
from orograph.measuring.flood_kernels import REACHED, WET, fill
from orograph.measuring.height_error import ErrorField, HeightError, takes_error
from orograph.measuring.places import Places
from orograph.measuring.probable import (
    DRAWS,
    MEMORY,
    PROBABILITY,
    Blocks,
    Counts,
    Probable,
    check_draws,
    known_from,
)
from orograph.parallel import map_ordered, threads_for
from orograph.progress import Progress
from orograph.store.opening import takes_terrain
from orograph.store.terrain import TILE, Terrain

Window = tuple[int, int, int, int]

CERTAIN = HeightError()


@takes_error
@takes_terrain
def flood(
    terrain: Terrain, level: float, sources: ArrayLike | None = None, error: HeightError = CERTAIN, *,
    lonlat: bool = False, draws: int = DRAWS, seed: int = 1, max_memory: Amount = MEMORY, jobs: int | None = None,
) -> Probable:  # fmt: skip
    """The probability that each sample is flooded: that its ground is below the level and connected to a source.

    Args:
        level: of the water, metres, in the terrain's heights.
        sources: (n, 2) easting and northing of the water's sources; each stands for the sample nearest to it. None: all
            ground below the level is flooded.
        lonlat: sources are longitude and latitude, degrees.
        error: of the heights; without one the result is 0 or 1. draws, seed: of the Monte Carlo.

    Returns:
        a ``Probable``.

    Raises:
        UsageError: the level is not finite; a source is not on the terrain, or in a hole; there are too few or too
            many draws. ReadError: see ``ErrorField``.
    """
    check_draws(draws)
    max_memory = bytes_of(max_memory)
    if not math.isfinite(level):
        raise UsageError(f"A water level must be a number of metres, not {level!r}.")
    errors = ErrorField(terrain, error, seed, max_memory=max_memory, jobs=jobs)
    jobs = threads_for(jobs)
    joined = "" if sources is None else " and connected to a source"
    band = Band(f"{PROBABILITY} of being flooded", "",
                f"the part of the draws in which the ground is below {level:g} m{joined}")  # fmt: skip
    tags = {"level": f"{level:g} m"}
    if sources is None:
        return Probable(
            "flood", terrain.grid, (band,), error, 0, seed, tags, _below(terrain, errors, level, jobs), jobs
        )
    seeds, above = _samples(terrain, sources, level, lonlat)
    exact = errors.largest == 0.0
    if exact:
        draws = 1
    tags["sources"] = "; ".join(f"{e:.10g}, {n:.10g}" for e, n in Places(terrain).points(sources, lonlat=lonlat))

    def made(progress: Progress) -> Blocks:
        counts = Counts(terrain.grid.shape, max_memory)
        rivers = _Rivers(terrain, errors, level, seeds, max_memory, jobs)
        for words in above:
            progress.warn(words + (": it floods nothing." if exact else ": it floods only in draws that put it below."))
        with progress.task("Flooding draws", total=draws) as task:
            for draw in range(draws):
                for row, col, reached in rivers.flooded(draw):
                    counts.add(row, col, reached)
                task.advance()
        known = known_from(terrain, 0, 0)
        for row, col, part in counts.parts():
            values = np.where(known(row, col, part.shape), part / np.float32(draws), np.nan)
            yield row, col, values.astype(np.float32)[None]

    return Probable("flood", terrain.grid, (band,), error, 0 if exact else draws, seed, tags, made, jobs)


def _below(terrain: Terrain, errors: ErrorField, level: float, jobs: int) -> Callable[[Progress], Blocks]:
    """Probabilities of being below a level, in closed form."""
    from scipy.special import ndtr

    def look(window: Window) -> NDArray[np.float32]:
        heights = terrain.read(0, *window).astype(np.float64) + errors.mean(*window)
        sigma = errors.deviations(*window)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.where(sigma > 0, ndtr((level - heights) / sigma), heights < level)
        return np.where(np.isnan(heights), np.nan, found).astype(np.float32)[None]

    def made(progress: Progress) -> Blocks:
        windows = list(rectangles(terrain.grid.shape, TILE, 4 * TILE))
        with progress.task("Looking at the ground", total=len(windows)) as task:
            for window, values in zip(windows, map_ordered(look, windows, jobs)):
                yield window[0], window[2], values
                task.advance()

    return made


def _samples(
    terrain: Terrain, sources: ArrayLike, level: float, lonlat: bool
) -> tuple[list[tuple[int, int]], list[str]]:
    """(row, col) of the samples nearest to places, and warnings about those above the level."""
    places = Places(terrain)
    points = places.points(sources, lonlat=lonlat)
    cols, rows = np.rint(places.samples(points)).astype(int).T
    found, above = list(zip(rows.tolist(), cols.tolist())), []
    for (row, col), point in zip(found, points):
        height = float(terrain.read(0, row, row + 1, col, col + 1)[0, 0])
        if math.isnan(height):
            raise UsageError(
                f"The source {point[0]:.10g}, {point[1]:.10g} is in a hole: the ground there is unknown.",
                remedy="Choose another point.",
            )  # fmt: skip
        if height >= level:
            above.append(
                f"The source {point[0]:.10g}, {point[1]:.10g} is at {height:,.2f} m, not below the level of {level:g} m"
            )
    return found, above


class _Rivers:
    """Floods of a terrain's draws, one after the other."""

    def __init__(
        self, terrain: Terrain, errors: ErrorField, level: float, seeds: list[tuple[int, int]], max_memory: int,
        jobs: int,
    ) -> None:  # fmt: skip
        self.terrain, self.errors, self.level, self.seeds, self.jobs = terrain, errors, level, seeds, jobs
        size = terrain.grid.rows * terrain.grid.cols
        self.release: Callable[[], None] | None = None
        if 3 * size > max_memory:
            space, self.release = scratch(size)
            self.state = space.reshape(terrain.grid.shape)
        else:
            self.state = np.zeros(terrain.grid.shape, np.uint8)
        lowest = terrain.tiles(0).minimum
        self.windows: dict[tuple[int, int], Window] = {}
        for row0, row1, col0, col1 in rectangles(terrain.grid.shape, TILE, TILE):
            i, j = row0 // TILE, col0 // TILE
            low = float(lowest[min(i, lowest.shape[0] - 1), min(j, lowest.shape[1] - 1)])
            if low < level + errors.beyond:
                self.windows[i, j] = (row0, row1, col0, col1)

    def flooded(self, draw: int) -> Iterator[tuple[int, int, NDArray[np.bool_]]]:
        """(first row, first column, whether samples are flooded) of the tiles that may be flooded."""

        def wet(window: Window) -> None:
            row0, row1, col0, col1 = window
            heights = self.terrain.read(0, *window) + self.errors.window(draw, *window)
            self.state[row0:row1, col0:col1] = heights < self.level

        for _ in map_ordered(wet, self.windows.values(), self.jobs):
            pass
        waiting: dict[tuple[int, int], None] = {}
        for row, col in self.seeds:
            if self.state[row, col] == WET:
                self.state[row, col] = WET | REACHED
                waiting[row // TILE, col // TILE] = None
        stack = np.empty(TILE * TILE, np.int64)
        springs = set(waiting)
        while waiting:
            i, j = next(iter(waiting))
            del waiting[i, j]
            spring = (i, j) in springs
            springs.discard((i, j))
            if fill(self.state, *self.windows[i, j], spring, stack) or spring:
                around = [(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1) if di or dj]
                waiting.update((tile, None) for tile in around if tile in self.windows)
        for row0, row1, col0, col1 in self.windows.values():
            reached_now = self.state[row0:row1, col0:col1] == WET | REACHED
            if reached_now.any():
                yield row0, col0, reached_now
        if self.release is not None:
            self.release()
