"""The kernels of the codec *progressive*: each level is predicted from the one above it (``progressive``)."""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.codec_head import MISSING


@kernel
def _filled(line, out):
    """Extrapolate a row or column linearly by two samples at its end and one at its beginning. A missing sample takes
    the nearest value before it, else the first one present. Return whether any is present."""
    n, first = line.size, np.int64(MISSING)
    for k in range(n):
        if line[k] != MISSING:
            first = np.int64(line[k])
            break
    if first == MISSING:
        out[:] = 0
        return False
    for k in range(n):
        if line[k] != MISSING:
            first = np.int64(line[k])
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
def predict(coarse, known_row, known_col, out):
    """Predict a chunk from every second of its samples.

    Args:
        coarse: (n, m) int32, ``MISSING`` where missing. known_row, known_col: 1 if its last row or column is also the
            last one of the chunk, which has an odd index; else 0.
        out: (rows, cols) int32, becomes the predictions, and ``coarse`` where the level above has the sample.
    """
    rows, cols = out.shape
    n, m = coarse.shape[0] - known_row, coarse.shape[1] - known_col
    line, tall = np.empty(coarse.shape[1] + 3, np.int64), np.empty(coarse.shape[0] + 3, np.int64)
    across, there = np.zeros((n + 3, cols // 2), np.int64), np.zeros(n, np.bool_)
    for i in range(n):
        there[i] = _filled(coarse[i, :m], line[: m + 3])
        _between(line, across[i + 1])
        for j in range(m):
            out[2 * i, 2 * j] = coarse[i, j]
        for j in range(cols // 2):
            out[2 * i, 2 * j + 1] = (across[i + 1, j] + 8) >> 4
    down = np.empty(rows // 2, np.int64)
    for j in range(m):
        _filled(coarse[:n, j], tall[: n + 3])
        _between(tall, down)
        for i in range(rows // 2):
            out[2 * i + 1, 2 * j] = (down[i] + 8) >> 4
    for i in range(1, n):  # a row without any sample repeats the one before it
        if not there[i]:
            across[i + 1] = across[i]
            there[i] = there[i - 1]
    for i in range(n - 2, -1, -1):
        if not there[i]:
            across[i + 1] = across[i + 2]
            there[i] = there[i + 1]
    for j in range(cols // 2):
        last = across[n, j] - across[n - 1, j] if n > 1 else 0
        across[0, j] = across[1, j] - (across[2, j] - across[1, j]) if n > 1 else across[1, j]
        across[n + 1, j], across[n + 2, j] = across[n, j] + last, across[n, j] + 2 * last
    for i in range(rows // 2):
        for j in range(cols // 2):
            near = 9 * (across[i + 1, j] + across[i + 2, j])
            out[2 * i + 1, 2 * j + 1] = (near - across[i, j] - across[i + 3, j] + 128) >> 8
    if known_row:
        _filled(coarse[n, :m], line[: m + 3])
        _between(line, across[0])
        for j in range(m):
            out[rows - 1, 2 * j] = coarse[n, j]
        for j in range(cols // 2):
            out[rows - 1, 2 * j + 1] = (across[0, j] + 8) >> 4
    if known_col:
        _filled(coarse[:n, m], tall[: n + 3])
        _between(tall, down)
        for i in range(n):
            out[2 * i, cols - 1] = coarse[i, m]
        for i in range(rows // 2):
            out[2 * i + 1, cols - 1] = (down[i] + 8) >> 4
    if known_row and known_col:
        out[rows - 1, cols - 1] = coarse[n, m]


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
def settle(units, coarse, known_row, known_col, factor, out):
    """Quantise heights: whole large steps from their predictions.

    Args:
        units: (rows, cols) float64, in small steps, NaN where missing. coarse, known_row, known_col: as in ``predict``.
        out: (rows, cols) int32.
    """
    predict(coarse, known_row, known_col, out)
    rows, cols = out.shape
    for i in range(rows):
        row = _given(i, rows, known_row)
        for j in range(cols):
            if row and _given(j, cols, known_col):
                continue
            here = units[i, j]
            if here == here:
                out[i, j] += np.int32(np.rint((here - out[i, j]) / factor)) * factor
            else:
                out[i, j] = MISSING


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
    rows, cols = out.shape
    for i in range(rows):
        row = _given(i, rows, known_row)
        for j in range(cols):
            if row and _given(j, cols, known_col):
                continue
            if stored[i, j] == MISSING:
                out[i, j] = MISSING
            else:
                out[i, j] = np.int32(out[i, j] + np.int64(stored[i, j]) * factor)
