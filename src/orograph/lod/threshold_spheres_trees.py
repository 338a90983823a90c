"""The data of Blow's kernels: two trees of triangles by place, the lists of waiting ones, and a frame's motion.

``threshold_spheres_pass`` says how; metres of stretched space, radians, and fixed-point units of both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

DONE, MISSED, GROW, PAUSED = 0, 1, 2, 3
"""Why kernels return."""

PARENT, CHILD, LEVEL = 3, 4, 5
"""Links of a triangle, behind those of ``radix_heap``: above; the first of two below, −1: none; level."""

TOP, FREE, NOW, TURNED, VISITS, SPLITS, MERGES, STEPS = range(8)
"""Counts: height of the stack; free pairs; the way and the turn, in units; triangles looked at, splits, merges; and all
steps of an update, which are limited."""

X, Y, Z, RADIUS, REACH, ERROR, COLOR, NUMBERS = range(8)
"""Of a triangle's diamond: its vertex (stretched metres); radius of its nested sphere; of its threshold sphere (∞:
always split in view, −1: never split, NaN: not yet known; 1 if the metric has no such spheres); its errors."""

RADIANS = 2.0**-34
"""Radians per unit of turn."""


class Frame(NamedTuple):
    """A frame's motion and constants, besides the camera.

    Attributes:
        eye: east, north, up, stretched metres. origin: east and north of the first sample; affine: metres east per
            column and row, north per column and row.
        way, turn: of the eye and of the axis of view so far, metres and radians; moved, turned: since the last frame.
        unit: metres per unit of way.
        reach: of threshold spheres, metres per metre of height. color_reach: of colored diamonds, in radii. Both 0 in
            a plan.
        slack: metres per level.
        secant: 1 / cos of the angle of the picture's corner.
    """

    eye: tuple[float, float, float]
    origin: tuple[float, float]
    affine: tuple[float, float, float, float]
    way: float
    turn: float
    moved: float
    turned: float
    unit: float
    reach: float
    color_reach: float
    slack: float
    secant: float


class Nodes(NamedTuple):
    """The two trees of triangles, by place.

    Attributes:
        corners: int64 (places, 3), heights: float32 (places, 4): see ``lod.bisection``.
        numbers: float64 (places, 7): the diamond, see ``X`` and following; REACH is NaN before it is known.
        due: int64 (places, 2), the way and the turn at which to look again.
        shown: uint8 (places,), whether there is surface.
        links: int32 (places, 6), of those that wait for a way; turning: int32 (places, 3), for a turn (``radix_heap``).
        free: int32 (places / 2,), first places of pairs not in use.
    """

    corners: NDArray[np.int64]
    heights: NDArray[np.float32]
    numbers: NDArray[np.float64]
    due: NDArray[np.int64]
    shown: NDArray[np.uint8]
    links: NDArray[np.int32]
    turning: NDArray[np.int32]
    free: NDArray[np.int32]


class Lists(NamedTuple):
    """The heads of the lists of those that wait for a way, and for a turn: int32 (LISTS,) each."""

    ways: NDArray[np.int32]
    turns: NDArray[np.int32]
