"""The synthetic terrain of the benches, in memory: what ``orograph synth --size SIZE --seed SEED`` writes."""

from __future__ import annotations

import numpy as np
from affine import Affine

from orograph.dem.synth import Synth
from orograph.geo.grid import Grid
from orograph.store.memory import MemoryTerrain


def synthetic(size: int, seed: int = 7, cell: float = 30.0) -> MemoryTerrain:
    """A square of so many samples a side, ``cell`` metres apart."""
    grid = Grid((size, size), Affine(cell, 0, 0, 0, -cell, 0), None)
    synth = Synth(grid.shape, seed)
    parts = [synth.read(row, min(row + 512, size), 0, size) for row in range(0, size, 512)]
    return MemoryTerrain(np.concatenate(parts), grid, "synthetic")
