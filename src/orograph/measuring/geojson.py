"""Lines and polygons from GeoJSON (RFC 7946): longitude, latitude, unless an old-style ``crs`` member says otherwise.

A file may be a geometry, a feature, or a collection that holds one line or polygon (a polygon may have holes). A third
coordinate is ignored: heights are measured, not read.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError
from orograph.geo.geojson import crs_name, geometries, lines, load
from orograph.geo.transform import transformer
from orograph.measuring.places import Places

Array = NDArray[np.float64]

Geometry = Any
"""GeoJSON: a file, a mapping, or an object with ``__geo_interface__`` (shapely's, geopandas')."""

DEPTHS = {"Point": 0, "MultiPoint": 1, "LineString": 0, "MultiLineString": 1, "Polygon": 1, "MultiPolygon": 2}
"""Nesting depth of lines or points in a geometry's coordinates."""


def is_geometry(given: Any) -> bool:
    """Whether something is GeoJSON in some form, and not an array of points."""
    return isinstance(given, str | os.PathLike | Mapping) or hasattr(given, "__geo_interface__")


def read_geojson(path: Any, kind: str, places: Places) -> list[Array]:
    """The rings of the file's polygon, or its line as a list of one, in the terrain's CRS.

    Args:
        path: of the file, or anything else that ``geo.geojson.load`` takes.
        kind: "Polygon" or "LineString".

    Raises:
        ReadError: the file cannot be read, or is not GeoJSON with one such geometry.
        UsageError: its coordinates cannot be transformed to the terrain's CRS.
    """
    data, called = load(path)
    found = [g for g in geometries(data) if g.get("type") == kind]
    if len(found) != 1:
        raise ReadError(
            f"It holds {len(found)} geometries of type {kind}, but only one can be measured at a time.", path=called,
            remedy="orograph.measure.areas measures each." if kind == "Polygon" and found else f"Give one {kind}.",
        )  # fmt: skip
    parts = found[0].get("coordinates")
    try:
        rings = lines(parts if kind == "Polygon" else [parts])
    except ValueError as error:
        raise ReadError(f"The {kind} has no list of coordinates.", path=called) from error
    return moved(rings, data, places)


def read_lines(path: Any, places: Places) -> list[Array]:
    """All lines, outlines of polygons, and points (as lines of one place) of a file, in the terrain's CRS.

    Args:
        path: of the file, or what else ``geo.geojson.load`` takes.

    Raises:
        ReadError: the file cannot be read, or is not GeoJSON with any of these.
        UsageError: as ``read_geojson``.
    """
    data, called = load(path)
    found: list[Array] = []
    try:
        for geometry in geometries(data):
            depth, parts = DEPTHS[geometry["type"]], [geometry["coordinates"]]
            for _ in range(depth):
                parts = [part for several in parts for part in several]
            if geometry["type"].endswith("Point"):
                parts = [[part] for part in parts]
            found += lines([part for part in parts if part]) if any(parts) else []
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ReadError(f"This is not GeoJSON of lines, polygons or points: {error!r}.", path=called) from error
    if not found:
        raise ReadError("It holds no lines, polygons or points.", path=called)
    return moved(found, data, places)


def moved(found: list[Array], data: dict[str, Any], places: Places) -> list[Array]:
    """Lines of a GeoJSON object in the terrain's CRS."""
    name = crs_name(data)
    if name is None:
        return [places.of_lonlat(line) for line in found]
    move = transformer(name, places.grid.crs)
    return [np.stack(move(line[:, 0], line[:, 1]), axis=-1) for line in found]
