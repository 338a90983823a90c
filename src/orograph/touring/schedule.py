"""The schedule of a tour: its keys grouped into ways, its rests and, if it has a speed, the resulting times.

Keys i … j that are joined in the same manner form one way; a zoom joins two keys. A key with ``hold`` occurs twice in
its way, at both times. The camera is at rest at the ends of ways, unless the tour begins or ends there without easing,
or loops in one way. Units: seconds, metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from orograph.errors import UsageError
from orograph.touring.keys import Key
from orograph.touring.ways import Curve, OrbitWay, Pace, SplineWay, Way, ZoomWay
from orograph.viewpoint import View

RAMP = 1.0
"""Seconds in which a tour with a speed reaches it from rest."""


@dataclass(frozen=True, slots=True)
class Part:
    """Keys that form one way.

    Attributes:
        first, last: numbers of its first and last key; in a loop the first key is also number n.
        loop: whether the way is a whole loop.
        begins, ends: whether the camera is at rest at its first and its last key.
    """

    first: int
    last: int
    loop: bool
    begins: bool
    ends: bool


@dataclass(frozen=True, slots=True)
class Schedule:
    """The ways of a tour in time.

    Attributes:
        times: of the keys. seconds: of the whole tour.
        ways: (from, to, way), in order.
    """

    times: tuple[float, ...]
    seconds: float
    ways: tuple[tuple[float, float, Way], ...]

    def way(self, time: float) -> Way | None:
        """The way at a time, None before the first and after the last."""
        for begins, ends, way in self.ways:
            if begins <= time <= ends:
                return way
        return None

    @classmethod
    def of(
        cls, keys: Sequence[Key], seconds: float | None, loop: bool, ease: bool, aim: Literal["target", "direction"],
        speed: float | None,
    ) -> Schedule:  # fmt: skip
        """Sort the keys into ways (see ``Tour`` for the arguments).

        Raises:
            UsageError: as ``Tour``.
        """
        if speed is None:
            times = _given(keys, seconds, loop)
            ends = times[-1] + keys[-1].hold
            total = ends if seconds is None else seconds
            if closed(keys, loop):
                times = [*times, total + times[0]]
        else:
            for i, key in enumerate(keys):
                if key.time is not None:
                    raise UsageError(f'Key {i} has a "time", but the tour a "speed", which determines the times.')
            if seconds is not None:
                raise UsageError('"seconds" and "speed" determine each other: give one of the two.')
            times, total = [], 0.0
        ways: list[tuple[float, float, Way]] = []
        for part in _parts(keys, loop, ease):
            numbers = [k % len(keys) for k in range(part.first, part.last + 1)]
            here = [keys[k] for k in numbers]
            pace: Pace | None = None
            if speed is not None:
                began = times[-1] if times else 0.0
                found, pace = _paced(part, here, speed, aim, began)
                times = [*times[: part.first], *found]
            knots, views, rests = _knots(part, here, times[part.first : part.last + 1])
            try:
                way = _way(here, knots, views, rests, part, aim, pace)
            except UsageError as error:
                raise UsageError(f"Keys {numbers[0]} to {numbers[-1]}: {error.what}", remedy=error.remedy) from error
            ways.append((knots[0], knots[-1], way))
        if speed is not None:
            times = times or [0.0]
            total = times[-1] if closed(keys, loop) else times[-1] + keys[-1].hold
        return cls(tuple(times[: len(keys)]), total, tuple(ways))


def closed(keys: Sequence[Key], loop: bool) -> bool:
    """Whether the last key leads back to the first: in a loop, except for a single key that does not orbit."""
    return loop and (len(keys) > 1 or keys[0].turns != 0)


def _given(keys: Sequence[Key], seconds: float | None, loop: bool) -> list[float]:
    """The times of keys that have them."""
    times: list[float] = []
    for i, key in enumerate(keys):
        if key.time is None:
            if i == 0:
                times.append(0.0)
                continue
            raise UsageError(
                f'The "time" of key {i} is missing.', remedy='Give it in seconds, or give the tour a "speed".'
            )
        if i and not key.time > times[-1] + keys[i - 1].hold:
            held = f" and its hold of {keys[i - 1].hold:g} s" if keys[i - 1].hold else ""
            raise UsageError(
                f"Keys must be in the order of their times, but key {i} ({key.time:g} s) does not come after key "
                f"{i - 1} ({times[-1]:g} s{held})."
            )
        times.append(float(key.time))
    ends = times[-1] + keys[-1].hold
    if seconds is None:
        if closed(keys, loop):
            raise UsageError('A loop needs "seconds": the time when the camera is back at the first key.')
    elif not math.isfinite(seconds) or seconds < ends:
        raise UsageError(f'The tour ends at {seconds:g} s ("seconds"), before its last key ends at {ends:g} s.')
    if closed(keys, loop) and seconds is not None and not seconds + times[0] > ends:
        raise UsageError(
            f'The loop is closed at {seconds:g} s ("seconds"), when its last key ends: no time is left for the way '
            "back."
        )
    return times


def _parts(keys: Sequence[Key], loop: bool, ease: bool) -> list[Part]:
    """The ways that keys form."""
    n = len(keys)
    last = n if closed(keys, loop) else n - 1
    borders = [0]
    for k in range(1, last):
        if keys[k].path != keys[k - 1].path or keys[k].path == "zoom":
            borders.append(k)
    borders.append(last)
    if last == 0:
        return []
    parts = list(pairwise(borders))
    if loop and len(parts) == 1 and keys[0].path != "zoom":
        return [Part(0, last, True, False, False)]
    rests = ease or loop
    return [
        Part(a, b, False, rests if a == 0 else True, rests if b == last else True)
        for a, b in parts
    ]  # fmt: skip


def _knots(part: Part, keys: Sequence[Key], times: Sequence[float]) -> tuple[list[float], list[View], list[int]]:
    """Times and views of a way, with holds twice, and which of them are at rest."""
    knots: list[float] = []
    views: list[View] = []
    rests: list[int] = []
    for k, (key, time) in enumerate(zip(keys, times)):
        first, last = k == 0, k == len(keys) - 1
        if (first and part.begins) or (last and part.ends) or (key.stop and not (last and part.loop)):
            rests.append(len(knots))
        if part.loop and last and keys[0].stop:
            rests.append(len(knots))
        knots.append(time)
        views.append(key.view)
        if key.hold and not last:
            rests += [len(knots) - 1, len(knots)]
            knots.append(time + key.hold)
            views.append(key.view)
        if part.loop and last and keys[0].hold:
            rests.append(len(knots) - 1)
    return knots, views, sorted(set(rests))


def _way(
    keys: Sequence[Key], times: list[float], views: list[View], rests: list[int], part: Part,
    aim: Literal["target", "direction"], pace: Pace | None,
) -> Way:  # fmt: skip
    kind = keys[0].path
    if kind == "zoom":
        return ZoomWay(times, views, rests)
    if kind == "orbit":
        turns: list[int] = []
        for key in keys[:-1]:
            turns += [0, key.turns] if key.hold else [key.turns]
        return OrbitWay(times, views, rests, part.loop, turns)
    return SplineWay(times, views, rests, part.loop, aim, pace)


def _paced(
    part: Part, keys: Sequence[Key], speed: float, aim: Literal["target", "direction"], began: float
) -> tuple[list[float], Pace | None]:
    """The times of the keys of a way with a given speed and, for a spline, the metres travelled at each time.

    Args:
        began: when the camera arrives at the first key.
    """
    phases = [float(k) for k in range(len(keys))]
    views = [key.view for key in keys]
    if keys[0].path == "orbit":
        way = OrbitWay(phases, views, [], part.loop, [key.turns for key in keys[:-1]])
        lengths = way.lengths(np.array(phases))
    else:
        lengths = Curve(phases, np.array([v.eye for v in views]), loop=part.loop).lengths
    for k, (a, b) in enumerate(pairwise(lengths)):
        if not b > a:
            raise UsageError(
                f"The eye does not move from key {part.first + k} to the next, so a speed gives no duration.",
                remedy='Replace them by one key with a "hold", or give the keys times.',
            )
    stops = {k for k, key in enumerate(keys) if key.hold or key.stop}
    if part.loop and 0 in stops:
        stops.add(len(keys) - 1)
    still = stops | ({0} if part.begins else set()) | ({len(keys) - 1} if part.ends else set())
    times = [began]
    legs: list[tuple[float, float, Cruise]] = []
    start = 0
    for k in range(1, len(keys)):
        if k not in still and k != len(keys) - 1:
            continue
        begins = times[start] + keys[start].hold
        leg = Cruise(float(lengths[k] - lengths[start]), speed, start in still, k in still)
        legs.append((begins, float(lengths[start]), leg))
        for j in range(start + 1, k):
            times.append(begins + leg.when(float(lengths[j] - lengths[start])))
        times.append(begins + leg.seconds)
        start = k

    def pace(time: float) -> float:
        for begins, before, leg in reversed(legs):
            if time >= begins:
                return before + leg(time - begins)
        return legs[0][1]

    return times, None if keys[0].path == "orbit" else pace


class Cruise:
    """A distance travelled at a speed, from rest and to rest if requested.

    The speed follows 3x² − 2x³ over ``RAMP`` seconds.

    Attributes:
        seconds: its duration.
    """

    def __init__(self, length: float, speed: float, from_rest: bool, to_rest: bool) -> None:
        self.length, self.speed = length, speed
        ramps = int(from_rest) + int(to_rest)
        self.ramp = min(RAMP, 2 * length / (speed * ramps)) if ramps else 0.0
        self.up, self.down = self.ramp * from_rest, self.ramp * to_rest
        self.seconds = length / speed + self.ramp * ramps / 2

    def __call__(self, time: float) -> float:
        """Metres travelled after ``time`` seconds."""
        if time <= 0:
            return 0.0
        if time >= self.seconds:
            return self.length
        if time < self.up:
            return self.speed * self.up * _ramped(time / self.up)
        if time > self.seconds - self.down:
            return self.length - self.speed * self.down * _ramped((self.seconds - time) / self.down)
        return self.speed * (time - self.up / 2)

    @staticmethod
    def length_of(seconds: float, speed: float) -> float:
        """The distance travelled from rest to rest in a time at a speed."""
        return speed * (seconds - RAMP if seconds >= 2 * RAMP else seconds / 2)

    @staticmethod
    def speed_for(length: float, seconds: float) -> float:
        """The speed at which a distance takes a given time from rest to rest."""
        return length / (seconds - RAMP if seconds >= 2 * RAMP else seconds / 2)

    def when(self, gone: float) -> float:
        """Seconds after which a distance has been travelled."""
        low, high = 0.0, self.seconds
        if gone >= self.length:
            return high
        for _ in range(80):
            middle = (low + high) / 2
            low, high = (middle, high) if self(middle) < gone else (low, middle)
        return (low + high) / 2


def _ramped(x: float) -> float:
    """∫ 3x² − 2x³."""
    return x**3 - x**4 / 2
