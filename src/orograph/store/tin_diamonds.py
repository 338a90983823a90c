"""The TINs of one diamond, made from the marks below it or reconstructed from its own.

The vertices on a diamond's legs were decided by the diamonds below, whose hypotenuses these are, and stay; those on its
hypotenuse move only along it (Cignoni et al. 2003, sec. 3). ``tin_build`` does this level by level.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import read_only
from orograph.errors import OrographError
from orograph.hierarchy import diamonds, triangles
from orograph.store.terrain import TILE, Heights, Terrain
from orograph.store.tin_greedy import deviation, make_row, simplify, sizes
from orograph.store.tin_kernels import Work, new_work, patches, triangulate
from orograph.store.tin_windows import Window, clipped, legs_of
from orograph.store.tins import EDGE, FINER, SQUARE, Marks, Tins, lattice

TOGETHER = 32
"""Maximum number of diamonds per call of a kernel."""

LIMIT = 1e-6
"""Error in metres below which no vertex is inserted."""

ROUNDING = 1.0 + 1e-6
"""Margin added to measured errors, for crossings too near a sample to be resolved."""

Integers = NDArray[np.int64]
Corners = NDArray[np.int32]

MarksOf = Callable[[int, int, int, int, int], Marks]
"""Returns the marks of an octave in a window: first row, end, first column, end."""


class Place:
    """The place of a diamond: its window, and the window on the raster.

    Args:
        terrain: the ground. row, col: the diamond. legs: segments along a leg of the finest patches.
    """

    __slots__ = ("ends", "heights_at", "octave", "window", "x0", "x1", "y0", "y1")

    def __init__(self, terrain: Terrain, row: int, col: int, legs: int) -> None:
        shape = terrain.grid.shape
        s, kind = int(diamonds.spacing(row, col)), int(diamonds.kind(row, col))
        self.octave = s.bit_length() - 1
        k = lattice(shape, self.octave, legs)
        step, last = 1 << k, (shape[0] - 1, shape[1] - 1)
        self.y0, self.x0 = max(row - s, 0), max(col - s, 0)
        self.y1, self.x1 = min(row + s, last[0]), min(col + s, last[1])
        i0, j0 = self.y0 >> k, self.x0 >> k
        self.heights_at = k, i0, -(-self.y1 >> k) + 1, j0, -(-self.x1 >> k) + 1
        odd = 1 - kind
        sparse = 1 << (lattice(shape, min(self.octave + odd, terrain.n - 1), legs) - k)
        self.window = Window(
            col - self.x0, row - self.y0, s, kind, int(triangles.axis(col, row, s << odd, odd)), self.x1 - self.x0,
            self.y1 - self.y0, step, sparse, i0, j0,
        )  # fmt: skip
        self.ends = np.full((5, 2), np.nan, np.float32)
        if row + s > last[0] or col + s > last[1]:
            for edge in range(5):
                ax, ay, dx, dy, low, high = clipped(self.window, edge)
                if low <= high:
                    for side, t in enumerate((low, high)):
                        y, x = self.y0 + ay + t * dy, self.x0 + ax + t * dx
                        self.ends[edge, side] = terrain.read(0, y, y + 1, x, x + 1)[0, 0]

    def read(self, terrain: Terrain) -> Heights:
        """The heights of the window's samples on its lattice."""
        return np.ascontiguousarray(terrain.read(*self.heights_at))


class Workplace(threading.local):
    """Work arrays, one set per thread."""

    def __init__(self) -> None:
        self.work: dict[int, Work] = {}

    def room(self, legs: int, marks: Marks) -> Work:
        """Arrays for a diamond's window."""
        side = max(legs << (FINER + 1), TILE) + 2  # (windows on the coarsest level are at most one tile)
        need = max(2 * legs * legs + 8 * side, int(np.count_nonzero(marks)) + 64)
        if legs not in self.work or len(self.work[legs].mesh.x) < need:
            self.work[legs] = new_work(need, side)
        return self.work[legs]


def tins_of(
    terrain: Terrain, tins: Tins, row: int, col: int, workplace: Workplace
) -> tuple[NDArray[np.float64], Corners, Corners]:
    """The TINs of a diamond: vertices (v, 3) column, row, metres; triangles (t, 3) of its top triangles 0 and 1.

    They are wound positively in (column, row).

    Raises:
        OrographError: its marks do not form a TIN. DamagedChunkError: as ``terrain.read``.
    """
    at = Place(terrain, row, col, tins.legs)
    bit = EDGE if at.window.shape else SQUARE
    marks = np.ascontiguousarray(tins.marks(at.octave, *at.heights_at[1:]) & bit)
    work = workplace.room(tins.legs, marks)
    if triangulate(at.window, work, at.read(terrain), at.ends, marks) < 0:
        raise OrographError(f"The marks of the diamond at row {row}, column {col} do not form TINs.", path=terrain.name)
    vertices, first, second = patches(work.mesh)
    vertices[:, 0] += at.x0
    vertices[:, 1] += at.y0
    return vertices, first, second


NUMBERS = ("error", "first", "second", "legs", "vertices", "full")
"""Results for a diamond: the error of its TINs, the triangles of each, the vertices on its legs and in total, and the
triangles of full resolution there."""


class Made(NamedTuple):
    """The TINs of some diamonds.

    Attributes:
        numbers: (d, 6) float64 (``NUMBERS``). windows: (d, 4) rows and columns of each one's window on its lattice,
            half-open. chosen: which samples of the windows are vertices, a bit each, whole bytes for each window.
    """

    numbers: NDArray[np.float64]
    windows: Integers
    chosen: NDArray[np.uint8]


def below(octave: int, kind: int, legs: int) -> int | None:
    """The octave whose marks give the vertices on the legs of a level's diamonds; None: all samples are vertices."""
    if kind == diamonds.SQUARE:
        return octave
    return octave - 1 if octave > legs.bit_length() - 1 else None


class Maker:
    """Makes the TINs of diamonds, one by one, from any thread.

    Args:
        terrain: the ground. legs: segments along a leg of the finest patches.
        marks: returns the marks of the levels below.
    """

    def __init__(self, terrain: Terrain, legs: int, marks: MarksOf) -> None:
        self.terrain, self.legs, self.marks = terrain, legs, marks
        self._workplace = Workplace()

    def made(self, rows: Integers, cols: Integers) -> Made:
        """The TINs of diamonds of one level."""
        numbers, windows, chosen = np.zeros((len(rows), len(NUMBERS))), np.zeros((len(rows), 4), np.int64), []
        d = 0
        while d < len(rows):
            end = self._beside(rows, cols, d)
            if end > d:
                numbers[d:end], windows[d:end], vertices = self._several(int(rows[d]), cols[d:end])
            else:
                numbers[d], windows[d], marks = self._one(int(rows[d]), int(cols[d]))
                end, vertices = d + 1, np.packbits(marks.view(bool))
            chosen.append(vertices.ravel())
            d = end
        return Made(numbers, windows, np.concatenate([np.zeros(0, np.uint8), *chosen]))

    def _beside(self, rows: Integers, cols: Integers, d: int) -> int:
        """The end of the diamonds that can be made together with diamond d: uncut, in its row, on all samples."""
        shape, row, s = self.terrain.grid.shape, int(rows[d]), int(diamonds.spacing(rows[d], cols[d]))
        last_row, last_col = (side - 1 for side in shape)
        if lattice(shape, s.bit_length() - 1, self.legs) or row < s or row + s > last_row:
            return d
        end = min(d + TOGETHER, len(rows))
        good = (rows[d:end] == row) & (cols[d:end] >= s) & (cols[d:end] + s <= last_col)
        return end if good.all() else d + int(np.argmin(good))

    def _several(self, row: int, cols: Integers) -> tuple[NDArray[np.float64], Integers, Marks]:
        """Make consecutive diamonds of a row: numbers, windows and vertices, as bits."""
        at = Place(self.terrain, row, int(cols[0]), self.legs)
        w, (_, i0, i1, _, _) = at.window, at.heights_at
        first = cols - w.s
        window = i0, i1, int(first[0]), int(first[-1]) + 2 * w.s + 1
        heights = np.ascontiguousarray(self.terrain.read(0, *window))
        source, given, bit = below(at.octave, w.shape, self.legs), np.zeros((1, 1), np.uint8), np.uint8(0)
        if source is not None:
            given = np.ascontiguousarray(self.marks(source, *window))
            bit = EDGE if w.shape == diamonds.SQUARE else SQUARE
        odd = 1 - w.shape
        axes = np.asarray(triangles.axis(cols, row, w.s << odd, odd), np.int64) + np.zeros(len(cols), np.int64)
        work = self._workplace.room(self.legs, given[:0])
        numbers, chosen = make_row(
            w, work, first, axes, read_only(heights), read_only(given), bit, 2 * self.legs**2, LIMIT
        )  # fmt: skip
        numbers[:, 0] *= ROUNDING
        windows = np.stack([np.full_like(first, i0), np.full_like(first, i1), first, first + 2 * w.s + 1], -1)
        return numbers, windows, chosen

    def _one(self, row: int, col: int) -> tuple[tuple[float, ...], tuple[int, ...], Marks]:
        """Make a diamond: its numbers, its window, and its vertices there."""
        terrain = self.terrain
        at = Place(terrain, row, col, self.legs)
        heights = at.read(terrain)
        marks = np.zeros(heights.shape, np.uint8)
        self._put_legs(at, marks)
        given = int(marks.sum())
        work = self._workplace.room(self.legs, marks)
        count, known = simplify(at.window, work, heights, at.ends, marks, 2 * self.legs**2, LIMIT)
        if count < 0:
            raise OrographError(f"The diamond at row {row}, column {col} has no TINs.", path=terrain.name)
        if at.window.step > 1:
            heights, known = terrain.read(0, at.y0, at.y1 + 1, at.x0, at.x1 + 1), -1.0
        error = float(deviation(work.mesh, np.ascontiguousarray(heights), known)) * ROUNDING
        first, second, whole = sizes(work.mesh)
        chosen = marks.astype(bool)
        numbers = error, int(first), int(second), given, int(chosen.sum()), int(whole)
        return numbers, at.heights_at[1:], chosen.view(np.uint8)

    def _put_legs(self, at: Place, marks: Marks) -> None:
        """Mark the vertices on a diamond's legs, which are those on the hypotenuses below."""
        shape, kind = self.terrain.grid.shape, at.window.shape
        source = below(at.octave, kind, self.legs)
        if source is None:
            legs_of(at.window, np.zeros((1, 1), np.uint8), 1, 0, marks)
            return
        ratio = 1 << (lattice(shape, at.octave, self.legs) - lattice(shape, source, self.legs))
        whole = self.terrain.shape(lattice(shape, source, self.legs))
        spans = [
            (first * ratio, min((first + count - 1) * ratio, last - 1) + 1)
            for first, count, last in zip((at.window.first_i, at.window.first_j), marks.shape, whole, strict=True)
        ]
        given = np.ascontiguousarray(self.marks(source, *spans[0], *spans[1]))
        bit = int(EDGE if kind == diamonds.SQUARE else SQUARE)
        legs_of(at.window._replace(first_i=0, first_j=0), given, ratio, bit, marks)
