"""Line integral convolution (Cabral & Leedom 1993): noise smeared along a flow, so that its ways are seen everywhere.

Steps are of equal length in metres on the surface, not on the map: on slopes streaks are as long as on flats. The noise
is a hash of a place's texel in the image over the whole terrain: wherever the image is cut, each texel is the same.
Positions are in texels of that image, counted from its corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel

GRAIN = 3
"""Texels of a grain of noise."""

STEPS = 24
"""Steps to either side, each ``STEP`` texels long on flat ground, where no size is given."""

STEP = 0.8

CONTRAST = 0.3
"""Of brightness, for one standard deviation of what the mean of so many grains is."""


def brightness(
    across: NDArray[np.float64], down: NDArray[np.float64], pace: NDArray[np.float64], steps: int,
    origin: tuple[int, int] = (0, 0),
) -> NDArray[np.float64]:  # fmt: skip
    """How bright texels are, (rows, cols), 0 to 1; 0.5 where there is no flow.

    Args:
        across, down: (rows, cols) unit vectors of the flow; 0: there is none. pace: (rows, cols) texels along the flow
            that a step takes. steps: to either side. origin: (row, col) of the first texel in the whole image.
    """
    out = np.empty(across.shape)
    convolve(across, down, pace, steps, GRAIN, origin[0], origin[1], out)
    return np.clip(0.5 + CONTRAST * out, 0, 1)


@inlined
def _noise(x, y, grain):
    """0 to 1, of the grain at a place: ``patterns``' hash."""
    i = np.uint64(np.int64(np.floor(x / grain)) & 0xFFFFFFFF)
    n = np.uint64(np.int64(np.floor(y / grain)) & 0xFFFFFFFF)
    for turn in range(2):
        n = ((n ^ (n >> np.uint64(16))) * np.uint64(0x7FEB352D)) & np.uint64(0xFFFFFFFF)
        n = ((n ^ (n >> np.uint64(15))) * np.uint64(0x846CA68B)) & np.uint64(0xFFFFFFFF)
        n = n ^ (n >> np.uint64(16))
        if turn == 0:
            n = n ^ ((i * np.uint64(0x9E3779B1)) & np.uint64(0xFFFFFFFF))
    return (float(n) + 0.5) / 4294967296.0


@kernel
def convolve(across, down, pace, steps, grain, row0, col0, out):
    """``brightness`` in standard deviations; arguments as there, ``out`` (rows, cols)."""
    rows, cols = across.shape
    for row in range(rows):
        for col in range(cols):
            if across[row, col] == 0.0 and down[row, col] == 0.0:
                out[row, col] = 0.0
                continue
            x0, y0 = col0 + col + 0.5, row0 + row + 0.5
            total, count, grains = _noise(x0, y0, grain), 1, 1
            for sign in (1.0, -1.0):
                x, y = x0, y0
                gx, gy = np.floor(x / grain), np.floor(y / grain)
                for _ in range(steps):
                    there = True
                    ux = uy = 0.0
                    for half in range(2):  # the midpoint method: the flow half a step ahead
                        px, py = x + 0.5 * half * ux, y + 0.5 * half * uy
                        j, i = int(np.floor(px)) - col0, int(np.floor(py)) - row0
                        if not (0 <= i < rows and 0 <= j < cols):
                            there = False
                            break
                        ux, uy = sign * across[i, j] * pace[i, j], sign * down[i, j] * pace[i, j]
                    if not there or (ux == 0.0 and uy == 0.0):
                        break
                    x, y = x + ux, y + uy
                    total += _noise(x, y, grain)
                    count += 1
                    hx, hy = np.floor(x / grain), np.floor(y / grain)
                    if hx != gx or hy != gy:
                        grains += 1
                        gx, gy = hx, hy
            out[row, col] = (total / count - 0.5) * np.sqrt(12.0 * grains)
