"""The flat coordinate system of a terrain: projected, in metres, with as little distortion as the area allows.

A terrain is metric: slopes, light and distances are wrong in degrees. A projected CRS in metres is kept; one in feet is
rewritten with metre axes, which moves no point. Geographic coordinates go to their UTM zone as long as its scale is
true within ``UTM_LIMIT`` over the whole area, else to the *conformal* projection (angles and thus slopes and light stay
true) with the least scale error there: Lambert's conic with standard parallels at 1/6 and 5/6 of the latitudes (Snyder,
*Map Projections: A Working Manual*, USGS PP 1395, p. 104), transverse Mercator, Mercator or stereographic, centred on
the area, on the source's own datum or body. Where even the best is off by more than ``FLAT_LIMIT`` the area is not
flat. Units: degrees, metres; scale error = |k − 1|.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Proj
from pyproj.crs import ProjectedCRS
from pyproj.crs.coordinate_operation import (
    LambertConformalConic2SPConversion,
    MercatorAConversion,
    PolarStereographicAConversion,
    StereographicConversion,
    TransverseMercatorConversion,
    UTMConversion,
)
from pyproj.exceptions import ProjError

from orograph.errors import ReadError

UTM_LIMIT = 0.0025
FLAT_LIMIT = 0.10
GOOD_ENOUGH = 0.0005

Degrees = NDArray[np.float64]

# UTM zones with EPSG codes of their own: geographic CRS -> (first code north, first code south, zones), per EPSG v11.
_UTM_CODES: dict[int, tuple[int | None, int | None, range]] = {
    4326: (32601, 32701, range(1, 61)),
    4269: (26901, None, range(1, 24)),  # NAD83
    4267: (26701, None, range(1, 23)),  # NAD27
    4258: (25828, None, range(28, 39)),  # ETRS89
    4322: (32201, 32301, range(1, 61)),  # WGS 72
    4283: (None, 28348, range(48, 59)),  # GDA94 (MGA zones)
    7844: (None, 7846, range(46, 60)),  # GDA2020 (MGA zones)
}


@dataclass(frozen=True, slots=True)
class Flat:
    """A chosen projection: the CRS, why (a phrase) and its largest scale error over the area."""

    crs: CRS
    reason: str
    scale_error: float


def horizontal(crs: CRS) -> CRS:
    """The two-dimensional horizontal part of a compound, bound or three-dimensional CRS."""
    while crs.is_bound and crs.source_crs is not None:
        crs = crs.source_crs
    if crs.is_compound:
        return horizontal(crs.sub_crs_list[0])
    return crs.to_2d() if len(crs.axis_info) > 2 and not crs.is_geocentric else crs


def in_metres(crs: CRS) -> tuple[CRS, float]:
    """The same projected CRS with metre axes, and how many metres one of its own units is."""
    factor = crs.axis_info[0].unit_conversion_factor if crs.axis_info else 1.0
    if factor == 1.0:
        return crs, 1.0
    json = crs.to_json_dict()
    for axis in json["coordinate_system"]["axis"]:
        axis["unit"] = "metre"
    for key in ("id", "ids", "usages"):  # it is no longer the CRS of that code
        json.pop(key, None)
    json["name"] = f"{json['name']} in metres"
    return CRS.from_json_dict(json), factor


def geodetic_base(crs: CRS) -> CRS:
    """The geographic CRS, in degrees from the prime meridian, on which to build a projection for ``crs``.

    That is the CRS's own datum; WGS 84 stands in if the datum's longitudes count from Paris, for example, or are not in
    degrees.
    """
    base = crs
    while base.is_derived and base.source_crs is not None:  # a projected CRS, or a rotated pole
        base = base.source_crs
    base = horizontal(base.geodetic_crs or base)
    meridian, axis = base.prime_meridian, base.axis_info[0]
    plain = meridian is None or abs(meridian.longitude) < 1e-9
    if not base.is_geographic or not plain or abs(axis.unit_conversion_factor - np.pi / 180) > 1e-12:
        return CRS.from_epsg(4326)
    return base


def unwrapped(lon: Degrees) -> Degrees:
    """Longitudes made continuous: the widest gap around the circle is outside [min, max]; the middle is in ±180."""
    turned = np.mod(lon, 360.0)
    ordered = np.sort(turned, axis=None)
    gaps = np.diff(ordered, append=ordered[0] + 360.0)
    start = ordered[(int(np.argmax(gaps)) + 1) % len(ordered)]
    out = start + np.mod(turned - start, 360.0)
    middle = (out.min() + out.max()) / 2
    return np.asarray(out - 360.0 * np.floor((middle + 180.0) / 360.0), np.float64)


def scale_error(crs: CRS, lon: Degrees, lat: Degrees) -> tuple[float, float]:
    """Smallest and largest point scale k of a projection at the given points (inf if a point cannot be projected)."""
    try:
        factors = Proj(crs).get_factors(lon, lat, errcheck=True)
    except ProjError:
        return 0.0, np.inf
    both = np.concatenate([np.ravel(factors.meridional_scale), np.ravel(factors.parallel_scale)])
    return (float(both.min()), float(both.max())) if np.isfinite(both).all() else (0.0, np.inf)


def flat_crs(base: CRS, lon: Degrees, lat: Degrees) -> Flat:
    """The projection for an area.

    Args:
        base: geographic CRS (see ``geodetic_base``).
        lon, lat: points all over the area, its border included, in degrees of ``base``; any wrapping.

    Raises:
        ReadError: the area is too large for a flat projection.
    """
    off_pole = np.abs(lat) < 89.999
    lon = unwrapped(lon[off_pole]) if off_pole.any() else np.zeros(1)
    west, east, south, north = float(lon.min()), float(lon.max()), float(lat.min()), float(lat.max())
    rim = np.linspace(0.0, 1.0, 13)
    lons, lats = (a.ravel() for a in np.meshgrid(west + (east - west) * rim, south + (north - south) * rim))
    lats = np.clip(lats, -89.99, 89.99)  # scale factors are not defined at the pole itself
    earth = base.ellipsoid is None or abs(base.ellipsoid.semi_major_metre - 6.378e6) < 2e4
    if earth and south >= -80 and north <= 84 and east - west < 20:
        zone, is_south = int(((west + east) / 2 + 180) // 6) % 60 + 1, south + north < 0
        utm = utm_crs(base, zone, is_south)
        low, high = scale_error(utm, lons, lats)
        if max(1 - low, high - 1) <= UTM_LIMIT:
            return Flat(utm, f"UTM zone {zone}{'S' if is_south else 'N'}", max(1 - low, high - 1))
    best: Flat | None = None
    for name, make in _candidates(west, south, east, north):
        flat = _balanced(base, name, make, lons, lats)
        if best is None or flat.scale_error < best.scale_error:
            best = flat
        if best.scale_error <= GOOD_ENOUGH:
            break
    if best is None or best.scale_error > FLAT_LIMIT:
        raise ReadError(
            f"The area ({east - west:.0f}° of longitude by {north - south:.0f}° of latitude) is too large for a flat "
            "projection.",
            remedy="Give a projected CRS of your choice with `crs` (EPSG:8857, say), or give fewer files.",
        )
    return best


Maker = Callable[[float], object]  # scale factor -> conversion


def _candidates(west: float, south: float, east: float, north: float) -> list[tuple[str, Maker]]:
    """Conformal projections centred on the box, in order of preference among equally good ones."""
    lon0, lat0 = _round((west + east) / 2), _round((south + north) / 2)
    lon0 = (lon0 + 180) % 360 - 180
    sixth = (north - south) / 6
    found: list[tuple[str, Maker]] = []
    if south > 60 or north < -60:
        pole = 90.0 if south > 0 else -90.0
        # Where the area surrounds the pole, Greenwich points down as on every such map.
        up = lon0 if east - west < 180 else 0.0
        found.append(
            ("polar stereographic", lambda k: PolarStereographicAConversion(pole, up, scale_factor_natural_origin=k))
        )
    if east - west > 180:
        return found
    if south * north > 0 and max(abs(south), abs(north)) < 88:
        first, second = _round(south + sixth), _round(north - sixth)
        if abs(second - first) > 1e-9:
            found.append(
                ("Lambert conformal conic", lambda k: LambertConformalConic2SPConversion(first, second, lat0, lon0))
            )
    if east - west < 60:
        found.append(
            ("transverse Mercator", lambda k: TransverseMercatorConversion(lat0, lon0, scale_factor_natural_origin=k))
        )
    if max(abs(south), abs(north)) < 80:
        found.append(
            ("Mercator", lambda k: MercatorAConversion(longitude_natural_origin=lon0, scale_factor_natural_origin=k))
        )
    found.append(("stereographic", lambda k: StereographicConversion(lat0, lon0, scale_factor_natural_origin=k)))
    return found


def _balanced(base: CRS, name: str, make: Maker, lons: Degrees, lats: Degrees) -> Flat:
    """The projection with its scale factor chosen so that k is as far above 1 as below it, over the area."""

    def crs(factor: float) -> CRS:
        datum = base.name
        return ProjectedCRS(conversion=make(factor), name=f"{datum} / local {name}", geodetic_crs=base)

    low, high = scale_error(crs(1.0), lons, lats)
    if name != "Lambert conformal conic" and np.isfinite(high) and high < 4:
        factor = round(2 / (low + high), 5)
        low, high = low * factor, high * factor
    else:
        factor = 1.0
    error = max(1 - low, high - 1)
    return Flat(crs(factor), f"local {name}", error)


def utm_crs(base: CRS, zone: int, south: bool) -> CRS:
    """UTM zone 1..60 on the datum of ``base``: the EPSG one where there is one, else built from the definition."""
    code = base.to_epsg()
    if code is None and base.name == "WGS 84":
        code = 4326
    north_first, south_first, zones = _UTM_CODES.get(code or 0, (None, None, range(0)))
    first = south_first if south else north_first
    if first is not None and zone in zones:
        return CRS.from_epsg(first + zone - zones.start)
    hemisphere = "S" if south else "N"
    return ProjectedCRS(
        conversion=UTMConversion(str(zone), hemisphere),
        name=f"{base.name} / UTM zone {zone}{hemisphere}",
        geodetic_crs=base,
    )


def _round(angle: float) -> float:
    """Rounded to a thousandth of a degree: readable parameters, whatever the raster's exact extent."""
    return round(angle, 3)
