"""Kernels that sample a raster at fractional positions: nearest, bilinear, cubic; and box means.

Missing samples (NaN) neither grow nor shrink: a position has a value exactly if its *nearest* sample is valid. So a
raster also reaches half a sample beyond its outermost ones, and adjacent rasters of different lattices meet without a
gap. If some neighbours are missing, bilinear gives each the value beside it in its row, and a wholly missing row the
values of the other row; cubic becomes bilinear. Values are computed as ``a + (b - a) t`` in float64, so where all
neighbours are equal the result is that value to the bit: the sea stays at 0. Cubic is Catmull-Rom (Keys, IEEE ASSP 29,
1981, a = −1/2), which interpolates and may overshoot. Before a source is sampled more coarsely, ``box_means`` averages
blocks of its samples to avoid aliasing. Units: samples in, heights out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel

Heights = NDArray[np.float32]
Floats = NDArray[np.float64]

METHODS = ("nearest", "bilinear", "cubic")


def sample(method: str, window: Heights, row0: int, col0: int, u: Floats, v: Floats, out: Heights) -> None:
    """Give each still missing (NaN) sample of ``out`` the raster's value at its position, where there is one.

    Args:
        method: one of ``METHODS``; or "ground", of a terrain's level 0: ``out`` is then (rows, cols, 2), the surface
            made of its triangles (NaN in a hole), and the highest of the four samples around.
        window: (h, w) float32 part of the raster, NaN where missing; beyond it everything counts as missing.
        row0, col0: index of the window's first sample in the raster.
        u, v: (rows, cols) float64: column and row positions in the raster; NaN for nowhere.
        out: (rows, cols) float32, changed in place.
    """
    kernels = {"nearest": _nearest, "bilinear": _bilinear, "cubic": _cubic, "ground": _ground}
    kernels[method](window, row0, col0, u, v, out)


@kernel
def _nearest(window: Heights, row0: int, col0: int, u: Floats, v: Floats, out: Heights) -> None:
    h, w = window.shape
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            x, y = u[r, c] - col0, v[r, c] - row0
            if math.isnan(out[r, c]) and -0.5 <= x < w - 0.5 and -0.5 <= y < h - 0.5:
                out[r, c] = window[math.floor(y + 0.5), math.floor(x + 0.5)]


@inlined
def _at(window: Heights, j: int, i: int) -> float:
    """A sample as float64, NaN outside."""
    if 0 <= j < window.shape[0] and 0 <= i < window.shape[1]:
        return np.float64(window[j, i])
    return np.nan


@kernel
def _patched(a: float, b: float, c: float, d: float, s: float, t: float) -> float:
    """Bilinear value among neighbours of which some are missing: a b above, c d below, at (s, t) of the way."""
    right, low = s >= 0.5, t >= 0.5
    nearest = (d if right else c) if low else (b if right else a)
    if math.isnan(nearest):
        return np.nan
    a, b = (b if math.isnan(a) else a), (a if math.isnan(b) else b)
    c, d = (d if math.isnan(c) else c), (c if math.isnan(d) else d)
    if math.isnan(a):
        a, b = c, d
    if math.isnan(c):
        c, d = a, b
    upper, lower = a + (b - a) * s, c + (d - c) * s
    return upper + (lower - upper) * t


@kernel
def _bilinear(window: Heights, row0: int, col0: int, u: Floats, v: Floats, out: Heights) -> None:
    h, w = window.shape
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            x, y = u[r, c], v[r, c]
            if not math.isnan(out[r, c]) or not (col0 - 0.5 <= x < col0 + w - 0.5 and row0 - 0.5 <= y < row0 + h - 0.5):
                continue
            # Take the fraction before subtracting the window's origin, so that it does not depend on the window.
            left, top = math.floor(x), math.floor(y)
            s, t = x - left, y - top
            i, j = int(left) - col0, int(top) - row0
            if 0 <= i < w - 1 and 0 <= j < h - 1:
                p, q = np.float64(window[j, i]), np.float64(window[j, i + 1])
                m, n = np.float64(window[j + 1, i]), np.float64(window[j + 1, i + 1])
                upper, lower = p + (q - p) * s, m + (n - m) * s
                value = upper + (lower - upper) * t
                if math.isnan(value):
                    value = _patched(p, q, m, n, s, t)
            else:
                value = _patched(
                    _at(window, j, i), _at(window, j, i + 1), _at(window, j + 1, i), _at(window, j + 1, i + 1), s, t
                )
            out[r, c] = value


@inlined
def _catmull_rom(a: float, b: float, c: float, d: float, t: float) -> float:
    return b + 0.5 * t * ((c - a) + t * ((2 * a - 5 * b + 4 * c - d) + t * (3 * (b - c) + d - a)))


@kernel
def _cubic(window: Heights, row0: int, col0: int, u: Floats, v: Floats, out: Heights) -> None:
    h, w = window.shape
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            x, y = u[r, c], v[r, c]
            if not math.isnan(out[r, c]) or not (col0 - 0.5 <= x < col0 + w - 0.5 and row0 - 0.5 <= y < row0 + h - 0.5):
                continue
            left, top = math.floor(x), math.floor(y)
            s, t = x - left, y - top
            i, j = int(left) - col0, int(top) - row0
            value = np.nan
            if 1 <= i < w - 2 and 1 <= j < h - 2:
                rows = (
                    _row(window, j - 1, i, s),
                    _row(window, j, i, s),
                    _row(window, j + 1, i, s),
                    _row(window, j + 2, i, s),
                )
                value = _catmull_rom(rows[0], rows[1], rows[2], rows[3], t)
            if math.isnan(value):
                value = _patched(
                    _at(window, j, i), _at(window, j, i + 1), _at(window, j + 1, i), _at(window, j + 1, i + 1), s, t
                )
            out[r, c] = value


@inlined
def _row(window: Heights, j: int, i: int, s: float) -> float:
    value: float = _catmull_rom(
        np.float64(window[j, i - 1]),
        np.float64(window[j, i]),
        np.float64(window[j, i + 1]),
        np.float64(window[j, i + 2]),
        s,
    )
    return value


@kernel
def _ground(window: Heights, row0: int, col0: int, u: Floats, v: Floats, out: Heights) -> None:
    """The triangle's plane (a cell's (even, even) and (odd, odd) corners are joined), and the cell's highest sample."""
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            x, y = u[r, c], v[r, c]
            if math.isnan(x + y) or not math.isnan(out[r, c, 1]):
                continue
            left, top = math.floor(x), math.floor(y)
            s, t = x - left, y - top
            i, j = int(left) - col0, int(top) - row0
            p, q = _at(window, j, i), _at(window, j, i + 1)
            m, n = _at(window, j + 1, i), _at(window, j + 1, i + 1)
            if (left + top) % 2 == 0:
                height = p + s * (q - p) + t * (n - q) if s >= t else p + t * (m - p) + s * (n - m)
            elif s + t <= 1:
                height = p + s * (q - p) + t * (m - p)
            else:
                height = n + (1 - s) * (m - n) + (1 - t) * (q - n)
            highest = p
            for other in (q, m, n):
                if not highest >= other and not math.isnan(other):
                    highest = other
            out[r, c, 0], out[r, c, 1] = height, highest


@kernel
def box_means(window: Heights, rows: int, cols: int, out: Heights) -> None:
    """Mean of the valid samples of each block of ``rows`` × ``cols``; NaN where fewer than half of the block are valid.

    Args:
        window: (h · rows, w · cols) float32.
        out: (h, w) float32, overwritten.
    """
    h, w = out.shape
    total, count = np.empty(w), np.empty(w, np.int64)
    for j in range(h):
        total[:] = 0.0
        count[:] = 0
        for r in range(j * rows, (j + 1) * rows):
            for i in range(w):
                for c in range(i * cols, (i + 1) * cols):
                    value = np.float64(window[r, c])
                    if not math.isnan(value):
                        total[i] += value
                        count[i] += 1
        for i in range(w):
            out[j, i] = total[i] / count[i] if 2 * count[i] >= rows * cols else np.nan
