"""Errors and nested spheres of every diamond of a raster, block by block: in memory or out of core, to the same bits.

A block of full-resolution samples with a margin of 64 decides all diamonds of octaves 0 to 4 in it: they and all their
descendants lie within 48 samples. Of the larger ones a block contributes what its samples say (the largest deviation
from each coarse triangle that overlaps it); they are finished at the end, from arrays 1/1024 of the raster's size.
Whatever the blocks and their order, every diamond's value is the maximum of the same numbers.

Per octave k the results are arrays of ``level_shape(shape, k)``: entry (i, j) belongs to the vertex (i·2^k, j·2^k) and
counts where it is a diamond of that octave (i or j odd). Errors are metres, float32, rounded up, +inf for *mixed*
diamonds (part surface, part hole); radii metres, float32, negative for *empty* ones (no surface under them).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.error import octaves
from orograph.error.deviation import triangle
from orograph.parallel import map_ordered

Kind = Literal["exact", "wedgie", "midpoint"]
Floats = NDArray[np.float32]
Shape = tuple[int, int]
Read = Callable[[int, int, int, int], Floats]

KINDS: dict[Kind, int] = {"midpoint": octaves.MIDPOINT, "wedgie": octaves.WEDGIE, "exact": octaves.EXACT}
SMALL = 5
"""Octaves that blocks finish themselves."""
MARGIN = 64
BLOCK = 1024


@dataclass(frozen=True, slots=True)
class Surface:
    """What the spheres must know of a raster.

    Attributes:
        shape: (rows, cols).
        metric: float64 (2, 2), metres of easting and northing per column and row.
        minimum: float32 (tile rows, tile cols), lowest height of each 256-cell tile, NaN where there is none.
        lowest: the lowest height of all (any number if nothing is valid).
    """

    shape: Shape
    metric: NDArray[np.float64]
    minimum: Floats
    lowest: float

    @property
    def n(self) -> int:
        return max(max(self.shape) - 2, 0).bit_length()

    def octave_shape(self, k: int) -> Shape:
        rows, cols = self.shape
        return -((1 - rows) >> k) + 1, -((1 - cols) >> k) + 1

    def filled(self, heights: Floats, row0: int, col0: int, k: int) -> Floats:
        """Heights at spacing 2^k that begin at a sample, missing ones replaced by the lowest of their tile."""
        gaps = np.isnan(heights)
        if not gaps.any():
            return heights
        i, j = np.nonzero(gaps)
        rows, cols = (np.minimum(at + (index << k), side - 1) for at, index, side in
                      zip((row0, col0), (i, j), self.shape))
        table = np.where(np.isnan(self.minimum), np.float32(self.lowest), self.minimum)
        result = heights.copy()
        result[i, j] = table[np.minimum(rows >> 8, table.shape[0] - 1), np.minimum(cols >> 8, table.shape[1] - 1)]
        return result


@dataclass(frozen=True, slots=True)
class Part:
    """The diamonds of one octave in a window: entries from (i, j) on.

    Attributes:
        octave, i, j: where.
        errors: kind to float32 (height, width).
        radii: float32, the same shape; negative where empty.
    """

    octave: int
    i: int
    j: int
    errors: dict[Kind, Floats]
    radii: Floats


@dataclass(slots=True)
class _Found:
    """What a block found: its parts, and what larger diamonds need of it."""

    parts: list[Part]
    sums: Floats | None
    states: NDArray[np.uint8] | None
    raw: list[tuple[int, int, int, Floats]]


def diamonds(
    read: Read,
    nested: Floats,
    surface: Surface,
    kinds: tuple[Kind, ...] = ("exact",),
    *,
    block: int = BLOCK,
    jobs: int | None = None,
    order: list[tuple[int, int]] | None = None,
) -> Iterator[Part]:
    """Yield the errors and radii of all diamonds, octaves 0 to n − 1.

    Args:
        read: ``read(row0, row1, col0, col1)``, full-resolution heights, NaN where missing; called from threads.
        nested: every 16th sample, the heights of level 4 (the last ones repeated at the raster's end).
        surface: see there.
        kinds: which errors.
        block: samples along the side of a block, a power of two ≥ 64.
        order: the blocks' (row, col) indices in the order wanted (default: row by row).
    """
    rows, cols = surface.shape
    n = surface.n
    coarse = _Coarse(nested, surface, kinds)
    spots = order or [(i, j) for i in range(-(-rows // block)) for j in range(-(-cols // block))]
    work = _Block(read, surface, kinds, block, coarse.heights)
    for spot, found in zip(spots, map_ordered(work, spots, jobs)):
        coarse.add(spot[0] * block, spot[1] * block, found)
        yield from found.parts
    if n > SMALL:
        yield from coarse.finish()


@inlined
def _vertex(coarse, i, j, s, last_row, last_col):
    """Row, column and height of a squeezed vertex."""
    height = np.float64(coarse[min(i, coarse.shape[0] - 1), min(j, coarse.shape[1] - 1)])
    return min(i * s, last_row), min(j * s, last_col), height


@kernel
def _overlap(z, row0, col0, coarse, k, rows, cols, i0, j0, raw):
    """The deviation of a block's samples from the coarse triangles of octave k's diamonds that overlap it.

    Args:
        z: the block, its first sample (row0, col0).
        coarse: the raster's heights at octave k's spacing.
        i0, j0: the entry that ``raw[0, 0]`` belongs to.
    """
    s = np.int64(1) << k
    y = np.int64(rows - 1)
    x = np.int64(cols - 1)
    for di in range(raw.shape[0]):
        for dj in range(raw.shape[1]):
            i, j = i0 + di, j0 + dj
            if not (i | j) & 1:
                continue
            row, col = i * s, j * s
            if i & 1 and j & 1:
                if octaves.is_falling(row, col, s):
                    ai, aj, bi, bj, pi, pj, qi, qj = i - 1, j - 1, i + 1, j + 1, i - 1, j + 1, i + 1, j - 1
                else:
                    ai, aj, bi, bj, pi, pj, qi, qj = i - 1, j + 1, i + 1, j - 1, i - 1, j - 1, i + 1, j + 1
            elif j & 1:
                ai, aj, bi, bj, pi, pj, qi, qj = i, j - 1, i, j + 1, i - 1, j, i + 1, j
            else:
                ai, aj, bi, bj, pi, pj, qi, qj = i - 1, j, i + 1, j, i, j - 1, i, j + 1
            worst = 0.0
            ay, ax, a = _vertex(coarse, ai, aj, s, y, x)
            by, bx, b = _vertex(coarse, bi, bj, s, y, x)
            if pi >= 0 and pj >= 0:
                py, px, p = _vertex(coarse, pi, pj, s, y, x)
                worst = max(worst, triangle(z, row0, col0, ay, ax, a, by, bx, b, py, px, p))
            if qi >= 0 and qj >= 0:
                qy, qx, q = _vertex(coarse, qi, qj, s, y, x)
                worst = max(worst, triangle(z, row0, col0, ay, ax, a, by, bx, b, qy, qx, q))
            raw[di, dj] = octaves.round_up(worst)


class _Block:
    """The work on one block."""

    def __init__(
        self, read: Read, surface: Surface, kinds: tuple[Kind, ...], block: int, coarse: list[Floats]
    ) -> None:
        self.read, self.surface, self.kinds, self.block, self.coarse = read, surface, kinds, block, coarse

    def __call__(self, spot: tuple[int, int]) -> _Found:
        (rows, cols), size, n = self.surface.shape, self.block, self.surface.n
        row, col = spot[0] * size, spot[1] * size
        row0, col0 = max(row - MARGIN, 0), max(col - MARGIN, 0)
        row1, col1 = min(row + size + MARGIN + 1, rows), min(col + size + MARGIN + 1, cols)
        fine = np.ascontiguousarray(self.read(row0, row1, col0, col1), np.float32)
        end = row1 == rows, col1 == cols
        gaps = bool(np.isnan(fine).any())
        own = [
            tuple(
                slice((at >> k) - (first >> k), (whole if at + size >= side else (at + size) >> k) - (first >> k))
                for at, first, whole, side in zip(
                    (row, col), (row0, col0), self.surface.octave_shape(k), self.surface.shape
                )
            )
            for k in range(min(SMALL, n))
        ]
        found = _Found([], None, None, [])
        z = fine
        below = {kind: np.zeros((0, 0), np.float32) for kind in self.kinds}
        sums, state = np.zeros((0, 0, 2), np.float32), np.zeros((0, 0, 2), np.uint8)
        filled_below, radii_below = z, np.zeros((0, 0), np.float32)
        for k in range(min(SMALL, n)):
            z = halve(z, end) if k else fine
            empty = np.zeros(z.shape, np.uint8)
            if gaps:
                new = np.zeros((*z.shape, 2), np.uint8)
                octaves.states(fine, state, row0, col0, k, new)
                state = new
            errors = {}
            for kind in self.kinds:
                e = errors[kind] = np.zeros(z.shape, np.float32)
                octaves.local_errors(fine, z, row0, col0, k, rows, cols, KINDS[kind], e)
                if kind == "wedgie":
                    new_sums = np.zeros((*z.shape, 2), np.float32)
                    octaves.wedgie_sums(sums, row0, col0, k, rows, cols, new_sums, e)
                    sums = new_sums
                if gaps:
                    octaves.mark(state, row0, col0, k, e, empty)
                octaves.close(below[kind], row0, col0, k, e)
            filled = self.surface.filled(z, row0, col0, k) if gaps else z
            radii = np.zeros(z.shape, np.float32)
            octaves.spheres(
                filled, filled_below, radii_below, row0, col0, k, rows, cols, self.surface.metric, radii
            )
            below, filled_below, radii_below = errors, filled, radii
            area = own[k]
            found.parts.append(
                Part(k, row >> k, col >> k, {kind: e[area] for kind, e in errors.items()},
                     _signed(radii[area], empty[area]))
            )
        if n > SMALL:
            area = own[-1]
            found.sums = sums[area] if "wedgie" in self.kinds else None
            found.states = state[area] if gaps else None
            if "exact" in self.kinds:
                ours = fine[row - row0 : row - row0 + size, col - col0 : col - col0 + size]
                found.raw = self._larger(ours, row, col)
        return found

    def _larger(self, ours: Floats, row: int, col: int) -> list[tuple[int, int, int, Floats]]:
        """For each larger octave: (octave, i, j, deviations of this block's samples)."""
        found = []
        ours = np.ascontiguousarray(ours)
        for k in range(SMALL, self.surface.n):
            # Diamonds reach one step to each side.
            i0, j0 = max((row >> k) - 1, 0), max((col >> k) - 1, 0)
            shape = self.surface.octave_shape(k)
            i1 = min(((row + ours.shape[0] - 1) >> k) + 2, shape[0] - 1)
            j1 = min(((col + ours.shape[1] - 1) >> k) + 2, shape[1] - 1)
            raw = np.zeros((i1 - i0 + 1, j1 - j0 + 1), np.float32)
            _overlap(ours, row, col, self.coarse[k - SMALL], k, *self.surface.shape, i0, j0, raw)
            found.append((k, i0, j0, raw))
        return found


def halve(heights: Floats, end: tuple[bool, bool]) -> Floats:
    """Every second sample each way, the last one repeated where the step leads beyond an ``end`` of the raster."""
    rows, cols = heights.shape
    i, j = (
        np.minimum(np.arange(0, side + (side + 1) % 2 * at_end, 2), side - 1) for side, at_end in zip((rows, cols), end)
    )
    return np.ascontiguousarray(heights[np.ix_(i, j)])


def _signed(radii: Floats, empty: NDArray[np.uint8]) -> Floats:
    """Radii, negative where the diamond is empty."""
    return np.where(empty == 1, -np.maximum(radii, np.float32(1e-30)), radii)


class _Coarse:
    """The diamonds of the octaves from SMALL on, put together from what the blocks found."""

    def __init__(self, nested: Floats, surface: Surface, kinds: tuple[Kind, ...]) -> None:
        self.surface, self.kinds = surface, kinds
        self.nested = np.ascontiguousarray(nested, np.float32)
        self.heights: list[Floats] = []
        for _ in range(SMALL, surface.n):
            self.heights.append(halve(self.heights[-1] if self.heights else self.nested, (True, True)))
        shape = surface.octave_shape(SMALL - 1)
        self.errors = {kind: np.zeros(shape, np.float32) for kind in kinds}
        self.radii = np.zeros(shape, np.float32)
        self.sums = np.zeros((*shape, 2) if "wedgie" in kinds else (0, 0, 2), np.float32)
        self.states: NDArray[np.uint8] | None = None
        self.raw = [np.zeros(surface.octave_shape(k), np.float32) for k in range(SMALL, surface.n)]

    def add(self, row: int, col: int, found: _Found) -> None:
        """Take over what a block found (from one thread)."""
        if not found.parts or self.surface.n <= SMALL:
            return
        part = found.parts[-1]
        area = slice(part.i, part.i + part.radii.shape[0]), slice(part.j, part.j + part.radii.shape[1])
        for kind in self.kinds:
            self.errors[kind][area] = part.errors[kind]
        self.radii[area] = np.abs(part.radii)
        if found.sums is not None:
            self.sums[area] = found.sums
        if found.states is not None:
            if self.states is None:  # so far everything was whole
                self.states = np.full((*self.radii.shape, 2), octaves.WHOLE, np.uint8)
            self.states[area] = found.states
        for k, i, j, raw in found.raw:
            whole = self.raw[k - SMALL][i : i + raw.shape[0], j : j + raw.shape[1]]
            np.maximum(whole, raw, out=whole)

    def finish(self) -> Iterator[Part]:
        (rows, cols), surface = self.surface.shape, self.surface
        below, sums, state = self.errors, self.sums, self.states
        radii_below, fine_filled = self.radii, surface.filled(self.nested, 0, 0, SMALL - 1)
        for k in range(SMALL, surface.n):
            z = self.heights[k - SMALL]
            empty = np.zeros(z.shape, np.uint8)
            if state is not None:
                new = np.zeros((*z.shape, 2), np.uint8)
                octaves.states(z, state, 0, 0, k, new)
                state = new
            errors = {}
            for kind in self.kinds:
                if kind == "exact":
                    e = self.raw[k - SMALL]
                else:
                    e = np.zeros(z.shape, np.float32)
                    octaves.local_errors(z, z, 0, 0, k, rows, cols, KINDS[kind], e)
                if kind == "wedgie":
                    new_sums = np.zeros((*z.shape, 2), np.float32)
                    octaves.wedgie_sums(sums, 0, 0, k, rows, cols, new_sums, e)
                    sums = new_sums
                if state is not None:
                    octaves.mark(state, 0, 0, k, e, empty)
                octaves.close(below[kind], 0, 0, k, e)
                errors[kind] = e
            filled = surface.filled(z, 0, 0, k)
            radii = np.zeros(z.shape, np.float32)
            octaves.spheres(filled, fine_filled, radii_below, 0, 0, k, rows, cols, surface.metric, radii)
            below, radii_below, fine_filled = errors, radii, filled
            yield Part(k, 0, 0, dict(errors), _signed(radii, empty))
