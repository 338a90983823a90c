"""What the encoder of *smallest* fits to a chunk: the weights of predictions, and the shares of signs in activities.

Both are least squares over some of the chunk's rows, in plain arithmetic, so that the same samples give the same bytes
everywhere.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES
from orograph._numba import kernel
from orograph.store.codec_fit import differences, solved, tally
from orograph.store.codec_head import (
    NEIGHBOURS,
    TOTAL,
)
from orograph.store.smallest_rows import SIGNS

SAMPLED = 4096  # samples of a class that are used, approximately
SWEEPS = 40
WIDTH = 2 * LANES  # of rows of sums, at least ``NEIGHBOURS``


@kernel
def _equations(whole, skips, row0, col0, step, stride, before, matrix, right):
    """Sum up the normal equations of the prediction; return the number of samples.

    Args:
        whole: (rows + 2, cols + 4) int32, the samples with their surroundings. skips: (rows, cols) uint8.
        row0, col0, step, stride: which rows and columns. before: weights of a first round, or zeros.
        matrix, right: as of ``tally``.
    """
    rows, cols = skips.shape
    used, d = 0, np.zeros(WIDTH)
    for row in range(row0 if row0 >= 2 else row0 + 2, rows, step):
        far, near, line, skip = whole[row], whole[row + 1], whole[row + 2], skips[row]
        for col in range(col0 if col0 >= 2 else col0 + 2, cols - 2, stride):
            if skip[np.uint64(col)]:
                continue
            used += 1
            sought = float(line[np.uint64(col + 2)]) - float(near[np.uint64(col + 2)])
            differences(far, near, line, col + 2, d)
            # A cliff must not outvote the plain, nor what is predicted badly what is predicted well.
            share = 1.0 / (2.0 + abs(d[0]) + abs(d[3]) + abs(d[4]) + abs(d[8]))
            if before[NEIGHBOURS]:
                said = 0.0
                for k in range(NEIGHBOURS):
                    said += before[k] * d[k]
                off = 0.5 + abs(sought - said)
                share = np.sqrt(share / off) / off
            tally(matrix, right, WIDTH, NEIGHBOURS, d, share, sought)
    return used


@kernel
def fitted_weights(whole, skips, row0, col0, spread, weights):
    """Fit the weights (NEIGHBOURS,) int64, in 1/4096, for samples whose rows and columns are ``spread`` apart."""
    rows, cols = skips.shape
    step = spread * max(rows * cols // (spread * spread * SAMPLED), 1)
    before = np.zeros(NEIGHBOURS + 1)
    for _ in range(2):
        sums, line = np.zeros(WIDTH * WIDTH), np.zeros(WIDTH)
        used = _equations(whole, skips, row0, col0, step, spread, before, sums, line)
        matrix, right = sums.reshape(WIDTH, WIDTH)[:NEIGHBOURS, :NEIGHBOURS], line[:NEIGHBOURS]
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
    n, width = SIGNS + 1, 3 * LANES
    sums, right, d, found = np.zeros(width * width), np.zeros(width), np.zeros(width), np.zeros(n)
    d[SIGNS] = 1.0
    for at in range(used):
        total, signs_of = 0.0, signs[at]
        for k in range(SIGNS):
            d[k] = float(signs_of[k])
            total += d[k]
        share = 1.0 / (1.0 + total / SIGNS)
        tally(sums, right, width, n, d, share * share, float(sizes[at]))
    matrix = sums.reshape(width, width)
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
