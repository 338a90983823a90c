"""Small terrains to refine, cameras to look at them, and whole arrays of what the references say vertex by vertex.

The meshes that engines are compared with are those of ``orograph.lod.reference``. Arrays are for larger rasters; they
share nothing with the engines and ``orograph.error.screen``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from affine import Affine

from orograph import viewpoint
from orograph.dem.mosaic import Mosaic
from orograph.error.diamonds import diamonds as surveyed
from orograph.geo.grid import Grid
from orograph.hierarchy import diamonds, fronts, triangles
from orograph.lod.method import Goal, Method, Ready, Resources
from orograph.lod.reference import camera as reference
from orograph.lod.reference import stateless
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.screen_error import wedgie
from orograph.lod.reference.terrain import Ground
from orograph.lod.registry import method_of
from orograph.lod.right_triangles import Mesh
from orograph.store.diamond_table import MemoryDiamonds
from orograph.store.diamonds import NESTED, gather
from orograph.store.diamonds import surface as ground_of
from orograph.store.levels import subsample
from orograph.store.memory import MemoryTerrain
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

GROUND = {
    "oblong, 30 m": "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",
    "city, 1 m": "nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif",
    "hills, 1 m": "lsd-topo/gabilan.tif",
    "voids, 90 m": "osgearth-srtm90m-volcano-voids/mt_rainier_90m.tif",
    "synthetic": "",
}
"""What methods are judged on at length: open data, and rough ground."""


def ground(shared_data: Path, name: str) -> Terrain:
    """One of ``GROUND``."""
    if not GROUND[name]:
        return terrain(rough(np.random.default_rng(7), (1500, 1100), amplitude=1500.0))
    return opened(Mosaic.open([shared_data / GROUND[name]]))


def rough(rng: np.random.Generator, shape, amplitude=80.0, hurst=0.8, gaps=0.0) -> np.ndarray:
    """Fractal heights (rows, cols) float32; about ``gaps`` of them missing, in patches."""
    z = np.zeros(shape)
    holes = np.zeros(shape)
    size = 2
    while size < 2 * max(shape):
        coarse = rng.normal(size=(size + 1, size + 1)), rng.normal(size=(size + 1, size + 1))
        y, x = (np.linspace(0, size, side) for side in shape)
        i, j = np.minimum(y.astype(int), size - 1), np.minimum(x.astype(int), size - 1)
        v, u = (y - i)[:, None], (x - j)[None]
        for total, c, power in ((z, coarse[0], hurst), (holes, coarse[1], 1.0)):
            at = np.ix_(i, j), np.ix_(i, j + 1), np.ix_(i + 1, j), np.ix_(i + 1, j + 1)
            total += size**-power * (
                (1 - v) * ((1 - u) * c[at[0]] + u * c[at[1]]) + v * ((1 - u) * c[at[2]] + u * c[at[3]])
            )
        size *= 2
    z = (amplitude * z).astype(np.float32)
    if gaps:
        z[holes > np.quantile(holes, 1 - gaps)] = np.nan
    return z


def terrain(heights, cell=30.0, angle=0.0, stretch=1.0) -> MemoryTerrain:
    """Heights on a grid of that cell size (stretched from west to east), turned by ``angle`` degrees."""
    transform = Affine.translation(5e5, 4e6) @ Affine.rotation(angle) @ Affine.scale(cell * stretch, -cell)
    return MemoryTerrain(np.ascontiguousarray(heights), Grid(heights.shape, transform, None), "test")


def surface(z: np.ndarray, col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Heights of the full-resolution surface: cells cut from their (even, even) to their (odd, odd) corner."""
    i = np.minimum(row.astype(int), z.shape[0] - 2)
    j = np.minimum(col.astype(int), z.shape[1] - 2)
    v, u = row - i, col - j
    a, b, c, d = z[i, j], z[i, j + 1], z[i + 1, j], z[i + 1, j + 1]
    falling = (i + j) % 2 == 0  # cut from a to d
    on_fall = np.where(u >= v, a + u * (b - a) + v * (d - b), a + v * (c - a) + u * (d - c))
    on_rise = np.where(u + v <= 1, a + u * (b - a) + v * (c - a), d + (1 - u) * (c - d) + (1 - v) * (b - d))
    return np.where(falling, on_fall, on_rise)


def on_mesh(t, col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Heights of a mesh over points; NaN off it."""
    height = np.full(len(col), np.nan)
    for p, q, r in t.vertices[t.triangles]:
        area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        v = ((col - p[0]) * (r[1] - p[1]) - (row - p[1]) * (r[0] - p[0])) / area
        w = ((q[0] - p[0]) * (row - p[1]) - (q[1] - p[1]) * (col - p[0])) / area
        inside = (v >= -1e-12) & (w >= -1e-12) & (v + w <= 1 + 1e-12)
        height[inside] = (p[2] + v * (q[2] - p[2]) + w * (r[2] - p[2]))[inside]
    return height


class Refiner:
    """A method that is asked for meshes of views, at one exaggeration; it has the method's attributes, too."""

    def __init__(self, method: Method, exaggeration: float) -> None:
        self.method, self.exaggeration = method, exaggeration

    def __getattr__(self, name):
        return getattr(self.method, name)

    def camera(self, view: View, exaggeration: float | None = None) -> viewpoint.Camera:
        return viewpoint.Camera.over(
            self.method.terrain.grid, view, self.exaggeration if exaggeration is None else exaggeration
        )

    def refine(self, view: View, **goal) -> Tessellation:
        return self.method.select(self.camera(view), Goal(**goal or {"tolerance": 1.0})).tessellation()

    def mesh(self, view: View, **goal) -> tuple[Mesh, float]:
        return self.method.mesh(self.camera(view), Goal(**goal))


class Patcher(Refiner):
    """A ``TrianglePatches`` that is asked for the patches of views; ``resident``: the tiles there, level by level."""

    def patches(self, view: View, tolerance: float, *, exaggeration=None, resident=None, wait=True, rim=1.0, **more):
        tiles = None if resident is None else np.concatenate([np.ravel(level) for level in resident])
        ready = Ready(tiles, wait=wait)
        return self.method.patches(self.camera(view, exaggeration), tolerance, ready, rim=rim, **more)


def refiner(method, t, *, exaggeration=1.0, max_memory=1 << 30, jobs=None, color=None, **options) -> Refiner:
    """A method, by its class or its name, with options, for a terrain."""
    made = (method_of(method) if isinstance(method, str) else method)(
        t, resources=Resources(max_memory, jobs, color=color), **options
    )
    return (Patcher if made.info.kind == "patches" else Refiner)(made, exaggeration)


def random_view(rng: np.random.Generator, t: MemoryTerrain, **options) -> View:
    """From anywhere over the terrain or beside it to anywhere on it: close, far, grazing, steep, narrow and wide."""
    rows, cols = t.grid.shape
    size = t.grid.transform
    extent = max(rows, cols) * math.hypot(size.a, size.d)
    low, high = t.height_range
    eye = size @ (rng.uniform(-0.2, 1.2) * cols, rng.uniform(-0.2, 1.2) * rows)
    target = size @ (rng.uniform(0, 1) * cols, rng.uniform(0, 1) * rows)
    above = extent * 10 ** rng.uniform(-2.0, 0.0)
    options = {"fov_y": float(rng.choice([15, 40, 60, 100])), "width": 320, "height": 200} | options
    return View((*eye, high + above), (*target, float(rng.uniform(low, high))), **options)


@dataclass
class Camera:
    """A perspective view in stretched metres."""

    view: View
    exaggeration: float = 1.0

    def __post_init__(self):
        camera = reference.Camera.of(self.view, self.exaggeration)
        self.axes, self.focal = np.array(camera.axes), camera.focal
        self.up = self.axes[:, 2] * self.exaggeration  # camera coordinates of a metre of height
        self.frustum = np.array(camera.planes)

    def to_camera(self, points):
        """(…, 3) easting, northing, height → right, up, depth."""
        return (np.asarray(points) - self.view.eye) * [1, 1, self.exaggeration] @ self.axes.T

    def planes(self):
        """(n, 4) of the frustum in camera coordinates, unit normals."""
        return self.frustum

    def stretch_of(self, p):
        """|(a·w − c·x, b·w − c·y)| of camera points (…, 3)."""
        a, b, c = self.up
        x, y, w = np.moveaxis(p, -1, 0)
        return np.hypot(a * w - c * x, b * w - c * y)


class Plain:
    """All vertices of a terrain's padded square as arrays (N + 1, N + 1): heights, errors, radii."""

    def __init__(self, t: MemoryTerrain, error: str = "exact"):
        self.t, self.n = t, t.n
        side = t.side
        rows, cols = t.grid.shape
        self.row, self.col = np.meshgrid(*(np.arange(side),) * 2, indexing="ij")
        self.i, self.j = np.minimum(self.row, rows - 1), np.minimum(self.col, cols - 1)
        self.z = t.heights[self.i, self.j].astype(float)
        tiles = t.tiles(0).minimum
        fill = np.where(np.isnan(tiles), t.height_range[0], tiles)
        k = (np.minimum(v >> 8, m - 1) for v, m in zip((self.i, self.j), tiles.shape))
        self.filled = np.where(np.isnan(self.z), fill[tuple(k)], self.z)
        x, y = t.grid.xy(self.j, self.i)
        self.at = np.stack([x, y, self.filled], -1)
        self.e, self.r = np.zeros((side, side)), np.zeros((side, side))
        octave = np.array([[diamonds.octave(r, c) if r | c else 99 for c in range(side)] for r in range(side)])
        for level in range(t.levels):
            shape = t.diamond_shape(level)
            errors, radii = t.derived("diamonds", error=error).read(level, 0, shape[0], 0, shape[1])
            mine = octave == level if level < t.levels - 1 else octave >= level
            inside = mine & (self.row >> level < shape[0]) & (self.col >> level < shape[1])
            self.e[inside] = errors[self.row[inside] >> level, self.col[inside] >> level]
            self.r[inside] = radii[self.row[inside] >> level, self.col[inside] >> level]
            self.r[mine & ~inside] = -1e-30  # beyond the raster: empty

    def corners(self, front: fronts.Front):
        """(m, 3) rows and columns of the corners: left end, right end, apex."""
        parts = [f(*front.arrays) for f in (triangles.left_end, triangles.right_end, triangles.apex)]
        return np.stack([y for _, y in parts], 1), np.stack([x for x, _ in parts], 1)

    def outside(self, camera: Camera, points, reach):
        """Whether all points (m, k, 3), each ± reach (m,) metres along the vertical, lie beyond one plane."""
        planes = camera.planes()
        d = camera.to_camera(points) @ planes[:, :3].T + planes[:, 3]
        along = np.abs(planes[:, :3] @ camera.up)
        with np.errstate(invalid="ignore"):
            return (d.max(1) + np.where(np.isinf(reach), np.inf, reach)[:, None] * along < 0).any(1)

    def displacement(self, camera: Camera, corners) -> float:
        """The largest displacement in pixels of a sample in view under a triangle, by looking at each.

        Args:
            corners: (3, 2) rows and columns, not beyond the raster.
        """
        a, b, c = (np.array(q) for q in corners)
        rows, cols = zip(*corners)
        grid = np.mgrid[min(rows) : max(rows) + 1, min(cols) : max(cols) + 1].reshape(2, -1)
        u, v = np.linalg.solve(np.stack([b - a, c - a], 1), grid - a[:, None])
        grid, u, v = (x[..., (np.minimum(u, v) > -1e-9) & (u + v < 1 + 1e-9)] for x in (grid, u, v))
        z = [self.filled[tuple(q)] for q in (a, b, c)]
        at = camera.to_camera(self.at[tuple(grid)])
        planes = camera.planes()
        seen = (at @ planes[:, :3].T + planes[:, 3] >= 0).all(1)
        moved = at + (z[0] + u * (z[1] - z[0]) + v * (z[2] - z[0]) - self.filled[tuple(grid)])[:, None] * camera.up
        at, moved = at[seen], moved[seen]
        if (moved[:, 2] <= 0).any():
            return math.inf
        off = moved[:, :2] / moved[:, 2:] - at[:, :2] / at[:, 2:]
        return float(camera.focal * np.hypot(*off.T).max(initial=0.0))

    def finest_bound(self, camera: Camera, corners) -> float:
        """ROAM's bound in pixels over the finest triangles under a triangle, not out of view.

        Args:
            corners: (3, 2) rows and columns, not beyond the raster.
        """
        a, b, c = (np.array(q) for q in corners)
        to_weights = np.linalg.inv(np.stack([b - a, c - a], 1))
        heights = np.array([self.filled[tuple(q)] for q in corners])
        rows, cols = zip(*corners)
        worst = 0.0
        for i, j in np.ndindex(max(rows) - min(rows), max(cols) - min(cols)):
            r, s = i + min(rows), j + min(cols)
            nw, ne, sw, se = (r, s), (r, s + 1), (r + 1, s), (r + 1, s + 1)
            for unit in ((nw, sw, se), (nw, ne, se)) if (r + s) % 2 == 0 else ((nw, ne, sw), (ne, sw, se)):
                u, v = to_weights @ (np.array(unit) - a).T
                ground = self.at[tuple(np.transpose(unit))]
                off = heights @ [1 - u - v, u, v] - ground[:, 2]
                if (
                    min(*u, *v, *(1 - u - v)) < -1e-9
                    or not off.any()
                    or self.outside(camera, ground[None], np.zeros(1))[0]
                ):
                    continue
                on = [tuple(p) for p in camera.to_camera(ground + off[:, None] * [0.0, 0.0, 1.0])]
                seen = reference.Camera.of(camera.view, camera.exaggeration)
                worst = max(worst, wedgie(seen, on, camera.exaggeration * np.abs(off).max() * (1 + 1e-9)))
        return worst

    def spheres_outside(self, camera: Camera):
        """(N + 1, N + 1): whether a diamond's sphere is beyond a plane."""
        planes = camera.planes()
        d = camera.to_camera(self.at) @ planes[:, :3].T + planes[:, 3]
        return (d < -np.abs(self.r)[..., None] * max(1.0, camera.exaggeration)).any(-1)

    def sphere_errors(self, camera: Camera, loose=False):
        """(N + 1, N + 1): the anisotropic bound over each sphere, pixels; ``loose``: in ROAM's form."""
        p = camera.to_camera(self.at)
        radius = np.abs(self.r) * max(1.0, camera.exaggeration)
        depth = p[..., 2] - radius
        near = np.maximum(depth, camera.view.near)
        with np.errstate(invalid="ignore", divide="ignore"):
            moved = near - self.e * abs(camera.up[2])
            if loose:
                lean = (camera.stretch_of(p) + radius * np.linalg.norm(camera.up)) / near
            else:
                size = radius * np.linalg.norm(p, axis=-1) / (p[..., 2] * depth)  # of the sphere, on a screen at 1
                lean = camera.stretch_of(p) / p[..., 2] + abs(camera.up[2]) * size
                half = np.array([camera.view.width, camera.view.height]) / 2 / camera.focal
                corners = [camera.up[:2] - camera.up[2] * half * (i, j) for i in (-1, 1) for j in (-1, 1)]
                lean = np.fmin(np.where(depth > 0, lean, np.inf), np.linalg.norm(corners, axis=-1).max())
            bound = camera.focal * self.e * lean / moved
        return np.where(self.e <= 0, 0.0, np.where(moved > 0, bound, np.inf))

    def triangle_set(self, front: fronts.Front, drawn) -> set:
        """The squeezed corners (col, row) of the drawn triangles with area."""
        rows, cols = self.corners(front)
        return _set(self.j[rows, cols][drawn], self.i[rows, cols][drawn])


def _set(cols, rows) -> set:
    found = {frozenset((int(c), int(r)) for c, r in zip(*t)) for t in zip(cols, rows)}
    return {t for t in found if len(t) == 3}


def triangles_of(tessellation) -> set:
    """The corners (col, row) of a tessellation's triangles."""
    v = tessellation.vertices[tessellation.triangles]
    return _set(v[..., 0], v[..., 1])


def front_of(n: int, T) -> fronts.Front:
    """A reference's triangles as a front, which knows whether it is valid."""
    return fronts.Front.of(n, *np.array([(int(t.x), int(t.y), t.L, t.omega) for t in T]).T)


def sphere_mesh(ground: Ground, view: View, tolerance: float, *, cull=True, exaggeration=1.0) -> set:
    """What is drawn of the state-less reference by the anisotropic bound over spheres."""
    spheres = Spheres(ground, reference.Camera.of(view, exaggeration), cull=cull)
    return drawn(ground, stateless.refine(ground.n, lambda i: spheres.priority(i) > tolerance), spheres)


def drawn(ground: Ground, T, criterion) -> set:
    """The corners (col, row) of those of a reference's triangles that are drawn."""
    return {frozenset(ground.places(t)) for t in T if criterion.is_drawn(t)}


SHAPES = [(17, 17), (33, 33), (20, 31), (33, 18), (9, 30), (2, 2), (3, 5)]
"""Sizes of small rasters, with and without squeezed borders."""


class Unrounded(MemoryTerrain):
    """A terrain whose errors and radii are not rounded to what a store can hold."""

    def derived(self, name, **options):
        if name != "diamonds":
            return super().derived(name, **options)
        kind = options["error"]
        ground = ground_of(self.grid, self.tiles(0).minimum, self.height_range[0])
        parts = surveyed(
            lambda a, b, c, d: self.heights[a:b, c:d], subsample(self.heights, NESTED), ground, (kind,), jobs=1
        )
        return MemoryDiamonds(self, *gather(self.grid.shape, parts, kind))


def unrounded(t):
    """The same terrain with errors and radii as they are."""
    return Unrounded(t.heights, t.grid, t.name)
