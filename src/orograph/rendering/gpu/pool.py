"""Nested windows of heights with their pyramids in one array, as shaders look them up.

For each window the pool holds its heights, row by row, its maxima from level 1 up, and, if requested, its minima
from level 2 up (``raycast.mips``). Heights are metres, float32; a missing one lies far below any other (``MISSING``),
as does the maximum of a node without any, whose minimum lies far above. Places are samples of the raster.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.raycast.mips import Mips
from orograph.raycast.stack import HeightWindow, check_diagonals

Values = NDArray[np.float32]

WINDOWS, NODES = 16, 256
"""Maximum windows, and levels of all their pyramids, in the shaders' tables."""

MISSING = np.float32(-1e30)


@dataclass(frozen=True, slots=True)
class Placed:
    """A window in a pool.

    Attributes:
        level: its samples lie 2^level samples of the raster apart.
        first, last: column and row of its first sample, and where it ends: not beyond the raster.
        cells: across and down. offset, stride: of its heights in the pool, and samples per row.
        node, top: the row of ``Pool.nodes`` for level 0 of its pyramid, and its coarsest level.
    """

    level: int
    first: tuple[int, int]
    last: tuple[int, int]
    cells: tuple[int, int]
    offset: int
    stride: int
    node: int
    top: int


@dataclass(frozen=True, slots=True)
class Pool:
    """Windows, outermost first.

    Attributes:
        values: (n,) float32, the heights and the pyramids. windows: their places.
        nodes: (levels of all windows, 4) int32: offset of the maxima, nodes per row, offset of the minima (−1: none),
            0.
        low, high: metres between which all heights lie; 0 if there are none.
    """

    values: Values
    windows: tuple[Placed, ...]
    nodes: NDArray[np.int32]
    low: float
    high: float

    @classmethod
    def of(
        cls, windows: Sequence[HeightWindow], pyramids: Sequence[Mips], shape: tuple[int, int], *, minima: bool = False
    ) -> Pool:
        """Create the pool of windows with their pyramids.

        Args:
            shape: (rows, cols) of the raster. minima: whether to hold them, too.

        Raises:
            ValueError: a window begins at an odd row or column.
        """
        check_diagonals(windows)
        parts: list[Values] = []
        placed: list[Placed] = []
        nodes = np.zeros((sum(m.levels for m in pyramids), 4), np.int32)
        nodes[:, 2] = -1
        at = row = 0
        for w, mips in zip(windows, pyramids, strict=True):
            rows, cols = w.heights.shape
            first = w.col0 << w.level, w.row0 << w.level
            last = (
                min(first[0] + ((cols - 1) << w.level), shape[1] - 1),
                min(first[1] + ((rows - 1) << w.level), shape[0] - 1),
            )
            placed.append(Placed(w.level, first, last, (cols - 1, rows - 1), at, cols, row, mips.levels - 1))
            parts += [np.where(np.isnan(w.heights), MISSING, w.heights).ravel(), np.maximum(mips.maxima, MISSING)]
            at += w.heights.size
            there = nodes[row : row + mips.levels]
            there[1:, 0], there[:, 1] = at + mips.max_offset[1:], mips.cols
            at += mips.maxima.size
            if minima:
                parts.append(np.minimum(mips.minima, -MISSING))
                there[2:, 2] = at + mips.min_offset[2:]
                at += mips.minima.size
            row += mips.levels
        ranges = np.array([m.height_range for m in pyramids], np.float64).reshape(-1, 2)
        known = ranges[np.isfinite(ranges).all(1)]
        low, high = (float(known[:, 0].min()), float(known[:, 1].max())) if len(known) else (0.0, 0.0)
        return cls(np.concatenate(parts), tuple(placed), nodes, low, high)


def samples_in(most: int) -> int:
    """The number of samples that fit into ``most`` bytes: heights, and a third of that for maxima, 4 bytes each."""
    return most // 16 * 3
