"""What the furniture of a scene says: title, colours, north, scale and light, from what was drawn."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.colour import linear_to_srgb
from orograph.picture.furniture import Legend, furnish
from orograph.picture.scene import Scene
from orograph.picture.shading import MISSING, WATER, Shader

Array = NDArray[np.float64]


def decorate(pixels: NDArray[np.uint8], scene: Scene, shader: Shader, depth: Array, veiled: bool) -> NDArray[np.uint8]:
    """The picture (height, width, 3) with its furniture.

    Args:
        depth: (height, width) view-space depth, NaN where no ground is.
        veiled: whether missing data is shown.
    """
    view, terrain = scene.view, scene.terrain
    low, high, colours = shader.tint.scale()
    water = shader.maps.water_fraction > 0.002
    legend = None
    if scene.drape is None:
        legend = Legend(
            low, high, linear_to_srgb(colours),
            water=linear_to_srgb(WATER) if water else None, missing=linear_to_srgb(MISSING) if veiled else None,
        )  # fmt: skip
    crs = terrain.grid.crs
    parts = [f"Light from {scene.sun.azimuth:g}°, {scene.sun.altitude:g}° high"]
    if scene.exaggeration != 1:
        parts.append(f"heights ×{scene.exaggeration:g}")
    if view.projection == "perspective":
        parts.append("scale at the picture's middle")
    if crs is not None:
        parts.append(crs.name)
    return furnish(
        pixels, title=scene.title if scene.title is not None else _title(terrain.name), legend=legend,
        north=north_on_screen(scene), metres_per_pixel=_scale(scene, depth), note=" · ".join(parts),
    )  # fmt: skip


def _title(name: str) -> str:
    return name.replace("_", " ").strip()


def north_on_screen(scene: Scene) -> float | None:
    """Direction of grid north at the target, degrees clockwise from the picture's up; None if it points at the eye."""
    view: Any = scene.view
    here = np.array(view.target)
    step = max(view.distance * 1e-4, 1e-3)
    (a, b), _ = view.project(np.stack([here, here + np.array([0.0, step, 0.0])]), scene.exaggeration)
    dx, dy = b - a
    if not (math.isfinite(dx) and math.isfinite(dy)) or math.hypot(dx, dy) < 1e-6:
        return None
    return math.degrees(math.atan2(dx, -dy))


def _scale(scene: Scene, depth: Array) -> float | None:
    """Metres across a pixel: anywhere in a plan, at the ground nearest the picture's middle in perspective."""
    view = scene.view
    if view.projection == "plan":
        return view.pixel_metres
    column = depth[:, view.width // 2]
    seen = np.flatnonzero(np.isfinite(column))
    if len(seen) == 0:
        return None
    middle = seen[np.argmin(np.abs(seen - view.height // 2))]
    return float(column[middle]) * view.pixel_slope
