"""Results of measuring: names and values for the panel, files, and a viewshed as an image over the ground."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.measuring import Places
from orograph.measuring.text import lines, metres, square
from orograph.store.terrain import Terrain
from orograph.viewer.data import Found
from orograph.viewpoint import Point

Kind = Literal["pick", "profile", "area", "los", "viewshed"]
"""Names as in ``orograph measure``."""
KINDS: tuple[Kind, ...] = ("pick", "profile", "area", "los", "viewshed")

SEEN = (255, 196, 64, 150)
HIDDEN = (20, 24, 40, 110)


def paint(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A viewshed (rows, cols) as colours (rows, cols, 4): light where visible, shade where not, clear beyond."""
    out = np.zeros((*values.shape, 4), np.uint8)
    out[values > 0.5] = SEEN
    out[values <= 0.5] = HIDDEN
    return out


def save_rgba(path: Path, pixels: NDArray[np.uint8], grid: Any) -> None:
    """A GeoTIFF (rows, cols, 4) on a grid.

    Raises:
        OutputError: it cannot be written.
    """
    import rasterio
    from rasterio.enums import ColorInterp

    from orograph.dem.writing import raster_file

    rows, cols = pixels.shape[:2]
    crs = {} if grid.crs is None else {"crs": grid.crs.to_wkt()}
    with (
        raster_file(path) as part,
        rasterio.open(
            part, "w", driver="GTiff", width=cols, height=rows, count=4, dtype="uint8", transform=grid.transform, **crs
        ) as file,
    ):
        file.colorinterp = ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha
        file.write(pixels.transpose(2, 0, 1))


def save(
    kind: Kind, result: Any, points: Sequence[Point], terrain: Terrain, stem: Path, found: Sequence[Found] = ()
) -> Path:
    """Write a result beside ``stem`` with the suffix of its kind: profiles as CSV, a viewshed as GeoTIFF, an area as
    GeoJSON with its numbers as properties (``orograph measure area --geojson`` takes it), a pick as JSON; the path.

    Args:
        points: the clicked points, in the terrain's CRS. found: the data at a pick, which its file lists, too.

    Raises:
        OutputError, OSError: it cannot be written.
    """
    if kind in ("profile", "los"):
        path = stem.with_name(stem.name + ".csv")
        result.save(path)
        return path
    if kind == "viewshed":
        path = stem.with_name(stem.name + ".tif")
        result[0].save(path)
        return path
    path, told = stem.with_name(stem.name + ".json"), result.to_dict()
    if found:
        told["data"] = [{"name": d.name, "value": d.value, "uncertainty": d.sigma, "unit": d.unit} for d in found]
    if kind == "area":
        corners = np.array(points)[:, :2]
        degrees = Places(terrain).lonlat(corners)
        told["corners"] = corners.tolist()
        if degrees is not None:
            path = stem.with_name(stem.name + ".geojson")
            if _area2(degrees) < 0:  # RFC 7946: counter-clockwise
                degrees = degrees[::-1]
            ring = [*degrees.tolist(), degrees[0].tolist()]
            told = {
                "type": "Feature", "properties": told, "geometry": {"type": "Polygon", "coordinates": [ring]},
            }  # fmt: skip
    path.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    return path


def _area2(ring: NDArray[np.float64]) -> float:
    """Twice the signed area of a ring (n, 2), positive counter-clockwise."""
    x, y = ring.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def rows(kind: Kind, result: Any) -> list[tuple[str, str]]:
    """(name, value) of a result."""
    if kind != "viewshed":
        return [(name, value) for name, value, _ in lines(result)]
    shed, values, _ = result
    known = np.isfinite(values)
    seen = float((values[known] > 0.5).mean()) if known.any() else 0.0
    cell = shed.grid.cell_area
    return [
        ("seen", f"{seen:.1%} within {metres(shed.radius)}"),
        ("", square(float((values[known] > 0.5).sum()) * cell)),
    ]
