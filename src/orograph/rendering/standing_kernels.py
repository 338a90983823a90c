"""Rays at simple solids: bars, spheres, cones, cylinders, flags, tubes, walls, panels, columns. See ``standing``.

All positions are in stretched space (heights times the exaggeration), in metres, relative to the eye's own place.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel

EPSILON = 1e-9


@inlined
def _box(ox, oy, oz, dx, dy, dz, x0, x1, y0, y1, z0, z1):
    """Parameter of the ray's entry into a box (inf if it misses) and the normal there."""
    near, far = -np.inf, np.inf
    nx = ny = nz = 0.0
    for axis in range(3):
        if axis == 0:
            o, d, low, high = ox, dx, x0, x1
        elif axis == 1:
            o, d, low, high = oy, dy, y0, y1
        else:
            o, d, low, high = oz, dz, z0, z1
        if abs(d) < EPSILON:
            if o < low or o > high:
                return np.inf, 0.0, 0.0, 0.0
            continue
        t0, t1 = (low - o) / d, (high - o) / d
        if t0 > t1:
            t0, t1 = t1, t0
        if t0 > near:
            near = t0
            nx, ny, nz = 0.0, 0.0, 0.0
            side = -1.0 if d > 0 else 1.0
            if axis == 0:
                nx = side
            elif axis == 1:
                ny = side
            else:
                nz = side
        far = min(far, t1)
    if near > far:
        return np.inf, 0.0, 0.0, 0.0
    return near, nx, ny, nz


@inlined
def _sphere(ox, oy, oz, dx, dy, dz, x, y, z, radius):
    a = dx * dx + dy * dy + dz * dz
    px, py, pz = ox - x, oy - y, oz - z
    b = (px * dx + py * dy + pz * dz) / a
    # The distance from the middle to the ray, not b² − c, of which nothing is left far away.
    qx, qy, qz = px - b * dx, py - b * dy, pz - b * dz
    rest = radius * radius - (qx * qx + qy * qy + qz * qz)
    if rest < 0:
        return np.inf, 0.0, 0.0, 0.0
    t = -b - np.sqrt(rest / a)
    return t, (px + t * dx) / radius, (py + t * dy) / radius, (pz + t * dz) / radius


@inlined
def _turned(ox, oy, oz, dx, dy, dz, x, y, z, radius, height, tip):
    """A cylinder (``tip`` 1) or a cone (``tip`` 0) that stands on its foot; ``tip``: its upper radius by its lower."""
    best, nx, ny, nz = np.inf, 0.0, 0.0, 0.0
    lean = radius * (tip - 1) / height  # of the radius, per metre upwards
    px, py, pz = ox - x, oy - y, oz - z
    # (px + t dx)² + (py + t dy)² = (radius + lean (pz + t dz))²
    # A first step to the nearest approach to the axis keeps digits.
    flat = dx * dx + dy * dy
    t0 = -(px * dx + py * dy) / flat if flat > EPSILON else 0.0
    qx, qy, qz = px + t0 * dx, py + t0 * dy, pz + t0 * dz
    r0 = radius + lean * qz
    a = flat - (lean * dz) ** 2
    b = qx * dx + qy * dy - r0 * lean * dz
    c = qx * qx + qy * qy - r0 * r0
    if abs(a) > EPSILON * EPSILON:
        rest = b * b - a * c
        if rest >= 0:
            root = np.sqrt(rest)
            for sign in (-1.0, 1.0):
                t = (-b + sign * root) / a
                up = qz + t * dz
                if 0 <= up <= height and radius + lean * up >= 0 and t0 + t < best:
                    hx, hy = qx + t * dx, qy + t * dy
                    size = np.sqrt(hx * hx + hy * hy)
                    if size > 0:
                        long = np.sqrt(1 + lean * lean)
                        best, nx, ny, nz = t0 + t, hx / size / long, hy / size / long, -lean / long
    if abs(dz) > EPSILON and tip > 0:
        t = (height - pz) / dz
        hx, hy = px + t * dx, py + t * dy
        if hx * hx + hy * hy <= (radius * tip) ** 2 and t < best:
            best, nx, ny, nz = t, 0.0, 0.0, 1.0
    return best, nx, ny, nz


@inlined
def _flag(ox, oy, oz, dx, dy, dz, x, y, z, radius, height, ex, ey):
    """A thin post, and at its top a cloth ``radius`` wide that faces the eye along (ex, ey)."""
    best, nx, ny, nz = _turned(ox, oy, oz, dx, dy, dz, x, y, z, radius / 12, height, 1.0)
    across = dx * ex + dy * ey
    if abs(across) > EPSILON:
        t = ((x - ox) * ex + (y - oy) * ey) / across
        side = (ox + t * dx - x) * ey - (oy + t * dy - y) * ex
        up = oz + t * dz - z
        if 0 <= side <= radius and height - 0.62 * radius <= up <= height and t < best:
            best, nx, ny, nz = t, -ex, -ey, 0.0
    return best, nx, ny, nz


@inlined
def _tube(ox, oy, oz, dx, dy, dz, x, y, z, ex, ey, ez, radius):
    """A tube from (x, y, z) to that and (ex, ey, ez), with round ends."""
    # A first step to the nearest approach to its middle keeps digits.
    d2 = dx * dx + dy * dy + dz * dz
    near = ((x + ex / 2 - ox) * dx + (y + ey / 2 - oy) * dy + (z + ez / 2 - oz) * dz) / d2
    px, py, pz = ox + near * dx - x, oy + near * dy - y, oz + near * dz - z
    e2 = ex * ex + ey * ey + ez * ez
    best = np.inf
    if e2 > 0:
        along, way = (px * ex + py * ey + pz * ez) / e2, (dx * ex + dy * ey + dz * ez) / e2
        # What of the ray is across the axis: q + t v.
        qx, qy, qz = px - along * ex, py - along * ey, pz - along * ez
        vx, vy, vz = dx - way * ex, dy - way * ey, dz - way * ez
        a, b = vx * vx + vy * vy + vz * vz, qx * vx + qy * vy + qz * vz
        rest = b * b - a * (qx * qx + qy * qy + qz * qz - radius * radius)
        if rest >= 0 and a > EPSILON * d2:
            t = (-b - np.sqrt(rest)) / a
            if 0 <= along + t * way <= 1:
                best = t
    for k in range(2):
        sx, sy, sz = px - k * ex, py - k * ey, pz - k * ez
        b = (sx * dx + sy * dy + sz * dz) / d2
        qx, qy, qz = sx - b * dx, sy - b * dy, sz - b * dz
        rest = radius * radius - (qx * qx + qy * qy + qz * qz)
        if rest >= 0:
            best = min(best, -b - np.sqrt(rest / d2))
    if best == np.inf:
        return np.inf, 0.0, 0.0, 0.0
    hx, hy, hz = px + best * dx, py + best * dy, pz + best * dz
    s = min(max((hx * ex + hy * ey + hz * ez) / e2, 0.0), 1.0) if e2 > 0 else 0.0
    return near + best, (hx - s * ex) / radius, (hy - s * ey) / radius, (hz - s * ez) / radius


@inlined
def _wall(ox, oy, oz, dx, dy, dz, x, y, z, ex, ey, ez, height):
    """An upright quadrangle above the line from (x, y, z) to that and (ex, ey, ez)."""
    size = np.sqrt(ex * ex + ey * ey)
    across = dx * ey - dy * ex
    if size == 0.0 or abs(across) < EPSILON * size:
        return np.inf, 0.0, 0.0, 0.0
    t = ((x - ox) * ey - (y - oy) * ex) / across
    s = ((ox + t * dx - x) * ex + (oy + t * dy - y) * ey) / (size * size)
    up = oz + t * dz - z - s * ez
    if not (0 <= s <= 1 and 0 <= up <= height):
        return np.inf, 0.0, 0.0, 0.0
    side = -1.0 if across > 0 else 1.0
    return t, side * ey / size, -side * ex / size, 0.0


@kernel
def cast(
    kind, place, end, radius, height, rgb, boxes, chosen, basis, offsets, ahead, sun, ambient, near, top, depth, color,
    nearest, which,
):  # fmt: skip
    """Draw things over rows of a picture.

    Args:
        kind, radius, height: (n,). place: (n, 3) feet. end: (n, 3) from them to the other ends of tubes and walls.
        rgb: (n, 3). boxes: (n, 4) first and last column and row that a thing may cover. chosen: indices of the things
            to draw.
        basis: (6, 3) o, ou, ov, d, du, dv of rays by pixel position (``View.ray_basis``, stretched).
        offsets: (s, 2) positions in a pixel. ahead: (2,) where the eye looks, along the
            ground. sun: (3,) towards the light. ambient: of the light.
        top: the first row. depth: (rows, cols) of the ground. color: (rows, cols, s, 3). nearest: (rows, cols, s),
            inf where nothing is. which: (rows, cols) the thing nearest at the first position, −1 where none is.
    """
    rows, cols = depth.shape
    for n in chosen:
        for row in range(max(boxes[n, 2] - top, 0), min(boxes[n, 3] - top + 1, rows)):
            for col in range(max(boxes[n, 0], 0), min(boxes[n, 1] + 1, cols)):
                ground = depth[row, col]
                for s in range(len(offsets)):
                    u, v = col + offsets[s, 0], top + row + offsets[s, 1]
                    ox = basis[0, 0] + u * basis[1, 0] + v * basis[2, 0]
                    oy = basis[0, 1] + u * basis[1, 1] + v * basis[2, 1]
                    oz = basis[0, 2] + u * basis[1, 2] + v * basis[2, 2]
                    dx = basis[3, 0] + u * basis[4, 0] + v * basis[5, 0]
                    dy = basis[3, 1] + u * basis[4, 1] + v * basis[5, 1]
                    dz = basis[3, 2] + u * basis[4, 2] + v * basis[5, 2]
                    x, y, z, r, h = place[n, 0], place[n, 1], place[n, 2], radius[n], height[n]
                    if kind[n] == 0:
                        t, nx, ny, nz = _box(ox, oy, oz, dx, dy, dz, x - r, x + r, y - r, y + r, z, z + h)
                    elif kind[n] == 1:
                        t, nx, ny, nz = _sphere(ox, oy, oz, dx, dy, dz, x, y, z + r, r)
                    elif kind[n] == 5:
                        t, nx, ny, nz = _tube(ox, oy, oz, dx, dy, dz, x, y, z, end[n, 0], end[n, 1], end[n, 2], r)
                    elif kind[n] == 6:
                        t, nx, ny, nz = _wall(ox, oy, oz, dx, dy, dz, x, y, z, end[n, 0], end[n, 1], end[n, 2], h)
                    elif kind[n] == 8 or kind[n] == 10:
                        t, nx, ny, nz = _wall(ox, oy, oz, dx, dy, dz, x, y, z, end[n, 0], end[n, 1], 0.0, end[n, 2])
                        if kind[n] == 8 and dx * end[n, 1] - dy * end[n, 0] <= 0:
                            t = np.inf
                    elif kind[n] == 4:
                        t, nx, ny, nz = _flag(ox, oy, oz, dx, dy, dz, x, y, z, r, h, ahead[0], ahead[1])
                    else:
                        up = end[n, 2] if kind[n] == 9 else h
                        t, nx, ny, nz = _turned(ox, oy, oz, dx, dy, dz, x, y, z, r, up, 0.0 if kind[n] == 2 else 1.0)
                    if not near <= t < nearest[row, col, s] or t >= ground:
                        continue
                    nearest[row, col, s] = t
                    light = ambient + (1 - ambient) * max(0.0, nx * sun[0] + ny * sun[1] + nz * sun[2])
                    if kind[n] == 8 or kind[n] == 10:
                        light = 1.0
                    for c in range(3):
                        color[row, col, s, c] = rgb[n, c] * light
                    if s == 0:
                        which[row, col] = n
