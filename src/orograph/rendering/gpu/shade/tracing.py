"""Light by rays, frame by frame: the terrain that rays meet around the camera, and how many rays a frame traces.

A picture traces all its rays, in parts of bounded work, so that no driver's watchdog fires and Ctrl-C is handled in
between. A frame of the window traces a few per pixel; at rest further frames trace the other rays of the same lattices,
and the picture is their mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from orograph.gpu.background import BackgroundTask
from orograph.gpu.device import Device
from orograph.rendering.cpu.mesh_surface import surface_of
from orograph.rendering.gpu.pool import samples_in
from orograph.rendering.gpu.shade.light_maps import has_sun_maps
from orograph.rendering.gpu.shade.ray_field import EXACT, NOTHING, RayField, field_of
from orograph.rendering.gpu.temporal.jitter import SAMPLES
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation

RAYS, SHADOW_RAYS = 1 << 16, 1 << 18
"""Flags of ``shaders/shade.wgsl``: all light by rays; the sun's shadows only."""

TRACED = RAYS | SHADOW_RAYS

SKYLINE = 8
"""Maximum rays that find the skyline in front of the sun's disc (``shaders/rays.wgsl``)."""

WORK = {True: 1 << 21, False: 1 << 23}
"""Rays per submission, and the target per frame of the window, on slow devices (software, integrated GPUs) and on
others: a second of work for the former, some hundredths for the latter. No driver's watchdog is shorter than two
seconds."""


def work_of(device: Device) -> int:
    """``WORK`` of a device."""
    return WORK[device.adapter.kind != "DiscreteGPU"]


class Around:
    """The terrain around the camera that rays meet: made at once for a picture, in the background for frames that may
    not wait.

    Args:
        most: bytes available for it.

    Attributes:
        field: the terrain to draw with.
    """

    def __init__(self, terrain: Terrain, most: int) -> None:
        self.terrain, self.most = terrain, most
        self.field = NOTHING
        self._aside = BackgroundTask()
        self._made: Any = None
        self._wish: Any = None
        self._mesh: Tessellation | None = None  # kept alive, so that its id stays unique

    @property
    def busy(self) -> bool:
        """Whether the terrain that the last scene needs is still being made."""
        return self._wish is not None and (self._aside.busy or self._wish != self._made)

    def at_once(self, scene: Scene, mesh: Tessellation | None = None) -> None:
        """Provide what a scene's rays meet, if it has rays: the terrain, or a mesh that is drawn instead."""
        key = self._key(scene) if casts(scene) else None
        self._wish = key if key is None or mesh is None else (*key, id(mesh))
        if self._wish is not None and self._wish != self._made:
            self.field, self._made, self._mesh = self._make(scene, mesh), self._wish, mesh

    def aside(self, scene: Scene) -> None:
        """Take over terrain that is ready, and request other terrain if the scene needs it."""
        done = self._aside.take()
        if done is not None:
            self._made, self.field = done
        key = self._wish = self._key(scene) if scene.lighting.light == "raytraced" else None
        if key is not None and key != self._made and self._aside.wants(key):
            self._aside.start(key, lambda: (key, self._make(scene)))

    def close(self) -> None:
        self._aside.close()

    def _make(self, scene: Scene, mesh: Tessellation | None = None) -> RayField:
        terrain = self.terrain if mesh is None else surface_of(mesh, self.terrain, scene.budget.max_memory)
        made = field_of(
            terrain,
            scene.view,
            scene.surface.exaggeration,
            scene.surface.tolerance or 1.0,
            self.most,
            scene.budget.jobs,
        )
        return made[1]()  # type: ignore[no-any-return]

    def _key(self, scene: Scene) -> Any:
        """What the choice of windows depends on. The camera's place counts in steps."""
        rows, cols = self.terrain.grid.shape
        if rows * cols <= min(EXACT, samples_in(self.most)):
            return (scene.surface.exaggeration,)
        view = scene.view
        step = 0.15 * max(view.distance, 1.0)
        where = (tuple(np.floor(np.asarray(p) / step).tolist()) for p in (view.eye, view.target))
        return scene.surface.exaggeration, scene.surface.tolerance, *where


def casts(scene: Scene) -> bool:
    """Whether a picture of a scene traces rays: for all of its light, or for the sun's shadows."""
    return scene.lighting.light == "raytraced" or has_sun_maps(scene)


@dataclass(frozen=True, slots=True)
class Share:
    """The part of its light that a frame of a scene traces.

    Attributes:
        first, rays, total: ``rays`` rays of every pixel's lattices of ``total`` rays, from ``first`` on.
        frames: the number of frames that make the whole. lights: the number of lights that rays go to.
        corner: the position of the target's upper left corner in the whole picture.
    """

    first: int
    rays: int
    total: int
    frames: int
    lights: int
    corner: tuple[float, float]

    @classmethod
    def of(
        cls, device: Device, scene: Scene, frame: int, frames: int, *, samples: int | None = None,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> Share:  # fmt: skip
        """The share of a scene's ``frame``: each of ``samples`` samples per pixel has its own, ``shift``-ed lattices,
        as in the CPU's pictures; or (None) frames share one, in ``frames`` of them or as many more as the work needs.
        """
        view = scene.view
        left, top, _, _ = view.frame
        if scene.lighting.light != "raytraced":
            return cls(0, SKYLINE, SKYLINE, SAMPLES, 1, (left, top))
        lights = 1 + (1 + len(scene.lighting.discs) if scene.lighting.shadows else 0)
        if samples is not None:
            rays = max(-(-scene.lighting.rays // samples), min(scene.lighting.rays, 8))
            return cls(0, rays, rays, samples, lights, (left + shift[0], top + shift[1]))
        most = work_of(device) // max(view.width * view.height * lights, 1)
        rays = max(min(-(-scene.lighting.rays // frames), most), 1)
        frames = max(frames, -(-scene.lighting.rays // rays))
        return cls(frame * rays % scene.lighting.rays, rays, scene.lighting.rays, frames, lights, (left, top))


def parts_of(device: Device, size: tuple[int, int], rays: int) -> list[tuple[int, int, int, int]]:
    """Divide a target into rectangles (x, y, width, height), each a submission's work, with ``rays`` rays per pixel."""
    width, height = size
    pixels = max(work_of(device) // max(rays, 1), 64)
    wide = min(width, pixels)
    high = min(max(pixels // wide, 1), height)
    return [
        (x, y, min(wide, width - x), min(high, height - y))
        for y in range(0, height, high)
        for x in range(0, width, wide)
    ]
