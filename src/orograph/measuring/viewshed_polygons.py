"""Visible ground as polygons: the outlines of the samples that an eye sees, for a GIS.

A sample stands for its cell. Visible cells that share an edge are one polygon, with holes. GDAL traces them
(``GDALPolygonize``) in a scratch raster of a byte per sample, row by row, so only the outlines are in memory
as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from orograph.errors import UsageError
from orograph.folders import temporary
from orograph.geo.grid import Grid
from orograph.geo.vector_files import ENDINGS, Batch, check_vector_file, vector_file

Values = NDArray[np.float32]

COLUMNS = {"grid_m2": np.float64}
"""The attributes of a polygon: its area on the grid, square metres."""
TOGETHER = 5_000
"""Polygons written at once."""


def check_polygons(path: Path, heights: bool, crs: CRS | None) -> bool:
    """Whether a viewshed goes to such a file as polygons, rather than as a GeoTIFF.

    Raises:
        UsageError: it can be written as neither, or needed ``heights`` as polygons.
    """
    ending = path.suffix.lower()
    if ending in (".tif", ".tiff"):
        return False
    if ending not in ENDINGS:
        raise UsageError(
            f"A viewshed cannot be written as {ending or 'a file without ending'}.", path=path,
            remedy=f"Use .tif, or for polygons {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}.",
        )  # fmt: skip
    if heights:
        raise UsageError("Heights that targets need are a raster, not polygons.", path=path, remedy="Write a .tif.")
    check_vector_file(path, crs, "Polygons")
    return True


def save_polygons(path: Path, grid: Grid, blocks: Iterable[tuple[int, int, Values]]) -> None:
    """Write the visible ground, one polygon with the column ``grid_m2`` for each connected part.

    Args:
        path: ends in one of ``vector_files.ENDINGS``.
        grid: of the viewshed. blocks: of the viewshed, first row, first column and values above 0 where it is visible.

    Raises:
        OutputError: the file cannot be written.
    """
    with temporary() as folder, vector_file(path, grid.crs, dict(COLUMNS), "Polygon") as write:
        scratch = _seen(Path(folder) / "seen.tif", grid, blocks)
        together: list[list[NDArray[np.float64]]] = []
        for rings in _outlines(scratch):
            together.append(rings)
            if len(together) == TOGETHER:
                write(_batch(together))
                together = []
        if together:
            write(_batch(together))


def _seen(path: Path, grid: Grid, blocks: Iterable[tuple[int, int, Values]]) -> Path:
    """A scratch raster, 1 where ground is visible and 0 elsewhere."""
    import rasterio
    from rasterio.windows import Window

    with rasterio.open(
        path, "w", driver="GTiff", width=grid.cols, height=grid.rows, count=1, dtype="uint8", transform=grid.transform,
        tiled=True, compress="deflate", zlevel=1, bigtiff="if_safer",
    ) as file:  # fmt: skip
        for row, col, values in blocks:
            file.write((values > 0).astype(np.uint8), 1, window=Window(col, row, *values.shape[::-1]))
    return path


def _outlines(path: Path) -> Iterator[list[NDArray[np.float64]]]:
    """The rings (n, 2) of each connected part, the outer one first and counter-clockwise, the holes clockwise."""
    import rasterio
    from rasterio.features import shapes

    with rasterio.open(path) as file:
        band = rasterio.band(file, 1)
        found: Any = shapes(band, mask=band, connectivity=4, transform=file.transform)
        for shape, _ in found:
            rings = [np.array(ring, np.float64) for ring in shape["coordinates"]]
            yield [ring if (_area(ring) > 0) == (k == 0) else ring[::-1] for k, ring in enumerate(rings)]


def _area(ring: NDArray[np.float64]) -> float:
    """The area of a closed ring, negative if it turns clockwise."""
    x, y = (ring - ring[0]).T
    return 0.5 * float(math.fsum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _batch(polygons: list[list[NDArray[np.float64]]]) -> Batch:
    rings = [ring for polygon in polygons for ring in polygon]
    offsets, parts = (
        np.cumsum([0, *map(len, of)], dtype=np.int64) for of in (rings, polygons)
    )  # fmt: skip
    areas = np.array([sum(map(_area, polygon)) for polygon in polygons])
    return Batch(np.concatenate(rings), offsets, {"grid_m2": areas}, parts)
