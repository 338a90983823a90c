"""SOAR's pass over subtrees, which leaves a strip, and the frontier of those subtrees.

A triangle is (e, x, a), its hypotenuse's first and last end and its apex; m is the hypotenuse's middle, its diamond's
vertex. Vertices are keys ``row << 32 | col`` of the padded square with their heights (metres, NaN where missing).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf, paired
from orograph.lod.criterion import DROP, LEAF, NAN, SPLIT, first_bits, weigh, weigh_both
from orograph.lod.pages import prefetch
from orograph.lod.work_sharing import enters, last, leave, left, stop

MARGIN = 1024
"""Room that a strip needs beyond its length: what one pass through the loop may append, 2n levels ending at once."""


STATE_SHIFT, ALL_BITS = 7, 127
"""A triangle on the stack: its state, behind its bits."""

LENGTH, TRIANGLES, NODES, TAKEN = range(4)
"""Counts: strip length, −1 if there was no room; triangles; diamonds looked at; subtrees taken."""


class Subtrees(NamedTuple):
    """The subtrees of a frontier, in the strip's order.

    Attributes:
        keys: int64 (capacity, 4), (e, x, a, m) of each; heights: float32 (capacity, 4), theirs.
        states: int64 (capacity, 3), level, state, bits.
    """

    keys: NDArray[np.int64]
    heights: NDArray[np.float32]
    states: NDArray[np.int64]


class Stack(NamedTuple):
    """Room for the triangles that wait: int64 (2n + 1, 5) and float32 (2n + 1, 3)."""

    nodes: NDArray[np.int64]
    heights: NDArray[np.float32]


@inlined
def begin_strip(keys, zs, start, length, fresh, even, ak, az, bk, bz):
    """Append (a, b), the first two of three vertices of a triangle, to what is there; the new length.

    Args:
        start: where what is there begins, an even place.
        fresh: whether what follows begins at an even place, as a strip of its own would.
        even: whether the triangle must begin at an even place to turn as it should.
    """
    if length > start:
        keys[length], zs[length] = keys[length - 1], zs[length - 1]
        keys[length + 1], zs[length + 1] = ak, az
        length += 2
        if fresh and length & 1:
            keys[length], zs[length] = ak, az
            length += 1
    if (length & 1 == 0) != even:
        keys[length], zs[length] = ak, az
        length += 1
    keys[length], zs[length] = ak, az
    keys[length + 1], zs[length + 1] = bk, bz
    return length + 2


@inlined
def append_first(keys, zs, start, length, fresh, is_open, newest_is_e, by_leg, level, ek, ez, ak, az, mk, mz):
    """Append leaf (e, a, m), a first child, to the strip; the new length.

    Args:
        is_open: whether the leaf goes on with the strip. newest_is_e: whether the strip's last vertex is e then, not
            the one before. by_leg: whether it is entered over a leg.
    """
    # The edge (a, m) is kept: m is new if it was entered over (e, a), its hypotenuse, else a is.
    keep, keep_z, new, new_z = (mk, mz, ak, az) if by_leg else (ak, az, mk, mz)
    if not is_open:
        even = (level & 1 == 1) == by_leg
        length = begin_strip(keys, zs, start, length, fresh, even, ek, ez, keep, keep_z)
        newest_is_e = False
    keys[length], zs[length] = keep, keep_z
    length += newest_is_e
    keys[length], zs[length] = new, new_z
    return length + 1


@inlined
def append_second(keys, zs, start, length, fresh, is_open, newest_is_e, by_leg, level, ek, ez, xk, xz, ak, az):
    """Append leaf (e, x, a), a second child left over a leg or its hypotenuse, to the strip; the new length.

    Args:
        by_leg: whether it is left over a leg. Others as for ``append_first``.
    """
    if not is_open:
        if by_leg:
            length = begin_strip(keys, zs, start, length, fresh, level & 1 == 1, ek, ez, ak, az)
        else:
            length = begin_strip(keys, zs, start, length, fresh, level & 1 == 0, ak, az, ek, ez)
        newest_is_e = not by_leg
    keys[length], zs[length] = (ak, az) if by_leg else (ek, ez)
    length += newest_is_e == by_leg
    keys[length], zs[length] = xk, xz
    return length + 1


@inlined
def prefetch_below(pages, mk, one, two, three, octave):
    """Have the squares between diamond m and three vertices ready in the cache, and the diamonds on their edges."""
    prefetch(pages, ((one + mk) >> 1) >> 32, ((one + mk) >> 1) & 0xFFFFFFFF, octave)
    prefetch(pages, ((two + mk) >> 1) >> 32, ((two + mk) >> 1) & 0xFFFFFFFF, octave)
    prefetch(pages, ((three + mk) >> 1) >> 32, ((three + mk) >> 1) & 0xFFFFFFFF, octave)


@inlined
def four(table, row):
    """The numbers of a row of four."""
    return table[row, 0], table[row, 1], table[row, 2], table[row, 3]


@inlined
def draws(ek, xk, ak, ez, xz, az, last_row, last_col, squeezed):
    """Whether a leaf is there: no corner is missing, and it does not lie wholly beyond the raster."""
    total = ez + xz + az
    there = total == total
    if squeezed and there:
        there = min(ek, min(xk, ak)) >> 32 < last_row and (
            min(ek & 0xFFFFFFFF, min(xk & 0xFFFFFFFF, ak & 0xFFFFFFFF)) < last_col
        )
    return there


@paired
def refine_subtrees(pages, criterion, leaf_level, subtrees, count, shares, helper, stack, keys, zs, places, counts):
    """Refine the subtrees that this thread takes, and write their strips.

    A leaf (e, x, a), hypotenuse from e to x, is entered over an edge at e and left over one at x; each is a leg or the
    hypotenuse. It is entered over a leg if it lies an even number of levels below the last triangle on the way to it
    that is a second child, left over one if so below the last that is a first child (its sibling is next).

    (Longer than a screen: one loop over two triangles, a strip and their levels, which no part of it can do without.)

    Args:
        pages: ``field.Pages``. criterion: ``Criterion``. leaf_level: 2n.
        subtrees: ``Subtrees`` of a ``frontier``, count of them.
        shares: ``work_sharing.begin``, the state of sharing.
        helper: number of a helper, whose strips are to be joined to the others: each begins at an even place. −1 of the
            thread that takes from the front and makes one strip.
        stack: ``Stack``.
        keys: int64 (capacity,), the strip's vertices, row << 32 | col of the padded square.
        zs: float32 (capacity,), their heights.
        places: int64 (2^(cut + 1), 4): helper, first vertex and length of each subtree's strip that helpers make; out.
        counts: int64 (4,); out.
    """
    helps = helper >= 0
    if helps and not enters(shares):
        return
    nodes, node_zs = stack.nodes, stack.heights
    n = leaf_level >> 1
    last_row, last_col = pages.edge[0], pages.edge[1]
    squeezed = last_row < 1 << n or last_col < 1 << n
    capacity = len(keys) - MARGIN
    start = length = triangles = looked_at = taken = 0
    while left(shares, count):
        subtree = last(shares, count) if helps else taken
        taken += 1
        if helps:
            length += length & 1
            start = length
            places[subtree, 0], places[subtree, 1] = helper, start
        ek, xk, ak, mk = four(subtrees.keys, subtree)
        ez, xz, az, mz = four(subtrees.heights, subtree)
        level0, state, bits = subtrees.states[subtree, 0], subtrees.states[subtree, 1], subtrees.states[subtree, 2]
        level = level0
        second, first = level0, level0  # levels of the last second child on the way, and of the last first child
        is_open = False  # whether the next leaf goes on with the strip
        fresh = True
        newest_is_e = False  # whether the strip's last vertex is the next leaf's e, not the one before
        top = 0
        if state != SPLIT and draws(ek, xk, ak, ez, xz, az, last_row, last_col, squeezed):
            length = begin_strip(keys, zs, start, length, fresh, level & 1 == 1, ek, ez, ak, az)
            keys[length], zs[length] = xk, xz
            length += 1
            triangles += 1
        while state == SPLIT:
            # (e, x, a) is split at m: first child (e, a, m), second (a, x, m).
            level += 1
            first_state = second_state = LEAF
            first_child_bits = second_child_bits = bits
            first_mz = second_mz = NAN
            first_mk = (ek + ak) >> 1
            second_mk = (ak + xk) >> 1
            if level < leaf_level:
                octave = n - 1 - (level >> 1)
                first_state, first_mz, first_child_bits, second_state, second_mz, second_child_bits = weigh_both(
                    pages, criterion, first_mk, second_mk, octave, bits
                )
                if level & 1 == 0 and level + 2 < leaf_level:
                    # What is two levels below a split triangle lies elsewhere in memory: it is fetched in time.
                    if first_state == SPLIT:
                        prefetch_below(pages, first_mk, ek, ak, mk, octave - 1)
                    if second_state == SPLIT:
                        prefetch_below(pages, second_mk, ak, mk, xk, octave - 1)
                looked_at += 2
            if first_state == SPLIT:
                nodes[top, 0], nodes[top, 1], nodes[top, 2] = xk, mk, second_mk
                nodes[top, 3], nodes[top, 4] = level, second_state << STATE_SHIFT | second_child_bits
                node_zs[top, 0], node_zs[top, 1], node_zs[top, 2] = xz, mz, second_mz
                top += 1
                xk, xz, ak, az, mk, mz = ak, az, mk, mz, first_mk, first_mz
                bits = first_child_bits
                first = level
                continue
            if first_state == LEAF and draws(ek, ak, mk, ez, az, mz, last_row, last_col, squeezed):
                by_leg = (level - second) & 1 == 0
                length = append_first(
                    keys, zs, start, length, fresh, is_open, newest_is_e, by_leg, level, ek, ez, ak, az, mk, mz
                )
                is_open, fresh, newest_is_e = True, False, by_leg
                triangles += 1
            else:
                is_open = False
            if second_state == SPLIT:
                ek, ez, ak, az, mk, mz = ak, az, mk, mz, second_mk, second_mz
                bits = second_child_bits
                second = level
                continue
            # The second child, and those that wait: each a leaf, or left out, until one is split.
            ek, ez, ak, az = ak, az, mk, mz
            state = second_state
            while True:
                if state == LEAF and draws(ek, xk, ak, ez, xz, az, last_row, last_col, squeezed):
                    by_leg = (level - first) & 1 == 0
                    length = append_second(
                        keys, zs, start, length, fresh, is_open, newest_is_e, by_leg, level, ek, ez, xk, xz, ak, az
                    )
                    is_open, fresh, newest_is_e = True, False, True
                    triangles += 1
                else:
                    is_open = False
                if top == 0:
                    state = DROP
                    break
                top -= 1
                # A second child begins where the first one ended.
                ek, ez = xk, xz
                xk, ak, mk = nodes[top, 0], nodes[top, 1], nodes[top, 2]
                xz, az, mz = node_zs[top, 0], node_zs[top, 1], node_zs[top, 2]
                level = nodes[top, 3]
                state, bits = nodes[top, 4] >> STATE_SHIFT, nodes[top, 4] & ALL_BITS
                second = level
                first = nodes[top - 1, 3] if top else level0
                if state == SPLIT:
                    break
            if length > capacity:
                break
        if length > capacity:
            length = -1
            stop(shares, count)
            break
        if helps:
            places[subtree, 2] = length - start
    counts[LENGTH], counts[TRIANGLES], counts[NODES], counts[TAKEN] = length, triangles, looked_at, taken
    if helps:
        leave(shares)


@leaf
def frontier(pages, criterion, leaf_level, cut, corners, corner_zs, stack, subtrees):
    """The triangles of level ``cut``, and the coarser ones that are drawn, in the strip's order.

    Args:
        pages, criterion, leaf_level, stack: as for ``refine_subtrees``.
        cut: a level, at most 2n − 1 (0 of a single cell).
        corners, corner_zs: int64 (2, 3), float32 (2, 3): (e, x, a) of both roots.
        subtrees: ``Subtrees`` with room for 2^(cut + 1); out.

    Returns: how many there are, how many of them are to be split, and how many diamonds were looked at.
    """
    nodes, node_zs = stack.nodes, stack.heights
    count = split = looked_at = 0
    for root in range(2):
        top = 0
        ek, xk, ak = corners[root, 0], corners[root, 1], corners[root, 2]
        ez, xz, az = corner_zs[root, 0], corner_zs[root, 1], corner_zs[root, 2]
        level = np.int64(0)
        bits = first_bits(criterion)
        while True:
            mk = (ek + xk) >> 1
            state, mz = LEAF, NAN
            if level < leaf_level:
                state, mz, bits = weigh(pages, criterion, mk, (leaf_level >> 1) - 1 - (level >> 1), bits)
                looked_at += 1
            if state == SPLIT and level < cut:
                level += 1
                nodes[top, 0], nodes[top, 1], nodes[top, 3], nodes[top, 4] = xk, mk, level, bits
                node_zs[top, 0], node_zs[top, 1] = xz, mz
                top += 1
                xk, xz, ak, az = ak, az, mk, mz
                continue
            if state != DROP:
                keys, zs, states = subtrees.keys, subtrees.heights, subtrees.states
                keys[count, 0], keys[count, 1], keys[count, 2], keys[count, 3] = ek, xk, ak, mk
                zs[count, 0], zs[count, 1], zs[count, 2], zs[count, 3] = ez, xz, az, mz
                states[count, 0], states[count, 1], states[count, 2] = level, state, bits
                count += 1
                split += state == SPLIT
            if top == 0:
                break
            top -= 1
            ek, ez = xk, xz
            xk, ak, level, bits = nodes[top, 0], nodes[top, 1], nodes[top, 3], nodes[top, 4]
            xz, az = node_zs[top, 0], node_zs[top, 1]
    return count, split, looked_at
