"""The kernels that encode chunks as the codec *smallest* (``smallest``; docs/codec.md has the format)."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel
from orograph.store.codec_head import (
    LEAST,
    MISSING,
    NEIGHBOURS,
    SYMBOLS,
    full_weights,
)
from orograph.store.compact_contexts import TOKENS, cost_of, grouped, joined, length, token
from orograph.store.compact_encode import decided_tables, push, push_plain, symbol_of, write_mask, write_tables
from orograph.store.smallest_decode import (
    BINS,
    CAP,
    CLASS,
    CLASSES,
    GROUPS,
    HEADER,
    PARTS,
    SETS,
    SIGNS,
    STEPS,
    VERSION,
    WORDS,
    class_of,
    continued,
    first_rows,
    judged,
    prepared,
    size_of,
    weighed,
)  # fmt: skip
from orograph.store.smallest_fit import SAMPLED, fitted_shares, fitted_weights

WHOLE_GROUPS, NESTED_GROUPS = 24, 12
SPLIT = 32  # rows from which on a chunk has two parts
RARE = 6  # values that one in 2^5 exceeds are ranges: shorter tables are worth more than what is lost


@kernel
def surrounded(numbers, classes, first, whole, skips):
    """Put a chunk among what decoders take to lie around it, and say which samples are not coded.

    Args:
        whole: (rows + 2, cols + 4) int32. skips: (rows, cols) uint8, 1 missing, 2 of the class that holds nothing.
    """
    rows, cols = numbers.shape
    whole[:2] = first
    for row in range(rows):
        line = whole[row + 2]
        for col in range(cols):
            here, skip = numbers[row, col], 0
            if classes == CLASSES and (row | col) & 1 == 0:
                here, skip = np.int32(0), 2
            elif here == MISSING:
                here, skip = whole[row + 1, col + 2], 1
            line[col + 2] = here
            skips[row, col] = skip
        continued(line, cols)


@kernel
def _judge(whole, skips, classes, weights, shares, step, seen, counts, values, activity, kind):
    """Predict every sample of a part as a decoder does.

    Args:
        whole, skips: from ``surrounded``. weights, shares: (CLASSES, …) int32.
        step: of every so many rows the signs of two are kept.
        seen: (CLASSES, n, SIGNS + 1) int32, become signs of some samples and the sizes of what is left.
        counts: (CLASSES,) int64, how many. values, activity, kind: (n,), become those of the samples that are coded:
            the value, the activity, and ``BINS`` times the class plus the bin.

    Returns:
        how many are coded.
    """
    rows, cols = skips.shape
    sizes = np.zeros((3, cols + 4), np.int32)
    side, halves = np.zeros((2, 9), np.int32), np.empty((2, cols), np.int32)
    bases, signs = np.empty(cols, np.int32), np.empty(cols, np.int32)
    lines, at, fitting = np.empty((3, cols + 4), np.int32), 0, seen.shape[1] > 0
    for row in range(rows):
        if fitting and (row + 2) % step >= 4:  # (those that are looked at need the sizes of the two before them)
            continue
        for k in range(3):
            lines[(row + k) % 3] = whole[row + (k + 2) % 3] if k else whole[row + 2]
        near, far, line, left = whole[row + 1], whole[row + (row == 1)], whole[row + 2], sizes[row % 3]
        above, further = sizes[(row + 2) % 3], sizes[(row + 1) % 3]
        prepared(row, classes, weights, shares, lines, sizes, halves, side, bases, signs)
        west, farther, last = side[0, 7], side[0, 8], np.int64(0)
        k0 = class_of(row, classes)
        some = fitting and row > 0 and row % step < 2
        for j in range(cols):
            here, size = line[j + 2], np.int64(0)
            if skips[row, j] == 0:
                c = j & 1
                k = k0 + c if classes == CLASSES else 0
                t = weighed(bases[j], side[c, 0], west, side[c, 1], farther)
                guess, active, other, bin_ = judged(t, signs[j], side, c, near[j + 2], west, farther, near[j + 1], last)
                residual = np.int32(here - guess)
                size = abs(np.int64(residual))
                if other:
                    residual = np.int32(-residual)
                values[at] = np.uint32(np.int32(residual << np.int32(1)) ^ np.int32(residual >> np.int32(31)))
                activity[at], kind[at] = active, BINS * k + bin_
                at += 1
                if some and counts[k] < seen.shape[1]:
                    one = seen[k, counts[k]]
                    counts[k] += 1
                    one[0], one[1], one[2], one[3], one[4] = (
                        above[j + 2],
                        above[j + 1],
                        above[j + 3],
                        above[j],
                        above[j + 4],
                    )
                    one[5] = further[j + 2]
                    one[6], one[7] = size_of(near[j + 2] - near[j + 1]), size_of(near[j + 2] - near[j + 3])
                    one[8], one[9] = size_of(near[j + 2] - far[j + 2]), size_of(near[j + 3] - far[j + 3])
                    one[10], one[11] = size_of(near[j + 1] - far[j + 1]), size_of(near[j + 3] - near[j + 4])
                    one[12], one[13], one[14] = last, size_of(west - near[j + 1]), size_of(west - farther)
                    one[15], one[16], one[17] = size_of(t >> 12), size_of(west - guess), min(size, CAP)
            last = min(size, np.int64(CAP))
            left[j + 2] = last
            farther = west
            west = here
    return at


@kernel
def _merged(counts, left, final):
    """Merge any two tables while that makes the chunk smaller; how many are left.

    Args:
        counts: (tables, TOKENS). left: tables. final: (tables,), becomes what each is merged into, without gaps.
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
def _divided(values, activity, kind, used, shift, groups, thresholds, places):
    """Decide groups of activity and the tables of all cells; (groups, tables).

    Args:
        values, activity, kind: from ``_judge``. used: how many are coded. groups: at most.
        thresholds: (GROUPS,) int64, become the first step of each group.
        places: (CLASSES, GROUPS, BINS) int64, become tables, -1 where there are no samples. ``kind`` becomes tables.
    """
    steps, group = np.zeros(STEPS, np.int64), np.empty(STEPS, np.int64)
    for k in range(used):
        activity[k] = min(activity[k] >> shift, STEPS - 1)
        steps[activity[k]] += 1
    groups = grouped(steps, group, groups)
    for step in range(STEPS - 1, -1, -1):
        thresholds[group[step]] = step
    cells = CLASSES * BINS * GROUPS
    counts, seen = np.zeros((cells, TOKENS), np.int64), np.zeros(cells, np.bool_)
    for k in range(used):
        cell = kind[k] * GROUPS + group[activity[k]]
        kind[k] = cell
        counts[cell, token(np.int64(values[k]))] += 1
        seen[cell] = True
    filled, table = 0, np.full(cells, -1, np.int64)
    for cell in range(cells):  # (counts move up: those that hold anything come first)
        if seen[cell]:
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
        group_, bin_ = cell % GROUPS, cell // GROUPS
        places[bin_ // BINS, group_, bin_ % BINS] = table[cell]
    for k in range(used):
        kind[k] = table[kind[k]]
    return groups, tables


@kernel
def _shift(activity, used):
    """By how much activities are shifted: nearly all are below ``STEPS`` then."""
    sizes = np.zeros(65, np.int64)
    for k in range(used):
        sizes[length(activity[k])] += 1
    bits, seen = 0, sizes[0]
    while seen < used - used // 32:
        bits += 1
        seen += sizes[bits]
    return min(max(bits - 10, 0), 15)


@kernel
def _write_map(out, at, classes, groups, places):
    """Write which table each class, group and bin has; where that ends."""
    bit = at * 8
    for k in range(classes):
        for g in range(groups):
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
def _stream(values, tables, used, depths, direct, found, words):
    """Write the words from the end, in the opposite order of reading; (the state, where they begin)."""
    p, state = np.int64(words.size), np.int64(LEAST)
    below = np.zeros(found.shape, np.int64)
    for c in range(found.shape[0]):
        for s in range(1, SYMBOLS):
            below[c, s] = below[c, s - 1] + found[c, s - 1]
    for k in range(used - 1, -1, -1):
        c, value = tables[k], np.int64(values[k])
        depth = depths[c]
        if depth:
            state, p = push_plain(state, p, words, depth, value & ((1 << depth) - 1))
            value >>= depth
        s = symbol_of(value, direct[c])
        if value >= direct[c]:
            beyond = value - direct[c] + 1
            bits = length(beyond) - 1
            beyond -= np.int64(1) << bits
            if bits > 16:
                state, p = push_plain(state, p, words, bits - 16, beyond >> 16)
            state, p = push_plain(state, p, words, min(bits, 16), beyond & 0xFFFF)
        state, p = push(state, p, words, found[c, s], below[c, s])
    return state, p


@kernel
def _write_u32(out, at, value):
    """Write the lowest 32 bits of a number, the lowest byte first."""
    for k in range(4):
        out[at + k] = np.uint8(value >> (8 * k) & 255)


@kernel
def encode(numbers, classes):
    """The bytes of a chunk, (n,) uint8.

    Args:
        numbers: (rows, cols) int32, C order, at least one sample. classes: 1, or ``CLASSES``: samples of even row and
            column hold nothing.
    """
    rows, cols = numbers.shape
    parts = PARTS if rows >= SPLIT else 1
    high, missing = first_rows(rows) if parts == PARTS else rows, 0
    above, begun = np.zeros(PARTS, np.int32), np.zeros(PARTS, np.bool_)
    for row in range(rows):
        part = np.int64(row >= high)
        for col in range(cols):
            here = numbers[row, col]
            if here == MISSING:
                missing += 1
            elif not begun[part]:
                begun[part] = True
                above[part] = here if classes == 1 else np.int32(0)
    whole, skips = np.empty((rows + 2, cols + 4), np.int32), np.empty((rows, cols), np.uint8)
    surrounded(numbers, classes, above[0], whole, skips)
    lower = np.empty((rows - high + 2, cols + 4), np.int32)
    surrounded(numbers[high:], classes, above[1], lower, skips[high:])
    given, held = np.zeros((CLASSES, NEIGHBOURS), np.int64), np.zeros((CLASSES, SIGNS), np.int64)
    weights, shares = np.zeros((CLASSES, NEIGHBOURS + 1), np.int32), np.zeros((CLASSES, SIGNS), np.int32)
    coded = classes - (classes == CLASSES)
    for k in range(classes - coded, classes):
        fitted_weights(whole, skips, k >> 1, k & 1, 1 if classes == 1 else 2, given[k])
        full_weights(given[k], weights[k])
    values, activity = np.empty(numbers.size, np.uint32), np.empty(numbers.size, np.int64)
    kind, counts = np.empty(numbers.size, np.int64), np.zeros(CLASSES, np.int64)
    seen = np.empty((CLASSES, SAMPLED, SIGNS + 1), np.int32)
    step = 2 * max(numbers.size // (SAMPLED * (1 if classes == 1 else 2)), 2)
    used = np.zeros(PARTS + 1, np.int64)
    for k in range(parts):
        one, there = (lower, skips[high:]) if k else (whole[: high + 2], skips[:high])
        _judge(one, there, classes, weights, shares, step, seen, counts, values, activity, kind)
    for k in range(classes - coded, classes):
        fitted_shares(seen[k], seen[k, :, SIGNS], counts[k], held[k])
        for i in range(SIGNS):
            shares[k, i] = held[k, i]
    for k in range(parts):
        one, there, at = (lower, skips[high:], used[1]) if k else (whole[: high + 2], skips[:high], np.int64(0))
        used[k + 1] = at + _judge(
            one, there, classes, weights, shares, step, seen[:, :0], counts, values[at:], activity[at:], kind[at:]
        )
    coded_samples = used[parts]
    shift = _shift(activity, coded_samples)
    thresholds, places = np.zeros(GROUPS, np.int64), np.empty((CLASSES, GROUPS, BINS), np.int64)
    groups = WHOLE_GROUPS if classes == 1 else NESTED_GROUPS
    groups, tables = _divided(values, activity, kind, coded_samples, shift, groups, thresholds, places)
    depths, direct = np.zeros(tables, np.int64), np.zeros(tables, np.int64)
    codes = np.zeros((tables, SYMBOLS), np.int64)
    found = np.zeros((tables, SYMBOLS), np.int64)
    sizes = decided_tables(values[:coded_samples], kind[:coded_samples], tables, RARE, depths, direct, found, codes)
    words, states = np.empty(WORDS * coded_samples, np.uint16), np.zeros(PARTS, np.int64)
    begins, end = np.zeros(PARTS, np.int64), words.size
    for k in range(parts - 1, -1, -1):  # (the words of the first part come first, both written from their ends)
        first, last = used[k], used[k + 1]
        states[k], begins[k] = _stream(values[first:], kind[first:], last - first, depths, direct, found, words[:end])
        end = begins[k]
    most = HEADER + CLASSES * (CLASS + GROUPS * BINS) + 2 * GROUPS + SETS * (4 + 8 * SYMBOLS)
    head = np.zeros(most + (2 * numbers.size + 16 if missing else 0), np.uint8)
    head[0], head[2], head[3], head[8], head[9], head[10] = VERSION, classes, shift, groups, tables, parts
    _write_u32(head, 4, np.int64(above[0]))
    at = HEADER
    for k in range(classes - coded, classes):
        for i in range(NEIGHBOURS):
            head[at + 2 * i], head[at + 2 * i + 1] = np.uint8(given[k, i] & 255), np.uint8(given[k, i] >> 8 & 255)
        for i in range(SIGNS):
            head[at + 2 * NEIGHBOURS + i] = held[k, i]
        at += CLASS
    for k in range(1, groups):
        head[at], head[at + 1] = np.uint8(thresholds[k] & 255), np.uint8(thresholds[k] >> 8)
        at += 2
    at = _write_map(head, at, coded, groups, places[classes - coded :])
    at = write_tables(head, at, tables, depths, direct, sizes, codes)
    if missing:
        one, two = write_mask(numbers, 1, head, at), write_mask(numbers, 2, head, at)
        head[1] = 1 if one <= two else 2
        at = write_mask(numbers, head[1], head, at)
    out = np.empty(at + 12 * parts - 8 + 2 * (words.size - end), np.uint8)
    for k in range(at):
        out[k] = head[k]
    if parts == PARTS:
        _write_u32(out, at, np.int64(above[1]))
        _write_u32(out, at + 4, begins[1] - begins[0])
        at += 8
    for k in range(parts):
        _write_u32(out, at, states[k])
        at += 4
    for k in range(words.size - end):
        out[at + 2 * k] = np.uint8(words[end + k] & 255)
        out[at + 2 * k + 1] = np.uint8(words[end + k] >> 8)
    return out
