"""Triangles of a tile become samples: the rasteriser's second half.

A sample is inside a triangle if it is inside its three edges (Pineda 1988, *A parallel algorithm for polygon
rasterization*); on an edge, it belongs to the triangle if that edge is a top or a left one. Corners and samples lie on
the lattice of ``raster_setup`` and edge functions are exact, so triangles that share an edge cover every sample once:
no gap, no double hit; and if corners do not meet, exactly the gap between them.

Depth is that of the sample's ray and the triangle's own plane in sample coordinates, in float64, regardless of snapping
and cutting; a sample that is inside only because of snapping gets no depth beyond those of the corners. The nearest
triangle wins, and of equally near ones that with the lower index: the order of drawing does not matter.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel, leaf
from orograph.rendering.cpu.raster_setup import BITS, ONE, corners_of

HALF = ONE >> 1


@leaf
def edge(px, py, qx, qy, x, y):
    """The edge function of p → q at (x, y), exact; not negative where the sample belongs to the inner side."""
    dx, dy = qx - px, qy - py
    owned = dy < 0 or (dy == 0 and dx > 0)  # a left or top edge
    return dx * (y - py) - dy * (x - px) - (0 if owned else 1)


@leaf
def plane_of(camera, mesh, triangle):
    """(a, b, c, nearest, farthest) of a triangle.

    a·x + b·y + c is 1/depth at pixel position (x, y) in perspective, and depth in a plan; nearest and farthest are the
    depths of its corners.
    """
    i, j, k = mesh.triangles[triangle, 0], mesh.triangles[triangle, 1], mesh.triangles[triangle, 2]
    p, q, r, o = mesh.vertices[i], mesh.vertices[j], mesh.vertices[k], camera.o
    ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    fx, fy, fz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    away = nx * (p[0] - o[0]) + ny * (p[1] - o[1]) + nz * (p[2] - o[2])
    along = nx * camera.d[0] + ny * camera.d[1] + nz * camera.d[2]
    u, v = (camera.du, camera.dv) if camera.perspective else (camera.ou, camera.ov)
    across = nx * u[0] + ny * u[1] + nz * u[2]
    down = nx * v[0] + ny * v[1] + nz * v[2]
    nearest = max(min(mesh.depth[i], mesh.depth[j], mesh.depth[k]), camera.clip)
    farthest = max(mesh.depth[i], mesh.depth[j], mesh.depth[k])
    if camera.perspective:
        return across / away, down / away, along / away, nearest, farthest
    return -across / along, -down / along, away / along, nearest, farthest


@leaf
def depth_at(plane, perspective, x, y):
    """Depth of a triangle's plane at a pixel position, within the depths of its corners."""
    a, b, c, nearest, farthest = plane
    t = a * x + (b * y + c)
    if perspective:
        t = 1.0 / t
    if not t >= nearest:  # true for NaN, for a triangle seen edge-on
        return nearest
    return min(t, farthest)


@kernel
def draw_tile(camera, mesh, numbers, left, right, top, bottom, depth, objects):
    """Draw the triangles and pieces ``numbers`` into the pixels [left, right) × [top, bottom) of the picture.

    Args:
        depth, objects: (bottom − top, right − left), NaN and −1 where nothing is drawn yet.
    """
    nowhere = (0.0, 0.0, 0.0, 0.0, 0.0)
    for number in numbers:
        ax, ay, bx, by, cx, cy, _ = corners_of(mesh, number)
        # Pixels whose centres lie within the bounds of the corners.
        x0 = max((min(ax, bx, cx) + HALF - 1) >> BITS, left)
        x1 = min((max(ax, bx, cx) - HALF) >> BITS, right - 1)
        y0 = max((min(ay, by, cy) + HALF - 1) >> BITS, top)
        y1 = min((max(ay, by, cy) - HALF) >> BITS, bottom - 1)
        if x0 > x1 or y0 > y1:
            continue
        triangle = number if number >= 0 else mesh.owners[-1 - number]
        x, y = (x0 << BITS) + HALF, (y0 << BITS) + HALF
        e0, e1, e2 = edge(ax, ay, bx, by, x, y), edge(bx, by, cx, cy, x, y), edge(cx, cy, ax, ay, x, y)
        u0, u1, u2 = (ay - by) << BITS, (by - cy) << BITS, (cy - ay) << BITS
        v0, v1, v2 = (bx - ax) << BITS, (cx - bx) << BITS, (ax - cx) << BITS
        plane, placed = nowhere, False
        for row in range(y0, y1 + 1):
            f0, f1, f2 = e0, e1, e2
            entered = False
            for col in range(x0, x1 + 1):
                if (f0 | f1 | f2) >= 0:
                    if not placed:
                        plane, placed = plane_of(camera, mesh, triangle), True
                    entered = True
                    t = depth_at(plane, camera.perspective, col + 0.5, row + 0.5)
                    j, i = col - left, row - top
                    before = depth[i, j]
                    if camera.near <= t <= camera.far and (
                        not t >= before or (t == before and triangle < objects[i, j])
                    ):
                        depth[i, j], objects[i, j] = t, triangle
                elif entered:
                    break
                f0, f1, f2 = f0 + u0, f1 + u1, f2 + u2
            e0, e1, e2 = e0 + v0, e1 + v1, e2 + v2


@kernel
def sort_by_pixel(level, left, top, px, py, order, starts):
    """Sort positions in a tile by pixel, row by row, with a counting sort.

    The tile has 2^``level`` pixels a side and begins at pixel (left, top). ``order`` (n,) lists positions, of which
    pixel k has [starts[k], starts[k + 1]).
    """
    starts[:] = 0
    for i in range(len(px)):
        starts[((np.int64(py[i]) - top) << level) + np.int64(px[i]) - left + 1] += 1
    for k in range(1, len(starts)):
        starts[k] += starts[k - 1]
    for i in range(len(px) - 1, -1, -1):  # from the last: starts[k + 1], pixel k's end, moves down to its beginning
        k = ((np.int64(py[i]) - top) << level) + np.int64(px[i]) - left
        starts[k + 1] -= 1
        order[starts[k + 1]] = i
    for k in range(len(starts) - 1):
        starts[k] = starts[k + 1]
    starts[-1] = len(px)


@kernel
def sample_tile(camera, mesh, numbers, level, left, top, px, py, depth, objects):
    """Draw the triangles and pieces ``numbers`` at positions inside the tile of 2^``level`` pixels at (left, top).

    Args:
        px, py: (n,) pixel positions. depth, objects: (n,), NaN and −1 where nothing is drawn yet.
    """
    side = 1 << level
    starts, order = np.empty((side << level) + 1, np.int64), np.empty(len(px), np.int64)
    sort_by_pixel(level, left, top, px, py, order, starts)
    fixed = np.empty((len(px), 2), np.int64)
    for k in range(len(order)):
        fixed[k, 0], fixed[k, 1] = np.floor(px[order[k]] * ONE), np.floor(py[order[k]] * ONE)
    nowhere = (0.0, 0.0, 0.0, 0.0, 0.0)
    for number in numbers:
        ax, ay, bx, by, cx, cy, _ = corners_of(mesh, number)
        x0, x1 = max((min(ax, bx, cx) >> BITS) - left, 0), min((max(ax, bx, cx) >> BITS) - left, side - 1)
        y0, y1 = max((min(ay, by, cy) >> BITS) - top, 0), min((max(ay, by, cy) >> BITS) - top, side - 1)
        triangle = number if number >= 0 else mesh.owners[-1 - number]
        plane, placed = nowhere, False
        for row in range(y0, y1 + 1):
            for k in range(starts[(row << level) + x0], starts[(row << level) + x1 + 1]):
                x, y = fixed[k, 0], fixed[k, 1]
                if edge(ax, ay, bx, by, x, y) < 0 or edge(bx, by, cx, cy, x, y) < 0 or edge(cx, cy, ax, ay, x, y) < 0:
                    continue
                if not placed:
                    plane, placed = plane_of(camera, mesh, triangle), True
                i = order[k]
                t = depth_at(plane, camera.perspective, px[i], py[i])
                if camera.near <= t <= camera.far and (not t >= depth[i] or (t == depth[i] and triangle < objects[i])):
                    depth[i], objects[i] = t, triangle
