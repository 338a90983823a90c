"""Heights at single places from a raster's own samples: bilinear between the four around, read block by block.

Missing samples are treated as in ``resample``: a place has a height exactly if its nearest sample has one. Units:
samples; metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.dem.layers import LatticeMap
from orograph.dem.resample import sample
from orograph.geo.grid import Grid

BLOCK = 256
"""Side in samples of the blocks by which places are processed."""

Array = NDArray[np.float64]
Read = Callable[[int, int, int, int], NDArray[np.float32]]


def heights_between(read: Read, shape: tuple[int, int], col: Array, row: Array, *, beyond: bool = False) -> Array:
    """Heights (n,) at sample positions (n,), NaN where there is none.

    Args:
        read: a window [row0, row1) × [col0, col1) of the raster, float32, NaN where missing.
        shape: (rows, cols) of the raster; places more than half a sample beyond it have no height.
        beyond: ``read`` takes windows that reach beyond the raster: around a globe the first column follows the last.
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
        c0, c1 = int(np.floor(u.min())), int(np.floor(u.max())) + 2
        if not beyond:
            c0, c1 = max(c0, 0), min(c1, shape[1])
        found = np.full(u.shape, np.nan, np.float32)
        sample("bilinear", np.ascontiguousarray(read(r0, r1, c0, c1)), r0, c0, u, v, found)
        out[part] = found[0]
    return out


def heights_at(grid: Grid, layers: Sequence[LatticeMap], x: ArrayLike, y: ArrayLike) -> Array:
    """Heights (n,) at places (n,) in a terrain's CRS from its original samples; NaN where there are none.

    Args:
        grid: of the terrain.
        layers: its lattices; the first with a height counts.
    """
    col, row = grid.index(np.atleast_1d(x), np.atleast_1d(y))
    out = np.full(col.shape, np.nan)
    for layer in layers:
        lost = np.flatnonzero(np.isnan(out))
        if len(lost):
            out[lost] = heights_between(
                layer.lattice.read, layer.lattice.grid.shape, *layer.positions(col[lost], row[lost]), beyond=True
            )
    return out
