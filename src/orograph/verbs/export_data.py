"""Write data for other tools, as they lie on a terrain: rasters at its samples, points with its heights.

A raster becomes a GeoTIFF with bands, or NetCDF with CF-1.8 attributes, holding values and their uncertainty at the
terrain's samples, interpolated as in pictures. Points become a table (CSV), GeoJSON, or a GeoPackage.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OutputError, UsageError
from orograph.geo.grid import Grid, wkt_of
from orograph.geovis.data.classes import says_classes
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.derived import deviations, read_data
from orograph.geovis.data.events import happened
from orograph.geovis.data.features import has_features, read_features
from orograph.geovis.data.field import Field, Values
from orograph.geovis.data.painting import as_shown
from orograph.geovis.data.points import is_table, read_points
from orograph.geovis.data.sampling import Positions
from orograph.lighting.raster import Band, rectangles, write
from orograph.measuring.ground import own_heights
from orograph.measuring.places import Places
from orograph.output import Beside, check_folder
from orograph.parallel import map_ordered
from orograph.progress import Progress
from orograph.store.terrain import TILE, Terrain

RASTERS = (".tif", ".tiff", ".nc")
TABLES = (".csv", ".geojson", ".gpkg")

UDUNITS = {"°C": "degC", "°": "degree", "%": "percent", "": "1", "m/s": "m s-1"}
"""Units in CF notation."""

DEVIATION = "standard deviation"


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A band or a variable: values (rows, cols) of a field, and its description."""

    name: str
    title: str
    unit: str
    note: str
    field: Field
    values: Values
    of: str | None = None
    """The layer whose uncertainty this is."""

    def over(self, grid: Grid) -> Values:
        """Its values at the samples of a grid."""
        at = Positions.of(grid, self.field)
        return at.nearest(self.values) if self.of is None and says_classes(self.field) else at.values(self.values)


def check_data_output(path: Path, data: Sequence[Dataset]) -> None:
    """Raise UsageError if data of these kinds cannot be written to a file with this ending."""
    ending = path.suffix.lower()
    tables = [one for one in data if has_features(one.source) or is_table(one.source)]
    if tables and len(data) > 1:
        raise UsageError(
            "Points are written one data set at a time.", path=path, remedy="Give `data` once, or rasters."
        )
    if ending not in (TABLES if tables else RASTERS):
        known = f"Points are written as {', '.join(TABLES)}" if tables else "Rasters are written as .tif or .nc"
        raise UsageError(f"{known}, not {ending or 'without an ending'}.", path=path)


def export_data(
    terrain: Terrain, grid: Grid, data: Sequence[Dataset], path: Path, *, max_memory: int | None, jobs: int | None,
    progress: Progress,
) -> None:  # fmt: skip
    """Write data on a terrain.

    Args:
        grid: the terrain's, or a window of it.

    Raises:
        ReadError, UsageError: data cannot be read, or cannot be written to such a file. OutputError: the file cannot be
        written.
    """
    check_folder(path)
    first = data[0]
    if has_features(first.source) or is_table(first.source):
        _table(terrain, grid, first, path)
        return
    layers = [layer for number, one in enumerate(data) for layer in _layers(one, terrain.grid, number)]
    if path.suffix.lower() == ".nc":
        _netcdf(layers, grid, path, max_memory, jobs, progress)
    else:
        _geotiff(layers, grid, path, jobs, progress)


def _layers(given: Dataset, grid: Grid, number: int) -> list[Layer]:
    field = read_data(given, grid)
    as_shown(given)  # (refuses a contradictory uncertainty)
    title = field.name if given.derived else given.name or field.name
    unit = field.unit if given.unit is None or given.exceeds is not None else given.unit
    name = re.sub(r"\W+", "_", title, flags=re.ASCII).strip("_").lower() or "data"
    name = name if name[0].isalpha() else f"data_{name}"
    name = name if number == 0 else f"{name}_{number + 1}"
    made = [Layer(name, title, unit, field.chosen, field, field.shown)]
    found = None if given.exceeds is not None else deviations(given, field, grid)
    if found is not None:
        half = given.uncertainty is not None and given.uncertainty.source == "ci90"
        what = "half of the central 90 %" if half else DEVIATION
        made.append(Layer(f"{name}_uncertainty", f"{title}: {what}", unit, field.chosen, *found, name))
    return made


Parts = Iterator[tuple[int, int, int, Values]]


def _blocks(layers: Sequence[Layer], grid: Grid, jobs: int | None, progress: Progress) -> Parts:
    """(0, first row, first column, values (layers, rows, cols))."""

    def look(window: tuple[int, int, int, int]) -> Values:
        part = grid.window(*window)
        return np.stack([layer.over(part) for layer in layers])

    windows = list(rectangles(grid.shape, TILE, 4 * TILE))
    with progress.task("Interpolating data", total=len(windows)) as task:
        for window, values in zip(windows, map_ordered(look, windows, jobs)):
            yield 0, window[0], window[2], values
            task.advance()


def _geotiff(layers: Sequence[Layer], grid: Grid, path: Path, jobs: int | None, progress: Progress) -> None:
    bands = [Band(layer.title, layer.unit, ", ".join(filter(None, (layer.title, layer.note)))) for layer in layers]
    write(path, grid, bands, _blocks(layers, grid, jobs, progress), tags={"software": "orograph"}, jobs=jobs,
          progress=progress)  # fmt: skip


def _netcdf(
    layers: Sequence[Layer], grid: Grid, path: Path, max_memory: int | None, jobs: int | None, progress: Progress
) -> None:
    """A classic NetCDF file with 64-bit offsets."""
    from scipy.io import netcdf_file

    if grid.transform.b or grid.transform.d:
        raise UsageError(
            "NetCDF needs coordinates along rows and columns, but the terrain's grid is rotated.", path=path,
            remedy="Write a GeoTIFF.",
        )  # fmt: skip
    size = 4 * len(layers) * grid.rows * grid.cols
    if 3 * size > (max_memory or 1 << 30) or size // len(layers) >= 1 << 31:
        raise UsageError(
            f"{size >> 20} MiB of values are too many for NetCDF, which is written from memory.", path=path,
            remedy="Write a GeoTIFF, or a part (`bbox`), or allow more memory (`max_memory`).",
        )  # fmt: skip
    values = np.empty((len(layers), *grid.shape), ">f4")
    for _, row, col, block in _blocks(layers, grid, jobs, progress):
        values[:, row : row + block.shape[1], col : col + block.shape[2]] = block
    x, _ = grid.xy(np.arange(grid.cols), 0)
    _, y = grid.xy(0, np.arange(grid.rows))
    with Beside(path) as part, netcdf_file(part, "w", version=2) as file:
        _say(file, Conventions="CF-1.8", source="Orograph")
        _axes(file, grid, x, y)
        for layer, own in zip(layers, values):
            _variable(file, layer, layers, own, grid.crs is not None)


def _axes(file: Any, grid: Grid, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    for name, places in (("y", y), ("x", x)):
        file.createDimension(name, len(places))
        axis = file.createVariable(name, "d", (name,))
        axis[:] = places
        _say(axis, units="m", axis=name.upper(), standard_name=f"projection_{name}_coordinate")
    if grid.crs is None:
        return
    mapping = file.createVariable("crs", "i", ())
    _say(mapping, **grid.crs.to_cf())


def _say(thing: Any, **attributes: Any) -> None:
    """Give a variable, or the file, attributes; strings as UTF-8, since SciPy takes bytes."""
    for key, value in attributes.items():
        setattr(thing, key, value.encode() if isinstance(value, str) else np.asarray(value, np.float64))


def _variable(file: Any, layer: Layer, layers: Sequence[Layer], values: NDArray[Any], placed: bool) -> None:
    made = file.createVariable(layer.name, "f", ("y", "x"))
    made[:] = values
    made._FillValue = np.float32(np.nan)
    doubts = " ".join(other.name for other in layers if other.of == layer.name)
    told = {
        "long_name": layer.title, "units": UDUNITS.get(layer.unit, layer.unit), "comment": layer.note,
        "grid_mapping": "crs" if placed else "", "ancillary_variables": doubts,
    }  # fmt: skip
    _say(made, **{key: value for key, value in told.items() if value})


def _table(terrain: Terrain, grid: Grid, given: Dataset, path: Path) -> None:
    features = read_features(given, terrain.grid) if has_features(given.source) else None
    if features is not None and features.kind != "points":
        raise UsageError(
            f"{features.kind.capitalize()} cannot be written, only points and rasters.", path=features.name
        )
    _, points, _ = happened(given, read_points(given, terrain.grid, features))
    col, row = grid.index(points.x, points.y)
    here = (col >= -0.5) & (row >= -0.5) & (col <= grid.cols - 0.5) & (row <= grid.rows - 0.5)
    places = np.stack([points.x, points.y], 1)[here]
    if not len(places):
        raise UsageError("None of the points lies in the area.", path=path, remedy="Choose another `bbox`.")
    degrees = Places(terrain).lonlat(places)
    columns: dict[str, NDArray[np.float64]] = {"x": places[:, 0], "y": places[:, 1]}
    if degrees is not None:
        columns |= {"longitude": degrees[:, 0], "latitude": degrees[:, 1]}
    columns["ground_height_m"] = own_heights(terrain, places)
    if points.classes is None:
        columns[points.name.replace(" ", "_")] = points.values[here]
    if points.sigma is not None:
        columns["uncertainty"] = points.sigma[here]
    writers: dict[str, Callable[..., None]] = {".csv": _csv, ".geojson": _geojson, ".gpkg": _geopackage}
    with Beside(path) as part:
        writers[path.suffix.lower()](columns, grid, part, path)


def _plain(value: float) -> float | None:
    return float(f"{value:.10g}") if np.isfinite(value) else None


def _csv(columns: dict[str, NDArray[np.float64]], grid: Grid, part: Path, path: Path) -> None:
    with part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in zip(*columns.values()):
            writer.writerow("" if not np.isfinite(value) else f"{value:.10g}" for value in row)


def _geojson(columns: dict[str, NDArray[np.float64]], grid: Grid, part: Path, path: Path) -> None:
    if "longitude" not in columns:
        raise UsageError("GeoJSON needs longitudes and latitudes, but the terrain has no CRS.", path=path,
                         remedy="Write a .csv.")  # fmt: skip
    features = []
    for row in zip(*columns.values()):
        told = {key: _plain(value) for key, value in zip(columns, row)}
        at = [told.pop("longitude"), told.pop("latitude")]
        geometry = {"type": "Point", "coordinates": at}
        features.append({"type": "Feature", "geometry": geometry, "properties": told})
    part.write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")


def _geopackage(columns: dict[str, NDArray[np.float64]], grid: Grid, part: Path, path: Path) -> None:
    try:
        from pyogrio.errors import DataSourceError
        from pyogrio.raw import write as write_features
    except ImportError as error:
        raise OutputError(
            "GeoPackages need pyogrio.", path=path, remedy="Install orograph[vector], or write .geojson or .csv."
        ) from error
    count = len(columns["x"])
    shapes = np.empty(count, object)
    raw = np.zeros(count, np.dtype([("order", "u1"), ("kind", "<u4"), ("x", "<f8"), ("y", "<f8")]))
    raw["order"], raw["kind"], raw["x"], raw["y"] = 1, 1, columns["x"], columns["y"]
    shapes[:] = [one.tobytes() for one in raw]  # WKB of points
    fields = [key for key in columns if key not in ("x", "y")]
    made = part.with_name(part.name + ".gpkg")
    try:
        write_features(
            str(made), shapes, [columns[key] for key in fields], fields, geometry_type="Point", driver="GPKG",
            crs=wkt_of(grid.crs), layer=path.stem,
        )  # fmt: skip
        made.replace(part)
    except DataSourceError as error:
        raise OutputError(f"The file cannot be written: {error}", path=path) from error
    finally:
        made.unlink(missing_ok=True)
