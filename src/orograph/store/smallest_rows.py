"""What encoder and decoder of *smallest* share: the order of samples, and their assumed surroundings (docs/codec.md).

Sixteen rows are decoded side by side, each three samples behind the one above it, so that every sample that a
prediction needs is already known. When a row ends, its lane continues with the sixteenth row after it.
"""

from __future__ import annotations

from orograph._lanes import LANES32, least, most, where
from orograph._lanes32 import float_bits, least_unsigned, shifted_right
from orograph._numba import inlined, kernel, shared
from orograph.store.codec_head import NEIGHBOURS, TOTAL

VERSION = 3
LAG = 3  # samples that a row is behind the one above it
CLASSES = 4  # most classes: of samples, by the parity of row and column
SIGNS = 17  # terms of an activity
WEIGHTS = NEIGHBOURS + 1
GROUPS = 64  # of activity: four per octave
OCTAVE = 7  # bits of the least activity beyond the first group
LOWEST = (127 + OCTAVE - 1) * 4  # quarter octaves below the first group, as the bits of a float count them
BINS = 5  # of the position of a prediction
SETS = 48  # most tables
CAP = 4095  # largest value of a sign
SMALL = 307  # of activity, in 1/256: below this, the bin depends on the fractional part of the prediction
HEADER = 8
CLASS = 2 * NEIGHBOURS + SIGNS  # bytes of a class


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


@kernel
def own_factors(row, weights, shares, own_weights, own_shares):
    """The weights and shares of a row: the first two rows have less above them.

    Args:
        weights, own_weights: (WEIGHTS,) int32, in 1/4096. shares, own_shares: (SIGNS,) int32, in 1/256.
    """
    own_weights[:], own_shares[:] = weights, shares
    if row == 0:
        own_weights[:], own_shares[:] = 0, 0
        own_weights[0], own_weights[1], own_weights[NEIGHBOURS] = 6144, -2048, -4096
        own_shares[12] = own_shares[14] = 128
    elif row == 1:  # (the row above also serves as the one two above)
        own_weights[2] += weights[6]
        own_weights[3] += weights[7]
        own_weights[4] += weights[9]
        own_weights[5] += weights[10]
        own_weights[NEIGHBOURS] += weights[8]
        own_weights[6:NEIGHBOURS] = 0
        own_shares[5], own_shares[8], own_shares[9], own_shares[10] = 0, 0, 0, 0


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
