"""What products have in common that add up something over horizons: a canvas, and the loop over swept blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.light.products import Blocks, Context, Options, Values
from orograph.light.raster import rectangles
from orograph.parallel import map_ordered

Add = Callable[[Values, Values, Values, Values, int, int, int], None]
"""(canvas (bands, rows, cols), slopes (r, c), gx (r, c), gy (r, c), row0, col0, index of the azimuth): add the horizons
of a window, which begins at (row0, col0) of the canvas."""

_ROWS = 64
"""Rows of a swept block that one thread takes at a time."""


def gathered(
    context: Context,
    bands: int,
    azimuths: Sequence[float] | NDArray[np.float64],
    add: Add,
    *,
    lowest: float = 0.0,
    what: str = "Sweeping horizons",
) -> Blocks:
    """Sweep horizons, add each to a canvas that begins with zeros, and yield the canvas block by block.

    Args:
        azimuths: degrees from grid north, in any order; each sample gets them in the same order, whatever the blocks.
        add: called from threads, on windows that do not overlap.
        lowest: as for ``Context.horizons``; gx and gy are NaN where heights are missing.
    """
    canvas = context.canvas(bands)
    for block in context.horizons(azimuths, lowest=lowest, what=what):

        def strip(row: int, block: Any = block) -> None:
            end = min(row + _ROWS, block.row1)
            gx, gy = (np.ascontiguousarray(g) for g in context.gradient(row, end, block.col0, block.col1))
            for k, index in enumerate(block.azimuths):
                slopes = block.slopes[k, row - block.row0 : end - block.row0]
                add(canvas.values, slopes, gx, gy, row, block.col0, int(index))

        for _ in map_ordered(strip, range(block.row0, block.row1, _ROWS), context.jobs):
            pass
        canvas.release()
    for row0, row1, col0, col1 in rectangles(context.shape, 256):
        yield row0, col0, canvas.values[:, row0:row1, col0:col1]
    canvas.release()


def context_of(heights: ArrayLike, linear: ArrayLike, options: Options, **how: Any) -> Context:
    """A context for heights in memory, so that functions on arrays are the products themselves.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform: metres east and north per column and per row.
        how: ``jobs``, ``max_memory``, ``progress`` of the context.

    Raises:
        UsageError: the shapes are wrong, or the cells degenerate.
    """
    from affine import Affine

    from orograph.geo.grid import Grid
    from orograph.store.memory import MemoryTerrain

    surface, cells = np.ascontiguousarray(heights, np.float32), np.asarray(linear, np.float64)
    if surface.ndim != 2 or surface.size == 0:
        raise UsageError(f"Light needs heights of shape (rows, cols), not {surface.shape}.")
    if cells.shape != (2, 2) or not np.isfinite(cells).all() or np.linalg.det(cells) == 0:
        raise UsageError("Light needs the 2 × 2 linear part of a geotransform, in metres, that can be inverted.")
    transform = Affine(cells[0, 0], cells[0, 1], 0.0, cells[1, 0], cells[1, 1], 0.0)
    return Context(MemoryTerrain(surface, Grid(surface.shape, transform), "heights"), options, **how)


def collected(context: Context, blocks: Blocks, bands: int) -> Values:
    """Blocks as one array (bands, rows, cols)."""
    out = np.full((bands, *context.shape), np.nan, np.float32)
    for row, col, values in blocks:
        out[:, row : row + values.shape[1], col : col + values.shape[2]] = values
    return out
