"""The kernels that encode chunks as the codec *smallest* (``smallest``; docs/codec.md has the format).

An encoder knows all samples, so nothing depends on the sample before: what decoders compute sample by sample is
computed here row by row (``smallest_look``).
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._lanes32 import transpose32
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
    put_codes,
    with_stream,
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
        costs[k] = cost_of(counts, k, k, lengths[k], 0)
        for m in range(k):
            joint[k, m] = cost_of(counts, k, m, max(lengths[k], lengths[m]), 1) - costs[k] - costs[m]
    while True:
        one, other, best = 0, 0, 0.0
        for k in range(left):
            for m in range(k):
                if joint[k, m] < best:
                    one, other, best = k, m, joint[k, m]
        if one == other:
            break
        counts[other] += counts[one]
        costs[other] += costs[one] + best
        lengths[other] = max(lengths[other], lengths[one])
        into[one], joint[one], joint[:, one] = other, 0.0, 0.0
        for k in range(left):
            if into[k] == k and k != other:
                change = cost_of(counts, k, other, max(lengths[k], lengths[other]), 1)
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
def _counted(values, cells, classes, most, merged):
    """Divide groups of activity into at most ``most``, and count the values of cells.

    Args:
        values, cells: from ``look``; ``cells`` become (class · ``BINS`` + bin) · groups + group.
        classes: how many there are. most: how many groups at most.
        merged: (GROUPS,), becomes the group that each belongs to.

    Returns:
        how often each cell has each token.
    """
    number, largest = classes * GROUPS * BINS, np.uint32(0)
    parts, found = np.zeros((4, number), np.int64), np.empty(number, np.int32)
    flat = parts.reshape(4 * number)
    for k in range(cells.size):  # (in four parts, for neighbours mostly have the same cell)
        flat[np.uint64((k & 3) * number + cells[k])] += 1
        largest = max(largest, values[k])
    sizes = np.zeros(GROUPS, np.int64)
    for cell in range(number):
        sizes[cell // BINS % GROUPS] += parts[:, cell].sum()
    groups = grouped(sizes, merged, most)
    for cell in range(number):
        kind = cell // (GROUPS * BINS) * BINS + cell % BINS
        found[cell] = kind * groups + merged[cell // BINS % GROUPS]
    longest = token(np.int64(largest)) + 1
    counts = np.zeros((classes * BINS * groups, longest), np.int64)
    every = counts.reshape(counts.size)
    for k in range(values.size):
        cell = found[np.uint64(cells[k])]
        cells[k] = cell
        every[np.uint64(cell * longest + token(np.int64(values[k])))] += 1
    return counts


@linked
def _divided(values, cells, classes, most, places):
    """Choose the tables of all cells; return their number.

    Args:
        values, cells: of the samples that are coded, from ``look``; ``cells`` become tables.
        classes, most: the number of classes, and the largest number of groups to distinguish.
        places: (classes, GROUPS, BINS) int64, become tables, -1 where there are no samples.
    """
    merged = np.empty(GROUPS, np.int64)
    counts = _counted(values, cells, classes, most, merged)
    count, filled = counts.shape[0], 0
    groups, table, lengths = count // (classes * BINS), np.full(count, -1, np.int64), np.zeros(count, np.int64)
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
    for kind in range(classes * BINS):
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


@linked
def _of_lanes(lines, found, none):
    """Numbers of all samples in the order of steps, lane by lane, flat.

    Args:
        found: the numbers in the order of ``look``. none: stands where a lane has nothing.
    """
    (rows, cols), n, every, marks = lines.shape, 0, 2 if lines.split else 1, lines.marks
    out = np.full((LANES32, -(-steps_of(rows, cols) // LANES32) * LANES32), none, np.int32)
    for row in range(rows):
        begin, (first, end) = begin_of(row, cols), parities_of(lines, row)
        own = out[row % LANES32, begin : begin + cols]
        if every == 1 and marks.size == 0:
            own[:] = found[n : n + cols]
            n += cols
            continue
        for parity in range(first, end):
            for col in range(parity, cols, every):
                if not (marks.size and marks[row, col]):
                    own[np.uint64(col)] = found[np.uint64(n)]
                    n += 1
    return out.reshape(out.size)


@kernel
def _write_stream(lines, values, codes, depths, direct, found, words, states):
    """As ``write_stream``, from values and codes in the order of ``look``."""
    own, lanes = _of_lanes(lines, values, 0), _of_lanes(lines, codes, depths.size * SYMBOLS)
    every, steps = own.size // LANES32, np.empty(own.size, np.int32)
    for step in range(0, every, LANES32):
        transpose32(lanes, step, every, steps, step * LANES32, LANES32)
    offsets = (np.arange(LANES32) * every).astype(np.int32)
    return write_stream(own, offsets, 1, steps, depths, direct, found, words, states)


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
    signed, placed = np.empty(numbers.size + LANES32, np.int32), np.empty(numbers.size + LANES32, np.int32)
    used = look(lines, rules, signed, placed)
    values, kinds = signed.view(np.uint32)[:used], placed[:used]
    places, most = np.empty((classes, GROUPS, BINS), np.int64), WHOLE_GROUPS if classes == 1 else NESTED_GROUPS
    number = _divided(values, kinds, classes, most, places)
    depths, direct = np.zeros(number, np.int64), np.zeros(number, np.int64)
    codes, found = np.zeros((number, SYMBOLS), np.int64), np.zeros((number, SYMBOLS), np.int64)
    sizes = decided_tables(values, kinds, number, RARE, COARSE, depths, direct, found, codes)
    words, states = np.empty(WORDS * used + LANES32, np.uint16), np.empty(LANES32, np.int32)
    placed[used:] = 0
    put_codes(signed[: used + LANES32 - 1], placed, depths, direct)
    p = _write_stream(lines, signed, placed, depths, direct, found, words, states)
    most = HEADER + CHOICES * SET + CLASSES * GROUPS * BINS + SETS * (4 + 8 * SYMBOLS)
    head = np.zeros(most + (2 * numbers.size + 16 if missing else 0), np.uint8)
    head[0], head[2], head[3] = VERSION, sets, number
    write_u32(head, 4, origin)
    write_u32(head, 8, factor)
    at = _write_sets(head, HEADER, skipped, sets, limits, given, held)
    at = _write_map(head, at, places[skipped:])
    at = write_tables(head, at, number, depths, direct, sizes, codes)
    if missing:
        one, two = write_mask(numbers, 1, head, at), write_mask(numbers, 2, head, at)
        head[1] = 1 if one <= two else 2
        at = write_mask(numbers, head[1], head, at)
    return with_stream(head, at, states[: min(rows, LANES32)], words[p:])
