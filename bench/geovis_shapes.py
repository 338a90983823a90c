"""Lines and polygons for ``bench/geovis.py``, made from local rasters and points.

They are land cover as polygons, earthquakes by hexagon, and the ways that water takes downhill.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

COVERS = {11: "Open water", 31: "Bare rock", 41: "Deciduous forest", 42: "Evergreen forest", 43: "Mixed forest",
          52: "Shrub", 71: "Grassland", **dict.fromkeys((21, 22, 23, 24), "Developed"),
          **dict.fromkeys((81, 82), "Fields"), **dict.fromkeys((90, 95), "Wetland")}  # fmt: skip
"""Classes of the National Land Cover Database 2011."""

COLORS = {"Open water": "#4d7fb5", "Bare rock": "#d9b48f", "Deciduous forest": "#8fbf3f", "Evergreen forest": "#1f6b3a",
          "Mixed forest": "#5e9e54", "Shrub": "#b9a05a", "Grassland": "#dbe39a", "Developed": "#a01c20",
          "Fields": "#e8c95a", "Wetland": "#6fb8b0"}  # fmt: skip


def collection(features: list[dict[str, Any]], crs: str | None = None) -> dict[str, Any]:
    extra = {} if crs is None else {"crs": {"type": "name", "properties": {"name": crs}}}
    return {"type": "FeatureCollection", "features": features, **extra}


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


def landcover(path: Path) -> dict[str, Any]:
    """Polygons of land cover from a raster of codes, without the smallest."""
    import rasterio
    import rasterio.features
    from scipy.ndimage import median_filter

    with rasterio.open(path) as file:
        codes, place, crs = median_filter(file.read(1), 9), file.transform, file.crs.to_string()
    names = sorted(set(COVERS.values()))
    number = np.zeros(256, np.uint8)
    for code, name in COVERS.items():
        number[code] = names.index(name) + 1
    found = rasterio.features.shapes(number[codes], number[codes] > 0, transform=place)
    return collection([feature(g["type"], g["coordinates"], cover=names[int(v) - 1]) for g, v in found], crs)


def hexagons(path: Path, attribute: str, radius: float = 0.15) -> dict[str, Any]:
    """Mean and standard error of points' values in hexagons with a radius of about ``radius`` degrees of latitude."""
    points = [
        (*one["geometry"]["coordinates"][:2], one["properties"][attribute])
        for one in json.loads(path.read_text())["features"] if one["properties"].get(attribute) is not None
    ]  # fmt: skip
    wide = 1 / np.cos(np.radians(37.5))
    dx, dy = radius * np.sqrt(3) * wide, 1.5 * radius
    cells: dict[tuple[float, float], list[float]] = {}
    for lon, lat, value in points:
        near = []
        for j in (np.floor(lat / dy), np.floor(lat / dy) + 1):
            shift = dx / 2 * (j % 2)
            x, y = round((lon - shift) / dx) * dx + shift, j * dy
            near.append((((lon - x) / wide) ** 2 + (lat - y) ** 2, x, y))
        cells.setdefault(min(near)[1:], []).append(value)
    turn = np.radians(np.arange(30, 391, 60))
    made = []
    for (x, y), values in cells.items():
        ring = np.stack([x + radius * wide * np.cos(turn), y + radius * np.sin(turn)], 1).tolist()
        error = float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 1.0
        made.append(feature("Polygon", [ring], mean=float(np.mean(values)), error=error))
    return collection(made)


def runs(terrain: Any, count: int = 200, steps: int = 900) -> dict[str, Any]:
    """Steepest-descent paths from places spread over a terrain, cut into pieces with the slope of each, m/km."""
    from scipy.ndimage import gaussian_filter

    raw = np.asarray(terrain.read(0, 0, terrain.grid.rows, 0, terrain.grid.cols), np.float64)
    heights = gaussian_filter(np.where(np.isfinite(raw), raw, np.nanmin(raw)), 3)
    down, across = np.gradient(heights)
    rng = np.random.default_rng(7)
    made, step, piece = [], max(terrain.grid.spacing), 15
    for _ in range(count):
        at, way = rng.uniform(0.05, 0.95, 2) * np.array(heights.shape), []
        for _ in range(steps):
            i, j = (int(v) for v in np.rint(at))
            if not (0 <= i < len(down) and 0 <= j < down.shape[1]) or (way and heights[i, j] > way[-1][2]):
                break
            way.append((*at[::-1], heights[i, j]))
            size = float(np.hypot(down[i, j], across[i, j]))
            at = at - np.array([down[i, j], across[i, j]]) / max(size, 1e-9)
        for k in range(0, len(way) - 1, piece):
            part = np.array(way[k : k + piece + 1])
            if len(part) < 5:
                continue
            x, y = terrain.grid.xy(part[:, 0], part[:, 1])
            fall = (part[0, 2] - part[-1, 2]) / (1e-3 * step * (len(part) - 1))
            made.append(feature("LineString", np.stack([x, y], 1).tolist(), fall=float(fall)))
    return collection(made, None if terrain.grid.crs is None else terrain.grid.crs.to_wkt())
