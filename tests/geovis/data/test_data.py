"""Data and uncertainty: reading, scales, patterns, signs, priorities, against plain computations."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, apply
from orograph.geovis.color import linear_to_srgb
from orograph.geovis.data import patterns, signs
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.painted import painted
from orograph.geovis.data.painting import shown
from orograph.geovis.data.priority import SCENARIOS, Priority
from orograph.geovis.data.reading import read
from orograph.geovis.data.sampling import Positions, bilinear
from orograph.geovis.data.scales import ColorScale, Shared, class_breaks, doubted, suppressed
from orograph.geovis.data.times import matches

UTM = "EPSG:32630"


def terrain_of(rows: int = 40, cols: int = 50, step: float = 100.0):
    heights = np.add.outer(np.arange(rows), np.arange(cols)).astype(np.float32)
    return orograph.terrain(heights, transform=from_origin(500_000, 5_600_000, step, step), crs=UTM)


def written(path, bands, transform, crs=UTM, **more):
    bands = np.asarray(bands, np.float32)
    with rasterio.open(
        path, "w", driver="GTiff", count=len(bands), height=bands.shape[1], width=bands.shape[2], dtype="float32",
        crs=crs, transform=transform, **more,
    ) as file:  # fmt: skip
        file.write(bands)
    return str(path)


@pytest.mark.parametrize("marks", product("+-", repeat=3))
def test_all_eight_priorities_are_read_in_any_order(marks):
    t, d, u = marks
    found = Priority.parse(f"U{u} t{t},D{d}")
    assert (found.terrain, found.data, found.uncertainty) == tuple(m == "+" for m in marks)
    assert Priority.parse(str(found)) == found


@pytest.mark.parametrize("text", ["", "T", "T+T-", "X+", "T+D", "T++"])
def test_what_is_no_priority_is_refused(text):
    with pytest.raises(UsageError, match=r"T\+D-U-"):
        Priority.parse(text)


def test_figure_5_of_the_paper():
    a, b, c = (Priority.parse(text) for text in ("T+D-U-", "T-D+U-", "T-D-U+"))
    assert (a.style, a.sign(a.style)) == ("segmented", "transparency")
    assert (b.style, b.sign(b.style)) == ("continuous", "noise")
    assert (c.style, c.sign(c.style)) == ("segmented", "glyphs")
    assert [Priority.parse(name) for name in ("overview", "approach", "overflight", "replanning")] == [a, a, b, c]
    assert len(SCENARIOS) == 4


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(-100, 100, width=32), min_size=6, max_size=12, unique=True), st.integers(2, 4))
def test_natural_breaks_are_the_best_of_all(values, classes):
    ordered = np.sort(np.array(values, np.float64))

    def cost(cuts):
        return sum(((part - part.mean()) ** 2).sum() for part in np.split(ordered, cuts))

    least = min(cost(cuts) for cuts in combinations(range(1, len(ordered)), classes - 1))
    found = class_breaks(ordered, classes, "jenks", ordered[0] - 1, ordered[-1] + 1)
    cuts = [int(np.searchsorted(ordered, value)) for value in found]
    assert cost(cuts) == pytest.approx(least, rel=1e-6, abs=1e-6)


def test_quantiles_hold_as_many_values_each():
    values = np.random.default_rng(1).gamma(2, size=10_000)
    scale = ColorScale.of(values, "viridis", (0, float(values.max())), 5, "quantiles")
    assert np.ptp(np.bincount(scale.place(values).astype(int))) <= 2


def test_given_breaks_are_kept():
    scale = ColorScale.of(np.linspace(0, 9, 50), "viridis", None, 5, (0.0, 1.0, 5.0, 9.0))
    assert scale.edges == (0.0, 1.0, 5.0, 9.0)
    assert scale.place(np.array([0.5, 1.0, 4.9, 7.0])).tolist() == [0, 1, 1, 2]


def test_bilinear_is_scipys_where_all_is_known():
    from scipy.ndimage import map_coordinates

    rng = np.random.default_rng(2)
    values = rng.normal(size=(7, 9)).astype(np.float32)
    c, r = rng.uniform(0, 8, 500), rng.uniform(0, 6, 500)
    np.testing.assert_allclose(bilinear(values, c, r), map_coordinates(values, [r, c], order=1), atol=1e-5)


def test_bilinear_ends_half_a_sample_outside_and_goes_round():
    values = np.array([[1, 2], [3, 4]], np.float32)
    at = np.array([-0.6, -0.4, 1.4, 1.6])
    assert np.isnan(bilinear(values, at, np.zeros(4))).tolist() == [True, False, False, True]
    round_ = bilinear(np.array([[0, 10, 20, 30]], np.float32), np.array([3.5, -0.5]), np.zeros(2), cyclic=True)
    np.testing.assert_allclose(round_, 15)


def test_members_mean_spread_and_quantiles(tmp_path):
    grid = terrain_of().grid
    bands = np.random.default_rng(3).normal(10, 2, (13, 8, 10)).astype(np.float32)
    bands[4, 2, 3] = np.nan
    bands[:, 5, 5] = np.nan
    path = written(tmp_path / "m.tif", bands, from_origin(500_000, 5_600_000, 500, 500), nodata=float("nan"))
    field = read(Dataset(path, uncertainty="spread"), grid)
    assert field.values.shape == (13, 8, 10)
    np.testing.assert_allclose(field.mean[0, 0], bands[:, 0, 0].mean(), rtol=1e-6)
    np.testing.assert_allclose(field.mean[2, 3], np.nanmean(bands[:, 2, 3]), rtol=1e-6)
    np.testing.assert_allclose(field.uncertainty("spread")[0, 0], bands[:, 0, 0].std(ddof=1), rtol=1e-5)
    low, high = np.quantile(bands[:, 1, 1], [0.05, 0.95])
    np.testing.assert_allclose(field.uncertainty("ci90")[1, 1], (high - low) / 2, rtol=1e-5)
    assert np.isnan(field.uncertainty("spread")[5, 5])
    assert read(Dataset(path, member="2-4"), grid).values.shape[0] == 3
    with pytest.raises(UsageError, match="numbered from 1 to 13"):
        read(Dataset(path, band=14), grid)
    with pytest.raises(UsageError, match="members"):
        read(Dataset(path, band=1), grid).uncertainty("spread")


def test_data_that_lie_elsewhere_or_are_all_missing_are_refused(tmp_path):
    grid = terrain_of().grid
    away = written(tmp_path / "a.tif", np.zeros((1, 5, 5)), from_origin(0, 1000, 100, 100))
    with pytest.raises(ReadError, match="do not overlap"):
        read(Dataset(away), grid)
    gone = written(tmp_path / "n.tif", np.full((1, 5, 5), -9.0), from_origin(500_000, 5_600_000, 1000, 1000), nodata=-9)
    with pytest.raises(ReadError, match="valid"):
        read(Dataset(gone), grid)
    doubt = written(tmp_path / "s.tif", np.full((1, 5, 5), -1.0), from_origin(500_000, 5_600_000, 1000, 1000))
    good = written(tmp_path / "g.tif", np.ones((1, 5, 5)), from_origin(500_000, 5_600_000, 1000, 1000))
    with pytest.raises(ReadError, match="cannot be negative"):
        shown(Dataset(good, uncertainty=doubt), grid, 64, Priority())


def test_times_are_matched_by_their_beginning_or_their_hour():
    assert matches("2019-03-01T12:00", "2019-03-01")
    assert matches("2019-03-01T12:00", "2019-03-01 12")
    assert matches("2019-03-05T12:00", "T12")
    assert not matches("2019-03-05T13:00", "T12")


def test_a_dataarray_gives_the_same_as_its_file(tmp_path):
    xr = pytest.importorskip("xarray")
    grid = terrain_of().grid
    bands = np.random.default_rng(4).normal(size=(3, 8, 10)).astype(np.float32)
    place = from_origin(500_000, 5_600_000, 500, 500)
    path = written(tmp_path / "m.tif", bands, place)
    array = xr.DataArray(
        bands, dims=("member", "y", "x"), name="rain", attrs={"units": "mm", "crs": UTM},
        coords={"x": 500_250 + 500 * np.arange(10), "y": 5_599_750 - 500 * np.arange(8)},
    )  # fmt: skip
    one, other = (read(Dataset(source, uncertainty="spread"), grid) for source in (path, array))
    over = Grid((20, 20), grid.transform, grid.crs)
    found = [Positions.of(over, field).values(field.mean) for field in (one, other)]
    np.testing.assert_allclose(*found, rtol=1e-5)
    assert (other.name, other.unit) == ("rain", "mm")


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_patterns_cover_the_share_they_are_asked_for(share):
    y, x = np.mgrid[:960, :960] + 0.5
    assert patterns.hatched(x, y, 24, np.float64(share)).mean() == pytest.approx(share, abs=0.01)
    assert patterns.dotted(x, y, 24, np.float64(min(share, 0.7))).mean() == pytest.approx(min(share, 0.7), abs=0.01)


def test_a_triangle_has_its_area():
    y, x = np.mgrid[-60:60, -60:60] + 0.5
    area = patterns.covered(patterns.triangle(x, y, np.float64(40))).sum()
    assert area == pytest.approx(3 * np.sqrt(3) / 4 * 40**2, rel=0.01)


def test_noise_is_normal_and_belongs_to_its_place():
    y, x = np.mgrid[:600, :600] + 0.5
    noise = patterns.gauss(x, y, 1)
    assert abs(noise.mean()) < 0.01
    assert noise.std() == pytest.approx(1, abs=0.01)
    assert abs(np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]) < 0.01
    np.testing.assert_array_equal(patterns.gauss(x[100:200, 50:60], y[100:200, 50:60], 1), noise[100:200, 50:60])


def test_a_palette_suppresses_values_level_by_level():
    scale = ColorScale.of(np.linspace(0, 1, 500), "viridis", (0, 1))
    values = np.linspace(0, 1, 500)
    told = [len(np.unique(suppressed(scale, values, np.full(500, u)), axis=0)) for u in (0.1, 0.3, 0.6, 0.9)]
    assert told == [8, 4, 2, 1]


@pytest.mark.parametrize("sign", ["noise", "whiteness", "saturation", "palette"])
def test_what_is_unknown_looks_as_what_is_most_uncertain(tmp_path, sign):
    grid = terrain_of().grid
    place = from_origin(500_000, 5_600_000, 100, 100)
    good = written(tmp_path / "g.tif", np.full((1, 40, 50), 5.0), place, nodata=-9)
    ramp = np.repeat(np.linspace(0, 1, 40), 50).reshape(1, 40, 50)
    ramp[:, :, 25:] = -9
    doubt = written(tmp_path / "s.tif", ramp, place, nodata=-9)

    asked = Uncertainty(doubt, style=sign, range=(0, 1))
    made = Dataset(good, range=(0, 10), style="continuous", uncertainty=asked)
    image = _image(painted(shown(made, grid, 200, Priority())))[0][..., :3].astype(float)
    rows, cols = image.shape[0] // 8, image.shape[1] // 3
    certain, uncertain, unknown = image[:rows, :cols], image[-rows:, :cols], image[:, -cols:]
    if sign == "noise":
        spread = [part.std((0, 1)).max() for part in (certain, uncertain, unknown)]
        assert spread[2] > 0.8 * spread[1] > 2 * spread[0]
    else:
        np.testing.assert_allclose(unknown.mean((0, 1)), uncertain.mean((0, 1)), atol=10)
        assert np.abs(unknown.mean((0, 1)) - certain.mean((0, 1))).max() > 15


@pytest.mark.parametrize("sign", ["whiteness", "saturation"])
def test_intrinsic_signs_fade_what_is_uncertain(sign):
    scale = ColorScale.of(np.linspace(0, 1, 50), "viridis", (0, 1))
    values = np.full(3, 0.2)
    rgb = signs.colored(values, np.array([0.0, 0.5, 1.0]), scale, sign)
    np.testing.assert_array_equal(rgb[0], scale.color(values)[0])
    spread = np.ptp(rgb, axis=1)
    assert spread[0] > spread[1] > spread[2]


def test_a_blur_keeps_what_is_certain_and_missing():
    values = np.zeros((60, 60))
    values[30, 30] = 1
    values[:5] = np.nan
    u = np.zeros((60, 60))
    u[:, 30:] = 1
    found = signs.blurred(values, u, 4.0)
    np.testing.assert_array_equal(found[5:, :30], values[5:, :30])
    assert np.isnan(found[:5]).all()
    assert 0 < found[30, 30] < 0.1


def _image(layer):
    with rasterio.open(layer.path) as file:
        return file.read().transpose(1, 2, 0), file.transform


def test_painted_data_have_the_colours_of_their_values_at_their_places(tmp_path):
    terrain = terrain_of()
    values = np.add.outer(np.arange(8) * 10, np.arange(10)).astype(np.float32)
    path = written(tmp_path / "v.tif", [values], from_origin(501_000, 5_599_500, 200, 200))
    found = shown(Dataset(path, range=(0, 80), style="continuous"), terrain.grid, 500, Priority())
    image, transform = _image(painted(found))
    for row, col in ((0, 0), (3, 4), (7, 9)):
        x, y = 501_000 + 200 * (col + 0.5), 5_599_500 - 200 * (row + 0.5)
        i, j = (int(v) for v in reversed(apply(~transform, x, y)))
        wanted = np.rint(linear_to_srgb(found.scale.color(values[row, col])) * 255)
        assert np.abs(image[i, j, :3].astype(int) - wanted).max() <= 12, (row, col)
        assert image[i, j, 3] == 255
    i, j = (int(v) for v in reversed(apply(~transform, 501_000 - 50, 5_599_000)))
    assert image[i, j, 3] == 0


@pytest.mark.parametrize(
    "sign", ["transparency", "noise", "blur", "saturation", "whiteness", "palette", "glyphs", "hatching"]
)
@pytest.mark.parametrize("style", ["continuous", "segmented", "isolines", "isobands", "cells", "hatching", "stipple"])
def test_every_style_and_sign_tells_the_certain_from_the_uncertain(tmp_path, style, sign):
    terrain = terrain_of()
    place = from_origin(500_000, 5_600_000, 250, 250)
    values = written(tmp_path / "v.tif", [np.linspace(0, 1, 320).reshape(16, 20)], place)
    sigma = np.where(np.arange(20) < 10, 0.01, 1.0) + np.zeros((16, 1))
    doubt = written(tmp_path / "s.tif", [sigma], place)
    dataset = Dataset(values, style=style, uncertainty=Uncertainty(doubt, style=sign))
    bare = Dataset(values, style=style)
    one, two = (_image(painted(shown(d, terrain.grid, 300, Priority())))[0].astype(int) for d in (dataset, bare))
    seen = [np.abs(one[:, part] - two[:, part]).mean() for part in (slice(20, 130), slice(170, 290))]
    assert seen[1] > 1.5 * seen[0], seen
    legend = painted(shown(dataset, terrain.grid, 300, Priority())).key
    assert len(legend.swatches) == 3
    tiles = [tile.astype(int) for _, tile in legend.swatches]
    assert np.abs(tiles[0] - tiles[2]).max() > 5


def test_arrows_point_where_the_wind_goes(tmp_path):
    """Against pyproj's own forward geodesics: a step along the arrow is a step along the wind."""
    from pyproj import Geod, Transformer

    from orograph.geovis.data import vectors

    terrain = orograph.terrain(
        np.zeros((60, 80), np.float32), transform=from_origin(200_000, 6_600_000, 500, 500), crs=UTM
    )
    to_degrees = Transformer.from_crs(UTM, 4326, always_xy=True)
    lon, lat = to_degrees.transform(220_000, 6_585_000)
    place = from_origin(lon - 2, lat + 2, 0.25, 0.25)
    azimuth = 70.0
    u, v = (np.full((16, 16), f(np.radians(azimuth)) * 7) for f in (np.sin, np.cos))
    path = written(tmp_path / "w.tif", [u, v], place, crs="EPSG:4326")
    found = shown(Dataset(path, band="1+2", style="arrows"), terrain.grid, 200, Priority())
    np.testing.assert_allclose(found.values, 7, rtol=1e-5)
    i, j = 70, 110
    x, y = found.over.xy(j, i)
    lon, lat = to_degrees.transform(x, y)
    lon, lat, _ = Geod(ellps="WGS84").fwd(lon, lat, azimuth, 500)
    x1, y1 = Transformer.from_crs(4326, UTM, always_xy=True).transform(lon, lat)
    true = np.array([x1 - x, -(y1 - y)])
    across, down = (part[i, j] for part in found.toward)
    assert np.degrees(np.arccos((across * true[0] + down * true[1]) / np.hypot(*true))) < 0.3
    # An arrow's shape: longer along its way than across, its head in front.
    y, x = np.mgrid[:40, :40] + 0.5
    ones = np.ones((40, 40))
    seen = vectors.arrows(x, y, 40.0, ones, 0 * ones, ones)
    assert np.ptp(np.nonzero(seen)[1]) > 35 and np.ptp(np.nonzero(seen)[0]) < 20
    assert seen[:, 25:].sum(0).max() > 2 * seen[:, 5:15].sum(0).max()
    with pytest.raises(UsageError, match="to the east and to the north"):
        shown(Dataset(path, style="arrows"), terrain.grid, 200, Priority())


def test_a_priority_sets_what_is_left_open_and_no_more():
    from orograph.scene.scene import Scene

    terrain = terrain_of()
    view = orograph.camera.whole(terrain, (200, 150))
    lines = Scene.of(terrain, view, priority="T-D+U-")
    assert lines.lighting.light == "none"
    assert lines.annotations.contours is not None
    assert lines.annotations.silhouettes is not None
    relief = Scene.of(terrain, view, priority="T+D+U-")
    assert relief.lighting.light == "relief"
    assert relief.annotations.contours is None
    own = Scene.of(terrain, view, priority="T-D+U-", colormap="viridis", contours=7.0)
    assert own.data.colormap == "viridis"
    assert own.annotations.contours.interval == 7.0


def test_a_picture_shows_data_and_says_what_they_are(tmp_path):
    terrain = terrain_of()
    place = from_origin(500_000, 5_600_000, 500, 500)
    path = written(tmp_path / "rain.tif", [np.tile(np.linspace(0, 1, 10), (8, 1))], place)
    view = orograph.camera.plan(terrain, (250, 200))
    data = Dataset(path, colormap="viridis", style="continuous", range=(0, 1))
    picture = orograph.render(terrain, view, data=data, light="none", priority="T+D+U+")
    west, east = picture.pixels[100, 30].astype(int), picture.pixels[100, 220].astype(int)
    assert west[2] > west[1]  # viridis: from violet
    assert east[0] > east[2]  # to yellow


@pytest.mark.parametrize(
    ("text", "what"),
    [("a.tif,stile=bars", "Did you mean style"), ("a.tif,style=bar", "Did you mean bars"),
     ("a.tif,classes=1", "2 to 12"),
     ("a.tif,range=3:1", "lower to a higher"), ("a.tif,opacity=2", "0 to 1"), ("a.tif,breaks=5:1", "increasing"),
     ("a.tif,colormap=nix", "no colour map"), ("a.tif,size=-3", "above 0")],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(text, what):
    with pytest.raises(UsageError, match=what):
        Dataset.parse(text)


def test_between_two_times_values_are_linear_and_classes_those_of_the_nearer(tmp_path):
    xr = pytest.importorskip("xarray")
    land = terrain_of()
    x, y = (500_050 + 100.0 * np.arange(50)), (5_599_950 - 100.0 * np.arange(40))
    when = np.array(["2020-01-01T00", "2020-01-01T06", "2020-01-02T00"], "M8[ns]")
    cube = np.array([1.0, 3.0, 9.0])[:, None, None] + np.zeros((1, 40, 50))
    about = {"crs": UTM}
    made = xr.DataArray(cube, coords={"time": when, "y": y, "x": x}, dims=("time", "y", "x"), attrs=about)
    for time, value in (("2020-01-01T03:00", 2.0), ("2020-01-01T15:00", 6.0), ("2020-01-01T06:00", 3.0)):
        found = read(Dataset(made, time=time), land.grid)
        assert found.values.min() == found.values.max() == pytest.approx(value)
    assert (
        "linear between 2020-01-01 06:00 and 2020-01-02 00:00"
        in read(Dataset(made, time="2020-01-01T15:00"), land.grid).chosen
    )
    named = read(Dataset(made, time="2020-01-01T02:59", style="classes"), land.grid)
    assert named.values.max() == 1.0 and "nearest" in named.chosen
    with pytest.raises(UsageError, match="times go from"):
        read(Dataset(made, time="2020-01-02T00:30"), land.grid)
    # An hour of all days is no moment.
    assert read(Dataset(made, time="T06"), land.grid).values.max() == 3.0


def test_a_constant_uncertainty_has_a_scale_from_0_to_itself():
    assert doubted(np.full(9, 0.15)) == (0.0, 0.15)
    assert doubted(np.zeros(9)) == doubted(np.full(9, np.nan)) == (0.0, 1.0)
    values = np.linspace(0, 100, 101)
    assert doubted(values) == (0.0, 98.0)


def test_signs_are_told_by_a_strong_colour_of_a_diverging_scale():
    plain, diverging = (ColorScale.of(np.array([-2.0, 2.0]), name, (-1.0, 1.0)) for name in ("viridis", "RdBu"))
    assert plain.telling == 0.0
    assert np.ptp(diverging.color(np.array([diverging.telling]))) > 0.3 > np.ptp(diverging.color(np.zeros(1)))


@pytest.mark.parametrize(
    ("span", "beyond"),
    [((-1.0, 1.0), (True, True)), ((-3.0, 1.0), (False, True)), ((-3.0, 3.0), (False, False)),
     (Shared((-3.0, 3.0)), (True, True))],
)  # fmt: skip
def test_a_scale_says_where_values_go_beyond_its_ends(span, beyond):
    values = np.array([-2.0, np.nan, 2.0])
    assert ColorScale.of(values, "RdBu", span).exceeded(values, span) == beyond
