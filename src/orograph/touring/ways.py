"""The ways between key frames: along a spline, about a target, or up, across and down. Each is smooth in itself.

A ``Way`` moves the camera through two or more keys, and gives its position at a time. Its behaviour at the ends (rest,
or continue smoothly where the tour loops) is given by ``rests`` and ``loop``, as for ``splines.Monotone``.

- ``SplineWay``: the eye follows a centripetal Catmull-Rom spline whose *height* is a monotonic cubic of the spline's
  parameter: between two keys it stays within their heights, so that a camera low in a valley does not dip into it. The
  target does the same ("target"), or the direction of view is a spline on the sphere ("direction").
- ``OrbitWay``: azimuth, pitch and distance about the target change, each as a monotonic cubic: a circle is a circle.
- ``ZoomWay``: the optimal path of van Wijk & Nuij, *Smooth and efficient zooming and panning* (InfoVis 2003): of all
  ways from one view of a map to another, the one along which the picture moves least, at constant perceived speed; ρ is
  their users' mean, 1.42.

Units: metres, seconds, degrees as in ``View``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.splines import Monotone, Track, angle_between, distance_between, lerp, slerp
from orograph.viewpoint import View

Array = NDArray[np.float64]
Pace = Callable[[float], float]

RHO = 1.42
"""van Wijk & Nuij 2003, section 6: how much users prefer zooming to panning."""

FINE, COARSE = 512, 128
"""Chords by which a span of a spline, and of an orbit, is measured: lengths to 1e-5 where it turns by less than 90°,
and speeds to 1e-3 even at the keys, where a Catmull-Rom spline's acceleration jumps."""


class Way(Protocol):
    """Part of a tour."""

    def view(self, time: float) -> View:
        """The camera at a time from the way's first to its last."""


class Curve:
    """The eye's or the target's path through points (n, 3): centripetal across the map, monotone in height.

    Attributes:
        knots: (n,) the parameter at the points.
        lengths: (n,) metres along the curve to each of them.
    """

    def __init__(self, times: Sequence[float], points: Array, rests: Collection[int] = (), loop: bool = False) -> None:
        self.track = Track(times, points, lerp, distance_between, rests, loop)
        self.knots = self.track.knots
        at, first = np.unique(self.knots, return_index=True)
        self.height = Monotone(at, points[first, 2], loop=loop)
        if len(at) == 1:
            self.fine, self.far = at, np.zeros(1)
        else:
            # Approximate each span by chords, with denser ends where the parameter begins to move.
            parts = [np.linspace(a, b, FINE, endpoint=False) for a, b in pairwise(at)]
            self.fine = np.append(np.concatenate(parts), at[-1])
            chords = np.linalg.norm(np.diff(self.along(self.fine), axis=0), axis=1)
            self.far = np.concatenate([[0.0], np.cumsum(chords)])
        self.lengths = np.interp(self.knots, self.fine, self.far)

    def along(self, u: Array) -> Array:
        """Points (m, 3) at parameters (m,)."""
        points = self.track.along(u)
        points[:, 2] = self.height.many(u)
        return points

    def after(self) -> Monotone:
        """Metres along the curve → parameter."""
        far, first = np.unique(self.far, return_index=True)
        return Monotone(far, self.fine[first])

    def __call__(self, time: float) -> Array:
        return np.asarray(self.along(np.array([self.track.pace(time)]))[0])


class _Lens:
    """The common part of all ways: the field of view and the picture's up direction."""

    def __init__(self, times: Sequence[float], views: Sequence[View], rests: Collection[int], loop: bool) -> None:
        self.first = views[0]
        self.zoom = Monotone(times, np.log(np.tan(np.radians([v.fov_y for v in views]) / 2)), rests, loop)
        up = np.array([v.up for v in views])
        up /= np.linalg.norm(up, axis=1)[:, None]
        self.up = Track(times, up, slerp, angle_between, rests, loop)

    def fov_y(self, time: float) -> float:
        return math.degrees(2 * math.atan(math.exp(self.zoom(time))))

    def seen(self, eye: Array, target: Array, time: float) -> View:
        if not np.linalg.norm(target - eye) > 1e-6 * (1.0 + float(np.abs(eye).max())):
            raise UsageError(
                f"At {time:g} s the camera flies through its target, and has no direction there.",
                remedy='Move a key, or use "aim": "direction".',
            )
        return replace(self.first, eye=tuple(eye), target=tuple(target), up=tuple(self.up(time)),
                       fov_y=self.fov_y(time))  # fmt: skip


class SplineWay:
    """Along a spline (see the module's text).

    Args:
        times: of the keys; equal views in succession are a rest.
        pace: time → metres along the eye's path, if that is prescribed; otherwise it follows from the times.
    """

    def __init__(
        self, times: Sequence[float], views: Sequence[View], rests: Collection[int], loop: bool,
        aim: Literal["target", "direction"], pace: Pace | None = None,
    ) -> None:  # fmt: skip
        eyes, targets = (np.array([getattr(v, name) for v in views]) for name in ("eye", "target"))
        self.lens = _Lens(times, views, rests, loop)
        self.eye = Curve(times, eyes, rests, loop)
        if pace is not None:
            given, after = pace, self.eye.after()
            self.eye.track.pace = lambda time: after(given(time))
        self.target = self.forward = None
        if aim == "target":
            self.target = Curve(times, targets, rests, loop)
        else:
            distance = np.linalg.norm(targets - eyes, axis=1)
            self.forward = Track(times, (targets - eyes) / distance[:, None], slerp, angle_between, rests, loop)
            self.distance = Monotone(times, np.log(distance), rests, loop)

    def view(self, time: float) -> View:
        eye = self.eye(time)
        if self.target is not None:
            return self.lens.seen(eye, self.target(time), time)
        assert self.forward is not None
        return self.lens.seen(eye, eye + math.exp(self.distance(time)) * self.forward(time), time)


class OrbitWay:
    """About the target (see the module's text).

    Args:
        turns: (n − 1,) full turns from each key to the next, besides the shorter way round.
    """

    def __init__(
        self, times: Sequence[float], views: Sequence[View], rests: Collection[int], loop: bool, turns: Sequence[int]
    ) -> None:
        self.lens = _Lens(times, views, rests, loop)
        arm = np.array([np.subtract(v.eye, v.target) for v in views])
        across = np.hypot(arm[:, 0], arm[:, 1])
        azimuth = np.degrees(np.arctan2(arm[:, 0], arm[:, 1]))
        steps = (np.diff(azimuth) + 180.0) % 360.0 - 180.0
        steps[np.abs(steps) < 1e-9] = 0.0
        steps += 360.0 * np.array(turns, np.float64)
        channels = [
            azimuth[0] + np.concatenate([[0.0], np.cumsum(steps)]),
            np.degrees(np.arctan2(arm[:, 2], across)),
            np.log(np.linalg.norm(arm, axis=1)),
            *np.array([v.target for v in views]).T,
        ]
        self.channels = [Monotone(times, c, rests, loop) for c in channels]

    def view(self, time: float) -> View:
        azimuth, pitch, distance, *target = (c(time) for c in self.channels)
        a, p, d = math.radians(azimuth), math.radians(pitch), math.exp(distance)
        arm = np.array([math.sin(a) * math.cos(p), math.cos(a) * math.cos(p), math.sin(p)]) * d
        return self.lens.seen(np.array(target) + arm, np.array(target), time)

    def lengths(self, times: Array) -> Array:
        """Metres travelled by the eye at each of ``times``, from the first."""
        found = [0.0]
        for a, b in pairwise(times):
            eyes = np.array([self.view(float(t)).eye for t in np.linspace(a, b, COARSE + 1)])
            found.append(found[-1] + float(np.linalg.norm(np.diff(eyes, axis=0), axis=1).sum()))
        return np.array(found)


class ZoomWay:
    """Up, across and down, from one view to another (see the module's text)."""

    def __init__(self, times: Sequence[float], views: Sequence[View], rests: Collection[int]) -> None:
        self.lens = _Lens(times, views, rests, False)
        self.part = Monotone(times, np.linspace(0.0, 1.0, 2) if len(times) == 2 else [0.0, 0.0, 1.0], rests)
        first, last = views[0], views[-1]
        self.path = zoom_path(_wide(first), _wide(last), math.dist(first.target, last.target))
        self.targets = np.array([first.target, last.target])
        aim = np.array([np.subtract(v.target, v.eye) for v in (first, last)])
        aim /= np.linalg.norm(aim, axis=1)[:, None]
        angle_between(aim[0], aim[1])
        self.aim = aim

    def view(self, time: float) -> View:
        part = self.part(time)
        moved, wide = self.path(part)
        target = lerp(self.targets[0], self.targets[1], np.array(moved))
        forward = slerp(self.aim[:1], self.aim[1:], np.array([[part]]))[0]
        lens = self.lens
        distance = wide / (2 * math.exp(lens.zoom(time)) * lens.first.width / lens.first.height)
        return lens.seen(target - distance * forward, target, time)


def _wide(view: View) -> float:
    """The visible width at the target, metres."""
    return view.pixel_metres * view.width


def zoom_path(w0: float, w1: float, u1: float) -> Callable[[float], tuple[float, float]]:
    """The optimal path between two views of a map (van Wijk & Nuij 2003, section 4).

    Args:
        w0, w1: the visible width of the first and the last view, metres. u1: the distance of their middles.

    Returns:
        part of the way (0 to 1, even perceived speed) → (part of u1 covered, visible width, metres).
    """
    if u1 <= 1e-9 * max(w0, w1):  # the same place: only zoom, by equal factors

        def zoomed(part: float) -> tuple[float, float]:
            return part, w0 * (w1 / w0) ** part

        return zoomed
    r2 = RHO * RHO

    def ends(w: float, sign: float) -> float:
        b = (w1 * w1 - w0 * w0 + sign * r2 * r2 * u1 * u1) / (2 * w * r2 * u1)
        return -math.asinh(b)  # ln(−b + √(b² + 1))

    r0, r1 = ends(w0, 1.0), ends(w1, -1.0)
    length = (r1 - r0) / RHO

    def path(part: float) -> tuple[float, float]:
        r = RHO * part * length + r0
        # cosh r0 tanh r − sinh r0, without the cancellation of large numbers
        moved = w0 / r2 * math.sinh(r - r0) / math.cosh(r)
        return moved / u1, w0 * math.cosh(r0) / math.cosh(r)

    return path
