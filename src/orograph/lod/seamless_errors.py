"""How far a level's surface is off in a block of the raster, for all levels and blocks that patches ask for.

Cell (i, j) of level k is two triangles, those of the square diamond at its centre: their ``exact`` error is that of the
level's surface over the cell. What is asked for are the largest over square blocks, of sides from half a smallest patch
up to half a patch of 2^Q segments of 2^k samples: some thirtieth of the raster's bytes for Q = 6. They are made when
they are first asked for, in squares of 512 × 512 cells of a level, and those asked for last are kept: fine levels are
asked for near the eye only. Metres, samples.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.lod.method import Resources
from orograph.lod.squares import BlockHeights, pooled, touched
from orograph.parallel import map_ordered
from orograph.raycast.select import Boxes
from orograph.store.diamond_table import DiamondTable
from orograph.store.patches import finite_errors, octave_window
from orograph.store.terrain import Heights, Terrain

CELLS = 9
"""Squares of 2^9 × 2^9 cells of a level are made at a time."""

SHARE = 4
"""Their errors may take the allowed memory divided by this."""


@dataclass(frozen=True, slots=True)
class Block:
    """Of blocks (rows, cols): the largest error, metres, and whether ground and missing ground meet in one."""

    error: Heights
    mixed: NDArray[np.bool_]

    def coarser(self) -> Block:
        """Of blocks twice as large."""
        return Block(pooled(self.error, np.maximum), pooled(self.mixed, np.logical_or))


Square = tuple[int, int, int]
"""A level, and the row and column of a square of its cells."""


class BlockErrors:
    """Errors of all levels by blocks.

    Args:
        terrain: the ground. kind: of errors. big: Q.
        resources: memory, threads, progress.

    Attributes:
        heights: of blocks.
    """

    def __init__(self, terrain: Terrain, kind: ErrorKind, big: int, resources: Resources) -> None:
        self.terrain, self.big, self.resources = terrain, big, resources
        self._table: DiamondTable = terrain.derived("diamonds", error=kind)
        self._spread = terrain.height_range[1] - terrain.height_range[0]
        self._squares: OrderedDict[Square, list[Block]] = OrderedDict()
        self._bytes = 0
        self.heights = BlockHeights(terrain)

    def _cells(self, level: int) -> tuple[int, int]:
        rows, cols = self.terrain.grid.shape
        return -((1 - rows) >> level), -((1 - cols) >> level)

    def _shape(self, level: int, side: int) -> tuple[int, int]:
        """How many blocks of sides 2^side a level has each way."""
        rows, cols = self._cells(level)
        return -(-rows >> (side - level)), -(-cols >> (side - level))

    def _least(self, level: int) -> int:
        """The exponent of the sides of the smallest blocks of a level."""
        return max(level, self.big - 1)

    def _made(self, square: Square) -> list[Block]:
        """The blocks of a square, from the smallest sides to the largest."""
        level, row, col = square
        rows, cols = self._cells(level)
        top, left = row << CELLS, col << CELLS
        end = 2 * min(top + (1 << CELLS), rows), 2 * min(left + (1 << CELLS), cols)
        k, begin = level - 1, (2 * top, 2 * left)
        whole = octave_window(self.terrain, self._table, k, begin, end)
        errors = whole[1::2, 1::2]
        mixed = np.isinf(errors)
        if mixed.any():
            errors = finite_errors(whole, self.terrain, k, begin, self._spread)[1::2, 1::2]
        block = Block(errors, mixed)
        for _ in range(self._least(level) - level):
            block = block.coarser()
        found = [Block(block.error.copy(), block.mixed.copy())]
        for _ in range(self._least(level), min(level + self.big - 1, self.terrain.n)):
            found.append(found[-1].coarser())
        return found

    def _have(self, squares: list[Square]) -> None:
        """Make those that are not cached."""
        lacking = [square for square in squares if square not in self._squares]
        for square, made in zip(lacking, map_ordered(self._made, lacking, self.resources.jobs)):
            self._squares[square] = made
            self._bytes += sum(one.error.nbytes + one.mixed.nbytes for one in made)

    def _leave(self) -> None:
        """Drop the oldest ones where there are too many."""
        while self._bytes > self.resources.max_memory // SHARE and len(self._squares) > 1:
            _, gone = self._squares.popitem(last=False)
            self._bytes -= sum(one.error.nbytes + one.mixed.nbytes for one in gone)

    def blocks(self, level: int, side: int) -> Block:
        """All blocks of a level, of sides 2^side (one of those that are kept)."""
        rows, cols = (-(-v >> CELLS) for v in self._cells(level))
        parts: list[Block] = []
        with self.resources.progress.task("Errors of blocks", rows) as task:
            for row in range(rows):
                squares = [(level, row, col) for col in range(cols)]
                self._have(squares)
                of = [self._squares[square][side - self._least(level)] for square in squares]
                parts.append(Block(np.hstack([one.error for one in of]), np.hstack([one.mixed for one in of])))
                self._leave()
                task.advance()
        return Block(np.concatenate([p.error for p in parts]), np.concatenate([p.mixed for p in parts]))

    def around(self, levels: range, boxes: Boxes, side: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """The largest errors of levels in boxes (k, m), and whether ground and missing ground meet there.

        Args:
            boxes: of two blocks by two at most, of sides 2^side.
        """
        errors, mixed = np.zeros((len(levels), len(boxes.west))), np.zeros((len(levels), len(boxes.west)), bool)
        for n, level in enumerate(levels):
            if level == 0 or not len(boxes.west):
                continue  # (samples are as they are)
            least = max(side, self._least(level))
            row, col = touched(boxes, least, self._shape(level, least))
            bits = CELLS - (least - level)
            off, holes = np.zeros(row.shape, np.float32), np.zeros(row.shape, bool)
            names = (row >> bits) << 32 | (col >> bits)
            squares = np.unique(names)
            keys = [(level, at >> 32, at & 0xFFFFFFFF) for at in squares.tolist()]
            self._have(keys)
            for at, key in zip(squares, keys):
                self._squares.move_to_end(key)
                block = self._squares[key][least - self._least(level)]
                here = names == at if len(squares) > 1 else slice(None)
                i, j = row[here] - (key[1] << bits), col[here] - (key[2] << bits)
                off[here], holes[here] = block.error[i, j], block.mixed[i, j]
            self._leave()
            errors[n], mixed[n] = off.max(0), holes.any(0)
        return errors, mixed
