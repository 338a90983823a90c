"""The settings behind the panels: light, colours, exaggeration, detail. No GUI; the result is a ``Scene``.

The sun is placed by hand, or it is the real sun at a time and the terrain's place (``lighting.sun``), and a day can be
played. Times are shown in a zone of whole hours from UTC, initially that of the place's longitude. Units: degrees,
pixels, seconds.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from orograph.errors import OrographError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.shared import Kept, sharing
from orograph.geovis.data.standing import Things
from orograph.geovis.layers import Layer
from orograph.lighting.sun import Moment, Sun, place, sun_of
from orograph.rendering.gpu.frame import Normals
from orograph.scene.flying import BASE
from orograph.scene.methods import mesh_choice
from orograph.scene.parts import OPTIONS, SHINING, check_options, made_of
from orograph.scene.scene import Scene
from orograph.scene.theming import Themed, themed
from orograph.store.terrain import Terrain
from orograph.viewer.data import ShownData
from orograph.viewer.refining import Refining
from orograph.viewer.variants import Made, Variants
from orograph.viewpoint import View

DEFAULT_TOLERANCE = 1.0
DAY = 86_400.0
HAZE = 1.5
PAINTED = (1920, 1080)
"""Size of a window for which data are painted, pixels."""
PLAYED = (640, 360)
"""The same while time passes and data are painted repeatedly."""
THEMED = ("layers", "data", "priority")
"""Options that make up a theme."""
PLAY = 3600.0
"""Speed of a played day: seconds of the sun's time per second."""


@dataclass(slots=True)
class SunSetting:
    """Where the light comes from.

    Attributes:
        mode: "placed" (azimuth, altitude) or "moment" (when).
        azimuth, altitude: degrees, from grid north.
        when: a time in ``zone``.
        playing: whether time passes; ``speed``: seconds per second.
        place: (longitude, latitude) of the terrain's middle; None if only placed suns make sense.
        trouble: why there is no place.
    """

    mode: Literal["placed", "moment"] = "placed"
    azimuth: float = 315.0
    altitude: float = 45.0
    when: datetime.datetime = field(default_factory=lambda: datetime.datetime.now(datetime.UTC))
    playing: bool = False
    speed: float = PLAY
    place: tuple[float, float] | None = None
    trouble: str = ""

    @classmethod
    def over(cls, terrain: Terrain, given: Any = None) -> SunSetting:
        """The light for a terrain; ``given``: a sun as ``sun_of`` takes it."""
        light = cls()
        try:
            light.place = place(terrain.grid)
            light.zone = round(light.place[0] / 15.0)
            light.when = light.when.replace(hour=12, minute=0, second=0, microsecond=0)
        except OrographError as error:
            light.trouble = str(error)
        if isinstance(given, Moment):
            if light.place is None:
                raise UsageError(light.trouble)
            light.mode, light.when = "moment", given.when
        elif given is not None:
            sun = sun_of(given, terrain.grid)
            light.azimuth, light.altitude = sun.azimuth % 360.0, sun.altitude
        return light

    @property
    def zone(self) -> float:
        """Hours that ``when`` is ahead of UTC."""
        offset = self.when.utcoffset()
        return 0.0 if offset is None else offset.total_seconds() / 3600.0

    @zone.setter
    def zone(self, hours: float) -> None:
        self.when = self.when.astimezone(datetime.timezone(datetime.timedelta(hours=hours)))

    @property
    def hour(self) -> float:
        """Hours since midnight, in the zone."""
        w = self.when
        return w.hour + w.minute / 60.0 + w.second / 3600.0

    @hour.setter
    def hour(self, hours: float) -> None:
        minutes = min(max(round(hours * 60.0), 0), 24 * 60 - 1)
        self.when = self.when.replace(hour=minutes // 60, minute=minutes % 60, second=0, microsecond=0)

    @property
    def day(self) -> int:
        """Day of the year, from 1."""
        return self.when.timetuple().tm_yday

    @day.setter
    def day(self, number: int) -> None:
        first = self.when.replace(month=1, day=1)
        last = (first.replace(year=first.year + 1) - first).days
        self.when = first + datetime.timedelta(days=min(max(number, 1), last) - 1)

    def advance(self, seconds: float) -> bool:
        """Advance time; returns whether the light moved. A played day starts again at its end."""
        if not (self.playing and self.mode == "moment"):
            return False
        begin = self.when.replace(hour=0, minute=0, second=0, microsecond=0)
        gone = (self.when - begin).total_seconds() + seconds * self.speed
        self.when = begin + datetime.timedelta(seconds=math.fmod(gone, DAY))
        return True

    def sun(self, terrain: Terrain) -> Sun:
        """The sun over the terrain."""
        if self.mode == "moment" and self.place is not None:
            return Moment(self.when).over(terrain.grid)
        return Sun(self.azimuth, self.altitude)


def _carried_out(options: dict[str, Any], terrain: Terrain, size: tuple[int, int]) -> tuple[Themed, Made]:
    """A theme applied, and the variants, for a window of ``size`` pixels."""
    with sharing():
        return themed(options, terrain, size), Variants.made(options, terrain, size)


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
        finer: data that a thread paints finely; ``finish`` takes them.
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
        self.finer: Refining[tuple[Themed, Made]] = Refining()
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
            finer: paint data coarsely at once, and finely in a thread, which calls this when ``finish`` is due. None:
                painting is complete when this returns.

        Raises:
            UsageError: there is no such time. Others: as ``scene.theming.themed``; nothing changes.
        """
        shown = self.shown
        if shown is None:
            self.variants.take(Variants.made(self.options, terrain, PAINTED))
            return
        if self.flight is not None and priority is not None:
            raise UsageError("A flight sets the priority.", remedy="Open the window without it.")
        before = shown.priority, shown.time
        try:
            shown.priority = priority or shown.priority
            shown.choose(shown.time if time is None else time)
            own = {layer.path: k for k, layer in enumerate(self._own)}
            held = {own[one.path]: (at, one) for at, one in enumerate(self.layers) if one.path in own}
            base = dict(self.options)
            base["layers"] = [one for one in self.layers if one.path not in own]
            for name, (old, new) in self._replaced.items():
                if base[name] is new:
                    base[name] = old
            coarse = shown.changing or finer is not None
            with sharing(self.kept):
                now = {"layers": tuple(base["layers"]), "data": shown.current(terrain), "priority": shown.priority}
                given = base | now
                theme, variants = _carried_out(given, terrain, PLAYED if coarse else PAINTED)
        except Exception:
            shown.priority, shown.time = before
            raise
        stack: list[Layer] = base["layers"]
        self._own = theme.options["layers"][len(stack) :]
        for k, layer in enumerate(self._own):
            at, old = held.get(k, (len(stack), None))
            if old is not None:
                layer = _as_set(layer, old)
            stack.insert(at, layer)
        changed = {name: value for name, value in theme.options.items() if name in base and name not in THEMED}
        self._replaced = {name: (base[name], new) for name, new in changed.items() if new is not base[name]}
        shown.painted, shown.things = theme.painted, theme.things
        self.variants.take(variants)
        self.options = {**base, **changed, "layers": stack}
        if finer is not None and coarse and not shown.changing:

            def fine() -> tuple[Themed, Made]:
                with sharing(self.kept):
                    return _carried_out(given, terrain, PAINTED)

            self.finer.wish(fine, finer)
        else:
            self.finer.drop()

    def finish(self) -> bool:
        """Take what a thread has painted finely, if it is ready and still current; returns whether it was. Layers keep
        their place in the stack and their current settings.

        Raises:
            As ``show``; the coarse picture stays.
        """
        shown = self.shown
        if shown is None or shown.changing:
            self.finer.drop()
        made = self.finer.take()
        if made is None or shown is None:
            return False
        theme, variants = made
        fine = theme.options["layers"][-len(self._own) :] if self._own else ()
        new = {old.path: layer for old, layer in zip(self._own, fine, strict=True)}
        self._own = fine
        stack = (_as_set(new[one.path], one) if one.path in new else one for one in self.layers)
        self.options["layers"] = list(stack)
        shown.painted, shown.things = theme.painted, theme.things
        self.variants.take(variants)
        return True

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
