"""What the encoder of *smallest* fits to a chunk: the weights of predictions, and the shares of signs in activities.

Both are least squares over some of the chunk's rows, in plain arithmetic, so that the same samples give the same bytes
everywhere.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32
from orograph._lanes32 import load32, store32
from orograph._numba import kernel
from orograph.store.codec_fit import (
    AROUND,
    FOUR,
    add_products,
    features_of,
    put_shares,
    put_surroundings,
    rounded_weights,
    sums_of,
    totals,
    weights_of,
)
from orograph.store.codec_head import NEIGHBOURS
from orograph.store.smallest_look import count_of, miss_row, parities_of, places_of, rows_of, signs_of
from orograph.store.smallest_rows import CLASSES, SIGNS, class_of

SAMPLED = 4096  # samples of a class that are used, approximately
SWEEPS = 100
LEAST_SIZE = 0.5  # of a residual that is expected, for the weights of samples
TERMS = -(-(SIGNS + 2) // FOUR) * FOUR  # the signs, a constant, the size of the residual, and zeros


@kernel
def _add_row(lines, row, parity, before, features, shares, counted, sums):
    """Add a row to the sums of the prediction; return the number of samples.

    Args:
        parity: of the columns. before: weights of a first round, and whether there are any.
    """
    skip = 1 if lines.split else 2  # (those less than two samples from an end do not count)
    ww, w, own, e, ee = places_of(lines, parity)
    at, pitch = (ww + skip, w + skip, own + skip, e + skip, ee + skip), lines.pitch
    every = 2 if lines.split else 1
    first, count = parity + every * skip, 0
    for col in range(first, lines.shape[1] - 2, every):
        counted[count] = not (lines.marks.size and lines.marks[row, col])
        count += 1
    around = lines.samples[row * pitch : (row + 3) * pitch].reshape(3, pitch)
    put_surroundings(around[0], around[1], around[2], at, count, features)
    used = put_shares(features, counted, shares)
    if before[NEIGHBOURS]:  # what is predicted badly must not outvote what is predicted well
        said = np.zeros(shares.size)
        for k in range(NEIGHBOURS):
            own, weight = features[k], before[k]
            for i in range(said.size):
                said[i] += weight * own[i]
        sought = features[NEIGHBOURS]
        for i in range(said.size):
            off = 0.5 + abs(sought[i] - said[i])
            shares[i] = np.sqrt(shares[i] / off) / off
    add_products(features, shares, np.empty(shares.size), sums)
    return used


@kernel
def fitted_weights(lines, row0, parity, weights):
    """Fit the weights (NEIGHBOURS,) int64, in 1/4096, of a class: of all columns of a parity in every row from the
    ``row0``-th on, or in every other one if the lines are split."""
    (rows, cols), spread = lines.shape, 2 if lines.split else 1
    step = spread * max(rows * cols // (spread * SAMPLED), 1)  # (classes of a nested chunk share the samples)
    features, before = features_of(AROUND, count_of(lines, parity)), np.zeros(NEIGHBOURS + 1)
    width = features.shape[1]
    shares, counted = np.zeros(width), np.zeros(width, np.int32)
    for _ in range(2):
        sums, used = sums_of(AROUND), 0
        for row in range(row0 if row0 >= 2 else row0 + 2, rows, step):
            used += _add_row(lines, row, parity, before, features, shares, counted, sums)
        before[:NEIGHBOURS], before[NEIGHBOURS] = weights_of(sums, used, 1e-6), 1.0
    rounded_weights(before, weights)


@kernel
def _add_signs(lines, row, parity, expected, noted, features, weighed, sums):
    """Add the samples of a parity of a row to the sums of their class.

    Args:
        expected: (SIGNS + 1,), how large residuals are by each sign and a constant; samples count accordingly.
        noted: flat, scratch: the signs, and the sizes of residuals. features: (``TERMS``, …), a constant in one.
    """
    rows, at, count = rows_of(lines, row), places_of(lines, parity), count_of(lines, parity)
    begin, width, every = parity * (lines.pitch // 2), features.shape[1], 2 if lines.split else 1
    for t in range(0, count, LANES32):
        signs = signs_of(lines, rows, at, load32(lines.sums, begin + t), t)
        for k in range(SIGNS):
            store32(noted, k * width + t, signs[k])
        store32(noted, SIGNS * width + t, load32(lines.sizes, rows[5] + at[2] + t))
    total = np.full(width, LEAST_SIZE + expected[SIGNS])
    for k in range(SIGNS + 1):
        own, sizes = features[k if k < SIGNS else SIGNS + 1], noted[k * width : (k + 1) * width]
        for i in range(width):
            own[i] = float(sizes[i])
        each = expected[k] if k < SIGNS else 0.0
        for i in range(width if each > 0.0 else 0):
            total[i] += each * own[i]
    for i in range(width):
        weighed[i] = 1.0 / (total[i] * total[i]) if i < count else 0.0
    if lines.marks.size:
        for i in range(count):
            weighed[i] = 0.0 if lines.marks[row, parity + every * i] else weighed[i]
    add_products(features, weighed, np.empty(width), sums)


@kernel
def fitted_shares(lines, weights, shares):
    """Fit each sign's share in the size of residuals: least squares without negative shares, over some rows.

    Args:
        weights: from ``factors_of``. shares: become (CLASSES, SIGNS) int64, in 1/256.
    """
    (rows, cols), classes = lines.shape, CLASSES if lines.split else 1
    step = 2 * max(rows * cols // (SAMPLED * (2 if lines.split else 1)), 2)
    features = features_of(TERMS, -(-count_of(lines, 0) // LANES32) * LANES32)
    noted, weighed = np.zeros(features.size, np.int32), np.zeros(features.shape[1])
    expected = np.full((CLASSES, SIGNS + 1), 1.0 / SIGNS)
    features[SIGNS] = 1.0
    for _ in range(2):  # (what is expected to be large must not outvote what is expected to be small)
        sums = [sums_of(TERMS) for _ in range(classes)]
        for row in range(rows):
            if (row + 2) % step >= 4:  # (two rows of each ``step``; they need the sizes of the two before them)
                continue
            miss_row(lines, row, weights)
            first, end = parities_of(lines, row)
            for parity in range(first, end if row > 0 and row % step < 2 else first):
                k = class_of(row, parity, classes)
                _add_signs(lines, row, parity, expected[k], noted, features, weighed, sums[k])
        for k in range(classes == CLASSES, classes):
            _solve_shares(totals(sums[k], TERMS), expected[k])
    for k in range(classes == CLASSES, classes):
        for i in range(SIGNS):
            shares[k, i] = min(np.int64(np.floor(expected[k, i] * 256 + 0.5)), 255)


@kernel
def _solve_shares(matrix, found):
    """Shares that are not negative, and a constant, from the sums of all products."""
    found[:] = 0.0
    for _ in range(SWEEPS):
        for k in range(SIGNS + 1):
            off = matrix[SIGNS + 1, k]
            for m in range(SIGNS + 1):
                off -= matrix[k, m] * found[m]
            found[k] = max(found[k] + off / (matrix[k, k] + 1e-3), 0.0)
