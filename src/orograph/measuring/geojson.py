"""Lines and polygons from GeoJSON (RFC 7946): longitude, latitude, unless an old-style ``crs`` member says otherwise.

A file may be a geometry, a feature, or a collection that holds one line or polygon (a polygon may have holes). A third
coordinate is ignored: heights are measured, not told.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.documents import parse
from orograph.errors import ReadError, UsageError
from orograph.geo.transform import transformer
from orograph.measuring.places import Places

Array = NDArray[np.float64]


def read_geojson(path: str | os.PathLike[str], kind: str, places: Places) -> list[Array]:
    """The rings of the file's polygon, or its line as a list of one, in the terrain's CRS.

    Args:
        kind: "Polygon" or "LineString".

    Raises:
        ReadError: the file cannot be read, or is no GeoJSON of one such geometry.
        UsageError: its coordinates cannot be brought to the terrain's CRS.
    """
    try:
        data = parse(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ReadError(f"It cannot be read: {error.strerror}.", path=path) from error
    except ValueError as error:
        raise ReadError(f"This is not JSON: {error}.", path=path) from error
    found = [g for g in _geometries(data) if g.get("type") == kind]
    if len(found) != 1:
        raise ReadError(
            f"It holds {len(found)} geometries of type {kind}, and one is measured at a time.", path=path,
            remedy=f"Give a GeoJSON file with one {kind}.",
        )  # fmt: skip
    try:
        parts = found[0]["coordinates"]
        rings = [np.array([p[:2] for p in part], np.float64) for part in (parts if kind == "Polygon" else [parts])]
        if not rings or any(ring.ndim != 2 or ring.shape[1] != 2 for ring in rings):
            raise ValueError("coordinates")
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ReadError(f"The {kind} has no list of coordinates.", path=path) from error
    name = _crs(data)
    if name is None:
        return [places.of_lonlat(ring) for ring in rings]
    move = transformer(name, places.grid.crs)
    return [np.stack(move(ring[:, 0], ring[:, 1]), axis=-1) for ring in rings]


def _geometries(data: Any) -> list[dict[str, Any]]:
    """All geometries in a GeoJSON object."""
    if not isinstance(data, dict):
        return []
    if data.get("type") == "FeatureCollection":
        return [g for feature in data.get("features") or [] for g in _geometries(feature)]
    if data.get("type") == "Feature":
        return _geometries(data.get("geometry"))
    if data.get("type") == "GeometryCollection":
        return [g for each in data.get("geometries") or [] for g in _geometries(each)]
    return [data]


def _crs(data: dict[str, Any]) -> str | None:
    """The name in an old-style ``crs`` member; None where it is longitude and latitude."""
    try:
        name = data["crs"]["properties"]["name"]
    except (KeyError, TypeError):
        return None
    if not isinstance(name, str):
        raise UsageError(f"The file's crs has no name that can be understood: {name!r}.")
    return None if name.rstrip("/").endswith(("CRS84", "4326")) else name
