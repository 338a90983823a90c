"""A terrain with a picture's exaggeration, for judging its appearance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orograph.errors import UsageError
from orograph.store.terrain import Heights, Terrain, TileTable
from orograph.viewpoint import View


class Stretched(Terrain):
    """A terrain with exaggerated heights; its errors and layers are not available."""

    def __init__(self, terrain: Terrain, times: float) -> None:
        self.grid, self.name, self.vertical = terrain.grid, terrain.name, terrain.vertical
        self._terrain, self.times = terrain, times

    @property
    def height_range(self) -> tuple[float, float]:
        low, high = self._terrain.height_range
        return low * self.times, high * self.times

    @property
    def valid_fraction(self) -> float:
        return self._terrain.valid_fraction

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        return np.asarray(self._terrain.read(level, row0, row1, col0, col1) * np.float32(self.times), np.float32)

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        return np.asarray(self._terrain.read_mean(level, row0, row1, col0, col1) * np.float32(self.times), np.float32)

    def tiles(self, level: int) -> TileTable:
        raise UsageError("A stretched terrain has no table of tiles.")

    def back(self, view: View) -> View:
        """A view of it as a view of the original terrain, to be stretched by the same factor."""
        (x, y, z), (u, v, w) = view.eye, view.target
        return replace(view, eye=(x, y, z / self.times), target=(u, v, w / self.times))
