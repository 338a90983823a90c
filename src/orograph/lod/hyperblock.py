"""HyperBlock-QuadTIN: blocks of a QuadTIN's hierarchy, each with a triangulation ready for every error level.

Lario, Pajarola & Tirado, *HyperBlock-QuadTIN: Hyper-Block Quadtree based Triangulated Irregular Networks* (VIIP 2003).
QuadTIN decides about every vertex in every frame; here a view selects one of a few error levels for each block, and the
block's strip at that level is drawn. If an adjacent block is finer, vertices near the border follow that one's level
(``hyperblock_blocks`` says which, and why that leaves no crack); such strips are made on first use, and kept. A frame
examines blocks, not vertices, and updates only what has changed.

Only the paper's abstract was available: docs/methods/hyperblock.md says what was derived. Metres, pixels.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import CameraParameters
from orograph.lod.block_boxes import weigh_boxes
from orograph.lod.hyperblock_blocks import (
    OWN,
    Bytes,
    Triangulation,
    blocks_of,
    bound_of,
    depth_for,
    joined,
    triangulate,
    weigh_colors,
)
from orograph.lod.method import MethodInfo
from orograph.lod.options import option
from orograph.lod.quadtin import ColoredOptions, QuadTin, Refined
from orograph.lod.quadtin_tree import BYTES
from orograph.lod.smart_blocks import thresholds
from orograph.parallel import map_ordered, threads_for
from orograph.raycast.select import Boxes, distances, in_frustum, off_axis
from orograph.viewpoint import Camera

Key = tuple[int, bytes]

READY = 100
"""Bytes that the triangulations ready of a vertex take, about."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HyperBlockOptions(ColoredOptions):
    """Options of ``hyperblock``."""

    cells: int = option(32, "Approximate vertices along a side of a block at its finest level.", least=4, most=512)
    levels: int = option(2, "Error levels for each factor of two.", least=1, most=7)
    cache: bool = option(True, "Keep triangulations that were made because of finer blocks nearby.")


class HyperBlock(QuadTin):
    """HyperBlock-QuadTIN. See ``QuadTin``.

    Attributes:
        blocks: of the hierarchy. levels: (b,) uint8, of the last view. ready: their triangulations by block and level;
            none where there is no room for all: then they are made on first use, as those beside finer blocks are.
    """

    info = MethodInfo(
        "hyperblock", "blocks of a QuadTIN, each with a strip ready for every level of error",
        "Lario, Pajarola & Tirado 2003", "triangles", HyperBlockOptions, lambda options: True,
    )  # fmt: skip

    _needs_all = True

    def _prepare(self) -> None:
        self._ends = thresholds(self.options.levels)
        tree = self.tree
        colored = self._color_errors() > self.color_tolerance
        self.blocks = blocks_of(tree, depth_for(len(tree.vertices), self.options.cells), self._ends, colored)
        blocks = self.blocks
        count = len(blocks.roots)
        self.levels = np.zeros(count, np.uint8)
        self._boxes = Boxes(*np.ascontiguousarray(blocks.boxes.T))
        self._rest = Triangulation(blocks.rest, blocks.rest, joined(tree.corners[blocks.rest]))
        self.ready: dict[tuple[int, int], Triangulation] = {}
        if len(tree.vertices) * (BYTES + READY) <= self.resources.max_memory:
            with self.resources.progress.task("Triangulating blocks"):
                found = map_ordered(self._levels_of, range(count), threads_for(self.resources.jobs))
                self.ready = {(block, level): one for block, every in enumerate(found) for level, one in every}
        self._kept: OrderedDict[Key, Triangulation] = OrderedDict()
        self._bytes = 0
        self._asked = np.full((count, 9), 255, np.uint8)
        self._drawn: list[Triangulation] = [self._rest] * count
        self._frame: tuple[NDArray[np.int32], NDArray[np.int32]] | None = None

    def _levels_of(self, block: int) -> list[tuple[int, Triangulation]]:
        """The triangulations of a block, each with the coarsest level that it is of."""
        tree, blocks = self.tree, self.blocks
        levels = np.unique(np.append(blocks.steps[block, OWN], 0)).tolist()
        return [(k, triangulate(tree, blocks, block, np.full(16, k, np.uint8))) for k in levels]

    def _refine(self, camera: Camera, tolerance: float) -> Refined:
        lens = self._lens(camera, tolerance)
        seen = self._weigh(camera, lens)
        made = self._follow(self._demands())
        if self._frame is None:
            parts = [self._rest, *self._drawn]
            self._frame = (
                np.concatenate([one.leaves for one in parts]),
                np.concatenate([one.strip for one in parts]),
            )
        leaves, strip = self._frame
        stats = {"blocks": len(seen), "blocks_seen": int(seen.sum()), "triangulated": made}
        return Refined(leaves, self._bound(lens, seen), strip, stats=stats)

    def _weigh(self, camera: Camera, lens: CameraParameters) -> NDArray[np.bool_]:
        """Find the level that the view needs of each block; which may be in view."""
        view, up = camera.view, camera.exaggeration
        seen = in_frustum(self.terrain, view, up, self._boxes)
        if not self.options.cull:
            seen[:] = True
        self.levels[:] = 0
        which = np.flatnonzero(seen)
        ranges = np.zeros(len(which), np.int16)
        boxes = Boxes(*(getattr(self._boxes, one.name)[which] for one in fields(Boxes)))
        away, cosine = distances(self.terrain, view, up, boxes), math.sqrt(off_axis(view))
        if lens.focal > 0:
            ranges[:] = len(self._ends) - 1
            weigh_boxes(lens, self._ends, self.blocks.boxes[which], away, cosine, ranges)
        if self.color_tolerance < math.inf:
            weigh_colors(lens, self.blocks.boxes[which], away, cosine, self.blocks.reach[which], ranges)
        self.levels[which] = 1 + ranges
        return seen

    def _demands(self) -> Bytes:
        """What is asked of each block (b, 9): its own level in the middle, and those of finer blocks around it, 0 where
        they ask for no more; each the coarsest level that means the same."""
        near, steps = self.blocks.near, self.blocks.steps
        around = np.where(near >= 0, self.levels[near], 0)
        asked = np.take_along_axis(steps, around[:, :, None].astype(np.int64), axis=2)[:, :, 0]
        own = asked[:, OWN, None]
        return np.where((asked > own) | (np.arange(9) == OWN), asked, 0).astype(np.uint8)

    def _follow(self, asked: Bytes) -> int:
        """Have what is asked drawn; how many blocks were triangulated for it."""
        changed = np.flatnonzero((asked != self._asked).any(axis=1))
        if not len(changed):
            return 0
        self._frame = None
        alone = np.count_nonzero(asked[changed], axis=1) == (asked[changed, OWN] > 0)
        lacking = []
        for block, lone in zip(changed.tolist(), alone.tolist()):
            if lone and self.ready:
                self._drawn[block] = self.ready[block, int(asked[block, OWN])]
                continue
            kept = self._kept.get((block, asked[block].tobytes()))
            if kept is None:
                lacking.append(block)
            else:
                self._kept.move_to_end((block, asked[block].tobytes()))
                self._drawn[block] = kept
        for block in lacking:
            self._drawn[block] = one = self._triangulate(block, asked[block])
            if self.options.cache:
                self._kept[block, asked[block].tobytes()] = one
                self._bytes += one.nbytes
        while self._bytes > self.resources.max_memory // 4 and self._kept:
            self._bytes -= self._kept.popitem(last=False)[1].nbytes
        self._asked = asked
        return len(lacking)

    def _triangulate(self, block: int, asked: Bytes) -> Triangulation:
        near = self.blocks.near[block]
        there = near >= 0
        levels = np.zeros(16, np.uint8)
        levels[self.blocks.color[near[there]]] = asked[there]
        return triangulate(self.tree, self.blocks, block, levels)

    def _bound(self, lens: CameraParameters, seen: NDArray[np.bool_]) -> float:
        """The largest bound in pixels of triangles that are not split any further, where it can be beyond that of the
        levels."""
        ends = np.append(np.inf, self._ends)
        loose = np.flatnonzero(seen & (self.blocks.off > ends[self.levels]))
        parts = [self._rest.finest, *(self._drawn[block].finest for block in loose.tolist())]
        return float(bound_of(lens, self.tree, np.concatenate(parts)))
