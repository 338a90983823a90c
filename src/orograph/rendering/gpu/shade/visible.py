"""Which ground a picture shows: from its depths if waiting for them is allowed, otherwise from its patches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.lod.patches.shape import STEPS
from orograph.rendering.gpu.shade.light_maps import LightMaps
from orograph.rendering.survey import stride
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]


def points_of(
    terrain: Terrain, view: View, exaggeration: float, depth: NDArray[np.float32]
) -> tuple[Array, float]:  # fmt: skip
    """Sample coordinates (n, 2) of evenly spread pixels that show ground, and how many pixels each stands for.

    Args:
        depth: (height, width) view-space metres, NaN where there is no ground.
    """
    step = stride(*depth.shape)
    some = depth[::step, ::step]
    rows, cols = np.nonzero(np.isfinite(some))
    o0, ou, ov, d0, du, dv = view.ray_basis(exaggeration)
    px, py = (cols * step + 0.5)[:, None], (rows * step + 0.5)[:, None]
    t = some[rows, cols].astype(np.float64)[:, None]
    at = o0 + px * ou + py * ov + t * (d0 + px * du + py * dv)
    col, row = terrain.grid.index(at[:, 0], at[:, 1])
    col = np.clip(col, 0, terrain.grid.cols - 1)
    row = np.clip(row, 0, terrain.grid.rows - 1)
    return np.stack([col, row], 1), float(step * step)


def about(
    terrain: Terrain, view: View, exaggeration: float, instances: NDArray[np.void], legs: int
) -> tuple[Array, tuple[float, float] | None]:
    """Sample coordinates (n, 2) of corners of the patches in view, and their range of depths (None: none is in view).

    This needs no reply from the GPU, so nothing waits for it.

    Args:
        instances: the patches (``lod.patches.shape.INSTANCE``), at least one. legs: segments of a patch's leg.
    """
    grid = terrain.grid
    reach = legs * (1 << instances["step"].astype(np.int64))
    steps = STEPS[instances["omega"]].astype(np.int64)
    row, col = instances["row"].astype(np.int64), instances["col"].astype(np.int64)
    rows = np.concatenate([row, row + reach * steps[:, 0, 0], row + reach * steps[:, 1, 0]])
    cols = np.concatenate([col, col + reach * steps[:, 0, 1], col + reach * steps[:, 1, 1]])
    points = np.stack([np.clip(cols, 0, grid.cols - 1), np.clip(rows, 0, grid.rows - 1)], 1).astype(np.float64)
    x, y = grid.xy(points[:, 0], points[:, 1])
    middle = sum(terrain.height_range) / 2
    pixels, depth = view.project(np.stack([x, y, np.full(len(x), middle)], -1), exaggeration)
    inside = (depth > 0) & (
        np.abs(pixels - [view.width / 2, view.height / 2]) <= [0.6 * view.width, 0.6 * view.height]
    ).all(-1)
    if not inside.any():
        return points, None
    return points[inside], (float(depth[inside].min()), float(depth[inside].max()))


def wet_at(maps: LightMaps | None, points: Array) -> NDArray[np.bool_]:
    """Whether sample coordinates (n, 2) lie in the water of the maps of light."""
    if maps is None or not maps.wet:
        return np.zeros(len(points), bool)
    _, rows, cols, level = maps.light
    field = maps.pool[rows * cols : 2 * rows * cols].reshape(rows, cols)
    at = np.rint((points + 0.5) / 2.0**level - 0.5).astype(np.intp) - np.array(maps.first)[::-1]
    return np.asarray(field[np.clip(at[:, 1], 0, rows - 1), np.clip(at[:, 0], 0, cols - 1)] > 0.5)
