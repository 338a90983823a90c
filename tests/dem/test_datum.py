"""DEMs from one vertical datum to another, against PROJ and a geoid of a known height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Transformer

from orograph.dem import Dem, read
from orograph.dem.datum import to_ellipsoidal, to_orthometric
from orograph.errors import ReadError, UsageError
from orograph.geo import Grid


def test_a_tile_to_ellipsoidal_heights_is_what_proj_says(shared_data: Path) -> None:
    dem = read(shared_data / "n44w072-hgt" / "N44W072.hgt")
    path = shared_data / "egm96-grid" / "egm96_15.gtx"
    converted = to_ellipsoidal(dem, path)
    assert converted.vertical == "ellipsoidal height (WGS 84)" and converted.grid == dem.grid
    proj = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={path} +multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    rows, cols = np.mgrid[0:1201:97, 0:1201:83]
    lon, lat = dem.grid.xy(cols, rows)
    expected = proj.transform(lon, lat, dem.heights[rows, cols].astype(float))[2]
    np.testing.assert_allclose(converted.heights[rows, cols], expected, rtol=0, atol=1e-3)
    assert -30 < float((converted.heights - dem.heights).mean()) < -20  # the geoid lies below WGS 84 in New Hampshire
    back = to_orthometric(converted, path)
    np.testing.assert_allclose(back.heights, dem.heights, rtol=0, atol=2e-4)
    assert back.vertical == "EGM96 height"


def test_a_projected_dem_with_holes(tmp_path: Path) -> None:
    """On a geoid whose height is its longitude, in a UTM zone; holes stay, even where they lie off the geoid grid."""
    path = tmp_path / "slanted.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=3, width=4, count=1, dtype="float32", crs="EPSG:4326",
        transform=Affine(1, 0, 6.5, 0, -1, 47.5),
    ) as dataset:  # fmt: skip
        dataset.write(np.tile(np.float32([7, 8, 9, 10]), (3, 1)), 1)
    heights = np.zeros((300, 2), np.float32)
    heights[0, 0] = np.nan
    grid = Grid((300, 2), Affine(1000, 0, 450000, 0, -200, 5.2e6), CRS("EPSG:32632"))
    converted = to_ellipsoidal(Dem(heights, grid, None, "x"), path)
    lon, _ = Transformer.from_crs(32632, 4326, always_xy=True).transform(*grid.xy(1, np.arange(300)))
    np.testing.assert_allclose(converted.heights[:, 1], lon, rtol=0, atol=1e-5)
    assert np.isnan(converted.heights[0, 0]) and np.isfinite(converted.heights[1:]).all()


def test_datums_that_do_not_fit_are_refused(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "egm96-grid" / "egm96_15.gtx"
    grid = Grid((1, 1), Affine(1, 0, 7, 0, -1, 46), CRS("EPSG:4326"))
    heights = np.zeros((1, 1), np.float32)
    with pytest.raises(UsageError, match="already"):
        to_ellipsoidal(Dem(heights, grid, "ellipsoidal height"), path)
    with pytest.raises(UsageError, match="NAVD88"):
        to_ellipsoidal(Dem(heights, grid, "NAVD88 height"), path)
    with pytest.raises(UsageError, match="not above the ellipsoid"):
        to_orthometric(Dem(heights, grid, "EGM96 height"), path)
    with pytest.raises(ReadError, match="no CRS"):
        to_ellipsoidal(Dem(heights, Grid((1, 1), Affine(1, 0, 0, 0, -1, 0)), None), path)
    with pytest.raises(ReadError, match="no such geoid grid"):
        to_ellipsoidal(Dem(heights, grid), tmp_path / "egm96_15.gtx")
    far = Grid((1, 1), Affine(1, 0, 30, 0, -1, 46), CRS("EPSG:4326"))
    alps = shared_data / "swiss-alps-geoids" / "us_nga_egm2008_1_clipAlps.tif"
    with pytest.raises(ReadError, match="off the geoid grid"):
        to_ellipsoidal(Dem(heights, far), alps)
