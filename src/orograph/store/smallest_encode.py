"""The kernels that encode chunks as the codec *smallest* (``smallest``; docs/codec.md has the format).

An encoder knows all samples, so nothing depends on the sample before: what decoders compute sample by sample is
computed here row by row (``smallest_look``).
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._numba import kernel, linked
from orograph.store.codec_fit import rounded_weights
from orograph.store.codec_head import (
    MISSING,
    NEIGHBOURS,
    SYMBOLS,
    WORDS,
    full_weights,
)
from orograph.store.codec_write import (
    based,
    decided_tables,
    symbol_of,
    write_mask,
    write_stream,
    write_tables,
    write_u32,
)
from orograph.store.compact_contexts import cost_of, grouped, joined, token
from orograph.store.smallest_fit import fitted_sets, fitted_shares, fitted_weights
from orograph.store.smallest_look import Rules, lines_of, look, parities_of
from orograph.store.smallest_rows import (
    BINS,
    CHOICES,
    CLASSES,
    COARSE_SHARE,
    COARSE_WEIGHT,
    ENTRIES,
    GROUPS,
    HEADER,
    SET,
    SETS,
    SHARE_BITS,
    SHORT_SET,
    SIGNS,
    TESTS,
    VERSION,
    WEIGHT_BITS,
    WEIGHTS,
    begin_of,
    put_choices,
    steps_of,
)

WHOLE_GROUPS, NESTED_GROUPS = 24, 12
CELLS = CLASSES * GROUPS * BINS
RARE, COARSE = 6, 4  # as in *compact*, where they are 8 and 5: here shorter tables outweigh the loss


@linked
def _merged(counts, lengths, left, final):
    """Merge any two tables while that makes the chunk smaller; return how many are left.

    Args:
        counts: (tables, n). lengths: (tables,), beyond which all counts are 0. left: the number of tables.
        final: (tables,), becomes the table that each is merged into, numbered without gaps.
    """
    costs, joint, into = np.zeros(left), np.zeros((left, left)), np.arange(left)
    for k in range(left):
        costs[k] = cost_of(counts[k, : lengths[k]], counts[k], 0)
        for m in range(k):
            joint[k, m] = cost_of(counts[k, : max(lengths[k], lengths[m])], counts[m], 1) - costs[k] - costs[m]
    while True:
        one, other, best = 0, 0, 0.0
        for k in range(left):
            row = joint[k, :k]
            for m in range(k):
                if row[m] < best:
                    one, other, best = k, m, row[m]
        if one == other:
            break
        counts[other] += counts[one]
        costs[other] += costs[one] + best
        lengths[other] = max(lengths[other], lengths[one])
        into[one], joint[one], joint[:, one] = other, 0.0, 0.0
        for k in range(left):
            if into[k] == k and k != other:
                change = cost_of(counts[k, : max(lengths[k], lengths[other])], counts[other], 1)
                joint[max(k, other), min(k, other)] = change - costs[k] - costs[other]
    number = 0
    for k in range(left):
        if into[k] == k:
            final[k] = number
            number += 1
        else:
            final[k] = final[into[k]]
    return number


@kernel
def _counted(values, cells, most, merged):
    """Divide groups of activity into at most ``most``, and count the values of cells.

    Args:
        values, cells: from ``look``; ``cells`` become (class · ``BINS`` + bin) · groups + group.
        merged: (GROUPS,), becomes the group that each belongs to.

    Returns:
        how often each cell has each token.
    """
    parts, found = np.zeros((4, CELLS), np.int64), np.empty(CELLS, np.int32)
    flat, largest = parts.reshape(4 * CELLS), np.uint32(0)
    for k in range(cells.size):  # (in four parts, for neighbours mostly have the same cell)
        flat[np.uint64((k & 3) * CELLS + cells[k])] += 1
        largest = max(largest, values[k])
    sizes = np.zeros(GROUPS, np.int64)
    for cell in range(CELLS):
        sizes[cell // BINS % GROUPS] += parts[:, cell].sum()
    groups = grouped(sizes, merged, most)
    for cell in range(CELLS):
        kind = cell // (GROUPS * BINS) * BINS + cell % BINS
        found[cell] = kind * groups + merged[cell // BINS % GROUPS]
    longest = token(np.int64(largest)) + 1
    counts = np.zeros((CLASSES * BINS * groups, longest), np.int64)
    every = counts.reshape(counts.size)
    for k in range(values.size):
        cell = found[np.uint64(cells[k])]
        cells[k] = cell
        every[np.uint64(cell * longest + token(np.int64(values[k])))] += 1
    return counts


@linked
def _divided(values, cells, most, places):
    """Choose the tables of all cells; return their number.

    Args:
        values, cells: of the samples that are coded, from ``look``; ``cells`` become tables.
        most: the largest number of groups to distinguish.
        places: (CLASSES, GROUPS, BINS) int64, become tables, -1 where there are no samples.
    """
    merged = np.empty(GROUPS, np.int64)
    counts = _counted(values, cells, most, merged)
    count, filled = counts.shape[0], 0
    groups, table, lengths = count // (CLASSES * BINS), np.full(count, -1, np.int64), np.zeros(count, np.int64)
    for cell in range(count):  # (counts move up: those that hold anything come first)
        length = counts.shape[1]
        while length > 0 and counts[cell, length - 1] == 0:
            length -= 1
        if length:
            if cell != filled:
                counts[filled] = counts[cell]
            table[cell], lengths[filled] = filled, length
            filled += 1
    tables, chain = 1, np.zeros(max(filled, 1), np.int64)
    if filled:
        firsts, final = np.zeros(filled, np.int64), np.zeros(filled, np.int64)
        links, now = joined(counts, lengths, filled, firsts, SETS), 0
        tables = _merged(counts, lengths, links, final)
        for at in range(filled):
            while now + 1 < links and at >= firsts[now + 1]:
                now += 1
            chain[at] = final[now]
    for cell in range(count):
        if table[cell] >= 0:
            table[cell] = chain[table[cell]]
    for kind in range(CLASSES * BINS):
        for group in range(GROUPS):
            places[kind // BINS, group, kind % BINS] = table[kind * groups + merged[group]]
    for k in range(cells.size):
        cells[k] = table[np.uint64(cells[k])]
    return tables


@linked
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
                bit = _write_bits(out, bit + 1, 6, here)
    return (bit + 7) >> 3


@kernel
def _in_steps(values, tables, depths, direct, lines):
    """Values and codes (a table's number times ``SYMBOLS``, plus the symbol) in the order of steps, flat, sixteen in
    each, -1 where a lane has nothing; and of each step whether it has ranges."""
    rows, cols = lines.shape
    steps, n, every, marks = steps_of(rows, cols), 0, 2 if lines.split else 1, lines.marks
    ordered, codes = np.zeros(steps * LANES32, np.uint32), np.full(steps * LANES32, -1, np.int32)
    ranges = np.zeros(steps, np.bool_)
    for row in range(rows):
        begin, (first, end) = begin_of(row, cols), parities_of(lines, row)
        at = begin * LANES32 + row % LANES32
        for parity in range(first, end):
            for col in range(parity, cols, every):
                if marks.size and marks[row, col]:
                    continue
                here, c, value = np.uint64(at + col * LANES32), np.uint64(tables[np.uint64(n)]), values[np.uint64(n)]
                symbol = symbol_of(np.int64(value) >> depths[c], direct[c])
                if symbol >= direct[c]:
                    ranges[np.uint64(begin + col)] = True
                ordered[here], codes[here] = value, np.int64(c) * SYMBOLS + symbol
                n += 1
    return ordered, codes, ranges


@linked
def _fitted(lines, classes, limits, given, held):
    """Fit the limits of tests, if there are any, and the weights (CHOICES, NEIGHBOURS) and shares (CHOICES, SIGNS) of
    all sets, as they are written; return the rules, and how many sets there are, counting from 0."""
    first, sets, tested = 1 if classes == CLASSES else 0, classes, False
    for k in range(first, classes):
        whole, features, counted = fitted_weights(lines, k >> 1, k & 1)
        rounded_weights(whole, given[k])
        if classes == 1 and fitted_sets(lines, whole, features, counted, limits, given):
            sets, tested = CHOICES, True
    weights, shares = np.zeros((CHOICES, WEIGHTS), np.int32), np.zeros((CHOICES, SIGNS), np.int32)
    for k in range(first, sets):
        full_weights(given[k], weights[k])
    rules = Rules(np.zeros((WEIGHTS + SIGNS) * ENTRIES, np.int32), limits, tested)
    put_choices(first, sets, weights, shares, rules.choices)
    fitted_shares(lines, rules, held)
    for k in range(first, sets):
        for i in range(SIGNS):
            shares[k, i] = held[k, i]
    put_choices(first, sets, weights, shares, rules.choices)
    return rules, sets


@linked
def _write_sets(out, at, first, sets, limits, given, held):
    """Write limits and sets; return where they end."""
    if sets == CHOICES:
        for k in range(TESTS):
            out[at + 2 * k], out[at + 2 * k + 1] = limits[k] & 255, limits[k] >> 8
        at += 2 * TESTS
    for k in range(first, sets):
        if sets == CHOICES:
            bit = at * 8
            for i in range(NEIGHBOURS):
                bit = _write_bits(out, bit, WEIGHT_BITS, given[k, i] >> COARSE_WEIGHT)
            for i in range(SIGNS):
                bit = _write_bits(out, bit, SHARE_BITS, held[k, i] >> COARSE_SHARE)
            at += SHORT_SET
        else:
            for i in range(NEIGHBOURS):
                out[at + 2 * i], out[at + 2 * i + 1] = np.uint8(given[k, i] & 255), np.uint8(given[k, i] >> 8 & 255)
            for i in range(SIGNS):
                out[at + 2 * NEIGHBOURS + i] = held[k, i]
            at += SET
    return at


@linked
def _write_bits(out, bit, count, value):
    """Write so many bits of a number to zeroed bytes, the lowest first; return where they end."""
    for i in range(count):
        out[bit >> 3] |= np.uint8((value >> i & 1) << (bit & 7))
        bit += 1
    return bit


@kernel
def encode(numbers, classes):
    """Return the bytes of a chunk, (n,) uint8.

    Args:
        numbers: (rows, cols) int32, C order, at least one sample.
        classes: 1, or ``CLASSES``: samples of even row and column hold nothing.
    """
    rows, skipped, missing = numbers.shape[0], 1 if classes == CLASSES else 0, (numbers == MISSING).any()
    origin, factor, numbers = based(numbers)
    lines = lines_of(numbers, classes, missing)
    given, held = np.zeros((CHOICES, NEIGHBOURS), np.int64), np.zeros((CHOICES, SIGNS), np.int64)
    limits = np.zeros(TESTS, np.int32)
    rules, sets = _fitted(lines, classes, limits, given, held)
    signed, kinds = np.empty(numbers.size + LANES32, np.int32), np.empty(numbers.size + LANES32, np.int32)
    used = look(lines, rules, signed, kinds)
    values, kinds = signed.view(np.uint32)[:used], kinds[:used]
    places = np.empty((CLASSES, GROUPS, BINS), np.int64)
    number = _divided(values, kinds, WHOLE_GROUPS if classes == 1 else NESTED_GROUPS, places)
    depths, direct = np.zeros(number, np.int64), np.zeros(number, np.int64)
    codes, found = np.zeros((number, SYMBOLS), np.int64), np.zeros((number, SYMBOLS), np.int64)
    sizes = decided_tables(values, kinds, number, RARE, COARSE, depths, direct, found, codes)
    words, states = np.empty(WORDS * used + 1, np.uint16), np.empty(LANES32, np.int64)
    ordered, steps, ranges = _in_steps(values, kinds, depths, direct, lines)
    p = write_stream(ordered, steps, ranges, depths, direct, found, words, states)
    most = HEADER + CHOICES * SET + CLASSES * GROUPS * BINS + SETS * (4 + 8 * SYMBOLS)
    head = np.zeros(most + (2 * numbers.size + 16 if missing else 0), np.uint8)
    head[0], head[2], head[3] = VERSION, sets, number
    write_u32(head, 4, origin)
    write_u32(head, 8, factor)
    at = _write_sets(head, HEADER, skipped, sets, limits, given, held)
    at = _write_map(head, at, places[skipped:classes])
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
        write_u32(out, at, states[k])
        at += 4
    for k in range(words.size - p):
        out[at + 2 * k] = np.uint8(words[p + k] & 255)
        out[at + 2 * k + 1] = np.uint8(words[p + k] >> 8)
    return out
