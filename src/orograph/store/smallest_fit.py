"""What the encoder of *smallest* fits to a chunk: the weights of predictions, and the shares of signs in activities.

Both are least squares over some of the chunk's rows, in plain arithmetic, so that the same samples give the same bytes
everywhere. First the whole chunk has one set of weights. Then its samples are divided by three tests, at the medians of
what they test, and each of the eight parts gets a set, if that makes residuals small enough.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES, LANES32
from orograph._lanes32 import load32, store32
from orograph._numba import linked
from orograph.store.codec_fit import (
    AROUND,
    FOUR,
    add_products,
    plane,
    put_shares,
    put_surroundings,
    room_of,
    sums_of,
    totals,
    weights_of,
)
from orograph.store.codec_head import BITS, NEIGHBOURS
from orograph.store.compact_contexts import log2
from orograph.store.smallest_look import count_of, miss_row, parities_of, places_of, rows_of, signs_of
from orograph.store.smallest_rows import (
    CAP,
    CHOICES,
    COARSE_SHARE,
    COARSE_WEIGHT,
    SHARE_BITS,
    SIGNS,
    TESTS,
    WEIGHT_BITS,
)

SAMPLED = 4096  # samples of a class that are used, approximately
MORE = 2  # times as many are used for the weights of sets
TESTED = (3, 4, 8)  # what tests look at, as features of a prediction: NW, NE and NN
JOINT = 0.1  # how much samples of all sets count for the shares of one, against its own
LEAST_GAIN = 0.045  # bits a sample by which weights of sets must be better
LEAST_CHUNK = 1 << 14  # samples of a chunk with tests
WIDE = 256  # samples of a block of features
SWEEPS, CLOSE = 100, 1e-3  # rounds in which shares are solved, and a change of them that does not count
LEAST_SIZE = 0.5  # of a residual that is expected, for the weights of samples
TERMS = -(-(SIGNS + 2) // FOUR) * FOUR  # the signs, a constant, the size of the residual, and zeros


@linked
def _blocks_of(blocks, count, samples):
    """Room for ``count`` features in blocks of so many samples, in whole lanes: (blocks, count, samples) float64, not
    cleared."""
    width = -(-max(samples, 1) // LANES) * LANES
    return room_of(blocks * count * width).reshape(blocks, count, width)


@linked
def _divided_blocks(samples):
    """How many blocks of how many samples, in whole lanes, hold so many: at most ``WIDE`` in each, evenly."""
    blocks = -(-samples // WIDE)
    return blocks, -(-samples // (max(blocks, 1) * LANES)) * LANES


@linked
def _surroundings(lines, row0, parity, step):
    """What a prediction is fitted to, a block for each row: (features (blocks, AROUND, n); which samples count,
    (blocks, n) int32).

    Args:
        row0, parity, step: the first row, the parity of columns, and how far rows are apart.
    """
    rows, skip = range(row0, lines.shape[0], step), 1 if lines.split else 2
    ww, w, own, e, ee = places_of(lines, parity)
    at, pitch = (ww + skip, w + skip, own + skip, e + skip, ee + skip), lines.pitch
    every, marks = 2 if lines.split else 1, lines.marks  # (samples less than two from an end do not count)
    begin, end = parity + every * skip, lines.shape[1] - 2
    n = len(range(begin, end, every))
    features = _blocks_of(len(rows), AROUND, count_of(lines, parity) - skip)
    counted = np.zeros((features.shape[0], features.shape[2]), np.int32)
    features[:, :, n:] = 0.0
    for block in range(len(rows)):
        row = row0 + block * step
        for i in range(n):
            counted[block, i] = not (marks.size and marks[row, begin + i * every])
        around = lines.samples[row * pitch : (row + 3) * pitch].reshape(3, pitch)
        put_surroundings(around[0], around[1], around[2], at, n, features[block])
    return features, counted


@linked
def _missed(features, weights, off):
    """By how much each sample of a block is off its prediction, and half a step."""
    for i in range(off.size):
        off[i] = features[NEIGHBOURS, i]
    for k in range(NEIGHBOURS):
        own, weight = features[k], weights[k]
        for i in range(off.size):
            off[i] -= weight * own[i]
    for i in range(off.size):
        off[i] = 0.5 + abs(off[i])


@linked
def _fit(features, counted, others, ridge, steps, weights):
    """Fit weights in some rounds. What is predicted badly must not outvote what is predicted well: in each, samples
    count by how far they were off. A round goes ``steps`` times as far as its solution, for they converge slowly.

    Args:
        features, counted: from ``_surroundings``. others: that weights are drawn towards; by ``ridge`` (``weights_of``)
            for one sample, and less for more.
        weights: of an earlier round, and whether there are any; become new.
    """
    width = features.shape[2]
    shares, off, scratch = np.empty(width), np.empty(width), np.empty(2 * width)
    for step in steps:
        used, sums = 0, sums_of(AROUND)
        for block in range(features.shape[0]):
            used += put_shares(features[block], counted[block], shares)
            if weights[NEIGHBOURS]:
                _missed(features[block], weights, off)
                for i in range(width):
                    shares[i] = np.sqrt(shares[i] / off[i]) / off[i]
            add_products(features[block], shares, scratch, sums)
        found = weights_of(sums, 1e-6 + ridge / max(used, 1), others)
        for k in range(NEIGHBOURS):
            weights[k] += step * (found[k] - weights[k])
        weights[NEIGHBOURS] = 1.0


@linked
def fitted_weights(lines, row0, parity):
    """Fit the weights of a class: of all columns of a parity in every row from the ``row0``-th on, or in every other
    one if the lines are split.

    Returns:
        the weights (NEIGHBOURS + 1,) float64, of which the last is 1, and what they are fitted to (``_surroundings``).
    """
    (rows, cols), spread = lines.shape, 2 if lines.split else 1
    step = spread * max(rows * cols // (spread * SAMPLED), 1)  # (classes of a nested chunk share the samples)
    features, counted = _surroundings(lines, row0 if row0 >= 2 else row0 + 2, parity, step)
    weights = np.zeros(NEIGHBOURS + 1)
    _fit(features, counted, plane(), 0.1, np.ones(2), weights)
    return weights, features, counted


@linked
def _put_limits(features, counted, limits):
    """Find the limits of tests: the medians of what they test."""
    counts, used = np.zeros((TESTS, CAP + 1), np.int64), counted.sum()
    for block in range(counted.shape[0]):
        for k in range(TESTS):
            own, into = features[block, TESTED[k]], counts[k]
            for i in range(own.size):
                into[np.uint64(min(abs(own[i]), CAP))] += counted[block, i]
    for k in range(TESTS):
        limits[k], below = 0, counts[k, 0]
        while limits[k] < CAP and 2 * below < used:
            limits[k] += 1
            below += counts[k, limits[k]]


@linked
def parted(which, count, sets, order):
    """Order samples by their set.

    Args:
        which: the set of each of ``count`` samples. order: becomes their numbers.

    Returns:
        where the samples of each set begin in ``order``, and where the last ones end.
    """
    begins = np.zeros(sets + 2, np.int64)
    for i in range(count):
        begins[which[i] + 2] += 1
    for k in range(sets):
        begins[k + 2] += begins[k + 1]
    for i in range(count):
        order[begins[which[i] + 1]] = i
        begins[which[i] + 1] += 1
    return begins[: sets + 1]


@linked
def _divided(features, counted, limits):
    """The features of the samples of each set, and which of them count, in lists of what ``_surroundings`` gives."""
    (blocks, width), count = counted.shape, counted.size
    which, order = np.zeros((blocks, width), np.int64), np.empty(count, np.int64)
    for block in range(blocks):
        for k in range(TESTS):
            own, limit = features[block, TESTED[k]], float(limits[k])
            for i in range(width):
                which[block, i] += np.int64(abs(own[i]) > limit) << k
    begins = parted(which.reshape(count), count, CHOICES, order)
    places, flat, flags = np.empty(count, np.int64), features.reshape(features.size), counted.reshape(count)
    for block in range(blocks):  # (where the first feature of each sample is)
        for i in range(width):
            places[block * width + i] = block * AROUND * width + i
    sizes = [_divided_blocks(begins[k + 1] - begins[k]) for k in range(CHOICES)]
    parts = [_blocks_of(sizes[k][0], AROUND, sizes[k][1]) for k in range(CHOICES)]
    marks = [np.zeros(sizes[k], np.int32) for k in range(CHOICES)]
    for k in range(CHOICES):
        for block in range(sizes[k][0]):
            begin = begins[k] + block * sizes[k][1]
            end = min(begin + sizes[k][1], begins[k + 1])
            some, own, mark = np.empty(end - begin, np.int64), order[begin:end], marks[k][block]
            for i in range(own.size):
                some[i], mark[i] = places[np.uint64(own[i])], flags[np.uint64(own[i])]
            for m in range(AROUND):
                target, offset = parts[k][block, m], m * width
                for i in range(some.size):
                    target[i] = flat[np.uint64(some[i] + offset)]
                target[some.size :] = 0.0
    return parts, marks


@linked
def _gain(features, counted, weights, whole):
    """The bits that samples take less than with the weights of the whole chunk, approximately."""
    width, bits, ratio = features.shape[2], 0.0, 1.0
    off, before = np.empty(width), np.empty(width)
    for block in range(features.shape[0]):
        _missed(features[block], weights, off)
        _missed(features[block], whole, before)
        for i in range(width):
            ratio *= before[i] / off[i] if counted[block, i] else 1.0
            if i % LANES == LANES - 1:
                bits += log2(ratio) if ratio >= 1.0 else -log2(1.0 / ratio)
                ratio = 1.0
    return bits


@linked
def fitted_sets(lines, whole, features, counted, limits, weights):
    """Fit weights for each outcome of the tests, if that pays; return whether it does.

    Args:
        whole, features, counted: from ``fitted_weights``, of the whole chunk.
        limits: (TESTS,) int32, become those of the tests.
        weights: (CHOICES, NEIGHBOURS) int64, become those of the sets, in 1/4096.
    """
    rows, cols = lines.shape
    if rows * cols < LEAST_CHUNK:
        return False
    sets, gain = np.zeros((CHOICES, NEIGHBOURS + 1)), 0.0
    _put_limits(features, counted, limits)
    parts, marks = _divided(features, counted, limits)
    for k in range(CHOICES):
        sets[k] = whole
        _fit(parts[k], marks[k], whole, 0.01, np.array([1.5]), sets[k])
        gain += _gain(parts[k], marks[k], sets[k], whole)
    if gain < LEAST_GAIN * counted.sum():
        return False
    for k in range(CHOICES):
        _fit(parts[k], marks[k], whole, 0.01, np.array([2.0]), sets[k])
    features, counted = _surroundings(lines, 2, 0, max(rows * cols // (MORE * SAMPLED), 1))
    parts, marks = _divided(features, counted, limits)
    most, unit = float((1 << (WEIGHT_BITS - 1)) - 1), float(1 << (BITS - COARSE_WEIGHT))
    for k in range(CHOICES):
        _fit(parts[k], marks[k], whole, 0.01, np.array([1.5, 1.0]), sets[k])
        for m in range(NEIGHBOURS):
            weights[k, m] = np.int64(np.floor(min(max(sets[k, m] * unit, -most), most) + 0.5)) << COARSE_WEIGHT
    return True


@linked
def _note_signs(lines, row, parity, begin, noted, which):
    """Put the signs of the samples of a parity of a row and, behind them, the sizes of residuals in (SIGNS + 1, …)
    int32, from ``begin`` on; likewise their sets, or -1 where they are missing. Return where they end."""
    rows, at, count = rows_of(lines, row), places_of(lines, parity), count_of(lines, parity)
    here, width, every = parity * (lines.pitch // 2), noted.shape[1], 2 if lines.split else 1
    flat, marks, entries = noted.reshape(noted.size), lines.marks, lines.entries
    for t in range(0, count, LANES32):
        signs = signs_of(lines, rows, at, load32(lines.sums, here + t), t)
        for k in range(SIGNS):
            store32(flat, k * width + begin + t, signs[k])
        store32(flat, SIGNS * width + begin + t, load32(lines.sizes, rows[5] + at[2] + t))
    for i in range(count):
        missing = marks.size and marks[row, parity + every * i]
        which[begin + i] = -1 if missing else entries[here + i]
    return begin + count


@linked
def _noted(lines, rules):
    """What shares are fitted to, of some rows: signs and sizes of residuals, and sets, as ``_note_signs`` has them."""
    rows, cols = lines.shape
    samples = SAMPLED * (2 if lines.split else 1) + (SAMPLED // 4 if rules.tested else 0)
    step, n = 2 * max(rows * cols // samples, 2), 0
    noted = np.empty((SIGNS + 1, 2 * (rows // step + 1) * cols + LANES32), np.int32)
    which = np.empty(noted.shape[1], np.int64)
    for row in range(rows):
        if (row + 2) % step < 4:  # (two rows of each ``step``; they need the sizes of the two before them)
            miss_row(lines, row, rules)
            first, end = parities_of(lines, row)
            for parity in range(first, end if row > 1 and row % step < 2 else first):
                n = _note_signs(lines, row, parity, n, noted, which)
    return noted, which[:n]


@linked
def _signs_of(noted, own):
    """The features of shares, in blocks: signs, a constant and the sizes of residuals, of some samples."""
    blocks, wide = _divided_blocks(own.size)
    features = _blocks_of(blocks, TERMS, wide)
    features[:, SIGNS + 2 :], features[blocks - 1 :] = 0.0, 0.0
    for block in range(blocks):
        some = own[block * wide : (block + 1) * wide]
        for k in range(SIGNS + 1):
            to, source = features[block, k if k < SIGNS else SIGNS + 1], noted[k]
            for i in range(some.size):
                to[i] = float(source[np.uint64(some[i])])
        features[block, SIGNS, : some.size] = 1.0
    return features


@linked
def _products(features, expected):
    """The sums of all products of a set's features. What is expected to be large must not outvote what is expected to
    be small. Args: expected: (SIGNS + 1,), the share of each sign in the size of a residual, and a constant."""
    wide = features.shape[2]
    weighed, scratch, sums = np.empty(wide), np.empty(2 * wide), sums_of(TERMS)
    for block in range(features.shape[0]):
        weighed[:] = LEAST_SIZE + expected[SIGNS]
        for k in range(SIGNS):
            signs, each = features[block, k], expected[k]
            for i in range(wide if each > 0.0 else 0):
                weighed[i] += each * signs[i]
        for i in range(wide):  # (the constant is 0 where there is no sample)
            weighed[i] = features[block, SIGNS, i] / (weighed[i] * weighed[i])
        add_products(features[block], weighed, scratch, sums)
    return totals(sums, TERMS)


@linked
def fitted_shares(lines, rules, shares):
    """Fit each sign's share in the size of residuals: least squares without negative shares, over some rows.

    Args:
        rules: with weights. shares: become (CHOICES, SIGNS) int64, in 1/256.
    """
    noted, which = _noted(lines, rules)
    order, found = np.empty(which.size, np.int64), np.full((CHOICES, SIGNS + 1), 1.0 / SIGNS)
    which += 1
    begins = parted(which, which.size, CHOICES + 1, order)
    features = [_signs_of(noted, order[begins[k + 1] : begins[k + 2]]) for k in range(CHOICES)]
    products = np.zeros((CHOICES, TERMS, TERMS))
    for _ in range(2):
        for k in range(CHOICES):
            products[k] = _products(features[k], found[k])
        every = products.sum(axis=0) * (JOINT if rules.tested else 0.0)
        for k in range(CHOICES):
            _solve_shares(products[k] + every, found[k])
    coarse, most = (COARSE_SHARE, (1 << SHARE_BITS) - 1) if rules.tested else (0, 255)
    for k in range(CHOICES):
        for i in range(SIGNS):
            share = np.floor(min(found[k, i] * (256 >> coarse), float(most)) + 0.5)
            shares[k, i] = np.int64(share) << coarse


@linked
def _solve_shares(matrix, found):
    """Shares that are not negative, and a constant, from the sums of all products."""
    found[:], off = 0.0, matrix[SIGNS + 1].copy()
    for _ in range(SWEEPS):
        most = 0.0
        for k in range(SIGNS + 1):
            change = max(off[k] / (matrix[k, k] + 1e-3), -found[k])
            if change != 0.0:
                found[k] += change
                most = max(most, abs(change))
                for m in range(off.size):
                    off[m] -= change * matrix[k, m]
        if most < CLOSE:
            break
