"""The xarray accessor against arrays written by hand and by rioxarray."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from orograph.dem import read
from orograph.errors import ReadError, UsageError

xr = pytest.importorskip("xarray")
accessor = importlib.import_module("orograph.accessor")


def made(values: np.ndarray, x: list[float], y: list[float], **attrs: object) -> xr.DataArray:
    return xr.DataArray(values, coords={"y": y, "x": x}, dims=("y", "x"), name="hill", attrs=attrs)


def test_a_plain_array() -> None:
    array = made(
        np.array([[1, 2, 3], [4, -9999, 6]], np.int16), [100, 110, 120], [50, 40], _FillValue=-9999, crs="EPSG:32611"
    )
    dem = array.orograph.to_dem()
    np.testing.assert_array_equal(dem.heights, np.float32([[1, 2, 3], [4, np.nan, 6]]))
    assert dem.grid.xy([0, 2], [0, 1]) == (pytest.approx([100, 120]), pytest.approx([50, 40]))
    assert dem.grid.crs is not None and dem.grid.crs.to_epsg() == 32611 and dem.name == "hill"


def test_south_up_east_first_and_feet() -> None:
    array = made(np.arange(6.0).reshape(2, 3), [120, 110, 100], [40, 50], units="ft")
    dem = array.orograph.to_dem()
    np.testing.assert_array_equal(dem.heights, np.float32(np.arange(6.0).reshape(2, 3)[::-1, ::-1] * 0.3048))
    assert dem.grid.xy(0, 0) == pytest.approx((100, 50))


def test_as_rioxarray_opens_it(shared_data: Path) -> None:
    rioxarray = pytest.importorskip("rioxarray")
    path = shared_data / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif"
    truth = read(path)
    for masked in (False, True):
        with rioxarray.open_rasterio(path, masked=masked) as array:
            dem = array.orograph.to_dem()
        np.testing.assert_array_equal(dem.heights, truth.heights)
        assert dem.grid.crs == truth.grid.crs
        np.testing.assert_allclose(dem.grid.transform[:6], truth.grid.transform[:6], rtol=0, atol=1e-6)


def test_a_geographic_array_becomes_a_metric_terrain() -> None:
    lon, lat = np.linspace(7, 7.1, 81), np.linspace(46.1, 46, 61)
    array = made(np.full((61, 81), 500.0), list(lon), list(lat), crs="EPSG:4326")
    terrain = array.orograph.to_terrain()
    assert terrain.grid.crs.to_epsg() == 32632 and terrain.height_range == (500, 500)
    projected = made(np.arange(6.0).reshape(2, 3), [100, 110, 120], [50, 40], crs="EPSG:32611").orograph.to_terrain()
    np.testing.assert_array_equal(projected.read(0, 0, 2, 0, 3), np.arange(6.0).reshape(2, 3))


def test_what_cannot_be_elevation_is_refused() -> None:
    square = np.zeros((2, 3))
    with pytest.raises(ReadError, match="evenly spaced"):
        made(square, [1, 2, 4], [1, 0]).orograph.to_dem()
    with pytest.raises(ReadError, match="no coordinates"):
        xr.DataArray(square, dims=("y", "x")).orograph.to_dem()
    with pytest.raises(ReadError, match="not a length"):
        made(square, [1, 2, 3], [1, 0], units="K").orograph.to_dem()
    with pytest.raises(UsageError, match="isel"):
        xr.DataArray(np.zeros((2, 2, 3)), dims=("t", "y", "x")).orograph.to_dem()
    with pytest.raises(ReadError, match="complex"):
        made(square.astype(complex), [1, 2, 3], [1, 0]).orograph.to_dem()
    with pytest.raises(ReadError, match="CRS"):
        made(square, [1, 2, 3], [1, 0], crs="EPSG:nonsense").orograph.to_dem()


def test_importing_orograph_registers_it_where_xarray_is_in_use() -> None:
    program = "import sys, {}\nprint('orograph.accessor' in sys.modules, 'xarray' in sys.modules)"
    for imports, says in (("xarray, orograph", "True True"), ("orograph", "False False")):
        run = subprocess.run(
            [sys.executable, "-c", program.format(imports)], capture_output=True, text=True, check=True
        )
        assert run.stdout.strip() == says


@pytest.mark.parametrize(("y", "x"), [("lat", "lon"), ("latitude", "longitude"), ("a", "b"), ("row", "col")])
def test_degrees_without_a_crs(y: str, x: str) -> None:
    """Longitudes and latitudes, and what says that it is in degrees, are no metres; what says neither is metres."""
    units = {"a": {"units": "degrees_north"}, "b": {"units": "degrees_east"}}
    array = xr.DataArray(
        np.full((61, 81), 500.0),
        coords={y: (y, np.linspace(46.1, 46, 61), units.get(y)), x: (x, np.linspace(7, 7.1, 81), units.get(x))},
        dims=(y, x), name="hill",
    )  # fmt: skip
    if y == "row":
        assert array.orograph.to_dem().grid.crs is None
        return
    with pytest.warns(
        UserWarning, match=f"hill has no CRS; its coordinates {x}, {y} are assumed to be degrees of WGS 84"
    ):
        dem = array.orograph.to_dem()
    assert dem.grid.crs is not None and dem.grid.crs.to_epsg() == 4326
    with pytest.warns(UserWarning):
        assert array.orograph.to_terrain().grid.crs.to_epsg() == 32632
    assert array.orograph.to_dem(crs="EPSG:4258").grid.crs.to_epsg() == 4258


def test_metres_that_are_called_latitude() -> None:
    array = xr.DataArray(
        np.zeros((2, 3)), coords={"lat": [4_000_030.0, 4e6], "lon": [5e5, 5e5 + 30, 5e5 + 60]}, dims=("lat", "lon")
    )
    assert array.orograph.to_dem().grid.crs is None
