"""Meshes of chunks, compressed for decoding on a GPU: runs of triangles, one thread each, with quantised heights.

After Dick, Schneider & Westermann, *Efficient Geometry Compression for GPU-based Decoding in Realtime Terrain
Rendering* (Computer Graphics Forum 28(1), 2009): restricted-quadtree meshes of tiles, along a path with one code per
triangle, whose positions follow from how triangles were split, and whose heights are differences from predictions. Here
the path is the Sierpinski curve through the binary tree of right triangles (``chunk_walk``), cut into *runs* of at most
``LEAVES`` leaves. Runs are independent: a vertex between two runs is in both.

*Words* (uint32) of a chunk: 8 of ``HEADER``; a byte for each depth of the tree but the last, the Rice parameter of its
residuals, padded to whole words; 8 bytes for each run, with its number of words, vertices, triangles and edges with a
skirt; the runs, each padded to whole words. A *run*, with the number of bits in parentheses, the lowest first:

- 4 + the excess of its Rice parameters over those of the chunk (3);
- the node that contains all of its leaves: which of the two roots (1), its depth (6), the halves that lead to it (1
  each);
- the nodes between that and the first leaf, which are all split: how many (6), the halves (1 each); everything before
  the second halves belongs to earlier runs;
- the three corners of that node: the height above ``base``; whether the coarser mesh has the same height (1), or else 0
  if it has none, or 1 + the difference in ``PARTS`` (zigzag);
- the walk, up to ``leaves`` leaves. For each node, unless it is already known or at the maximum depth: whether it is
  split (1). For a vertex that is new in the run: whether the coarser mesh has it (1); its difference from the middle of
  its two ends (zigzag), as a Rice code: its higher bits in unary (ones), a zero, its lower bits; after ``ONES`` ones,
  the number itself (``RAW``).

Corners and vertices on the chunk's sides are followed by the depth of the skirt below them, in ``drop`` bits: 0, no
skirt, or 1 + steps. With ``VOIDS`` they begin with whether they are missing (1; then nothing follows), and each leaf
has a bit for whether it has no ground (1). All arithmetic is int32.

A *step* is a power of two in metres: either the largest one of which all heights of the chunk are multiples, up to 1
km; or the terrain's own (``step_of``), with which heights are off by half a step at most. All chunks share one lattice,
so those of one level still fit together.
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
    WORDS,
    Chunk,
    Corners,
    Layout,
    Words,
    on_sides,
    unpacked,
    with_skirt,
)

HEADER = ("vertices", "triangles", "hung", "runs", "leaves", "flags", "base", "bits")
"""A chunk's counts of vertices, triangles, edges with a skirt, runs, leaves of a run; ``flags``: 64 + log2 of the
step (8 bits), ``drop`` (8 bits), ``VOIDS``, ``EXACT``; the lowest height, steps; bits of a corner's height above that
(8 bits) and of its difference in the coarser mesh (8 bits)."""

VOIDS, EXACT = 1 << 16, 1 << 17
"""Flags: heights may be missing; heights are exact."""

LEAVES = 128
"""Leaves of a run."""

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
    from orograph.store.chunk_write import choose_rices, settle, survey, write_runs

    mesh = _replayed(words, layout.corners(level, i, j))
    count, levels = len(mesh.places), layout.levels(level)
    step, exact = _lattice(mesh.metres, step)
    side = np.asarray(on_sides(mesh.places, layout.side(level), i, j).any(0), np.bool_)
    heights, down = _quantised(mesh, step, side)
    low = np.where(down > 0, heights - down + 1, MISSING).astype(np.int32)
    told, paths = np.zeros((count, 8), np.int64), np.empty((mesh.codes, 2), np.int64)
    ends, targets = np.zeros((count, 2), np.int64), np.empty(count, np.int32)
    leaves = survey(mesh.slots, mesh.places, levels, ends, told, paths)
    targets[:4] = np.where(np.isnan(mesh.coarse), MISSING, np.rint(np.nan_to_num(mesh.coarse) * (PARTS / step)))
    about = _about(layout, level, i, j)
    settle(mesh.places, ends, heights, mesh.kept, about, targets)
    base = _tell(told, heights, targets, ends, mesh.kept, down)
    told[:, 6] = side

    rices, (spans, size) = np.zeros(levels, np.uint8), _spans(*leaves)
    choose_rices(told, rices)
    voids = bool(told[:, 0].any() or (mesh.slots[:, 1] == -2).any())
    high, drop = (int(told[:, k].max()).bit_length() for k in (1, 7))
    moved = int(told[told[:, 3] != 1, 3].max(initial=0)).bit_length()
    about[6:] = voids, drop, base, high, moved
    table, room = np.zeros((len(spans), 4), np.int64), np.zeros(len(spans) * WORDS, np.uint32)
    used = write_runs(mesh.slots, mesh.places, heights, low, told, about, rices, paths, spans, room, table)
    _, vertices, triangles, hung = table.sum(0).tolist()
    flags = 64 + int(math.log2(step)) | drop << 8 | VOIDS * voids | EXACT * exact
    head = vertices, triangles, hung, len(spans), size, flags, base & 0xFFFFFFFF, high | moved << 8
    told_runs = table.astype(np.uint16).reshape(-1).view(np.uint32)
    return np.concatenate([np.array(head, np.uint32), _filled(rices), told_runs, room[:used]])


class _Replayed(NamedTuple):
    """A chunk from the words of ``chunked``.

    The number of codes; heights in metres of vertices, of skirts at vertices on the sides, and of corners in the
    coarser mesh; the other fields are those of ``chunk_write.replay``.
    """

    codes: int
    metres: NDArray[np.float32]
    hanging: NDArray[np.float32]
    coarse: NDArray[np.float32]
    places: Corners
    kept: NDArray[np.uint8]
    slots: NDArray[np.int64]


def _replayed(words: Words, corners: Corners) -> _Replayed:
    from orograph.store.chunk_write import replay

    codes, count = int(words[0]), int(words[1]) + 4
    at = 2 - (-codes // PER_WORD)
    walk = (words[2:at, None] >> np.arange(0, 2 * PER_WORD, 2, dtype=np.uint32) & 3).reshape(-1)[:codes]
    numbers = words[at:].view(np.float32)
    slots = np.full((1 << max(2 * codes, 16).bit_length(), 2), -1, np.int64)
    places, kept = np.empty((count, 2), np.int64), np.empty(count, np.uint8)
    replay(walk.astype(np.uint8), corners, places, kept, slots)
    return _Replayed(codes, numbers[:count], numbers[count:-4], numbers[-4:], places, kept, slots)


def _quantised(mesh: _Replayed, step: float, side: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Heights in steps, and 1 + the depth of the skirt below them, 0 where there is none."""
    missing = np.isnan(mesh.metres)
    heights = np.where(missing, MISSING, np.rint(np.where(missing, 0, mesh.metres) / step)).astype(np.int32)
    hangs = np.full(len(heights), np.nan)
    hangs[side] = mesh.hanging
    there = ~np.isnan(hangs) & ~missing
    down = np.zeros(len(heights), np.int64)
    down[there] = heights[there] - np.floor(hangs[there] / step) + 1
    return heights, down


def _tell(
    told: NDArray[np.int64], heights: NDArray[np.int32], targets: NDArray[np.int32], ends: NDArray[np.int64],
    kept: NDArray[np.uint8], down: NDArray[np.int64],
) -> int:  # fmt: skip
    """Fill in what is written for each vertex (``chunk_write``); returns the lowest height."""
    there, whole = heights != MISSING, heights.astype(np.int64)
    base = int(whole[there].min(initial=MOST)) if there.any() else 0
    e, f = whole[ends].T
    guess = np.where((e == MISSING) | (f == MISSING), np.where(e == MISSING, f, e), (e + f) >> 1)
    told[:, 0], told[:, 2], told[:, 7] = ~there, kept, down
    told[there, 1], told[there, 4] = (whole - base)[there], _zigzag(whole - np.where(guess == MISSING, 0, guess))[there]
    moved = there & (targets != MISSING)
    told[moved, 3] = 1 + _zigzag(targets[moved] - PARTS * whole[moved])
    return base


def decoded(words: Words, layout: Layout, level: int, i: int, j: int) -> Decoded:
    """A chunk's mesh from its words, without skirts; vertices between runs are repeated.

    Raises:
        ValueError: they are not the words of a chunk.
    """
    from orograph.store.chunk_read import read_runs

    count, made, _, _, leaves, flags, _, bits = words[: len(HEADER)].astype(np.int64).tolist()
    levels = layout.levels(level)
    rices = words[len(HEADER) :].view(np.uint8)[:levels]
    _, begin, _ = runs_of(words, np.zeros(1, np.int64), np.array([levels]))
    about = _about(layout, level, i, j)
    about[6:] = bool(flags & VOIDS), flags >> 8 & 255, words[6].astype(np.int32), bits & 255, bits >> 8
    places, triangles = np.empty((count, 2), np.int64), np.empty((made, 3), np.int32)
    heights, targets, low = np.empty((3, count), np.int32)
    found = read_runs(
        np.append(words, np.zeros(2, np.uint32)), begin, leaves, about, rices, layout.corners(level, i, j), places,
        heights, targets, low, triangles,
    )  # fmt: skip
    if found != (count, made):
        raise ValueError("These are not the words of a chunk.")
    return Decoded(places, heights, targets, low, triangles, 2.0 ** ((flags & 255) - 64), bool(flags & EXACT))


def runs_of(
    words: Words, chunks: NDArray[np.int64], depths: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The runs of chunks.

    Args:
        words: of all chunks. chunks: where each begins. depths: of their trees (``Layout.levels``).

    Returns: (r,) of which chunk each run is; where its words begin; (r, 4) how many words, vertices, triangles and
        edges with a skirt it has.
    """
    counts = words[chunks + HEADER.index("runs")].astype(np.int64)
    of, ends = np.repeat(np.arange(len(chunks)), counts), np.cumsum(counts)
    tables = chunks + len(HEADER) - (-depths // 4)
    at = 2 * (np.arange(len(of)) - (ends - counts)[of]) + tables[of]
    table = np.stack([words[at], words[at + 1]], 1).view(np.uint16).astype(np.int64)
    sizes = np.cumsum(table[:, 0]) - table[:, 0]
    return of, (tables + 2 * counts - sizes[ends - counts])[of] + sizes, table


def chunk_of(words: Words, layout: Layout, level: int, i: int, j: int) -> Chunk:
    """Return a chunk's mesh in metres, with its skirt."""
    mesh = decoded(words, layout, level, i, j)
    _, first, of = np.unique(mesh.places[:, 0] << 32 | mesh.places[:, 1], return_index=True, return_inverse=True)
    places, last = mesh.places[first], np.array(layout.shape)[::-1] - 1
    heights, targets, low = (
        np.where(a == MISSING, np.nan, a * (mesh.step / parts))[first]
        for a, parts in ((mesh.heights, 1), (mesh.targets, PARTS), (mesh.low, 1))
    )
    vertices = np.column_stack([np.minimum(places[:, ::-1], last), heights])
    triangles = of.reshape(-1)[mesh.triangles].astype(np.int32)
    return with_skirt(vertices, targets, triangles, places, low, layout.side(level), i, j)


def mesh_of(words: Words, layout: Layout, compressed: bool, level: int, i: int, j: int) -> Chunk:
    """Return the mesh of chunk (i, j) of a level from its words, compressed or not."""
    return (chunk_of if compressed else unpacked)(words, layout, level, i, j)


def off_by(words: Words) -> float:
    """Return the largest error of a chunk's heights, metres."""
    flags = int(words[HEADER.index("flags")])
    return 0.0 if flags & EXACT else float(2.0 ** ((flags & 255) - 65))


def _lattice(heights: NDArray[np.float32], least: float) -> tuple[float, bool]:
    """Return the step of a chunk, and whether its heights are multiples of it."""
    there = heights[~np.isnan(heights)].astype(np.float64)
    exact = bool((there / least == np.rint(there / least)).all())
    if not exact:
        return least, False
    every = int(np.bitwise_or.reduce(np.abs(there / least).astype(np.int64), initial=0))
    return min(least * (every & -every or 1 << 40), 1024.0), True


def _about(layout: Layout, level: int, i: int, j: int) -> NDArray[np.int64]:
    """Facts about a chunk that kernels need in addition to its words (``chunk_walk``)."""
    from orograph.store.chunk_walk import ABOUT

    side, about = layout.side(level), np.zeros(ABOUT, np.int64)
    about[:6] = i * side, j * side, side, layout.shape[0] - 1, layout.shape[1] - 1, layout.levels(level)
    return about


def _spans(*leaves: int) -> tuple[NDArray[np.int64], int]:
    """(r, 2) the first leaf of each run and the one after its last, from the leaves of each root and of a run."""
    size = max(-(-count // -(-count // LEAVES)) for count in leaves)
    firsts, begin = [], 0
    for count in leaves:
        starts = begin + np.arange(0, count, size)
        firsts.append(np.stack([starts, np.minimum(starts + size, begin + count)], 1))
        begin += count
    return np.concatenate(firsts), size


def _zigzag(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    return numbers << 1 ^ numbers >> 63


def _filled(data: NDArray[np.uint8]) -> Words:
    return np.append(data, np.zeros(-len(data) % 4, np.uint8)).view(np.uint32)
