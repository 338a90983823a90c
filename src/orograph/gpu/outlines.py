"""Silhouettes on the GPU: a pass between geometry and light finds where ground breaks off (``shaders/breaks.wgsl``).

The shading pass draws the lines (``shaders/lines.wgsl``), as ``picture.silhouettes`` does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph.gpu.device import Device
from orograph.gpu.passes import Targets

BREAKS = "rgba16float"


class BreakPass:
    """Finds breaks in the targets' depth.

    Args:
        camera: the uniform buffer (``camera.CAMERA``).
    """

    def __init__(self, device: Device, camera: Any) -> None:
        self.device, self.camera = device, camera
        self.range = device.buffer(16, "UNIFORM", "depths in view")
        self._pipeline: Any = None
        self._of: tuple[Targets | None, Any, Any] = (None, None, None)

    def view(self, targets: Targets) -> Any:
        """The view of the breaks of these targets."""
        if self._of[0] is not targets:
            usage = "RENDER_ATTACHMENT|TEXTURE_BINDING"
            texture = self.device.texture((targets.width, targets.height), BREAKS, usage, label="breaks")
            self._of = targets, texture.create_view(), self._group(targets)
        return self._of[1]

    def aim(self, depths: tuple[float, float]) -> None:
        """Say which depths are in view, metres."""
        self.device.queue.write_buffer(self.range, 0, np.array([*depths, 0, 0], np.float32))

    def draw(self, encoder: Any, targets: Targets) -> None:
        """Find the breaks of what the targets hold."""
        view = self.view(targets)
        pass_ = encoder.begin_render_pass(
            color_attachments=[{"view": view, "clear_value": (0, 0, 0, 0), "load_op": "clear", "store_op": "store"}]
        )
        pass_.set_pipeline(self._made())
        pass_.set_bind_group(0, self._of[2])
        pass_.draw(3)
        pass_.end()

    def _made(self) -> Any:
        if self._pipeline is None:
            module = self.device.shader("breaks")
            self._pipeline = self.device.handle.create_render_pipeline(
                label="breaks",
                layout="auto",
                vertex={"module": module, "entry_point": "vertex"},
                primitive={"topology": "triangle-list"},
                fragment={"module": module, "entry_point": "fragment", "targets": [{"format": BREAKS}]},
            )
        return self._pipeline

    def _group(self, targets: Targets) -> Any:
        return self.device.handle.create_bind_group(
            layout=self._made().get_bind_group_layout(0),
            entries=[
                {"binding": 0, "resource": {"buffer": self.camera}},
                {"binding": 1, "resource": targets.depth_view},
                {"binding": 2, "resource": {"buffer": self.range}},
            ],
        )
