"""Flights: a camera that moves smoothly through given views, frame by frame; a JSON file of keys.

    {"fps": 60, "seconds": 10, "keys": [{"time": 0, "eye": […], "target": […]}, {"time": 10, "eye": …, "target": …}]}

A key is a view (as VIEW.json) and the time in seconds at which the camera is there. Between keys

- the eye follows a Catmull-Rom spline with *centripetal* knots (the square roots of the distances between keys), which
  passes every key and makes neither cusps nor loops (Yuksel, Schaefer & Keyser, *Parameterization and applications of
  Catmull-Rom curves*, CAD 2011);
- the directions of view and of up follow the same spline on the sphere: of the pyramid of interpolations that Barry &
  Goldman (SIGGRAPH 1988) make the spline of, each step is a slerp (Schlag 1991, *Graphics Gems II*, VIII.4);
- distance to the target and tan(fov_y/2) change by equal factors in equal times.

How fast the camera goes along these is a monotonic cubic of time (Fritsch & Butland 1984): it changes smoothly, never
runs backwards, and rests where two keys are alike. Size, projection, near and far are the same in all keys.

Units: seconds; metres and degrees as in ``View``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.view import View

Array = NDArray[np.float64]

DEFAULT_FPS = 60.0

MOST_FRAMES = 1_000_000

SAME = ("width", "height", "projection", "near", "far")
"""What all keys have alike."""


@dataclass(frozen=True, slots=True)
class Flight:
    """A camera's way through views.

    Attributes:
        times: of the keys, seconds, increasing, none below 0.
        views: the keys.
        seconds: how long it takes, at least the last key's time. Before the first key and after the last one it rests.
        fps: frames per second.

    Raises:
        UsageError: there is no key, times do not increase, views differ in what has to be the same, or the camera turns
            by 180° from one key to the next (which way round?).
    """

    times: tuple[float, ...]
    views: tuple[View, ...]
    seconds: float
    fps: float = DEFAULT_FPS
    _eye: Track = field(init=False, repr=False, compare=False)
    _forward: Track = field(init=False, repr=False, compare=False)
    _up: Track = field(init=False, repr=False, compare=False)
    _scales: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.views or len(self.times) != len(self.views):
            raise UsageError(f"A flight has a time for each of its keys, not {len(self.times)} for {len(self.views)}.")
        if not 0 < self.fps < math.inf:
            raise UsageError(f"fps is the number of frames in a second, more than 0, not {self.fps:g}.")
        for i, time in enumerate(self.times):
            if not 0 <= time < math.inf:
                raise UsageError(f"The time of key {i} is in seconds from the beginning, 0 or more, not {time:g}.")
            if i and not time > self.times[i - 1]:
                raise UsageError(f"Keys are in the order of their times, but key {i} ({time:g} s) follows "
                                 f"{self.times[i - 1]:g} s.")  # fmt: skip
        if not self.times[-1] <= self.seconds < math.inf:
            raise UsageError(f"The flight ends at {self.seconds:g} s, before its last key at {self.times[-1]:g} s.")
        if self.seconds * self.fps > MOST_FRAMES:
            raise UsageError(f"{self.seconds:g} s at {self.fps:g} frames per second are more than a million frames.")
        for i, view in enumerate(self.views[1:], 1):
            for name in SAME:
                if getattr(view, name) != getattr(self.views[0], name):
                    raise UsageError(
                        f"All keys of a flight have the same {name}, but key {i} has {getattr(view, name)} and key 0 "
                        f"{getattr(self.views[0], name)}."
                    )
        eye = np.array([v.eye for v in self.views])
        aim = np.array([v.target for v in self.views]) - eye
        distance = np.linalg.norm(aim, axis=1)
        up = np.array([v.up for v in self.views])
        zoom = np.tan(np.radians([v.fov_y for v in self.views]) / 2)
        # Slots of a frozen dataclass are set so.
        object.__setattr__(self, "_eye", Track(self.times, eye, lerp, distance_between))
        object.__setattr__(self, "_forward", Track(self.times, aim / distance[:, None], slerp, angle_between))
        object.__setattr__(
            self, "_up", Track(self.times, up / np.linalg.norm(up, axis=1)[:, None], slerp, angle_between)
        )
        object.__setattr__(self, "_scales", np.log(np.stack([distance, zoom])))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], *, crs: Any = None) -> Self:
        """A flight from its JSON.

        Args:
            values: ``keys``: views with a ``time``; optionally ``seconds`` (default: the last key's time) and ``fps``
                (default: 60).
            crs: the terrain's CRS, as for ``View.from_dict``.

        Raises:
            UsageError: something is missing, unknown or of the wrong kind; of a key, its number is named.
        """
        unknown = set(values) - {"fps", "seconds", "keys"}
        if unknown:
            raise UsageError(f"A flight has no {sorted(unknown)[0]!r}; its keys are fps, seconds and keys.")
        keys = values.get("keys")
        if not isinstance(keys, Sequence) or isinstance(keys, str) or not keys:
            raise UsageError('A flight lacks "keys": a list of views, each with a "time" in seconds.')
        times, views = [], []
        for i, key in enumerate(keys):
            if not isinstance(key, Mapping):
                raise UsageError(f'Key {i} of the flight is no view (a JSON object with "time", "eye", "target"…).')
            times.append(_number(key.get("time"), f'The "time" of key {i}'))
            try:
                views.append(View.from_dict({k: v for k, v in key.items() if k != "time"}, crs=crs))
            except UsageError as error:
                raise UsageError(f"Key {i}: {error.what}", remedy=error.remedy) from error
        seconds = values.get("seconds")
        fps = values.get("fps")
        return cls(
            tuple(times),
            tuple(views),
            times[-1] if seconds is None else _number(seconds, '"seconds"'),
            DEFAULT_FPS if fps is None else _number(fps, '"fps"'),
        )

    @classmethod
    def load(cls, path: str | Path, *, crs: Any = None) -> Self:
        """Read a flight's file.

        Raises:
            ReadError: the file cannot be read, or is no JSON object. UsageError: as ``from_dict``, naming the file.
        """
        try:
            values = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise ReadError(f"The flight cannot be read: {error.strerror}.", path=path) from error
        except ValueError as error:
            raise ReadError(f"This is not JSON: {error}.", path=path) from error
        if not isinstance(values, dict):
            raise ReadError("A flight is a JSON object with fps, seconds and keys.", path=path)
        try:
            return cls.from_dict(values, crs=crs)
        except UsageError as error:
            raise UsageError(error.what, path=path, remedy=error.remedy) from error

    def to_dict(self) -> dict[str, Any]:
        """What ``from_dict`` reads."""
        keys = [{"time": t, **v.to_dict()} for t, v in zip(self.times, self.views)]
        return {"fps": self.fps, "seconds": self.seconds, "keys": keys}

    def __len__(self) -> int:
        """How many frames there are, at least 1."""
        return max(1, round(self.seconds * self.fps))

    def at(self, time: float) -> View:
        """The view at a time in seconds."""
        if time <= self.times[0] or len(self.times) == 1:
            return self.views[0]
        if time >= self.times[-1]:
            return self.views[-1]
        if time in self.times:
            return self.views[self.times.index(time)]
        eye, forward = self._eye(time), self._forward(time)
        distance, zoom = (math.exp(monotonic(self.times, scale, time)) for scale in self._scales)
        return replace(
            self.views[0], eye=tuple(eye), target=tuple(eye + distance * forward), up=tuple(self._up(time)),
            fov_y=math.degrees(2 * math.atan(zoom)),
        )  # fmt: skip

    def frames(self) -> Iterator[View]:
        """The views of all frames; frame k is that at k/fps seconds."""
        return (self.at(k / self.fps) for k in range(len(self)))


class Track:
    """A spline through points (n, d) at times (n,), by a way of mixing two points and of measuring between them."""

    def __init__(
        self,
        times: Sequence[float],
        points: Array,
        mix: Callable[[Array, Array, float], Array],
        between: Callable[[Array, Array], float],
    ) -> None:
        self.times, self.mix = times, mix
        knots = [0.0]
        moved = [points[0]]
        for a, b in pairwise(points):
            knots.append(knots[-1] + math.sqrt(between(a, b)))
            if knots[-1] > knots[-2]:
                moved.append(b)
        self.knots = np.array(knots)  # by key; equal where the camera rests
        self.rests = len(moved) == 1
        if self.rests:
            self.points, self.at = points[:1], np.zeros(1)
            return
        at = np.unique(self.knots)
        # The ends go on as they began: a point mirrored at each.
        self.points = np.array([mix(moved[1], moved[0], 2.0), *moved, mix(moved[-2], moved[-1], 2.0)])
        self.at = np.array([2 * at[0] - at[1], *at, 2 * at[-1] - at[-2]])

    def __call__(self, time: float) -> Array:
        """The point at a time between the first and the last."""
        if self.rests:
            return np.asarray(self.points[0])
        u = monotonic(self.times, self.knots, time)
        i = int(np.clip(np.searchsorted(self.at, u, side="right") - 1, 1, len(self.at) - 3))
        t, p = self.at[i - 1 : i + 3], list(self.points[i - 1 : i + 3])
        for span in (1, 2):
            p = [self.mix(p[k], p[k + 1], (u - t[k]) / (t[k + span] - t[k])) for k in range(len(p) - 1)]
        return self.mix(p[0], p[1], (u - t[1]) / (t[2] - t[1]))


def lerp(a: Array, b: Array, t: float) -> Array:
    """The point at t on the line through a (0) and b (1)."""
    return np.asarray(a + t * (b - a))


def slerp(a: Array, b: Array, t: float) -> Array:
    """The unit vector at t on the great circle through a (0) and b (1); t may lie beyond them."""
    angle = angle_between(a, b)
    if angle < 1e-12:
        return a
    c = np.asarray((math.sin((1 - t) * angle) * a + math.sin(t * angle) * b) / math.sin(angle))
    return np.asarray(c / np.linalg.norm(c))


def distance_between(a: Array, b: Array) -> float:
    """Metres."""
    return float(np.linalg.norm(b - a))


def angle_between(a: Array, b: Array) -> float:
    """Radians between unit vectors, to the last digits also for small angles.

    Raises:
        UsageError: it is 180°.
    """
    angle = 2 * math.atan2(float(np.linalg.norm(a - b)), float(np.linalg.norm(a + b)))
    if angle > math.pi - 1e-6:
        raise UsageError(
            "The camera turns by 180° from one key to the next, which may be done in many ways.",
            remedy="Put a key between them.",
        )
    return angle


def monotonic(times: Sequence[float], values: Array, time: float) -> float:
    """The monotonic cubic interpolation of values (n,) at times (n,) (Fritsch & Butland 1984, as PCHIP)."""
    x, y = np.asarray(times, np.float64), np.asarray(values, np.float64)
    h, d = np.diff(x), np.diff(y) / np.diff(x)
    slopes = np.empty(len(x))
    slopes[0], slopes[-1] = d[0], d[-1]
    for k in range(1, len(d)):
        a, b = 2 * h[k] + h[k - 1], h[k] + 2 * h[k - 1]
        slopes[k] = 0.0 if d[k - 1] * d[k] <= 0 else (a + b) / (a / d[k - 1] + b / d[k])
    i = int(np.clip(np.searchsorted(x, time, side="right") - 1, 0, len(h) - 1))
    s = (time - x[i]) / h[i]
    from_left = y[i] + h[i] * s * slopes[i]
    rest = y[i + 1] - y[i] - h[i] * slopes[i]
    bend = h[i] * (slopes[i] + slopes[i + 1]) - 2 * (y[i + 1] - y[i])
    return float(from_left + s * s * (rest - bend * (1 - s)))


def _number(value: Any, what: str) -> float:
    """A finite JSON number.

    Raises:
        UsageError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise UsageError(f"{what} must be a number, not {value!r}.")
    return float(value)
