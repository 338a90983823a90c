"""A terrain with detail beyond its data, for pictures: finer levels below the terrain's own, made when they are read.

Its level k is the terrain's level 0, whose samples stay unchanged; levels 0 to k − 1 are doublings of it
(``refining``). Its tables, which say how coarsely each tile may be drawn, are estimates: there is no promise for ground
that nobody has measured. Only pictures read it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid, compose
from orograph.progress import SILENT, Progress
from orograph.raycast.select import distances, tile_boxes
from orograph.store.given import source_of
from orograph.store.patches import stored_levels
from orograph.store.terrain import TILE, Heights, Terrain, TileTable, tile_shape
from orograph.synthesis.detailed_diamonds import DiamondsOfData, Shifted
from orograph.synthesis.exemplar import Exemplar
from orograph.synthesis.refining import Data, Doubled, Fractal, Lattice, Residual, metres
from orograph.synthesis.steered import Steering
from orograph.synthesis.terrain import example
from orograph.synthesis.windows import Range
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.gpu.device import Device

MOST = 10
"""Maximum doublings."""

TILES = 1 << 21
"""Maximum tiles of the finest level."""

SEEN = 0.25
"""Maximum height of detail, as a part of the samples' spacing: half a pixel if they are two pixels apart."""

FALL = 0.5
"""Assumed minimum factor by which residuals fall from level to level, to estimate how large they may be."""


class Detailed(Terrain):
    """A terrain with detail (see the module).

    Args:
        terrain: the data. doublings: how many, at least 1. seed: a different number gives different detail.
        steering: detail by example; None: fractal. Levels finer than the example are fractal too.
        device: computes it; None: the CPU. The result is the same.
    """

    def __init__(
        self, terrain: Terrain, doublings: int, seed: int = 1, steering: Steering | None = None,
        device: Device | None = None,
    ) -> None:  # fmt: skip
        self.data, self.doublings = terrain, doublings
        rows, cols = terrain.grid.shape
        scale = 2.0**-doublings
        middle = Affine.translation(0.5, 0.5)
        transform = compose(terrain.grid.transform, middle, Affine.scale(scale), ~middle)
        shape = ((rows - 1) << doublings) + 1, ((cols - 1) << doublings) + 1
        self.grid = Grid(shape, transform, terrain.grid.crs)
        self.name, self.vertical, self.attribution = terrain.name, terrain.vertical, terrain.attribution
        self._lattices: list[Lattice] = [Data(terrain)]
        known = 0 if steering is None else steering.doublings
        for n in range(1, doublings + 1):
            residual: Residual
            if steering is not None and n <= known:
                residual = steering.residual(n)
            else:
                residual = _fractal(self._lattices[known], n - known, n, seed, device)
            self._lattices.append(Doubled(self._lattices[-1], residual))
        self._largest = _largest(terrain)
        self._tables: dict[int, TileTable] = {}

    @property
    def height_range(self) -> tuple[float, float]:
        return self.data.height_range

    @property
    def valid_fraction(self) -> float:
        return self.data.valid_fraction

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        self.check_window(self.shape(level), row0, row1, col0, col1)
        if level >= self.doublings:
            return self.data.read(level - self.doublings, row0, row1, col0, col1)
        if row0 == row1 or col0 == col1:
            return np.zeros((row1 - row0, col1 - col0), np.float32)
        # The last sample of a level repeats the raster's last one if it falls beyond it.
        step, (rows, cols) = 1 << level, self.grid.shape
        lattice, finer = self._lattices[self.doublings - level], self.doublings - level
        inner = Range(row0, min(row1, (rows - 1) // step + 1), col0, min(col1, (cols - 1) // step + 1))
        heights = metres(lattice.read(inner), lattice.quantum).astype(np.float32)
        # The data's own samples are not rounded to quanta.
        first, last = (tuple(-(-at >> finer) for at in ends) for ends in ((inner.row0, inner.col0),
                                                                            (inner.row1, inner.col1)))  # fmt: skip
        if first[0] < last[0] and first[1] < last[1]:
            own = self.data.read(0, first[0], last[0], first[1], last[1])
            times = 1 << finer
            heights[-inner.row0 % times :: times, -inner.col0 % times :: times] = own
        return np.pad(heights, ((0, row1 - inner.row1), (0, col1 - inner.col1)), mode="edge")

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Means around the middle of each block: of the level's nearest four samples; level 0 is the raster."""
        self.check_window(self.mean_shape(level), row0, row1, col0, col1)
        if level == 0 or row0 == row1 or col0 == col1:
            return self.read(level, row0, row1, col0, col1)
        if level < self.doublings:
            shape, t = self.shape(level), 0.5
            found = self.read(level, row0, min(row1 + 1, shape[0]), col0, min(col1 + 1, shape[1]))
        else:
            # Blocks of the data begin at their first sample; those of this terrain surround it.
            own = level - self.doublings
            shape, t = self.data.mean_shape(own), (1 - 2.0**-self.doublings) / 2.0 ** (own + 1)
            found = self.data.read_mean(own, row0, min(row1 + 1, shape[0]), col0, min(col1 + 1, shape[1]))
        wide = np.pad(
            found, [(0, n + 1 - have) for n, have in zip((row1 - row0, col1 - col0), found.shape)], mode="edge"
        )
        for axis in (0, 1):
            a, b = (np.take(wide, range(k, wide.shape[axis] - 1 + k), axis) for k in (0, 1))
            wide = np.where(np.isnan(a) | np.isnan(b), np.where(np.isnan(a), b, a), a + np.float32(t) * (b - a))
        return np.asarray(wide, np.float32)

    def has(self, name: str, **options: Any) -> bool:
        return name == "patches" or self.data.has(name, **options)

    def derived(self, name: str, **options: Any) -> Any:
        """Diamonds and their patches: those of the data (``detailed_diamonds``)."""
        if name == "diamonds":
            return DiamondsOfData(self, self.data, self.doublings, **options)
        if name == "patches":
            own, first = self.data.derived(name, **options), stored_levels(self.data.grid.shape, options["legs"])[0]
            return Shifted(self, self.data, self.doublings, own.read, first, 0.0)
        return super().derived(name, **options)

    def tiles(self, level: int) -> TileTable:
        """Estimates: the terrain's own tables, and the possible effect of detail."""
        if level not in self._tables:
            self._tables[level] = self._estimated(level)
        return self._tables[level]

    def _estimated(self, level: int) -> TileTable:
        own = max(level - self.doublings, 0)
        table, more = self.data.tiles(own), self._largest * FALL / (1 - FALL)
        if level >= self.doublings:
            error = table.error + np.float32(min(more, SEEN * max(self.data.grid.spacing) * 2.0**own))
            return TileTable(table.minimum - np.float32(more), table.maximum + np.float32(more), error, table.valid)
        times = 1 << (self.doublings - level)
        rows, cols = tile_shape(self.grid.shape, self._check(level))

        def repeated(values: NDArray[np.generic]) -> NDArray[np.generic]:
            return np.repeat(np.repeat(values, times, 0), times, 1)[:rows, :cols]

        spacing = max(self.grid.spacing) * 2.0**level
        rest = np.float32(min(more * FALL ** (self.doublings - level), SEEN * spacing) if level else 0.0)
        valid = repeated(table.valid)
        low, high = (repeated(one).astype(np.float32) for one in (table.minimum - more, table.maximum + more))
        return TileTable(low, high, np.full((rows, cols), rest, np.float32), valid.astype(np.uint8))


def _fractal(base: Lattice, doublings: int, level: int, seed: int, device: Device | None) -> Fractal:
    if device is None:
        return Fractal(base, doublings, level, seed)
    from orograph.synthesis.detail_gpu import FractalOnGpu

    return FractalOnGpu(device, base, doublings, level, seed)


def _largest(terrain: Terrain) -> float:
    """The distance of samples from the coarser level's surface: a high percentile of the tiles' errors, metres."""
    level = min(1, terrain.levels - 1)
    if level:
        errors = terrain.tiles(1).error
        known = errors[np.isfinite(errors)]
        return float(np.percentile(known, 90)) if known.size else 0.0
    rows, cols = terrain.grid.shape
    heights = terrain.read(0, 0, rows, 0, cols).astype(np.float64)
    rest = np.abs(heights[:, 1:-1] - (heights[:, :-2] + heights[:, 2:]) / 2)
    return float(np.nanmax(rest)) if np.isfinite(rest).any() else 0.0


def doublings_for(terrain: Terrain, view: View, exaggeration: float, most: int = TILES) -> int:
    """The number of doublings that makes samples about as fine as pixels where the ground is nearest to the eye.

    Args:
        most: tiles of the finest level.
    """
    spacing = max(terrain.grid.spacing)
    if view.projection == "plan":
        pixel = view.pixel_metres
    else:
        pixel = view.pixel_slope * max(_nearest(terrain, view, exaggeration), view.near, 1e-3)
    wanted = math.ceil(math.log2(spacing / pixel)) if spacing > pixel else 0
    return min(wanted, room_for(terrain, most))


def room_for(terrain: Terrain, most: int = TILES) -> int:
    """The number of doublings with at most ``most`` tiles of the finest level."""
    tiles = math.prod(tile_shape(terrain.grid.shape, 0))
    return min(max((most // tiles).bit_length() - 1, 0) // 2, MOST)


def _nearest(terrain: Terrain, view: View, exaggeration: float) -> float:
    """Metres from the eye to about the nearest sample, in stretched space."""
    boxes = tile_boxes(terrain, 0)
    far = distances(terrain, view, exaggeration, boxes)
    least = float(np.nanmin(np.where(np.isfinite(boxes.low), far, np.inf)))
    near = np.argwhere(far <= least + max(terrain.grid.spacing))
    best = math.inf
    a, b, c, d, e, f = terrain.grid.samples[:6]
    rows, cols = terrain.grid.shape
    for ty, tx in near[:9]:
        row0, col0 = ty * TILE, tx * TILE
        heights = terrain.read(0, row0, min(row0 + TILE + 1, rows), col0, min(col0 + TILE + 1, cols))
        y, x = np.mgrid[row0 : row0 + heights.shape[0], col0 : col0 + heights.shape[1]]
        dx, dy = a * x + b * y + c - view.eye[0], d * x + e * y + f - view.eye[1]
        apart = np.sqrt(dx * dx + dy * dy + ((heights - view.eye[2]) * exaggeration) ** 2)
        if np.isfinite(apart).any():
            best = min(best, float(np.nanmin(apart)))
    return least if math.isinf(best) else best


def steering_of(
    terrain: Terrain, given: object, seed: int, progress: Progress = SILENT, device: Device | None = None
) -> tuple[Steering, str]:
    """Detail by example for a terrain, and the example's name.

    Args:
        given: the example, whatever ``orograph.terrain`` takes. device: computes it; None: the CPU.

    Raises:
        UsageError: it is not an example (``Exemplar.of``), or not finer than the terrain.
        ReadError: it cannot be read.
    """
    source = source_of(given, progress, called="detail")
    own, spacing = max(source.grid.spacing), max(terrain.grid.spacing)
    doublings = round(math.log2(spacing / own))
    if doublings < 1:
        raise UsageError(
            f"An example of detail must be finer than the terrain: its samples are {own:.3g} m apart, the terrain's "
            f"{spacing:.3g} m.",
            path=source.name, remedy="Use lidar, or omit the example.",
        )  # fmt: skip
    exemplar = Exemplar.of(example(source), source.name, None, progress)
    # On coarser terrain, the example's coarsest level stands in for levels coarser than its own.
    doublings = min(doublings, exemplar.top)
    numbers = doublings, spacing / (own * 2.0**doublings), seed
    if device is None:
        return Steering(exemplar, Data(terrain), *numbers), source.name
    from orograph.synthesis.detail_gpu import SteeringOnGpu

    return SteeringOnGpu(device, exemplar, Data(terrain), *numbers), source.name
