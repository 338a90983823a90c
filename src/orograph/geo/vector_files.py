"""Write lines or polygons with attributes to files for other tools, batch by batch.

GeoPackage, Shapefile and FlatGeobuf by GDAL (pyogrio), GeoParquet 1.1 by pyarrow, GeoJSON (RFC 7946: longitude and
latitude, to the nanodegree) as text. A file appears when it is complete.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from orograph.errors import OutputError, UsageError
from orograph.geo.grid import wkt_of
from orograph.geo.operations import same_body
from orograph.geo.transform import transformer
from orograph.output import Beside, remove

Array = NDArray[np.float64]

WGS84 = CRS.from_epsg(4326)
DRIVERS = {".gpkg": "GPKG", ".shp": "ESRI Shapefile", ".fgb": "FlatGeobuf"}
"""GDAL drivers by file ending."""
ENDINGS = (".gpkg", ".geojson", ".shp", ".parquet", ".fgb")
"""Endings of files of lines or polygons."""
ONCE = (".fgb",)
"""Formats that cannot be appended to: all lines are written together."""


@dataclass(frozen=True, slots=True)
class Batch:
    """A batch of lines or polygons.

    Attributes:
        points: (n, 2) in the CRS. offsets: (m + 1,): line or ring i is points[offsets[i]:offsets[i + 1]].
        columns: by name attributes, one value for each line or polygon.
        rings: of polygons (k + 1,): polygon j has the rings rings[j]:rings[j + 1], closed, the outer one first and
            counter-clockwise, the others clockwise. None: lines.
    """

    points: Array
    offsets: NDArray[np.int64]
    columns: dict[str, NDArray[Any]]
    rings: NDArray[np.int64] | None = None


Writer = Callable[[Batch], None]


def check_vector_file(path: Path, crs: CRS | None, what: str = "Lines") -> None:
    """Raise UsageError unless lines (or ``what`` else) can be written to such a file on this machine; OutputError if
    layers of other origin would be lost with a GeoPackage that is there."""
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise UsageError(
            f"{what} cannot be written as {ending or 'a file without ending'}.", path=path,
            remedy=f"Use {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}.",
        )  # fmt: skip
    if ending == ".geojson" and crs is None:
        raise UsageError(
            "GeoJSON needs longitudes and latitudes, but the terrain has no CRS.", path=path, remedy="Write a .gpkg.",
        )  # fmt: skip
    module, extra = ("pyarrow", "parquet") if ending == ".parquet" else ("pyogrio", "vector")
    if ending != ".geojson":
        import importlib

        try:
            importlib.import_module(module)
        except ImportError as error:
            raise UsageError(
                f"A {ending} needs {module}, which is not installed.", path=path,
                remedy=f"Run pip install 'orograph[{extra}]', or write .geojson.",
            ) from error  # fmt: skip
    if others := _layers(path) - {path.stem}:
        layers = f"layer{'s' if len(others) > 1 else ''} {', '.join(sorted(others))}"
        raise OutputError(
            f"It holds the {layers}, which would be lost.", path=path, remedy="Write another file, or remove this one."
        )


def _layers(path: Path) -> set[str]:
    """The layers of a GeoPackage; none if there is no such file."""
    if path.suffix.lower() != ".gpkg" or not path.is_file():
        return set()
    with (
        contextlib.suppress(sqlite3.Error),
        contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as base,
    ):
        return {name for (name,) in base.execute("SELECT table_name FROM gpkg_contents")}
    return set()


@contextmanager
def vector_file(path: Path, crs: CRS | None, columns: dict[str, Any], kind: str = "LineString") -> Iterator[Writer]:
    """A function that writes lines to a file, batch by batch; the file is complete when the block ends.

    Args:
        columns: by name the dtype of each attribute.
        kind: "LineString" or "Polygon", which all of them are.

    Raises:
        OutputError: the file cannot be written.
    """
    ending = path.suffix.lower()
    with Beside(path) as part:
        if ending == ".geojson":
            with _geojson(part, crs) as writer:
                yield writer
        elif ending == ".parquet":
            with _parquet(part, crs, columns, kind) as writer:
                yield writer
        else:
            with _gdal(part, path, crs, columns, kind) as writer:
                yield writer


@contextmanager
def _geojson(part: Path, crs: CRS | None) -> Iterator[Writer]:
    assert crs is not None
    degrees = transformer(crs, WGS84 if same_body(crs, WGS84) else crs.geodetic_crs)
    with part.open("w", encoding="utf-8", newline="\n") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        begun = False

        def write(batch: Batch) -> None:
            nonlocal begun
            places = np.column_stack(degrees(batch.points[:, 0], batch.points[:, 1])).round(9)
            for i, told in enumerate(_rows(batch.columns)):
                shape = _shape(batch, i, places)
                feature = {"type": "Feature", "properties": told, "geometry": shape}
                file.write((",\n" if begun else "\n") + json.dumps(feature, allow_nan=False))
                begun = True

        yield write
        file.write("\n]}\n")


def _shape(batch: Batch, i: int, places: Array) -> dict[str, Any]:
    """The i-th line or polygon as GeoJSON; across the 180th meridian it goes on, not around the globe."""
    if batch.rings is None:
        line = places[batch.offsets[i] : batch.offsets[i + 1]]
        if (np.abs(np.diff(line[:, 0])) > 180).any():
            line = np.stack([np.unwrap(line[:, 0], period=360), line[:, 1]], -1)
        return {"type": "LineString", "coordinates": line.tolist()}
    bounds = batch.offsets[batch.rings[i] : batch.rings[i + 1] + 1]
    corners = places[bounds[0] : bounds[-1]].copy()
    corners[:, 0] -= 360 * np.round((corners[:, 0] - corners[0, 0]) / 360)
    rings = np.split(corners, bounds[1:-1] - bounds[0])
    return {"type": "Polygon", "coordinates": [ring.tolist() for ring in rings]}


@contextmanager
def _gdal(part: Path, path: Path, crs: CRS | None, columns: dict[str, Any], kind: str) -> Iterator[Writer]:
    from pyogrio.errors import DataSourceError
    from pyogrio.raw import write as write_features

    made, driver = part.with_name(part.name + path.suffix.lower()), DRIVERS[path.suffix.lower()]
    held: list[Batch] = []
    begun = False

    def flush(batch: Batch) -> None:
        nonlocal begun
        found = _wkb(batch)
        shapes = np.empty(len(found), object)
        shapes[:] = found
        values = [_plain(v) if driver == "ESRI Shapefile" else v for v in batch.columns.values()]
        write_features(
            str(made), shapes, values, list(batch.columns), geometry_type=kind, driver=driver, crs=wkt_of(crs),
            append=begun, **({"layer": path.stem} if driver == "GPKG" else {}),
        )  # fmt: skip
        begun = True

    try:
        yield held.append if path.suffix.lower() in ONCE else flush
        none = np.zeros(1, np.int64)
        empty = Batch(
            np.empty((0, 2)), none, {k: np.empty(0, v) for k, v in columns.items()}, none if kind == "Polygon" else None
        )
        if held or not begun:
            flush(_together([empty, *held]))
        made.replace(part)
        for other in part.parent.glob(f"{part.name}.*"):  # of a Shapefile: .shx, .dbf, .prj, .cpg
            other.replace(path.with_suffix(other.suffix))
    except DataSourceError as error:
        raise OutputError(f"The file cannot be written: {error}", path=path) from error
    finally:
        for left in part.parent.glob(f"{part.name}.*"):
            remove(left)


@contextmanager
def _parquet(part: Path, crs: CRS | None, columns: dict[str, Any], kind: str) -> Iterator[Writer]:
    import pyarrow
    import pyarrow.parquet

    geometry: dict[str, Any] = {"encoding": "WKB", "geometry_types": [kind],
                                "crs": None if crs is None else crs.to_json_dict()}  # fmt: skip
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": geometry}}
    fields = [pyarrow.field(name, pyarrow.from_numpy_dtype(np.dtype(kind))) for name, kind in columns.items()]
    schema = pyarrow.schema([*fields, pyarrow.field("geometry", pyarrow.binary())], {"geo": json.dumps(geo)})
    with pyarrow.parquet.ParquetWriter(part, schema, compression="zstd") as file:

        def write(batch: Batch) -> None:
            arrays = [pyarrow.array(values) for values in batch.columns.values()]
            file.write_table(pyarrow.Table.from_arrays([*arrays, pyarrow.array(_wkb(batch))], schema=schema))

        yield write


def _together(batches: list[Batch]) -> Batch:
    columns = {name: np.concatenate([b.columns[name] for b in batches]) for name in batches[0].columns}
    offsets = _chained([b.offsets for b in batches])
    of_polygons = [b.rings for b in batches if b.rings is not None]
    rings = _chained(of_polygons) if of_polygons else None
    return Batch(np.concatenate([b.points for b in batches]), offsets, columns, rings)


def _chained(offsets: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Offsets of lists, one after the other, as those of one list."""
    shift = np.cumsum([0, *(one[-1] for one in offsets[:-1])])
    return np.concatenate([[0], *(one[1:] + s for one, s in zip(offsets, shift))])


def _wkb(batch: Batch) -> list[bytes]:
    """Lines or polygons as well-known binary (OGC 06-103r4, 8), little endian."""
    points = np.ascontiguousarray(batch.points, "<f8")
    bounds = zip(batch.offsets[:-1].tolist(), batch.offsets[1:].tolist())
    if batch.rings is None:
        return [struct.pack("<BII", 1, 2, b - a) + points[a:b].tobytes() for a, b in bounds]
    rings = [struct.pack("<I", b - a) + points[a:b].tobytes() for a, b in bounds]
    parts = zip(batch.rings[:-1].tolist(), batch.rings[1:].tolist())
    return [struct.pack("<BII", 1, 3, b - a) + b"".join(rings[a:b]) for a, b in parts]


def _rows(columns: dict[str, NDArray[Any]]) -> Iterator[dict[str, Any]]:
    for row in zip(*(values.tolist() for values in columns.values())):
        yield dict(zip(columns, row))


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Booleans as integers, for formats without booleans."""
    return values.astype(np.int32) if values.dtype == np.bool_ else values
