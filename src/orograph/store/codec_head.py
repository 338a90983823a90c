"""Reading the heads of chunks (docs/codec.md), for the decoders of *compact* and *smallest*.

Nothing read from a chunk is used as an index before it is checked.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, linked

MISSING = -(1 << 31)
NEIGHBOURS = 11  # not counting N
BITS = 12  # of probabilities
TOTAL = 1 << BITS
DIRECT = 224  # the first symbols of a table, at most this many, are values; the others are ranges of larger ones
SYMBOLS = DIRECT + 32
START = 36  # the predecessor of a table's first code
DEEPEST = 16  # maximum bits below symbols
LEAST = 1 << 16  # smallest state
WORDS = 4  # maximum words per sample

CUT_OFF, UNKNOWN, TABLES, MASK, STREAM = 1, 2, 3, 4, 5
"""Error codes: the chunk is too short; another version; its tables, mask or stream of words are invalid."""


@inlined
def u16(data, at):
    return np.int64(data[at]) | np.int64(data[at + 1]) << 8


@inlined
def u32(data, at):
    return (
        np.int64(data[at]) | np.int64(data[at + 1]) << 8 | np.int64(data[at + 2]) << 16 | np.int64(data[at + 3]) << 24
    )


@linked
def frequencies(codes, count, out):
    """Decode frequencies, which sum to ``TOTAL``; return whether the codes are valid.

    Args:
        codes: of ``count`` symbols. out: becomes the frequencies.
    """
    total, most = np.int64(0), np.int64(0)
    for s in range(count):
        code = np.int64(codes[s])
        out[s] = code if code < 8 else (4 + (code & 3)) << ((code >> 2) - 1)
        total += out[s]
        if out[s] > out[most]:
            most = np.int64(s)
    if total == 0:
        return False
    rest = np.int64(TOTAL)
    for s in range(count):
        if out[s]:
            out[s] = max(out[s] * TOTAL // total, 1)
            rest -= out[s]
    out[most] += rest
    return out[most] > 0


@linked
def read_tables(data, at, contexts, table, depths, direct):
    """Read the tables of all contexts from ``at``; return where they end, or -1.

    Args:
        table: (contexts × TOTAL,) uint32, becomes frequency - 1, offset and symbol (12, 12 and 8 bits) by slot.
            Symbols from ``DIRECT`` are ranges.
        depths: becomes the bits below symbols, by context. direct: becomes the number of symbols that are values.
    """
    codes, found = np.zeros(SYMBOLS, np.int64), np.zeros(SYMBOLS, np.int64)
    for context in range(contexts):
        if at + 3 > data.size:
            return -1
        depths[context], direct[context], ranges = np.int64(data[at]), np.int64(data[at + 1]), np.int64(data[at + 2])
        at += 3
        count = direct[context] + ranges
        if depths[context] > DEEPEST or direct[context] > DIRECT or ranges > 32 or count == 0:
            return -1
        bit, last, code = at * 8, data.size * 8, np.int64(START)
        for s in range(count):
            # A difference: half of it in unary (ones, then a zero), then its lowest bit, zigzag-coded.
            ones = np.int64(0)
            while bit < last and data[bit >> 3] >> (bit & 7) & 1:
                ones += 1
                bit += 1
            if bit + 2 > last:
                return -1
            value = ones << 1 | np.int64(data[(bit + 1) >> 3]) >> ((bit + 1) & 7) & 1
            bit += 2
            code += (value >> 1) ^ -(value & 1)
            if code < 0 or code > 47:
                return -1
            codes[s] = code
        at = (bit + 7) >> 3
        if not frequencies(codes, count, found):
            return -1
        slot = np.int64(context * TOTAL)
        for s in range(count):
            entry = np.uint32((found[s] - 1) << 20 | (s if s < direct[context] else s - direct[context] + DIRECT))
            for k in range(found[s]):
                table[np.uint64(slot + k)] = entry | np.uint32(k) << np.uint32(8)
            slot += found[s]
    return at


@linked
def read_mask(data, at, mode, out):
    """Put ``MISSING`` where the runs from ``at`` say so, and zeros elsewhere; return where they end, or -1."""
    rows, cols = out.shape
    filled, missing, size = np.int64(0), False, rows * cols
    flat = out.reshape(size)
    while filled < size:
        run, shift = np.int64(0), np.int64(0)
        while True:
            if at >= data.size or shift > 35:
                return -1
            byte = np.int64(data[at])
            at += 1
            run |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        if run > size - filled:
            return -1
        flat[filled : filled + run] = MISSING if missing else 0
        filled += run
        missing = not missing
    if mode == 2:
        for row in range(1, rows):
            for col in range(cols):
                out[row, col] ^= out[row - 1, col]
    return at


@linked
def full_weights(weights, out):
    """Complete the twelve weights: N's makes the sum zero, because N itself is added to the prediction."""
    total = np.int64(0)
    for k in range(NEIGHBOURS):
        out[k] = weights[k]
        total += weights[k]
    out[NEIGHBOURS] = -total


@linked
def read_weights(data, at, out):
    """Read weights; return where they end. ``out``: as in ``full_weights``."""
    given = np.empty(NEIGHBOURS, np.int64)
    for k in range(NEIGHBOURS):
        given[k] = np.int16(u16(data, at + 2 * k))
    full_weights(given, out)
    return at + 2 * NEIGHBOURS


@linked
def read_words(data, at, out):
    """Copy the words of a stream to a buffer with room to read beyond their end; return where they end."""
    some = data[at : at + 2 * out.size]
    for k in range(some.size // 2):
        here = np.uint64(2 * k)
        out[np.uint64(k)] = np.uint16(some[here]) | np.uint16(some[here + np.uint64(1)]) << np.uint16(8)
    return at + 2 * out.size


@linked
def mark_missing(marks, out):
    """Put ``MISSING`` where samples are marked."""
    for row in range(marks.shape[0]):
        for col in range(marks.shape[1]):
            if marks[row, col]:
                out[row, col] = MISSING
