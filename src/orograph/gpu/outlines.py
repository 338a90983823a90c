"""Silhouettes on the GPU: a pass between geometry and light finds where ground breaks off (``shaders/breaks.wgsl``).

The shading pass draws the lines (``shaders/lines.wgsl``), as ``picture.silhouettes`` does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph.gpu.device import Device
from orograph.gpu.passes import Targets
from orograph.picture.silhouettes import terrain_ends
from orograph.store.terrain import Terrain

BREAKS = "rgba16float"
SHADERS = "breaks", "breaks_near"


class BreakPass:
    """Finds breaks in the targets' depth.

    Args:
        camera: the uniform buffer (``camera.CAMERA``). terrain: what is drawn.
    """

    def __init__(self, device: Device, camera: Any, terrain: Terrain) -> None:
        self.device, self.camera, self.terrain = device, camera, terrain
        self._away: Any = None  # where the terrain ends (``terrain_ends``), made when first asked for
        self._step = 1
        self.range = device.buffer(16, "UNIFORM", "depths in view")
        self._pipelines: dict[str, Any] = {}
        self._of: Targets | None = None
        self._views: tuple[Any, Any] = (None, None)
        self._groups: tuple[Any, Any] = (None, None)

    def views(self, targets: Targets) -> tuple[Any, Any]:
        """The views of the breaks of these targets, and of the heaviest one in every square of 8 × 8 pixels."""
        if self._of is not targets:
            usage = "RENDER_ATTACHMENT|TEXTURE_BINDING"
            sizes = (targets.width, targets.height), (-(-targets.width // 8), -(-targets.height // 8))
            textures = [self.device.texture(size, BREAKS, usage, label="breaks") for size in sizes]
            self._of, self._views = targets, (textures[0].create_view(), textures[1].create_view())
            buffers = [{"buffer": b} for b in (self.camera, self.range)]
            self._groups = (
                self._group("breaks", buffers[0], targets.depth_view, buffers[1], self._away.create_view()),
                self._group("breaks_near", self._views[0]),
            )
        return self._views

    def aim(self, depths: tuple[float, float]) -> None:
        """Say which depths are in view, metres; before ``views``."""
        if self._away is None:
            away, self._step = terrain_ends(self.terrain)
            height, width = away.shape
            self._away = self.device.texture((width, height), "r32float", "COPY_DST|TEXTURE_BINDING", label="ends")
            self.device.queue.write_texture(
                {"texture": self._away}, away, {"bytes_per_row": 4 * width}, (width, height, 1)
            )
        self.device.queue.write_buffer(self.range, 0, np.array([*depths, self._step, 0], np.float32))

    def draw(self, encoder: Any, targets: Targets) -> None:
        """Find the breaks of what the targets hold."""
        for name, view, group in zip(SHADERS, self.views(targets), self._groups, strict=True):
            pass_ = encoder.begin_render_pass(
                color_attachments=[{"view": view, "clear_value": (0, 0, 0, 0), "load_op": "clear", "store_op": "store"}]
            )
            pass_.set_pipeline(self._pipeline(name))
            pass_.set_bind_group(0, group)
            pass_.draw(3)
            pass_.end()

    def _pipeline(self, name: str) -> Any:
        if name not in self._pipelines:
            module = self.device.shader(name)
            self._pipelines[name] = self.device.handle.create_render_pipeline(
                label=name,
                layout="auto",
                vertex={"module": module, "entry_point": "vertex"},
                primitive={"topology": "triangle-list"},
                fragment={"module": module, "entry_point": "fragment", "targets": [{"format": BREAKS}]},
            )
        return self._pipelines[name]

    def _group(self, name: str, *resources: Any) -> Any:
        return self.device.handle.create_bind_group(
            layout=self._pipeline(name).get_bind_group_layout(0),
            entries=[{"binding": k, "resource": resource} for k, resource in enumerate(resources)],
        )
