"""The inner loop of contour lines (``scene.annotations.contours``): how much of each pixel a line covers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.rendering.lookup import BESIDE, SHORE, bilinear, within_map

CLOSE = 3.0, 7.0
"""Pixels between lines at which they are gone, and from which on they are whole."""

AROUND, WIDE = 6.0, 4.0
"""Pixels from a pixel to the four places beside it whose slopes tell how dense lines are around, and over which those
are averaged."""

LEVEL = 5e-5, 2e-4
"""Slopes at which ground is too level to have a contour, and from which on it has one."""


class Seen(NamedTuple):
    """The ground that pixels (n,) show.

    Attributes:
        points: (n, 3) sample coordinates and height, metres. heights: (n,) that lines are of, metres.
        gradient: (n, 2) of heights, metres per sample along columns and rows. drawn: (n, 2) of what is seen, if that
            is another surface (a mesh), else the same.
        to_world: (2, 2) gradients per sample → per metre.
    """

    points: NDArray[np.float64]
    heights: NDArray[np.float64]
    gradient: NDArray[np.float64]
    drawn: NDArray[np.float64]
    to_world: NDArray[np.floating]


class Lines(NamedTuple):
    """Contour lines: interval, metres; every how many a thick line, 0: none; width, pixels."""

    interval: float
    every: int
    width: float


@kernel
def _ramp(low, high, x):
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@inlined
def _ray(basis, px, py, t):
    """The direction of a pixel's ray, and a pixel's steps across and down at its end: east, north, up."""
    _, ou, ov, d0, du, dv = basis
    d = d0[0] + px * du[0] + py * dv[0], d0[1] + px * du[1] + py * dv[1], d0[2] + px * du[2] + py * dv[2]
    u = ou[0] + t * du[0], ou[1] + t * du[1], ou[2] + t * du[2]
    v = ov[0] + t * dv[0], ov[1] + t * dv[1], ov[2] + t * dv[2]
    return d, u, v


@inlined
def _rate(gradient, drawn, to_world, ray):
    """Metres of height from pixel to pixel, the most on the screen, and the slope, metres per metre.

    ``gradient`` (2,) is of heights, ``drawn`` of the tangent plane, per sample; ``ray`` as of ``_ray``.
    """
    (dx, dy, dz), (ux, uy, uz), (vx, vy, vz) = ray
    (a, b), (c, d) = gradient, drawn
    gx = to_world[0, 0] * a + to_world[0, 1] * b
    gy = to_world[1, 0] * a + to_world[1, 1] * b
    hx = to_world[0, 0] * c + to_world[0, 1] * d
    hy = to_world[1, 0] * c + to_world[1, 1] * d
    facing = dz - hx * dx - hy * dy
    if facing == 0.0:
        return np.inf, np.sqrt(gx * gx + gy * gy)
    u, v = (uz - hx * ux - hy * uy) / facing, (vz - hx * vx - hy * vy) / facing
    across = gx * (ux - u * dx) + gy * (uy - u * dy)
    down = gx * (vx - v * dx) + gy * (vy - v * dy)
    return max(np.sqrt(across * across + down * down), 1e-9), np.sqrt(gx * gx + gy * gy)


@inlined
def _nearest(height, lines):
    """The number of the line nearest to a height, and whether it is a thick one."""
    nearest = np.floor(height / lines.interval + 0.5)
    every = lines.every
    return nearest, every > 0 and nearest - every * np.floor(nearest / max(every, 1) + 0.5) == 0


@kernel
def line_cover(px, py, t, seen, basis, lines, water, place, casing, out):
    """Part of each pixel (n,) that contour lines cover.

    Args:
        px, py: pixel positions. t: depths, NaN where there is no ground. basis: ``View.ray_basis``, true space.
        seen: ``Seen``. lines: ``Lines``. water: the field of water, place: where it lies (``kernels.compose``).
        casing: pixels more to each side.
        out: (n,) float32.
    """
    points, heights = seen.points, seen.heights
    for i in range(len(t)):
        out[i] = 0.0
        if t[i] != t[i] or heights[i] != heights[i]:
            continue
        # The height's derivative along the screen's axes, over the tangent plane.
        gradient, drawn = (seen.gradient[i, 0], seen.gradient[i, 1]), (seen.drawn[i, 0], seen.drawn[i, 1])
        rate, slope = _rate(gradient, drawn, seen.to_world, _ray(basis, px[i], py[i], t[i]))
        nearest, thick = _nearest(heights[i], lines)
        away = abs(heights[i] / lines.interval - nearest) * lines.interval / rate
        half = lines.width if thick and nearest != 0.0 else 0.5 * lines.width  # a shore is a thin line
        half += casing
        apart = lines.interval / rate * (lines.every if thick else 1)
        cover = min(max(half - away + 0.5, 0.0), 1.0) * _ramp(CLOSE[0], CLOSE[1], apart)
        cover *= _ramp(LEVEL[0], LEVEL[1], slope)
        if cover > 0.0 and water.shape[0] > 0:
            x, y = within_map(place, points[i, 0], points[i, 1])
            dry, wet = BESIDE if nearest == 0.0 else (0.5 - SHORE, 0.5 + SHORE)
            cover *= 1.0 - _ramp(dry, wet, bilinear(water, x, y))
        out[i] = cover


@kernel
def thin_out(px, py, t, heights, around, to_world, basis, lines, cover):
    """Lessen ``cover`` (n,) where lines run together in the ground around: of such lines nothing is left on a ledge.

    Args:
        around: (k, n, 2) gradients of the ground at k places around each pixel. Others as for ``line_cover``.
    """
    for i in range(len(t)):
        ray = _ray(basis, px[i], py[i], t[i])
        total = 0.0
        for k in range(len(around)):
            gradient = around[k, i, 0], around[k, i, 1]
            rate, _ = _rate(gradient, gradient, to_world, ray)
            total += min(rate, 1e6)
        _, thick = _nearest(heights[i], lines)
        apart = lines.interval * (lines.every if thick else 1) * len(around) / max(total, 1e-9)
        cover[i] *= _ramp(CLOSE[0], CLOSE[1], apart)
