"""Projected CRSs that count westings and southings: every sample stays, and lies where rasterio and PROJ have it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS, Transformer
from rasterio.warp import transform as gdal_transform

from orograph import store
from orograph.cli import cli
from orograph.dem import Source
from orograph.dem.axes import east_north
from orograph.dem.mosaic import Mosaic
from orograph.geo.grid import apply
from orograph.geo.transform import transformer
from orograph.viewpoint import View

# A corner of the raster inside each CRS's area, in its own (x, y); and which way its coordinates grow.
PLACES = {
    2048: (-37_000.0, 3_675_000.0),  # Lo19: west, south
    22275: (-60_000.0, 3_759_000.0),  # Cape / Lo15
    5513: (1_083_000.0, 684_000.0),  # Krovak: south, west
    2065: (1_083_000.0, 684_000.0),  # the same from Ferro
}
HEIGHTS = np.add.outer(np.arange(30) * 100, np.arange(40)).astype(np.float32)


def written(path: Path, code: int, transform: Affine) -> Path:
    with rasterio.open(
        path, "w", driver="GTiff", height=30, width=40, count=1, dtype="float32", crs=f"EPSG:{code}",
        transform=transform,
    ) as dataset:  # fmt: skip
        dataset.write(HEIGHTS, 1)
    return path


def places(path: Path) -> dict[float, tuple[float, float]]:
    """Longitude and latitude of each height by GDAL alone."""
    with rasterio.open(path) as dataset:
        values = dataset.read(1)
        rows, cols = np.mgrid[:30, :40]
        x, y = rasterio.transform.xy(dataset.transform, rows.ravel(), cols.ravel())
        lon, lat = gdal_transform(dataset.crs, "EPSG:4326", list(x), list(y))
    return dict(zip(values.ravel().tolist(), zip(lon, lat)))


@pytest.mark.parametrize("code", PLACES)
@pytest.mark.parametrize(
    "a,b,d,e",
    [
        (25, 0, 0, -25), (-25, 0, 0, 25), (25, 0, 0, 25), (-25, 0, 0, -25), (0, 25, 25, 0), (0, -25, 25, 0),
        (20, 15, 15, -20),
    ],
)  # fmt: skip
def test_samples_are_kept_where_gdal_has_them(tmp_path: Path, code: int, a: int, b: int, d: int, e: int) -> None:
    x, y = PLACES[code]
    path = written(tmp_path / "a.tif", code, Affine(a, b, x, d, e, y))
    expected = places(path)
    source, mosaic = Source.open(path), Mosaic.open(path)
    assert mosaic.lossless and mosaic.grid.crs is not None
    assert [axis.direction for axis in mosaic.grid.crs.axis_info] == ["east", "north"]
    assert mosaic.grid.transform.determinant < 0  # rows run to the right of columns, as on every map
    for raster in (source, mosaic):
        heights = raster.read(0, 30, 0, 40)
        assert sorted(heights.ravel()) == sorted(HEIGHTS.ravel())
        rows, cols = np.mgrid[:30, :40]
        lon, lat = transformer(raster.grid.crs, 4326)(*raster.grid.xy(cols, rows))
        want = np.array([expected[h] for h in heights.ravel().tolist()])
        metre = 1 / 111_000
        np.testing.assert_allclose(lon.ravel(), want[:, 0], rtol=0, atol=0.01 * metre)
        np.testing.assert_allclose(lat.ravel(), want[:, 1], rtol=0, atol=0.01 * metre)
    if (b, d) == (0, 0) and code in (2048, 22275):  # the first sample is the north-west one
        assert lon[0, 0] < lon[0, -1] and lat[0, 0] > lat[-1, 0]
        assert mosaic.grid.transform.a == 25 and mosaic.grid.transform.e == -25


@pytest.mark.parametrize("code", PLACES)
def test_views_in_longitude_and_latitude(tmp_path: Path, code: int) -> None:
    path = written(tmp_path / "a.tif", code, Affine(-25, 0, PLACES[code][0], 0, 25, PLACES[code][1]))
    mosaic = Mosaic.open(path)
    lon, lat = transformer(mosaic.grid.crs, 4326)(*mosaic.grid.xy(20, 15))
    said = {"crs": "EPSG:4326", "eye": [float(lon), float(lat) - 0.05, 3000], "target": [float(lon), float(lat), 100]}
    view = View.from_dict({**said, "fov_y": 30, "width": 64, "height": 48}, crs=mosaic.grid.crs)
    np.testing.assert_allclose(
        view.target[:2], mosaic.grid.xy(20, 15), rtol=0, atol=0.01
    )  # PROJ's Krovak is good to 1 mm
    east, north = view.target[0] - view.eye[0], view.target[1] - view.eye[1]
    # It looks north along the meridian: grid north is off by the meridian's convergence only (9.6° for Krovak).
    assert math.hypot(east, north) == pytest.approx(0.05 * 111_200, rel=0.01) and abs(east) < 0.2 * north
    with store.terrain(mosaic) as terrain:
        assert terrain.grid == mosaic.grid


def test_info_tells_the_file_s_own_coordinates(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tif", 2048, Affine(-25, 0, -37_000, 0, 25, 3_675_000))
    result = CliRunner().invoke(cli, ["--quiet", "info", "--json", str(path)], catch_exceptions=False)
    told = json.loads(result.stdout)
    assert told["crs"] == "EPSG:2048" and told["transform"] == [-25, 0, -37_000, 0, 25, 3_675_000]
    assert told["spacing_m"] == [25, 25] and told["warnings"] == []


def test_a_terrain_brought_to_such_a_crs_counts_east_and_north(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=30, width=40, count=1, dtype="float32", crs="EPSG:4148",
        transform=Affine(0.001, 0, 19.3, 0, -0.001, -33),
    ) as dataset:  # fmt: skip
        dataset.write(HEIGHTS, 1)
    mosaic = Mosaic.open(path, crs="EPSG:2048")
    westing, southing = Transformer.from_crs(4148, 2048, always_xy=True).transform(19.32, -33.015)
    col, row = mosaic.grid.index(-westing, -southing)
    found = mosaic.read(*(int(v) for v in (row, row + 1, col, col + 1)))[0, 0]
    assert found == pytest.approx(100 * 14.5 + 19.5, abs=110)
    assert mosaic.grid.transform.a > 0 > mosaic.grid.transform.e


def test_twins() -> None:
    assert east_north(CRS(5513))[0] == CRS(5514) and east_north(CRS(2065))[0].geodetic_crs == CRS(2065).geodetic_crs
    for code in (32633, 2056, 31466, 2200, 3031, 3413, 5041, 32661, 4326, 3857):  # also northing first, and polar
        assert east_north(CRS(code)) == (CRS(code), Affine.identity())
    for code in PLACES:
        crs = CRS(code)
        twin, turn = east_north(crs)
        lon, lat = (
            np.array([15.3, 18.9]),
            (np.array([49.8, 48.6]) if code in (5513, 2065) else np.array([-33.9, -30.0])),
        )
        there = Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True).transform(lon, lat)
        np.testing.assert_allclose(
            apply(turn, *there), Transformer.from_crs(crs.geodetic_crs, twin, always_xy=True).transform(lon, lat),
            rtol=0, atol=1e-6,
        )  # fmt: skip
