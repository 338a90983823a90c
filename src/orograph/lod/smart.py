"""SMART: blocks of a quadtree, each with one strip, and masks over it for ranges of errors; strips are kept.

Bao, Pajarola & Shafae, *SMART: An Efficient Technique for Massive Terrain Visualization from Out-of-core* (VMV 2004).
The unit of work is a block, a restricted quadtree triangulation of 2^m × 2^m cells. A view asks each block for a
*range* of errors: the coarsest whose threshold, anywhere in the block, is within the tolerance. Which vertices the
range has is a mask over the strip that all blocks share (``smart_strip``), and the strip that is left is kept: as long
as a block's range and those around it stay the same, it is drawn as it is. Blocks form a quadtree, coarser ones far
away; vertices and errors come in pages, out of core (``lod.field``), and neither blocks nor strips take more memory
than is allowed.

Blocks conform without looking at each other's meshes: whether a vertex is active depends on its error and on the finest
range among the blocks that its region touches; regions are nested and errors saturated, so what is active is closed
(docs/methods/smart.md has the proof). The paper was not at hand; that page says what was derived. Pixels, metres.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import ANISOTROPIC, CameraParameters
from orograph.errors import UsageError
from orograph.lod.block_boxes import weigh_boxes, weigh_colors
from orograph.lod.budget import by_tolerance
from orograph.lod.field import Field
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.right_triangles import METRIC, Mesh, MeshOptions, RightTriangleMeshes
from orograph.lod.smart_blocks import (
    ABSENT,
    INNER,
    LEAF,
    NEAR_PLACES,
    NONE,
    ZONE_PLACES,
    Kept,
    Tree,
    ask,
    gather_ranges,
    keep,
    list_leaves,
    thresholds,
    unfit,
    weigh,
)
from orograph.lod.smart_strip import ZONES, shape_of, triangulate
from orograph.parallel import for_each, map_ordered
from orograph.raycast.select import Boxes, distances, off_axis
from orograph.slots import Slots
from orograph.viewpoint import Camera

SHARE = 8
"""Blocks that a thread takes at a time."""

AT_ONCE = 64
"""Blocks that are taken over from pages at a time."""

Index = NDArray[np.int64]
Strip = tuple[NDArray[np.int64], NDArray[np.float32], int]
"""Keys, heights, triangles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SmartOptions(MeshOptions):
    """Options of ``smart``."""

    metric: str | None = option(None, METRIC, choices=("anisotropic", "isotropic", "isotropic-published"))
    cells: int = option(32, "Cells along a side of a block.", choices=(16, 32, 64))
    ranges: int = option(4, "Ranges of errors for each factor of two.", least=1, most=7)
    boxes: bool = option(True, "Also judge blocks by their boxes, not only by their spheres (metric anisotropic).")
    cache: bool = option(True, "Whether strips are kept for later frames.")


class Smart(RightTriangleMeshes):
    """SMART. See ``RightTriangles`` for the arguments.

    Attributes:
        m: blocks have 2^m cells a side. tree: the blocks of the last refinement. kept: what is kept of blocks.
    """

    info = MethodInfo(
        "smart", "blocks of one strip, masked by ranges of errors; a strip is kept while its ranges stay the same",
        "Bao, Pajarola & Shafae 2004", "triangles", SmartOptions, lambda options: options.conservative,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        n = self.field.n
        self.m = min(int(self.options.cells).bit_length() - 1, n)
        self._ends = thresholds(self.options.ranges)
        self._shape = shape_of(self.m)
        self.tree = Tree.of(n, self.m)
        vertices = self._shape.side**2
        each = Kept.bytes_of(vertices, len(self._ends))
        slots = min(len(self.tree.states), max(1, self.resources.max_memory // 4 // each))
        self.kept = Kept.room_for(slots, vertices, len(self._ends))
        self._slots: Slots[int] = Slots(slots)
        self._strips: OrderedDict[tuple[int, bytes], Strip] = OrderedDict()
        self._bytes = self._frame = 0
        self._touched: list[Index] = []

    def _pages(self) -> Field:
        # (The other half of the memory is for blocks and strips.)
        memory = self.resources.max_memory // 2
        return Field(self.terrain, self.error, color=self.resources.color, max_memory=memory, jobs=self.jobs)

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        if goal.tolerance is None:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        lens = self._lens(camera, goal.tolerance)
        self._frame += 1
        forced = self._grow(camera, lens)
        leaves = np.empty((int(sum(map(len, self._touched))), 3), np.int64)
        leaves = leaves[: list_leaves(self.tree, leaves)]
        wanted = np.empty((len(leaves), len(ZONES) + 2), np.uint8)
        ask(self.tree, self.kept, leaves, ZONE_PLACES, wanted)
        strips, made = self._strips_of(leaves, wanted)
        keys = np.concatenate([np.zeros(0, np.int64), *(keys for keys, _, _ in strips)])
        heights = np.concatenate([np.zeros(0, np.float32), *(zs for _, zs, _ in strips)])
        stats = {"blocks": len(leaves), "forced": forced, "triangulated": made}
        return Mesh(
            keys, heights, is_strip=True, clockwise=False, triangles=sum(count for _, _, count in strips), stats=stats
        )

    # ---- blocks ----

    def _grow(self, camera: Camera, lens: CameraParameters) -> int:
        """Make the tree of a view; return how many blocks are split only for their neighbours."""
        tree, top = self.tree, len(self.tree.base) - 1
        for ids in self._touched:
            tree.states[ids] = ABSENT
        self._touched = []
        leaves: list[list[Index]] = [[] for _ in range(top + 1)]
        inner: list[list[Index]] = [[] for _ in range(top + 1)]
        self._divide(camera, lens, top, np.zeros((1, 2), np.int64), leaves, inner)
        forced = 0
        level = 1
        while level <= top:
            # A split makes blocks one level below, which may ask for more at this level and above; never below.
            names = np.concatenate([np.zeros((0, 2), np.int64), *leaves[level]])
            found = np.zeros(len(names), np.uint8)
            unfit(tree, self.kept, level, names, NEAR_PLACES, found)
            leaves[level] = [names[found == 0]]
            more = names[found == 1]
            forced += len(more)
            inner[level].append(more)
            if len(more):
                tree.states[self._ids(level, more)] = INNER
                self._divide(camera, lens, level - 1, _quarters(more), leaves, inner)
                level = 1
                continue
            level += 1
        split = [_named(k, np.concatenate(of)) for k, of in enumerate(inner) if of]
        gather_ranges(tree, np.concatenate([np.zeros((0, 3), np.int64), *split]))
        return forced

    def _divide(
        self, camera: Camera, lens: CameraParameters, level: int, names: Index, leaves: list[list[Index]],
        inner: list[list[Index]],
    ) -> None:  # fmt: skip
        """Add blocks of a level to the tree, and below those that are too coarse their quarters."""
        tree = self.tree
        while True:
            ranges = self._weigh(lens, level, names)
            names, ranges = names[ranges != NONE], ranges[ranges != NONE]
            ids = self._ids(level, names)
            slots = self._fetch(level, names, ids)
            self._weigh_boxes(camera, lens, level, names, slots, ranges)
            tree.slots[ids], tree.ranges[ids] = slots, ranges
            self._touched.append(ids)
            split = ranges >= self.kept.least[slots, 0] if level else np.zeros(len(names), bool)
            tree.states[ids] = np.where(split, INNER, LEAF)
            leaves[level].append(names[~split])
            inner[level].append(names[split])
            if not split.any():
                return
            names, level = _quarters(names[split]), level - 1

    def _ids(self, level: int, names: Index) -> Index:
        return np.asarray(self.tree.base[level] + names[:, 0] * self.tree.width[level] + names[:, 1])

    def _weigh(self, lens: CameraParameters, level: int, names: Index) -> NDArray[np.int16]:
        """The range that the view needs of each block, −1 where nothing is visible."""
        ranges = np.empty(len(names), np.int16)
        exponents = _named(self.m + level, names)
        self.field.begin()
        while not weigh(self.field.pages, lens, self.spheres, self.cull, self._ends, exponents, ranges):
            self.field.fetch()
        return ranges

    def _weigh_boxes(
        self, camera: Camera, lens: CameraParameters, level: int, names: Index, slots: NDArray[np.int32],
        ranges: NDArray[np.int16],
    ) -> None:  # fmt: skip
        """Lower the ranges of blocks where their boxes allow it, and raise them where colours require it."""
        boxed = lens.focal > 0 and self.options.boxes and self.metric.number == ANISOTROPIC
        colored = self.color_tolerance < math.inf
        if not (boxed or colored):
            return
        (rows, cols), p = self.terrain.grid.shape, self.m + level
        row, col = (names << p).T
        reach = self.kept.reach[slots].T
        ends = (col, np.minimum(col + (1 << p), cols - 1), row, np.minimum(row + (1 << p), rows - 1), *reach)
        boxes = Boxes(*(np.asarray(v, np.float64) for v in ends))
        away = distances(self.terrain, camera.view, camera.exaggeration, boxes)
        sides = np.stack([boxes.west, boxes.east, boxes.north, boxes.south, boxes.low, boxes.high], 1)
        cosine = math.sqrt(off_axis(camera.view))
        if boxed:
            weigh_boxes(lens, self._ends, sides, away, cosine, ranges)
        if colored:
            weigh_colors(lens, self._ends, sides, away, cosine, self.kept.last[slots], ranges)

    def _fetch(self, level: int, names: Index, ids: Index) -> NDArray[np.int32]:
        """Keep the vertices of blocks; return their slots.

        Raises:
            UsageError: there are more than memory allows.
        """
        slots = np.array([self._slots.find(i) for i in ids.tolist()], np.int32)
        there = slots >= 0
        self._slots.touch(slots[there], self._frame)
        lacking = np.flatnonzero(~there)
        if len(lacking) > self._slots.room(self._frame):
            raise UsageError(
                f"One view needs more than the {self._slots.capacity} blocks that memory holds.",
                remedy="Allow more memory (`max_memory`), or a larger tolerance.",
            )
        if not len(lacking):
            return slots
        for i, key in zip(lacking.tolist(), ids[lacking].tolist()):
            slots[i], _ = self._slots.take(key, self._frame)
        exponents = _named(self.m + level, names)[lacking]
        try:
            for begin in range(0, len(lacking), AT_ONCE):
                part = slice(begin, begin + AT_ONCE)
                self._keep(exponents[part], slots[lacking][part])
        except BaseException:
            for key in ids[lacking].tolist():
                self._slots.release(key)
            raise
        self._slots.last[slots[lacking]] = self._frame
        return slots

    def _keep(self, names: Index, slots: NDArray[np.int32]) -> None:
        """Copy blocks from pages, with several threads."""
        missed = np.ones(len(names), np.uint8)
        self.field.begin()
        while missed.any():
            which = np.flatnonzero(missed)
            todo, at, absent = names[which], slots[which], np.zeros(len(which), np.uint8)

            def work(start: int) -> None:
                keep(
                    self.field.pages, self.field.n, self._ends, self.color_tolerance, self._shape, todo,  # noqa: B023
                    start, min(start + SHARE, len(todo)), at, self.kept, absent, NEAR_PLACES,  # noqa: B023
                )  # fmt: skip

            for_each(work, range(0, len(todo), SHARE), self.jobs)
            missed[which] = absent
            self.field.fetch()

    # ---- strips ----

    def _strips_of(self, leaves: Index, wanted: NDArray[np.uint8]) -> tuple[list[Strip], int]:
        """The strips of leaves, and how many were not kept."""
        ids = (self.tree.base[leaves[:, 0]] + leaves[:, 1] * self.tree.width[leaves[:, 0]] + leaves[:, 2]).tolist()
        names = [(i, row.tobytes()) for i, row in zip(ids, wanted)]
        lacking = []
        for k, name in enumerate(names):
            if name in self._strips:
                self._strips.move_to_end(name)
            else:
                lacking.append(k)
        made = map_ordered(lambda k: self._triangulate(leaves[k].tolist(), ids[k], wanted[k]), lacking, self.jobs)
        for k, strip in zip(lacking, made):
            self._strips[names[k]] = strip
            self._bytes += _bytes(strip)
        found = [self._strips[name] for name in names]
        least = self.resources.max_memory // 4 if self.options.cache else 0
        while self._bytes > least and self._strips:
            self._bytes -= _bytes(self._strips.popitem(last=False)[1])
        return found, len(lacking)

    def _triangulate(self, leaf: list[int], at: int, wanted: NDArray[np.uint8]) -> Strip:
        level, row, col = leaf
        slot = self.tree.slots[at]
        last_row, last_col = self.terrain.grid.rows - 1, self.terrain.grid.cols - 1
        place = (row << (self.m + level), col << (self.m + level), 1 << level, last_row, last_col)
        keys, heights, made = triangulate(
            self._shape, (row ^ col) & 1 == 0, self.kept.ranks[slot], self.kept.empty[slot], self.kept.heights[slot],
            wanted, place,
        )  # fmt: skip
        return keys, heights, int(made)


def _bytes(strip: Strip) -> int:
    return strip[0].nbytes + strip[1].nbytes


def _named(number: int, names: Index) -> Index:
    """Rows and columns (k, 2) behind a number: (k, 3)."""
    return np.concatenate([np.full((len(names), 1), number, np.int64), names], 1)


def _quarters(names: Index) -> Index:
    """The rows and columns of the quarters of blocks."""
    return np.concatenate([2 * names + step for step in ((0, 0), (0, 1), (1, 0), (1, 1))])
