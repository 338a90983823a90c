"""Light: the part of the sun's disc above a horizon, and the colours of sun and sky.

Angles in degrees; colours are linear RGB, relative to the same light at a sun 45° high; pure functions on arrays.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ZENITH_DEPTH = np.array([0.085, 0.145, 0.275])
"""Optical depth of a clear atmosphere towards the zenith, per colour: Rayleigh and thin haze (Bird & Hulstrom 1981)."""


def disc_fraction(horizon: ArrayLike, altitude: float, diameter: float) -> Array:
    """The part of a disc of light above a level horizon line.

    Args:
        horizon: angle of the horizon in the disc's azimuth, any shape.
        altitude: of the disc's centre. diameter: of the disc; 0 is a point of light.

    Returns:
        float64 in [0, 1]: the area of the circular segment above the chord over the disc's.
    """
    horizon = np.asarray(horizon, np.float64)
    if diameter <= 0:
        return (altitude > horizon).astype(np.float64)
    d = np.clip((horizon - altitude) / (diameter / 2), -1.0, 1.0)
    return np.asarray((np.arccos(d) - d * np.sqrt(1.0 - d * d)) / math.pi)


def air_mass(altitude: float) -> float:
    """The air that a sunbeam crosses, relative to the zenith (Kasten & Young 1989); at most that at the horizon."""
    h = max(altitude, 0.0)
    return 1.0 / (math.sin(math.radians(h)) + 0.50572 * math.pow(h + 6.07995, -1.6364))


def sun_color(altitude: float) -> Array:
    """Colour (3,) of direct sunlight, with green at 1 down to a low sun: an eye or a camera adapts to its strength."""
    color = np.exp(-ZENITH_DEPTH * (air_mass(altitude) - air_mass(45.0)))
    strength = color[1]
    night = min(max((altitude + 0.27) / 0.54, 0.0), 1.0)  # the disc sets
    return np.asarray(np.array([1.02, 1.0, 0.95]) * (color / strength) ** 0.7 * strength**0.25 * night)


def sky_color(altitude: float) -> Array:
    """Colour (3,) of a clear sky's light on level ground, with the sun ``altitude`` degrees high."""
    high = min(max((altitude + 6.0) / 51.0, 0.0), 1.0)
    blue, dusk = np.array([0.86, 0.97, 1.20]), np.array([0.80, 0.90, 1.25])
    return np.asarray((blue * high + dusk * (1 - high)) * (0.25 + 0.75 * high**0.5))
