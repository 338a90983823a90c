"""Openness: how wide the view is from a sample upwards, or into the ground downwards.

Yokoyama, Shirasawa & Pike 2002, "Visualizing Topography by Openness: A New Application of Image Processing to Digital
Elevation Models", PE&RS 68(3). *Positive* openness is the mean over azimuths of the largest zenith angle at which the
sky is visible, 90° − β, with β the highest elevation angle along the azimuth, within the radius or without limit;
unlike for the sky, β may be negative: 90° on any plane, more on ridges, less in valleys. *Negative* openness is the
mean nadir angle, 90° + δ, with δ the lowest elevation angle: the positive openness of the terrain turned upside down.
It is not the complement of the positive one.

Azimuths in which the terrain ends at a sample (a border, or only missing samples) are left out of the mean.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.lighting.context import Context
from orograph.lighting.gather import Sweep, Window
from orograph.lighting.products import Product
from orograph.lighting.sky import arctangent
from orograph.lighting.sweep import Block

Values = NDArray[np.float32]


@kernel
def _angles(slopes: Values, total: Values, count: Values) -> None:
    """Add the zenith angles of one azimuth's horizons, radians, and count them."""
    zero, one, right = np.float32(0.0), np.float32(1.0), np.float32(0.5 * np.pi)
    for j in range(len(total)):
        t = slopes[j]
        a = arctangent(abs(t))
        angle = right - (a if t >= zero else -a)
        known = t > np.float32(-np.inf)
        total[j] += angle if known or t != t else zero
        count[j] += one if known else zero


@kernel
def _add_angles(
    slopes: Values, cols: int, first: int, last: int, row0: int, col0: int, total: Values, count: Values
) -> None:
    """Add all azimuths to the rows [first, last) of a window ``cols`` wide."""
    for i in range(first, last):
        for k in range(slopes.shape[0]):
            row, at = row0 + i, slice(col0, col0 + cols)
            _angles(slopes[k, i, :cols], total[row, at], count[row, at])


def _openness(below: bool) -> Product:
    def make(context: Context) -> Sweep:
        def add(canvas: Values, block: Block, first: int, last: int) -> None:
            cols = block.col1 - block.col0
            _add_angles(block.padded, cols, first, last, block.row0, block.col0, canvas[0], canvas[1])

        def finish(canvas: Values, window: Window) -> Values:
            total, count = canvas[:, window[0] : window[1], window[2] : window[3]]
            out = np.full(total.shape, np.nan, np.float32)
            np.divide(total, count, out=out, where=count > 0)
            return np.degrees(out)[None]

        return Sweep(context.options.directions(), 2, add, finish, lowest=-np.inf, below=below)

    name = "openness-negative" if below else "openness"
    side = "nadir angle of the ground's underside" if below else "zenith angle of the horizon"
    return Product(name, lambda _: [name], "degrees", f"mean {side} (Yokoyama et al. 2002)", make, (0.0, 180.0))


PRODUCTS = (_openness(False), _openness(True))
