"""The loop of correlated errors: white noise on a lattice, spread over samples by a Gaussian (see ``height_error``)."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel

REACH = 8
"""Nodes of the lattice in each direction that contribute to a sample's error."""


@kernel
def spread(noise, first_row, first_col, row0, col0, row_step, col_step, out):
    """Errors of unit variance at samples (row0 + i, col0 + j).

    Args:
        noise: (m, n) float64, independent, of unit variance; node (first_row, first_col) of the lattice comes first.
        row_step, col_step: samples from node to node, each half the distance at which correlation is exp(−1).
        out: (rows, cols) float64.
    """
    rows, cols = out.shape
    half = REACH // 2
    base = np.empty(cols, np.int64)
    weights = np.empty((cols, REACH))
    for j in range(cols):
        x = (col0 + j) / col_step
        base[j] = np.int64(np.floor(x)) - half + 1
        total = 0.0
        for k in range(REACH):
            w = np.exp(-0.5 * (x - (base[j] + k)) ** 2)
            weights[j, k] = w
            total += w * w
        for k in range(REACH):
            weights[j, k] /= np.sqrt(total)
        base[j] -= first_col
    between = np.empty(noise.shape[1])
    own = np.empty(REACH)
    for i in range(rows):
        y = (row0 + i) / row_step
        first = np.int64(np.floor(y)) - half + 1
        total = 0.0
        for k in range(REACH):
            w = np.exp(-0.5 * (y - (first + k)) ** 2)
            own[k] = w
            total += w * w
        for n in range(len(between)):
            between[n] = 0.0
        for k in range(REACH):
            w = own[k] / np.sqrt(total)
            for n in range(len(between)):
                between[n] += w * noise[first - first_row + k, n]
        for j in range(cols):
            value = 0.0
            for k in range(REACH):
                value += weights[j, k] * between[base[j] + k]
            out[i, j] = value
