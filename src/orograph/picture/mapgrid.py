"""Maps of light and water over the ground in view, made once for a picture and looked up by its pixels.

A sky-view factor is smooth: it is swept on a grid of at most ``WORKING`` samples over what is seen, of the level whose
samples are about a pixel large, with the whole terrain around it at that level or coarser as horizon.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph.light.horizon import sky_view
from orograph.picture.ground import Ground
from orograph.picture.scene import Scene
from orograph.progress import SILENT, Progress

Array = NDArray[np.float64]

WORKING = 1_500_000
"""Samples of a map of light."""

AZIMUTHS = 16


class MapGrid:
    """Sky-view factor and water, bilinear.

    Attributes:
        visible_range: metres from the nearest to the farthest ground in view.
        water_fraction: of the working grid.
    """

    def __init__(self, scene: Scene, ground: Ground, depth: Array, progress: Progress = SILENT) -> None:
        terrain, view = scene.terrain, scene.view
        step = max(1, int(math.sqrt(depth.size / 40_000)))
        rows, cols = np.nonzero(np.isfinite(depth[::step, ::step]))
        rows, cols = rows * step, cols * step
        if len(rows) == 0:
            rows, cols = np.nonzero(np.isfinite(depth))
        seen = ground.rays.meet(cols + 0.5, rows + 0.5, depth[rows, cols], np.zeros(len(rows), np.int8))
        self.visible_range = (float(seen.depth.min()), float(seen.depth.max()))
        west, north = np.maximum(seen.points[:, :2].min(0) - 8, 0)
        east, south = seen.points[:, :2].max(0) + 8
        limit = terrain.levels - 1
        level = 0
        # A band around what is seen casts its shadow on the sky too: a fifth of its size, cut at the terrain's border.
        band = 0.2 * max(east - west, south - north)
        west, north = max(west - band, 0), max(north - band, 0)
        east, south = min(east + band, terrain.grid.cols - 1), min(south + band, terrain.grid.rows - 1)
        while level < limit and (east - west) * (south - north) / 4.0**level > WORKING:
            level += 1
        self.scale = 2.0**level
        total_rows, total_cols = terrain.mean_shape(level)
        r0, c0 = int(north / self.scale), int(west / self.scale)
        r1 = min(int(south / self.scale) + 2, total_rows)
        c1 = min(int(east / self.scale) + 2, total_cols)
        heights = terrain.read_mean(level, r0, r1, c0, c1)
        self.row0, self.col0 = r0, c0
        t = terrain.grid.transform
        linear = np.array([[t.a, t.b], [t.d, t.e]]) * self.scale
        self.sky_view = sky_view(heights * np.float32(scene.exaggeration), linear, AZIMUTHS, jobs=scene.jobs)
        self.water: NDArray[np.float32] | None = None
        if scene.water is not None:
            if scene.water == "auto":
                from orograph.geovis.water import find_water

                found = find_water(heights, abs(float(np.linalg.det(linear))))
            else:
                found = heights <= np.float32(scene.water)
            if found.any():
                self.water = found.astype(np.float32)
        self.water_fraction = 0.0 if self.water is None else float(self.water.mean())

    def look_up(self, points: Array) -> tuple[Array, Array | None]:
        """Sky-view factor and share of water (or None, if there is none) at points (n, 3) in sample coordinates."""
        u = (points[:, 0] + 0.5) / self.scale - 0.5 - self.col0
        v = (points[:, 1] + 0.5) / self.scale - 0.5 - self.row0
        rows, cols = self.sky_view.shape
        j = np.clip(np.floor(u), 0, max(cols - 2, 0)).astype(np.int64)
        i = np.clip(np.floor(v), 0, max(rows - 2, 0)).astype(np.int64)
        fu, fv = np.clip(u - j, 0, 1), np.clip(v - i, 0, 1)
        j1, i1 = np.minimum(j + 1, cols - 1), np.minimum(i + 1, rows - 1)

        def bilinear(a: NDArray[np.float32]) -> Array:
            top = a[i, j] * (1 - fu) + a[i, j1] * fu
            low = a[i1, j] * (1 - fu) + a[i1, j1] * fu
            return np.asarray(top * (1 - fv) + low * fv, np.float64)

        sky = bilinear(self.sky_view)
        sky[~np.isfinite(sky)] = 1.0
        return sky, None if self.water is None else bilinear(self.water)
