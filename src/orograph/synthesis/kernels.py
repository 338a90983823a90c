"""The steps of synthesis by example on windows of coordinates, in integers.

They are those of S. Lefebvre and H. Hoppe, *Parallel controllable texture synthesis* (SIGGRAPH 2005, §3).

A coordinate is a place (x, y) in the exemplar's *plane*: the exemplar, (rows, cols), with its mirror images, (2 rows, 2
cols), repeated for ever. ``shaders/synthesis.wgsl`` does the same on the GPU, and ``reference.py`` in plain NumPy. All
three agree in every bit, so there is no division and no floating point here. Windows of coordinates are int32 (h, w,
2): x, y. Distances are at most ``FARTHEST`` and fit 32 bits with their weights.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.dem.noise import hashed

PASSES = 2
"""Maximum corrections of a level, each in four ordered sub-passes (§3.3)."""

MARGIN = 2 * 4 * PASSES
"""Places around a window that correction reads: two for each sub-pass."""

ORDER = np.array([[0, 0], [1, 1], [1, 0], [0, 1], [1, 1], [0, 0], [0, 1], [1, 0]], np.int32)
"""(row, column) parities of the places that each sub-pass corrects; the second pass has another order."""


def order(passes: int) -> NDArray[np.int32]:
    """The parities of the passes, one after the other."""
    return ORDER[: 4 * passes]


COHERENT, STRADDLING = 4, 4
"""Factors of a candidate's distance: 4 if it continues a neighbour, 4 + kappa if it is only similar to such a place;
times 4 if its neighbourhood crosses a mirror."""


@inlined
def wrapped(x, size):
    """A coordinate in the plane's first period, from at most a period beside it."""
    period = 2 * size
    return x + period if x < 0 else (x - period if x >= period else x)


@inlined
def folded(x, size):
    """The place in the exemplar of a coordinate at most a period beside the first, mirrored at the borders."""
    x = wrapped(x, size)
    return x if x < size else 2 * size - 1 - x


@kernel
def upsampled(parent, row0, col0, top, left, step, reach, level, seed, rows, cols, out):
    """Coordinates of a level from those of the coarser one, moved at random (§3.1 and §3.2).

    Args:
        parent: (h, w, 2), with the first place at (row0, col0) of the coarser level.
        top, left: the first place of ``out``, of this level.
        step: samples of the exemplar between places of this level. reach: of the jitter, in 1/256 of a step.
        rows, cols: of the exemplar.
    """
    for i in range(out.shape[0]):
        r = top + i
        for j in range(out.shape[1]):
            c = left + j
            x = parent[(r >> 1) - row0, (c >> 1) - col0, 0] + step * (c & 1)
            y = parent[(r >> 1) - row0, (c >> 1) - col0, 1] + step * (r & 1)
            if reach:
                h = hashed(c, r, seed + 7919 * level)
                x += (step * reach * ((h & 0x1FFF) - 4096) + 0x80000) >> 20
                y += (step * reach * (((h >> 16) & 0x1FFF) - 4096) + 0x80000) >> 20
            out[i, j, 0] = x % (2 * cols)
            out[i, j, 1] = y % (2 * rows)


@inlined
def straddles(x, size, reach):
    """Whether places up to ``reach`` from a place of the exemplar lie across its border."""
    return x < reach or x >= size - reach


@inlined
def of_one_piece(places, i, j, step):
    """Whether the 5 × 5 places around one continue it: its neighbourhood is that of the exemplar."""
    x, y = places[i, j, 0], places[i, j, 1]
    for di in range(-2, 3):
        for dj in range(-2, 3):
            if places[i + di, j + dj, 0] != x + step * dj or places[i + di, j + dj, 1] != y + step * di:
                return False
    return True


@kernel
def corrected(before, features, similar, step, kappa, guide, guides, even_row, even_col, inset, out):
    """One sub-pass of correction: the places of one parity are replaced by the best of the k-coherent candidates.

    A candidate is the continuation of a neighbour, or of the place most similar to it; the best is the one whose
    neighbourhood of 5 × 5 in the exemplar is closest to that around the place.

    Args:
        before, out: (h, w, 2) coordinates. inset: rows and columns along the border that stay as they are.
        features: (rows, cols) int16, up to ±1023, the exemplar as this level sees it.
        similar: (rows, cols, 2) int16, for each place of the exemplar a similar one.
        kappa: 0 or 1; see ``COHERENT``.
        guide: (h, w, g) int16, properties of the terrain at places; guides: (rows, cols, g), of the exemplar. g may be
            0; the first and second change their signs with mirrored columns and rows, as slopes along x and y do.
        even_row, even_col: the index of the first row and column that are corrected: 0 or 1.
    """
    height, width = before.shape[:2]
    rows, cols = features.shape
    steered = guide.shape[2]
    reach = min(2 * step, min(rows, cols) // 4)
    around, beside = np.empty(25, np.int64), np.empty(5, np.int64)
    tried = np.empty((18, 2), np.int64)
    for i in range(height):
        for j in range(width):
            out[i, j, 0], out[i, j, 1] = before[i, j, 0], before[i, j, 1]
    for i in range(inset + ((inset + even_row) & 1), height - inset, 2):
        for j in range(inset + ((inset + even_col) & 1), width - inset, 2):
            if steered == 0 and of_one_piece(before, i, j, step):
                continue  # no candidate is closer than the place itself
            for di in range(5):
                for dj in range(5):
                    x, y = before[i + di - 2, j + dj - 2, 0], before[i + di - 2, j + dj - 2, 1]
                    around[5 * di + dj] = features[folded(y, rows), folded(x, cols)]
            best = np.int64(0xFFFFFFFF)
            count = 0
            for k in range(2):
                for n in range(9):
                    m = (n + 4) % 9  # the place itself first
                    dr, dc = m // 3 - 1, m % 3 - 1
                    x, y = np.int64(before[i + dr, j + dc, 0]), np.int64(before[i + dr, j + dc, 1])
                    if k == 1:
                        fx, fy = folded(x, cols), folded(y, rows)
                        sx, sy = similar[fy, fx, 0], similar[fy, fx, 1]
                        x = sx if x < cols else 2 * cols - 1 - sx
                        y = sy if y < rows else 2 * rows - 1 - sy
                    x, y = wrapped(x - step * dc, cols), wrapped(y - step * dr, rows)
                    known = False
                    for t in range(count):
                        known |= tried[t, 0] == x and tried[t, 1] == y
                    if known:
                        continue
                    tried[count, 0], tried[count, 1] = x, y
                    count += 1
                    fx, fy = folded(x, cols), folded(y, rows)
                    across = straddles(fx, cols, 2 * step) or straddles(fy, rows, 2 * step)
                    weight = COHERENT + k * kappa
                    if across and (straddles(fx, cols, reach) or straddles(fy, rows, reach)):
                        weight *= STRADDLING
                    d = np.int64(0)
                    for g in range(steered):
                        there = np.int64(guides[fy, fx, g])
                        if (g == 0 and x >= cols) or (g == 1 and y >= rows):
                            there = -there
                        d += 8 * (guide[i, j, g] - there) * (guide[i, j, g] - there)
                    if across:
                        for dj in range(5):
                            beside[dj] = folded(x + step * (dj - 2), cols)
                        for di in range(5):
                            if d * weight >= best:
                                break
                            fy = folded(y + step * (di - 2), rows)
                            for dj in range(5):
                                e = around[5 * di + dj] - features[fy, beside[dj]]
                                d += e * e
                    else:
                        right, down = step if x < cols else -step, step if y < rows else -step
                        fx, fy = fx - 2 * right, fy - 2 * down
                        for di in range(5):
                            if d * weight >= best:
                                break
                            for dj in range(5):
                                e = around[5 * di + dj] - features[fy + di * down, fx + dj * right]
                                d += e * e
                    if d * weight < best:
                        best = d * weight
                        out[i, j, 0], out[i, j, 1] = x, y


@inlined
def _tap(stack, x, y):
    return np.int64(stack[folded(y, stack.shape[0]), folded(x, stack.shape[1])])


@inlined
def _across(stack, x, y, step, odd):
    """Eight times ``stack`` along its row, as if doubled from samples two steps apart."""
    if odd:
        return 4 * (_tap(stack, x - step, y) + _tap(stack, x + step, y))
    return 6 * _tap(stack, x, y) + _tap(stack, x - 2 * step, y) + _tap(stack, x + 2 * step, y)


@kernel
def raised(coarse, row0, col0, chosen, top, left, finer, coarser, step, out):
    """Heights of a level: the coarser ones, doubled, plus the exemplar's difference from its own doubled coarser level.

    Doubling is subdivision by the cubic B-spline, 1 4 6 4 1. Where neighbours are chosen from one piece of the
    exemplar, that piece is reproduced to the bit; between pieces, every band of wavelengths blends within about its own
    wavelength (P. Burt, E. Adelson, *A multiresolution spline*, 1983).

    Args:
        coarse: (h, w) int32, whose first sample is (row0, col0) of the coarser level.
        chosen: (h, w, 2) coordinates of this level from (top, left) on, in the shape of ``out``.
        finer, coarser: (rows, cols) int32, the exemplar's stack at this level and at the coarser one.
        step: samples of the exemplar between places of this level.
    """
    height, width = out.shape
    # Columns first, times 8: rows of the coarser level at all columns of this one.
    first, last = (top >> 1) - 1, ((top + height - 1) >> 1) + 1
    wide = np.empty((last - first + 1, width), np.int64)
    for i in range(wide.shape[0]):
        r = first + i - row0
        for j in range(width):
            c = ((left + j) >> 1) - col0
            if (left + j) & 1:
                wide[i, j] = 4 * (np.int64(coarse[r, c]) + coarse[r, c + 1])
            else:
                wide[i, j] = 6 * np.int64(coarse[r, c]) + coarse[r, c - 1] + coarse[r, c + 1]
    for i in range(height):
        r = ((top + i) >> 1) - first
        for j in range(width):
            x, y, odd = np.int64(chosen[i, j, 0]), np.int64(chosen[i, j, 1]), (left + j) & 1
            if (top + i) & 1:
                smooth = 4 * (wide[r, j] + wide[r + 1, j])
                own = 4 * (_across(coarser, x, y - step, step, odd) + _across(coarser, x, y + step, step, odd))
            else:
                smooth = 6 * wide[r, j] + wide[r - 1, j] + wide[r + 1, j]
                own = 6 * _across(coarser, x, y, step, odd)
                own += _across(coarser, x, y - 2 * step, step, odd) + _across(coarser, x, y + 2 * step, step, odd)
            out[i, j] = ((smooth + 32) >> 6) + _tap(finer, x, y) - ((own + 32) >> 6)
