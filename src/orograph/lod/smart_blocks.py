"""The blocks of SMART: ranges of errors, what is kept of a block, and which range a view asks of it.

A *range* r of errors ends at the threshold ε(r), metres; the last one at 0. The *rank* of a vertex is the first range
in which it is active: its error exceeds ε(r) in that range and all finer ones, so the triangulations of a block are
nested, and all that is kept of a block is a rank and a height for each of its vertices.

A block of exponent p has a side of 2^p samples. Its vertices of the finest spacing are drawn only where they are
samples (blocks of level 0); else they say whether the block must be split: in a block that is drawn none of them is
active.

With a color tolerance a vertex whose colours are off by more has its sphere's radius as its error, if that is larger.
Radii are nested and color errors saturated, so errors stay saturated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf
from orograph.error.screen import outside
from orograph.lod.criterion import color_error, exceeds, look_up, place_of
from orograph.lod.smart_strip import NEAR, ZONES

COARSEST = 16
"""The coarsest range ends at 2^16 m, the finest but the last at 2^−16 m."""

ABSENT, LEAF, INNER = 0, 1, 2
"""States of a block: beyond the view or the ground, drawn, split."""

NONE = -1
NEVER = 255
"""A rank behind all ranges."""

NEAR_PLACES = np.array([[ZONES[z][0], ZONES[z][1], z] for z in NEAR], np.int64)
ZONE_PLACES = np.array(ZONES, np.int64)


def thresholds(each: int) -> NDArray[np.float64]:
    """ε of all ranges, metres, falling; ``each`` of them for a factor of two."""
    return np.append(2.0 ** (COARSEST - np.arange(2 * COARSEST * each + 1) / each), 0.0)


class Tree(NamedTuple):
    """The blocks of a view, by level (0: the finest), row and column.

    Attributes:
        base: int64 (levels,), where the blocks of each level begin. width: int64 (levels,), blocks across.
        states: uint8, of each block. ranges: int16, that of a leaf, or the finest one below.
        slots: int32, where the block's vertices are kept, −1: nowhere.
    """

    base: NDArray[np.int64]
    width: NDArray[np.int64]
    states: NDArray[np.uint8]
    ranges: NDArray[np.int16]
    slots: NDArray[np.int32]

    @classmethod
    def of(cls, n: int, m: int) -> Tree:
        """Blocks of 2^m cells of a square of 2^n."""
        width = 1 << np.arange(n - m, -1, -1, dtype=np.int64)
        base = np.concatenate([[0], np.cumsum(width * width)])
        size = int(base[-1])
        ranges, slots = np.full(size, NONE, np.int16), np.full(size, -1, np.int32)
        return cls(base[:-1], width, np.zeros(size, np.uint8), ranges, slots)


class Kept(NamedTuple):
    """What is kept of blocks, by slot.

    Attributes:
        ranks: uint8 (slots, v), of vertices. empty: uint8 (slots, v), whether there is no surface around them.
        heights: float32 (slots, v), metres, NaN where missing.
        steps: uint8 (slots, ranges), to each range the coarsest one with the same mesh.
        reach: float32 (slots, 2), the lowest and the highest vertex, metres.
        least: uint8 (slots, 1 + near), the least rank of a vertex of the finest spacing: of all, and of those whose
            region touches each near zone.
        last: uint8 (slots,), the largest rank of a vertex whose colours are off by more than γ; 0 where there is none.
    """

    ranks: NDArray[np.uint8]
    empty: NDArray[np.uint8]
    heights: NDArray[np.float32]
    steps: NDArray[np.uint8]
    least: NDArray[np.uint8]
    reach: NDArray[np.float32]
    last: NDArray[np.uint8]

    @classmethod
    def room_for(cls, slots: int, vertices: int, ranges: int) -> Kept:
        """For so many blocks; memory is taken when it is first used."""
        return cls(
            np.empty((slots, vertices), np.uint8), np.empty((slots, vertices), np.uint8),
            np.empty((slots, vertices), np.float32), np.empty((slots, ranges), np.uint8),
            np.empty((slots, 1 + len(NEAR)), np.uint8), np.empty((slots, 2), np.float32), np.empty(slots, np.uint8),
        )  # fmt: skip

    @staticmethod
    def bytes_of(vertices: int, ranges: int) -> int:
        """Of a block."""
        return 6 * vertices + ranges + 10 + len(NEAR)


@inlined
def _octave(row, col, most):
    """How often 2 divides both, at most ``most``."""
    both, octave = row | col, 0
    while octave < most and both & 1 == 0:
        both >>= 1
        octave += 1
    return octave


@inlined
def rank_of(e, ends):
    """The first range in which an error exceeds the threshold; behind the last one for errors of 0."""
    low, high = 0, len(ends)
    while low < high:
        middle = (low + high) >> 1
        if e > ends[middle]:
            high = middle
        else:
            low = middle + 1
    return low


@leaf
def close(kept, slot, side):
    """Activate vertices without surface around them with the vertices that halve their triangles.

    Their own errors are 0, for nothing of them is drawn; but a mask holds what is closed.
    """
    ranks, empty = kept.ranks, kept.empty
    s = 1
    while 2 * s < side:
        for turn in range(2):  # middles of sides first, whose parents are centres of squares
            for y in range(turn * s, side, 2 * s if turn else s):
                for x in range(turn * s, side, 2 * s if turn else s):
                    odd_y, odd_x = y // s & 1, x // s & 1
                    if odd_y + odd_x != 1 + turn:
                        continue
                    down, right = odd_x * s, odd_y * s
                    if turn and (y // (2 * s) + x // (2 * s)) & 1 == 0:
                        right = -right
                    for sign in range(-1, 2, 2):
                        i, j = y + sign * down, x + sign * right
                        if 0 <= i < side and 0 <= j < side and empty[slot, i * side + j]:
                            v = i * side + j
                            ranks[slot, v] = min(ranks[slot, v], ranks[slot, y * side + x])
        s *= 2


@leaf
def keep(pages, n, ends, gamma, shape, names, begin, end, slots, kept, missed, near):
    """Take over the vertices of blocks; ``missed[i]`` is whether pages of block i were absent.

    Args:
        pages: ``field.Pages``. n: of the square. ends: ``thresholds``. gamma: the color tolerance.
        shape: ``smart_strip.Shape``.
        names: int64 (k, 3), exponent, row and column; those in [begin, end) are kept at ``slots`` of ``kept``.
        near: ``NEAR_PLACES``.
    """
    side = shape.side
    for i in range(begin, end):
        p, slot = names[i, 0], slots[i]
        step = np.int64(1 << p) // (side - 1)
        row0, col0 = names[i, 1] << p, names[i, 2] << p
        samples = step == 1
        missed[i], gaps = 0, False
        low, high = np.float32(np.inf), np.float32(-np.inf)
        ranks, least, steps = kept.ranks, kept.least, kept.steps
        for k in range(len(near) + 1):
            least[slot, k] = NEVER
        for r in range(len(ends)):
            steps[slot, r] = 0
        last: int = 0
        for v in range(side * side):
            row, col = row0 + v // side * step, col0 + v % side * step
            found, z, e, r, c = look_up(pages, row << 32 | col, _octave(row, col, n))
            if found == -1 or found == -2:
                missed[i] = 1
            colored = r > 0 and color_error(c) > gamma
            rank = rank_of(np.float64(max(e, r) if colored else e), ends)
            if colored and rank < len(ends):
                last = max(last, rank)
            kept.empty[slot, v] = r < 0
            gaps |= r < 0
            if c >= 0 and (r >= 0 or (row <= pages.edge[0] and col <= pages.edge[1])):
                low, high = min(low, z), max(high, z)
            kept.heights[slot, v] = z if c >= 0 else np.float32(np.nan)
            ranks[slot, v] = rank
            if not samples and shape.finest[v]:
                least[slot, 0] = min(least[slot, 0], rank)
                for k in range(len(near)):
                    if shape.zones[v] >> np.uint32(near[k, 2]) & np.uint32(1):
                        least[slot, 1 + k] = min(least[slot, 1 + k], rank)
            elif rank < len(ends):
                steps[slot, rank] = 1
        kept.reach[slot, 0], kept.reach[slot, 1], kept.last[slot] = low, high, last
        if gaps:
            close(kept, slot, side)
        at = 0
        for r in range(len(ends)):
            at = r if steps[slot, r] else at
            steps[slot, r] = at


@leaf
def weigh(pages, camera, metric, cull, ends, names, ranges):
    """The range that a view asks of blocks, −1 of those out of view or without ground.

    Over the sphere of a block's own diamond, which holds all that it can draw, an error as large as the threshold is
    within the tolerance.

    Args:
        names: int64 (k, 3), exponent, row, column. ranges: int16 (k,); out.

    Returns: whether all pages were there.
    """
    there = True
    for i in range(len(names)):
        p = names[i, 0]
        if p == 0:
            ranges[i] = 0
            continue
        half = np.int64(1) << (p - 1)
        key = ((names[i, 1] << p) + half) << 32 | ((names[i, 2] << p) + half)
        slot, z, _, r, _ = look_up(pages, key, p - 1)
        there &= slot != -1 and slot != -2
        if r < 0:
            ranges[i] = NONE
            continue
        col, row = place_of(pages, key)
        radius = np.float64(r) * camera.stretch
        if cull:
            out, _ = outside(camera, col, row, np.float64(z), radius, np.int64(0))
            if out:
                ranges[i] = NONE
                continue
        low, high = 0, len(ends) - 1
        while low < high:
            middle = (low + high) >> 1
            found, _ = exceeds(camera, metric, col, row, np.float64(z), ends[middle], radius)
            if found:
                low = middle + 1
            else:
                high = middle
        ranges[i] = low
    return there


@leaf
def range_at(tree, level, row, col):
    """(the finest range within a square, its state): that of the block around it where it is part of a larger one."""
    if row < 0 or col < 0 or row >= tree.width[level] or col >= tree.width[level]:
        return NONE, ABSENT
    state = ABSENT
    for k in range(level, len(tree.base)):
        at = tree.base[k] + (row >> (k - level)) * tree.width[k] + (col >> (k - level))
        state = tree.states[at]
        if state == LEAF or (state == INNER and k == level):
            return np.int64(tree.ranges[at]), state
        if state == INNER:
            break
    return NONE, ABSENT


@leaf
def unfit(tree, kept, level, names, near, found):
    """Which leaves of a level must be split for the sake of their neighbours.

    Neighbours are at most twice as small; active vertices of the finest spacing are drawn by blocks of level 0 only.

    Args:
        names: int64 (k, 2), rows and columns. near: ``NEAR_PLACES``. found: uint8 (k,); out.
    """
    for i in range(len(names)):
        row, col = names[i, 0], names[i, 1]
        slot = tree.slots[tree.base[level] + row * tree.width[level] + col]
        found[i] = 0
        for k in range(len(near)):
            range_, state = range_at(tree, level - 1, 2 * row + near[k, 0], 2 * col + near[k, 1])
            if state == INNER or range_ >= np.int64(kept.least[slot, 1 + k]):
                found[i] = 1
                break


@leaf
def gather_ranges(tree, names_by_level):
    """Give every block that is split the finest range below it.

    Args:
        names_by_level: int64 (k, 3): level, row, column of these blocks, finer levels first.
    """
    for i in range(len(names_by_level)):
        level, row, col = names_by_level[i, 0], names_by_level[i, 1], names_by_level[i, 2]
        most: int = NONE
        for k in range(4):
            at = tree.base[level - 1] + (2 * row + (k >> 1)) * tree.width[level - 1] + 2 * col + (k & 1)
            if tree.states[at] != ABSENT:
                most = max(most, int(tree.ranges[at]))
        tree.ranges[tree.base[level] + row * tree.width[level] + col] = most


@leaf
def ask(tree, kept, leaves, zones, wanted):
    """What leaves are asked for: their ranges, those of the zones around them, and the sides with smaller blocks.

    Ranges are the coarsest with the same mesh of the block: only a change of these changes the mesh.

    Args:
        leaves: int64 (k, 3): level, row, column. zones: ``ZONE_PLACES``.
        wanted: uint8 (k, 1 + zones + 1), as ``smart_strip.mask`` has them; out.
    """
    for i in range(len(leaves)):
        level, row, col = leaves[i, 0], leaves[i, 1], leaves[i, 2]
        at = tree.base[level] + row * tree.width[level] + col
        slot, own = tree.slots[at], np.int64(tree.ranges[at])
        wanted[i, 0] = kept.steps[slot, own]
        for z in range(len(zones)):
            y, x = 2 * row + zones[z, 0], 2 * col + zones[z, 1]
            # (Blocks of level 0 have no smaller ones beside them.)
            range_, _ = range_at(tree, level - 1, y, x) if level else range_at(tree, level, y >> 1, x >> 1)
            wanted[i, 1 + z] = kept.steps[slot, max(own, range_)]
        sides = 0
        for k in range(4):
            down, right = (k == 2) - (k == 0), (k == 1) - (k == 3)
            _, state = range_at(tree, level, row + down, col + right)
            sides |= (state == INNER) << k
        wanted[i, 1 + len(zones)] = sides


@kernel
def list_leaves(tree, leaves):
    """The leaves along a Z-curve, int64 (k, 3): level, row, column; out. How many there are."""
    top = len(tree.base) - 1
    stack = np.zeros((4 * (top + 1), 3), np.int64)
    stack[0, 0] = top
    size, count = 1, 0
    while size:
        size -= 1
        level, row, col = stack[size, 0], stack[size, 1], stack[size, 2]
        state = tree.states[tree.base[level] + row * tree.width[level] + col]
        if state == LEAF:
            leaves[count, 0], leaves[count, 1], leaves[count, 2] = level, row, col
            count += 1
        elif state == INNER:
            for k in range(3, -1, -1):
                stack[size, 0], stack[size, 1], stack[size, 2] = level - 1, 2 * row + (k >> 1), 2 * col + (k & 1)
                size += 1
    return count
