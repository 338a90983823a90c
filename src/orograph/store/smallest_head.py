"""What the decoder of *smallest* prepares before it steps: factors of lanes, marks of steps, tables of cells."""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._numba import linked
from orograph.store.codec_head import NEIGHBOURS, TOTAL, full_weights, read_weights, u16
from orograph.store.smallest_rows import (
    BINS,
    CAP,
    CHOICES,
    CLASSES,
    COARSE_SHARE,
    COARSE_WEIGHT,
    ENTRIES,
    GROUPS,
    SET,
    SHARE_BITS,
    SHORT_SET,
    SIGNS,
    TESTS,
    WEIGHT_BITS,
    WEIGHTS,
    begin_of,
    class_of,
    entry_of,
    put_choices,
)

MARKS = np.uint16  # a bit for each lane
FACTORS = WEIGHTS + SIGNS + 1  # of a lane: weights, shares, and the offset of its class among the cells


@linked
def read_sets(data, at, form, limits, choices):
    """Read the limits of tests and the sets of weights and shares; return where they end, or -1.

    Args:
        form: how many sets there are; ``CLASSES``: one fewer.
        limits: (TESTS,) int32, become those of the tests, unless there are none. choices: as in ``put_choices``.
    """
    weights, shares = np.zeros((CHOICES, WEIGHTS), np.int32), np.zeros((CHOICES, SIGNS), np.int32)
    first = 1 if form == CLASSES else 0
    if at + (2 * TESTS + CHOICES * SHORT_SET if form == CHOICES else (form - first) * SET) > data.size:
        return -1
    if form == CHOICES:
        for k in range(TESTS):
            limits[k] = u16(data, at + 2 * k)
        at += 2 * TESTS
        for k in range(CHOICES):
            _read_short(data, at + k * SHORT_SET, weights[k], shares[k])
        at += CHOICES * SHORT_SET
    else:
        for k in range(first, form):
            at = read_weights(data, at, weights[k])
            shares[k] = data[at : at + SIGNS]
            at += SIGNS
    put_choices(first, form, weights, shares, choices)
    return at


@linked
def _read_short(data, at, weights, shares):
    """Read a set of fewer bits."""
    given, bit = np.empty(NEIGHBOURS, np.int64), at * 8
    for k in range(NEIGHBOURS):
        given[k] = np.int16(_bits(data, bit, WEIGHT_BITS) << (16 - WEIGHT_BITS)) >> (16 - WEIGHT_BITS) << COARSE_WEIGHT
        bit += WEIGHT_BITS
    full_weights(given, weights)
    for k in range(SIGNS):
        shares[k] = _bits(data, bit, SHARE_BITS) << COARSE_SHARE
        bit += SHARE_BITS


@linked
def _bits(data, bit, count):
    """So many bits from a place on, the lowest first."""
    value = np.int64(0)
    for k in range(count):
        value |= np.int64(data[(bit + k) >> 3] >> ((bit + k) & 7) & 1) << k
    return value


@linked
def put_factors(band, classes, limits, choices, factors, tests):
    """Fill in the factors of all lanes, for rows of the first band of sixteen, or of later ones.

    Args:
        limits: as in ``read_sets``. factors: flat, of both parities. tests: flat, become the entry of each lane, if no
            test holds, and the limits of its tests.
    """
    for i in range(LANES32):
        row = band * LANES32 + i
        for parity in range(2):
            k = class_of(i, parity + i, classes)  # (the parity of the column follows from the step and the lane)
            entry, at = entry_of(row, k), parity * FACTORS * LANES32 + i
            for m in range(WEIGHTS + SIGNS):
                factors[at + m * LANES32] = choices[m * ENTRIES + entry]
            factors[at + (FACTORS - 1) * LANES32] = k * GROUPS * BINS
        tests[i] = entry_of(row, 0)
        for m in range(TESTS):
            tests[(1 + m) * LANES32 + i] = limits[m] if row > 1 else CAP


@linked
def mark_steps(marks, rows, cols, classes, coded, starts):
    """Mark which lanes have a sample in each step, and which are two before a row."""
    for row in range(rows):
        begin, bit = begin_of(row, cols), MARKS(1 << row % LANES32)
        if begin >= 2:
            starts[begin - 2] |= bit
        here, every = coded[begin : begin + cols], 2 if classes == CLASSES and row & 1 == 0 else 1
        if marks.size:
            for col in range(every - 1, cols, every):
                here[col] |= bit if marks[row, col] == 0 else MARKS(0)
        elif every == 1:
            for col in range(cols):
                here[np.uint64(col)] |= bit
        else:
            for col in range(1, cols, 2):
                here[np.uint64(col)] |= bit


@linked
def read_cells(data, at, classes, tables, cells):
    """Read the offset of the table of each class, group and bin; return where that ends, or -1."""
    bit, last = at * 8, data.size * 8
    for cell in range(classes * GROUPS * BINS):
        if bit + 1 > last:
            return -1
        same = data[bit >> 3] >> (bit & 7) & 1
        bit += 1
        if same:
            inner = cell % (GROUPS * BINS)
            cells[cell] = cells[cell - BINS] if inner >= BINS else (cells[cell - 1] if inner else 0)
            continue
        if bit + 6 > last:
            return -1
        value = _bits(data, bit, 6)
        bit += 6
        if value >= tables:
            return -1
        cells[cell] = value * TOTAL
    return (bit + 7) >> 3
