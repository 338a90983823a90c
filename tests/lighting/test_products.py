"""Products by name: in one call on arrays, DataArrays, Dems, terrains and files; the same within any memory."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

import orograph.store
from orograph import lighting
from orograph.dem import Dem
from orograph.errors import OutputError, UsageError
from orograph.geo.grid import Grid
from orograph.lighting import products
from orograph.lighting.arrays import terrain_of
from orograph.lighting.context import Context, Options
from orograph.lighting.products import compute, names, product
from orograph.lighting.raster import to_bytes

CELL = 30.0


@pytest.fixture(scope="module")
def heights():
    y, x = np.mgrid[:60, :80]
    h = (300 + 100 * np.sin(x / 7) * np.cos(y / 5)).astype(np.float32)
    h[20:23, 30:34] = np.nan
    return h


def grid_of(heights, epsg=32611):
    return Grid(heights.shape, Affine(CELL, 0, 5e5, 0, -CELL, 4e6), CRS.from_epsg(epsg))


def test_several_products_are_bands_of_one_result(heights):
    dem = Dem(heights, grid_of(heights))
    several = ("slope", "normal", "sky-view-factor", "openness")
    made = lighting.make(dem, several, azimuths=8)
    alone = [lighting.make(dem, name, azimuths=8) for name in several]
    np.testing.assert_array_equal(made.values, np.concatenate([one.values for one in alone]))
    assert [band.name for band in made.bands][:3] == ["slope", "normal east", "normal north"]
    np.testing.assert_array_equal(lighting.make(heights, "slope,aspect", cell=CELL)[0], made.values[0])
    with pytest.raises(UsageError, match="no product"):
        lighting.make(dem, ["slope", "beauty"])


def test_what_comes_back_is_what_was_given(heights, tmp_path):
    xr = pytest.importorskip("xarray")
    dem = Dem(heights, grid_of(heights))
    array = lighting.slope(heights, cell=CELL)
    assert isinstance(array, np.ndarray) and array.dtype == np.float32 and array.shape == heights.shape
    made = lighting.slope(dem)
    assert isinstance(made, lighting.Map) and made.grid == dem.grid and made.bands[0].unit == "degrees"
    np.testing.assert_array_equal(made.values[0], array)
    np.testing.assert_array_equal(lighting.slope(orograph.store.terrain(dem)).values[0], array)
    made.save(tmp_path / "slope.tif")
    with rasterio.open(tmp_path / "slope.tif") as file:
        np.testing.assert_array_equal(file.read(1), array)
        assert file.units == ("degrees",)
    again = lighting.slope(tmp_path / "slope.tif")
    assert again.grid.shape == heights.shape
    x, y = dem.grid.xy(np.arange(80), 0)[0], dem.grid.xy(0, np.arange(60))[1]
    ref = xr.DataArray(0, attrs={"crs_wkt": dem.grid.crs.to_wkt()})
    given = xr.DataArray(heights[::-1], {"lat": y[::-1], "lon": x, "spatial_ref": ref}, ("lat", "lon"))
    back = lighting.slope(given)
    assert isinstance(back, xr.DataArray) and back.dims == ("lat", "lon") and back.attrs["units"] == "degrees"
    np.testing.assert_array_equal(back.values[::-1], array)  # in the order that was given
    np.testing.assert_array_equal(back["lat"].values, given["lat"].values)
    assert lighting.normals(given).dims == ("band", "lat", "lon")


def test_each_name_is_its_product(heights):
    same = {
        "aspect": lighting.aspect, "normal": lighting.normals, "hillshade": lighting.hillshade,
        "horizon": lighting.horizons,
        "sky-view-factor": lighting.sky_view_factor, "visible-sky": lighting.visible_sky,
        "ambient-occlusion": lighting.ambient_occlusion, "aperture": lighting.apertures,
    }  # fmt: skip
    for name, function in same.items():
        np.testing.assert_array_equal(function(heights, cell=CELL), lighting.make(heights, name, cell=CELL))
    horizontal = lighting.sky_view_factor(heights, 16, horizontal=True, cell=CELL)
    np.testing.assert_array_equal(horizontal, lighting.make(heights, "sky-view-horizontal", azimuths=16, cell=CELL))
    for negative, name in ((False, "openness"), (True, "openness-negative")):
        got = lighting.openness(heights, 8, radius=90.0, negative=negative, cell=CELL)
        np.testing.assert_array_equal(got, lighting.make(heights, name, azimuths=8, radius=90.0, cell=CELL))


def test_sun_and_seasons_by_name_on_whatever_has_heights(heights, tmp_path):
    dem = Dem(heights, grid_of(heights))
    when = "2026-03-21T16:00Z"
    for data in (dem, orograph.store.terrain(dem)):
        made = lighting.shadows(data, when)
        assert [b.name for b in made.bands] == ["fraction", "code"]
        np.testing.assert_array_equal(made.values, lighting.make(dem, "shadow", sun=when).values)
        year = lighting.insolation(data, "2026", step=60.0)
        assert [b.name for b in year.bands] == ["direct", "diffuse", "global"] and year.bands[0].unit == "Wh/m2"
        np.testing.assert_array_equal(
            year.values, lighting.make(dem, "insolation", date="2026", step=60.0, azimuths=64).values
        )
    np.testing.assert_array_equal(
        lighting.hillshade(dem, sun=when).values, lighting.make(dem, "hillshade", sun=when).values
    )
    np.testing.assert_array_equal(
        lighting.ambient_occlusion(heights, 200.0, rho="linear", method="rays", rays=8, cell=CELL),
        lighting.make(heights, "ambient-occlusion", radius=200.0, rho="linear", method="rays", rays=8, cell=CELL),
    )
    with pytest.raises(UsageError, match="where on Earth"):
        lighting.insolation(heights, "2026", cell=CELL)


def named(heights, dims=("y", "x"), epsg=32611, **more):
    """A DataArray of heights, as rioxarray has them."""
    xr = pytest.importorskip("xarray")
    grid = grid_of(heights, epsg)
    x, y = grid.xy(np.arange(heights.shape[1]), 0)[0], grid.xy(0, np.arange(heights.shape[0]))[1]
    ref = xr.DataArray(0, attrs={"crs_wkt": grid.crs.to_wkt()})
    return xr.DataArray(heights, {dims[0]: y, dims[1]: x, "spatial_ref": ref, **more}, dims)


def test_rows_of_a_data_array_are_not_taken_for_columns(heights):
    """Dimensions that say they are turned: NetCDF files with (x, y), (lon, lat), or CF's axis and standard_name."""
    expected = lighting.aspect(Dem(heights, grid_of(heights))).values[0]
    for dims in (("y", "x"), ("northing", "easting"), ("lat", "lon")):
        turned = named(heights, dims).transpose()
        made = lighting.aspect(turned)
        assert made.dims == dims[::-1]
        np.testing.assert_array_equal(made.transpose().values, expected)
    odd = named(heights, ("down", "across")).transpose()
    odd["across"].attrs["axis"] = "X"
    odd["down"].attrs["standard_name"] = "projection_y_coordinate"
    np.testing.assert_array_equal(lighting.aspect(odd).transpose().values, expected)
    assert lighting.normals(odd).dims == ("band", "across", "down")


def test_what_a_data_array_keeps(heights):
    xr = pytest.importorskip("xarray")
    scalars = {"time": np.datetime64("2026-06-21", "ns"), "season": "summer", "band": 1}
    given = named(heights.astype(np.float64), **scalars).assign_attrs(units="m", long_name="heights", source="SRTM")
    given.name = "dem"
    made = lighting.slope(given)
    assert made.name == "slope" and made.attrs == {"units": "degrees", "long_name": "steepness of the ground"}
    assert set(made.coords) == {"y", "x", "spatial_ref", "time", "season"} and made.season == "summer"
    xr.testing.assert_identical(made, lighting.make(given, "slope"))
    importlib.import_module("orograph.accessor")
    xr.testing.assert_identical(made, given.orograph.light("slope"))
    np.testing.assert_array_equal(made.values, lighting.slope(given.expand_dims("band")).values)
    shade = lighting.normals(given)
    assert list(shade.band.values) == ["normal east", "normal north", "normal up"]
    slope = lighting.slope(given.to_dataset(name="hill"))
    np.testing.assert_array_equal(slope, lighting.slope(given))
    with pytest.raises(UsageError, match="dataset"):
        lighting.slope(given.to_dataset(name="a").assign(b=given))


def test_metres_are_not_called_degrees(heights):
    """A map of a grid in degrees is in metres, and its dimensions are not latitude and longitude."""
    xr = pytest.importorskip("xarray")
    y, x = 45.0 - np.arange(60) * 3e-4, 7.0 + np.arange(80) * 3e-4
    given = xr.DataArray(heights, {"lat": y, "lon": x}, ("lat", "lon"), attrs={"crs": "EPSG:4326"})
    made = lighting.slope(given)
    assert made.dims == ("y", "x") and made.y.max() > 1e6 and "UTM" in made.spatial_ref.attrs["crs_wkt"]


def test_lazy_masked_and_odd_arrays(heights):
    expected = lighting.slope(heights, cell=CELL)
    masked = np.ma.masked_invalid(heights)
    masked.data[masked.mask] = -9999.0
    np.testing.assert_array_equal(lighting.slope(masked, cell=CELL), expected)
    np.testing.assert_array_equal(lighting.slope(np.where(np.isnan(heights), np.inf, heights), cell=CELL), expected)

    class Lazy:
        dtype, shape = heights.dtype, heights.shape

        def __array__(self, dtype=None, copy=None):
            return heights if dtype is None else heights.astype(dtype)

    np.testing.assert_array_equal(lighting.slope(Lazy(), cell=CELL), expected)
    for wrong in (heights.astype(complex), heights.astype(str), heights.astype("datetime64[s]")):
        with pytest.raises(UsageError, match="real numbers"):
            lighting.slope(wrong, cell=CELL)


def test_cells_of_arrays(heights):
    square = lighting.slope(heights, cell=CELL)
    np.testing.assert_array_equal(square, lighting.slope(heights, cell=(CELL, CELL)))
    np.testing.assert_array_equal(square, lighting.slope(heights, cell=[[CELL, 0], [0, -CELL]]))
    assert not np.allclose(square, lighting.slope(heights, cell=(CELL, 2 * CELL)), equal_nan=True)
    for wrong in (None, 0.0, (1.0, -1.0), (1.0, 2.0, 3.0)):
        with pytest.raises(UsageError, match=r"[Cc]ell"):
            lighting.slope(heights, cell=wrong)
    with pytest.raises(UsageError, match="cell"):
        lighting.slope(Dem(heights, grid_of(heights)), cell=3.0)
    with pytest.raises(UsageError, match="float"):
        lighting.slope(3.0)


SWEPT = ("horizon", "sky-view-factor", "sky-view-horizontal", "visible-sky", "openness", "openness-negative")


@pytest.mark.parametrize("name", SWEPT)
def test_a_canvas_on_disk_changes_no_bit(heights, name, monkeypatch):
    terrain = terrain_of(heights, np.diag([CELL, -CELL]))
    options = Options(azimuths=6)
    plenty = compute(Context(terrain, options), name)
    monkeypatch.setattr(Context, "budget", property(lambda self: 20_000))
    context = Context(terrain, options, jobs=1)
    made = context.canvas(1)
    made.values[0, 3] = 7.0
    made.release()
    assert made.on_disk and (made.values[0, 3] == 7.0).all()
    np.testing.assert_array_equal(plenty, compute(context, name))
    assert np.array_equal(np.isnan(plenty[0]), np.isnan(heights))


def test_blocks_cover_the_raster_once(heights):
    for name in ("slope", "normal", *SWEPT):
        came = np.zeros(heights.shape, int)
        context = Context(terrain_of(heights, np.diag([CELL, -CELL])), Options(azimuths=5))
        for row, col, values in product(name).run(context):
            assert values.dtype == np.float32 and len(values) == len(product(name).bands(context.options))
            came[row : row + values.shape[1], col : col + values.shape[2]] += 1
        assert (came == 1).all(), name


def test_a_scratch_folder_without_room_says_so(heights, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("orograph.folders.mmap.mmap", full)
    monkeypatch.setattr(Context, "budget", property(lambda self: 20_000))
    with pytest.raises(OutputError, match="TMPDIR"):
        lighting.visible_sky(heights, cell=CELL)


def test_wrong_options_are_refused(heights):
    with pytest.raises(UsageError, match="sky-view-factor"):
        lighting.make(heights, "sky", cell=CELL)
    for wrong in (
        {"azimuths": 2}, {"azimuths": 8.5}, {"radius": 0.0}, {"radius": np.inf}, {"radius": "300"}, {"jobs": 0},
        {"refraction": np.nan}, {"exaggeration": 0.0}, {"lights": ((315.0,),)}, {"lights": ("315,north",)},
        {"lights": ((0, 0, np.nan),)},
    ):  # fmt: skip
        with pytest.raises(UsageError):
            lighting.make(heights, "visible-sky", cell=CELL, **wrong)
    with pytest.raises(UsageError, match=r"raduis.*radius"):
        lighting.make(heights, "visible-sky", cell=CELL, raduis=300.0)


def test_bytes_are_gdals_for_hillshades():
    values = np.array([[0.0, 0.5, 1.0, np.nan, -1.0, 2.0]], np.float32)
    np.testing.assert_array_equal(to_bytes(values, 0.0, 1.0), [[1, 128, 255, 0, 1, 255]])  # 1 + 254 · cosine


def test_every_product_is_registered_where_it_is(heights):
    for name in names():
        found = product(name)
        assert found.name == name and found.unit and found.doc and found.bands(Options())
    assert set(SWEPT) < set(products.names())


def test_a_sun_is_a_pair_a_sun_or_a_moment(heights):
    from orograph.lighting.shadow import shadow
    from orograph.lighting.sun import Sun, sun_of

    wide = Sun(200.0, 20.0, 10.0)
    made = lighting.make(heights, "shadow", cell=CELL, sun=wide)
    np.testing.assert_array_equal(made, np.stack(shadow(heights, np.diag([CELL, -CELL]), wide)))
    narrow = lighting.make(heights, "shadow", cell=CELL, sun=(200.0, 20.0))
    assert not np.array_equal(made, narrow, equal_nan=True)
    dem = Dem(heights, grid_of(heights))
    when = "2026-03-21T16:00Z"
    there = sun_of(when, dem.grid)
    by_time = lighting.make(dem, "hillshade", sun=when).values
    np.testing.assert_array_equal(by_time, lighting.make(dem, "hillshade", sun=(there.azimuth, there.altitude)).values)


def test_keeping_canvases_on_disk_takes_no_memory(tmp_path, monkeypatch):
    """Their pages are let go of behind what is written and read."""
    from orograph.lighting import raster_resume
    from orograph.lighting.raster import Canvas

    monkeypatch.setattr(raster_resume, "_CHUNK", 100)
    released, release = [], Canvas.release
    monkeypatch.setattr(Canvas, "release", lambda self: released.append(self) or release(self))
    canvases = [Canvas(2, (13, 17), on_disk) for on_disk in (True, False)]
    for k, canvas in enumerate(canvases):
        canvas.values[:] = np.arange(442).reshape(2, 13, 17) + k
    kept = raster_resume.Checkpoint(tmp_path / "kept", {"plan": 1})
    kept.save("a+b", canvases, [3, 1])
    assert len(released) == 10
    again = [Canvas(2, (13, 17), True) for _ in canvases]
    assert kept.load("a+b", again) == [3, 1]
    for one, other in zip(canvases, again):
        np.testing.assert_array_equal(one.values, other.values)
