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
from orograph.picture.kernels import SHORE
from orograph.picture.scene import Scene
from orograph.progress import SILENT, Progress

Array = NDArray[np.float64]

WORKING = 1_500_000
"""Samples of a map of light."""

AZIMUTHS = 16

TYPICAL_SLOPE = 0.42
"""Slope (rise over run) that four fifths of the ground should not exceed once strengthened."""

MOST_STRENGTH = 6.0


class MapGrid:
    """Sky-view factor and water, bilinear.

    Attributes:
        sky_view, water: (rows, cols) float32, samples of 2^level = ``scale``, first (row0, col0); water may be empty.
            Water is where the water field, interpolated, is above 0.5.
        strength: by how much slopes are strengthened for shading unless the scene says.
        visible_range: metres from the nearest to the farthest ground in view.
        water_fraction: of the working grid.
    """

    def __init__(self, scene: Scene, ground: Ground, depth: Array, progress: Progress = SILENT) -> None:
        terrain = scene.terrain
        step = max(1, int(math.sqrt(depth.size / 40_000)))
        rows, cols = np.nonzero(np.isfinite(depth[::step, ::step]))
        rows, cols = rows * step, cols * step
        if len(rows) == 0:
            rows, cols = np.nonzero(np.isfinite(depth))
        px, py, depths = (np.asarray(a, np.float64) for a in (cols + 0.5, rows + 0.5, depth[rows, cols]))
        seen = ground.rays.meet(px, py, depths, np.zeros(len(depths), np.int8), depths)
        self.visible_range = (float(seen.t.min()), float(seen.t.max()))
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
        self.water = np.empty((0, 0), np.float32)
        self.water_fraction = 0.0
        if scene.water is not None:
            from orograph.geovis.water import shore, water_in

            if scene.water == "auto":
                found = water_in(terrain, ground.rays.spacing, level, r0, c0, heights)
                field = shore(found) if found.any() else self.water
            else:
                found = heights <= np.float32(scene.water)
                # Linear in height, so that its contour is that of the ground; what has just this height is water.
                field = np.where(np.isfinite(heights), np.float32(scene.water + 0.5 + SHORE) - heights, 0)
            if found.any():
                self.water = field.astype(np.float32)
                self.water_fraction = float(found.mean())
        self.strength = self._strength(heights, linear, scene.exaggeration)

    @staticmethod
    def _strength(heights: NDArray[np.float32], linear: Array, exaggeration: float) -> float:
        """How much slopes are strengthened for shading: 1 for rugged ground, more where a small scale or a gentle land
        leaves little to see (cartographers' practice: relief is drawn for its form, Imhof 1965 ch. 8)."""
        rows, cols = heights.shape
        if rows < 3 or cols < 3:
            return 1.0
        down, across = heights[1:, :-1] - heights[:-1, :-1], heights[:-1, 1:] - heights[:-1, :-1]
        to_world = np.linalg.inv(linear).T
        gx = to_world[0, 0] * across + to_world[0, 1] * down
        gy = to_world[1, 0] * across + to_world[1, 1] * down
        slope = np.sqrt(gx * gx + gy * gy)
        slope = slope[np.isfinite(slope) & (slope > 0)]  # water is level and has no say
        if slope.size == 0:
            return 1.0
        typical = float(np.percentile(slope, 80)) * exaggeration
        return float(np.clip(TYPICAL_SLOPE / max(typical, 1e-9), 1.0, MOST_STRENGTH))
