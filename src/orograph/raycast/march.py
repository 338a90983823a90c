"""Rays of a row of pixels, walked from where their front stopped to their first hits, without climbing.

Heights, coordinates and the side of the surface are as in ``traverse``, whose ``cast`` takes over the few rays that get
far from where they began, or from one window into another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._numba import inlined, leaf
from orograph.raycast.traverse import INF, cell_hit, clip, inverse

MARCH_LEVEL = 3
"""The fixed level of ``march_row``: nodes of 8 × 8 cells (``mips.LEAST_ROOT`` makes sure that it is there)."""

CELLS, NODES = 24, 64
"""Steps from cell to cell before ``march_row`` goes over to nodes, and from node to node before it calls ``cast``."""

UNLIMITED = 1 << 30

ABOVE, BELOW, UNKNOWN = -2, -3, -4
"""``which`` of a ray that ``march_row`` has not finished: the side of the surface on which it runs."""


HIT, ARRIVED, BEYOND, TIRED = range(4)
"""Why a walk stops: it met the surface; it came to its end; it left its cells; it has taken all its steps."""


class Ray(NamedTuple):
    """A ray o + t·d, with 1/d, and whether it runs to the right and down: 1 or 0."""

    ox: float
    oy: float
    oz: float
    dx: float
    dy: float
    dz: float
    ix: float
    iy: float
    right: int
    down: int


@inlined
def borders(ray, x, y, shift):
    """The t at which a ray leaves cell or node (x, y) of side 2^shift by column, and by row."""
    tx = INF if ray.dx == 0.0 else (((x + ray.right) << shift) - ray.ox) * ray.ix
    ty = INF if ray.dy == 0.0 else (((y + ray.down) << shift) - ray.oy) * ray.iy
    return tx, ty


@inlined
def walk_cells(pool, base, stride, ray, t, end, z, side, cx, cy, first_x, last_x, first_y, last_y, steps):
    """Walk from cell to cell, from t to ``end`` at most.

    Args:
        base, stride: of the window. z: height of the ray at t. side: of the surface.
        cx, cy: the cell at t; first_x … last_y: the cells to stay in. steps: how many to take.

    Returns: why it stops, t (of the hit, if it is one), z and side there, and the cell.
    """
    sx, sy = 2 * ray.right - 1, 2 * ray.down - 1
    ax, ay = abs(ray.ix), abs(ray.iy)
    tx, ty = borders(ray, cx, cy, 0)
    i, step_y = base + cy * stride + cx, sy * stride
    why = TIRED
    for _ in range(steps):
        t1 = max(min(min(tx, ty), end), t)
        z1 = ray.oz + t1 * ray.dz
        a, b = np.float64(pool[i]), np.float64(pool[i + 1])
        c, d = np.float64(pool[i + stride]), np.float64(pool[i + stride + 1])
        least = min(z, z1)
        if side >= 0 and (least > a) & (least > b) & (least > c) & (least > d):
            side = 1
        else:
            u0, v0 = ray.ox + t * ray.dx - cx, ray.oy + t * ray.dy - cy
            u1, v1 = ray.ox + t1 * ray.dx - cx, ray.oy + t1 * ray.dy - cy
            s, side = cell_hit(a, b, c, d, ((cx + cy) & 1) == 0, u0, v0, z, u1, v1, z1, side)
            if s >= 0.0:
                t += s * (t1 - t)
                why = HIT
                break
        t, z = t1, z1
        if t1 >= end:
            why = ARRIVED
            break
        across = tx <= ty  # which border comes first is a toss: selects instead of branches
        cx += sx if across else 0
        cy += 0 if across else sy
        tx += ax if across else 0.0
        ty += 0.0 if across else ay
        i += sx if across else step_y
        if (cx < first_x) | (cx > last_x) | (cy < first_y) | (cy > last_y):
            why = BEYOND
            break
    return why, t, z, side, cx, cy


@inlined
def walk_nodes(pool, maxima, offset, per_row, base, stride, nc, nr, ray, t, end, z, side, cx, cy):
    """Walk from node to node of level ``MARCH_LEVEL``, and through the cells of those that the ray comes down to.

    Args:
        offset, per_row: where the level begins in the maxima, and its nodes in a row. nc, nr: cells of the window.
        Others as for ``walk_cells``.

    Returns: why it stops, t (of the hit, if it is one), and the side there.
    """
    size = 1 << MARCH_LEVEL
    last_x, last_y = (nc - 1) >> MARCH_LEVEL, (nr - 1) >> MARCH_LEVEL
    sx, sy = 2 * ray.right - 1, 2 * ray.down - 1
    ax, ay = abs(ray.ix) * size, abs(ray.iy) * size
    jx, jy = cx >> MARCH_LEVEL, cy >> MARCH_LEVEL
    tx, ty = borders(ray, jx, jy, MARCH_LEVEL)
    why = TIRED
    for _ in range(NODES):
        t1 = max(min(min(tx, ty), end), t)
        z1 = ray.oz + t1 * ray.dz
        if side >= 0 and min(z, z1) > maxima[offset + jy * per_row + jx]:
            side = 1
        else:
            x0, x1 = jx * size, min(jx * size + size, nc) - 1
            y0, y1 = jy * size, min(jy * size + size, nr) - 1
            cx = min(max(np.int64(ray.ox + t * ray.dx), x0), x1)
            cy = min(max(np.int64(ray.oy + t * ray.dy), y0), y1)
            inner, t, _, side, _, _ = walk_cells(
                pool, base, stride, ray, t, t1, z, side, cx, cy, x0, x1, y0, y1, UNLIMITED
            )
            if inner == HIT:
                why = HIT
                break
        t, z = t1, z1
        if t1 >= end:
            why = ARRIVED
            break
        across = tx <= ty
        jx += sx if across else 0
        jy += 0 if across else sy
        tx += ax if across else 0.0
        ty += 0.0 if across else ay
        if (jx < 0) | (jx > last_x) | (jy < 0) | (jy > last_y):
            why = BEYOND
            break
    return why, t, side


@inlined
def stretch(ray, t, last, number, rect, inner):
    """(t at which a ray leaves the window, to the outside or for a coarser or finer one; whether the latter)."""
    west, north, east, south = rect
    end = last
    if ray.dx != 0.0:
        end = min(end, ((east if ray.right else west) - ray.ox) * ray.ix)
    if ray.dy != 0.0:
        end = min(end, ((south if ray.down else north) - ray.oy) * ray.iy)
    leaves = number > 0 and end < last
    if inner[0] < inner[2]:
        a, b = clip(ray.ox, ray.dx, inner[0], inner[2], t, end)
        a, b = clip(ray.oy, ray.dy, inner[1], inner[3], a, b)
        if a <= b:
            end, leaves = a, True
    return max(t, end), leaves


@inlined
def within(rect, x, y):
    """Whether a rectangle (west, north, east, south) holds a place."""
    return rect[0] <= x and x <= rect[2] and rect[1] <= y and y <= rect[3]


@leaf
def march_row(
    scene, window, rect, inner, low, high, o, d0, du, dv, py, px0, px1, starts, few, near, far, corner, out, which
):
    """Walk rays of one row of a pinhole camera's pixels through one window, from close above the surface.

    Steps of fixed size (Amanatides & Woo 1987), first on cells, then on nodes of one level: where ``traverse.cast``
    climbs and descends, a long chain of dependent operations for each step, this adds a constant to one of two
    parameters.

    Args:
        scene: (pool, maxima, minima, mips) of the stack.
        window: (number, base, stride, nc, nr, first column of ``mips``).
        rect, inner: (west, north, east, south) of the window and of the finer one in it (west > east: none).
        low, high: the slab of all heights.
        o, d0, du, dv: the camera in the window's coordinates.
        starts: the t up to which the rays of pixels px0 … px1 − 1 are above the surface, if they are over the window.
        few: whether the hits are likely to be only a few cells beyond.
        near, far: the range of t that counts.
        corner: (row, col) of the pixel that ``out`` and ``which`` begin with.
        out, which: t and the window's number; NaN and −1; or where the ray got to and a side: a ray that begins
            beside the window, enters the finer one or leaves for the coarser one.
    """
    pool, maxima, _, mips = scene
    number, base, stride, nc, nr, m0 = window
    offset, per_row = mips[0, m0 + MARCH_LEVEL], mips[2, m0 + MARCH_LEVEL]
    nested = inner[0] < inner[2]
    row, left = py - corner[0], corner[1]
    for px in range(px0, px1):
        dx, ix = inverse(d0[0] + px * du[0] + py * dv[0])
        dy, iy = inverse(d0[1] + px * du[1] + py * dv[1])
        dz = d0[2] + px * du[2] + py * dv[2]
        t, last = starts[px - px0], far
        if dz < 0.0:
            last = min(last, (low - o[2]) / dz)
        elif dz > 0.0:
            last = min(last, (high - o[2]) / dz)
        if t >= last:  # over missing ground a ray falls on for long where nothing can be hit any more
            out[row, px - left], which[row, px - left] = np.nan, -1
            continue
        x, y = o[0] + t * dx, o[1] + t * dy
        begins = within(rect, x, y) and not (nested and within(inner, x, y))
        if not begins or t < near:
            out[row, px - left], which[row, px - left] = t, UNKNOWN
            continue
        ray = Ray(o[0], o[1], o[2], dx, dy, dz, ix, iy, 1 if dx > 0.0 else 0, 1 if dy > 0.0 else 0)
        end, leaves = stretch(ray, t, last, number, rect, inner)
        cx, cy = min(max(np.int64(x), 0), nc - 1), min(max(np.int64(y), 0), nr - 1)
        z, side, why = o[2] + t * dz, 1, TIRED
        if few:
            why, t, z, side, cx, cy = walk_cells(
                pool, base, stride, ray, t, end, z, side, cx, cy, 0, nc - 1, 0, nr - 1, CELLS
            )
        if why == TIRED:
            why, t, side = walk_nodes(pool, maxima, offset, per_row, base, stride, nc, nr, ray, t, end, z, side, cx, cy)
        if why == HIT:
            out[row, px - left], which[row, px - left] = t, number
        elif why != TIRED and not leaves:
            out[row, px - left], which[row, px - left] = np.nan, -1
        else:
            out[row, px - left] = min(t, end)
            which[row, px - left] = ABOVE if side > 0 else BELOW if side < 0 else UNKNOWN
