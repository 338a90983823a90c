"""Geometries from GeoJSON (RFC 7946): longitude, latitude, unless an old-style ``crs`` member says otherwise."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.documents import parse
from orograph.errors import ReadError, UsageError

Array = NDArray[np.float64]


def load(given: Any) -> tuple[dict[str, Any], str]:
    """A GeoJSON object and its name: from a file, a mapping, or an object with ``__geo_interface__``.

    Raises:
        ReadError: the file cannot be read, or is not JSON. UsageError: it is none of these.
    """
    if isinstance(given, Mapping):
        return dict(given), "the geometry"
    if hasattr(given, "__geo_interface__"):
        return _with_crs(given), f"the {type(given).__name__}"
    if not isinstance(given, str | os.PathLike):
        raise UsageError(
            f"A geometry must be a GeoJSON file or object, or have __geo_interface__, not {type(given).__name__}."
        )
    try:
        return parse(Path(given).read_text(encoding="utf-8-sig")), os.fspath(given)
    except OSError as error:
        raise ReadError(f"It cannot be read: {error.strerror}.", path=given) from error
    except ValueError as error:
        remedy = "ogr2ogr -t_srs EPSG:4326 area.geojson FILE converts other formats to GeoJSON."
        raise ReadError(f"This is not JSON: {error}.", path=given, remedy=remedy) from error


def geometries(data: Any) -> list[dict[str, Any]]:
    """All geometries in a GeoJSON object."""
    if not isinstance(data, Mapping):
        return []
    if data.get("type") == "FeatureCollection":
        return [g for feature in data.get("features") or [] for g in geometries(feature)]
    if data.get("type") == "Feature":
        return geometries(data.get("geometry"))
    if data.get("type") == "GeometryCollection":
        return [g for each in data.get("geometries") or [] for g in geometries(each)]
    return [dict(data)]


def lines(parts: Any) -> list[Array]:
    """Lists of coordinates, each (n, 2); a third coordinate is dropped.

    Raises:
        ValueError: they are no such lists.
    """
    try:
        found = [np.array([p[:2] for p in part], np.float64) for part in parts]
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError("coordinates") from error
    if not found or any(one.ndim != 2 or one.shape[1] != 2 or not np.isfinite(one).all() for one in found):
        raise ValueError("coordinates")
    return found


def polygons(data: Any, called: str) -> list[list[Array]]:
    """The polygons of a GeoJSON object, each its rings (n, 2), the outer one first.

    Raises:
        ReadError: there is none, or one has no list of coordinates.
    """
    found: list[list[Array]] = []
    for geometry in geometries(data):
        kind, parts = geometry.get("type"), geometry.get("coordinates")
        try:
            if kind == "Polygon":
                found.append(lines(parts))
            elif kind == "MultiPolygon":
                found += [lines(one) for one in parts or ()]
        except (ValueError, TypeError) as error:
            raise ReadError(f"The {kind} has no list of coordinates.", path=called) from error
    if not found:
        raise ReadError("It holds no polygon.", path=called, remedy="Give GeoJSON with a Polygon or MultiPolygon.")
    return found


def crs_name(data: Mapping[str, Any]) -> str | None:
    """The name in an old-style ``crs`` member; None where it is longitude and latitude."""
    try:
        name = data["crs"]["properties"]["name"]
    except (KeyError, TypeError):
        return None
    if not isinstance(name, str):
        raise UsageError(f"The file's crs has no known name: {name!r}.")
    return None if name.rstrip("/").endswith(("CRS84", "4326")) else name


def _with_crs(given: Any) -> dict[str, Any]:
    """The GeoJSON of an object; a GeoDataFrame also gives its CRS."""
    data, crs = dict(given.__geo_interface__), getattr(given, "crs", None)
    if crs is not None and "crs" not in data:
        data["crs"] = {"properties": {"name": crs.to_wkt() if hasattr(crs, "to_wkt") else str(crs)}}
    return data
