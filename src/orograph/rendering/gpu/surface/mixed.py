"""Patches and rays in one picture: each block of the screen is drawn by one of them (``surface.mixer`` decides).

Each way draws its blocks whole and includes all ground there, so no pixel is left out where they
meet: a border only shows the difference of two surfaces that are both within the tolerance. Blocks of rays are first
filled with a depth that keeps patches out; then patches are drawn, except those that lie only over such blocks; then
rays overwrite their blocks.

The thread that selects windows also counts the steps of some rays (``rays.RaySteps``), which tells their cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.lod.selection import PatchesAndRays
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.surface.patches import PatchPass
from orograph.rendering.gpu.surface.rays import RayPass, RaySteps
from orograph.rendering.gpu.surface.shares import Labels
from orograph.rendering.gpu.surface.windows import CastWindows, Windows
from orograph.rendering.gpu.targets import Targets, cleared
from orograph.store.terrain import Terrain


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixableWindows(PatchesAndRays):
    """Windows on the GPU, and the cost of rays at them.

    Attributes:
        rays: the windows. steps: ``RaySteps.count`` for the camera's view.
    """

    rays: CastWindows
    steps: NDArray[np.uint32]


@dataclass(frozen=True, slots=True, eq=False)
class Cast:
    """Where rays are cast: the same object as long as windows and blocks stay the same.

    Attributes:
        windows: the windows. by_rays: the blocks, of ``side`` pixels.
    """

    windows: CastWindows
    by_rays: Labels
    side: int


@dataclass(frozen=True, slots=True, eq=False)
class Mixed:
    """What a frame draws.

    Attributes:
        instances: patches to draw. cast: where rays are cast.
    """

    instances: NDArray[Any]
    cast: Cast

    @property
    def rays(self) -> Cast | None:
        """Where rays are cast; None: nowhere."""
        return self.cast if self.cast.by_rays.any() else None


class Mixing:
    """Prepares selections of patches and rays for mixing; may be called from any thread."""

    def __init__(self, device: Device, terrain: Terrain, windows: Windows) -> None:
        self.terrain, self.windows = terrain, windows
        self._steps = RaySteps(device)

    def ready(self, selection: PatchesAndRays, again: Callable[[float], PatchesAndRays]) -> MixableWindows:
        """See ``Windows.ready``."""
        rays = self.windows.ready(selection, again)
        camera = selection.camera
        steps = self._steps.count(rays, camera_of(camera.view, self.terrain, camera.exaggeration))
        return MixableWindows(
            method=selection.method, bound=rays.bound, lacking=rays.lacking, stats=rays.stats, windows=rays.windows,
            camera=camera, block=selection.block, shares=selection.shares, hysteresis=selection.hysteresis,
            select_patches=selection.select_patches, rays=rays, steps=steps,
        )  # fmt: skip


class MixedPass:
    """Draws patches and rays into depth and marks.

    Args:
        patches, rays: the passes for either.
    """

    def __init__(self, device: Device, patches: PatchPass, rays: RayPass) -> None:
        self.device, self.patches, self.rays = device, patches, rays

    def draw(self, encoder: Any, targets: Targets, selection: Mixed, left: Left) -> None:
        """Clear the targets and draw."""
        cast, slopes = selection.cast, bool(left.slopes)
        if cast.by_rays.all():
            self.rays.draw(encoder, targets, cast.windows, left)
            return
        side = cast.side
        self.patches.bring(selection.instances)
        blocks = self.rays.bring_blocks(cast.by_rays)
        if blocks:
            self.rays.bring(encoder, targets, cast.windows)
            self.rays.compute_blocks(encoder, blocks, side, slopes)
        pass_ = cleared(targets, self.device, slopes).begin(encoder)
        if blocks:
            self.rays.keep_free(pass_, blocks, side, slopes)
        self.patches.record(pass_, len(selection.instances), left)
        if blocks:
            self.rays.cast_blocks(pass_, blocks, side, slopes)
        pass_.end()
