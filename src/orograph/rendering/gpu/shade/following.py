"""Maps of light, and membranes over holes, that follow the camera: made at once for pictures, or in their own thread
for frames that must not wait; old ones are used until new ones are ready.

The first maps of a window are quick ones: water, and coarse shadows under an open sky, in a tenth of the time. Until
they are ready, level ground that may be water is hatched, and so are the holes that the coarsest level shows. When the
camera comes to rest, maps are made for what it sees; while it keeps moving they are renewed occasionally, so rarely
that the thread leaves three quarters of the time to others.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.background import BackgroundTask
from orograph.memo import Memo
from orograph.rendering.gpu.shade.light_maps import LightMaps, light_maps, plain_maps, quick_maps, whole
from orograph.rendering.gpu.shade.visible import about
from orograph.rendering.gpu.surface.void_fill import EXACT, VoidFillPass, coarse_void_fills, void_fills
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]

SETTLED = 0.25
"""Seconds that the camera must rest before maps of light are made for its place."""
RENEWED = 1.0
"""Minimum seconds between maps for a camera that never rests."""
SHARE = 4.0
"""Maps are used at least this many times as long as they took to make."""
QUICK = "quick"
"""Replaces the camera's place in the key of temporary maps, which serve until there are others."""
DETAIL = 1.5
"""Maximum pixels per sample of the sun's finest window; for quick maps: ``COARSE``."""
COARSE = 12.0


def maps_key(scene: Scene) -> tuple[Any, ...]:
    """The properties of a scene that the maps of light depend on, besides the camera."""
    return (
        scene.lighting.sun,
        scene.lighting.shadows,
        scene.surface.exaggeration,
        scene.data.water,
        scene.lighting.light,
    )


Upload = Callable[[NDArray[Any]], None]

KINDS = 5
"""Number of parts of a key from ``maps_key``; the rest say where the camera is."""


class Following:
    """The maps for the camera's place.

    Args:
        memo: results of earlier maps. void_fill: takes the membranes. legs: segments of a patch's leg.
        upload: uploads the pool of background maps, in their thread, since frames have no time for so many bytes.

    Attributes:
        maps: the current maps; None before the first frame. range: of the depths in view, metres.
    """

    def __init__(
        self, terrain: Terrain, memo: Memo, void_fill: VoidFillPass, legs: int, upload: Upload = lambda _: None
    ) -> None:
        self.terrain, self.memo, self.void_fill, self.legs, self.upload = terrain, memo, void_fill, legs, upload
        self.maps: LightMaps | None = None
        self.range = (1.0, 1e5)
        self._aside = BackgroundTask()
        self._own = Memo()
        """What the thread keeps for the next maps; ``memo`` would make frames wait while it computes."""
        self._begun = self._taken = self._took = 0.0
        self._wish: Any = None
        self._due_now: tuple[Any, Callable[[], Any]] | None = None
        self._last_view: View | None = None
        self._moved = 0.0

    @property
    def busy(self) -> bool:
        """Whether better maps are being made, or are due."""
        return self._aside.busy or self._aside.done != self._wish

    def at_once(self, scene: Scene, seen: Callable[[], tuple[Array, tuple[float, float] | None]]) -> None:
        """Make maps for the scene; ``seen`` returns the ground in view like ``seen.about``."""
        points, found = seen()
        self.range = found or self.range
        self.maps = light_maps(scene, points if found else whole(self.terrain), self.memo)
        self.void_fill.load(*self._void_fills(scene, self.memo))
        self._wish = self._key(scene)
        self._aside.done = (*self._wish[:KINDS], QUICK) if self.maps.by_rays else self._wish

    def begin(self) -> LightMaps:
        """The current maps: those of an open sky, and coarse membranes, until there are others."""
        if self.maps is None:
            self.maps = plain_maps()
            if self.terrain.valid_fraction < 1:
                self.void_fill.load(*coarse_void_fills(self.terrain))
        return self.maps

    def aside(self, scene: Scene, instances: NDArray[Any]) -> None:
        """Take over maps that are ready; if the scene needs others, ``go_on`` starts them."""
        now, self._due_now = time.monotonic(), None
        done = self._aside.take()
        if done is not None:
            self.maps, self.range, void_fill = done
            self._taken, self._took = now, now - self._begun
            if void_fill is not None:
                self.void_fill.load(*void_fill)
        self.begin()
        if self._last_view is None:
            self.range = self._about(scene, instances)[1]
        key = self._wish = self._key(scene)
        if scene.view != self._last_view:
            self._last_view, self._moved = scene.view, now
        if not self._due(key, now) or not self._aside.wants(key):
            return
        instances = instances.copy()  # those of the next frame replace them
        quick = self._aside.done is None

        def make() -> tuple[LightMaps, tuple[float, float], Any]:
            points, visible = self._about(scene, instances)
            if quick:
                return self._uploaded(quick_maps(scene, points, self._own, detail=COARSE)), visible, None
            maps = self._uploaded(light_maps(scene, points, self._own, detail=DETAIL))
            return maps, visible, self._void_fills(scene, self._own)

        self._due_now = (*key[:KINDS], QUICK) if quick else key, make

    def go_on(self) -> None:
        """Start the work that ``aside`` found due: after a frame was submitted, since it would slow down the frame's
        Python."""
        if self._due_now is not None:
            begin, self._due_now = self._due_now, None
            self._begun = time.monotonic()
            self._aside.start(*begin)

    def _due(self, key: tuple[Any, ...], now: float) -> bool:
        """Whether maps are due: after a change of the sun, for the first maps, and after quick ones there is no
        waiting."""
        done = self._aside.done
        if done is None or done[:KINDS] != key[:KINDS] or done[KINDS] == QUICK:
            return True
        return now - self._moved > SETTLED or now - self._taken > max(RENEWED, SHARE * self._took)

    def close(self) -> None:
        self._aside.close()

    def _uploaded(self, maps: LightMaps) -> LightMaps:
        self.upload(maps.pool)
        return maps

    def _about(self, scene: Scene, instances: NDArray[Any]) -> tuple[Array, tuple[float, float]]:
        if not len(instances):
            return whole(self.terrain), self.range
        points, found = about(self.terrain, scene.view, scene.surface.exaggeration, instances, self.legs)
        return points, found or self.range

    def _void_fills(self, scene: Scene, memo: Memo) -> tuple[NDArray[Any], NDArray[np.uint32]]:
        """Patches over the holes in view."""
        view, terrain, tolerance = scene.view, self.terrain, scene.surface.tolerance or 1.0
        known = (
            ()
            if terrain.grid.shape[0] * terrain.grid.shape[1] <= EXACT
            else (view, scene.surface.exaggeration, tolerance)
        )
        return memo(
            "void fills", known, lambda: void_fills(terrain, view, scene.surface.exaggeration, tolerance), terrain
        )

    def _key(self, scene: Scene) -> Any:
        view = scene.view
        step = 0.15 * max(view.distance, 1.0)
        return (*maps_key(scene), *(math.floor(v / step) for v in (*view.eye, *view.target)))
