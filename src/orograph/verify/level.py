"""A view for judging meshes without a view, in vertical metres."""

from __future__ import annotations

import math

import numpy as np

from orograph.errors import UsageError
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

FAR = 1e9
"""Metres from the eye to the terrain: over 100 km, the size of a pixel changes by a factor of 1e-4."""


def level_view(terrain: Terrain) -> View:
    """A horizontal view in which a pixel is a metre of height anywhere on the terrain, with all of it in view.

    >>> verify.judge_mesh(mesh, terrain, verify.level_view(terrain)).largest  # metres    # doctest: +SKIP

    Raises:
        UsageError: the terrain has no valid sample.
    """
    rows, cols = terrain.grid.shape
    low, high = terrain.height_range
    if not high >= low:
        raise UsageError("The terrain has no valid sample.", path=terrain.name)
    x, y = terrain.grid.xy(np.array([0, cols - 1, 0, cols - 1.0]), np.array([0, 0, rows - 1, rows - 1.0]))
    east, north, up = (float(x.min() + x.max()) / 2, float(y.min() + y.max()) / 2, (low + high) / 2)
    pixels = math.ceil(2 * (float(np.ptp(x)) + float(np.ptp(y)) + high - low)) + 2
    fov = math.degrees(2 * math.atan(pixels / 2 / FAR))
    return View((east, north - FAR, up), (east, north, up), fov_y=fov, width=pixels, height=pixels)
