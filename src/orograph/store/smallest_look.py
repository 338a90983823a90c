"""What the encoder of *smallest* computes from samples: residuals, activities, cells (``smallest_encode``).

All samples are known, so sixteen samples of a row are computed side by side. Where classes alternate along rows, the
even and the odd columns of a row are kept apart, so that the samples of a class are neighbours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._lanes import LANES32
from orograph._lanes32 import load32, picked32, store32
from orograph._numba import inlined, linked, shared
from orograph.store.codec_head import BITS, MISSING
from orograph.store.smallest_rows import (
    BINS,
    CLASSES,
    ENTRIES,
    GROUPS,
    WEIGHTS,
    cell_of,
    class_of,
    entry_of,
    outcome,
    size_of,
)

Flat = NDArray[np.int32]


class Lines(NamedTuple):
    """A chunk in the surroundings that decoders assume: two rows above it, two samples at both ends of rows.

    Attributes:
        samples: flat, rows of ``pitch`` samples; if ``split``, the even columns of a row are before its odd ones.
        sizes: flat, of the last three rows: the sizes of residuals.
        sums, residuals, entries: flat, of a row: weighted sums, residuals, and the entries of their choices
            (``Rules``), from ``pitch`` / 2 on those of odd columns.
        marks: (rows, cols), which samples are missing; without rows if none is.
        shape: rows, cols.
        split: whether classes alternate along rows.
        pitch: a multiple of 32.
    """

    samples: Flat
    sizes: Flat
    sums: Flat
    residuals: Flat
    entries: Flat
    marks: NDArray[np.bool_]
    shape: tuple[int, int]
    split: bool
    pitch: int


class Rules(NamedTuple):
    """What predicts samples.

    Attributes:
        choices: of weights and shares (``put_choices``).
        limits: (TESTS,) int32, of the tests that choose. tested: whether there are tests.
    """

    choices: Flat
    limits: Flat
    tested: bool


@linked
def lines_of(numbers, classes, missing):
    """A chunk's lines. Args: missing: whether samples are missing."""
    (rows, cols), split = numbers.shape, classes == CLASSES
    pitch = 2 * (-(-cols // (2 * LANES32)) + 1) * LANES32
    marks = numbers == MISSING if missing else np.empty((0, cols), np.bool_)
    room = np.zeros(6 * pitch, np.int32)
    samples, line = np.empty((rows + 2) * pitch, np.int32), np.empty(cols + 4, np.int32)
    samples[: 2 * pitch] = line[2] = 0
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
    sizes, sums, residuals = room[: 3 * pitch], room[3 * pitch : 4 * pitch], room[4 * pitch : 5 * pitch]
    return Lines(samples, sizes, sums, residuals, room[5 * pitch :], marks, (rows, cols), split, pitch)


@linked
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


@inlined
def _picked(choices, k, entries):
    """The choices of the weight or share k."""
    return picked32(choices, k * ENTRIES, entries)


@linked
def _choose(lines, rows, at, begin, count, entry, rules):
    """Find the entries of the choices of the samples of a parity.

    Args:
        at, begin, count: as in ``_miss``. entry: where no test holds. rules: none if they do not count in this row.
    """
    samples, (far, near), (_, b, c, d, _) = lines.samples, rows[:2], at
    limits = rules.limits[0], rules.limits[1], rules.limits[2]
    for t in range(0, count, LANES32):
        north = load32(samples, near + c + t)
        across, ahead = size_of(north - load32(samples, near + b + t)), size_of(north - load32(samples, near + d + t))
        down = size_of(north - load32(samples, far + c + t))
        store32(lines.entries, begin + t, outcome(across, ahead, down, limits) + entry)


@linked
def _miss(lines, rows, at, begin, count, choices):
    """Find the weighted sums, including the half that rounds them, and the residuals of the samples of a parity.

    Args:
        at: from ``places_of``. begin: where entries, sums and residuals go. choices: of the weights.
    """
    samples, sizes, (far, near, line, _, _, left), (a, b, c, d, e) = lines.samples, lines.sizes, rows, at
    for t in range(0, count, LANES32):
        own, north = load32(lines.entries, begin + t), load32(samples, near + c + t)
        upper = load32(samples, far + a + t) * _picked(choices, 6, own)
        upper += load32(samples, far + b + t) * _picked(choices, 7, own)
        upper += load32(samples, far + c + t) * _picked(choices, 8, own)
        upper += load32(samples, far + d + t) * _picked(choices, 9, own)
        upper += load32(samples, far + e + t) * _picked(choices, 10, own) + north * _picked(choices, 11, own)
        lower = load32(samples, near + a + t) * _picked(choices, 2, own)
        lower += load32(samples, near + b + t) * _picked(choices, 3, own)
        lower += load32(samples, near + d + t) * _picked(choices, 4, own)
        lower += load32(samples, near + e + t) * _picked(choices, 5, own)
        before = load32(samples, line + b + t) * _picked(choices, 0, own)
        sums = upper + lower + before + load32(samples, line + a + t) * _picked(choices, 1, own) + 2048
        off = load32(samples, line + c + t) - north - (sums >> BITS)
        store32(lines.sums, begin + t, sums)
        store32(lines.residuals, begin + t, off)
        store32(sizes, left + c + t, size_of(off))
    for t in range(count, -(-count // LANES32) * LANES32):
        sizes[left + c + t] = 0


@linked
def miss_row(lines, row, rules):
    """Find the entries, weighted sums and residuals of a row."""
    rows, (first, end), classes = rows_of(lines, row), parities_of(lines, row), CLASSES if lines.split else 1
    left, half = rows[5], lines.pitch // 2
    if first:  # (even columns hold nothing)
        lines.sizes[left : left + half] = 0
    for parity in range(first, end):
        at, count = places_of(lines, parity), count_of(lines, parity)
        entry, begin = np.int32(entry_of(row, class_of(row, parity, classes))), parity * half
        if rules.tested and row > 1:
            _choose(lines, rows, at, begin, count, entry, rules)
        else:
            lines.entries[begin : begin + count + LANES32] = entry
        _miss(lines, rows, at, begin, count, rules.choices)
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


@inlined
def _active(e, choices, entries):
    """The activities, from signs."""
    k = WEIGHTS
    above = e[0] * _picked(choices, k, entries) + e[1] * _picked(choices, k + 1, entries)
    above += e[2] * _picked(choices, k + 2, entries) + e[3] * _picked(choices, k + 3, entries)
    above += e[4] * _picked(choices, k + 4, entries) + e[5] * _picked(choices, k + 5, entries)
    slopes = e[6] * _picked(choices, k + 6, entries) + e[7] * _picked(choices, k + 7, entries)
    slopes += e[8] * _picked(choices, k + 8, entries) + e[9] * _picked(choices, k + 9, entries)
    slopes += e[10] * _picked(choices, k + 10, entries) + e[11] * _picked(choices, k + 11, entries)
    left = e[12] * _picked(choices, k + 12, entries) + e[13] * _picked(choices, k + 13, entries)
    left += e[14] * _picked(choices, k + 14, entries) + e[15] * _picked(choices, k + 15, entries)
    return above + slopes + left + e[16] * _picked(choices, k + 16, entries)


@linked
def _place(lines, rows, at, begin, count, choices, kind, room, values, cells):
    """Find the values and cells of the samples of a parity.

    Args:
        at, begin, count: as in ``_miss``. choices: of the weights and shares. kind: the first cell of their class.
        room: where values and cells go; there is room for fifteen more.
    """
    for t in range(0, count, LANES32):
        sums, own = load32(lines.sums, begin + t), load32(lines.entries, begin + t)
        e = signs_of(lines, rows, at, sums, t)
        cell, turned = cell_of(_active(e, choices, own), sums)
        told = (load32(lines.residuals, begin + t) ^ turned) - turned
        store32(values, room + t, (told << 1) ^ (told >> 31))
        store32(cells, room + t, cell + kind)


@linked
def look(lines, rules, values, cells):
    """Examine all samples, in the order of rows and, within these, of classes.

    Args:
        values, cells: (n + ``LANES32``,) int32, become those of the coded samples: zigzag-coded values, and cells:
            (class · ``GROUPS`` + group) · ``BINS`` + bin.

    Returns:
        the number of coded samples.
    """
    room, classes = 0, CLASSES if lines.split else 1
    for row in range(lines.shape[0]):
        miss_row(lines, row, rules)
        rows, (first, end) = rows_of(lines, row), parities_of(lines, row)
        for parity in range(first, end):
            at, count, k = places_of(lines, parity), count_of(lines, parity), class_of(row, parity, classes)
            begin = parity * (lines.pitch // 2)
            _place(lines, rows, at, begin, count, rules.choices, k * GROUPS * BINS, room, values, cells)
            if lines.marks.size:
                kept, marks = room, lines.marks[row, parity :: 2 if lines.split else 1]
                for t in range(count):
                    values[kept], cells[kept] = values[room + t], cells[room + t]
                    kept += not marks[t]
                room = kept
            else:
                room += count
    return room
