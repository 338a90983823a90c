"""What makes a scene's picture surprising without being an error: an eye under the ground, a sun under the horizon.

Sentences for ``Progress.warn``. Units: metres, degrees.
"""

from __future__ import annotations

import math

from orograph.picture.camera import far_outside, ground
from orograph.picture.scene import Scene

TWILIGHT = -6.0
"""Degrees of the sun's altitude below which civil twilight is over: only the sky gives light."""


def doubts(scene: Scene) -> list[str]:
    """What the user of a scene should know before looking at it."""
    return [text for text in (_eye(scene), _sun(scene)) if text is not None]


def _eye(scene: Scene) -> str | None:
    x, y, z = scene.view.eye
    if scene.view.projection == "plan":
        top = scene.terrain.height_range[1]
        if not z < top:
            return None
        return f"the plan's eye is at {z:.0f} m: what rises above it, up to {top:.0f} m, is left out."
    height = ground(scene.terrain, x, y, default=math.nan)
    if not z < height:
        return None
    depth = f"{height - z:.0f}" if height - z >= 10 else f"{height - z:.2g}"
    return f"the eye is {depth} m below the ground there ({height:.0f} m): the picture shows the underside."


def _sun(scene: Scene) -> str | None:
    altitude = scene.sun.altitude
    if altitude >= TWILIGHT:
        return None
    return f"the sun is {round(-altitude, 1):g}° below the horizon: only the light of the sky is drawn."


def looks_like_degrees(scene: Scene) -> bool:
    """Whether the eye could be a longitude and a latitude, and lies far outside the terrain as it is."""
    x, y, _ = scene.view.eye
    crs = scene.terrain.grid.crs
    if crs is None or not crs.is_projected or abs(x) > 180 or abs(y) > 90:
        return False
    return far_outside(scene.terrain.grid, x, y)
