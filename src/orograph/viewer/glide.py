"""A smooth flight from one view to another: van Wijk & Nuij, *Smooth and efficient zooming and panning*, InfoVis 2003.

Seen from above, a view is described by where it looks (u along the line between both targets) and how much it shows (w,
here the distance from eye to target). Of all paths from (0, w0) to (u1, w1) the shortest in the metric

    ds² = ρ²/w² du² + 1/(ρ² w²) dw²

is the one that appears to move evenly: a long path rises first and descends at the end. Its closed form is eq. (9) of
the paper, with the special case u1 = 0 (pure zoom). ρ = √2 balances panning and zooming (the paper's users preferred
1.42). Heading, pitch and lens are interpolated too, the heading the shorter way round. The flight eases in and out.

Units: metres, seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from orograph.viewer.navigation import FREE, Limits, lifted
from orograph.viewer.pose import Pose, wrapped
from orograph.viewpoint import View

RHO = math.sqrt(2.0)
PACE = 1.6
"""Length in the metric per second."""
SHORTEST, LONGEST = 0.25, 4.0
"""Minimum and maximum duration of a flight, seconds."""


class Path:
    """The path of van Wijk & Nuij from (0, w0) to (u1, w1), by arc length.

    Args:
        distance: u1 ≥ 0. start, end: w0, w1 > 0.

    Attributes:
        length: S, in the metric.
    """

    def __init__(self, distance: float, start: float, end: float, rho: float = RHO) -> None:
        self.w0, self.w1, self.u1, self.rho = start, end, distance, rho
        r2 = rho * rho
        # If the pan is less than a millionth of what is shown, the general form loses precision.
        self.zooms = distance < 1e-6 * max(start, end)
        if self.zooms:
            self.length = abs(math.log(end / start)) / rho
            return
        b0 = (end**2 - start**2 + r2 * r2 * distance**2) / (2 * start * r2 * distance)
        b1 = (end**2 - start**2 - r2 * r2 * distance**2) / (2 * end * r2 * distance)
        self.r0, r1 = -math.asinh(b0), -math.asinh(b1)
        self.length = (r1 - self.r0) / rho

    def __call__(self, s: float) -> tuple[float, float]:
        """(u, w) at arc length s."""
        if self.zooms:
            part = s / self.length if self.length > 0 else 1.0
            return self.u1 * part, self.w0 * math.exp(math.copysign(self.rho * s, math.log(self.w1 / self.w0)))
        r = self.rho * s + self.r0
        u = self.w0 / self.rho**2 * (math.cosh(self.r0) * math.tanh(r) - math.sinh(self.r0))
        return u, self.w0 * math.cosh(self.r0) / math.cosh(r)


@dataclass(slots=True)
class Glide:
    """A flight between two views.

    Attributes:
        start, end: the views; size and range are the end's.
        seconds: duration; None: from the length of the path.
    """

    start: View
    end: View
    limits: Limits = FREE
    exaggeration: float = 1.0
    seconds: float | None = None
    _at: Callable[[float], Pose] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        a, b = Pose.of(self.start, self.exaggeration), Pose.of(self.end, self.exaggeration)
        from_, to = (p.eye + p.distance * p.axes()[2] for p in (a, b))
        path = Path(float(np.linalg.norm(to - from_)), a.distance, b.distance)
        turn, tilt = wrapped(b.heading - a.heading), b.pitch - a.pitch
        lens = [math.log(math.tan(math.radians(v.fov_y) / 2)) for v in (self.start, self.end)]
        if self.seconds is None:
            length = max(path.length, math.hypot(turn, tilt))
            self.seconds = min(max(length / PACE, SHORTEST), LONGEST)

        def at(part: float) -> Pose:
            u, w = path(part * path.length)
            along = u / path.u1 if path.u1 > 0 else part
            fov = math.degrees(2 * math.atan(math.exp(lens[0] + part * (lens[1] - lens[0]))))
            view = replace(self.end, fov_y=fov)
            pose = replace(b, view=view, distance=w).turned(a.heading + part * turn, a.pitch + part * tilt)
            return pose.at(from_ + along * (to - from_) - w * pose.axes()[2])

        self._at = at

    def at(self, time: float) -> View:
        """The view at a time; the end view from ``seconds`` on."""
        assert self.seconds is not None
        if time >= self.seconds:
            return self.end
        t = max(time, 0.0) / self.seconds
        part = t * t * t * (t * (6 * t - 15) + 10)  # at rest, without jerk, at both ends (Perlin's fade)
        return lifted(self._at(part), self.limits).to_view()
