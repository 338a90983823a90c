"""SOAR's pass over subtrees, which leaves a strip, and the frontier of those subtrees.

A triangle is (e, x, a), its hypotenuse's first and last end and its apex; m is the hypotenuse's middle, its diamond's
vertex. Vertices are keys ``row << 32 | col`` of the padded square with their heights (metres, NaN where missing).
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf, paired
from orograph.lod.soar_weigh import DROP, EVERYWHERE, LEAF, NAN, SPLIT, call, draws, weigh, weigh_both
from orograph.lod.work_sharing import enters, last, leave, left, stop

MARGIN = 1024
"""Room that a strip needs beyond its length: what one pass through the loop may append, 2n levels ending at once."""


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


@paired
def refine_subtrees(
    pages, lens, metric, cull, pruned, leaf_level, subtrees, subtree_zs, states, count, shares, helper, stack, stack_zs,
    keys, zs, places, counts,
):  # fmt: skip
    """Refine the subtrees that this thread takes, and write their strips.

    A leaf (e, x, a), hypotenuse from e to x, is entered over an edge at e and left over one at x; each is a leg or the
    hypotenuse. It is entered over a leg if it lies an even number of levels below the last triangle on the way to it
    that is a second child, left over one if so below the last that is a first child (its sibling is next).

    Args:
        pages: ``field.Pages``. lens: the camera. metric: its number.
        cull: whether what is out of view is left out.
        pruned: int64, the table of diamonds that are not to be split for their errors (``lod.look_ahead``).
        leaf_level: 2n.
        subtrees, subtree_zs, states: those of a ``frontier``, count of them.
        shares: ``sharing.begin``, the state of sharing.
        helper: number of a helper, whose strips are to be joined to the others: each begins at an even place. −1 of the
            thread that takes from the front and makes one strip.
        stack: int64 (2n + 1, 5), stack_zs: float32 (2n + 1, 3), for the triangles that wait.
        keys: int64 (capacity,), the strip's vertices, row << 32 | col of the padded square.
        zs: float32 (capacity,), their heights.
        places: int64 (2^(cut + 1), 4): helper, first vertex and length of each subtree's strip that helpers make; out.
        counts: int64 (4,): strip length, triangles, diamonds looked at, subtrees taken; out. Length −1 if the capacity
            did not suffice.
    """
    helps = helper >= 0
    if helps and not enters(shares):
        return
    n = leaf_level >> 1
    last_row, last_col = pages.edge[0], pages.edge[1]
    squeezed = last_row < 1 << n or last_col < 1 << n
    capacity = len(keys) - MARGIN
    start = length = triangles = nodes = taken = 0
    while left(shares, count):
        subtree = last(shares, count) if helps else taken
        taken += 1
        if helps:
            length += length & 1
            start = length
            places[subtree, 0], places[subtree, 1] = helper, start
        ek, xk, ak, mk = subtrees[subtree, 0], subtrees[subtree, 1], subtrees[subtree, 2], subtrees[subtree, 3]
        ez, xz, az, mz = (
            subtree_zs[subtree, 0], subtree_zs[subtree, 1], subtree_zs[subtree, 2], subtree_zs[subtree, 3],
        )  # fmt: skip
        level0, state, mask = states[subtree, 0], states[subtree, 1], states[subtree, 2]
        level = level0
        second, ahead = level0, level0  # levels of the last second child on the way, and of the last first child
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
            first_mask = second_mask = mask
            first_mz = second_mz = NAN
            first_mk = (ek + ak) >> 1
            second_mk = (ak + xk) >> 1
            if level < leaf_level:
                octave = n - 1 - (level >> 1)
                first_state, first_mz, first_mask, second_state, second_mz, second_mask = weigh_both(
                    pages, lens, metric, cull, pruned, first_mk, second_mk, octave, mask
                )
                if level & 1 == 0 and level + 2 < leaf_level:
                    # What is two levels below a split triangle lies elsewhere in memory: it is called for in time.
                    if first_state == SPLIT:
                        call(pages, (ek + first_mk) >> 1, octave - 1)
                        call(pages, (ak + first_mk) >> 1, octave - 1)
                        call(pages, (mk + first_mk) >> 1, octave - 1)
                    if second_state == SPLIT:
                        call(pages, (ak + second_mk) >> 1, octave - 1)
                        call(pages, (mk + second_mk) >> 1, octave - 1)
                        call(pages, (xk + second_mk) >> 1, octave - 1)
                nodes += 2
            if first_state == SPLIT:
                stack[top, 0], stack[top, 1], stack[top, 2] = xk, mk, second_mk
                stack[top, 3], stack[top, 4] = level, second_state << 7 | second_mask
                stack_zs[top, 0], stack_zs[top, 1], stack_zs[top, 2] = xz, mz, second_mz
                top += 1
                xk, xz, ak, az, mk, mz = ak, az, mk, mz, first_mk, first_mz
                mask = first_mask
                ahead = level
                continue
            if first_state == LEAF and draws(ek, ak, mk, ez, az, mz, last_row, last_col, squeezed):
                # The edge (a, m) is kept: m is new if it was entered over (e, a), its hypotenuse, else a is.
                by_leg = (level - second) & 1 == 0
                keep, keep_z, new, new_z = (mk, mz, ak, az) if by_leg else (ak, az, mk, mz)
                if not is_open:
                    even = (level & 1 == 1) == by_leg
                    length = begin_strip(keys, zs, start, length, fresh, even, ek, ez, keep, keep_z)
                    is_open, fresh, newest_is_e = True, False, False
                keys[length], zs[length] = keep, keep_z
                length += newest_is_e
                keys[length], zs[length] = new, new_z
                length += 1
                newest_is_e = by_leg
                triangles += 1
            else:
                is_open = False
            if second_state == SPLIT:
                ek, ez, ak, az, mk, mz = ak, az, mk, mz, second_mk, second_mz
                mask = second_mask
                second = level
                continue
            # The second child, and those that wait: each a leaf, or left out, until one is split.
            ek, ez, ak, az = ak, az, mk, mz
            state = second_state
            while True:
                if state == LEAF and draws(ek, xk, ak, ez, xz, az, last_row, last_col, squeezed):
                    by_leg = (level - ahead) & 1 == 0
                    if not is_open:
                        if by_leg:
                            length = begin_strip(keys, zs, start, length, fresh, level & 1 == 1, ek, ez, ak, az)
                        else:
                            length = begin_strip(keys, zs, start, length, fresh, level & 1 == 0, ak, az, ek, ez)
                        is_open, fresh, newest_is_e = True, False, not by_leg
                    keys[length], zs[length] = (ak, az) if by_leg else (ek, ez)
                    length += newest_is_e == by_leg
                    keys[length], zs[length] = xk, xz
                    length += 1
                    newest_is_e = True
                    triangles += 1
                else:
                    is_open = False
                if top == 0:
                    state = DROP
                    break
                top -= 1
                # A second child begins where the first one ended.
                ek, ez = xk, xz
                xk, ak, mk = stack[top, 0], stack[top, 1], stack[top, 2]
                xz, az, mz = stack_zs[top, 0], stack_zs[top, 1], stack_zs[top, 2]
                level = stack[top, 3]
                state, mask = stack[top, 4] >> 7, stack[top, 4] & EVERYWHERE
                second = level
                ahead = stack[top - 1, 3] if top else level0
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
    counts[0], counts[1], counts[2], counts[3] = length, triangles, nodes, taken
    if helps:
        leave(shares)


@leaf
def frontier(
    pages, lens, metric, cull, pruned, leaf_level, cut, corners, corner_zs, stack, stack_zs, subtrees, zs, states
):
    """The triangles of level ``cut``, and the coarser ones that are drawn, in the strip's order.

    Args:
        pages, lens, metric, cull, pruned, leaf_level, stack, stack_zs: as ``refine_subtrees``.
        cut: a level, at most 2n − 1 (0 of a single cell).
        corners, corner_zs: int64 (2, 3), float32 (2, 3): (e, x, a) of both roots.
        subtrees: int64 (2^(cut + 1), 4), (e, x, a, m) of each; zs: float32, their heights.
        states: int64 (2^(cut + 1), 3), level, state, bits.

    Returns: how many there are, how many of them are to be split, and how many diamonds were looked at.
    """
    count = split = nodes = 0
    for root in range(2):
        top = 0
        ek, xk, ak = corners[root, 0], corners[root, 1], corners[root, 2]
        ez, xz, az = corner_zs[root, 0], corner_zs[root, 1], corner_zs[root, 2]
        level = np.int64(0)
        mask = np.int64(EVERYWHERE - 63 if len(pruned) == 1 else 0)
        while True:
            mk = (ek + xk) >> 1
            state, mz = LEAF, NAN
            if level < leaf_level:
                state, mz, mask = weigh(
                    pages, lens, metric, cull, pruned, mk, (leaf_level >> 1) - 1 - (level >> 1), mask
                )
                nodes += 1
            if state == SPLIT and level < cut:
                level += 1
                stack[top, 0], stack[top, 1], stack[top, 3], stack[top, 4] = xk, mk, level, mask
                stack_zs[top, 0], stack_zs[top, 1] = xz, mz
                top += 1
                xk, xz, ak, az = ak, az, mk, mz
                continue
            if state != DROP:
                subtrees[count, 0], subtrees[count, 1], subtrees[count, 2], subtrees[count, 3] = ek, xk, ak, mk
                zs[count, 0], zs[count, 1], zs[count, 2], zs[count, 3] = ez, xz, az, mz
                states[count, 0], states[count, 1], states[count, 2] = level, state, mask
                count += 1
                split += state == SPLIT
            if top == 0:
                break
            top -= 1
            ek, ez = xk, xz
            xk, ak, level, mask = stack[top, 0], stack[top, 1], stack[top, 3], stack[top, 4]
            xz, az = stack_zs[top, 0], stack_zs[top, 1]
    return count, split, nodes
