"""How far the rays of a block of pixels run free: fronts pushed outward before any ray is cast.

What a pinhole camera and a height field give beyond a general ray tracer: the rays of a column of pixels lie over a
thin *wedge* of the plan. A front is pushed outward along it as long as the lowest of the rays stays above the maximum
of the ground in the wedge's next stretch (`advance`); no ray hits anything before. A higher row of pixels sees over
everything that the row below it has passed, so rows are taken upward and each begins where its neighbour's front
stopped. Where rays are steep, a *cone* of a few rows begins anew. Eight beams are pushed side by side (see ``_lanes``),
and a ray walks only the last few cells by itself. (Anderson 1982, *Hidden line elimination in projected grid surfaces*,
carries a horizon through a picture in the same way; Amanatides 1984, *Ray tracing with cones*, is the beams' ancestor.)
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orograph._lanes import gather, least, most, size, some, spread, where, whole
from orograph._numba import inlined, leaf
from orograph.raycast.tables import (
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
    WEST,
)

INF = np.inf


class Beams(NamedTuple):
    """Eight beams side by side: of each the rays o + s·(x, y, z) with x in [xa, xb], y in [ya, yb]."""

    xa: Any
    xb: Any
    ya: Any
    yb: Any


@inlined
def highest(maxima, mips, m0, m1, nc, nr, x0, x1, y0, y1):
    """Upper bounds of the surface over [x0, x1] × [y0, y1], clipped to the cells: four nodes, or fewer."""
    last_x, last_y = np.float64(nc - 1), np.float64(nr - 1)
    i0, i1 = whole(clamped(x0, last_x)), whole(clamped(x1, last_x))
    j0, j1 = whole(clamped(y0, last_y)), whole(clamped(y1, last_y))
    span = where(i1 - i0 > j1 - j0, i1 - i0, j1 - j0)
    k, top = 1, m1 - m0 - 1
    level, first, per_row = spread(1), spread(mips[0, m0 + 1]), spread(mips[2, m0 + 1])
    while k < top:
        wide = span > (1 << k)
        if not some(wide):
            break
        k += 1
        level = where(wide, k, level)
        first, per_row = where(wide, mips[0, m0 + k], first), where(wide, mips[2, m0 + k], per_row)
    i0, i1 = i0 >> level, i1 >> level
    j0, j1 = first + (j0 >> level) * per_row, first + (j1 >> level) * per_row
    upper = most(gather(maxima, j0 + i0), gather(maxima, j0 + i1))
    return most(upper, most(gather(maxima, j1 + i0), gather(maxima, j1 + i1)))


@inlined
def clamped(x, last):
    """Numbers held within 0 … last."""
    return least(where(x > 0.0, x, 0.0), spread(last))


@inlined
def ground_below(scene, x0, x1, y0, y1, wanted):
    """(Upper bounds of the surface over rectangles, −inf beside it; scales of the finest windows there)."""
    maxima, mips, ints, floats = scene.maxima, scene.mips, scene.ints, scene.floats
    ground, scale = spread(-INF), spread(0.0)
    for w in range(ints.shape[0] - 1, -1, -1):
        west, north, east, south = floats[w, WEST], floats[w, NORTH], floats[w, EAST], floats[w, SOUTH]
        there = wanted & (x1 >= west) & (x0 <= east) & (y1 >= north) & (y0 <= south)
        if not some(there):
            continue
        k = floats[w, INVERSE]
        m0, m1 = ints[w, MIP_FIRST], ints[w, MIP_FIRST] + ints[w, MIP_COUNT]
        u0 = (most(x0, spread(west)) - floats[w, ORIGIN_X]) * k
        u1 = (least(x1, spread(east)) - floats[w, ORIGIN_X]) * k
        v0 = (most(y0, spread(north)) - floats[w, ORIGIN_Y]) * k
        v1 = (least(y1, spread(south)) - floats[w, ORIGIN_Y]) * k
        here = highest(maxima, mips, m0, m1, ints[w, CELLS_X], ints[w, CELLS_Y], u0, u1, v0, v1)
        ground = where(there & (here > ground), here, ground)
        scale = where(there & (scale == 0.0), floats[w, SCALE], scale)
        # Nothing of the coarser windows is seen within this one.
        wanted = wanted & ~(there & (x0 >= west) & (x1 <= east) & (y0 >= north) & (y1 <= south))
        if not some(wanted):
            break
    return ground, scale


@inlined
def advance(scene, o, beams, slope, s, end, step, ground, moving, cells):
    """Push the fronts of the beams that are ``moving`` outward from ``s``.

    Rays of a beam have z ≥ ``slope``, s ≤ ``end``; they are known to be above the ground up to ``s``. The shortest
    stretch that is tried is of so many ``cells``.

    Returns:
        (s, step, ground): rays are above the ground up to the new s; in the ``step`` beyond it the ground may reach
        ``ground`` (−inf: s has come to ``end``).
    """
    xa, xb, ya, yb = beams
    width = most(xb - xa, yb - ya)
    speed = most(most(size(xa), size(xb)), most(size(ya), size(yb))) + 1e-300
    ox, oy, oz = o[0], o[1], o[2]
    ground = where(moving, -INF, ground)
    passed = s < -INF
    moving = moving & (s < end)
    while some(moving):
        above = moving & (oz + s * slope > scene.high)  # every summit, until it comes down to them
        if some(above):
            falls = slope < 0.0
            s = where(above, where(falls, most(s, (scene.high - oz) / slope), end), s)
            moving = moving & (s < end)
        to = s + step
        z = oz + where(slope >= 0.0, s, to) * slope
        x0, x1 = ox + least(s * xa, to * xa), ox + most(s * xb, to * xb)
        y0, y1 = oy + least(s * ya, to * ya), oy + most(s * yb, to * yb)
        here, cell = ground_below(scene, x0, x1, y0, y1, moving)
        free = moving & (z > here)
        shortest = most(cell * cells, s * width * LEAST_WIDTH) / speed
        stops = moving & ~free & (step <= shortest)
        ground = where(stops, here, ground)
        s = where(free, to, s)
        # A single step forward is what a row usually gains on the one below.
        shorter = where(moving & ~free & ~stops, most(step * 0.5, shortest), step)
        step = where(free & passed, step * 2.0, shorter)
        passed = free
        moving = moving & ~stops & (s < end)
    return s, step, ground


LEAST_WIDTH = 0.125
"""The shortest stretch that ``advance`` tries in widths of the beam."""


@inlined
def cones(d0, du, dv, a, b, y0, y1):
    """Beams where s is the rays' parameter, of columns a … b and rows [y0, y1): (beams, least z)."""
    xa, xb, ya, yb, slope = spread(INF), spread(-INF), spread(INF), spread(-INF), spread(INF)
    for py in (y0, y1 - 1):
        for px in (a, b):
            dx, dy = d0[0] + px * du[0] + py * dv[0], d0[1] + px * du[1] + py * dv[1]
            xa, xb, ya, yb = least(xa, dx), most(xb, dx), least(ya, dy), most(yb, dy)
            slope = least(slope, d0[2] + px * du[2] + py * dv[2])
    return Beams(xa, xb, ya, yb), slope


@inlined
def wedges(d0, du, dv, gx, gy, a, b, y0, y1):
    """Beams where s is the distance in the plan along g, of columns a … b and rows [y0, y1): (beams, least slope).

    Ratios of linear functions over a positive denominator are extreme at corners.
    """
    k0, k1, slope = spread(INF), spread(-INF), spread(INF)
    for py in (y0, y1 - 1):
        for px in (a, b):
            dx, dy = d0[0] + px * du[0] + py * dv[0], d0[1] + px * du[1] + py * dv[1]
            q, lateral = dx * gx + dy * gy, dy * gx - dx * gy
            k0, k1 = least(k0, lateral / q), most(k1, lateral / q)
            slope = least(slope, (d0[2] + px * du[2] + py * dv[2]) / q)
    ax, bx, ay, by = gx - k0 * gy, gx - k1 * gy, k0 * gx + gy, k1 * gx + gy
    return Beams(least(ax, bx), most(ax, bx), least(ay, by), most(ay, by)), slope


@inlined
def row_slopes(d0, du, dv, gx, gy, a, b, py):
    """(Least slopes, largest plan speeds along g) of columns a … b of one row of pixels."""
    q0 = (d0[0] + a * du[0] + py * dv[0]) * gx + (d0[1] + a * du[1] + py * dv[1]) * gy
    q1 = (d0[0] + b * du[0] + py * dv[0]) * gx + (d0[1] + b * du[1] + py * dv[1]) * gy
    z0, z1 = d0[2] + a * du[2] + py * dv[2], d0[2] + b * du[2] + py * dv[2]
    return least(z0 / q0, z1 / q1), most(q0, q1)


@leaf
def turns(d0, du, dv, gx, gy, x0, x1, y0, y1):
    """Whether the plan directions of a block's rays turn more than TURN from g, so that there is no wedge."""
    for py in (y0, y1 - 1):
        for px in (x0, x1 - 1):
            dx, dy = d0[0] + px * du[0] + py * dv[0], d0[1] + px * du[1] + py * dv[1]
            q, lateral = dx * gx + dy * gy, dy * gx - dx * gy
            if not abs(lateral) <= TURN * q or q == 0.0:
                return True
    return False


TURN = 2.0
"""The largest tangent of the angle between g and a ray's plan direction in a wedge."""


@leaf
def grazes(d0, du, dv, gx, gy, x0, x1, y0, y1):
    """Whether the rays are so flat that on level ground rows of pixels lie GRAZING times as far apart as columns."""
    if y1 - y0 < 2:
        return False
    upper, q = row_slope(d0, du, dv, gx, gy, x0, x1, y0)
    lower, _ = row_slope(d0, du, dv, gx, gy, x0, x1, y1 - 1)
    apart = np.hypot(du[0], du[1]) / q
    return upper * lower <= 0.0 or abs(upper - lower) > GRAZING * apart * (y1 - 1 - y0) * min(abs(upper), abs(lower))


GRAZING = 2.0


@leaf
def row_slope(d0, du, dv, gx, gy, x0, x1, py):
    """(Least slope, largest plan speed along g) of one row of pixels."""
    q0 = (d0[0] + x0 * du[0] + py * dv[0]) * gx + (d0[1] + x0 * du[1] + py * dv[1]) * gy
    q1 = (d0[0] + (x1 - 1) * du[0] + py * dv[0]) * gx + (d0[1] + (x1 - 1) * du[1] + py * dv[1]) * gy
    z0, z1 = d0[2] + x0 * du[2] + py * dv[2], d0[2] + (x1 - 1) * du[2] + py * dv[2]
    return min(z0 / q0, z1 / q1), max(q0, q1)
