"""Vectors of three plain numbers: a camera asks for so few that arrays would cost more than the arithmetic."""

from __future__ import annotations

import math

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
