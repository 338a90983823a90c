"""The data of a QuadTIN's hierarchy, and the positions of its triangles relative to the truth's: exact in int64.

Lattice units; metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel


class Truth(NamedTuple):
    """A triangulated surface.

    Attributes:
        x, y: (n,) int64 on the lattice. z: (n,) float64, metres.
        triangles: (m, 3) int32, of positive area. rim: (m,) uint8, bit k: no triangle lies beyond corners k, k + 1.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    z: NDArray[np.float64]
    triangles: NDArray[np.int32]
    rim: NDArray[np.uint8]


class Tree(NamedTuple):
    """All triangles, including split ones, in the order in which they are made.

    Attributes:
        x, y: (v,) int64; z: (v,) float64: vertices; the first four are the domain's corners.
        steiner: (v,) uint8, 1 where a vertex is a Steiner point, not one of the truth's.
        owners: (v, 2) int32, the triangles that a vertex splits, −1: none.
        corners: (t, 3) int32: left and right end of the base, apex; of positive area.
        beside: (t, 3) int32, the leaves across the base, (right, apex), (apex, left); −1: none.
        child: (t,) int32, the first of two, which have the vertex as apex: that at the left end, that at the right.
        node: (t,) int32, the vertex that splits it, −1: a leaf.
        state: (t,) uint8. error: (t,) float64, the largest deviation of the truth, metres. low, high: (t,) float64,
            heights of the truth under it.
        lists: (t, 2) int64, the part of ``pool`` with the truth's triangles that overlap a leaf.
        pool: int32. counts: (6,) int64.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    z: NDArray[np.float64]
    steiner: NDArray[np.uint8]
    owners: NDArray[np.int32]
    corners: NDArray[np.int32]
    beside: NDArray[np.int32]
    child: NDArray[np.int32]
    node: NDArray[np.int32]
    state: NDArray[np.uint8]
    error: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    lists: NDArray[np.int64]
    pool: NDArray[np.int32]
    counts: NDArray[np.int64]


class Outline(NamedTuple):
    """The rectangle that a tree covers, and the vertices that trees beyond its sides require of it.

    Sides are west, east, north, south. Vertices on an *inner* side, which has another tree beyond it, depend on its
    ends alone, so both trees have the same ones: the sample nearest to the middle; the middle itself below the
    sample spacing.

    Attributes:
        bounds: (4,) int64, the sides on the lattice. inner: (4,) uint8.
        unit: int64, the sample spacing; 0: the truth is not a raster. width, col0, row0: int64, of the raster's window.
        forced: int64, sorted, positions of vertices that the other side has; forced_at: (5,) int64, offsets by side.
        near: int32, rising, the truth's triangles that touch each side; near_at: (5,) int64.
    """

    bounds: NDArray[np.int64]
    inner: NDArray[np.uint8]
    unit: np.int64
    width: np.int64
    col0: np.int64
    row0: np.int64
    forced: NDArray[np.int64]
    forced_at: NDArray[np.int64]
    near: NDArray[np.int32]
    near_at: NDArray[np.int64]


@inlined
def orient(ax, ay, bx, by, cx, cy):
    """Twice the signed area of the triangle of three points, exact."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@inlined
def apart(tree, truth, t, s):
    """Whether a triangle of the tree and one of the truth share no area."""
    c = tree.corners
    for k in range(3):
        p, q = c[t, k], c[t, (k + 1) % 3]
        outside = True
        for i in range(3):
            v = truth.triangles[s, i]
            outside = outside and orient(
                tree.x[p], tree.y[p], tree.x[q], tree.y[q], truth.x[v], truth.y[v]) <= 0  # fmt: skip
        if outside:
            return True
    for k in range(3):
        p, q = truth.triangles[s, k], truth.triangles[s, (k + 1) % 3]
        outside = True
        for i in range(3):
            v = c[t, i]
            outside = outside and orient(
                truth.x[p], truth.y[p], truth.x[q], truth.y[q], tree.x[v], tree.y[v]) <= 0  # fmt: skip
        if outside:
            return True
    return False


@inlined
def enters(tree, truth, t, p, q):
    """Whether an edge of the truth has a part inside a triangle of the tree."""
    c = tree.corners
    px, py, qx, qy = truth.x[p], truth.y[p], truth.x[q], truth.y[q]
    below = above = False
    for k in range(3):
        u, v = c[t, k], c[t, (k + 1) % 3]
        ux, uy, vx, vy = tree.x[u], tree.y[u], tree.x[v], tree.y[v]
        if orient(ux, uy, vx, vy, px, py) <= 0 and orient(ux, uy, vx, vy, qx, qy) <= 0:
            return False
        side = orient(px, py, qx, qy, ux, uy)
        below, above = below or side < 0, above or side > 0
    return below and above


@inlined
def height_on(xs, ys, zs, a, b, c, x, y):
    """The height at a point of the plane through three vertices."""
    u = orient(xs[b], ys[b], xs[c], ys[c], x, y)
    v = orient(xs[c], ys[c], xs[a], ys[a], x, y)
    area = orient(xs[a], ys[a], xs[b], ys[b], xs[c], ys[c])
    w = area - u - v
    return (u * zs[a] + v * zs[b] + w * zs[c]) / area


@inlined
def covers(xs, ys, a, b, c, x, y):
    """Whether a point lies in a triangle, its sides included."""
    return (
        orient(xs[a], ys[a], xs[b], ys[b], x, y) >= 0
        and orient(xs[b], ys[b], xs[c], ys[c], x, y) >= 0
        and orient(xs[c], ys[c], xs[a], ys[a], x, y) >= 0
    )


@inlined
def crossing(tree, truth, u, v, p, q):
    """The deviation where a side (u, v) of the tree crosses an edge (p, q) of the truth; 0 where they do not cross."""
    ux, uy, vx, vy = tree.x[u], tree.y[u], tree.x[v], tree.y[v]
    px, py, qx, qy = truth.x[p], truth.y[p], truth.x[q], truth.y[q]
    a, b = orient(ux, uy, vx, vy, px, py), orient(ux, uy, vx, vy, qx, qy)
    if not ((a > 0 and b < 0) or (a < 0 and b > 0)):
        return 0.0
    c, d = orient(px, py, qx, qy, ux, uy), orient(px, py, qx, qy, vx, vy)
    if (c > 0 and d > 0) or (c < 0 and d < 0):
        return 0.0
    s, t = a / np.float64(a - b), c / np.float64(c - d)
    on_truth = truth.z[p] + s * (truth.z[q] - truth.z[p])
    on_side = tree.z[u] + t * (tree.z[v] - tree.z[u])
    return abs(on_truth - on_side)


@kernel
def rim_of(triangles, points):
    """Which sides of triangles have no triangle beyond them, as bits."""
    first = np.zeros(points + 1, np.int64)
    for t in range(len(triangles)):
        for k in range(3):
            first[triangles[t, k] + 1] += 1
    for p in range(points):
        first[p + 1] += first[p]
    ends, at = np.empty(first[points], np.int32), first[:-1].copy()
    for t in range(len(triangles)):
        for k in range(3):
            p = triangles[t, k]
            ends[at[p]] = triangles[t, (k + 1) % 3]
            at[p] += 1
    rim = np.zeros(len(triangles), np.uint8)
    for t in range(len(triangles)):
        for k in range(3):
            p, q = triangles[t, k], triangles[t, (k + 1) % 3]
            beyond = False
            for i in range(first[q], first[q + 1]):
                beyond = beyond or ends[i] == p
            if not beyond:
                rim[t] |= np.uint8(1 << k)
    return rim
