"""The kernel that decodes chunks of the codec *compact* (``compact``; docs/codec.md has the format).

Nothing read from a chunk is used as an index before it is checked, and the stream of words is copied to a buffer that
allows reading a row beyond the longest possible one. Damaged bytes give a status and touch nothing else.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.codec_head import (
    BITS,
    CUT_OFF,
    DIRECT,
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
)  # fmt: skip

VERSION = 1
LANES = 4
CONTEXTS = 8
CAP = 65535  # largest magnitude that counts for a context
LEVELS = 256  # of activity
HEADER = 8 + 2 * NEIGHBOURS


@inlined
def next_symbol(x, p, words, table, base):
    """Decode a symbol: (the next state, the next word, the symbol)."""
    entry = np.int64(table[np.uint64(base + (x & (TOTAL - 1)))])
    x = ((entry >> 20) + 1) * (x >> BITS) + (entry >> 8 & (TOTAL - 1))
    short = x < LEAST
    more = x << 16 | np.int64(words[np.uint64(p)])
    return more if short else x, p + short, entry & 255


@inlined
def plain_bits(x, p, words, bits):
    """Read plain bits, at most 16: (the next state, the next word, the bits)."""
    value = x & ((np.int64(1) << bits) - 1)
    x >>= bits
    short = x < LEAST
    more = x << 16 | np.int64(words[np.uint64(p)])
    return more if short else x, p + short, value


@kernel
def ranged(x, p, words, symbol, direct):
    """Decode the value of a range symbol and the bits after it: (the state, the next word, the value)."""
    bits = symbol - DIRECT
    x, p, value = plain_bits(x, p, words, min(bits, 16))
    if bits > 16:
        x, p, high = plain_bits(x, p, words, bits - 16)
        value |= high << 16
    return x, p, (np.int64(1) << bits) + value + direct - 1


@inlined
def _step(value, base, north, w0, w1, west, farther):
    """A sample, from its value, the result of ``predicted``, N, and the two samples before it."""
    residual = np.int32(np.int32(value >> np.uint32(1)) ^ -np.int32(value & np.uint32(1)))
    t = np.int32(np.int32(base + np.int32(w1 * farther)) + np.int32(w0 * west))
    return np.int32(np.int32(north + residual) + np.int32(t >> np.int32(12)))


@kernel
def _row(states, p, words, table, depths, direct, deep, begins, values, weights, before, base, near, line):
    """Decode the values of a row in four lanes, and rebuild the samples of the row above it; return the next word.

    The two tasks are independent, and each is mostly latency: a state waits for the table, a sample for the one before
    it. Interleaved, they take little longer than one of them.

    Args:
        states: of the lanes. begins: the offset of each column's table.
        values: (n,) uint32, become the row's.
        weights, base, near: as in ``predicted``, for the row above. before: its values.
        line: (n + 4,) int32, becomes its samples, from index 2 on.
    """
    a, b, c, d = states[0], states[1], states[2], states[3]
    w0, w1 = weights[0], weights[1]
    west = farther = near[2]
    for i in range(values.size // LANES):
        j = np.uint64(4 * i)
        k, l, m = j + np.uint64(1), j + np.uint64(2), j + np.uint64(3)  # noqa: E741
        ca, cb, cc, cd = np.int64(begins[j]), np.int64(begins[k]), np.int64(begins[l]), np.int64(begins[m])
        a, p, va = next_symbol(a, p, words, table, ca)
        b, p, vb = next_symbol(b, p, words, table, cb)
        c, p, vc = next_symbol(c, p, words, table, cc)
        d, p, vd = next_symbol(d, p, words, table, cd)
        if max(max(va, vb), max(vc, vd)) >= DIRECT:
            if va >= DIRECT:
                a, p, va = ranged(a, p, words, va, direct[np.uint64(ca >> BITS)])
            if vb >= DIRECT:
                b, p, vb = ranged(b, p, words, vb, direct[np.uint64(cb >> BITS)])
            if vc >= DIRECT:
                c, p, vc = ranged(c, p, words, vc, direct[np.uint64(cc >> BITS)])
            if vd >= DIRECT:
                d, p, vd = ranged(d, p, words, vd, direct[np.uint64(cd >> BITS)])
        if deep:
            da, db = depths[np.uint64(ca >> BITS)], depths[np.uint64(cb >> BITS)]
            dc, dd = depths[np.uint64(cc >> BITS)], depths[np.uint64(cd >> BITS)]
            a, p, low = plain_bits(a, p, words, da)
            va = va << da | low
            b, p, low = plain_bits(b, p, words, db)
            vb = vb << db | low
            c, p, low = plain_bits(c, p, words, dc)
            vc = vc << dc | low
            d, p, low = plain_bits(d, p, words, dd)
            vd = vd << dd | low
        values[j], values[k], values[l], values[m] = va, vb, vc, vd
        n, o = m + np.uint64(1), m + np.uint64(2)
        e0 = _step(before[j], base[j], near[l], w0, w1, west, farther)
        e1 = _step(before[k], base[k], near[m], w0, w1, e0, west)
        farther = _step(before[l], base[l], near[n], w0, w1, e1, e0)
        west = _step(before[m], base[m], near[o], w0, w1, farther, e1)
        line[l], line[m], line[n], line[o] = e0, e1, farther, west
    states[0], states[1], states[2], states[3] = a, b, c, d
    return p


@kernel
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


@kernel
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
    first = np.int32(u32(data, 4))
    weights = np.empty(NEIGHBOURS + 1, np.int32)
    at: Any = read_weights(data, 8, weights)
    if at + contexts - 1 > data.size:
        return CUT_OFF
    table_of = np.zeros(LEVELS, np.int32)
    for k in range(contexts - 1):
        for level in range(np.int64(data[at + k]), LEVELS):
            table_of[level] += TOTAL
    at += contexts - 1
    table = np.empty(contexts * TOTAL, np.uint32)
    depths, direct = np.zeros(CONTEXTS, np.int64), np.zeros(CONTEXTS, np.int64)
    at = read_tables(data, at, contexts, table, depths, direct)
    if at < 0:
        return TABLES
    marks = np.empty((rows if mode else 0, cols), np.int32)
    if mode:
        at = read_mask(data, at, mode, marks)
        if at < 0:
            return MASK
    if at + 4 * LANES > data.size:
        return CUT_OFF
    states = np.empty(LANES, np.int64)
    for k in range(LANES):
        states[k] = u32(data, at + 4 * k)
    at += 4 * LANES
    count = (data.size - at) // 2
    width = LANES * (-(-cols // LANES))
    words = np.zeros(count + WORDS * width + 1, np.uint16)
    at = read_words(data, at, words[:count])
    p = np.int64(0)
    values, before, padded = np.zeros(width, np.uint32), np.zeros(width, np.uint32), np.zeros(width + 4, np.int32)
    levels, base, lines = np.zeros(width, np.int32), np.zeros(width, np.int32), np.zeros((3, width + 4), np.int32)
    begins = np.zeros(width, np.int32)
    deep = depths.any()
    for row in range(rows):  # the values of this row, and the samples of the one above
        line, near, far = lines[(row + 2) % 3], lines[(row + 1) % 3], lines[row % 3]
        if row > 1:
            predicted(weights, near if row == 2 else far, near, base)
        for col in range(width):
            begins[col] = table_of[np.uint64(levels[col])]
        p = _row(states, p, words, table, depths, direct, deep, begins, values, weights, before, base, near, line)
        if p > count:
            return STREAM
        if row == 1:
            _first(before, first, line)
        if row > 0:
            extend(line, cols)
            out[row - 1] = line[2 : cols + 2]
        activities(values, shift, padded, levels)
        values, before = before, values
    line, near, far = lines[(rows + 2) % 3], lines[(rows + 1) % 3], lines[rows % 3]
    if rows == 1:
        _first(before, first, line)
    else:
        predicted(weights, near if rows == 2 else far, near, base)
        _rebuilt(weights, before, base, near, line)
    out[rows - 1] = line[2 : cols + 2]
    if p != count or at != data.size:
        return STREAM
    for k in range(LANES):
        if states[k] != LEAST:
            return STREAM
    mark_missing(marks, out)
    return 0


@kernel
def _first(values, first, line):
    """Rebuild the first row: each sample is predicted by the one before it."""
    west = first
    for j in range(values.size):
        v = values[j]
        west = np.int32(west + np.int32(np.int32(v >> np.uint32(1)) ^ -np.int32(v & np.uint32(1))))
        line[j + 2] = west


@kernel
def _rebuilt(weights, before, base, near, line):
    """Rebuild the samples of a row, as in ``_row``."""
    west = farther = near[2]
    for j in range(before.size):
        here = _step(before[j], base[j], near[j + 2], weights[0], weights[1], west, farther)
        farther = west
        west = here
        line[j + 2] = here


@kernel
def extend(line, cols):
    """Repeat the first and last sample of a row in the two places beside them."""
    line[0] = line[1] = line[2]
    line[cols + 2] = line[cols + 3] = line[cols + 1]
