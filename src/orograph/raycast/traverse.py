"""One ray against one height field: hierarchical traversal of the cells, exact intersection of their two triangles.

Idea and source: Tevs, Ihrke & Seidel 2008 (maximum mipmaps, §3): walk along the ray from node to node of the pyramid,
climb a level where a parent's border is crossed, descend where the ray comes below a node's maximum. Here the walk is
in integers (no position is recomputed from a rounded parameter, so no cell is skipped or visited twice), and carries
the *side* of the surface on which the ray runs: a change of side is a hit, also between cells whose shared edge rounds
differently, so nothing leaks through an edge.

Coordinates are the samples' own: x to the right along a row, y down the rows, z in metres; the ray is o + t·d, t ≥ 0.
The surface is the finest triangulation of the right-triangle hierarchy: cells are cut along the diagonal joining their
(even, even) and (odd, odd) corners. A triangle with a missing corner (NaN) is a hole.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.raycast.tables import (
    BASE,
    CELLS_X,
    CELLS_Y,
    INVERSE,
    MIP_COUNT,
    MIP_FIRST,
    ORIGIN_X,
    ORIGIN_Y,
    STRIDE,
)

INF = np.inf


@inlined
def plane_height(a, b, c, d, u, v, even, first):
    """Height at (u, v) on one triangle of a cell with corners a (0,0), b (1,0), c (0,1), d (1,1).

    ``even``: the diagonal runs a–d, and ``first`` is the triangle a b d (u ≥ v); else it runs b–c, ``first`` is a b c.
    """
    if even:
        if first:
            return a + u * (b - a) + v * (d - b)
        return a + v * (c - a) + u * (d - c)
    if first:
        return a + u * (b - a) + v * (c - a)
    return d + (1.0 - u) * (c - d) + (1.0 - v) * (b - d)


@leaf
def clip(o, d, low, high, t0, t1):
    """The part of [t0, t1] on which o + t·d lies in [low, high]; empty if t0 > t1."""
    if d == 0.0:
        return (t0, t1) if low <= o <= high else (1.0, 0.0)
    a, b = (low - o) / d, (high - o) / d
    return max(t0, min(a, b)), min(t1, max(a, b))


@inlined
def inverse(d):
    """(d, 1/d); (0, inf) for a component so small that its inverse overflows."""
    if abs(d) < 1e-150:
        return 0.0, INF
    return d, 1.0 / d


@leaf
def cell_hit(a, b, c, d, even, u0, v0, z0, u1, v1, z1, side):
    """Intersect the ray's passage (u0, v0, z0) → (u1, v1, z1) through a cell with its two triangles.

    Returns (s, side): the fraction of the passage at the hit (−1: none) and the side after it: +1 above, −1 below,
    0 unknown (after a hole).
    """
    whole = a + b + c + d
    if side > 0 and whole == whole:
        # The usual case, with the fewest branches and divisions. Mirrored where the diagonal runs b–c, the triangles
        # lie in a + v·(d − a) + w·(b − a) where w = u − v ≥ 0, and in a + u·(d − a) − w·(c − a) where w ≤ 0.
        if not even:
            u0, u1 = 1.0 - u0, 1.0 - u1
            a, b, c, d = b, a, d, c
        w0, w1 = u0 - v0, u1 - v1
        ad, ab, ac = d - a, b - a, c - a
        upper0, upper1 = z0 - a - v0 * ad - w0 * ab, z1 - a - v1 * ad - w1 * ab
        lower0, lower1 = z0 - a - u0 * ad + w0 * ac, z1 - a - u1 * ad + w1 * ac
        begins_upper = w0 > 0.0 or (w0 == 0.0 and w1 > 0.0)
        ends_upper = w1 > 0.0 or (w1 == 0.0 and w0 > 0.0)
        p0 = upper0 if begins_upper else lower0
        p1 = upper1 if begins_upper else lower1
        if w0 * w1 < 0.0 and (w0 * p1 - w1 * p0) * w0 <= 0.0:  # below the first triangle's plane at the diagonal
            return (p0 / (p0 - p1) if p0 > 0.0 else 0.0), side
        q0 = upper0 if ends_upper else lower0
        q1 = upper1 if ends_upper else lower1
        if q1 > 0.0:
            return -1.0, side
        return (q0 / (q0 - q1) if q0 > 0.0 else 0.0), side
    g0 = u0 - v0 if even else 1.0 - u0 - v0
    g1 = u1 - v1 if even else 1.0 - u1 - v1
    cut = 1.0
    first = g0 + g1 >= 0.0
    parts = 1
    if g0 * g1 < 0.0:
        cut = g0 / (g0 - g1)
        first = g0 > 0.0
        parts = 2
    s0 = 0.0
    for part in range(parts):
        s1 = cut if part + 1 < parts else 1.0
        f1 = z0 + s1 * (z1 - z0) - plane_height(a, b, c, d, u0 + s1 * (u1 - u0), v0 + s1 * (v1 - v0), even, first)
        f0 = z0 + s0 * (z1 - z0) - plane_height(a, b, c, d, u0 + s0 * (u1 - u0), v0 + s0 * (v1 - v0), even, first)
        if f0 != f0 or f1 != f1:
            side = 0
        else:
            if side == 0:
                side = 1 if (f0 > 0.0 or (f0 == 0.0 and f1 > 0.0)) else -1
            if (side > 0 and f1 <= 0.0) or (side < 0 and f1 >= 0.0):
                span = f0 - f1
                if f0 * side <= 0.0 or span == 0.0:
                    return s0, side
                return s0 + (s1 - s0) * (f0 / span), side
        s0 = s1
        first = not first
    return -1.0, side


@leaf
def cast(scene, window, o, d, t0, t1, side, level):
    """The first hit of a ray with one window of a ``Scene`` for t in [t0, t1], within which it stays on its cells.

    Args:
        o, d: the ray o + t·d, (x, y, z) in the terrain's samples.
        side: +1 if the ray is known to run above the surface at t0, −1 below, 0 unknown.
        level: where in the pyramid to begin.

    Returns:
        (t, side): the parameter of the hit (inf: none) and the side of the surface at the end.
    """
    pool, maxima, minima, mips = scene.pool, scene.maxima, scene.minima, scene.mips
    ints, floats = scene.ints, scene.floats
    base, stride = ints[window, BASE], ints[window, STRIDE]
    nc, nr = ints[window, CELLS_X], ints[window, CELLS_Y]
    finest, top = ints[window, MIP_FIRST], ints[window, MIP_COUNT] - 1
    k = floats[window, INVERSE]
    ox, oy, oz = (o[0] - floats[window, ORIGIN_X]) * k, (o[1] - floats[window, ORIGIN_Y]) * k, o[2]
    dx, ix = inverse(d[0] * k)
    dy, iy = inverse(d[1] * k)
    dz = d[2]
    level = min(level, top)
    right, down = dx > 0.0, dy > 0.0
    t = t0
    cx = min(max(np.int64(np.floor(ox + t * dx)), 0), nc - 1)
    cy = min(max(np.int64(np.floor(oy + t * dy)), 0), nr - 1)
    while True:
        jx, jy = cx >> level, cy >> level
        tx = INF if dx == 0.0 else ((((jx + 1) << level) if right else (jx << level)) - ox) * ix
        ty = INF if dy == 0.0 else ((((jy + 1) << level) if down else (jy << level)) - oy) * iy
        te = max(min(min(tx, ty), t1), t)
        za, zb = oz + t * dz, oz + te * dz
        free = False
        if level >= 1:
            # Free, unless that would be the other side: then the ray has come through the step between two windows.
            node = jy * mips[2, finest + level] + jx
            highest = maxima[mips[0, finest + level] + node]
            if min(za, zb) > highest and (side >= 0 or highest == -INF):
                side = 1 if highest > -INF else 0
                free = True
            elif level >= 2 and side <= 0 and max(za, zb) < minima[mips[1, finest + level] + node]:
                side = -1
                free = True
            else:
                level -= 1
                continue
        if not free:
            i = base + cy * stride + cx
            s, side = cell_hit(
                np.float64(pool[i]),
                np.float64(pool[i + 1]),
                np.float64(pool[i + stride]),
                np.float64(pool[i + stride + 1]),
                ((cx + cy) & 1) == 0,
                ox + t * dx - cx,
                oy + t * dy - cy,
                za,
                ox + te * dx - cx,
                oy + te * dy - cy,
                zb,
                side,
            )
            if s >= 0.0:
                return t + s * (te - t), side
        if te >= t1:
            return INF, side
        t = te
        if tx <= ty:
            climb = ((jx & 1) == 1) == right
            cx = ((jx + 1) << level) if right else (jx << level) - 1
            if cx < 0 or cx >= nc:
                return INF, side
            cy = min(max(np.int64(np.floor(oy + t * dy)), jy << level), min(((jy + 1) << level), nr) - 1)
        else:
            climb = ((jy & 1) == 1) == down
            cy = ((jy + 1) << level) if down else (jy << level) - 1
            if cy < 0 or cy >= nr:
                return INF, side
            cx = min(max(np.int64(np.floor(ox + t * dx)), jx << level), min(((jx + 1) << level), nc) - 1)
        if climb and level < top:
            level += 1
