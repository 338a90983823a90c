"""How the codec *compact* divides the samples of a chunk among tables (``compact_encode``): kernels.

Activities are put in groups of about as many samples, and neighbours among these are joined while that makes the chunk
smaller. Logarithms are made of plain arithmetic, so that the same samples are the same bytes on every machine.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel, shared
from orograph.store.compact_decode import CONTEXTS, LEVELS, activities

GROUPS = 24  # of activities, before those that are alike are joined
TOKENS = 64 + 4 * 26  # what values are counted as there
ENTRY = 3.5  # bits of a symbol in a table, about


@shared
def length(value):
    """Bits of a whole number."""
    bits = 0
    while value:
        bits += 1
        value >>= 1
    return bits


@shared
def _log2(value):
    """The binary logarithm of a number of at least 1, to 0.01: by arithmetic that is the same everywhere."""
    whole = 0
    while value >= 2.0:
        value *= 0.5
        whole += 1
    return whole + (value - 1.0) * (1.3465 - 0.3465 * (value - 1.0))


@kernel
def activity_of(values, shift, found):
    """The activity of every sample, as decoders find it."""
    rows, size = values.shape
    levels, padded = np.zeros(size, np.int32), np.zeros(size + 4, np.int32)
    for row in range(rows):
        found[row] = levels
        activities(values[row], shift, padded, levels)


@kernel
def shift_of(values):
    """By how much activities are shifted: nearly all are below ``LEVELS`` then."""
    sizes, size = np.zeros(34, np.int64), values.size
    flat = values.reshape(size)
    for k in range(size):
        sizes[length(np.int64(flat[k]))] += 1
    bits, seen = 0, sizes[0]
    while seen < size - size // 32:
        bits += 1
        seen += sizes[bits]
    return min(max(bits + 3 - 8, 0), 12)


@shared
def _token(value):
    """What a value is counted as: itself, or a quarter of an octave."""
    if value < 64:
        return value
    bits = length(value)
    return 64 + (bits - 7) * 4 + ((value >> (bits - 3)) & 3)


@kernel
def _cost(counts):
    """Bits of values so counted, table included."""
    total, bits, kinds = 0, 0.0, 0
    for k in range(counts.size):
        if counts[k]:
            total += counts[k]
            bits -= counts[k] * _log2(float(counts[k]))
            kinds += 1
    return bits + total * _log2(float(total)) + 16 + ENTRY * kinds if total else 0.0


@kernel
def _grouped(levels, group):
    """Put levels of activity into at most ``GROUPS`` of about as many samples; how many there are."""
    total, so_far, groups = levels.sum(), 0, 0
    for level in range(LEVELS):
        group[level] = groups
        so_far += levels[level]
        if so_far * GROUPS >= total * (groups + 1) and groups < GROUPS - 1:
            groups = min(so_far * GROUPS // max(total, 1), GROUPS - 1)
    last, count = -1, 0
    for level in range(LEVELS):  # without gaps
        if group[level] != last:
            last = group[level]
            count += 1
        group[level] = count - 1
    return count


@kernel
def _joined(counts, groups, bounds):
    """Join neighbours among groups while that costs nothing, or there are too many; how many are left.

    Args:
        counts: (groups, TOKENS). bounds: becomes the first group of each.
    """
    left, costs, joint = groups, np.zeros(groups), np.zeros(groups)
    for k in range(groups):
        bounds[k] = k
        costs[k] = _cost(counts[k])
    for k in range(groups - 1):
        joint[k] = _cost(counts[k] + counts[k + 1])
    while left > 1:
        best = 0
        for k in range(1, left - 1):
            if joint[k] - costs[k] - costs[k + 1] < joint[best] - costs[best] - costs[best + 1]:
                best = k
        if left <= CONTEXTS and joint[best] >= costs[best] + costs[best + 1]:
            break
        counts[best] += counts[best + 1]
        costs[best] = joint[best]
        for k in range(best + 1, left - 1):
            counts[k] = counts[k + 1]
            costs[k], bounds[k], joint[k] = costs[k + 1], bounds[k + 1], joint[k + 1]
        left -= 1
        if best > 0:
            joint[best - 1] = _cost(counts[best - 1] + counts[best])
        if best < left - 1:
            joint[best] = _cost(counts[best] + counts[best + 1])
    return left


@kernel
def divided(values, activity, bounds):
    """Decide the contexts, and how many; ``bounds`` becomes the first level of each, ``activity`` contexts."""
    size = activity.size
    flat, of = activity.reshape(size), values.reshape(size)
    levels, group = np.zeros(LEVELS, np.int64), np.empty(LEVELS, np.int64)
    for k in range(size):
        levels[flat[k]] += 1
    groups = _grouped(levels, group)
    counts, joined = np.zeros((groups, TOKENS), np.int64), np.empty(groups, np.int64)
    for k in range(size):
        counts[group[flat[k]], _token(np.int64(of[k]))] += 1
    contexts = _joined(counts, groups, joined)
    context = np.empty(LEVELS, np.int32)
    now = 0
    for level in range(LEVELS):
        while now + 1 < contexts and group[level] >= joined[now + 1]:
            now += 1
            bounds[now] = level
        context[level] = now
    for k in range(size):
        flat[k] = context[flat[k]]
    return contexts
