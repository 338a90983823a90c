"""The nested windows that a caster runs over, flattened into the few arrays its kernels take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import read_only
from orograph.hierarchy.clip_stack import Rectangle
from orograph.raycast.mips import Mips, build_mips
from orograph.raycast.tables import Scene

MARGIN = 1e-3
"""Metres by which the slab of heights is opened, so that a level plain is not a slab of no thickness."""


@dataclass(frozen=True, slots=True)
class HeightWindow:
    """A rectangle of samples of one level, with their heights.

    Attributes:
        level: sample (x, y) of the window is sample ``(col0 + x) · 2^level, (row0 + y) · 2^level`` of the terrain, or
            the mean of the block of 2^level × 2^level samples that begins there.
        heights: (rows, cols) float32 metres, NaN where missing.
    """

    level: int
    col0: int
    row0: int
    heights: NDArray[np.float32]

    @property
    def where(self) -> Rectangle:
        """The samples."""
        rows, cols = self.heights.shape
        return Rectangle(self.level, self.row0, self.row0 + rows, self.col0, self.col0 + cols)


def check_diagonals(windows: Sequence[HeightWindow]) -> None:
    """Refuse windows whose cells are not cut along the terrain's diagonals.

    Raises:
        ValueError: one begins at an odd row or column.
    """
    if any(w.col0 % 2 or w.row0 % 2 for w in windows):
        raise ValueError("a window begins at an even column and row")


@dataclass(frozen=True, slots=True)
class Stack:
    """Windows, outermost (coarsest) first, each inside the one before.

    Attributes:
        scene: it as the kernels take it; its pool is no copy if there is one window.
    """

    windows: tuple[HeightWindow, ...]
    scene: Scene

    @classmethod
    def build(cls, windows: list[HeightWindow], shape: tuple[int, int], jobs: int | None = None) -> Stack:
        """Flatten ``windows``; ``shape`` is the terrain's (rows, cols) at full resolution: nothing is hit beyond it."""
        check_diagonals(windows)
        pyramids: list[Mips] = [build_mips(w.heights, jobs) for w in windows]
        ints = np.zeros((len(windows), 6), np.int64)
        floats = np.zeros((len(windows), 8), np.float64)
        base = mip = max_base = min_base = 0
        tables = []
        for k, (w, m) in enumerate(zip(windows, pyramids)):
            rows, cols = w.heights.shape
            scale = 2.0**w.level
            ints[k] = base, cols, cols - 1, rows - 1, mip, m.levels
            west, north = w.col0 * scale, w.row0 * scale
            east, south = west + (cols - 1) * scale, north + (rows - 1) * scale
            east, south = min(east, shape[1] - 1.0), min(south, shape[0] - 1.0)
            floats[k] = west, north, scale, west, north, east, south, 1.0 / scale
            tables.append(np.stack([m.max_offset + max_base, m.min_offset + min_base, m.cols]))
            base += w.heights.size
            mip += m.levels
            max_base += m.maxima.size
            min_base += m.minima.size
        ranges = [m.height_range for m in pyramids]
        pool = read_only(_joined([w.heights for w in windows]))
        # The windows become views of the pool, so that heights are held once.
        views = [
            HeightWindow(w.level, w.col0, w.row0, pool[n[0] : n[0] + w.heights.size].reshape(w.heights.shape))
            for w, n in zip(windows, ints)
        ]
        scene = Scene(
            pool,
            _joined([m.maxima for m in pyramids]),
            _joined([m.minima for m in pyramids]),
            np.ascontiguousarray(np.concatenate(tables, axis=1)),
            ints,
            floats,
            float(min(r[0] for r in ranges) - MARGIN),
            float(max(r[1] for r in ranges) + MARGIN),
        )
        return cls(tuple(views), scene)


def _joined(arrays: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """The arrays flat, one after the other; a single one is not copied."""
    if len(arrays) == 1:
        return np.ascontiguousarray(arrays[0]).ravel()
    return np.concatenate([a.ravel() for a in arrays])
