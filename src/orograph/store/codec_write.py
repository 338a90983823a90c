"""What the encoders of *compact* and *smallest* share: they decide tables of frequencies, and write these, the mask of
missing samples and the stream of words (docs/codec.md).
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32, least, most, some, where
from orograph._lanes32 import (
    count_of,
    gather32,
    least_unsigned,
    lengths32,
    load32,
    quotients32,
    shifted_right,
    spread32,
    store32,
    store_before,
)
from orograph._numba import inlined, kernel, linked, shared
from orograph.store.codec_head import BITS, DEEPEST, DIRECT, LEAST, MISSING, START, SYMBOLS, TOTAL, frequencies
from orograph.store.compact_contexts import length, log2

FINE = 5  # bits of a mean value in symbols; those below are separate
SYMBOL_BITS = SYMBOLS.bit_length() - 1  # of a code; those above are the table's number
RANGE = 1 << 16  # marks the codes of ranges: all others are below, for a chunk has fewer than 256 tables
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
    sizes, sums, counts = np.zeros(number, np.int64), np.zeros(number, np.int64), np.zeros(number, np.int64)
    flat, of = values.reshape(values.size), contexts.reshape(values.size)
    large = np.empty(values.size, np.int64)
    many = _count_values(flat, of, depths, found, large)
    for k in range(many):
        sums[of[large[k]]] += np.int64(flat[large[k]])
        counts[of[large[k]]] += 1
    for c in range(number):
        for value in range(DIRECT):
            sums[c] += value * found[c, value]
            counts[c] += found[c, value]
        depths[c] = max(length(sums[c] // max(counts[c], 1)) - FINE, 0)
        direct[c] = DIRECT
    if depths.any():  # (then decoders read such bits of all samples, and more of them take no longer)
        for c in range(number):
            depths[c] = min(max(length(sums[c] // max(counts[c], 1)) - coarse, 0), DEEPEST)
        found[:] = 0
        many = _count_values(flat, of, depths, found, large)
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
def _count_values(values, contexts, depths, found, large):
    """Count the values of each context, without the bits below them, in ``found``; return how many are ranges in any
    case. Where they are is put in ``large``."""
    every, many = found.reshape(found.size), 0
    for k in range(values.size):
        context = np.int64(contexts[k])
        value = np.int64(values[k]) >> depths[np.uint64(context)]
        if value < DIRECT:
            every[np.uint64(context * SYMBOLS + value)] += 1
        else:
            large[many] = k
            many += 1
    return many


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
def _spilled(states, p, words, full):
    """Write a word of each full state: (the states without them; the word before)."""
    store_before(words, p, states, full)
    return where(full, shifted_right(states, 16), states), p - count_of(full)


@inlined
def _push(states, p, words, both):
    """Encode a symbol of each lane: (the states before them; the word before).

    Args:
        both: frequencies and, 16 bits up, the sums of those before (``_ready_to_push``).
    """
    frequencies = both & 0xFFFF
    states, p = _spilled(states, p, words, shifted_right(states, 32 - BITS) >= frequencies)
    return quotients32(states, frequencies) * (TOTAL - frequencies) + shifted_right(both, 16) + states, p


@inlined
def _push_plain(states, p, words, bits, values):
    """Encode plain bits of each lane, at most 16: (the states before them; the word before)."""
    states, p = _spilled(states, p, words, shifted_right(states, 16) >= (spread32(1) << (16 - bits)))
    return (states << bits) | values, p


@linked
def _ready_to_push(found):
    """For each table and symbol, flat int32: the frequency and, 16 bits up, the sum of those before. Then for a lane
    that has nothing: a symbol that changes no state."""
    both = np.zeros(found.size + SYMBOLS, np.int32)
    both[found.size] = TOTAL
    for c in range(found.shape[0]):
        below = np.int64(0)
        for s in range(SYMBOLS):
            both[c * SYMBOLS + s] = found[c, s] | below << 16
            below += found[c, s]
    return both


@linked
def _for_lanes(numbers, none):
    """Numbers of tables as int32, and that of the lanes that have nothing."""
    out = np.full(numbers.size + 1, none, np.int32)
    for c in range(numbers.size):
        out[c] = numbers[c]
    return out


@kernel
def put_codes(values, tables, depths, direct):
    """Put the codes of values where their tables are: the table's number times ``SYMBOLS``, plus the symbol, plus
    ``RANGE`` if it is a range.

    Args:
        values, tables: flat, with room for whole lanes; tables: int32, become codes.
    """
    below, firsts = _for_lanes(depths, 0), _for_lanes(direct, 0)
    for k in range(0, values.size // LANES32 * LANES32, LANES32):
        table = load32(tables, k)
        value, first = shifted_right(load32(values, k), gather32(below, table)), gather32(firsts, table)
        ranged = least_unsigned(value, DIRECT) >= first
        symbol = where(ranged, first + (RANGE - 1) + lengths32(value - first + 1), value)
        store32(tables, k, table * SYMBOLS + symbol)


@kernel
def write_stream(values, offsets, apart, codes, depths, direct, found, words, states):
    """Write the words from the end, in the opposite order of reading; return where they begin.

    Args:
        values: flat. offsets: (LANES32,) int32, where the first value of each lane is. apart: how far the value of
            the next step is from it.
        codes: flat, of sixteen lanes in each step (``put_codes``); the number of tables times ``SYMBOLS`` where a lane
            has nothing.
        words: uint16, with room for ``LANES32`` more. states: (LANES32,) int32, become those to begin with.
    """
    p, deep, lanes = np.int64(words.size), depths.any(), load32(offsets, 0)
    both, below, firsts = _ready_to_push(found), _for_lanes(depths, 0), _for_lanes(direct, SYMBOLS)
    now = spread32(LEAST)
    for step in range(codes.size // LANES32 - 1, -1, -1):
        code = load32(codes, step * LANES32)
        ranged = code >= RANGE
        if deep or some(ranged):
            code = code & (RANGE - 1)
            value, table = gather32(values, lanes + step * apart), shifted_right(code, SYMBOL_BITS)
            depth = gather32(below, table)
            if deep:
                now, p = _push_plain(now, p, words, depth, value & ((spread32(1) << depth) - 1))
            if some(ranged):
                first = gather32(firsts, table)
                bits = where(ranged, (code & (SYMBOLS - 1)) - first, 0)
                beyond = where(ranged, shifted_right(value, depth) - first + 1 - (spread32(1) << bits), 0)
                if some(bits > 16):
                    now, p = _push_plain(now, p, words, most(bits - 16, 0), shifted_right(beyond, 16))
                now, p = _push_plain(now, p, words, least(bits, 16), beyond & 0xFFFF)
        now, p = _push(now, p, words, gather32(both, code))
    store32(states, 0, now)
    return p


@linked
def with_stream(head, at, states, words):
    """The bytes of a chunk: of its head, of states and of words."""
    out = np.empty(at + 4 * states.size + 2 * words.size, np.uint8)
    out[:at] = head[:at]
    out[at : at + 4 * states.size] = states.view(np.uint8)
    out[at + 4 * states.size :] = words.view(np.uint8)
    return out
