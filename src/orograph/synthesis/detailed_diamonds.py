"""Diamonds of a terrain with detail: those of its data. Levels below have no error, so no triangle is split there.

Methods that refine by errors therefore draw the data without detail, because no bound of the detail is known; the GPU's
renderer, which draws detail by rays, uses them to find what is in view. An entry of a level lies at the same place of
the ground as one of the data's, ``doublings`` levels lower; the top level of small data, a square of several octaves,
is coarser there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from orograph.store.diamond_table import DiamondTable
from orograph.store.terrain import Heights, Terrain

Table = Callable[[int, int, int, int, int], Heights]


class Shifted:
    """A table of the data's diamonds, read as one of the terrain with detail.

    Args:
        read: reads a level's window of the data. first: the coarsest level of the data that has none.
        nothing: the value where there is none.
    """

    def __init__(self, terrain: Terrain, data: Terrain, doublings: int, read: Table, first: int, nothing: float):
        self.terrain, self.data, self.doublings = terrain, data, doublings
        self._read, self._first, self._nothing = read, first, nothing

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """The entries ``[row0, row1) × [col0, col1)`` of a level."""
        self.terrain.check_window(self.terrain.diamond_shape(level), row0, row1, col0, col1)
        own = level - self.doublings
        if own >= 0 and own <= self.data.levels - 1:
            if own < self._first:
                return np.full((row1 - row0, col1 - col0), self._nothing, np.float32)
            return self._read(own, row0, row1, col0, col1)
        out = np.full((row1 - row0, col1 - col0), self._nothing, np.float32)
        if level == self.terrain.levels - 1 and self._first <= 0:
            step = 1 << -own
            side, _ = self.data.diamond_shape(0)
            r0, r1, c0, c1 = -(-row0 // step), -(-row1 // step), -(-col0 // step), -(-col1 // step)
            r1, c1 = min(r1, side), min(c1, side)
            if r0 < r1 and c0 < c1:
                out[r0 * step - row0 :: step, c0 * step - col0 :: step] = self._read(0, r0, r1, c0, c1)
        return out


class DiamondsOfData:
    """Errors and radii: a ``DiamondTable``."""

    def __init__(self, terrain: Terrain, data: Terrain, doublings: int, **options: Any) -> None:
        table: DiamondTable = data.derived("diamonds", **options)
        reads = table.values, lambda *window: table.read(*window)[1]
        self._errors, self._radii = (Shifted(terrain, data, doublings, read, 0, 0.0) for read in reads)

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        """See ``DiamondTable.read``."""
        window = level, row0, row1, col0, col1
        return self._errors.read(*window), self._radii.read(*window)

    def values(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """See ``DiamondTable.values``."""
        return self._errors.read(level, row0, row1, col0, col1)
