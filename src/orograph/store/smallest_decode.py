"""The kernels that decode chunks of the codec *smallest* (``smallest``; docs/codec.md has the format).

A sample's table hangs on the sample before it, so samples are decoded one by one. All that the two rows above say is
worked out beforehand, row by row, with vector instructions. The two parts of a chunk, its upper and its lower rows,
share nothing but weights and tables, and are decoded in turn. Tables, runs of missing samples and plain bits are those
of *compact*; as there, nothing that is read out of a chunk becomes an index before it is checked.
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
    mark_missing,
    read_mask,
    read_tables,
    read_weights,
    read_words,
    u16,
    u32,
)
from orograph.store.compact_decode import (
    next_symbol,
    plain_bits,
    predicted,
    ranged,
)

VERSION = 2
PARTS = 2  # at most: of a chunk, each decoded by itself
CLASSES = 4  # at most: of samples, by the parity of row and column
SIGNS = 17  # what makes an activity
ABOVE = 12  # of these are known before the row is decoded
STEPS = 1024  # of activity
BINS = 5  # of what a prediction says besides itself
GROUPS = 32  # of activity, at most
SETS = 48  # tables, at most
CAP = 4095  # of each sign
FIRST_ROW = 128  # share of the two signs that a first row has, in 1/256
SMALL = 307  # of activity, in 1/256: where a prediction lies between two numbers tells something
HEADER = 11
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
def judged(t, signs, side, c, north, west, farther, northwest, last):
    """(The prediction of a sample, its activity, whether what is left is told with the other sign, its bin).

    Args:
        t: the weighted sum, in 1/4096, with the half that rounds it. signs: from ``signs_above``.
        side: a part's of ``_row``, by which the other signs count. c: the column's parity.
        last: the size of what was left of the sample before, at most ``CAP``.
    """
    said = np.int32(t >> np.int32(12))
    guess = np.int32(north + said)
    activity = np.int64(signs) + side[c, 2] * last + side[c, 3] * size_of(west - northwest)
    activity += side[c, 4] * size_of(west - farther) + side[c, 5] * size_of(said) + side[c, 6] * size_of(west - guess)
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


@inlined
def _sample(state, p, words, table, depths, direct, places, c, groups, shift, side, skip, base, sign, north, northwest,
            west, farther, last):  # fmt: skip
    """Decode a sample; (the state, the next word, the sample, the size of what was left of it)."""
    if skip:
        return state, p, north if skip == 1 else np.int32(0), np.int64(0)
    t = weighed(base, side[c, 0], west, side[c, 1], farther)
    said, activity, other, bin_ = judged(t, sign, side, c, north, west, farther, northwest, last)
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
    turned = -np.int32(other)  # (no branch: which sign it is cannot be foreseen)
    here = np.int32(said + ((residual ^ turned) - turned))
    return state, p, here, min(((value & 0xFFFFFFFF) + 1) >> 1, np.int64(CAP))


@kernel
def _row(
    states, at, words, table, depths, direct, places, groups, shift, side, skips, bases, signs, near, line, values
):
    """Decode a row of the first part.

    Args:
        states, at: (PARTS,) int64, of each part the state and the next word, which go on. words: (PARTS, …) uint16.
        places: (2, GROUPS * BINS) int32, where the table begins, by column parity. groups: (STEPS,) uint8.
        side: (PARTS, 2, 9) int32, by column parity: weights of W and WW, shares of the last signs; and what stands for
            W and WW left of the row.
        skips: (PARTS, n) uint8, 1 missing, 2 not coded. bases, signs: (PARTS, n) int32, what the rows above give.
        near: (PARTS, n + 4) int32, the row above. line, values: (PARTS, n + 4) int32, become samples and sizes of what
            is left.
    """
    state, p, some, left = states[0], at[0], words[0], side[0]
    west, farther, last = left[0, 7], left[0, 8], np.int64(0)
    for j in range(skips.shape[1]):
        state, p, here, last = _sample(
            state, p, some, table, depths, direct, places, np.uint64(j & 1), groups, shift, left, skips[0, j],
            bases[0, j], signs[0, j], near[0, j + 2], near[0, j + 1], west, farther, last,
        )  # fmt: skip
        values[0, j + 2], line[0, j + 2] = np.int32(last), here
        farther, west = west, here
    states[0], at[0] = state, p


@kernel
def _rows(
    states, at, words, table, depths, direct, places, groups, shift, side, skips, bases, signs, near, line, values
):
    """Decode a row of either part, sample by sample in turn: while one waits for itself, the other goes on.

    Args: as of ``_row``.
    """
    state0, p0, words0, side0 = states[0], at[0], words[0], side[0]
    state1, p1, words1, side1 = states[1], at[1], words[1], side[1]
    west0, farther0, last0 = side0[0, 7], side0[0, 8], np.int64(0)
    west1, farther1, last1 = side1[0, 7], side1[0, 8], np.int64(0)
    for j in range(skips.shape[1]):
        c = np.uint64(j & 1)
        state0, p0, here0, last0 = _sample(
            state0, p0, words0, table, depths, direct, places, c, groups, shift, side0, skips[0, j],
            bases[0, j], signs[0, j], near[0, j + 2], near[0, j + 1], west0, farther0, last0,
        )  # fmt: skip
        state1, p1, here1, last1 = _sample(
            state1, p1, words1, table, depths, direct, places, c, groups, shift, side1, skips[1, j],
            bases[1, j], signs[1, j], near[1, j + 2], near[1, j + 1], west1, farther1, last1,
        )  # fmt: skip
        values[0, j + 2], line[0, j + 2] = np.int32(last0), here0
        values[1, j + 2], line[1, j + 2] = np.int32(last1), here1
        farther0, west0 = west0, here0
        farther1, west1 = west1, here1
    states[0], at[0], states[1], at[1] = state0, p0, state1, p1


@kernel
def first_rows(rows):
    """How many rows the first of two parts has."""
    return 2 * ((rows + 3) // 4)


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
        halves: (2, n) int32, scratch. side, bases, signs: a part's of ``_row``; become the row's.
    """
    near, far = lines[(row + 2) % 3], lines[(row + 1) % 3]
    if row == 1:  # (above the first row there is nothing that tells anything)
        far = near
    first = class_of(row, classes)
    slope = np.int32(near[2] - far[2])
    side[0, 7], side[0, 8] = np.int32(near[1] + slope), np.int32(near[0] + slope)
    for c in range(2):
        k = first + c if classes == CLASSES else 0
        side[c, 0], side[c, 1] = weights[k, 0], weights[k, 1]
        side[c, 2:7] = shares[k, ABOVE:]
        if row == 0:
            side[c, 0], side[c, 1], side[c, 2:7] = 3 * TOTAL // 2, -TOTAL // 2, 0
            side[c, 2], side[c, 4] = FIRST_ROW, FIRST_ROW
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

    (One function, though long: what the head says is checked where it is read, and the rows need all of it.)

    Args:
        data: (n,) uint8, its bytes. out: (rows, cols) int32, C order, becomes the samples.

    Returns:
        0, or what is wrong (``codec_head``).
    """
    rows, cols = out.shape
    if data.size < HEADER:
        return CUT_OFF
    mode, classes, shift = np.int64(data[1]), np.int64(data[2]), np.int64(data[3])
    if data[0] != VERSION or mode > 2 or (classes != 1 and classes != CLASSES):
        return UNKNOWN
    first, groups, tables = np.int32(u32(data, 4)), np.int64(data[8]), np.int64(data[9])
    parts, high = np.int64(data[10]), rows
    if shift > 15 or groups < 1 or groups > GROUPS or tables < 1 or tables > SETS or parts < 1 or parts > PARTS:
        return TABLES
    if parts == PARTS:
        high = first_rows(rows)
        if high >= rows:
            return TABLES
    at: Any = HEADER
    coded = classes - (classes == CLASSES)
    if at + coded * CLASS + 2 * (groups - 1) > data.size:
        return CUT_OFF
    weights, shares = np.zeros((CLASSES, NEIGHBOURS + 1), np.int32), np.zeros((CLASSES, SIGNS), np.int32)
    for k in range(classes - coded, classes):
        at = read_weights(data, at, weights[k])
        shares[k] = data[at : at + SIGNS]
        at += SIGNS
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
    if at + 12 * parts - 8 > data.size:
        return CUT_OFF
    above, count = np.full(PARTS, first, np.int32), np.zeros(PARTS, np.int64)
    if parts == PARTS:
        above[1], count[0] = np.int32(u32(data, at)), u32(data, at + 4)
        at += 8
    states, nexts = np.full(PARTS, LEAST, np.int64), np.zeros(PARTS, np.int64)
    for k in range(parts):
        states[k] = u32(data, at)
        at += 4
    count[parts - 1] = (data.size - at) // 2 - (count[0] if parts == PARTS else 0)
    if count[parts - 1] < 0:
        return STREAM
    words = np.zeros((parts, count.max() + WORDS * cols + 1), np.uint16)
    for k in range(parts):
        at = read_words(data, at, words[k, : count[k]])
    lines, sizes = np.empty((PARTS, 3, cols + 4), np.int32), np.zeros((PARTS, 3, cols + 4), np.int32)
    side, halves = np.zeros((PARTS, 2, 9), np.int32), np.empty((2, cols), np.int32)
    bases, signs = np.empty((PARTS, cols), np.int32), np.empty((PARTS, cols), np.int32)
    skips = np.zeros((PARTS, cols), np.uint8)
    for k in range(PARTS):
        lines[k] = above[k]
    for row in range(high):
        both = parts == PARTS and high + row < rows
        for k in range(1 + both):
            prepared(row, classes, weights, shares, lines[k], sizes[k], halves, side[k], bases[k], signs[k])
            if mode:
                for col in range(cols):
                    skips[k, col] = marks[k * high + row, col] != 0
            elif classes == CLASSES:
                skips[k] = 0
            if classes == CLASSES and row % 2 == 0:
                skips[k, ::2] = 2
        c, line, near = class_of(row, classes), lines[:, row % 3], lines[:, (row + 2) % 3]
        if both:
            _rows(states, nexts, words, table, depths, direct, places[c : c + 2], group_of, shift, side, skips, bases,
                  signs, near, line, sizes[:, row % 3])  # fmt: skip
        else:
            _row(states, nexts, words, table, depths, direct, places[c : c + 2], group_of, shift, side, skips, bases,
                 signs, near, line, sizes[:, row % 3])  # fmt: skip
        for k in range(1 + both):
            if nexts[k] > count[k]:
                return STREAM
            out[k * high + row] = line[k, 2 : cols + 2]
            continued(line[k], cols)
    if at != data.size:
        return STREAM
    for k in range(parts):
        if nexts[k] != count[k] or states[k] != LEAST:
            return STREAM
    mark_missing(marks, out)
    return 0
