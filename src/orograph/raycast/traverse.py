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

from orograph._numba import inlined, kernel

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


@kernel
def clip(o, d, low, high, t0, t1):
    """The part of [t0, t1] on which o + t·d lies in [low, high]; empty if t0 > t1."""
    if d == 0.0:
        return (t0, t1) if low <= o <= high else (1.0, 0.0)
    a, b = (low - o) / d, (high - o) / d
    return max(t0, min(a, b)), min(t1, max(a, b))


@kernel
def cell_hit(a, b, c, d, even, u0, v0, z0, u1, v1, z1, side):
    """Intersect the ray's passage (u0, v0, z0) → (u1, v1, z1) through a cell with its two triangles.

    Returns (s, side): the fraction of the passage at the hit (−1: none) and the side after it: +1 above, −1 below,
    0 unknown (after a hole).
    """
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
        if not (side > 0 and f1 > 0.0):  # else: above at both ends of a straight piece over a plane
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


@kernel
def cast(
    pool,
    base,
    stride,
    nc,
    nr,
    maxima,
    max_offset,
    minima,
    min_offset,
    mip_cols,
    ox,
    oy,
    oz,
    dx,
    dy,
    dz,
    t0,
    t1,
    side,
    level,
):
    """The first hit of a ray with one height field for t in [t0, t1], within which the ray stays on its cells.

    Args:
        pool, base, stride: heights (float32) of sample (x, y) are ``pool[base + y * stride + x]``.
        nc, nr: cells per row and column.
        maxima … mip_cols: its ``Mips``.
        side: +1 if the ray is known to run above the surface at t0, −1 below, 0 unknown.
        level: where in the pyramid to begin.

    Returns:
        (t, side): the parameter of the hit (inf: none) and the side of the surface at the end.
    """
    top = mip_cols.shape[0] - 1
    level = min(level, top)
    ix = 1.0 / dx if dx != 0.0 else 0.0
    iy = 1.0 / dy if dy != 0.0 else 0.0
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
            node = jy * mip_cols[level] + jx
            if min(za, zb) > maxima[max_offset[level] + node]:
                side = 1
                free = True
            elif level >= 2 and max(za, zb) < minima[min_offset[level] + node]:
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


MARCH_LEVEL = 2
"""The fixed level of ``march``: nodes of 4 × 4 cells."""

PATIENCE = 24
"""Nodes that ``march`` may find free before it leaves the ray to ``cast``, which climbs."""


@kernel
def march_block(
    pool,
    base,
    stride,
    nc,
    nr,
    maxima,
    max_offset,
    minima,
    min_offset,
    mip_cols,
    o,
    d0,
    du,
    dv,
    px0,
    px1,
    py0,
    py1,
    near,
    far,
    clear,
    out,
    which,
):
    """``cast`` for a block of a pinhole camera's rays that begin (at ``near``) close above the surface of one window.

    Steps of fixed size (Amanatides & Woo 1987) on two levels: where ``cast`` climbs and descends, a long chain of
    dependent operations for each step, this adds a constant to one of two parameters. After ``PATIENCE`` free nodes a
    ray is left to ``cast``. Coordinates are the window's; ``clear``: the rays run above the surface at ``near`` if they
    are over the window there. ``out`` receives t or NaN, ``which`` 0 or −1.
    """
    offset, per_row = max_offset[MARCH_LEVEL], mip_cols[MARCH_LEVEL]
    size = 1 << MARCH_LEVEL
    last_x, last_y = (nc - 1) >> MARCH_LEVEL, (nr - 1) >> MARCH_LEVEL
    ox, oy, oz = o[0], o[1], o[2]
    for py in range(py0, py1):
        for px in range(px0, px1):
            dx = d0[0] + px * du[0] + py * dv[0]
            dy = d0[1] + px * du[1] + py * dv[1]
            dz = d0[2] + px * du[2] + py * dv[2]
            t, t1, side = near, far, 1
            x, y = ox + t * dx, oy + t * dy
            hit = INF
            if not (clear and 0.0 <= x <= nc and 0.0 <= y <= nr):
                t, t1 = clip(ox, dx, 0.0, np.float64(nc), t, t1)
                t, t1 = clip(oy, dy, 0.0, np.float64(nr), t, t1)
                side = 0
                if t > t1:
                    out[py, px], which[py, px] = np.nan, -1
                    continue
                x, y = ox + t * dx, oy + t * dy
            ix = 1.0 / dx if dx != 0.0 else INF
            iy = 1.0 / dy if dy != 0.0 else INF
            gx, gy = (1 if dx > 0.0 else 0), (1 if dy > 0.0 else 0)
            sx, sy = 2 * gx - 1, 2 * gy - 1
            ax, ay = abs(ix), abs(iy)
            cx, cy = min(max(np.int64(x), 0), nc - 1), min(max(np.int64(y), 0), nr - 1)
            jx, jy = cx >> MARCH_LEVEL, cy >> MARCH_LEVEL
            tx = INF if dx == 0.0 else (((jx + gx) << MARCH_LEVEL) - ox) * ix
            ty = INF if dy == 0.0 else (((jy + gy) << MARCH_LEVEL) - oy) * iy
            za = oz + t * dz
            over = False
            for _ in range(PATIENCE):
                te = max(min(min(tx, ty), t1), t)
                zb = oz + te * dz
                if min(za, zb) > maxima[offset + jy * per_row + jx]:
                    side = 1
                else:
                    cx = min(max(np.int64(ox + t * dx), jx * size), min(jx * size + size, nc) - 1)
                    cy = min(max(np.int64(oy + t * dy), jy * size), min(jy * size + size, nr) - 1)
                    ux = INF if dx == 0.0 else ((cx + gx) - ox) * ix
                    uy = INF if dy == 0.0 else ((cy + gy) - oy) * iy
                    zc = za
                    while True:
                        ue = max(min(min(ux, uy), te), t)
                        zd = oz + ue * dz
                        i = base + cy * stride + cx
                        a, b = np.float64(pool[i]), np.float64(pool[i + 1])
                        c, d = np.float64(pool[i + stride]), np.float64(pool[i + stride + 1])
                        least = min(zc, zd)
                        if least > a and least > b and least > c and least > d:
                            side = 1
                        else:
                            s, side = cell_hit(
                                a,
                                b,
                                c,
                                d,
                                ((cx + cy) & 1) == 0,
                                ox + t * dx - cx,
                                oy + t * dy - cy,
                                zc,
                                ox + ue * dx - cx,
                                oy + ue * dy - cy,
                                zd,
                                side,
                            )
                            if s >= 0.0:
                                hit = t + s * (ue - t)
                                over = True
                                break
                        t, zc = ue, zd
                        if ue >= te:
                            break
                        if ux <= uy:
                            cx += sx
                            ux += ax
                            if (cx >> MARCH_LEVEL) != jx or cx >= nc:
                                break
                        else:
                            cy += sy
                            uy += ay
                            if (cy >> MARCH_LEVEL) != jy or cy >= nr:
                                break
                    if over:
                        break
                if te >= t1:
                    over = True
                    break
                t, za = te, zb
                if tx <= ty:
                    jx += sx
                    tx += ax * size
                    if jx < 0 or jx > last_x:
                        over = True
                        break
                else:
                    jy += sy
                    ty += ay * size
                    if jy < 0 or jy > last_y:
                        over = True
                        break
            if not over:
                hit, side = cast(
                    pool,
                    base,
                    stride,
                    nc,
                    nr,
                    maxima,
                    max_offset,
                    minima,
                    min_offset,
                    mip_cols,
                    ox,
                    oy,
                    oz,
                    dx,
                    dy,
                    dz,
                    t,
                    t1,
                    side,
                    MARCH_LEVEL,
                )
            out[py, px] = hit if hit < INF else np.nan
            which[py, px] = 0 if hit < INF else -1


@kernel
def highest(maxima, max_offset, mip_cols, nc, nr, x0, x1, y0, y1):
    """An upper bound of the surface over [x0, x1] × [y0, y1], clipped to the cells: at most four nodes are read."""
    top = mip_cols.shape[0] - 1
    i0 = min(max(np.int64(np.floor(x0)), 0), nc - 1)
    i1 = min(max(np.int64(np.floor(x1)), 0), nc - 1)
    j0 = min(max(np.int64(np.floor(y0)), 0), nr - 1)
    j1 = min(max(np.int64(np.floor(y1)), 0), nr - 1)
    level = 1
    while level < top and (((i1 >> level) - (i0 >> level)) > 1 or ((j1 >> level) - (j0 >> level)) > 1):
        level += 1
    m = np.float32(-np.inf)
    for j in range(j0 >> level, (j1 >> level) + 1):
        for i in range(i0 >> level, (i1 >> level) + 1):
            m = max(m, maxima[max_offset[level] + j * mip_cols[level] + i])
    return np.float64(m)
