"""The stored form of a QuadTIN's hierarchy: in blocks, and these in parts by depth.

*Blocks* are 2^k × 2^k squares of the quadtree: their corners lie on samples, in straight rows and columns, so each
is a separate hierarchy. Above them is the *top*, the triangles between the squares' corners. A view needs a block only
to the depth that its tolerance requires: *part* 0 is its triangles to depth ``DEPTHS[0]``, and so on.

*Words* (uint32) of a part: numbers of vertices and of triangles; for its vertices, positions on the lattice from the
block's north-western corner (x, y), heights (float64), errors and radii (float32); for its triangles, the vertices that
split them (numbers in the block, after its corners 0 to 3; −1: none), their errors (float32, metres, rounded up) and
whether there is ground. The arrays continue part after part. ``summaries`` holds the facts about all blocks that are
needed before they are read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.store.array_spec import ArraySpec
from orograph.store.terrain import Shape

if TYPE_CHECKING:
    from orograph.store.stored import StoredTerrain

SIDE = 256
"""Approximate samples along a block's side."""

DEPTHS = (8, 13, 64)
"""Depths of triangles in the parts of a block."""

SPLITS = ("nearest", "deviation")
"""Which points split triangles."""

Words = NDArray[np.uint32]
Ints = NDArray[np.int64]
Corners = NDArray[np.int32]


class Layout(NamedTuple):
    """The layout of blocks.

    Attributes:
        bits: of the lattice. xs, ys: (2^k + 1,) int64, columns and rows of their corners on it.
    """

    bits: int
    xs: Ints
    ys: Ints

    @property
    def across(self) -> int:
        """Blocks along a side."""
        return len(self.xs) - 1

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return self.across**2


def layout_of(shape: Shape, side: int = SIDE) -> Layout:
    """The blocks of a raster, with about ``side`` samples a side."""
    from orograph.dem.delaunay import lattice_bits  # (a store can be read without Numba)

    rows, cols = shape
    bits = lattice_bits(rows, cols)
    wanted = round(float(np.log2(max(np.sqrt((rows - 1) * (cols - 1)) / side, 1.0))))
    k = max(min(wanted, max(min(rows, cols) - 1, 1).bit_length() - 1), 0)
    steps = np.arange((1 << k) + 1, dtype=np.int64)
    return Layout(bits, (steps * (cols - 1) >> k) << bits, (steps * (rows - 1) >> k) << bits)


class Top(NamedTuple):
    """The hierarchy above the blocks.

    Attributes:
        node: (t,) int32, the vertex that splits each triangle; −1: it is one of the two that a block begins with.
        order: (v, 2) rows and columns among the blocks' corners of vertices, in the order of their numbers.
        roots: (b, 2) int32, the triangles that each block begins with.
    """

    node: Corners
    order: Ints
    roots: Corners


FIRST = {0: ((2, 0, 1), (0, 2, 3)), 1: ((3, 1, 2), (1, 3, 0))}
"""The corners of a block's two triangles, by the parity of its row + column; corners: north-west, and so clockwise."""


def top_of(across: int) -> Top:
    """The top for this many blocks per side."""
    ids = np.full((across + 1, across + 1), -1, np.int32)
    order = [(0, 0), (0, across), (across, across), (across, 0)]
    for number, at in enumerate(order):
        ids[at] = number
    places = [np.array(order, np.int64)]
    front = np.array([[order[v] for v in FIRST[0][t]] for t in (0, 1)], np.int64)  # (t, 3, 2)
    nodes = []
    for _ in range(2 * (across.bit_length() - 1)):
        middle = (front[:, 0] + front[:, 1]) >> 1
        flat = middle[:, 0] * (across + 1) + middle[:, 1]
        _, first = np.unique(flat, return_index=True)
        new = middle[np.sort(first)]
        ids[new[:, 0], new[:, 1]] = np.arange(len(new)) + sum(map(len, places))
        places.append(new)
        nodes.append(ids[middle[:, 0], middle[:, 1]])
        p, q, a = front[:, 0], front[:, 1], front[:, 2]
        one, two = np.stack([a, p, middle], 1), np.stack([q, a, middle], 1)
        front = np.stack([one, two], 1).reshape(-1, 3, 2)
    row, col = front.min(axis=1).T
    block, apex = row * across + col, front[:, 2]
    parity = (row + col) & 1
    # (The first of a block's triangles has its apex in the north-east, or in the south-east.)
    second = (apex[:, 1] == col) | ((parity == 1) & (apex[:, 0] == row))
    roots = np.zeros((across**2, 2), np.int32)
    roots[block, second.astype(np.int64)] = np.arange(len(front)) + sum(map(len, nodes))
    nodes.append(np.full(len(front), -1, np.int32))
    return Top(np.concatenate(nodes).astype(np.int32), np.concatenate(places), roots)


class Part(NamedTuple):
    """A part of a block, or several consecutive ones including the first.

    Attributes:
        x, y: (v,) int64, on the block's lattice. z: (v,) float64, metres.
        error, radius: (v,) float32, metres.
        node: (t,) int32. off: (t,) float32, metres. state: (t,) uint8.
    """

    x: Ints
    y: Ints
    z: NDArray[np.float64]
    error: NDArray[np.float32]
    radius: NDArray[np.float32]
    node: Corners
    off: NDArray[np.float32]
    state: NDArray[np.uint8]


def cut(part: Part, v0: int, v1: int, t0: int, t1: int) -> Part:
    """Some vertices and triangles of a part."""
    v, t = slice(v0, v1), slice(t0, t1)
    return Part(
        part.x[v], part.y[v], part.z[v], part.error[v], part.radius[v], part.node[t], part.off[t], part.state[t]
    )


def packed(part: Part) -> Words:
    """Encode a part as words."""
    v, t = len(part.x), len(part.node)
    return np.concatenate(
        [
            np.array([v, t], np.uint32), part.x.astype(np.uint32), part.y.astype(np.uint32), part.z.view(np.uint32),
            part.error.view(np.uint32), part.radius.view(np.uint32), part.node.view(np.uint32),
            part.off.view(np.uint32), part.state.astype(np.uint32),
        ]
    )  # fmt: skip


def unpacked(words: Words) -> Part:
    """Decode a part from its words."""
    v, t = int(words[0]), int(words[1])
    x, y, z, error, radius, node, off, state = np.split(words[2:], np.cumsum([v, v, 2 * v, v, v, t, t]))
    return Part(
        x.astype(np.int64), y.astype(np.int64), np.ascontiguousarray(z).view(np.float64), error.view(np.float32),
        radius.view(np.float32), node.view(np.int32), off.view(np.float32), state.astype(np.uint8),
    )  # fmt: skip


class Summary(NamedTuple):
    """Facts about blocks (b,) that are needed before they are read, and about the top's vertices and triangles.

    Attributes:
        centre: (b, 3) float64: column, row, metres of the vertex that splits a block. radius: (b,) metres, around it.
        errors: (b, parts) metres: the largest error of the vertices of each part; 0: it has none.
        vertices: (b, parts) int64, the number in each part. triangles: likewise.
        z, error, sphere: (V,) of the top's vertices. off: (T,) metres, state: (T,) of its triangles.
    """

    centre: NDArray[np.float64]
    radius: NDArray[np.float64]
    errors: NDArray[np.float64]
    vertices: NDArray[np.float64]
    triangles: NDArray[np.float64]
    z: NDArray[np.float64]
    error: NDArray[np.float64]
    sphere: NDArray[np.float64]
    off: NDArray[np.float64]
    state: NDArray[np.float64]


def summary_shapes(across: int) -> dict[str, tuple[int, ...]]:
    """The shapes of a summary's arrays."""
    b, v, t = across**2, (across + 1) ** 2, 4 * across**2 - 2
    p = len(DEPTHS)
    return {
        "centre": (b, 3), "radius": (b,), "errors": (b, p), "vertices": (b, p), "triangles": (b, p), "z": (v,),
        "error": (v,), "sphere": (v,), "off": (t,), "state": (t,),
    }  # fmt: skip


class Facts(NamedTuple):
    """Facts about a whole hierarchy.

    Attributes:
        points: number of vertices of the truth. steiner: number of other vertices. finest: metres.
        stuck: triangles that could not be split although they are further off. whole: whether everything is ground.
    """

    points: int
    steiner: int
    finest: float
    stuck: int
    whole: bool


class MemoryQuadTin:
    """A hierarchy in memory.

    Args:
        words: of each part of each block.
    """

    def __init__(self, layout: Layout, facts: Facts, summary: Summary, words: list[list[Words]]) -> None:
        self.layout, self.facts, self.summary, self.words = layout, facts, summary, words

    def part(self, part: int, block: int) -> Part:
        """A part of a block."""
        return unpacked(self.words[part][block])


def lengths_spec(across: int, part: int, shard: int, chunk: int) -> ArraySpec:
    """The array of the word counts of each block's part."""
    return ArraySpec(f"quadtin/part-{part}/lengths", (across, across), shard, chunk, "uint32", 0.0)


def words_spec(part: int, rows: int, shard: int, chunk: int) -> ArraySpec:
    """The array of the words of all blocks' parts, block after block, ``chunk`` per row."""
    return ArraySpec(f"quadtin/part-{part}/words", (rows, chunk), shard, chunk, "uint32", 0.0)


def summary_spec(across: int, shard: int, chunk: int) -> ArraySpec:
    """The array of the summary: its arrays one after the other, float64 as two words each."""
    count = sum(int(np.prod(shape)) for shape in summary_shapes(across).values())
    return ArraySpec("quadtin/summary", (-(-2 * count // chunk), chunk), shard, chunk, "uint32", 0.0)


class StoredQuadTin:
    """The hierarchy of a store. See ``MemoryQuadTin``. Thread-safe."""

    def __init__(self, terrain: StoredTerrain, what: dict[str, Any]) -> None:
        self.terrain, self._rows = terrain, what["rows"]
        self.layout = layout_of(terrain.grid.shape, what["side"])
        self.facts = Facts(*(what[name] for name in Facts._fields))
        self._sizes = terrain.record.shard, terrain.record.chunk
        across = self.layout.across
        spec = summary_spec(across, *self._sizes)
        words: Words = terrain.opened("quadtin/summary", 0, lambda: spec).read(0, spec.shape[0], 0, spec.shape[1])
        numbers, at, found = np.ascontiguousarray(words).reshape(-1).view(np.float64), 0, {}
        for name, shape in summary_shapes(across).items():
            size = int(np.prod(shape))
            found[name], at = numbers[at : at + size].reshape(shape), at + size
        self.summary = Summary(**found)
        self._starts = [self._lengths(part) for part in range(len(DEPTHS))]

    def _lengths(self, part: int) -> Ints:
        """The offset of each block's words, and the last one's end."""
        across = self.layout.across
        spec = lengths_spec(across, part, *self._sizes)
        found = self.terrain.opened("quadtin/lengths", part, lambda: spec).read(0, across, 0, across)
        return np.append(0, np.cumsum(found.reshape(-1), dtype=np.int64))

    def part(self, part: int, block: int) -> Part:
        """A part of a block.

        Raises:
            DamagedChunkError: as ``terrain.read``.
        """
        begin, end = (int(v) for v in self._starts[part][block : block + 2])
        wide = self._sizes[1]
        first = begin // wide
        array = self.terrain.opened("quadtin/words", part, lambda: words_spec(part, self._rows[part], *self._sizes))
        read: Words = array.read(first, -(-end // wide), 0, wide).reshape(-1)
        return unpacked(read[begin - first * wide : end - first * wide])


QuadTins = MemoryQuadTin | StoredQuadTin
