"""Silhouettes on the GPU: passes between geometry and light find how far ground faces the eye
(``shaders/facing.wgsl``), and where it breaks off or turns away and back (``shaders/depth_edges.wgsl``).

The shading pass draws the lines (``shaders/lines.wgsl``), as ``rendering.lines.silhouettes`` does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.rendering.gpu.targets import Targets
from orograph.rendering.lines.silhouettes import terrain_ends
from orograph.store.terrain import Terrain

BREAKS = "rgba16float"
FACING = "r16float"
SHADERS = {"facing": FACING, "depth_edges": BREAKS, "depth_edges_near": BREAKS}


class BreakPass:
    """Finds breaks in the targets' depth.

    Args:
        camera: the uniform buffer (``camera.CAMERA``). terrain: what is drawn.
        slopes: the view of the slopes' atlas, its pages and the table of levels (``shaders/slopes.wgsl``).
    """

    def __init__(self, device: Device, camera: Any, terrain: Terrain, slopes: tuple[Any, Any, Any]) -> None:
        self.device, self.camera, self.terrain, self.slopes = device, camera, terrain, slopes
        self._away: Any = None  # where the terrain ends (``terrain_ends``), made on first use
        self._step = 1
        self.range = device.buffer(16, "UNIFORM", "depths in view")
        self._programs = {name: Program(device, name) for name in SHADERS}
        self._pipelines: dict[str, Any] = {}
        self._of: Targets | None = None
        self._views: tuple[Any, ...] = ()
        self._groups: tuple[Any, ...] = ()

    def views(self, targets: Targets) -> tuple[Any, Any]:
        """The views of the breaks of these targets, and of the heaviest one in every square of 8 × 8 pixels."""
        if self._of is not targets:
            usage = "RENDER_ATTACHMENT|TEXTURE_BINDING"
            full = targets.width, targets.height
            sizes = full, full, (-(-targets.width // 8), -(-targets.height // 8))
            self._of = targets
            facing, breaks, _ = self._views = tuple(
                self.device.texture(size, format, usage, label=name).create_view()
                for size, (name, format) in zip(sizes, SHADERS.items(), strict=True)
            )
            common = {"camera": self.camera, "depths": targets.depth_view}
            slopes = dict(zip(("slopes", "pages", "levels"), self.slopes, strict=True))
            ranges = {"range": self.range, "away": self._away, "facing": facing}
            needed = common | slopes, common | ranges, {"breaks": breaks}
            self._groups = tuple(
                program.bind(resources) for program, resources in zip(self._programs.values(), needed, strict=True)
            )
        return self._views[1], self._views[2]

    def aim(self, depths: tuple[float, float], creases: float) -> None:
        """Set the depths in view, metres, and the weight of creases; before ``views``."""
        if self._away is None:
            away, self._step = terrain_ends(self.terrain)
            height, width = away.shape
            self._away = self.device.texture((width, height), "r32float", "COPY_DST|TEXTURE_BINDING", label="ends")
            self.device.queue.write_texture(
                {"texture": self._away}, away, {"bytes_per_row": 4 * width}, (width, height, 1)
            )
        self.device.queue.write_buffer(self.range, 0, np.array([*depths, self._step, creases], np.float32))

    def draw(self, encoder: Any, targets: Targets) -> None:
        """Find the breaks in the targets' depth."""
        self.views(targets)
        for name, view, group in zip(SHADERS, self._views, self._groups, strict=True):
            pass_ = encoder.begin_render_pass(
                color_attachments=[{"view": view, "clear_value": (0, 0, 0, 0), "load_op": "clear", "store_op": "store"}]
            )
            pass_.set_pipeline(self._pipeline(name))
            pass_.set_bind_group(0, group)
            pass_.draw(3)
            pass_.end()

    def _pipeline(self, name: str) -> Any:
        if name not in self._pipelines:
            self._pipelines[name] = self._programs[name].draw([{"format": SHADERS[name]}])
        return self._pipelines[name]
