"""The referee of meshes whose truth is the Delaunay surface of points, not the raster (``stats["truth"]``).

Both surfaces are linear on the intersections of their triangles. Each such piece is found by clipping, and the distance
on the screen is measured at its corners, at the middles of its sides and at its centre, where they are in view. Missing
and extra parts are found by areas and by places: the mesh may end up to ``RIM`` samples within the surface's rim.
T-junctions, overlaps and the like are those that ``judge_mesh`` finds. Sample coordinates; pixels.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, linked
from orograph.dem.delaunay import Surface
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.verify.report import Report, place
from orograph.viewpoint import View

RIM = 2.0
"""Samples along the rim of the surface that may be uncovered."""

Floats = NDArray[np.float64]


def against_points(
    report: Report, tessellation: Tessellation, terrain: Terrain, view: View, exaggeration: float
) -> Report:
    """The report on the mesh itself, with its errors from the Delaunay surface of the terrain's points."""
    surface: Surface = terrain.derived("points")
    x, y = (np.ldexp(v.astype(np.float64), -surface.bits) for v in (surface.x, surface.y))
    truth = np.stack([x, y, surface.z.astype(np.float64)], -1)
    lens, planes = _lens(view, terrain, exaggeration)
    corners = tessellation.vertices
    size, first, held = _buckets(corners, tessellation.triangles, terrain.grid.shape)
    found, worst, areas, covered, heights = _measure(
        truth, surface.triangles, corners, tessellation.triangles, size, first, held, lens, planes
    )
    used = np.unique(surface.triangles)
    seen = used[_in_view(truth[used], lens, planes)]
    off = np.array([_distance(lens, truth[v], heights[v]) for v in seen if covered[v]])
    lost = seen[~covered[seen]]
    rim = _rim(truth, surface.triangles)
    lost = [v for v in lost if _from_rim(truth[v, :2], rim) > RIM]
    at = corners[tessellation.triangles][:, :, :2]
    (ux, uy), (vx, vy) = (at[:, 1] - at[:, 0]).T, (at[:, 2] - at[:, 0]).T
    whole = np.abs(ux * vy - uy * vx) / 2
    bridged = np.flatnonzero(areas < whole * (1 - 1e-6) - 1e-6)
    places = {name: at for name, at in report.places.items() if name in OF_MESHES}
    if len(lost):
        places["uncovered"] = place(*truth[lost[0], :2])
    if len(bridged):
        places["bridged"] = place(*at[bridged[0]].mean(axis=0))
    return replace(
        report, samples=len(seen), largest=float(found), worst=place(*worst) if found > 0 else None,
        largest_at_samples=float(off.max(initial=0.0)), worst_sample=None,
        rms=math.sqrt(float((off**2).mean())) if len(off) else 0.0, uncovered=len(lost), holes=0,
        bridged=len(bridged), wrong_heights=int((~np.isfinite(corners)).any(1).sum()), inner=0,
        border=report.border + report.inner, places=places,
    )  # fmt: skip


OF_MESHES = ("t_junctions", "overlaps", "crowded", "reversed", "flat", "duplicates")
"""Defects that say nothing of the ground."""


def _lens(view: View, terrain: Terrain, exaggeration: float) -> tuple[Floats, Floats]:
    """Rows (right, up, depth), and planes, over (column, row, height, 1).

    The first row's extra last number is the focal length in pixels, 0 in a plan.
    """
    a, b, c, d, e, f = terrain.grid.samples[:6]
    to_world = np.array([[a, b, 0, c], [d, e, 0, f], [0, 0, exaggeration, 0], [0, 0, 0, 1]])
    plan = view.projection == "plan"
    at = view.target[:2] if plan else view.eye[:2]
    eye = np.array([*at, view.eye[2] * exaggeration])
    move = np.eye(4)
    move[:3, 3] = -eye
    axes = np.array([[*axis, 0.0] for axis in view.plain_axes(exaggeration)]) @ move @ to_world
    planes = np.array(view.frustum(exaggeration)) @ to_world
    focal = 0.0 if plan else 1 / view.pixel_slope
    return np.vstack([axes, [focal, 0, 0, 0]]), planes


def _in_view(points: Floats, lens: Floats, planes: Floats) -> NDArray[np.bool_]:
    whole = np.c_[points, np.ones(len(points))]
    return np.asarray((whole @ planes.T >= 0).all(1))


def _distance(lens: Floats, point: Floats, height: float) -> float:
    """Pixels between a point and another on its vertical."""
    p, q = lens[:3, :3] @ point + lens[:3, 3], lens[:3, :3] @ [*point[:2], height] + lens[:3, 3]
    return math.hypot(*(lens[3, 0] * (p[:2] / p[2] - q[:2] / q[2]))) if q[2] > 0 else math.inf


def _rim(truth: Floats, triangles: NDArray[np.int32]) -> Floats:
    """The sides (k, 2, 2) of triangles that no other triangle has."""
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    found, counts = np.unique(sides, axis=0, return_counts=True)
    return np.asarray(truth[found[counts == 1]][:, :, :2])


def _from_rim(at: Floats, rim: Floats) -> float:
    a, d = rim[:, 0], rim[:, 1] - rim[:, 0]
    t = np.clip(((at - a) * d).sum(1) / (d * d).sum(1), 0, 1)[:, None]
    return float(np.hypot(*(at - a - t * d).T).min())


def _buckets(
    corners: Floats, triangles: NDArray[np.int32], shape: tuple[int, int]
) -> tuple[float, NDArray[np.int64], NDArray[np.int32]]:
    """Triangles by the cells of a lattice that their boxes meet.

    Returns: the cells' side; where each cell's triangles begin (``first[-2:]`` is the lattice's shape); the triangles.
    """
    size = max(1.0, math.sqrt(shape[0] * shape[1] / max(1, len(triangles))))
    rows, cols = int(shape[0] / size) + 1, int(shape[1] / size) + 1
    at = corners[triangles][:, :, :2]
    low, high = np.floor(at.min(1) / size).astype(int), np.floor(at.max(1) / size).astype(int)
    cells, which = [], []
    for t, ((c0, r0), (c1, r1)) in enumerate(zip(low, high)):
        own = (np.arange(r0, r1 + 1)[:, None] * cols + np.arange(c0, c1 + 1)).ravel()
        cells.append(own)
        which.append(np.full(len(own), t))
    cell, held = np.concatenate(cells or [np.zeros(0, int)]), np.concatenate(which or [np.zeros(0, int)])
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange(rows * cols + 1))
    return size, np.append(first, [rows, cols]).astype(np.int64), held[order].astype(np.int32)


@kernel
def _measure(truth, ground, corners, mesh, size, first, held, lens, planes):
    """Measure the mesh against the surface.

    Returns: the largest distance in pixels, and where; the area (m,) of the surface under each triangle of the mesh;
    which (n,) of the surface's points it covers, and its height there.
    """
    rows, cols = first[-2], first[-1]
    areas, covered, heights = np.zeros(len(mesh)), np.zeros(len(truth), np.bool_), np.zeros(len(truth))
    last, worst, where = np.full(len(mesh), -1, np.int32), 0.0, np.zeros(2)
    p, q = np.empty((16, 2)), np.empty((16, 2))
    for s in range(len(ground)):
        a, b, c = truth[ground[s, 0]], truth[ground[s, 1]], truth[ground[s, 2]]
        r0 = min(max(int(min(a[1], b[1], c[1]) / size), 0), rows - 1)
        r1 = min(max(int(max(a[1], b[1], c[1]) / size), 0), rows - 1)
        c0 = min(max(int(min(a[0], b[0], c[0]) / size), 0), cols - 1)
        c1 = min(max(int(max(a[0], b[0], c[0]) / size), 0), cols - 1)
        for r in range(r0, r1 + 1):
            for k in range(c0, c1 + 1):
                for i in range(first[r * cols + k], first[r * cols + k + 1]):
                    t = held[i]
                    if last[t] == s:
                        continue
                    last[t] = s
                    u, v, w = corners[mesh[t, 0]], corners[mesh[t, 1]], corners[mesh[t, 2]]
                    for j in range(3):
                        point = ground[s, j]
                        if not covered[point]:
                            inside, z = _height(u, v, w, truth[point, 0], truth[point, 1])
                            if inside:
                                covered[point], heights[point] = True, z
                    count = _clip(a, b, c, u, v, w, p, q)
                    if count < 3:
                        continue
                    area, mx, my = 0.0, 0.0, 0.0
                    for j in range(count):
                        n = (j + 1) % count
                        area += p[j, 0] * p[n, 1] - p[n, 0] * p[j, 1]
                        mx, my = mx + p[j, 0] / count, my + p[j, 1] / count
                    areas[t] += abs(area) / 2
                    for j in range(2 * count + 1):
                        n, m = (j // 2) % count, (j // 2 + j % 2) % count
                        x, y = 0.5 * (p[n, 0] + p[m, 0]), 0.5 * (p[n, 1] + p[m, 1])
                        if j == 2 * count:
                            x, y = mx, my
                        _, below = _height(a, b, c, x, y)
                        _, above = _height(u, v, w, x, y)
                        off = _pixels(lens, planes, x, y, below, above)
                        if off > worst:
                            worst, where[0], where[1] = off, x, y
    return worst, where, areas, covered, heights


@linked
def _height(u, v, w, x, y):
    """Whether a place is in a triangle, and the height of its plane there."""
    area = (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0])
    f = ((x - u[0]) * (w[1] - u[1]) - (y - u[1]) * (w[0] - u[0])) / area
    g = ((v[0] - u[0]) * (y - u[1]) - (v[1] - u[1]) * (x - u[0])) / area
    return f >= -1e-9 and g >= -1e-9 and f + g <= 1 + 1e-9, u[2] + f * (v[2] - u[2]) + g * (w[2] - u[2])


@linked
def _clip(a, b, c, u, v, w, p, q):
    """The intersection of two triangles, in ``p``; returns its number of corners (Sutherland & Hodgman 1974)."""
    for axis in range(2):
        p[0, axis], p[1, axis], p[2, axis] = a[axis], b[axis], c[axis]
    count = 3
    turn = (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0])
    for k in range(3):
        e, f = (u, v) if k == 0 else (v, w) if k == 1 else (w, u)
        kept = 0
        for j in range(count):
            n = (j + 1) % count
            one = ((f[0] - e[0]) * (p[j, 1] - e[1]) - (f[1] - e[1]) * (p[j, 0] - e[0])) * turn
            two = ((f[0] - e[0]) * (p[n, 1] - e[1]) - (f[1] - e[1]) * (p[n, 0] - e[0])) * turn
            if one >= 0:
                q[kept, 0], q[kept, 1] = p[j, 0], p[j, 1]
                kept += 1
            if (one > 0 and two < 0) or (one < 0 and two > 0):
                share = one / (one - two)
                for axis in range(2):
                    q[kept, axis] = p[j, axis] + (p[n, axis] - p[j, axis]) * share
                kept += 1
        count = kept
        for j in range(count):
            p[j, 0], p[j, 1] = q[j, 0], q[j, 1]
    return count


@linked
def _pixels(lens, planes, x, y, below, above):
    """Pixels between two points on a vertical; 0 where the first is not in view."""
    for k in range(len(planes)):
        if planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * below + planes[k, 3] < 0:
            return 0.0
    focal = lens[3, 0]
    if focal == 0:
        return 0.0
    w = lens[2, 0] * x + lens[2, 1] * y + lens[2, 3]
    d, e = w + lens[2, 2] * below, w + lens[2, 2] * above
    if d <= 0 or e <= 0:
        return np.inf
    p, r = lens[0, 0] * x + lens[0, 1] * y + lens[0, 3], lens[1, 0] * x + lens[1, 1] * y + lens[1, 3]
    dx = (p + lens[0, 2] * below) / d - (p + lens[0, 2] * above) / e
    dy = (r + lens[1, 2] * below) / d - (r + lens[1, 2] * above) / e
    return focal * np.hypot(dx, dy)
