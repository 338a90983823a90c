"""Local frames: east, north and up in the plane that touches the ellipsoid under an origin (a topocentric frame).

EPSG Guidance Note 7-2, §4.1.2 (methods 9836 and 9837): a rotation about the origin, nothing else, so distances and
angles are those of space. ``up`` is the ellipsoid's normal: a point d metres away on the ground lies about d²/2R
below the plane. Units: metres, degrees; arrays (..., 3) float64.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from orograph.geo.ellipsoid import EARTH, F64, Ellipsoid


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """East-north-up about an origin.

    Attributes:
        lon, lat: of the origin, degrees; height: above the ellipsoid, metres.
        ellipsoid: of the body.
    """

    lon: float
    lat: float
    height: float = 0.0
    ellipsoid: Ellipsoid = EARTH
    _origin: F64 = field(init=False, repr=False, compare=False)
    _axes: F64 = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        lam, phi = np.radians(self.lon), np.radians(self.lat)
        sin_l, cos_l, sin_p, cos_p = np.sin(lam), np.cos(lam), np.sin(phi), np.cos(phi)
        axes = [[-sin_l, cos_l, 0], [-sin_p * cos_l, -sin_p * sin_l, cos_p], [cos_p * cos_l, cos_p * sin_l, sin_p]]
        object.__setattr__(self, "_axes", np.array(axes, np.float64))
        object.__setattr__(self, "_origin", self.ellipsoid.ecef([self.lon, self.lat, self.height]))

    @property
    def axes(self) -> F64:
        """(3, 3): the unit vectors east, north and up as rows, in geocentric coordinates."""
        return self._axes.copy()

    def from_ecef(self, ecef: ArrayLike) -> F64:
        """East, north, up (..., 3), metres, of geocentric X, Y, Z."""
        # Not by matmul: BLAS may sum in another order for another number of points.
        offset = np.asarray(ecef, np.float64) - self._origin
        return np.stack([(offset * axis).sum(axis=-1) for axis in self._axes], axis=-1)

    def to_ecef(self, enu: ArrayLike) -> F64:
        """Geocentric X, Y, Z (..., 3), metres, of east, north, up: the inverse of ``from_ecef``."""
        local = np.asarray(enu, np.float64)
        return np.stack([(local * axis).sum(axis=-1) for axis in self._axes.T], axis=-1) + self._origin

    def from_geodetic(self, geodetic: ArrayLike) -> F64:
        """East, north, up of longitude, latitude (degrees) and ellipsoidal height (metres)."""
        return self.from_ecef(self.ellipsoid.ecef(geodetic))

    def to_geodetic(self, enu: ArrayLike) -> F64:
        """Longitude, latitude (degrees) and ellipsoidal height (metres) of east, north, up."""
        return self.ellipsoid.geodetic(self.to_ecef(enu))
