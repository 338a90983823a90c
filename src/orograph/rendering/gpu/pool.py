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

from orograph.hierarchy.clip_stack import Rectangle
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
        node, top: the row of ``Table.nodes`` that its pyramid's level 0 has, and its coarsest level.
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
class Lying:
    """A window with its pyramid in a row of numbers, wherever that begins.

    Attributes:
        where: the samples. size: how many numbers. nodes: (levels, 4) as of ``Table``, from where it begins.
        low, high: metres between which its heights lie; NaN: there are none. whole: no sample is missing.
    """

    where: Rectangle
    size: int
    nodes: NDArray[np.int32]
    low: float
    high: float
    whole: bool


def size_of(heights: Values, mips: Mips, *, minima: bool) -> int:
    """How many numbers a window takes."""
    return heights.size + mips.maxima.size + (mips.minima.size if minima else 0)


def lay(window: HeightWindow, mips: Mips, out: Values, *, minima: bool = False) -> Lying:
    """Write a window and its pyramid to ``out`` (``size_of``,).

    Args:
        minima: write them, too.
    """
    heights, begin = window.heights, window.heights.size
    end = begin + mips.maxima.size
    np.fmax(heights.ravel(), MISSING, out=out[:begin])  # (NaN gives way)
    np.maximum(mips.maxima, MISSING, out=out[begin:end])
    nodes = np.zeros((mips.levels, 4), np.int32)
    nodes[1:, 0], nodes[:, 1], nodes[:, 2] = begin + mips.max_offset[1:], mips.cols, -1
    if minima:
        np.minimum(mips.minima, -MISSING, out=out[end:])
        nodes[2:, 2] = end + mips.min_offset[2:]
    low, high = mips.height_range if np.isfinite(mips.height_range).all() else (np.nan, np.nan)
    return Lying(window.where, len(out), nodes, low, high, not np.isnan(heights.min()))


@dataclass(frozen=True, slots=True)
class Table:
    """Where windows lie in a pool, outermost first.

    Attributes:
        windows: where they are. nodes: (levels of all windows, 4) int32: offset of the maxima, nodes per row, offset of
            the minima (−1: none), 0.
        low, high: metres between which all heights lie; 0 where there are none. whole: no sample is missing.
    """

    windows: tuple[Placed, ...]
    nodes: NDArray[np.int32]
    low: float
    high: float
    whole: bool

    @classmethod
    def of(cls, lying: Sequence[tuple[Lying, int]], shape: tuple[int, int]) -> Table:
        """Of windows, each with where in the pool it begins.

        Args:
            shape: (rows, cols) of the raster.
        """
        placed: list[Placed] = []
        nodes: list[NDArray[np.int32]] = []
        row = 0
        for one, at in lying:
            w, (rows, cols) = one.where, one.where.shape
            first = w.col0 << w.level, w.row0 << w.level
            last = (
                min(first[0] + ((cols - 1) << w.level), shape[1] - 1),
                min(first[1] + ((rows - 1) << w.level), shape[0] - 1),
            )
            top = len(one.nodes) - 1
            placed.append(Placed(w.level, first, last, (cols - 1, rows - 1), at, cols, row, top))
            here = one.nodes.copy()
            here[1:, 0] += at
            here[here[:, 2] >= 0, 2] += at
            nodes.append(here)
            row += top + 1
        known = [one for one, _ in lying if not np.isnan(one.low)]
        low, high = min((one.low for one in known), default=0.0), max((one.high for one in known), default=0.0)
        whole = all(one.whole for one, _ in lying)
        return cls(tuple(placed), np.concatenate(nodes or [np.zeros((0, 4), np.int32)]), low, high, whole)


@dataclass(frozen=True, slots=True)
class Pool:
    """Windows, outermost first, in one array.

    Attributes:
        values: (n,) float32, the heights and maxima. table: where they are.
    """

    values: Values
    table: Table

    @classmethod
    def of(cls, windows: Sequence[HeightWindow], pyramids: Sequence[Mips], shape: tuple[int, int]) -> Pool:
        """Of windows with their pyramids.

        Args:
            shape: (rows, cols) of the raster.

        Raises:
            ValueError: a window begins at an odd row or column.
        """
        check_diagonals(windows)
        both = list(zip(windows, pyramids, strict=True))
        sizes = [size_of(w.heights, mips, minima=False) for w, mips in both]
        ends = np.cumsum(sizes).tolist()
        values = np.empty(ends[-1], np.float32)
        lying = [
            (lay(w, mips, values[end - size : end]), end - size)
            for (w, mips), size, end in zip(both, sizes, ends, strict=True)
        ]
        return cls(values, Table.of(lying, shape))


def samples_in(most: int) -> int:
    """The number of samples that fit into ``most`` bytes: heights, and a third of that for maxima, 4 bytes each."""
    return most // 16 * 3
