"""Many rays against a stack of nested windows: the loops that the caster's threads run.

A *window* is a rectangle of samples of one level of the terrain; windows are nested, the outermost and coarsest first.
A ray is cut by their borders into at most 2·W − 1 stretches, each on the finest window that contains it, and runs
through them in order. Where two levels disagree at a border, the change of side is a hit on the border: no crack can be
seen through.

What a pinhole camera and a height field give beyond a general ray tracer: the rays of a block of pixels lie in one thin
pyramid, which is marched first (`beam`): as long as the pyramid's lower side stays above the maximum of the ground
below it, none of its rays hits, and all begin their own walk there, a cell or two before the surface. Blocks hand their
start down to the smaller blocks in them (Amanatides 1984, *Ray tracing with cones*, is the ancestor).
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel
from orograph.raycast.traverse import cast, clip, highest, march_block

# Columns of the windows' tables (see stack.py): integers and floats of each window.
BASE, STRIDE, CELLS_X, CELLS_Y, MIP_FIRST, MIP_COUNT = range(6)
ORIGIN_X, ORIGIN_Y, SCALE, WEST, NORTH, EAST, SOUTH = range(7)


@kernel
def ray(pool, maxima, minima, mips, ints, floats, low, high, ox, oy, oz, dx, dy, dz, t0, t1, clear):
    """The first hit of one ray with the stack: (t, window), t = inf if there is none.

    ``clear``: known to be above the ground at t0.
    """
    a, b = clip(oz, dz, low, high, t0, t1)
    from_above = a > t0 and dz < 0.0
    began = a
    windows = ints.shape[0]
    enter, leave = np.empty(windows), np.empty(windows)
    inner = 0
    for w in range(windows):
        f = floats[w]
        a, b = clip(ox, dx, f[WEST], f[EAST], a, b)
        a, b = clip(oy, dy, f[NORTH], f[SOUTH], a, b)
        if a > b:
            break
        enter[w], leave[w] = a, b
        inner = w + 1
    # A ray that comes in through a side wall may run below the surface; one through the ceiling, or clear, runs above.
    side = 1 if inner > 0 and enter[0] == began and (clear or from_above) else 0
    for stretch in range(2 * inner - 1):
        w = stretch if stretch < inner else 2 * inner - 2 - stretch
        if stretch < inner:
            a, b = enter[w], (enter[w + 1] if w + 1 < inner else leave[w])
        else:
            a, b = leave[w + 1], leave[w]
        if a >= b and windows > 1:
            continue
        f, n = floats[w], ints[w]
        k = 1.0 / f[SCALE]
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
            2 if clear else 6,
        )
        if t < np.inf:
            return t, w
    return np.inf, -1


@kernel
def cast_rays(
    pool, maxima, minima, mips, ints, floats, low, high, origins, directions, t0, t1, out, which, first, last
):
    """Rays [first, last) of arrays (n, 3); ``out`` float64 (n,): t (NaN: none), ``which`` int8 (n,): the window hit."""
    for i in range(first, last):
        o, d = origins[i], directions[i]
        t, w = ray(
            pool, maxima, minima, mips, ints, floats, low, high, o[0], o[1], o[2], d[0], d[1], d[2], t0, t1, False
        )
        out[i] = t if t < np.inf else np.nan
        which[i] = w


@kernel
def beam(maxima, mips, ints, floats, high, o, corners, t, t1, first):
    """How far a pyramid of rays o + t·d, d spanned by four ``corners`` (4, 3), stays above the ground.

    The answer is at most the first hit of any of its rays.
    """
    windows = ints.shape[0]
    finest = floats[windows - 1, SCALE]
    speed = 1e-300
    for c in range(4):
        speed = max(speed, max(abs(corners[c, 0]), abs(corners[c, 1])))
    lowest = min(min(corners[0, 2], corners[1, 2]), min(corners[2, 2], corners[3, 2]))
    if lowest < 0.0 and o[2] > high:  # all of it is in the air above the highest summit until then
        t = max(t, (high - o[2]) / lowest)
    step = first * finest / speed
    while t < t1:
        end = min(t + step, t1)
        x0, x1, y0, y1, z = np.inf, -np.inf, np.inf, -np.inf, np.inf
        wide = 0.0
        for c in range(4):
            for s in (t, end):
                x, y = o[0] + s * corners[c, 0], o[1] + s * corners[c, 1]
                x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
                z = min(z, o[2] + s * corners[c, 2])
            wide = max(wide, max(abs(corners[c, 0] - corners[0, 0]), abs(corners[c, 1] - corners[0, 1])))
        ground = -np.inf
        for w in range(windows):
            f, n = floats[w], ints[w]
            if x1 < f[WEST] or x0 > f[EAST] or y1 < f[NORTH] or y0 > f[SOUTH]:
                continue
            k = 1.0 / f[SCALE]
            m0, m1 = n[MIP_FIRST], n[MIP_FIRST] + n[MIP_COUNT]
            u0, u1 = max(x0, f[WEST]), min(x1, f[EAST])
            v0, v1 = max(y0, f[NORTH]), min(y1, f[SOUTH])
            ground = max(
                ground,
                highest(
                    maxima,
                    mips[0, m0:m1],
                    mips[2, m0:m1],
                    n[CELLS_X],
                    n[CELLS_Y],
                    (u0 - f[ORIGIN_X]) * k,
                    (u1 - f[ORIGIN_X]) * k,
                    (v0 - f[ORIGIN_Y]) * k,
                    (v1 - f[ORIGIN_Y]) * k,
                ),
            )
        if z > ground:
            t = end
            step *= 2.0
        else:
            step *= 0.5
            if step * speed < max(0.5 * finest, 0.125 * wide * t):
                break
    return t


@kernel
def block_corners(d0, du, dv, x0, x1, y0, y1, out):
    """Directions through the outer pixel centres of a block."""
    for k in range(3):
        out[0, k] = d0[k] + x0 * du[k] + y0 * dv[k]
        out[1, k] = d0[k] + (x1 - 1) * du[k] + y0 * dv[k]
        out[2, k] = d0[k] + x0 * du[k] + (y1 - 1) * dv[k]
        out[3, k] = d0[k] + (x1 - 1) * du[k] + (y1 - 1) * dv[k]


FIRST_OUTER, FIRST_INNER = 64.0, 4.0
OUTER_X, OUTER_Y, INNER_X, INNER_Y = 64, 16, 16, 4


@kernel
def cast_pinhole(
    pool, maxima, minima, mips, ints, floats, low, high, o, d0, du, dv, t0, t1, clear, x0, x1, y0, y1, out, which
):
    """Pixels [x0, x1) × [y0, y1) of a pinhole camera at ``o``: direction d0 + px·du + py·dv through pixel (px, py).

    ``clear``: the eye is known to be above the surface (or outside it), so beams may be marched.
    """
    corners = np.empty((4, 3))
    # One window at full resolution (it ends where the terrain does): its own loop, in its own coordinates.
    f, n = floats[0], ints[0]
    single = ints.shape[0] == 1 and f[SCALE] == 1.0
    local = np.array([o[0] - f[ORIGIN_X], o[1] - f[ORIGIN_Y], o[2]])
    for by in range(y0, y1, OUTER_Y):
        for bx in range(x0, x1, OUTER_X):
            ey, ex = min(by + OUTER_Y, y1), min(bx + OUTER_X, x1)
            start = t0
            if clear:
                block_corners(d0, du, dv, bx, ex, by, ey, corners)
                start = beam(maxima, mips, ints, floats, high, o, corners, t0, t1, FIRST_OUTER)
            for sy in range(by, ey, INNER_Y):
                for sx in range(bx, ex, INNER_X):
                    fy, fx = min(sy + INNER_Y, ey), min(sx + INNER_X, ex)
                    near = start
                    if clear and start < t1:
                        block_corners(d0, du, dv, sx, fx, sy, fy, corners)
                        near = beam(maxima, mips, ints, floats, high, o, corners, start, t1, FIRST_INNER)
                    if near >= t1:
                        out[sy:fy, sx:fx] = np.nan
                        which[sy:fy, sx:fx] = -1
                    elif single:
                        march_block(
                            pool,
                            n[BASE],
                            n[STRIDE],
                            n[CELLS_X],
                            n[CELLS_Y],
                            maxima,
                            mips[0],
                            minima,
                            mips[1],
                            mips[2],
                            local,
                            d0,
                            du,
                            dv,
                            sx,
                            fx,
                            sy,
                            fy,
                            near,
                            t1,
                            clear,
                            out,
                            which,
                        )
                    else:
                        for py in range(sy, fy):
                            for px in range(sx, fx):
                                t, w = ray(
                                    pool,
                                    maxima,
                                    minima,
                                    mips,
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
                                    near,
                                    t1,
                                    clear,
                                )
                                out[py, px] = t if t < np.inf else np.nan
                                which[py, px] = w
