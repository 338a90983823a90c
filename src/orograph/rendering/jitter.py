"""The positions of samples in a pixel: the same pattern for every pixel, backend and picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def pattern(n: int) -> Array:
    """n positions in a pixel (n, 2), evenly spread around its centre: the R2 sequence (Roberts 2018), the same for all.

    Steps are counted from the middle of the sequence, so that positions are symmetric and edges stay where they are.
    """
    g = 1.32471795724474602596
    k = (np.arange(n) - (n - 1) / 2)[:, None]
    return np.asarray((0.5 + k * np.array([1 / g, 1 / g**2])) % 1.0)
