"""Bodies and their ellipsoids: geodetic (longitude, latitude, height) ⇄ geocentric (ECEF) coordinates in float64.

Forward: EPSG Guidance Note 7-2, §4.1.1 (method 9602). Inverse: the closed solution of Vermeille (2002), "Direct
transformation from geocentric coordinates to geodetic coordinates", J. Geodesy 76, in the form that Karney (2011),
"Geodesics on an ellipsoid of revolution", appendix B, made stable everywhere (inside the body and on its axis too):
no iteration, no tolerance. Radii: WGS 84 (NGA TR8350.2); Moon and Mars as the IAU working group has them (Archinal et
al. 2018, "Report of the IAU Working Group on Cartographic Coordinates and Rotational Elements: 2015").

Units: degrees east and north, metres. Arrays are (..., 3) float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """An oblate ellipsoid of revolution, or a sphere.

    Attributes:
        name: of the body or the figure.
        a: equatorial radius, metres.
        f: flattening (a − b) / a, 0 for a sphere.
    """

    name: str
    a: float
    f: float

    def __post_init__(self) -> None:
        if not (self.a > 0 and math.isfinite(self.a) and 0 <= self.f < 1):
            raise ValueError(f"not an oblate ellipsoid: a = {self.a}, f = {self.f}")

    @property
    def b(self) -> float:
        """Polar radius, metres."""
        return self.a * (1 - self.f)

    @property
    def e2(self) -> float:
        """First eccentricity squared, f (2 − f)."""
        return self.f * (2 - self.f)

    @classmethod
    def of(cls, crs: CRS) -> Ellipsoid:
        """The ellipsoid of a CRS (that of its datum).

        Raises:
            ValueError: the CRS has none (a local engineering CRS).
        """
        found = crs.ellipsoid
        if found is None:
            raise ValueError(f"the CRS {crs.name!r} has no ellipsoid")
        inverse = found.inverse_flattening or 0.0
        return cls(found.name, found.semi_major_metre, 1 / inverse if inverse else 0.0)

    def radii(self, lat: ArrayLike) -> tuple[F64, F64]:
        """Radii of curvature (metres) at latitudes in degrees: in the meridian M, in the prime vertical N."""
        sine2 = np.sin(np.radians(np.asarray(lat, np.float64))) ** 2
        root = np.sqrt(1 - self.e2 * sine2)
        return self.a * (1 - self.e2) / root**3, self.a / root

    def degree_lengths(self, lat: ArrayLike) -> tuple[F64, F64]:
        """Metres in one degree of longitude and in one of latitude, on the surface at latitudes in degrees."""
        meridian, vertical = self.radii(lat)
        return np.radians(vertical * np.cos(np.radians(np.asarray(lat, np.float64)))), np.radians(meridian)

    def ecef(self, geodetic: ArrayLike) -> F64:
        """Geocentric X, Y, Z (metres), (..., 3), of longitude, latitude (degrees) and ellipsoidal height (metres)."""
        lon, lat, height = _columns(geodetic)
        lam, phi = np.radians(lon), np.radians(lat)
        cos_phi, sin_phi = np.cos(phi), np.sin(phi)
        normal = self.a / np.sqrt(1 - self.e2 * sin_phi**2)
        across = (normal + height) * cos_phi
        up = (normal * (1 - self.e2) + height) * sin_phi
        return np.stack([across * np.cos(lam), across * np.sin(lam), up], axis=-1)

    def geodetic(self, ecef: ArrayLike) -> F64:
        """Longitude, latitude (degrees) and height (metres), (..., 3), of geocentric X, Y, Z: the inverse of ``ecef``.

        On the axis the longitude is 0; at the centre of the body the latitude is taken as 90 (sphere: the same).
        """
        x, y, z = _columns(ecef)
        r = np.hypot(x, y)
        lon = np.where(r == 0, 0.0, np.arctan2(y, x))
        if self.f == 0:
            lat = np.where((r == 0) & (z == 0), np.pi / 2, np.arctan2(z, r))
            height = np.hypot(r, z) - self.a
        else:
            lat, height = self._meridian(r, z)
        return np.stack([np.degrees(lon), np.degrees(lat), height], axis=-1)

    def _meridian(self, r: F64, z: F64) -> tuple[F64, F64]:
        """Latitude (radians) and height in the meridian plane; the letters are Vermeille's and Karney's."""
        e2, e4, e2m = self.e2, self.e2**2, 1 - self.e2
        # Squares of what is smaller than any length would lose their digits: it is 0.
        r, z = (np.where(np.abs(v) < _NOTHING, np.copysign(0.0, v), v) for v in (r, z))
        p, q = (r / self.a) ** 2, e2m * (z / self.a) ** 2
        rho = (p + q - e4) / 6
        disc_s = e4 * p * q / 4
        with np.errstate(invalid="ignore", divide="ignore"):
            cube = rho**3
            disc = disc_s * (2 * cube + disc_s)
            t3 = disc_s + cube
            t = np.cbrt(t3 + np.copysign(np.sqrt(np.maximum(disc, 0)), t3))
            u_outside = rho + t + np.where(t != 0, rho**2 / t, 0)
            u_inside = rho + 2 * rho * np.cos(np.arctan2(np.sqrt(np.maximum(-disc, 0)), -t3) / 3)
            u = np.where(disc >= 0, u_outside, u_inside)
            v = np.sqrt(u**2 + e4 * q)
            uv = np.where(u < 0, e4 * q / (v - u), u + v)
            w = np.maximum(0, e2 * (uv - q) / (2 * v))
            k = uv / (np.sqrt(uv + w**2) + w)
            lat = np.arctan2(z / k, r / (k + e2))
            height = (1 - e2m / k) * np.hypot(k * r / (k + e2), z)
        # The disc about the centre in the equatorial plane, where two latitudes are equally near: take the northern.
        singular = (e4 * q == 0) & (rho <= 0)
        if np.any(singular):
            zz, xx = np.sqrt(np.maximum(e4 - p, 0) / e2m), np.sqrt(p)
            lat = np.where(singular, np.copysign(np.arctan2(zz, xx), np.where(z < 0, -1.0, 1.0)), lat)
            height = np.where(singular, -self.a * e2m * np.hypot(zz, xx) / e2, height)
        return lat, height


_NOTHING = 1e-80  # metres


def _columns(points: ArrayLike) -> tuple[F64, F64, F64]:
    array = np.asarray(points, np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"points must be (..., 3), not {array.shape}")
    return array[..., 0], array[..., 1], array[..., 2]


EARTH = Ellipsoid("WGS 84", 6378137.0, 1 / 298.257223563)
MOON = Ellipsoid("Moon (2015)", 1737400.0, 0.0)
MARS = Ellipsoid("Mars (2015)", 3396190.0, (3396190.0 - 3376200.0) / 3396190.0)
BODIES: dict[str, Ellipsoid] = {"earth": EARTH, "moon": MOON, "mars": MARS}
