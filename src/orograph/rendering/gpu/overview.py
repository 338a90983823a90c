"""What all tiles of a picture share: the ground that the whole picture shows, found from a small picture of it.

A picture too large for a graphics card is drawn tile by tile (``View.tile``). Each tile must have the light and haze of
the whole picture, or there would be seams: this overview determines the windows of the light maps, the strengthening of
relief and the depth range of haze. Lines that depend on surrounding pixels need a rim, which is drawn with a tile and
cut off. Patches are chosen by the whole view's bound (``error.screen``), so neighbours' agree.

Units: pixels; sample coordinates; metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.readback import depth_of
from orograph.rendering.gpu.shade.visible import points_of
from orograph.rendering.gpu.surface.ground import Ground
from orograph.rendering.gpu.targets import Targets
from orograph.rendering.lines.silhouettes import rim
from orograph.scene.aids import interval_of
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]
Seen = tuple[Array, tuple[float, float] | None]
"""Sample coordinates (n, 2) of some of the ground in view, and the range of its depths (None: there is none)."""

SIDE = 1024
"""Pixels on the longer side of the small picture."""


def seen_by(terrain: Terrain, view: View, exaggeration: float, depth: NDArray[np.float32]) -> Seen:
    """What a picture with these depths (NaN: no ground) shows."""
    points, _ = points_of(terrain, view, exaggeration, depth)
    return points, (float(np.nanmin(depth)), float(np.nanmax(depth))) if len(points) else None


def overview(device: Device, ground: Ground, camera: Any, scene: Scene) -> Seen:
    """What a scene's whole view shows, from a small picture of it.

    Args:
        camera: the buffer that ``ground`` looks at; it is written.

    Raises:
        StoreError: a tile cannot be read.
    """
    terrain, view, exaggeration = scene.terrain, scene.view.whole, scene.surface.exaggeration
    smaller = SIDE / max(view.width, view.height, SIDE)
    small = view.resized(max(round(smaller * view.width), 1), max(round(smaller * view.height), 1))
    chosen = ground.tiles.choose(small, 1.0, exaggeration, wait=True)
    targets, eye = Targets(device, small.width, small.height), camera_of(small, terrain, exaggeration)
    write(device, camera, eye)
    encoder = device.handle.create_command_encoder()
    ground.draw_patches(encoder, targets, chosen.patches)
    device.queue.submit([encoder.finish()])
    return seen_by(terrain, small, exaggeration, depth_of(device, targets, eye))


def rimmed(scene: Scene) -> tuple[View, tuple[slice, slice]]:
    """A tile with the surrounding pixels that its lines depend on, and its position in that; a whole view unchanged."""
    view, lines = scene.view, scene.annotations.silhouettes
    by = rim(lines.fitted(view.whole)) if lines is not None and view.projection != "plan" else 0
    by = max(by, int(interval_of(scene.annotations.aids, scene.view) is not None))
    if view.part is None or by == 0:
        return view, (slice(0, view.height), slice(0, view.width))
    left, top, width, height = view.part
    x0, y0 = max(left - by, 0), max(top - by, 0)
    x1, y1 = min(left + view.width + by, width), min(top + view.height + by, height)
    own = slice(top - y0, top - y0 + view.height), slice(left - x0, left - x0 + view.width)
    return view.whole.tile(x0, y0, x1 - x0, y1 - y0), own
