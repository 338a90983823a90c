"""Irradiance under a cloudless sky: the clear-sky model of the European Solar Radiation Atlas, as in r.sun.

Sources: Rigollier, Bauer & Wald 2000, *Solar Energy* 68(1); Hofierka & Šúri 2002, "The solar radiation model for open
source GIS" (r.sun), eqs. 1–17 and 21–26. The haze of the air is the Linke turbidity T (at air mass 2): how many clean
and dry atmospheres would weaken the sun as much; 2 is very clean and cold, 3 clean and warm, 4–6 moist or urban; 0 is
no atmosphere at all. The beam grows with height above the sea (less air); the light of the sky does not, in this model.

Units: W/m², angles in degrees, heights in metres.
"""

from __future__ import annotations

import datetime
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SOLAR_CONSTANT = 1367.0
"""W/m² at the Earth's mean distance (WMO), as the model was fitted with."""

SCALE_HEIGHT = 8434.5
"""Metres over which the pressure of the air falls to 1/e."""


def extraterrestrial(when: datetime.datetime) -> float:
    """Irradiance of a surface facing the sun outside the atmosphere (Hofierka & Šúri 2002, eqs. 1–2)."""
    day = 2 * math.pi * when.timetuple().tm_yday / 365.25
    return SOLAR_CONSTANT * (1 + 0.03344 * math.cos(day - 0.048869))


def air_mass(altitude: ArrayLike, height: ArrayLike) -> Array:
    """Relative optical air mass at an apparent altitude (Kasten & Young 1989) and a height (eqs. 5–6)."""
    h = np.maximum(np.asarray(altitude, np.float64), 0.0)
    pressure = np.exp(-np.asarray(height, np.float64) / SCALE_HEIGHT)
    return np.asarray(pressure / (np.sin(np.radians(h)) + 0.50572 * (h + 6.07995) ** -1.6364))


def rayleigh(mass: ArrayLike) -> Array:
    """Optical thickness of a clean, dry atmosphere per unit of air mass (Kasten 1996; eqs. 8–9)."""
    m = np.asarray(mass, np.float64)
    near = np.minimum(m, 20.0)
    thin = 6.6296 + near * (1.7513 + near * (-0.1202 + near * (0.0065 - near * 0.00013)))
    return np.asarray(1.0 / np.where(m <= 20.0, thin, 10.4 + 0.718 * m))


def beam(normal: ArrayLike, altitude: ArrayLike, height: ArrayLike, turbidity: float) -> Array:
    """Irradiance by the sun's beam of a surface that faces it at the ground (eq. 3).

    Args:
        normal: outside the atmosphere. altitude: of the sun, apparent. height: of the ground. turbidity: Linke's T.
    """
    mass = air_mass(altitude, height)
    return np.asarray(np.asarray(normal) * np.exp(-0.8662 * turbidity * mass * rayleigh(mass)))


def diffuse(normal: ArrayLike, altitude: ArrayLike, turbidity: float) -> Array:
    """Irradiance of level, open ground by the sky (eqs. 21–25); 0 while the sun's geometric altitude is not above 0."""
    if turbidity == 0:
        return np.zeros(np.broadcast(normal, altitude).shape)
    t = turbidity
    zenith = -0.015843 + t * (0.030543 + t * 0.0003797)
    a1 = 0.26463 + t * (-0.061581 + t * 0.0031408)
    if a1 * zenith < 0.0022:
        a1 = 0.0022 / zenith
    a2 = 2.04020 + t * (0.018945 - t * 0.011161)
    a3 = -1.3025 + t * (0.039231 + t * 0.0085079)
    up = np.sin(np.radians(np.asarray(altitude, np.float64)))
    sky = np.maximum(np.asarray(normal) * zenith * (a1 + up * (a2 + up * a3)), 0.0)
    return np.asarray(np.where(up > 0.0, sky, 0.0))
