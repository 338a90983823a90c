"""Focus, flight and ghosted surfaces in the window: variants of its scene, made once, drawn over every frame.

Each variant has its own renderer, which keeps tiles and smoothing from frame to frame and takes as much GPU memory
again. The visible scenario of a flight follows the camera's height above ground and its speed, changing by at most ``1
/ BLENDED`` per second.
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
"""Seconds to blend from one scenario to another."""

VARIED = ("focus", "flight", "ghosts")
"""Options that make variants."""

LEAST = 1e-4
"""Smaller changes of a scenario's weight are ignored."""

Made = tuple[tuple[Variant, ...], Flown | None]
"""Variants, and the scenario that the flight ends with, if there is one."""


class Variants:
    """The variants of a window's scene.

    Attributes:
        shares: weights of approach, overflight and re-planning; None: there is no flight.
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
        """The argument for ``take`` from a scene's options, with its data as given.

        Args:
            size: pixels, for painted data.

        Raises:
            UsageError: both a flight and a focus are given. Others: as for a ``Scene``.
        """
        bare = {name: value for name, value in options.items() if name not in VARIED}
        focus, flight, ghosts = (
            made_of(name, given, terrain) if (given := options.get(name)) else None for name in VARIED
        )
        if not (focus or flight or ghosts):
            return (), None
        if focus is not None and flight is not None:
            raise UsageError("`flight` and `focus` both set the priority: give one of them.", remedy="Give one.")
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
        """Show these variants from now on; a flight continues where it is."""
        self._made, self._flown = made
        if self._flown is None:
            self.shares, self.moving = None, False

    def over(self, scene: Scene, options: Mapping[str, Any], above: tuple[Layer, ...]) -> Scene:
        """A frame's scene with its variants.

        Args:
            options: the scene's. above: layers over all others: a tool's painting, the veil over what is not selected.
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
                fitted = replace(fitted, weight=replace(fitted.weight, filmed=self.shares))
            made.append(fitted)
        return replace(scene, variants=tuple(made))

    def advance(self, view: View, seconds: float) -> None:
        """Let the scenarios follow the camera after ``seconds`` of motion."""
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
    def shares_text(self) -> str:
        """The weights of the scenarios as text; "" without a flight."""
        if self.shares is None:
            return ""
        return ", ".join(f"{name} {share:.0%}" for name, share in zip((BASE, *OTHERS), self.shares) if share >= 0.005)


def _array(point: Point) -> Any:
    import numpy as np

    return np.asarray(point, np.float64)
