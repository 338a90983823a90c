"""Pages of diamonds on the GPU: what a tree that lives there needs of a vertex, in an atlas filled by threads.

A page is that of ``lod.field`` with the first row and column of the next ones: 257 × 257 vertices of a level, each a
height, an error, the radius of its sphere, whether its sample is missing, and whether its colours are off by more than
a color tolerance γ (so pages are made for one γ), in 8 bytes (``packed``).

A tree splits nothing that patches do not. So it wants the pages of all tiles that the terrain's patches want for the
same tolerance, and those of coarser levels there; in motion only of tiles that take away more than the tolerance, for
patches, which grow, begin at smaller errors. Where ground and missing ground share a tile, a tree follows the edge to
the sample: there it wants pages whose samples are larger than the tolerance. With γ, which counts where a sphere looks
larger than a pixel, it also wants all pages whose samples are larger than half a pixel, last. A picture that waits asks
the tree itself, too (``take_asked``), which then follows edges and colours to the end. The coarsest pages never leave.
Lengths on the screen are pixels.
"""

from __future__ import annotations

import math
import time
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.lod.field import Vertices
from orograph.lod.triangle_patches import Patches
from orograph.parallel import map_ordered
from orograph.raycast.select import tile_boxes
from orograph.rendering.gpu.stream.landing import Landing, Tile
from orograph.rendering.gpu.stream.residency import ASK, READERS, REMOTE_READERS, UPLOAD, UPLOADING
from orograph.rendering.gpu.stream.streamer import Streamer
from orograph.rendering.gpu.stream.tiles import SIDES, Atlas, Key, Tables
from orograph.rendering.gpu.stream.wanted import Tree
from orograph.store.terrain import TILE
from orograph.viewpoint import View

LEAST, BITS = (0x37800000, 0x3B800000), 13
"""Errors and radii are 15 bits: a float32's exponent and upper 10 bits of its fraction, counted from 2⁻¹⁶ and 2⁻⁸ m."""

INFINITE, COLORED, MISSING = 0x7FFF, 1 << 30, 1 << 31
"""The code of a mixed diamond's error, and of an empty one's, which has no radius; what marks diamonds whose colours
are off by more than γ, and samples that are missing."""

UNKNOWN = 1e6
"""Pixels: larger errors are not distinguished."""


class DiamondPages:
    """The pages of a terrain on a device.

    Args:
        vertices: the terrain's. budget: bytes of the atlas. jobs: threads that read. gamma: γ, ΔE.

    Attributes:
        atlas: the pages. levels: uint32 (32, 4), the offset of each level's pages, and their rows and columns.
        bound: the largest error, in pixels, that a missing page of the last view would remove, or 0.
        moved: bytes uploaded to the GPU so far.
    """

    def __init__(
        self, device: Device, vertices: Vertices, budget: int, jobs: int | None = None, gamma: float = math.inf
    ) -> None:
        terrain = self.terrain = vertices.terrain
        self.vertices, self.jobs, self.gamma = vertices, jobs, gamma
        shapes = [(max(1, -(-(r - 1) // TILE)), max(1, -(-(c - 1) // TILE))) for r, c in vertices.shapes]
        offsets = np.concatenate([[0], np.cumsum([rows * cols for rows, cols in shapes])])
        self.tables = Tables(offsets[:-1].tolist(), shapes, int(offsets[-1]))
        landing = Landing(device, SIDES["diamonds"], 8)
        self.atlas = Atlas(device, terrain, "diamonds", budget, self.tables, landing)
        self.levels = np.zeros((32, 4), np.uint32)
        for k, (rows, cols) in enumerate(shapes):
            self.levels[k, :3] = offsets[k], rows, cols
        self._offsets, self._across = offsets[:-1].astype(np.int64), np.array([cols for _, cols in shapes], np.int64)
        self._edges = self._colored = None
        if any((terrain.tiles(level).valid == 1).any() for level in range(terrain.levels)):
            self._edges = _by_samples(vertices, self.tables, (1,))
        if gamma < math.inf:
            self._colored = _by_samples(vertices, self.tables, (1, 2))
        self._streamer: Streamer[Literal["diamonds"], Key, Tile] = Streamer(
            lambda kind, key: landing.land(self._page(key)), jobs or (REMOTE_READERS if terrain.remote else READERS)
        )
        self._frame = 0
        self._lacking: list[Key] = []
        self._asked: tuple[Patches, Any] | None = None
        self.bound, self.moved = 0.0, 0
        top = vertices.top
        rows, cols = shapes[top]
        self._load([(top, i, j) for i in range(rows) for j in range(cols)], pin=True)

    def choose(self, view: View, patches: Patches, tolerance: float, exaggeration: float, beyond: float = 0.0) -> bool:
        """Request the pages of a view, and upload those already read; return whether there were any.

        Args:
            patches: of the view, as fine as the tree is to be. beyond: pixels of error that a tree surely keeps whole.
        """
        count, end = 0, time.perf_counter() + UPLOADING
        while count < UPLOAD and (not count or time.perf_counter() < end):
            taken = self._streamer.take(1)
            if not taken:
                break
            _, key, data = taken[0]
            self.moved += data.nbytes
            self.atlas.insert(key, data, self._frame - 1)
            count += 1
        self.atlas.flush()
        asked = view, tolerance, exaggeration, beyond, self.atlas.changes
        same = self._asked is not None and self._asked[0] is patches and self._asked[1] == asked
        if same and not (self._lacking and (self._streamer.failed or not self._streamer.waiting)):
            return count > 0
        self._asked = patches, asked
        self._frame += 1
        self._lacking, pixels = self._lacking_of(view, patches, tolerance, exaggeration, beyond, ASK)
        self._streamer.want([(p, "diamonds", key) for p, key in zip(pixels, self._lacking, strict=True)])
        return count > 0

    def load(self, view: View, patches: Patches, tolerance: float, exaggeration: float) -> None:
        """Upload the pages of a view to the GPU, as many as fit, and wait for them.

        Raises:
            StoreError, DamagedChunkError: a page cannot be read.
        """
        self._frame += 2  # (a picture may evict the pages of the one before)
        keys, _ = self._lacking_of(view, patches, tolerance, exaggeration)
        self._load(keys[: self.atlas.room])
        self._lacking_of(view, patches, tolerance, exaggeration)
        self._lacking, self._asked = [], None

    def take_asked(self, bits: NDArray[np.uint32]) -> int:
        """Upload the pages that a tree reported missing; return how many fitted.

        Args:
            bits: one for each place in the page table.
        """
        places = np.flatnonzero(np.unpackbits(bits.view(np.uint8), bitorder="little"))
        return self._load(self._keys(places[self.atlas.pages[places] == 0]))

    @property
    def waiting(self) -> int:
        """The number of pages being loaded."""
        return self._streamer.waiting

    @property
    def lacking(self) -> int:
        """The number of readable pages that the last view wanted but lacked."""
        return len({("diamonds", key) for key in self._lacking} - self._streamer.failed.keys())

    @property
    def failure(self) -> str:
        """What the last view lacks because it could not be read, and why; "" if nothing."""
        for key in self._lacking:
            if ("diamonds", key) in self._streamer.failed:
                return f"diamonds of tile {key}: {self._streamer.failed['diamonds', key][1]}"
        return ""

    def close(self) -> None:
        """Stop reading."""
        self._streamer.close()

    def _lacking_of(
        self, view: View, patches: Patches, tolerance: float, exaggeration: float, beyond: float = 0.0,
        most: int | None = None,
    ) -> tuple[list[Key], list[float]]:  # fmt: skip
        """The absent pages that a view wants, at most so many, by the error that each removes, largest first; of
        patches only those that are ``beyond`` so many pixels."""
        pixels = self._wanted(view, patches, tolerance, exaggeration, beyond)
        which = np.flatnonzero(pixels)
        lack = which[self.atlas.lacking(which, self._frame)]
        order = np.argsort(-pixels[lack], kind="stable")[:most]
        found = pixels[lack[order]]
        self.bound = 0.0 if not len(found) else float(found[0]) if found[0] < UNKNOWN else math.inf
        return self._keys(lack[order]), found.tolist()

    def _wanted(
        self, view: View, patches: Patches, tolerance: float, exaggeration: float, beyond: float
    ) -> NDArray[np.float64]:  # fmt: skip
        """The error that each page of the table removes, pixels; 0 where it is not wanted."""
        pixels, tables = np.zeros(self.tables.total), self.tables
        if view.projection != "plan":  # in which heights displace nothing
            some = patches.pixels > beyond if beyond else slice(None)
            level, row, col = patches.tiling.where(patches.tiles[some])
            np.maximum.at(
                pixels, self._offsets[level] + row * self._across[level] + col, np.maximum(patches.pixels[some], 1e-9)
            )
        if self._edges is not None:
            tree, places = self._edges
            which, samples = tree.of(view, exaggeration, pixels=tolerance)
            np.maximum.at(pixels, places[which], samples)
        if self._colored is not None:
            tree, places = self._colored
            which, samples = tree.of(view, exaggeration)
            np.maximum.at(pixels, places[which], 1e-9 * samples)  # (no error in pixels)
        for k, (down, across) in enumerate(tables.shapes[:-1]):
            begin, above = tables.offsets[k], tables.offsets[k + 1]
            here = np.flatnonzero(pixels[begin : begin + down * across])
            up = above + (here // across >> 1) * tables.shapes[k + 1][1] + (here % across >> 1)
            np.maximum.at(pixels, up, pixels[begin + here])
        return pixels

    def _keys(self, places: NDArray[np.int64]) -> list[Key]:
        """Levels, rows and columns of places in the page table."""
        level = np.searchsorted(self._offsets, places, side="right") - 1
        row, col = np.divmod(places - self._offsets[level], self._across[level])
        return list(zip(level.tolist(), row.tolist(), col.tolist(), strict=True))

    def _load(self, keys: list[Key], *, pin: bool = False) -> int:
        count = 0
        for key, data in zip(keys, map_ordered(self._page, keys, self.jobs), strict=True):
            self.moved += data.nbytes
            count += self.atlas.insert(key, data, self._frame, pin=pin)
        self.atlas.flush()
        return count

    def _page(self, key: Key) -> NDArray[np.uint32]:
        return packed(self.vertices.page(*key, TILE + 1), self.gamma)


def packed(page: NDArray[np.float32], gamma: float = math.inf) -> NDArray[np.uint32]:
    """Vertices (…, 4) of ``lod.field`` as shaders read them: (…, 2) uint32.

    The first number is the height's float32. The second has the error in its lower 15 bits and the radius in the next
    15, both rounded up by less than a part in 1024; then ``COLORED`` and ``MISSING``.
    """
    bits, (error, radius, color) = page.view(np.int32), (page[..., k] for k in (1, 2, 3))
    out = np.empty((*page.shape[:-1], 2), np.uint32)
    out[..., 0], code = page[..., 0].view(np.uint32), np.zeros(page.shape[:-1], np.int32)
    some = error > 0, (radius > 0) | (error == np.inf)  # (a mixed diamond has a radius)
    for k, least in enumerate(LEAST):
        part = np.clip((bits[..., 1 + k] - least + (1 << BITS) - 1) >> BITS, 1, INFINITE)
        code |= np.where(some[k], part, 0) << 15 * k  # (0 is for none)
    code[radius < 0] = INFINITE
    out[..., 1] = code.view(np.uint32)
    if gamma < math.inf:
        out[..., 1] |= np.where(np.where(color < 0, -1.0 - color, color) > gamma, COLORED, 0).astype(np.uint32)
    out[..., 1] |= np.where(color < 0, MISSING, 0).astype(np.uint32)
    return out


def _by_samples(vertices: Vertices, tables: Tables, kinds: tuple[int, ...]) -> tuple[Tree, NDArray[np.int64]]:
    """The pages of all levels, coarsest first, that are too coarse where their samples are too far apart, of tiles that
    are ``valid`` in one of some ways (``TileTable``); and their places in the table."""
    terrain, parts = vertices.terrain, list[tuple[Any, ...]]()
    above = begin = 0
    for level in range(vertices.top, -1, -1):
        rows, cols = tables.shapes[level]
        i, j = (a.ravel() for a in np.mgrid[:rows, :cols])
        box, valid = tile_boxes(terrain, level), terrain.tiles(level).valid
        at = np.minimum(i, valid.shape[0] - 1), np.minimum(j, valid.shape[1] - 1)
        parents = np.full(len(i), -1)
        if level < vertices.top:
            parents = above + (i >> 1) * tables.shapes[level + 1][1] + (j >> 1)
        boxes = np.stack([a[at] for a in (box.west, box.east, box.north, box.south, box.low, box.high)], 1)
        apart = max(terrain.grid.spacing) * 2.0**level
        parts.append(
            (boxes, parents, np.where(np.isin(valid, kinds), apart, 0.0)[at], tables.offsets[level] + i * cols + j)
        )
        above, begin = begin, begin + len(i)
    boxes, parents, sizes, places = (np.concatenate(some) for some in zip(*parts, strict=True))
    return Tree(terrain, boxes, parents.astype(np.int64), sizes), places.astype(np.int64)
