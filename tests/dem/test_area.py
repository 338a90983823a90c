"""Areas: a box or polygons cut rasters before anything else is chosen, and everything reads what is left alike."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS, Transformer

import orograph
from orograph.dem.area import lonlat_bounds
from orograph.dem.mosaic import Mosaic
from orograph.dem.raster import Dem
from orograph.errors import ReadError, UsageError
from orograph.geo import Grid
from orograph.store.repair import repair

HEIGHTS = np.random.default_rng(3).normal(500, 90, (60, 80)).astype(np.float32)
UTM = Affine(30, 0, 380_000, 0, -30, 3_790_000)


def tif(path: Path, heights: NDArray[np.float32], transform: Affine, crs: str) -> Path:
    rows, cols = heights.shape
    with rasterio.open(path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype="float32", crs=crs,
                       transform=transform, nodata=-9999) as out:  # fmt: skip
        out.write(heights, 1)
    return path


def degrees(points: list[tuple[float, float]]) -> list[list[float]]:
    """Places in UTM zone 11N as longitude, latitude."""
    lon, lat = Transformer.from_crs(32611, 4326, always_xy=True).transform(*zip(*points))
    return [[float(x), float(y)] for x, y in zip(lon, lat)]


@pytest.fixture
def utm(tmp_path: Path) -> Path:
    return tif(tmp_path / "utm.tif", HEIGHTS, UTM, "EPSG:32611")


def box_of(row0: int, row1: int, col0: int, col1: int) -> tuple[float, float, float, float]:
    """A box in degrees well inside which lie the samples of a window of ``utm``."""
    x, y = [380_015 + 30 * c for c in (col0, col1 - 1)], [3_789_985 - 30 * r for r in (row0, row1 - 1)]
    found = np.array(degrees([(a, b) for a in x for b in y]))
    return float(found[:, 0].min()), float(found[:, 1].min()), float(found[:, 0].max()), float(found[:, 1].max())


def test_a_box_keeps_the_samples_within_it(utm: Path) -> None:
    """As counted one by one: the smallest window with every sample whose longitude and latitude lie in the box."""
    box = box_of(10, 41, 22, 58)
    row, col = np.mgrid[:60, :80]
    lon, lat = Transformer.from_crs(32611, 4326, always_xy=True).transform(380_015 + 30 * col, 3_789_985 - 30 * row)
    inside = (lon >= box[0]) & (lon <= box[2]) & (lat >= box[1]) & (lat <= box[3])
    rows, cols = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    mosaic = Mosaic.open(utm, bbox=box)
    r0, c0 = (round(float(v)) for v in reversed(Grid((60, 80), UTM).index(*mosaic.grid.xy(0, 0))))
    assert (r0, c0) == (rows[0], cols[0]) and mosaic.grid.shape == (len(range(*_span(rows))), len(range(*_span(cols))))
    np.testing.assert_array_equal(every(mosaic),
                                  HEIGHTS[slice(*_span(rows)), slice(*_span(cols))])  # fmt: skip


def _span(which: NDArray[np.intp]) -> tuple[int, int]:
    return int(which[0]), int(which[-1]) + 1


def test_polygons_leave_out_what_lies_beside_them(utm: Path, tmp_path: Path) -> None:
    """A triangle with a hole, judged sample by sample with cross products."""
    outer = [(380_403.3, 3_789_697.1), (382_102.9, 3_789_401.7), (380_897.6, 3_788_303.2)]
    hole = [(380_907.0, 3_789_411.0), (381_204.0, 3_789_353.0), (381_001.0, 3_789_108.0)]
    area = {"type": "Polygon", "coordinates": [degrees([*ring, ring[0]]) for ring in (outer, hole)]}
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": area}))
    row, col = np.mgrid[:60, :80]
    x, y = 380_015.0 + 30 * col, 3_789_985.0 - 30 * row
    truth = np.where(_within(outer, x, y) & ~_within(hole, x, y), HEIGHTS, np.nan)
    rows, cols = (10, 57), (13, 70)  # what lies between the corners
    for given in (path, area, type("Shape", (), {"__geo_interface__": area})()):
        mosaic = Mosaic.open(utm, clip=given)
        found = every(mosaic)
        part = truth[slice(*rows), slice(*cols)]
        assert found.shape == part.shape and np.isnan(part).sum() > 500
        np.testing.assert_array_equal(found, part)
        np.testing.assert_array_equal(mosaic.read(5, 20, 3, 30), part[5:20, 3:30])  # whatever the window
    projected = {**area, "coordinates": [[*ring, ring[0]] for ring in (outer, hole)],
                 "crs": {"properties": {"name": "EPSG:32611"}}}  # fmt: skip
    np.testing.assert_array_equal(every(Mosaic.open(utm, clip=projected)), part)


def every(source: Any) -> NDArray[np.float32]:
    """All heights of a mosaic or a terrain."""
    window = 0, source.grid.rows, 0, source.grid.cols
    return source.read(*window) if isinstance(source, Mosaic) else source.read(0, *window)


def _within(triangle: list[tuple[float, float]], x: NDArray, y: NDArray) -> NDArray[np.bool_]:
    sides = [(bx - ax) * (y - ay) - (by - ay) * (x - ax)
             for (ax, ay), (bx, by) in zip(triangle, [*triangle[1:], triangle[0]])]  # fmt: skip
    return np.all(np.array(sides) > 0, axis=0) | np.all(np.array(sides) < 0, axis=0)


def test_files_beside_the_area_are_not_read(tmp_path: Path) -> None:
    for i in range(2):
        for j in range(3):
            transform = UTM @ Affine.translation(80 * j, 60 * i)
            tif(tmp_path / f"{i}{j}.tif", HEIGHTS + 10 * i + j, transform, "EPSG:32611")
    files = sorted(tmp_path.glob("*.tif"))
    box = box_of(50, 70, 170, 200)
    mosaic = Mosaic.open(files, bbox=box)
    assert [source.name for source in mosaic.sources] == ["02", "12"] and mosaic.name == "02 and 1 more"
    whole = Mosaic.open(files).read(50, 70, 170, 200)
    col, row = Grid((120, 240), UTM).index(*mosaic.grid.xy(0, 0))
    at = 50 - round(float(row)), 170 - round(float(col))
    np.testing.assert_array_equal(mosaic.read(at[0], at[0] + 20, at[1], at[1] + 30), whole)


@pytest.mark.parametrize(("west", "box"), [(-180.0, (178.0, -10.0, -177.0, 12.0)), (0.0, (-8.0, 40.0, 9.0, 60.0))])
def test_across_the_seam_of_a_globe(tmp_path: Path, west: float, box: tuple[float, float, float, float]) -> None:
    """A world raster from any meridian: one terrain of the area, in a projection for it, without a gap."""
    lat, lon = 89.5 - np.arange(180)[:, None], west + 0.5 + np.arange(360)[None]
    world = (1000 + 300 * np.sin(np.radians(lat * 3)) * np.cos(np.radians(lon * 5))).astype(np.float32)
    path = tif(tmp_path / "world.tif", world, Affine(1, 0, west, 0, -1, 90), "EPSG:4326")
    mosaic = Mosaic.open(path, bbox=box)
    heights = every(mosaic)
    rows, cols = mosaic.grid.shape
    row, col = np.mgrid[1 : rows - 1, 1 : cols - 1]
    lon, lat = Transformer.from_crs(mosaic.grid.crs, 4326, always_xy=True).transform(*mosaic.grid.xy(col, row))
    truth = 1000 + 300 * np.sin(np.radians(lat * 3)) * np.cos(np.radians(lon * 5))
    found = heights[1:-1, 1:-1]
    known = np.isfinite(found)
    assert known.mean() > 0.8 and np.abs(found - truth)[known].max() < 4
    turn = (lon[known] - box[0]) % 360
    assert turn.min() < 1.6 and turn.max() > (box[2] - box[0]) % 360 - 1.6


def test_every_form_of_heights_is_cut_alike(utm: Path, tmp_path: Path) -> None:
    box = box_of(10, 41, 22, 58)
    truth = orograph.terrain(utm, False, bbox=box)
    dem = orograph.read(utm)
    store = orograph.build(utm, tmp_path / "a.oro", progress=False)
    for given in (dem, orograph.terrain(dem, False), store, str(tmp_path / "a.oro"), rasterio.open(utm)):
        found = orograph.terrain(given, False, bbox=box)
        assert found.grid.shape == truth.grid.shape and tuple(found.grid.transform) == pytest.approx(
            tuple(truth.grid.transform)
        )
        np.testing.assert_array_equal(every(found), every(truth))
    array = orograph.terrain(HEIGHTS, False, transform=UTM, crs="EPSG:32611", bbox=box)
    assert array.grid.shape == truth.grid.shape


def test_a_store_of_an_area_is_repaired_from_that_area(utm: Path, tmp_path: Path) -> None:
    box = box_of(10, 41, 22, 58)
    with orograph.build(utm, tmp_path / "a.oro", bbox=box, progress=False) as terrain:
        heights = every(terrain)
    victim = max((tmp_path / "a.oro" / "heights" / "0").rglob("c/*/*"), key=lambda f: f.stat().st_size)
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 255
    victim.write_bytes(data)
    repair(tmp_path / "a.oro")
    assert orograph.check(tmp_path / "a.oro", progress=False) == []
    with orograph.terrain(tmp_path / "a.oro", False) as terrain:
        np.testing.assert_array_equal(every(terrain), heights)


def test_what_is_wrong_is_said(utm: Path, tmp_path: Path) -> None:
    for box in ((1, 2, 3), (5, 9, 6, 3), (5, 1, 5, 3), (5, 1, float("nan"), 3), "west"):
        with pytest.raises(UsageError, match="west, south, east, north"):
            Mosaic.open(utm, bbox=box)
    with pytest.raises(UsageError, match="No sample lies within 7, 45, 8, 46"):
        Mosaic.open(utm, bbox=(7, 45, 8, 46))
    bare = Dem(HEIGHTS, Grid(HEIGHTS.shape, UTM, None), name="bare")
    with pytest.raises(UsageError, match="no CRS"):
        orograph.terrain(bare, False, bbox=(7, 45, 8, 46))
    for text, words in (("{", "not JSON"), ('{"type": "Point", "coordinates": [1, 2]}', "no polygon"),
                        ('{"type": "Polygon", "coordinates": [["a"]]}', "no list of coordinates")):  # fmt: skip
        (tmp_path / "a.geojson").write_text(text)
        with pytest.raises(ReadError, match=words):
            Mosaic.open(utm, clip=tmp_path / "a.geojson")
    with pytest.raises(ReadError, match="cannot be read"):
        Mosaic.open(utm, clip=tmp_path / "none.geojson")
    assert CRS.from_epsg(32611) == Mosaic.open(utm, bbox=box_of(0, 9, 0, 9)).grid.crs


@pytest.mark.parametrize(
    ("crs", "corner", "cell", "expected"),
    [
        ("+proj=eqc +R=1737400", (-5_460_000, 2_740_000), 20_000, (-179.7, -90, 179.7, 90)),  # a whole Moon
        ("+proj=eqc +lon_0=180 +R=1737400", (-2_730_000, 1_365_000), 10_000, (90.1, -45.2, -90.1, 44.8)),
        ("EPSG:3413", (-2_000_000, 2_000_000), 7_500, (-180, 63.1, 180, 90)),  # around the pole
        ("EPSG:3031", (500_000, 2_000_000), 2_000, (14.1, -80.5, 60.3, -66.8)),  # beside it
        ("EPSG:32760", (600_000, 8_000_000), 800, (177.9, -22, -177.8, -18)),  # across the 180th meridian
        ("EPSG:32631", (500_000, 5_000_000), 100, (3, 44.7, 3.7, 45.2)),
    ],
)
def test_the_degrees_that_a_raster_spans(crs, corner, cell, expected):
    shape = (274, 546) if "eqc" in crs else (547, 547)
    grid = Grid(shape, Affine(cell, 0, corner[0], 0, -cell, corner[1]), CRS.from_user_input(crs))
    assert lonlat_bounds(grid) == pytest.approx(expected, abs=0.06)
