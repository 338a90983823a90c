"""How the codec *compact* divides the samples of a chunk among tables (``compact_encode``): kernels.

Activities are divided into groups of about equal size; neighbouring groups are merged while that makes the chunk
smaller. Logarithms use plain arithmetic, so the same samples give the same bytes on every machine.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf, linked, shared
from orograph.store.compact_decode import (
    CONTEXTS,
    LEVELS,
    activities,
)

GROUPS = 24  # of activities, before similar ones are merged
TOKENS = 64 + 4 * 26  # bins in which values are counted for this
ENTRY = 3.5  # bits of a symbol in a table, approximately


@shared
def length(value):
    """Bits of a whole number, at least 0: without a branch, for it cannot be foreseen."""
    bits = 0
    for half in (32, 16, 8, 4, 2, 1):
        more = value >= 1 << half
        bits, value = bits + half * more, value >> (half * more)
    return bits + value


@shared
def log2(value):
    """The binary logarithm of a number ≥ 1, to 0.0002, by arithmetic that is the same everywhere."""
    whole = 0
    while value >= 2.0:
        value *= 0.5
        whole += 1
    f = value - 1.0
    return whole + f * (1.43807 + f * (-0.67477 + f * (0.31700 + f * -0.08030)))


SMALL_COUNTS = np.array([0.0] + [count * log2(float(count)) for count in range(1, 4096)])
"""Counts times their logarithms."""


@shared
def _entropy(count):
    """A count times its logarithm."""
    return SMALL_COUNTS[np.uint64(count)] if count < SMALL_COUNTS.size else count * log2(float(count))


@linked
def activity_of(values, shift, found):
    """The activity of every sample, as decoders compute it."""
    rows, size = values.shape
    levels, padded = np.zeros(size, np.int32), np.zeros(size + 4, np.int32)
    for row in range(rows):
        found[row] = levels
        activities(values[row], shift, padded, levels)


@linked
def shift_of(values):
    """By how much activities are shifted: nearly all are below ``LEVELS`` then."""
    low, high, size = 0, 32, values.size
    flat = values.reshape(size)
    while low < high:  # (the fewest bits that all but one in 32 have)
        bits = (low + high) // 2
        limit, larger = np.uint32((1 << bits) - 1), np.int32(0)
        for k in range(size):
            larger += np.int32(flat[k] > limit)
        low, high = (low, bits) if larger <= size // 32 else (bits + 1, high)
    return min(max(low + 3 - 8, 0), 12)


@shared
def token(value):
    """The bin of a value: the value itself, or a quarter of an octave."""
    if value < 64:
        return value
    bits = length(value)
    return 64 + (bits - 7) * 4 + ((value >> (bits - 3)) & 3)


@leaf
def cost_of(counts, one, other, size, share):
    """Bits of the values that one context counts, ``share`` times those of the other included, and of their table.

    Args:
        counts: of each context. size: beyond which they are 0.
    """
    total, bits, kinds = 0, 0.0, 0
    for k in range(size):
        count = counts[one, k] + share * counts[other, k]
        total, kinds = total + count, kinds + (count > 0)
        bits -= _entropy(count)
    return bits + _entropy(total) + 16 + ENTRY * kinds if total else 0.0


@linked
def grouped(levels, group, most):
    """Divide levels of activity into at most ``most`` groups of about equal size; return the number of groups.

    Args:
        levels: samples by level. group: becomes the group of each.
    """
    total, so_far, groups = levels.sum(), 0, 0
    for level in range(levels.size):
        group[level] = groups
        so_far += levels[level]
        if so_far * most >= total * (groups + 1) and groups < most - 1:
            groups = min(so_far * most // max(total, 1), most - 1)
    last, count = -1, 0
    for level in range(levels.size):  # renumber without gaps
        if group[level] != last:
            last = group[level]
            count += 1
        group[level] = count - 1
    return count


@linked
def joined(counts, lengths, groups, bounds, most):
    """Merge neighbouring groups while that costs nothing, or there are more than ``most``; return how many are left.

    Args:
        counts: (groups, n), becomes that of what is left. lengths: (groups,), beyond which all counts are 0, likewise.
        bounds: becomes the first group of each.
    """
    left, costs, joint, at = groups, np.zeros(groups), np.zeros(groups), np.arange(groups)
    for k in range(groups):
        bounds[k] = k
        costs[k] = cost_of(counts, k, k, lengths[k], 0)
    for k in range(groups - 1):
        joint[k] = cost_of(counts, k, k + 1, max(lengths[k], lengths[k + 1]), 1)
    while left > 1:
        best = 0
        for k in range(1, left - 1):
            if joint[k] - costs[k] - costs[k + 1] < joint[best] - costs[best] - costs[best + 1]:
                best = k
        if left <= most and joint[best] >= costs[best] + costs[best + 1]:
            break
        here, behind = at[best], at[best + 1]
        counts[here] += counts[behind]
        costs[best], lengths[here] = joint[best], max(lengths[here], lengths[behind])
        for k in range(best + 1, left - 1):
            at[k], costs[k], bounds[k], joint[k] = at[k + 1], costs[k + 1], bounds[k + 1], joint[k + 1]
        left -= 1
        for k in range(max(best - 1, 0), min(best + 1, left - 1)):
            one, two = at[k], at[k + 1]
            joint[k] = cost_of(counts, one, two, max(lengths[one], lengths[two]), 1)
    for k in range(left):
        counts[k], lengths[k] = counts[at[k]], lengths[at[k]]
    return left


@linked
def divided(values, activity, bounds):
    """Choose the contexts; return their number. ``bounds`` becomes the first level of each, ``activity`` contexts."""
    size = activity.size
    flat, of = activity.reshape(size), values.reshape(size)
    levels, group = np.zeros(LEVELS, np.int64), np.empty(LEVELS, np.int64)
    for k in range(size):
        levels[np.uint64(flat[k])] += 1
    groups = grouped(levels, group, GROUPS)
    counts, firsts = np.zeros((groups, TOKENS), np.int64), np.empty(groups, np.int64)
    every = counts.reshape(groups * TOKENS)
    for k in range(size):
        every[np.uint64(group[np.uint64(flat[k])] * TOKENS + token(np.int64(of[k])))] += 1
    contexts = joined(counts, np.full(groups, TOKENS), groups, firsts, CONTEXTS)
    context = np.empty(LEVELS, np.int32)
    now = 0
    for level in range(LEVELS):
        while now + 1 < contexts and group[level] >= firsts[now + 1]:
            now += 1
            bounds[now] = level
        context[level] = now
    for k in range(size):
        flat[k] = context[np.uint64(flat[k])]
    return contexts
