"""Spherical caps: the area that two of them share.

A cap is a direction and an angular radius. Two caps of radii a and b, d apart,

- share the smaller one if d ≤ |a − b|;
- share a lens if |a − b| < d < a + b, whose area has a closed form (Tovchigrechko & Vakser 2001);
- share nothing otherwise.

``smooth_overlap`` replaces the lens by a smoothstep between the two ends, as Oat & Sander 2007 (sec. 4.1) do for speed:
the error is up to 0.04 of the sun's disc on an aperture's rim, and 0.12 for discs as wide as apertures. Radians and
steradians, scalars; for kernels and for Python.
"""

from __future__ import annotations

import math

from orograph._numba import shared

POINT = 1e-5
"""Radians below which a cap is visible fully or not at all, because the closed form would suffer from rounding."""


@shared
def cap_area(radius):
    """Solid angle of a cap."""
    return 2.0 * math.pi * (1.0 - math.cos(radius))


@shared
def exact_overlap(distance, a, b):
    """Solid angle that two caps of radii a, b ≤ π/2 share, their centres ``distance`` apart."""
    small = min(a, b)
    if distance >= a + b:
        return 0.0
    if distance <= abs(a - b):
        return cap_area(small)
    if small < POINT:
        return cap_area(small) if distance <= max(a, b) else 0.0
    ca, cb, cd = math.cos(a), math.cos(b), math.cos(distance)
    sa, sb, sd = math.sin(a), math.sin(b), math.sin(distance)
    lune = math.acos(min(max((cd - ca * cb) / (sa * sb), -1.0), 1.0))
    at_a = math.acos(min(max((cb - cd * ca) / (sd * sa), -1.0), 1.0))
    at_b = math.acos(min(max((ca - cd * cb) / (sd * sb), -1.0), 1.0))
    return min(max(2.0 * (math.pi - lune - at_a * ca - at_b * cb), 0.0), cap_area(small))


@shared
def smooth_overlap(distance, a, b):
    """``exact_overlap`` with a smoothstep for the lens."""
    small, least = min(a, b), abs(a - b)
    if distance >= a + b or small <= 0.0:
        return 0.0
    if distance <= least:
        return cap_area(small)
    x = 1.0 - (distance - least) / (a + b - least)
    return cap_area(small) * x * x * (3.0 - 2.0 * x)
