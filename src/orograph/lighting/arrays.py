"""Arrays as terrain: a context for products from heights and the linear part of a geotransform."""

from __future__ import annotations

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lighting.context import MEMORY, Context, Options
from orograph.progress import SILENT, Progress
from orograph.store.memory import MemoryTerrain


def terrain_of(heights: ArrayLike, linear: ArrayLike) -> MemoryTerrain:
    """A terrain in memory from an array, which is shared if it is float32.

    Args:
        heights: (rows, cols), metres; missing where masked or not finite.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.

    Raises:
        UsageError: wrong shapes, values that are not real numbers, or degenerate cells.
    """
    given = heights if isinstance(heights, np.ndarray) else np.asarray(heights)
    if given.dtype.kind not in "iufb":
        raise UsageError(f"Heights must be real numbers, not {given.dtype}.")
    surface = np.ascontiguousarray(np.ma.getdata(given), np.float32)
    missing = np.ma.getmaskarray(given) if isinstance(given, np.ma.MaskedArray) else np.zeros((), np.bool_)
    missing = missing | np.isinf(surface)
    if missing.any():
        surface = np.where(missing, np.float32(np.nan), surface)
    cells = np.asarray(linear, np.float64)
    if surface.ndim != 2 or surface.size == 0:
        raise UsageError(f"Heights must have the shape (rows, cols), not {surface.shape}.")
    if cells.shape != (2, 2) or not np.isfinite(cells).all() or abs(np.linalg.det(cells)) == 0:
        raise UsageError("Cells must be the invertible 2 × 2 linear part of a geotransform, in metres.")
    (a, b), (d, e) = cells.tolist()
    return MemoryTerrain(surface, Grid((surface.shape[0], surface.shape[1]), Affine(a, b, 0, d, e, 0)), "array")


def context_of(
    heights: ArrayLike,
    linear: ArrayLike,
    options: Options | None = None,
    *,
    jobs: int | None = None,
    max_memory: int = MEMORY,
    progress: Progress = SILENT,
) -> Context:
    """The context of an array (see ``terrain_of``)."""
    return Context(terrain_of(heights, linear), options, jobs=jobs, max_memory=max_memory, progress=progress)
