"""Features with attributes: points, lines and polygons from GeoJSON, from what OGR reads, from objects in memory.

GeoJSON is longitude and latitude (RFC 7946) unless an old-style ``crs`` says otherwise; an object's ``crs`` (GeoPandas)
is its own. Of files that OGR reads only what meets the terrain is read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import locate, stamped
from orograph.errors import ReadError, UsageError
from orograph.geo import geojson
from orograph.geo.grid import Grid
from orograph.geo.wkb import Part, parse
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.shared import reading_once

Array = NDArray[np.float64]
Kind = Literal["points", "lines", "polygons"]

GEOJSON = (".geojson", ".json")
VECTORS = (".gpkg", ".shp", ".fgb", ".kml", ".gml", ".parquet", ".gdb", ".geojsonl", ".geojsons", ".gpx", ".tab",
           ".mif", ".dxf", ".sqlite", ".shz")  # fmt: skip

MOST_CLASSES = 12
"""Maximum distinguishable classes of texts."""

SIMPLE: dict[str, Kind] = {"Point": "points", "LineString": "lines", "Polygon": "polygons"}


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of one kind.

    Attributes:
        kind: what they are. parts: of each feature its places, its lines, or all rings of its polygons, each (n, 3)
            x, y, z, NaN where there is no z.
        columns: attributes by name, one for each feature: numbers (NaN where there is none), or texts ("" where none).
        crs: of x and y; None: the terrain's own. name: what the source is called.
    """

    kind: Kind
    parts: list[list[Array]]
    columns: dict[str, NDArray[Any]]
    crs: Any
    name: str

    def __len__(self) -> int:
        return len(self.parts)


def has_features(source: Any) -> bool:
    """Whether a dataset's source holds features, by its looks: no raster, and no table."""
    if isinstance(source, str):
        return Path(source).suffix.lower() in (*GEOJSON, *VECTORS)
    if isinstance(source, Mapping):
        return "type" in source and ("features" in source or "geometry" in source or "coordinates" in source)
    return hasattr(source, "__geo_interface__")


def read_features(given: Dataset, grid: Grid) -> Features:
    """The features of a dataset; of large files those that may meet a terrain with this grid.

    Raises:
        ReadError: the file cannot be read, or holds none.
        UsageError: there are several kinds of geometry, or several layers, and none is chosen.
    """
    source = given.source
    if isinstance(source, str) and Path(source).suffix.lower() not in GEOJSON:
        near = stamped(locate(source)), given.layer, grid
        name, found, columns, crs = reading_once("features", near, lambda: _of_vectors(given, grid))
    elif isinstance(source, str):
        location = locate(source)
        name, found, columns, crs = reading_once("features", stamped(location), lambda: _of_geojson(location, source))
    else:
        name, found, columns, crs = _of_geojson(source, source)
    kinds = {kind: sum(kind == one for parts in found for one, _ in parts) for kind in SIMPLE.values()}
    there = [kind for kind, count in kinds.items() if count]
    if not there:
        raise ReadError(
            "It holds no point, line or polygon" + (" near the terrain." if len(found) == 0 else "."), path=name,
            remedy="Give a file with geometries in the terrain's area.",
        )  # fmt: skip
    if given.geometry is None and len(there) > 1:
        raise UsageError(
            f"It mixes {' and '.join(f'{kinds[kind]} {kind}' for kind in there)}, drawn differently.", path=name,
            remedy=f"Choose one kind: geometry={there[-1]}; several data show several.",
        )  # fmt: skip
    kind = given.geometry or there[0]
    if kind not in there:
        raise UsageError(f"It holds no {kind}, only {' and '.join(there)}.", path=name)
    keep = [i for i, parts in enumerate(found) if any(one == kind for one, _ in parts)]
    parts = [[array for one, arrays in found[i] if one == kind for array in arrays] for i in keep]
    return Features(kind, parts, {k: v[keep] for k, v in columns.items()}, crs, name)


def column(values: Iterable[Any]) -> NDArray[Any]:
    """An attribute: numbers if all that is known is a number, else texts."""
    raw = list(values)
    numbers = np.array([_number(value) for value in raw])
    told = [value is not None and value == value and value != "" for value in raw]
    if not any(t and not np.isfinite(n) and isinstance(v, str) for t, n, v in zip(told, numbers, raw)):
        return numbers
    return np.array([str(v) if t else "" for t, v in zip(told, raw)], object)


def classes_in(values: NDArray[Any], asked: str, name: str) -> tuple[Array, tuple[str, ...]]:
    """Of texts (n,) the numbers of their classes, NaN where there is none, and the classes' names.

    Raises:
        UsageError: there are more than can be told apart.
    """
    classes = sorted({str(text) for text in values if text})
    if len(classes) > MOST_CLASSES:
        raise UsageError(
            f"{asked} has {len(classes)} classes ({', '.join(classes[:3])}, …), but only {MOST_CLASSES} can be "
            "distinguished.",
            path=name, remedy="Choose an attribute with fewer classes, or one with numbers.",
        )  # fmt: skip
    numbered = {text: k for k, text in enumerate(classes)}
    return np.array([numbered.get(str(text), np.nan) for text in values], np.float64), tuple(classes)


def _number(value: Any) -> float:
    try:
        return float(value) if value is not None and not isinstance(value, bool) else np.nan
    except (TypeError, ValueError):
        return np.nan


# ---- GeoJSON -------------------------------------------------------------------------------------------------------


def _of_geojson(source: Any, called: Any) -> tuple[str, list[list[Part]], dict[str, NDArray[Any]], Any]:
    data, name = geojson.load(source)
    name = called if isinstance(called, str) else name
    told = geojson.crs_name(data)
    unknown = hasattr(source, "__geo_interface__") and hasattr(source, "crs") and source.crs is None
    features = data.get("features") if data.get("type") == "FeatureCollection" else [data]
    found, about = [], []
    for feature in features or []:
        geometry = feature.get("geometry") if feature.get("type") == "Feature" else feature
        try:
            found.append([part for one in geojson.geometries(geometry or {}) for part in _simple(one)])
        except (ValueError, TypeError, IndexError, KeyError) as error:
            raise ReadError(
                f"Feature {len(found) + 1} has no list of coordinates.", path=name, remedy="Correct or remove it."
            ) from error
        about.append(feature.get("properties") or {} if feature.get("type") == "Feature" else {})
    keys = dict.fromkeys(key for one in about for key in one)
    columns = {str(key): column(one.get(key) for one in about) for key in keys}
    return name, found, columns, None if unknown else told or "EPSG:4326"


def _simple(geometry: Mapping[str, Any]) -> list[Part]:
    """The simple geometries in one of GeoJSON, as ``wkb.parse`` has them."""
    kind, inside = geometry.get("type", ""), geometry.get("coordinates")
    if kind.startswith("Multi"):
        return [part for one in inside or () for part in _simple({"type": kind[5:], "coordinates": one})]
    if kind not in SIMPLE or not inside:
        return []
    arrays = [_places([inside] if kind == "Point" else inside)] if kind != "Polygon" else [_places(r) for r in inside]
    least = {"Point": 1, "LineString": 2, "Polygon": 3}[kind]
    return [(SIMPLE[kind], arrays)] if len(arrays[0]) >= least else []


def _places(given: Any) -> Array:
    out = np.full((len(given), 3), np.nan)
    for i, place in enumerate(given):
        out[i, : min(len(place), 3)] = place[:3]
    if not np.isfinite(out[:, :2]).all():
        raise ValueError("coordinates")
    return out


# ---- what OGR reads ------------------------------------------------------------------------------------------------


def _of_vectors(given: Dataset, grid: Grid) -> tuple[str, list[list[Part]], dict[str, NDArray[Any]], Any]:
    source = str(given.source)
    try:
        from pyogrio import list_layers, read_info
        from pyogrio.raw import read
    except ImportError as error:
        raise ReadError(
            "Files of this format need pyogrio.", path=source,
            remedy="Install orograph[vector], or convert them to GeoJSON.",
        ) from error  # fmt: skip
    from pyogrio.errors import DataLayerError, DataSourceError

    location = locate(source)
    try:
        layers = [str(name) for name in list_layers(location)[:, 0]]
        if given.layer is None and len(layers) > 1:
            raise UsageError(
                f"It holds {len(layers)} layers: {', '.join(layers)}.", path=source, remedy="Choose one: layer=NAME."
            )
        if given.layer is not None and given.layer not in layers:
            raise UsageError(f"It has no layer {given.layer!r}, only {', '.join(layers)}.", path=source)
        own = read_info(location, layer=given.layer)["crs"]
        box = None
        if own is not None and grid.crs is not None:
            from orograph.geovis.data.reach import Reach

            box = Reach.of(grid, own, source).plain
        meta, _, shapes, values = read(location, layer=given.layer, bbox=box)
    except (DataSourceError, DataLayerError) as error:
        raise ReadError(f"Its features cannot be read: {error}", path=source, remedy="Check what it holds.") from error
    try:
        found = [parse(shape) for shape in (shapes if shapes is not None else [])]
    except ValueError as error:
        raise ReadError(f"Its geometries cannot be read: {error}.", path=source) from error
    columns = {str(k): column(v.tolist()) for k, v in zip(meta["fields"], values)}
    return source, found, columns, meta["crs"]
