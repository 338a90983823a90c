"""Where the pixels of a picture lie on the ground, by its depth; for a tile to the bit as for the whole picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.scene.scene import Scene

Array = NDArray[np.float64]


def rays_of(scene: Scene, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """(height, width, 3) origins and directions of the rays through pixels' middles; ``shape`` of the scene's view."""
    left, top, _, _ = scene.view.frame
    origin, ou, ov, d, du, dv = scene.view.whole.ray_basis(scene.surface.exaggeration)
    u, v = np.meshgrid(left + np.arange(shape[1]) + 0.5, top + np.arange(shape[0]) + 0.5)
    u, v = u[..., None], v[..., None]
    return origin + u * ou + v * ov, d + u * du + v * dv


def ground_places(scene: Scene, depth: NDArray[np.floating]) -> tuple[Array, Array]:
    """(height, width) eastings and northings; NaN where no ground is."""
    origins, ways = rays_of(scene, depth.shape)
    t = np.where(np.isfinite(depth), depth, np.nan).astype(np.float64)
    return origins[..., 0] + t * ways[..., 0], origins[..., 1] + t * ways[..., 1]
