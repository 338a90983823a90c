"""Where ground and missing ground meet, rings are split down to the samples, as the hierarchy of right triangles is.

A triangle is split at the middle of its longest side if the diamond there is *mixed* (``store.diamond_table``: part
ground, part hole). Errors of diamonds are monotonic, so those whose triangles it needs as neighbours are mixed, too:
every triangle decides alone, and the mesh stays conforming. What is not mixed is ground or hole as a whole. With a
promise (``Limit``) a triangle is split as well where its error, seen anywhere in the diamond's sphere, exceeds the
tolerance; spheres are nested, which keeps that monotonic. Metres, samples, pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy import diamonds
from orograph.raycast.select import off_axis
from orograph.store.diamond_table import DiamondTable
from orograph.store.terrain import TILE, Heights, Terrain
from orograph.viewpoint import Camera

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
LOW = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class Limit:
    """What errors may be.

    Attributes:
        tolerance: pixels.
    """

    camera: Camera
    tolerance: float

    def exceeded(self, terrain: Terrain, row: Index, col: Index, z: Heights, error: Heights, radius: Heights) -> Mask:
        """Whether errors, metres, of diamonds are seen as more than the tolerance from somewhere in their spheres."""
        view, x = self.camera.view, self.camera.exaggeration
        if view.projection == "plan":
            return np.zeros(len(row), bool)
        low = terrain.tiles(0).minimum
        filled = low[np.minimum(row // TILE, low.shape[0] - 1), np.minimum(col // TILE, low.shape[1] - 1)]
        filled = np.where(np.isnan(filled), terrain.height_range[0], filled)
        height = np.where(np.isnan(z), filled, z).astype(np.float64)
        east, north = terrain.grid.xy(col, row)
        eye = view.eye
        away = np.sqrt((east - eye[0]) ** 2 + (north - eye[1]) ** 2 + (x * (height - eye[2])) ** 2)
        away = np.maximum(away - np.abs(radius.astype(np.float64)) * max(1.0, x), view.near)
        off = error.astype(np.float64) * x
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = np.where(away > off, off / view.pixel_slope / ((away - off) * off_axis(view)), np.inf)
        return np.asarray((off > 0) & (pixels > self.tolerance))


class Rims:
    """Splits triangles over missing ground.

    Args:
        terrain: the ground.
    """

    def __init__(self, terrain: Terrain) -> None:
        self.terrain = terrain
        self._table: DiamondTable = terrain.derived("diamonds", error="exact")

    def beside(self, level: int, row: Index, col: Index) -> Mask:
        """Whether a triangle at a level's cell may have to be split: one of the nine tiles around has missing ground
        and ground. (What splits force others to reaches less than four cells.)"""
        if level >= self.terrain.levels:
            return np.ones(len(row), bool)
        near = self.partial(level)
        return np.asarray(near[np.minimum(row // TILE, near.shape[0] - 1), np.minimum(col // TILE, near.shape[1] - 1)])

    def partial(self, level: int) -> Mask:
        """(tile rows, tile cols) of a level: whether a tile or one beside it is ground only in part."""
        some = np.pad(self.terrain.tiles(level).valid == 1, 1)
        rows, cols = some.shape[0] - 2, some.shape[1] - 2
        return np.asarray(np.any([some[i : i + rows, j : j + cols] for i in range(3) for j in range(3)], axis=0))

    def split(self, keys: Index, heights: Heights, limit: Limit | None) -> tuple[Index, Heights]:
        """Triangles (m, 3), the apex first, split as far as they have to be; those over holes are left out.

        Args:
            keys: ``row << 32 | col`` of the padded square. heights: of the corners.
        """
        found_keys, found_heights = [keys[:0]], [heights[:0]]
        while len(keys):
            ends = keys[:, 1] + keys[:, 2]
            row, col = ((keys[:, 1] >> 32) + (keys[:, 2] >> 32)), (ends & LOW)
            unit = ((row | col) & 1) == 1
            there: Mask = np.asarray(~np.isnan(heights).any(1))
            found_keys.append(keys[unit & there])
            found_heights.append(heights[unit & there])
            keys, heights, there = keys[~unit], heights[~unit], there[~unit]
            row, col = row[~unit] >> 1, col[~unit] >> 1
            error, radius, z = self._at(row, col)
            parted = np.isinf(error)
            if limit is not None:
                parted |= limit.exceeded(self.terrain, *self._squeezed(row, col), z, error, radius)
            kept = ~parted & there & (radius >= 0) & ~np.isnan(z)
            found_keys.append(keys[kept])
            found_heights.append(heights[kept])
            keys, heights = _halves(keys[parted], heights[parted], row[parted] << 32 | col[parted], z[parted])
        return np.concatenate(found_keys), np.concatenate(found_heights)

    def _squeezed(self, row: Index, col: Index) -> tuple[Index, Index]:
        rows, cols = self.terrain.grid.shape
        return np.minimum(row, rows - 1), np.minimum(col, cols - 1)

    def _at(self, row: Index, col: Index) -> tuple[Heights, Heights, Heights]:
        """Error and radius of diamonds, and the heights of their vertices; empty beyond what a level has."""
        terrain = self.terrain
        error, radius = np.zeros(len(row), np.float32), np.full(len(row), -1.0, np.float32)
        z = np.full(len(row), np.nan, np.float32)
        level = np.minimum(diamonds.octave(row, col), terrain.levels - 1)
        i, j = row >> level, col >> level
        for k, row0, col0, some in _by_tile(level, i, j):
            high, wide = terrain.diamond_shape(k)
            some = some[(i[some] < high) & (j[some] < wide)]
            if len(some):
                part = row0, min(row0 + TILE, high), col0, min(col0 + TILE, wide)
                at = i[some] - row0, j[some] - col0
                error[some], radius[some] = (found[at] for found in self._table.read(k, *part))
        last = np.array([terrain.shape(k) for k in range(terrain.levels)]) - 1
        i, j = np.minimum(i, last[level, 0]), np.minimum(j, last[level, 1])  # (squeezed onto the raster)
        for k, row0, col0, some in _by_tile(level, i, j):
            part = row0, min(row0 + TILE, int(last[k, 0]) + 1), col0, min(col0 + TILE, int(last[k, 1]) + 1)
            z[some] = terrain.read(k, *part)[i[some] - row0, j[some] - col0]
        return error, radius, z


def _by_tile(level: Index, i: Index, j: Index) -> Iterator[tuple[int, int, int, Index]]:
    """Level, first row and first column of the tiles that entries lie in, and which entries those are."""
    names = level << 48 | (i // TILE) << 24 | j // TILE
    order = np.argsort(names, kind="stable")
    tiles, begins = np.unique(names[order], return_index=True)
    for tile, here in zip(tiles.tolist(), np.split(order, begins[1:])):
        yield tile >> 48, (tile >> 24 & 0xFFFFFF) * TILE, (tile & 0xFFFFFF) * TILE, here


def _halves(keys: Index, heights: Heights, middle: Index, z: Heights) -> tuple[Index, Heights]:
    """The two halves of triangles, whose apex is the middle of the longest side."""
    apex, left, right = keys.T
    p, a, b = heights.T
    halves = np.stack([middle, apex, left], 1), np.stack([middle, right, apex], 1)
    tall = np.stack([z, p, a], 1), np.stack([z, b, p], 1)
    return np.concatenate(halves), np.concatenate(tall)
