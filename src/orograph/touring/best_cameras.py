"""The candidate cameras of a best view: all look at the target's middle, from *places* around it.

A place is at an azimuth and a ground distance from the middle. Above it are cameras at several heights: those that look
down at given pitches, and those at given heights above the ground; each with every field of view. The ground that hides
a piece of the target from a place is found once for all heights (``best_search``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.measuring.ground import heights
from orograph.store.terrain import Terrain
from orograph.touring.best_target import Target
from orograph.viewpoint import View

Array = NDArray[np.float64]

PITCHES = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0)
FITS = (0.75, 1.0, 1.5, 2.0, 3.0)
"""Default distances, in multiples of the one from which the whole target just fits into the picture."""
LEAST_RADIUS = 20.0
"""Samples: a smaller target is treated as if it were this large."""
MOST = 10_000_000


@dataclass(frozen=True, slots=True)
class Cameras:
    """Cameras, place by place.

    Attributes:
        eyes: (m, 3) in the terrain's CRS. fov: (m,) degrees, vertical.
        place: (places, 2) easting and northing. first: (places + 1,) the first camera of each; a place's cameras follow
            one another.
        middle: (3,) where they look. size: (width, height), pixels. radius: of the target, metres.
    """

    eyes: Array
    fov: Array
    place: Array
    first: NDArray[np.int64]
    middle: Array
    size: tuple[int, int]
    radius: float

    def __len__(self) -> int:
        return len(self.eyes)

    def view(self, number: int) -> View:
        """A camera as a view."""
        eye, middle = (tuple(float(v) for v in p) for p in (self.eyes[number], self.middle))
        return View(eye, middle, fov_y=float(self.fov[number]), width=self.size[0], height=self.size[1])  # type: ignore[arg-type]

    def numbers(self) -> Array:
        """(14, m), for ``best_kernels``.

        These are the eye; the directions right (its third is 0), up and forward; the tangents of half the picture's
        width and height; and the distance from which the whole target is in it.
        """
        forward = (self.middle - self.eyes).T
        forward = forward / np.sqrt((forward**2).sum(0))
        across = np.sqrt((forward[:2] ** 2).sum(0))
        right = np.stack([forward[1], -forward[0]]) / across
        up = np.stack([right[1] * forward[2], -right[0] * forward[2], across])
        tall = np.tan(np.radians(self.fov) / 2)
        wide = tall * self.size[0] / self.size[1]
        fitting = self.radius / np.sin(np.arctan(np.minimum(wide, tall)))
        return np.concatenate([self.eyes.T, right, up, forward, [wide, tall, fitting]])


def cameras(
    terrain: Terrain, target: Target, size: tuple[int, int], *, azimuths: int | Sequence[float] = 72,
    pitches: Sequence[float] = PITCHES, above: Sequence[float] = (), distances: Sequence[float] = (),
    fovs: Sequence[float] = (40.0,), clearance: float = 2.0,
) -> Cameras:  # fmt: skip
    """All allowed cameras.

    Args:
        azimuths: sides of the target where cameras stand, degrees clockwise from north; a number: that many, evenly.
        pitches: degrees by which cameras look down. above: metres above the ground they stand on.
        distances: metres over the ground, from the target's middle; none: ``FITS``.
        fovs: vertical fields of view, degrees. clearance: minimum height of an eye above the ground, metres.

    Raises:
        UsageError: a number is out of its range, or no camera is above the ground.
    """
    _check(azimuths, pitches, above, distances, fovs, clearance)
    spread = np.arange(azimuths) * 360.0 / azimuths if isinstance(azimuths, int) else np.asarray(azimuths, np.float64)
    middle, radius = target.middle, max(target.radius, LEAST_RADIUS * max(terrain.grid.spacing))
    half = min(math.radians(min(fovs)) / 2, math.atan(math.tan(math.radians(min(fovs)) / 2) * size[0] / size[1]))
    far = np.asarray(distances or [radius / math.sin(half) * f for f in FITS], np.float64)
    if len(spread) * len(far) * (len(pitches) + len(above)) * len(fovs) > MOST:
        raise UsageError(f"These are more than {MOST:,} cameras.", remedy="Allow fewer azimuths, pitches or distances.")
    a, d = (v.ravel() for v in np.meshgrid(np.radians(spread), far, indexing="ij"))
    place = middle[:2] + np.column_stack([np.sin(a) * d, np.cos(a) * d])
    ground = _ground(terrain, place)
    z = np.column_stack([
        middle[2] + d[:, None] * np.tan(np.radians(np.asarray(pitches, np.float64))),
        ground[:, None] + np.asarray(above, np.float64),
    ])  # fmt: skip
    allowed = ~(z < ground[:, None] + clearance) & np.isfinite(z)
    if not allowed.any():
        raise UsageError(
            f"None of the {z.size * len(fovs)} cameras is above the ground, by {clearance:g} m.", path=terrain.name,
            remedy="Allow steeper `pitches`, larger `distances`, or `heights` above the ground.",
        )  # fmt: skip
    count = allowed.sum(1) * len(fovs)
    first = np.concatenate([[0], np.cumsum(count[count > 0])]).astype(np.int64)
    which, level = np.nonzero(allowed)
    eyes = np.repeat(np.column_stack([place[which], z[which, level]]), len(fovs), axis=0)
    fov = np.tile(np.asarray(fovs, np.float64), len(which))
    return Cameras(eyes, fov, place[count > 0], first, middle, size, radius)


def _check(
    azimuths: int | Sequence[float], pitches: Sequence[float], above: Sequence[float], distances: Sequence[float],
    fovs: Sequence[float], clearance: float,
) -> None:  # fmt: skip
    """Raise UsageError for values out of range."""
    if (azimuths if isinstance(azimuths, int) else len(azimuths)) < 1:
        raise UsageError("`azimuths` must have at least one.")
    if not isinstance(azimuths, int) and not np.isfinite(azimuths).all():
        raise UsageError("`azimuths` must be directions in degrees, finite numbers.")
    if not len(pitches) and not len(above):
        raise UsageError("Give `pitches` or `heights`: without either there are no cameras.")
    if not all(-90 < p < 90 for p in pitches):
        raise UsageError("`pitches` must be downward angles between −90 and 90 degrees, both excluded.")
    if not all(0 < d < math.inf for d in distances):
        raise UsageError("`distances` must be in metres, more than 0.")
    if not all(0 <= h < math.inf for h in (*above, clearance)):
        raise UsageError("`heights` and `clearance` must be metres above the ground, 0 or more.")
    if not len(fovs) or not all(0 < f < 180 for f in fovs):
        raise UsageError("`fov` must be an angle in degrees between 0 and 180.")


def _ground(terrain: Terrain, place: Array) -> Array:
    """Heights (n,) of the ground, NaN outside it."""
    rows, cols = terrain.grid.shape
    col, row = terrain.grid.index(place[:, 0], place[:, 1])
    on = (col >= 0) & (col <= cols - 1) & (row >= 0) & (row <= rows - 1)
    out = np.full(len(place), np.nan)
    out[on] = heights(terrain, col[on], row[on])
    return out
