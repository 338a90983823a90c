"""The skyline in one azimuth, seen from points on the ground: the steepest slope to any ground in that direction.

One walk answers how much of a light's disc is seen: it begins with the slope below which nothing matters (the disc's
lower limb), passes over all nodes whose maximum lies under the line of that slope, raises the slope where the ground
stands above it, and ends as soon as the upper limb is covered. The profile along the walk is the surface itself, cut
exactly: straight pieces between the crossings of cell borders and diagonals, so its steepest slope lies at a crossing.
Coordinates as in ``traverse``; slopes are rise over horizontal distance, both in metres.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel, leaf
from orograph.raycast.tables import (
    BASE,
    CELLS_X,
    CELLS_Y,
    EAST,
    INVERSE,
    MIP_COUNT,
    MIP_FIRST,
    NORTH,
    ORIGIN_X,
    ORIGIN_Y,
    SOUTH,
    STRIDE,
    WEST,
)
from orograph.raycast.traverse import clip, plane_height

INF = np.inf


@leaf
def steepest(scene, window, o, d, s0, s1, slope, enough):
    """The larger of ``slope`` and the steepest slope from o, (x, y, z), to the ground at o + s·d, s in [s0, s1] metres.

    d is the step (x, y) in the terrain's samples for one metre; the walk stays on the window's cells and stops once
    ``enough`` is reached.
    """
    pool, maxima, mips, ints, floats = scene.pool, scene.maxima, scene.mips, scene.ints, scene.floats
    base, stride = ints[window, BASE], ints[window, STRIDE]
    nc, nr = ints[window, CELLS_X], ints[window, CELLS_Y]
    finest, top = ints[window, MIP_FIRST], ints[window, MIP_COUNT] - 1
    k = floats[window, INVERSE]
    ox, oy, oz = (o[0] - floats[window, ORIGIN_X]) * k, (o[1] - floats[window, ORIGIN_Y]) * k, o[2]
    dx, dy = d[0] * k, d[1] * k
    ix = 1.0 / dx if dx != 0.0 else 0.0
    iy = 1.0 / dy if dy != 0.0 else 0.0
    right, down = dx > 0.0, dy > 0.0
    s = s0
    level = 0
    cx = min(max(np.int64(np.floor(ox + s * dx)), 0), nc - 1)
    cy = min(max(np.int64(np.floor(oy + s * dy)), 0), nr - 1)
    while True:
        jx, jy = cx >> level, cy >> level
        sx = INF if dx == 0.0 else ((((jx + 1) << level) if right else (jx << level)) - ox) * ix
        sy = INF if dy == 0.0 else ((((jy + 1) << level) if down else (jy << level)) - oy) * iy
        se = max(min(min(sx, sy), s1), s)
        if level >= 1:
            line = oz + slope * (s if slope >= 0.0 else se)
            if maxima[mips[0, finest + level] + jy * mips[2, finest + level] + jx] > line:
                level -= 1
                continue
        else:
            i = base + cy * stride + cx
            a, b = np.float64(pool[i]), np.float64(pool[i + 1])
            c, d = np.float64(pool[i + stride]), np.float64(pool[i + stride + 1])
            if max(max(a, b), max(c, d)) - oz > slope * (s if slope >= 0.0 else se) or (a + b + c + d != a + b + c + d):
                even = ((cx + cy) & 1) == 0
                u0, v0 = ox + s * dx - cx, oy + s * dy - cy
                u1, v1 = ox + se * dx - cx, oy + se * dy - cy
                g0 = u0 - v0 if even else 1.0 - u0 - v0
                g1 = u1 - v1 if even else 1.0 - u1 - v1
                if s > 0.0:
                    slope = max_slope(
                        slope, plane_height(a, b, c, d, u0, v0, even, g0 > 0.0 or (g0 == 0.0 and g1 > 0.0)) - oz, s
                    )
                if g0 * g1 < 0.0:  # at the diagonal, on either triangle: the other may be missing
                    f = g0 / (g0 - g1)
                    u, v, at = u0 + f * (u1 - u0), v0 + f * (v1 - v0), s + f * (se - s)
                    slope = max_slope(slope, plane_height(a, b, c, d, u, v, even, True) - oz, at)
                    slope = max_slope(slope, plane_height(a, b, c, d, u, v, even, False) - oz, at)
                slope = max_slope(
                    slope, plane_height(a, b, c, d, u1, v1, even, g1 > 0.0 or (g1 == 0.0 and g0 > 0.0)) - oz, se
                )
                if slope >= enough:
                    return slope
        if se >= s1:
            return slope
        s = se
        if sx <= sy:
            climb = ((jx & 1) == 1) == right
            cx = ((jx + 1) << level) if right else (jx << level) - 1
            if cx < 0 or cx >= nc:
                return slope
            cy = min(max(np.int64(np.floor(oy + s * dy)), jy << level), min(((jy + 1) << level), nr) - 1)
        else:
            climb = ((jy & 1) == 1) == down
            cy = ((jy + 1) << level) if down else (jy << level) - 1
            if cy < 0 or cy >= nr:
                return slope
            cx = min(max(np.int64(np.floor(ox + s * dx)), jx << level), min(((jx + 1) << level), nc) - 1)
        if climb and level < top:
            level += 1


@leaf
def max_slope(slope, rise, distance):
    """The larger of ``slope`` and rise / distance; a missing rise (NaN) or no distance changes nothing."""
    if distance > 0.0 and rise > slope * distance:
        return rise / distance
    return slope


@kernel
def skylines(scene, points, dx, dy, skip, lower, enough, out, first, last):
    """Skyline slopes from ``points`` [first, last), (n, 3): at least ``lower``, at most the first found ≥ ``enough``.

    ``skip`` (n,): horizontal metres left out next to the point, where the ground is its own facet and the shading
    normal decides. Windows are walked as in ``kernels.ray``.
    """
    floats = scene.floats
    windows = floats.shape[0]
    enter, leave = np.empty(windows), np.empty(windows)
    for i in range(first, last):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        slope = lower
        if z != z:
            out[i] = np.nan
            continue
        a, b = skip[i], INF
        if slope > 0.0:
            b = (scene.high - z) / slope  # beyond, nothing reaches up to the line
        inner = 0
        for w in range(windows):
            a, b = clip(x, dx, floats[w, WEST], floats[w, EAST], a, b)
            a, b = clip(y, dy, floats[w, NORTH], floats[w, SOUTH], a, b)
            if a > b:
                break
            enter[w], leave[w] = a, b
            inner = w + 1
        for stretch in range(2 * inner - 1):
            w = stretch if stretch < inner else 2 * inner - 2 - stretch
            if stretch < inner:
                a, b = enter[w], (enter[w + 1] if w + 1 < inner else leave[w])
            else:
                a, b = leave[w + 1], leave[w]
            if a >= b:
                continue
            slope = steepest(scene, w, (x, y, z), (dx, dy), a, b, slope, enough)
            if slope >= enough:
                break
        out[i] = slope
