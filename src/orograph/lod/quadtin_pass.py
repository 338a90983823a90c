"""A QuadTIN refined for a view, and the strip of its triangles.

Vertices are reached from the first one down the hierarchy; one is *active* if the bound of its error exceeds the
tolerance, it may be in view, and all that it depends on is active. Errors are saturated and spheres nested, so the last
condition holds by itself, but for rounding. The triangles are then met in the order of the Sierpinski curve: each
shares a side with the one before, so they are one generalised strip (Pajarola 1998; Lindstrom & Pascucci 2001).
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.error.screen import (
    ANISOTROPIC,
    anisotropic_exceeds,
    color_exceeds,
    outside,
    sphere_bound,
    to_camera,
    triangle_bound,
)
from orograph.store.quadtin_build import LIVE

FIRST = 4
"""The vertex that splits the first two triangles; those before are the domain's corners."""


@kernel
def parts_needed(camera, cull, centres, radii, errors, out):
    """How many parts of each block a view may need.

    Args:
        centres: (b, 3); radii: (b,); errors: (b, parts): as of ``Summary``. out: (b,) int8, filled.
    """
    for b in range(len(centres)):
        col, row, z, r = centres[b, 0], centres[b, 1], centres[b, 2], radii[b] * camera.stretch
        out[b] = 0
        if cull:
            gone, _ = outside(camera, col, row, z, r, 0)
            if gone:
                continue
        for p in range(errors.shape[1]):
            exceeds, _ = anisotropic_exceeds(camera, col, row, z, errors[b, p], r)
            if exceeds and errors[b, p] > 0:
                out[b] = p + 1


@kernel
def activate(camera, cull, tree, colors, active, met, stack):
    """Mark the active vertices; how many there are.

    Args:
        colors: (v,) float32, color errors, ΔE.
        active: (v,) uint8, of the last time, cleared by its marks in ``met``. met: (v,) int32, vertices that were
            looked at; its first entry is their number. stack: (v,) int32.
    """
    for i in range(1, met[0] + 1):
        active[met[i]] = 0
    for v in range(FIRST):
        active[v] = 1
    met[0] = 0
    count, depth = 0, 1
    stack[0] = FIRST
    active[FIRST] = 2
    met[0], met[1] = 1, FIRST
    while depth:
        depth -= 1
        v = stack[depth]
        col, row, z = tree.vertices[v, 0], tree.vertices[v, 1], tree.vertices[v, 2]
        r = np.float64(tree.radius[v]) * camera.stretch
        split, w = anisotropic_exceeds(camera, col, row, z, np.float64(tree.error[v]), r)
        split = split or color_exceeds(camera, colors[v], w, r)
        seen = True
        if cull and split:
            gone, _ = outside(camera, col, row, z, r, 0)
            seen = not gone
        if not (split and seen):
            active[v] = 3  # looked at
            continue
        active[v] = 1
        count += 1
        for k in range(4):
            u = tree.nodes[v, k]
            if u < 0 or active[u] != 0:
                continue
            if active[tree.parents[u, 0]] == 1 and active[tree.parents[u, 1]] == 1:
                active[u] = 2
                met[0] += 1
                met[met[0]] = u
                stack[depth] = u
                depth += 1
    return count


@inlined
def distance(tree, i, j):
    """Metres between two vertices."""
    p, linear = tree.vertices, tree.linear
    dx, dy, dz = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]
    east, north = linear[0, 0] * dx + linear[0, 1] * dy, linear[1, 0] * dx + linear[1, 1] * dy
    return np.sqrt(east * east + north * north + dz * dz)


@inlined
def finest_bound(camera, tree, t):
    """The bound in pixels of a triangle that is not split any further; 0 where it is not in view."""
    a, b, c = tree.corners[t, 2], tree.corners[t, 0], tree.corners[t, 1]
    p, off = tree.vertices, np.float64(tree.off[t])
    r = (max(distance(tree, a, b), distance(tree, a, c)) + off) * camera.stretch
    gone, _ = outside(camera, p[a, 0], p[a, 1], p[a, 2], r, 0)
    if gone:
        return 0.0
    ax, ay, aw = to_camera(camera, p[a, 0], p[a, 1], p[a, 2])
    bx, by, bw = to_camera(camera, p[b, 0], p[b, 1], p[b, 2])
    cx, cy, cw = to_camera(camera, p[c, 0], p[c, 1], p[c, 2])
    return min(
        sphere_bound(camera, ANISOTROPIC, ax, ay, aw, off, r),
        triangle_bound(camera, ax, ay, aw, bx, by, bw, cx, cy, cw, off),
    )


@kernel
def leaves_of(camera, tree, active, out, stack):
    """The triangles of a mesh whose active vertices are marked by 1, in the curve's order: how many (−1: no room), and
    the largest bound in pixels of those that are not split any further.

    Args:
        out: (m,) int32, filled with triangles that lie on ground. stack: (k, 2) int32.
    """
    stack[0, 0], stack[0, 1] = 1, 1
    stack[1, 0], stack[1, 1] = 0, 1
    depth, count, worst = 2, 0, 0.0
    while depth:
        depth -= 1
        t, forward = stack[depth, 0], stack[depth, 1]
        m = tree.node[t]
        if m >= 0 and active[m] == 1:
            one = tree.child[t]
            first, second = (one, one + 1) if forward else (one + 1, one)
            stack[depth, 0], stack[depth, 1] = second, 1 - forward
            stack[depth + 1, 0], stack[depth + 1, 1] = first, 1 - forward
            depth += 2
        elif tree.state[t] == LIVE:
            if count == len(out):
                return -1, worst
            out[count] = t
            count += 1
            if m == -1:
                worst = max(worst, finest_bound(camera, tree, t))
    return count, worst


@inlined
def has(triangles, i, v):
    """Whether a vertex is a corner of triangle i."""
    return triangles[i, 0] == v or triangles[i, 1] == v or triangles[i, 2] == v


@kernel
def strip_of(triangles, out):
    """One generalised strip of triangles (m, 3) that all turn the same way, where one can share a side with the next.

    Triangle i of the strip joins its vertices i to i + 2, every second one turned over; those without area join parts,
    and turn corners. Returns the strip's length.
    """
    length = 0
    for i in range(len(triangles)):
        a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
        joined, new = False, a
        if length:
            u, v = out[length - 2], out[length - 1]
            if has(triangles, i, u) and has(triangles, i, v):
                new = a if a != u and a != v else b if b != u and b != v else c
                joined = out[length - 3] != new
        if joined:
            out[length] = new
            length += 1
        else:
            # The first corner is the one that the next triangle lacks, so that the strip goes on from the other two.
            if i + 1 < len(triangles):
                for _ in range(2):
                    if has(triangles, i + 1, a):
                        a, b, c = b, c, a
            if length:
                out[length], out[length + 1] = out[length - 1], a
                length += 2
                if length % 2 == 1:
                    out[length] = a
                    length += 1
            out[length], out[length + 1], out[length + 2] = a, b, c
            length += 3
        if i + 1 < len(triangles):
            # Where the next triangle hangs on the side (first, last) of this one, that side is brought to the end.
            w, u, v = out[length - 3], out[length - 2], out[length - 1]
            k = i + 1
            if has(triangles, k, v) and has(triangles, k, w) and not has(triangles, k, u):
                out[length - 1], out[length] = w, v
                length += 1
    return length
