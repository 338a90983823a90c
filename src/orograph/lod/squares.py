"""Squares of a quadtree over a raster, many at a time, and the ground's heights in them.

The squares of exponent p have sides of 2^p samples; the root, of exponent n, is the square that the raster is thought
of in. Samples, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.raycast.select import Boxes
from orograph.store.terrain import TILE, Terrain

Index = NDArray[np.int64]

BESIDE = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""Rows and columns from a square to its neighbours on those sides."""


@dataclass(frozen=True, slots=True)
class Squares:
    """Squares (m,) of one size.

    Attributes:
        p: the exponent of their sides. row, col: of their upper left corners, in sides.
    """

    p: int
    row: Index
    col: Index

    def __len__(self) -> int:
        return len(self.row)

    def where(self, chosen: NDArray[np.bool_]) -> Squares:
        """Some of them."""
        return Squares(self.p, self.row[chosen], self.col[chosen])

    def children(self) -> Squares:
        """Their quarters."""
        row, col = (np.concatenate([2 * v + d for d in steps]) for v, steps in
                    ((self.row, (0, 0, 1, 1)), (self.col, (0, 1, 0, 1))))  # fmt: skip
        return Squares(self.p - 1, row, col)

    def beside(self, side: int) -> Squares:
        """Their neighbours."""
        return Squares(self.p, self.row + BESIDE[side][0], self.col + BESIDE[side][1])

    def parents(self) -> Squares:
        """Their parent squares, each once."""
        return Squares(self.p + 1, self.row >> 1, self.col >> 1)

    @property
    def codes(self) -> Index:
        """Their numbers."""
        return np.asarray(self.row << 32 | self.col)


class BlockHeights:
    """The lowest and highest samples of blocks of a terrain."""

    def __init__(self, terrain: Terrain) -> None:
        self.shape = terrain.grid.shape
        table = terrain.tiles(0)
        self._low, self._high = [table.minimum], [table.maximum]
        while max(self._low[-1].shape) > 1:
            self._low.append(pooled(self._low[-1], np.fmin))
            self._high.append(pooled(self._high[-1], np.fmax))

    def on_ground(self, squares: Squares) -> Squares:
        """Those that have a cell of the raster."""
        (rows, cols), row, col, p = self.shape, squares.row, squares.col, squares.p
        return squares.where((row >= 0) & (col >= 0) & (row << p < rows - 1) & (col << p < cols - 1))

    def of(self, squares: Squares) -> Boxes:
        """The boxes of squares."""
        p, row, col = squares.p, squares.row, squares.col
        return self.around(col << p, row << p, (col + 1) << p, (row + 1) << p, p)

    def around(self, west: Index, north: Index, east: Index, south: Index, side: int) -> Boxes:
        """Boxes (m,) of extents in samples, of two blocks by two of sides 2^side at most, cut to the raster."""
        last_row, last_col = self.shape[0] - 1, self.shape[1] - 1
        w, e = (np.clip(v, 0, last_col).astype(np.float64) for v in (west, east))
        n, s = (np.clip(v, 0, last_row).astype(np.float64) for v in (north, south))
        at = min(max(side - (TILE.bit_length() - 1), 0), len(self._low) - 1)
        i, j = touched(Boxes(w, e, n, s, w, w), at + TILE.bit_length() - 1, self._low[at].shape)
        low, high = np.fmin.reduce(self._low[at][i, j]), np.fmax.reduce(self._high[at][i, j])
        return Boxes(w, e, n, s, low.astype(np.float64), high.astype(np.float64))


def touched(boxes: Boxes, side: int, shape: tuple[int, ...]) -> tuple[Index, Index]:
    """Rows and columns (4, m) of the blocks that boxes touch."""
    ends = []
    for least, most, count in ((boxes.north, boxes.south, shape[0]), (boxes.west, boxes.east, shape[1])):
        first = least.astype(np.int64) >> side
        last = np.maximum(np.ceil(most).astype(np.int64) - 1, least.astype(np.int64)) >> side
        ends.append((np.minimum(first, count - 1), np.minimum(last, count - 1)))
    (top, bottom), (left, right) = ends
    return np.stack([top, top, bottom, bottom]), np.stack([left, right, left, right])


def pooled(blocks: Any, pool: np.ufunc) -> Any:
    """Two by two; those beyond the last ones do not count."""
    rows, cols = blocks.shape
    high = pool.reduceat(blocks, np.arange(0, rows, 2), axis=0)
    return pool.reduceat(high, np.arange(0, cols, 2), axis=1)
