"""The layout of a terrain's diamonds in arrays: one pair of arrays per nested level, errors and radii.

The array of level k has the level's shape and holds the diamonds of octave k: entry (i, j), i or j odd, belongs to the
vertex (i·2^k, j·2^k). That of the top level is the whole padded square of side 2^(n − top) + 1; the octaves above have
their entries there too, each vertex (row, col) at (row >> top, col >> top), where every diamond has its own place
because a vertex belongs to only one octave. See ``diamond_table`` for the meaning of the numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from orograph.geo.grid import Grid
from orograph.store.terrain import Heights, Shape, diamond_shape, level_count

if TYPE_CHECKING:  # kernels are only compiled where diamonds are made
    from orograph.error import ErrorKind
    from orograph.error.diamonds import Part, Surface

NESTED = 4
"""The level whose heights ``error.diamonds`` needs: every 16th sample."""


def metric(grid: Grid) -> NDArray[np.float64]:
    """Easting and northing per column and row, metres, (2, 2)."""
    a, b, _, d, e, _ = grid.samples[:6]
    return np.array([[a, b], [d, e]])


def surface(grid: Grid, minimum: Heights, lowest: float) -> Surface:
    """The data of a terrain that the spheres need.

    Args:
        minimum: the minima of level 0's tiles.
        lowest: height of the lowest sample, NaN if there is none.
    """
    from orograph.error.diamonds import Surface

    return Surface(grid.shape, metric(grid), minimum, 0.0 if np.isnan(lowest) else lowest)


def blank_top(shape: Shape, dtype: DTypeLike, empty: float) -> NDArray[Any]:
    """The top level before any part is known: entries wholly beyond the raster stay ``empty``."""
    side, _ = diamond_shape(shape, level_count(shape) - 1)
    whole = np.full((side, side), empty, dtype)
    whole[:: side - 1, :: side - 1] = 0  # the square's corners are not diamonds
    return whole


def place(whole: NDArray[Any], values: NDArray[Any], octave: int, i: int, j: int, level: int) -> None:
    """Put an octave's diamonds, and nothing else, into the array of a ``level`` ≤ the octave.

    Args:
        values: a window of the octave whose first entry is (i, j).
    """
    step = 1 << (octave - level)
    rows, cols = values.shape
    i0, j0 = i * step, j * step
    window = whole[i0 : i0 + (rows - 1) * step + 1 : step, j0 : j0 + (cols - 1) * step + 1 : step]
    odd_row, odd_col = 1 - i % 2, 1 - j % 2  # the first odd entries
    window[odd_row::2] = values[odd_row::2]
    window[1 - odd_row :: 2, odd_col::2] = values[1 - odd_row :: 2, odd_col::2]


def gather(shape: Shape, parts: Iterable[Part], kind: ErrorKind) -> tuple[list[Heights], list[Heights]]:
    """The errors of a kind and the radii of every level, merged from all parts.

    Radii are left empty if the parts have none.
    """
    from orograph.error.diamonds import NOTHING

    top = level_count(shape) - 1
    shapes = [diamond_shape(shape, level) for level in range(top)]
    errors = [*(np.zeros(s, np.float32) for s in shapes), blank_top(shape, np.float32, 0)]
    radii = [*(np.zeros(s, np.float32) for s in shapes), blank_top(shape, np.float32, float(NOTHING))]
    for part in parts:
        level = min(part.octave, top)
        place(errors[level], part.errors[kind], part.octave, part.i, part.j, level)
        if part.radii is not None:
            place(radii[level], part.radii, part.octave, part.i, part.j, level)
    return errors, radii
