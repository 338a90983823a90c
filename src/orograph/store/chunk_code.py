"""Meshes of chunks in a compressed form that a GPU can decode: split bits level by level, quantised heights.

After Dick, Schneider & Westermann, *Efficient Geometry Compression for GPU-based Decoding in Realtime Terrain
Rendering* (Computer Graphics Forum 28(1), 2009): restricted-quadtree meshes of tiles, whose positions follow from how
triangles were split, and whose heights are stored as differences from predictions. There a mesh is a strip along a
path, with one code per triangle. Here it is the binary tree of right triangles level by level: all triangles of a level
are halved at once, and prefix sums tell each where its bit, its vertex and its neighbours are. So a workgroup decodes a
chunk, and no chain of look-ups is longer than the tree is deep. The next coarser mesh, to which vertices move, is
encoded too.

*Words* (uint32) of a chunk: 15 of ``HEADER``, then the following, each padded to whole words. A bit for each owner of a
hypotenuse (``chunk_code_kernels``) in each level but the finest: whether it is split. A bit for each vertex but the
corners: whether the coarser mesh has it. With ``VOIDS``, a bit for each vertex: whether it is missing. A byte for each
``BLOCK`` vertices but the corners: the bit length of their steps. How far the skirt hangs below the vertices on the
chunk's sides, in ``drop`` bits each: 0 for no skirt, or 1 + steps. The vertices' steps (zigzag). With ``VOIDS``, a bit
for each node: whether it has no ground. Vertices are in the order in which the levels create them. All is int32.

A *step* is a power of two in metres: the largest of which all heights of the chunk are multiples, up to 1 km; or the
terrain's own (``step_of``), with which heights are off by half a step at most. All chunks share one lattice, so those
of one level still fit together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.store.chunked import (
    MISSING,
    PARTS,
    PER_WORD,
    Chunk,
    Corners,
    Layout,
    Words,
    on_sides,
    unpacked,
    with_skirt,
)

HEADER = (
    "vertices", "triangles", "hung", "widest", "bits", "sides", "flags", "height0", "height1", "height2", "height3",
    "coarse0", "coarse1", "coarse2", "coarse3",
)  # fmt: skip
"""Of a chunk: the numbers of vertices, triangles, edges with a skirt, nodes of the largest level, bits of splits, and
vertices on its sides; ``flags``: 64 + log2 of the step (8 bits), ``drop`` (8 bits), ``VOIDS``, ``EXACT``; the corners'
heights in steps, and those in the coarser mesh in ``PARTS`` of a step."""

VOIDS, EXACT = 1 << 16, 1 << 17
"""Flags: heights may be missing; heights are exact."""

BLOCK = 16
"""Number of vertices whose steps have the same bit length."""

FINER = 4
"""The error of the finest chunks is at least this many steps."""

MOST = 1 << 18
"""Heights are below this many steps, so that ``PARTS`` of them are also whole numbers in float32."""


class Decoded(NamedTuple):
    """A chunk's mesh in integers.

    Attributes:
        places: (v, 2) int64, rows and columns, not squeezed. heights, targets, low: (v,) int32: heights in steps; in
            the coarser mesh, in ``PARTS`` of a step; the skirt's lower end in steps; ``MISSING`` where there is none.
        triangles: (t, 3) int32. step: metres. exact: whether all heights are exact.
    """

    places: Corners
    heights: NDArray[np.int32]
    targets: NDArray[np.int32]
    low: NDArray[np.int32]
    triangles: NDArray[np.int32]
    step: float
    exact: bool


def step_of(error: float, highest: float) -> float:
    """Return the step of a terrain, metres.

    Args:
        error: the error of its finest chunks, metres. highest: the largest distance of a height from 0, metres.
    """
    fine = math.floor(math.log2(error / FINER)) if error > 0 else -20
    return 2.0 ** max(fine, math.ceil(math.log2(max(highest, 1e-6) / (MOST - 1))), -20)


def encoded(words: Words, layout: Layout, level: int, i: int, j: int, step: float) -> Words:
    """Return the words of a chunk, encoded from those of ``chunked``.

    Args:
        step: the terrain's step, metres (``step_of``).
    """
    from orograph.store.chunk_code_kernels import replay, walk_levels

    codes, count = int(words[0]), int(words[1]) + 4
    at = 2 - (-codes // PER_WORD)
    told = (words[2:at, None] >> np.arange(0, 2 * PER_WORD, 2, dtype=np.uint32) & 3).reshape(-1)[:codes]
    numbers = words[at:].view(np.float32)
    metres, hanging, coarse = numbers[:count], numbers[count:-4], numbers[-4:]
    step, exact = _lattice(metres, step)
    corners = layout.corners(level, i, j)
    slots = np.full((1 << max(2 * codes, 16).bit_length(), 2), -1, np.int64)
    known, kept = np.empty((count, 2), np.int64), np.empty(count, np.uint8)
    replay(told.astype(np.uint8), corners, known, kept, slots)
    bits, dropped = np.zeros(codes + 2, np.uint8), np.zeros(2 * codes + 2, np.uint8)
    places, ends, order = np.empty((count, 2), np.int64), np.empty((count, 2), np.int64), np.empty(count, np.int64)
    leaves, nodes, beyond = np.empty((codes, 3), np.int32), *np.empty((2, codes + 2, 8), np.int64)
    depth = 2 * (layout.p + level)
    _, made, owners, seen, widest = walk_levels(
        bits, dropped, slots, corners, depth, places, ends, order, leaves, nodes, beyond
    )
    metres, kept = metres[order], kept[order]
    missing = np.asarray(np.isnan(metres), np.bool_)
    heights = np.where(missing, MISSING, np.rint(np.where(missing, 0, metres) / step)).astype(np.int64)
    e, f = heights[ends].T
    without = np.where(e == MISSING, np.where(f == MISSING, 0, f), e)
    rests = np.where(missing, 0, heights - np.where((e == MISSING) | (f == MISSING), without, (e + f) >> 1))[4:]
    zigzag = (rests << 1 ^ rests >> 63).astype(np.uint32)
    widths = _lengths(np.append(zigzag, np.zeros(-len(zigzag) % BLOCK, np.uint32)).reshape(-1, BLOCK).max(1, initial=0))
    side = np.asarray(on_sides(known, layout.side(level), i, j).any(0), np.bool_)
    hangs = np.full(count, np.nan)
    hangs[side] = hanging
    hangs, side = hangs[order], side[order]
    with np.errstate(invalid="ignore"):
        down = np.where(np.isnan(hangs) | missing, 0, heights - np.floor(hangs / step) + 1).astype(np.uint32)
    drop = int(_lengths(down[side].max(initial=0)))
    raised = np.where(np.isnan(coarse), MISSING, np.rint(np.nan_to_num(coarse) * (PARTS / step)))
    voids = bool(missing.any() or dropped[:seen].any())
    low = np.where(down > 0, heights - down.astype(np.int64) + 1, MISSING).astype(np.int32)
    found = _alive(leaves[:made], places, heights, layout)
    edges = _hung(found, on_sides(places, layout.side(level), i, j), low)
    flags = 64 + int(math.log2(step)) | drop << 8 | VOIDS * voids | EXACT * exact
    head = np.array([count, len(found), len(edges), widest, owners, side.sum(), flags], np.uint32)
    parts = [_bits(bits[:owners]), _bits(kept[4:])]
    parts += [_bits(missing)] if voids else []
    parts += [_filled(widths.astype(np.uint8)), _bits(_spread(down[side], np.full(side.sum(), drop)))]
    parts += [_bits(_spread(zigzag, np.repeat(widths, BLOCK)[: count - 4]))]
    parts += [_bits(dropped[:seen])] if voids else []
    own = np.concatenate([heights[:4], raised]).astype(np.int32).view(np.uint32)
    return np.concatenate([head, own, *parts])


def decoded(words: Words, layout: Layout, level: int, i: int, j: int) -> Decoded:
    """Return a chunk's mesh from its words, without skirts.

    Raises:
        ValueError: they are not those of a chunk.
    """
    from orograph.store.chunk_code_kernels import raise_vertices, walk_levels

    count, _, _, widest, owners, sides, flags = words[:7].astype(np.int64).tolist()
    step, drop = 2.0 ** ((flags & 255) - 64), flags >> 8 & 255
    own = words[7:15].view(np.int32)
    reader = _Reader(words, 15)
    bits, kept = reader.bits(owners), reader.bits(count - 4)
    missing = reader.bits(count) if flags & VOIDS else np.zeros(count, np.uint8)
    blocks = -(-(count - 4) // BLOCK)
    widths = reader.bytes(blocks)
    down = reader.numbers(np.full(sides, drop))
    zigzag = reader.numbers(np.repeat(widths, BLOCK)[: count - 4])
    dropped = reader.bits(32 * (len(words) - reader.at)) if flags & VOIDS else np.zeros(0, np.uint8)
    places, ends, order = np.empty((count, 2), np.int64), np.empty((count, 2), np.int64), np.empty(count, np.int64)
    leaves, nodes, beyond = np.empty((2 * count + 2, 3), np.int32), *np.empty((2, widest, 8), np.int64)
    found, all_leaves, *_ = walk_levels(
        bits, dropped, np.empty((0, 2), np.int64), layout.corners(level, i, j), 2 * (layout.p + level), places, ends,
        order, leaves, nodes, beyond,
    )  # fmt: skip
    if found != count:
        raise ValueError("These are not the words of a chunk.")
    rests = np.zeros(count, np.int32)
    rests[4:] = (zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32)
    heights, targets = np.empty(count, np.int32), np.empty(count, np.int32)
    heights[:4], targets[:4] = own[:4], own[4:]
    last_row, last_col = (size - 1 for size in layout.shape)
    raise_vertices(rests, missing, np.append(np.ones(4, np.uint8), kept), places, ends, last_row, last_col, heights,
                   targets)  # fmt: skip
    low = np.full(count, MISSING, np.int32)
    side = np.flatnonzero(on_sides(places, layout.side(level), i, j).any(0))
    hung = side[down > 0]
    low[hung] = heights[hung] - down[down > 0].astype(np.int32) + 1
    triangles = _alive(leaves[:all_leaves], places, heights, layout)
    return Decoded(places, heights, targets, low, triangles, step, bool(flags & EXACT))


def chunk_of(words: Words, layout: Layout, level: int, i: int, j: int) -> Chunk:
    """Return a chunk's mesh in metres, with its skirt."""
    mesh = decoded(words, layout, level, i, j)
    last = np.array(layout.shape)[::-1] - 1
    heights, targets, low = (
        np.where(a == MISSING, np.nan, a * (mesh.step / of))
        for a, of in ((mesh.heights, 1), (mesh.targets, PARTS), (mesh.low, 1))
    )
    vertices = np.column_stack([np.minimum(mesh.places[:, ::-1], last), heights])
    return with_skirt(vertices, targets, mesh.triangles, mesh.places, low, layout.side(level), i, j)


def mesh_of(words: Words, layout: Layout, compressed: bool, level: int, i: int, j: int) -> Chunk:
    """Return the mesh of chunk (i, j) of a level from its words, compressed or not."""
    return (chunk_of if compressed else unpacked)(words, layout, level, i, j)


def off_by(words: Words) -> float:
    """Return the largest error of a chunk's heights, metres."""
    flags = int(words[HEADER.index("flags")])
    return 0.0 if flags & EXACT else float(2.0 ** ((flags & 255) - 65))


def hung_edges(mesh: Decoded, layout: Layout, level: int, i: int, j: int) -> NDArray[np.int32]:
    """Return the edges of a chunk that have a skirt, (e, 2)."""
    return _hung(mesh.triangles, on_sides(mesh.places, layout.side(level), i, j), mesh.low)


def _lattice(heights: NDArray[np.float32], least: float) -> tuple[float, bool]:
    """Return the step of a chunk, and whether its heights are multiples of it."""
    there = heights[~np.isnan(heights)].astype(np.float64)
    exact = bool((there / least == np.rint(there / least)).all())
    if not exact:
        return least, False
    every = int(np.bitwise_or.reduce(np.abs(there / least).astype(np.int64), initial=0))
    return min(least * (every & -every or 1 << 40), 1024.0), True


def _alive(leaves: NDArray[np.int32], places: Corners, heights: NDArray[np.int64] | NDArray[np.int32],
           layout: Layout) -> NDArray[np.int32]:  # fmt: skip
    """Return the triangles with three heights and, after squeezing onto the raster's border, an area."""
    at = np.minimum(places, np.array(layout.shape) - 1)[leaves]
    u, v = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    found: NDArray[np.int32] = leaves[(heights[leaves] != MISSING).all(1) & (u[:, 0] * v[:, 1] != u[:, 1] * v[:, 0])]
    return found


def _hung(triangles: NDArray[np.int32], on: NDArray[np.bool_], low: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the edges on a side that have a skirt, (e, 2)."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    found: NDArray[np.int32] = edges[(low[edges] != MISSING).all(1) & np.any([one[edges].all(1) for one in on], axis=0)]
    return found


# ---- bits -----------------------------------------------------------------------------------------------------------


def _lengths(numbers: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return the bit lengths of numbers."""
    return np.ceil(np.log2(np.asarray(numbers, np.float64) + 1)).astype(np.int64)


def _filled(data: NDArray[np.uint8]) -> Words:
    return np.append(data, np.zeros(-len(data) % 4, np.uint8)).view(np.uint32)


def _bits(bits: NDArray[np.generic]) -> Words:
    return _filled(np.packbits(bits.astype(bool), bitorder="little"))


def _spread(numbers: NDArray[np.uint32], widths: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Concatenate the bits of numbers, lowest first."""
    places = np.arange(int(widths.max(initial=0)))
    of: NDArray[np.uint8] = (numbers[:, None] >> places.astype(np.uint32) & 1).astype(np.uint8)
    return of[places < widths[:, None]]


class _Reader:
    """Reads consecutive parts of the words."""

    def __init__(self, words: Words, at: int) -> None:
        self.data, self.at = words, at

    def bytes(self, count: int) -> NDArray[np.int64]:
        size = -(-count // 4)
        self.at += size
        return self.data[self.at - size : self.at].view(np.uint8)[:count].astype(np.int64)

    def bits(self, count: int) -> NDArray[np.uint8]:
        size = -(-count // 32)
        self.at += size
        return np.unpackbits(self.data[self.at - size : self.at].view(np.uint8), count=count, bitorder="little")

    def numbers(self, widths: NDArray[np.int64]) -> NDArray[np.uint32]:
        places = np.arange(int(widths.max(initial=0)))
        mask = places < widths[:, None]
        of = np.zeros(mask.shape, np.uint32)
        of[mask] = self.bits(int(widths.sum()))
        return np.asarray((of << places.astype(np.uint32)).sum(1), np.uint32)
