"""The inner loop of contour lines (``scene.annotations.contours``): how much of each pixel a line covers."""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.rendering.lookup import SHORE, bilinear

CLOSE = 3.0, 7.0
"""Pixels between lines at which they are gone, and from which on they are whole."""

AROUND, WIDE = 6.0, 4.0
"""Pixels from a pixel to the four places beside it whose slopes tell how dense lines are around, and over which those
are averaged."""

LEVEL = 5e-5, 2e-4
"""Slopes at which ground is too level to have a contour, and from which on it has one."""


@kernel
def _ramp(low, high, x):
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@inlined
def _rate(a, b, c, d, to_world, ux, uy, uz, vx, vy, vz, dx, dy, dz):
    """Metres of height from pixel to pixel, the most on the screen, and the slope, metres per metre.

    (a, b) is the gradient of heights, (c, d) that of the tangent plane, per sample; u and v are a pixel's steps at the
    ray's end, d its direction: east, north, up.
    """
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


@kernel
def line_cover(
    px, py, t, points, heights, gradient, drawn, water, scale, row0, col0, to_world, basis, interval, index, width,
    casing, out
):  # fmt: skip
    """Part of each pixel (n,) that contour lines cover.

    Args:
        px, py: pixel positions. t: depths, NaN where there is no ground.
        points: (n, 3) sample coordinates and height, metres. heights: (n,) that lines are of, metres.
        gradient: (n, 2) of heights, metres per sample along columns and rows. drawn: (n, 2) of what is seen, if that
            is another surface (a mesh), else the same. water: the field of water, scale, row0, col0:
            where it lies (``kernels.compose``).
        to_world: (2, 2) gradients per sample → per metre.
        basis: (6, 3) of ``View.ray_basis``, true space.
        interval: metres; index: every how many a thick line, 0: none; width: pixels. casing: pixels more to each side.
        out: (n,) float32.
    """
    ou, ov, d0, du, dv = basis[1], basis[2], basis[3], basis[4], basis[5]
    for i in range(len(t)):
        out[i] = 0.0
        if t[i] != t[i] or heights[i] != heights[i]:
            continue
        dx = d0[0] + px[i] * du[0] + py[i] * dv[0]
        dy = d0[1] + px[i] * du[1] + py[i] * dv[1]
        dz = d0[2] + px[i] * du[2] + py[i] * dv[2]
        # The height's derivative along the screen's axes, over the tangent plane.
        ux, uy, uz = ou[0] + t[i] * du[0], ou[1] + t[i] * du[1], ou[2] + t[i] * du[2]
        vx, vy, vz = ov[0] + t[i] * dv[0], ov[1] + t[i] * dv[1], ov[2] + t[i] * dv[2]
        rate, slope = _rate(
            gradient[i, 0], gradient[i, 1], drawn[i, 0], drawn[i, 1], to_world, ux, uy, uz, vx, vy, vz, dx, dy, dz
        )
        n = heights[i] / interval
        nearest = np.floor(n + 0.5)
        away = abs(n - nearest) * interval / rate
        thick = index > 0 and nearest - index * np.floor(nearest / max(index, 1) + 0.5) == 0
        half = width if thick and nearest != 0.0 else 0.5 * width  # a shore is a thin line
        half += casing
        apart = interval / rate * (index if thick else 1)
        cover = min(max(half - away + 0.5, 0.0), 1.0) * _ramp(CLOSE[0], CLOSE[1], apart)
        cover *= _ramp(LEVEL[0], LEVEL[1], slope)
        if cover > 0.0 and water.shape[0] > 0:
            x = (points[i, 0] + 0.5) / scale - 0.5 - col0
            y = (points[i, 1] + 0.5) / scale - 0.5 - row0
            cover *= 1.0 - _ramp(0.5 - SHORE, 0.5 + SHORE, bilinear(water, x, y))
        out[i] = cover


@kernel
def thin_out(px, py, t, heights, around, to_world, basis, interval, index, cover):
    """Lessen ``cover`` (n,) where lines run together in the ground around: of such lines nothing is left on a ledge.

    Args:
        around: (k, n, 2) gradients of the ground at k places around each pixel. Others as for ``line_cover``.
    """
    ou, ov, d0, du, dv = basis[1], basis[2], basis[3], basis[4], basis[5]
    for i in range(len(t)):
        dx = d0[0] + px[i] * du[0] + py[i] * dv[0]
        dy = d0[1] + px[i] * du[1] + py[i] * dv[1]
        dz = d0[2] + px[i] * du[2] + py[i] * dv[2]
        ux, uy, uz = ou[0] + t[i] * du[0], ou[1] + t[i] * du[1], ou[2] + t[i] * du[2]
        vx, vy, vz = ov[0] + t[i] * dv[0], ov[1] + t[i] * dv[1], ov[2] + t[i] * dv[2]
        total = 0.0
        for k in range(len(around)):
            a, b = around[k, i, 0], around[k, i, 1]
            rate, _ = _rate(a, b, a, b, to_world, ux, uy, uz, vx, vy, vz, dx, dy, dz)
            total += min(rate, 1e6)
        nearest = np.floor(heights[i] / interval + 0.5)
        thick = index > 0 and nearest - index * np.floor(nearest / max(index, 1) + 0.5) == 0
        apart = interval * (index if thick else 1) * len(around) / max(total, 1e-9)
        cover[i] *= _ramp(CLOSE[0], CLOSE[1], apart)
