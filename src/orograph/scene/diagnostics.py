"""Reasons why a picture may surprise without being an error: an eye under the ground, a sun below the horizon.

Sentences for ``Progress.warn``. Units: metres, degrees.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from orograph.geo.beyond import beyond
from orograph.geo.transform import far_outside
from orograph.scene.camera import ground

if TYPE_CHECKING:
    from orograph.scene.scene import Scene

TWILIGHT = -6.0
"""Altitude of the sun below which civil twilight is over, degrees: only the sky gives light."""


TALL = 1e5
"""Metres above or below zero beyond which there is no ground on any planet."""

NEEDLE = 100.0
"""A terrain this many times as tall as wide probably has wrong heights."""


SMALL = 0.1
"""Part of the picture's height; a terrain that fills less of it may have been meant to be elsewhere."""

LEAVE_CAMERA = "Leave out the camera options to see all of it."


def diagnose(scene: Scene) -> list[str]:
    """Warnings about a scene, before it is drawn."""
    return [text for text in (_eye(scene), _sun(scene)) if text is not None]


def _eye(scene: Scene) -> str | None:
    x, y, z = scene.view.eye
    if scene.view.projection == "plan":
        top = scene.terrain.height_range[1]
        if not z < top:
            return None
        return f"the plan's eye is at {z:.0f} m: ground above it, up to {top:.0f} m, is left out."
    far = beyond(scene.terrain.grid, x, y)
    if far is not None:
        across = _across(scene)
        if across < SMALL * far.metres * 2 * math.tan(math.radians(scene.view.fov_y) / 2):
            return (
                f"the eye stands {far}, which is {across / 1000:,.3g} km across: from there it fills less than "
                f"{SMALL:.0%} of the picture's height."
            )
        return None
    height = ground(scene.terrain, x, y, default=math.nan)
    if not z < height:
        return None
    depth = f"{height - z:.0f}" if height - z >= 10 else f"{height - z:.2g}"
    return f"the eye is {depth} m below the ground there ({height:.0f} m): the picture shows the underside."


def _sun(scene: Scene) -> str | None:
    altitude = scene.lighting.sun.altitude
    if altitude >= TWILIGHT:
        return None
    return f"the sun is {round(-altitude, 1):g}° below the horizon: only the light of the sky is drawn."


def _looks_like_degrees(scene: Scene) -> bool:
    """Whether the eye looks like a longitude and a latitude, and lies far outside the terrain."""
    x, y, _ = scene.view.eye
    crs = scene.terrain.grid.crs
    if crs is None or not crs.is_projected or abs(x) > 180 or abs(y) > 90:
        return False
    return far_outside(scene.terrain.grid, x, y)


def _across(scene: Scene) -> float:
    """Distance between opposite corners of the terrain, metres."""
    rows, cols = scene.terrain.grid.shape
    return math.hypot(*(n * s for n, s in zip((cols, rows), scene.terrain.grid.spacing, strict=True)))


def why_empty(scene: Scene) -> str:
    """Why nothing of a terrain is in view, in a sentence or two."""
    view, terrain = scene.view, scene.terrain
    low, high = terrain.height_range
    wide = _across(scene)
    tall = (high - low) * scene.surface.exaggeration
    if tall > NEEDLE * wide:
        return (
            f"Nothing of the terrain is in view: it is {wide:,.0f} m across and {tall:,.0f} m tall, which is thinner "
            "than a pixel when all of it is in view."
        )
    far = beyond(terrain.grid, view.eye[0], view.eye[1])
    place = "above or under its area" if far is None else f"{far},"
    return (
        f"Nothing of the terrain is in view: the eye at ({view.eye[0]:.0f}, {view.eye[1]:.0f}, {view.eye[2]:.0f}) is "
        f"{place} and looks towards ({view.target[0]:.0f}, {view.target[1]:.0f}, {view.target[2]:.0f})."
    )


def what_to_do(scene: Scene) -> str:
    """What may help if nothing is in view."""
    if _looks_like_degrees(scene):
        return 'If these numbers are longitude and latitude, add "crs": "EPSG:4326" to the view.'
    if max(map(abs, scene.terrain.height_range)) > TALL:
        return "Give the unit of its heights (`vertical_unit`), or the number that means missing data (`nodata`)."
    return LEAVE_CAMERA
