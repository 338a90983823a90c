"""The renderer of a window: draws the terrain, or the terrain with detail if a scene asks for detail beyond the data.

A thread makes the second renderer; until it is ready the terrain itself is drawn. It has as many doublings as the GPU's
tables hold, so that it works wherever the eye goes: how many are drawn depends on pixels, as with all levels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.gpu.background import BackgroundTask
from orograph.gpu.device import Device
from orograph.memo import Memo
from orograph.progress import SILENT
from orograph.rendering.detail import detailed
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.detail import Detail
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain


class DetailRenderer:
    """Draws a terrain on a device, with or without detail.

    Args:
        make: makes the renderer of a terrain.

    Attributes:
        plain: of the terrain itself.
    """

    def __init__(self, device: Device, terrain: Terrain, make: Callable[[Terrain], Renderer]) -> None:
        self.device, self.terrain, self._make = device, terrain, make
        self.plain = self._drawn = make(terrain)
        self._fine: Renderer | None = None
        self._memo, self._aside = Memo(), BackgroundTask()
        self._detail: Detail | None = None
        self._failure: OrographError | None = None

    def draw(self, target: Any, format: str, scene: Scene, **how: Any) -> Any:
        """See ``Renderer.draw``.

        Raises:
            UsageError, ReadError: the scene's detail cannot be made.
        """
        self._fit(scene, wait=bool(how.get("wait")))
        fine = self._fine if scene.surface.detail is not None else None
        self._drawn = fine or self.plain
        if fine is not None:
            scene, _ = detailed(scene, self._memo, SILENT, self.device, fixed=True)
        return self._drawn.draw(target, format, scene, **how)

    def _fit(self, scene: Scene, *, wait: bool) -> None:
        """Request the renderer of the scene's detail, now or later."""
        wish = scene.surface.detail
        if wish != self._detail:
            self._let_go()
            self._detail, self._aside.done = wish, None
        made = self._aside.take()
        if isinstance(made, OrographError):
            self._failure = made
        elif made is not None and made[0] == wish:
            self._fine = made[1]
        elif made is not None:
            made[1].close()
        if wish is None or self._fine is not None:
            return
        if self._failure is not None:
            raise self._failure

        def make() -> Any:
            try:
                ground, _ = detailed(scene, self._memo, SILENT, self.device, fixed=True)
                return None if ground.terrain is self.terrain else (wish, self._make(ground.terrain))
            except OrographError as error:
                return error

        if wait and not self._aside.busy:
            made = make()
            if isinstance(made, OrographError):
                raise made
            self._fine = None if made is None else made[1]
        elif self._aside.wants(wish):
            self._aside.start(wish, make)

    def _let_go(self) -> None:
        if self._fine is not None:
            self._fine.close()
        self._fine = self._failure = None

    def prepare(self, format: str, scene: Scene, **how: Any) -> None:
        """See ``Renderer.prepare``."""
        self.plain.prepare(format, scene, **how)

    def depth(self) -> NDArray[np.float32]:
        """See ``Renderer.depth``."""
        return self._drawn.depth()

    @property
    def busy(self) -> bool:
        """Whether the next frame will be better."""
        return self._aside.busy or self._drawn.busy

    @property
    def resting(self) -> bool:
        """Whether the picture is as good as it gets."""
        return not self._aside.busy and self._drawn.resting

    def close(self) -> None:
        """Stop reading."""
        self._aside.close()
        self._let_go()
        self.plain.close()

    def __getattr__(self, name: str) -> Any:
        """Other attributes come from the renderer that drew last."""
        return getattr(self.__dict__["_drawn"], name)
