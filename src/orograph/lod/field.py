"""The data that methods refine: the vertices of the hierarchy with their diamonds' errors and spheres, in pages, out of
core.

A vertex (row, col) of octave k lives in one page of level min(k, top): a square of 256 × 256 entries of four float32,
(height, error, radius, color error), so that one look-up gives all that decides about its diamond, and coarse vertices
share pages with each other (the hierarchical layout of Lindstrom & Pascucci 2002, by tiles). Kernels look pages up in a
table; an absent page is noted as a *miss* and its diamonds count as accurate; the method reads the missed pages and
refines again until nothing is missed. Memory is bounded: the least recently used pages leave first.

In a page: height is filled where the sample is missing (spheres need one); error as in ``store.diamond_table`` (+inf
mixed); radius negative if the diamond is empty; color error c as −1 − c if the vertex's own sample is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.errors import UsageError
from orograph.lod.method import check_surface
from orograph.lod.pages import BEYOND, PAGE_BYTES, SHIFT, SIDE, Pages, find
from orograph.parallel import map_ordered
from orograph.slots import Slots
from orograph.store.diamond_table import DiamondTable
from orograph.store.terrain import Terrain, level_shape

__all__ = ["ColorErrors", "Field", "Pages", "Vertices", "find"]

ColorErrors = Callable[[int, int, int, int, int], NDArray[np.float32]]


class Vertices:
    """The vertices of a terrain by pages, read on demand.

    Args:
        terrain: the terrain. kind, color: as for ``Field``.

    Attributes:
        shapes: (rows, cols) of every level; the top level is a padded square. counts: of its pages.
        corners: float32 (2, 2), heights of the square's corners (NaN where missing).

    Raises:
        UsageError: the terrain has no surface.
        StoreError: the store lacks the errors of diamonds.
    """

    def __init__(self, terrain: Terrain, kind: str = "exact", color: ColorErrors | None = None) -> None:
        check_surface(terrain)
        self.terrain, self.color = terrain, color
        self.diamonds: DiamondTable = terrain.derived("diamonds", error=cast(ErrorKind, kind))
        self.top = terrain.levels - 1
        self.shapes = [level_shape(terrain.grid.shape, level) for level in range(self.top)]
        side = (1 << (terrain.n - self.top)) + 1
        self.shapes.append((side, side))
        self.counts = [(-(-r // SIDE), -(-c // SIDE)) for r, c in self.shapes]
        tiles = terrain.tiles(0)
        lowest = terrain.height_range[0]
        self._fill = np.where(np.isnan(tiles.minimum), np.float32(0.0 if np.isnan(lowest) else lowest), tiles.minimum)
        rows, cols = terrain.shape(self.top)
        top = terrain.read(self.top, 0, rows, 0, cols)
        self.corners = np.array([[top[0, 0], top[0, -1]], [top[-1, 0], top[-1, -1]]], np.float32)

    def page(self, level: int, i: int, j: int, side: int = SIDE) -> NDArray[np.float32]:
        """Height, error, radius and color error (side, side, 4) of page (i, j) of a level, from 256 times (i, j) on.

        Raises:
            StoreError, DamagedChunkError: as ``terrain.read``.
        """
        rows, cols = self.shapes[level]
        row0, col0 = i * SIDE, j * SIDE
        row1, col1 = min(row0 + side, rows), min(col0 + side, cols)
        have = self.terrain.shape(level)
        # The top level is a padded square: beyond the raster its last samples are repeated.
        r0, c0 = min(row0, have[0] - 1), min(col0, have[1] - 1)
        heights = self.terrain.read(level, r0, min(row1, have[0]), c0, min(col1, have[1]))
        i_at = np.minimum(np.arange(row0, row1), have[0] - 1) - r0
        j_at = np.minimum(np.arange(col0, col1), have[1] - 1) - c0
        heights = heights[np.ix_(i_at, j_at)]
        missing = np.isnan(heights)
        if missing.any():
            y, x = np.nonzero(missing)
            shape = self.terrain.grid.shape
            y_tile = np.minimum((y + row0) << level, shape[0] - 1) >> SHIFT
            x_tile = np.minimum((x + col0) << level, shape[1] - 1) >> SHIFT
            heights = heights.copy()
            heights[y, x] = self._fill[
                np.minimum(y_tile, self._fill.shape[0] - 1), np.minimum(x_tile, self._fill.shape[1] - 1)
            ]
        data = np.zeros((side, side, 4), np.float32)
        data[..., 2] = -1.0  # empty, where the level has nothing
        here = data[: row1 - row0, : col1 - col0]
        here[..., 0] = heights
        here[..., 1], here[..., 2] = self.diamonds.read(level, row0, row1, col0, col1)
        color = 0.0 if self.color is None else self.color(level, row0, row1, col0, col1)
        here[..., 3] = np.where(missing, -1.0 - color, color)
        return data


class Field:
    """The pages of a terrain, as many as memory allows.

    Args:
        terrain: the terrain to refine.
        kind: which error: exact, wedgie, midpoint.
        color: ``color(level, row0, row1, col0, col1)``, color errors in the layout of ``store.diamond_table``.
        max_memory: bytes of pages.
        jobs: threads that read.

    Attributes:
        pages: for kernels.
        tiles_read: how many pages were read so far.
        corners: float32 (2, 2), heights of the square's corners (NaN where missing).

    Raises:
        UsageError: the terrain has no surface, or memory is too small for the coarsest pages.
    """

    def __init__(
        self,
        terrain: Terrain,
        kind: str = "exact",
        *,
        color: ColorErrors | None = None,
        max_memory: int = 1 << 30,
        jobs: int | None = None,
    ) -> None:
        self.vertices = Vertices(terrain, kind, color)
        rows, cols = terrain.grid.shape
        self.terrain, self.jobs = terrain, jobs
        self.n, self.top = terrain.n, self.vertices.top
        counts = self.vertices.counts
        width = [((1 << (self.n - level)) >> SHIFT) + 1 for level in range(self.top + 1)]
        base = np.concatenate([[0], np.cumsum(np.square(width))])
        table = np.full(base[-1], BEYOND, np.int32)
        for (r, c), side, begin in zip(counts, width, base):
            table[begin : begin + side * side].reshape(side, side)[:r, :c] = -1
        slots = int(min((table == -1).sum(), max(1, max_memory // PAGE_BYTES)))
        if slots < counts[-1][0] * counts[-1][1]:
            raise UsageError(f"{max_memory >> 20} MiB are too few for the coarsest tiles; allow at least 16 MiB.")
        data = _aligned((slots, SIDE, SIDE, 4))
        i = np.arange(SIDE)
        # Blocks of 16 × 16 entries, in them lines of 2 × 2.
        down, across = ((i & 0xF0) << s | (i & 14) << t | (i & 1) << u for s, t, u in ((8, 4, 1), (4, 1, 0)))
        self.pages = Pages(
            data, data.reshape(-1), table, base[:-1].astype(np.int64), np.array(width, np.int64), down * 4, across * 4,
            np.zeros(slots, np.uint8), np.zeros(2 * len(table) + 64, np.int32), np.zeros(1, np.int64),
            np.array([rows - 1, cols - 1, self.top], np.int64),
        )  # fmt: skip
        self.slots: Slots[int] = Slots(slots)
        self._round = 0
        self.tiles_read = 0
        self.corners = self.vertices.corners

    @property
    def resident(self) -> int:
        """Pages in memory."""
        return len(self.slots)

    def begin(self) -> None:
        """Begin a new round: nothing is used or requested yet."""
        self._round += 1
        self.pages.used[:] = 0
        self._asked()

    def _asked(self) -> NDArray[np.int64]:
        """Return the requested pages, and clear the requests."""
        if self.pages.count[0] == 0:
            return np.zeros(0, np.int64)
        asked = np.flatnonzero(self.pages.table == -2)
        self.pages.table[asked] = -1
        self.pages.count[0] = 0
        return asked

    def fetch(self, *, resumes: bool = False, most: int | None = None) -> bool:
        """Read the pages missed since ``begin``; returns whether there were any.

        Args:
            resumes: the refinement continues from where it missed them and asks again for what it still lacks, so any
                other page may leave, and only as many are read as fit.
            most: with ``resumes``, the maximum to read.

        Raises:
            UsageError: the pages of one refinement do not fit into the allowed memory.
        """
        wanted = self._asked()
        count = len(wanted)
        self.slots.touch(np.flatnonzero(self.pages.used == 1), self._round)
        if count == 0:
            return False
        before = self._round + 1 if resumes else self._round
        room = self.slots.room(before)
        if resumes:
            wanted = wanted[: room if most is None else min(most, room)]
            count = len(wanted)
        if room < count:
            raise UsageError(
                f"One view needs more than the {self.slots.capacity} tiles that fit into "
                f"{self.slots.capacity * PAGE_BYTES >> 20} MiB.",
                remedy="Allow more memory (`max_memory`), or a larger tolerance.",
            )
        taken = [(page, self._take(page, before)) for page in wanted.tolist()]
        try:
            for (page, slot), _ in zip(taken, map_ordered(self._load, taken, self.jobs), strict=True):
                self.pages.table[page] = slot
                self.slots.last[slot] = self._round
        except BaseException:
            for page, _ in taken:
                if self.pages.table[page] < 0:
                    self.slots.release(page)
            raise
        self.tiles_read += count
        return True

    def _take(self, page: int, before: int) -> int:
        """A held slot to read a page into, −1 if there is none; the page that had it is forgotten."""
        slot, gone = self.slots.take(page, before)
        if gone is not None:
            self.pages.table[gone] = -1
        return slot

    def _load(self, what: tuple[int, int]) -> None:
        page, slot = what
        level = int(np.searchsorted(self.pages.base, page, side="right")) - 1
        i, j = divmod(page - int(self.pages.base[level]), int(self.pages.width[level]))
        place = self.pages.down[:, None] + self.pages.across >> 2
        self.pages.data[slot].reshape(-1, 4)[place] = self.vertices.page(level, i, j)


def _aligned(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """An array aligned to the processor's pages, so that no line of entries straddles two.

    ``np.empty``, because NumPy requests huge pages there (Linux), which halves the time of a large refinement.
    """
    size = int(np.prod(shape))
    room = np.empty(size + 4096 // 4, np.float32)
    skip = -room.ctypes.data % 4096 // 4
    return room[skip : skip + size].reshape(shape)
