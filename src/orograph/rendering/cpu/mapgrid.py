"""Maps of light and water over the ground in view, made once per picture and looked up by its pixels.

A sky-view factor is smooth: it is swept on a grid of at most ``WORKING`` samples over the visible ground, at the level
whose samples are about a pixel large, with the whole surrounding terrain at that level or coarser as horizon.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import Rectangle
from orograph.lighting.horizon import sky_view
from orograph.memo import Memo
from orograph.rendering.cpu.ground import Ground
from orograph.rendering.lookup import SHORE, MapPlace
from orograph.rendering.survey import Survey
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]

WORKING = 1_500_000
"""Maximum samples of a map of light."""

AZIMUTHS = 16

TYPICAL_SLOPE = 0.42
"""Slope (rise over run) that four fifths of the ground should not exceed after strengthening."""

MOST_STRENGTH = 6.0


class MapGrid:
    """Sky-view factor and water, bilinear.

    Attributes:
        window: the grid, of a level of box means.
        place: where its samples lie.
        sky_view, water: (rows, cols) float32; water may be empty. Water is where the water field, interpolated, is
            above 0.5. The sky is swept for the light "relief" only.
        strength: factor on slopes for shading unless the scene sets one.
        water_fraction: of the working grid.
    """

    def __init__(self, scene: Scene, ground: Ground, survey: Survey, memo: Memo) -> None:
        terrain = scene.terrain
        self.window = window = working_window(terrain, survey.hits.points)
        self.place = MapPlace(2.0**window.level, window.row0, window.col0)
        linear = terrain.chart.linear * self.place.scale

        def sky() -> NDArray[np.float32]:
            heights = terrain.read_mean(*window)
            return sky_view(heights * np.float32(scene.surface.exaggeration), linear, AZIMUTHS, jobs=scene.budget.jobs)

        known = window, scene.surface.exaggeration
        self.sky_view = (
            memo("sky", known, sky, terrain) if scene.lighting.light == "relief" else np.empty((0, 0), np.float32)
        )
        self.strength = (
            memo("strength", known, lambda: strength_of(ground.bare, window), ground.bare.terrain)
            if scene.lighting.relief is None
            else scene.lighting.relief
        )
        self.water, self.water_fraction = np.empty((0, 0), np.float32), 0.0
        if scene.data.water is not None:
            self.water, self.water_fraction = water_map(scene, ground, window, memo)


def working_window(terrain: Terrain, points: Array) -> Rectangle:
    """The working grid for ground in view.

    It covers points (n, 2 or 3) in sample coordinates and a fifth of their extent around them, because ground there
    hides the sky too. Its borders lie at multiples of an eighth of its size, so that it mostly stays the same from
    frame to frame of a movie.
    """
    west, north = np.maximum(points[:, :2].min(0) - 8, 0)
    east, south = points[:, :2].max(0) + 8
    level = 0
    band = 0.2 * max(east - west, south - north)
    west, north = max(west - band, 0), max(north - band, 0)
    east, south = min(east + band, terrain.grid.cols - 1), min(south + band, terrain.grid.rows - 1)
    while level < terrain.levels - 1 and (east - west) * (south - north) / 4.0**level > WORKING:
        level += 1
    scale = 2.0**level
    total_rows, total_cols = terrain.mean_shape(level)
    size = max(east - west, south - north) / scale
    grain = max(16, 1 << max(0, math.ceil(math.log2(max(size, 1.0) / 8))))
    r0, c0 = int(north / scale) // grain * grain, int(west / scale) // grain * grain
    r1 = min(-(-(int(south / scale) + 2) // grain) * grain, total_rows)
    c1 = min(-(-(int(east / scale) + 2) // grain) * grain, total_cols)
    return Rectangle(level, r0, r1, c0, c1)


def water_map(scene: Scene, ground: Ground, window: Rectangle, memo: Memo) -> tuple[NDArray[np.float32], float]:
    """``_water``, computed once per window."""
    return memo(
        "water", (window, scene.data.water), lambda: _water(ground.bare, ground, window), ground.bare.terrain
    )  # fmt: skip


def _water(scene: Scene, ground: Ground, window: Rectangle) -> tuple[NDArray[np.float32], float]:
    """The field of water over the working grid, (0, 0) if there is none, and the part of the grid that is water."""
    from orograph.geovis.water import shore, still, water_in

    heights = scene.terrain.read_mean(*window)
    field: NDArray[np.floating] = np.empty((0, 0), np.float32)
    if scene.data.water == "auto":
        found = water_in(scene.terrain, ground.rays.to_samples.spacing, window.level, window.row0, window.col0, heights)
        if found.any():
            field = shore(found, still(heights))
    else:
        assert scene.data.water is not None
        found = heights <= np.float32(scene.data.water)
        # Linear in height, so that its contour is that of the ground; ground at exactly this height is water.
        if found.any():
            field = np.where(np.isfinite(heights), np.float32(scene.data.water + 0.5 + SHORE) - heights, 0)
    return field.astype(np.float32), float(found.mean()) if found.any() else 0.0


def strength_of(scene: Scene, window: Rectangle) -> float:
    """The factor on slopes for shading: 1 for rugged ground, and more for a small scale or gentle land.

    There, little relief would be visible (cartographers' practice: relief is drawn for its form, Imhof 1965 ch. 8).

    Args:
        window: the ground, from ``working_window``.
    """
    heights = scene.terrain.read_mean(*window)
    linear = scene.terrain.chart.linear * 2.0**window.level
    rows, cols = heights.shape
    if rows < 3 or cols < 3:
        return 1.0
    down, across = heights[1:, :-1] - heights[:-1, :-1], heights[:-1, 1:] - heights[:-1, :-1]
    to_world = np.linalg.inv(linear).T
    gx = to_world[0, 0] * across + to_world[0, 1] * down
    gy = to_world[1, 0] * across + to_world[1, 1] * down
    slope = np.sqrt(gx * gx + gy * gy)
    slope = slope[np.isfinite(slope) & (slope > 0)]  # water is level and does not count
    if slope.size == 0:
        return 1.0
    typical = float(np.percentile(slope, 80)) * scene.surface.exaggeration
    return float(np.clip(TYPICAL_SLOPE / max(typical, 1e-9), 1.0, MOST_STRENGTH))
