"""Labels of contour lines on the GPU: placed in their own thread, set for every camera, looked up by pixel.

Labels keep their places in the terrain: each frame sets those found last along their lines for its own camera, while a
thread finds which can be shown from there (``rendering.lines.labels``). The CPU sets the type
(``rendering.lines.label_type``); the sheet is uploaded when it has changed.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from orograph.gpu.background import BackgroundTask
from orograph.gpu.device import Device
from orograph.rendering.lines.label_type import NOTHING, Labels, Lettering
from orograph.rendering.lines.labels import Placer
from orograph.rendering.mesh_points import mesh_heights
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation


class Letters:
    """The labels of a terrain's contour lines.

    Attributes:
        view: of a texture, two bytes per pixel: ink and halo; None if no label is shown.
        state: changes whenever what is shown may have changed, apart from the camera.
    """

    def __init__(self, device: Device, terrain: Terrain) -> None:
        self.device = device
        self.placer = Placer(terrain)
        self.view: Any = None
        self.state: Any = None
        self._labels: Labels = NOTHING
        self._aside = BackgroundTask()
        self._wish: Any = None
        self._texture: Any = None
        self._held: tuple[Any, Any] = (None, None)

    @property
    def busy(self) -> bool:
        """Whether other labels are being found, or are due."""
        return self._wish is not None and (self._aside.busy or self._aside.done != self._wish)

    def prepare(self, scene: Scene, contours: Contours | None, *, wait: bool, mesh: Tessellation | None = None) -> bool:
        """Provide the labels of a scene's contours (``fitted``; None: no lines), on a mesh of the terrain if one is
        drawn: at once if ``wait``, else the current ones while others are found in the background. Returns whether
        there are any."""
        if contours is None or not contours.labels or contours.step <= 0:
            self._labels, self._wish, self.view, self.state = NOTHING, None, None, None
            return False
        surface, dry = scene.surface, scene.data.water is None
        key = self._wish = scene.view.whole, surface.exaggeration, surface.tolerance, contours, dry, id(mesh)
        drawn = None if mesh is None else partial(mesh_heights, mesh)
        if wait:
            if self._aside.done != key:
                self._labels = self.placer.place(scene, contours, drawn)
            self._aside.done = key
        else:
            made = self._aside.take()
            self._labels = self._labels if made is None else made
            if self._aside.wants(key):
                self._aside.start(key, lambda: self.placer.place(scene, contours, drawn))
        self.state = id(self._labels)
        self._set(scene, contours)
        return self.view is not None

    def close(self) -> None:
        self._aside.close()

    def _set(self, scene: Scene, contours: Contours) -> None:
        view = scene.view
        known = self._labels, (view, scene.surface.exaggeration, contours)
        if known[0] is self._held[0] and known[1] == self._held[1]:
            return
        self._held = known
        lettering = Lettering.of(self._labels, view, scene.surface.exaggeration, contours.type_size)
        if not lettering.words:
            self.view = None
            return
        left, top, _, _ = view.frame
        sheet = lettering.sheet((top, top + view.height, left, left + view.width))
        if self._texture is None or tuple(self._texture.size[:2]) != (view.width, view.height):
            usage = "TEXTURE_BINDING|COPY_DST"
            self._texture = self.device.texture((view.width, view.height), "rg8unorm", usage, label="labels")
            self._view = self._texture.create_view()
        self.device.queue.write_texture(
            {"texture": self._texture}, np.ascontiguousarray(sheet),
            {"bytes_per_row": 2 * view.width, "rows_per_image": view.height}, (view.width, view.height, 1),
        )  # fmt: skip
        self.view = self._view
