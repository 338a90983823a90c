"""What the encoder of *smallest* computes from samples: residuals, activities, cells (``smallest_encode``).

All samples are known, so sixteen samples of a row are computed side by side. Where classes alternate along rows, the
even and the odd columns of a row are kept apart, so that the samples of a class are neighbours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._lanes import LANES32
from orograph._lanes32 import load32, store32
from orograph._numba import inlined, kernel, shared
from orograph.store.codec_head import BITS, MISSING
from orograph.store.smallest_rows import (
    BINS,
    CLASSES,
    GROUPS,
    SIGNS,
    WEIGHTS,
    cell_of,
    class_of,
    own_factors,
    size_of,
)

Flat = NDArray[np.int32]


class Lines(NamedTuple):
    """A chunk in the surroundings that decoders assume: two rows above it, two samples at both ends of rows.

    Attributes:
        samples: flat, rows of ``pitch`` samples; if ``split``, the even columns of a row are before its odd ones.
        sizes: flat, of the last three rows: the sizes of residuals.
        sums, residuals: flat, of a row: weighted sums and residuals, from ``pitch`` / 2 on those of odd columns.
        marks: (rows, cols), which samples are missing; without rows if none is.
        shape: rows, cols.
        split: whether classes alternate along rows.
        pitch: a multiple of 32.
    """

    samples: Flat
    sizes: Flat
    sums: Flat
    residuals: Flat
    marks: NDArray[np.bool_]
    shape: tuple[int, int]
    split: bool
    pitch: int


@kernel
def lines_of(numbers, classes, first, missing):
    """A chunk's lines.

    Args:
        first: the value above the first row. missing: whether samples are missing.
    """
    (rows, cols), split = numbers.shape, classes == CLASSES
    pitch = 2 * (-(-cols // (2 * LANES32)) + 1) * LANES32
    marks = numbers == MISSING if missing else np.empty((0, cols), np.bool_)
    room = np.zeros(5 * pitch, np.int32)
    samples, line = np.empty((rows + 2) * pitch, np.int32), np.empty(cols + 4, np.int32)
    samples[: 2 * pitch] = line[2] = first
    for row in range(rows):
        own, left = numbers[row], line[2]
        line[0] = line[1] = left
        if split and row & 1 == 0:  # (even columns hold nothing)
            line[2] = left
            for col in range(1, cols, 2):
                left = own[col] if own[col] != MISSING else left
                line[col + 2] = line[col + 3] = left
        else:
            for col in range(cols):
                line[col + 2] = own[col]
            for col in range(cols if missing else 0):
                left = own[col] if own[col] != MISSING else left
                line[col + 2] = left
        line[cols + 2] = line[cols + 3] = line[cols + 1]
        _put_line(line, split, samples[(row + 2) * pitch : (row + 3) * pitch])
    return Lines(samples, room[: 3 * pitch], room[3 * pitch : 4 * pitch], room[4 * pitch :], marks, (rows, cols), split,
                 pitch)  # fmt: skip


@kernel
def _put_line(line, split, out):
    """Copy a row, even columns first if it is split."""
    if split:
        even, odd = out[: (line.size + 1) // 2], out[out.size // 2 :]
        for t in range(line.size // 2):
            even[t], odd[t] = line[np.uint64(2 * t)], line[np.uint64(2 * t + 1)]
        if line.size & 1:
            even[line.size // 2] = line[line.size - 1]
    else:
        for x in range(line.size):
            out[x] = line[x]


@shared
def places_of(lines, parity):
    """Where in a row the first sample of the columns of a parity and the two on both sides of it are; with lines that
    are not split, all columns count as even."""
    x, half = parity, lines.pitch // 2
    if not lines.split:
        return x, x + 1, x + 2, x + 3, x + 4
    even, odd = (x >> 1) + (x & 1) * half, (x + 1 >> 1) + (x + 1 & 1) * half
    return even, odd, even + 1, odd + 1, even + 2


@shared
def parities_of(lines, row):
    """The parities of columns that are coded in a row, as a range: (the first, one more than the last)."""
    return (1 - (row & 1), 2) if lines.split else (0, 1)


@shared
def count_of(lines, parity):
    """The number of columns of a parity."""
    return (lines.shape[1] - parity + 1) // 2 if lines.split else lines.shape[1]


@shared
def rows_of(lines, row):
    """Where a row's samples begin, and the sizes of residuals: two rows above it, above it, its own, of both."""
    pitch = lines.pitch
    own = (row + 1) % 3 * pitch, (row + 2) % 3 * pitch, row % 3 * pitch
    return row * pitch, (row + 1) * pitch, (row + 2) * pitch, own[0], own[1], own[2]


@kernel
def factors_of(classes, weights, shares):
    """Weights and shares of the first row, the second, and all others, by class."""
    all_weights, all_shares = np.zeros((3, CLASSES, WEIGHTS), np.int32), np.zeros((3, CLASSES, SIGNS), np.int32)
    for row in range(3):
        for k in range(classes == CLASSES, classes):
            own_factors(row, weights[k], shares[k], all_weights[row, k], all_shares[row, k])
    return all_weights, all_shares


@kernel
def _miss(lines, rows, at, begin, count, w):
    """Find the weighted sums, including the half that rounds them, and the residuals of the samples of a parity.

    Args:
        at: from ``places_of``. begin: where sums and residuals go. w: (WEIGHTS,).
    """
    samples, sizes, (far, near, line, _, _, left), (a, b, c, d, e) = lines.samples, lines.sizes, rows, at
    w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, w10, w11 = (
        w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8], w[9], w[10], w[11],
    )  # fmt: skip
    for t in range(0, count, LANES32):
        north = load32(samples, near + c + t)
        upper = load32(samples, far + a + t) * w6 + load32(samples, far + b + t) * w7
        upper += load32(samples, far + c + t) * w8 + load32(samples, far + d + t) * w9
        upper += load32(samples, far + e + t) * w10 + north * w11
        lower = load32(samples, near + a + t) * w2 + load32(samples, near + b + t) * w3
        lower += load32(samples, near + d + t) * w4 + load32(samples, near + e + t) * w5
        sums = upper + lower + load32(samples, line + b + t) * w0 + load32(samples, line + a + t) * w1 + 2048
        off = load32(samples, line + c + t) - north - (sums >> BITS)
        store32(lines.sums, begin + t, sums)
        store32(lines.residuals, begin + t, off)
        store32(sizes, left + c + t, size_of(off))
    for t in range(count, -(-count // LANES32) * LANES32):
        sizes[left + c + t] = 0


@kernel
def miss_row(lines, row, weights):
    """Find the weighted sums and residuals of a row. Args: weights: from ``factors_of``."""
    rows, (first, end), own = rows_of(lines, row), parities_of(lines, row), weights[min(row, 2)]
    left, half = rows[5], lines.pitch // 2
    if first:  # (even columns hold nothing)
        lines.sizes[left : left + half] = 0
    for parity in range(first, end):
        at, count = places_of(lines, parity), count_of(lines, parity)
        k = class_of(row, parity, CLASSES if lines.split else 1)
        _miss(lines, rows, at, parity * half, count, own[k])
        if lines.marks.size:
            marks = lines.marks[row, parity :: 2 if lines.split else 1]
            for t in range(count):
                if marks[t]:
                    lines.sizes[left + at[2] + t] = 0


@inlined
def signs_of(lines, rows, at, sums, t):
    """The signs of sixteen samples of a parity from the ``t``-th on, as docs/codec.md lists them.

    Args:
        rows: from ``rows_of``. at: from ``places_of``. sums: their weighted sums.
    """
    samples, sizes, (far, near, line, further, above, left), (a, b, c, d, e) = lines.samples, lines.sizes, rows, at
    n, nw, ne = load32(samples, near + c + t), load32(samples, near + b + t), load32(samples, near + d + t)
    west, said = load32(samples, line + b + t), sums >> BITS
    return (
        load32(sizes, above + c + t), load32(sizes, above + b + t), load32(sizes, above + d + t),
        load32(sizes, above + a + t), load32(sizes, above + e + t), load32(sizes, further + c + t),
        size_of(n - nw), size_of(n - ne), size_of(n - load32(samples, far + c + t)),
        size_of(ne - load32(samples, far + d + t)), size_of(nw - load32(samples, far + b + t)),
        size_of(ne - load32(samples, near + e + t)),
        load32(sizes, left + b + t), size_of(west - nw), size_of(west - load32(samples, line + a + t)),
        size_of(said), size_of(west - n - said),
    )  # fmt: skip


@kernel
def _place(lines, rows, at, begin, count, s, kind, room, values, cells):
    """Find the values and cells of the samples of a parity.

    Args:
        at, begin, count: as in ``_miss``. s: (SIGNS,). kind: the first cell of their class.
        room: where values and cells go; there is room for fifteen more.
    """
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8]
    s9, s10, s11, s12, s13, s14, s15, s16 = s[9], s[10], s[11], s[12], s[13], s[14], s[15], s[16]
    for t in range(0, count, LANES32):
        sums = load32(lines.sums, begin + t)
        e = signs_of(lines, rows, at, sums, t)
        active = e[0] * s0 + e[1] * s1 + e[2] * s2 + e[3] * s3 + e[4] * s4 + e[5] * s5 + e[6] * s6 + e[7] * s7
        active += e[8] * s8 + e[9] * s9 + e[10] * s10 + e[11] * s11 + e[12] * s12 + e[13] * s13 + e[14] * s14
        cell, turned = cell_of(active + e[15] * s15 + e[16] * s16, sums)
        told = (load32(lines.residuals, begin + t) ^ turned) - turned
        store32(values, room + t, (told << 1) ^ (told >> 31))
        store32(cells, room + t, cell + kind)


@kernel
def look(lines, weights, shares, values, cells):
    """Examine all samples, in the order of rows and, within these, of classes.

    Args:
        weights, shares: from ``factors_of``.
        values, cells: (n + ``LANES32``,) int32, become those of the coded samples: zigzag-coded values, and cells:
            (class · ``GROUPS`` + group) · ``BINS`` + bin.

    Returns:
        the number of coded samples.
    """
    room, classes = 0, CLASSES if lines.split else 1
    for row in range(lines.shape[0]):
        miss_row(lines, row, weights)
        rows, (first, end), own = rows_of(lines, row), parities_of(lines, row), shares[min(row, 2)]
        for parity in range(first, end):
            at, count, k = places_of(lines, parity), count_of(lines, parity), class_of(row, parity, classes)
            begin = parity * (lines.pitch // 2)
            _place(lines, rows, at, begin, count, own[k], k * GROUPS * BINS, room, values, cells)
            if lines.marks.size:
                kept, marks = room, lines.marks[row, parity :: 2 if lines.split else 1]
                for t in range(count):
                    values[kept], cells[kept] = values[room + t], cells[room + t]
                    kept += not marks[t]
                room = kept
            else:
                room += count
    return room
