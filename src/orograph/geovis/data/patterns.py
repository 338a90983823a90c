"""Patterns on the ground: how much of a texel lines, dots and triangles cover.

All are functions of a texel's place alone (x and y in texels, any shape) and of what is shown there, so that a legend's
swatch is painted by the same lines as the terrain. Coverage is 0 to 1, smooth over one texel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def covered(distance: NDArray[Any]) -> Array:
    """Coverage by the signed distance to a shape's outline, texels, negative inside."""
    return np.clip(0.5 - distance, 0.0, 1.0)


def hatched(x: Array, y: Array, pitch: float, share: NDArray[Any], turn: NDArray[Any] | float = 45.0) -> Array:
    """Lines ``pitch`` texels apart that cover ``share`` of the ground; ``turn``: degrees of what is across them."""
    across = x * np.cos(np.radians(turn)) + y * np.sin(np.radians(turn))
    return covered(np.abs(across / pitch - np.floor(across / pitch) - 0.5) * pitch - share * pitch / 2)


def lattice(x: Array, y: Array, pitch: float) -> tuple[Array, Array]:
    """The centre, in texels, of the sign that a texel belongs to: rows ``pitch`` apart, every other one shifted."""
    row = np.floor(y / pitch)
    shift = pitch / 2 * (row % 2)
    return (np.floor((x - shift) / pitch) + 0.5) * pitch + shift, (row + 0.5) * pitch


def dotted(x: Array, y: Array, pitch: float, share: NDArray[Any]) -> Array:
    """Dots on the lattice that cover ``share`` (up to 0.7) of the ground."""
    cx, cy = lattice(x, y, pitch)
    radius = pitch * np.sqrt(np.minimum(share, 0.7) / np.pi)
    return covered(np.hypot(x - cx, y - cy) - radius)


def triangle(dx: Array, dy: Array, radius: NDArray[Any]) -> Array:
    """Distance to an upright equilateral triangle's outline; ``radius``: from its middle to a corner, texels."""
    # Its three sides are radius / 2 from the middle; y grows downwards.
    sides = [dy, -dy / 2 + dx * np.sqrt(0.75), -dy / 2 - dx * np.sqrt(0.75)]
    return np.asarray(np.maximum.reduce(sides) - radius / 2)


def gauss(x: Array, y: Array, grain: int) -> Array:
    """Normal noise (mean 0, standard deviation 1), the same wherever a place is painted; constant over ``grain``².

    A hash of the place (Wang's, by multiplication and shifts in 32 bits) gives two even numbers, and Box & Muller 1958
    one normal one.
    """
    i, j = (np.floor(v / grain).astype(np.int64).astype(np.uint32) for v in (x, y))
    first = _hash(i * np.uint32(0x9E3779B1) ^ _hash(j))
    second = _hash(first ^ np.uint32(0x85EBCA6B))
    u, v = (first + 0.5) / 2.0**32, second / 2.0**32
    return np.asarray(np.sqrt(-2 * np.log(u)) * np.cos(2 * np.pi * v))


def _hash(n: NDArray[np.uint32]) -> NDArray[np.uint32]:
    n = (n ^ (n >> np.uint32(16))) * np.uint32(0x7FEB352D)
    n = (n ^ (n >> np.uint32(15))) * np.uint32(0x846CA68B)
    return n ^ (n >> np.uint32(16))
