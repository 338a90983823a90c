"""A QuadTIN's hierarchy as it is selected from: the top, and of its blocks the parts that views have asked for.

Vertices on sides between blocks are one vertex in both; a triangle whose children are not in memory is none that ends
there. What is in memory changes nothing of what is drawn: a part is read if any of its vertices may be active. Sample
coordinates; metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import CameraParameters
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lod.quadtin_pass import parts_needed
from orograph.store.quadtin_grow import rounded_up
from orograph.store.quadtin_kernels import UNREAD, expand
from orograph.store.quadtin_layout import DEPTHS, FIRST, Layout, Part, QuadTins, Top, top_of

BYTES, HELD = 170, 70
"""A vertex and its four triangles, in memory; and as it was read, which is kept where views read parts, and there is
room."""

AT_ONCE = 1 << 20
"""Hierarchies of no more vertices are read whole."""

Floats = NDArray[np.float64]


class Hierarchy(NamedTuple):
    """A QuadTIN, or what of it is in memory.

    Attributes:
        vertices: (v, 3) float64: column, row, metres; the first four are the corners of the domain.
        error, radius: (v,) float32, metres: of the diamond that a vertex splits, with all that depends on it; of the
            sphere around the vertex that holds its ground.
        parents: (v, 2) int32, the vertices that it depends on, twice the same on the border.
        corners: (t, 3) int32: left and right end of the base, apex; of positive area.
        child, node: (t,) int32: the first of two children, −1: none; the vertex that splits it, −1: none does, −2: it
            is not in memory.
        state: (t,) uint8: DEAD, LIVE or MIXED.
        off: (t,) float32, metres, how far a triangle is from the truth.
        nodes: (v, 4) int32, the vertices that depend on it, −1: none.
        linear: (2, 2) float64, what a column and a row (the columns of the matrix) are in metres.
        points: how many vertices are the truth's. steiner: how many are not. finest: metres.
        stuck: triangles that could not be split although they are further off.
        whole: whether there is ground everywhere. (These five of all of it.)
    """

    vertices: Floats
    error: NDArray[np.float32]
    radius: NDArray[np.float32]
    parents: NDArray[np.int32]
    corners: NDArray[np.int32]
    child: NDArray[np.int32]
    node: NDArray[np.int32]
    state: NDArray[np.uint8]
    off: NDArray[np.float32]
    nodes: NDArray[np.int32]
    linear: Floats
    points: int
    steiner: int
    finest: float
    stuck: int
    whole: bool


class Resident:
    """What of a hierarchy is in memory.

    Args:
        source: the hierarchy as it is kept. grid: the terrain's. max_memory: bytes. name: of the terrain.
        whole: read all of it, once.

    Attributes:
        tree: what is in memory. parts: (b,) int8, how many parts of each block that is. read: blocks' parts, by now.
    """

    def __init__(self, source: QuadTins, grid: Grid, max_memory: int, name: str, whole: bool = False) -> None:
        self.source, self.grid, self.max_memory, self.name = source, grid, max_memory, name
        self._top = top_of(source.layout.across)
        self._held: dict[int, list[Part]] = {}
        self.read = 0
        count = source.layout.blocks
        all_of_it = int(source.summary.vertices.sum())
        self._static = whole or all_of_it <= min(AT_ONCE, max_memory // (4 * BYTES))
        self.parts = np.full(count, len(DEPTHS) if self._static else 0, np.int8)
        if whole and all_of_it * BYTES > max_memory:
            raise UsageError(
                f"The hierarchy has {all_of_it:,} vertices, which do not fit into memory.", path=name,
                remedy="Allow more memory, or a larger error (its option finest).",
            )  # fmt: skip
        self.tree = self._assembled()

    def follow(self, camera: CameraParameters, cull: bool) -> Hierarchy:
        """What is in memory, when it has what a view needs.

        Raises:
            UsageError: that does not fit. DamagedChunkError: as of stores.
        """
        if self._static:
            return self.tree
        needed = np.zeros_like(self.parts)
        s = self.source.summary
        parts_needed(camera, cull, s.centre, s.radius, s.errors, needed)
        if (needed <= self.parts).all():
            return self.tree
        kept = np.maximum(needed, self.parts)
        self.parts = kept if self._bytes(kept, BYTES + HELD) <= self.max_memory // 2 else needed
        if self._bytes(self.parts, BYTES) > self.max_memory:
            raise UsageError(
                f"One view needs more than {self.max_memory >> 20} MiB of the hierarchy.", path=self.name,
                remedy="Allow more memory, or a larger tolerance.",
            )  # fmt: skip
        self.tree = self._assembled()
        return self.tree

    def _bytes(self, parts: NDArray[np.int8], each: int) -> int:
        """The bytes of parts of blocks, at so many a vertex."""
        there = np.arange(len(DEPTHS)) < parts[:, None]
        return int(self.source.summary.vertices[there].sum()) * each

    def _of(self, block: int) -> list[Part]:
        """The parts of a block that are to be there."""
        have = self._held.get(block, [])
        for p in range(len(have), int(self.parts[block])):
            have = [*have, self.source.part(p, block)]
            self.read += 1
        return have[: int(self.parts[block])]

    def _assembled(self) -> Hierarchy:
        """The top, and the parts of blocks that are to be there."""
        layout, summary, facts = self.source.layout, self.source.summary, self.source.facts
        top, n = self._top, len(self._top.order)
        blocks = np.flatnonzero(self.parts)
        there = np.arange(len(DEPTHS)) < self.parts[:, None]
        keeps = not self._static and self._bytes(self.parts, BYTES + HELD) <= self.max_memory
        held: dict[int, list[Part]] = {}
        most, base = n + int(summary.vertices[there].sum()), len(top.node)  # (vertices on sides count twice)
        total = base + int(summary.triangles[there].sum()) - 2 * len(blocks)
        vertices = np.empty((most, 3))
        error, radius = np.empty(most, np.float32), np.empty(most, np.float32)
        row, col = top.order.T
        vertices[:n] = np.column_stack([_samples(layout.xs[col], layout), _samples(layout.ys[row], layout), summary.z])
        error[:n], radius[:n] = summary.error, summary.sphere
        corners = np.zeros((total, 3), np.int32)
        corners[:2] = FIRST[0]
        child, node = np.full(total, -1, np.int32), np.full(total, -1, np.int32)
        parents, nodes = np.full((most, 2), -1, np.int32), np.full((most, 4), -1, np.int32)
        off, state = np.empty(total, np.float32), np.empty(total, np.uint8)
        off[:base], state[:base] = rounded_up(summary.off), summary.state
        first = np.arange(n, dtype=np.int32)
        expand(top.node, first, first[:2], 2, corners, child, node, parents, nodes)
        node[top.roots[(summary.vertices.sum(axis=1) > 0) & (self.parts == 0)]] = UNREAD
        numbering = Numbering(layout, top)
        for block in blocks.tolist():
            parts = self._of(block)
            if keeps:
                held[block] = parts
            number, x, y = numbering.of(block, parts)
            vertices[number[4:], 0], vertices[number[4:], 1] = _samples(x, layout), _samples(y, layout)
            vertices[number[4:], 2] = np.concatenate([one.z for one in parts])
            error[number[4:]] = np.concatenate([one.error for one in parts])
            radius[number[4:]] = np.concatenate([one.radius for one in parts])
            splits = np.concatenate([one.node for one in parts])
            expand(splits, number, top.roots[block], base, corners, child, node, parents, nodes)
            end = base + len(splits) - 2
            off[base:end] = np.concatenate([one.off for one in parts])[2:]
            state[base:end] = np.concatenate([one.state for one in parts])[2:]
            base = end
        self._held = held
        parents[parents < 0] = 0
        v = numbering.count
        return Hierarchy(
            vertices[:v], error[:v], radius[:v], parents[:v], corners, child, node, state, off, nodes[:v],
            np.array(self.grid.linear), facts.points, facts.steiner, facts.finest, facts.stuck, facts.whole,
        )  # fmt: skip


def _samples(places: NDArray[np.int64], layout: Layout) -> Floats:
    """Places on the lattice in samples."""
    return np.ldexp(places.astype(np.float64), -layout.bits)


class Numbering:
    """Numbers of vertices in the whole, given out block by block; those on sides between blocks have one.

    Attributes:
        count: how many there are.
    """

    def __init__(self, layout: Layout, top: Top) -> None:
        row, col = top.order.T
        self.layout, self.count = layout, len(row)
        self._corners = np.empty((layout.across + 1, layout.across + 1), np.int32)
        self._corners[row, col] = np.arange(len(row))
        self._sides: dict[tuple[bool, int, int], NDArray[np.int64]] = {}

    def of(self, block: int, parts: list[Part]) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
        """The numbers of a block's vertices, its corners' first; columns and rows of the others on the lattice."""
        layout = self.layout
        r, c = divmod(block, layout.across)
        x = np.concatenate([one.x for one in parts]) + layout.xs[c]
        y = np.concatenate([one.y for one in parts]) + layout.ys[r]
        numbers = np.full(len(x), -1, np.int64)
        sides = [
            ((upright, r + down, c + right), y if upright else x, on)
            for upright, down, right, on in (
                (True, 0, 0, x == layout.xs[c]), (True, 0, 1, x == layout.xs[c + 1]),
                (False, 0, 0, y == layout.ys[r]), (False, 1, 0, y == layout.ys[r + 1]),
            )
        ]  # fmt: skip
        for key, along, on in sides:
            if key in self._sides and on.any():
                known, number = self._sides[key]
                near = np.minimum(np.searchsorted(known, along[on]), len(known) - 1)
                numbers[on] = np.where(known[near] == along[on], number[near], -1)
        new = numbers < 0
        numbers[new] = self.count + np.arange(np.count_nonzero(new))
        self.count += int(np.count_nonzero(new))
        for key, along, on in sides:
            known, number = self._sides.get(key, np.zeros((2, 0), np.int64))
            places, first = np.unique(np.append(known, along[on]), return_index=True)
            self._sides[key] = np.stack([places, np.append(number, numbers[on])[first]])
        corners = self._corners[[r, r, r + 1, r + 1], [c, c + 1, c + 1, c]]
        return np.append(corners, numbers).astype(np.int32), x, y
