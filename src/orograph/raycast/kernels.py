"""Many rays against a stack of nested windows: the loops that the caster's threads run.

A *window* is a rectangle of samples of one level of the terrain; windows are nested, the outermost and coarsest first.
A ray is cut by their borders into at most 2·W − 1 stretches, each on the finest window that contains it, and runs
through them in order. Where two levels disagree at a border, the change of side is a hit on the border: no crack can be
seen through.

Pixels of a pinhole camera are taken in blocks whose rays begin where a common *front* stops (see ``fronts``).
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.raycast.fronts import advance, directions, grazes, row_slope, wedge
from orograph.raycast.march import ABOVE, BELOW, UNKNOWN, march_row
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
    SCALE,
    SOUTH,
    STRIDE,
    WEST,
)
from orograph.raycast.traverse import cast, clip

INF = np.inf

BLOCK_X, BLOCK_Y, STRIP, THIN, LOW = 64, 16, 16, 8, 4
"""Pixels: a block; the strips of columns in it; the thin strips in those; and how many rows of a strip without a wedge
share a beam."""


@kernel
def ray(scene, ints, floats, low, high, ox, oy, oz, dx, dy, dz, t0, t1, side, level, spans):
    """The first hit of one ray with the stack: (t, window), t = inf if there is none.

    ``side``: of the surface at t0 if the ray is over the terrain there (0 unknown). ``level``: where in the pyramids to
    begin. ``spans`` (W, 2): scratch.
    """
    pool, maxima, minima, mips = scene
    a, b = clip(oz, dz, low, high, t0, t1)
    if a > t0:
        side = 1 if dz < 0.0 else -1
    began = a
    windows = ints.shape[0]
    inner = 0
    for w in range(windows):
        f = floats[w]
        a, b = clip(ox, dx, f[WEST], f[EAST], a, b)
        a, b = clip(oy, dy, f[NORTH], f[SOUTH], a, b)
        if a > b:
            break
        spans[w, 0], spans[w, 1] = a, b
        inner = w + 1
    # A ray that comes in through a side wall may run above or below the surface.
    if inner > 0 and spans[0, 0] > began:
        side = 0
    for stretch in range(2 * inner - 1):
        w = stretch if stretch < inner else 2 * inner - 2 - stretch
        if stretch < inner:
            a, b = spans[w, 0], (spans[w + 1, 0] if w + 1 < inner else spans[w, 1])
        else:
            a, b = spans[w + 1, 1], spans[w, 1]
        if a >= b and windows > 1:
            continue
        f, n = floats[w], ints[w]
        k = f[INVERSE]
        m0, m1 = n[MIP_FIRST], n[MIP_FIRST] + n[MIP_COUNT]
        t, side = cast(
            pool,
            n[BASE],
            n[STRIDE],
            n[CELLS_X],
            n[CELLS_Y],
            maxima,
            mips[0, m0:m1],
            minima,
            mips[1, m0:m1],
            mips[2, m0:m1],
            (ox - f[ORIGIN_X]) * k,
            (oy - f[ORIGIN_Y]) * k,
            oz,
            dx * k,
            dy * k,
            dz,
            a,
            b,
            side,
            level,
        )
        if t < INF:
            return t, w
    return INF, -1


@kernel
def cast_rays(scene, ints, floats, low, high, origins, directions, t0, t1, out, which, first, last):
    """Rays [first, last) of arrays (n, 3); ``out`` float64 (n,): t (NaN: none), ``which`` int8 (n,): the window hit."""
    spans = np.empty((ints.shape[0], 2))
    for i in range(first, last):
        o, d = origins[i], directions[i]
        t, w = ray(scene, ints, floats, low, high, o[0], o[1], o[2], d[0], d[1], d[2], t0, t1, 0, 6, spans)
        out[i] = t if t < INF else np.nan
        which[i] = w


@kernel
def finish(scene, ints, floats, low, high, o, d0, du, dv, t0, t1, x0, x1, y0, y1, corner, out, which, spans):
    """Cast the rays that ``march_row`` left."""
    for py in range(y0, y1):
        for px in range(x0, x1):
            w = which[py - corner[0], px - corner[1]]
            if w > ABOVE:
                continue
            side = 1 if w == ABOVE else -1 if w == BELOW else 0
            t, w = ray(
                scene,
                ints,
                floats,
                low,
                high,
                o[0],
                o[1],
                o[2],
                d0[0] + px * du[0] + py * dv[0],
                d0[1] + px * du[1] + py * dv[1],
                d0[2] + px * du[2] + py * dv[2],
                max(t0, out[py - corner[0], px - corner[1]]),
                t1,
                side,
                2,
                spans,
            )
            out[py - corner[0], px - corner[1]] = t if t < INF else np.nan
            which[py - corner[0], px - corner[1]] = w


@kernel
def cast_pinhole(scene, ints, floats, low, high, o, d0, du, dv, t0, t1, clear, x0, x1, y0, y1, corner, out, which):
    """Pixels [x0, x1) × [y0, y1) of a pinhole camera at ``o``: direction d0 + px·du + py·dv through pixel (px, py).

    ``corner``: (row, col) of the pixel that ``out`` and ``which`` begin with. ``clear``: the eye is known to be above
    the surface (or beside it), so that fronts may be pushed from there.

    (One function, though long: block, strip and pixel narrow the same dozen numbers, which calls would pass on.)
    """
    windows = ints.shape[0]
    top, left = corner
    spans = np.empty((windows, 2))
    starts = np.empty(STRIP)
    thin = np.empty((STRIP // THIN, 7))  # xa, xb, ya, yb, front, step, ground
    # Beyond its farthest corner no ray is over the terrain.
    edge_x = max(abs(o[0] - floats[0, WEST]), abs(o[0] - floats[0, EAST]))
    edge_y = max(abs(o[1] - floats[0, NORTH]), abs(o[1] - floats[0, SOUTH]))
    edge = np.hypot(edge_x, edge_y) * (1.0 + 1e-9) + 1e-9
    # Along this direction the slope of an upright camera's rays is the same all along a row.
    length = np.hypot(du[0], du[1])
    gx, gy = (-du[1] / length, du[0] / length) if length > 0.0 else (1.0, 0.0)
    if gx * (d0[0] + x1 * du[0] + y0 * dv[0]) + gy * (d0[1] + x1 * du[1] + y0 * dv[1]) < 0.0:
        gx, gy = -gx, -gy
    for by in range(y0, y1, BLOCK_Y):
        for bx in range(x0, x1, BLOCK_X):
            ey, ex = min(by + BLOCK_Y, y1), min(bx + BLOCK_X, x1)
            if not clear:
                out[by - top : ey - top, bx - left : ex - left] = t0
                which[by - top : ey - top, bx - left : ex - left] = UNKNOWN
                finish(scene, ints, floats, low, high, o, d0, du, dv, t0, t1, bx, ex, by, ey, corner, out, which, spans)
                continue
            xa, xb, ya, yb, slope = wedge(d0, du, dv, gx, gy, bx, ex, by, ey)
            wedged = xa <= xb and grazes(d0, du, dv, gx, gy, bx, ex, by, ey)
            if wedged:
                end, speed = edge, 1.0
            else:
                xa, xb, ya, yb, slope = directions(d0, du, dv, bx, ex, by, ey)
                end, speed = t1, max(max(abs(xa), abs(xb)), max(abs(ya), abs(yb))) + 1e-300
            finest = floats[windows - 1, SCALE]
            first, step, _ = advance(
                scene, ints, floats, high, o, xa, xb, ya, yb, slope, 0.0, end, 16.0 * finest / speed
            )
            if first >= end:
                out[by - top : ey - top, bx - left : ex - left] = np.nan
                which[by - top : ey - top, bx - left : ex - left] = -1
                continue
            for sx in range(bx, ex, STRIP):
                fx = min(sx + STRIP, ex)
                front, tried, ground = first, step, -INF
                upward = False
                lowest = -INF
                if wedged:
                    xa, xb, ya, yb, _ = wedge(d0, du, dv, gx, gy, sx, fx, by, ey)
                    for j in range((fx - sx + THIN - 1) // THIN):
                        a = sx + j * THIN
                        b = min(a + THIN, fx)
                        thin[j, 0], thin[j, 1], thin[j, 2], thin[j, 3], _ = wedge(d0, du, dv, gx, gy, a, b, by, ey)
                    thin[:, 4], thin[:, 5], thin[:, 6] = first, step, -INF
                    upper, _ = row_slope(d0, du, dv, gx, gy, sx, fx, by)
                    lower, _ = row_slope(d0, du, dv, gx, gy, sx, fx, ey - 1)
                    upward = upper >= lower
                for row in range(ey - by):
                    py = ey - 1 - row if upward else by + row
                    if wedged:
                        slope, fastest = row_slope(d0, du, dv, gx, gy, sx, fx, py)
                        if slope < lowest:  # a turned camera: this row does not see over the one before
                            front, tried, ground = first, step, -INF
                            thin[:, 4], thin[:, 5], thin[:, 6] = first, step, -INF
                        lowest = slope
                        if o[2] + (front if slope >= 0.0 else front + tried) * slope > ground:
                            front, tried, ground = advance(
                                scene, ints, floats, high, o, xa, xb, ya, yb, slope, front, end, tried
                            )
                        for j in range((fx - sx + THIN - 1) // THIN if front < end else 0):
                            if front > thin[j, 4]:
                                thin[j, 4], thin[j, 5], thin[j, 6] = front, tried, -INF
                            s = thin[j, 4]
                            if o[2] + (s if slope >= 0.0 else s + thin[j, 5]) * slope > thin[j, 6]:
                                thin[j, 4], thin[j, 5], thin[j, 6] = advance(
                                    scene,
                                    ints,
                                    floats,
                                    high,
                                    o,
                                    thin[j, 0],
                                    thin[j, 1],
                                    thin[j, 2],
                                    thin[j, 3],
                                    slope,
                                    s,
                                    end,
                                    thin[j, 5],
                                )
                            for i in range(j * THIN, (j + 1) * THIN):
                                starts[i] = thin[j, 4] / fastest
                    elif row % LOW == 0:
                        upto = min(py + LOW, ey)
                        xa, xb, ya, yb, slope = directions(d0, du, dv, sx, fx, py, upto)
                        front, tried, ground = advance(
                            scene, ints, floats, high, o, xa, xb, ya, yb, slope, first, end, step
                        )
                        starts[:] = front
                    if front >= end:
                        out[py - top, sx - left : fx - left] = np.nan
                        which[py - top, sx - left : fx - left] = -1
                        continue
                    # The finest window that holds the middle of the row where it begins.
                    x, y = o[0] + 0.5 * front * (xa + xb), o[1] + 0.5 * front * (ya + yb)
                    w = 0
                    while w + 1 < windows and holds(floats, w + 1, x, y):
                        w += 1
                    march_row(
                        scene,
                        (w, ints[w, BASE], ints[w, STRIDE], ints[w, CELLS_X], ints[w, CELLS_Y], ints[w, MIP_FIRST]),
                        local_rectangle(floats, w, w),
                        local_rectangle(floats, w + 1, w) if w + 1 < windows else (1.0, 1.0, 0.0, 0.0),
                        low,
                        high,
                        local(floats, w, o[0] - floats[w, ORIGIN_X], o[1] - floats[w, ORIGIN_Y], o[2]),
                        local(floats, w, d0[0], d0[1], d0[2]),
                        local(floats, w, du[0], du[1], du[2]),
                        local(floats, w, dv[0], dv[1], dv[2]),
                        py,
                        sx,
                        fx,
                        starts,
                        (xb - xa) * front < 16.0 * floats[w, SCALE],
                        t0,
                        t1,
                        corner,
                        out,
                        which,
                    )
                finish(scene, ints, floats, low, high, o, d0, du, dv, t0, t1, sx, fx, by, ey, corner, out, which, spans)


@inlined
def holds(floats, w, x, y):
    """Whether a window's rectangle holds a place."""
    return floats[w, WEST] <= x and x <= floats[w, EAST] and floats[w, NORTH] <= y and y <= floats[w, SOUTH]


@inlined
def local(floats, w, x, y, z):
    """A vector in a window's own samples."""
    k = floats[w, INVERSE]
    return x * k, y * k, z


@inlined
def local_rectangle(floats, w, v):
    """(west, north, east, south) of window ``w`` in the samples of window ``v``."""
    k = floats[v, INVERSE]
    x, y = floats[v, ORIGIN_X], floats[v, ORIGIN_Y]
    return (
        (floats[w, WEST] - x) * k,
        (floats[w, NORTH] - y) * k,
        (floats[w, EAST] - x) * k,
        (floats[w, SOUTH] - y) * k,
    )
