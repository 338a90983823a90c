"""The kernel that decodes chunks of the codec *compact* (``compact``; docs/codec.md has the format).

Nothing read from a chunk is used as an index before it is checked, and the stream of words is copied to a buffer that
allows reading a row beyond the longest possible one. Damaged bytes give a status and touch nothing else.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph._lanes import LANES32, where
from orograph._lanes32 import load32, marked, shifted_right, spread32, store32
from orograph._numba import inlined, kernel, linked
from orograph.store.codec_head import (
    CUT_OFF,
    LEAST,
    MASK,
    NEIGHBOURS,
    STREAM,
    TABLES,
    TOTAL,
    UNKNOWN,
    WORDS,
    mark_missing,
    read_mask,
    read_tables,
    read_weights,
    read_words,
    u32,
)
from orograph.store.codec_lanes import Tables, add_depths, next_values

VERSION = 3
CONTEXTS = 8
CAP = 65535  # largest magnitude that counts for a context
LEVELS = 256  # of activity
HEADER = 12 + 2 * NEIGHBOURS


@inlined
def _step(own, base, w0, w1, west, farther):
    """A sample, from the sum of N and its residual, the result of ``predicted``, and the two samples before it."""
    t = np.int32(np.int32(base + np.int32(w1 * farther)) + np.int32(w0 * west))
    return np.int32(own + np.int32(t >> np.int32(12)))


@linked
def _row(states, p, words, tables, deep, places, values, before, sums, weights, base, near, line):
    """Decode the values of a row in sixteen lanes, and rebuild the samples of the row above it; return the next word.

    The two tasks are independent, and each is mostly latency: a state waits for the table, a sample for the one before
    it. Interleaved, they take little longer than one of them.

    Args:
        states: (LANES32,) int32. places: (n,) int32, of the columns' tables.
        values: (n,) int32, become the row's. before: those of the row above. sums: (n,) int32, scratch.
        weights, base, near: as in ``predicted``, for the row above.
        line: (n + 4,) int32, becomes its samples, from index 2 on.
    """
    now, every, w0, w1 = load32(states, 0), marked(0xFFFF), weights[0], weights[1]
    west = farther = near[2]
    for group in range(values.size // LANES32):
        at = np.uint64(group * LANES32)
        now, p, found = next_values(now, p, words, tables, deep, load32(places, at), every)
        store32(values, at, found)
        own = load32(before, at)
        store32(sums, at, load32(near, at + np.uint64(2)) + (shifted_right(own, 1) ^ (0 - (own & 1))))
        for k in range(LANES32):
            j = at + np.uint64(k)
            here = _step(sums[j], base[j], w0, w1, west, farther)
            farther = west
            west = here
            line[j + np.uint64(2)] = west
    store32(states, 0, now)
    return p


@linked
def activities(values, shift, padded, levels):
    """Compute the activity around each column of a row: the size of values there, for the contexts of the next row.

    Args:
        values: (n,) uint32, of the row. padded: (n + 4,) int32, zeros at both ends; scratch.
        levels: (n,) int32, become the activity, in 0 to ``LEVELS`` - 1.
    """
    for j in range(values.size):
        padded[j + 2] = np.int32(min(values[j], np.uint32(CAP)))
    for j in range(values.size):
        near = np.int32(3) * padded[j + 2] + np.int32(2) * (padded[j + 1] + padded[j + 3])
        levels[j] = min(np.int32(near + padded[j] + padded[j + 4]) >> np.int32(shift), np.int32(LEVELS - 1))


@linked
def predicted(weights, far, near, out):
    """Compute the part of a row's prediction that comes from the two rows above: all but W's and WW's share.

    Args:
        weights: (12,) int32, in 1/4096: W, WW, NWW, NW, NE, NEE, NNWW, NNW, NN, NNE, NNEE, and N's.
        far, near: int32, the row two above and the one above, each with two more samples at both ends.
        out: int32, becomes the sums, rounding included.
    """
    w2, w3, w4, w5 = weights[2], weights[3], weights[4], weights[5]
    w6, w7, w8, w9, w10, north = weights[6], weights[7], weights[8], weights[9], weights[10], weights[11]
    for j in range(out.size):
        upper = w6 * far[j] + w7 * far[j + 1] + w8 * far[j + 2] + w9 * far[j + 3] + w10 * far[j + 4]
        lower = w2 * near[j] + w3 * near[j + 1] + north * near[j + 2] + w4 * near[j + 3] + w5 * near[j + 4]
        out[j] = np.int32(upper + lower + 2048)


@kernel
def decode(data, out):
    """Decode a chunk.

    Args:
        data: (n,) uint8, its bytes. out: (rows, cols) int32, C order, becomes the samples.

    Returns:
        0, or an error code.
    """
    rows, cols = out.shape
    if data.size < HEADER:
        return CUT_OFF
    mode, contexts, shift = np.int64(data[1]), np.int64(data[2]), np.int64(data[3])
    if data[0] != VERSION or mode > 2:
        return UNKNOWN
    if contexts < 1 or contexts > CONTEXTS or shift > 15:
        return TABLES
    scale = np.int32(u32(data, 4)), np.int32(u32(data, 8))
    weights = np.empty(NEIGHBOURS + 1, np.int32)
    at: Any = read_weights(data, 12, weights)
    if at + contexts - 1 > data.size:
        return CUT_OFF
    bounds = data[at : at + contexts - 1].astype(np.int32)
    at += contexts - 1
    entries = np.empty(contexts * TOTAL, np.uint32)
    depths, direct = np.zeros(contexts, np.int64), np.zeros(contexts, np.int64)
    at = read_tables(data, at, contexts, entries, depths, direct)
    if at < 0:
        return TABLES
    marks = np.empty((rows if mode else 0, cols), np.int32)
    if mode:
        at = read_mask(data, at, mode, marks)
        if at < 0:
            return MASK
    if at + 4 * LANES32 > data.size:
        return CUT_OFF
    states = np.empty(LANES32, np.int32)
    for k in range(LANES32):
        states[k] = np.int32(u32(data, at + 4 * k))
    at += 4 * LANES32
    count, width = (data.size - at) // 2, LANES32 * (-(-cols // LANES32))
    words = np.zeros(count + WORDS * width + LANES32, np.uint16)
    if read_words(data, at, words[:count]) != data.size:
        return STREAM
    tables, deep = Tables(entries.view(np.int32), direct.astype(np.int32)), depths.any()
    places = np.arange(contexts, dtype=np.int32) * np.int32(TOTAL)
    add_depths(places, depths)
    if not _decode_rows(words, count, tables, deep, bounds, places, weights, shift, scale, states, out):
        return STREAM
    mark_missing(marks, out)
    return 0


@linked
def _decode_rows(words, count, tables, deep, bounds, places, weights, shift, scale, states, out):
    """Decode all rows; return whether the words end where they must.

    Args:
        words: uint16, ``count`` of them and zeros after them.
        bounds: the least activities of contexts from the second on. places: of the contexts' tables.
        scale: the sample that is coded as 0, and what a step of 1 stands for. states: (LANES32,).
        out: becomes the chunk.
    """
    rows, cols = out.shape
    width, p = LANES32 * (-(-cols // LANES32)), np.int64(0)
    values, before, sums = np.zeros(width, np.int32), np.zeros(width, np.int32), np.zeros(width, np.int32)
    levels, base, padded = np.zeros(width, np.int32), np.zeros(width, np.int32), np.zeros(width + 4, np.int32)
    lines, own = np.zeros((3, width + 4), np.int32), np.full(width, places[0], np.int32)
    for row in range(rows):  # the values of this row, and the samples of the one above
        line, near, far = lines[(row + 2) % 3], lines[(row + 1) % 3], lines[row % 3]
        if row > 1:
            predicted(weights, near if row == 2 else far, near, base)
        p = _row(states, p, words, tables, deep, own, values, before, sums, weights, base, near, line)
        if p > count:
            return False
        if row == 1:
            _first(before, line)
        if row > 0:
            extend(line, cols)
            _put_line(line, scale, out[row - 1])
        activities(values.view(np.uint32), shift, padded, levels)
        _put_places(levels, bounds, places, own)
        values, before = before, values
    line, near, far = lines[(rows + 2) % 3], lines[(rows + 1) % 3], lines[rows % 3]
    if rows == 1:
        _first(before, line)
    else:
        predicted(weights, near if rows == 2 else far, near, base)
        _rebuilt(weights, before, base, near, line)
    _put_line(line, scale, out[rows - 1])
    return p == count and (states == LEAST).all()


@inlined
def _residual(value):
    """A difference from its zigzag code."""
    return np.int32((value >> np.int32(1)) & np.int32(0x7FFFFFFF)) ^ -np.int32(value & np.int32(1))


@linked
def _put_places(levels, bounds, places, own):
    """The place of each column's table, by its activity."""
    for at in range(0, own.size, LANES32):
        level, found = load32(levels, at), spread32(places[0])
        for k in range(bounds.size):
            found = where(level < bounds[k], found, places[k + 1])
        store32(own, at, found)


@linked
def _put_line(line, scale, out):
    """Put a row's samples in their place."""
    origin, factor = scale
    for j in range(out.size):
        out[j] = line[j + 2] * factor + origin


@linked
def _first(values, line):
    """Rebuild the first row: each sample is predicted by the one before it."""
    west = np.int32(0)
    for j in range(values.size):
        west = np.int32(west + _residual(values[j]))
        line[j + 2] = west


@linked
def _rebuilt(weights, before, base, near, line):
    """Rebuild the samples of a row, as in ``_row``."""
    west = farther = near[2]
    for j in range(before.size):
        here = _step(np.int32(near[j + 2] + _residual(before[j])), base[j], weights[0], weights[1], west, farther)
        farther = west
        west = here
        line[j + 2] = here


@linked
def extend(line, cols):
    """Repeat the first and last sample of a row in the two places beside them."""
    line[0] = line[1] = line[2]
    line[cols + 2] = line[cols + 3] = line[cols + 1]
