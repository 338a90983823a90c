"""Least squares for the encoders of *compact* and *smallest*, with samples of a row side by side.

Sums are added in an order that does not depend on the processor, so that equal samples give equal bytes.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES, fused, load, store
from orograph._numba import kernel, linked
from orograph.store.codec_head import NEIGHBOURS, TOTAL

FOUR = 4  # products that are added at once
AROUND = NEIGHBOURS + 1  # features of a prediction: differences of the samples around from N, and that of the sample


@linked
def room_of(count):
    """An array, not cleared, at an address from which vectors of eight load fastest."""
    room = np.empty(count + LANES)
    at = -(room.ctypes.data // 8) % LANES
    return room[at : at + count]


@linked
def cleared(count):
    """The same, but zeros."""
    room = room_of(count)
    room[:] = 0.0
    return room


@linked
def features_of(count, samples):
    """Room for ``count`` features (a multiple of ``FOUR``) of so many samples: zeros, a row for each."""
    width = -(-max(samples, 1) // LANES) * LANES
    return cleared(count * width).reshape(count, width)


@linked
def sums_of(count):
    """Room for the sums of all products of two of ``count`` features, eight partial ones each."""
    return cleared(count * count * LANES)


@kernel
def add_products(features, shares, scratch, sums):
    """Add up the products of features.

    Args:
        features: from ``features_of``. shares: (width,) float64, what each sample counts. scratch: (2 width,) float64.
        sums: from ``sums_of``; at and below the diagonal they are right.
    """
    count, width = features.shape
    flat = features.reshape(count * width)
    for k in range(0, count, 2):  # (four sums at once would wait for each other)
        for i in range(0, width, LANES):
            share = load(shares, i)
            store(scratch, i, load(flat, k * width + i) * share)
            store(scratch, width + i, load(flat, (k + 1) * width + i) * share)
        for m in range(0, k + 1, FOUR):
            here, next_, at = (k * count + m) * LANES, ((k + 1) * count + m) * LANES, m * width
            s0, s1 = load(sums, here), load(sums, here + LANES)
            s2, s3 = load(sums, here + 2 * LANES), load(sums, here + 3 * LANES)
            t0, t1 = load(sums, next_), load(sums, next_ + LANES)
            t2, t3 = load(sums, next_ + 2 * LANES), load(sums, next_ + 3 * LANES)
            for i in range(0, width, LANES):
                one, other = load(scratch, i), load(scratch, width + i)
                f0, f1 = load(flat, at + i), load(flat, at + width + i)
                f2, f3 = load(flat, at + 2 * width + i), load(flat, at + 3 * width + i)
                s0, s1, s2, s3 = fused(one, f0, s0), fused(one, f1, s1), fused(one, f2, s2), fused(one, f3, s3)
                t0, t1, t2, t3 = fused(other, f0, t0), fused(other, f1, t1), fused(other, f2, t2), fused(other, f3, t3)
            store(sums, here, s0)
            store(sums, here + LANES, s1)
            store(sums, here + 2 * LANES, s2)
            store(sums, here + 3 * LANES, s3)
            store(sums, next_, t0)
            store(sums, next_ + LANES, t1)
            store(sums, next_ + 2 * LANES, t2)
            store(sums, next_ + 3 * LANES, t3)


@linked
def totals(sums, count):
    """The sums of all products, (count, count) float64."""
    found = np.empty((count, count))
    for k in range(count):
        for m in range(k + 1):
            total, at = 0.0, (k * count + m) * LANES
            for i in range(LANES):
                total += sums[at + i]
            found[k, m] = found[m, k] = total
    return found


@linked
def _put_differences(source, near, count, out):
    """Differences of ``count`` samples from those of the row above."""
    for i in range(count):
        out[i] = float(source[i]) - float(near[i])


@linked
def put_surroundings(far, near, line, at, count, features):
    """The features of a row's samples.

    They are the differences of the surrounding samples from the one above, in the order of the weights, and that of the
    sample itself.

    Args:
        far, near: the two rows above. at: where the first sample is, and those beside it: WW, W, itself, E, EE.
        count: how many samples. features: (``AROUND``, …).
    """
    ww, w, own, e, ee = at
    above = near[own:]
    _put_differences(line[w:], above, count, features[0])
    _put_differences(line[ww:], above, count, features[1])
    for k, place in enumerate((ww, w, e, ee)):
        _put_differences(near[place:], above, count, features[2 + k])
    for k, place in enumerate(at):
        _put_differences(far[place:], above, count, features[6 + k])
    _put_differences(line[own:], above, count, features[NEIGHBOURS])


@linked
def put_shares(features, counted, shares):
    """The weights of samples in the fit, so that a cliff does not outvote the plain. Return how many samples count.

    Args:
        counted: (width,) int32, 0 for samples that do not.
    """
    w, nw, ne, n = features[0], features[3], features[4], features[8]
    used = 0
    for i in range(shares.size):
        rough = abs(w[i]) + abs(nw[i]) + abs(ne[i]) + abs(n[i])
        shares[i] = counted[i] / (2.0 + rough)
        used += counted[i]
    return used


@linked
def weights_of(sums, ridge, others):
    """The weights of a prediction, (NEIGHBOURS,) float64, drawn towards others.

    Args:
        ridge: how strongly, relative to the sums.
    """
    every = totals(sums, AROUND)
    matrix, right = every[:NEIGHBOURS, :NEIGHBOURS].copy(), every[NEIGHBOURS, :NEIGHBOURS].copy()
    trace = 0.0
    for k in range(NEIGHBOURS):
        trace += matrix[k, k]
    ridge = trace * ridge + 1e-3
    for k in range(NEIGHBOURS):
        matrix[k, k] += ridge
        right[k] += ridge * others[k]
    solved(matrix, right)
    return right


@linked
def plane():
    """The weights of W + N - NW."""
    weights = np.zeros(NEIGHBOURS)
    weights[0], weights[3] = 1.0, -1.0
    return weights


@linked
def rounded_weights(real, weights):
    """Weights in 1/4096, as they are written."""
    for k in range(NEIGHBOURS):
        weights[k] = np.int64(np.floor(min(max(real[k], -7.9), 7.9) * TOTAL + 0.5))


@linked
def solved(matrix, right):
    """Solve a positive definite system, in place."""
    n = right.size
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
