"""Line of sight between two points over the ground, on a round body with refracting air; where it is obstructed.

At s metres along the ellipsoid ground of height z appears at z − c s²/2 to an eye at s = 0, c = (1 − k) / R: R is
Gauss's radius of curvature at the eye, k the coefficient of refraction (0.13 in survey practice; Torge & Müller 2012,
§5.1.1). In these heights light runs straight. The ground is the triangulated surface, cut at every edge (``profile``):
its clearance under the line of sight is, piece by piece, a quadratic whose minimum and zeros are found in closed form.
Obstructions count from ``LEAST`` = 0.1 mm, as for viewsheds. Holes hide nothing; their length is reported.

Units: metres; heights above the ground at both ends.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.measuring.places import Places
from orograph.measuring.profile import Profile, profile
from orograph.store.opening import takes_terrain
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]

LEAST = 1e-4
"""How far ground must rise above a line of sight to obstruct it, metres: less is rounding."""
REFRACTION = 0.13


@dataclass(frozen=True, slots=True)
class Mark:
    """A place on a line of sight.

    Attributes:
        easting, northing: metres; longitude, latitude: degrees, None without a CRS.
        height: of the ground, metres; distance: from the first point along the ellipsoid, metres.
        clearance: metres of the line above the ground, negative under it.
    """

    easting: float
    northing: float
    longitude: float | None
    latitude: float | None
    height: float
    distance: float
    clearance: float


@dataclass(frozen=True)
class Sight:
    """A line of sight.

    Attributes:
        visible: whether nothing obstructs it.
        obstruction: where it first meets the ground; None if it is visible.
        tightest: the ground that rises highest above the line, or comes nearest to it (the ends do not count).
        needed: metres above the ground at which a target there is just visible from the eye.
        clearance: (n,) metres of the line above the ground at the places of ``profile``; NaN over holes.
        line: (n,) heights of the line of sight there, metres, as the ground's are counted.
        profile: the ground under it.
        eye, target: metres above the ground; bend: c, per metre (0: a plane).
    """

    visible: bool
    obstruction: Mark | None
    tightest: Mark | None
    needed: float
    clearance: Array
    line: Array
    profile: Profile
    eye: float
    target: float
    bend: float

    def hidden(self) -> NDArray[np.bool_]:
        """(n,): places of the ground that the eye does not see, judged by the steepest ground before each."""
        p = self.profile
        rise = p.surface_heights - 0.5 * self.bend * p.distance**2 - (p.surface_heights[0] + self.eye)
        slope = np.divide(rise, p.distance, out=np.full(len(rise), -np.inf), where=p.distance > 0)
        before = np.maximum.accumulate(np.where(np.isnan(slope), -np.inf, slope))
        away = p.distance > 0
        out = np.zeros(len(rise), bool)
        out[away] = (before[away] - slope[away]) * p.distance[away] > LEAST  # false over holes
        return out

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it by the file's ending: a plot (.png, .svg, .pdf), or the ground under it as a table (.csv).

        Raises:
            UsageError: another ending. ReadError: a plot needs matplotlib. OutputError: the file cannot be written.
        """
        if Path(path).suffix.lower() == ".csv":
            return self.profile.save(path)
        from orograph.measuring.plot import ENDINGS, save_sight

        if Path(path).suffix.lower() not in ENDINGS:
            raise UsageError(f"A line of sight must be written as .csv, {', '.join(ENDINGS)}.", path=path)
        save_sight(self, path)
        return Path(path)

    def to_dict(self) -> dict[str, Any]:
        """A summary for JSON."""
        from dataclasses import asdict

        return {
            "visible": self.visible, "obstruction": None if self.obstruction is None else asdict(self.obstruction),
            "tightest": None if self.tightest is None else asdict(self.tightest), "target_needed_m": self.needed,
            "eye_m": self.eye, "target_m": self.target, "horizontal_m": float(self.profile.distance[-1]),
            "straight_m": self._straight(), "bend_per_m": self.bend, "missing_m": self.profile.missing,
        }  # fmt: skip

    def _straight(self) -> float:
        """From the eye to the target, through space."""
        p = self.profile
        ends = p.places.ecef(p.points[[0, -1]], p.surface_heights[[0, -1]] + [self.eye, self.target])
        return float(np.linalg.norm(ends[1] - ends[0]))


def bend_of(places: Places, point: Array, flat: bool, refraction: float) -> float:
    """c = (1 − k) / R, per metre, at a point (2,); 0 for a plane.

    Raises:
        UsageError: the refraction is not a number below 1.
    """
    if not (math.isfinite(refraction) and refraction < 1):
        raise UsageError(f"The coefficient of refraction must be a number below 1, usually 0.13, not {refraction!r}.")
    return 0.0 if flat else (1.0 - refraction) / places.gauss_radius(point)


def check_heights(**heights: float) -> None:
    """Raise UsageError unless they are finite and not negative."""
    for name, value in heights.items():
        if not (math.isfinite(value) and value >= 0):
            raise UsageError(f"The {name} must be 0 or more metres above the ground, not {value!r}.")


@takes_terrain
def line_of_sight(
    terrain: Terrain,
    a: ArrayLike,
    b: ArrayLike,
    eye: float = 1.7,
    target: float = 0.0,
    *,
    flat: bool = False,
    refraction: float = REFRACTION,
    lonlat: bool = False,
) -> Sight:
    """Whether ``b`` is visible from ``a``, and what obstructs the line.

    Args:
        a, b: easting and northing of the eye and of the target.
        eye, target: metres above the ground there.
        flat: leave the body flat, and without refraction.
        refraction: k; 0 without air.
        lonlat: the points are longitude and latitude, degrees.

    Raises:
        UsageError: a point is not on the terrain, in a hole, or the same as the other; a height is negative.
    """
    check_heights(**{"eye's height": eye, "target's height": target})
    places = Places(terrain)
    ends = np.concatenate([places.points(a, lonlat=lonlat), places.points(b, lonlat=lonlat)])
    if len(ends) != 2:
        raise UsageError("A line of sight needs two points.")
    bend = bend_of(places, ends[0], flat, refraction)
    ground = profile(terrain, ends)
    for k, name in ((0, "first"), (-1, "second")):
        if math.isnan(ground.surface_heights[k]):
            raise UsageError(
                f"The {name} point, {ends[k][0]:.10g}, {ends[k][1]:.10g}, is in a hole: the ground there is unknown.",
                remedy="Choose another point.",
            )
    s, z = ground.distance, ground.surface_heights
    whole = float(s[-1])
    start, stop = z[0] + eye, z[-1] + target - 0.5 * bend * whole**2
    apparent = z - 0.5 * bend * s**2
    straight = start + (stop - start) * (s / whole)
    clearance = straight - apparent
    first, least = _least(clearance, ground.known, s, bend)
    obstruction = None if first is None else _mark(ground, *first)
    return Sight(
        first is None, obstruction, None if least is None else _mark(ground, *least),
        _needed(ground, start, z[-1] - 0.5 * bend * whole**2, bend), clearance, straight + 0.5 * bend * s**2, ground,
        float(eye), float(target), bend,
    )  # fmt: skip


Found = tuple[int, float, float]
"""A piece, the fraction of it, and the clearance there."""


def _least(clearance: Array, known: NDArray[np.bool_], s: Array, bend: float) -> tuple[Found | None, Found | None]:
    """Where the line first meets the ground (None: nowhere), and where it is nearest to it or deepest below it."""
    f0, f1, gap = clearance[:-1], clearance[1:], np.diff(s)
    # On a piece: f(τ) = f0 + (f1 − f0) τ − bend/2 gap² τ (1 − τ).
    curl = 0.5 * bend * gap**2
    lowest = np.where(f1 < f0, 1.0, 0.0)
    bowl = curl > 0
    lowest[bowl] = np.clip(0.5 - 0.5 * (f1 - f0)[bowl] / curl[bowl], 0.0, 1.0)
    value = f0 + (f1 - f0) * lowest - curl * lowest * (1 - lowest)
    value = np.where(known, value, np.inf)
    blocked = np.flatnonzero(value < -LEAST)
    first = None
    if len(blocked):
        i = int(blocked[0])
        part = _enters(float(f0[i]), float(f1[i]), float(curl[i]), float(lowest[i]))
        first = (i, part, min(float(f0[i]), 0.0))
    inner = value.copy()
    if not len(blocked):  # the ends are the eye and the target, whose clearance does not count
        inner[0] = np.inf if lowest[0] == 0.0 else inner[0]
        inner[-1] = np.inf if lowest[-1] == 1.0 else inner[-1]
    if not np.isfinite(inner).any():
        return first, None
    j = int(np.argmin(inner))
    return first, (j, float(lowest[j]), float(value[j]))


def _enters(f0: float, f1: float, curl: float, lowest: float) -> float:
    """The fraction of a piece, at most ``lowest``, at which its clearance passes 0 downward."""
    if f0 <= 0.0:
        return 0.0
    slope = f1 - f0 - curl  # f(τ) = f0 + slope τ + curl τ²
    root = 2.0 * f0 / (-slope + math.sqrt(max(slope * slope - 4.0 * curl * f0, 0.0)))
    return min(max(root, 0.0), lowest)


def _mark(ground: Profile, piece: int, part: float, clearance: float) -> Mark:
    def between(values: Array) -> Any:
        return values[piece] + part * (values[piece + 1] - values[piece])

    point = between(ground.points)
    degrees = ground.places.lonlat(point[None])
    lon, lat = (None, None) if degrees is None else (float(v) for v in degrees[0])
    height, distance = float(between(ground.surface_heights)), float(between(ground.distance))
    return Mark(float(point[0]), float(point[1]), lon, lat, height, distance, float(clearance))


def _needed(ground: Profile, start: float, end: float, bend: float) -> float:
    """How far above the ground at the end a target must be to be visible from ``start`` (apparent heights)."""
    s, z = ground.distance, ground.surface_heights
    s0, s1, z0, z1 = s[:-1], s[1:], z[:-1], z[1:]
    tilt = (z1 - z0) / (s1 - s0)
    offset = z0 - tilt * s0 - start  # the ground is start + offset + tilt s − bend/2 s²
    steepest = -math.inf
    for at in (s0, s1, np.clip(np.sqrt(np.maximum(-2 * offset, 0) / bend), s0, s1) if bend > 0 else s1):
        ok = ground.known & (at > 0)
        if ok.any():
            steepest = max(steepest, float((offset[ok] / at[ok] + tilt[ok] - 0.5 * bend * at[ok]).max()))
    return max(0.0, float(start + steepest * s[-1] - end)) if math.isfinite(steepest) else 0.0
