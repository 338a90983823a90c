"""Pages of diamonds on the GPU: what a tree that lives there asks of a vertex, in an atlas filled by threads.

A page is that of ``lod.field``: 256 × 256 vertices of a level, each a height, an error, the radius of its sphere, and
whether its sample is missing (float32). Which pages a view wants is told by the errors of tiles that the terrain knows
anyway: a page is wanted where the samples of its level take an error away that may be seen. A picture that waits asks
the tree itself, too (``take_asked``). The coarsest pages never leave. Metres, pixels.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.lod.field import Vertices
from orograph.parallel import map_ordered
from orograph.raycast.select import tile_boxes
from orograph.rendering.gpu.stream.residency import READERS, REMOTE_READERS
from orograph.rendering.gpu.stream.streamer import Streamer
from orograph.rendering.gpu.stream.tiles import Atlas, Key, Tables
from orograph.rendering.gpu.stream.wanted import Tree
from orograph.viewpoint import View

INFINITE = np.float32(3e38)
"""Metres: the error of a mixed diamond. Shaders may not rely on infinity."""

UPLOAD, ASK = 8, 64
"""Pages that a frame brings to the GPU, and asks for, at most."""

PLAN = 1e30
"""Pixels: what a plan allows, in which only edges of missing ground are seen."""


class DiamondPages:
    """The pages of a terrain on a device.

    Args:
        vertices: the terrain's. budget: bytes of the atlas. jobs: threads that read.

    Attributes:
        atlas: the pages. levels: uint32 (32, 4), where each level's pages begin, and how many rows and columns.
        bound: pixels of the largest error that a page of the last view takes away and that is not there yet, or 0.
        moved: bytes brought to the GPU so far.
    """

    def __init__(self, device: Device, vertices: Vertices, budget: int, jobs: int | None = None) -> None:
        terrain = self.terrain = vertices.terrain
        self.vertices, self.jobs = vertices, jobs
        offsets = np.concatenate([[0], np.cumsum([rows * cols for rows, cols in vertices.counts])])
        tables = Tables(offsets[:-1].tolist(), vertices.counts, int(offsets[-1]))
        self.atlas = Atlas(device, terrain, "diamonds", budget, tables)
        self.levels = np.zeros((32, 4), np.uint32)
        for k, (rows, cols) in enumerate(vertices.counts):
            self.levels[k, :3] = offsets[k], rows, cols
        self._tree, self._keys, self._index = _tree(vertices, tables)
        self._streamer: Streamer[Literal["diamonds"], Key] = Streamer(
            lambda kind, key: self._page(key), jobs or (REMOTE_READERS if terrain.remote else READERS)
        )
        self._frame = 0
        self._lacking: list[Key] = []
        self.bound, self.moved = 0.0, 0
        top = vertices.top
        rows, cols = vertices.counts[top]
        self._load([(top, i, j) for i in range(rows) for j in range(cols)], pin=True)

    def choose(self, view: View, tolerance: float, exaggeration: float) -> bool:
        """Have the pages of a view read, and bring those that were to the GPU; whether there were any."""
        self._frame += 1
        count = 0
        for _, key, data in self._streamer.take(UPLOAD):
            self.moved += data.nbytes
            count += self.atlas.insert(key, data, self._frame - 1)
        self.atlas.flush()
        which, pixels = self._wanted(view, tolerance, exaggeration)
        lack = self.atlas.lacking(self._index[which], self._frame)
        self.bound = float(pixels[lack].max(initial=0.0))
        which, pixels = which[lack], pixels[lack]
        order = np.argsort(-pixels, kind="stable")[:ASK]
        keys = [(int(k), int(i), int(j)) for k, i, j in self._keys[which[order]]]
        self._lacking = keys
        self._streamer.want([(p, "diamonds", key) for p, key in zip(pixels[order].tolist(), keys, strict=True)])
        return count > 0

    def load(self, view: View, tolerance: float, exaggeration: float) -> None:
        """Bring the pages of a view to the GPU, as many as there is room for, and wait for it.

        Raises:
            StoreError, DamagedChunkError: a page cannot be read.
        """
        self._frame += 2  # (a picture may take the place of the one before)
        which, pixels = self._wanted(view, tolerance, exaggeration)
        lack = self.atlas.lacking(self._index[which], self._frame)
        order = np.argsort(-pixels[lack], kind="stable")[: self.atlas.room]
        self._load([(int(k), int(i), int(j)) for k, i, j in self._keys[which[lack][order]]])
        self.bound, self._lacking = 0.0, []

    def take_asked(self, bits: NDArray[np.uint32]) -> int:
        """Bring the pages that a tree looked for in vain; how many there was room for.

        Args:
            bits: one for each place in the page table.
        """
        places = np.flatnonzero(np.unpackbits(bits.view(np.uint8), bitorder="little"))
        places = places[self.atlas.pages[places] == 0]
        offsets = np.array(self.atlas.tables.offsets)
        level = np.searchsorted(offsets, places, side="right") - 1
        cols = np.array([cols for _, cols in self.vertices.counts])[level]
        row, col = np.divmod(places - offsets[level], cols)
        return self._load(list(zip(level.tolist(), row.tolist(), col.tolist(), strict=True)))

    @property
    def waiting(self) -> int:
        """How many pages are on their way."""
        return self._streamer.waiting

    @property
    def lacking(self) -> int:
        """How many pages the last view wanted and had not, and that can be read."""
        return len({("diamonds", key) for key in self._lacking} - self._streamer.failed.keys())

    @property
    def failure(self) -> str:
        """What the last view lacks because it could not be read, and why; "" if there is nothing."""
        for key in self._lacking:
            if ("diamonds", key) in self._streamer.failed:
                return f"diamonds of tile {key}: {self._streamer.failed['diamonds', key][1]}"
        return ""

    def close(self) -> None:
        """Stop reading."""
        self._streamer.close()

    def _wanted(
        self, view: View, tolerance: float, exaggeration: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:  # fmt: skip
        """Places of the pages wanted, and pixels of the error that each takes away, at most."""
        allowed = PLAN
        if view.projection != "plan":
            _, _, width, height = view.frame
            slopes = view.pixel_slope * width / 2, view.pixel_slope * height / 2
            # Away from its axis a flat screen stretches by up to 1/cos².
            allowed = tolerance / (exaggeration * (1.0 + slopes[0] ** 2 + slopes[1] ** 2))
        which, priority = self._tree.of(view, exaggeration, pixels=allowed)
        every = np.full(len(self._index), np.inf)
        every[which] = priority / 2  # (see ``Tree.of``)
        above = self._tree.parents[which]
        return which, np.where(above < 0, np.inf, every[above]) * (tolerance / allowed)

    def _load(self, keys: list[Key], *, pin: bool = False) -> int:
        count = 0
        for key, data in zip(keys, map_ordered(self._page, keys, self.jobs), strict=True):
            self.moved += data.nbytes
            count += self.atlas.insert(key, data, self._frame, pin=pin)
        self.atlas.flush()
        return count

    def _page(self, key: Key) -> NDArray[np.float32]:
        data = self.vertices.page(*key)
        np.minimum(data[..., 1], INFINITE, out=data[..., 1])
        data[..., 3] = data[..., 3] < 0
        return data


def _tree(vertices: Vertices, tables: Tables) -> tuple[Tree, NDArray[np.int64], NDArray[np.int64]]:
    """The pages of all levels, coarsest first, with the errors of the tiles there; their keys; their table places."""
    parts: list[tuple[Any, ...]] = []
    above = begin = 0
    for level in range(vertices.top, -1, -1):
        rows, cols = vertices.counts[level]
        i, j = (a.ravel() for a in np.mgrid[:rows, :cols])
        box, table = tile_boxes(vertices.terrain, level), vertices.terrain.tiles(level)
        at = np.minimum(i, box.low.shape[0] - 1), np.minimum(j, box.low.shape[1] - 1)
        sizes = np.where(table.valid == 1, np.inf, table.error.astype(np.float64))[at]
        parents = np.full(len(i), -1)
        if level < vertices.top:
            parents = above + (i >> 1) * vertices.counts[level + 1][1] + (j >> 1)
        boxes = np.stack([a[at] for a in (box.west, box.east, box.north, box.south, box.low, box.high)], 1)
        keys = np.stack([np.full(len(i), level), i, j], 1)
        parts.append((boxes, parents, sizes, keys, tables.offsets[level] + i * cols + j))
        above, begin = begin, begin + len(i)
    boxes, parents, sizes, keys, index = (np.concatenate(some) for some in zip(*parts, strict=True))
    return Tree(vertices.terrain, boxes, parents.astype(np.int64), sizes), keys.astype(np.int64), index.astype(np.int64)
