"""Tiles on the GPU: fixed atlases that hold the part of a terrain that views want, filled by background threads.

Two kinds of tile, both of 256 × 256 cells of a level, work in the same way (a third is for trees: ``diamonds``):

- ``heights``: the 257 × 257 nested samples that a tile's patches take their vertices from, float32 metres, with
  ``missing(terrain)`` added to missing ones. Neighbours share their border samples: no vertex depends on its tile.
- ``slopes``: gradients of the box means, 258 × 258 (a border of one all around, so that filtering never leaves the
  tile), two float16: metres of height per sample of the raster along columns and rows. Means of gradients are gradients
  of means: the exact prefilter of slopes for pixels larger than samples (``lighting.relief``).

Every frame the renderer requests tiles by priority; threads read and convert them (``streamer``), and the
frame's thread uploads those that are ready, a bounded number of bytes at a time (``atlas``). The coarsest level is
loaded first and never leaves: something can always be drawn.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.gpu.device import Device
from orograph.lighting.normal import central
from orograph.rendering.gpu.stream.atlas import TileAtlas
from orograph.rendering.gpu.stream.landing import Landing, Tile
from orograph.store.terrain import TILE, Terrain, tile_shape

Kind = Literal["heights", "slopes", "diamonds"]
Key = tuple[int, int, int]
"""(level, tile row, tile column)."""

MISSING = 1_000_000
"""Metres added to the values that stand for missing heights in textures: shaders may not rely on NaN. The values are
near the ground beside them, so that the triangles there, which are not drawn, are no larger than others."""

SIDES = {"heights": TILE + 1, "slopes": TILE + 2, "diamonds": TILE + 1}
_FORMATS: dict[str, tuple[str, int]] = {
    "heights": ("r32float", 4),
    "slopes": ("rg16float", 4),
    "diamonds": ("rg32uint", 8),
}


@kernel
def _slopes(means, rows0, rows1, short_u, short_v, out):
    """Central differences (see ``lighting.relief``) of ``means`` (260, 260), which begins two blocks before the tile.

    It is NaN beyond the raster; ``out`` (258, 258, 2). Blocks without ground take the mean of their neighbours' slopes.

    ``short_u``, ``short_v`` (260,): how much nearer the middle of a column or row of blocks is than a whole block's.
    """
    n, m = out.shape[0], out.shape[1]
    for i in range(rows0, rows1):
        for j in range(m):
            z = np.float64(means[i + 1, j + 1])
            if z == z:
                out[i, j, 0] = central(
                    np.float64(means[i + 1, j]), z, np.float64(means[i + 1, j + 2]),
                    1.0 - short_u[j + 1], 1.0 - short_u[j + 2],
                )  # fmt: skip
                out[i, j, 1] = central(
                    np.float64(means[i, j + 1]), z, np.float64(means[i + 2, j + 1]),
                    1.0 - short_v[i + 1], 1.0 - short_v[i + 2],
                )  # fmt: skip
            else:
                out[i, j, 0] = out[i, j, 1] = np.nan
    for i in range(n):
        for j in range(m):
            if means[i + 1, j + 1] != means[i + 1, j + 1]:
                gu = gv = count = 0.0
                for a in range(max(i - 1, 0), min(i + 2, n)):
                    for b in range(max(j - 1, 0), min(j + 2, m)):
                        if means[a + 1, b + 1] == means[a + 1, b + 1]:
                            gu += out[a, b, 0]
                            gv += out[a, b, 1]
                            count += 1.0
                out[i, j, 0] = gu / count if count > 0 else 0.0
                out[i, j, 1] = gv / count if count > 0 else 0.0


def missing(terrain: Terrain) -> int:
    """Metres added to missing heights, more than twice any height; ``MISSING``, unless heights are radii."""
    highest = float(np.nanmax(np.abs(terrain.height_range), initial=0.0))
    return MISSING if highest < 0.4 * MISSING else 2 ** math.ceil(math.log2(4.0 * highest))


def height_tile(terrain: Terrain, key: Key) -> NDArray[np.float32]:
    """The samples (257, 257) of a tile; beyond the raster the last row and column are repeated.

    At coarse levels a missing sample takes the mean of the valid ones around it, if there are any within its own cell:
    a hole smaller than a triangle must not remove all triangles around it, and the edge of a larger one stays in place
    to half a triangle. Patches are that coarse only where their triangles are smaller than a pixel.
    """
    level, ty, tx = key
    rows, cols = terrain.shape(level)
    r0, c0 = ty * TILE, tx * TILE
    read = terrain.read(level, r0, min(r0 + TILE + 1, rows), c0, min(c0 + TILE + 1, cols))
    if level and np.isnan(read).any():
        read = np.where(np.isnan(read), _means(terrain, level, r0, c0, read.shape), read)
    block = _filled(read, np.float32(missing(terrain)))
    out = np.empty((TILE + 1, TILE + 1), np.float32)
    out[: read.shape[0], : read.shape[1]] = block
    out[: read.shape[0], read.shape[1] :] = block[:, -1:]
    out[read.shape[0] :] = out[read.shape[0] - 1]
    return out


def _means(terrain: Terrain, level: int, r0: int, c0: int, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Means of the blocks whose corners are nested samples of a level, NaN where there is none."""
    rows, cols = terrain.mean_shape(level)
    out = np.full(shape, np.nan, np.float32)
    r1, c1 = min(r0 + shape[0], rows), min(c0 + shape[1], cols)
    if r1 > r0 and c1 > c0:
        out[: r1 - r0, : c1 - c0] = terrain.read_mean(level, r0, r1, c0, c1)
    return out


def _filled(heights: NDArray[np.float32], missing: np.float32) -> NDArray[np.float32]:
    """Replace missing heights by the mean of their neighbours, or else of all, plus ``missing``."""
    there = np.isfinite(heights)
    if there.all():
        return heights
    if not there.any():
        return np.full(heights.shape, missing, np.float32)
    known = np.where(there, heights, np.float32(0))
    total, count = np.zeros(heights.shape, np.float32), np.zeros(heights.shape, np.float32)
    rows, cols = heights.shape
    padded, weights = np.pad(known, 1), np.pad(there.astype(np.float32), 1)
    for i in range(3):
        for j in range(3):
            total += padded[i : i + rows, j : j + cols]
            count += weights[i : i + rows, j : j + cols]
    mean = np.float32(heights[there].mean())
    around = np.where(count > 0, total / np.maximum(count, 1), mean)
    filled: NDArray[np.float32] = np.where(there, heights, around + missing).astype(np.float32)
    return filled


def slope_tile(terrain: Terrain, key: Key) -> NDArray[np.float16]:
    """Gradients (258, 258, 2) of a tile's box means, per sample of the full-resolution raster."""
    level, ty, tx = key
    rows, cols = terrain.mean_shape(level)
    r0, c0 = ty * TILE - 2, tx * TILE - 2
    r1, c1 = min(r0 + TILE + 4, rows), min(c0 + TILE + 4, cols)
    means = np.full((TILE + 4, TILE + 4), np.nan, np.float32)
    top, left = max(-r0, 0), max(-c0, 0)
    if r1 > max(r0, 0) and c1 > max(c0, 0):
        means[top : r1 - r0, left : c1 - c0] = terrain.read_mean(level, r0 + top, r1, c0 + left, c1)
    scale = float(1 << level)
    shorts = []
    for count, first, samples in ((cols, c0, terrain.grid.cols), (rows, r0, terrain.grid.rows)):
        short = np.zeros(TILE + 4)
        if 0 <= count - 1 - first < TILE + 4:
            short[count - 1 - first] = (count - samples / scale) / 2
        shorts.append(short)
    out = np.empty((TILE + 2, TILE + 2, 2), np.float32)
    _slopes(means, 0, TILE + 2, shorts[0], shorts[1], out)
    half: NDArray[np.float16] = np.clip(out / np.float32(scale), -6e4, 6e4).astype(np.float16)
    return half


def warm() -> None:
    """Load the kernel of slope tiles, and with it all that Numba needs before its first kernel."""
    out = np.empty((1, 1, 2), np.float32)
    _slopes(np.zeros((3, 3), np.float32), 0, 1, np.zeros(3), np.zeros(3), out)


@dataclass(slots=True)
class Tables:
    """The offset of each level's tiles in a page table, and their number."""

    offsets: list[int]
    shapes: list[tuple[int, int]]
    total: int

    @classmethod
    def of(cls, terrain: Terrain) -> Tables:
        shapes = [tile_shape(terrain.grid.shape, k) for k in range(terrain.levels)]
        offsets = [0]
        for rows, cols in shapes:
            offsets.append(offsets[-1] + rows * cols)
        return cls(offsets[:-1], shapes, offsets[-1])

    def index(self, key: Key) -> int:
        level, row, col = key
        return self.offsets[level] + row * self.shapes[level][1] + col

    def key(self, index: int) -> Key:
        """The tile at a place of the table."""
        level = bisect_right(self.offsets, index) - 1
        row, col = divmod(index - self.offsets[level], self.shapes[level][1])
        return level, row, col


class _Names(dict[int, tuple[Kind, Key]]):
    """The kind and the keys of tiles by their places in the page table, each made when it is first asked for."""

    def __init__(self, kind: Kind, tables: Tables) -> None:
        super().__init__()
        self.kind, self.tables = kind, tables

    def __missing__(self, tile: int) -> tuple[Kind, Key]:
        self[tile] = found = self.kind, self.tables.key(tile)
        return found


class Atlas(TileAtlas):
    """One kind of tile of a terrain, and the page table that shaders find them by.

    Args:
        tables: the places of tiles in the page table; None: one for each of the terrain's.

    Attributes:
        kind: of the tiles.
        pages: uint32 (tiles of all levels): slot + 1, 0 where a tile is not there. resident: uint8, as many: 1 where
            it is there. changes: how often a tile came or went.
    """

    def __init__(
        self, device: Device, terrain: Terrain, kind: Kind, budget: int, tables: Tables | None = None,
        landing: Landing | None = None,
    ) -> None:  # fmt: skip
        self.kind = kind
        self.tables = tables or Tables.of(terrain)
        super().__init__(device, SIDES[kind], *_FORMATS[kind], budget, self.tables.total, kind, landing)
        self.pages: NDArray[np.uint32] = np.zeros(self.tables.total, np.uint32)
        self.page_buffer = device.buffer(self.pages, "STORAGE", f"{kind} pages")
        self.resident: NDArray[np.uint8] = np.zeros(self.tables.total, np.uint8)
        self.changes = 0
        self._flushed = 0
        self._names = _Names(kind, self.tables)

    def named(self, tiles: NDArray[np.int64]) -> list[tuple[Kind, Key]]:
        """The kind and the keys of tiles, by their places in the page table."""
        return [self._names[tile] for tile in tiles.tolist()]

    def lacking(self, tiles: NDArray[np.int64], frame: int) -> NDArray[np.bool_]:
        """Which tiles, by their places in the page table, are absent; the others are marked as wanted in a frame."""
        pages = self.pages[tiles]
        lack: NDArray[np.bool_] = pages == 0
        self.touch(pages.view(np.int32) - np.int32(1), frame)
        return lack

    def insert(self, key: Key, data: Tile, frame: int, *, pin: bool = False) -> bool:
        """Upload a tile; False if all slots hold tiles that this frame wants."""
        there = self.slot(key) >= 0
        slot, before = (-1, None) if there else self.put(key, data, frame, pin=pin)
        if slot < 0:
            if self.landing is not None:
                self.landing.give_back(data)
            return there
        if before is not None:
            self._mark(before, 0)
        self._mark(key, slot + 1)
        return True

    def flush(self) -> None:
        """Have tiles copied that landed, and bring the page table to the GPU if it changed."""
        if self.landing is not None:
            self.landing.settle()
        if self._flushed != self.changes:
            self.device.queue.write_buffer(self.page_buffer, 0, self.pages)
            self._flushed = self.changes

    def _mark(self, key: Key, page: int) -> None:
        self.pages[self.tables.index(key)] = page
        self.resident[self.tables.index(key)] = page > 0
        self.changes += 1


_MAKE: dict[Kind, Callable[[Terrain, Key], NDArray[Any]]] = {"heights": height_tile, "slopes": slope_tile}


def make_tile(terrain: Terrain, kind: Kind, key: Key) -> NDArray[Any]:
    """Make a tile of a terrain, of either kind."""
    return _MAKE[kind](terrain, key)
