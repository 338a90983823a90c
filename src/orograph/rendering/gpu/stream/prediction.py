"""Where a moving camera will be shortly, predicted from its last movements: tiles are prefetched for that view.

Eye and target are extrapolated along straight lines at a speed averaged over ``SMOOTH`` seconds: right for a flight,
good enough for a turn of the head or an orbit, which curve little in ``HORIZONS``. A camera that jumps has no speed,
and one that stands still has none after a moment. Metres, seconds.
"""

from __future__ import annotations

import math
from dataclasses import replace

from orograph.errors import UsageError
from orograph.geo.vectors import Vector
from orograph.viewpoint import View

HORIZONS = (0.75, 1.5)
"""How far ahead to predict, alternately; seconds."""

PERIOD = 0.1
"""Seconds between two predictions: each costs as much as selecting a frame's patches."""

SMOOTH = 0.3
"""Seconds over which the speed is averaged."""

PAUSE = 0.5
"""Seconds between two frames after which the speed is unknown."""

JUMP = 0.3
"""A step between two frames that is longer than this part of the distance to the target is no movement."""

STILL = 1e-3
"""A speed below which nothing is predicted, as a part of the distance to the target per second."""


class Prediction:
    """The speed of a camera, updated frame by frame.

    Attributes:
        turn: which of the ``HORIZONS`` was used last.
    """

    def __init__(self) -> None:
        self._last: View | None = None
        self._when = self._looked = -math.inf
        self._eye: Vector = (0.0, 0.0, 0.0)
        self._target: Vector = (0.0, 0.0, 0.0)
        self.turn = 0

    def see(self, view: View, now: float) -> None:
        """Record a frame's view and its time (by any clock)."""
        last, passed = self._last, now - self._when
        self._last, self._when = view, now
        if last is None or not 0 < passed <= PAUSE or last.projection != view.projection:
            self._eye = self._target = (0.0, 0.0, 0.0)
            return
        far = max(math.dist(view.eye, last.eye), math.dist(view.target, last.target))
        if far > JUMP * view.distance:
            self._eye = self._target = (0.0, 0.0, 0.0)
            return
        keep = math.exp(-passed / SMOOTH)
        self._eye = _mixed(self._eye, view.eye, last.eye, passed, keep)
        self._target = _mixed(self._target, view.target, last.target, passed, keep)

    @property
    def moving(self) -> bool:
        """Whether the camera moves noticeably."""
        if self._last is None:
            return False
        fastest = max(math.hypot(*self._eye), math.hypot(*self._target))
        return fastest > STILL * self._last.distance

    def ahead(self, now: float) -> View | None:
        """The predicted view; None if the camera rests, or if the last prediction is less than ``PERIOD`` old."""
        if self._last is None or not self.moving or now - self._looked < PERIOD:
            return None
        self._looked = now
        self.turn = (self.turn + 1) % len(HORIZONS)
        return self.at(HORIZONS[self.turn])

    def at(self, seconds: float) -> View | None:
        """The view after some seconds; None if it would be invalid."""
        view = self._last
        if view is None:
            return None
        # At most by the distance to the target: ground beyond was not in view yet, and the speed may be wrong.
        seconds = min(seconds, view.distance / max(math.hypot(*self._eye), math.hypot(*self._target), 1e-12))
        eye, target = _moved(view.eye, self._eye, seconds), _moved(view.target, self._target, seconds)
        try:
            return replace(view, eye=eye, target=target)
        except UsageError:  # eye and target met
            return None


def _moved(place: Vector, speed: Vector, seconds: float) -> Vector:
    return place[0] + seconds * speed[0], place[1] + seconds * speed[1], place[2] + seconds * speed[2]


def _mixed(speed: Vector, now: Vector, before: Vector, passed: float, keep: float) -> Vector:
    a, b, c = (keep * s + (1 - keep) * (n - p) / passed for s, n, p in zip(speed, now, before, strict=True))
    return a, b, c
