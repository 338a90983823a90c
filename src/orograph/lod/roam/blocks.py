"""Blocks of cells and the pyramid above them: boxes of gradients, and lowest heights.

A block is 2^shift cells a side, ground on its border included; a block of the next level four of those below. The
blocks are as small as the memory they may take allows. Heights in metres, gradients in metres a cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.store.terrain import Terrain

BYTES = 20
BAND = 512
"""About how many rows of samples are read at a time."""


class Blocks(NamedTuple):
    """The blocks of all levels, the finest first, each level row by row.

    Attributes:
        values: float32 (m, 5): least and most h_c, least and most h_r, least height. Gradients are those of the unit
            triangles that exist, and 0 where ground is missing; the least height is −inf there, for it hides nothing.
        base, width, height: int64 (levels,): where a level begins, how many blocks it has in a row, and how many rows.
        shift: the cells of a finest block are 2^shift a side.
    """

    values: NDArray[np.float32]
    base: NDArray[np.int64]
    width: NDArray[np.int64]
    height: NDArray[np.int64]
    shift: int


NO_BLOCKS = Blocks(
    np.zeros((1, 5), np.float32), np.zeros(1, np.int64), np.ones(1, np.int64), np.ones(1, np.int64), 0
)  # fmt: skip


def blocks_of(terrain: Terrain, max_memory: int) -> Blocks:
    """The blocks of a terrain, in at most ``max_memory`` bytes, or those of the largest side that makes sense."""
    rows, cols = (side - 1 for side in terrain.grid.shape)
    shift = 0
    while (rows >> shift) * (cols >> shift) * BYTES * 4 > max_memory * 3:
        shift += 1
    size = 1 << shift
    table = np.empty((-(-rows // size), -(-cols // size), 5), np.float32)
    step = max(BAND >> shift, 1)
    for i in range(0, len(table), step):
        part = table[i : i + step]
        z = terrain.read(0, i * size, min((i + step) * size, rows) + 1, 0, cols + 1)
        across, down = np.diff(z, axis=1), np.diff(z, axis=0)
        across[np.isnan(across)] = 0.0
        down[np.isnan(down)] = 0.0
        for at, extreme in ((0, np.minimum), (1, np.maximum)):
            part[..., at] = _over(extreme, across, size, (True, False))
            part[..., 2 + at] = _over(extreme, down, size, (False, True))
        part[..., 4] = _over(np.minimum, np.where(np.isnan(z), -np.inf, z), size, (True, True))
    levels = [table]
    while max(table.shape[:2]) > 1:
        even = np.pad(table, [(0, table.shape[0] % 2), (0, table.shape[1] % 2), (0, 0)], mode="edge")
        four = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2, 5)
        table = np.where(np.arange(5) % 2 == 0, four.min((1, 3)), four.max((1, 3)))
        levels.append(table)
    height, width = np.array([one.shape[:2] for one in levels], np.int64).T.copy()
    base = np.cumsum(np.concatenate([[0], height * width]))[:-1]
    return Blocks(np.concatenate([one.reshape(-1, 5) for one in levels]), base, width, height, shift)


def _over(extreme: np.ufunc, values: NDArray[np.float32], size: int, shared: tuple[bool, bool]) -> NDArray[np.float32]:
    """The extremes of values over blocks of ``size``, and along ``shared`` axes of the first ones of the next block."""
    for axis in range(2):
        if shared[axis]:
            first, second = np.split(values, [-1], axis)[0], np.split(values, [1], axis)[1]
            values = extreme(first, second)
        values = extreme.reduceat(values, np.arange(0, values.shape[axis], size), axis)
    return values
