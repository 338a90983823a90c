"""SOAR's kernels: what becomes of a triangle, the pass over subtrees that leaves a strip, and those subtrees.

A triangle is (e, x, a), its hypotenuse's first and last end and its apex; m is the hypotenuse's middle, its diamond's
vertex. Vertices are keys ``row << 32 | col`` of the padded square with their heights (metres, NaN where missing).
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.error.screen import anisotropic_exceeds, color_exceeds, outside, sphere_exceeds, to_camera
from orograph.lod.pages import BEYOND, locate, prefetch

DROP, LEAF, SPLIT = 0, 1, 2
"""What becomes of a triangle: left out (out of view, or no surface), drawn, or split."""
MARGIN = 1024
"""Room that a strip needs beyond its length: what one pass through the loop may append, 2n levels ending at once."""

EVERYWHERE = 63
"""Bits of all six planes: a sphere known to be inside of them all is not tested again."""

NAN = np.float32(np.nan)


@inlined
def weigh(pages, lens, metric, cull, key, octave, mask):
    """What becomes of the triangles that share the diamond at ``key``: (state, its height, planes it is inside of)."""
    row = key >> 32
    col = key & 0xFFFFFFFF
    slot, at = locate(pages, row, col, octave)
    state = LEAF  # where the page is absent: it is asked for, and this pass is not the last one
    z = NAN
    if slot == BEYOND:
        state = DROP
    elif slot >= 0:
        place = np.uint64(at)
        z = pages.flat[place]
        e = np.float64(pages.flat[place + np.uint64(1)])
        r = np.float64(pages.flat[place + np.uint64(2)]) * lens[15]
        c = pages.flat[place + np.uint64(3)]
        x_at = np.float64(min(col, pages.edge[1]))
        y_at = np.float64(min(row, pages.edge[0]))
        height = np.float64(z)
        out = r < 0.0
        if cull and mask != EVERYWHERE and not out:
            out, mask = outside(lens, x_at, y_at, height, r, mask)
        if out:
            state = DROP
        else:
            if metric == 0:
                exceeds, w = anisotropic_exceeds(lens, x_at, y_at, height, e, r)
            else:
                x, y, w = to_camera(lens, x_at, y_at, height)
                exceeds = sphere_exceeds(lens, metric, x, y, w, e, r)
            if c != np.float32(0.0):
                if c < np.float32(0.0):
                    c = np.float32(-1.0) - c
                    z = NAN
                exceeds |= color_exceeds(lens, np.float64(c), w, r)
            if exceeds:
                state = SPLIT
    return state, z, mask


@inlined
def call(pages, key, octave):
    """Have the diamond at ``key`` ready in the cache."""
    prefetch(pages, key >> 32, key & 0xFFFFFFFF, octave)


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


@inlined
def begin_strip(keys, zs, length, fresh, even, ak, az, bk, bz):
    """Append (a, b), the first two of three vertices of a triangle, to what is there; the new length.

    Args:
        fresh: whether what follows begins at an even place, as a strip of its own would.
        even: whether the triangle must begin at an even place to turn as it should.
    """
    if length:
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


@leaf
def refine_subtrees(
    pages, lens, metric, cull, leaf_level, subtrees, subtree_zs, states, first, last, stack, stack_zs, keys, zs, counts
):
    """Refine triangles and append their strips to what there is.

    A leaf (e, x, a), hypotenuse from e to x, is entered over an edge at e and left over one at x; each is a leg or the
    hypotenuse. It is entered over a leg if it lies an even number of levels below the last triangle on the way to it
    that is a second child, left over one if so below the last that is a first child (its sibling is next).

    Args:
        pages: ``field.Pages``. lens: the camera. metric: its number.
        cull: whether what is out of view is left out.
        leaf_level: 2n.
        subtrees, subtree_zs, states, first, last: those of a ``frontier`` that are to be refined: [first, last).
        stack: int64 (2n + 1, 5), stack_zs: float32 (2n + 1, 3), for the triangles that wait.
        keys: int64 (capacity,), the strip's vertices, row << 32 | col of the padded square.
        zs: float32 (capacity,), their heights.
        counts: int64 (3,): strip length, triangles, diamonds looked at; in and out. Length −1 if the capacity did not
            suffice.
    """
    n = leaf_level >> 1
    last_row, last_col = pages.edge[0], pages.edge[1]
    squeezed = last_row < 1 << n or last_col < 1 << n
    capacity = len(keys) - MARGIN
    length, triangles, nodes = counts[0], counts[1], counts[2]
    for subtree in range(first, last):
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
        if length > capacity:
            length = -1
            break
        if state != SPLIT:
            if draws(ek, xk, ak, ez, xz, az, last_row, last_col, squeezed):
                length = begin_strip(keys, zs, length, fresh, level & 1 == 1, ek, ez, ak, az)
                keys[length], zs[length] = xk, xz
                length += 1
                triangles += 1
            continue
        while True:
            # (e, x, a) is split at m: first child (e, a, m), second (a, x, m).
            level += 1
            first_state = second_state = LEAF
            first_mask = second_mask = mask
            first_mz = second_mz = NAN
            first_mk = (ek + ak) >> 1
            second_mk = (ak + xk) >> 1
            if level < leaf_level:
                octave = n - 1 - (level >> 1)
                first_state, first_mz, first_mask = weigh(pages, lens, metric, cull, first_mk, octave, mask)
                second_state, second_mz, second_mask = weigh(pages, lens, metric, cull, second_mk, octave, mask)
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
                stack[top, 3], stack[top, 4] = level, second_state << 6 | second_mask
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
                    length = begin_strip(keys, zs, length, fresh, (level & 1 == 1) == by_leg, ek, ez, keep, keep_z)
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
                            length = begin_strip(keys, zs, length, fresh, level & 1 == 1, ek, ez, ak, az)
                        else:
                            length = begin_strip(keys, zs, length, fresh, level & 1 == 0, ak, az, ek, ez)
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
                state, mask = stack[top, 4] >> 6, stack[top, 4] & EVERYWHERE
                second = level
                ahead = stack[top - 1, 3] if top else level0
                if state == SPLIT:
                    break
            if state != SPLIT:
                break
            if length > capacity:
                break
        if length > capacity:
            length = -1
            break
    counts[0], counts[1], counts[2] = length, triangles, nodes


@leaf
def frontier(pages, lens, metric, cull, leaf_level, cut, corners, corner_zs, stack, stack_zs, subtrees, zs, states):
    """The triangles of level ``cut``, and the coarser ones that are drawn, in the strip's order.

    Args:
        pages, lens, metric, cull, leaf_level, stack, stack_zs: as ``refine_subtrees``.
        cut: a level, at most 2n − 1 (0 of a single cell).
        corners, corner_zs: int64 (2, 3), float32 (2, 3): (e, x, a) of both roots.
        subtrees: int64 (2^(cut + 1), 4), (e, x, a, m) of each; zs: float32, their heights.
        states: int64 (2^(cut + 1), 3), level, state, planes.

    Returns: how many there are, how many of them are to be split, and how many diamonds were looked at.
    """
    count = split = nodes = 0
    for root in range(2):
        top = 0
        ek, xk, ak = corners[root, 0], corners[root, 1], corners[root, 2]
        ez, xz, az = corner_zs[root, 0], corner_zs[root, 1], corner_zs[root, 2]
        level = mask = np.int64(0)
        while True:
            mk = (ek + xk) >> 1
            state, mz = LEAF, NAN
            if level < leaf_level:
                state, mz, mask = weigh(pages, lens, metric, cull, mk, (leaf_level >> 1) - 1 - (level >> 1), mask)
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
