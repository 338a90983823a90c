"""What the decoder of *smallest* prepares before it steps: factors of lanes, marks of steps, tables of cells."""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._numba import kernel
from orograph.store.codec_head import TOTAL
from orograph.store.smallest_rows import (
    BINS,
    CLASSES,
    GROUPS,
    SIGNS,
    WEIGHTS,
    begin_of,
    class_of,
    own_factors,
)

MARKS = np.uint16  # a bit for each lane
FACTORS = WEIGHTS + SIGNS + 1  # of a lane: weights, shares, and the offset of its class among the cells


@kernel
def put_factors(band, classes, weights, shares, factors):
    """Fill in the factors of all lanes, for rows of the first band of sixteen, or of later ones."""
    own_weights, own_shares = np.empty(WEIGHTS, np.int32), np.empty(SIGNS, np.int32)
    for parity in range(2):
        for i in range(LANES32):
            k = class_of(i, parity + i, classes)  # (the parity of the column follows from the step and the lane)
            own_factors(band * LANES32 + i, weights[k], shares[k], own_weights, own_shares)
            at = parity * FACTORS * LANES32 + i
            for m in range(WEIGHTS):
                factors[at + m * LANES32] = own_weights[m]
            for m in range(SIGNS):
                factors[at + (WEIGHTS + m) * LANES32] = own_shares[m]
            factors[at + (FACTORS - 1) * LANES32] = k * GROUPS * BINS


@kernel
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


@kernel
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
        value = np.int64(0)
        for k in range(6):
            value |= np.int64(data[(bit + k) >> 3] >> ((bit + k) & 7) & 1) << k
        bit += 6
        if value >= tables:
            return -1
        cells[cell] = value * TOTAL
    return (bit + 7) >> 3
