"""The settings behind the panels: light, colours, exaggeration, detail. No GUI; the result is a ``Scene``.

Data are read and painted by a thread, and replace those before when they are painted. Units: degrees, pixels, seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.shared import Kept, sharing
from orograph.geovis.data.standing import Things
from orograph.geovis.layers import Layer
from orograph.rendering.gpu.frame import Normals
from orograph.scene.flying import BASE
from orograph.scene.methods import mesh_choice
from orograph.scene.parts import OPTIONS, SHINING, check_options, made_of
from orograph.scene.scene import Scene
from orograph.scene.theming import Themed, themed
from orograph.store.terrain import Terrain
from orograph.viewer.data import ShownData
from orograph.viewer.refining import Refining
from orograph.viewer.sun_setting import SunSetting
from orograph.viewer.variants import Made, Variants
from orograph.viewpoint import View

DEFAULT_TOLERANCE = 1.0
HAZE = 1.5
PAINTED = (1920, 1080)
"""Size of a window for which data are painted, pixels."""
PLAYED = (640, 360)
"""The same while time passes and data are painted repeatedly."""
THEMED = ("layers", "data", "priority")
"""Options that make up a theme."""


def _carried_out(options: dict[str, Any], terrain: Terrain, size: tuple[int, int]) -> tuple[Themed, Made]:
    """A theme applied, and the variants, for a window of ``size`` pixels."""
    with sharing():
        return themed(options, terrain, size), Variants.made(options, terrain, size)


@dataclass(frozen=True, slots=True)
class Painting:
    """Data painted over a terrain: of which options, and the theme and the variants that they make."""

    given: dict[str, Any]
    terrain: Terrain
    theme: Themed
    variants: Made


def _as_set(layer: Layer, old: Layer) -> Layer:
    """A layer with the visible settings of another."""
    return replace(layer, opacity=old.opacity, visible=old.visible, blend=old.blend, held=layer.held)


class Settings:
    """All settings of the picture: a scene's options by name (``scene.parts``), and the window's own.

    Args:
        terrain: the terrain.
        options: as for ``Scene.of``; ``tolerance`` and ``sky`` have the window's defaults.

    Attributes:
        sun: see ``SunSetting``. layers: a list. lamps, discs: shine if ``light`` supports them.
        painted: a layer above all others while a tool shows its result, or None. veil: over what is not selected, or
            None. seen: gives what stands, as it should appear; None: as it is.
        wireframe, levels, normals: as in ``rendering.gpu.frame.Overlay``. occlusion: strength of screen-space ambient
            occlusion.
        budget: triangles to aim for instead of a tolerance, or None.
        method: as in ``Scene``; "auto": patches, the window's own.
        shown: data, their priorities and times; None: there are none.
        variants: focus, flight and ghosted surfaces, drawn over the scene.
        finer: data that a thread paints; ``finish`` takes them.
        kept: what was read of data, for the next time or priority.
        frozen: the view for which the mesh is made while the camera flies around it, or None.
        panels: whether panels are shown at all; ``furniture``: north arrow, scale bar and colour bar.

    Raises:
        UsageError: there is no such option, or its value makes no sense.
    """

    def __init__(self, terrain: Terrain, **options: Any) -> None:
        self.sun = SunSetting.over(terrain, options.pop("sun", None))
        self.painted: Layer | None = None
        self.veil: Layer | None = None
        self.seen: Callable[[], Things | None] | None = None
        self.budget: int | None = None
        self.wireframe = self.levels = False
        self.occlusion = 0.0
        self.normals: Normals = "computed"
        self.frozen: View | None = None
        self.shown: ShownData | None = None
        self.variants = Variants()
        self.kept = Kept()
        self._own: tuple[Layer, ...] = ()
        self._replaced: dict[str, tuple[Any, Any]] = {}
        self.finer: Refining[Painting] = Refining()
        self._then: Callable[[], None] = lambda: None
        self._again = False
        self.panels = self.furniture = True
        own = {"sun", *vars(self)}
        self.options: dict[str, Any] = {name: one.default for name, one in OPTIONS.items() if name not in own}
        self.options |= {"tolerance": DEFAULT_TOLERANCE, "sky": True}
        check_options(options)
        for name, value in options.items():
            setattr(self, name, made_of(name, value, terrain))
        self.options["layers"] = list(self.options["layers"])
        data, first = self.options["data"], self.options["priority"]
        self.options |= {"data": (), "priority": None}
        if self.flight is not None:
            if first is not None:
                raise UsageError("`flight` and `priority` both set the priority: give one of them.", remedy="Give one.")
            first = Priority.parse(BASE)
        if data or first is not None or (self.aids is not None and self.aids.walls):
            with sharing(self.kept):
                self.shown = ShownData(data, first or Priority(data=True), terrain.grid)
            self.show(terrain)
        else:
            self.variants.take(Variants.made(self.options, terrain, PAINTED))
        if options.get("normals") == "auto":
            self.normals = "computed"

    def show(
        self,
        terrain: Terrain,
        priority: Priority | None = None,
        time: str | None = None,
        finer: Callable[[], None] | None = None,
    ) -> None:
        """Apply the theme: data become layers and standing things. Options that only an earlier priority set return to
        their former values; the data's layers keep their opacity, place and visibility.

        Args:
            priority, time: the new ones; None: unchanged.
            finer: a thread reads and paints the data, coarsely and then finely, and calls this whenever ``finish`` is
                due; until then everything stays as it is. None: painting is complete when this returns.

        Raises:
            UsageError: there is no such time. Others: as ``scene.theming.themed`` (with ``finer`` from ``finish``);
                nothing changes.
        """
        shown = self.shown
        if shown is None:
            self.variants.take(Variants.made(self.options, terrain, PAINTED))
            return
        if self.flight is not None and priority is not None:
            raise UsageError("A flight sets the priority.", remedy="Open the window without it.")
        shown.choose(shown.time if time is None else time)
        shown.priority = priority or shown.priority
        base = self._base()

        def paint(size: tuple[int, int]) -> Painting:
            with sharing(self.kept):
                given = {**base, "data": shown.current(terrain), "priority": shown.priority}
                return Painting(given, terrain, *_carried_out(given, terrain, size))

        self.finer.drop()
        if finer is not None:
            self._then, self._again = finer, False
            self.finer.wish(lambda: paint(PLAYED), finer)
            return
        try:
            made = paint(PLAYED if shown.changing else PAINTED)
        except Exception:
            shown.revert()
            raise
        self._put(made)

    def finish(self) -> bool:
        """Take what a thread has painted, if it is ready and still current; returns whether it was. Layers keep their
        place in the stack and their current settings.

        Raises:
            As ``show``; the picture stays.
        """
        shown = self.shown
        if shown is None or (shown.changing and self._again):
            self.finer.drop()
        try:
            made = self.finer.take()
        except Exception:
            if shown is not None:
                shown.revert()
            raise
        if made is None or shown is None:
            return False
        self._put(made, self._again)
        if not self._again and not shown.changing:
            given, terrain = made.given, made.terrain

            def fine() -> Painting:
                with sharing(self.kept):
                    return Painting(given, terrain, *_carried_out(given, terrain, PAINTED))

            self._again = True
            self.finer.wish(fine, self._then)
        return True

    @property
    def painting(self) -> bool:
        """Whether other data are chosen than are shown: the thread has not painted them yet."""
        return self.finer.coming and not self._again

    def _base(self) -> dict[str, Any]:
        """The options without what a priority has set and without the data's layers."""
        base, own = dict(self.options), {layer.path for layer in self._own}
        base["layers"] = tuple(one for one in self.layers if one.path not in own)
        for name, (old, new) in self._replaced.items():
            if base[name] is new:
                base[name] = old
        return base

    def _put(self, made: Painting, again: bool = False) -> None:
        """Show what was painted.

        Args:
            again: it is the same as before, painted finely: only layers change.
        """
        assert self.shown is not None
        layers = made.theme.options["layers"][len(made.given["layers"]) :]
        number = {layer.path: k for k, layer in enumerate(self._own)}
        held = {number[one.path]: one for one in self.layers if one.path in number}
        stack = [
            one if one.path not in number else _as_set(layers[number[one.path]], one)
            for one in self.layers
            if one.path not in number or number[one.path] < len(layers)
        ]
        base = self.options
        if not again:
            stack += [layer for k, layer in enumerate(layers) if k not in held]
            base, theme = self._base(), made.theme.options
            changed = {
                name: theme[name] for name, given in made.given.items()
                if name not in THEMED and theme[name] is not given and base[name] is given
            }  # fmt: skip
            self._replaced = {name: (base[name], new) for name, new in changed.items()}
            base = {**base, **changed}
        self._own, self.options = layers, {**base, "layers": stack}
        self.shown.painted, self.shown.things = made.theme.painted, made.theme.things
        self.shown.settle()
        self.variants.take(made.variants)

    def __getattr__(self, name: str) -> Any:
        if name == "options" or name not in self.options:
            raise AttributeError(f"There is no setting {name!r}.")
        return self.options[name]

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__.get("options", ()):
            self.options[name] = value
        else:
            super().__setattr__(name, value)

    def scene(self, terrain: Terrain, view: View) -> Scene:
        """The scene with these settings.

        Haze begins at a distance equal to the eye's height and grows over ``HAZE`` diagonals of the terrain: it changes
        smoothly during a flight, and is thin from high above and dense along the ground.
        """
        west, south, east, north = terrain.grid.bounds()
        low, high = terrain.height_range
        near = max(view.eye[2] - (low + high) / 2, 0.0) * self.exaggeration if math.isfinite(low) else 0.0
        depths = (near, near + HAZE * math.hypot(east - west, north - south))
        lines = self.contours and replace(self.contours, fading=True)
        changed = {"sun": self.sun.sun(terrain), "layers": self.stack, "contours": lines, "depths": depths}
        if self.light not in SHINING:
            changed |= {"lamps": (), "discs": ()}
        if self.shown is not None and self.aids is not None:
            changed["aids"] = replace(self.aids, walls=False)  # they are part of the things already
        options = {**self.options, **changed, "focus": None, "flight": None, "ghosts": ()}
        scene = Scene.of(terrain, view, **options)
        things = None if self.shown is None else self.seen() if self.seen is not None else self.shown.things
        if things is not None:
            scene = replace(scene, theme=replace(scene.theme, things=things))
        return self.variants.over(scene, options, self.stack[len(self.layers) :])

    def renew(self, terrain: Terrain, before: Grid) -> list[str]:
        """Adapt to a new terrain; returns the settings over the grid ``before`` that do not carry over."""
        there = SunSetting.over(terrain)
        self.sun.place, self.sun.trouble = there.place, there.trouble
        if self.sun.place is None and self.sun.mode == "moment":
            self.sun.mode, self.sun.playing = "placed", False
        self.frozen = self.painted = self.veil = None
        self.show(terrain)
        if self.options["lamps"] and before.crs != terrain.grid.crs:
            self.options["lamps"] = ()
            return ["lamps, which stood at places of another CRS"]
        return []

    @property
    def leveled(self) -> bool:
        """Whether the drawing has levels: streamed patches, or windows of rays."""
        choice = mesh_choice(self.method, "gpu")
        return choice is None or choice.info.kind == "rays"

    @property
    def stack(self) -> tuple[Layer, ...]:
        """All layers, bottom to top."""
        return (*self.layers, *(one for one in (self.veil, self.painted) if one is not None))

    def overlay(self) -> Any:
        """What else the renderer shows (``rendering.gpu.frame.Overlay``)."""
        from orograph.rendering.gpu.frame import Overlay

        return Overlay(
            self.wireframe, self.levels and self.leveled, occlusion=self.occlusion, normals=self.normals,
        )  # fmt: skip

    def balance(self, triangles: int) -> bool:
        """With a budget: move the tolerance towards that of a mesh with as many triangles; returns whether it moved.

        The number of triangles grows about as 1 / tolerance; a step goes most of the way, and within 5 % nothing
        changes.
        """
        if self.budget is None or triangles <= 0 or self.frozen is not None:
            return False
        ratio = triangles / self.budget
        if 0.9 <= ratio <= 1.05:
            return False
        wanted = min(max(self.tolerance * ratio**0.8, 0.05), 100.0)
        moved: bool = abs(wanted - self.tolerance) > 1e-3 * self.tolerance
        self.options["tolerance"] = wanted
        return moved
