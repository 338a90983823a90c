"""Terrain to draw, and what its pictures must show, found another way: triangles from the definition of the surface,
heights on them by plain interpolation, first hits by Embree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from PIL import Image
from pyproj import CRS

from orograph.geo.grid import Grid
from orograph.store import MemoryTerrain, Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]

NORTH_UP = Affine(30, 0, 500_000, 0, -30, 4_000_000)
RECTANGULAR = Affine(30, 0, 500_000, 0, -12, 4_000_000)
ROTATED = Affine.translation(500_000, 4_000_000) @ Affine.rotation(27) @ Affine.scale(30, -18)


def terrain(
    heights: NDArray[np.float32], transform: Affine = NORTH_UP, crs: str | None = "EPSG:32611"
) -> MemoryTerrain:
    known = None if crs is None else CRS.from_user_input(crs)
    return MemoryTerrain(np.asarray(heights, np.float32), Grid(heights.shape, transform, known), "made up")


def hills(rows: int = 61, cols: int = 83, seed: int = 0, tall: float = 400.0) -> NDArray[np.float32]:
    """Rough hills: summits, valleys, noise at the scale of samples."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :cols]
    z = np.sin(x / 9 + seed) * np.cos(y / 7) + 0.5 * np.sin(x / 3.1 + y / 4.3) + rng.normal(0, 0.06, (rows, cols))
    return (800 + tall * z).astype(np.float32)


def holes(heights: NDArray[np.float32], seed: int = 1, part: float = 0.03) -> NDArray[np.float32]:
    """The same with samples missing at random, and a rectangle of them at a border."""
    out = heights.copy()
    out[np.random.default_rng(seed).random(out.shape) < part] = np.nan
    out[: out.shape[0] // 3, : out.shape[1] // 4] = np.nan
    return out


def triangles(of: Terrain) -> tuple[Array, NDArray[np.int32]]:
    """Positions (n, 3) in the CRS of all samples, and the valid triangles (m, 3): every cell is cut from its
    (even, even) to its (odd, odd) corner."""
    rows, cols = of.grid.shape
    heights = of.read(0, 0, rows, 0, cols).astype(np.float64)
    r, c = np.mgrid[:rows, :cols]
    x, y = of.grid.xy(c, r)
    index = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    nw, ne, sw, se = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    even = (r[:-1, :-1] + c[:-1, :-1]) % 2 == 0
    first = np.where(even[..., None], np.stack([nw, ne, se], -1), np.stack([nw, ne, sw], -1))
    second = np.where(even[..., None], np.stack([nw, se, sw], -1), np.stack([ne, se, sw], -1))
    found = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    known = np.isfinite(heights.ravel())
    points = np.stack([x.ravel(), y.ravel(), np.where(known, heights.ravel(), 0)], 1)
    return points, found[known[found].all(1)]


def pixel_rays(view: View, exaggeration: float = 1.0) -> tuple[Array, Array, Array]:
    """(origin, directions (n, 3) through the pixel centres, forward) of a perspective view in stretched space, from its
    definition: tan(fov_y / 2) at half the height."""
    stretch = np.array([1.0, 1.0, exaggeration])
    eye = np.array(view.eye) * stretch
    forward = np.array(view.target) * stretch - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, view.up)
    right = np.array([1.0, 0, 0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
    up = np.cross(right, forward)
    half = np.tan(np.radians(view.fov_y) / 2)
    px, py = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    a = (2 * px / view.width - 1) * half * view.width / view.height
    b = (1 - 2 * py / view.height) * half
    return eye, forward + a.reshape(-1, 1) * right + b.reshape(-1, 1) * up, forward


def embree_depth(of: Terrain, view: View, exaggeration: float = 1.0) -> Array:
    """View-space depth (height, width) of the first triangle each pixel centre's ray meets; NaN where none."""
    eye, directions, _ = pixel_rays(view, exaggeration)
    return embree_hits(*triangles(of), eye, directions, exaggeration).reshape(view.height, view.width)


def embree_hits(
    points: Array, tri: NDArray[np.integer], eye: Array, directions: Array, exaggeration: float = 1.0
) -> Array:
    """The parameter (n,) at which rays (n, 3) from the eye (stretched space) first meet a triangle; NaN where none.

    Embree calculates in single precision, so the scene is moved to the eye and the hit triangle is met again in double.
    """
    import embreex.mesh_construction
    import embreex.rtcore_scene

    local = points * [1.0, 1.0, exaggeration] - eye
    scene = embreex.rtcore_scene.EmbreeScene(robust=True)
    embreex.mesh_construction.TriangleMesh(scene, local[tri].astype(np.float32))
    rays = directions.astype(np.float32)
    hit = scene.run(np.zeros_like(rays), rays, query="INTERSECT").astype(np.int64)
    corner = local[tri[np.maximum(hit, 0)]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    t = (normal * corner[:, 0]).sum(1) / (normal * directions).sum(1)
    return np.where(hit >= 0, t, np.nan)


def surface(of: Terrain, col: Array, row: Array) -> Array:
    """Height of the triangulation at sample positions; NaN in holes and outside."""
    rows, cols = of.grid.shape
    h = of.read(0, 0, rows, 0, cols).astype(np.float64)
    c = np.clip(np.floor(col), 0, cols - 2).astype(int)
    r = np.clip(np.floor(row), 0, rows - 2).astype(int)
    u, v = col - c, row - r
    nw, ne, sw, se = h[r, c], h[r, c + 1], h[r + 1, c], h[r + 1, c + 1]
    even = np.where(u >= v, nw + u * (ne - nw) + v * (se - ne), nw + v * (sw - nw) + u * (se - sw))
    odd = np.where(u + v <= 1, nw + u * (ne - nw) + v * (sw - nw), se + (1 - u) * (sw - se) + (1 - v) * (ne - se))
    inside = (col >= 0) & (row >= 0) & (col <= cols - 1) & (row <= rows - 1)
    return np.where(inside, np.where((r + c) % 2 == 0, even, odd), np.nan)


def read(path: Path) -> NDArray[np.uint8]:
    """The pixels (rows, cols, 3) of a picture's file."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))
