"""A triangle rasteriser: shows a mesh as a camera sees it, including holes, cracks and T-junctions.

Vertices may lie anywhere, on samples of the terrain or between; triangles may overlap and face either way. The mesh is
projected and sorted by tiles of the picture once (``raster_setup``); then any area and any position is drawn from its
tiles alone (``raster_scan``), tiles over threads. The triangle that a sample shows depends only on the mesh and the
camera: areas, tiles and threads make no difference to the bit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.parallel import for_each, map_ordered
from orograph.rendering.cpu.raster_scan import draw_tile, sample_tile
from orograph.rendering.cpu.raster_setup import (
    GUARD,
    PIECES,
    Camera,
    Mesh,
    Tiling,
    cut_triangles,
    find_unplaced,
    project,
    sort_into_tiles,
)
from orograph.rendering.gbuffer import Area, GBuffer
from orograph.rendering.projection import Projection

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]

BLOCK = 1 << 15
"""Vertices or triangles that a thread takes at a time."""

LEVEL, MOST = 6, 4096
"""Tiles are 2^LEVEL pixels a side, or more in pictures that would have more than MOST of them."""


class MeshSurface:
    """A triangle mesh seen by a camera; a ``Surface`` whose objects are triangles.

    Args:
        vertices: (n, 3) float64, sample coordinates: column, row, true height in metres. Triangles with a vertex that
            is not finite are not drawn.
        triangles: (m, 3) int32, indices into ``vertices``; both faces are drawn.
        projection: of the whole picture.
        jobs: threads (default: all processors).

    Raises:
        UsageError: the picture is more than 131,072 pixels wide or high.
    """

    def __init__(self, vertices: Array, triangles: Triangles, projection: Projection, jobs: int | None = None) -> None:
        if max(projection.width, projection.height) > GUARD:
            raise UsageError(
                f"A mesh can be drawn in pictures of up to {GUARD} × {GUARD} pixels, not {projection.width} × "
                f"{projection.height}."
            )
        self.projection, self.jobs = projection, jobs
        self._camera = Camera.of(projection)
        self._tiling = _tiling(projection.width, projection.height)
        self._mesh = self._projected(np.ascontiguousarray(vertices), np.ascontiguousarray(triangles))
        self._numbers, self._starts = self._sorted()

    @property
    def side(self) -> int:
        return 1 << self._tiling.level

    def draw(self, area: Area) -> GBuffer:
        first_row, last_row, first_col, last_col = area
        out = GBuffer.empty((last_row - first_row, last_col - first_col))
        side = self.side

        def draw(place: tuple[int, int]) -> None:
            row, col = place
            top, bottom = max(row * side, first_row), min((row + 1) * side, last_row)
            left, right = max(col * side, first_col), min((col + 1) * side, last_col)
            part = np.s_[top - first_row : bottom - first_row, left - first_col : right - first_col]
            draw_tile(
                self._camera, self._mesh, self._of_tile(row * self._tiling.cols + col), left, right, top, bottom,
                out.depth[part], out.objects[part],
            )  # fmt: skip

        rows, cols = range(first_row // side, -(-last_row // side)), range(first_col // side, -(-last_col // side))
        for_each(draw, [(row, col) for row in rows for col in cols], self.jobs)
        return out

    def at(self, px: Array, py: Array) -> GBuffer:
        out, level, cols = GBuffer.empty(px.shape), self._tiling.level, self._tiling.cols
        inside = np.flatnonzero((px >= 0) & (px < self.projection.width) & (py >= 0) & (py < self.projection.height))
        tiles = (py[inside].astype(np.int64) >> level) * cols + (px[inside].astype(np.int64) >> level)
        order = np.argsort(tiles, kind="stable")
        inside, tiles = inside[order], tiles[order]
        first = np.flatnonzero(np.diff(tiles, prepend=-1))
        for tile, which in zip(tiles[first].tolist(), np.split(inside, first[1:])):
            depth, objects = out.depth[which], out.objects[which]
            sample_tile(
                self._camera, self._mesh, self._of_tile(tile), level, (tile % cols) << level, (tile // cols) << level,
                px[which], py[which], depth, objects,
            )  # fmt: skip
            out.depth[which], out.objects[which] = depth, objects
        return out

    def _of_tile(self, tile: int) -> NDArray[np.int32]:
        return self._numbers[self._starts[tile] : self._starts[tile + 1]]

    def _projected(self, vertices: Array, triangles: Triangles) -> Mesh:
        """The projected mesh, with the pieces of the triangles that must be cut."""
        screen, depth = np.empty((len(vertices), 2), np.int32), np.empty(len(vertices))
        mesh = Mesh(vertices, triangles, screen, depth, np.empty((0, 3, 2), np.int32), np.empty(0, np.int32))
        counts = self._by_spans(
            len(vertices), lambda first, last: project(self._camera, vertices, first, last, screen, depth)
        )
        if not sum(counts):
            return mesh
        found = np.empty(len(triangles), np.int32)
        counts = self._by_spans(
            len(triangles), lambda first, last: find_unplaced(self._camera, mesh, first, last, found[first:last])
        )
        unplaced = np.concatenate([found[BLOCK * k : BLOCK * k + n] for k, n in enumerate(counts)])
        pieces, owners = np.empty((PIECES * len(unplaced), 3, 2), np.int32), np.empty(PIECES * len(unplaced), np.int32)
        n = cut_triangles(self._camera, mesh, unplaced, pieces, owners)
        return mesh._replace(pieces=pieces[:n].copy(), owners=owners[:n].copy())

    def _by_spans(self, count: int, work: Callable[[int, int], int]) -> list[int]:
        """The results of ``work`` for each span of ``count`` items, by all threads."""
        return list(map_ordered(lambda span: work(*span), _spans(count), self.jobs))

    def _sorted(self) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """The numbers of triangles and pieces tile by tile, and the offset of each tile's (tiles + 1,)."""
        tiling, mesh = self._tiling, self._mesh
        spans = _spans(len(mesh.triangles)) + [(-last, -first) for first, last in _spans(len(mesh.pieces))]

        def sort(cursors: NDArray[np.int64], numbers: NDArray[np.int32], write: bool) -> None:
            for_each(
                lambda k: sort_into_tiles(mesh, tiling, *spans[k], cursors[k], numbers, write),
                range(len(spans)), self.jobs,
            )  # fmt: skip

        counts = np.zeros((len(spans), tiling.rows * tiling.cols), np.int64)
        sort(counts, np.empty(0, np.int32), False)
        ends = np.cumsum(counts.T.ravel()).reshape(-1, len(spans))  # each tile's numbers, in the order of the spans
        numbers = np.empty(int(ends[-1, -1]), np.int32)
        sort(np.ascontiguousarray(ends.T - counts), numbers, True)
        return numbers, np.concatenate([np.zeros(1, np.int64), ends[:, -1]])


def _tiling(width: int, height: int) -> Tiling:
    level = LEVEL
    while -(-width >> level) * -(-height >> level) > MOST:
        level += 1
    return Tiling(level, -(-height >> level), -(-width >> level))


def _spans(count: int) -> list[tuple[int, int]]:
    return [(first, min(first + BLOCK, count)) for first in range(0, max(count, 1), BLOCK)]
