"""How maps are looked up by pixels: between samples, across shores, and how finely."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._numba import inlined, kernel

SHORE = 0.04
"""The field of water goes from dry to wet within 0.5 ± this: a crisp shore, however large its samples are."""

LEAST = 0.7
"""The minor axis of a footprint, at least, in pixels on ground that faces the eye at the same distance."""

BESIDE = 0.06, 0.2
"""The field of water from where on the contour of height 0 fades, and where it is gone: beside the sea, which its own
edge ends, there would be only bits of it, where the shore is smoother than the samples."""


class MapPlace(NamedTuple):
    """Where a map lies: its samples are 2^level = ``scale`` apart, the first is (row0, col0) of that level."""

    scale: float
    row0: int
    col0: int


@inlined
def within_map(place, x, y):
    """(column, row) of a map at the sample coordinates (x, y)."""
    return (x + 0.5) / place.scale - 0.5 - place.col0, (y + 0.5) / place.scale - 0.5 - place.row0


@kernel
def bilinear(field, u, v):
    """``field`` (rows, cols) between its samples at column ``u`` and row ``v``, held at its borders."""
    rows, cols = field.shape
    j = min(max(np.int64(np.floor(u)), 0), max(cols - 2, 0))
    i = min(max(np.int64(np.floor(v)), 0), max(rows - 2, 0))
    fu, fv = min(max(u - j, 0.0), 1.0), min(max(v - i, 0.0), 1.0)
    j1, i1 = min(j + 1, cols - 1), min(i + 1, rows - 1)
    top = field[i, j] * (1.0 - fu) + field[i, j1] * fu
    low = field[i1, j] * (1.0 - fu) + field[i1, j1] * fu
    return top * (1.0 - fv) + low * fv
