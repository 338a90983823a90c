"""Packets: eight rays walked from cell to cell side by side (see ``_lanes``).

Steps of fixed size (Amanatides & Woo 1987): where ``traverse.cast`` climbs and descends, a long chain of dependent
operations for each step, this adds a constant to one of two parameters. All rays run above the surface until they meet
it, or over a hole. One that comes out of a hole below the surface is left to ``cast``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orograph._lanes import corners, least, most, real, some, spread, where, whole
from orograph._numba import inlined
from orograph.raycast.tables import (
    BASE,
    CELLS_X,
    CELLS_Y,
    EAST,
    INVERSE,
    NORTH,
    ORIGIN_X,
    ORIGIN_Y,
    SOUTH,
    STRIDE,
    WEST,
)

INF = np.inf

ABOVE, UNKNOWN, TIRED, BESIDE = -2, -3, -4, -5
"""``which`` of a ray that is not finished. Above the surface: it leaves its window; it has taken all its steps; it does
not begin in the window. Unknown: it may run on either side."""


class Packet(NamedTuple):
    """Rays o + t·d with 1/d."""

    ox: float
    oy: float
    oz: float
    dx: Any
    dy: Any
    dz: Any
    ix: Any
    iy: Any


@inlined
def inverses(d):
    """(d, 1/d); (0, inf) for components so small that their inverse overflows."""
    none = (d < 1e-150) & (d > -1e-150)
    return where(none, 0.0, d), where(none, INF, 1.0 / d)


@inlined
def clips(o, d, low, high, t0, t1):
    """The parts of [t0, t1] on which o + t·d lies in [low, high]; empty where t0 > t1."""
    level = d == 0.0
    a, b = (low - o) / d, (high - o) / d
    first, last = where(b < a, b, a), where(b < a, a, b)
    within = low <= o and o <= high
    begin, end = where(first > t0, first, t0), where(last < t1, last, t1)
    return where(level, where(spread(within), t0, 1.0), begin), where(level, where(spread(within), t1, 0.0), end)


@inlined
def stretches(rays, t, last, number, rect, inner):
    """(t at which the rays leave the window, to the outside or for a coarser or finer one; whether the latter)."""
    west, north, east, south = rect
    end = last
    out = (where(rays.dx > 0.0, east, west) - rays.ox) * rays.ix
    end = where((out < end) & ((rays.dx > 0.0) | (rays.dx < 0.0)), out, end)
    out = (where(rays.dy > 0.0, south, north) - rays.oy) * rays.iy
    end = where((out < end) & ((rays.dy > 0.0) | (rays.dy < 0.0)), out, end)
    leaves = (end < last) & spread(number > 0)
    if inner[0] < inner[2]:
        a, b = clips(rays.ox, rays.dx, inner[0], inner[2], t, end)
        a, b = clips(rays.oy, rays.dy, inner[1], inner[3], a, b)
        enters = a <= b
        end, leaves = where(enters, a, end), leaves | enters
    return where(end > t, end, t), leaves


@inlined
def within(rect, x, y):
    """Which places a rectangle (west, north, east, south) holds."""
    return (x >= rect[0]) & (x <= rect[2]) & (y >= rect[1]) & (y <= rect[3])


@inlined
def cell_hits(a, b, c, d, even, u0, v0, z0, u1, v1, z1, lost):
    """Intersect passages through cells with their two triangles, as ``traverse.cell_hit`` does.

    Rays run above the surface, or over a hole and are ``lost``.

    Returns:
        s; which rays meet the surface; which do not know on which side of it they are; which are over a hole.
    """
    # Mirrored where the diagonal runs b–c, the triangles lie in a + v·(d − a) + w·(b − a) where w = u − v ≥ 0, and in
    # a + u·(d − a) − w·(c − a) where w ≤ 0: p on the first one that a ray is over, q on the last one.
    u0, u1 = where(even, u0, 1.0 - u0), where(even, u1, 1.0 - u1)
    a, b, c, d = where(even, a, b), where(even, b, a), where(even, c, d), where(even, d, c)
    w0, w1 = u0 - v0, u1 - v1
    ad, ab, ac = d - a, b - a, c - a
    upper0, upper1 = z0 - a - v0 * ad - w0 * ab, z1 - a - v1 * ad - w1 * ab
    lower0, lower1 = z0 - a - u0 * ad + w0 * ac, z1 - a - u1 * ad + w1 * ac
    begins_upper = (w0 > 0.0) | ((w0 == 0.0) & (w1 > 0.0))
    ends_upper = (w1 > 0.0) | ((w1 == 0.0) & (w0 > 0.0))
    p0, p1 = where(begins_upper, upper0, lower0), where(begins_upper, upper1, lower1)
    q0, q1 = where(ends_upper, upper0, lower0), where(ends_upper, upper1, lower1)
    crosses = w0 * w1 < 0.0
    early = crosses & ((w0 * p1 - w1 * p0) * w0 <= 0.0)
    f0, f1 = where(early, p0, q0), where(early, p1, q1)
    there, there_too = p1 == p1, q1 == q1  # false where a corner is missing
    unsure = (lost & there & (p0 <= 0.0)) | (crosses & ~there & ((w0 * q1 - w1 * q0) * w0 <= 0.0))
    return where(f0 > 0.0, f0 / (f0 - f1), 0.0), early | (q1 <= 0.0), unsure, ~there_too


@inlined
def rectangle(floats, w, v):
    """(west, north, east, south) of window ``w`` in the samples of window ``v``; of no window: none."""
    if w >= floats.shape[0]:
        return 1.0, 1.0, 0.0, 0.0
    k, x, y = floats[v, INVERSE], floats[v, ORIGIN_X], floats[v, ORIGIN_Y]
    return (floats[w, WEST] - x) * k, (floats[w, NORTH] - y) * k, (floats[w, EAST] - x) * k, (floats[w, SOUTH] - y) * k


@inlined
def walk_packet(scene, w, o, dx, dy, dz, start, near, far, wanted, steps):
    """Walk eight rays through window ``w``, from close above the surface.

    Args:
        scene: the stack.
        o: where the rays begin; dx, dy, dz: their directions. start: the t up to which they are above the surface, if
            they are over the window there. near, far: the range of t that counts. wanted: which are asked for.
        steps: how many to take.

    Returns:
        t and what ``which`` holds: t and the window's number; NaN and −1; or where the ray got to and why it stopped.
    """
    pool, ints, floats = scene.pool, scene.ints, scene.floats
    rect, inner = rectangle(floats, w, w), rectangle(floats, w + 1, w)
    base, stride, nc, nr = ints[w, BASE], ints[w, STRIDE], ints[w, CELLS_X], ints[w, CELLS_Y]
    k = floats[w, INVERSE]
    ox, oy, oz = (o[0] - floats[w, ORIGIN_X]) * k, (o[1] - floats[w, ORIGIN_Y]) * k, o[2]
    dx, ix = inverses(dx * k)
    dy, iy = inverses(dy * k)
    rays, t = Packet(ox, oy, oz, dx, dy, dz, ix, iy), start
    lost = spread(False)
    x, y = ox + t * dx, oy + t * dy
    out = ~within(rect, x, y)
    misses = out & spread(False)
    if w == 0 and some(wanted & out):  # a ray that comes in through a side wall may run above or below the surface
        first, final = clips(ox, dx, rect[0], rect[2], t, spread(far))
        first, final = clips(oy, dy, rect[1], rect[3], first, final)
        lost = out & (first <= final)
        misses = out & ~lost
        t = where(lost, first, t)
        x, y = ox + t * dx, oy + t * dy
        x = where(lost, least(most(x, spread(rect[0])), spread(rect[2])), x)
        y = where(lost, least(most(y, spread(rect[1])), spread(rect[3])), y)
    last = where(dz < 0.0, scene.low - oz, scene.high - oz) / dz
    last = where(((dz < 0.0) | (dz > 0.0)) & (last < far), last, far)
    begins = within(rect, x, y) & (t >= near)
    if inner[0] < inner[2]:
        begins = begins & ~within(inner, x, y)
    over = (t < last) & ~misses  # over missing ground a ray falls on for long where nothing can be hit any more
    end, leaves = stretches(rays, t, last, w, rect, inner)
    walking = wanted & over & begins
    arrives = where(leaves, ABOVE, -1)
    which = where(over, where(begins, spread(TIRED), where(t >= near, spread(BESIDE), UNKNOWN)), -1)
    last_x, last_y = np.float64(nc - 1), np.float64(nr - 1)
    x, y = where(walking & (x > 0.0), x, 0.0), where(walking & (y > 0.0), y, 0.0)
    column, row = whole(least(x, spread(last_x))), whole(least(y, spread(last_y)))
    cx, cy = real(column), real(row)
    i = row * stride + column + base
    even = ((column + row) & 1) == 0
    right, down = dx > 0.0, dy > 0.0
    sx, sy = where(right, 1.0, -1.0), where(down, 1.0, -1.0)
    step_x, step_y = where(right, spread(1), -1), where(down, spread(stride), -stride)
    ax, ay = where(right, ix, 0.0 - ix), where(down, iy, 0.0 - iy)
    tx = where((dx > 0.0) | (dx < 0.0), (cx + where(right, 1.0, 0.0) - ox) * ix, INF)
    ty = where((dy > 0.0) | (dy < 0.0), (cy + where(down, 1.0, 0.0) - oy) * iy, INF)
    ax, ay = where(tx == INF, 0.0, ax), where(ty == INF, 0.0, ay)
    z = oz + t * dz
    for _ in range(steps if some(walking) else 0):
        t1 = most(least(least(tx, ty), end), t)
        z1 = oz + t1 * dz
        a, b, c, d = corners(pool, i, stride)
        lower = least(z, z1)
        near_ground = walking & ~((lower > a) & (lower > b) & (lower > c) & (lower > d))
        if some(near_ground):
            u0, v0 = ox + t * dx - cx, oy + t * dy - cy
            u1, v1 = ox + t1 * dx - cx, oy + t1 * dy - cy
            s, meets, unsure, over_hole = cell_hits(a, b, c, d, even, u0, v0, z, u1, v1, z1, lost)
            hit = near_ground & meets & ~unsure
            t = where(hit, t + s * (t1 - t), t)
            which = where(near_ground & unsure, UNKNOWN, where(hit, w, which))
            walking = walking & ~(near_ground & (meets | unsure))
            lost = near_ground & over_hole
        else:
            lost = spread(False)
        t, z = where(walking, t1, t), where(walking, z1, z)
        arrived = walking & (t1 >= end)
        across = tx <= ty
        cx, cy = where(across, cx + sx, cx), where(across, cy, cy + sy)
        beyond = (cx < 0.0) | (cx > last_x) | (cy < 0.0) | (cy > last_y)
        which = where(arrived | (walking & beyond), where(lost & leaves, spread(UNKNOWN), arrives), which)
        walking = walking & ~(arrived | beyond)
        if not some(walking):
            break
        i = where(walking, where(across, i + step_x, i + step_y), i)
        even = ~even
        tx, ty = where(across, tx + ax, tx), where(across, ty, ty + ay)
    which = where(lost & (which == TIRED), UNKNOWN, which)
    return where(which == -1, np.nan, t), which
