"""Make TINs of patches bottom up: level by level of the hierarchy, diamond by diamond, each from those below it.

For each diamond, the four patches below become two above with half the triangles (Cignoni et al. 2003, sec. 3). The
vertices on the diamond's legs were decided by the diamonds below, whose hypotenuses these are, and stay; those on its
hypotenuse move only along it. Then the TINs' error is measured again, against all full-resolution samples in the
diamond and all crossings of its edges with the surface's, and made at least the children's. Diamonds of a level share
only vertices that are already decided, so they may be made in any order, by any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.folders import held
from orograph.hierarchy import diamonds, triangles
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress, Task, Within
from orograph.store.diamonds import blank_top, place
from orograph.store.terrain import TILE, Heights, Terrain
from orograph.store.tin_diamonds import NUMBERS, Integers, Made, Maker
from orograph.store.tin_greedy import put_marks
from orograph.store.tin_windows import look
from orograph.store.tins import EDGE, MOST_OCTAVE, NO_TIN, SQUARE, Marks, MemoryTins, lattice, octaves

BAND = 1 << 24
"""Approximate samples of the bands in which the finest diamonds are examined."""

AT_ONCE = 1 << 17
"""Approximate number of diamonds in a band of a level that is made at once; it determines the memory beyond the
result."""

CHUNK = 32
"""Diamonds per task."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Statistics of the TINs of a level.

    Attributes:
        octave, kind: of its diamonds (``hierarchy.diamonds``). diamonds: how many have TINs. triangles: the total.
        below: triangles of the patches below. legs: vertices on legs, which could not be moved. vertices: the total.
        error: the largest before saturation, metres.
    """

    octave: int
    kind: int
    diamonds: int
    triangles: int
    below: int
    legs: int
    vertices: int
    error: float


class Band(NamedTuple):
    """Diamonds of a level that are made together.

    Attributes:
        octave, kind: of the level. first: whether this is its first band. rows, cols: of the diamonds. error, radius,
            below: from the diamonds below. todo: which have TINs. numbers: their ``Made.numbers``, filled in by
            ``take``.
    """

    octave: int
    kind: int
    first: bool
    rows: Integers
    cols: Integers
    error: NDArray[np.float64]
    radius: NDArray[np.float64]
    below: Integers
    todo: NDArray[np.intp]
    numbers: NDArray[np.float64]

    def wanted(self) -> tuple[Integers, Integers]:
        """Rows and columns of the diamonds that have TINs."""
        return self.rows[self.todo], self.cols[self.todo]


class Building:
    """TINs under construction, octave by octave.

    Args:
        terrain: the ground. legs: segments along a leg of the finest patches.

    Attributes:
        marks: by octave. errors, radii: by octave, float64, at (row >> octave, col >> octave): inf where there is no
            TIN; negative radii where there is nothing. triangles: of both TINs of a diamond.
    """

    def __init__(self, terrain: Terrain, legs: int) -> None:
        self.terrain, self.legs, self.n = terrain, legs, terrain.n
        shape = terrain.grid.shape
        self.marks: dict[int, Marks] = {}
        self._releases: list[Callable[[], None]] = []
        for k in octaves(shape, legs):
            rows, cols = terrain.shape(lattice(shape, k, legs))
            room, release = held(rows * cols)
            self.marks[k] = room.reshape(rows, cols)
            self._releases.append(release)
        sides = {k: (1 << (self.n - k)) + 1 for k in self.marks}
        self.errors = {k: np.zeros((side, side)) for k, side in sides.items()}
        self.radii = {k: np.full((side, side), -1.0) for k, side in sides.items()}
        self.triangles = {k: np.zeros((side, side, 2), np.int32) for k, side in sides.items()}
        a, b, _, d, e, _ = terrain.grid.samples[:6]
        self._metric = np.array([a, d, b, e])
        tiles, lowest = terrain.tiles(0).minimum, terrain.height_range[0]
        self._fill = np.where(np.isnan(tiles), np.float32(0.0 if np.isnan(lowest) else lowest), tiles)
        self._levels: dict[int, Heights] = {}

    def level(self, octave: int, kind: int, run: Callable[[Band], None], task: Task | None = None) -> Figures:
        """Make a level's TINs, by bands of rows of diamonds.

        Args:
            run: makes the diamonds of a band and passes them to ``take``.
            task: receives progress by bands (``bands``).
        """
        totals, largest = np.zeros(5, np.int64), 0.0
        per = self._rows_at_once(octave)
        for first in range(0, (1 << (self.n - octave)) + 1, per):
            band = self._band(octave, kind, first, first + per)
            run(band)
            counts, error = self._taken(band)
            totals, largest = totals + counts, max(largest, error)
            for release in self._releases:
                release()
            if task is not None:
                task.advance()
        made, count, below, legs, vertices = (int(total) for total in totals)
        return Figures(octave, kind, made, count, below, legs, vertices, largest)

    def bands(self, octave: int) -> int:
        """The number of bands in which a level is made."""
        return -(-((1 << (self.n - octave)) + 1) // self._rows_at_once(octave))

    def _rows_at_once(self, octave: int) -> int:
        """Rows of diamonds of a band."""
        return max(2, AT_ONCE >> (self.n - octave))

    def _band(self, octave: int, kind: int, first: int, end: int) -> Band:
        """The diamonds of a band, with their values from the diamonds below."""
        rows, cols = self._diamonds(octave, kind, first, end)
        if octave == self.legs.bit_length() - 1 and kind == diamonds.EDGE:
            error, radius = self._first(rows, cols, octave)
            below = np.zeros(len(rows), np.int64)
        else:
            error, radius, below = self._from_children(rows, cols)
        if octave > MOST_OCTAVE:
            error[:] = np.inf
        todo = np.flatnonzero(np.isfinite(error) & (radius >= 0))
        numbers = np.zeros((len(todo), len(NUMBERS)))
        return Band(octave, kind, first == 0, rows, cols, error, radius, below, todo, numbers)

    def marks_of(self, octave: int, row0: int, row1: int, col0: int, col1: int) -> Marks:
        """The marks of a window of an octave's lattice."""
        return self.marks[octave][row0:row1, col0:col1]

    def take(self, band: Band, part: slice, made: Made) -> None:
        """Store the TINs of a part of a band's diamonds. Safe from any thread, for different parts."""
        band.numbers[part] = made.numbers
        bit = np.uint8(SQUARE if band.kind == diamonds.SQUARE else EDGE)
        put_marks(self.marks[band.octave], made.windows, made.chosen, bit)  # only its own vertices: windows overlap

    def _taken(self, band: Band) -> tuple[Integers, float]:
        """Record a band's diamonds, once all are taken; return their ``Figures``."""
        octave, todo, found, error, below = band.octave, band.todo, band.numbers, band.error, band.below
        error[todo] = np.maximum(error[todo], found[:, 0])
        i, j = band.rows >> octave, band.cols >> octave
        self.errors[octave][i, j], self.radii[octave][i, j] = error, band.radius
        self.triangles[octave][i[todo], j[todo]] = found[:, 1:3].astype(np.int32)
        if octave == self.legs.bit_length() - 1 and band.kind == diamonds.EDGE:
            below[todo] = found[:, 5].astype(np.int64)
        counts = len(todo), found[:, 1:3].sum(), below[todo].sum(), found[:, 3].sum(), found[:, 4].sum()
        return np.array(counts).astype(np.int64), float(found[:, 0].max(initial=0.0))

    def _diamonds(self, octave: int, kind: int, first: int = 0, end: int | None = None) -> tuple[Integers, Integers]:
        """The diamonds of a level that have an area on the raster, in a half-open range of rows, counted in
        spacings."""
        s, side = 1 << octave, (1 << (self.n - octave)) + 1
        j = np.arange(side, dtype=np.int64)
        i = j[first:end]
        last_row, last_col = (side - 1 for side in self.terrain.grid.shape)
        odd, even = (j[j & 1 == 1], j[j & 1 == 0]) if kind == diamonds.EDGE else (np.zeros(0, np.int64), j[j & 1 == 1])
        # (For edges the columns of odd rows are even, and vice versa; for squares both are odd.)
        pairs = [(i[i & 1 == 1], even), (i[i & 1 == 0], odd)]
        rows, cols = (
            np.concatenate([part.ravel() for part in of]) * s
            for of in zip(*(np.meshgrid(r, c, indexing="ij") for r, c in pairs))
        )
        down, right = np.maximum(rows - last_row, 0), np.maximum(cols - last_col, 0)
        there = down + right < s if kind == diamonds.EDGE else (down < s) & (right < s)
        return rows[there], cols[there]

    def _first(self, rows: Integers, cols: Integers, octave: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values of the finest diamonds before they are made: errors 0 or inf, and radii."""
        s, (high, wide) = 1 << octave, self.terrain.grid.shape
        count, squares = np.zeros((len(rows), 2), np.int64), np.zeros(len(rows))
        band = rows // (s * max(1, min(64, BAND // (s * wide))))
        for b in np.unique(band):
            here = np.flatnonzero(band == b)
            row0, row1 = max(int(rows[here].min()) - s, 0), min(int(rows[here].max()) + s + 1, high)
            heights = self.terrain.read(0, row0, row1, 0, wide)
            count[here], squares[here] = look(
                heights, row0, rows[here], cols[here], s, self._filled(rows[here], cols[here]), self._metric
            )
        mixed = count[:, 1] > 0
        return np.where(mixed, np.inf, 0.0), np.where(count[:, 0] > 0, np.sqrt(squares), -1.0)

    def _filled(self, rows: Integers, cols: Integers) -> NDArray[np.float64]:
        """The heights used for missing vertices (``lod.field``)."""
        last_row, last_col = (side - 1 for side in self.terrain.grid.shape)
        i, j = np.minimum(rows, last_row) // TILE, np.minimum(cols, last_col) // TILE
        i, j = np.minimum(i, self._fill.shape[0] - 1), np.minimum(j, self._fill.shape[1] - 1)
        return np.asarray(self._fill[i, j], np.float64)

    def _places(self, rows: Integers, cols: Integers) -> NDArray[np.float64]:
        """Diamonds' vertices (d, 3), metres, squeezed onto the raster and filled."""
        last_row, last_col = (side - 1 for side in self.terrain.grid.shape)
        r, c = np.minimum(rows, last_row), np.minimum(cols, last_col)
        z = self._heights(rows, cols)
        z = np.where(np.isnan(z), self._filled(rows, cols), z)
        a, d, b, e = self._metric
        return np.stack([a * c + b * r, d * c + e * r, z], -1)

    def _heights(self, rows: Integers, cols: Integers) -> NDArray[np.float64]:
        """Heights of the vertices of diamonds of one level, squeezed onto the raster."""
        if not len(rows):
            return np.zeros(0)
        k = min(int(diamonds.octave(rows[0], cols[0])), self.terrain.levels - 1)
        if k not in self._levels:
            self._levels[k] = self.terrain.read(k, 0, self.terrain.shape(k)[0], 0, self.terrain.shape(k)[1])
        whole = self._levels[k]
        i, j = np.minimum(rows >> k, whole.shape[0] - 1), np.minimum(cols >> k, whole.shape[1] - 1)
        return np.asarray(whole[i, j], np.float64)

    def _from_children(
        self, rows: Integers, cols: Integers
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], Integers]:
        """The errors, radii and triangles of diamonds from those below them."""
        here = self._places(rows, cols)
        error, radius, below = np.zeros(len(rows)), np.full(len(rows), -1.0), np.zeros(len(rows), np.int64)
        for k in range(4):
            r, c = diamonds.child(rows, cols, k, self.n)
            there = r >= 0
            rc, cc = r[there], c[there]
            if not len(rc):
                continue
            octave = int(diamonds.octave(rc[0], cc[0]))
            e, size = (of[octave][rc >> octave, cc >> octave] for of in (self.errors, self.radii))
            away = np.sqrt(np.square(self._places(rc, cc) - here[there]).sum(-1))
            error[there] = np.maximum(error[there], e)
            radius[there] = np.maximum(radius[there], np.where(size >= 0, away + size, -1.0))
            omega = triangles.child(*diamonds.top(rows[there], cols[there], k >> 1), k & 1)[3]
            below[there] += self.triangles[octave][rc >> octave, cc >> octave, omega >> 2]
        return error, radius * (1 + 1e-12), below

    def finished(self, figures: Sequence[Figures]) -> MemoryTins:
        """The result, in the layout of ``diamond_table``."""
        top = self.terrain.levels - 1
        tables: list[list[Heights]] = []
        for of, nothing in ((self.errors, 0.0), (self.radii, -1.0)):
            levels = [np.zeros((0, 0), np.float32) for _ in range(top)]
            levels.append(blank_top(self.terrain.grid.shape, np.float32, nothing))
            for k, found in of.items():
                signed = np.empty(found.shape, np.float32)
                for i in range(0, len(found), 64):
                    here = slice(i, i + 64)
                    values = np.where(np.isinf(found[here]), 0.0, found[here])
                    up = np.nextafter(values.astype(np.float32), np.float32(np.inf))
                    up = np.where(values == 0, np.float32(0), up)
                    there = np.where(np.isinf(found[here]), NO_TIN, up)
                    signed[here] = np.where(self.radii[k][here] < 0, np.float32(nothing), there)
                rows, cols = self.terrain.diamond_shape(min(k, top))
                if k < top:
                    levels[k] = np.ascontiguousarray(signed[:rows, :cols])
                else:
                    place(levels[top], signed, k, 0, 0, top)
            tables.append(levels)
        return MemoryTins(self.terrain, self.legs, self.marks, tables[0], tables[1], list(figures))


def make_tins(
    terrain: Terrain, legs: int, *, jobs: int | None = None, progress: Progress = SILENT
) -> MemoryTins:  # fmt: skip
    """Make the TINs of a terrain, in this process. See ``made_by``.

    Args:
        jobs: threads (default: all processors); the result does not depend on them.
    """

    def run(building: Building, band: Band, progress: Progress) -> None:
        rows, cols = band.wanted()
        maker = Maker(terrain, legs, building.marks_of)
        parts = [slice(i, i + CHUNK) for i in range(0, len(rows), CHUNK)]
        for part, made in zip(parts, map_ordered(lambda part: maker.made(rows[part], cols[part]), parts, jobs)):
            building.take(band, part, made)

    return made_by(terrain, legs, run, progress)


def made_by(
    terrain: Terrain, legs: int, run: Callable[[Building, Band, Progress], None], progress: Progress
) -> MemoryTins:  # fmt: skip
    """Make the TINs of a terrain.

    About one byte per five samples is held. The marks, about three bytes per sample, are in scratch files if there are
    many; memory holds only those in use.

    Args:
        terrain: the ground. legs: segments along a finest patch's leg.
        run: makes a band's diamonds and passes them to ``take``; reports progress within another task.
        progress: receives progress by levels.

    Raises:
        DamagedChunkError: as ``terrain.read``. OutputError: the disk for temporary files is full.
    """
    building = Building(terrain, legs)
    todo = [(k, kind) for k in building.marks for kind in (diamonds.EDGE, diamonds.SQUARE)]
    figures = []
    with progress.task("Making TINs", sum(building.bands(k) for k, _ in todo)) as task:
        within = Within(progress, Task())
        for k, kind in todo:
            figures.append(building.level(k, kind, lambda band: run(building, band, within), task))
    return building.finished(figures)
