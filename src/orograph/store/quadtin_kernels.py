"""The stored form of a QuadTIN's hierarchy: errors and spheres of its vertices, closed over it, and its triangles.

Triangles are ordered by depth, and within a depth by their parents; vertices are in the order in which they
split triangles. So the topology is stored as the splitting vertex of each triangle, and nothing else.
Errors and radii are float32, rounded up when they are computed, so the closure holds for the stored numbers. Metres.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.quadtin_build import DEAD, MIXED, RIM, VERTICES

UNREAD = -2
"""Replaces the number of a splitting vertex that is not in memory; −1: there is none."""


@inlined
def up(value):
    """A number as float32, rounded up."""
    found = np.float32(value)
    return found if found >= value else np.nextafter(found, np.float32(np.inf))


@kernel
def own_bounds(tree, east, north, error, radius):
    """Compute the errors and spheres of each vertex's own triangles.

    Args:
        east, north: (v,) metres. error, radius: (v,) float32 zeros, filled: the error of the triangles that a vertex
            splits, and the radius around it that covers their ground.
    """
    for v in range(4, tree.counts[VERTICES]):
        for side in range(2):
            t = tree.owners[v, side]
            if t < 0:
                continue
            error[v] = max(error[v], np.float32(np.inf) if tree.state[t] == MIXED else up(tree.error[t]))
            if tree.state[t] != DEAD:
                far = 0.0
                for k in range(3):
                    c = tree.corners[t, k]
                    far = max(far, np.hypot(east[c] - east[v], north[c] - north[v]))
                height = max(abs(tree.high[t] - tree.z[v]), abs(tree.low[t] - tree.z[v]))
                radius[v] = max(radius[v], up(np.hypot(far, height) * (1 + RIM)))


@kernel
def saturate(places, parents, error, radius):
    """Close errors and spheres over a hierarchy.

    The error of a vertex becomes at least those of its dependents, and its sphere contains theirs.

    Args:
        places: (v, 3) metres, vertices before their dependents. parents: (v, 2) int32, −1: none.
        error, radius: (v,) float32, changed.
    """
    for v in range(len(parents) - 1, -1, -1):
        for k in range(2):
            p = parents[v, k]
            if p < 0:
                continue
            error[p] = max(error[p], error[v])
            dx, dy, dz = places[p, 0] - places[v, 0], places[p, 1] - places[v, 1], places[p, 2] - places[v, 2]
            radius[p] = max(radius[p], up((np.sqrt(dx * dx + dy * dy + dz * dz) + radius[v]) * (1 + RIM)))


@kernel
def expand(node, ids, roots, base, corners, child, nodes_of, parents, nodes):
    """Rebuild the topology of a part of a hierarchy.

    Args:
        node: (t,) int32, the vertex that splits each triangle, −1: none; numbers beyond ``ids`` are not in memory.
        ids: (v,) int32, the numbers of vertices in the whole. roots: (2,) int32, the numbers of the first two
            triangles, whose corners are known; the others are ``base`` and so on.
        corners: (T, 3) int32. child, nodes_of: (T,) int32: the first child, the vertex. parents: (V, 2) int32, −1 where
            not yet known. nodes: (V, 4) int32, the dependents of each vertex, −1 likewise.
    """
    following = 2
    for t in range(len(node)):
        at = roots[t] if t < 2 else base + t - 2
        n = node[t]
        if n < 0 or n >= len(ids):
            nodes_of[at], child[at] = (-1 if n < 0 else UNREAD), -1
            continue
        m = ids[n]
        one = base + following - 2
        following += 2
        nodes_of[at], child[at] = m, one
        p, q, a = corners[at, 0], corners[at, 1], corners[at, 2]
        corners[one, 0], corners[one, 1], corners[one, 2] = a, p, m
        corners[one + 1, 0], corners[one + 1, 1], corners[one + 1, 2] = q, a, m
        if parents[m, 0] < 0:
            parents[m, 0] = parents[m, 1] = a
        else:
            parents[m, 1] = a
        for k in range(4):
            if nodes[a, k] == m:
                break
            if nodes[a, k] < 0:
                nodes[a, k] = m
                break
    return following
