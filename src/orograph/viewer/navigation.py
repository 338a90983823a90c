"""Camera moves as pure functions from ``View`` to ``View``: orbit, pan, zoom, look, and requested views.

- ``Grab``: a ground point held by the cursor. *Pan* moves the camera without turning it so that the point stays exactly
  under the cursor: at the eye's own height if the ground is seen from above, parallel to the picture at a grazing angle
  (where a level move would leap).
- ``zoom``: towards the point under the cursor or away from it; the point does not move in the picture.
- ``orbit``: about the point under the cursor as a rigid body; the point does not move, and the horizon stays level.
- ``look``: turning the head.

No move takes the eye below ``clearance`` metres above the ground: instead the nearest move is made that stays above it
*and* keeps the point under the cursor. The ground is a function (easting, northing) → height in true metres, NaN where
there is none. Units: metres, degrees; pixel positions as in ``View``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from orograph.viewer.pose import Pose
from orograph.viewpoint import Point, View

Array = NDArray[np.float64]
Pixel = tuple[float, float]
Ground = Callable[[float, float], float]

CLEARANCE = 2.0
"""Minimum height of the eye above the ground, metres: that of a tall person."""
NEAREST = 1.0
"""Minimum depth of the point zoomed to, metres."""
GRAZING = math.radians(14.0)
"""Angle between ray and horizontal below which a pan is parallel to the picture."""
LOWEST = math.radians(4.0)
"""A level pan follows the cursor down to this angle below the horizontal, so that the point is never dragged to the
horizon."""
HIGHEST_PITCH = math.radians(85.0)


def no_ground(x: float, y: float) -> float:
    """The ground of a world without ground."""
    return math.nan


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a camera.

    Attributes:
        ground: height of the ground, true metres.
        clearance: metres above it that the eye keeps.
        farthest: maximum distance from the point under the cursor when zooming out, metres.
    """

    ground: Ground = no_ground
    clearance: float = CLEARANCE
    farthest: float = math.inf

    def floor(self, pose: Pose) -> float:
        """The minimum height of a pose's eye, stretched space; −inf where there is no ground."""
        height = self.ground(float(pose.eye[0]), float(pose.eye[1]))
        return -math.inf if math.isnan(height) else (height + self.clearance) * pose.exaggeration

    def allow(self, pose: Pose) -> bool:
        """Whether the eye is high enough (a thousandth of a millimetre allows for rounding)."""
        return bool(pose.eye[2] >= self.floor(pose) - 1e-6)


FREE = Limits()


def kept_above(view: View, limits: Limits = FREE, exaggeration: float = 1.0) -> View:
    """The view, lifted together with its target if its eye is too low."""
    pose = Pose.of(view, exaggeration)
    return view if limits.allow(pose) and view.projection == "perspective" else lifted(pose, limits).to_view()


def lifted(pose: Pose, limits: Limits) -> Pose:
    """The pose, raised to the lowest allowed height at its place if it is lower."""
    floor = limits.floor(pose)
    return pose if pose.eye[2] >= floor else pose.at(np.array([pose.eye[0], pose.eye[1], floor]))


# ---- pan -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Grab:
    """A point that the cursor holds while it drags.

    Attributes:
        start: the camera when it was taken.
        point: the point, stretched space.
        level: whether the camera moves at its own height; else parallel to the picture.
    """

    start: Pose
    point: Array
    level: bool

    @classmethod
    def take(cls, view: View, point: Point, exaggeration: float = 1.0) -> Self:
        """Grab a point (easting, northing, height) of the ground."""
        pose = Pose.of(view, exaggeration)
        held = np.array(point, np.float64) * [1.0, 1.0, exaggeration]
        down = pose.eye - held
        return cls(pose, held, math.atan2(down[2], math.hypot(down[0], down[1])) >= GRAZING)

    def to(self, pixel: Pixel, limits: Limits = FREE) -> View:
        """The view in which the point appears at ``pixel``."""
        ray = self.start.ray(pixel)
        depth = self.start.depth(self.point)
        if self.level:
            ray = _below(ray, LOWEST)
            depth = float((self.point[2] - self.start.eye[2]) / ray[2])
        pose = self.start.at(self.point - depth * ray)
        if limits.allow(pose):
            return pose.to_view()
        return _cleared(self.start, self.point, ray, depth, limits).to_view()


def _below(ray: Array, angle: float) -> Array:
    """The ray, or if it falls by less than ``angle``, the one below it that falls by it; its horizontal length
    is kept."""
    level = math.hypot(ray[0], ray[1])
    return np.array([ray[0], ray[1], min(ray[2], -level * math.tan(angle))]) if level > 0 else ray


def _cleared(pose: Pose, point: Array, ray: Array, depth: float, limits: Limits) -> Pose:
    """The eye on the half line ``point − depth·ray`` at the nearest allowed depth to ``depth``; lifted, if none is
    allowed."""

    def at(d: float) -> Pose:
        return pose.at(point - d * ray)

    good = None
    for k in range(1, 40):  # away from the point if that is upwards, otherwise towards it
        d = depth * (1.0 + 0.05 * 1.25**k) if ray[2] < 0 else depth * 0.85**k
        if d < 1e9 and limits.allow(at(d)):
            good = d
            break
    if good is None:
        return lifted(at(depth), limits)
    return at(_bisect(depth, good, lambda d: limits.allow(at(d))))


def _bisect(bad: float, good: float, allowed: Callable[[float], bool]) -> float:
    """The allowed value nearest to ``bad``, to 1e-12 of their distance."""
    for _ in range(40):
        middle = 0.5 * (bad + good)
        if allowed(middle):
            good = middle
        else:
            bad = middle
    return good


# ---- zoom ----------------------------------------------------------------------------------------------------------


def zoom(
    view: View, point: Point, factor: float, limits: Limits = FREE, exaggeration: float = 1.0
) -> View:  # fmt: skip
    """Bring a point (easting, northing, height) ``factor`` times as near; it keeps its place in the picture."""
    pose = Pose.of(view, exaggeration)
    held = np.array(point, np.float64) * [1.0, 1.0, exaggeration]
    depth = pose.depth(held)
    offset = held - pose.eye
    if depth <= 0:
        return pose.to_view()
    reach = float(np.linalg.norm(offset)) / depth
    wanted = min(max(depth / factor, NEAREST), max(limits.farthest / reach, depth))
    if factor > 1:
        wanted = min(wanted, depth)

    def at(d: float) -> Pose:
        return pose.at(held - offset * (d / depth))

    if not limits.allow(at(wanted)):
        if not limits.allow(pose):
            return lifted(pose, limits).to_view()
        wanted = _bisect(wanted, depth, lambda d: limits.allow(at(d)))
    # Move the target to the point: the camera now looks at what was zoomed to.
    return replace(at(wanted), distance=max(wanted, NEAREST)).to_view()


def dolly(view: View, pixel: Pixel, metres: float, limits: Limits = FREE, exaggeration: float = 1.0) -> View:
    """Move along a pixel's ray, for a cursor that is not on the ground; slide over the ground where the ray
    meets it."""
    pose = Pose.of(view, exaggeration)
    ray = pose.ray(pixel)
    return lifted(pose.at(pose.eye + ray * (metres / float(np.linalg.norm(ray)))), limits).to_view()


# ---- orbit and look ------------------------------------------------------------------------------------------------


def orbit(view: View, pivot: Point, turn: float, tilt: float, limits: Limits = FREE, exaggeration: float = 1.0) -> View:
    """Turn the camera about a point (easting, northing, height), which keeps its pixel and its distance.

    Args:
        turn: degrees by which the heading grows. tilt: degrees by which the pitch grows (negative: looks down more).
    """
    pose = Pose.of(view, exaggeration)
    centre = np.array(pivot, np.float64) * [1.0, 1.0, exaggeration]
    heading = pose.heading + math.radians(turn)
    pitch = _pitch(pose.pitch + math.radians(tilt))
    moved = pose.around(centre, heading, pitch)
    if not limits.allow(moved):
        if not limits.allow(pose):
            return lifted(moved, limits).to_view()
        # Steeper views of the same point are higher; if even the steepest is too low, turn less.
        if limits.allow(pose.around(centre, heading, -math.pi / 2)):
            pitch = _bisect(pitch, -math.pi / 2, lambda p: limits.allow(pose.around(centre, heading, p)))
            moved = pose.around(centre, heading, pitch)
        else:
            part = _bisect(1.0, 0.0, lambda s: limits.allow(_between(pose, centre, heading, pitch, s)))
            moved = _between(pose, centre, heading, pitch, part)
    return moved.to_view()


def _between(pose: Pose, centre: Array, heading: float, pitch: float, part: float) -> Pose:
    return pose.around(centre, pose.heading + part * (heading - pose.heading), pose.pitch + part * (pitch - pose.pitch))


def look(view: View, turn: float, tilt: float, exaggeration: float = 1.0) -> View:
    """Turn the head: heading and pitch grow by degrees, the eye stays."""
    pose = Pose.of(view, exaggeration)
    return pose.turned(pose.heading + math.radians(turn), _pitch(pose.pitch + math.radians(tilt))).to_view()


def _pitch(angle: float) -> float:
    return min(max(angle, -math.pi / 2), HIGHEST_PITCH)


# ---- views one asks for --------------------------------------------------------------------------------------------


def towards(
    view: View, point: Point, limits: Limits = FREE, exaggeration: float = 1.0, *, heading: float | None = None,
    pitch: float | None = None, distance: float | None = None,
) -> View:  # fmt: skip
    """The view with a point (easting, northing, height) in the middle of the picture.

    Args:
        heading, pitch: degrees; None: unchanged.
        distance: metres of stretched space from the point; None: unchanged.
    """
    pose = Pose.of(view, exaggeration)
    centre = np.array(point, np.float64) * [1.0, 1.0, exaggeration]
    far = float(np.linalg.norm(centre - pose.eye)) if distance is None else distance
    far = max(far, NEAREST)
    turned = pose.turned(
        pose.heading if heading is None else math.radians(heading),
        pose.pitch if pitch is None else _pitch(math.radians(pitch)),
    )
    pose = replace(turned.at(centre - far * turned.axes()[2]), distance=far)
    if not limits.allow(pose):
        steep = pose.around(centre, pose.heading, -math.pi / 2)
        if limits.allow(steep):
            tilt = _bisect(pose.pitch, -math.pi / 2, lambda p: limits.allow(pose.around(centre, pose.heading, p)))
            pose = pose.around(centre, pose.heading, tilt)
        else:
            pose = lifted(pose, limits)
    return pose.to_view()


def heading_pitch(view: View, exaggeration: float = 1.0) -> tuple[float, float]:
    """Heading in [0, 360) clockwise from grid north, and pitch above the horizontal; degrees, as in the picture."""
    pose = Pose.of(view, exaggeration)
    return math.degrees(pose.heading) % 360.0, math.degrees(pose.pitch)
