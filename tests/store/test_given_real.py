"""Real rasters, given in every way there is: each time the terrain that the file gives."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import orograph
from orograph.errors import OrographError, ReadError

xr = pytest.importorskip("xarray")
rioxarray = pytest.importorskip("rioxarray")

FILES = (
    "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",  # int16, nodata, UTM
    "n44w072-hgt/N44W072.hgt",  # int16, degrees, points
    "gironde-demcompare/srtm_ref.tif",
    "gironde-demcompare/Copernicus_N45E005_500x500.tif",
    "california-3s-tiles/N36W118.tif",
)


def heights(terrain: orograph.Terrain) -> np.ndarray:
    return terrain.read(0, 0, terrain.grid.rows, 0, terrain.grid.cols)


def same(found: orograph.Terrain, truth: orograph.Terrain, apart: float = 0.0) -> None:
    assert found.grid.shape == truth.grid.shape and found.grid.crs == truth.grid.crs
    np.testing.assert_allclose(found.grid.transform[:6], truth.grid.transform[:6], rtol=0, atol=1e-4)
    np.testing.assert_allclose(heights(found), heights(truth), rtol=0, atol=apart)


@pytest.mark.cases(2)
@pytest.mark.parametrize("name", FILES)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_way_is_the_same_terrain(name: str, shared_data: Path) -> None:
    path = shared_data / name
    truth = orograph.terrain(path)
    # Coordinates along axes are sums of spacings: of resampled ones some samples move by a billionth of a cell.
    near = 0.0 if truth.grid.crs == orograph.read(path).grid.crs else 0.01
    with rasterio.open(path) as dataset:
        same(orograph.terrain(dataset), truth)
        same(orograph.terrain([dataset]), truth)
        place: dict[str, Any] = {"transform": dataset.transform, "crs": dataset.crs}
        same(orograph.terrain(dataset.read(1, masked=True), **place), truth)
        same(orograph.terrain(dataset.read(1), nodata=dataset.nodata, **place), truth)
        rows, cols = dataset.shape
        halves = [(dataset, ((0, rows // 2), (0, cols))), (dataset, ((rows // 2, rows), (0, cols)))]
        same(orograph.terrain(halves), truth)
    for options in ({}, {"masked": True}, {"chunks": {"y": 300, "x": 200}}):
        if "chunks" in options:
            pytest.importorskip("dask")
        with rioxarray.open_rasterio(path, **options) as array:
            same(orograph.terrain(array), truth, near)
    with xr.open_dataset(path, engine="rasterio") as dataset:
        same(orograph.terrain(dataset), truth, near)


def test_tiles_are_put_together_whatever_they_come_as(shared_data: Path) -> None:
    tiles = [shared_data / "california-3s-tiles" / f"N36W11{k}.tif" for k in (7, 8)]
    truth = orograph.terrain(tiles)
    with rasterio.open(tiles[1]) as second:
        same(orograph.terrain([tiles[0], second]), truth)
        same(orograph.terrain([orograph.read(tiles[0]), second]), truth)


@pytest.mark.stress
def test_samples_of_all_types(shared_data: Path) -> None:
    read = 0
    for path in sorted((shared_data / "nasty-gdal").glob("*.tif")):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                with rasterio.open(path) as dataset:
                    if dataset.width * dataset.height > 1 << 22:
                        continue  # a small file that says it is a large one
                    raw = dataset.read(1)
                    truth = None if raw.dtype.kind == "c" else orograph.terrain(path, spacing=1)
            except (OrographError, rasterio.errors.RasterioError):
                continue  # is no DEM for whoever opens it
            if truth is None:
                with pytest.raises(ReadError, match="complex"):
                    orograph.terrain(raw, spacing=1)
                continue
            with rasterio.open(path) as dataset:
                same(orograph.terrain(dataset, spacing=1), truth)
            read += 1
    assert read >= 5
