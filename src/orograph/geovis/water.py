"""Water, found by what only water is: exactly level over a large connected area.

Elevation models are given lakes and seas of one value. Plains of integer heights have level patches too, but small and
ragged ones, as often above their surroundings as below: a level area is water if it is large, much of it lies well
inside, and its surroundings are banks. Resampling and averaging keep constant
areas exactly constant, so equality is the test. Heights are metres; sizes are in samples, for what cannot be seen cannot
be told apart either.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel

LEAST_SAMPLES = 120
"""Level samples (whose eight neighbours have their height) that an area must have."""

LEAST_INSIDE = 0.4
"""Least part of them whose 24 neighbours have their height: ragged patches have little inside."""

BANKS = 3.0
"""Ground around it must be higher this many times as often as lower: a plateau or a step of a plain is no lake."""


@kernel
def _flood(heights, level, inner, least, inside, banks, water):
    """Mark in ``water`` the connected level areas that pass; ``level`` is used up."""
    rows, cols = heights.shape
    stack = np.empty(rows * cols, np.int64)
    for seed in range(rows * cols):
        if not level[seed // cols, seed % cols]:
            continue
        level[seed // cols, seed % cols] = False
        stack[0] = seed
        size, read, deep, higher, lower = 1, 0, 0, 0, 0
        while read < size:  # what was pushed stays: it is the area
            at = stack[read]
            read += 1
            r, c = at // cols, at % cols
            deep += inner[r, c]
            if not inner[r, c]:  # near the shore: what lies behind it?
                for i in range(max(r - 2, 0), min(r + 3, rows)):
                    for j in range(max(c - 2, 0), min(c + 3, cols)):
                        higher += heights[i, j] > heights[r, c]
                        lower += heights[i, j] < heights[r, c]
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, cols)):
                    if level[i, j] and heights[i, j] == heights[r, c]:
                        level[i, j] = False
                        stack[size] = i * cols + j
                        size += 1
        if size >= least and deep >= inside * size and higher >= banks * lower:
            for k in range(size):
                r, c = stack[k] // cols, stack[k] % cols
                for i in range(max(r - 1, 0), min(r + 2, rows)):  # out to the shore, whose samples are level too
                    for j in range(max(c - 1, 0), min(c + 2, cols)):
                        if heights[i, j] == heights[r, c]:
                            water[i, j] = True


def find_water(heights: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Samples (rows, cols) of ``heights`` (float32 metres, NaN where missing) that are water."""
    level = _same(heights, np.isfinite(heights))
    water = np.zeros(heights.shape, bool)
    if level.any():
        _flood(np.ascontiguousarray(heights), level, _same(heights, level), LEAST_SAMPLES, LEAST_INSIDE, BANKS, water)
    return water


def _same(heights: NDArray[np.float32], where: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples in ``where`` whose eight neighbours (those inside the raster) are in ``where`` and have their height."""
    level = where
    for axis in (0, 1):
        a, b = [slice(None)] * 2, [slice(None)] * 2
        a[axis], b[axis] = slice(1, None), slice(None, -1)
        equal = (heights[tuple(a)] == heights[tuple(b)]) & level[tuple(a)] & level[tuple(b)]
        level = level.copy()
        level[tuple(a)] &= equal
        level[tuple(b)] &= equal
    return level
