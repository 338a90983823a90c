"""The metric ``localised``: the wedgie's bound taken apart, so that a large triangle is judged where its error is.

A wedgie puts the largest error of a whole triangle at the corner from which it looks worst, though the sample that is
off may lie at the other end, or out of view. Here a triangle T is judged by branch and bound over the triangles below
it in the hierarchy. For a triangle t under T, the full-resolution surface over t lies within

    min(e_T, e_t + max over t's corners of |z − T|)        metres of T on its vertical,

e the stored errors (bounds, exact errors best): t's surface is linear, and so is T's. That length, projected from the
part of T under t, bounds what points of t are displaced by; t is done if this is within the tolerance, or if the
prism t ± e_t is out of view. Otherwise t is halved; the vertex in the middle of its hypotenuse is a sample, and if it
is in view and *its* displacement exceeds the tolerance, T is inaccurate beyond doubt. At the depth allowed the bounds
stand as they are. A finest triangle is the surface itself (e_t = 0), and is judged by the bound unless it is wholly
out of view: its corners may be out of view and points between them not. All of it is conservative.

Not for triangles that straddle the border of a raster that is not 2^n + 1 samples wide (the squeeze takes their halves
off their own ground), nor for published errors that are no bounds. Metres, pixels; coordinates as in ``error.screen``.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.error.screen import image_motion, in_frustum, plane_of, to_camera, triangle_bound
from orograph.hierarchy.kernels import diamonds
from orograph.lod.field import find

STACK = 10
"""Numbers that wait for each triangle: row, column and height of three corners, and its depth below T."""


@inlined
def prism_outside(camera, a, b, c, e):
    """Whether all points within e (metres) of a triangle on their vertical lie beyond one plane of the frustum.

    Args:
        a, b, c: (row, column, height) of its corners.
    """
    (ar, ac, az), (br, bc, bz), (cr, cc, cz) = a, b, c
    for plane in range(6):
        p, q, v, d = plane_of(camera, plane)
        farthest = max(p * ac + q * ar + v * az, max(p * bc + q * br + v * bz, p * cc + q * cr + v * cz)) + d
        if farthest + e * abs(v) < 0.0:
            return True
    return False


@inlined
def plane_through(e, x, a):
    """(base, down, across) of the plane through three corners: its height is base + down · row + across · col."""
    (er, ec, ez), (xr, xc, xz), (ar, ac, az) = e, x, a
    p1r, p1c, p2r, p2c = np.float64(xr - er), np.float64(xc - ec), np.float64(ar - er), np.float64(ac - ec)
    area = p1r * p2c - p1c * p2r
    z1, z2 = np.float64(xz) - np.float64(ez), np.float64(az) - np.float64(ez)
    down = (z1 * p2c - z2 * p1c) / area
    across = (z2 * p1r - z1 * p2r) / area
    return np.float64(ez) - down * er - across * ec, down, across


@inlined
def put(todo, at, e, x, a, depth):
    """Let a triangle wait at a place of the stack: the ends of its hypotenuse and its apex, and its depth below T."""
    todo[at, 0], todo[at, 1], todo[at, 2] = e
    todo[at, 3], todo[at, 4], todo[at, 5] = x
    todo[at, 6], todo[at, 7], todo[at, 8] = a
    todo[at, 9] = depth


@inlined
def take(todo, at):
    """The triangle that waits there: the ends of its hypotenuse and its apex, and its depth below T."""
    e, x = (todo[at, 0], todo[at, 1], todo[at, 2]), (todo[at, 3], todo[at, 4], todo[at, 5])
    return e, x, (todo[at, 6], todo[at, 7], todo[at, 8]), np.int64(todo[at, 9])


@inlined
def push_halves(todo, top, b, d, f, m, depth):
    """Put the halves of triangle b, d, f on the stack; m is the middle of its hypotenuse, depth theirs. The new top."""
    put(todo, top, f, b, m, depth)
    put(todo, top + 1, f, d, m, depth)
    return top + 2


@inlined
def localised_bound(pages, camera, triangle, level, leaf, e, mz, low, enough, cull, depth, todo):
    """(a bound in pixels of what T displaces, whether a page is missing) for a triangle T inside the raster.

    Args:
        triangle: row, column (int64) and height of the hypotenuse's ends and the apex.
        level, leaf: T's and the finest level. e: T's error, finite. mz: height of T's middle.
        low: displacements up to this do not matter. enough: one beyond this ends the search.
        cull: whether what is out of view does not count.
        depth: halvings.
        todo: float64 (depth + 2, STACK) for triangles that wait.
    """
    n = leaf >> 1
    base, down, across = plane_through(triangle[0], triangle[1], triangle[2])
    worst = 0.0
    missed = False
    top = 1
    put(todo, 0, triangle[0], triangle[1], triangle[2], 0.0)
    first = True
    while top > 0:
        top -= 1
        b, d, f, at = take(todo, top)
        (br, bc, bz), (dr, dc, dz), (fr, fc, fz) = b, d, f
        finest = level + at == leaf
        hz, known = np.float64(mz), np.float64(e)
        if finest:
            known = np.float64(0.0)  # it is the ground
        elif not first:
            slot, i, j = find(pages, np.int64(br + dr) >> 1, np.int64(bc + dc) >> 1, n - 1 - ((level + at) >> 1))
            if slot < 0:
                missed = True
                continue
            hz, known = np.float64(pages.data[slot, i, j, 0]), np.float64(pages.data[slot, i, j, 1])
        if (cull or finest) and not first and prism_outside(camera, b, d, f, known):
            continue
        tb = base + down * br + across * bc
        td = base + down * dr + across * dc
        tf = base + down * fr + across * fc
        if not first:
            # (1e-9: roundings of the plane's heights must not make the bound smaller)
            off = max(abs(bz - tb), max(abs(dz - td), abs(fz - tf)))
            length = min(e, (known + off) * (1.0 + 1e-9))
            bx, by, bw = to_camera(camera, bc, br, tb)
            dx, dy, dw = to_camera(camera, dc, dr, td)
            fx, fy, fw = to_camera(camera, fc, fr, tf)
            bound = triangle_bound(camera, bx, by, bw, dx, dy, dw, fx, fy, fw, length)
            if bound <= max(low, worst):
                continue
            if at >= depth or finest:
                worst = bound
                if worst > enough:
                    break
                continue
        first = False
        # The middle is a sample: what it is displaced by, if it is in view.
        mr, mc = 0.5 * (br + dr), 0.5 * (bc + dc)
        on = base + down * mr + across * mc
        x, y, w = to_camera(camera, mc, mr, hz)
        if w > 0.0 and (not cull or in_frustum(camera, mc, mr, hz)):
            moved = w + (on - hz) * camera.depth[2]
            p, q = image_motion(camera, x, y, w)
            if moved > 0.0:
                # (Whoever looks at this sample may round otherwise.)
                worst = max(worst, camera.focal * abs(on - hz) * np.sqrt(p * p + q * q) / (w * moved) * (1.0 + 1e-9))
            else:
                worst = np.inf
            if worst > enough:
                break
        top = push_halves(todo, top, b, d, f, (mr, mc, hz), at + 1)
    return worst, missed


@inlined
def sample_exceeds(camera, col, row, z, on, cull):
    """Whether a sample in view is displaced by more than the tolerance from the height ``on``."""
    x, y, w = to_camera(camera, col, row, z)
    p, q = image_motion(camera, x, y, w)
    moved = w + (on - z) * camera.depth[2]
    far = camera.tolerance * w * moved
    off = camera.focal * (on - z)
    exceeds = w > 0.0 and (moved <= 0.0 or off * off * (p * p + q * q) > far * far)
    return exceeds and (not cull or in_frustum(camera, col, row, z))


@leaf
def diamond_exceeds(pages, camera, cull, depth, row, col, n, todo):
    """(1 if B of the diamond at (row, col) exceeds the tolerance, 2 if its triangles are out of view, else 0; whether a
    page was missing).

    Args:
        todo: float64 (depth + 2, STACK), scratch.
    """
    size = np.int64(1) << n
    slot, i, j = find(pages, row, col, diamonds.octave(row, col))
    mz, e = np.float64(pages.data[slot, i, j, 0]), np.float64(pages.data[slot, i, j, 1])
    er, ec = diamonds.end(row, col, 0)
    xr, xc = diamonds.end(row, col, 1)
    es, ei, ej = _corner(pages, er, ec, size)
    xs, xi, xj = _corner(pages, xr, xc, size)
    tolerance = camera.tolerance
    missed = es < 0 or xs < 0
    out = True
    # The middle is a sample of both triangles: many need no more than a look at it.
    if not missed:
        on = 0.5 * (np.float64(pages.data[es, ei, ej, 0]) + np.float64(pages.data[xs, xi, xj, 0]))
        inside = er + xr == 2 * row and max(er, xr) <= pages.edge[0] and max(ec, xc) <= pages.edge[1]
        if inside and sample_exceeds(camera, np.float64(col), np.float64(row), mz, on, cull):
            return 1, False
    for k in range(2):
        ar, ac = diamonds.apex(row, col, k)
        if ar < 0 or ac < 0 or ar > size or ac > size:
            continue
        if max(er, max(xr, ar)) > pages.edge[0] or max(ec, max(xc, ac)) > pages.edge[1]:
            return 1, False
        s, i, j = _corner(pages, ar, ac, size)
        if missed or s < 0:
            missed = True
            continue
        ez, xz, az = pages.data[es, ei, ej, 0], pages.data[xs, xi, xj, 0], pages.data[s, i, j, 0]
        triangle = (er, ec, ez), (xr, xc, xz), (ar, ac, az)
        if cull and prism_outside(camera, triangle[0], triangle[1], triangle[2], e):
            continue
        out = False
        ex, ey, ew = to_camera(camera, ec, er, np.float64(ez))
        xx, xy, xw = to_camera(camera, xc, xr, np.float64(xz))
        ax, ay, aw = to_camera(camera, ac, ar, np.float64(az))
        if triangle_bound(camera, ex, ey, ew, xx, xy, xw, ax, ay, aw, e) <= tolerance:
            continue
        level = np.int64(diamonds.level(row, col, n))
        bound, lacks = localised_bound(
            pages, camera, triangle, level, 2 * n, e, mz, tolerance, tolerance, cull, depth, todo
        )
        if bound > tolerance:
            return 1, False
        missed = missed or lacks
    return (2 if out else 0), missed


@inlined
def _corner(pages, row, col, size):
    """(slot, i, j) of a vertex of any octave; the corners of the square are in the coarsest pages."""
    octave = np.int64(63)
    if (row | col) & (size - 1) != 0:
        octave = diamonds.octave(row, col)
    return find(pages, row, col, octave)
