"""The kernels that encode chunks as the codec *compact* (``compact``; docs/codec.md has the format).

The encoder decides what a decoder need not know: the weights (least squares over some of the chunk's rows), the values
of missing samples, and (``compact_contexts``) how activities are divided among tables. Nothing depends on a library's
arithmetic or on the order of threads, so the same samples give the same bytes everywhere.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._numba import inlined, kernel, shared
from orograph.store.codec_fit import (
    AROUND,
    add_products,
    features_of,
    put_shares,
    put_surroundings,
    rounded_weights,
    sums_of,
    weights_of,
)
from orograph.store.codec_head import (
    BITS,
    DEEPEST,
    DIRECT,
    LEAST,
    MISSING,
    NEIGHBOURS,
    START,
    SYMBOLS,
    TOTAL,
    WORDS,
    frequencies,
    full_weights,
)
from orograph.store.compact_contexts import activity_of, divided, length, log2, shift_of
from orograph.store.compact_decode import (
    CONTEXTS,
    HEADER,
    VERSION,
    extend,
    predicted,
)

SAMPLED = 32  # rows that weights are fitted to
FINE = 5  # bits of a mean value in symbols; those below are separate
RARE = 8  # values that one in 2^8 exceeds are ranges
CODES, LN2 = 48, 0.6931471805599453  # of frequencies; the natural logarithm of 2
WEIGHT = np.array([code if code < 8 else (4 + code % 4) << (code // 4 - 1) for code in range(CODES)], np.float64)
SURPRISE = np.array([1e9] + [float(BITS) - log2(weight) for weight in WEIGHT[1:]])  # bits of a symbol, by its code


@kernel
def _mark_counted(far, near, line, counted):
    """Mark the samples of a row of which, and of all around them, none is missing: 1, else 0."""
    for i in range(counted.size):
        lowest = min(min(line[i], line[i + 1]), line[i + 2])
        for k in range(5):
            lowest = min(min(lowest, near[i + k]), far[i + k])
        counted[i] = lowest != MISSING


@kernel
def fitted(numbers, weights):
    """The weights (11,) int64, in 1/4096, fitted to some rows; those of a plane where there is too little to go by."""
    rows, cols = numbers.shape
    count, sums, used = max(cols - 4, 0), sums_of(AROUND), 0
    features = features_of(AROUND, count)
    width = features.shape[1]
    shares, scratch, counted = np.empty(width), np.empty(width), np.zeros(width, np.int32)
    for row in range(2, rows, max(rows // SAMPLED, 1)):
        far, near, line = numbers[row - 2], numbers[row - 1], numbers[row]
        _mark_counted(far, near, line, counted[:count])
        put_surroundings(far, near, line, (0, 1, 2, 3, 4), count, features)
        used += put_shares(features, counted, shares)
        add_products(features, shares, scratch, sums)
    rounded_weights(weights_of(sums, used, 1e-5), weights)


@kernel
def _values(numbers, weights, first, lowest, highest, values):
    """Compute each sample's difference from its prediction, zigzag-coded, in rows of whole lanes. A missing sample
    takes its prediction, clamped to the range of the others."""
    rows, cols = numbers.shape
    lines, base = np.empty((3, cols + 4), np.int32), np.empty(cols, np.int32)
    w0, w1 = weights[0], weights[1]
    for row in range(rows):
        line, near, far = lines[row % 3], lines[(row + 2) % 3], lines[(row + 1 + (row == 1)) % 3]
        if row:
            predicted(weights, far, near, base)
        west = farther = first if row == 0 else near[2]
        for col in range(cols):
            if row:
                t = np.int32(np.int32(base[col] + np.int32(w1 * farther)) + np.int32(w0 * west))
                said = np.int32(near[col + 2] + np.int32(t >> np.int32(12)))
            else:
                said = np.int32(west)
            here = numbers[row, col]
            if here == MISSING:
                here = np.int32(min(max(said, lowest), highest))
            residual = np.int32(here - said)
            values[row, col] = np.uint32(np.int32(residual << np.int32(1)) ^ np.int32(residual >> np.int32(31)))
            farther = west
            west = here
            line[col + 2] = here
        values[row, cols:] = 0
        extend(line, cols)


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


@kernel
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


@kernel
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


@kernel
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


@kernel
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


@kernel
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
def _coded(values, contexts, depths, direct):
    """The codes of all values, flat, and of each sixteen whether they have ranges (``stream``)."""
    flat, of = values.reshape(values.size), contexts.reshape(values.size)
    codes, ranges = np.empty(flat.size, np.int32), np.zeros(flat.size // LANES32, np.bool_)
    for k in range(flat.size):
        c = np.uint64(of[k])
        symbol = symbol_of(np.int64(flat[k]) >> depths[c], direct[c])
        codes[k] = np.int64(c) * SYMBOLS + symbol
        ranges[k // LANES32] |= symbol >= direct[c]
    return flat, codes, ranges


@kernel
def stream(values, codes, ranges, depths, direct, found, words, states):
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


@kernel
def _push_low(values, codes, at, depths, states, p, words):
    """Write the bits below the symbols of sixteen values; the word before."""
    for i in range(LANES32 - 1, -1, -1):
        depth = depths[codes[at + i] // SYMBOLS] if codes[at + i] >= 0 else 0
        if depth:
            low = np.int64(values[at + i]) & ((1 << depth) - 1)
            states[i], p = push_plain(states[i], p, words, depth, low)
    return p


@kernel
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


@kernel
def encode(numbers):
    """Return the bytes of a chunk, (n,) uint8.

    Args:
        numbers: (rows, cols) int32, C order, at least one sample.
    """
    rows, cols = numbers.shape
    lowest, highest, missing = np.int32(2**31 - 1), np.int32(-(2**31 - 1)), 0
    for row in range(rows):
        for col in range(cols):
            here = numbers[row, col]
            if here == MISSING:
                missing += 1
            else:
                lowest, highest = min(lowest, here), max(highest, here)
    if missing == rows * cols:
        lowest = highest = np.int32(0)
    first = np.int32(lowest if numbers[0, 0] == MISSING else numbers[0, 0])
    given, weights = np.empty(NEIGHBOURS, np.int64), np.empty(NEIGHBOURS + 1, np.int32)
    fitted(numbers, given)
    full_weights(given, weights)
    width = LANES32 * (-(-cols // LANES32))
    values, activity = np.empty((rows, width), np.uint32), np.empty((rows, width), np.int32)
    _values(numbers, weights, first, lowest, highest, values)
    shift = shift_of(values)
    activity_of(values, shift, activity)
    bounds = np.zeros(CONTEXTS, np.int64)
    contexts = divided(values, activity, bounds)
    depths, direct = np.zeros(contexts, np.int64), np.zeros(contexts, np.int64)
    codes = np.zeros((contexts, SYMBOLS), np.int64)
    found = np.zeros((contexts, SYMBOLS), np.int64)
    sizes = decided_tables(values, activity, contexts, RARE, FINE, depths, direct, found, codes)
    words, states = np.empty(WORDS * values.size + 1, np.uint16), np.empty(LANES32, np.int64)
    flat, steps, ranges = _coded(values, activity, depths, direct)
    p = stream(flat, steps, ranges, depths, direct, found, words, states)
    head = np.zeros(HEADER + CONTEXTS * (4 + 8 * SYMBOLS) + (2 * numbers.size + 16 if missing else 0), np.uint8)
    mode, at = 0, HEADER
    head[0], head[2], head[3] = VERSION, contexts, shift
    for k in range(4):
        head[4 + k] = np.uint8(np.int64(first) >> (8 * k) & 255)
    for k in range(NEIGHBOURS):
        head[8 + 2 * k], head[9 + 2 * k] = np.uint8(given[k] & 255), np.uint8(given[k] >> 8 & 255)
    for k in range(1, contexts):
        head[at] = np.uint8(bounds[k])
        at += 1
    at = write_tables(head, at, contexts, depths, direct, sizes, codes)
    if missing:
        one, two = write_mask(numbers, 1, head, at), write_mask(numbers, 2, head, at)
        mode = 1 if one <= two else 2
        at = write_mask(numbers, mode, head, at)
    head[1] = mode
    out = np.empty(at + 4 * LANES32 + 2 * (words.size - p), np.uint8)
    for k in range(at):
        out[k] = head[k]
    for lane in range(LANES32):
        for k in range(4):
            out[at + 4 * lane + k] = np.uint8(states[lane] >> (8 * k) & 255)
    at += 4 * LANES32
    for k in range(words.size - p):
        out[at + 2 * k] = np.uint8(words[p + k] & 255)
        out[at + 2 * k + 1] = np.uint8(words[p + k] >> 8)
    return out
