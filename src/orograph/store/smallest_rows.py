"""What encoder and decoder of *smallest* share: the order of samples, and their assumed surroundings (docs/codec.md).

Sixteen rows are decoded side by side, each three samples behind the one above it, so that every sample that a
prediction needs is already known. When a row ends, its lane continues with the sixteenth row after it.
"""

from __future__ import annotations

import numpy as np

from orograph._lanes import LANES32, least, most, where
from orograph._lanes32 import float_bits, least_unsigned, shifted_right
from orograph._numba import inlined, linked, shared
from orograph.store.codec_head import NEIGHBOURS, TOTAL

VERSION = 4
LAG = 3  # samples that a row is behind the one above it
CLASSES = 4  # most classes: of samples, by the parity of row and column
SIGNS = 17  # terms of an activity
WEIGHTS = NEIGHBOURS + 1
TESTS = 3  # of a sample's surroundings, which choose its set of weights and shares
CHOICES = 1 << TESTS  # most sets: one for each outcome, or one for each class
ENTRIES = 16  # of each weight and share, to choose from: those of the sets, and of the first two rows
TOP, SECOND = 13, 14  # where the latter are
GROUPS = 64  # of activity: four per octave
OCTAVE = 7  # bits of the least activity beyond the first group
LOWEST = (127 + OCTAVE - 1) * 4  # quarter octaves below the first group, as the bits of a float count them
BINS = 5  # of the position of a prediction
SETS = 48  # most tables
CAP = 4095  # largest value of a sign
SMALL = 307  # of activity, in 1/256: below this, the bin depends on the fractional part of the prediction
HEADER = 12
SET = 2 * NEIGHBOURS + SIGNS  # bytes of a set
SHORT_SET = 28  # bytes of a set where tests choose it: 11 bits for a weight, 6 for a share
WEIGHT_BITS, SHARE_BITS = 11, 6
COARSE_WEIGHT, COARSE_SHARE = 4, 2  # bits of weights and shares that are not written there


@shared
def period_of(cols):
    """Steps from the first sample of a row to that of the sixteenth after it: an even number."""
    return max((cols + 5) // 2 * 2, LAG * LANES32)


@shared
def steps_of(rows, cols):
    """The number of steps that decode a chunk; each takes one sample from every active row."""
    return -(-rows // LANES32) * period_of(cols) + LAG * (LANES32 - 1)


@shared
def begin_of(row, cols):
    """The step of a row's first sample."""
    return row // LANES32 * period_of(cols) + row % LANES32 * LAG


@shared
def class_of(row, col, classes):
    """The class of a sample."""
    return 2 * (row & 1) + (col & 1) if classes == CLASSES else 0


@shared
def entry_of(row, set_):
    """Which entry of the choices the samples of a row have, by their set."""
    return set_ if row > 1 else SECOND + (set_ & 1) if row else TOP


@linked
def put_choices(first, sets, weights, shares, choices):
    """Put the weights and shares of sets where they are chosen from.

    Args:
        first, sets: the first set, and one more than the last. weights: (CHOICES, WEIGHTS) int32, in 1/4096.
        shares: (CHOICES, SIGNS) int32, in 1/256.
        choices: flat, becomes ``ENTRIES`` of each weight and, after these, of each share.
    """
    put_one(choices, TOP, np.zeros(WEIGHTS, np.int32), np.zeros(SIGNS, np.int32))
    choices[TOP], choices[ENTRIES + TOP], choices[NEIGHBOURS * ENTRIES + TOP] = 6144, -2048, -4096
    choices[(WEIGHTS + 12) * ENTRIES + TOP] = choices[(WEIGHTS + 14) * ENTRIES + TOP] = 128
    for k in range(first, sets):
        put_one(choices, k, weights[k], shares[k])
    for k in range(first, min(sets, CLASSES) if first else 1):
        own_weights, own_shares = weights[k].copy(), shares[k].copy()
        own_weights[2] += own_weights[6]  # (the row above also serves as the one two above)
        own_weights[3] += own_weights[7]
        own_weights[4] += own_weights[9]
        own_weights[5] += own_weights[10]
        own_weights[NEIGHBOURS] += own_weights[8]
        own_weights[6:NEIGHBOURS] = 0
        own_shares[5], own_shares[8], own_shares[9], own_shares[10] = 0, 0, 0, 0
        if k != 1:  # (that of even rows)
            put_one(choices, SECOND + (k & 1), own_weights, own_shares)


@linked
def put_one(choices, entry, weights, shares):
    """Put one set of weights and shares in its place."""
    for m in range(WEIGHTS):
        choices[m * ENTRIES + entry] = weights[m]
    for m in range(SIGNS):
        choices[(WEIGHTS + m) * ENTRIES + entry] = shares[m]


@inlined
def outcome(across, ahead, down, limits):
    """The outcome of the tests of a sample, 0 to 7: whether the differences of N from NW, from NE and from NN are
    beyond their limits: lanes.

    Args:
        across, ahead, down: these differences. limits: of each, lanes or numbers.
    """
    return where(across > limits[0], 1, 0) + where(ahead > limits[1], 2, 0) + where(down > limits[2], 4, 0)


@inlined
def size_of(difference):
    """The absolute values of differences, at most ``CAP``: lanes of int32."""
    return least_unsigned(most(difference, 0 - difference), CAP)


@inlined
def cell_of(active, t):
    """The cells within a class, from activities and weighted sums; -1 where the sign is reversed, else 0: lanes."""
    beyond = (t & (TOTAL - 1)) - TOTAL // 2
    lean = t - TOTAL // 2
    far = shifted_right(most(lean, 0 - lean), 4)
    steps = where(far + far > active, 1, 0) + where(far > active, 1, 0)
    steps += where(far > active + active, 1, 0) + where(far > (active << 2), 1, 0)
    small = active < SMALL
    bin_ = where(small, least(most(beyond, 0 - beyond) >> 9, 3), steps)
    group = least(most((float_bits(active) >> 21) - LOWEST, 0), GROUPS - 1)
    return group * BINS + bin_, where(small, beyond, lean) >> 31
