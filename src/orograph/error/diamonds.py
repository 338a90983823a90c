"""Errors and nested spheres of every diamond of a raster, block by block: in memory or out of core, to the same bits.

A block of full-resolution samples with a margin around it decides all diamonds of octaves 0 to 4 in it: they and all
their descendants lie within 48 samples. Of the larger ones a block contributes what its samples say (the largest
deviation from each coarse triangle that overlaps it); they are finished at the end, from arrays 1/1024 of the raster's
size. Whatever the blocks and their order, every diamond's value is the maximum of the same numbers.

Per octave k the results are arrays of ``level_shape(shape, k)``: entry (i, j) belongs to the vertex (i·2^k, j·2^k) and
counts where it is a diamond of that octave (i or j odd). Errors are metres, float32, rounded up, +inf for *mixed*
diamonds (part surface, part hole); radii metres, float32, negative for *empty* ones (no surface under them).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind, holes, octaves
from orograph.error.climb import NOTHING, Climb, halve
from orograph.error.encode import Encoder
from orograph.error.parts import Floats, Part, Rest, Shape, Surface
from orograph.parallel import map_ordered

__all__ = [
    "ALIGNED", "BLOCK", "NOTHING", "REACH", "SMALL", "Part", "Rest", "Surface", "Survey", "diamonds", "halve",
]  # fmt: skip

Read = Callable[[int, int, int, int], Floats]

SMALL = 5
"""Octaves that blocks complete themselves."""
REACH = 48
"""Samples from a block's own to the farthest that decide its diamonds."""
ALIGNED = 64
"""Windows begin at multiples of this."""
BLOCK = 1024


def diamonds(
    read: Read,
    nested: Floats,
    surface: Surface,
    kinds: tuple[ErrorKind, ...] = ("exact",),
    *,
    radii: bool = True,
    rounding: Encoder | None = None,
    block: int = BLOCK,
    jobs: int | None = None,
    order: list[Shape] | None = None,
) -> Iterator[Part]:
    """Yield the errors and radii of all diamonds, octaves 0 to n − 1.

    Args:
        read: ``read(row0, row1, col0, col1)``, full-resolution heights, NaN where missing; called from threads.
        nested, surface, kinds, radii, rounding, block: see ``Survey``.
        order: the blocks' (row, col) indices in the order wanted (default: row by row).
    """
    survey = Survey(nested, surface, kinds, radii=radii, rounding=rounding, block=block)
    for parts, rest in map_ordered(lambda spot: survey.block(spot, read), order or survey.blocks(), jobs):
        survey.add(rest)
        yield from parts
    yield from survey.finish()


class Survey:
    """Computes a raster's diamonds: first blocks, in any order and from any thread, then the larger octaves.

    Args:
        nested: every 16th sample, the heights of level 4 (the last ones repeated at the raster's end).
        surface: see there.
        kinds: which errors.
        radii: whether to make the nested spheres, too.
        rounding: make them for these codes: each sphere around the rounded ones of its children, and rounded.
        block: samples along the side of a block, a power of two ≥ 32.
    """

    def __init__(
        self,
        nested: Floats,
        surface: Surface,
        kinds: tuple[ErrorKind, ...],
        *,
        radii: bool = True,
        rounding: Encoder | None = None,
        block: int = BLOCK,
    ) -> None:
        self.surface, self.kinds, self.with_radii, self.rounding, self.size = surface, kinds, radii, rounding, block
        self.nested = np.ascontiguousarray(nested, np.float32)
        self.heights: list[Floats] = []  # of the octaves from SMALL on
        for _ in range(SMALL, surface.n):
            self.heights.append(halve(self.heights[-1] if self.heights else self.nested))
        # Of the last octave that blocks finish:
        shape = surface.octave_shape(SMALL - 1)
        self.squares = 2, shape[0] // 2, shape[1] // 2
        self.errors = {kind: np.zeros(shape, np.float32) for kind in kinds}
        self.radii = np.zeros(shape, np.float32) if radii else None
        self.sums = np.zeros(self.squares, np.float32) if "wedgie" in kinds else None
        self.states: NDArray[np.uint8] | None = None
        # Of the larger ones:
        larger = range(SMALL, surface.n) if "exact" in kinds else ()
        self.raw = [np.zeros(surface.octave_shape(k), np.float32) for k in larger]
        self._lock = threading.Lock()

    def blocks(self) -> list[Shape]:
        """All blocks (row, col), row by row."""
        rows, cols = (-(-side // self.size) for side in self.surface.shape)
        return [(i, j) for i in range(rows) for j in range(cols)]

    def block(self, spot: Shape, read: Read) -> tuple[list[Part], Rest | None]:
        """Survey one block.

        Args:
            read: called once for the block and the samples around it that matter.

        Returns:
            its diamonds, an octave each, and what ``add`` must be told of it.
        """
        (rows, cols), size, n = self.surface.shape, self.size, self.surface.n
        row, col = spot[0] * size, spot[1] * size
        row0, col0 = (max((at - REACH) // ALIGNED * ALIGNED, 0) for at in (row, col))
        row1, col1 = min(row + size + REACH + 1, rows), min(col + size + REACH + 1, cols)
        fine = np.ascontiguousarray(read(row0, row1, col0, col1), np.float32)
        end = row1 == rows, col1 == cols
        gaps = bool(np.isnan(fine).any())
        # At a squeezed border diamonds may lie beyond the surface; elsewhere only missing samples make holes.
        states = np.zeros((2, 0, 0), np.uint8) if gaps or (self.surface.squeezed and any(end)) else None
        none = np.zeros((0, 0), np.float32)
        climb = Climb(
            self.surface,
            self.kinds,
            self.rounding,
            row0,
            col0,
            dict.fromkeys(self.kinds, none),
            np.zeros((2, 0, 0), np.float32) if "wedgie" in self.kinds else None,
            states,
            none if self.with_radii else None,
            none,
            gaps=gaps,
        )
        parts = []
        z, area = fine, (slice(0), slice(0))
        for k in range(min(SMALL, n)):
            z = halve(z, end) if k else fine
            climb.step(k, fine, z)
            shape = self.surface.octave_shape(k)
            # The last block of a row or column has the entries beyond the raster's end, too.
            last_row = shape[0] if row + size >= rows else (row + size) >> k
            last_col = shape[1] if col + size >= cols else (col + size) >> k
            i0, j0 = row0 >> k, col0 >> k
            area = slice((row >> k) - i0, last_row - i0), slice((col >> k) - j0, last_col - j0)
            parts.append(climb.part(k, row >> k, col >> k, area))
        if n <= SMALL:
            return parts, None
        squares = (slice(None), *(slice(s.start >> 1, s.stop >> 1) for s in area))
        sums = None if climb.sums is None else climb.sums[squares]
        states = None if climb.states is None else climb.states[squares]
        raw = []
        if "exact" in self.kinds:
            ours = fine[row - row0 : row - row0 + size, col - col0 : col - col0 + size]
            raw = self._larger(np.ascontiguousarray(ours), row, col)
        return parts, Rest(parts[-1], sums, states, raw)

    def _larger(self, ours: Floats, row: int, col: int) -> list[tuple[int, int, int, Floats]]:
        """For each larger octave: (octave, i, j, deviations of this block's samples)."""
        found = []
        for k in range(SMALL, self.surface.n):
            # Diamonds reach one step to each side.
            i0, j0 = max((row >> k) - 1, 0), max((col >> k) - 1, 0)
            shape = self.surface.octave_shape(k)
            i1 = min(((row + ours.shape[0] - 1) >> k) + 2, shape[0] - 1)
            j1 = min(((col + ours.shape[1] - 1) >> k) + 2, shape[1] - 1)
            raw = np.zeros((i1 - i0 + 1, j1 - j0 + 1), np.float32)
            octaves.overlap(ours, row, col, self.heights[k - SMALL], k, *self.surface.shape, i0, j0, raw)
            found.append((k, i0, j0, raw))
        return found

    def add(self, rest: Rest | None) -> None:
        """Merge a block's result. Every block exactly once, in any order, from any thread."""
        if rest is None:
            return
        part = rest.part
        rows, cols = part.errors[self.kinds[0]].shape
        area = slice(part.i, part.i + rows), slice(part.j, part.j + cols)
        halves = slice(None), *(slice(s.start >> 1, s.stop >> 1) for s in area)
        with self._lock:
            for kind in self.kinds:
                self.errors[kind][area] = part.errors[kind]
            if self.radii is not None and part.radii is not None:
                self.radii[area] = np.abs(part.radii)
            if self.sums is not None and rest.sums is not None:
                self.sums[halves] = rest.sums
            if rest.states is not None:
                if self.states is None:  # so far everything was whole
                    self.states = np.full(self.squares, holes.WHOLE, np.uint8)
                self.states[halves] = rest.states
            for k, i, j, raw in rest.raw:
                whole = self.raw[k - SMALL][i : i + raw.shape[0], j : j + raw.shape[1]]
                np.maximum(whole, raw, out=whole)

    def finish(self) -> Iterator[Part]:
        """The diamonds of the octaves that no block completes."""
        filled = self.surface.filled(self.nested, 0, 0, SMALL - 1)
        at = self.surface, self.kinds, self.rounding, 0, 0
        climb = Climb(*at, self.errors, self.sums, self.states, self.radii, filled, gaps=True)
        for k in range(SMALL, self.surface.n):
            z = self.heights[k - SMALL]
            climb.step(k, z, z, self.raw[k - SMALL] if self.raw else None)
            yield climb.part(k, 0, 0, (slice(None), slice(None)))
