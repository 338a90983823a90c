"""``Tour``: key frames, and the camera, the light and the scene's numbers at every moment between them; a JSON file.

    {"fps": 30, "loop": false, "ease": true, "aim": "target", "keys": [
       {"time": 0, "eye": [E, N, height], "target": [E, N, height], "sun": "2026-06-21T06:00+02:00"},
       {"time": 8, "target": […], "azimuth": 225, "pitch": 20, "distance": 4000, "exaggeration": 1.5, "hold": 2}, …]}

A tour is made of *ways* (``ways``): neighbouring keys that are joined in the same manner. Where the manner changes, at
keys that ``hold`` or ``stop``, and at both ends unless ``ease`` is off, the camera comes to rest; everywhere else
position, direction and field of view have continuous velocities. It passes every key exactly, in time. With ``speed``
the keys have no times: the eye moves at that many metres a second, with ramps of ``RAMP`` seconds.
With ``loop`` the last key leads smoothly to the first again, at ``seconds``.

Layers have the opacity that a key gives, and fade in between (``layers``). Numbers of the scene change as monotonic
cubics through the keys that give them; a sun given by moments changes by its moment, so shadows move as they did that
day. A flight's file (``flight``) can be read as a tour's.

Units: seconds; metres and degrees as in ``View``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, Self

from orograph._named import named
from orograph.documents import load_object, naming, number, write
from orograph.errors import UsageError
from orograph.flight import SAME, Flight
from orograph.geovis.layers import Layer, found_beside
from orograph.lighting.sun import Moment, Passage, Placed, passage
from orograph.splines import Monotone
from orograph.touring.keys import INHERITED, SETTINGS, Key, has_camera, staying
from orograph.touring.schedule import Schedule
from orograph.touring.ways import Way
from orograph.viewpoint import View

DEFAULT_FPS = 30.0
MOST_FRAMES = 1_000_000
FORMAT = 1
"""The version of the file's format; ``"tour": 1`` in the file gives it, and may be omitted."""

SIZE = (("width", 1280), ("height", 720))
"""Default size of a tour's frames, pixels."""

OWN = ("tour", "fps", "seconds", "loop", "ease", "aim", "speed", "above_ground", "keys")


@named("A tour")
@dataclass(frozen=True, slots=True)
class Tour:
    """A camera's path through key frames (see the module).

    Attributes:
        keys: the key frames.
        seconds: its duration; None: up to the last key and its hold or, with a speed, as long as that needs.
        fps: frames per second.
        loop: whether the last key leads to the first again.
        ease: it begins and ends at rest (never in a loop).
        aim: what is interpolated: the "target", so that the target stays in view, or the "direction" of view.
        speed: metres per second of the eye; None: the keys have times.
        passage: of the sun from beginning to end, evenly in time, instead of the keys' suns; None: the keys' suns.
        above_ground: metres that the eye stays above the ground, where a terrain is given (``course``); None: wherever
            the path leads.

    Raises:
        UsageError: there is no key, times do not increase or are missing, views differ in what must be the same, …; of
            a key, its number (from 0) is named.
    """

    keys: tuple[Key, ...]
    seconds: float | None = None
    fps: float = DEFAULT_FPS
    loop: bool = False
    ease: bool = True
    aim: Literal["target", "direction"] = "target"
    speed: float | None = None
    above_ground: float | None = None
    passage: Passage | None = None
    _schedule: Schedule = field(init=False, repr=False, compare=False)
    _settings: dict[str, Monotone] = field(init=False, repr=False, compare=False)
    _sun: tuple[type | None, tuple[Monotone, ...]] = field(init=False, repr=False, compare=False)
    _layers: tuple[tuple[Layer, Monotone], ...] | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._check()
        schedule = Schedule.of(self.keys, self.seconds, self.loop, self.ease, self.aim, self.speed)
        if schedule.seconds * self.fps > MOST_FRAMES:
            raise UsageError(
                f"{schedule.seconds:g} s at {self.fps:g} frames per second are more than a million frames."
            )
        # How to set slots of a frozen dataclass.
        object.__setattr__(self, "_schedule", schedule)
        if self.speed is None:
            object.__setattr__(self, "seconds", schedule.seconds)
        channels = {}
        for name in SETTINGS:
            values = [getattr(key, name) for key in self.keys]
            if any(v is not None for v in values):
                channels[name] = self._channel(values)
        object.__setattr__(self, "_settings", channels)
        object.__setattr__(self, "_sun", self._suns())
        object.__setattr__(self, "_layers", self._stack())

    def _check(self) -> None:
        if not self.keys:
            raise UsageError("A tour needs at least one key.")
        if not 0 < self.fps < math.inf:
            raise UsageError(f'"fps" must be the number of frames per second, more than 0, not {self.fps:g}.')
        if self.aim not in ("target", "direction"):
            raise UsageError(f'"aim" must be "target" or "direction", not {self.aim!r}.')
        if self.speed is not None and not 0 < self.speed < math.inf:
            raise UsageError(f'"speed" must be in metres per second, more than 0, not {self.speed:g}.')
        if self.above_ground is not None and not 0 <= self.above_ground < math.inf:
            raise UsageError(f'"above_ground" must be in metres, 0 or more, not {self.above_ground:g}.')
        first = self.keys[0].view
        for i, key in enumerate(self.keys):
            if key.view.part is not None:
                raise UsageError(f"Key {i} is a tile of a view; a tour needs whole views.")
            for name in SAME:
                if getattr(key.view, name) != getattr(first, name):
                    raise UsageError(f"All keys must have the same {name}, but key {i} has {getattr(key.view, name)} "
                                     f"and key 0 {getattr(first, name)}.")  # fmt: skip
            if key.path == "zoom" and (i + 1 < len(self.keys) or self.loop) and self.speed is not None:
                raise UsageError(
                    f'Key {i}: a "zoom" has no speed in metres per second.',
                    remedy='Give the keys times, not a "speed".',
                )

    def _channel(self, values: Sequence[float | None], around: float = 0.0) -> Monotone:
        """A number interpolated between the keys that give it.

        In a loop it returns to its first value, up to multiples of ``around``.
        """
        times: list[float] = []
        known: list[float] = []
        for time, key, value in zip(self._schedule.times, self.keys, values):
            if value is None:
                continue
            times.append(time)
            known.append(value)
            if key.hold:
                times.append(time + key.hold)
                known.append(value)
        if self.loop and len(known) > 1:
            times.append(self._schedule.seconds + times[0])
            nearest = round((known[-1] - known[0]) / around) * around if around else 0.0
            known.append(known[0] + nearest)
        return Monotone(times, known, loop=self.loop and len(known) > 2)

    def _suns(self) -> tuple[type | None, tuple[Monotone, ...]]:
        suns = [key.sun for key in self.keys]
        kinds = {type(sun) for sun in suns if sun is not None}
        if not kinds:
            return None, ()
        if len(kinds) > 1:
            raise UsageError("The suns of all keys must be all directions or all times, not a mixture.")
        kind = kinds.pop()
        if kind is Moment:
            return kind, (self._channel([s.when.timestamp() if isinstance(s, Moment) else None for s in suns]),)
        azimuths: list[float | None] = []
        last: float | None = None
        for sun in suns:
            if not isinstance(sun, Placed):
                azimuths.append(None)
                continue
            # The shorter way round from the key before.
            last = sun.azimuth if last is None else last + (sun.azimuth - last + 180.0) % 360.0 - 180.0
            azimuths.append(last)
        return kind, (
            self._channel(azimuths, 360.0),
            self._channel([s.altitude if isinstance(s, Placed) else None for s in suns]),
        )

    def _stack(self) -> tuple[tuple[Layer, Monotone], ...] | None:
        """All layers of all keys, bottom to top, and their opacities over time; None if no key has layers."""
        if all(key.layers is None for key in self.keys):
            return None
        order: list[Layer] = []
        for key in self.keys:
            at = 0  # a new layer goes above the one below it
            for layer in key.layers or ():
                one = replace(layer, opacity=1.0, visible=True)
                if one in order:
                    at = order.index(one) + 1
                else:
                    order.insert(at, one)
                    at += 1
        channels = []
        for one in order:
            values: list[float | None] = []
            for key in self.keys:
                found = [layer for layer in key.layers or () if replace(layer, opacity=1.0, visible=True) == one]
                shown = found[0].opacity if found and found[0].visible else 0.0
                values.append(None if key.layers is None else shown)
            channels.append((one, self._channel(values)))
        return tuple(channels)

    # ---- files ---------------------------------------------------------------------------------------------------

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], *, crs: Any = None, whole: Callable[[int, int], View] | None = None
    ) -> Self:
        """A tour from its JSON.

        Args:
            values: ``keys`` (see ``Key.from_dict``); optionally the fields of ``Tour``, and defaults for the keys'
                fields in ``keys.INHERITED``. Keys without an eye and a target have the camera of the key
                before. The ``sun`` beside the keys may be a passage, A..B.
            crs: the terrain's CRS, as for ``View.from_dict``.
            whole: (width, height) → the camera of a first key that has none; None: it needs one.

        Raises:
            UsageError: something is missing, unknown or of the wrong kind; of a key, its number is named.
        """
        unknown = set(values) - {*OWN, *INHERITED}
        if unknown:
            raise UsageError(
                f"A tour has no {sorted(unknown)[0]!r}; it has {', '.join(OWN)}, and for all keys "
                f"{', '.join(INHERITED)}."
            )
        if values.get("tour") not in (None, FORMAT):
            raise UsageError(f"This tour is of format {values['tour']!r}; this release reads format {FORMAT}.")
        keys = values.get("keys")
        if keys is None:
            raise UsageError('A tour lacks "keys": a list of cameras, each with a "time" in seconds.')
        if not isinstance(keys, Sequence) or isinstance(keys, str):
            raise UsageError('"keys" of a tour must be a list of cameras, each with a "time" in seconds.')
        if not keys:
            raise UsageError(
                'The list "keys" of the tour is empty.', remedy='Give it cameras, each with a "time" in seconds.'
            )
        common = {k: values[k] for k in INHERITED if values.get(k) is not None}
        more: dict[str, Any] = {}
        if (moving := passage(common.get("sun"))) is not None:
            more["passage"] = moving
            del common["sun"]
        made: list[Key] = []
        camera: Mapping[str, Any] | None = None
        for i, key in enumerate(keys):
            if not isinstance(key, Mapping):
                raise UsageError(f'Key {i} is not a JSON object with a "time", an "eye" and a "target".')
            try:
                merged = {**common, **key}
                if camera is None and whole is not None and not has_camera(key):
                    width, height = (int(number(merged.get(n, default), f'The "{n}"')) for n, default in SIZE)
                    camera = whole(width, height).to_dict()
                camera = merged if camera is None or has_camera(key) else {**common, **staying(camera, key)}
                made.append(Key.from_dict(camera, crs=crs))
            except UsageError as error:
                raise UsageError(f"Key {i}: {error.what}", remedy=error.remedy) from error
        for name in ("seconds", "fps", "speed", "above_ground"):
            if values.get(name) is not None:
                more[name] = number(values[name], f'"{name}"')
        for name in ("loop", "ease"):
            if name in values:
                if not isinstance(values[name], bool):
                    raise UsageError(f'"{name}" must be true or false, not {values[name]!r}.')
                more[name] = values[name]
        if "aim" in values:
            more["aim"] = values["aim"]
        return cls(tuple(made), **more)

    @classmethod
    def load(cls, path: str | Path, *, crs: Any = None, whole: Callable[[int, int], View] | None = None) -> Self:
        """Read a tour's file. Arguments as for ``from_dict``.

        Raises:
            ReadError: the file cannot be read, or is not a JSON object. UsageError: as ``from_dict``, naming the file.
        """
        values = load_object(path, "tour", "keys")
        with naming(path):
            tour = cls.from_dict(values, crs=crs, whole=whole)
        if all(key.layers is None for key in tour.keys):
            return tour
        folder = Path(path).parent  # paths in a file are used as they are, or relative to it
        keys = [k if k.layers is None else replace(k, layers=found_beside(k.layers, folder)) for k in tour.keys]
        return replace(tour, keys=tuple(keys))

    def save(self, path: str | Path) -> None:
        """Write a tour's file, whole or not at all.

        Raises:
            OutputError: it cannot be written.
        """
        write(self.to_dict(), path)

    @staticmethod
    def readable(path: str | Path) -> None:
        """Raise ReadError unless the file holds a JSON object: faults that show before any terrain is known."""
        load_object(path, "tour", "keys")

    def to_dict(self) -> dict[str, Any]:
        """The input of ``from_dict``."""
        values: dict[str, Any] = {"tour": FORMAT, "fps": self.fps, "loop": self.loop, "ease": self.ease,
                                  "aim": self.aim}  # fmt: skip
        for name in ("speed", "above_ground"):
            if getattr(self, name) is not None:
                values[name] = getattr(self, name)
        if self.speed is None:
            values["seconds"] = self.seconds
        if self.passage is not None:
            values["sun"] = str(self.passage)
        return {**values, "keys": [key.to_dict() for key in self.keys]}

    # ---- at a time -----------------------------------------------------------------------------------------------

    @property
    def times(self) -> tuple[float, ...]:
        """When the camera is at each key (on arrival, if it stays)."""
        return self._schedule.times

    @property
    def duration(self) -> float:
        """The total time, seconds."""
        return self._schedule.seconds

    def __len__(self) -> int:
        """The number of frames, at least 1."""
        return max(1, round(self.duration * self.fps))

    def moment(self, time: float) -> float:
        """The time within the tour: a loop wraps around, any other tour rests at its ends."""
        if self.loop and self.duration > 0:
            return self.times[0] + (time - self.times[0]) % self.duration
        return min(max(time, 0.0), self.duration)

    def at(self, time: float) -> View:
        """The camera at a time in seconds."""
        time = self.moment(time)
        for key, arrived in zip(self.keys, self.times):
            if arrived <= time <= arrived + key.hold:
                return key.view
        way: Way | None = self._schedule.way(time)
        if way is None:
            return self.keys[0].view if time < self.times[0] else self.keys[-1].view
        return way.view(time)

    def settings(self, time: float) -> dict[str, float]:
        """The scene's numbers that the tour sets, at a time: those of ``keys.SETTINGS`` that any key has."""
        time = self.moment(time)
        return {name: channel(time) for name, channel in self._settings.items()}

    def layers(self, time: float) -> tuple[Layer, ...] | None:
        """The layers at a time, bottom to top, with their opacities; None if no key has layers."""
        if self._layers is None:
            return None
        time = self.moment(time)
        opacities = [(layer, min(max(channel(time), 0.0), 1.0)) for layer, channel in self._layers]
        return tuple(replace(layer, opacity=opacity) for layer, opacity in opacities if opacity > 1e-3)

    def sun(self, time: float) -> Placed | Moment | None:
        """The sun at a time; None if no key has one."""
        time = self.moment(time)
        if self.passage is not None:
            return self.passage.at(time / self.duration if self.duration > 0 else 0.0)
        kind, channels = self._sun
        if kind is None:
            return None
        if kind is Moment:
            import datetime

            zone = next(key.sun.when.tzinfo for key in self.keys if isinstance(key.sun, Moment))
            return Moment(datetime.datetime.fromtimestamp(channels[0](time), zone))
        return Placed(channels[0](time) % 360.0, channels[1](time))

    def frames(self) -> Iterator[View]:
        """The cameras of all frames; frame k is at k/fps seconds. So a tour can replace a flight."""
        return (self.at(k / self.fps) for k in range(len(self)))

    def resized(self, width: int, height: int) -> Self:
        """The same tour with pictures of another size."""
        return replace(self, keys=tuple(replace(k, view=k.view.resized(width, height)) for k in self.keys))


def moves(path: str | Path, *, crs: Any = None) -> Flight | Tour:
    """A moving camera from a file: a tour if the file has any field that only tours have, otherwise a flight.

    Raises:
        ReadError, UsageError: as ``Flight.load`` and ``Tour.load``.
    """
    values = load_object(path, "flight or tour", "keys")
    words = {"time", *(f.name for f in fields(View)), "crs"}
    keys = values.get("keys")
    plain = set(values) <= {"fps", "seconds", "keys"} and isinstance(keys, list)
    if plain and all(isinstance(key, dict) and set(key) <= words for key in keys or ()):
        return Flight.load(path, crs=crs)
    return Tour.load(path, crs=crs)
