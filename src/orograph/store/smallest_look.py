"""What the encoder of *smallest* computes from samples: residuals, activities, cells (``smallest_encode``).

All samples are known, so whole rows are computed at once, by plain loops that LLVM turns into vector instructions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, shared
from orograph.store.codec_head import MISSING, TOTAL
from orograph.store.smallest_rows import (
    BINS,
    CAP,
    CLASSES,
    GROUPS,
    LOWEST,
    SIGNS,
    SMALL,
    WEIGHTS,
    class_of,
    own_factors,
)

Row = NDArray[np.int32]


class Rows(NamedTuple):
    """A row of samples (n + 4,) and the two above it, and the sizes of their residuals, at most ``CAP``."""

    far: Row
    near: Row
    line: Row
    further: Row
    above: Row
    left: Row


class Found(NamedTuple):
    """For each sample of a row (n,): its weighted sum, residual, activity, group, bin and value."""

    sums: Row
    residuals: Row
    active: Row
    groups: Row
    bins: Row
    values: Row


@shared
def size_of(difference):
    """The absolute value of a difference of two samples, which wraps, clamped to 0 … ``CAP``."""
    wrapped = np.int32(difference)
    return np.int32(min(np.uint32(wrapped if wrapped >= 0 else -wrapped), np.uint32(CAP)))


@kernel
def surrounded(numbers, classes, first, whole, skips):
    """Copy a chunk into the surroundings that decoders assume, and mark the samples that are not coded.

    Args:
        whole: (rows + 2, cols + 4) int32. skips: (rows, cols) uint8, 1 where a sample is missing or holds nothing.
    """
    rows, cols = numbers.shape
    whole[:2] = first
    for row in range(rows):
        line = whole[row + 2]
        line[0] = line[1] = whole[row + 1, 2]
        for col in range(cols):
            skip = numbers[row, col] == MISSING or (classes == CLASSES and (row | col) & 1 == 0)
            line[col + 2] = line[col + 1] if skip else numbers[row, col]
            skips[row, col] = skip
        line[cols + 2] = line[cols + 3] = line[cols + 1]


@kernel
def _sum(w, rows, out):
    """The weighted sums, including the half that rounds them."""
    far, near, line = rows.far, rows.near, rows.line
    w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, w10, w11 = (
        w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8], w[9], w[10], w[11],
    )  # fmt: skip
    for j in range(out.size):
        upper = w6 * far[j] + w7 * far[j + 1] + w8 * far[j + 2] + w9 * far[j + 3] + w10 * far[j + 4]
        lower = w2 * near[j] + w3 * near[j + 1] + w11 * near[j + 2] + w4 * near[j + 3] + w5 * near[j + 4]
        out[j] = np.int32(upper + lower + w0 * line[j + 1] + w1 * line[j] + 2048)


@kernel
def _miss(rows, sums, skips, residuals):
    """The residual of each sample, and its size; 0 where the sample is not coded."""
    near, line, left = rows.near, rows.line, rows.left
    for j in range(residuals.size):
        residuals[j] = np.int32(line[j + 2] - near[j + 2] - (sums[j] >> np.int32(12)))
        left[j + 2] = size_of(residuals[j]) * (skips[j] == 0)


@kernel
def _activate(s, rows, sums, out):
    """The activities, in 1/256."""
    far, near, line, further, above, left = rows
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8]
    s9, s10, s11, s12, s13, s14, s15, s16 = s[9], s[10], s[11], s[12], s[13], s[14], s[15], s[16]
    for j in range(out.size):
        n, ne, nw, west = near[j + 2], near[j + 3], near[j + 1], line[j + 1]
        total = s0 * above[j + 2] + s1 * above[j + 1] + s2 * above[j + 3] + s3 * above[j] + s4 * above[j + 4]
        total += s5 * further[j + 2] + s6 * size_of(n - nw) + s7 * size_of(n - ne)
        total += s8 * size_of(n - far[j + 2]) + s9 * size_of(ne - far[j + 3])
        total += s10 * size_of(nw - far[j + 1]) + s11 * size_of(ne - near[j + 4])
        said = sums[j] >> np.int32(12)
        total += s12 * left[j + 1] + s13 * size_of(west - nw) + s14 * size_of(west - line[j])
        out[j] = np.int32(total + s15 * size_of(said) + s16 * size_of(west - n - said))


@kernel
def _place(found, real):
    """The groups, bins and values of a row. ``real``: (n,) float32, scratch."""
    sums, residuals, active, groups, bins, values = found
    for j in range(real.size):
        real[j] = np.float32(active[j])
    bits = real.view(np.int32)
    for j in range(real.size):
        groups[j] = min(max((bits[j] >> np.int32(21)) - np.int32(LOWEST), np.int32(0)), np.int32(GROUPS - 1))
    for j in range(real.size):
        a, beyond = active[j], np.int32((sums[j] & np.int32(TOTAL - 1)) - np.int32(TOTAL // 2))
        lean = np.int32(sums[j] - np.int32(TOTAL // 2))
        far = np.int32(np.uint32(lean if lean >= 0 else -lean) >> np.uint32(4))
        steps = np.int32(2 * far > a) + np.int32(far > a) + np.int32(far > 2 * a) + np.int32(far > 4 * a)
        small = a < SMALL
        bins[j] = min(abs(beyond) >> 9, 3) if small else steps
        turned = np.int32((beyond if small else lean) >> np.int32(31))
        told = np.int32((residuals[j] ^ turned) - turned)
        values[j] = np.int32(np.int32(told << np.int32(1)) ^ np.int32(told >> np.int32(31)))


@kernel
def _note(rows, sums, j, seen):
    """Record the signs of a sample, and the size of its residual: (SIGNS + 1,) int32."""
    far, near, line, further, above, left = rows
    for k, at in enumerate((2, 1, 3, 0, 4)):
        seen[k] = above[j + at]
    n, ne, nw, west, said = near[j + 2], near[j + 3], near[j + 1], line[j + 1], sums[j] >> np.int32(12)
    seen[5], seen[6], seen[7] = further[j + 2], size_of(n - nw), size_of(n - ne)
    seen[8], seen[9] = size_of(n - far[j + 2]), size_of(ne - far[j + 3])
    seen[10], seen[11] = size_of(nw - far[j + 1]), size_of(ne - near[j + 4])
    seen[12], seen[13], seen[14] = left[j + 1], size_of(west - nw), size_of(west - line[j])
    seen[15], seen[16], seen[17] = size_of(said), size_of(west - n - said), left[j + 2]


@kernel
def look(whole, skips, classes, weights, shares, step, seen, counts, values, groups, kinds):
    """Examine all samples, or the signs of some.

    Args:
        whole, skips: from ``surrounded``. weights, shares: (CLASSES, …) int32.
        step: unless ``seen`` is empty, only the signs of two rows in each ``step`` rows are recorded.
        seen: (CLASSES, n, SIGNS + 1) int32. counts: (CLASSES,) int64, how many are recorded.
        values, groups, kinds: (n,), become those of the coded samples: the value, the group of activity, and
            ``BINS`` times the class plus the bin.

    Returns:
        the number of coded samples.
    """
    rows, cols = skips.shape
    sizes, odd = np.zeros((3, cols + 4), np.int32), np.empty(cols, np.int32)
    own_weights, own_shares = np.empty((2, WEIGHTS), np.int32), np.empty((2, SIGNS), np.int32)
    table = np.empty((6, cols), np.int32)
    found, real = Found(table[0], table[1], table[2], table[3], table[4], table[5]), np.empty(cols, np.float32)
    at, noting, two = 0, seen.shape[1] > 0, classes == CLASSES
    for row in range(rows):
        if noting and (row + 2) % step >= 4:  # (recorded rows need the sizes of the two before them)
            continue
        further, above, left = sizes[(row + 1) % 3], sizes[(row + 2) % 3], sizes[row % 3]
        around = Rows(whole[row], whole[row + 1], whole[row + 2], further, above, left)
        for c in range(1 + two):
            k = class_of(row, c, classes)
            own_factors(row, weights[k], shares[k], own_weights[c], own_shares[c])
        one = two and row & 1 == 0  # (only samples of odd columns are coded)
        _sum(own_weights[np.int64(one)], around, found.sums)
        if two and not one:
            _sum(own_weights[1], around, odd)
            found.sums[1::2] = odd[1::2]
        _miss(around, found.sums, skips[row], found.residuals)
        if noting:
            for j in range(cols if row > 0 and row % step < 2 else 0):
                k = class_of(row, j, classes)
                if skips[row, j] == 0 and counts[k] < seen.shape[1]:
                    _note(around, found.sums, j, seen[k, counts[k]])
                    counts[k] += 1
            continue
        _activate(own_shares[np.int64(one)], around, found.sums, found.active)
        if two and not one:
            _activate(own_shares[1], around, found.sums, odd)
            found.active[1::2] = odd[1::2]
        _place(found, real)
        skip, of_even, of_odd = skips[row], BINS * class_of(row, 0, classes), BINS * class_of(row, 1, classes)
        for j in range(cols):  # (without a branch: what is skipped is written over)
            here = np.uint64(at)
            values[here], groups[here] = np.uint32(found.values[j]), found.groups[j]
            kinds[here] = (of_odd if j & 1 else of_even) + found.bins[j]
            at += 0 if skip[j] else 1
    return at
