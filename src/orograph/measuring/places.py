"""Places of measurements: terrain coordinates, samples, degrees, and the true length of a grid metre.

A map projection stretches: a metre on the grid is not a metre on the ground (0.04 % in the middle of a UTM zone, a
factor of two in Web Mercator at 60°). The stretch at a point is the *metric* G = DᵀD of the map from the grid to
geocentric space, D (3, 2) its derivative, by central differences: a step d on the grid is sqrt(dᵀ G d) metres on the
ellipsoid, in any projection, at the poles too. At height h above the ellipsoid all is longer by 1 + h / R, R the mean
radius (2a + b) / 3. Heights are used as they are; heights above a geoid make that factor wrong by at most 2e-5. A
terrain without CRS is a plane of true metres.

Units: metres, degrees; arrays are float64. Source: Snyder (1987), *Map Projections: A Working Manual*, §4 (distortion);
Torge & Müller (2012), *Geodesy*, §4.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Geod

from orograph.dem.area import lonlat_bounds
from orograph.errors import UsageError
from orograph.geo.ellipsoid import Ellipsoid
from orograph.geo.local import LocalFrame
from orograph.geo.operations import same_body
from orograph.geo.transform import transformer
from orograph.several import numbers
from orograph.store.opening import terrain as opened

Array = NDArray[np.float64]
Move = Callable[[ArrayLike, ArrayLike], tuple[Array, Array]]

STEP = 30.0
"""Step of the finite differences for G, metres: both their rounding and their curvature are below 1e-10."""
BORDER = 1e-6
"""Samples beyond the border that count as rounding, and as on it."""
WGS84 = CRS.from_epsg(4326)


@lru_cache(32)
def _way(source: CRS | None, target: CRS | None) -> Move:
    """``transformer``, cached: PROJ takes milliseconds to find an operation."""
    return transformer(source, target)


class Places:
    """The places of a terrain.

    Args:
        terrain: at least 2 × 2 samples.

    Attributes:
        ellipsoid: of its CRS; None without one.
        degrees: the CRS of longitudes and latitudes: WGS 84, another body's own; None without one.

    Raises:
        UsageError: the terrain has no surface.
    """

    def __init__(self, terrain: Any) -> None:
        terrain = opened(terrain, called="Places")
        rows, cols = terrain.grid.shape
        if rows < 2 or cols < 2:
            raise UsageError(f"{terrain.name} has {rows} × {cols} samples: there is no surface to measure.")
        self.terrain, self.grid = terrain, terrain.grid
        crs = terrain.grid.crs
        self.ellipsoid = None if crs is None else Ellipsoid.of(crs)
        self.degrees = None if crs is None else WGS84 if same_body(crs, WGS84) else crs.geodetic_crs

    @cached_property
    def geod(self) -> Geod | None:
        """Geodesics of the ellipsoid (Karney 2013); None without a CRS."""
        body = self.ellipsoid
        return None if body is None else Geod(a=body.a, f=body.f)

    @property
    def linear(self) -> Array:
        """(2, 2) metres east and north on the grid per column and per row."""
        linear: Array = self.grid.linear
        return linear

    # ---- coordinates ---------------------------------------------------------------------------------------------

    def points(self, given: ArrayLike, *, least: int = 1, what: str = "A point", lonlat: bool = False) -> Array:
        """Points (n, 2) = easting, northing, checked to be numbers and on the terrain.

        Args:
            given: (n, 2) numbers, or a text for each point: "-71.3,44.2".
            lonlat: they are given as longitude, latitude in degrees.

        Raises:
            UsageError: they are not, or there are fewer than ``least``.
        """
        try:
            if isinstance(given, str):
                given = [given]
            if isinstance(given, Sequence) and given and all(isinstance(one, str) for one in given):
                given = [numbers(one, "point") for one in given]
            found = np.atleast_2d(np.asarray(given, np.float64))
        except (TypeError, ValueError, UsageError) as error:
            raise UsageError(f"{what} must be easting and northing, two numbers each, not {given!r}.") from error
        if found.ndim != 2 or found.shape[1] != 2 or not np.isfinite(found).all():
            raise UsageError(f"{what} must be easting and northing, two finite numbers each, not {given!r}.")
        if len(found) < least:
            raise UsageError(f"{what} needs at least {least} points, not {len(found)}.")
        found = self.of_lonlat(found) if lonlat else found
        self.samples(found)
        return found

    def samples(self, points: Array) -> Array:
        """Sample coordinates (n, 2) = column, row of points (n, 2); those beyond the border by rounding count as on it.

        Raises:
            UsageError: a point is not on the terrain.
        """
        rows, cols = self.grid.shape
        at = np.stack(self.grid.index(points[:, 0], points[:, 1]), axis=-1)
        last = np.array([cols - 1.0, rows - 1.0])
        outside = ((at < -BORDER) | (at > last + BORDER)).any(axis=1)
        if outside.any():
            first = int(np.argmax(outside))
            self._refuse(points[first], at[first])
        return np.asarray(np.clip(at, 0.0, last))

    def _refuse(self, point: Array, at: Array) -> NoReturn:
        """Raise UsageError for a point (2,) outside the terrain, ``at`` in sample coordinates.

        The message says how far outside it is, and which point inside is nearest.
        """
        rows, cols = self.grid.shape
        last = np.array([cols - 1.0, rows - 1.0])
        off = point - np.stack(self.grid.xy(*np.clip(at, 0.0, last)))
        ways = [
            f"{_far(abs(metres))} {names[int(metres < 0)]}"
            for metres, names in zip(off, (("east", "west"), ("north", "south")))
            if abs(metres) > 1e-6 * np.abs(off).max()
        ]
        x, y = self.grid.xy([0, last[0], 0, last[0]], [0, 0, last[1], last[1]])
        raise UsageError(
            f"The point {point[0]:.10g}, {point[1]:.10g} lies {' and '.join(ways)} of {self.terrain.name}, whose "
            f"surface reaches from {x.min():.10g}, {y.min():.10g} to {x.max():.10g}, {y.max():.10g}"
            f"{self._degrees()}. The nearest point of it is {self._nearest(at)}.",
            remedy=self._remedy(point),
        )

    def _remedy(self, point: Array) -> str:
        """The remedy for a point outside: if it is on the terrain as degrees, it was probably meant in degrees."""
        how = "with `lonlat=True`."
        plain = f"Give easting, northing in the terrain's CRS, or longitude, latitude {how}"
        if self._holds(point):
            return f"As longitude, latitude it would lie there: give it so {how}"
        if self._holds(point[::-1]):
            return f"As latitude, longitude it would lie there: give longitude, latitude {how}"
        degrees = self.lonlat(point[None])
        if degrees is not None and self._holds(degrees[0, ::-1]):
            return "The other way round it would lie there: longitude comes first, then latitude."
        return plain

    def _holds(self, degrees: Array) -> bool:
        """Whether a longitude and latitude (2,) lie on the terrain."""
        if self.grid.crs is None or not (abs(degrees[0]) <= 360 and abs(degrees[1]) <= 90):
            return False
        try:
            at = np.stack(self.grid.index(*self.of_lonlat([degrees]).T), axis=-1)
        except UsageError:
            return False
        rows, cols = self.grid.shape
        return bool((at > -1).all() and (at < [cols, rows]).all())

    def _nearest(self, at: Array) -> str:
        """The point of the surface nearest to a place (2,) in sample coordinates, in both systems.

        It is moved inwards so that the rounded numbers are still on the surface.
        """
        rows, cols = self.grid.shape
        spacing = np.array(self.grid.spacing)
        digits = 2 + max(0, math.ceil(-math.log10(spacing.min())))
        last = np.array([cols - 1.0, rows - 1.0])
        inward = np.minimum(10.0**-digits / spacing, last / 2)
        point = np.stack(self.grid.xy(*np.clip(at, inward, last - inward)))
        degrees = self.lonlat(point[None])
        written = f"{point[0]:.{digits}f},{point[1]:.{digits}f}"
        if degrees is None or not np.isfinite(degrees).all():
            return written
        lon, lat = degrees[0]
        return f"{written} (longitude {lon:.{digits + 6}f}, latitude {lat:.{digits + 6}f})"

    def _degrees(self) -> str:
        found = lonlat_bounds(self.grid)
        if found is None:
            return ""
        west, south, east, north = found
        return f" (longitudes {west:.6g} to {east:.6g}, latitudes {south:.6g} to {north:.6g})"

    def lonlat(self, points: Array) -> Array | None:
        """Longitude and latitude (n, 2) of points (n, 2), degrees; None without a CRS."""
        if self.degrees is None:
            return None
        return np.stack(_way(self.grid.crs, self.degrees)(points[..., 0], points[..., 1]), axis=-1)

    def of_lonlat(self, degrees: ArrayLike) -> Array:
        """Points (n, 2) of longitudes and latitudes (n, 2).

        Raises:
            UsageError: there is no CRS, or a place cannot be expressed in it.
        """
        if self.degrees is None:
            raise UsageError(
                f"{self.terrain.name} has no CRS, so longitudes and latitudes cannot be located on it.",
                remedy="Give easting, northing, or the CRS with `assume_crs`.",
            )
        given = np.atleast_2d(np.asarray(degrees, np.float64))
        found = np.stack(_way(self.degrees, self.grid.crs)(given[:, 0], given[:, 1]), axis=-1)
        bad = ~np.isfinite(found).all(axis=1) | (np.abs(given[:, 1]) > 90)
        if bad.any():
            lon, lat = given[int(np.argmax(bad))]
            raise UsageError(
                f"There is no longitude {lon:.10g}, latitude {lat:.10g} in {self.grid.crs and self.grid.crs.name}.",
                remedy="Longitude comes first, then latitude, in degrees.",
            )
        return found

    # ---- true metres ---------------------------------------------------------------------------------------------

    @cached_property
    def radius(self) -> float:
        """Mean radius (2a + b) / 3, metres; infinite without a CRS."""
        body = self.ellipsoid
        return math.inf if body is None else (2 * body.a + body.b) / 3

    def gauss_radius(self, point: Array) -> float:
        """Gauss's radius of curvature sqrt(M N) at a point (2,), metres; the Earth's mean radius without a CRS."""
        if self.ellipsoid is None:
            return 6_371_008.8
        meridian, vertical = self.ellipsoid.radii(self.geodetic(point[None])[0, 1])
        return float(np.sqrt(meridian * vertical))

    def metric(self, points: Array) -> Array:
        """G (n, 2, 2) at points (n, 2): the square of a grid step's length on the ellipsoid is dᵀ G d."""
        if self.ellipsoid is None:
            return np.broadcast_to(np.eye(2), (len(points), 2, 2)).copy()
        d = self._derivative(points)
        return np.asarray(np.einsum("nki,nkj->nij", d, d))

    def jacobian(self, point: Array) -> Array:
        """(2, 2): true metres east and north on the ellipsoid per grid metre east and north at a point (2,)."""
        if self.ellipsoid is None:
            return np.eye(2)
        lon, lat = self.geodetic(point[None])[0]
        axes = LocalFrame(float(lon), float(lat), 0.0, self.ellipsoid).axes
        return np.asarray(axes[:2] @ self._derivative(point[None])[0])

    def ecef(self, points: Array, heights: Array) -> Array:
        """Places in space (n, 3), metres: geocentric, or unchanged without a CRS."""
        if self.ellipsoid is None:
            return np.asarray(np.column_stack([points, heights]))
        return np.asarray(self.ellipsoid.ecef(np.column_stack([self.geodetic(points), heights])))

    def geodetic(self, points: Array, strict: bool = True) -> Array:
        """Longitude and latitude (n, 2) on the CRS's own datum.

        Raises:
            UsageError: a point has none (it lies where the projection does not reach); not ``strict``: inf.
        """
        crs = self.grid.crs
        assert crs is not None
        found = np.stack(_way(crs, crs.geodetic_crs)(points[:, 0], points[:, 1]), axis=-1)
        if strict and not np.isfinite(found).all():
            raise UsageError(
                f"A place on {self.terrain.name} has no longitude and latitude in {crs.name}.",
                remedy="The terrain's CRS is used outside its area: build it in another one (`crs`).",
            )
        return found

    def _derivative(self, points: Array) -> Array:
        """D (n, 3, 2)."""
        assert self.ellipsoid is not None
        moved = points[:, None, :] + STEP * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        degrees = self.geodetic(moved.reshape(-1, 2))
        space: Array = self.ellipsoid.ecef(np.column_stack([degrees, np.zeros(len(degrees))])).reshape(
            len(points), 4, 3
        )
        return np.stack([space[:, 0] - space[:, 1], space[:, 2] - space[:, 3]], axis=-1) / (2 * STEP)


def _far(metres: float) -> str:
    return f"{metres:.6g} m" if metres < 1e5 else f"{metres / 1000:,.0f} km"


def lift(places: Places, heights: Array) -> Array:
    """1 + h / R: how much longer a metre is at a height than on the ellipsoid; 1 where the height is missing."""
    factor = 1.0 + np.asarray(heights, np.float64) / places.radius
    return np.asarray(np.where(np.isnan(factor), 1.0, factor))
