"""What the encoder of *smallest* fits to a chunk: the weights of predictions, and the shares of signs in activities.

Both are least squares over some of the chunk's rows, in plain arithmetic, so that the same samples give the same bytes
everywhere.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel
from orograph.store.codec_head import (
    NEIGHBOURS,
    TOTAL,
)
from orograph.store.compact_encode import OFFSETS
from orograph.store.smallest_rows import SIGNS

SAMPLED = 4096  # samples of a class that are used, approximately
SWEEPS = 40


@kernel
def _equations(whole, skips, row0, col0, step, stride, before, matrix, right):
    """Sum up the normal equations of the prediction; return the number of samples.

    Args:
        whole: (rows + 2, cols + 4) int32, the samples with their surroundings. skips: (rows, cols) uint8.
        row0, col0, step, stride: which rows and columns. before: weights of a first round, or zeros.
    """
    rows, cols = skips.shape
    used, d = 0, np.empty(NEIGHBOURS)
    for row in range(row0 if row0 >= 2 else row0 + 2, rows, step):
        for col in range(col0 if col0 >= 2 else col0 + 2, cols - 2, stride):
            if skips[row, col]:
                continue
            used += 1
            north = float(whole[row + 1, col + 2])
            sought = float(whole[row + 2, col + 2]) - north
            said = 0.0
            for k in range(NEIGHBOURS):
                d[k] = float(whole[row + 2 + OFFSETS[k, 0], col + 2 + OFFSETS[k, 1]]) - north
                said += before[k] * d[k]
            # A cliff must not outweigh the plain, nor badly predicted samples well predicted ones.
            share = 1.0 / (2.0 + abs(d[0]) + abs(d[3]) + abs(d[4]) + abs(d[8]))
            if before[NEIGHBOURS]:
                off = 0.5 + abs(sought - said)
                share = np.sqrt(share / off) / off
            for k in range(NEIGHBOURS):
                part = share * d[k]
                right[k] += part * sought
                for m in range(k + 1):
                    matrix[k, m] += part * d[m]
    return used


@kernel
def solved(matrix, right):
    """Solve a positive definite system, of which the lower triangle is given, in place."""
    n = right.size
    for k in range(n):
        for m in range(k):
            matrix[m, k] = matrix[k, m]
    for k in range(n):
        for m in range(k + 1, n):
            share = matrix[m, k] / matrix[k, k]
            right[m] -= share * right[k]
            for i in range(k, n):
                matrix[m, i] -= share * matrix[k, i]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            right[k] -= matrix[k, i] * right[i]
        right[k] /= matrix[k, k]


@kernel
def fitted_weights(whole, skips, row0, col0, spread, weights):
    """Fit the weights (NEIGHBOURS,) int64, in 1/4096, for samples whose rows and columns are ``spread`` apart."""
    rows, cols = skips.shape
    step = spread * max(rows * cols // (spread * spread * SAMPLED), 1)
    before = np.zeros(NEIGHBOURS + 1)
    for _ in range(2):
        matrix, right = np.zeros((NEIGHBOURS, NEIGHBOURS)), np.zeros(NEIGHBOURS)
        used = _equations(whole, skips, row0, col0, step, spread, before, matrix, right)
        trace = 0.0
        for k in range(NEIGHBOURS):
            trace += matrix[k, k]
        ridge = trace * (1e-6 + (0.1 / used if used else 0.0)) + 1e-3
        for k in range(NEIGHBOURS):  # towards W + N - NW
            matrix[k, k] += ridge
        right[0] += ridge
        right[3] -= ridge
        solved(matrix, right)
        before[:NEIGHBOURS], before[NEIGHBOURS] = right, 1.0
    for k in range(NEIGHBOURS):
        weights[k] = np.int64(np.floor(min(max(before[k], -7.9), 7.9) * TOTAL + 0.5))


@kernel
def fitted_shares(signs, sizes, used, shares):
    """Fit each sign's share in the size of residuals: least squares without negative shares.

    Args:
        signs: (n, SIGNS) int32. sizes: (n,) int32. used: how many to use. shares: become (SIGNS,) int64, in 1/256.
    """
    n = SIGNS + 1
    matrix, right, d, found = np.zeros((n, n)), np.zeros(n), np.ones(n), np.zeros(n)
    for at in range(used):
        total = 0.0
        for k in range(SIGNS):
            d[k] = float(signs[at, k])
            total += d[k]
        share = 1.0 / (1.0 + total / SIGNS)
        share *= share
        for k in range(n):
            part = share * d[k]
            right[k] += part * sizes[at]
            for m in range(k + 1):
                matrix[k, m] += part * d[m]
    for k in range(n):
        for m in range(k):
            matrix[m, k] = matrix[k, m]
    for _ in range(SWEEPS):
        for k in range(n):
            off = right[k]
            for m in range(n):
                off -= matrix[k, m] * found[m]
            found[k] = max(found[k] + off / (matrix[k, k] + 1e-3), 0.0)
    for k in range(SIGNS):
        shares[k] = min(np.int64(np.floor(found[k] * 256 + 0.5)), 255)
