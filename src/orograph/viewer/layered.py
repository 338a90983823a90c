"""What is drawn over a frame of the window: standing things, and the variants of its scene (``viewer.variants``)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from orograph.gpu.device import Device
from orograph.rendering.blending import mixed
from orograph.rendering.picture import Picture
from orograph.scene.aids import interval_of
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewer.screen import Screen

if TYPE_CHECKING:
    from orograph.rendering.standing import Stood
    from orograph.viewer.drawing import Drawer
    from orograph.viewer.window import Window


class Standing:
    """Draws standing things over a picture, with its depth, as in pictures; remembers where they stand."""

    def __init__(self) -> None:
        self._placed: tuple[Any, float, Any] | None = None

    def draw(self, scene: Scene, renderer: Drawer, screen: Screen) -> Stood | None:
        """Draw them, and the grid; returns the standing things, or None."""
        things = scene.theme.things
        gridded = interval_of(scene.annotations.aids, scene.view) is not None
        if things is None and not gridded:
            return None
        from orograph.rendering.lines.ground_grid import label, lay_on_bytes
        from orograph.rendering.standing import places, stand

        pixels, depth = screen.pixels(), renderer.depth()
        if gridded:
            pixels = pixels.copy()
            lay_on_bytes(scene, pixels, depth)
        if things is None:
            screen.write(label(scene, pixels))
            return None
        stretch = scene.surface.exaggeration
        if self._placed is None or self._placed[0] is not things or self._placed[1] != stretch:
            self._placed = things, stretch, places(things, scene.terrain, stretch)
        stood = stand(things, pixels, depth, scene, self._placed[2])
        screen.write(label(scene, stood.pixels))
        return stood


class Others:
    """Draws the variants of a window's scene over its picture, each with its own renderer.

    Args:
        window: the window. make: makes a renderer on a device.
    """

    def __init__(self, window: Window, make: Callable[[Device, Terrain], Drawer]) -> None:
        self.window, self.make = window, make
        self._made: dict[int, tuple[Terrain, Drawer, Standing]] = {}
        self._screen: Screen | None = None

    def draw(self, scene: Scene, renderer: Drawer, screen: Screen, how: dict[str, Any]) -> bool:
        """Draw the variants over the picture on a screen; returns whether further frames would be the same.

        Args:
            renderer: drew the picture. how: as for ``Drawer.draw``; a frozen mesh belongs to the scene's terrain.
        """
        if not scene.variants:
            return True
        if self._screen is None or self._screen.device is not self.window.device:
            self._screen = Screen(self.window.device, screen.format)
        apart, overlay, rests = self._screen, self.window.session.settings.overlay(), True
        stretch = scene.surface.exaggeration

        def other(number: int) -> Callable[[Scene], Picture]:
            def drawn(one: Scene) -> Picture:
                nonlocal rests
                made = self._made.get(number)
                if made is None or made[0] is not one.terrain:
                    if made is not None:
                        made[1].close()
                    made = one.terrain, self.make(self.window.device, one.terrain), Standing()
                    self._made[number] = made
                _, own, standing = made
                apart.prepare(one.view.width, one.view.height)
                told = how if one.terrain is scene.terrain else {**how, "freeze": None}
                own.draw(apart.view, apart.format, one, overlay=overlay, **told)
                standing.draw(one, own, apart)
                rests = rests and own.resting
                return Picture(apart.pixels(), own.depth(), one.view, exaggeration=stretch)

            return drawn

        picture = Picture(screen.pixels(), renderer.depth(), scene.view, exaggeration=stretch)
        screen.write(mixed(scene, picture, other))
        return rests

    def close(self) -> None:
        """Release everything."""
        for _, renderer, _ in self._made.values():
            renderer.close()
        self._made, self._screen = {}, None
