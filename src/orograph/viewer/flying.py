"""Flying with held keys: speed is proportional to the height above the ground, and the path is the same at any frame
rate.

A velocity in camera axes follows the keys within a tenth of a second (exponentially), and the eye follows the velocity.
The speed depends on the place, so the path is integrated in ticks of fixed length, independent of frames: the same time
always gives the same ticks. The rest of a frame after its last tick is drawn but not kept, so motion stays even.

Units: metres and radians of stretched space, seconds.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from orograph.viewer.navigation import FREE, HIGHEST_PITCH, Limits, lifted
from orograph.viewer.pose import Pose
from orograph.viewpoint import View

Array = NDArray[np.float64]

TICK = 1.0 / 240.0
RESPONSE = 0.1
"""Seconds in which the velocity comes within 1/e of the keys' target."""
PACE = 0.8
"""Heights above the ground per second."""
SLOWEST, FASTEST = 1.5, 2e6
"""Minimum and maximum speed, metres per second."""
FAST, SLOW = 5.0, 0.2
TURN = math.radians(50.0)
"""Turning speed of the arrow keys, radians per second."""

MOVES: dict[str, tuple[float, float, float]] = {
    "w": (0, 0, 1), "s": (0, 0, -1), "a": (-1, 0, 0), "d": (1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0),
}  # fmt: skip
"""Key → (right, up, forward); up is the world's."""
TURNS: dict[str, tuple[float, float]] = {
    "ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowUp": (0, 1), "ArrowDown": (0, -1),
}  # fmt: skip
"""Key → (heading, pitch)."""
KEYS = frozenset({*MOVES, *TURNS})


@dataclass(slots=True)
class Flying:
    """The state of a flight by keys.

    Attributes:
        velocity: (5,) right, up, forward in heights above ground per second times ``PACE``, heading, pitch in radians
            per second.
        rest: seconds since the last tick.
    """

    velocity: Array = field(default_factory=lambda: np.zeros(5))
    rest: float = 0.0
    _kept: Pose | None = None
    _drawn: View | None = None

    @property
    def moving(self) -> bool:
        """Whether the camera still moves."""
        return bool(np.abs(self.velocity).max() > 0)

    def stop(self) -> None:
        """Stop at once."""
        self.velocity[:] = 0.0
        self.rest = 0.0
        self._kept = self._drawn = None

    def advance(
        self, view: View, keys: Collection[str], seconds: float, limits: Limits = FREE, exaggeration: float = 1.0,
        pace: float = 1.0,
    ) -> View:  # fmt: skip
        """The view after some more time.

        Args:
            view: the last result, or any other view: the flight continues from there.
            keys: held down, of ``KEYS``.
            pace: a factor on the speed (``FAST``, ``SLOW``).
        """
        wanted = np.zeros(5)
        for key in keys:
            wanted[:3] += np.array(MOVES.get(key, (0, 0, 0))) * pace
            wanted[3:] += np.array(TURNS.get(key, (0, 0))) * TURN
        unchanged = self._kept is not None and view == self._drawn and self._kept.exaggeration == exaggeration
        pose = self._kept if unchanged and self._kept is not None else Pose.of(view, exaggeration)
        self.rest += seconds
        ticks = math.floor(self.rest / TICK + 1e-9)
        keep = math.exp(-TICK / RESPONSE)
        for _ in range(ticks):
            self.velocity = wanted + (self.velocity - wanted) * keep
            pose = step(pose, self.velocity, TICK, limits)
        self.rest = max(self.rest - ticks * TICK, 0.0)
        if not wanted.any() and np.abs(self.velocity).max() < 1e-3:
            self.stop()
            return pose.to_view()
        self._kept = pose
        self._drawn = (step(pose, self.velocity, self.rest, limits) if self.rest > 0 else pose).to_view()
        return self._drawn


def step(pose: Pose, velocity: Array, seconds: float, limits: Limits) -> Pose:
    """Move with a velocity; over rising ground the eye rises with it."""
    ground = limits.ground(float(pose.eye[0]), float(pose.eye[1]))
    height = pose.distance if math.isnan(ground) else pose.eye[2] - ground * pose.exaggeration
    speed = min(max(PACE * height, SLOWEST), FASTEST)
    right, _, forward = pose.axes()
    move = right * velocity[0] + np.array([0.0, 0.0, 1.0]) * velocity[1] + forward * velocity[2]
    pitch = min(max(pose.pitch + velocity[4] * seconds, -math.pi / 2), HIGHEST_PITCH)
    turned = pose.turned(pose.heading + velocity[3] * seconds, pitch)
    return lifted(replace(turned, eye=pose.eye + move * (speed * seconds)), limits)
