"""Read back the last frame of a renderer: depths in metres, missing ground, and pixel counts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.overview import Seen, seen_by
from orograph.rendering.gpu.readback import depth_of, void_filled_of
from orograph.rendering.gpu.shade.following import Following
from orograph.rendering.gpu.shade.visible import points_of, wet_at
from orograph.rendering.gpu.stream.imagery import Imagery
from orograph.rendering.gpu.surface.ground import Ground
from orograph.rendering.gpu.surface.resident import Resident
from orograph.rendering.gpu.surface.tree import TreeFrame
from orograph.rendering.gpu.surface.void_fill import VoidFillPass
from orograph.rendering.gpu.surface.windows import CastWindows
from orograph.rendering.gpu.targets import Targets
from orograph.rendering.gpu.temporal.jitter import Jitter
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation


class Reading:
    """The part of a renderer that reads its last frame back.

    Attributes:
        device, terrain: the renderer's. imagery: its layers.
    """

    device: Device
    terrain: Terrain
    imagery: Imagery
    _targets: Targets | None
    _void_fill: VoidFillPass
    _light: Following
    _samples: Jitter
    _ground: Ground

    def depth_at(self, x: float, y: float) -> float | None:
        """View-space depth of the last frame at a pixel position, metres; None where there is no ground."""
        t = self._targets
        if t is None or not (0 <= x < t.width and 0 <= y < t.height):
            return None
        value = float(depth_of(self.device, t, self._camera_drawn, (int(x), int(y), 1, 1))[0, 0])
        return value if math.isfinite(value) else None

    def depth(self) -> NDArray[np.float32]:
        """View-space depth (height, width) of the last frame, metres, NaN where there is no ground."""
        assert self._targets is not None
        return np.where(
            self.void_filled(), np.float32(np.nan), depth_of(self.device, self._targets, self._camera_drawn)
        )

    def void_filled(self) -> NDArray[np.bool_]:
        """Pixels (height, width) of the last frame that show missing ground."""
        t = self._targets
        assert t is not None
        return void_filled_of(self.device, t) if self._void_fill.count else np.zeros((t.height, t.width), bool)

    def shown(self, scene: Scene, depth: NDArray[np.float32], void_filled: NDArray[np.bool_]) -> dict[str, int]:
        """How many pixels show ground, how many of them water and imagery, and how many missing ground; the middle two
        estimated from a sample."""
        ground = int(np.isfinite(depth).sum())
        points, share = points_of(self.terrain, scene.view, scene.surface.exaggeration, depth)
        wet, covered = wet_at(self._light.maps, points), 0
        if scene.data.layers and len(points):
            x, y = self.terrain.grid.xy(points[:, 0], points[:, 1])
            hidden = self.imagery.covered(scene.data.layers, x, y) > 0.5
            wet, covered = wet & ~hidden, int(hidden.sum())
        return {
            "ground": ground, "water": round(int(wet.sum()) * share), "draped": round(covered * share),
            "missing": int(void_filled.sum()),
        }  # fmt: skip

    @property
    def mesh(self) -> Tessellation | None:
        """The mesh of the scene's method that the last frame drew; None: something else, such as patches."""
        return self._ground.mesh

    @property
    def resident(self) -> TreeFrame | Resident | None:
        """The last frame's triangles that exist only on the GPU but can be read; None: something else."""
        return self._ground.resident

    @property
    def tree(self) -> TreeFrame | None:
        """The tree that the last frame drew; None: it drew something else."""
        found = self.resident
        return found if isinstance(found, TreeFrame) else None

    @property
    def windows(self) -> CastWindows | None:
        """The windows that the last frame's rays were cast at; None: it drew triangles."""
        return self._ground.rays

    @property
    def light(self) -> str:
        """The source of the last frame's light, if it was looked up in a layer or found by rays."""
        scene = self._samples.state and self._samples.state[0]
        if scene and scene.lighting.light == "raytraced":
            return f"{scene.lighting.rays} rays"
        return self._light.maps.description if self._light.maps is not None else ""

    def _seen(self, scene: Scene) -> Seen:
        """Some of the ground in view, by the last frame's depth."""
        return seen_by(self.terrain, scene.view, scene.surface.exaggeration, self.depth())

    @property
    def _camera_drawn(self) -> NDArray[Any]:
        """The camera of the last frame."""
        scene = self._samples.state[0]
        return camera_of(scene.view, self.terrain, scene.surface.exaggeration)
