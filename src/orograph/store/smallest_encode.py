"""The kernels that encode chunks as the codec *smallest* (``smallest``; docs/codec.md has the format).

An encoder knows all samples, so nothing depends on the sample before: what decoders compute sample by sample is
computed here row by row (``smallest_look``).
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._numba import kernel
from orograph.store.codec_head import (
    LEAST,
    MISSING,
    NEIGHBOURS,
    SYMBOLS,
    full_weights,
)
from orograph.store.compact_contexts import TOKENS, cost_of, grouped, joined, token
from orograph.store.compact_encode import (
    decided_tables,
    push,
    push_plain,
    ready_to_push,
    symbol_of,
    write_mask,
    write_tables,
)
from orograph.store.smallest_fit import SAMPLED, fitted_shares, fitted_weights
from orograph.store.smallest_look import look, surrounded
from orograph.store.smallest_rows import (
    BINS,
    CLASS,
    CLASSES,
    GROUPS,
    HEADER,
    SETS,
    SIGNS,
    VERSION,
    WEIGHTS,
    WORDS,
    begin_of,
    steps_of,
)

WHOLE_GROUPS, NESTED_GROUPS = 24, 12
RARE = 6  # values that only one in 2^6 exceeds are coded as ranges: shorter tables outweigh the loss


@kernel
def _merged(counts, left, final):
    """Merge any two tables while that makes the chunk smaller; return how many are left.

    Args:
        counts: (tables, TOKENS). left: the number of tables. final: (tables,), becomes the table that each is merged
            into, numbered without gaps.
    """
    costs, joint, into = np.zeros(left), np.zeros((left, left)), np.arange(left)
    for k in range(left):
        costs[k] = cost_of(counts[k], counts[k], 0)
        for m in range(k):
            joint[k, m] = cost_of(counts[k], counts[m], 1) - costs[k] - costs[m]
    while True:
        one, other, best = 0, 0, 0.0
        for k in range(left):
            for m in range(k):
                if into[k] == k and into[m] == m and joint[k, m] < best:
                    one, other, best = k, m, joint[k, m]
        if one == other:
            break
        counts[other] += counts[one]
        costs[other] += costs[one] + best
        into[one] = other
        for k in range(left):
            if into[k] == k and k != other:
                change = cost_of(counts[k], counts[other], 1) - costs[k] - costs[other]
                joint[max(k, other), min(k, other)] = change
    number = 0
    for k in range(left):
        if into[k] == k:
            final[k] = number
            number += 1
        else:
            final[k] = final[into[k]]
    return number


@kernel
def _divided(values, groups, kinds, most, places):
    """Choose the tables of all cells; return their number.

    Args:
        values, groups, kinds: of the samples that are coded, from ``look``; ``kinds`` become tables.
        most: the largest number of groups to distinguish.
        places: (CLASSES, GROUPS, BINS) int64, become tables, -1 where there are no samples.
    """
    parts, merged = np.zeros(4 * GROUPS, np.int64), np.empty(GROUPS, np.int64)
    for k in range(groups.size):  # (in four parts, for neighbours mostly have the same group)
        parts[np.uint64((k & 3) * GROUPS + groups[k])] += 1
    most = grouped(parts.reshape(4, GROUPS).sum(0), merged, most)
    cells = CLASSES * BINS * most
    counts = np.zeros((cells, TOKENS), np.int64)
    every = counts.reshape(cells * TOKENS)
    for k in range(values.size):
        cell = kinds[k] * most + merged[np.uint64(groups[k])]
        kinds[k] = cell
        every[np.uint64(cell * TOKENS + token(np.int64(values[k])))] += 1
    filled, table, longest = 0, np.full(cells, -1, np.int64), TOKENS
    while longest > 1 and not counts[:, longest - 1].any():
        longest -= 1
    counts = np.ascontiguousarray(counts[:, :longest])
    for cell in range(cells):  # (counts move up: those that hold anything come first)
        if counts[cell].any():
            counts[filled] = counts[cell]
            table[cell] = filled
            filled += 1
    tables, chain = 1, np.zeros(max(filled, 1), np.int64)
    if filled:
        firsts, final = np.zeros(filled, np.int64), np.zeros(filled, np.int64)
        links, now = joined(counts, filled, firsts, SETS), 0
        tables = _merged(counts, links, final)
        for at in range(filled):
            while now + 1 < links and at >= firsts[now + 1]:
                now += 1
            chain[at] = final[now]
    for cell in range(cells):
        if table[cell] >= 0:
            table[cell] = chain[table[cell]]
    for kind in range(CLASSES * BINS):
        for group in range(GROUPS):
            places[kind // BINS, group, kind % BINS] = table[kind * most + merged[group]]
    for k in range(kinds.size):
        kinds[k] = table[np.uint64(kinds[k])]
    return tables


@kernel
def _write_map(out, at, places):
    """Write the table of each class, group and bin; return where that ends."""
    bit = at * 8
    for k in range(places.shape[0]):
        for g in range(GROUPS):
            for b in range(BINS):
                before = places[k, g - 1, b] if g else (places[k, 0, b - 1] if b else 0)
                here = places[k, g, b]
                if here < 0 or here == before:
                    places[k, g, b] = before
                    out[bit >> 3] |= np.uint8(1 << (bit & 7))
                    bit += 1
                    continue
                bit += 1
                for i in range(6):
                    out[bit >> 3] |= np.uint8((here >> i & 1) << (bit & 7))
                    bit += 1
    return (bit + 7) >> 3


@kernel
def _in_steps(values, tables, depths, direct, skips):
    """Values and codes (a table's number times ``SYMBOLS``, plus the symbol) in the order of steps, flat, sixteen in
    each, -1 where a lane has nothing; and of each step whether it has ranges."""
    rows, cols = skips.shape
    steps, n = steps_of(rows, cols), 0
    ordered, codes = np.zeros(steps * LANES32, np.uint32), np.full(steps * LANES32, -1, np.int32)
    ranges = np.zeros(steps, np.bool_)
    for row in range(rows):
        begin, skip = begin_of(row, cols), skips[row]
        at = begin * LANES32 + row % LANES32
        for col in range(cols):
            if skip[np.uint64(col)]:
                continue
            here, c, value = np.uint64(at + col * LANES32), np.uint64(tables[np.uint64(n)]), values[np.uint64(n)]
            symbol = symbol_of(np.int64(value) >> depths[c], direct[c])
            if symbol >= direct[c]:
                ranges[np.uint64(begin + col)] = True
            ordered[here], codes[here] = value, np.int64(c) * SYMBOLS + symbol
            n += 1
    return ordered, codes, ranges


@kernel
def _stream(ordered, codes, ranges, depths, direct, found, words, states):
    """Write the words from the end, in the opposite order of reading; where they begin.

    Args:
        ordered, codes, ranges: from ``_in_steps``. states: (LANES32,) int64, become those to begin with.
    """
    p, deep = np.int64(words.size), depths.any()
    both, inverse = ready_to_push(found)
    states[:] = LEAST
    for step in range(ranges.size - 1, -1, -1):
        at = step * LANES32
        if deep:
            p = _push_low(ordered, codes, at, depths, states, p, words)
        if ranges[step]:
            p = _push_ranges(ordered, codes, at, depths, direct, states, p, words)
        for i in range(LANES32 - 1, -1, -1):
            code = np.int64(codes[np.uint64(at + i)])
            if code >= 0:
                states[np.uint64(i)], p = push(states[np.uint64(i)], p, words, both, inverse, code)
    return p


@kernel
def _push_low(ordered, codes, at, depths, states, p, words):
    """Write the bits below the symbols of a step; the word before."""
    for i in range(LANES32 - 1, -1, -1):
        depth = depths[codes[at + i] // SYMBOLS] if codes[at + i] >= 0 else 0
        if depth:
            low = np.int64(ordered[at + i]) & ((1 << depth) - 1)
            states[i], p = push_plain(states[i], p, words, depth, low)
    return p


@kernel
def _push_ranges(ordered, codes, at, depths, direct, states, p, words):
    """Write the bits of the ranges of a step: those above sixteen bits before the rest; the word before."""
    for high in range(1, -1, -1):
        for i in range(LANES32 - 1, -1, -1):
            c = codes[at + i] // SYMBOLS
            bits = codes[at + i] - c * SYMBOLS - direct[c] if c >= 0 else -1
            if bits < 0:
                continue
            beyond = (np.int64(ordered[at + i]) >> depths[c]) - direct[c] + 1 - (np.int64(1) << bits)
            if high and bits > 16:
                states[i], p = push_plain(states[i], p, words, bits - 16, beyond >> 16)
            elif not high:
                states[i], p = push_plain(states[i], p, words, min(bits, 16), beyond & 0xFFFF)
    return p


@kernel
def _write_u32(out, at, value):
    """Write the lowest 32 bits of a number, lowest byte first."""
    for k in range(4):
        out[at + k] = np.uint8(value >> (8 * k) & 255)


@kernel
def _first_of(numbers):
    """The first sample that is not missing, or 0."""
    flat = numbers.reshape(numbers.size)
    for k in range(flat.size):
        if flat[k] != MISSING:
            return flat[k]
    return np.int32(0)


@kernel
def _fitted(whole, skips, classes, weights, shares, given, held):
    """Fit the weights and shares of all classes; (CLASSES, …), as used and as written."""
    rows, cols = skips.shape
    for k in range(classes == CLASSES, classes):
        row0, col0, spread = (k >> 1, k & 1, 2) if classes == CLASSES else (0, 0, 1)
        fitted_weights(whole, skips, row0, col0, spread, given[k])
        full_weights(given[k], weights[k])
    step = 2 * max(rows * cols // (SAMPLED * (1 if classes == 1 else 2)), 2)
    seen, counts = np.empty((CLASSES, SAMPLED, SIGNS + 1), np.int32), np.zeros(CLASSES, np.int64)
    none = np.empty(0, np.uint32), np.empty(0, np.int32), np.empty(0, np.int32)
    look(whole, skips, classes, weights, shares, step, seen, counts, none[0], none[1], none[2])
    for k in range(classes == CLASSES, classes):
        fitted_shares(seen[k], counts[k], held[k])
        for i in range(SIGNS):
            shares[k, i] = held[k, i]


@kernel
def encode(numbers, classes):
    """Return the bytes of a chunk, (n,) uint8.

    Args:
        numbers: (rows, cols) int32, C order, at least one sample.
        classes: 1, or ``CLASSES``: samples of even row and column hold nothing.
    """
    rows, cols = numbers.shape
    whole, skips = np.empty((rows + 2, cols + 4), np.int32), np.empty((rows, cols), np.uint8)
    first, missing = _first_of(numbers), (numbers == MISSING).any()
    surrounded(numbers, classes, first, whole, skips)
    given, weights = np.zeros((CLASSES, NEIGHBOURS), np.int64), np.zeros((CLASSES, WEIGHTS), np.int32)
    held, shares = np.zeros((CLASSES, SIGNS), np.int64), np.zeros((CLASSES, SIGNS), np.int32)
    _fitted(whole, skips, classes, weights, shares, given, held)
    size = rows * cols
    values, groups, kinds = np.empty(size, np.uint32), np.empty(size, np.int32), np.empty(size, np.int32)
    seen, counts = np.empty((CLASSES, 0, SIGNS + 1), np.int32), np.zeros(CLASSES, np.int64)
    used = look(whole, skips, classes, weights, shares, 1, seen, counts, values, groups, kinds)
    values, groups, kinds = values[:used], groups[:used], kinds[:used]
    places = np.empty((CLASSES, GROUPS, BINS), np.int64)
    number = _divided(values, groups, kinds, WHOLE_GROUPS if classes == 1 else NESTED_GROUPS, places)
    depths, direct = np.zeros(number, np.int64), np.zeros(number, np.int64)
    codes, found = np.zeros((number, SYMBOLS), np.int64), np.zeros((number, SYMBOLS), np.int64)
    sizes = decided_tables(values, kinds, number, RARE, depths, direct, found, codes)
    words, states = np.empty(WORDS * used + 1, np.uint16), np.empty(LANES32, np.int64)
    ordered, steps, ranges = _in_steps(values, kinds, depths, direct, skips)
    p = _stream(ordered, steps, ranges, depths, direct, found, words, states)
    most = HEADER + CLASSES * (CLASS + GROUPS * BINS) + SETS * (4 + 8 * SYMBOLS)
    head = np.zeros(most + (2 * numbers.size + 16 if missing else 0), np.uint8)
    head[0], head[2], head[3] = VERSION, classes, number
    _write_u32(head, 4, np.int64(first))
    at = HEADER
    for k in range(classes == CLASSES, classes):
        for i in range(NEIGHBOURS):
            head[at + 2 * i], head[at + 2 * i + 1] = np.uint8(given[k, i] & 255), np.uint8(given[k, i] >> 8 & 255)
        for i in range(SIGNS):
            head[at + 2 * NEIGHBOURS + i] = held[k, i]
        at += CLASS
    at = _write_map(head, at, places[classes == CLASSES : classes])
    at = write_tables(head, at, number, depths, direct, sizes, codes)
    if missing:
        one, two = write_mask(numbers, 1, head, at), write_mask(numbers, 2, head, at)
        head[1] = 1 if one <= two else 2
        at = write_mask(numbers, head[1], head, at)
    lanes = min(rows, LANES32)
    out = np.empty(at + 4 * lanes + 2 * (words.size - p), np.uint8)
    for k in range(at):
        out[k] = head[k]
    for k in range(lanes):
        _write_u32(out, at, states[k])
        at += 4
    for k in range(words.size - p):
        out[at + 2 * k] = np.uint8(words[p + k] & 255)
        out[at + 2 * k + 1] = np.uint8(words[p + k] >> 8)
    return out
