"""Water, found by what only water is: exactly level over a large connected area.

Elevation models are given lakes and seas of one value. Plains of whole metres have level patches too, but small and
ragged ones, as often above their surroundings as below. So a level area is water if it is large, much of it lies well
inside, and its surroundings are banks; and away from the sea, if its level is a whole number of metres (which is where
plains are level), its banks must soon rise by more than the metre that rounding makes. Dry lake beds and salt pans that
lie beneath steep slopes are still taken for lakes. Resampling and averaging keep constant areas exactly constant, so
equality is the test. Heights are metres; sizes are in samples, for what cannot be seen cannot be told apart either.
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

RISE, REACH, RISING = 1.5, 400.0, 0.5
"""Of the ground ``REACH`` metres around water that may be a plain, at least ``RISING`` is ``RISE`` metres higher."""


@kernel
def _rises(heights, inner, area, reach):
    """Part of the ground ``reach`` samples from the rim of ``area`` (flat indices) that is ``RISE`` metres above it."""
    rows, cols = heights.shape
    around = high = 0
    for k in range(len(area)):
        r, c = area[k] // cols, area[k] % cols
        if inner[r, c]:
            continue
        for i in range(max(r - reach, 0), min(r + reach + 1, rows), reach):
            for j in range(max(c - reach, 0), min(c + reach + 1, cols), reach):
                around += heights[i, j] == heights[i, j] and heights[i, j] != heights[r, c]
                high += heights[i, j] > heights[r, c] + RISE
    return high / max(around, 1)


@kernel
def _flood(heights, level, inner, least, inside, banks, reach, water):
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
            height = heights[seed // cols, seed % cols]
            plain = height != 0.0 and height == np.round(height)
            if plain and _rises(heights, inner, stack[:size], reach) < RISING:
                continue
            for k in range(size):
                r, c = stack[k] // cols, stack[k] % cols
                for i in range(max(r - 1, 0), min(r + 2, rows)):  # out to the shore, whose samples are level too
                    for j in range(max(c - 1, 0), min(c + 2, cols)):
                        if heights[i, j] == heights[r, c]:
                            water[i, j] = True


def find_water(heights: NDArray[np.float32], spacing: float = 100.0) -> NDArray[np.bool_]:
    """Samples that are water.

    Args:
        heights: (rows, cols) float32 metres, NaN where missing. spacing: metres between samples.
    """
    level = _same(heights, np.isfinite(heights))
    water = np.zeros(heights.shape, bool)
    if level.any():
        reach = min(max(round(REACH / spacing) + 1, 4), 8)  # from the rim, one sample inside the shore
        inner = _same(heights, level)
        _flood(np.ascontiguousarray(heights), level, inner, LEAST_SAMPLES, LEAST_INSIDE, BANKS, reach, water)
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
