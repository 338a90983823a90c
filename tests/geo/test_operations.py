"""Missing datum grids are told: PROJ's own bookkeeping, asked with and without a grid in its folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Transformer, datadir

from orograph.dem.mosaic import Mosaic
from orograph.geo.operations import approximation

CALIFORNIA = (-118.0, 36.0, -117.0, 37.0)


def lacks(grid: str) -> bool:
    folders = [datadir.get_data_dir(), datadir.get_user_data_dir()]
    return not pyproj.network.is_network_enabled() and not any((Path(f) / grid).exists() for f in folders)


NADCON = "us_noaa_nadcon5_nad27_nad83_1986_conus.tif"
needs_no_grid = pytest.mark.skipif(not lacks(NADCON), reason="PROJ has its grids here")


@needs_no_grid
def test_a_worse_way_is_told_where_it_could_be_seen() -> None:
    said = approximation(CRS(4267), CRS(26911), CALIFORNIA)
    assert said is not None and NADCON in said and "From NAD27 to NAD83" in said and "about 11 m" in said
    # PROJ goes by one mean shift for all western states to WGS 84, good to 7 m, and another to NAD83, good to 4 m.
    taken = Transformer.from_crs(4267, 26911, always_xy=True)
    taken.transform(-117.5, 36.5)
    assert "NAD27 to WGS 84 (6)" in taken.get_last_used_operation().description
    assert approximation(CRS(4267), CRS(26911), CALIFORNIA, tolerance=15) is None
    assert approximation(CRS(4267), CRS(26911), CALIFORNIA, tolerance=5) == said


@pytest.mark.parametrize(
    "source,target,bounds",
    [
        (4326, 32611, CALIFORNIA),  # the same datum
        (4326, 3857, CALIFORNIA),
        (26711, 26712, (5e5, 3.9e6, 5.1e5, 3.91e6)),
        (4258, 32632, (7, 46, 8, 47)),  # ETRS89 to WGS 84: no grid in it
        (2056, 32632, (2.6e6, 1.2e6, 2.61e6, 1.21e6)),
    ],
)
def test_nothing_is_said_where_nothing_is_lost(source: int, target: int, bounds: tuple[float, ...]) -> None:
    west, south, east, north = bounds
    assert approximation(CRS(source), CRS(target), (west, south, east, north)) is None


def test_datums_without_any_way_between_them() -> None:
    own = CRS.from_wkt(
        'GEOGCRS["own",DATUM["own datum",ELLIPSOID["Bessel 1841",6377397.155,299.1528128]],'
        'CS[ellipsoidal,2],AXIS["latitude",north],AXIS["longitude",east],ANGLEUNIT["degree",0.0174532925199433]]'
    )
    said = approximation(own, CRS(32632), (7, 46, 8, 47))
    assert said is not None and "has no transformation" in said and "own" in said


def test_with_its_grid_nothing_is_said(tmp_path: Path) -> None:
    """A grid of that name in PROJ's folder is all that PROJ's bookkeeping asks for."""
    grid = "de_adv_BETA2007.tif"
    if not lacks(grid):
        pytest.skip("PROJ has its grids here")
    bounds = (7.0, 50.0, 8.0, 51.0)
    assert grid in (approximation(CRS(4314), CRS(25832), bounds) or "")
    before = datadir.get_data_dir()
    try:
        shutil.copy(Path(before) / "proj.db", tmp_path)
        (tmp_path / grid).write_bytes(b"")
        datadir.set_data_dir(str(tmp_path))
        assert approximation(CRS(4314), CRS(25832), bounds) is None
    finally:
        datadir.set_data_dir(before)


@pytest.mark.stress
@needs_no_grid
def test_a_mosaic_warns(tmp_path: Path) -> None:
    def write(name: str, crs: str, left: float) -> Path:
        with rasterio.open(
            tmp_path / name, "w", driver="GTiff", height=20, width=20, count=1, dtype="float32", crs=crs,
            transform=Affine(0.001, 0, left, 0, -0.001, 36.5),
        ) as file:  # fmt: skip
            file.write(np.full((20, 20), 7, np.float32), 1)
        return tmp_path / name

    old, new = write("old.tif", "EPSG:4267", -117.02), write("new.tif", "EPSG:4269", -117)
    assert not any("datum" in w or "PROJ" in w for w in Mosaic.open(new).warnings + Mosaic.open(old).warnings)
    both = Mosaic.open([new, old], resolution=10).warnings
    assert sum(w.startswith("old: From NAD27 to NAD83") and NADCON in w for w in both) == 1
    alone = Mosaic.open(old, crs="EPSG:26911", resolution=10).warnings
    assert sum(w.startswith("From NAD27 to NAD83") for w in alone) == 1
    assert not Mosaic.open([new, old]).warnings  # 11 m are not to be seen where samples are 100 m apart
