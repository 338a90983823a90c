"""What netCDF's conventions (CF) say of axes, units and missing data, in files and in arrays of xarray."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import xarray as xr
from affine import Affine
from numpy.typing import NDArray

from orograph.dem import Source, read
from orograph.dem.conventions import even_axis
from orograph.dem.dataarray import from_xarray, place_of
from orograph.errors import ReadError

ROWS, COLS = 200, 260
X, Y = 500_000 + 30.0 * np.arange(COLS), 4_000_000 - 30.0 * np.arange(ROWS)
LON, LAT = 7 + np.arange(COLS) / 1200, 46 - np.arange(ROWS) / 1200
HEIGHTS = (300 + np.cumsum(np.random.default_rng(8).normal(0, 5, (ROWS, COLS)), axis=1)).astype(np.float32)
EAST = {"standard_name": "projection_x_coordinate", "units": "m"}
NORTH = {"standard_name": "projection_y_coordinate", "units": "m"}
DEGREES = ({"standard_name": "longitude", "units": "degrees_east"},
           {"standard_name": "latitude", "units": "degrees_north"})  # fmt: skip


def array(
    x: NDArray[Any] = X, y: NDArray[Any] = Y, axes: Any = (EAST, NORTH), names: Any = ("y", "x"), **attrs: Any
) -> xr.DataArray:
    """The heights with coordinates, and attributes of them and of the axes."""
    coords = {names[1]: (names[1], x, axes[0]), names[0]: (names[0], y, axes[1])}
    return xr.DataArray(HEIGHTS, dims=names, coords=coords, name="z", attrs=attrs)


def file_of(given: xr.DataArray, path: Path) -> Path:
    fill = given.attrs.pop("_FillValue", None)
    data = xr.Dataset({"z": given}, attrs={"Conventions": "CF-1.8"})
    data.to_netcdf(path, engine="scipy", encoding={"z": {"_FillValue": fill}, **{c: {"_FillValue": None} for c in
                   given.coords}})  # fmt: skip
    return path


UNEVEN = {
    "a gap": (LON, np.where(np.arange(ROWS) > 120, LAT - 60 / 1200, LAT)),
    "slowly growing steps": (LON, 46 - np.arange(ROWS) * (1 + np.arange(ROWS) / 2000) / 1200),
    "the same twice": (np.where(np.arange(COLS) == 100, LON[99], LON), LAT),
    "none at all": (np.where(np.arange(COLS) == 100, np.nan, LON), LAT),
    "nowhere at the end": (np.where(np.arange(COLS) == COLS - 1, np.inf, LON), LAT),
    "two halves": (np.where(np.arange(COLS) < 130, LON, LON[130] + (np.arange(COLS) - 130) * 1.02 / 1200), LAT),
}


@pytest.mark.parametrize("case", UNEVEN)
def test_uneven_axes(tmp_path: Path, case: str) -> None:
    """GDAL compares a few coordinates, with a tolerance of 0.001 degrees: more than a sample of such a grid."""
    given = array(*UNEVEN[case], DEGREES, ("lat", "lon"))
    with warnings.catch_warnings(), pytest.raises(ReadError, match=r"not evenly spaced: number \d+ is"):
        warnings.simplefilter("ignore")  # (what its degrees are taken for)
        from_xarray(given)
    with pytest.raises(ReadError, match=r"a\.nc: .* not evenly spaced: number \d+ is"):
        read(file_of(given, tmp_path / "a.nc"))


def test_axes_that_float32_has_rounded_are_even(tmp_path: Path) -> None:
    lon, lat = (170 + np.arange(COLS) / 3600).astype(np.float32), (46 - np.arange(ROWS) / 3600).astype(np.float32)
    assert np.abs(np.diff(lon) * 3600 - 1).max() > 0.04
    given = array(lon, lat, DEGREES, ("lat", "lon"))
    with pytest.warns(UserWarning, match="assumed to be degrees"):
        from_xarray(given)
    np.testing.assert_array_equal(read(file_of(given, tmp_path / "a.nc")).heights, HEIGHTS)


def test_where_an_axis_is_uneven() -> None:
    assert even_axis(np.array([5.0])) == (5, 1)
    assert even_axis(np.array([5.0, 4.0, 3.0])) == (5, -1)
    for odd in ([1.0, 1.0], [0.0, 1.2, 2.0], [0.0, np.nan, 2.0]):
        with pytest.raises(ValueError, match="number 1 is"):
            even_axis(np.array(odd))


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("said", [True, False])
def test_rows_are_where_their_coordinates_say(tmp_path: Path, up: bool, said: bool) -> None:
    """Also where nothing but the names of the axes tells what they are, which GDAL does not know."""
    given = array(axes=(EAST, NORTH) if said else ({}, {}))
    dem = read(file_of(given[::-1] if up else given, tmp_path / "a.nc"))
    np.testing.assert_array_equal(dem.heights, HEIGHTS)
    np.testing.assert_allclose(dem.grid.transform[:6], (30, 0, X[0] - 15, 0, -30, Y[0] + 15))


@pytest.mark.parametrize(("unit", "metres"), [("km", 1000), ("ft", 0.3048), ("m", 1)])
def test_axes_in_other_units(tmp_path: Path, unit: str, metres: float) -> None:
    given = array(X / metres, Y / metres, ({"units": unit}, {"units": unit}))
    dems = from_xarray(given), read(file_of(given, tmp_path / "a.nc"))
    for heights, grid in ((dem.heights, dem.grid) for dem in dems):
        np.testing.assert_array_equal(heights, HEIGHTS)
        np.testing.assert_allclose(grid.transform[:6], (30, 0, X[0] - 15, 0, -30, Y[0] + 15), rtol=1e-9)


def test_axes_that_no_plane_has(tmp_path: Path) -> None:
    radians = array(np.radians(LON), np.radians(LAT), ({"units": "radians"}, {"units": "radians"}))
    with pytest.raises(ReadError, match=r"no CRS.* is in 'radians'"):
        from_xarray(radians)
    with pytest.raises(ReadError, match=r"no CRS.* is in 'radians'"):
        read(file_of(radians, tmp_path / "a.nc"))
    rotated = array(LON, LAT, ({"units": "degrees"}, {"units": "degrees"}), ("rlat", "rlon"))
    with pytest.raises(ReadError, match="rotated pole"):
        from_xarray(rotated)


MISSING = {
    "range": ({"valid_range": np.array([0, 300], np.float32)}, HEIGHTS > 300),
    "range and fill": ({"valid_range": np.array([0, 300], np.float32), "_FillValue": np.float32(-9)}, HEIGHTS > 300),
    "greatest": ({"valid_max": np.float32(300)}, HEIGHTS > 300),
    "least": ({"valid_min": np.float32(300)}, HEIGHTS < 300),
    "two numbers": ({"missing_value": HEIGHTS[5, 5], "_FillValue": HEIGHTS[7, 7]},
                    np.isin(HEIGHTS, (HEIGHTS[5, 5], HEIGHTS[7, 7]))),
    "one": ({"missing_value": HEIGHTS[5, 5]}, HEIGHTS[5, 5] == HEIGHTS),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:variable 'heights' has multiple fill values")
@pytest.mark.parametrize("case", MISSING)
def test_missing_data(tmp_path: Path, case: str) -> None:
    attributes, missing = MISSING[case]
    assert missing.any() and not missing.all()
    wanted = np.where(missing, np.nan, HEIGHTS)
    np.testing.assert_array_equal(from_xarray(array(**attributes)).heights, wanted)
    path = file_of(array(**attributes), tmp_path / "a.nc")
    np.testing.assert_array_equal(read(path).heights, wanted)
    with Source.open(path) as source:
        np.testing.assert_array_equal(source.read(0, ROWS, 0, COLS, step=3), wanted[::3, ::3])
    np.testing.assert_array_equal(read(path, nodata="none").heights, HEIGHTS)


def test_packed_numbers_have_a_packed_range(tmp_path: Path) -> None:
    packed = np.round(HEIGHTS / 0.5).astype(np.int16)
    said = {"scale_factor": 0.5, "add_offset": 100.0, "valid_range": np.array([0, 600], np.int16)}
    given = array(**said).copy(data=packed)
    wanted = np.where(packed > 600, np.nan, packed * 0.5 + 100).astype(np.float32)
    np.testing.assert_array_equal(from_xarray(given).heights, wanted)
    path = file_of(given, tmp_path / "a.nc")
    np.testing.assert_array_equal(read(path).heights, wanted)
    with xr.open_dataset(path, engine="scipy") as decoded:
        np.testing.assert_array_equal(from_xarray(decoded["z"]).heights, wanted)


def test_the_ends_of_a_packed_range_are_in_it(tmp_path: Path) -> None:
    """Decoded numbers are rounded: 602 · 0.1 is more than 60.2 as float32, and the range's end no less a height."""
    packed = (np.arange(ROWS * COLS).reshape(ROWS, COLS) % 700).astype(np.int16)
    for scale in (0.1, -0.1):
        said = {"scale_factor": scale, "valid_range": np.array([3, 602], np.int16)}
        path = file_of(array(**said).copy(data=packed), tmp_path / f"a{scale}.nc")
        with xr.open_dataset(path, engine="scipy") as decoded:
            found = from_xarray(decoded["z"]).heights
        np.testing.assert_array_equal(np.isnan(found), (packed < 3) | (packed > 602))


def test_a_height_may_equal_the_number_that_was_missing_when_packed(tmp_path: Path) -> None:
    packed = (np.arange(ROWS * COLS).reshape(ROWS, COLS) % 700).astype(np.int16)
    said = {"scale_factor": 0.5, "add_offset": -100.0, "_FillValue": np.int16(0)}
    wanted = np.where(packed == 0, np.nan, packed * 0.5 - 100)
    assert (wanted == 0).any()
    np.testing.assert_array_equal(from_xarray(array(**said).copy(data=packed)).heights, wanted)
    with xr.open_dataset(file_of(array(**said).copy(data=packed), tmp_path / "a.nc"), engine="scipy") as decoded:
        np.testing.assert_array_equal(from_xarray(decoded["z"]).heights, wanted)


def test_a_layer_s_axes_have_units_too() -> None:
    _, transform, crs = place_of(array(X / 1000, Y / 1000, ({"units": "km"}, {"units": "km"})))
    assert crs is None and transform is not None
    np.testing.assert_allclose(transform[:6], (30, 0, X[0] - 15, 0, -30, Y[0] + 15), rtol=1e-9)


@pytest.mark.parametrize("said", [{"standard_name": "sea_floor_depth_below_geoid"}, {"positive": "down"}])
def test_depths_become_heights(tmp_path: Path, said: dict[str, str]) -> None:
    given = array(**said)
    with pytest.warns(UserWarning, match="are depths"):
        np.testing.assert_array_equal(from_xarray(given).heights, -HEIGHTS)
    path = file_of(given, tmp_path / "a.nc")
    with Source.open(path) as source:
        assert any("are depths" in warning for warning in source.warnings)
        np.testing.assert_array_equal(source.read(0, ROWS, 0, COLS), -HEIGHTS)
    np.testing.assert_array_equal(read(path, vertical_unit="m").heights, HEIGHTS)


def test_a_crs_whose_vertical_axis_points_down(tmp_path: Path) -> None:
    path = tmp_path / "depths.tif"
    with rasterio.open(path, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="float32",
                       crs="EPSG:32632+5715", transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(HEIGHTS, 1)
    with Source.open(path) as source:
        assert source.vertical == "MSL height" and any("are depths" in warning for warning in source.warnings)
        np.testing.assert_array_equal(source.read(0, ROWS, 0, COLS), -HEIGHTS)
    np.testing.assert_array_equal(read(path, vertical_unit="m").heights, HEIGHTS)
