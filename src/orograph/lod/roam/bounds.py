"""The bound in pixels over a triangle's volume, and for how long it stays on its side of a threshold.

*Bound* (ROAM, sec. 6.2). With the metric ``wedgie``

    f · e · max N / (a · b),    N = |(a_u·w − c_u·x, b_u·w − c_u·y)|, which does not change along a vertical,

with N at the footprint's corners, a the least depth of the volume (of a sample that is seen: at least ``near``), b that
of the mesh (at least a − e·|c_u|), u the vertical unit. Everything in it can only grow from a triangle to its parent,
for volumes nest. With a sphere metric the bound is ``sphere_bound``'s (of the anisotropic one ``loose_bound``); the
published metrics promise nothing.

*Slack* (sec. 5.3). A camera motion changes each depth, each distance to a plane of the frustum, and N / |u|, by at most
x = s + D·θ (see ``queues``). With m the depth and E = f·e: a bound that is below a threshold t stays so while
E·(N + |u|·x) ≤ t·(m − g − x)², g what the metric takes off; one above while E·(N − |u|·x) > t·(m + x)²: quadratics in
x. What is outside a plane by d stays so while x < d, what is not while x < its distance from leaving.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.error.screen import (
    ANISOTROPIC,
    WEDGIE,
    color_exceeds,
    color_slack,
    image_motion,
    loose_bound,
    sphere_bound,
    to_camera,
)
from orograph.lod.criterion import color_error
from orograph.lod.roam.mesh import EMPTY, LOADED, METRIC, RATE
from orograph.lod.roam.queues import PER_OCTAVE
from orograph.lod.roam.terms import HEIGHT, STEEPNESS
from orograph.lod.roam.volumes import corner, seen_from, straddles

STALE = 2.0 ** (1.0 / PER_OCTAVE) - 1.0
"""How far, as a share of it, a priority between the thresholds may have moved before it is computed again: the width of
a bucket, within which the order is any."""


@leaf
def below(e, n, m, up, t):
    """The motion for which e·(n + up·x) ≤ t·(m − x)² with x ≤ m goes on to hold, if it does now."""
    if not m > 0.0:
        return 0.0
    c = t * m * m - e * n
    if not c > 0.0:
        return 0.0
    b = 2.0 * t * m + e * up
    return 2.0 * c / (b + np.sqrt(max(b * b - 4.0 * t * c, 0.0)))


@leaf
def above(e, n, m, up, t):
    """The motion for which e·(n − up·x) > t·(m + x)² goes on to hold, if it does now."""
    if e == np.inf:
        return np.inf
    c = e * n - t * m * m
    if not c > 0.0:
        return 0.0
    b = 2.0 * t * m + e * up
    return 2.0 * c / (b + np.sqrt(b * b + 4.0 * t * c))


@leaf
def screen(node, edge, camera, options, low, high):
    """(the bound in pixels over a node's volume, the motion for which it does not come to lie between low and high).

    If it lies there, the motion for which it stays within ``STALE`` of what it is.
    """
    if not node.flags & LOADED or node.flags & EMPTY:
        return 0.0, np.inf
    e = np.float64(node.error)
    focal, near, up = camera.focal, camera.near, camera.exaggeration
    metric = int(options[METRIC])
    if e == np.inf:
        return np.inf, np.inf
    bound, slack = 0.0, np.inf
    if metric != WEDGIE or node.color > 0.0 or node.color < -1.0:
        row = np.float64(min((node.r0 + node.r1) >> 1, edge[0]))
        col = np.float64(min((node.c0 + node.c1) >> 1, edge[1]))
        z, r = np.float64(node.height), np.float64(node.radius) * camera.stretch
        x, y, w = to_camera(camera, col, row, z)
    if e > 0.0 and focal > 0.0:
        if metric == WEDGIE:
            depth, numerator = np.inf, 0.0
            z = np.float64(node.low if camera.depth[2] > 0.0 else node.high)
            count = 4 if straddles(node, edge) else 3
            for k in range(count):
                row_k, col_k = corner(node, edge, k)
                px, py, pw = to_camera(camera, col_k, row_k, z)
                depth = min(depth, pw)
                p, q = image_motion(camera, px, py, pw)
                numerator = max(numerator, p * p + q * q)
            numerator = np.sqrt(numerator)
            nearest, taken = max(depth, near), 0.0
            moved = max(depth, nearest - e * abs(camera.depth[2]))
            bound = focal * e * numerator / (nearest * moved) if moved > 0.0 else np.inf
        else:
            depth = w - r
            nearest, taken = max(depth, near), e * up
            if metric == ANISOTROPIC:
                bound = loose_bound(camera, x, y, w, e, r)
                p, q = image_motion(camera, x, y, w)
                numerator = np.sqrt(p * p + q * q) + r * up
            else:
                bound = sphere_bound(camera, metric, x, y, w, e, r)
                numerator = up * (np.sqrt(x * x + y * y + w * w) + r)
        if metric > WEDGIE:
            slack = 0.0  # not bounds: nothing is known of how they change
        elif bound <= low:
            slack = below(focal * e, numerator, depth - taken, up, low)
            if near > e * up and focal * e * numerator <= low * near * (near - e * up):
                # Never nearer than ``near``, whatever the depth.
                slack = max(slack, low * near * (near - e * up) / (focal * e * up) - numerator / up)
        elif bound > high:
            slack = max(above(focal * e, numerator, max(nearest, 0.0), up, high), -depth if near == 0.0 else 0.0)
        else:
            more, less = bound * (1.0 + STALE), bound / (1.0 + STALE)
            slack = below(focal * e, numerator, depth - taken, up, more)
            slack = min(slack, above(focal * e, numerator, max(nearest, 0.0), up, less))
    if node.color > 0.0 or node.color < -1.0:
        c = color_error(np.float64(node.color))
        slack = min(slack, color_slack(camera, c, w, r))
        if color_exceeds(camera, c, w, r):
            bound = max(bound, options[RATE] * c / max(camera.color_tolerance, 1e-6))
    return bound, slack


@leaf
def around(node, edge, terms, camera, options, low, high):
    """(the bound in pixels at a volume's least distance, the motion for which it stays out of (low, high))."""
    e = np.float64(node.error) * camera.focal * camera.exaggeration
    c = color_error(np.float64(node.color))
    colored = c > camera.color_tolerance
    if e == np.inf or (e <= 0.0 and not colored):
        return 0.0, np.inf
    flat = seen_from(node, edge, terms)[0]
    up = max(max(node.low - terms.eye[HEIGHT], terms.eye[HEIGHT] - node.high), 0.0) / terms.eye[STEEPNESS]
    d = np.sqrt(flat * flat + up * up)
    bound, slack = 0.0, np.inf
    if e > 0.0:
        bound = e / d if d > 0.0 else np.inf
        if bound <= low:
            slack = d - e / low
        elif bound <= high or high > 0.0:
            slack = e / high - d if bound > high else 0.0
    if colored:
        r = np.float64(node.radius) * camera.stretch
        slack = min(slack, color_slack(camera, c, d + r, r))
        if color_exceeds(camera, c, d + r, r):
            bound = max(bound, options[RATE] * c / max(camera.color_tolerance, 1e-6))
    return bound, slack
