"""Smooth paths through given values at given times, for flights and tours.

- ``Track``: a Catmull-Rom spline with *centripetal* knots (the square roots of the distances between points), which
  passes every point and makes neither cusps nor loops (Yuksel, Schaefer & Keyser, *Parameterization and applications of
  Catmull-Rom curves*, CAD 2011). On a sphere each step of Barry & Goldman's pyramid of interpolations (SIGGRAPH 1988)
  is a slerp (Schlag 1991, *Graphics Gems II*, VIII.4).
- ``Monotone``: the monotonic cubic (Fritsch & Butland 1984, as PCHIP), which never leaves the range of neighbouring
  values. It gives the speed along a track: smooth, never backwards, at rest where two points are equal.

Units are the caller's; times in seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError

Array = NDArray[np.float64]


class Monotone:
    """The monotonic cubic interpolation of values (n,) at increasing times (n,).

    Args:
        rests: indices of values where the slope is 0.
        loop: the last value is the first again: both ends have one slope, that of an inner value.
    """

    def __init__(
        self, times: Sequence[float] | Array, values: ArrayLike, rests: Collection[int] = (), loop: bool = False
    ) -> None:
        self.times, self.values = np.asarray(times, np.float64), np.asarray(values, np.float64)
        n = len(self.times)
        self.slopes = np.zeros(n)
        if n > 1:
            h, d = np.diff(self.times), np.diff(self.values) / np.diff(self.times)
            self.slopes[0], self.slopes[-1] = d[0], d[-1]
            for k in range(1, n - 1):
                self.slopes[k] = _between(h[k - 1], h[k], d[k - 1], d[k])
            if loop:
                self.slopes[[0, -1]] = _between(h[-1], h[0], d[-1], d[0])
        self.slopes[list(rests)] = 0.0

    def __call__(self, time: float) -> float:
        """The value at a time; constant beyond the ends."""
        return float(self.many(np.array([time]))[0])

    def many(self, times: Array) -> Array:
        """Values at times (m,)."""
        x, y = self.times, self.values
        if len(x) == 1:
            return np.full(len(times), y[0])
        t = np.clip(times, x[0], x[-1])
        i = np.clip(np.searchsorted(x, t, side="right") - 1, 0, len(x) - 2)
        h = x[i + 1] - x[i]
        s = (t - x[i]) / h
        from_left = y[i] + h * s * self.slopes[i]
        rest = y[i + 1] - y[i] - h * self.slopes[i]
        bend = h * (self.slopes[i] + self.slopes[i + 1]) - 2 * (y[i + 1] - y[i])
        return np.asarray(from_left + s * s * (rest - bend * (1 - s)))


def _between(before: float, after: float, slope_before: float, slope_after: float) -> float:
    """The slope at a value between two intervals: the weighted harmonic mean of their slopes, 0 at an extremum."""
    if slope_before * slope_after <= 0:
        return 0.0
    a, b = 2 * after + before, after + 2 * before
    return float((a + b) / (a / slope_before + b / slope_after))


class Track:
    """A spline through points (n, d) at times (n,), given how to mix two points and how to measure their distance.

    Args:
        mix: the points at t (m, 1) between a (m, d) at 0 and b (m, d) at 1; t may lie beyond.
        between: the distance of two points (d,).
        rests, loop: as for ``Monotone``; with ``loop`` the last point is the first again.

    Attributes:
        knots: (n,) of the points, equal where the track rests.
        pace: time → knot.
    """

    def __init__(
        self,
        times: Sequence[float],
        points: Array,
        mix: Callable[[Array, Array, Array], Array],
        between: Callable[[Array, Array], float],
        rests: Collection[int] = (),
        loop: bool = False,
    ) -> None:
        self.mix = mix
        knots = [0.0]
        moved = [points[0]]
        for a, b in pairwise(points):
            knots.append(knots[-1] + math.sqrt(between(a, b)))
            if knots[-1] > knots[-2]:
                moved.append(b)
        self.knots = np.array(knots)
        self.pace: Callable[[float], float] = Monotone(times, self.knots, rests, loop)
        self.still = len(moved) == 1
        if self.still:
            self.points, self.at = points[:1], np.zeros(1)
            return
        at = np.unique(self.knots)
        if loop and len(moved) > 2:
            before, after = moved[-2], moved[1]
            ends = at[0] - (at[-1] - at[-2]), at[-1] + (at[1] - at[0])
        else:  # extend the ends: mirror a point at each
            two = np.array([[2.0]])
            before = mix(moved[1][None], moved[0][None], two)[0]
            after = mix(moved[-2][None], moved[-1][None], two)[0]
            ends = 2 * at[0] - at[1], 2 * at[-1] - at[-2]
        self.points = np.array([before, *moved, after])
        self.at = np.array([ends[0], *at, ends[1]])

    def __call__(self, time: float) -> Array:
        """The point (d,) at a time between the first and the last."""
        return np.asarray(self.along(np.array([self.pace(time)]))[0])

    def along(self, u: Array) -> Array:
        """The points (m, d) at knots u (m,)."""
        if self.still:
            return np.repeat(self.points, len(u), 0)
        i = np.clip(np.searchsorted(self.at, u, side="right") - 1, 1, len(self.at) - 3)
        t = [self.at[i + k][:, None] for k in (-1, 0, 1, 2)]
        p = [self.points[i + k] for k in (-1, 0, 1, 2)]
        v = u[:, None]
        for span in (1, 2):
            p = [self.mix(p[k], p[k + 1], (v - t[k]) / (t[k + span] - t[k])) for k in range(len(p) - 1)]
        return self.mix(p[0], p[1], (v - t[1]) / (t[2] - t[1]))


def lerp(a: Array, b: Array, t: Array) -> Array:
    """The points at t on the lines through a (0) and b (1)."""
    return np.asarray(a + t * (b - a))


def slerp(a: Array, b: Array, t: Array) -> Array:
    """The unit vectors (m, d) at t on the great circles through a (0) and b (1); t may lie beyond them."""
    angle = angles_between(a, b)[:, None]
    near = angle < 1e-12
    safe = np.where(near, 1.0, angle)
    c = np.where(near, a, np.sin((1 - t) * safe) * a + np.sin(t * safe) * b)
    return np.asarray(c / np.linalg.norm(c, axis=1, keepdims=True))


def distance_between(a: Array, b: Array) -> float:
    """Metres."""
    return float(np.linalg.norm(b - a))


def angle_between(a: Array, b: Array) -> float:
    """The angle in radians between unit vectors (d,), accurate for small angles too.

    Raises:
        UsageError: it is 180°.
    """
    return float(angles_between(a[None], b[None])[0])


def angles_between(a: Array, b: Array) -> Array:
    """``angle_between`` for many: (m, d) → (m,)."""
    angles = 2 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    if (angles > math.pi - 1e-6).any():
        raise UsageError(
            "The camera turns by 180° from one key to the next, which may be done in many ways.",
            remedy="Put a key between them.",
        )
    return np.asarray(angles)
