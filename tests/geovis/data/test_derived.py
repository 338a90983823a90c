"""Statistics of members and probabilities of exceeding: NumPy's and SciPy's numbers, legends, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.derived import read_data
from orograph.geovis.data.reading import read
from orograph.geovis.data.statistics import exceedance, statistic
from orograph.scene.theming import themed


def members(shape=(9, 7, 8), seed=0, holes=True):
    values = np.random.default_rng(seed).normal(10, 4, shape).astype(np.float32)
    if holes:
        values[:, 2, 3] = np.nan
        values[1:, 4, 4] = np.nan
        values[3:4, 5, 1] = np.nan
    return values


@pytest.fixture(scope="module")
def ground():
    return orograph.terrain(np.zeros((71, 81), np.float32), spacing=10.0)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_statistics_are_those_of_numpy():
    values = members()
    wide = values.astype(float)
    for text, expected in {
        "median": np.nanmedian(wide, 0), "min": np.nanmin(wide, 0), "max": np.nanmax(wide, 0),
        "p90": np.nanpercentile(wide, 90, axis=0), "p2.5": np.nanpercentile(wide, 2.5, axis=0),
        "mean": np.nanmean(wide, 0),
    }.items():  # fmt: skip
        np.testing.assert_allclose(statistic(values, text), expected, rtol=1e-6, err_msg=text)
    spread = statistic(values, "spread")
    assert np.isnan(spread[4, 4]) and np.isnan(spread[2, 3])  # one member, none
    np.testing.assert_allclose(spread[5, 1], np.nanstd(wide[:, 5, 1], ddof=1), rtol=1e-6)
    np.testing.assert_allclose(spread[0, 0], wide[:, 0, 0].std(ddof=1), rtol=1e-6)


def test_a_probability_counts_known_members():
    values = members()
    found = exceedance(values, 12.0)
    assert found[0, 0] == np.float32((values[:, 0, 0] > 12).mean())
    assert np.isnan(found[2, 3]) and found[4, 4] == (values[0, 4, 4] > 12)
    assert found[5, 1] == np.float32((np.delete(values[:, 5, 1], 3) > 12).mean())
    assert not exceedance(np.full((3, 1, 1), 5.0, np.float32), 5.0).any()  # not above itself


@pytest.mark.parametrize("style", [None, "continuous", "isobands", "bars", "hatching", "cells"])
def test_what_is_shown_says_what_it_is(ground, style):
    made = Dataset(members(holes=False), exceeds=12.0, unit="°C", name="Temperature", style=style)
    found = themed({"data": made, "priority": "T+D-U-"}, ground, (300, 200))
    if found.things is not None:
        scale = found.things.legend.scales[0]
        assert found.things.values.max() <= 1
    else:
        (one,) = found.painted
        assert one.title == "P(Temperature > 12 °C)" and one.unit == "" and "part of 9" in one.note
        assert one.scale.edges is None or one.scale.edges == pytest.approx((0, 0.2, 0.4, 0.6, 0.8, 1.0))
        scale = found.options["layers"][-1].key.scales[0]
    assert (scale.low, scale.high, scale.words) == (0.0, 1.0, "P(Temperature > 12 °C)")


def test_a_quantile_is_drawn_with_its_name_and_the_spread_of_members(ground):
    values = members(holes=False)
    made = Dataset(values, value="p90", unit="K", name="Theta", uncertainty="spread")
    (one,) = themed({"data": made, "priority": "T+D+U-"}, ground, (300, 200)).painted
    assert one.title == "Theta, p90" and one.unit == "K" and one.sign == "noise"
    field = read_data(made, ground.grid)
    np.testing.assert_allclose(field.shown, np.percentile(values.astype(float), 90, axis=0), rtol=1e-6)
    np.testing.assert_allclose(field.uncertainty("spread"), values.std(0, ddof=1), rtol=1e-5)


def test_standard_deviations_make_a_probability_by_the_normal_law(ground):
    values, sigma = members((1, 14, 16), holes=False)[0], np.full((7, 8), 2.0, np.float32)
    made = Dataset(values, exceeds=12.0, uncertainty=Uncertainty(sigma))
    found = read_data(made, ground.grid)
    np.testing.assert_allclose(found.values[0], stats.norm.sf((12 - values.astype(float)) / 2), atol=1e-6)
    (one,) = themed({"data": made}, ground, (300, 200)).painted
    assert one.sign == "none" and "normal law" in one.note
    certain = read_data(made.but(uncertainty=Uncertainty(0 * sigma)), ground.grid)
    np.testing.assert_array_equal(certain.values[0], values > 12)
    with pytest.raises(ReadError, match="cannot be negative"):
        read_data(made.but(uncertainty=Uncertainty(-sigma)), ground.grid)


def test_the_command_line_says_the_same():
    assert Dataset.parse("a.nc,value=p90,member=all") == Dataset("a.nc", value="p90", member="all")
    assert Dataset.parse("a.nc,exceeds=-2.5").exceeds == -2.5


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda g: Dataset("a.nc", value="p101"), "p90"),
        (lambda g: Dataset("a.nc", value="mode"), "median, min, max"),
        (lambda g: Dataset("a.nc", value="mean", exceeds=3.0), "one of the two"),
        (lambda g: Dataset("a.nc", exceeds=float("nan")), "must be a number"),
        (lambda g: read_data(Dataset(members((1, 7, 8)), value="p90"), g.grid), "has one"),
        (lambda g: read_data(Dataset(members((1, 7, 8)), exceeds=3.0), g.grid), "`uncertainty`"),
        (lambda g: themed({"data": Dataset(members(), exceeds=3.0, uncertainty="spread")}, g, (9, 9)), "no spread"),
        (lambda g: themed({"data": Dataset(members(), value="p90", style="lic", band="1+2")}, g, (9, 9)), "components"),
        (lambda g: themed({"data": Dataset({"x": [1.0], "y": [-1.0], "v": [1.0]}, value="p90")}, g, (9, 9)), "rasters"),
    ],
)
def test_what_makes_no_sense_is_refused(ground, call, says):
    with pytest.raises(UsageError) as told:
        call(ground)
    assert says in f"{told.value.what} {told.value.remedy}"


def test_a_single_time_is_what_it_is_in_the_window(ground):
    xarray = pytest.importorskip("xarray")
    from orograph.geovis.data.priority import Priority
    from orograph.viewer.data import ShownData

    times = np.array(["2019-03-01T12", "2019-03-02T12", "2019-03-03T12"], "M8[ns]")
    y, x = 660.0 - np.arange(7) * 100.0, np.arange(8) * 100.0 + 50
    array = xarray.DataArray(members((3, 7, 8), holes=False), dims=("time", "y", "x"),
                             coords={"time": times, "y": y, "x": x}, name="t")  # fmt: skip
    shown = ShownData((Dataset(array, exceeds=12.0),), Priority())
    assert shown.current(ground)[0].exceeds == 12.0
    shown.choose("2019-03-02T12:00")
    (one,) = shown.current(ground)
    assert one.exceeds is None and one.range is not None
    np.testing.assert_array_equal(read(one, ground.grid).mean, array.values[1])
