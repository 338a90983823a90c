"""The ground around a tile of samples: at full resolution nearby, coarser with distance.

Ring k holds every 2^k-th sample (the terrain's nested level k) up to ``REACH`` of its own samples beyond the tile, or
up to R, if there is one; the part that finer rings hold is its hole. So each ring takes a few MB whatever the raster,
and their number is the logarithm of the number of samples within R. Ground at distance d consists of samples at most 2
d / ``REACH`` apart; if such a level has an error of e metres, the tangent of an elevation seen from the tile has an
error of at most e / d: ``bound`` is the largest of these over a terrain. Within ``REACH`` samples everything is exact.

Rings depend only on their tile, neither on memory nor on the device. Units: samples, metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.hierarchy.clip_stack import ClipStack, Rectangle, Ring
from orograph.store.terrain import Terrain

REACH = 512
"""How far a ring reaches beyond its tile, in its own samples."""
MISSING = np.float32(-1e30)
BLOCK = 16
"""Cells along the side of a block, the unit of extremes."""
_SNAP = 64  # all rings except the finest begin and end at multiples of this, so that neighbouring tiles share them


def rings(
    terrain: Terrain, tile: tuple[int, int, int, int], linear: NDArray[np.float64], radius: float, reach: int
) -> tuple[Ring, ...]:
    """The rings around a tile (first row, end, first column, end), the finest first.

    Args:
        linear: (2, 2) metres east and north per column and per row. radius: R, metres; inf: the whole terrain.
        reach: how far a ring reaches beyond the tile, in its own samples.
    """
    rows, cols = terrain.grid.shape
    over, down = cols, rows
    if math.isfinite(radius):
        over, down = (min(math.ceil(radius * float(np.linalg.norm(v))) + 2, n)
                      for v, n in zip(np.linalg.inv(linear), (cols, rows)))  # fmt: skip
    row0, row1, col0, col1 = tile
    need = max(row0 - down, 0), min(row1 + down, rows) - 1, max(col0 - over, 0), min(col1 + over, cols) - 1
    out: list[Rectangle] = []
    for level in range(terrain.levels):
        last = level == terrain.levels - 1
        shape, far, snap = terrain.shape(level), reach << level, _SNAP if level else 2
        sides: list[int] = []
        for axis, (first, end, most) in enumerate(((row0, row1, shape[0]), (col0, col1, shape[1]))):
            low, high = need[2 * axis], need[2 * axis + 1]
            if not last:
                low, high = max(low, first - far), min(high, end - 1 + far)
            a, b = low >> level, -(-high >> level)
            if out:
                inner = out[-1].around(level)[1 + 2 * axis : 3 + 2 * axis]
                a, b = min(a, inner[0]), max(b, inner[1] - 1)
            # Cells are cut along the terrain's diagonals, and the next ring's samples are on the border.
            a, b = a // snap * snap, min(-(-b // snap) * snap, most - 1)
            sides += [min(a, max(most - 2, 0) & ~1), b]
        out.append(Rectangle(level, sides[0], sides[1] + 1, sides[2], sides[3] + 1))
        low_enough = all(sides[k] << level <= need[k] for k in (0, 2))
        if low_enough and all(sides[k] << level >= need[k] for k in (1, 3)):
            break
    return ClipStack(reversed(out)).rings()[::-1]


def bound(terrain: Terrain, radius: float = math.inf, reach: int = REACH) -> float:
    """The largest error of the tangent of an elevation that results from coarser ground far away.

    Args:
        radius: R, metres.
    """
    worst, spacing = 0.0, min(terrain.grid.spacing)
    for level in range(1, terrain.levels):
        nearest = (reach << (level - 1)) * spacing
        if nearest >= min(radius, max(terrain.grid.shape) * max(terrain.grid.spacing)):
            break
        error = terrain.tiles(level).error
        known = error[np.isfinite(error)]
        worst = max(worst, float(known.max()) / nearest if known.size else 0.0)
    return worst


@dataclass(frozen=True, slots=True)
class Held:
    """Heights in GPU memory.

    Attributes:
        buffer: (rows, cols) float32, ``MISSING`` where there is none. low, high: of valid heights, metres; inf and
            −inf if there are none. blocks: for each block of ``BLOCK``² cells, its lowest and highest sample, and
            whether any is missing (0 or 1), (3, block rows, block cols).
    """

    buffer: Any
    low: float
    high: float
    blocks: NDArray[np.float32]


class Store:
    """Rings' heights on a device; those of the last tile are kept for the next.

    Args:
        terrain: to read.
    """

    def __init__(self, device: Device, terrain: Terrain) -> None:
        self.device, self.terrain = device, terrain
        self._held: dict[Rectangle, Held] = {}

    def load(self, wanted: tuple[Rectangle, ...]) -> list[Held]:
        """The heights of rectangles.

        Raises:
            DeviceLimitError: the device's memory does not hold them.
        """
        for r in [r for r in self._held if r not in wanted]:
            self._held.pop(r).buffer.destroy()
        for r in wanted:
            if r not in self._held:
                self._held[r] = self._read(r)
        return [self._held[r] for r in wanted]

    def _read(self, r: Rectangle) -> Held:
        heights = self.terrain.read(*r)
        gone = np.isnan(heights)
        holes = bool(gone.any())
        low, high = (math.inf, -math.inf) if holes and gone.all() else (
            float(np.nanmin(heights)), float(np.nanmax(heights)))  # fmt: skip
        data = np.where(gone, MISSING, heights) if holes else np.ascontiguousarray(heights, np.float32)
        missing = _reduced(gone, np.logical_or) if holes else np.zeros(1, bool)
        lowest, highest = _reduced(heights, np.fmin), _reduced(heights, np.fmax)
        blocks = np.stack(np.broadcast_arrays(
            np.where(np.isnan(lowest), np.inf, lowest), np.where(np.isnan(highest), -np.inf, highest), missing
        )).astype(np.float32)  # fmt: skip
        return Held(self.device.buffer(data, "STORAGE", "the ground around a tile"), low, high, blocks)


def _reduced(values: NDArray[Any], of: np.ufunc) -> NDArray[Any]:
    """Reduce the samples of every block of cells to one, for example their minimum."""
    for axis in (0, 1):
        starts = np.arange(0, max(values.shape[axis] - 1, 1), BLOCK)
        inner = of.reduceat(values, starts, axis=axis)
        values = of(inner, values.take(np.minimum(starts + BLOCK, values.shape[axis] - 1), axis=axis))
    return values
