"""Pictures of volumes and profiles, for ``geovis``: synthetic boreholes, earthquakes at their depths, winds aloft."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import orograph

SIZE = (300, 214) if "--quick" in sys.argv else (900, 640)
SHARED = Path(__file__).resolve().parent.parent.parent / "shared" / "data"

BEDS = (("Soil", 5, 30), ("Navajo sandstone", 150, 420), ("Kayenta", 60, 150), ("Moenave", 40, 90), ("Chinle", 80, 200))
"""Synthetic beds from the top, with the range of their thickness (metres)."""

COLORS = {"Soil": "#8c510a", "Navajo sandstone": "#e69f00", "Kayenta": "#d55e00", "Moenave": "#cc79a7",
          "Chinle": "#0072b2"}  # fmt: skip


def boreholes(land: Any, count: int = 28) -> dict[str, list[Any]]:
    """A table of boreholes with intervals, beds and temperatures."""
    rng = np.random.default_rng(3)
    rows: list[tuple[Any, ...]] = []
    for hole in range(count):
        x, y = land.grid.xy(rng.uniform(20, land.grid.cols - 20), rng.uniform(20, land.grid.rows - 20))
        top = 0.0
        for bed, thin, thick in BEDS:
            deep = rng.uniform(thin, thick)
            rows.append((float(x), float(y), f"B{hole}", top, top + deep, bed, 14 + 0.03 * (top + deep / 2)))
            top += deep
            if rng.random() < 0.12:
                break
    names = ("x", "y", "hole", "from", "to", "bed", "temperature")
    return {name: [row[k] for row in rows] for k, name in enumerate(names)}


def pictures() -> dict[str, dict[str, Any]]:
    """Options of pictures, by name."""
    made: dict[str, dict[str, Any]] = {}
    path = SHARED / "spdatalarge-zion-nz-ecuador" / "zion_srtm.tif"
    if path.exists():
        land = orograph.terrain(path, vertical_unit="metre")
        view = orograph.camera.around(land, SIZE, azimuth=200, pitch=30, exaggeration=2)
        common = {"terrain": land, "exaggeration": 2, "view": view, "furniture": True, "title": "Made boreholes"}
        holes = orograph.Dataset(boreholes(land), depth="from+to", group="hole")
        beds = holes.but(variable="bed", colormap=COLORS, style="logs")
        warm = holes.but(variable="temperature", style="columns", size=700.0, colormap="inferno", unit="°C", hidden=0.8)
        made["logs"] = {**common, "data": beds}
        made["columns in the ground"] = {**common, "data": warm}
    tiles = sorted((SHARED / "california-3s-tiles").glob("N3[67]W1[12]*.tif"))
    points = SHARED / "fields-and-points" / "earthquakes.geojson"
    if tiles and points.exists():
        land = orograph.terrain([str(t) for t in tiles])
        view = orograph.camera.around(land, SIZE, azimuth=195, pitch=35, exaggeration=3)
        quakes = orograph.Dataset(str(points), variable="mag", depth="z:km", colormap="magma", name="Magnitude",
                                  size=16_000)  # fmt: skip
        made["quakes at their depths"] = {
            "terrain": land, "exaggeration": 3, "view": view, "data": quakes, "aids": "drops", "furniture": True,
            "title": "Quakes at their depths",
        }  # fmt: skip
    ground = SHARED / "ukv-theta-over-orography" / "uk_orography_2km.tif"
    winds = SHARED / "fields-and-points" / "eraint_uvz.nc"
    if ground.exists() and winds.exists():
        land = orograph.terrain(ground, vertical_unit="metre")
        view = orograph.camera.around(land, SIZE, azimuth=205, pitch=22, exaggeration=10, distance=760_000)
        wind = orograph.Dataset(str(winds), variable="u", band=1, name="Wind to the east", colormap="magma")
        common = {"terrain": land, "exaggeration": 10, "view": view, "furniture": True, "title": "January"}
        line = "-5.5:54.9:-3.2:53.5:-4.9:52.75"
        made["curtains"] = {**common, "data": wind.but(style="curtains", along=line)}
        made["walls"] = {**common, "data": wind.but(style="walls")}
    return made


def hikers(land: Any) -> str:
    """GPX of three synthetic walks over two days, each from place to place up to the highest one around."""
    heights = land.read(0, 0, land.grid.rows, 0, land.grid.cols)
    rng = np.random.default_rng(8)
    from pyproj import Transformer

    back = Transformer.from_crs(land.grid.crs, 4326, always_xy=True)
    tracks = []
    for name, hour, pace, rest in (("Ada", 6, 1.1, 2.0), ("Ben", 9, 0.8, 5.0), ("Cleo", 13, 1.4, 1.0)):
        turn, place = rng.uniform(0, 6.3), np.array([land.grid.cols / 2, land.grid.rows / 2])
        place = place + rng.uniform(-60, 60, 2)
        second, points = hour * 3600.0, []
        for step in range(150):
            turn += rng.normal(0, 0.28)
            place = np.clip(place + 2.2 * np.array([np.cos(turn), np.sin(turn)]), 5, np.array(heights.shape[::-1]) - 6)
            second += 2.2 * max(land.grid.spacing) / pace * rng.uniform(0.7, 1.6) + (rest * 3600 if step == 70 else 0)
            lon, lat = back.transform(*land.grid.xy(*place))
            day, left = divmod(int(second), 86_400)
            moment = f"2019-06-{1 + day:02}T{left // 3600:02}:{left // 60 % 60:02}:{left % 60:02}Z"
            points.append(f'<trkpt lat="{lat:.6f}" lon="{lon:.6f}"><time>{moment}</time></trkpt>')
        tracks.append(f"<trk><name>{name}</name><trkseg>{''.join(points)}</trkseg></trk>")
    return f'<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">{"".join(tracks)}</gpx>'


def walks(folder: Path) -> dict[str, dict[str, Any]]:
    """Options of pictures of tracks with times, by name. Writes their GPX into a folder."""
    path = SHARED / "spdatalarge-zion-nz-ecuador" / "zion_srtm.tif"
    if not path.exists():
        return {}
    land = orograph.terrain(path, vertical_unit="metre")
    (folder / "walks.gpx").write_text(hikers(land))
    view = orograph.camera.around(land, SIZE, azimuth=190, pitch=24, exaggeration=2, distance=78_000)
    common = {"terrain": land, "exaggeration": 2, "view": view, "furniture": True, "title": "Made walks"}
    walk = orograph.Dataset(str(folder / "walks.gpx"), name="Walks")
    return {
        "tubes": {**common, "data": walk.but(style="tubes", variable="speed", colormap="plasma", name="Speed")},
        "paths": {**common, "data": walk.but(style="paths"), "aids": "shadows"},
    }


def ghosts() -> dict[str, dict[str, Any]]:
    """Options of pictures of transparent surfaces, by name."""
    made: dict[str, dict[str, Any]] = {}
    ground = SHARED / "n44w072-hgt" / "N44W072.hgt"
    if ground.exists():
        from scipy.ndimage import gaussian_filter, minimum_filter

        land = orograph.terrain(ground, bbox=(-71.45, 44.08, -71.1, 44.4))
        heights = land.read(0, 0, land.grid.rows, 0, land.grid.cols)
        table = gaussian_filter(minimum_filter(np.nan_to_num(heights, nan=float(np.nanmin(heights))), 25), 12) + 12
        water = orograph.Ghost(table.astype(np.float32), color="#0a5fc2", opacity=0.85, hidden=0.1,
                               name="Water table (made)")  # fmt: skip
        view = orograph.camera.around(land, SIZE, azimuth=180, pitch=38, exaggeration=1.5)
        made["water table"] = {"terrain": land, "view": view, "exaggeration": 1.5, "ghosts": water, "water": "none",
                               "furniture": True, "title": "White Mountains"}  # fmt: skip
    folder = SHARED / "swiss-alps-geoids"
    first, second = folder / "chgeo2004_LV95.tif", folder / "us_nga_egm2008_1_clipAlps.tif"
    if first.exists() and second.exists():
        import rasterio
        from rasterio.warp import Resampling, reproject

        land = orograph.terrain(first)
        heights = land.read(0, 0, land.grid.rows, 0, land.grid.cols)
        other = np.full(heights.shape, np.nan, np.float32)
        with rasterio.open(second) as file:
            reproject(rasterio.band(file, 1), other, src_crs="EPSG:4326", dst_transform=land.grid.transform,
                      dst_crs="EPSG:2056", resampling=Resampling.bilinear, dst_nodata=np.nan)  # fmt: skip
        other += np.float32(np.nanmean(heights) - np.nanmean(other))
        ghost = orograph.Ghost(other, color="#c8501e", opacity=0.7, hidden=0.2, name="EGM2008, same mean")
        view = orograph.camera.around(land, SIZE, azimuth=180, pitch=30, exaggeration=6000)
        made["two geoids"] = {"terrain": land, "view": view, "exaggeration": 6000, "ghosts": ghost, "furniture": True,
                              "title": "Geoids of Switzerland"}  # fmt: skip
    return made
