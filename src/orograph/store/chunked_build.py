"""Make meshes of chunks from a terrain's heights (Ulrich 2002): first the levels of each vertex, then chunk by chunk.

The levels of a vertex are those whose error it reaches. They follow from the errors of diamonds (``midpoint``: the
vertical distance of a vertex from the middle of its hypotenuse, no less than that of its dependents). Chunks need
nothing else from each other, so they are made on demand, in any order, by any number of threads.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.folders import held
from orograph.hierarchy import diamonds
from orograph.store.chunk_code import encoded, mesh_of, step_of
from orograph.store.chunked import APART, PER_WORD, Chunk, Kind, Layout, Words, on_sides
from orograph.store.chunked_kernels import lowest, middle, write_walk
from orograph.store.terrain import TILE, Heights, Terrain

SHARE = 1 / 2
"""Default error of level 0, as a share of the median error of the finest vertices."""

BAND = 256
"""Rows of diamonds read at once."""

CORNERS = 1 << 16
"""Number of chunk corners whose heights in coarser meshes are cached."""

SEEN = 64
"""Maximum number of bands of the finest vertices used for the median."""

Integers = NDArray[np.int64]


class Reached(NamedTuple):
    """What ``MemoryChunks`` computes from all errors before it makes any chunk.

    Attributes:
        error: of level 0, metres. levels: those of all vertices (uint8), octave by octave.
    """

    error: float
    levels: NDArray[np.uint8]


class MemoryChunks:
    """The chunks of a terrain, each made on demand.

    About 1.4 bytes per sample are held; for large terrains in a temporary file, of which only the active parts are in
    memory.

    Args:
        terrain: the ground; its ``midpoint`` errors are needed. kind: of the chunks.
        reached: from another process with the same terrain; None: computed here.

    Attributes:
        layout: of the chunks. error: of level 0, metres. reached: for other processes.
        compressed: whether words are encoded by ``chunk_code``.

    Raises:
        StoreError: a store has no such errors. DamagedChunkError: as ``terrain.read``.
    """

    def __init__(self, terrain: Terrain, kind: Kind, reached: Reached | None = None) -> None:
        self.terrain, self.layout = terrain, Layout(terrain.grid.shape, kind.cells)
        self.compressed = kind.compressed
        self._table = terrain.derived("diamonds", error="midpoint") if terrain.n else None
        self.error = kind.finest or self._usual() if reached is None else reached.error
        self._step = step_of(self.error, max(map(abs, terrain.height_range)))
        self._places = self._offsets()
        self._levels = self._vertices() if reached is None else reached.levels
        self.reached = Reached(self.error, self._levels)
        self._corners: dict[tuple[int, int, int], float] = {}

    def chunk(self, level: int, i: int, j: int) -> Chunk:
        """Like ``StoredChunks.chunk``."""
        return mesh_of(self.words(level, i, j), self.layout, self.compressed, level, i, j)

    def words(self, level: int, i: int, j: int) -> Words:
        """Return the stored words of a chunk."""
        corners, side = self.layout.corners(level, i, j), self.layout.side(level)
        codes, places, known = self._walk(corners, level)
        places = np.concatenate([corners, places])
        known = np.concatenate([np.full(4, 255, np.uint8), known])
        heights = self._heights(places)
        hanging = self._skirt(places, heights, known, level, i, j, side)
        coarse = np.array([self._corner(level + 1, int(row), int(col)) for row, col in corners], np.float32)
        padded = np.zeros(-(-len(codes) // PER_WORD) * PER_WORD, np.uint32)
        padded[: len(codes)] = codes
        shifts = np.arange(0, 2 * PER_WORD, 2, dtype=np.uint32)
        packed = np.bitwise_or.reduce(padded.reshape(-1, PER_WORD) << shifts, axis=1)
        counts = np.array([len(codes), len(places) - 4], np.uint32)
        numbers = np.concatenate([heights, hanging, coarse]).astype(np.float32)
        words = np.concatenate([counts, packed.astype(np.uint32), numbers.view(np.uint32)])
        return encoded(words, self.layout, level, i, j, self._step) if self.compressed else words

    # ---- the levels of vertices ----

    def _usual(self) -> float:
        """Return the default error of level 0: a share of the median of the finest vertices' errors."""
        found = [errors[(errors > 0) & np.isfinite(errors) & (radii >= 0)] for errors, radii in self._bands(0, SEEN)]
        some = np.concatenate([np.zeros(0, np.float32), *found])
        return float(np.median(some)) * SHARE if len(some) else 1.0

    def _bands(self, level: int, most: int | None = None) -> Iterator[tuple[Heights, Heights]]:
        """Yield errors and radii of a level's diamonds in bands of rows; at most ``most`` bands, evenly spaced."""
        if self._table is None:
            return
        rows, cols = self.terrain.diamond_shape(level)
        starts = np.arange(0, rows, BAND)
        if most is not None:
            starts = starts[:: -(-len(starts) // most)]
        for row in starts.tolist():
            yield self._table.read(level, row, min(row + BAND, rows), 0, cols)

    def _offsets(self) -> Integers:
        """Return each octave's offset in the table of levels, its rows and columns (``chunked_kernels.level_of``)."""
        if self._table is None:
            return np.array([[0, 3, 3]], np.int64)
        shapes = [self.terrain.diamond_shape(level) for level in range(self.terrain.levels)]
        begins = np.cumsum([0, *(rows * cols for rows, cols in shapes)])
        return np.array([(at, *shape) for at, shape in zip(begins.tolist(), shapes)], np.int64)

    def _vertices(self) -> NDArray[np.uint8]:
        """Return the levels of all vertices."""
        if self._table is None:  # a raster of one cell, whose square has one diamond, squeezed onto it
            return np.full(9, 255, np.uint8)
        reached = self.error * 2.0 ** np.append(0.0, np.arange(1, self.layout.top + 1) - 0.5)
        last, rows, cols = self._places[-1].tolist()
        found, _ = held(last + rows * cols)
        for level, at in enumerate(self._places[:, 0].tolist()):
            for errors, radii in self._bands(level):
                levels = (1 + np.searchsorted(reached, errors, side="right")).astype(np.uint8)
                levels[np.isinf(errors)] = 255
                levels[radii < 0] = 0
                found[at : at + levels.size] = levels.reshape(-1)
                at += levels.size
        return found

    def _known(self, row: int, col: int) -> int:
        """Return the levels of one vertex."""
        k = min(int(diamonds.octave(row, col)), len(self._places) - 1)
        begin, rows, cols = self._places[k].tolist()
        i, j = row >> k, col >> k
        return int(self._levels[begin + i * cols + j]) if i < rows and j < cols else 0

    # ---- a chunk ----

    def _walk(self, corners: Integers, level: int) -> tuple[NDArray[np.uint8], Integers, NDArray[np.uint8]]:
        room = 1 << 11
        while True:
            codes, found, known = np.empty(4 * room, np.uint8), np.empty((room, 2), np.int64), np.empty(room, np.uint8)
            slots = np.full((4 * room, 2), -1, np.int64)
            count, vertices = write_walk(self._levels, self._places, corners, level, codes, found, known, slots)
            if count >= 0:
                return codes[:count], found[:vertices], known[:vertices]
            room *= 4

    def _heights(self, places: Integers) -> Heights:
        """Return the heights of vertices, squeezed onto the raster: each from the coarsest level that has it."""
        found = np.empty(len(places), np.float32)
        octave = np.minimum(diamonds.octave(*places.T), self.terrain.levels - 1)
        octave[(places == 0).all(1)] = self.terrain.levels - 1
        for k in np.unique(octave).tolist():
            here = np.flatnonzero(octave == k)
            rows, cols = self.terrain.shape(k)
            i, j = np.minimum(places[here, 0] >> k, rows - 1), np.minimum(places[here, 1] >> k, cols - 1)
            blocks = i // TILE * cols + j // TILE
            for block in np.unique(blocks).tolist():
                some = blocks == block
                r, c = i[some], j[some]
                r0, c0 = int(r.min()), int(c.min())
                found[here[some]] = self.terrain.read(k, r0, int(r.max()) + 1, c0, int(c.max()) + 1)[r - r0, c - c0]
        return found

    def _skirt(
        self, places: Integers, heights: Heights, known: NDArray[np.uint8], level: int, i: int, j: int, side: int
    ) -> Heights:
        """Return the lower end of the skirt at the vertices on the sides; NaN along the raster's border, which has no
        skirt."""
        low = np.full(len(places), np.nan, np.float32)
        last_row, last_col = (size - 1 for size in self.terrain.grid.shape)
        sides = on_sides(places, side, i, j)
        for number, on in enumerate(sides):
            across, along = (0, 1) if number % 2 == 0 else (1, 0)  # (the coordinate that is constant along it, …)
            fixed = int((i, j)[across] + number // 2) * side
            if not 0 < fixed < (last_row, last_col)[across]:
                continue
            here = np.flatnonzero(on)
            here = here[np.argsort(places[here, along], kind="stable")]
            first = int((i, j)[along]) * side
            end = min(first + side, (last_row, last_col)[along]) + 1
            window = (fixed, fixed + 1, first, end) if across == 0 else (first, end, fixed, fixed + 1)
            # A neighbour is coarser by at most APART levels and no coarser than its own border allows, and may be
            # moving to the next level.
            coarsest = min(int(diamonds.octave(fixed, 0)) - self.layout.p, level + APART)
            reach = min(coarsest + 1, self.layout.top) - level
            line = np.ascontiguousarray(self.terrain.read(0, *window).reshape(-1))
            ends = [[self._corner(level + 1 + m, *places[at].tolist()) for at in here[[0, -1]]] for m in range(reach)]
            result = np.empty(len(here), np.float32)
            lowest(
                places[here, along] - first, heights[here], known[here], line, np.array(ends).reshape(reach, 2), level,
                reach, result,
            )  # fmt: skip
            low[here] = np.fmin(low[here], np.nextafter(result, np.float32(-np.inf)))
        return low[sides.any(0)]

    def _corner(self, level: int, row: int, col: int) -> float:
        """Return the height of a chunk corner in the mesh of a coarser level (above the last level, its own height)."""
        key = level, row, col
        found = self._corners.get(key)
        if found is not None:
            return found
        if len(self._corners) >= CORNERS:
            self._corners = {}
        own = float(self._heights(np.array([[row, col]]))[0])
        whole = (row | col) % self.layout.side(min(level, self.layout.top)) == 0  # a chunk corner of that level
        if level <= self.layout.top and not whole and self._known(row, col) < level + 2:
            (lr, lc), (rr, rc) = ends = [tuple(map(int, diamonds.end(row, col, k))) for k in (0, 1)]
            left, right = (self._corner(level, *end) for end in ends)
            last_row, last_col = (size - 1 for size in self.terrain.grid.shape)
            own = float(middle(lr, lc, rr, rc, left, right, own, last_row, last_col))
        self._corners[key] = own
        return own
