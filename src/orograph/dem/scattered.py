"""Scattered points with heights from files: tables (CSV), what OGR reads (GeoPackage, GeoJSON…), LAS and LAZ.

Tables name their columns; longitude and latitude are assumed to be WGS 84. Features are points in their own CRS; their
heights are their z, or an attribute. From LAS and LAZ, ground points (class 2) are read if there are any, else all but
noise; withheld ones never. Heights become metres; points without a place or a height are left out, with a message.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.handles import is_manifest, locate
from orograph.dem.header import parsed_crs
from orograph.dem.source import HUGE
from orograph.dem.tables import DEGREES, number, places_in, read_table
from orograph.dem.units import METRES, metres_per
from orograph.errors import ReadError, UsageError

TABLES = (".csv", ".tsv")
CLOUDS = (".las", ".laz")
VECTORS = (".gpkg", ".geojson", ".shp", ".fgb", ".kml", ".gml", ".parquet", ".geojsonl", ".geojsons", ".shz")

HEIGHTS = ("z", "height", "elevation", "elev", "altitude", "alt", "h", "height_m", "elevation_m", "ele")
"""Column names that mean heights, in order of preference."""

FILLS = (-9999.0, -99999.0, -32768.0, -32767.0, -999.0)
"""Common placeholders for missing heights."""

DEPTHS = "Its numbers are depths and become heights below 0 (give `vertical_unit` if they are not depths)."

GROUND, NOISE = 2, (7, 18)
"""Classes of LAS 1.4: ground; low and high noise."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Scattered:
    """Points with heights.

    Attributes:
        x, y: (n,) float64, in ``crs``. z: (n,) float64, metres.
        crs: of x and y; None: unknown, metres. vertical: the datum of the heights; None: unknown.
        name: the file's stem. path: as it was given. warnings: messages for the user, full sentences.
    """

    x: Array
    y: Array
    z: Array
    crs: CRS | None
    vertical: str | None
    name: str
    path: str
    warnings: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.z)


def is_points(path: str | os.PathLike[str]) -> bool:
    """Whether a file holds points rather than a raster, by its name; for a GeoPackage by its contents."""
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix != ".gpkg":
        return not is_manifest(path) and suffix in (*TABLES, *CLOUDS, *VECTORS)
    import sqlite3  # late, for only this needs it

    with (
        contextlib.suppress(sqlite3.Error),
        contextlib.closing(sqlite3.connect(f"file:{file.as_posix()}?mode=ro", uri=True)) as base,
    ):
        kinds = {kind for (kind,) in base.execute("SELECT data_type FROM gpkg_contents")}
        return "features" in kinds and not kinds & {"tiles", "2d-gridded-coverage"}
    return False


def read_scattered(
    path: str | os.PathLike[str], *, height_column: str | None = None, point_layer: str | None = None,
    point_classes: Sequence[int] | None = None, assume_crs: Any = None, vertical_unit: str | None = None,
    assume_vertical: str | None = None,
) -> Scattered:  # fmt: skip
    """The points of a file.

    Args:
        path: CSV, TSV, LAS, LAZ, or a file of vectors that OGR reads.
        height_column: the column or attribute that holds the heights, where it is not clear.
        point_layer: of a file of several layers.
        point_classes: of LAS and LAZ, the classes that are taken.
        assume_crs: of files that declare none.
        vertical_unit: of the heights, instead of the CRS's own.
        assume_vertical: the vertical datum of files that declare none.

    Raises:
        ReadError: the file cannot be read, a package that reads it is missing, or it holds no point with a height.
        UsageError: it is not clear which column holds the heights; an option does not fit the file.
    """
    text = os.fspath(path)
    suffix = Path(text).suffix.lower()
    if point_classes is not None and suffix not in CLOUDS:
        raise UsageError("`point_classes` apply to LAS and LAZ only.", path=text)
    if point_layer is not None and suffix not in VECTORS:
        raise UsageError("`point_layer` applies to files with several layers (GeoPackage…) only.", path=text)
    if height_column is not None and suffix in CLOUDS:
        raise UsageError("Points of LAS and LAZ have one height, no `height_column`.", path=text)
    warnings: list[str] = []
    if suffix in CLOUDS:
        x, y, z, crs = _of_cloud(text, point_classes, warnings)
    elif suffix in TABLES:
        x, y, z, crs = _of_columns(read_table(text), text, height_column, vertical_unit, warnings)
    else:
        x, y, z, crs = _of_vectors(text, height_column, point_layer, vertical_unit, warnings)
    return _settled(x, y, z, crs, text, warnings, assume_crs, vertical_unit, assume_vertical)


def _settled(
    x: Array, y: Array, z: Array, crs: CRS | None, path: str, warnings: list[str], assume_crs: Any,
    vertical_unit: str | None, assume_vertical: str | None,
) -> Scattered:  # fmt: skip
    """Points with places and heights, in metres of height, of a horizontal CRS."""
    from orograph.dem.header import assumed_vertical, crs_datum, horizontal, vertical_axis

    factor, vertical = 1.0, crs_datum(crs)
    if crs is None and assume_crs is not None:
        crs = parsed_crs(assume_crs)
        vertical = crs_datum(crs)
    elif assume_crs is not None and parsed_crs(assume_crs) != crs:
        warnings.append("Its points declare their own CRS, so `assume_crs` is not used for them.")
    axis = vertical_axis(crs)
    if axis is not None and axis.unit_conversion_factor > 0:
        factor = float(axis.unit_conversion_factor)
    if axis is not None and axis.direction == "down" and vertical_unit is None:
        factor = -factor
        warnings.append(DEPTHS)
    if vertical_unit is not None:
        metres = metres_per(vertical_unit)
        if metres is None:
            raise UsageError(f"{vertical_unit!r} is not a unit of length; there are {', '.join(sorted(METRES)[:8])}…")
        factor = metres
    if vertical is None and assume_vertical is not None:
        vertical = assumed_vertical(assume_vertical)
    elif vertical is not None and assume_vertical is not None and assumed_vertical(assume_vertical) != vertical:
        warnings.append(f"It declares its own vertical datum ({vertical}), so `assume_vertical` is not used for it.")
    z = np.where(np.abs(z) < HUGE, z, np.nan)
    there = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    if not there.any():
        raise ReadError(
            f"None of its {len(z)} points has both a position and a height." if len(z) else "It holds no points.",
            path=path, remedy="Check its contents, and name the column of heights (`height_column`).",
        )  # fmt: skip
    if not there.all():
        warnings.append(
            f"Of its {len(z):,} points {int((~there).sum()):,} lack a position or a height and are omitted."
        )
    x, y, z = x[there], y[there], z[there]
    code = next((n for n in FILLS if (z == n).any() and n < np.median(z) - 1000), None)
    if code is not None:
        warnings.append(
            f"Of its heights {int((z == code).sum()):,} are {code:g}, a usual number for missing ones: remove those "
            "points if they are."
        )
    z = z * factor
    if crs is None and (np.abs(x) <= 360).all() and (np.abs(y) <= 90).all():
        warnings.append("Its x and y look like degrees but are taken as metres (give `assume_crs`, e.g. EPSG:4326).")
    elif crs is None:
        warnings.append("It has no CRS; its coordinates are taken to be metres (give `assume_crs=CODE`).")
    return Scattered(x, y, z, horizontal(crs), vertical, Path(path).stem, path, warnings)


def _of_columns(
    columns: dict[str, Array], path: str, height: str | None, unit: str | None, warnings: list[str]
) -> tuple[Array, Array, Array, CRS | None]:
    """Places and heights from columns."""
    east, north = places_in(columns, path, "a projected CRS (`assume_crs`)")
    others = {k: v for k, v in columns.items() if k not in (east, north) and np.isfinite(v).any()}
    crs = CRS.from_epsg(4326) if east.lower() in DEGREES else None
    return columns[east], columns[north], _heights(others, height, path, unit, warnings), crs


def _heights(
    columns: dict[str, Array], column: str | None, path: str, unit: str | None, warnings: list[str]
) -> Array:  # fmt: skip
    """The column of heights, negative if its name says that they are depths.

    Warns of a unit in its name that is ignored.
    """
    name = _height_of(columns, column, path)
    words = set(re.split(r"[^a-z]+", name.lower()))
    if unit is None and words & {"ft", "feet", "foot", "ftus", "cm", "mm", "km"}:
        warnings.append(
            f"Its column {name!r} is taken to be in metres, although its name does not say so (give `vertical_unit`)."
        )
    if unit is None and words & {"depth", "depths", "sounding", "soundings"} and np.nanmedian(columns[name]) > 0:
        warnings.append(DEPTHS)
        return -columns[name]
    return columns[name]


def _height_of(columns: dict[str, Array], column: str | None, path: str) -> str:
    """The name of the column that holds the heights."""
    if column is not None:
        if column not in columns:
            there = ", ".join(columns) or "none"
            raise UsageError(
                f"There is no column {column!r} with numbers; there are {there}.", path=path,
                remedy="Name the column that holds heights (`height_column`).",
            )  # fmt: skip
        return column
    known = [k for word in HEIGHTS for k in columns if k.lower() == word]
    if len(known) > 1:
        raise UsageError(
            f"Several of its columns may hold the heights: {', '.join(known)}.", path=path,
            remedy="Name the right one (`height_column`).",
        )  # fmt: skip
    if known:
        return known[0]
    if len(columns) == 1:
        return next(iter(columns))
    if not columns:
        raise ReadError("It has no column with numbers for the heights.", path=path, remedy="Check its contents.")
    raise UsageError(
        f"It is not clear which of its columns holds the heights: {', '.join(columns)}.", path=path,
        remedy="Name it (`height_column`).",
    )  # fmt: skip


def _of_cloud(
    path: str, classes: Sequence[int] | None, warnings: list[str]
) -> tuple[Array, Array, Array, CRS | None]:  # fmt: skip
    """Points from LAS or LAZ."""
    try:
        import laspy
    except ImportError as error:
        raise ReadError(
            "LAS and LAZ need laspy.", path=path, remedy="Install orograph[points], or convert them to CSV."
        ) from error
    from laspy.errors import LaspyException

    file = locate(path)
    try:
        with laspy.open(file) as reader:
            cloud = reader.read()
            header, crs = reader.header, reader.header.parse_crs()
    except (LaspyException, OSError, ValueError, RuntimeError) as error:
        raise ReadError(f"Its points cannot be read: {error}", path=path, remedy="Fetch or make it again.") from error
    except Exception as error:  # (the decoder's own exception)
        if type(error).__module__.partition(".")[0] not in ("lazrs", "laspy"):
            raise
        raise ReadError(f"Its points cannot be read: {error}", path=path, remedy="Fetch or make it again.") from error
    _check_cloud(cloud, header, path)
    kind = np.asarray(cloud.classification)
    if classes is not None:
        wanted = np.isin(kind, list(classes))
        which = f"of class {', '.join(map(str, classes))}"
    elif (kind == GROUND).any():
        wanted, which = kind == GROUND, "of the ground (class 2)"
    else:
        wanted, which = ~np.isin(kind, NOISE), "that are not noise (none is classified as ground)"
    withheld = np.asarray(cloud.withheld).astype(bool) if "withheld" in cloud.point_format.dimension_names else False
    wanted &= ~np.asarray(withheld)
    if not wanted.any() and len(kind):
        there = ", ".join(map(str, np.unique(kind)))
        raise ReadError(
            f"It has no points {which}; its classes are {there}.", path=path, remedy="Name others: `point_classes`."
        )
    if not wanted.all():
        warnings.append(f"Of its {len(kind):,} points the {int(wanted.sum()):,} {which} are taken (`point_classes`).")
    places = [np.asarray(axis, np.float64)[wanted] for axis in (cloud.x, cloud.y, cloud.z)]
    return places[0], places[1], places[2], None if crs is None else CRS.from_user_input(crs)


def _check_cloud(cloud: Any, header: Any, path: str) -> None:
    """Raise ReadError unless there are as many points as the header says, if it does (LAS 1.4, section 2.4)."""
    fault = None
    if len(cloud) != header.point_count:
        fault = f"Its header declares {header.point_count:,} points, and it holds {len(cloud):,}"
    elif not str(path).lower().endswith(".laz") and (behind := _behind(header, path)):
        fault = f"It has {behind:,} bytes behind its {len(cloud):,} points: its header says too few"
    for axis, name in enumerate("xyz") if fault is None and len(cloud) else ():
        values = np.asarray(getattr(cloud, name), np.float64)
        low, high, step = header.mins[axis], header.maxs[axis], 1.5 * abs(header.scales[axis])
        if (low, high) != (0, 0) and not (low - step <= values.min() and values.max() <= high + step):
            fault = (
                f"Its header has {name} between {low:.10g} and {high:.10g}, and its points are between "
                f"{values.min():.10g} and {values.max():.10g}"
            )
            break
    if fault is not None:
        raise ReadError(
            f"{fault}.", path=path, remedy="It is damaged or was written incorrectly: fetch it again, or rewrite it."
        )


def _behind(header: Any, path: str) -> int:
    """Bytes after a LAS file's points that are not extended records."""
    end = header.offset_to_point_data + header.point_count * header.point_format.size
    extended = getattr(header, "number_of_evlrs", 0) or getattr(header, "start_of_waveform_data_packet_record", 0)
    return 0 if extended else max(Path(locate(path)).stat().st_size - end, 0)


def _of_vectors(
    path: str, height: str | None, layer: str | None, unit: str | None, warnings: list[str]
) -> tuple[Array, Array, Array, CRS | None]:
    """Points from features that OGR reads."""
    try:
        from pyogrio import list_layers
        from pyogrio.raw import read
    except ImportError as error:
        raise ReadError(
            "Files of this format need pyogrio.", path=path, remedy="Install orograph[vector], or convert them to CSV."
        ) from error
    from pyogrio.errors import DataLayerError, DataSourceError

    from orograph.geo.wkb import parse

    file = locate(path)
    try:
        layers = [str(name) for name in list_layers(file)[:, 0]]
        if layer is None and len(layers) > 1:
            raise UsageError(
                f"It holds {len(layers)} layers: {', '.join(layers)}.", path=path, remedy="Choose one: `point_layer`."
            )
        if layer is not None and layer not in layers:
            raise UsageError(f"It has no layer {layer!r}, only {', '.join(layers)}.", path=path)
        meta, _, shapes, values = read(file, layer=layer)
        found = [parse(shape) for shape in (shapes if shapes is not None else [])]
    except (DataSourceError, DataLayerError, ValueError) as error:
        raise ReadError(f"Its points cannot be read: {error}", path=path, remedy="Check its contents.") from error
    parts = [[places for kind, arrays in one if kind == "points" for places in arrays] for one in found]
    if not any(parts):
        raise ReadError("It holds no points.", path=path, remedy="Name a file, or a layer, of points with heights.")
    at = np.concatenate([array for own in parts for array in own])
    of = np.repeat(np.arange(len(parts)), [sum(map(len, own)) for own in parts])
    columns = {str(k): np.array([number(v) for v in column.tolist()])[of] for k, column in zip(meta["fields"], values)}
    columns = {k: v for k, v in columns.items() if np.isfinite(v).any()}
    crs = None if not meta["crs"] else CRS.from_user_input(meta["crs"])
    if others := sum(kind != "points" for one in found for kind, _ in one):
        warnings.append(f"{others:,} of its features are lines or areas, which are ignored.")
    if height is None and np.isfinite(at[:, 2]).any():
        other = [k for k in columns if k.lower() in HEIGHTS]
        if other and not np.nan_to_num(at[:, 2]).any():
            warnings.append(f"The z of its points is 0, and they have {', '.join(other)} (`height_column`).")
        return at[:, 0], at[:, 1], at[:, 2], crs
    return at[:, 0], at[:, 1], _heights(columns, height, path, unit, warnings), crs
