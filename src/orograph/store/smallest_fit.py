"""What the encoder of *smallest* fits to a chunk: the weights of predictions, and the shares of signs in activities.

Both are least squares over some of the chunk's rows, in plain arithmetic, so that the same samples give the same bytes
everywhere.
"""

from __future__ import annotations

import numpy as np

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
from orograph.store.smallest_rows import SIGNS

SAMPLED = 4096  # samples of a class that are used, approximately
SWEEPS = 40
TERMS = -(-(SIGNS + 2) // FOUR) * FOUR  # the signs, a constant, the size of the residual, and zeros
BLOCK = 256  # samples


@kernel
def _add_row(whole, skip, row, col0, stride, before, features, shares, counted, sums):
    """Add a row to the sums of the prediction; return the number of samples.

    Args:
        whole: (rows + 2, cols + 4) int32, the samples with their surroundings. skip: (cols,) uint8.
        col0, stride: which columns. before: weights of a first round, and whether there are any.
    """
    first, count = col0 if col0 >= 2 else col0 + 2, 0
    for col in range(first, skip.size - 2, stride):
        counted[count] = skip[col] == 0
        count += 1
    put_surroundings(whole[row], whole[row + 1], whole[row + 2], first + 2, stride, count, features)
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
def fitted_weights(whole, skips, row0, col0, spread, weights):
    """Fit the weights (NEIGHBOURS,) int64, in 1/4096, for samples whose rows and columns are ``spread`` apart."""
    rows, cols = skips.shape
    step = spread * max(rows * cols // (spread * SAMPLED), 1)  # (classes of a nested chunk share the samples)
    features, before = features_of(AROUND, cols // spread), np.zeros(NEIGHBOURS + 1)
    width = features.shape[1]
    shares, counted = np.zeros(width), np.zeros(width, np.int32)
    for _ in range(2):
        sums, used = sums_of(AROUND), 0
        for row in range(row0 if row0 >= 2 else row0 + 2, rows, step):
            used += _add_row(whole, skips[row], row, col0, spread, before, features, shares, counted, sums)
        before[:NEIGHBOURS], before[NEIGHBOURS] = weights_of(sums, used, 1e-6), 1.0
    rounded_weights(before, weights)


@kernel
def fitted_shares(signs, used, shares):
    """Fit each sign's share in the size of residuals: least squares without negative shares.

    Args:
        signs: (n, SIGNS + 1) int32, last the sizes of residuals. used: how many to use.
        shares: become (SIGNS,) int64, in 1/256.
    """
    sums, features, found = sums_of(TERMS), features_of(TERMS, BLOCK), np.zeros(SIGNS + 1)
    weighed, scratch = np.zeros(BLOCK), np.empty(BLOCK)
    features[SIGNS] = 1.0
    for first in range(0, used, BLOCK):
        count = min(BLOCK, used - first)
        total = np.zeros(BLOCK, np.int32)
        for k in range(SIGNS + 1):
            own, sizes = features[k if k < SIGNS else SIGNS + 1], signs[first : first + count, k]
            for i in range(count):
                own[i] = float(sizes[i])
                total[i] += sizes[i] if k < SIGNS else 0
        for i in range(BLOCK):
            share = 1.0 / (1.0 + total[i] / SIGNS)
            weighed[i] = share * share if i < count else 0.0
        add_products(features, weighed, scratch, sums)
    matrix = totals(sums, TERMS)
    for _ in range(SWEEPS):
        for k in range(SIGNS + 1):
            off = matrix[SIGNS + 1, k]
            for m in range(SIGNS + 1):
                off -= matrix[k, m] * found[m]
            found[k] = max(found[k] + off / (matrix[k, k] + 1e-3), 0.0)
    for k in range(SIGNS):
        shares[k] = min(np.int64(np.floor(found[k] * 256 + 0.5)), 255)
