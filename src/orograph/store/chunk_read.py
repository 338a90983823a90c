"""Read a chunk's runs (``chunk_code``)."""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.chunk_walk import (
    APEX,
    BASE,
    DEEP,
    DROP,
    ENTRY,
    EXIT,
    HIGH,
    HOLES,
    LEVELS,
    MOVED,
    begin,
    beside,
    drawn,
    guess,
    halfway,
    halve,
    met,
    onward,
    parameter,
)
from orograph.store.chunked import DEPTH, MET, MISSING, ONES, PARTS, RAW


@inlined
def take(words, cursor, width):
    """The next bits, at most 32; 0 beyond the words."""
    at, shift = cursor[0] >> 5, cursor[0] & 31
    cursor[0] += width
    if at + 1 >= len(words):
        return np.int64(0)
    both = np.uint64(words[at]) | np.uint64(words[at + 1]) << np.uint64(32)
    return np.int64(both >> np.uint64(shift) & ((np.uint64(1) << np.uint64(width)) - np.uint64(1)))


@inlined
def signed(zigzag):
    return zigzag >> 1 ^ -(zigzag & 1)


@inlined
def hang(words, cursor, about, places, heights, low, v):
    """Read the depth of the skirt below a vertex."""
    low[v] = MISSING
    if heights[v] != MISSING and beside(places, v, about):
        down = take(words, cursor, about[DROP])
        low[v] = heights[v] - down + 1 if down else MISSING


@inlined
def read_corner(words, cursor, about, places, heights, targets, low, v):
    """Read a corner of a run's node."""
    heights[v] = targets[v] = MISSING
    if not about[HOLES] or not take(words, cursor, 1):
        heights[v] = about[BASE] + take(words, cursor, about[HIGH])
        delta = np.int64(1) if take(words, cursor, 1) else take(words, cursor, about[MOVED])
        if delta:
            targets[v] = PARTS * heights[v] + signed(delta - 1)
    hang(words, cursor, about, places, heights, low, v)


@inlined
def read_vertex(words, cursor, about, k, places, heights, targets, low, v, e, f):
    """Read the vertex between two others; ``k``: the Rice parameter."""
    places[v, 0], places[v, 1] = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
    heights[v] = targets[v] = MISSING
    if not about[HOLES] or not take(words, cursor, 1):
        kept, ahead, ones = take(words, cursor, 1), take(words, cursor, ONES), 0
        while ahead >> ones & 1:
            ones += 1
        cursor[0] -= max(ONES - 1 - ones, 0)
        rest = take(words, cursor, RAW) if ones == ONES else ones << k | take(words, cursor, k)
        heights[v] = guess(heights[e], heights[f]) + signed(rest)
        targets[v] = PARTS * heights[v]
        if not kept:
            targets[v] = halfway(places, targets, e, f, targets[v], about)
    hang(words, cursor, about, places, heights, low, v)


@inlined
def read_root(words, cursor, about, corners, places, first):
    """Read the position of a run's node; returns its depth."""
    root = take(words, cursor, 1)
    for k in range(2):
        places[first, k], places[first + 1, k] = corners[2 * root, k], corners[1 + 2 * root, k]
        places[first + 2, k] = corners[3 - 2 * root, k]
    depth = take(words, cursor, 6)
    for _ in range(depth):
        which = take(words, cursor, 1)
        for k in range(2):
            a, e, f = places[first, k], places[first + 1, k], places[first + 2, k]
            places[first, k] = (e + f) >> 1
            places[first + 1, k], places[first + 2, k] = (a, f) if which else (e, a)
    return depth


@kernel
def read_runs(words, starts, leaves, about, rices, corners, places, heights, targets, low, triangles):
    """The mesh of a chunk.

    Args:
        words: of the chunk, two more after them. starts: (r,) int64, the words where runs begin. leaves: of a run.
            about, rices: as written. corners: (4, 2) rows and columns.
        places: (v, 2) int64. heights, targets, low: (v,) int32, steps, targets in ``PARTS``. triangles: (t, 3) int32.
            All are written to.

    Returns: how many vertices and triangles there are; the first is −1 if there is no room.
    """
    node, stack, counts = np.empty(7, np.int64), np.empty(DEPTH, np.int64), np.empty(2, np.int64)
    waiting, cursor, own = np.empty((2, MET), np.int64), np.empty(1, np.int64), np.arange(MET)
    made = first = 0
    for start in starts:
        cursor[0], counts[0], counts[1] = 32 * start, 0, 0
        shift, top, met_leaves, v = take(words, cursor, 3) - 4, 0, 0, first + 3
        if v > len(places):
            return -1, 0
        begin(node, 0, 1, 2, read_root(words, cursor, about, corners, places, first))
        left = take(words, cursor, 6)
        path = cursor[0]
        cursor[0] += left
        end = cursor[0]
        for k in range(3):
            read_corner(words, cursor, about, places, heights, targets, low, first + k)
        while top >= 0:
            a, e, f = first + node[APEX], first + node[ENTRY], first + node[EXIT]
            over = 0
            if path < end:
                here, cursor[0] = cursor[0], path
                over, split = take(words, cursor, 1), np.int64(1)
                path, cursor[0] = path + 1, here
            else:
                split = take(words, cursor, 1) if node[DEEP] < about[LEVELS] else np.int64(0)
            if split:
                row, col = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
                b = met(node, waiting, counts, places, own, first, row, col)
                if node[DEEP] >= about[LEVELS] or (b < 0 and v == min(len(places), first + MET)):
                    return -1, 0
                if b < 0:
                    k = parameter(rices, node[DEEP], shift)
                    read_vertex(words, cursor, about, k, places, heights, targets, low, v, e, f)
                    b = v - first
                    v += 1
                top = halve(node, b, over, stack, top)
                continue
            gone = about[HOLES] and take(words, cursor, 1)
            if not gone and drawn(places, heights, a, e, f, about):
                if made == len(triangles):
                    return -1, 0
                odd = node[DEEP] & 1
                triangles[made, 0], triangles[made, 1 + odd], triangles[made, 2 - odd] = a, e, f
                made += 1
            met_leaves += 1
            if met_leaves == leaves:
                break
            top = onward(node, stack, top, waiting, counts)
        first = v
    return first, made
