"""``orograph.difference`` against NumPy, analytic surfaces and a published difference."""

from __future__ import annotations

import json
import math
import warnings
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.errors import UsageError
from orograph.measuring import differing
from orograph.measuring.order import HALF, floats, ordered, quantiles, upper_counts
from orograph.verbs.difference import Difference

UTM = "EPSG:32611"


def raster(heights: Any, place: Affine, crs: Any = UTM, **more: Any) -> orograph.Dem:
    heights = np.asarray(heights, np.float32)
    return orograph.Dem(heights, orograph.Grid(heights.shape, place, crs), **more)


@pytest.fixture(scope="module")
def pair():
    """Two rough surfaces on one lattice, the second a part of it, both with holes."""
    rng = np.random.default_rng(5)
    place = Affine(30, 0, 500_000, 0, -40, 4_000_000)
    first = 500 + rng.normal(0, 3, (70, 90)).astype(np.float32)
    second = 500 + rng.normal(0.5, 2, (50, 95)).astype(np.float32)
    first[5:20, 30:35], second[:8, 40:60] = np.nan, np.nan
    moved = Affine(30, 0, 500_000 + 20 * 30, 0, -40, 4_000_000 - 10 * 40)
    return raster(first, place, name="first"), raster(second, moved, name="second")


def plain(pair: Any) -> np.ndarray:
    return pair[0].heights[10:60, 20:90] - pair[1].heights[:, :70]


def test_aligned_rasters_against_numpy(pair):
    found = orograph.difference(*pair, quantiles=(0.1, 0.5, 0.83))
    d = plain(pair)
    assert np.array_equal(found.values, d, equal_nan=True)
    assert found.grid.bounds() == (500_600, 3_997_600, 502_700, 3_999_600)
    x, told = d[~np.isnan(d)].astype(np.float64), found.statistics
    assert (told.count, told.missing) == (x.size, d.size - x.size)
    assert told.median == np.median(x) and (told.low, told.high) == (x.min(), x.max())
    assert told.mean == pytest.approx(x.mean(), abs=1e-12) and told.std == pytest.approx(x.std())
    assert told.rms == pytest.approx(math.sqrt((x * x).mean()))
    assert told.nmad == pytest.approx(1.4826 * np.median(np.abs(x - np.median(x))), rel=1e-6)
    assert [q for q, _ in told.quantiles] == [0.1, 0.5, 0.83]
    assert [v for _, v in told.quantiles] == pytest.approx(np.quantile(x, [0.1, 0.5, 0.83]), rel=1e-12)
    # UTM's scale is 0.9996 on its central meridian, which is here.
    assert told.gain == pytest.approx(x[x > 0].sum() * 1200 / 0.9996**2, rel=1e-6)
    assert told.loss == pytest.approx(-x[x < 0].sum() * 1200 / 0.9996**2, rel=1e-6)
    assert told.area == pytest.approx(x.size * 1200 / 0.9996**2, rel=1e-6)
    assert told.net == told.gain - told.loss and told.gain_area + told.loss_area == pytest.approx(told.area)


def test_blocks_and_threads_make_no_difference(pair, monkeypatch):
    whole = orograph.difference(*pair, jobs=1)
    monkeypatch.setattr(differing, "BLOCK", 17)
    one, many = (orograph.difference(*pair, jobs=jobs) for jobs in (1, 3))
    assert np.array_equal(one.values, whole.values, equal_nan=True)
    assert one.statistics == many.statistics
    exact = ("median", "nmad", "low", "high", "quantiles", "count", "missing")
    assert all(getattr(one.statistics, k) == getattr(whole.statistics, k) for k in exact)
    # (beyond half of the memory it lies in a scratch file)
    assert orograph.difference(*pair, max_memory=20_000).statistics == many.statistics


@pytest.mark.parametrize("onto", ["first", "second", "finer"])
def test_planes_on_two_lattices(onto):
    """Bilinear interpolation keeps planes, whatever the cells and turns of the grids."""
    turned = Affine(20, 7, 500_000, 5, -28, 4_000_000)
    straight = Affine(45, 0, 499_000, 0, -35, 4_001_500)
    made = []
    for place, shape, tilt in ((turned, (60, 50), (0.2, -0.1, 40)), (straight, (120, 90), (0.15, 0.05, 10))):
        grid = orograph.Grid(shape, place, UTM)
        x, y = grid.xy(*np.meshgrid(np.arange(shape[1]), np.arange(shape[0])))
        made.append(raster(tilt[0] * (x - 500_000) + tilt[1] * (y - 4_000_000) + tilt[2], place))
    found = orograph.difference(*made, onto=onto)
    x, y = found.grid.xy(*np.meshgrid(np.arange(found.grid.cols), np.arange(found.grid.rows)))
    inside = ~np.isnan(found.values)
    true = 0.05 * (x - 500_000) - 0.15 * (y - 4_000_000) + 30
    if onto == "second":  # (which is coarser: blocks of the other are averaged, on its rim what there is of them)
        col, row = made[0].grid.index(x, y)
        inside &= (col >= 2) & (row >= 2) & (col <= 47) & (row <= 57)
    assert inside.sum() > 800
    np.testing.assert_allclose(found.values[inside], true[inside], atol=2e-3)
    assert found.grid.spacing == pytest.approx(made[1 if onto == "second" else 0].grid.spacing)


def test_rasters_in_degrees_on_one_lattice(tmp_path):
    """Both are brought to the same metres, so that what is equal stays equal."""
    y, x = np.mgrid[:80, :60]
    heights = (300 + 50 * np.sin(x / 5) * np.cos(y / 9)).astype(np.float32)
    place = Affine(1 / 1200, 0, 10.2, 0, -1 / 1200, 47.5)
    low, high = raster(heights, place, "EPSG:4326"), raster(heights + 4, place, "EPSG:4326")
    found = orograph.difference(high, low)
    assert found.statistics.count > 4000
    assert found.statistics.low == pytest.approx(4, abs=1e-4) and found.statistics.high == pytest.approx(4, abs=1e-4)


def test_the_true_area_of_a_projection_that_stretches():
    """Mercator at 60° N: a cell of the map is four times the ground's."""
    grid = orograph.Grid((40, 40), Affine(100, 0, 1e6, 0, -100, 8_399_737.9 + 2000), "EPSG:3857")
    heights = np.zeros((40, 40), np.float32)
    found = orograph.difference(orograph.Dem(heights + 2, grid), orograph.Dem(heights, grid), progress=False).statistics
    spherical = 40 * 40 * 100 * 100 / 4
    assert found.area == pytest.approx(spherical, rel=0.01) and found.gain == pytest.approx(2 * found.area)


@pytest.mark.parametrize("count", [0, 1, 2, 1001])
def test_exact_quantiles(count):
    rng = np.random.default_rng(count)
    values = (rng.normal(0, 10.0, count) * 10.0 ** rng.integers(-20, 20, count)).astype(np.float32) + np.float32(0)
    values[: count // 3] = values[:1]  # (many are equal)
    assert np.array_equal(floats(ordered(values)), values)
    order = np.argsort(values, kind="stable")
    assert np.array_equal(np.argsort(ordered(values), kind="stable"), order)
    parts = np.array_split(values, 3)
    upper = sum((upper_counts(one) for one in parts), np.zeros(HALF, np.int64))
    wanted = [0, 0.05, 1 / 3, 0.5, 0.99, 1]
    found = quantiles(range(3), lambda k: parts[k], upper, wanted)
    truth = np.quantile(values.astype(np.float64), wanted) if count else [math.nan] * 6
    np.testing.assert_allclose(found, truth, rtol=1e-12)


def test_what_is_given_back(pair, tmp_path):
    found = orograph.difference(*pair, tmp_path / "d.tif")
    assert isinstance(found, Difference) and repr(found).startswith("<Difference 'first minus second': 50 × 70 samples")
    with rasterio.open(tmp_path / "d.tif") as file:
        assert np.array_equal(file.read(1), plain(pair), equal_nan=True) and math.isnan(file.nodata)
        assert file.crs.to_epsg() == 32611 and file.transform == found.grid.transform and file.units == ("m",)
    assert np.array_equal(np.asarray(found), found.values, equal_nan=True)
    array = found.to_xarray()
    assert array.dims == ("y", "x") and float(array.x[0]) == 500_615
    assert found.limit >= max(map(abs, found.statistics.ends)) and float(f"{found.limit:.2g}") == found.limit
    pytest.importorskip("matplotlib").use("Agg")
    assert found.plot().get_clim() == (-found.limit, found.limit)


def test_stores_files_and_arrays(pair, tmp_path):
    d = plain(pair)
    files = [orograph.export(one, tmp_path / f"{one.name}.tif") for one in pair]
    store = orograph.build(pair[0], tmp_path / "first.oro", progress=False)
    for a, b in (
        (store, files[1]),
        (str(store.url), pair[1]),
        (files[0], str(files[1])),
        (orograph.terrain(pair[0]), pair[1]),
    ):
        assert np.array_equal(orograph.difference(a, b, progress=False).values, d, equal_nan=True)
    x = orograph.difference(np.ones((5, 6)), np.zeros((5, 6)), spacing=2, progress=False)
    assert x.statistics.gain == 5 * 6 * 4
    part = orograph.difference(files[0], files[1], bbox=(-116.996, 36.128, -116.98, 36.14), progress=False)
    assert 0 < part.statistics.count < x.values.size * 400


@pytest.mark.stress
def test_a_picture_is_centred_at_zero(tmp_path):
    x = np.mgrid[:80, :100][1]
    place = Affine(30, 0, 500_000, 0, -30, 4_000_000)
    ground = 500 + 40 * np.sin(x / 12)
    after = ground + np.where(x < 30, 5, np.where(x > 70, -5, 0))
    out = tmp_path / "d.png"
    found = orograph.difference(raster(after, place), raster(ground, place), out, limit=5, progress=False)
    picture = found.render(limit=5, size=(400, 320), furniture=False, progress=False)
    red, blue = (picture.pixels[..., k].astype(int) for k in (0, 2))
    middle = picture.pixels.shape[0] // 2
    assert (blue - red)[middle, 70] > 40 and (red - blue)[middle, 330] > 40
    assert abs((blue - red)[middle, 200]) < 25
    assert out.stat().st_size > 10_000


def test_vertical_datums(tmp_path):
    place = Affine(30, 0, 500_000, 0, -30, 4_000_000)
    flat = np.full((20, 30), 100.0)
    sea, ellipsoid, silent = (
        raster(flat, place, vertical=datum, name=name)
        for datum, name in (("EGM96 height", "sea"), ("ellipsoidal height", "gps"), (None, "silent"))
    )
    with pytest.raises(
        UsageError, match="those of gps above ellipsoidal height, so their difference is not a difference"
    ):
        orograph.difference(sea, ellipsoid)
    assert orograph.difference(sea, ellipsoid, any_vertical=True).statistics.mean == 0
    with pytest.warns(UserWarning, match="silent does not say above which datum"):
        orograph.difference(sea, silent)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        orograph.difference(silent, silent)
        orograph.difference(sea, sea)
    grid = Affine(0.25, 0, -180.125, 0, -0.25, 90.125)
    with rasterio.open(
        tmp_path / "egm96.tif", "w", driver="GTiff", width=1440, height=721, count=1, dtype="float32", crs="EPSG:4326",
        transform=grid,
    ) as file:  # fmt: skip
        file.write(np.full((721, 1440), -30, np.float32), 1)
    how = {"to_vertical": "ellipsoidal", "geoid": tmp_path / "egm96.tif"}
    assert orograph.difference(sea, ellipsoid, **how).statistics.mean == -30
    assert orograph.difference(ellipsoid, sea, **how).statistics.mean == 30


def test_units_that_may_be_wrong(pair):
    feet = raster(pair[1].heights / 0.3048, pair[1].grid.transform, name="feet")
    with pytest.warns(
        UserWarning, match=r"The heights of feet are 3\.28 times those of the other: they may be in feet"
    ):
        orograph.difference(pair[0], feet)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = orograph.difference(pair[0].to_xarray(), feet.to_xarray(), vertical_unit="m,ft")
    np.testing.assert_allclose(found.values, orograph.difference(*pair).values, atol=0.01)
    with pytest.raises(UsageError, match="one unit, or two"):
        orograph.difference(pair[0], feet, vertical_unit="m,ft,m")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"onto": "coarser"}, "`onto` must be one of first, second, finer"),
        ({"resampling": "lanczos"}, "The resampling"),
        ({"quantiles": "0.5,2"}, "`quantiles` must be numbers from 0 to 1"),
        ({"output": "d.gpkg"}, "cannot be written as .gpkg"),
        ({"output": ["d.tif", "d"]}, "a file without ending"),
        ({"geoid": "x.gtx"}, "not what to convert to"),
        ({"spaccing": 3}, "no option 'spaccing'"),
    ],
)
def test_what_cannot_be_meant(pair, options, said):
    with pytest.raises(UsageError, match=said):
        orograph.difference(*pair, **options)


def test_two_places(pair):
    place = pair[0].grid.transform
    far = raster(pair[0].heights, Affine(30, 0, 700_000, 0, -40, 4_000_000), name="far")
    with pytest.raises(UsageError, match=r"first and far do not overlap.*Give two rasters of the same place"):
        orograph.difference(pair[0], far)
    with pytest.raises(UsageError, match="nowhere has no CRS but the other has one"):
        orograph.difference(pair[0], raster(pair[0].heights, place, None, name="nowhere"))
    with pytest.raises(UsageError, match="different planets or moons"):
        orograph.difference(pair[0], raster(pair[0].heights, place, "IAU_2015:49910", name="mars"))


def test_the_command_line(pair, tmp_path):
    files = [orograph.export(one, tmp_path / f"{one.name}.tif") for one in pair]
    found = orograph.difference(*files, progress=False)
    args = ["difference", *map(str, files)]
    ran = CliRunner().invoke(cli, [*args, "-o", str(tmp_path / "d.tif"), "--json"], obj={"quiet": True})
    assert ran.exit_code == 0, ran.output
    told = json.loads(ran.stdout)
    assert told["a"] == "first" and told["count"] == found.statistics.count and told["gain_m3"] == found.statistics.gain
    ran = CliRunner().invoke(cli, args, obj={"quiet": True})
    assert (
        ran.stdout.startswith("first minus second\n  3,290 samples")
        and f"NMAD {found.statistics.nmad:.4g} m" in ran.stdout
    )
    ran = CliRunner().invoke(cli, [*args, "-o", str(files[0])], obj={"quiet": True})
    assert ran.exit_code != 0 and "would overwrite A" in str(ran.exception)


def test_a_published_difference(shared_data):
    folder = shared_data / "fortbragg-1m-dem-ortho"
    found = orograph.difference(folder / "elevation_2016.tif", folder / "elevation_2012.tif", progress=False)
    with rasterio.open(folder / "difference_2012_2016.tif") as file:
        assert np.array_equal(found.values, file.read(1), equal_nan=True)
