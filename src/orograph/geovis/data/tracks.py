"""Tracks: places with times, of GPX, of GeoJSON, of tables and points with the name of a track.

GeoJSON's lines have their times in ``coordTimes``, ``times`` or ``coordinateProperties.times`` of their properties, as
converters from GPX write them. Between samples places are linear in time; a gap that a file says (a new segment of
GPX) is not bridged. Speeds are differences over both neighbours, along the ground of the terrain's CRS.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import locate, stamped
from orograph.dem.tables import DEGREES, places_in
from orograph.errors import ReadError, UsageError
from orograph.geo import geojson
from orograph.geo.grid import Grid
from orograph.geo.transform import transformer
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.features import GEOJSON, MOST_CLASSES, classes_in, has_features, read_features
from orograph.geovis.data.points import attribute_of, columns_of, columns_of_features, is_table, level_of, when_of
from orograph.geovis.data.shared import reading_once
from orograph.geovis.data.times import seconds_of

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


class Rows(NamedTuple):
    """Samples of tracks as a source has them: columns as ``points.columns_of`` has them.

    Attributes:
        part: (n,) the unbroken stretch that each belongs to; None: the source does not say.
        track: (n,) the name of its track; None: the same.
    """

    columns: dict[str, Array]
    texts: dict[str, NDArray[np.object_]]
    crs: Any
    name: str
    part: Numbers | None = None
    track: NDArray[np.object_] | None = None


class Tracks(NamedTuple):
    """Samples of tracks over a terrain, by part and time.

    Attributes:
        at: (n, 3) x, y in the terrain's CRS, and metres (see ``Dataset.height``; NaN where the source has none).
        seconds: (n,) since 1970, UTC; NaN where nothing says when. part, values, sigma: (n,).
        tracks: how many. name, unit, classes: what the values are.
    """

    at: Array
    seconds: Array
    part: Numbers
    values: Array
    sigma: Array | None
    tracks: int
    name: str
    unit: str
    classes: tuple[str, ...] | None


def rows_of(given: Dataset, grid: Grid) -> Rows | None:
    """The samples of a source; None: it has lines, which say no times.

    Raises:
        ReadError: it cannot be read, or is no GPX.
    """
    source = given.source
    if isinstance(source, str) and Path(source).suffix.lower() == ".gpx" and given.layer is None:
        return reading_once("gpx", stamped(locate(source)), lambda: _of_gpx(source))
    if not has_features(source):
        return Rows(*columns_of(source)) if is_table(source) else None
    if not isinstance(source, str) or Path(source).suffix.lower() in GEOJSON:
        what = stamped(locate(source)) if isinstance(source, str) else source
        found = reading_once("lines", what, lambda: _of_lines(source))
        if found is not None:
            return found
    features = read_features(given, grid)
    return Rows(*columns_of_features(features)) if features.kind == "points" else None


def read_tracks(given: Dataset, rows: Rows, grid: Grid) -> Tracks:
    """The tracks of a source's samples.

    Raises:
        ReadError: no two samples of a track are on the terrain; a time cannot be read.
        UsageError: it is not clear which attribute is meant.
    """
    east, north = places_in(rows.columns, rows.name, "the terrain's CRS")
    numbers = {k: v for k, v in rows.columns.items() if k not in (east, north) and np.isfinite(v).any()}
    level, used = level_of(given, numbers, rows.name)
    if level is None and rows.part is None:
        level = np.full(len(rows.columns[east]), np.nan)
    elif level is None:
        level = numbers.get("z", np.full(len(rows.columns[east]), np.nan))
    if level.ndim != 1:
        raise UsageError("A track has one height at a time, not an interval.", path=rows.name)
    when = when_of(given, rows.texts, rows.name)
    seconds = np.full(len(level), np.nan) if when is None else seconds_of(rows.texts[when], rows.name, when)
    if given.group is not None and given.group not in rows.texts:
        raise UsageError(f"There is no attribute {given.group!r}.", path=rows.name, remedy="Choose one: group=NAME.")
    names = rows.texts[given.group] if given.group is not None else rows.track
    track = np.zeros(len(level), np.int64) if names is None else np.unique(names.astype(str), return_inverse=True)[1]
    part = track if rows.part is None or given.group is not None else rows.part
    x, y = rows.columns[east], rows.columns[north]
    crs = "EPSG:4326" if rows.crs is None and east.lower() in DEGREES else rows.crs
    if crs is not None and grid.crs is not None:
        x, y = (np.where(np.isfinite(v), v, np.nan) for v in transformer(crs, grid.crs)(x, y))
    order = np.lexsort([np.arange(len(x)), np.zeros(len(x)) if when is None else seconds, part])
    known = np.isfinite(x) & np.isfinite(y) & (np.isfinite(seconds) if when is not None else True)
    order = order[known[order]]
    if when is not None:  # (of samples at one moment the first counts)
        again = (np.diff(part[order]) == 0) & (np.diff(seconds[order]) == 0)
        order = order[np.concatenate([[True], ~again])] if len(order) else order
    at = np.stack([x, y, level], 1)[order]
    seconds, part, track = seconds[order], part[order], track[order]
    told = None if names is None else names[order]
    values, name, unit, classes = _values(given, rows, {k: v[order] for k, v in numbers.items() if k not in used},
                                          order, at, seconds, part, told)  # fmt: skip
    sigma = None
    if given.uncertainty is not None:
        sigma = numbers[attribute_of(given.uncertainty.source, numbers, rows.name)][order]
        if (sigma < 0).any():
            raise ReadError("A standard deviation cannot be negative.", path=rows.name, remedy="Choose another.")
    col, row = grid.index(at[:, 0], at[:, 1])
    here = (col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1)
    if not (here[1:] & here[:-1] & (np.diff(part) == 0)).any():
        raise ReadError(
            "No two consecutive samples of a track lie on the terrain.", path=rows.name,
            remedy="Give data of the same area, and say which track each belongs to: group=NAME.",
        )  # fmt: skip
    return Tracks(at, seconds, part, values, sigma, len(np.unique(track[here])), name, unit, classes)


def span_of(given: Dataset, grid: Grid) -> tuple[float, float] | None:
    """The first and the last moment of a source of tracks, seconds since 1970; None: it is none, or says no times."""
    if given.style not in ("tubes", "paths"):
        return None
    rows = rows_of(given, grid)
    when = None if rows is None else when_of(given, rows.texts, rows.name)
    if rows is None or when is None:
        return None
    seconds = seconds_of(rows.texts[when], rows.name, when)
    known = seconds[np.isfinite(seconds)]
    return (float(known.min()), float(known.max())) if len(known) else None


def until(tracks: Tracks, second: float) -> Tracks:
    """What of tracks has been at a moment: their last places are linear between their neighbours in time."""
    before = tracks.seconds <= second
    ahead = np.flatnonzero(before[:-1] & ~before[1:] & (np.diff(tracks.part) == 0))
    part = ((second - tracks.seconds[ahead]) / (tracks.seconds[ahead + 1] - tracks.seconds[ahead]))[:, None]
    last = tracks.at[ahead] + (tracks.at[ahead + 1] - tracks.at[ahead]) * part
    keep = np.concatenate([np.flatnonzero(before), ahead])
    order = np.argsort(np.concatenate([np.flatnonzero(before), ahead + 0.5]), kind="stable")
    return tracks._replace(
        at=np.concatenate([tracks.at[before], last])[order],
        seconds=np.concatenate([tracks.seconds[before], np.full(len(ahead), second)])[order],
        part=tracks.part[keep][order], values=tracks.values[keep][order],
        sigma=None if tracks.sigma is None else tracks.sigma[keep][order],
    )  # fmt: skip


def _values(
    given: Dataset, rows: Rows, numbers: dict[str, Array], order: Numbers, at: Array, seconds: Array, part: Numbers,
    names: NDArray[np.object_] | None,
) -> tuple[Array, str, str, tuple[str, ...] | None]:  # fmt: skip
    """Values of samples, what they are, their unit, and the names of their classes."""
    asked = given.variable
    if asked is None and names is not None and len({*names}) <= MOST_CLASSES:
        values, classes = classes_in(names, "the track", rows.name)
        return values, "track", "", classes
    if asked is None:
        alike = given.name or Path(rows.name).stem
        return np.zeros(len(at)), alike, "", (alike,)
    if asked in numbers:
        return numbers[asked], asked.replace("_", " "), "", None
    if asked in ("speed", "time") and not np.isfinite(seconds).any():
        raise UsageError(
            f"There are no times, so there is no {asked}.", path=rows.name, remedy="Name the attribute: when=."
        )
    if asked == "speed":
        return _speed(at, seconds, part), "speed", "m/s", None
    if asked == "time":
        return (seconds - seconds.min()) / 3600, "time since the first", "h", None
    if (asked in rows.texts and asked not in rows.columns | numbers) or asked in rows.texts:
        values, classes = classes_in(rows.texts[asked][order], asked, rows.name)
        return values, asked.replace("_", " "), "", classes
    known = [*numbers, "speed", "time", *(k for k in rows.texts if k not in numbers)]
    raise UsageError(f"There is no attribute {asked!r}: {', '.join(known)}.", path=rows.name,
                     remedy="Choose one: variable=NAME.")  # fmt: skip


def _speed(at: Array, seconds: Array, part: Numbers) -> Array:
    """Metres a second, over both neighbours of a sample in its part."""
    n = len(at)
    before, after = np.maximum(np.arange(n) - 1, 0), np.minimum(np.arange(n) + 1, n - 1)
    before = np.where(part[before] == part, before, np.arange(n))
    after = np.where(part[after] == part, after, np.arange(n))
    here = np.arange(n)
    way = sum(np.hypot(*(at[a, :2] - at[b, :2]).T) for a, b in ((here, before), (after, here)))
    took = seconds[after] - seconds[before]
    return np.asarray(np.divide(way, took, out=np.full(n, np.nan), where=took > 0))


def _of_gpx(source: str) -> Rows:
    """Track points and routes of GPX (1.0 and 1.1)."""
    try:
        root = ElementTree.parse(locate(source)).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise ReadError(f"It is not GPX: {error}", path=source, remedy="Export it again.") from error
    found: list[tuple[float, float, float, str, int, str]] = []
    part = 0
    for number, track in enumerate(one for one in root if _tag(one) in ("trk", "rte")):
        name = next((one.text for one in track if _tag(one) == "name" and one.text), f"track {number + 1}")
        for piece in [one for one in track if _tag(one) == "trkseg"] or [track]:
            for place in (one for one in piece if _tag(one) in ("trkpt", "rtept")):
                inside = {_tag(one): (one.text or "").strip() for one in place}
                try:
                    where = float(place.attrib["lon"]), float(place.attrib["lat"]), float(inside.get("ele") or "nan")
                except (KeyError, ValueError):
                    raise ReadError(f"Point {len(found) + 1} has no place.", path=source, remedy="Mend it.") from None
                found.append((*where, inside.get("time", ""), part, name))
            part += 1
    if not found:
        raise ReadError("It holds neither a track nor a route.", path=source, remedy="Give a file with tracks.")
    lon, lat, ele, time, parts, names = zip(*found)
    texts = {"time": np.array(time, object), "track": np.array(names, object)}
    columns = {"longitude": np.array(lon), "latitude": np.array(lat), "ele": np.array(ele)}
    return Rows(columns, texts, "EPSG:4326", source, np.array(parts), texts["track"])


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _of_lines(source: Any) -> Rows | None:
    """Lines of GeoJSON whose places have times; None: none has."""
    data, name = geojson.load(locate(source) if isinstance(source, str) else source)
    places: list[list[float]] = []
    times: list[str] = []
    parts: list[int] = []
    names: list[str] = []
    for number, feature in enumerate(data.get("features") or [data]):
        about = feature.get("properties") or {} if isinstance(feature, dict) else {}
        inside = about.get("coordinateProperties")
        told: Any = about.get("coordTimes") or about.get("times") or (inside or {}).get("times")
        lines = (feature.get("geometry") or {}) if told else {}
        if lines.get("type") == "LineString":
            lines, told = {"coordinates": [lines["coordinates"]], "type": "MultiLineString"}, [told]
        if lines.get("type") != "MultiLineString":
            continue
        for line, moments in zip(lines["coordinates"], told):
            if len(line) != len(moments):
                raise ReadError(
                    f"Feature {number + 1} has {len(line)} places and {len(moments)} times.", path=name,
                    remedy="Give a time for each place.",
                )  # fmt: skip
            places += [[*place[:3], *[np.nan] * (3 - len(place))] for place in line]
            times += [str(moment) for moment in moments]
            parts += [max(parts, default=-1) + 1] * len(line)
            names += [str(about.get("name") or f"track {number + 1}")] * len(line)
    if not places:
        return None
    x, y, z = np.array(places, np.float64).T
    texts = {"time": np.array(times, object), "track": np.array(names, object)}
    columns = {"x": x, "y": y} | ({"z": z} if np.isfinite(z).any() else {})
    crs = geojson.crs_name(data) or "EPSG:4326"
    return Rows(columns, texts, crs, source if isinstance(source, str) else name, np.array(parts), texts["track"])
