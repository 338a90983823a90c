"""The triangles of a chunk level by level, in the order of ``chunk_code``: from a walk, or from the stored bits.

A *node* is a right triangle of the hierarchy: its apex and the two ends of its hypotenuse, as vertex numbers, and
its neighbours in the level across its first leg, its second leg and its hypotenuse, −1 where there is none. All nodes
of a level are halved at once: the k-th one that is split has the children 2k and 2k + 1 in the next level. The *owner*
of a hypotenuse is the first of its two nodes: only the owner has a bit, and its split creates the vertex.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.chunked import MISSING, PARTS
from orograph.store.chunked_kernels import DROPPED, KEPT, SPLIT, slot


@kernel
def replay(codes, corners, places, kept, slots):
    """Find the vertices of a walk (``chunked_kernels.write_walk``).

    Args:
        codes, corners: as written. places: (v, 2) int64, written: rows and columns, the corners' first. kept: (v,)
            uint8, written: whether the next coarser level has it. slots: (s, 2) int64, all −1; written: by place, the
            number of the vertex there, or −2 if it is the middle of the hypotenuse of a triangle without ground.
    """
    stack = np.empty((128, 6), np.int64)
    for k in range(2):
        a, b, c = (0, 1, 3) if k == 1 else (2, 3, 1)
        stack[k, 0], stack[k, 1], stack[k, 2] = corners[a, 0], corners[a, 1], corners[b, 0]
        stack[k, 3], stack[k, 4], stack[k, 5] = corners[b, 1], corners[c, 0], corners[c, 1]
    for k in range(4):
        places[k, 0], places[k, 1], kept[k] = corners[k, 0], corners[k, 1], 1
    top, count = 2, 4
    for n in range(len(codes)):
        top -= 1
        ar, ac, lr, lc, rr, rc = stack[top]
        br, bc = (lr + rr) >> 1, (lc + rc) >> 1
        key = br << 32 | bc
        if codes[n] >= SPLIT:
            at = slot(slots, key)
            if slots[at, 0] == -1:
                slots[at, 0], slots[at, 1] = key, count
                places[count, 0], places[count, 1], kept[count] = br, bc, codes[n] == KEPT
                count += 1
            stack[top, 0], stack[top, 1], stack[top, 2] = br, bc, rr
            stack[top, 3], stack[top, 4], stack[top, 5] = rc, ar, ac
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = br, bc, ar
            stack[top + 1, 3], stack[top + 1, 4], stack[top + 1, 5] = ac, lr, lc
            top += 2
        elif codes[n] == DROPPED:
            at = slot(slots, key)
            slots[at, 0], slots[at, 1] = key, -2


@inlined
def child(nodes, of, which):
    """The child of a neighbour, or −1; ``nodes[:, 6]`` is 1 + the number of split nodes before it, 0 if not split."""
    return np.int64(-1) if of < 0 or nodes[of, 6] == 0 else 2 * (nodes[of, 6] - 1) + which


@kernel
def walk_levels(bits, dropped, slots, corners, levels, places, ends, order, leaves, nodes, beyond):
    """Halve the two triangles of a chunk level by level.

    Args:
        bits: (b,) uint8, whether the owners are split: input, unless there are ``slots``. dropped: (m,) uint8, whether
            each node has no ground; empty: all have; input or output as ``bits``. slots: (s, 2) int64 from ``replay``;
            empty: the bits are the input.
        corners: (4, 2) rows and columns. levels: how many times triangles may be halved.
        places: (v, 2) int64. ends: (v, 2) int64, the two vertices each lies between. order: (v,) int64, its number in
            ``slots``. leaves: (t, 3) int32, triangles that are neither split nor dropped. nodes, beyond: (w, 8) int64,
            room for two levels. All are written to.

    Returns: the numbers of vertices, leaves, bits and nodes, and the nodes of the largest level; the first is −1 if
        there is no room.
    """
    for k in range(4):
        places[k, 0], places[k, 1], order[k] = corners[k, 0], corners[k, 1], k
        ends[k, 0], ends[k, 1] = k, k
    for k in range(2):
        nodes[k, 0], nodes[k, 1], nodes[k, 2] = 2 * k, 1 + 2 * k, 3 - 2 * k
        nodes[k, 3], nodes[k, 4], nodes[k, 5] = -1, -1, 1 - k
    reading = len(slots) == 0
    count, vertices, made, told, seen, widest = 2, 4, 0, 0, 0, 2
    for level in range(levels + 1):
        splits = 0
        for i in range(count):
            e, f, across = nodes[i, 1], nodes[i, 2], nodes[i, 5]
            split, at = False, -1
            row, col = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
            if not reading:
                key = row << 32 | col
                where = slot(slots, key)
                at = slots[where, 1] if slots[where, 0] == key else -1
            if 0 <= across < i:
                split = nodes[across, 6] > 0
                nodes[i, 7] = nodes[across, 7]
            elif level < levels:
                if told == len(bits):
                    return -1, 0, 0, 0, 0
                if not reading:
                    bits[told] = at >= 0
                split = bits[told] == 1
                told += 1
                if split:
                    if vertices == len(places):
                        return -1, 0, 0, 0, 0
                    places[vertices, 0], places[vertices, 1] = row, col
                    ends[vertices, 0], ends[vertices, 1], order[vertices] = e, f, at
                    nodes[i, 7] = vertices
                    vertices += 1
            nodes[i, 6] = splits + 1 if split else 0
            splits += split
            if not split:
                gone = False
                if len(dropped):
                    if seen + i >= len(dropped):
                        return -1, 0, 0, 0, 0
                    if not reading and level < levels:
                        dropped[seen + i] = at == -2
                    gone = dropped[seen + i] == 1
                if not gone:
                    if made == len(leaves):
                        return -1, 0, 0, 0, 0
                    leaves[made, 0], leaves[made, 1], leaves[made, 2] = nodes[i, 0], e, f
                    made += 1
        if 2 * splits > len(beyond):
            return -1, 0, 0, 0, 0
        for i in range(count):
            if nodes[i, 6] == 0:
                continue
            k, b = 2 * (nodes[i, 6] - 1), nodes[i, 7]
            beyond[k, 0], beyond[k, 1], beyond[k, 2] = b, nodes[i, 0], nodes[i, 1]
            beyond[k, 3], beyond[k, 4] = k + 1, child(nodes, nodes[i, 5], 1)
            beyond[k, 5] = child(nodes, nodes[i, 3], 1)
            beyond[k + 1, 0], beyond[k + 1, 1], beyond[k + 1, 2] = b, nodes[i, 2], nodes[i, 0]
            beyond[k + 1, 3], beyond[k + 1, 4] = child(nodes, nodes[i, 5], 0), k
            beyond[k + 1, 5] = child(nodes, nodes[i, 4], 0)
        seen += count
        nodes, beyond, count = beyond, nodes, 2 * splits
        widest = max(widest, count)
        if count == 0:
            break
    return vertices, made, told, seen, widest


@kernel
def raise_vertices(rests, missing, kept, places, ends, last_row, last_col, heights, targets):
    """Compute the heights of vertices from their differences from the middle of their ends.

    Args:
        rests: (v,) int32, steps; not used for the corners. missing, kept: (v,) uint8. places, ends: as written.
            last_row, last_col: of the raster.
        heights: (v,) int32, steps; the corners' are input; ``MISSING`` where there is none. targets: (v,) int32, in
            the next coarser mesh, ``PARTS`` of a step; the corners' are input. Both are written to.
    """
    for v in range(4, len(rests)):
        e, f = ends[v]
        heights[v] = MISSING if missing[v] else guess(heights[e], heights[f]) + rests[v]
        targets[v] = MISSING if missing[v] else PARTS * heights[v]
        if not kept[v] and not missing[v]:
            targets[v] = halfway(
                places[e, 0], places[e, 1], places[f, 0], places[f, 1], targets[e], targets[f], targets[v], last_row,
                last_col,
            )  # fmt: skip


@inlined
def guess(a, b):
    """The predicted height of a vertex between two others, steps."""
    if a == MISSING and b == MISSING:
        return 0
    if a == MISSING:
        return b
    return a if b == MISSING else (a + b) >> 1


@inlined
def halfway(lr, lc, rr, rc, left, right, own, last_row, last_col):
    """``chunked_kernels.middle`` in integers."""
    if left == MISSING or right == MISSING:
        return own
    if max(lr, rr) <= last_row and max(lc, rc) <= last_col:
        return (left + right) >> 1
    if lr == rr:
        return part(lc, rc, left, right, own, last_col)
    if lc == rc:
        return part(lr, rr, left, right, own, last_row)
    return own


@inlined
def part(a, b, left, right, own, last):
    """The height of the line between two ends above the point between them on the raster; an end beyond the raster
    lies on its last sample. Numbers fit 32 bits."""
    low, high = min(a, b), max(a, b)
    under, over = (left, right) if a < b else (right, left)
    whole, done = min(high, last) - min(low, last), min((a + b) >> 1, last) - min(low, last)
    if whole == 0:
        return own
    while whole > 1 << 15:
        whole, done = whole >> 1, done >> 1
    rise = over - under
    sign = -1 if rise < 0 else 1
    size = sign * rise
    return under + sign * (size // whole * done + size % whole * done // whole)
