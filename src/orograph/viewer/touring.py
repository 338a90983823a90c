"""A tour made by hand: a sequence of cameras, interpolated by ``tour``. No GUI.

A tour is a list of *stops*, each a key frame (``touring.keys``) and the seconds from it to the next, so that stops can
be moved, removed and inserted anywhere, and times always increase. What is shown while it plays is what ``orograph
movie --tour`` films: the same ``Tour``, kept above the ground by the same ``Course``. Units: seconds and metres.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.geovis.layers import Layer
from orograph.lighting.sun import Moment, Placed
from orograph.scene.parts import HOMES, OPTIONS
from orograph.touring.course import Course
from orograph.touring.keys import Key
from orograph.touring.make import still
from orograph.touring.tour import DEFAULT_FPS, Tour
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.viewer.session import Session

LEG = 4.0
"""Default seconds from one stop to the next."""
SHORTEST = 0.1
FILMED = tuple(
    one
    for name, one in OPTIONS.items()
    if HOMES[name] in ("lighting", "data") and one.flag is not None and not one.multiple
    and name != "sun"
)  # fmt: skip
"""Options of the window that a film needs: light and ground, which the tour does not set."""
ALONG = 240
"""Places along the path drawn in the plan."""


@dataclass(slots=True)
class Stop:
    """A key frame and the seconds from leaving it to the next (in a loop, from the last to the first)."""

    key: Key
    leg: float = LEG


class Touring:
    """The tour of a window.

    Args:
        session: its camera and light make the stops.

    Attributes:
        stops: in order. chosen: the one to edit, or None.
        loop, ease, aim, fps, above_ground: as in ``Tour``; ``begin``: when the camera is at the first stop.
        time: where in the tour the window is; ``playing``: whether time passes.
        trouble: why there is no tour, or "".
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.stops: list[Stop] = []
        self.chosen: int | None = None
        self.loop, self.ease = False, True
        self.aim: Literal["target", "direction"] = "target"
        self.fps, self.begin = DEFAULT_FPS, 0.0
        self.above_ground: float | None = None
        self.time, self.playing, self.trouble = 0.0, False, ""
        self._made: tuple[object, Tour | None] = (None, None)
        self._course: tuple[Tour | None, Course | None] = (None, None)
        self._way: tuple[Tour | None, NDArray[np.float64]] = (None, np.zeros((0, 2, 3)))
        self._shown: View | None = None

    # ---- the tour ------------------------------------------------------------------------------------------------

    @property
    def times(self) -> list[float]:
        """When the camera arrives at each stop."""
        out, time = [], self.begin
        for stop in self.stops:
            out.append(time)
            time += stop.key.hold + stop.leg
        return out

    @property
    def tour(self) -> Tour | None:
        """The tour through the stops, or None; then ``trouble`` says why."""
        state = (
            tuple((s.key, s.leg) for s in self.stops), self.loop, self.ease, self.aim, self.fps, self.above_ground,
            self.begin,
        )  # fmt: skip
        if self._made[0] != state:
            self._made = state, self._make() if self.stops else None
        return self._made[1]

    def _make(self) -> Tour | None:
        keys = tuple(replace(s.key, time=t) for s, t in zip(self.stops, self.times))
        loop = self.loop and len(keys) > 1
        last = self.stops[-1]
        self.trouble = ""
        try:
            return Tour(
                keys, seconds=last.key.hold + last.leg + self.times[-1] if loop else None, fps=self.fps, loop=loop,
                ease=self.ease, aim=self.aim, above_ground=self.above_ground,
            )  # fmt: skip
        except OrographError as error:
            self.trouble = str(error)
            return None

    @property
    def duration(self) -> float:
        """Total seconds; 0 without a tour."""
        tour = self.tour
        return 0.0 if tour is None else tour.duration

    # ---- stops ---------------------------------------------------------------------------------------------------

    def add(self) -> None:
        """Add the current camera and light as a stop, after the chosen one or at the end."""
        at = len(self.stops) if self.chosen is None else self.chosen + 1
        self.stops.insert(at, Stop(self._key(self.stops[0].key if self.stops else None)))
        self.chosen = at
        self.time = self.times[at]

    def put(self, k: int) -> None:
        """Set stop ``k`` to the current camera and light."""
        old = self.stops[k].key
        others = [s.key for i, s in enumerate(self.stops) if i != k]
        new = self._key(others[0] if others else None)
        self.stops[k].key = replace(new, hold=old.hold, stop=old.stop, path=old.path, turns=old.turns)

    def remove(self, k: int) -> None:
        """Remove a stop; the path leads on to the next."""
        del self.stops[k]
        self.chosen = None if not self.stops else min(k, len(self.stops) - 1)
        self.playing = self.playing and bool(self.stops)

    def move(self, k: int, by: int) -> None:
        """Swap a stop with a neighbour; path sections keep their times."""
        to = k + by
        if not 0 <= to < len(self.stops):
            return
        self.stops[k].key, self.stops[to].key = self.stops[to].key, self.stops[k].key
        self.chosen = to

    def retime(self, k: int, time: float) -> None:
        """Move the arrival at stop ``k`` to a time; later stops shift with it."""
        if k == 0:
            self.begin = max(time, 0.0)
        else:
            before = self.stops[k - 1]
            before.leg = max(before.leg + time - self.times[k], SHORTEST)

    def change(self, k: int, **values: object) -> None:
        """Change a stop's key (``hold``, ``path``, ``turns``…); reports and ignores invalid changes."""
        try:
            self.stops[k].key = replace(self.stops[k].key, **values)  # type: ignore[arg-type]
        except OrographError as error:
            self.session.messages.say(str(error))

    def renew(self, moved: Callable[[View], View | None]) -> None:
        """Switch to a new terrain: the tour stays if all of its cameras look at it."""
        self.playing, self._course = False, (None, None)
        views = [moved(stop.key.view) for stop in self.stops]
        for stop, view in zip(self.stops, views, strict=True):
            if view is None:
                self.clear()
                return
            stop.key = replace(stop.key, view=view)

    def clear(self) -> None:
        """Begin anew."""
        self.stops, self.chosen, self.time, self.playing, self.begin = [], None, 0.0, False, 0.0

    def _key(self, other: Key | None) -> Key:
        """The current camera and light; ``other``: a key of the tour, which must agree in some respects."""
        view, settings = self.session.view, self.session.settings
        if other is not None:
            first = other.view
            view = replace(
                view.resized(first.width, first.height), near=first.near, far=first.far, projection=first.projection
            )
        light = settings.sun
        sun: Placed | Moment | None = (
            Moment(light.when) if light.mode == "moment" else Placed(light.azimuth % 360.0, light.altitude)
        )
        kinds = {type(s.key.sun) for s in self.stops if s.key.sun is not None}
        if kinds and type(sun) not in kinds and len(self.stops) > 0:
            sun = None
            self.session.messages.say("The sun of this key follows the others, which set it differently.")
        water = settings.water if isinstance(settings.water, float) else None
        # Full paths, so that the tour can be saved in another folder.
        settings.layers = [replace(layer, path=_whole(layer.path)) for layer in settings.layers]
        said = bool(settings.layers) or any(s.key.layers is not None for s in self.stops)
        return Key(
            view, sun=sun, exaggeration=settings.exaggeration, relief=settings.relief, water=water,
            layers=tuple(settings.layers) if said else None,
        )  # fmt: skip

    # ---- playing -------------------------------------------------------------------------------------------------

    def play(self) -> None:
        """Play from the current time, or from the beginning if at the end; or pause."""
        if self.playing:
            self.playing = False
            return
        if self.tour is None or self.duration == 0:
            self.session.messages.say(self.trouble or "A tour needs at least two stops: add some cameras first.")
            return
        if not self.loop and self.time >= self.duration - 1e-6:
            self.time = 0.0
        self.playing, self._shown = True, None
        self.session.messages.hush()

    def advance(self, seconds: float) -> None:
        """Advance time. If something else moves the camera, the tour pauses."""
        if not self.playing:
            return
        if self.tour is None or (self._shown is not None and not _same(self.session.view, self._shown)):
            self.playing = False
            return
        if self._shown is not None:
            self.time += seconds
        if self.time >= self.duration:
            if self.loop:
                self.time %= max(self.duration, 1e-9)
            else:
                self.time, self.playing = self.duration, False
        self.show(self.time)

    def show(self, time: float) -> None:
        """Set camera, light and scene to those at a time of the tour."""
        tour = self.tour
        if tour is None:
            return
        session, settings = self.session, self.session.settings
        self.time = time
        values = tour.settings(time)
        if abs(values.get("exaggeration", settings.exaggeration) - settings.exaggeration) > 1e-9:
            session.stretch(values["exaggeration"], hold=False)
        for name in ("relief", "tolerance", "water"):
            if name in values:
                setattr(settings, name, values[name])
        layers = tour.layers(time)
        if layers is not None:
            settings.layers = _laid(settings.layers, layers)
        sun, light = tour.sun(time), settings.sun
        if isinstance(sun, Placed):
            light.mode, light.azimuth, light.altitude = "placed", sun.azimuth, sun.altitude
        elif sun is not None and light.place is not None:
            light.mode, light.playing = "moment", False
            light.when = sun.when.astimezone(light.when.tzinfo)
        session.nav.stop()
        session.nav.view = self.at(time).resized(session.view.width, session.view.height)
        self._shown = session.view

    def at(self, time: float) -> View:
        """The camera at a time, above the ground if the tour asks for it (once that is computed).

        Raises:
            IndexError: there is no tour.
        """
        tour = self.tour
        if tour is None:
            raise IndexError("there is no tour")
        if tour.above_ground is None:
            return tour.at(time)
        if self._course[0] is not tour:
            self._course = tour, None
            self.session.probe.submit(lambda: self._lift(tour))
        course = self._course[1]
        return tour.at(time) if course is None else course.at(time)

    def _lift(self, tour: Tour) -> None:
        """Compute in a thread how far the camera must be lifted."""
        try:
            course = Course(tour, self.session.terrain)
        except (OrographError, OSError) as error:
            self.session.messages.say(f"The tour cannot be kept above the ground: {error}", error=True)
            return
        if self._course[0] is tour:
            self._course = tour, course
            self.session.changed()

    def way(self) -> NDArray[np.float64]:
        """Places of the eye and its target along the tour: (n, 2, 3); (0, 2, 3) without one."""
        tour = self.tour
        if self._way[0] is not tour or tour is None:
            views = [] if tour is None else [tour.at(t) for t in np.linspace(0.0, tour.duration, ALONG)]
            self._way = tour, np.array([(v.eye, v.target) for v in views]).reshape(-1, 2, 3)
        return self._way[1]

    # ---- files ---------------------------------------------------------------------------------------------------

    def save(self, path: Path) -> bool:
        """Write TOUR.json, as ``orograph movie --tour`` takes it; reports the outcome and returns whether it
        succeeded."""
        tour = self.tour
        if tour is None:
            self.session.messages.say(self.trouble or "There is no tour to save: add some cameras first.")
            return False
        try:
            tour.save(path)
        except OrographError as error:
            self.session.messages.say(f"The tour was not saved: {error}", error=True)
            return False
        self.session.messages.say(f"Saved {path.name} in {path.resolve().parent}.")
        return True

    def load(self, path: Path) -> bool:
        """Read a TOUR.json in place of the current tour; reports the outcome and returns whether it succeeded."""
        try:
            tour = Tour.load(path, crs=self.session.terrain.grid.crs, whole=self._whole)
        except OrographError as error:
            self.session.messages.say(f"The tour was not read: {error}", error=True)
            return False
        self.take(tour)
        speed = " Its speed was converted to times." if tour.speed is not None else ""
        self.session.messages.say(f"{path.name}: {len(tour.keys)} stops, {tour.duration:.1f} s.{speed}")
        return True

    def _whole(self, width: int, height: int) -> View:
        """The camera of a first key that has none."""
        exaggeration = self.session.settings.exaggeration
        return still(self.session.terrain, (width, height), exaggeration=exaggeration).keys[0].view

    def take(self, tour: Tour) -> None:
        """Edit a tour."""
        times = list(tour.times)
        ends = [*times[1:], tour.duration if tour.loop else times[-1] + tour.keys[-1].hold + LEG]
        self.clear()
        self.stops = [
            Stop(
                replace(key, time=None, sun=tour.sun(time) if tour.passage else key.sun),
                max(end - time - key.hold, SHORTEST),
            )
            for key, time, end in zip(tour.keys, times, ends)
        ]
        self.loop, self.ease, self.aim, self.fps = tour.loop, tour.ease, tour.aim, tour.fps
        self.above_ground, self.begin = tour.above_ground, times[0]
        self.chosen = 0

    def command(self, path: Path, paths: Sequence[str]) -> str:
        """The command line that films the tour saved at ``path``, with the terrain of ``paths`` as shown in
        the window."""
        settings = self.session.settings
        words = ["orograph", "movie", *(paths or [self.session.terrain.name]), "--tour", str(path)]
        words += ["-o", str(path.with_suffix(".mp4")), "--size", "1920x1080"]
        for one in FILMED:
            value = getattr(settings, one.name)
            if value != one.default:
                words += [f"--{'no-' * (value is False)}{one.key}", *([] if one.kind is bool else [one.text(value)])]
        return shlex.join(words)


def _whole(path: str) -> str:
    """An absolute path, if it names an existing file."""
    return str(Path(path).resolve()) if Path(path).exists() else path


def _laid(have: Sequence[Layer], shown: Sequence[Layer]) -> list[Layer]:
    """The window's layers: those that a tour shows are visible, as opaque as it says; the others are kept."""
    opacities = {_kind(layer): layer.opacity for layer in shown}
    out = [
        replace(layer, opacity=opacities.pop(kind), visible=True)
        if (kind := _kind(layer)) in opacities
        else replace(layer, visible=False)
        for layer in have
    ]
    return out + [layer for layer in shown if _kind(layer) in opacities]


def _kind(layer: Layer) -> Layer:
    return replace(layer, opacity=1.0, visible=True)


def _same(a: View, b: View) -> bool:
    """Whether two views are the same camera, whatever the size of their pictures."""
    return a.resized(b.width, b.height) == b
