"""The requested area as a box of longitudes and latitudes, from a box, a circle, or GeoJSON.

A box may cross the 180th meridian: its east is then beyond 180. Geometries are replaced by the box around them: the
smallest arc of longitudes that contains them, in either direction around the globe. Units: degrees; metres on the
ground.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import Geod

from orograph.documents import load_object
from orograph.errors import UsageError
from orograph.geo.ellipsoid import Ellipsoid

MOST_NESTED = 16


@dataclass(frozen=True, slots=True)
class Box:
    """Longitudes and latitudes: −180 ≤ west < 180, west < east ≤ west + 360, south < north."""

    west: float
    south: float
    east: float
    north: float

    @property
    def across(self) -> bool:
        """Whether it crosses the 180th meridian."""
        return self.east > 180

    def __str__(self) -> str:
        return f"{_degrees(self.west, 'EW')} to {_degrees(_turned(self.east), 'EW')}, " \
               f"{_degrees(self.south, 'NS')} to {_degrees(self.north, 'NS')}"  # fmt: skip


def asked(area: Any, bbox: Any, at: Any, radius: float | None, geojson: Any) -> Any:
    """The area from the arguments of ``fetch``, of which exactly one is needed.

    Raises:
        UsageError: there is none or more than one, or a radius around something else. ReadError: the file is no
            GeoJSON.
    """
    given = [one for one in (area, bbox, at, geojson) if one is not None]
    if len(given) != 1:
        raise UsageError(
            "Give one of `bbox`, `at` (with `radius`) and `geojson`."
            if given else "An area is needed: `bbox`, `at` (with `radius`) or `geojson`."
        )  # fmt: skip
    if radius is not None and (bbox is not None or geojson is not None):
        raise UsageError("`radius` needs `at`.")
    if isinstance(geojson, str | os.PathLike):
        return load_object(Path(geojson), "GeoJSON file", "a type, and coordinates")
    return given[0]


def area_of(area: Any, radius: float | None, body: Ellipsoid) -> Box:
    """The box of a requested area.

    Args:
        area: (west, south, east, north); (longitude, latitude), with ``radius``; or a GeoJSON object, or one that has
            ``__geo_interface__``.
        radius: metres around a place.

    Raises:
        UsageError: it is none of these, empty, or not on the globe.
    """
    described = getattr(area, "__geo_interface__", area)
    if isinstance(described, Mapping):
        if radius is not None:
            raise UsageError("A radius needs a place, (longitude, latitude), not a geometry.")
        return _around(described)
    numbers = _numbers(area)
    if len(numbers) == 2:
        if radius is None or not (math.isfinite(radius) and radius > 0):
            raise UsageError(
                "A place needs a radius of more than 0 metres.", remedy="Give a radius, such as `radius=5000`."
            )
        return _circle(numbers[0], numbers[1], radius, body)
    if len(numbers) != 4:
        raise UsageError(
            f"An area must be west, south, east, north; or longitude, latitude and a radius; not {len(numbers)} "
            "numbers."
        )
    if radius is not None:
        raise UsageError("A radius needs a place, (longitude, latitude), not a box.")
    west, south, east, north = numbers
    if east < west:
        east += 360  # across the 180th meridian
    return _box(west, south, east, north)


def _numbers(area: Any) -> list[float]:
    if isinstance(area, str) and "," in area:
        area = area.split(",")
    if isinstance(area, str) or not isinstance(area, (Sequence, np.ndarray)):
        raise UsageError(f"An area must be four numbers, a place with a radius, or GeoJSON, not {area!r}.")
    try:
        return [float(v) for v in area]
    except (TypeError, ValueError):
        raise UsageError(f"The numbers of an area must be degrees, not {area!r}.") from None


def _box(west: float, south: float, east: float, north: float) -> Box:
    if not all(map(math.isfinite, (west, south, east, north))):
        raise UsageError("The bounds of an area must be finite numbers.")
    if max(abs(west), abs(east)) > 540 or max(-south, north) > 90:
        raise UsageError(
            f"{west:g}, {south:g}, {east:g}, {north:g} are not degrees of longitude and latitude.",
            remedy="Give west, south, east, north, in degrees.",
        )
    if not (south < north and west < east):
        raise UsageError(
            f"The area {west:g}, {south:g}, {east:g}, {north:g} is empty.", remedy="Give west, south, east, north."
        )
    if east - west > 360:
        raise UsageError(f"The area is {east - west:g} degrees wide, more than once around the globe.")
    start = _turned(west)
    return Box(start, south, start + (east - west), north)


def _circle(lon: float, lat: float, radius: float, body: Ellipsoid) -> Box:
    """The box around all places within a distance."""
    if not (abs(lat) <= 90 and abs(lon) <= 540):
        raise UsageError(f"{lon:g}, {lat:g} is not a place.", remedy="Give longitude, latitude, in degrees.")
    globe = Geod(a=body.a, b=body.b)
    azimuths = np.arange(0, 360, 0.25)
    ones = np.ones_like(azimuths)
    lons, lats, _ = globe.fwd(lon * ones, lat * ones, azimuths, radius * ones)
    pole = min(globe.inv(lon, lat, lon, sign * 90)[2] for sign in (-1, 1))
    if radius >= pole or radius >= math.pi * body.b / 2:
        raise UsageError(
            f"A circle of {radius / 1000:g} km around {lon:g}, {lat:g} contains a pole, or half of the globe.",
            remedy="Give a smaller radius, or a box.",
        )
    apart = (np.asarray(lons) - lon + 180) % 360 - 180
    return _box(lon + float(apart.min()), float(np.min(lats)), lon + float(apart.max()), float(np.max(lats)))


def _around(geometry: Mapping[str, Any]) -> Box:
    """The smallest box around the parts of a GeoJSON object."""
    spans, lats = [], []
    for ring in _rings(geometry, 0):
        try:
            points = np.asarray([position[:2] for position in ring], np.float64)
        except (TypeError, ValueError, IndexError):
            raise UsageError("The coordinates of the geometry are not pairs of numbers.") from None
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise UsageError("The coordinates of the geometry are not pairs of numbers.")
        spans.append((float(points[:, 0].min()), float(points[:, 0].max())))
        lats += [float(points[:, 1].min()), float(points[:, 1].max())]
    if not spans:
        raise UsageError(
            "The geometry has no coordinates.", remedy="Give a geometry with coordinates, such as a polygon."
        )
    west, east = _arc(spans)
    return _box(west, min(lats), east, max(lats))


def _rings(part: Any, depth: int) -> Iterator[Sequence[Any]]:
    """Lists of positions of a GeoJSON object."""
    if depth > MOST_NESTED or not isinstance(part, Mapping):
        raise UsageError("This is not a GeoJSON geometry.", remedy="Give a Geometry, a Feature or a FeatureCollection.")
    for key in ("features", "geometries"):
        for one in part.get(key) or ():
            yield from _rings(one, depth + 1)
    if isinstance(part.get("geometry"), Mapping):
        yield from _rings(part["geometry"], depth + 1)
    if part.get("coordinates"):
        yield from _lists(part["coordinates"], 0)


def _lists(nested: Any, depth: int) -> Iterator[Sequence[Any]]:
    if depth > MOST_NESTED or not isinstance(nested, Sequence) or isinstance(nested, str) or not nested:
        raise UsageError("The coordinates of the geometry are not pairs of numbers.")
    if isinstance(nested[0], (int, float)):
        yield [nested]
    elif isinstance(nested[0], Sequence) and nested[0] and isinstance(nested[0][0], (int, float)):
        yield nested
    else:
        for one in nested:
            yield from _lists(one, depth + 1)


def _arc(spans: list[tuple[float, float]]) -> tuple[float, float]:
    """The shortest arc of longitudes that contains all spans."""
    if any(east - west >= 360 for west, east in spans):
        return -180.0, 180.0
    ordered = sorted((_turned(west), _turned(west) + east - west) for west, east in spans)
    end, widest, start, stop = ordered[0][1], -1.0, ordered[0][0], 0.0
    for west, east in [*ordered[1:], (ordered[0][0] + 360, ordered[0][1] + 360)]:
        if west - end > widest:
            widest, start, stop = west - end, west, end
        end = max(end, east)
    if widest <= 0:
        return -180.0, 180.0
    west = _turned(start)
    return west, west + (stop - start) % 360


def _turned(lon: float) -> float:
    """A longitude wrapped into [−180, 180)."""
    return lon if -180 <= lon < 180 else (lon + 180) % 360 - 180


def _degrees(value: float, letters: str) -> str:
    letter = letters[0] if value > 0 else letters[1]
    return f"{abs(value):.6g}°{letter if value else ''}"
