"""``orograph.export``: heights of a terrain, or data as they lie on it, for other tools."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.exceptions import ProjError

from orograph._named import answering
from orograph.dem.area import both, box_window, checked, whole
from orograph.dem.header import copyright_tags
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.geo.grid import Grid
from orograph.geo.vertical import ELLIPSOIDAL
from orograph.geovis.data.dataset import Dataset, datasets_of
from orograph.lighting.raster import Band, Values, rectangles, write
from orograph.output import check_vacant
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.given import check_apart
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain

STEP = 1024
"""Samples along the side of the blocks that are read."""


@answering
def export(
    terrain: Any,
    output: str | os.PathLike[str],
    *,
    data: Any = (),
    bbox: Sequence[float] | str | None = None,
    overwrite: bool = False,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Path:
    """Write the heights of a terrain as a Cloud Optimized GeoTIFF: float32, metres, full resolution, NaN where missing.

    The file's CRS includes the vertical datum if it is known. It is written block by block, so any size works. With
    ``data``, the data are written instead: rasters at the terrain's samples, values and uncertainty, as a GeoTIFF
    (.tif) or NetCDF (.nc, CF-1.8, from memory); points with the height of the ground as .csv, .geojson or .gpkg.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        output: the file: .tif, of data also .nc, .csv, .geojson, .gpkg.
        data: a ``Dataset``, or several rasters; the derived value (``value``, ``exceeds``) is what is written.
        bbox: west, south, east, north of the area in degrees; None: all of it.
        overwrite: replace a file that is there.
        max_memory: bytes that heights may take. jobs: threads. progress: gets progress reports; False: silent.

    Returns:
        the path of the file.

    Raises:
        UsageError: the area is not in the terrain. ReadError, StoreError: the terrain cannot be read.
        OutputError: the file cannot be written, or exists.
    """
    max_memory = bytes_of(max_memory)
    datasets = datasets_of(data)
    path = check_output(output, overwrite, datasets)
    check_apart(path, terrain)
    heard = reporting(progress)
    ground = opened(terrain, heard, max_memory=max_memory, jobs=jobs, called="export", **reading)
    row0, row1, col0, col1 = (0, ground.grid.rows, 0, ground.grid.cols) if bbox is None else area_of(ground, bbox)
    grid = ground.grid.window(row0, row1, col0, col1)
    if datasets:
        from orograph.verbs.export_data import export_data

        export_data(ground, grid, datasets, path, max_memory=max_memory, jobs=jobs, progress=heard)
        return path
    parts = list(rectangles(grid.shape, STEP, STEP))

    def blocks() -> Iterator[tuple[int, int, int, Values]]:
        with heard.task("Reading heights", total=len(parts)) as task:
            for r0, r1, c0, c1 in parts:
                heights = ground.read(0, row0 + r0, row0 + r1, col0 + c0, col0 + c1)
                yield 0, r0, c0, np.ascontiguousarray(heights[None])
                task.advance()

    told = copyright_tags(ground.attribution)
    if ground.vertical is not None:
        told["VERTICAL_DATUM"] = ground.vertical
    band = Band("height", "m", f"height{f' above {ground.vertical}' if ground.vertical else ''}, metres")
    write(path, Grid(grid.shape, grid.transform, _with_vertical(ground)), [band], blocks(), tags=told, jobs=jobs,
          progress=heard)  # fmt: skip
    return path


def check_output(output: str | os.PathLike[str], overwrite: bool, data: Sequence[Dataset] = ()) -> Path:
    """The path of the file to write.

    Raises:
        UsageError: it is not a GeoTIFF, or such data cannot be written as this file. OutputError: the file exists.
    """
    path = Path(output)
    if data:
        from orograph.verbs.export_data import check_data_output

        check_data_output(path, data)
    elif path.suffix.lower() not in (".tif", ".tiff"):
        raise UsageError("Heights can only be written as a GeoTIFF: .tif.", path=path)
    check_vacant(path, overwrite)
    return path


def area_of(terrain: Terrain, bbox: Sequence[float] | str) -> tuple[int, int, int, int]:
    """First row, row after the last, first column, column after it of the samples in an area, degrees.

    Raises:
        UsageError: there is none, the area is not an area, or the terrain has no CRS.
    """
    box = checked(bbox)
    if terrain.grid.crs is None:
        raise UsageError("The terrain has no CRS, so an area in degrees cannot be located in it.", path=terrain.name)
    window = both(whole(terrain.grid), box_window(terrain.grid, box))
    if window[1] > window[0] and window[3] > window[2]:
        return window
    raise UsageError(
        f"No sample of the terrain lies within {', '.join(f'{v:g}' for v in box)}.", path=terrain.name,
        remedy="See where it is with orograph info.",
    )  # fmt: skip


def _with_vertical(terrain: Terrain) -> CRS | None:
    """The terrain's CRS with its vertical datum, if PROJ knows the datum by name."""
    crs, datum = terrain.grid.crs, terrain.vertical
    if crs is None or datum is None:
        return crs
    try:
        if datum.startswith(ELLIPSOIDAL):
            return crs.to_3d()
        return CompoundCRS(f"{crs.name} + {datum}", [crs, CRS.from_user_input(datum)])
    except ProjError:
        return crs
