"""TINs of the hierarchy's patches (BDAM): their vertices, errors and spheres.

Every triangle of the hierarchy above the finest patches carries a TIN. It shares a diamond with one other, across the
hypotenuse, and both are made together (``tin_kernels``). All vertices are samples of a lattice of the terrain's nested
levels, ``FINER`` times finer than that of a regular patch. So a diamond needs the same small window whatever
its size, and a TIN is stored as marks on the lattice: which samples are vertices. Heights are the terrain's own; the
triangles follow from the vertices.

Cignoni et al. 2003 (*BDAM – Batched Dynamic Adaptive Meshes for high performance terrain visualization*).

*Marks* of octave k: uint8 on lattice ``lattice(k)``: bit 1 for vertices of the octave's squares, bit 2 of its edges.
*Errors* and radii: as ``diamond_table`` has them, in metres: the largest vertical distance of a diamond's TINs from the
full-resolution surface, saturated; negative where no TIN stands for it (ground and missing ground meet).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.store.array_spec import ArraySpec
from orograph.store.patches import NOTHING
from orograph.store.terrain import Heights, Shape, Terrain, diamond_shape, exponent, level_count, level_shape

if TYPE_CHECKING:
    from orograph.store.stored import StoredTerrain

LEGS = 16
"""Default number of segments along a finest patch's leg; its square is the number of a patch's triangles."""

ALL_LEGS = (4, 8, 16, 32)
"""The allowed values."""

FINER = 2
"""log2 of the lattice's samples along a leg for each sample of a regular patch."""

MOST_OCTAVE = 11
"""Diamonds of coarser octaves have no TINs: their windows would exceed 4097 samples a side."""

SQUARE, EDGE = np.uint8(1), np.uint8(2)
"""Bits of marks, by the kind of diamond."""

NO_TIN = -NOTHING
"""The error of a diamond without a TIN."""

Marks = NDArray[np.uint8]


def octaves(shape: Shape, legs: int) -> range:
    """The octaves whose diamonds may have TINs."""
    return range(legs.bit_length() - 1, exponent(shape))


def lattice(shape: Shape, octave: int, legs: int) -> int:
    """The level of the terrain whose samples are candidates for an octave's vertices."""
    return min(max(octave - legs.bit_length() + 1 - FINER, 0), level_count(shape) - 1)


def stored_levels(shape: Shape, legs: int) -> range:
    """The levels that have errors of diamonds."""
    top = level_count(shape) - 1
    return range(min(legs.bit_length() - 1, top), top + 1)


def table_spec(shape: Shape, level: int, name: str, shard: int, chunk: int) -> ArraySpec:
    """Errors or radii of a level."""
    return ArraySpec(f"tins/level-{level}/{name}", diamond_shape(shape, level), shard, chunk, "float32", 0.0)


def marks_spec(shape: Shape, octave: int, legs: int, shard: int, chunk: int) -> ArraySpec:
    """The marks of an octave."""
    at = level_shape(shape, lattice(shape, octave, legs))
    return ArraySpec(f"tins/octave-{octave}/marks", at, shard, chunk, "uint8", 0.0)


class MemoryTins:
    """TINs in memory.

    Args:
        legs: segments along a leg of the finest patches. marks: by octave. errors, radii: by level, in the layout of
            ``diamond_table``. figures: statistics by octave and kind (``tin_build.Figures``).
    """

    def __init__(
        self, terrain: Terrain, legs: int, marks: dict[int, Marks], errors: list[Heights], radii: list[Heights],
        figures: list[Any],
    ) -> None:  # fmt: skip
        self.terrain, self.legs, self._marks, self.errors, self.radii = terrain, legs, marks, errors, radii
        self.figures = figures

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        """Errors and radii of the entries of a level, as for ``DiamondTable.read``."""
        return self.errors[level][row0:row1, col0:col1], self.radii[level][row0:row1, col0:col1]

    def marks(self, octave: int, row0: int, row1: int, col0: int, col1: int) -> Marks:
        """The marks of samples of the octave's lattice."""
        return self._marks[octave][row0:row1, col0:col1]


class StoredTins:
    """TINs of a store."""

    def __init__(self, terrain: StoredTerrain, legs: int) -> None:
        self.terrain, self.legs = terrain, legs
        self._sizes = terrain.record.shard, terrain.record.chunk

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        """See ``MemoryTins``; levels finer than TINs are empty."""
        shape = self.terrain.grid.shape
        self.terrain.check_window(self.terrain.diamond_shape(level), row0, row1, col0, col1)
        if level not in stored_levels(shape, self.legs):
            return np.zeros((row1 - row0, col1 - col0), np.float32), np.zeros((row1 - row0, col1 - col0), np.float32)
        found = [
            self.terrain.opened(f"tins/{name}", level, lambda: table_spec(shape, level, name, *self._sizes)).read(  # noqa: B023
                row0, row1, col0, col1
            )
            for name in ("error", "radius")
        ]
        return found[0], found[1]

    def marks(self, octave: int, row0: int, row1: int, col0: int, col1: int) -> Marks:
        """See ``MemoryTins``."""
        array = self.terrain.opened(
            "tins/marks", octave, lambda: marks_spec(self.terrain.grid.shape, octave, self.legs, *self._sizes)
        )
        found: Marks = array.read(row0, row1, col0, col1)
        return found


Tins = MemoryTins | StoredTins
