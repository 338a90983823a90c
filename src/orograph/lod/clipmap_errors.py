"""Choose a clipmap's windows from stored errors: which a tolerance requires, and which tiles they lack.

For windows as printed the errors of tiles decide, which bound the distance between a level's surface and the
full-resolution one; of levels coarser than stored ones there is one number, the largest of the errors of their cells
(``store.diamond_table``). Guaranteed windows are chosen by blocks of 32 × 32 cells (``seamless_errors``). Metres,
samples, pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import Rectangle
from orograph.lod.method import Ready, Resources
from orograph.lod.seamless_errors import BlockErrors
from orograph.lod.selection import NOTHING_WANTED, WANTED
from orograph.lod.squares import BlockHeights, Squares, pooled
from orograph.raycast.select import Boxes, in_frustum, moved, tile_boxes
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import Camera

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


BIG = 6
"""A block has 2^(BIG − 1) cells a side, or fewer where the raster is smaller."""


class LevelErrors:
    """Errors of all levels, by tiles.

    Args:
        terrain: the ground. coarsest: level.
    """

    def __init__(self, terrain: Terrain, coarsest: int) -> None:
        self.terrain, self.coarsest = terrain, coarsest
        stored = min(terrain.levels - 1, coarsest)
        self._errors = [terrain.tiles(k).error.astype(np.float64) for k in range(stored + 1)]
        self._boxes = [tile_boxes(terrain, k) for k in range(stored + 1)]
        if coarsest > stored:
            side, _ = terrain.diamond_shape(stored)
            table = terrain.derived("diamonds", error="exact").read(stored, 0, side, 0, side)[0]
            low, high = terrain.height_range
            last_row, last_col = (float(v - 1) for v in terrain.grid.shape)
            every = Boxes(*(np.full((1, 1), v) for v in (0.0, last_col, 0.0, last_row, low, high)))
            for level in range(stored + 1, coarsest + 1):
                half = 1 << (level - 1 - stored)
                cells = table[half :: 2 * half, half :: 2 * half]
                largest = float(cells[np.isfinite(cells)].max(initial=0.0))
                self._errors.append(np.full((1, 1), largest))
                self._boxes.append(every)

    def keeps(self, camera: Camera, tolerance: float, window: Rectangle) -> bool:
        """Whether the next coarser level keeps a tolerance in what is in view of a window."""
        level = window.level + 1
        if min(window.shape) < 2:
            return False
        boxes, view = self._boxes[level], camera.view
        within = (boxes.west < (window.col1 - 1) << window.level) & (boxes.east > window.col0 << window.level)
        within &= (boxes.north < (window.row1 - 1) << window.level) & (boxes.south > window.row0 << window.level)
        within &= in_frustum(self.terrain, view, camera.exaggeration, boxes)
        off = moved(self.terrain, view, camera.exaggeration, self._errors[level], boxes)
        return bool((off[within] <= tolerance).all())

    def ready(self, stack: Sequence[Rectangle], camera: Camera, ready: Ready) -> tuple[int, NDArray[Any]]:
        """How many windows, from the coarsest, have all their tiles; and the tiles that the others lack."""
        if ready.tiles is None:
            return len(stack), NOTHING_WANTED
        first = np.cumsum([0, *(self.terrain.tiles(k).error.size for k in range(self.terrain.levels))])
        there, lacking = len(stack), []
        for number, window in enumerate(stack):
            k = window.level
            if k >= self.terrain.levels:
                continue
            high, wide = self.terrain.tiles(k).error.shape
            rows = np.arange(window.row0 // TILE, min((window.row1 - 2) // TILE + 1, high))
            cols = np.arange(window.col0 // TILE, min((window.col1 - 2) // TILE + 1, wide))
            i, j = (v.ravel() for v in np.meshgrid(rows, cols, indexing="ij"))
            gone = ready.tiles[first[k] + i * wide + j] == 0
            if not gone.any():
                continue
            there = min(there, max(number, 1))
            off = np.full((high, wide), np.inf)
            if k + 1 <= self.coarsest:
                coarse = self._errors[k + 1], self._boxes[k + 1]
                off = moved(self.terrain, camera.view, camera.exaggeration, *coarse)
                off = (
                    np.repeat(np.repeat(off, 2, 0), 2, 1)
                    if k + 1 < self.terrain.levels
                    else np.full((high, wide), off.max())
                )
            some = np.zeros(int(gone.sum()), WANTED)
            some["level"], some["row"], some["col"] = k, i[gone], j[gone]
            some["pixels"] = off[i[gone], j[gone]]
            lacking.append(some)
        if not lacking:
            return there, NOTHING_WANTED
        every = np.concatenate(lacking)
        return there, every[np.argsort(-every["pixels"], kind="stable")]


class Blocks:
    """Errors of all levels by blocks of 32 × 32 cells.

    Args:
        terrain: the ground. coarsest: level. heights: of blocks. resources: threads, progress.
    """

    def __init__(self, terrain: Terrain, coarsest: int, heights: BlockHeights, resources: Resources) -> None:
        self.terrain, self.coarsest = terrain, coarsest
        self._big = max(min(BIG, terrain.n), 1)
        made = BlockErrors(terrain, "exact", self._big, resources)
        self._errors: list[Array] = []
        self._boxes: list[Boxes] = []
        for level in range(1, coarsest + 1):
            side = self._side(level)
            error = made.blocks(level, side).error.astype(np.float64)
            row, col = (v.ravel() for v in np.indices(error.shape))
            boxes = heights.of(Squares(side, row, col))
            shaped = (getattr(boxes, f.name).reshape(error.shape) for f in fields(Boxes))
            self._errors.append(error)
            self._boxes.append(Boxes(*shaped))

    def _side(self, level: int) -> int:
        """The exponent of a block's sides, in samples."""
        return min(level + self._big - 1, self.terrain.n)

    def wanted(self, camera: Camera, tolerance: float, *, blended: bool) -> dict[int, Rectangle]:
        """By level, the smallest window outside of which the next coarser level keeps a tolerance.

        Args:
            blended: it has to keep it with its own error and the level's together, as where heights are between both.
        """
        found: dict[int, Rectangle] = {}
        for level in range(self.coarsest):
            need = self._exceeds(camera, tolerance, level + 1, blended)
            if need.any():
                rows, cols = np.flatnonzero(need.any(1)), np.flatnonzero(need.any(0))
                s = self._side(level + 1) - level
                found[level] = Rectangle(
                    level, int(rows[0]) << s, (int(rows[-1] + 1) << s) + 1, int(cols[0]) << s,
                    (int(cols[-1] + 1) << s) + 1,
                )  # fmt: skip
        return found

    def _exceeds(self, camera: Camera, tolerance: float, level: int, blended: bool) -> Mask:
        """Which blocks of a level are in view and off by more than a tolerance."""
        error, boxes = self._errors[level - 1], self._boxes[level - 1]
        if blended:
            finer = self._errors[level - 2] if level > 1 else np.zeros(error.shape)
            if finer.shape != error.shape:
                finer = pooled(finer, np.maximum)
            error = error + np.maximum(finer, error)
        need = moved(self.terrain, camera.view, camera.exaggeration, error, boxes) > tolerance
        return np.asarray(need & in_frustum(self.terrain, camera.view, camera.exaggeration, boxes))
