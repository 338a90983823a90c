"""Encode a chunk's runs (``chunk_code``): the walk of ``chunk_walk`` over a chunk of ``chunked``."""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.chunk_walk import (
    APEX,
    DEEP,
    DROP,
    ENTRY,
    EXIT,
    HIGH,
    HOLES,
    LEVELS,
    MOVED,
    begin,
    drawn,
    halfway,
    halve,
    hangs,
    met,
    onward,
    parameter,
)
from orograph.store.chunked import DEPTH, MET, MISSING, ONES, PARTS, RAW
from orograph.store.chunked_kernels import DROPPED, KEPT, SPLIT, slot

MISSED, HEIGHT, KEPT_, DELTA, REST, AT, BESIDE, DOWN = range(8)
"""Fields of a vertex to write: whether it is missing, its height above ``BASE``, whether its target equals its height,
1 + the difference of its target (zigzag), its residual (zigzag), the depth of the nodes that it splits, whether it lies
on a side of the chunk, the depth of the skirt."""


@kernel
def replay(codes, corners, places, kept, slots):
    """Find the vertices of a walk (``chunked_kernels.write_walk``).

    Args:
        codes, corners: as written. places: (v, 2) int64, written: rows and columns, the corners' first. kept: (v,)
            uint8, written: whether the next coarser level has it. slots: (s, 2) int64, all −1; written: by place, the
            number of the vertex there, or −2 for a triangle without ground whose hypotenuse has its middle there.
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


@kernel
def settle(places, ends, heights, kept, about, targets):
    """The heights of vertices in the next coarser mesh.

    Args:
        places, ends: (v, 2) int64, of ``survey``. heights: (v,) int32, steps. kept: (v,) uint8, whether that mesh has
            them. about: as written. targets: (v,) int32, ``PARTS`` of a step, the corners' as they are; written to.
    """
    for v in range(4, len(heights)):
        targets[v] = MISSING if heights[v] == MISSING else PARTS * heights[v]
        if not kept[v] and heights[v] != MISSING:
            targets[v] = halfway(places, targets, ends[v, 0], ends[v, 1], targets[v], about)


@kernel
def survey(slots, places, levels, ends, told, paths):
    """Walk over a whole chunk.

    Args:
        slots, places: of ``replay``. levels: how many times triangles may be halved. ends: (v, 2) int64, between which
            two vertices each lies. told: (v, 8) int64; of each ``AT``. paths: (t, 2) int64: for each leaf which root
            and then which halves lead to it, the first in the lowest bit; its depth. All are written to.

    Returns: how many leaves each of the two roots has.
    """
    stack = np.empty((DEPTH + 2, 5), np.int64)
    count, before = 0, 0
    for root in range(2):
        before = count
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = 2 * root, 1 + 2 * root, 3 - 2 * root, root, 0
        top = 1
        while top:
            top -= 1
            a, e, f, path, depth = stack[top]
            row, col = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
            b = found(slots, row, col) if depth < levels else -1
            if b < 0:
                paths[count, 0], paths[count, 1] = path, depth
                count += 1
                continue
            ends[b, 0], ends[b, 1], told[b, AT] = e, f, depth
            stack[top, 0], stack[top, 1], stack[top, 2] = b, a, f
            stack[top, 3], stack[top, 4] = path | 2 << depth, depth + 1
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = b, e, a
            stack[top + 1, 3], stack[top + 1, 4] = path, depth + 1
            top += 2
    return before, count - before


@inlined
def found(slots, row, col):
    """The number of the vertex at a place; −1: none; −2: none, and no ground."""
    key = row << 32 | col
    at = slot(slots, key)
    return slots[at, 1] if slots[at, 0] == key else np.int64(-1)


@inlined
def cost(rest, k):
    """The bits of a residual."""
    return (rest >> k) + 1 + k if rest >> k < ONES else ONES + RAW


@kernel
def choose_rices(told, rices):
    """The best Rice parameter for each depth. ``told``: (v, 8), the corners' first; ``rices``: uint8, written to."""
    costs = np.zeros((len(rices), RAW), np.int64)
    for v in range(4, len(told)):
        if not told[v, MISSED]:
            for k in range(RAW):
                costs[told[v, AT], k] += cost(told[v, REST], k)
    for depth in range(len(rices)):
        rices[depth] = np.argmin(costs[depth])


@inlined
def write(words, at, number, width):
    """Write bits; returns the next position."""
    if width:
        shift = at & 31
        words[at >> 5] |= np.uint32(number << shift & 0xFFFFFFFF)
        if shift + width > 32:
            words[(at >> 5) + 1] |= np.uint32(number >> (32 - shift))
    return at + width


@inlined
def write_path(words, at, path, count):
    """Write the number of halves and which they are."""
    at = write(words, at, count, 6)
    for k in range(count):
        at = write(words, at, path >> k & 1, 1)
    return at


@inlined
def trace(slots, places, heights, low, about, paths, span, node, stack, waiting, counts, names, steps, table):
    """Walk over a run.

    Args:
        span: its first leaf and the one after its last. names: numbers of its vertices in the chunk, written to.
        steps: written to: ~0 and ~1 for bits, numbers for vertices. table: as in ``write_runs``.

    Returns: how many steps and vertices there are, and the depth of the node that the run lies in.
    """
    first, last = span[0], span[1]
    path, depth = paths[first, 0], paths[first, 1]
    other, common = path ^ paths[last - 1, 0], min(depth, paths[last - 1, 1])
    for k in range(common, -1, -1):
        if other >> k & 1:
            common = k - 1
    root = path & 1
    names[0], names[1], names[2] = 2 * root, 1 + 2 * root, 3 - 2 * root
    for k in range(common):
        a, e, f = names[0], names[1], names[2]
        b = found(slots, (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1)
        names[0] = b
        names[1], names[2] = (a, f) if path >> (k + 1) & 1 else (e, a)
    begin(node, 0, 1, 2, common)
    counts[0] = counts[1] = 0
    made, count, top, left = 3, 0, 0, depth - common
    while True:
        a, e, f = names[node[APEX]], names[node[ENTRY]], names[node[EXIT]]
        b = np.int64(-1)
        row, col = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
        if node[DEEP] < about[LEVELS]:
            b = found(slots, row, col)
            if left == 0:
                steps[count] = ~np.int64(b >= 0)
                count += 1
        if b >= 0:
            over = left > 0 and path >> (node[DEEP] + 1) & 1
            left = max(left - 1, 0)
            mid = met(node, waiting, counts, places, names, 0, row, col)
            if mid < 0:
                mid, names[made] = made, b
                steps[count] = b
                made, count = made + 1, count + 1
            top = halve(node, mid, over, stack, top)
            continue
        if about[HOLES]:
            steps[count] = ~np.int64(b == -2)
            count += 1
        if b != -2 and drawn(places, heights, a, e, f, about):
            table[2] += 1
            table[3] += hangs(places, low, a, e, about) + hangs(places, low, e, f, about)
            table[3] += hangs(places, low, f, a, about)
        first += 1
        if first == last:
            return count, made, common
        top = onward(node, stack, top, waiting, counts)


@inlined
def spell(told, about, rices, path, depth, common, names, steps, words, at):
    """Encode a run. Args: as for ``trace``; ``words``, ``at``: as for ``write``. Returns where it ends."""
    least, shift = 1 << 62, 0
    for some in range(-4, 4):
        whole = 0
        for step in steps:
            if step >= 0 and not told[step, MISSED]:
                whole += cost(told[step, REST], parameter(rices, told[step, AT], some))
        if whole < least:
            least, shift = whole, some
    at = write(words, at, shift + 4, 3)
    at = write(words, at, path & 1, 1)
    at = write_path(words, at, path >> 1, common)
    at = write_path(words, at, path >> (common + 1), depth - common)
    for k in range(3):
        v = names[k]
        if about[HOLES]:
            at = write(words, at, told[v, MISSED], 1)
        if not told[v, MISSED]:
            at = write(words, at, told[v, HEIGHT], about[HIGH])
            kept = told[v, DELTA] == 1
            at = write(words, at, kept, 1)
            at = write(words, at, told[v, DELTA], 0 if kept else about[MOVED])
            at = write(words, at, told[v, DOWN], about[DROP] if told[v, BESIDE] else 0)
    for step in steps:
        if step < 0:
            at = write(words, at, ~step, 1)
            continue
        if about[HOLES]:
            at = write(words, at, told[step, MISSED], 1)
        if not told[step, MISSED]:
            at = write(words, at, told[step, KEPT_], 1)
            rest, k = told[step, REST], parameter(rices, told[step, AT], shift)
            ones = min(rest >> k, ONES)
            at = write(words, at, (1 << ones) - 1, min(ones + 1, ONES))
            at = write(words, at, rest if ones == ONES else rest & ((1 << k) - 1), RAW if ones == ONES else k)
            at = write(words, at, told[step, DOWN], about[DROP] if told[step, BESIDE] else 0)
    return at


@kernel
def write_runs(slots, places, heights, low, told, about, rices, paths, spans, words, table):
    """Encode runs.

    Args:
        slots, places: of ``replay``. heights, low: (v,) int32, steps. told: (v, 8) int64, of each vertex (see above).
            about: (11,) int64, of the chunk (see above). rices: of ``choose_rices``. paths: of ``survey``. spans: (r,
            2) int64, the first leaf of each run and the one after its last.
        words: (w,) uint32, zeros. table: (r, 4) int64, zeros: words, vertices, triangles, edges that a skirt hangs
            from. Both are written to.

    Returns: how many words there are.
    """
    node, stack, counts = np.empty(7, np.int64), np.empty(DEPTH, np.int64), np.empty(2, np.int64)
    waiting, names, steps = np.empty((2, MET), np.int64), np.empty(MET, np.int64), np.empty(8 * MET, np.int64)
    at = 0
    for run in range(len(spans)):
        count, made, common = trace(
            slots, places, heights, low, about, paths, spans[run], node, stack, waiting, counts, names, steps,
            table[run],
        )  # fmt: skip
        first = spans[run, 0]
        end = spell(told, about, rices, paths[first, 0], paths[first, 1], common, names, steps[:count], words, at)
        table[run, 0], table[run, 1] = (end - at + 31) >> 5, made
        at += 32 * table[run, 0]
    return at >> 5
