"""The inclination of every sample: gradients by central differences over cells of any affine shape, and unit normals.

A sample's two differences (along its row and its column) are taken between its neighbours, or one-sided where one of
them is missing or beyond the border, and converted to metres per metre east and north by the inverse of the cells'
linear map, so that rectangular, rotated and south-up rasters are correct too. Second order inside, exact on planes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._numba import inlined, kernel, read_only
from orograph.parallel import map_ordered

Heights = NDArray[np.float32]

_ROWS = 256
"""Rows differentiated at a time by a thread."""


@inlined
def central(before: float, here: float, after: float, back: float, ahead: float) -> float:
    """The difference quotient at a value between neighbours at distances ``back`` and ``ahead``.

    One-sided where a neighbour is missing (NaN), 0 where both are.
    """
    low, high, gap = here, here, 0.0
    if before == before:
        low = before
        gap += back
    if after == after:
        high = after
        gap += ahead
    return (high - low) / gap if gap > 0.0 else 0.0


@kernel
def _differences(
    heights: Heights, inverse: NDArray[np.float64], first: int, last: int, east: Heights, north: Heights
) -> None:
    """Gradients of rows [first, last); ``inverse`` (2, 2) maps (east, north) to (columns, rows)."""
    rows, cols = heights.shape
    nan = np.float32(np.nan)
    for i in range(first, last):
        for j in range(cols):
            here = heights[i, j]
            if here != here:
                east[i, j] = north[i, j] = nan
                continue
            a = heights[i, j - 1] if j > 0 else nan
            b = heights[i, j + 1] if j + 1 < cols else nan
            c = heights[i - 1, j] if i > 0 else nan
            d = heights[i + 1, j] if i + 1 < rows else nan
            z = np.float64(here)
            across = central(np.float64(a), z, np.float64(b), 1.0, 1.0)
            down = central(np.float64(c), z, np.float64(d), 1.0, 1.0)
            east[i, j] = across * inverse[0, 0] + down * inverse[1, 0]
            north[i, j] = across * inverse[0, 1] + down * inverse[1, 1]


def gradient(heights: ArrayLike, linear: ArrayLike, jobs: int | None = None) -> tuple[Heights, Heights]:
    """Rise per metre towards east and towards north.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.
        jobs: threads; None: all processors.

    Returns:
        two arrays (rows, cols) float32; NaN where heights are; 0 along an axis on which both neighbours are missing.
    """
    surface = read_only(np.ascontiguousarray(heights, np.float32))
    inverse = np.linalg.inv(np.asarray(linear, np.float64))
    east, north = np.empty_like(surface), np.empty_like(surface)

    def run(first: int) -> None:
        _differences(surface, inverse, first, min(first + _ROWS, len(surface)), east, north)

    for _ in map_ordered(run, range(0, len(surface), _ROWS), jobs):
        pass
    return east, north


def normals(heights: ArrayLike, linear: ArrayLike, jobs: int | None = None) -> NDArray[np.float32]:
    """Unit normals (rows, cols, 3) float32: east, north, up; NaN where heights are. Arguments as for ``gradient``."""
    east, north = gradient(heights, linear, jobs)
    out = np.stack([-east, -north, np.ones_like(east)], axis=-1)
    out /= np.sqrt(1.0 + east * east + north * north)[..., None]
    return out
