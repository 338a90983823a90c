"""Meshes, cameras, and what pixels must show of them, found another way than by the rasteriser: the camera's geometry
from its definition, cover by brute force on whole numbers, depth by rays in double precision, first hits by Embree."""

from __future__ import annotations

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.geo.grid import Grid
from orograph.viewpoint import View

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]

GRIDS = {
    "north up": Affine(30, 0, 500_000, 0, -30, 4_000_000),
    "rectangular": Affine(30, 0, 500_000, 0, -12, 4_000_000),
    "south up": Affine(30, 0, 500_000, 0, 30, 4_000_000),
    "rotated": Affine.translation(500_000, 4_000_000) @ Affine.rotation(27) @ Affine.scale(30, -18),
}


def grid(name: str, rows: int = 61, cols: int = 83) -> Grid:
    return Grid((rows, cols), GRIDS[name], CRS.from_epsg(32611))


def hills(rows: int = 61, cols: int = 83, seed: int = 0, tall: float = 400.0) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :cols]
    z = np.sin(x / 9 + seed) * np.cos(y / 7) + 0.5 * np.sin(x / 3.1 + y / 4.3) + rng.normal(0, 0.06, (rows, cols))
    return (800 + tall * z).astype(np.float32)


def full(heights: NDArray[np.float32]) -> tuple[Array, Triangles]:
    """All valid triangles of a raster, cells cut from their (even, even) to their (odd, odd) corner."""
    rows, cols = heights.shape
    y, x = np.mgrid[:rows, :cols]
    index = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    nw, ne, sw, se = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    even = ((y + x)[:-1, :-1] % 2 == 0)[..., None]
    one = np.where(even, np.stack([nw, ne, se], -1), np.stack([nw, ne, sw], -1))
    other = np.where(even, np.stack([nw, se, sw], -1), np.stack([ne, se, sw], -1))
    tri = np.stack([one, other], 2).reshape(-1, 3)
    vertices = np.stack([x, y, heights], -1).reshape(-1, 3).astype(np.float64)
    return vertices, tri[np.isfinite(vertices[tri, 2]).all(1)]


def scattered(seed: int, count: int = 300, rows: int = 61, cols: int = 83) -> tuple[Array, Triangles]:
    """A Delaunay triangulation of random places between samples and the raster's corners, rough in height; its
    triangles turn at random."""
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(seed)
    flat = rng.random((count, 2)) * [cols - 1, rows - 1]
    flat[:4] = [[0, 0], [cols - 1, 0], [0, rows - 1], [cols - 1, rows - 1]]
    tri = Delaunay(flat).simplices.astype(np.int32)
    turned = rng.random(len(tri)) < 0.5
    tri[turned] = tri[turned][:, ::-1]
    return np.column_stack([flat, rng.normal(800, 120, count)]), np.ascontiguousarray(rng.permutation(tri))


def seen_from(g: Grid, col: float, row: float, z: float, to: tuple[float, float, float], **given: object) -> View:
    """A view between two places in sample coordinates, 96 × 64 pixels."""
    (x, u), (y, v) = (a.tolist() for a in g.xy(np.array([col, to[0]]), np.array([row, to[1]])))
    return View(eye=(x, y, z), target=(u, v, to[2]), **{"width": 96, "height": 64, **given})  # type: ignore[arg-type]


def places(vertices: Array, g: Grid, exaggeration: float = 1.0) -> Array:
    """Vertices in stretched space, relative to the grid's first sample, which keeps their digits."""
    t = g.transform
    east, north = t.a * vertices[:, 0] + t.b * vertices[:, 1], t.d * vertices[:, 0] + t.e * vertices[:, 1]
    return np.stack([east, north, vertices[:, 2] * exaggeration], -1)


def camera(view: View, g: Grid, exaggeration: float = 1.0) -> tuple[Array, Array]:
    """The eye in the space of ``places`` and the axes (3, 3) right, up, forward: from what the two projections are."""
    x, y = (float(v) for v in g.xy(0.0, 0.0))
    eye, target = ((np.array(p) - [x, y, 0.0]) * [1, 1, exaggeration] for p in (view.eye, view.target))
    forward, up = target - eye, np.array(view.up)
    if view.projection == "plan":
        up = up * [1, 1, 0] if np.hypot(*up[:2]) > 0 else forward * [1, 1, 0]
        up = up if np.hypot(*up[:2]) > 0 else np.array([0.0, 1.0, 0.0])
        forward, eye = np.array([0.0, 0.0, -1.0]), np.array([target[0], target[1], eye[2]])
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return eye, np.stack([right, np.cross(right, forward), forward])


def rays(view: View, g: Grid, px: Array, py: Array, exaggeration: float = 1.0) -> tuple[Array, Array]:
    """Origins and directions (n, 3) of unit forward component through pixel positions, in the space of ``places``."""
    eye, (right, up, forward) = camera(view, g, exaggeration)
    half = np.tan(np.radians(view.fov_y) / 2)
    a = ((2 * px / view.width - 1) * half * view.width / view.height)[:, None]
    b = ((1 - 2 * py / view.height) * half)[:, None]
    if view.projection == "plan":
        d = np.linalg.norm(np.array(view.target) - np.array(view.eye))
        return eye + a * d * right + b * d * up, np.broadcast_to(forward, (len(px), 3))
    return np.broadcast_to(eye, (len(px), 3)), forward + a * right + b * up


def centres(view: View) -> tuple[Array, Array]:
    py, px = np.mgrid[: view.height, : view.width].reshape(2, -1) + 0.5
    return px, py


def first_hits(
    points: Array, tri: Triangles, origins: Array, directions: Array, near: float, far: float
) -> tuple[Array, NDArray[np.int64]]:
    """Depth and triangle (n,) that rays meet first, NaN and −1 where none: every ray against every triangle, as Möller
    & Trumbore (1997) intersect them, in double precision."""
    a = points[tri[:, 0]]
    e1, e2 = points[tri[:, 1]] - a, points[tri[:, 2]] - a
    depth, which = np.full(len(origins), np.nan), np.full(len(origins), -1)
    for k in range(0, len(origins), 256):
        o, d = origins[k : k + 256, None], directions[k : k + 256, None]
        p = np.cross(d, e2)
        s = o - a
        q = np.cross(s, e1)
        with np.errstate(all="ignore"):
            det = (e1 * p).sum(-1)
            u, v, t = (s * p).sum(-1) / det, (q * d).sum(-1) / det, (e2 * q).sum(-1) / det
            hit = (np.minimum(np.minimum(u, v), 1 - u - v) >= 0) & (t >= near) & (t <= far)
        first = np.where(hit, t, np.inf)
        met = hit.any(1)
        depth[k : k + 256] = np.where(met, first.min(1), np.nan)
        which[k : k + 256] = np.where(met, first.argmin(1), -1)
    return depth, which


def seen(
    mesh: tuple[Array, Triangles], view: View, g: Grid, px: Array, py: Array
) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:  # fmt: skip
    """Depth and triangle (n,) at pixel positions, and whether that is certain: the same 1/1000 pixel away from there,
    which is four times as far as rounding moves a vertex."""
    points, away = places(mesh[0], g), 1e-3
    depth, which = first_hits(points, mesh[1], *rays(view, g, px, py), view.near, view.far)
    certain = np.ones(len(px), bool)
    for x, y in ((-away, -away), (-away, away), (away, -away), (away, away)):
        certain &= first_hits(points, mesh[1], *rays(view, g, px + x, py + y), view.near, view.far)[1] == which
    return depth, which, certain


def cover(
    points: Array, tri: Triangles, view: View, g: Grid, exaggeration: float = 1.0
) -> tuple[NDArray[np.int64], list[NDArray[np.bool_]]]:  # fmt: skip
    """How many triangles cover each pixel centre (height, width), and which pixels each covers; whole numbers only.

    Vertices are rounded to 1/4096 pixel; of centres on an edge, those of top edges (level, the triangle below) and left
    ones (the triangle to the right) are the triangle's. All vertices must be in front of the eye.
    """
    eye, (right, up, forward) = camera(view, g, exaggeration)
    delta = points - eye
    scale = np.tan(np.radians(view.fov_y) / 2) * 2 / view.height
    scale = scale * (
        np.linalg.norm(np.array(view.target) - np.array(view.eye)) if view.projection == "plan" else delta @ forward
    )
    x = np.floor((delta @ right / scale + view.width / 2) * 4096 + 0.5).astype(np.int64)
    y = np.floor((view.height / 2 - delta @ up / scale) * 4096 + 0.5).astype(np.int64)
    v, u = np.mgrid[: view.height, : view.width].astype(np.int64) * 4096 + 2048
    count, covered = np.zeros(u.shape, np.int64), []
    for i, j, k in tri:
        area = (x[j] - x[i]) * (y[k] - y[i]) - (y[j] - y[i]) * (x[k] - x[i])
        inside = np.full(u.shape, area != 0)
        for a, b in ((i, j), (j, k), (k, i)):
            dx, dy = int(np.sign(area)) * (x[b] - x[a]), int(np.sign(area)) * (y[b] - y[a])
            e = dx * (v - y[a]) - dy * (u - x[a])
            owned = dy < 0 or (dy == 0 and dx > 0)
            inside &= (e > 0) | ((e == 0) & owned)
        count += inside
        covered.append(inside)
    return count, covered


def embree_hits(points: Array, tri: Triangles, origins: Array, directions: Array) -> NDArray[np.int64]:
    """The triangle (n,) that each ray meets first, −1 where none, by Embree, which calculates in single precision: so
    the scene is moved to the first ray's origin."""
    from embreex import mesh_construction, rtcore_scene

    scene = rtcore_scene.EmbreeScene(robust=True)
    mesh_construction.TriangleMesh(scene, (points - origins[0])[tri].astype(np.float32))
    return np.asarray(
        scene.run((origins - origins[0]).astype(np.float32), directions.astype(np.float32), query="INTERSECT"), np.int64
    )
