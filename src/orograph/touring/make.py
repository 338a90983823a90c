"""Ready-made tours: around a terrain, the terrain on a turntable, along a line over the ground.

- ``orbit``: the camera goes once round the terrain, with all of it in the picture from every side; a loop.
- ``turntable``: the same, but the light turns with the camera, as if the terrain were turned in front of it.
- ``still``: the camera stays, for data that change.
- ``flyover``: along a line (a road, a valley, a GPX track) at an even speed and a height above the ground, looking
  ahead along the line.

``read_line`` reads lines from GPX and GeoJSON. Units: metres, seconds, degrees; positions in the terrain's CRS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from orograph.documents import parse
from orograph.errors import ReadError, UsageError
from orograph.geo.beyond import beyond
from orograph.geo.transform import far_outside, place
from orograph.lighting.sun import Placed
from orograph.scene import camera
from orograph.store.opening import takes_terrain
from orograph.store.terrain import Terrain
from orograph.touring.course import highest
from orograph.touring.keys import Key
from orograph.touring.schedule import Cruise
from orograph.touring.tour import Tour
from orograph.viewpoint import View

Array = NDArray[np.float64]

SIDES = 24
"""Azimuths from which the whole terrain of an orbit must fit into the picture."""

TURNTABLE_KEYS = 6

SECONDS = 12.0
"""Seconds for one turn."""

CLEAR = 0.02
"""Height above the ground of an eye that orbits a place, as a part of its distance: there may be hills around."""

CRUISE = 12.0
"""Seconds in which a fly-over covers its height above the ground times ``AHEAD``: a speed that looks even at any
scale."""

AHEAD = 4.0
"""How far a fly-over looks ahead along its line, in heights above the ground."""

KEYS_PER_LOOK = 3.0
"""Keys between the eye and the point it looks at."""


@takes_terrain
def orbit(
    terrain: Terrain, size: tuple[int, int], *, seconds: float = SECONDS, azimuth: float = 180.0, pitch: float = 35.0,
    distance: float | None = None, fov_y: float = 30.0, turns: int = 1, exaggeration: float = 1.0,
    around: Sequence[float] | None = None, also: Array | None = None,
) -> Tour:  # fmt: skip
    """Once round the terrain at an even speed: a loop.

    Args:
        size: (width, height) of the pictures. seconds: for all turns.
        azimuth: the side where it begins. turns: clockwise seen from above; negative: anticlockwise.
        pitch, distance: as for ``camera.around``; None: the shortest from which all of it is in view on every side.
        around: (longitude, latitude[, radius]): a place to orbit instead, with this many metres of ground around it
            in view (a quarter of the terrain's shorter side, if neither this nor the distance is given); the eye keeps
            above the ground.
        also: (n, 3) further positions to keep in view with all of the terrain, as for ``camera.whole``.

    Raises:
        UsageError: a number is out of its range, or the place lies beside the terrain. NothingInViewError: no sample is
            valid.
    """
    if not 0 < seconds < math.inf:
        raise UsageError(f"The seconds of a tour must be more than 0, not {seconds:g}.")
    if turns == 0:
        raise UsageError("An orbit needs at least one turn: turns must be 1, −1, 2, …")
    if around is None:
        view, above = _around(terrain, size, azimuth, pitch, distance, fov_y, exaggeration, also), None
    else:
        view = _about(terrain, size, around, azimuth, pitch, distance, fov_y, exaggeration)
        above = CLEAR * view.distance
    key = Key(view, 0.0, path="orbit", turns=turns)
    return Tour((key,), seconds=seconds, loop=True, ease=False, above_ground=above)


@takes_terrain
def turntable(
    terrain: Terrain, size: tuple[int, int], *, sun: tuple[float, float] = (315.0, 45.0), seconds: float = SECONDS,
    azimuth: float = 180.0, pitch: float = 35.0, distance: float | None = None, fov_y: float = 30.0,
    exaggeration: float = 1.0, around: Sequence[float] | None = None, also: Array | None = None,
) -> Tour:  # fmt: skip
    """The terrain turned once in front of a fixed camera and sun: a loop. Arguments as for ``orbit``.

    Args:
        sun: its position at the beginning of the tour.
    """
    once = orbit(terrain, size, seconds=seconds, azimuth=azimuth, pitch=pitch, distance=distance, fov_y=fov_y,
                 exaggeration=exaggeration, around=around, also=also)  # fmt: skip
    keys = []
    for k in range(TURNTABLE_KEYS):
        time = seconds * k / TURNTABLE_KEYS
        light = Placed((sun[0] + 360.0 * k / TURNTABLE_KEYS) % 360.0, sun[1])
        keys.append(Key(once.at(time), time, path="orbit", sun=light))
    return Tour(tuple(keys), seconds=seconds, loop=True, ease=False, above_ground=once.above_ground)


@takes_terrain
def still(
    terrain: Terrain, size: tuple[int, int], *, seconds: float = SECONDS, plan: bool = False, azimuth: float = 180.0,
    pitch: float = 35.0, distance: float | None = None, fov_y: float = 30.0, exaggeration: float = 1.0,
    around: Sequence[float] | None = None, insets: camera.Insets = camera.NO_INSETS, also: Array | None = None,
) -> Tour:  # fmt: skip
    """A fixed camera. Arguments as for ``orbit``.

    Args:
        insets: parts of the picture to leave free, as for ``camera.around``.
        plan: it looks straight down on the whole terrain, as on a map; excludes all other arguments of its place.
    """
    if not 0 < seconds < math.inf:
        raise UsageError(f"A film takes some seconds, more than 0, not {seconds:g}.")
    if plan:
        view = camera.plan(terrain, size, insets=insets)
    elif around is not None:
        view = _about(terrain, size, around, azimuth, pitch, distance, fov_y, exaggeration)
    else:
        view = camera.around(terrain, size, azimuth=azimuth, pitch=pitch, distance=distance, fov_y=fov_y,
                             exaggeration=exaggeration, insets=insets, also=also)  # fmt: skip
    return Tour((Key(view, 0.0),), seconds=seconds, ease=False)


@takes_terrain
def flyover(
    terrain: Terrain, size: tuple[int, int], line: Array, *, height: float | None = None, speed: float | None = None,
    seconds: float | None = None, fov_y: float = 45.0,
) -> Tour:  # fmt: skip
    """Along a line over the ground.

    Args:
        line: (n, 2) places in the terrain's CRS.
        height: metres above the ground; None: a fifteenth of the line, from 50 to 3000 m.
        speed: metres per second; None: one that suits the height. seconds: the duration, instead of a speed.

    Raises:
        UsageError: the line has no length, lies beside the terrain or goes far beyond it; a number is out of range.
    """
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    line = line[np.concatenate([[True], steps > 0])]
    far = np.concatenate([[0.0], np.cumsum(steps[steps > 0])])
    if len(line) < 2:
        raise UsageError("A line to fly along needs at least two points.")
    if not np.isfinite(highest(terrain, line)).any():
        raise UsageError(
            "The line lies outside the terrain.", path=terrain.name,
            remedy="Its points must be longitude and latitude (or in the terrain's CRS, with `line_crs`).",
        )  # fmt: skip
    for x, y in line:
        if far_outside(terrain.grid, x, y):
            raise UsageError(
                f"The line extends far beyond the terrain, to {x:.10g}, {y:.10g} in its CRS.", path=terrain.name,
                remedy="Longitude comes first, then latitude; use `line_crs` for another CRS.",
            )  # fmt: skip
    if height is None:
        height = min(max(far[-1] / 15, 50.0), 3000.0)
    if not 0 < height < math.inf:
        raise UsageError(f"`height` must be in metres above the ground, more than 0, not {height:g}.")
    if seconds is not None and not 0 < seconds < math.inf:
        raise UsageError(f"The seconds of a tour must be more than 0, not {seconds:g}.")
    ahead = AHEAD * height
    speed = ahead / CRUISE * 3 if speed is None else speed
    count = max(2, math.ceil(far[-1] / (ahead / KEYS_PER_LOOK)) + 1)
    stations = np.linspace(0.0, far[-1], count)

    def place(at: Array) -> Array:
        """Places along the line, which continues straight beyond its end."""
        inside = np.stack([np.interp(at, far, line[:, k]) for k in (0, 1)], 1)
        on = (line[-1] - line[-2]) / np.linalg.norm(line[-1] - line[-2])
        return np.asarray(inside + np.maximum(at - far[-1], 0.0)[:, None] * on)

    # Smooth it by the distance that the camera looks ahead, so that it does not follow each bend of a path.
    window = np.linspace(-0.5, 0.5, 9) * ahead / KEYS_PER_LOOK
    eyes = np.mean([place(np.clip(stations + w, 0, far[-1])) for w in window], axis=0)
    eyes[[0, -1]] = line[[0, -1]]
    targets = np.mean([place(stations + ahead + w) for w in window], axis=0)
    default = float(np.nanmean(highest(terrain, line)))
    below = np.array([_ground(terrain, p, ahead / KEYS_PER_LOOK / 2, default) for p in eyes])
    seen = np.array([_ground(terrain, p, 0.0, default) for p in targets])
    keys = [
        Key(View((x, y, z + height), (tx, ty, tz), fov_y=fov_y, width=size[0], height=size[1]))
        for (x, y), z, (tx, ty), tz in zip(eyes, below, targets, seen)
    ]
    tour = Tour(tuple(keys), speed=speed, above_ground=height / 2)
    if seconds is None:
        return tour
    # The length follows from the time at a speed, and the speed from the available time: both have ramps.
    length = Cruise.length_of(tour.duration, speed)
    return Tour(tuple(keys), speed=Cruise.speed_for(length, seconds), above_ground=height / 2)


def _ground(terrain: Terrain, place: Array, around: float, default: float) -> float:
    """Mean height of the ground within ``around`` of a place, metres."""
    offsets = np.linspace(-around, around, 5 if around else 1)
    x, y = (a.ravel() for a in np.meshgrid(offsets, offsets))
    found = highest(terrain, place + np.stack([x, y], 1))
    return float(np.nanmean(found)) if np.isfinite(found).any() else default


def _around(
    terrain: Terrain, size: tuple[int, int], azimuth: float, pitch: float, distance: float | None, fov_y: float,
    exaggeration: float, also: Array | None = None,
) -> View:  # fmt: skip
    """The view of ``camera.around``, from a distance at which the whole terrain is in view from every side."""
    view = camera.around(terrain, size, azimuth=azimuth, pitch=pitch, distance=1.0 if distance is None else distance,
                         fov_y=fov_y, exaggeration=exaggeration)  # fmt: skip
    if distance is not None:
        return view
    from scipy.optimize import minimize_scalar

    points = camera.joined(camera.outline(terrain), also)
    stretch = np.array([1.0, 1.0, exaggeration])
    middle = (points.min(0) + points.max(0)) / 2
    ty = math.tan(math.radians(fov_y) / 2) * camera.MARGIN
    tx = ty * size[0] / size[1]
    sides = []
    for k in range(SIDES):
        forward = camera.direction(azimuth + 360.0 * k / SIDES, pitch)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
        sides.append(np.stack([right, np.cross(right, forward), forward], 1))

    def needed(drop: float) -> float:
        """The distance from which everything is in view if the camera aims ``drop`` below the middle."""
        far = 0.0
        for axes in sides:
            # At distance d a point is in the picture if |a| ≤ tx·(c + d) and |b| ≤ ty·(c + d).
            a, b, c = (((points - middle) * stretch + [0.0, 0.0, drop]) @ axes).T
            far = max(far, float((np.abs(a) / tx - c).max()), float((np.abs(b) / ty - c).max()))
        return far

    # Near ground reaches farther from the picture's middle than far ground, so the camera aims below the terrain's
    # middle. The distance is convex in the drop: a maximum of linear functions.
    span = float(np.linalg.norm(np.ptp(points[:, :2], axis=0)))
    drop = float(minimize_scalar(needed, bounds=(0.0, span), method="bounded", options={"xatol": 1e-4 * span}).x)
    far = needed(drop)
    middle = middle - [0.0, 0.0, drop / exaggeration]
    eye = middle - camera.direction(azimuth, pitch) * far * 1.005 / stretch
    return View(tuple(eye), tuple(middle), fov_y=fov_y, width=size[0], height=size[1])


def _about(
    terrain: Terrain, size: tuple[int, int], around: Sequence[float], azimuth: float, pitch: float,
    distance: float | None, fov_y: float, exaggeration: float,
) -> View:  # fmt: skip
    """The view of a place from a side, at a distance, or with a radius of ground around it in view from every side."""
    camera.check_around(azimuth, pitch, distance, exaggeration)
    if len(around) not in (2, 3):
        raise UsageError(f"A place to orbit must be (longitude, latitude[, radius]), not {around!r}.")
    x, y = place(terrain.grid, *around[:2])
    far = beyond(terrain.grid, x, y)
    if far is not None:
        raise UsageError(
            f"The place to orbit lies {far}.", path=terrain.name,
            remedy="Longitude comes first, then latitude; orograph info shows where the terrain is.",
        )  # fmt: skip
    if distance is None:
        sides = (n * s for n, s in zip(terrain.grid.shape[::-1], terrain.grid.spacing))
        radius = around[2] if len(around) == 3 else min(sides) / 4
        if not 0 < radius < math.inf:
            raise UsageError(f"The radius around a place must be in metres, more than 0, not {radius:g}.")
        # A ball of this radius is in view whatever the side and the pitch.
        half = math.atan(math.tan(math.radians(fov_y) / 2) * min(1.0, size[0] / size[1]))
        distance = radius / math.sin(half)
    middle = float(np.mean(terrain.height_range))
    target = np.array([x, y, camera.ground(terrain, x, y, default=middle)])
    eye = target - camera.direction(azimuth, pitch) * distance / np.array([1.0, 1.0, exaggeration])
    return View(tuple(eye), tuple(target), fov_y=fov_y, width=size[0], height=size[1])


def read_line(path: str | Path, crs: Any, line_crs: Any = None) -> Array:
    """The line in a GPX or GeoJSON file: its longest track, route or LineString.

    Args:
        crs: the terrain's CRS. line_crs: the file's, if it is GeoJSON and not in longitude and latitude.

    Returns:
        (n, 2) float64 in the terrain's CRS.

    Raises:
        ReadError: the file cannot be read, or holds no line. UsageError: its CRS cannot be brought to the terrain's.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ReadError(f"The line cannot be read: {getattr(error, 'strerror', None) or error}.", path=path) from error
    try:
        lines = _gpx(text) if text.lstrip().startswith("<") else _geojson(parse(text))
    except (ValueError, ElementTree.ParseError, TypeError, KeyError, IndexError) as error:
        raise ReadError(f"This is neither GPX nor GeoJSON: {error}.", path=path) from error
    lines = [line for line in lines if len(line) > 1]
    if not lines:
        raise ReadError("There is no line in this file (a track, a route, a LineString).", path=path)
    return to_crs(max(lines, key=len), crs, line_crs)


def longest(geojson: Any) -> list[tuple[float, float]]:
    """The longest line (with most points) in GeoJSON: a mapping, or an object with ``__geo_interface__``.

    Raises:
        UsageError: it is not GeoJSON, or holds no line.
    """
    try:
        lines = _geojson(dict(getattr(geojson, "__geo_interface__", geojson)))
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise UsageError(f"The line is not GeoJSON: {error}.") from error
    found = max(lines, key=len, default=[])
    if len(found) < 2:
        raise UsageError("There is no line in this GeoJSON (a LineString of two points or more).")
    return found


def to_crs(places: Sequence[Sequence[float]], crs: Any, line_crs: Any = None) -> Array:
    """Places (n, 2), longitude and latitude or in ``line_crs``, in the terrain's CRS: (n, 2) float64.

    Raises:
        UsageError: the CRS cannot be brought to the terrain's, or a place cannot.
    """
    from orograph.geo.transform import transformer

    given = np.array([p[:2] for p in places], np.float64)
    x, y = transformer(line_crs or "EPSG:4326", crs)(given[:, 0], given[:, 1])
    found = np.stack([np.asarray(x, np.float64), np.asarray(y, np.float64)], 1)
    if not np.isfinite(found).all():
        wrong = given[~np.isfinite(found).all(1)][0]
        raise UsageError(f"The place {wrong[0]:g}, {wrong[1]:g} cannot be transformed to the terrain's CRS.")
    return found


def _gpx(text: str) -> list[list[tuple[float, float]]]:
    """Track segments and routes of a GPX file."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("it defines entities of its own")
    root = ElementTree.fromstring(text)
    found = []
    for element in root.iter():
        kind = element.tag.rpartition("}")[2]
        if kind in ("trkseg", "rte"):
            points = [e for e in element if e.tag.rpartition("}")[2] in ("trkpt", "rtept")]
            found.append([(float(p.attrib["lon"]), float(p.attrib["lat"])) for p in points])
    return found


def _geojson(value: Any) -> list[list[tuple[float, float]]]:
    """LineStrings of a GeoJSON object at any depth."""
    if not isinstance(value, dict):
        raise ValueError("it holds no JSON object")
    kind = value.get("type")
    if kind == "FeatureCollection":
        return [line for feature in value["features"] for line in _geojson(feature)]
    if kind == "Feature":
        return _geojson(value["geometry"]) if value["geometry"] else []
    if kind == "GeometryCollection":
        return [line for part in value["geometries"] for line in _geojson(part)]
    if kind == "LineString":
        return [[(float(p[0]), float(p[1])) for p in value["coordinates"]]]
    if kind == "MultiLineString":
        return [[(float(p[0]), float(p[1])) for p in line] for line in value["coordinates"]]
    if kind in ("Point", "MultiPoint", "Polygon", "MultiPolygon"):
        return []
    raise ValueError(f'its "type" is {kind!r}')
