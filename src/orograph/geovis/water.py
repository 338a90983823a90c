"""Water, found by what only water is: exactly level over a large connected area.

Elevation models are given lakes and seas of one value. Plains of integer heights have level patches too, but small and
ragged ones: a level area is water if it is large, and more so if it is compact. Resampling keeps constant areas exactly
constant, so equality is the test; heights in metres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

LEAST_SAMPLES = 150
"""Level samples (whose eight neighbours have the same height) from which an area can be a lake."""

COMPACT = 0.35
"""Least part of an area's samples that lies inside it, neighbours and all: ragged patches of plains have little inside."""


def find_water(heights: NDArray[np.float32], cell_area: float) -> NDArray[np.bool_]:
    """Samples (rows, cols) that are water.

    Args:
        heights: (rows, cols) float32 metres, NaN where missing.
        cell_area: square metres of a sample.
    """
    del cell_area
    level = np.zeros(heights.shape, bool)
    core = heights[1:-1, 1:-1]
    same = np.isfinite(core)
    for dr in (0, 1, 2):
        for dc in (0, 1, 2):
            if (dr, dc) != (1, 1):
                same &= heights[dr : heights.shape[0] - 2 + dr, dc : heights.shape[1] - 2 + dc] == core
    level[1:-1, 1:-1] = same
    if not level.any():
        return level
    from scipy import ndimage

    square = np.ones((3, 3), bool)
    labels, count = ndimage.label(level, square)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    inner = ndimage.binary_erosion(level, square)
    inside = np.bincount(labels[inner], minlength=count + 1)
    water = (sizes >= LEAST_SAMPLES) & (inside >= COMPACT * sizes - 2 * math.sqrt(LEAST_SAMPLES))
    water[0] = False
    found = water[labels]
    # The shore: level samples found by their neighbours are one short of it, if of the same height.
    grown = ndimage.grey_dilation(np.where(found, heights, -np.inf), footprint=square)
    return np.asarray(found | (grown == heights))
