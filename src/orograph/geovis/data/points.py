"""Points with values: stations, quakes, samples; of GeoJSON, of tables (CSV), of columns in memory, of other vectors.

Places are longitude and latitude where a file's columns are called so, or its format says so (GeoJSON, RFC 7946); else
they are in the terrain's CRS, or in the file's. What is no number is missing.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import locate
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset

Array = NDArray[np.float64]

TABLES = (".csv", ".tsv", ".txt")
GEOJSON = (".geojson", ".json")
VECTORS = (".gpkg", ".shp", ".fgb", ".kml", ".gml", ".parquet", ".gdb")

EAST = ("longitude", "lon", "long", "lng", "x", "easting", "east")
NORTH = ("latitude", "lat", "y", "northing", "north")
DEGREES = ("longitude", "lon", "long", "lng")


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Values at places.

    Attributes:
        x, y: (n,) in the terrain's CRS, of those on the terrain. values: (n,). sigma: (n,) standard deviations;
            None: unknown.
        name: what they are.
    """

    x: Array
    y: Array
    values: Array
    sigma: Array | None
    name: str


def are_points(source: Any) -> bool:
    """Whether a dataset's source holds points, and no raster."""
    if isinstance(source, str):
        return Path(source).suffix.lower() in (*TABLES, *GEOJSON, *VECTORS)
    return isinstance(source, Mapping) or hasattr(source, "__geo_interface__") or hasattr(source, "columns")


def read_points(given: Dataset, grid: Grid) -> Points:
    """The points of a dataset that lie on a terrain with this grid, and have a value.

    Raises:
        ReadError: the file cannot be read, or none of its points lies on the terrain.
        UsageError: it is not clear which attribute is meant.
    """
    columns, crs, name = _columns(given.source)
    east, north = (next((k for k in columns if k.lower() in known), None) for known in (EAST, NORTH))
    if east is None or north is None:
        raise ReadError(
            f"Its columns do not say where the points lie; they are {', '.join(columns)}.", path=name,
            remedy="Call them longitude and latitude, or x and y in the terrain's CRS.",
        )  # fmt: skip
    if crs is None and east.lower() in DEGREES:
        crs = "EPSG:4326"
    numbers = {k: v for k, v in columns.items() if k not in (east, north) and np.isfinite(v).any()}
    value = _attribute(given.variable, numbers, name)
    doubt = given.uncertainty
    sigma = None if doubt is None else _attribute(doubt.source, numbers, name)
    if sigma is not None and (numbers[sigma] < 0).any():
        raise ReadError(f"{sigma} is a standard deviation, never negative.", path=name, remedy="Name another.")
    x, y = columns[east], columns[north]
    if crs is not None and grid.crs is not None:
        from orograph.geo.transform import transformer

        x, y = transformer(crs, grid.crs)(x, y)
    col, row = grid.index(x, y)
    with np.errstate(invalid="ignore"):
        here = (col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1) & np.isfinite(numbers[value])
    if not here.any():
        raise ReadError(
            f"None of its {len(x)} points lies on the terrain and has a {value}.", path=name,
            remedy="Name data of the same area.",
        )  # fmt: skip
    spread = None if sigma is None else np.nan_to_num(numbers[sigma][here])
    return Points(x[here], y[here], numbers[value][here], spread, value.replace("_", " "))


def _attribute(asked: Any, numbers: Mapping[str, Array], name: str) -> str:
    if asked is None and len(numbers) == 1:
        return next(iter(numbers))
    if asked in numbers:
        return str(asked)
    what = "There are several attributes" if asked is None else f"There is no attribute {asked!r} of numbers"
    raise UsageError(f"{what}: {', '.join(numbers) or 'none'}.", path=name, remedy="Choose one: variable=NAME.")


def _columns(source: Any) -> tuple[dict[str, Array], Any, str]:
    """Columns of numbers by name, their CRS (None: not known), and what the source is called."""
    if not isinstance(source, str):
        return _of_memory(source)
    path = Path(locate(source))
    ending = path.suffix.lower()
    try:
        if ending in TABLES:
            with path.open(newline="", encoding="utf-8-sig") as file:
                sample = file.read(4096)
                file.seek(0)
                mark = max(",;\t", key=sample.split("\n", 1)[0].count)
                rows = list(csv.DictReader(file, delimiter=mark))
            keys = [k for k in (rows[0] if rows else {}) if k]
            return {k.strip(): np.array([_number(row.get(k)) for row in rows]) for k in keys}, None, source
        if ending in GEOJSON:
            return (*_of_geojson(json.loads(path.read_text("utf-8"))), source)
    except (OSError, ValueError, csv.Error) as error:
        raise ReadError(f"Its points cannot be read: {error}", path=source, remedy="See what it holds.") from error
    return _of_vectors(source)


def _of_memory(source: Any) -> tuple[dict[str, Array], Any, str]:
    if hasattr(source, "__geo_interface__") and not isinstance(source, Mapping):
        columns, _ = _of_geojson(source.__geo_interface__)
        return columns, getattr(source, "crs", None) or "EPSG:4326", "points"
    if isinstance(source, Mapping) and source.get("type") in ("FeatureCollection", "Feature"):
        return (*_of_geojson(source), "points")
    keys = list(source) if isinstance(source, Mapping) else list(source.columns)
    return {str(k): np.array([_number(v) for v in np.asarray(source[k])]) for k in keys}, None, "points"


def _of_geojson(found: Mapping[str, Any]) -> tuple[dict[str, Array], Any]:
    """Points of features; of lines and polygons none. Attributes that are no numbers are missing."""
    features = found.get("features", [found] if found.get("type") == "Feature" else [])
    rows: list[dict[str, float]] = []
    for feature in features:
        shape: Mapping[str, Any] = feature.get("geometry") or {}
        where = shape.get("coordinates")
        places: list[Any] = {"Point": [where], "MultiPoint": where}.get(shape.get("type", "")) or []
        about = {k: _number(v) for k, v in (feature.get("properties") or {}).items()}
        for place in places:
            height = {"z": float(place[2])} if len(place) > 2 else {}
            rows.append({**height, **about, "longitude": float(place[0]), "latitude": float(place[1])})
    keys = dict.fromkeys(key for row in rows for key in row)
    return {k: np.array([row.get(k, np.nan) for row in rows]) for k in keys}, "EPSG:4326"


def _of_vectors(source: str) -> tuple[dict[str, Array], Any, str]:
    """Of any format that OGR reads."""
    try:
        from pyogrio.raw import read
    except ImportError as error:
        raise ReadError(
            "Points of this format need pyogrio.", path=source,
            remedy="Install orograph[vector], or convert them to GeoJSON.",
        ) from error  # fmt: skip
    from pyogrio.errors import DataSourceError

    try:
        meta, _, shapes, values = read(source)
    except DataSourceError as error:
        raise ReadError(f"Its points cannot be read: {error}", path=source, remedy="See what it holds.") from error
    places = np.array([_wkb_point(shape) for shape in shapes], np.float64).reshape(-1, 2)
    columns = {str(k): np.array([_number(v) for v in column]) for k, column in zip(meta["fields"], values)}
    return {**columns, "x": places[:, 0], "y": places[:, 1]}, meta["crs"], source


def _wkb_point(shape: bytes | None) -> tuple[float, float]:
    """x and y of a point in well-known binary; NaN of anything else."""
    if shape is None or len(shape) < 21:
        return np.nan, np.nan
    order = "<" if shape[0] == 1 else ">"
    if (int(np.frombuffer(shape, order + "u4", 1, 1)[0]) & 0xFFFF) % 1000 != 1:  # (Z, M and flags aside)
        return np.nan, np.nan
    x, y = np.frombuffer(shape, order + "f8", 2, 5)
    return float(x), float(y)


def _number(value: Any) -> float:
    try:
        return float(value) if value is not None and not isinstance(value, bool) else np.nan
    except (TypeError, ValueError):
        return np.nan
