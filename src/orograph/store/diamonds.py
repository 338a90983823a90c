"""How the diamonds of a terrain lie in arrays: one pair of arrays per nested level, errors and radii.

The array of level k has the level's shape and holds the diamonds of octave k: entry (i, j), i or j odd, belongs to the
vertex (i·2^k, j·2^k). That of the top level is the whole padded square of side 2^(n − top) + 1; the octaves above have
their entries there too, each vertex (row, col) at (row >> top, col >> top), where every diamond finds a place of its
own because a vertex belongs to one octave only. See ``Terrain.diamonds`` for what the numbers mean.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.error.diamonds import NOTHING, Part, Surface
from orograph.geo.grid import Grid
from orograph.store.terrain import Heights, Shape, exponent, level_count, level_shape

NESTED = 4
"""The level whose heights ``error.diamonds`` asks for: every 16th sample."""


def diamond_shape(shape: Shape, level: int) -> Shape:
    """(rows, cols) of a level's arrays."""
    top = level_count(shape) - 1
    side = (1 << (exponent(shape) - top)) + 1
    return (side, side) if level == top else level_shape(shape, level)


def surface(grid: Grid, minimum: Heights, lowest: float) -> Surface:
    """What the spheres must know of a terrain.

    Args:
        minimum: of the tiles of level 0.
        lowest: height of the lowest sample, NaN if there is none.
    """
    a, b, _, d, e, _ = grid.samples[:6]
    metric = np.array([[a, b], [d, e]])
    return Surface(grid.shape, metric, minimum, 0.0 if np.isnan(lowest) else lowest)


def blank_top(shape: Shape) -> tuple[Heights, Heights]:
    """The top level's errors and radii before any part is known: what lies wholly beyond the raster is empty."""
    side = diamond_shape(shape, level_count(shape) - 1)
    radii = np.full(side, NOTHING, np.float32)
    radii[:: side[0] - 1, :: side[1] - 1] = 0.0  # the square's corners are no diamonds
    return np.zeros(side, np.float32), radii


def place(whole: NDArray[np.float32], values: Heights, part: Part, level: int) -> None:
    """Put a part's diamonds, and nothing else of it, into the array of ``level`` ≤ its octave."""
    step = 1 << (part.octave - level)
    rows, cols = values.shape
    i, j = part.i * step, part.j * step
    window = whole[i : i + (rows - 1) * step + 1 : step, j : j + (cols - 1) * step + 1 : step]
    odd_row, odd_col = 1 - part.i % 2, 1 - part.j % 2
    window[odd_row::2] = values[odd_row::2]
    window[1 - odd_row :: 2, odd_col::2] = values[1 - odd_row :: 2, odd_col::2]


def gather(shape: Shape, parts: Iterable[Part], kind: ErrorKind) -> tuple[list[Heights], list[Heights]]:
    """The errors of a kind and the radii of every level from all parts (no radii worth having if those have none)."""
    top = level_count(shape) - 1
    shapes = [diamond_shape(shape, level) for level in range(top)]
    last = blank_top(shape)
    errors = [*(np.zeros(s, np.float32) for s in shapes), last[0]]
    radii = [*(np.zeros(s, np.float32) for s in shapes), last[1]]
    for part in parts:
        level = min(part.octave, top)
        place(errors[level], part.errors[kind], part, level)
        if part.radii is not None:
            place(radii[level], part.radii, part, level)
    return errors, radii
