"""From a mesh to triangles sorted by tiles of the picture: the rasteriser's first half.

Vertices are projected once and snapped to a lattice of 1/4096 pixel, on which all further steps are exact (int64). A
triangle that comes too near to the eye's plane, or reaches farther than ``GUARD`` pixels from the picture, is cut into
*pieces* first (Sutherland & Hodgman 1974, *Reentrant polygon clipping*; homogeneous, Blinn & Newell 1978). New corners
are computed from an edge's inner end to its outer one, so both triangles at an edge get the same. Triangles and pieces
are then put into every tile that they touch, by counting sort: one pass counts, one writes.

Units: pixels of the whole picture; *fixed*: 1/4096 of them. Depths in metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.rendering.projection import Projection

BITS = 12
"""Fractional bits of a fixed coordinate."""

ONE = 1 << BITS

GUARD = 1 << 17
"""Pixels from the picture's first one beyond which triangles are cut off. Edge functions stay below 8·(2^29)² = 2^61.
It is also the largest picture."""

UNPLACED = -(1 << 31)
"""The fixed x of a vertex that has no place on the lattice."""

CORNERS = 8
"""A triangle cut by five planes has at most as many corners."""

PIECES = CORNERS - 2


class Camera(NamedTuple):
    """``Projection`` for kernels."""

    matrix: NDArray[np.float64]
    o: NDArray[np.float64]
    ou: NDArray[np.float64]
    ov: NDArray[np.float64]
    d: NDArray[np.float64]
    du: NDArray[np.float64]
    dv: NDArray[np.float64]
    perspective: bool
    width: int
    height: int
    near: float
    far: float
    clip: float

    @classmethod
    def of(cls, p: Projection) -> Camera:
        size = p.width, p.height
        return cls(p.matrix(), p.o, p.ou, p.ov, p.d, p.du, p.dv, p.perspective, *size, p.near, p.far, p.clip)


class Mesh(NamedTuple):
    """A projected mesh.

    A *number* k ≥ 0 is that of a triangle; −1 − k is that of a piece.

    Attributes:
        vertices: (n, 3) float64, sample coordinates. triangles: (m, 3) int32.
        screen: (n, 2) int32, fixed; x = ``UNPLACED`` for vertices without a place. depth: (n,) float64.
        pieces: (k, 3, 2) int32, fixed. owners: (k,) int32, the triangles that the pieces belong to.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    screen: NDArray[np.int32]
    depth: NDArray[np.float64]
    pieces: NDArray[np.int32]
    owners: NDArray[np.int32]


class Tiling(NamedTuple):
    """Squares of 2^``level`` pixels that cover a picture: ``rows`` × ``cols`` of them, row by row."""

    level: int
    rows: int
    cols: int


@leaf
def homogeneous(camera, vertices, i):
    """(t·x, t·y, t) of a vertex at depth t and pixel position (x, y); in a plan (x, y, t)."""
    m, o = camera.matrix, camera.o
    x, y, z = vertices[i, 0] - o[0], vertices[i, 1] - o[1], vertices[i, 2] - o[2]
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@kernel
def project(camera, vertices, first, last, screen, depth):
    """Project the vertices [first, last) into ``screen`` and ``depth`` of ``Mesh``; returns how many have no place."""
    unplaced = 0
    for i in range(first, last):
        x, y, t = homogeneous(camera, vertices, i)
        depth[i] = t
        k = 1.0 / t if camera.perspective else 1.0
        u, v = x * k, y * k
        if t >= camera.clip and abs(u) <= GUARD and abs(v) <= GUARD:  # false for NaN
            screen[i, 0], screen[i, 1] = np.floor(u * ONE + 0.5), np.floor(v * ONE + 0.5)
        else:
            screen[i, 0], screen[i, 1] = UNPLACED, UNPLACED
            unplaced += 1
    return unplaced


@leaf
def outside(camera, vertices, i):
    """The planes of the picture that a vertex lies outside of, as bits."""
    x, y, t = homogeneous(camera, vertices, i)
    w = t if camera.perspective else 1.0
    bits = 1 if t < camera.clip else 0
    bits |= 2 if x < 0.0 else 4 if x > camera.width * w else 0
    bits |= 8 if y < 0.0 else 16 if y > camera.height * w else 0
    return bits


@kernel
def find_unplaced(camera, mesh, first, last, out):
    """Write to ``out`` which of the triangles [first, last) must be cut to be drawn; their count."""
    n = 0
    for k in range(first, last):
        a, b, c = mesh.triangles[k, 0], mesh.triangles[k, 1], mesh.triangles[k, 2]
        s, v = mesh.screen, mesh.vertices
        if s[a, 0] != UNPLACED and s[b, 0] != UNPLACED and s[c, 0] != UNPLACED:
            continue
        if outside(camera, v, a) & outside(camera, v, b) & outside(camera, v, c) == 0:
            out[n] = k
            n += 1
    return n


@leaf
def inner_distance(camera, p, plane):
    """How far a homogeneous point (3,) lies inside a clipping plane: 0 the eye's, 1 to 4 the guard band's."""
    if plane == 0:
        return p[2] - camera.clip
    far = GUARD * (p[2] if camera.perspective else 1.0)
    if plane == 1:
        return far + p[0]
    if plane == 2:
        return far - p[0]
    if plane == 3:
        return far + p[1]
    return far - p[1]


@leaf
def cut(camera, plane, polygon, count, out):
    """The part of a convex polygon (``count`` homogeneous corners) inside a plane; its number of corners."""
    n = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        here, there = inner_distance(camera, polygon[i], plane), inner_distance(camera, polygon[j], plane)
        if here >= 0.0:
            for axis in range(3):
                out[n, axis] = polygon[i, axis]
            n += 1
        if (here >= 0.0) != (there >= 0.0):
            a, b, p, q = (i, j, here, there) if here >= 0.0 else (j, i, there, here)
            f = p / (p - q)
            for axis in range(3):
                out[n, axis] = polygon[a, axis] + (polygon[b, axis] - polygon[a, axis]) * f
            if plane == 0:
                out[n, 2] = camera.clip
            n += 1
    return n


@kernel
def cut_triangles(camera, mesh, chosen, pieces, owners):
    """Cut the triangles ``chosen`` (k,) into pieces (≥ 6·k, 3, 2) fixed with ``owners``; returns how many."""
    one, other = np.empty((CORNERS + 1, 3)), np.empty((CORNERS + 1, 3))
    fixed = np.empty((CORNERS + 1, 2), np.int32)
    first = 0 if camera.perspective else 1
    total = 0
    for k in chosen:
        finite = True
        for corner in range(3):
            x, y, t = homogeneous(camera, mesh.vertices, mesh.triangles[k, corner])
            one[corner, 0], one[corner, 1], one[corner, 2] = x, y, t
            finite &= np.isfinite(x) and np.isfinite(y) and np.isfinite(t)
        n = 3 if finite else 0
        for plane in range(first, 5):
            n = cut(camera, plane, one, n, other)
            one, other = other, one
        for i in range(n):
            w = one[i, 2] if camera.perspective else 1.0
            for axis in range(2):
                place = min(max(one[i, axis] / w, -GUARD), GUARD)
                fixed[i, axis] = np.floor(place * ONE + 0.5)
        for i in range(1, n - 1):
            for axis in range(2):
                pieces[total, 0, axis], pieces[total, 1, axis] = fixed[0, axis], fixed[i, axis]
                pieces[total, 2, axis] = fixed[i + 1, axis]
            owners[total] = k
            total += 1
    return total


@leaf
def corners_of(mesh, number):
    """The corners of a triangle or piece, oriented so that its area is not negative, and twice that area.

    (ax, ay, bx, by, cx, cy) are int64, fixed. The area is 0 for triangles without area or place.
    """
    if number >= 0:
        i, j, k = mesh.triangles[number, 0], mesh.triangles[number, 1], mesh.triangles[number, 2]
        s = mesh.screen
        ax, ay, bx, by, cx, cy = s[i, 0], s[i, 1], s[j, 0], s[j, 1], s[k, 0], s[k, 1]
        if ax == UNPLACED or bx == UNPLACED or cx == UNPLACED:
            return np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    else:
        p = mesh.pieces
        i = -1 - number
        ax, ay, bx, by, cx, cy = p[i, 0, 0], p[i, 0, 1], p[i, 1, 0], p[i, 1, 1], p[i, 2, 0], p[i, 2, 1]
    ax, ay, bx, by = np.int64(ax), np.int64(ay), np.int64(bx), np.int64(by)
    cx, cy = np.int64(cx), np.int64(cy)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area < 0:
        return ax, ay, cx, cy, bx, by, -area
    return ax, ay, bx, by, cx, cy, area


@leaf
def beyond(px, py, qx, qy, x, y, last):
    """Whether the square of fixed side ``last`` at (x, y) lies wholly outside the edge from p to q."""
    dx, dy = qx - px, qy - py
    # The corner that lies farthest inside.
    u, v = (x + last if dy < 0 else x), (y + last if dx > 0 else y)
    return dx * (v - py) - dy * (u - px) < 0


@kernel
def sort_into_tiles(mesh, tiling, first, last, cursors, numbers, write):
    """Count the triangles [first, last) (negative: pieces) by tile in ``cursors``, or write them to ``numbers``.

    Args:
        cursors: (tiles,) int64: receives the counts; or the position of each tile's next number, which is advanced.
        numbers: int32.
    """
    shift = BITS + tiling.level
    side = 1 << shift
    for number in range(first, last):
        ax, ay, bx, by, cx, cy, area = corners_of(mesh, number)
        if area == 0:
            continue
        left, right = max(min(ax, bx, cx) >> shift, 0), min(max(ax, bx, cx) >> shift, tiling.cols - 1)
        top, bottom = max(min(ay, by, cy) >> shift, 0), min(max(ay, by, cy) >> shift, tiling.rows - 1)
        large = right > left and bottom > top
        for row in range(top, bottom + 1):
            for col in range(left, right + 1):
                x, y = col * side, row * side
                if large and (
                    beyond(ax, ay, bx, by, x, y, side)
                    or beyond(bx, by, cx, cy, x, y, side)
                    or beyond(cx, cy, ax, ay, x, y, side)
                ):
                    continue
                tile = row * tiling.cols + col
                if write:
                    numbers[cursors[tile]] = number
                cursors[tile] += 1
