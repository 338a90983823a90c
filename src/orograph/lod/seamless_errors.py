"""How far a level's surface is off in a block of the raster, for all levels and blocks that patches ask for.

Cell (i, j) of level k is two triangles, those of the square diamond at its centre: their ``exact`` error is that of the
level's surface over the cell. What is kept are the largest over square blocks, of sides from half a smallest patch up
to half a patch of 2^Q segments of 2^k samples: some thirtieth of the raster's bytes for Q = 6. Metres, samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.lod.method import Resources
from orograph.lod.squares import BlockHeights, Index, pooled, touched
from orograph.parallel import map_ordered
from orograph.raycast.select import Boxes
from orograph.store.diamond_table import DiamondTable
from orograph.store.patches import finite_errors, octave_window
from orograph.store.terrain import Heights, Terrain

ROWS = 512
"""Cells of a level that are read at a time, in rows."""


@dataclass(frozen=True, slots=True)
class Block:
    """Of blocks (rows, cols): the largest error, metres, and whether ground and missing ground meet in one."""

    error: Heights
    mixed: NDArray[np.bool_]

    def coarser(self) -> Block:
        """Of blocks twice as large."""
        return Block(pooled(self.error, np.maximum), pooled(self.mixed, np.logical_or))


class BlockErrors:
    """Errors of all levels by blocks.

    Args:
        terrain: the ground. kind: of errors. big: Q.
        resources: threads, progress.

    Attributes:
        heights: of blocks.
    """

    def __init__(self, terrain: Terrain, kind: ErrorKind, big: int, resources: Resources) -> None:
        self.terrain, self.big = terrain, big
        self._table: DiamondTable = terrain.derived("diamonds", error=kind)
        self._spread = terrain.height_range[1] - terrain.height_range[0]
        self._blocks: dict[tuple[int, int], Block] = {}
        levels = range(1, terrain.n + 1)
        strips = {level: range(0, self._cells(level)[0], ROWS) for level in levels}
        with resources.progress.task("Errors of blocks", sum(len(s) for s in strips.values())) as task:
            for level in levels:
                parts = []
                for part in map_ordered(lambda row: self._strip(level, row), strips[level], resources.jobs):  # noqa: B023
                    parts.append(part)
                    task.advance()
                self._keep(level, parts)
        self.heights = BlockHeights(terrain)

    def _cells(self, level: int) -> tuple[int, int]:
        rows, cols = self.terrain.grid.shape
        return -((1 - rows) >> level), -((1 - cols) >> level)

    def _strip(self, level: int, row: int) -> Block:
        """Blocks of a level's cells from a row on, as small as they are kept."""
        rows, cols = self._cells(level)
        last, k = min(row + ROWS, rows), level - 1
        errors = octave_window(self.terrain, self._table, k, (2 * row, 0), (2 * last, 2 * cols))[1::2, 1::2]
        mixed = np.isinf(errors)
        if mixed.any():
            whole = octave_window(self.terrain, self._table, k, (2 * row, 0), (2 * last, 2 * cols))
            errors = finite_errors(whole, self.terrain, k, (2 * row, 0), self._spread)[1::2, 1::2]
        found = Block(errors, mixed)
        for _ in range(self._least(level) - level):
            found = found.coarser()
        return found

    def _least(self, level: int) -> int:
        """The exponent of the sides of the smallest blocks of a level."""
        return max(level, self.big - 1)

    def _keep(self, level: int, parts: list[Block]) -> None:
        block = Block(np.concatenate([p.error for p in parts]), np.concatenate([p.mixed for p in parts]))
        least = self._least(level)
        for side in range(least, min(level + self.big - 1, self.terrain.n) + 1):
            if side > least:
                block = block.coarser()
            self._blocks[level, side] = block

    def blocks(self, level: int, side: int) -> Block:
        """All blocks of a level, of sides 2^side (one of those that are kept)."""
        return self._blocks[level, side]

    def around(self, levels: range, boxes: Boxes, side: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """The largest errors of levels in boxes (k, m), and whether ground and missing ground meet there.

        Args:
            boxes: of two blocks by two at most, of sides 2^side.
        """
        errors, mixed = np.zeros((len(levels), len(boxes.west))), np.zeros((len(levels), len(boxes.west)), bool)
        places: dict[int, tuple[Index, Index]] = {}
        for n, level in enumerate(levels):
            if level == 0:
                continue  # (samples are as they are)
            least = max(side, self._least(level))
            block = self._blocks[level, least]
            if least not in places:
                places[least] = touched(boxes, least, block.error.shape)
            errors[n] = block.error[places[least]].max(0)
            mixed[n] = block.mixed[places[least]].any(0)
        return errors, mixed
