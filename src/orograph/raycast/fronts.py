"""How far the rays of a block of pixels run free: fronts pushed outward before any ray is cast.

What a pinhole camera and a height field give beyond a general ray tracer: the rays of a block of pixels lie over a thin
*wedge* of the plan. A front is pushed outward along it as long as the lowest of the rays stays above the maximum of the
ground in the wedge's next stretch (`advance`); no ray hits anything before. A higher row of pixels sees over everything
that the row below it has passed, so rows are taken upward and each begins where its neighbour's front stopped. Wide
wedges hand their front to the narrow ones in them, and a ray walks only the last few cells by itself. (Anderson 1982,
*Hidden line elimination in projected grid surfaces*, carries a horizon through a picture in the same way; Amanatides
1984, *Ray tracing with cones*, is the beams' ancestor.)
"""

from __future__ import annotations

import numpy as np

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
from orograph.raycast.traverse import highest

INF = np.inf


@inlined
def ground_below(scene, ints, floats, x0, x1, y0, y1):
    """(Upper bound of the surface over a rectangle, −inf beside it; scale of the finest window there)."""
    _, maxima, _, mips = scene
    ground, scale = -INF, 0.0
    for w in range(ints.shape[0] - 1, -1, -1):
        west, north, east, south = floats[w, WEST], floats[w, NORTH], floats[w, EAST], floats[w, SOUTH]
        if x1 < west or x0 > east or y1 < north or y0 > south:
            continue
        k = floats[w, INVERSE]
        m0, m1 = ints[w, MIP_FIRST], ints[w, MIP_FIRST] + ints[w, MIP_COUNT]
        u0, u1 = (max(x0, west) - floats[w, ORIGIN_X]) * k, (min(x1, east) - floats[w, ORIGIN_X]) * k
        v0, v1 = (max(y0, north) - floats[w, ORIGIN_Y]) * k, (min(y1, south) - floats[w, ORIGIN_Y]) * k
        here = highest(maxima, mips, m0, m1, ints[w, CELLS_X], ints[w, CELLS_Y], u0, u1, v0, v1)
        ground = max(ground, here)
        if scale == 0.0:
            scale = floats[w, SCALE]
        if x0 >= west and x1 <= east and y0 >= north and y1 <= south:
            break  # nothing of the coarser windows is seen here
    return ground, scale


@leaf
def advance(scene, ints, floats, high, o, xa, xb, ya, yb, slope, s, end, step):
    """Push the front of a beam outward from ``s``.

    The beam holds the rays o + s·(x, y, z) with x in [xa, xb], y in [ya, yb], z ≥ ``slope``, s ≤ ``end``; they are
    known to be above the ground up to ``s``.

    Returns:
        (s, step, ground): rays are above the ground up to the new s; in the ``step`` beyond it the ground may reach
        ``ground`` (−inf: s has come to ``end``).
    """
    width = max(xb - xa, yb - ya)
    speed = max(max(abs(xa), abs(xb)), max(abs(ya), abs(yb))) + 1e-300
    ox, oy, oz = o[0], o[1], o[2]
    passed = False
    while s < end:
        if oz + s * slope > high:  # above every summit until it comes down to them
            if slope >= 0.0:
                return end, step, -INF
            s = max(s, (high - oz) / slope)
        to = s + step
        z = oz + (s if slope >= 0.0 else to) * slope
        x0, x1 = ox + min(s * xa, to * xa), ox + max(s * xb, to * xb)
        y0, y1 = oy + min(s * ya, to * ya), oy + max(s * yb, to * yb)
        ground, cell = ground_below(scene, ints, floats, x0, x1, y0, y1)
        if z > ground:
            s = to
            if passed:  # a single step forward is what a row usually gains on the one below
                step *= 2.0
            passed = True
        else:
            passed = False
            least = max(LEAST_CELLS * cell, LEAST_WIDTH * width * s) / speed
            if step <= least:
                return s, step, ground
            step = max(0.5 * step, least)
    return end, step, -INF


LEAST_CELLS, LEAST_WIDTH = 0.5, 0.125
"""The shortest stretch that ``advance`` tries: in cells of the finest window, and in widths of the beam."""


@leaf
def directions(d0, du, dv, x0, x1, y0, y1):
    """The range of a block's rays for ``advance`` where s is their parameter: (xa, xb, ya, yb, least z)."""
    xa, xb, ya, yb, slope = INF, -INF, INF, -INF, INF
    for py in (y0, y1 - 1):
        for px in (x0, x1 - 1):
            dx, dy = d0[0] + px * du[0] + py * dv[0], d0[1] + px * du[1] + py * dv[1]
            xa, xb, ya, yb = min(xa, dx), max(xb, dx), min(ya, dy), max(yb, dy)
            slope = min(slope, d0[2] + px * du[2] + py * dv[2])
    return xa, xb, ya, yb, slope


@leaf
def wedge(d0, du, dv, gx, gy, x0, x1, y0, y1):
    """The range of a block's rays for ``advance`` where s is the distance in the plan along g: (xa, xb, ya, yb, slope).

    Ratios of linear functions over a positive denominator are extreme at corners. xa > xb: there is no wedge, the plan
    directions turn more than STEEPEST from g.
    """
    k0, k1, slope = INF, -INF, INF
    for py in (y0, y1 - 1):
        for px in (x0, x1 - 1):
            dx, dy = d0[0] + px * du[0] + py * dv[0], d0[1] + px * du[1] + py * dv[1]
            q, lateral = dx * gx + dy * gy, dy * gx - dx * gy
            if not abs(lateral) <= TURN * q or q == 0.0:
                return 1.0, 0.0, 0.0, 0.0, 0.0
            k0, k1 = min(k0, lateral / q), max(k1, lateral / q)
            slope = min(slope, (d0[2] + px * du[2] + py * dv[2]) / q)
    ax, bx, ay, by = gx - k0 * gy, gx - k1 * gy, gy + k0 * gx, gy + k1 * gx
    return min(ax, bx), max(ax, bx), min(ay, by), max(ay, by), slope


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
