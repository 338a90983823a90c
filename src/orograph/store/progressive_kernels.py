"""The kernels of the codec *progressive*: each level is predicted from the one above it (``progressive``)."""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.codec_head import MISSING


@kernel
def _filled(line, out):
    """Extrapolate a row or column linearly by two samples at its end and one at its beginning. A missing sample takes
    the nearest value before it, else the first one present. Return whether any is present."""
    n, lowest, highest = line.size, line[0], line[0]
    for k in range(n):
        lowest, highest = min(lowest, line[k]), max(highest, line[k])
        out[k + 1] = line[k]
    if highest == MISSING:
        out[:] = 0
        return False
    if lowest == MISSING:
        first = np.int64(0)
        for k in range(n - 1, -1, -1):
            first = np.int64(line[k]) if line[k] != MISSING else first
        for k in range(n):
            first = np.int64(line[k]) if line[k] != MISSING else first
            out[k + 1] = first
    last = out[n] - out[n - 1] if n > 1 else 0
    out[0] = out[1] - (out[2] - out[1]) if n > 1 else out[1]
    out[n + 1], out[n + 2] = out[n] + last, out[n] + 2 * last
    return True


@kernel
def _between(line, out):
    """16 times the interpolated value half-way after each sample of a filled line: (-1, 9, 9, -1)."""
    for k in range(out.size):
        out[k] = 9 * (line[k + 1] + line[k + 2]) - line[k] - line[k + 3]


@kernel
def _extended(lines, count):
    """Extrapolate ``count`` rows, from the second on: a row before them and two behind, like ``_filled``'s ends."""
    first, second = lines[1], lines[2 if count > 1 else 1]
    last, before = lines[count], lines[count - 1 if count > 1 else count]
    for j in range(lines.shape[1]):
        step = last[j] - before[j]
        lines[0, j] = 2 * first[j] - second[j]
        lines[count + 1, j], lines[count + 2, j] = last[j] + step, last[j] + 2 * step


@kernel
def _columns(coarse, lines):
    """All columns of a chunk's known samples, filled like ``_filled``: (rows + 3, columns) int64."""
    n, m = coarse.shape
    before = lines[0]
    before[:] = 0
    for i in range(n - 1, -1, -1):
        own = coarse[i]
        for j in range(m):
            before[j] = own[j] if own[j] != MISSING else before[j]
    for i in range(n):
        own, line = coarse[i], lines[i + 1]
        for j in range(m):
            line[j] = own[j] if own[j] != MISSING else before[j]
        before = line
    _extended(lines, n)


@kernel
def _down(lines, i, bits, found):
    """The interpolated values half-way below a row of ``lines``, divided by 2^``bits`` and rounded."""
    above, upper, lower, below, half = lines[i], lines[i + 1], lines[i + 2], lines[i + 3], 1 << bits >> 1
    for j in range(lines.shape[1]):
        found[j] = (9 * (upper[j] + lower[j]) - above[j] - below[j] + half) >> bits


@kernel
def _alternating(even, odd, line):
    """A row of samples from those of its even and of its odd columns."""
    for j in range(odd.size):
        line[np.uint64(2 * j)], line[np.uint64(2 * j + 1)] = even[j], odd[j]
    for j in range(odd.size, even.size):
        line[2 * j] = even[j]


@kernel
def _put_last_column(coarse, known_row, out):
    """Predict the last column of a chunk from its own samples, where the level above has some."""
    (rows, cols), n = out.shape, coarse.shape[0] - known_row
    last, tall, down = coarse.shape[1] - 1, np.empty(n + 3, np.int64), np.empty(rows // 2, np.int64)
    _filled(coarse[:n, last], tall)
    _between(tall, down)
    for i in range(rows // 2):
        out[2 * i + 1, cols - 1] = (down[i] + 8) >> 4
    for i in range(n):
        out[2 * i, cols - 1] = coarse[i, last]
    if known_row:
        out[rows - 1, cols - 1] = coarse[n, last]


@kernel
def predict(coarse, known_row, known_col, out):
    """Predict a chunk from every second of its samples.

    Args:
        coarse: (n, m) int32, ``MISSING`` where missing. known_row, known_col: 1 if its last row or column is also the
            last one of the chunk, which has an odd index; else 0.
        out: (rows, cols) int32, becomes the predictions, and ``coarse`` where the level above has the sample.
    """
    rows, cols = out.shape
    n, m, half = coarse.shape[0] - known_row, coarse.shape[1] - known_col, cols // 2
    line, odd, even = np.empty(m + 3, np.int64), np.empty(half, np.int64), np.empty(m, np.int64)
    across, there = np.zeros((n + 3, half), np.int64), np.zeros(n, np.bool_)
    for i in range(coarse.shape[0]):
        some, found = _filled(coarse[i, :m], line), across[i + 1 if i < n else 0]
        _between(line, found)
        for j in range(half):
            odd[j] = (found[j] + 8) >> 4
        _alternating(coarse[i, :m], odd, out[2 * i if i < n else rows - 1])
        if i < n:
            there[i] = some
    for i in range(1, n):  # a row without any sample repeats the one before it
        if not there[i]:
            across[i + 1] = across[i]
            there[i] = there[i - 1]
    for i in range(n - 2, -1, -1):
        if not there[i]:
            across[i + 1] = across[i + 2]
            there[i] = there[i + 1]
    _extended(across, n)
    columns = np.empty((n + 3, m), np.int64)
    _columns(coarse[:n, :m], columns)
    last = rows - 1 if known_row else rows
    for i in range(last // 2):
        _down(columns, i, 4, even)
        _down(across, i, 8, odd)
        _alternating(even, odd, out[2 * i + 1])
    if known_col:
        _put_last_column(coarse, known_row, out)


@inlined
def _given(k, side, known):
    """Whether the level above has a row or column."""
    return k & 1 == 0 or (known and k == side - 1)


@inlined
def _floored(value, factor):
    """Whole times that a factor fits a number. (A division of floats is exact enough below 2^52, and vectors do it.)"""
    return np.floor(np.float64(value) / factor)


@kernel
def _predicted(coarse, known_row, known_col, factor, exact, out):
    """Like ``predict``; if ``exact``, predictions are rounded to large steps."""
    predict(coarse, known_row, known_col, out)
    if exact and factor > 1:
        half, wide = factor // 2, np.float64(factor)
        for i in range(out.shape[0]):
            line = out[i]
            for j in range(line.size):
                line[j] = np.int32(_floored(np.float64(line[j]) + half, wide) * wide)
        _put_known(coarse, known_row, known_col, out)


@kernel
def _put_known(coarse, known_row, known_col, out):
    """Put the samples that the level above has where they belong."""
    rows, cols = out.shape
    for i in range(coarse.shape[0]):
        line = out[rows - 1 if known_row and i == coarse.shape[0] - 1 else 2 * i]
        for j in range(coarse.shape[1] - known_col):
            line[2 * j] = coarse[i, j]
        if known_col:
            line[cols - 1] = coarse[i, coarse.shape[1] - 1]


@kernel
def settle(heights, step, coarse, known_row, known_col, factor, out):
    """Quantise heights: whole large steps from their predictions.

    Args:
        heights: (rows, cols) float32, metres, NaN where missing. step: the small step, metres.
        coarse, known_row, known_col: as in ``predict``. out: (rows, cols) int32.
    """
    predict(coarse, known_row, known_col, out)
    wide, share = np.float64(factor), 1.0 / factor
    for i in range(out.shape[0]):
        own, line = heights[i], out[i]
        for j in range(line.size):
            here = np.float64(own[j]) / step
            steps = np.rint((here - np.float64(line[j])) * share) * wide
            line[j] = np.int32(line[j] + np.int32(steps)) if here == here else np.int32(MISSING)
    _put_known(coarse, known_row, known_col, out)


@kernel
def subtract(numbers, coarse, known_row, known_col, factor, exact, out):
    """The stored differences of a chunk: (rows, cols) int32, in large steps, 0 where the level above has the sample."""
    _predicted(coarse, known_row, known_col, factor, exact, out)
    rows, cols = out.shape
    wide = np.float64(factor)
    for i in range(rows):
        here, line = numbers[i], out[i]
        for j in range(cols):
            steps = np.int32(_floored(np.float64(here[j]) - np.float64(line[j]), wide))
            line[j] = steps if here[j] != MISSING else np.int32(MISSING)
        if _given(i, rows, known_row):
            for j in range(cols):
                if _given(j, cols, known_col) and here[j] != MISSING:
                    line[j] = 0


@kernel
def add(stored, coarse, known_row, known_col, factor, exact, out):
    """Rebuild a chunk from its stored differences and the samples that the level above has."""
    _predicted(coarse, known_row, known_col, factor, exact, out)
    for i in range(out.shape[0]):
        own, line = stored[i], out[i]
        for j in range(line.size):
            line[j] = np.int32(line[j] + own[j] * np.int32(factor)) if own[j] != MISSING else np.int32(MISSING)
    _put_known(coarse, known_row, known_col, out)
