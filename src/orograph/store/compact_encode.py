"""The kernels that encode chunks as the codec *compact* (``compact``; docs/codec.md has the format).

The encoder decides what a decoder need not know: the weights (least squares over some of the chunk's rows), the values
of missing samples, and (``compact_contexts``) how activities are divided among tables. Nothing depends on a library's
arithmetic or on the order of threads, so the same samples give the same bytes everywhere.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._numba import kernel, linked
from orograph.store.codec_fit import (
    AROUND,
    add_products,
    features_of,
    plane,
    put_shares,
    put_surroundings,
    rounded_weights,
    sums_of,
    weights_of,
)
from orograph.store.codec_head import MISSING, NEIGHBOURS, SYMBOLS, WORDS, full_weights
from orograph.store.codec_write import (
    FINE,
    based,
    decided_tables,
    put_codes,
    with_stream,
    write_mask,
    write_stream,
    write_tables,
    write_u32,
)
from orograph.store.compact_contexts import activity_of, divided, shift_of
from orograph.store.compact_decode import (
    CONTEXTS,
    HEADER,
    VERSION,
    extend,
    predicted,
)

SAMPLED = 32  # rows that weights are fitted to
RARE = 8  # values that one in 2^8 exceeds are ranges


@linked
def _mark_counted(far, near, line, counted):
    """Mark the samples of a row of which, and of all around them, none is missing: 1, else 0."""
    for i in range(counted.size):
        lowest = min(min(line[i], line[i + 1]), line[i + 2])
        for k in range(5):
            lowest = min(min(lowest, near[i + k]), far[i + k])
        counted[i] = lowest != MISSING


@linked
def fitted(numbers, weights):
    """The weights (11,) int64, in 1/4096, fitted to some rows; those of a plane where there is too little to go by."""
    rows, cols = numbers.shape
    count, sums, used = max(cols - 4, 0), sums_of(AROUND), 0
    features = features_of(AROUND, count)
    width = features.shape[1]
    shares, scratch, counted = np.empty(width), np.empty(2 * width), np.zeros(width, np.int32)
    for row in range(2, rows, max(rows // SAMPLED, 1)):
        far, near, line = numbers[row - 2], numbers[row - 1], numbers[row]
        _mark_counted(far, near, line, counted[:count])
        put_surroundings(far, near, line, (0, 1, 2, 3, 4), count, features)
        used += put_shares(features, counted, shares)
        add_products(features, shares, scratch, sums)
    rounded_weights(weights_of(sums, 1e-5 + 0.1 / max(used, 1), plane()), weights)


@linked
def _values(numbers, weights, lowest, highest, values):
    """Compute each sample's difference from its prediction, zigzag-coded, in rows of whole lanes. A missing sample
    takes its prediction, clamped to the range of the others."""
    rows, cols = numbers.shape
    lines, base = np.empty((3, cols + 4), np.int32), np.empty(cols, np.int32)
    w0, w1 = weights[0], weights[1]
    for row in range(rows):
        line, near, far = lines[row % 3], lines[(row + 2) % 3], lines[(row + 1 + (row == 1)) % 3]
        if row:
            predicted(weights, far, near, base)
        west = farther = np.int32(0) if row == 0 else near[2]
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


@kernel
def encode(numbers):
    """Return the bytes of a chunk, (n,) uint8.

    Args:
        numbers: (rows, cols) int32, C order, at least one sample.
    """
    (rows, cols), (origin, factor, numbers) = numbers.shape, based(numbers)
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
    given, weights = np.empty(NEIGHBOURS, np.int64), np.empty(NEIGHBOURS + 1, np.int32)
    fitted(numbers, given)
    full_weights(given, weights)
    width = LANES32 * (-(-cols // LANES32))
    values, activity = np.empty((rows, width), np.uint32), np.empty((rows, width), np.int32)
    _values(numbers, weights, lowest, highest, values)
    shift = shift_of(values)
    activity_of(values, shift, activity)
    bounds = np.zeros(CONTEXTS, np.int64)
    contexts = divided(values, activity, bounds)
    depths, direct = np.zeros(contexts, np.int64), np.zeros(contexts, np.int64)
    codes = np.zeros((contexts, SYMBOLS), np.int64)
    found = np.zeros((contexts, SYMBOLS), np.int64)
    sizes = decided_tables(values, activity, contexts, RARE, FINE, depths, direct, found, codes)
    flat, steps = values.reshape(values.size), activity.reshape(values.size)
    put_codes(flat, steps, depths, direct)
    words, states = np.empty(WORDS * values.size + LANES32, np.uint16), np.empty(LANES32, np.int32)
    lanes = np.arange(LANES32).astype(np.int32)
    p = write_stream(flat, lanes, LANES32, steps, depths, direct, found, words, states)
    head = np.zeros(HEADER + CONTEXTS * (4 + 8 * SYMBOLS) + (2 * numbers.size + 16 if missing else 0), np.uint8)
    mode, at = 0, HEADER
    head[0], head[2], head[3] = VERSION, contexts, shift
    write_u32(head, 4, origin)
    write_u32(head, 8, factor)
    for k in range(NEIGHBOURS):
        head[12 + 2 * k], head[13 + 2 * k] = np.uint8(given[k] & 255), np.uint8(given[k] >> 8 & 255)
    for k in range(1, contexts):
        head[at] = np.uint8(bounds[k])
        at += 1
    at = write_tables(head, at, contexts, depths, direct, sizes, codes)
    if missing:
        one, two = write_mask(numbers, 1, head, at), write_mask(numbers, 2, head, at)
        mode = 1 if one <= two else 2
        at = write_mask(numbers, mode, head, at)
    head[1] = mode
    return with_stream(head, at, states, words[p:])
