"""Products by name: in one call on arrays, DataArrays, Dems, terrains and files; the same within any memory."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

import orograph.store
from orograph import light
from orograph.dem import Dem
from orograph.errors import OutputError, UsageError
from orograph.geo.grid import Grid
from orograph.light import products
from orograph.light.arrays import terrain_of
from orograph.light.products import Context, Options, compute, names, product
from orograph.light.raster import to_bytes

CELL = 30.0


@pytest.fixture(scope="module")
def heights():
    y, x = np.mgrid[:60, :80]
    h = (300 + 100 * np.sin(x / 7) * np.cos(y / 5)).astype(np.float32)
    h[20:23, 30:34] = np.nan
    return h


def grid_of(heights, epsg=32611):
    return Grid(heights.shape, Affine(CELL, 0, 5e5, 0, -CELL, 4e6), CRS.from_epsg(epsg))


def test_what_comes_back_is_what_was_given(heights, tmp_path):
    xr = pytest.importorskip("xarray")
    dem = Dem(heights, grid_of(heights))
    array = light.slope(heights, cell=CELL)
    assert isinstance(array, np.ndarray) and array.dtype == np.float32 and array.shape == heights.shape
    made = light.slope(dem)
    assert isinstance(made, light.Map) and made.grid == dem.grid and made.bands[0].unit == "degrees"
    np.testing.assert_array_equal(made.values[0], array)
    np.testing.assert_array_equal(light.slope(orograph.store.terrain(dem)).values[0], array)
    made.save(tmp_path / "slope.tif")
    with rasterio.open(tmp_path / "slope.tif") as file:
        np.testing.assert_array_equal(file.read(1), array)
        assert file.units == ("degrees",)
    again = light.slope(tmp_path / "slope.tif")
    assert again.grid.shape == heights.shape
    x, y = dem.grid.xy(np.arange(80), 0)[0], dem.grid.xy(0, np.arange(60))[1]
    ref = xr.DataArray(0, attrs={"crs_wkt": dem.grid.crs.to_wkt()})
    given = xr.DataArray(heights[::-1], {"lat": y[::-1], "lon": x, "spatial_ref": ref}, ("lat", "lon"))
    back = light.slope(given)
    assert isinstance(back, xr.DataArray) and back.dims == ("lat", "lon") and back.attrs["units"] == "degrees"
    np.testing.assert_array_equal(back.values[::-1], array)  # in the order that was given
    np.testing.assert_array_equal(back["lat"].values, given["lat"].values)
    assert light.normals(given).dims == ("band", "lat", "lon")


def test_each_name_is_its_product(heights):
    same = {
        "aspect": light.aspect, "normal": light.normals, "hillshade": light.hillshade, "horizon": light.horizons,
        "sky-view-factor": light.sky_view_factor, "visible-sky": light.visible_sky,
    }  # fmt: skip
    for name, function in same.items():
        np.testing.assert_array_equal(function(heights, cell=CELL), light.make(heights, name, cell=CELL))
    horizontal = light.sky_view_factor(heights, 16, horizontal=True, cell=CELL)
    np.testing.assert_array_equal(horizontal, light.make(heights, "sky-view-horizontal", azimuths=16, cell=CELL))
    for negative, name in ((False, "openness"), (True, "openness-negative")):
        got = light.openness(heights, 8, radius=90.0, negative=negative, cell=CELL)
        np.testing.assert_array_equal(got, light.make(heights, name, azimuths=8, radius=90.0, cell=CELL))


def test_cells_of_arrays(heights):
    square = light.slope(heights, cell=CELL)
    np.testing.assert_array_equal(square, light.slope(heights, cell=(CELL, CELL)))
    np.testing.assert_array_equal(square, light.slope(heights, cell=[[CELL, 0], [0, -CELL]]))
    assert not np.allclose(square, light.slope(heights, cell=(CELL, 2 * CELL)), equal_nan=True)
    for wrong in (None, 0.0, (1.0, -1.0), (1.0, 2.0, 3.0)):
        with pytest.raises(UsageError, match=r"[Cc]ell"):
            light.slope(heights, cell=wrong)
    with pytest.raises(UsageError, match="cell"):
        light.slope(Dem(heights, grid_of(heights)), cell=3.0)
    with pytest.raises(UsageError, match="float"):
        light.slope(3.0)


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

    monkeypatch.setattr("orograph.light.raster.mmap.mmap", full)
    monkeypatch.setattr(Context, "budget", property(lambda self: 20_000))
    with pytest.raises(OutputError, match="TMPDIR"):
        light.visible_sky(heights, cell=CELL)


def test_wrong_options_are_refused(heights):
    with pytest.raises(UsageError, match="sky-view-factor"):
        light.make(heights, "sky", cell=CELL)
    for wrong in ({"azimuths": 2}, {"radius": 0.0}, {"radius": np.inf}):
        with pytest.raises(UsageError):
            light.make(heights, "visible-sky", cell=CELL, **wrong)


def test_bytes_are_gdals_for_hillshades():
    values = np.array([[0.0, 0.5, 1.0, np.nan, -1.0, 2.0]], np.float32)
    np.testing.assert_array_equal(to_bytes(values, 0.0, 1.0), [[1, 128, 255, 0, 1, 255]])  # 1 + 254 · cosine


def test_every_product_is_registered_where_it_is(heights):
    for name in names():
        found = product(name)
        assert found.name == name and found.unit and found.doc and found.bands(Options())
    assert set(SWEPT) < set(products.names())


def test_a_sun_is_a_pair_a_sun_or_a_moment(heights):
    from orograph.light.shadow import shadow
    from orograph.light.sun import Sun, sun_of

    wide = Sun(200.0, 20.0, 10.0)
    made = light.make(heights, "shadow", cell=CELL, sun=wide)
    np.testing.assert_array_equal(made, np.stack(shadow(heights, np.diag([CELL, -CELL]), wide)))
    narrow = light.make(heights, "shadow", cell=CELL, sun=(200.0, 20.0))
    assert not np.array_equal(made, narrow, equal_nan=True)
    dem = Dem(heights, grid_of(heights))
    when = "2026-03-21T16:00Z"
    there = sun_of(when, dem.grid)
    by_time = light.make(dem, "hillshade", sun=when).values
    np.testing.assert_array_equal(by_time, light.make(dem, "hillshade", sun=(there.azimuth, there.altitude)).values)


def test_keeping_canvases_on_disk_takes_no_memory(tmp_path, monkeypatch):
    """Their pages are let go of behind what is written and read."""
    from orograph.light import raster_resume
    from orograph.light.raster import Canvas

    monkeypatch.setattr(raster_resume, "_CHUNK", 100)
    released, release = [], Canvas.release
    monkeypatch.setattr(Canvas, "release", lambda self: released.append(self) or release(self))
    canvases = [Canvas(2, (13, 17), on_disk) for on_disk in (True, False)]
    for k, canvas in enumerate(canvases):
        canvas.values[:] = np.arange(442).reshape(2, 13, 17) + k
    kept = raster_resume.Kept(tmp_path / "kept", {"plan": 1})
    kept.save("a+b", canvases, [3, 1])
    assert len(released) == 10
    again = [Canvas(2, (13, 17), True) for _ in canvases]
    assert kept.load("a+b", again) == [3, 1]
    for one, other in zip(canvases, again):
        np.testing.assert_array_equal(one.values, other.values)
