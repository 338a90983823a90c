"""Focus, flight and ghosted surfaces in the window: variants of its scene, made once, drawn over every frame.

Each variant has a renderer of its own, so that its tiles and its smoothing go on from frame to frame; it takes as much
GPU memory again. Which scenario of a flight shows follows the camera's height above ground and its speed, by at most
``1 / BLENDED`` a second.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from orograph.errors import UsageError
from orograph.geovis.layers import Layer
from orograph.scene.flying import BASE, OTHERS, Flown
from orograph.scene.parts import made_of
from orograph.scene.scene import BY_PRIORITY, Scene, Variant
from orograph.store.terrain import Terrain
from orograph.viewpoint import Point, View

if TYPE_CHECKING:
    from orograph.scene.flying import Flight

BLENDED = 3.0
"""Seconds in which one scenario replaces another."""

VARIED = ("focus", "flight", "ghosts")
"""Options that make variants."""

LEAST = 1e-4
"""Of a scenario: less need not change."""

Made = tuple[tuple[Variant, ...], Flown | None]
"""Variants, and the scenario that the flight ends with, if there is one."""


class Variants:
    """The variants of a window's scene.

    Attributes:
        shares: how much shows of approach, overflight and re-planning; None: there is no flight.
        moving: whether they change by themselves.
    """

    def __init__(self) -> None:
        self.shares: tuple[float, float, float] | None = None
        self.moving = False
        self._made: tuple[Variant, ...] = ()
        self._flown: Flown | None = None
        self._eye: Point | None = None

    @staticmethod
    def made(options: Mapping[str, Any], terrain: Terrain, size: tuple[int, int]) -> Made:
        """What ``take`` takes, of a scene's options, its data being as they are given.

        Args:
            size: pixels that painted data suit.

        Raises:
            UsageError: both a flight and a focus are given. Others: as of a ``Scene``.
        """
        bare = {name: value for name, value in options.items() if name not in VARIED}
        focus, flight, ghosts = (
            made_of(name, given, terrain) if (given := options.get(name)) else None for name in VARIED
        )
        if not (focus or flight or ghosts):
            return (), None
        if focus is not None and flight is not None:
            raise UsageError("`flight` says which priority holds, and so does `focus`.", remedy="Give one.")
        low, high = terrain.height_range
        x, y = (float(v) for v in terrain.grid.xy(0.0, 0.0))
        anywhere = View((x, y, high + 1.0), (x, y, low - 1.0), width=size[0], height=size[1])
        made: list[Variant] = []
        flown = None
        if focus is not None:
            there = Scene.of(terrain, anywhere, **{**bare, "priority": focus.priority})
            made.append(Variant(there, focus.over(terrain.grid)))
        if flight is not None:
            whole: Flight = flight.over(terrain)
            for k, name in enumerate(OTHERS):
                flown = Flown(terrain, whole, k)
                made.append(Variant(Scene.of(terrain, anywhere, **{**bare, "priority": name}), flown, name))
        if ghosts:
            plain = Scene.of(terrain, anywhere, **{**bare, "data": (), "priority": None, "layers": (), "aids": None})
            made += [Scene.ghost(plain, one) for one in ghosts]
        return tuple(made), flown

    def take(self, made: Made) -> None:
        """Show these from now on; a flight goes on where it is."""
        self._made, self._flown = made
        if self._flown is None:
            self.shares, self.moving = None, False

    def over(self, scene: Scene, options: Mapping[str, Any], above: tuple[Layer, ...]) -> Scene:
        """A frame's scene with its variants.

        Args:
            options: the scene's. above: layers over all others: what a tool paints, what is not selected.
        """
        if not self._made:
            return scene
        common = {name: value for name, value in options.items() if name not in BY_PRIORITY}
        made = []
        for one in self._made:
            fitted = one.but(None, scene.view, common)
            if one.rgb is None and above:
                fitted = replace(fitted, scene=fitted.scene.but(layers=(*fitted.scene.data.layers, *above)))
            if isinstance(fitted.weight, Flown):
                fitted = replace(fitted, weight=replace(fitted.weight, told=self.shares))
            made.append(fitted)
        return replace(scene, variants=tuple(made))

    def advance(self, view: View, seconds: float) -> None:
        """Let the scenarios follow the camera, which moved for so long."""
        if self._flown is None or self._flown.flight is None:
            return
        speed = 0.0 if self._eye is None or seconds <= 0 else math.dist(view.eye, self._eye) / seconds
        self._eye = view.eye
        wanted = self._flown.flight.shares(self._flown.height(_array(view.eye)), speed)
        if self.shares is None:
            self.shares = wanted
            return
        ways = [b - a for a, b in zip(self.shares, wanted)]
        far = max(map(abs, ways))
        part = 1.0 if far <= LEAST else min(1.0, seconds / BLENDED / far)
        a, b, c = (have + part * way for have, way in zip(self.shares, ways))
        self.shares, self.moving = (a, b, c), far > LEAST

    @property
    def told(self) -> str:
        """How much shows of the scenarios, in words; "" without a flight."""
        if self.shares is None:
            return ""
        return ", ".join(f"{name} {share:.0%}" for name, share in zip((BASE, *OTHERS), self.shares) if share >= 0.005)


def _array(point: Point) -> Any:
    import numpy as np

    return np.asarray(point, np.float64)
