"""Flights: a camera that moves smoothly through given views, frame by frame; a JSON file of keys.

    {"fps": 60, "seconds": 10, "keys": [{"time": 0, "eye": […], "target": […]}, {"time": 10, "eye": …, "target": …}]}

A key is a view (as VIEW.json) and the time in seconds at which the camera is there. Between keys

- the eye follows a centripetal Catmull-Rom spline, and the directions of view and of up the same spline on the sphere;
- distance to the target and tan(fov_y/2) change by equal factors in equal times.

The speed along these is a monotonic cubic of time: it changes smoothly, never runs backwards, and rests where two keys
are alike (``splines``, with the sources). Size, projection, near and far are the same in all keys.

A flight holds a camera only, so that measurements can be repeated; films are made from a ``tour``.

Units: seconds; metres and degrees as in ``View``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from orograph.documents import load_object, naming, number
from orograph.errors import UsageError
from orograph.splines import Monotone, Track, angle_between, distance_between, lerp, slerp
from orograph.viewpoint import View

DEFAULT_FPS = 60.0

MOST_FRAMES = 1_000_000

SAME = ("width", "height", "projection", "near", "far", "part")
"""What all keys have in common."""


@dataclass(frozen=True, slots=True)
class Flight:
    """A camera path through views.

    Attributes:
        times: of the keys, seconds, increasing, none below 0.
        views: the keys.
        seconds: how long it takes, at least the last key's time. The camera rests before the first key and after the
        last one.
        fps: frames per second.

    Raises:
        UsageError: there is no key, times do not increase, views differ in what must be equal, or the camera turns by
            180° from one key to the next (which way round?).
    """

    times: tuple[float, ...]
    views: tuple[View, ...]
    seconds: float
    fps: float = DEFAULT_FPS
    _eye: Track = field(init=False, repr=False, compare=False)
    _forward: Track = field(init=False, repr=False, compare=False)
    _up: Track = field(init=False, repr=False, compare=False)
    _scales: tuple[Monotone, Monotone] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.views or len(self.times) != len(self.views):
            raise UsageError(f"A flight needs one time per key, not {len(self.times)} for {len(self.views)}.")
        if not 0 < self.fps < math.inf:
            raise UsageError(f"fps must be greater than 0, not {self.fps:g}.")
        for i, time in enumerate(self.times):
            if not 0 <= time < math.inf:
                raise UsageError(f"The time of key {i} must be 0 or more seconds from the beginning, not {time:g}.")
            if i and not time > self.times[i - 1]:
                raise UsageError(f"Keys must be in the order of their times, but key {i} ({time:g} s) follows "
                                 f"{self.times[i - 1]:g} s.")  # fmt: skip
        if not self.times[-1] <= self.seconds < math.inf:
            raise UsageError(f"The flight ends at {self.seconds:g} s, before its last key at {self.times[-1]:g} s.")
        if self.seconds * self.fps > MOST_FRAMES:
            raise UsageError(f"{self.seconds:g} s at {self.fps:g} frames per second are more than a million frames.")
        for i, view in enumerate(self.views[1:], 1):
            for name in SAME:
                if getattr(view, name) != getattr(self.views[0], name):
                    raise UsageError(
                        f"All keys of a flight must have the same {name}, but key {i} has {getattr(view, name)} and "
                        f"key 0 {getattr(self.views[0], name)}."
                    )
        eye = np.array([v.eye for v in self.views])
        aim = np.array([v.target for v in self.views]) - eye
        distance = np.linalg.norm(aim, axis=1)
        up = np.array([v.up for v in self.views])
        zoom = np.tan(np.radians([v.fov_y for v in self.views]) / 2)
        # Attributes of a frozen dataclass are set this way.
        object.__setattr__(self, "_eye", Track(self.times, eye, lerp, distance_between))
        object.__setattr__(self, "_forward", Track(self.times, aim / distance[:, None], slerp, angle_between))
        object.__setattr__(
            self, "_up", Track(self.times, up / np.linalg.norm(up, axis=1)[:, None], slerp, angle_between)
        )
        object.__setattr__(self, "_scales", tuple(Monotone(self.times, np.log(v)) for v in (distance, zoom)))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], *, crs: Any = None) -> Self:
        """A flight from its JSON.

        Args:
            values: ``keys``: views with a ``time``; optionally ``seconds`` (default: the last key's time) and ``fps``
                (default: 60).
            crs: the terrain's CRS, as for ``View.from_dict``.

        Raises:
            UsageError: something is missing, unknown or of the wrong kind; the message names the key's number.
        """
        unknown = set(values) - {"fps", "seconds", "keys"}
        if unknown:
            raise UsageError(f"A flight has no key {sorted(unknown)[0]!r}; it may have fps, seconds and keys.")
        keys = values.get("keys")
        if not isinstance(keys, Sequence) or isinstance(keys, str) or not keys:
            raise UsageError('A flight lacks "keys": a list of views, each with a "time" in seconds.')
        times, views = [], []
        for i, key in enumerate(keys):
            if not isinstance(key, Mapping):
                raise UsageError(f'Key {i} of the flight is not a view (a JSON object with "time", "eye", "target"…).')
            times.append(number(key.get("time"), f'The "time" of key {i}'))
            try:
                views.append(View.from_dict({k: v for k, v in key.items() if k != "time"}, crs=crs))
            except UsageError as error:
                raise UsageError(f"Key {i}: {error.what}", remedy=error.remedy) from error
        seconds = values.get("seconds")
        fps = values.get("fps")
        return cls(
            tuple(times),
            tuple(views),
            times[-1] if seconds is None else number(seconds, '"seconds"'),
            DEFAULT_FPS if fps is None else number(fps, '"fps"'),
        )

    @classmethod
    def load(cls, path: str | Path, *, crs: Any = None) -> Self:
        """Read a flight's file.

        Raises:
            ReadError: the file cannot be read, or is no JSON object. UsageError: as ``from_dict``, naming the file.
        """
        values = load_object(path, "flight", "fps, seconds and keys")
        with naming(path):
            return cls.from_dict(values, crs=crs)

    def to_dict(self) -> dict[str, Any]:
        """The inverse of ``from_dict``."""
        keys = [{"time": t, **v.to_dict()} for t, v in zip(self.times, self.views)]
        return {"fps": self.fps, "seconds": self.seconds, "keys": keys}

    def __len__(self) -> int:
        """How many frames there are, at least 1."""
        return max(1, round(self.seconds * self.fps))

    def at(self, time: float) -> View:
        """The view at a time, in seconds."""
        if time <= self.times[0] or len(self.times) == 1:
            return self.views[0]
        if time >= self.times[-1]:
            return self.views[-1]
        if time in self.times:
            return self.views[self.times.index(time)]
        eye, forward = self._eye(time), self._forward(time)
        distance, zoom = (math.exp(scale(time)) for scale in self._scales)
        return replace(
            self.views[0], eye=tuple(eye), target=tuple(eye + distance * forward), up=tuple(self._up(time)),
            fov_y=math.degrees(2 * math.atan(zoom)),
        )  # fmt: skip

    def frames(self) -> Iterator[View]:
        """The views of all frames; frame k is that at k/fps seconds."""
        return (self.at(k / self.fps) for k in range(len(self)))
