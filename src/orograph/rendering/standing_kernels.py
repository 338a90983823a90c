"""Rays at simple solids: bars, spheres, cones, cylinders, flags, tubes, walls, panels, columns. See ``standing``.

All positions are in stretched space (heights times the exaggeration), in metres, relative to the eye's own place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.geovis.data.standing import Kind
from orograph.viewpoint import RayBasis

EPSILON = 1e-9

BAR, SPHERE, CONE, _, FLAG, TUBE, WALL, _, PANEL, COLUMN, SECTION = map(int, Kind)


class Solids(NamedTuple):
    """Things to draw.

    Attributes:
        kind: (n,) of ``Kind``. place: (n, 3) feet. end: (n, 3) from them to the other ends of tubes and walls.
        radius, height: (n,). rgb: (n, 3). boxes: (n, 4) first and last column and row that each may cover.
    """

    kind: NDArray[np.int8]
    place: NDArray[np.float64]
    end: NDArray[np.float64]
    radius: NDArray[np.float64]
    height: NDArray[np.float64]
    rgb: NDArray[np.float32]
    boxes: NDArray[np.int64]


class Eye(NamedTuple):
    """Where the rays come from.

    Attributes:
        basis: of rays by pixel position, stretched. offsets: (s, 2) positions in a pixel.
        ahead: (2,) where the eye looks, along the ground. near: depth from which on things are seen.
    """

    basis: RayBasis
    offsets: NDArray[np.float64]
    ahead: NDArray[np.float64]
    near: float


class Light(NamedTuple):
    """sun: (3,) towards it. ambient: the share of the light that comes from everywhere."""

    sun: NDArray[np.float64]
    ambient: float


class Sheet(NamedTuple):
    """Rows of a picture.

    Attributes:
        top: the first row. depth: (rows, cols) of the ground. color: (rows, cols, s, 3). nearest: (rows, cols, s),
            inf where nothing is. which: (rows, cols) the thing nearest at the first position, −1 where none is.
    """

    top: int
    depth: NDArray[np.float64]
    color: NDArray[np.float32]
    nearest: NDArray[np.float64]
    which: NDArray[np.int32]


@inlined
def _box(ray_o, ray_d, lows, highs):
    """Parameter of the ray's entry into a box (inf if it misses) and the normal there."""
    near, far = -np.inf, np.inf
    nx = ny = nz = 0.0
    for axis in range(3):
        o, d, low, high = ray_o[axis], ray_d[axis], lows[axis], highs[axis]
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
def _sphere(o, d, middle, radius):
    (ox, oy, oz), (dx, dy, dz), (x, y, z) = o, d, middle
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
def _turned(o, d, foot, radius, height, tip):
    """A cylinder (``tip`` 1) or a cone (``tip`` 0) that stands on its foot; ``tip``: its upper radius by its lower."""
    (ox, oy, oz), (dx, dy, dz), (x, y, z) = o, d, foot
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
def _flag(o, d, foot, radius, height, ahead):
    """A thin post, and at its top a cloth ``radius`` wide that faces the eye along ``ahead``."""
    (ox, oy, oz), (dx, dy, dz), (x, y, z) = o, d, foot
    ex, ey = ahead
    best, nx, ny, nz = _turned(o, d, foot, radius / 12, height, 1.0)
    across = dx * ex + dy * ey
    if abs(across) > EPSILON:
        t = ((x - ox) * ex + (y - oy) * ey) / across
        side = (ox + t * dx - x) * ey - (oy + t * dy - y) * ex
        up = oz + t * dz - z
        if 0 <= side <= radius and height - 0.62 * radius <= up <= height and t < best:
            best, nx, ny, nz = t, -ex, -ey, 0.0
    return best, nx, ny, nz


@inlined
def _tube(o, d, foot, end, radius):
    """A tube from its foot to that and ``end``, with round ends."""
    (ox, oy, oz), (dx, dy, dz), (x, y, z), (ex, ey, ez) = o, d, foot, end
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
def _wall(o, d, foot, end, height):
    """An upright quadrangle above the line from its foot to that and ``end``."""
    (ox, oy, oz), (dx, dy, dz), (x, y, z), (ex, ey, ez) = o, d, foot, end
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


@inlined
def _hit(solids, n, o, d, ahead):
    """Parameter of a ray's hit on a thing (inf if it misses) and the normal there."""
    kind, r, h = solids.kind[n], solids.radius[n], solids.height[n]
    x, y, z = foot = solids.place[n, 0], solids.place[n, 1], solids.place[n, 2]
    ex, ey, ez = end = solids.end[n, 0], solids.end[n, 1], solids.end[n, 2]
    if kind == BAR:
        return _box(o, d, (x - r, y - r, z), (x + r, y + r, z + h))
    if kind == SPHERE:
        return _sphere(o, d, (x, y, z + r), r)
    if kind == TUBE:
        return _tube(o, d, foot, end, r)
    if kind == WALL:
        return _wall(o, d, foot, end, h)
    if kind in (PANEL, SECTION):
        if kind == PANEL and d[0] * ey - d[1] * ex <= 0:
            return np.inf, 0.0, 0.0, 0.0
        return _wall(o, d, foot, (ex, ey, 0.0), ez)
    if kind == FLAG:
        return _flag(o, d, foot, r, h, (ahead[0], ahead[1]))
    return _turned(o, d, foot, r, ez if kind == COLUMN else h, 0.0 if kind == CONE else 1.0)


@kernel
def cast(solids, chosen, eye, light, sheet):
    """Draw the ``chosen`` of ``Solids`` over a ``Sheet``."""
    o0, ou, ov, d0, du, dv = eye.basis
    kind, boxes, rgb, offsets = solids.kind, solids.boxes, solids.rgb, eye.offsets
    sun, ambient = light
    top, depth, color, nearest, which = sheet
    rows, cols = depth.shape
    for n in chosen:
        for row in range(max(boxes[n, 2] - top, 0), min(boxes[n, 3] - top + 1, rows)):
            for col in range(max(boxes[n, 0], 0), min(boxes[n, 1] + 1, cols)):
                ground = depth[row, col]
                for s in range(len(offsets)):
                    u, v = col + offsets[s, 0], top + row + offsets[s, 1]
                    o = o0[0] + u * ou[0] + v * ov[0], o0[1] + u * ou[1] + v * ov[1], o0[2] + u * ou[2] + v * ov[2]
                    d = d0[0] + u * du[0] + v * dv[0], d0[1] + u * du[1] + v * dv[1], d0[2] + u * du[2] + v * dv[2]
                    t, nx, ny, nz = _hit(solids, n, o, d, eye.ahead)
                    if not eye.near <= t < nearest[row, col, s] or t >= ground:
                        continue
                    nearest[row, col, s] = t
                    lit = ambient + (1 - ambient) * max(0.0, nx * sun[0] + ny * sun[1] + nz * sun[2])
                    if kind[n] in (PANEL, SECTION):
                        lit = 1.0
                    for c in range(3):
                        color[row, col, s, c] = rgb[n, c] * lit
                    if s == 0:
                        which[row, col] = n
