"""How a camera stands: eye, heading and pitch in *stretched* space, where navigation happens, and back to a ``View``.

What is under the cursor depends on the picture, where heights are stretched by the exaggeration; so all moves are made
there and converted to true places at the end. A navigation camera never rolls: it has only a heading (radians clockwise
from grid north) and a pitch (radians above the horizontal, −π/2 straight down).

The set of eyes from which a point G appears at a pixel, for a fixed heading and pitch, is the half line G − τ·d, τ > 0,
with d the pixel's ray of unit forward component: τ is G's depth. Panning, zooming and keeping above ground while G
stays under the cursor are three ways of choosing τ.

Units: metres, radians; pixel positions as in ``View``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.viewpoint import Point, View

Array = NDArray[np.float64]

STEEP = math.radians(60.0)
"""Beyond this pitch the view's up is set to its heading: (0, 0, 1) is useless when looking along it."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A camera that does not roll.

    Attributes:
        eye: (3,) float64, stretched space.
        heading, pitch: radians.
        distance: from the eye to the target, metres of stretched space.
        view: the view that the pose was made from; gives size, lens and range.
        exaggeration: the stretch.
    """

    eye: Array
    heading: float
    pitch: float
    distance: float
    view: View
    exaggeration: float

    @classmethod
    def of(cls, view: View, exaggeration: float = 1.0) -> Pose:
        """The pose of a view; roll is lost, and a plan becomes a perspective straight down at the same scale."""
        stretch = np.array([1.0, 1.0, exaggeration])
        _, up, forward = view.axes(exaggeration)
        level = math.hypot(forward[0], forward[1])
        if level > 0.5:
            heading = math.atan2(forward[0], forward[1])
        elif forward[2] < 0:
            heading = math.atan2(up[0], up[1])
        else:
            heading = math.atan2(-up[0], -up[1])
        if view.projection == "plan":
            eye = np.array(view.target) * stretch + [0.0, 0.0, view.distance]
            return cls(eye, heading, -math.pi / 2, view.distance, replace(view, projection="perspective"), exaggeration)
        offset = (np.array(view.target) - np.array(view.eye)) * stretch
        return cls(
            np.array(view.eye) * stretch, heading, math.atan2(forward[2], level), float(np.linalg.norm(offset)), view,
            exaggeration,
        )  # fmt: skip

    def to_view(self) -> View:
        """The view, with the target at ``distance``."""
        forward = self.axes()[2]
        unstretch = np.array([1.0, 1.0, 1.0 / self.exaggeration])
        up: Point = (0.0, 0.0, 1.0)
        if abs(self.pitch) > STEEP:
            side = -math.copysign(1.0, self.pitch)
            up = (side * math.sin(self.heading), side * math.cos(self.heading), 0.0)
        return replace(
            self.view, eye=_point(self.eye * unstretch),
            target=_point((self.eye + self.distance * forward) * unstretch), up=up,
        )  # fmt: skip

    def axes(self) -> tuple[Array, Array, Array]:
        """Unit vectors (right, up, forward)."""
        sh, ch, sp, cp = (f(a) for a in (self.heading, self.pitch) for f in (math.sin, math.cos))
        return np.array([ch, -sh, 0.0]), np.array([-sh * sp, -ch * sp, cp]), np.array([sh * cp, ch * cp, sp])

    def ray(self, pixel: tuple[float, float]) -> Array:
        """The direction (3,) of a pixel's ray, its forward component 1."""
        right, up, forward = self.axes()
        s = self.view.pixel_slope
        return np.asarray(
            forward
            + right * ((pixel[0] - self.view.width / 2) * s)
            - up * ((pixel[1] - self.view.height / 2) * s)
        )  # fmt: skip

    def depth(self, point: Array) -> float:
        """View-space depth of a point (3,) of stretched space."""
        return float((point - self.eye) @ self.axes()[2])

    def at(self, eye: Array) -> Pose:
        """The same camera elsewhere."""
        return replace(self, eye=np.asarray(eye, np.float64))

    def turned(self, heading: float, pitch: float) -> Pose:
        """The same place with another direction; the heading is normalised to (−π, π]."""
        return replace(self, heading=wrapped(heading), pitch=pitch)

    def around(self, pivot: Array, heading: float, pitch: float) -> Pose:
        """Rotate as a rigid body about a point (3,): the point keeps its pixel and its depth."""
        offset = pivot - self.eye
        seen = [float(a @ offset) for a in self.axes()]
        turned = self.turned(heading, pitch)
        return turned.at(pivot - sum((a * s for a, s in zip(turned.axes(), seen)), np.zeros(3)))


def wrapped(angle: float) -> float:
    """The same direction in (−π, π]."""
    return math.remainder(angle, 2 * math.pi)


def _point(values: Any) -> Point:
    x, y, z = (float(v) for v in values)
    return x, y, z
