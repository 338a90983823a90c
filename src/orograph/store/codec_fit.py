"""What the encoders of *compact* and *smallest* fit with: sums of least squares, vectors of eight at a time.

Sums are added up in the order of the samples, whatever the processor, so that the same samples are the same bytes.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES, load, store
from orograph._numba import inlined, kernel
from orograph.store.codec_head import MISSING


@inlined
def differences(far, near, line, j, d):
    """What the eleven samples around the one at ``j`` of ``line`` differ from the one above it by; whether all are
    there.

    Args:
        far, near: the two rows above. d: (11 or more,) float64, becomes the differences, in the order of the weights.
    """
    n = near[np.uint64(j)]
    a, b = line[np.uint64(j - 1)], line[np.uint64(j - 2)]
    d[0], d[1] = float(a) - n, float(b) - n
    lowest = min(min(n, a), b)
    for k in range(2):
        a, b = near[np.uint64(j - 2 + k)], near[np.uint64(j + 1 + k)]
        d[2 + k], d[4 + k] = float(a) - n, float(b) - n
        lowest = min(min(lowest, a), b)
    for k in range(5):
        a = far[np.uint64(j - 2 + k)]
        d[6 + k] = float(a) - n
        lowest = min(lowest, a)
    return lowest != MISSING


@inlined
def tally(matrix, right, stride, count, d, share, sought):
    """Add a sample to the normal equations: to what lies at and below the diagonal (and to some of what is above it).

    Args:
        matrix: flat float64, rows of ``stride``, a multiple of eight. right: (stride,) float64.
        d: (stride,) float64, of which ``count`` are those of the sample, and the others 0.
    """
    for at in range(0, count, LANES):
        store(right, at, load(right, at) + load(d, at) * share * sought)
    for k in range(count):
        part = share * d[np.uint64(k)]
        for at in range(0, k + 1, LANES):
            here = k * stride + at
            store(matrix, here, load(matrix, here) + load(d, at) * part)


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
