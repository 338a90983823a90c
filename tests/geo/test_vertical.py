"""Geoid grids: the grid named is the grid used, as PROJ and published values have it; a missing one is an error."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Transformer

from orograph.errors import ReadError
from orograph.geo import Geoid


@pytest.fixture(scope="module")
def egm96_path(shared_data: Path) -> Path:
    return shared_data / "egm96-grid" / "egm96_15.gtx"


@pytest.fixture(scope="module")
def egm96(egm96_path: Path) -> Geoid:
    return Geoid.open(egm96_path)


def write_grid(
    path: Path, values: np.ndarray, transform: Affine, nodata: float | None = None, crs: str = "EPSG:4326"
) -> Path:
    with rasterio.open(
        path, "w", driver="GTiff", height=values.shape[0], width=values.shape[1], count=1, dtype="float32",
        crs=crs, transform=transform, nodata=nodata,
    ) as dataset:  # fmt: skip
        dataset.write(values.astype(np.float32), 1)
    return path


def test_published_spot_values(egm96: Geoid, shared_data: Path) -> None:
    """NGA's F477 points: a bilinear 15′ grid is within 0.06 m of them, and equal to a bilinear reading by others."""
    with (shared_data / "geodesy-truth" / "egm96_spot_values.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 7
    for row in rows:
        found = float(egm96.undulation(float(row["lon"]), float(row["lat"])))
        assert found == pytest.approx(float(row["bilinear_egm96_15_m"]), abs=6e-5)
        assert found == pytest.approx(float(row["published_N_m"]), abs=0.06)


def test_it_is_proj_with_that_grid(egm96: Geoid, egm96_path: Path) -> None:
    rng = np.random.default_rng(7)
    lon, lat = rng.uniform(-180, 180, 2000), np.degrees(np.arcsin(rng.uniform(-1, 1, 2000)))
    heights = rng.uniform(-400, 8000, 2000)
    proj = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={egm96_path} +multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    expected = np.array(proj.transform(lon, lat, heights)[2])
    assert np.abs(expected - heights).max() > 50  # PROJ did use the grid
    np.testing.assert_allclose(egm96.ellipsoidal(heights, lon, lat), expected, rtol=0, atol=2e-5)
    np.testing.assert_allclose(egm96.orthometric(expected, lon, lat), heights, rtol=0, atol=2e-5)


def test_samples_of_the_grid_are_met_and_halves_are_means(egm96: Geoid) -> None:
    """The grid's file is read here by hand: big-endian float32 after a 40-byte header, rows from the south."""
    raw = np.fromfile(egm96.path, ">f4", offset=40).reshape(721, 1440)
    for i, j in ((0, 0), (360, 720), (720, 1439), (123, 1)):
        lat, lon = -90 + i / 4, -180 + j / 4
        assert float(egm96.undulation(lon, lat)) == raw[i, j]
        assert float(egm96.undulation(lon + 720, lat)) == raw[i, j]
        assert float(egm96.undulation(lon + 0.125, lat)) == pytest.approx(
            (float(raw[i, j]) + float(raw[i, (j + 1) % 1440])) / 2, abs=1e-9
        )


def test_rows_that_are_needed_are_as_the_whole(egm96: Geoid, egm96_path: Path) -> None:
    rng = np.random.default_rng(8)
    for south, north in ((-90, -60), (35.1, 35.2), (70, 90), (-12.5, 13)):
        part = Geoid.open(egm96_path, latitudes=(south, north))
        assert part.grid.rows <= (north - south) * 4 + 7 and part.grid.cols == 1440
        lon, lat = rng.uniform(-180, 180, 300), rng.uniform(south, north, 300)
        np.testing.assert_allclose(part.undulation(lon, lat), egm96.undulation(lon, lat), rtol=0, atol=1e-9)
    with pytest.raises(ReadError, match="lies off the geoid grid"):
        Geoid.open(egm96_path, latitudes=(10, 20)).undulation(0, 30)


def test_another_grid_gives_another_height(tmp_path: Path) -> None:
    at = Affine(1, 0, 6.5, 0, -1, 48.5)  # samples at 7…11° E, 48…45° N
    flat = Geoid.open(write_grid(tmp_path / "flat.tif", np.full((4, 5), 100.0), at))
    plane = Geoid.open(write_grid(tmp_path / "plane.tif", np.arange(20.0).reshape(4, 5), at))
    assert float(flat.ellipsoidal(12.0, 8.3, 46.2)) == 112.0
    assert float(plane.undulation(8.25, 46.5)) == pytest.approx(1.5 * 5 + 1.25)
    np.testing.assert_allclose(plane.undulation([7, 11, 11], [48, 48, 45]), [0, 4, 19], atol=1e-12)  # the corners
    assert plane.datum == "height above plane"


def test_off_the_grid_and_in_holes_is_an_error(tmp_path: Path) -> None:
    values = np.full((4, 5), 50.0)
    values[1, 1] = -9999
    geoid = Geoid.open(write_grid(tmp_path / "g.tif", values, Affine(1, 0, 6.5, 0, -1, 48.5), nodata=-9999))
    for lon, lat in ((6.99, 46), (11.01, 46), (9, 48.01), (9, 44.99)):
        with pytest.raises(ReadError, match="lies off the geoid grid"):
            geoid.undulation([9, lon], [46.5, lat])
    with pytest.raises(ReadError, match="hole"):
        geoid.undulation(8.4, 46.6)
    assert float(geoid.undulation(9.0, 47.0)) == 50.0  # beside the hole, of weight 0
    assert np.isnan(geoid.undulation([np.nan, 9], [46, np.nan])).all()


def test_a_missing_or_unfit_grid_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="no such geoid grid"):
        Geoid.open(tmp_path / "egm96_15.gtx")
    (tmp_path / "broken.gtx").write_bytes(b"not a grid")
    with pytest.raises(ReadError, match="cannot be read"):
        Geoid.open(tmp_path / "broken.gtx")
    utm = write_grid(tmp_path / "utm.tif", np.zeros((3, 3)), Affine(1000, 0, 5e5, 0, -1000, 5e6), crs="EPSG:32632")
    with pytest.raises(ReadError, match="geographic"):
        Geoid.open(utm)


def test_egm2008_over_the_alps_is_named_and_agrees_with_proj(shared_data: Path) -> None:
    path = shared_data / "swiss-alps-geoids" / "us_nga_egm2008_1_clipAlps.tif"
    geoid = Geoid.open(path)
    assert geoid.datum == "EGM2008 height"
    rng = np.random.default_rng(3)
    lon, lat = rng.uniform(5, 14, 300), rng.uniform(42, 49, 300)
    proj = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={path} +multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    np.testing.assert_allclose(
        geoid.undulation(lon, lat), proj.transform(lon, lat, np.zeros(300))[2], rtol=0, atol=2e-5
    )
