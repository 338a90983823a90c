"""Heights at single places out of a raster's own samples: bilinear between the four around, read block by block.

What is missing is treated as ``resample`` does: a place has a height exactly if its nearest sample has one. Units:
samples; metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orograph.dem.resample import sample

BLOCK = 256
"""Samples along the side of the blocks by which places are taken."""

Array = NDArray[np.float64]
Read = Callable[[int, int, int, int], NDArray[np.float32]]


def heights_between(read: Read, shape: tuple[int, int], col: Array, row: Array) -> Array:
    """Heights (n,) at sample positions (n,), NaN where there is none.

    Args:
        read: a window [row0, row1) × [col0, col1) of the raster, float32, NaN where missing.
        shape: (rows, cols) of the raster; places more than half a sample beyond it have no height.
    """
    out = np.full(col.shape, np.nan)
    inside = np.isfinite(col) & np.isfinite(row)
    with np.errstate(invalid="ignore"):
        inside &= (col >= -0.5) & (col < shape[1] - 0.5) & (row >= -0.5) & (row < shape[0] - 0.5)
    which = np.flatnonzero(inside)
    key = (np.floor(row[which]).astype(np.int64) // BLOCK << 32) + np.floor(col[which]).astype(np.int64) // BLOCK
    order = np.argsort(key, kind="stable")
    for part in np.split(which[order], np.flatnonzero(np.diff(key[order])) + 1):
        if not len(part):
            continue
        u, v = col[None, part], row[None, part]
        r0, r1 = max(int(np.floor(v.min())), 0), min(int(np.floor(v.max())) + 2, shape[0])
        c0, c1 = max(int(np.floor(u.min())), 0), min(int(np.floor(u.max())) + 2, shape[1])
        found = np.full(u.shape, np.nan, np.float32)
        sample("bilinear", np.ascontiguousarray(read(r0, r1, c0, c1)), r0, c0, u, v, found)
        out[part] = found[0]
    return out
