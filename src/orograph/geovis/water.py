"""Water, found by what only water is: exactly level over a large connected area.

Elevation models are given lakes and seas of one value. Plains of integer heights have level patches too, but small and
ragged ones: a level area is water if it is large, and more so if it is compact. Resampling keeps constant areas exactly
constant, so equality is the test; heights in metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEAST_SAMPLES = 100
"""Samples an area must have left, once its two outer rings are taken off, to be water: that leaves little of ragged
patches."""


def find_water(heights: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Samples (rows, cols) of heights (float32 metres, NaN where missing) that are water."""
    inner = _level(heights)
    if not inner.any():
        return inner
    from rasterio.features import sieve

    kept = sieve(inner.astype(np.uint8), LEAST_SAMPLES, connectivity=8).astype(bool) & inner
    # Back out to the shore: two rings of samples of the same height.
    grown = np.where(kept, heights, -np.inf)
    for axis in (0, 1):
        wide = grown.copy()
        for shift in (1, 2):
            a, b = [slice(None)] * 2, [slice(None)] * 2
            a[axis], b[axis] = slice(shift, None), slice(None, -shift)
            np.maximum(wide[tuple(a)], grown[tuple(b)], out=wide[tuple(a)])
            np.maximum(wide[tuple(b)], grown[tuple(a)], out=wide[tuple(b)])
        grown = wide
    return np.asarray(grown == heights)


def _level(heights: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Samples whose 5 × 5 surroundings have exactly their height (inside the raster's border or cut by it)."""
    level = np.isfinite(heights)
    for axis in (0, 1):
        same = level.copy()
        a, b = [slice(None)] * 2, [slice(None)] * 2
        for shift in (1, 2):
            a[axis], b[axis] = slice(shift, None), slice(None, -shift)
            equal = (heights[tuple(a)] == heights[tuple(b)]) & level[tuple(a)] & level[tuple(b)]
            same[tuple(a)] &= equal
            same[tuple(b)] &= equal
        level = same
    return level
