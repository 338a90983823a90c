"""Rays of a row of pixels, walked from where their front stopped to their first hits, without climbing.

Heights, coordinates and the side of the surface are as in ``traverse``, whose ``cast`` takes over the few rays that get
far from where they began, or from one window into another.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.raycast.traverse import INF, cell_hit, clip, inverse

MARCH_LEVEL = 3
"""The fixed level of ``march_row``: nodes of 8 × 8 cells (``mips.LEAST_ROOT`` makes sure that it is there)."""

CELLS, NODES = 24, 64
"""Steps from cell to cell before ``march_row`` goes over to nodes, and from node to node before it calls ``cast``."""

ABOVE, BELOW, UNKNOWN = -2, -3, -4
"""``which`` of a ray that ``march_row`` has not finished: the side of the surface on which it runs."""


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
    size = 1 << MARCH_LEVEL
    last_x, last_y = (nc - 1) >> MARCH_LEVEL, (nr - 1) >> MARCH_LEVEL
    west, north, east, south = rect
    west1, north1, east1, south1 = inner
    nested = west1 < east1
    ox, oy, oz = o
    row, left = py - corner[0], corner[1]
    for px in range(px0, px1):
        dx, ix = inverse(d0[0] + px * du[0] + py * dv[0])
        dy, iy = inverse(d0[1] + px * du[1] + py * dv[1])
        dz = d0[2] + px * du[2] + py * dv[2]
        t, last = starts[px - px0], far
        if dz < 0.0:
            last = min(last, (low - oz) / dz)
        elif dz > 0.0:
            last = min(last, (high - oz) / dz)
        if t >= last:  # over missing ground a ray falls on for long where nothing can be hit any more
            out[row, px - left], which[row, px - left] = np.nan, -1
            continue
        x, y = ox + t * dx, oy + t * dy
        begins = west <= x and x <= east and north <= y and y <= south
        if nested and west1 <= x and x <= east1 and north1 <= y and y <= south1:
            begins = False
        if not begins or t < near:
            out[row, px - left], which[row, px - left] = t, UNKNOWN
            continue
        right, down = dx > 0.0, dy > 0.0
        # Where the ray leaves the window, for good (to the outside or a coarser window) or for the finer one.
        t1 = last
        if dx != 0.0:
            t1 = min(t1, ((east if right else west) - ox) * ix)
        if dy != 0.0:
            t1 = min(t1, ((south if down else north) - oy) * iy)
        leaves = number > 0 and t1 < last
        if nested:
            a, b = clip(ox, dx, west1, east1, t, t1)
            a, b = clip(oy, dy, north1, south1, a, b)
            if a <= b:
                t1, leaves = a, True
        t1 = max(t, t1)
        gx1, gy1 = (1 if right else 0), (1 if down else 0)
        sx, sy = 2 * gx1 - 1, 2 * gy1 - 1
        ax, ay = abs(ix), abs(iy)
        cx, cy = min(max(np.int64(x), 0), nc - 1), min(max(np.int64(y), 0), nr - 1)
        ux = INF if dx == 0.0 else ((cx + gx1) - ox) * ix
        uy = INF if dy == 0.0 else ((cy + gy1) - oy) * iy
        za = oz + t * dz
        side = 1
        hit = INF
        over = False
        i = base + cy * stride + cx
        stepy = sy * stride
        for _ in range(CELLS if few else 0):
            ue = max(min(min(ux, uy), t1), t)
            zb = oz + ue * dz
            a, b = np.float64(pool[i]), np.float64(pool[i + 1])
            c, d = np.float64(pool[i + stride]), np.float64(pool[i + stride + 1])
            least = min(za, zb)
            if side >= 0 and (least > a) & (least > b) & (least > c) & (least > d):
                side = 1
            else:
                u0, v0 = ox + t * dx - cx, oy + t * dy - cy
                u1, v1 = ox + ue * dx - cx, oy + ue * dy - cy
                s, side = cell_hit(a, b, c, d, ((cx + cy) & 1) == 0, u0, v0, za, u1, v1, zb, side)
                if s >= 0.0:
                    hit = t + s * (ue - t)
                    over = True
                    break
            t, za = ue, zb
            if ue >= t1:
                over = True
                break
            across = ux <= uy  # which border comes first is a toss: selects instead of branches
            cx += sx if across else 0
            cy += 0 if across else sy
            ux += ax if across else 0.0
            uy += 0.0 if across else ay
            i += sx if across else stepy
            if (cx < 0) | (cx >= nc) | (cy < 0) | (cy >= nr):
                over = True
                break
        if not over:
            jx, jy = cx >> MARCH_LEVEL, cy >> MARCH_LEVEL
            tx = INF if dx == 0.0 else (((jx + gx1) << MARCH_LEVEL) - ox) * ix
            ty = INF if dy == 0.0 else (((jy + gy1) << MARCH_LEVEL) - oy) * iy
            for _ in range(NODES):
                te = max(min(min(tx, ty), t1), t)
                zb = oz + te * dz
                if side >= 0 and min(za, zb) > maxima[offset + jy * per_row + jx]:
                    side = 1
                else:
                    cx = min(max(np.int64(ox + t * dx), jx * size), min(jx * size + size, nc) - 1)
                    cy = min(max(np.int64(oy + t * dy), jy * size), min(jy * size + size, nr) - 1)
                    ux = INF if dx == 0.0 else ((cx + gx1) - ox) * ix
                    uy = INF if dy == 0.0 else ((cy + gy1) - oy) * iy
                    zc = za
                    while True:
                        ue = max(min(min(ux, uy), te), t)
                        zd = oz + ue * dz
                        i = base + cy * stride + cx
                        a, b = np.float64(pool[i]), np.float64(pool[i + 1])
                        c, d = np.float64(pool[i + stride]), np.float64(pool[i + stride + 1])
                        least = min(zc, zd)
                        if side >= 0 and (least > a) & (least > b) & (least > c) & (least > d):
                            side = 1
                        else:
                            u0, v0 = ox + t * dx - cx, oy + t * dy - cy
                            u1, v1 = ox + ue * dx - cx, oy + ue * dy - cy
                            s, side = cell_hit(a, b, c, d, ((cx + cy) & 1) == 0, u0, v0, zc, u1, v1, zd, side)
                            if s >= 0.0:
                                hit = t + s * (ue - t)
                                over = True
                                break
                        t, zc = ue, zd
                        if ue >= te:
                            break
                        across = ux <= uy
                        cx += sx if across else 0
                        cy += 0 if across else sy
                        ux += ax if across else 0.0
                        uy += 0.0 if across else ay
                        if ((cx >> MARCH_LEVEL) != jx) | ((cy >> MARCH_LEVEL) != jy) | (cx >= nc) | (cy >= nr):
                            break
                    if over:
                        break
                t, za = te, zb
                if te >= t1:
                    over = True
                    break
                across = tx <= ty
                jx += sx if across else 0
                jy += 0 if across else sy
                tx += ax * size if across else 0.0
                ty += 0.0 if across else ay * size
                if (jx < 0) | (jx > last_x) | (jy < 0) | (jy > last_y):
                    over = True
                    break
        if hit < INF:
            out[row, px - left], which[row, px - left] = hit, number
        elif over and not leaves:
            out[row, px - left], which[row, px - left] = np.nan, -1
        else:
            out[row, px - left] = min(t, t1)
            which[row, px - left] = ABOVE if side > 0 else BELOW if side < 0 else UNKNOWN
