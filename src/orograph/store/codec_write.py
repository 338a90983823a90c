"""What the encoders of *compact* and *smallest* share: they decide tables of frequencies, and write these, the mask of
missing samples and the stream of words (docs/codec.md).
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._numba import inlined, kernel, linked, shared
from orograph.store.codec_head import BITS, DEEPEST, DIRECT, LEAST, MISSING, START, SYMBOLS, TOTAL, frequencies
from orograph.store.compact_contexts import length, log2

FINE = 5  # bits of a mean value in symbols; those below are separate
CODES, LN2 = 48, 0.6931471805599453  # of frequencies; the natural logarithm of 2
WEIGHT = np.array([code if code < 8 else (4 + code % 4) << (code // 4 - 1) for code in range(CODES)], np.float64)
SURPRISE = np.array([1e9] + [float(BITS) - log2(weight) for weight in WEIGHT[1:]])  # bits of a symbol, by its code


@linked
def based(numbers):
    """The first sample that is not missing, the largest common factor of all differences from it, and the samples as
    multiples of that: (int64, int64, (rows, cols) int32). Missing samples stay as they are."""
    rows, cols = numbers.shape
    flat, origin, factor = numbers.reshape(numbers.size), np.int64(0), np.int64(0)
    for k in range(flat.size):
        if flat[k] != MISSING:
            origin = np.int64(flat[k])
            break
    for row in range(rows):
        if factor == 1:
            break
        factor = _common(numbers[row], origin, factor)
    found, wrong = np.empty((rows, cols), np.int32), 0
    if factor <= 1:
        for k in range(flat.size):
            wrong += flat[k] != MISSING and np.int32(flat[k] - origin) == MISSING
        factor, origin = np.int64(1), origin if wrong == 0 else np.int64(0)  # (what is missing must be told from it)
    for row in range(rows):
        to, own = found[row], numbers[row]
        for col in range(cols if factor == 1 else 0):
            to[col] = np.int32(own[col] - origin) if own[col] != MISSING else MISSING
        for col in range(cols if factor > 1 else 0):
            to[col] = np.int32((own[col] - origin) / factor) if own[col] != MISSING else MISSING
    return origin, factor, found


@linked
def _common(line, origin, factor):
    """The largest common factor of a factor, 0 for any, and of a row's differences from the origin."""
    wrong = 1 if factor == 0 else 0
    for k in range(line.size if factor else 0):  # (mostly they are all multiples, and this is quick)
        off = np.float64(line[k]) - origin
        wrong += line[k] != MISSING and np.rint(off / max(factor, 1)) * factor != off
    for k in range(line.size if wrong else 0):
        one, other = abs(np.int64(line[k]) - origin) if line[k] != MISSING else 0, factor
        while one:
            one, other = other % one, one
        factor = other
        if factor == 1:
            break
    return factor


@linked
def write_u32(out, at, value):
    """Write the lowest 32 bits of a number, lowest byte first."""
    for k in range(4):
        out[at + k] = np.uint8(value >> (8 * k) & 255)


@shared
def symbol_of(value, direct):
    """The symbol of a value, without the bits below it."""
    return value if value < direct else direct - 1 + length(value - direct + 1)


@kernel
def decided_tables(values, contexts, number, rare, coarse, depths, direct, found, codes):
    """Decide the tables: ``depths`` by context, how many symbols are values (``direct``: those that one in 2^``rare``
    exceeds are ranges), the ``codes`` of the ``found`` frequencies; symbols of each.

    If any table has bits below its symbols, a mean value has ``coarse`` bits in symbols, for all of them.
    """
    parts = np.zeros(4 * 2 * number, np.int64)  # (in four parts, for neighbours mostly have the same context)
    size, sizes = values.size, np.zeros(number, np.int64)
    flat, of = values.reshape(size), contexts.reshape(size)
    for k in range(size):
        here = np.uint64(((k & 3) * number + of[k]) * 2)
        parts[here] += np.int64(flat[k])
        parts[here + np.uint64(1)] += 1
    sums, counts = np.zeros(number, np.int64), np.zeros(number, np.int64)
    for c in range(4 * number):
        sums[c % number] += parts[2 * c]
        counts[c % number] += parts[2 * c + 1]
    for c in range(number):
        depths[c] = max(length(sums[c] // max(counts[c], 1)) - FINE, 0)
        direct[c] = DIRECT
    if depths.any():  # (then decoders read such bits of all samples, and more of them take no longer)
        for c in range(number):
            depths[c] = min(max(length(sums[c] // max(counts[c], 1)) - coarse, 0), DEEPEST)
    large, many = np.empty(size, np.int64), 0  # where values are that are ranges in any case
    every = found.reshape(found.size)
    for k in range(size):
        context = np.int64(of[k])
        value = np.int64(flat[k]) >> depths[np.uint64(context)]
        if value < DIRECT:
            every[np.uint64(context * SYMBOLS + value)] += 1
        else:
            large[many] = k
            many += 1
    for c in range(number):
        beyond, s = counts[c] - found[c, :DIRECT].sum(), DIRECT  # from here on, ranges cost hardly more
        while s > 0 and beyond + found[c, s - 1] <= counts[c] >> rare:
            s -= 1
            beyond += found[c, s]
        direct[c] = s
        ranges = np.zeros(SYMBOLS, np.int64)
        for value in range(s, DIRECT):
            ranges[symbol_of(value, s)] += found[c, value]
        found[c, s:] = ranges[s:]
    for k in range(many):
        c = of[large[k]]
        found[c, symbol_of(np.int64(flat[large[k]]) >> depths[c], direct[c])] += 1
    for c in range(number):
        for s in range(SYMBOLS):
            sizes[c] = s + 1 if found[c, s] or s == 0 else sizes[c]
        decided_codes(found[c, : sizes[c]], codes[c])
        direct[c] = min(direct[c], sizes[c]) if counts[c] else 1
        frequencies(codes[c], sizes[c], found[c])
    return sizes


@linked
def decided_codes(counts, codes):
    """Decide the codes of a table: those with which values and table together take the fewest bits.

    A shortest path: from symbol to symbol, the least bits up to each code. A step up by n takes n + 2 bits in the
    table, one down n + 1. Weights count as if their sum were ``TOTAL``, which makes it so, approximately.

    Args:
        counts: of each symbol. codes: become theirs.
    """
    size, bits, found = counts.size, np.zeros(CODES), np.empty(CODES)
    before, price = np.empty((size, CODES), np.int8), counts.sum() / (TOTAL * LN2)
    for s in range(size):
        if s == 0:
            for code in range(CODES):
                found[code] = abs(code - START)
        else:
            low = 0
            for code in range(CODES):
                if bits[code] - code <= bits[low] - low:
                    low = code
                found[code], before[s, code] = bits[low] - low + code + 2.0, low
            high = CODES - 1
            for code in range(CODES - 2, -1, -1):
                if bits[high] + high - code + 1.0 < found[code]:
                    found[code], before[s, code] = bits[high] + high - code + 1.0, high
                if bits[code] + code < bits[high] + high:
                    high = code
        count = float(counts[s])
        for code in range(CODES):
            bits[code] = found[code] + count * SURPRISE[code] + price * WEIGHT[code]
    codes[size - 1] = np.argmin(bits)
    for s in range(size - 1, 0, -1):
        codes[s - 1] = before[s, codes[s]]


@linked
def write_tables(out, at, number, depths, direct, sizes, codes):
    """Write the tables at ``at`` in the chunk's zeroed bytes; return where they end."""
    for c in range(number):
        out[at], out[at + 1], out[at + 2] = depths[c], direct[c], sizes[c] - direct[c]
        bit, last = (at + 3) * 8, np.int64(START)
        for s in range(sizes[c]):
            step = codes[c, s] - last
            last = codes[c, s]
            value = (step << 1) ^ (step >> 63)
            for _ in range(value >> 1):
                out[bit >> 3] |= np.uint8(1 << (bit & 7))
                bit += 1
            bit += 1
            out[bit >> 3] |= np.uint8((value & 1) << (bit & 7))
            bit += 1
        at = (bit + 7) >> 3
    return at


@linked
def write_mask(numbers, mode, out, at):
    """Write the runs of valid and missing samples at ``at``; return where they end."""
    rows, cols = numbers.shape
    state, run = False, np.int64(0)
    for row in range(rows):
        for col in range(cols):
            bit = numbers[row, col] == MISSING
            if mode == 2 and row:
                bit ^= numbers[row - 1, col] == MISSING
            if bit != state:
                at = _write_run(out, at, run)
                state, run = bit, np.int64(0)
            run += 1
    return _write_run(out, at, run)


@linked
def _write_run(out, at, run):
    while run > 127:
        out[at] = np.uint8(run & 127 | 128)
        at += 1
        run >>= 7
    out[at] = np.uint8(run)
    return at + 1


@inlined
def push(x, p, words, both, inverse, at):
    """Encode a symbol: (the state before it, the word before). A word before the first is written, but does not count.

    Multiplying by the inverse divides: the added half keeps the product off integers by more than its rounding error.

    Args:
        both, inverse: from ``ready_to_push``. at: which symbol of which table.
    """
    frequency, below = both[np.uint64(at)] & 0xFFFF, both[np.uint64(at)] >> 16
    words[np.uint64(p - 1)] = np.uint16(x & 0xFFFF)  # (no branch: whether a word is due is unpredictable)
    full = x >= frequency << (32 - BITS)
    x, p = x >> 16 if full else x, p - full
    return np.int64((x + 0.5) * inverse[np.uint64(at)]) * (TOTAL - frequency) + below + x, p


@inlined
def push_plain(x, p, words, bits, value):
    """Encode plain bits: (the state before them, the word before)."""
    words[np.uint64(p - 1)] = np.uint16(x & 0xFFFF)
    full = x >= np.int64(1) << (32 - bits)
    x, p = x >> 16 if full else x, p - full
    return x << bits | value, p


@linked
def ready_to_push(found):
    """For each table and symbol, flat: the frequency and, 16 bits up, the sum of those before; and the inverse."""
    both, inverse = np.zeros(found.size, np.int64), np.ones(found.size)
    for c in range(found.shape[0]):
        below = np.int64(0)
        for s in range(SYMBOLS):
            if found[c, s]:
                both[c * SYMBOLS + s] = found[c, s] | below << 16
                inverse[c * SYMBOLS + s] = 1.0 / found[c, s]
                below += found[c, s]
    return both, inverse


@kernel
def write_stream(values, codes, ranges, depths, direct, found, words, states):
    """Write the words from the end, in the opposite order of reading; where they begin.

    Args:
        values: flat, of sixteen lanes in each step. codes: of each, a table's number times ``SYMBOLS``, plus the
            symbol; -1 where a lane has nothing. ranges: of each step, whether it has ranges.
        states: (LANES32,) int64, become those to begin with.
    """
    p, deep = np.int64(words.size), depths.any()
    both, inverse = ready_to_push(found)
    states[:] = LEAST
    for step in range(ranges.size - 1, -1, -1):
        at = step * LANES32
        if deep:
            p = _push_low(values, codes, at, depths, states, p, words)
        if ranges[step]:
            p = _push_ranges(values, codes, at, depths, direct, states, p, words)
        for i in range(LANES32 - 1, -1, -1):
            code = np.int64(codes[np.uint64(at + i)])
            if code >= 0:
                states[np.uint64(i)], p = push(states[np.uint64(i)], p, words, both, inverse, code)
    return p


@linked
def _push_low(values, codes, at, depths, states, p, words):
    """Write the bits below the symbols of sixteen values; the word before."""
    for i in range(LANES32 - 1, -1, -1):
        depth = depths[codes[at + i] // SYMBOLS] if codes[at + i] >= 0 else 0
        if depth:
            low = np.int64(values[at + i]) & ((1 << depth) - 1)
            states[i], p = push_plain(states[i], p, words, depth, low)
    return p


@linked
def _push_ranges(values, codes, at, depths, direct, states, p, words):
    """Write the bits of the ranges of sixteen values: those above sixteen bits before the rest; the word before."""
    for high in range(1, -1, -1):
        for i in range(LANES32 - 1, -1, -1):
            c = codes[at + i] // SYMBOLS
            bits = codes[at + i] - c * SYMBOLS - direct[c] if c >= 0 else -1
            if bits < 0:
                continue
            beyond = (np.int64(values[at + i]) >> depths[c]) - direct[c] + 1 - (np.int64(1) << bits)
            if high and bits > 16:
                states[i], p = push_plain(states[i], p, words, bits - 16, beyond >> 16)
            elif not high:
                states[i], p = push_plain(states[i], p, words, min(bits, 16), beyond & 0xFFFF)
    return p
