"""The kernels that decode chunks of the codec *smallest* (``smallest``; docs/codec.md has the format).

A sample's table hangs on the sample before it, so samples are decoded one by one. All that the two rows above say is
worked out beforehand, row by row, with vector instructions. Tables, runs of missing samples and plain bits are those of
*compact*; as there, nothing that is read out of a chunk becomes an index before it is checked.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.compact_decode import (
    BITS,
    CUT_OFF,
    DIRECT,
    LEAST,
    MASK,
    MISSING,
    NEIGHBOURS,
    STREAM,
    TABLES,
    TOTAL,
    UNKNOWN,
    full_weights,
    next_symbol,
    plain_bits,
    predicted,
    ranged,
    read_mask,
    read_tables,
    u16,
    u32,
)  # fmt: skip

VERSION = 1
CLASSES = 4  # at most: of samples, by the parity of row and column
SIGNS = 17  # what makes an activity
ABOVE = 12  # of these are known before the row is decoded
STEPS = 1024  # of activity
BINS = 5  # of what a prediction says besides itself
GROUPS = 32  # of activity, at most
SETS = 48  # tables, at most
CAP = 4095  # of each sign
SMALL = 307  # of activity, in 1/256: where a prediction lies between two numbers tells something
HEADER = 10
CLASS = 2 * NEIGHBOURS + SIGNS  # bytes of a class
WORDS = 5  # that one sample takes at most


@inlined
def size_of(difference):
    """The absolute value of a difference of two samples, in 0 to ``CAP``."""
    wrapped = np.int32(difference)
    return np.int32(min(np.uint32(wrapped if wrapped >= 0 else -wrapped), np.uint32(CAP)))


@kernel
def signs_above(shares, far, near, further, above, out):
    """What the rows above give to the activities of a row.

    Args:
        shares: (SIGNS,) int32, of the signs, in 1/256.
        far, near: (n + 4,) int32, the samples of the row two above and of the one above.
        further, above: (n + 4,) int32, the values of these rows, at most ``CAP``, 0 at both ends.
        out: (n,) int32.
    """
    s0, s1, s2, s3, s4, s5 = shares[0], shares[1], shares[2], shares[3], shares[4], shares[5]
    s6, s7, s8, s9, s10, s11 = shares[6], shares[7], shares[8], shares[9], shares[10], shares[11]
    for j in range(out.size):
        total = s0 * above[j + 2] + s1 * above[j + 1] + s2 * above[j + 3] + s3 * above[j] + s4 * above[j + 4]
        total += s5 * further[j + 2]
        total += s6 * size_of(near[j + 2] - near[j + 1]) + s7 * size_of(near[j + 2] - near[j + 3])
        total += s8 * size_of(near[j + 2] - far[j + 2]) + s9 * size_of(near[j + 3] - far[j + 3])
        total += s10 * size_of(near[j + 1] - far[j + 1]) + s11 * size_of(near[j + 3] - near[j + 4])
        out[j] = np.int32(total)


@inlined
def judged(t, signs, share, north, west, farther, northwest, last):
    """(The prediction of a sample, its activity, whether what is left is told with the other sign, its bin).

    Args:
        t: the weighted sum, in 1/4096, with the half that rounds it. signs: from ``signs_above``.
        share: ``side`` of ``_row``, by which the other signs count. last: the value before, at most ``CAP``.
    """
    said = np.int32(t >> np.int32(12))
    guess = np.int32(north + said)
    activity = np.int64(signs) + share[2] * last + share[3] * size_of(west - northwest)
    activity += share[4] * size_of(west - farther) + share[5] * size_of(said) + share[6] * size_of(west - guess)
    beyond = np.int64(t & 4095) - 2048
    lean = np.int64(np.int32(t)) - 2048
    far = abs(lean) >> 4
    if activity < SMALL:
        return guess, activity, beyond < 0, min(abs(beyond) >> 9, 3)
    steps = np.int64(2 * far > activity) + np.int64(far > activity)
    return guess, activity, lean < 0, steps + np.int64(far > 2 * activity) + np.int64(far > 4 * activity)


@inlined
def weighed(base, w0, west, w1, farther):
    """What the rows above and the two samples before give for a prediction, in 1/4096."""
    return np.int32(np.int32(base + np.int32(w1 * farther)) + np.int32(w0 * west))


@kernel
def _row(state, p, words, table, depths, direct, places, groups, shift, side, skips, bases, signs, near, line, values):
    """Decode a row of samples; (the state, the next word).

    Args:
        places: (2, GROUPS * BINS) int32, where the table begins, by column parity. groups: (STEPS,) uint8.
        side: (2, 9) int32, by column parity: weights of W and WW, shares of the last signs; and what stands for W and
            WW left of the row.
        skips: (n,) uint8, 1 missing, 2 not coded. bases, signs: (n,) int32, what the rows above give.
        near: (n + 4,) int32, the row above. line, values: (n + 4,) int32, become samples and sizes of what is left.
    """
    west, farther, last = side[0, 7], side[0, 8], np.int64(0)
    for j in range(skips.size):
        c = np.uint64(j & 1)
        north = near[j + 2]
        here = north
        left = np.int64(0)
        if skips[j] == 0:
            share = side[c]
            t = weighed(bases[j], share[0], west, share[1], farther)
            said, activity, other, bin_ = judged(t, signs[j], share, north, west, farther, near[j + 1], last)
            group = np.uint64(groups[np.uint64(min(activity >> shift, STEPS - 1))])
            begin = np.int64(places[c, group * np.uint64(BINS) + np.uint64(bin_)])
            state, p, value = next_symbol(state, p, words, table, begin)
            if value >= DIRECT:
                state, p, value = ranged(state, p, words, value, direct[begin >> BITS])
            depth = depths[begin >> BITS]
            if depth:
                state, p, low = plain_bits(state, p, words, depth)
                value = value << depth | low
            residual = np.int32(np.int32(np.uint32(value) >> np.uint32(1)) ^ -np.int32(value & 1))
            here = np.int32(said - residual) if other else np.int32(said + residual)
            left = ((value & 0xFFFFFFFF) + 1) >> 1
        elif skips[j] == 2:
            here = np.int32(0)
        last = min(left, np.int64(CAP))
        values[j + 2] = np.int32(last)
        line[j + 2] = here
        farther = west
        west = here
    return state, p


@kernel
def continued(line, cols):
    """Put two samples beside both ends of a row: on the line through the last two."""
    left = np.int64(line[2]) - line[3] if cols > 1 else 0
    right = np.int64(line[cols + 1]) - line[cols] if cols > 1 else 0
    for k in range(1, 3):
        line[2 - k] = np.int32(line[2] + k * left)
        line[cols + 1 + k] = np.int32(line[cols + 1] + k * right)


@kernel
def class_of(row, classes):
    """The first of the two classes of a row."""
    return 2 * (row & 1) if classes == CLASSES else 0


@kernel
def prepared(row, classes, weights, shares, lines, sizes, halves, side, bases, signs):
    """Work out what the rows above give for a row.

    Args:
        weights: (CLASSES, NEIGHBOURS + 1) int32. shares: (CLASSES, SIGNS) int32.
        lines, sizes: (3, n + 4) int32, the samples, and the values of rows, modulo 3.
        halves: (2, n) int32, scratch. side, bases, signs: as in ``_row``; become the row's.
    """
    near, far = lines[(row + 2) % 3], lines[(row + 1) % 3]
    first = class_of(row, classes)
    slope = np.int32(near[2] - far[2])
    side[0, 7], side[0, 8] = np.int32(near[1] + slope), np.int32(near[0] + slope)
    for c in range(2):
        k = first + c if classes == CLASSES else 0
        side[c, 0], side[c, 1] = weights[k, 0], weights[k, 1]
        side[c, 2:7] = shares[k, ABOVE:]
        if row == 0:
            side[c, 0], side[c, 1], side[c, 3], side[c, 5], side[c, 6] = 2 * TOTAL, -TOTAL, 0, 0, 0
        if c and classes == 1:
            break
        if row:
            predicted(weights[k], far, near, halves[0] if c else bases)
        else:
            bases[:] = np.int32(2048 - (np.int64(near[2]) << 12))
        signs_above(shares[k], far, near, sizes[(row + 1) % 3], sizes[(row + 2) % 3], halves[1] if c else signs)
        if c:
            for j in range(1, bases.size, 2):
                signs[j] = halves[1, j]
                if row:
                    bases[j] = halves[0, j]


@kernel
def _map(data, at, classes, groups, tables, places):
    """Read which table each class, group and bin has; where that ends, or -1."""
    bit, last = at * 8, data.size * 8
    for k in range(classes):
        for g in range(groups):
            for b in range(BINS):
                if bit + 1 > last:
                    return -1
                same = data[bit >> 3] >> (bit & 7) & 1
                bit += 1
                if same:
                    found = places[k, (g - 1) * BINS + b] if g else (places[k, b - 1] if b else np.int32(0))
                else:
                    if bit + 6 > last:
                        return -1
                    value = np.int64(0)
                    for i in range(6):
                        value |= np.int64(data[(bit + i) >> 3] >> ((bit + i) & 7) & 1) << i
                    bit += 6
                    if value >= tables:
                        return -1
                    found = np.int32(value * TOTAL)
                places[k, g * BINS + b] = found
    return (bit + 7) >> 3


@kernel
def decode(data, out):
    """Decode a chunk.

    Args:
        data: (n,) uint8, its bytes. out: (rows, cols) int32, C order, becomes the samples.

    Returns:
        0, or what is wrong (``compact_decode``).
    """
    rows, cols = out.shape
    if data.size < HEADER:
        return CUT_OFF
    mode, classes, shift = np.int64(data[1]), np.int64(data[2]), np.int64(data[3])
    if data[0] != VERSION or mode > 2 or (classes != 1 and classes != CLASSES):
        return UNKNOWN
    first, groups, tables = np.int32(u32(data, 4)), np.int64(data[8]), np.int64(data[9])
    if shift > 15 or groups < 1 or groups > GROUPS or tables < 1 or tables > SETS:
        return TABLES
    at: Any = HEADER
    coded = classes - (classes == CLASSES)
    if at + coded * CLASS + 2 * (groups - 1) > data.size:
        return CUT_OFF
    weights, shares = np.zeros((CLASSES, NEIGHBOURS + 1), np.int32), np.zeros((CLASSES, SIGNS), np.int32)
    given = np.empty(NEIGHBOURS, np.int64)
    for k in range(classes - coded, classes):
        for i in range(NEIGHBOURS):
            given[i] = np.int16(u16(data, at + 2 * i))
        full_weights(given, weights[k])
        for i in range(SIGNS):
            shares[k, i] = data[at + 2 * NEIGHBOURS + i]
        at += CLASS
    group_of = np.zeros(STEPS, np.uint8)
    for _ in range(groups - 1):
        for step in range(u16(data, at), STEPS):
            group_of[step] += 1
        at += 2
    places = np.zeros((CLASSES, GROUPS * BINS), np.int32)
    at = _map(data, at, coded, groups, tables, places[classes - coded :])
    if at < 0:
        return TABLES
    if classes == 1:
        places[1] = places[0]
    table = np.empty(tables * TOTAL, np.uint32)
    depths, direct = np.zeros(SETS, np.int64), np.zeros(SETS, np.int64)
    at = read_tables(data, at, tables, table, depths, direct)
    if at < 0:
        return TABLES
    marks = np.empty((rows if mode else 0, cols), np.int32)
    if mode:
        at = read_mask(data, at, mode, marks)
        if at < 0:
            return MASK
    if at + 4 > data.size:
        return CUT_OFF
    state: Any = np.int64(u32(data, at))
    at += 4
    count = (data.size - at) // 2
    words = np.zeros(count + WORDS * cols + 1, np.uint16)
    for k in range(count):
        words[k] = np.uint16(u16(data, at + 2 * k))
    p: Any = np.int64(0)
    lines, sizes = np.full((3, cols + 4), first, np.int32), np.zeros((3, cols + 4), np.int32)
    side, halves = np.zeros((2, 9), np.int32), np.empty((2, cols), np.int32)
    bases, signs, skips = np.empty(cols, np.int32), np.empty(cols, np.int32), np.zeros(cols, np.uint8)
    for row in range(rows):
        prepared(row, classes, weights, shares, lines, sizes, halves, side, bases, signs)
        if mode:
            for col in range(cols):
                skips[col] = marks[row, col] != 0
        elif classes == CLASSES:
            skips[:] = 0
        if classes == CLASSES and row % 2 == 0:
            skips[::2] = 2
        k, line = class_of(row, classes), lines[row % 3]
        state, p = _row(
            state, p, words, table, depths, direct, places[k : k + 2], group_of, shift, side, skips, bases, signs,
            lines[(row + 2) % 3], line, sizes[row % 3],
        )  # fmt: skip
        if p > count:
            return STREAM
        out[row] = line[2 : cols + 2]
        continued(line, cols)
    if p != count or at + 2 * count != data.size or state != LEAST:
        return STREAM
    if mode:
        for row in range(rows):
            for col in range(cols):
                if marks[row, col]:
                    out[row, col] = MISSING
    return 0
