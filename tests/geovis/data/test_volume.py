"""Volumes over the ground: levels and heights against published tables, sections against the function they sample."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data import standing_sections as sections
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.listing import levels_in
from orograph.geovis.data.reading import read
from orograph.geovis.data.standing import Kind
from orograph.geovis.data.vertical import axis_of, geometric, standard_heights
from orograph.geovis.data.volume import read_volume
from orograph.scene.theming import themed

UTM = "EPSG:32630"
WEST, NORTH = 500_000, 5_600_000


def hill(rows=40, cols=50):
    """Ground that rises to the east, 4 m a column; cells of 20 by 10 m."""
    heights = np.broadcast_to(4.0 * np.arange(cols), (rows, cols)).astype(np.float32)
    return orograph.terrain(heights, transform=from_origin(WEST, NORTH, 20, 10), crs=UTM)


def truth(x, y, h):
    return 3 + (x - WEST) / 100 - (NORTH - y) / 50 + h / 40


def volume(levels, name="height", attrs=None, over=None, **more):
    """Samples of ``truth`` over the hill; levels are heights unless ``over`` says heights of them."""
    x, y = WEST + 25.0 + 50 * np.arange(21), NORTH - 25.0 - 50 * np.arange(9)
    h = np.asarray(levels, float) if over is None else np.asarray(over, float)
    values = truth(x[None, None], y[None, :, None], h[:, None, None])
    made = xr.DataArray(
        values, coords={name: (name, np.asarray(levels, float), attrs or {}), "y": y, "x": x},
        dims=(name, "y", "x"), name="warmth", attrs={"units": "K", **more},
    )  # fmt: skip
    return made.rio.write_crs(UTM)


@pytest.fixture(autouse=True)
def _rio():
    pytest.importorskip("rioxarray")


def things(data, **options):
    found = themed({"data": data, **options}, hill(), (300, 200)).things
    assert found is not None
    return found


ALONG = {"type": "LineString", "crs": {"properties": {"name": UTM}},
         "coordinates": [[WEST + 105.0, NORTH - 205.0], [WEST + 905.0, NORTH - 105.0]]}  # fmt: skip


def middles(found):
    return (
        (found.x + found.ends[:, 1]) / 2, (found.y + found.ends[:, 2]) / 2, (found.ends[:, 0] + found.ends[:, 3]) / 2
    )  # fmt: skip


def test_a_curtain_has_the_values_of_the_field_it_cuts():
    found = things(Dataset(volume([0, 150, 300, 600]), style="curtains", along=ALONG))
    assert set(found.kind) == {Kind.SECTION}
    x, y, h = middles(found)
    inside = (h >= 0) & (h <= 600)
    assert inside.mean() > 0.7
    np.testing.assert_allclose(found.values[inside], truth(x, y, h)[inside], atol=1e-3)
    # It follows the line, from one end to the other, half a layer beyond the outermost levels and no farther.
    np.testing.assert_allclose(y - (NORTH - 205), (x - WEST - 105) / 8, atol=0.5)
    assert found.ends[:, 0].min() == pytest.approx(-75) and found.ends[:, 3].max() == pytest.approx(750)
    np.testing.assert_allclose(found.values[h > 600], truth(x, y, 600.0)[h > 600], atol=1e-3)


def test_what_counts_from_the_ground_follows_it():
    over = volume([0, 100], attrs={"standard_name": "height", "units": "m"})
    above = things(Dataset(over, style="curtains", along=ALONG))
    x, *_ = middles(above)
    ground = (x - WEST - 10) / 5
    assert (above.ends[:, 0] >= ground - 1e-6).all() and (above.ends[:, 3] <= ground + 150 + 3).all()
    deep = volume([1, 3], "depth", {"units": "cm", "positive": "down"})
    below = things(Dataset(deep, style="curtains", along=ALONG))
    x, *_ = middles(below)
    ground = (x - WEST - 10) / 5
    assert (below.ends[:, 3] <= ground + 1e-3).all() and (below.ends[:, 0] >= ground - 0.04 - 1e-3).all()
    assert set(below.hidden) == {0.65} and set(above.hidden) == {0.0}


def test_pressures_have_the_heights_of_the_standard_atmosphere():
    # ICAO Doc 7488 (geopotential metres): 1000, 850, 700, 500, 300, 200, 100 hPa.
    found = standard_heights(np.array([1000.0, 850, 700, 500, 300, 200, 100]))
    np.testing.assert_allclose(found, [110.9, 1457.3, 3012.2, 5574.4, 9163.9, 11784.1, 16179.6], atol=2.5)
    # The same document: 10 000 gpm are 10 015.8 m.
    assert geometric(np.array([10_000.0]))[0] == pytest.approx(10_015.8, abs=0.1)
    made = read_volume(
        Dataset(volume([1000, 990, 980], "plev", {"units": "hPa"}), style="curtains"), hill().grid
    )  # fmt: skip
    assert made.note == "heights of the standard atmosphere" and made.kind == "pressure"


def test_geopotential_gives_heights_where_there_is_one():
    heights = np.array([20.0, 180.0, 420.0])
    wind = volume([1000, 980, 950], "level", {"units": "millibars"}, over=heights)
    z = xr.zeros_like(wind) + (heights * 6_356_766 / (6_356_766 + heights) * 9.80665)[:, None, None]
    z.attrs = {"units": "m**2 s**-2"}
    both = xr.Dataset({"t": wind, "z": z})
    found = things(Dataset(both, variable="t", style="curtains", along=ALONG))
    x, y, h = middles(found)
    inside = (h >= 20) & (h <= 420)
    np.testing.assert_allclose(found.values[inside], truth(x, y, h)[inside], atol=2e-2)
    assert "geopotential" in found.legend.note
    # Cut at the ground.
    assert (found.ends[:, 0] >= (x - WEST - 10) / 5 - 1e-6).all()


def test_walls_show_a_volume_on_both_sides_and_in_one_scale():
    made = Dataset(volume([0, 150, 300, 600]), style="walls")
    found = things(made)
    shown = np.isfinite(found.values)
    assert set(found.kind[shown]) == {Kind.PANEL}
    part = sections.Filling(made, hill().grid, lambda x, y: (x - WEST - 10) / 5,
                            sections.middle_lines(hill().grid, 480))  # fmt: skip
    assert shown.sum() == 2 * sum(len(cut.values) for cut in part.cuts)
    # Of the section along the row through the middle the two walls have the same values.
    first = len(part.cuts[0].values)
    np.testing.assert_array_equal(found.values[shown][:first], found.values[shown][first : 2 * first])
    assert len(found.legend.scales) == 1
    with pytest.raises(UsageError, match="one volume"):
        things([made, made])


def test_one_level_is_a_raster_like_any_other():
    made = volume([0, 150, 300], "height")
    found = read(Dataset(made, level="150"), hill().grid)
    x, y = made.x.values[3], made.y.values[4]
    assert found.chosen == "at 150 m" and found.values[0, 4, 3] == pytest.approx(truth(x, y, 150.0), abs=1e-3)
    with pytest.raises(UsageError, match="its levels are: 0, 150, 300"):
        read(Dataset(made, level="200"), hill().grid)
    with pytest.raises(UsageError, match="Choose one level"):
        read(Dataset(made), hill().grid)


def test_members_of_a_volume_have_a_spread():
    base = volume([0, 150, 300])
    many = xr.concat([base - 2, base, base + 2], "member").rio.write_crs(UTM)
    found = things(Dataset(many, style="curtains", along=ALONG, uncertainty="spread"))
    x, y, h = middles(found)
    inside = (h >= 0) & (h <= 300)
    np.testing.assert_allclose(found.values[inside], truth(x, y, h)[inside], atol=1e-3)
    assert next(words for words, _ in found.legend.swatches).startswith("±")


def test_levels_of_a_file(tmp_path):
    """NetCDF as GDAL reads it: levels are parts of its bands."""
    path = tmp_path / "wind.nc"
    lon, lat = np.linspace(-3.2, -2.8, 9), np.linspace(50.7, 50.3, 9)
    values = np.add.outer([10.0, 20.0, 30.0], np.zeros((9, 9))).astype(np.float32)
    made = xr.Dataset(
        {"u": (("level", "latitude", "longitude"), values, {"units": "m s**-1"}),
         "z": (("level", "latitude", "longitude"), values * 98.0665, {"units": "m**2 s**-2"})},
        coords={"level": ("level", np.array([500, 700, 850], np.int32), {"units": "millibars"}),
                "latitude": ("latitude", lat, {"units": "degrees_north"}),
                "longitude": ("longitude", lon, {"units": "degrees_east"})},
    )  # fmt: skip
    made.to_netcdf(path, engine="scipy")
    given = Dataset(str(path), variable="u")
    levels = levels_in(given)
    assert levels is not None and levels.values.tolist() == [500, 700, 850] and levels.axis.kind == "pressure"
    one = read(given.but(level="700"), hill().grid)
    assert one.chosen == "at 700 hPa" and np.nanmax(one.values) == np.nanmin(one.values) == 20
    found = read_volume(given.but(style="curtains"), hill().grid)
    assert [float(np.nanmax(f.values)) for f in found.fields] == [10, 20, 30]
    assert found.heights is not None
    np.testing.assert_allclose([f.values[0, 4, 4] for f in found.heights], [100, 200, 300], rtol=1e-3)


@pytest.mark.parametrize(
    ("source", "change", "words"),
    [
        (lambda: volume([5]), {}, "one level"),
        (lambda: volume([5, 6], "thing"), {}, "no known vertical dimension"),
        (lambda: volume([5, 6]), {"level": "5"}, "all levels"),
        (lambda: volume([5, 6]), {"along": "1:2:3"}, "lon:lat"),
        (lambda: volume([5, 6]), {"along": "9:9:10:10"}, "lies on the terrain"),
        (lambda: volume([5, 6]), {"uncertainty": "spread"}, "members"),
    ],
)
def test_what_is_no_volume_is_refused(source, change, words):
    with pytest.raises((UsageError, ReadError), match=words):
        things(Dataset(source(), style="curtains", **change))


@pytest.mark.parametrize(
    ("name", "about", "kind", "factor"),
    [
        ("plev", {"units": "Pa"}, "pressure", 0.01),
        ("level", {"units": "hPa", "positive": "down"}, "pressure", 1.0),
        ("lev", {"standard_name": "air_pressure", "units": "kPa"}, "pressure", 10.0),
        ("altitude", {"units": "km"}, "height", 1000.0),
        ("z", {"units": "m", "positive": "down"}, "height", -1.0),
        ("h", {"standard_name": "height", "units": "m"}, "above", 1.0),
        ("depth", {}, "depth", 1.0),
        ("soil", {"units": "cm", "positive": "down"}, "depth", 0.01),
        ("month", {}, None, None),
        ("band", {"units": "nm"}, None, None),
    ],
)
def test_what_dimensions_count_follows_from_their_attributes(name, about, kind, factor):
    found = axis_of(name, about)
    assert (found is None) == (kind is None)
    if found is not None:
        assert (found.kind, found.factor) == (kind, factor)
