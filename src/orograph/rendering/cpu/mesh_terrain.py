"""A tessellation as a terrain that is read by windows, for meshes of terrains larger than memory.

A window of level k holds the mesh's heights at every 2^k-th sample. If it is drawn by windows that show the *terrain*
within some pixels (``raycast.select``), the mesh is shown within the same number: consider half a cell of level k. If
the mesh does not split it, it is one of the hierarchy's triangles or part of a larger one, and the mesh is linear
there. If the mesh splits it, its corners are vertices of the mesh, which are samples of the terrain, and so are all
vertices inside; the window's error from the mesh is then its error from the terrain at some of its samples. (This is
accurate to a cell along the last row and column of a raster that is not 2^n + 1 samples a side, as in ``surface``.)

Where there is no triangle, heights are the terrain's: ground out of view, and holes. Heights in metres.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.store.levels import reduce_tiles
from orograph.store.terrain import TILE, Heights, Terrain, TileTable
from orograph.tessellation import Tessellation

Corners = NDArray[np.float64]

STRIP = 1 << 21
"""Samples that are read at a time for means."""

EDGE = 1e-12
"""Tolerance of barycentric coordinates for a sample that rounding puts beyond an edge."""

QUARTERS = 2
"""Means of level k use samples of level k − 2, five along each axis with the weights of the trapezoid rule."""


class MeshTerrain(Terrain):
    """The surface of a tessellation of ``terrain``, and around it the terrain.

    Args:
        tessellation: triangles between samples of the terrain.
        terrain: of the mesh.
    """

    def __init__(self, tessellation: Tessellation, terrain: Terrain) -> None:
        self.terrain, self.grid, self.name = terrain, terrain.grid, terrain.name
        self.vertical, self.remote = terrain.vertical, terrain.remote
        self._vertices, self._triangles = tessellation.vertices, tessellation.triangles

    @property
    def height_range(self) -> tuple[float, float]:
        return self.terrain.height_range  # a mesh's vertices are samples

    @property
    def valid_fraction(self) -> float:
        return self.terrain.valid_fraction

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        heights = np.array(self.terrain.read(level, row0, row1, col0, col1), np.float32)
        rows, cols = self.grid.shape
        interpolate(self._vertices, self._triangles, level, row0, col0, rows, cols, heights)
        heights.flags.writeable = False
        return heights

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        self.check_window(self.mean_shape(level), row0, row1, col0, col1)
        if level == 0:
            return self.read(0, row0, row1, col0, col1)
        means = np.empty((row1 - row0, col1 - col0), np.float32)
        tall = max(1, STRIP >> 2 * min(level, QUARTERS)) // max(1, col1 - col0) or 1
        for row in range(row0, row1, tall):
            end = min(row + tall, row1)
            means[row - row0 : end - row0] = self._means(level, row, end, col0, col1)
        return means

    def _means(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """``read_mean`` of a strip, from finer samples."""
        down = min(level, QUARTERS)
        times, finer = 1 << down, level - down
        # The last block of a side may have fewer samples: those repeated beyond the raster do not count.
        rows, cols = (-(-side >> finer) for side in self.grid.shape)
        r1, c1 = min(row1 * times + 1, rows), min(col1 * times + 1, cols)
        part = self.read(finer, row0 * times, r1, col0 * times, c1)
        weights = np.ones(times + 1)
        # (Up to level 2 the samples are the raster's own, without the next block's.)
        weights[[0, -1]] = (0.5, 0.5) if finer else (1.0, 0.0)
        shape = row1 - row0, col1 - col0
        total, weight = np.zeros(shape), np.zeros(shape)
        for i, down_weight in enumerate(weights):
            for j, across_weight in enumerate(weights):
                some = part[i::times, j::times][: shape[0], : shape[1]]
                here = total[: some.shape[0], : some.shape[1]], weight[: some.shape[0], : some.shape[1]]
                there = ~np.isnan(some)
                share = down_weight * across_weight
                here[0][there] += share * some[there]
                here[1][there] += share
        with np.errstate(invalid="ignore"):
            return np.asarray(total / weight, np.float32)

    def tiles(self, level: int) -> TileTable:
        table = self.terrain.tiles(level)
        return TileTable(*self._extremes[self._check(level)], table.error, table.valid)

    @cached_property
    def _extremes(self) -> list[tuple[Heights, Heights]]:
        """Lowest and highest height by tile of each level: a large triangle may exceed those of the ground below."""
        table = self.terrain.tiles(0)
        low, high = table.minimum.copy(), table.maximum.copy()
        widen(self._vertices, self._triangles, low, high)
        valid = table.valid
        found = [(low, high)]
        for _ in range(1, self.levels):
            low, high, valid = reduce_tiles(low, high, valid)
            found.append((low, high))
        return found


@kernel
def interpolate(
    vertices: Corners, triangles: NDArray[np.int32], level: int, row0: int, col0: int, rows: int, cols: int,
    heights: Heights,
) -> None:  # fmt: skip
    """Interpolate triangles at the samples of a window that they cover.

    A vertex on a sample gives its height to the bit.

    Args:
        vertices: (n, 3) float64, column, row, height in metres.
        triangles: (m, 3) int32.
        level: of the window: sample (i, j) is at row min((row0 + i)·2^level, rows − 1), and columns likewise.
        row0, col0: the window's first sample.
        rows, cols: of the raster.
        heights: (window rows, window cols) float32, overwritten where a triangle is.
    """
    step = 1 << level
    for k in range(len(triangles)):
        a, b, c = vertices[triangles[k, 0]], vertices[triangles[k, 1]], vertices[triangles[k, 2]]
        abx, aby, acx, acy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
        area = abx * acy - acx * aby
        if area == 0.0:
            continue
        first_row, last_row = _span(min(a[1], b[1], c[1]), max(a[1], b[1], c[1]), step, row0, rows, len(heights))
        first_col, last_col = _span(min(a[0], b[0], c[0]), max(a[0], b[0], c[0]), step, col0, cols, heights.shape[1])
        for i in range(first_row, last_row + 1):
            y = min((row0 + i) * step, rows - 1) - a[1]
            for j in range(first_col, last_col + 1):
                x = min((col0 + j) * step, cols - 1) - a[0]
                u, v = (x * acy - acx * y) / area, (abx * y - x * aby) / area  # of b and of c
                if u >= -EDGE and v >= -EDGE and u + v <= 1.0 + EDGE:
                    heights[i, j] = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
    for k in range(len(vertices)):  # to the bit
        x, y = int(vertices[k, 0]), int(vertices[k, 1])
        if x != vertices[k, 0] or y != vertices[k, 1]:
            continue
        i, j = -(-y >> level) - row0, -(-x >> level) - col0
        shown = (y & (step - 1) == 0 or y == rows - 1) and (x & (step - 1) == 0 or x == cols - 1)
        if shown and 0 <= i < len(heights) and 0 <= j < heights.shape[1]:
            heights[i, j] = vertices[k, 2]


@kernel
def _span(low: float, high: float, step: int, first: int, side: int, count: int) -> tuple[int, int]:
    """The first and the last index of samples from low to high, in a window that begins with sample ``first``."""
    begin, end = max(int(np.ceil(low / step)) - first, 0), min(int(np.floor(high / step)) - first, count - 1)
    return begin, count - 1 if high >= side - 1 else end  # the last sample repeats the raster's last one


@kernel
def widen(vertices: Corners, triangles: NDArray[np.int32], low: Heights, high: Heights) -> None:
    """Widen the lowest and highest heights of tiles to hold all triangles over them.

    Tiles have 256 × 256 cells; the heights are (tile rows, tile cols) float32.
    """
    for k in range(len(triangles)):
        p, q, r = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        z0 = np.float32(min(vertices[p, 2], vertices[q, 2], vertices[r, 2]))
        z1 = np.float32(max(vertices[p, 2], vertices[q, 2], vertices[r, 2]))
        x0 = int(min(vertices[p, 0], vertices[q, 0], vertices[r, 0])) // TILE
        x1 = min(int(max(vertices[p, 0], vertices[q, 0], vertices[r, 0])) // TILE, low.shape[1] - 1)
        y0 = int(min(vertices[p, 1], vertices[q, 1], vertices[r, 1])) // TILE
        y1 = min(int(max(vertices[p, 1], vertices[q, 1], vertices[r, 1])) // TILE, low.shape[0] - 1)
        for i in range(y0, y1 + 1):
            for j in range(x0, x1 + 1):
                if not low[i, j] <= z0:
                    low[i, j] = z0
                if not high[i, j] >= z1:
                    high[i, j] = z1
