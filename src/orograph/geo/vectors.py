"""Vectors of three plain numbers: a camera asks for so few that arrays would cost more than the arithmetic."""

from __future__ import annotations

import math
from functools import lru_cache

Vector = tuple[float, float, float]


def cross(a: Vector, b: Vector) -> Vector:
    (p, q, r), (x, y, z) = a, b
    return q * z - r * y, r * x - p * z, p * y - q * x


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(a: Vector) -> float:
    return math.sqrt(dot(a, a))


def unit(a: Vector) -> Vector:
    size = length(a)
    return a[0] / size, a[1] / size, a[2] / size


@lru_cache(maxsize=16)  # a frame's parts all ask for those of its camera
def camera_axes(
    eye: Vector, target: Vector, up: Vector, plan: bool, exaggeration: float
) -> tuple[Vector, Vector, Vector]:  # fmt: skip
    """Right, up and forward of a camera, in stretched space."""
    (x, y, z), (u, v, w) = eye, target
    forward = unit((u - x, v - y, (w - z) * exaggeration))
    if plan:
        heading = up[0], up[1], 0.0
        if length(heading) < 1e-9 * max(1.0, length(up)):
            heading = forward[0], forward[1], 0.0
        up = heading if length(heading) >= 1e-9 else (0.0, 1.0, 0.0)
        forward = 0.0, 0.0, -1.0
    right = cross(forward, up)
    if length(right) < 1e-9 * length(up):  # looking along up: north is up in the picture, or else the zenith
        right = cross(forward, (0.0, 1.0, 0.0))
        if length(right) < 1e-9:
            right = cross(forward, (0.0, 0.0, 1.0))
    right = unit(right)
    return right, cross(right, forward), forward
