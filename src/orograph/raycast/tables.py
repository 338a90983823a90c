"""What the caster's kernels take: a stack of windows, whose tables have a row for each; a camera; a picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BASE, STRIDE, CELLS_X, CELLS_Y, MIP_FIRST, MIP_COUNT = range(6)
"""Integers: offset of its heights in the pool, samples per row, cells each way, its first mip level, their number."""

ORIGIN_X, ORIGIN_Y, SCALE, WEST, NORTH, EAST, SOUTH, INVERSE = range(8)
"""Floats, in sample coordinates: its first sample, 2^level, the limits of its ground, 2^−level."""


class Scene(NamedTuple):
    """A stack of nested windows, outermost first.

    Attributes:
        pool: all heights, float32, flat. maxima, minima: all their pyramids, flat.
        mips: (3, levels of all windows) int64: offset of the maxima, of the minima, nodes per row.
        ints (W, 6), floats (W, 8): columns ``BASE`` and following, ``ORIGIN_X`` and following.
        low, high: the slab that holds every height, metres.
    """

    pool: NDArray[np.float32]
    maxima: NDArray[np.float32]
    minima: NDArray[np.float32]
    mips: NDArray[np.int64]
    ints: NDArray[np.int64]
    floats: NDArray[np.float64]
    low: float
    high: float


class Pinhole(NamedTuple):
    """A camera at ``eye``, sample coordinates, whose ray through pixel (px, py) has direction d0 + px·du + py·dv.

    ``near``, ``far``: the range of t that counts, in lengths of a direction.
    """

    eye: NDArray[np.float64]
    d0: NDArray[np.float64]
    du: NDArray[np.float64]
    dv: NDArray[np.float64]
    near: float
    far: float


class Picture(NamedTuple):
    """What rays through pixels find: t (NaN: nothing), the window hit; ``corner``: (row, col) of the first pixel."""

    corner: tuple[int, int]
    t: NDArray[np.float64]
    window: NDArray[np.int8]
