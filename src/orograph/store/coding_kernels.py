"""The kernels that turn heights into numbers of steps and back (``coding``), flat, whole blocks at a time."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel
from orograph.store.codec_head import MISSING


@kernel
def number(heights, step, out):
    """The numbers of heights: (n,) float32, metres; int32."""
    for k in range(out.size):
        here = np.rint(np.float64(heights[k]) / step)
        out[k] = np.int32(here) if here == here else np.int32(MISSING)


@kernel
def place(numbers, step, out):
    """The heights of numbers: (n,) int32; float32, metres, NaN where missing."""
    for k in range(out.size):
        here = np.float32(numbers[k] * step)
        out[k] = here if numbers[k] != MISSING else np.float32(np.nan)


@kernel
def quantise(heights, step, kept, own, out):
    """Heights as stored, and their losses.

    Args:
        heights: (rows, cols) float32, metres, NaN where missing.
        kept: the numbers that they become; without rows: the nearest.
        out: (rows, cols) float32, becomes the heights.
    """
    rows, cols = heights.shape
    highest, worst, largest, squares = np.float32(0), 0.0, 0.0, 0.0
    for row in range(rows):
        read, made, summed = heights[row], out[row], 0.0
        if kept.shape[0]:
            numbers = kept[row]
            for k in range(cols):
                made[k] = np.float32(numbers[k] * step) if read[k] == read[k] else read[k]
        else:
            for k in range(cols):
                made[k] = np.float32(np.rint(np.float64(read[k]) / step) * step)
        inside = own if row < own else 0
        for k in range(cols):
            off, size = abs(np.float64(made[k]) - np.float64(read[k])), abs(read[k])
            worst, highest = off if off > worst else worst, size if size > highest else highest
            if k < inside and off == off:
                largest, summed = max(off, largest), summed + off * off
        squares += summed
    return np.float64(highest), worst, largest, squares
