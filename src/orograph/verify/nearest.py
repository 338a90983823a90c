"""The one-sided Hausdorff distance from a terrain to its mesh: how many metres the farthest sample is from it.

For each sample of the full-resolution surface the nearest point of the mesh in space, not on the vertical; the largest
of these distances (Cignoni, Rocchini & Scopigno 1998, *Metro*, §3; here over all samples instead of random ones).

Only few samples need a search: the vertical distance bounds the one in space, so with samples in the order of falling
vertical distances, the search ends when these fall below the largest distance so far (Taha & Hanbury 2015). A
search goes down a tree of boxes over the triangles in Morton order (Lauterbach et al. 2009), nearer boxes first, and
stops as soon as a triangle nearer than the largest distance so far shows that the sample does not matter.
The distance of a point from a triangle is Ericson's (2005, *Real-Time Collision Detection*, §5.1.5). Metres, float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from orograph._numba import inlined, kernel, leaf
from orograph.parallel import aside
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.verify.bands import bands, take_apart
from orograph.verify.ground import existing_units, on_surface
from orograph.verify.spans import span_row, tabulate
from orograph.verify.strips import R0, R2, ceiling

LEAF = 4
"""Triangles in a leaf of the tree."""


@dataclass(frozen=True, slots=True)
class Distance:
    """A one-sided distance.

    Attributes:
        metres: from the farthest sample to the mesh; infinite if the mesh has no triangle, 0 if the terrain has no
            surface.
        sample: (column, row) of the farthest; None if there is none.
    """

    metres: float
    sample: tuple[int, int] | None


def hausdorff(tessellation: Tessellation, terrain: Terrain) -> Distance:
    """The largest distance in space from a sample of the full-resolution surface to the mesh.

    Samples that lie on no existing unit triangle are not part of the surface. True metres, no exaggeration, no view.

    Raises:
        UsageError: as ``judge_mesh``. DamagedChunkError: as ``terrain.read``.
    """
    return aside(partial(_hausdorff, tessellation, terrain))


def _hausdorff(tessellation: Tessellation, terrain: Terrain) -> Distance:
    mesh = take_apart(tessellation, terrain)
    a, b, _, d, e, _ = terrain.grid.samples[:6]
    linear = np.array([a, b, d, e])
    points = tessellation.vertices.copy()
    points[:, 0], points[:, 1] = a * points[:, 0] + b * points[:, 1], d * points[:, 0] + e * points[:, 1]
    solid = np.ascontiguousarray(tessellation.triangles[mesh.signs != 0])
    ranks, boxes = build_tree(points, solid, mesh.corners)
    squared, column, row = -1.0, -1, -1
    for band in bands(mesh, terrain, None):
        ground = band.read(terrain)
        drops = deviations(ground, np.array([band.first, band.last]), mesh.corners, band.members)
        squared, column, row = farthest(
            ground, band.first, drops, linear, points, solid, ranks, boxes, squared, column, row
        )
    return Distance(math.sqrt(max(squared, 0.0)), None if column < 0 else (int(column), int(row)))


@inlined
def spread(value):
    """The bits of a number below 2^21 with a zero between each."""
    v = np.uint64(value)
    v = (v | (v << np.uint64(16))) & np.uint64(0x0000FFFF0000FFFF)
    v = (v | (v << np.uint64(8))) & np.uint64(0x00FF00FF00FF00FF)
    v = (v | (v << np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    v = (v | (v << np.uint64(2))) & np.uint64(0x3333333333333333)
    return (v | (v << np.uint64(1))) & np.uint64(0x5555555555555555)


@kernel
def build_tree(points, triangles, corners):
    """A complete binary tree over triangles in Morton order.

    Returns:
        (ranks (m,), boxes (2L, 6)): the order, LEAF triangles to a leaf; node i's box (lowest x, y, z, highest). The
        root is node 1, the children of i are 2i and 2i + 1, the leaves L … 2L − 1. Empty boxes are (inf …, −inf …).
    """
    m = triangles.shape[0]
    codes = np.empty(m, np.uint64)
    x, y, shift = corners.x, corners.y, corners.shift
    for t in range(m):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        column, row = ((x[a] + x[b] + x[c]) // 3) >> shift, ((y[a] + y[b] + y[c]) // 3) >> shift
        codes[t] = spread(column) | (spread(row) << np.uint64(1))
    ranks = np.argsort(codes)
    leaves = 1
    while leaves * LEAF < m:
        leaves *= 2
    boxes = np.empty((2 * leaves, 6), np.float64)
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    for i in range(m):
        node = leaves + i // LEAF
        for k in range(3):
            v = triangles[ranks[i], k]
            for axis in range(3):
                boxes[node, axis] = min(boxes[node, axis], points[v, axis])
                boxes[node, axis + 3] = max(boxes[node, axis + 3], points[v, axis])
    for node in range(leaves - 1, 0, -1):
        for axis in range(3):
            boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
            boxes[node, axis + 3] = max(boxes[2 * node, axis + 3], boxes[2 * node + 1, axis + 3])
    return ranks, boxes


@inlined
def to_box(boxes, node, x, y, z):
    """Squared distance of a point from a box."""
    dx = max(boxes[node, 0] - x, x - boxes[node, 3], 0.0)
    dy = max(boxes[node, 1] - y, y - boxes[node, 4], 0.0)
    dz = max(boxes[node, 2] - z, z - boxes[node, 5], 0.0)
    return dx * dx + dy * dy + dz * dz


@leaf
def to_triangle(points, a, b, c, x, y, z):
    """Squared distance of a point from the triangle of points a, b, c."""
    ax, ay, az = x - points[a, 0], y - points[a, 1], z - points[a, 2]
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    d1, d2 = ux * ax + uy * ay + uz * az, vx * ax + vy * ay + vz * az
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        s, t = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        s, t = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        s, t = 0.0, 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        s, t = d1 / (d1 - d3), 0.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        s, t = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = 1.0 - t
    else:
        whole = va + vb + vc
        s, t = vb / whole, vc / whole
    dx, dy, dz = ax - s * ux - t * vx, ay - s * uy - t * vy, az - s * uz - t * vz
    return dx * dx + dy * dy + dz * dz


@leaf
def to_mesh(points, triangles, ranks, boxes, stack, x, y, z, best, enough):
    """Squared distance of a point from the nearest triangle; ``best`` bounds it, any value ≤ ``enough`` will do."""
    leaves, m = boxes.shape[0] // 2, triangles.shape[0]
    stack[0], height = 1, 1
    while height > 0 and best > enough:
        height -= 1
        node = stack[height]
        if to_box(boxes, node, x, y, z) >= best:
            continue
        if node >= leaves:
            for i in range((node - leaves) * LEAF, min((node - leaves + 1) * LEAF, m)):
                t = ranks[i]
                best = min(best, to_triangle(points, triangles[t, 0], triangles[t, 1], triangles[t, 2], x, y, z))
            continue
        left_first = to_box(boxes, 2 * node, x, y, z) <= to_box(boxes, 2 * node + 1, x, y, z)
        stack[height], stack[height + 1] = (2 * node + 1, 2 * node) if left_first else (2 * node, 2 * node + 1)
        height += 2
    return best


@kernel
def deviations(ground, band, corners, members):
    """Vertical distance between each sample of a band and the mesh, (rows of the band, columns read) metres.

    Infinite where there is no triangle, −1 for samples that are not part of the surface. Arguments as for ``sweep``.
    """
    heights, top, west, shift = ground.heights, ground.top, ground.west, corners.shift
    count, width = band[1] - band[0] + 1, heights.shape[1]
    lowest, highest = np.full((count, width), np.inf), np.full((count, width), -np.inf)
    table, planes = np.empty((members.shape[0], 7), np.int64), np.empty((members.shape[0], 5), np.float64)
    tabulate(corners, members, table, planes)
    for k in range(members.shape[0]):
        first, last = max(ceiling(table[k, R0], 1 << shift), band[0]), min(table[k, R2] >> shift, band[1])
        for row in range(first, last + 1):
            span_row(table, planes, k, row, shift, west, lowest[row - band[0]], highest[row - band[0]])
    over, under = np.zeros(width + 1, np.uint8), np.zeros(width + 1, np.uint8)
    if band[0] > 0:
        existing_units(ground, band[0] - 1, over)
    for i in range(count):
        row = band[0] + i
        under[:] = 0
        if row + 1 < ground.rows:
            existing_units(ground, row, under)
        for j in range(width):
            h = np.float64(heights[row - top, j])
            if not on_surface(over, under, j, (row + west + j) & 1):
                lowest[i, j] = -1.0
            elif lowest[i, j] <= highest[i, j]:
                lowest[i, j] = max(abs(lowest[i, j] - h), abs(highest[i, j] - h))
            else:
                lowest[i, j] = np.inf
        over, under = under, over
    return lowest


@kernel
def farthest(ground, first, drops, linear, points, triangles, ranks, boxes, squared, column, row):
    """Continue the search for the farthest sample in a band: (squared distance, its column and row)."""
    heights, top, west, stack = ground.heights, ground.top, ground.west, np.empty(128, np.int64)
    flat = drops.reshape(-1)
    largest = math.sqrt(squared) if squared >= 0.0 else -0.5
    count = 0
    for i in range(flat.shape[0]):
        count += flat[i] > largest
    candidates, falling = np.empty(count, np.int64), np.empty(count, np.float64)
    count = 0
    for i in range(flat.shape[0]):
        if flat[i] > largest:
            candidates[count], falling[count] = i, -flat[i]
            count += 1
    for i in np.argsort(falling):
        bound = falling[i] * falling[i]
        if bound <= squared:
            break
        r, c = first + candidates[i] // drops.shape[1], west + candidates[i] % drops.shape[1]
        x, y = linear[0] * c + linear[1] * r, linear[2] * c + linear[3] * r
        z = np.float64(heights[r - top, c - west])
        here = to_mesh(points, triangles, ranks, boxes, stack, x, y, z, bound, squared)
        if here > squared:
            squared, column, row = here, c, r
    return squared, column, row
