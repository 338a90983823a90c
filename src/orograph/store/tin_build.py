"""TINs of patches made bottom up: level by level of the hierarchy, diamond by diamond, each from those below it.

Per diamond the four patches below become two above at half the triangles (Cignoni et al. 2003, sec. 3). The vertices on
the diamond's legs were decided by the diamonds below, whose hypotenuses these are, and stay; those on its hypotenuse
move along it only. Then the TINs' error is measured anew, against all full-resolution samples in the diamond and all
crossings of its edges with the surface's, and made no less than the children's. Diamonds of a level touch each other
nowhere but in vertices that are decided, so they may be made in any order, by any number of threads.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.folders import held
from orograph.hierarchy import diamonds, triangles
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress, Task
from orograph.store.diamonds import blank_top, place
from orograph.store.terrain import TILE, Heights, Terrain
from orograph.store.tin_kernels import Work, deviation, new_work, patches, simplify, sizes, triangulate
from orograph.store.tin_windows import Window, clipped, legs_of, look
from orograph.store.tins import EDGE, FINER, MOST_OCTAVE, NO_TIN, SQUARE, Marks, MemoryTins, Tins, lattice, octaves

LIMIT = 1e-6
"""Metres: no vertex is inserted for less."""

ROUNDING = 1.0 + 1e-6
"""What is measured counts as so much more, for crossings nearer to a sample than can be told."""

BAND = 1 << 24
"""Samples of the bands in which the finest diamonds are looked at, about."""

AT_ONCE = 1 << 17
"""Diamonds of a band of a level that is made at once, about: what it takes besides the result follows from this."""

CHUNK = 32
"""Diamonds of a task."""

Integers = NDArray[np.int64]
Corners = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Figures:
    """How the TINs of a level came out.

    Attributes:
        octave, kind: of its diamonds (``hierarchy.diamonds``). diamonds: how many have TINs. triangles: of all.
        below: of the patches below them. legs: vertices on legs, which could not be moved. vertices: of all.
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


class Place:
    """Where a diamond is: its window, and the window on the raster.

    Args:
        terrain: the ground. row, col: the diamond. legs: of the finest patches.
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
    """Arrays to work in, of each thread its own."""

    def __init__(self) -> None:
        self.work: dict[int, Work] = {}

    def room(self, legs: int, marks: Marks) -> Work:
        """Arrays for a diamond's window."""
        side = max(legs << (FINER + 1), TILE) + 2  # (windows on the coarsest level are of a tile at most)
        need = max(2 * legs * legs + 8 * side, int(np.count_nonzero(marks)) + 64)
        if legs not in self.work or len(self.work[legs].mesh.x) < need:
            self.work[legs] = new_work(need, side)
        return self.work[legs]


def tins_of(
    terrain: Terrain, tins: Tins, row: int, col: int, workplace: Workplace
) -> tuple[NDArray[np.float64], Corners, Corners]:
    """The TINs of a diamond: vertices (v, 3) column, row, metres; triangles (t, 3) of its top triangles 0 and 1.

    They turn positively in (column, row).

    Raises:
        OrographError: its marks make no TIN. DamagedChunkError: as ``terrain.read``.
    """
    at = Place(terrain, row, col, tins.legs)
    bit = EDGE if at.window.shape else SQUARE
    marks = np.ascontiguousarray(tins.marks(at.octave, *at.heights_at[1:]) & bit)
    work = workplace.room(tins.legs, marks)
    if triangulate(at.window, work, at.read(terrain), at.ends, marks) < 0:
        raise OrographError(f"The TINs of the diamond at row {row}, column {col} are none.", path=terrain.name)
    vertices, first, second = patches(work.mesh)
    vertices[:, 0] += at.x0
    vertices[:, 1] += at.y0
    return vertices, first, second


class Building:
    """TINs that are being made, octave by octave.

    Args:
        terrain: the ground. legs: of the finest patches.

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
        self._workplace = Workplace()
        self._levels: dict[int, Heights] = {}

    def level(self, octave: int, kind: int, jobs: int | None, task: Task | None = None) -> Figures:
        """Make a level's TINs, by bands of rows of diamonds.

        Args:
            task: is told of each band (``bands``).
        """
        totals, largest = np.zeros(5, np.int64), 0.0
        per = self._rows_at_once(octave)
        for first in range(0, (1 << (self.n - octave)) + 1, per):
            counts, error = self._band(octave, kind, *self._diamonds(octave, kind, first, first + per), jobs)
            totals, largest = totals + counts, max(largest, error)
            for release in self._releases:
                release()
            if task is not None:
                task.advance()
        made, count, below, legs, vertices = (int(total) for total in totals)
        return Figures(octave, kind, made, count, below, legs, vertices, largest)

    def bands(self, octave: int) -> int:
        """In how many bands a level is made."""
        return -(-((1 << (self.n - octave)) + 1) // self._rows_at_once(octave))

    def _rows_at_once(self, octave: int) -> int:
        """Rows of diamonds of a band."""
        return max(2, AT_ONCE >> (self.n - octave))

    def _band(self, octave: int, kind: int, rows: Integers, cols: Integers, jobs: int | None) -> tuple[Integers, float]:
        """Make the TINs of some diamonds of a level; what ``Figures`` says of them."""
        finest = octave == self.legs.bit_length() - 1 and kind == diamonds.EDGE
        if finest:
            error, radius = self._first(rows, cols, octave)
            below = np.zeros(len(rows), np.int64)
        else:
            error, radius, below = self._from_children(rows, cols)
        if octave > MOST_OCTAVE:
            error[:] = np.inf
        todo = np.flatnonzero(np.isfinite(error) & (radius >= 0))
        parts = [todo[i : i + CHUNK] for i in range(0, len(todo), CHUNK)]

        def run(part: NDArray[np.intp]) -> NDArray[np.float64]:
            return np.array([self._one(int(rows[i]), int(cols[i])) for i in part]).reshape(-1, 6)

        found = np.concatenate([np.zeros((0, 6)), *map_ordered(run, parts, jobs)])
        error[todo] = np.maximum(error[todo], found[:, 0])
        i, j = rows >> octave, cols >> octave
        self.errors[octave][i, j], self.radii[octave][i, j] = error, radius
        self.triangles[octave][i[todo], j[todo]] = found[:, 1:3].astype(np.int32)
        if finest:
            below[todo] = found[:, 5].astype(np.int64)
        counts = len(todo), found[:, 1:3].sum(), below[todo].sum(), found[:, 3].sum(), found[:, 4].sum()
        return np.array(counts).astype(np.int64), float(found[:, 0].max(initial=0.0))

    def _diamonds(self, octave: int, kind: int, first: int = 0, end: int | None = None) -> tuple[Integers, Integers]:
        """Those of a level that have an area on the raster, in a half-open range of rows, counted in spacings."""
        s, side = 1 << octave, (1 << (self.n - octave)) + 1
        j = np.arange(side, dtype=np.int64)
        i = j[first:end]
        last_row, last_col = (side - 1 for side in self.terrain.grid.shape)
        odd, even = (j[j & 1 == 1], j[j & 1 == 0]) if kind == diamonds.EDGE else (np.zeros(0, np.int64), j[j & 1 == 1])
        # (Of edges the columns of odd rows are even, and the other way round; of squares both are odd.)
        pairs = [(i[i & 1 == 1], even), (i[i & 1 == 0], odd)]
        rows, cols = (
            np.concatenate([part.ravel() for part in of]) * s
            for of in zip(*(np.meshgrid(r, c, indexing="ij") for r, c in pairs))
        )
        down, right = np.maximum(rows - last_row, 0), np.maximum(cols - last_col, 0)
        there = down + right < s if kind == diamonds.EDGE else (down < s) & (right < s)
        return rows[there], cols[there]

    def _first(self, rows: Integers, cols: Integers, octave: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What is known of the finest diamonds before they are made: errors 0 or inf, and radii."""
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
        """The heights that vertices have where they are missing (``lod.field``)."""
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
        """The errors, radii and triangles that diamonds have from those below them."""
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

    def _one(self, row: int, col: int) -> tuple[float, int, int, int, int, int]:
        """Make a diamond's TINs: their error, the triangles of both, vertices on legs, vertices, and the triangles that
        full resolution has there."""
        terrain = self.terrain
        at = Place(terrain, row, col, self.legs)
        heights = at.read(terrain)
        marks = np.zeros(heights.shape, np.uint8)
        square = at.window.shape == diamonds.SQUARE
        below = at.octave if square else max(at.octave - 1, self.legs.bit_length() - 1)
        shape = terrain.grid.shape
        ratio = 1 << (lattice(shape, at.octave, self.legs) - lattice(shape, below, self.legs))
        finest = not square and below == at.octave
        legs_of(at.window, self.marks[below], ratio, 0 if finest else int(EDGE if square else SQUARE), marks)
        given = int(marks.sum())
        work = self._workplace.room(self.legs, marks)
        simplify(at.window, work, heights, at.ends, marks, 2 * self.legs**2, LIMIT)
        count = triangulate(at.window, work, heights, at.ends, marks)
        if count < 0:
            raise OrographError(f"The diamond at row {row}, column {col} has no TINs.", path=terrain.name)
        if at.window.step > 1:
            heights = terrain.read(0, at.y0, at.y1 + 1, at.x0, at.x1 + 1)
        error = float(deviation(work.mesh, np.ascontiguousarray(heights))) * ROUNDING
        _, i0, i1, j0, j1 = at.heights_at
        chosen = marks.astype(bool)
        # (Only vertices of its own are written: windows overlap.)
        self.marks[at.octave][i0:i1, j0:j1][chosen] |= SQUARE if square else EDGE
        first, second, whole = sizes(work.mesh)
        return error, int(first), int(second), given, int(chosen.sum()), int(whole)

    def finished(self, figures: Sequence[Figures]) -> MemoryTins:
        """What was made, in the layout of ``diamond_table``."""
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
    """Make the TINs of a terrain.

    A byte in five samples or so is held. The marks, some three bytes a sample, lie in scratch files where they are
    many, of which memory holds what is at work.

    Args:
        terrain: the ground. legs: segments along a finest patch's leg.
        jobs: threads (default: all processors); the result does not depend on them. progress: is told of levels.

    Raises:
        DamagedChunkError: as ``terrain.read``. OutputError: the disk that temporary files are on is full.
    """
    building = Building(terrain, legs)
    todo = [(k, kind) for k in building.marks for kind in (diamonds.EDGE, diamonds.SQUARE)]
    figures = []
    with progress.task("Making TINs", sum(building.bands(k) for k, _ in todo)) as task:
        for k, kind in todo:
            figures.append(building.level(k, kind, jobs, task))
    return building.finished(figures)
