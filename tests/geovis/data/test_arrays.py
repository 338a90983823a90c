"""Arrays of xarray's and their times: read where the terrain is, decoded, dated by their calendar."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from affine import Affine

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.derived import deviations
from orograph.geovis.data.field import MOST
from orograph.geovis.data.reading import read
from orograph.geovis.data.times import array_times, counted
from orograph.geovis.keys import written_unit

xarray = pytest.importorskip("xarray")

GRID = Grid((40, 60), Affine(500, 0, 480_000, 0, -500, 5_620_000), "EPSG:32630")
LAT, LON = np.linspace(45, 56, 111), np.linspace(-10, 5, 151)


def array(values: Any, **named: Any) -> Any:
    dims = ("member", "lat", "lon")[-values.ndim :]
    return xarray.DataArray(values, dims=dims, coords={"lat": LAT, "lon": LON}, name="t", **named)


def plane() -> np.ndarray:
    return np.add.outer(LAT, LON).astype(np.float32)


def test_only_what_lies_at_the_terrain_is_read():
    dask = pytest.importorskip("dask.array")
    touched = []

    def block(part: np.ndarray) -> np.ndarray:
        touched.append(part.size)
        return part

    lazy = dask.from_array(plane(), chunks=10).map_blocks(block, meta=np.empty((0, 0), np.float32))
    found = read(Dataset(array(lazy)), GRID)
    whole = read(Dataset(array(plane())), GRID)
    assert sum(touched) < plane().size / 10
    np.testing.assert_array_equal(found.values, whole.values)
    lat, lon = (found.grid.xy(*np.meshgrid(*map(np.arange, found.grid.shape[::-1])))[k] for k in (1, 0))
    np.testing.assert_allclose(found.values[0], lat + lon, atol=1e-4)


def test_members_are_chosen_before_they_are_read():
    values = np.stack([plane() + k for k in range(5)])
    found = read(Dataset(array(values), member="2-3"), GRID)
    assert found.values.shape[0] == 2
    np.testing.assert_allclose(found.values[1] - found.values[0], 1, atol=1e-5)


def test_large_arrays_are_averaged(monkeypatch):
    from orograph.geovis.data import field

    whole = read(Dataset(array(plane())), GRID)
    monkeypatch.setattr(field, "MOST", whole.values.size // 4)
    found = read(Dataset(array(plane())), GRID)
    assert field.MOST < MOST and found.values.size <= whole.values.size // 4
    lat, lon = (found.grid.xy(*np.meshgrid(*map(np.arange, found.grid.shape[::-1])))[k] for k in (1, 0))
    np.testing.assert_allclose(found.values[0], lat + lon, atol=1e-4)


def test_numbers_that_nobody_has_decoded_are_decoded():
    raw = np.rint(plane() * 10).astype(np.int16)
    raw[::2] = -999
    packed = array(raw, attrs={"scale_factor": 0.1, "_FillValue": np.int16(-999)})
    bare = plane()
    bare[::2] = -999.0
    for given in (packed, array(bare, attrs={"_FillValue": -999.0})):
        values = read(Dataset(given), GRID).values[0]
        assert np.nanmin(values) > 30 and np.isnan(values).any(1).sum() == np.isnan(values).all(1).sum() > 2


@pytest.mark.parametrize(
    ("start", "days", "calendar", "is_"),
    [
        ("1850-1-1", 59, "noleap", "1850-03-01"),
        ("1852-2-28", 1, "365_day", "1852-03-01"),
        ("1850-01-01 00:00:00", 365 * 150, "noleap", "2000-01-01"),
        ("1900-01-01 00:00:0.0", 43464, "gregorian", "2019-01-01"),
        ("1-1-1", 0, "standard", "0000-12-30"),
        ("1582-10-4", 1, "standard", "1582-10-15"),
        ("1582-10-4", 1, "proleptic_gregorian", "1582-10-05"),
        ("2000-02-28T00:00:00Z", 1, "standard", "2000-02-29"),
        ("1970-01-01 06:00 UTC", 0.25, "standard", "1970-01-01T12:00"),
    ],
)
def test_days_are_counted_in_their_calendar(start, days, calendar, is_):
    assert counted(start, days * 86400.0, calendar) == np.datetime64(is_)


@pytest.mark.parametrize(("start", "calendar"), [("1850-1-1", "360_day"), ("yesterday", "standard")])
def test_what_cannot_be_dated_has_no_time(start, calendar):
    assert counted(start, 0.0, calendar) is None


def dates(calendar: str) -> Any:
    days = [SimpleNamespace(year=2001, month=2, day=day, hour=12, minute=0, calendar=calendar) for day in (27, 28)]
    coordinate = np.empty(2, object)
    coordinate[:] = days
    values = np.stack([plane(), plane() + 1])
    given = xarray.DataArray(values, dims=("time", "lat", "lon"), coords={"lat": LAT, "lon": LON})
    return given.assign_coords(time=("time", coordinate))


def test_dates_of_other_calendars_are_told_or_refused():
    assert array_times(dates("noleap")) == ["2001-02-27T12:00", "2001-02-28T12:00"]
    found = read(Dataset(dates("noleap"), time="2001-02-28"), GRID)
    np.testing.assert_allclose(
        found.values - read(Dataset(dates("noleap"), time="2001-02-27"), GRID).values, 1, atol=1e-5
    )
    with pytest.raises(UsageError, match="calendar 360_day"):
        read(Dataset(dates("360_day"), time="2001-02-28"), GRID)


def test_a_negative_deviation_is_refused_in_words():
    data = Dataset(np.ones((40, 60), np.float32), uncertainty=Uncertainty(np.full((40, 60), -1.0, np.float32)))
    with pytest.raises(ReadError, match=r"^the uncertainty: A standard deviation cannot be negative") as told:
        deviations(data, read(data, GRID), GRID)
    assert len(str(told.value)) < 200


def test_fahrenheit_is_written_as_people_do():
    assert {written_unit(told) for told in ("degF", "fahrenheit", "degrees_fahrenheit")} == {"°F"}


@pytest.mark.parametrize(
    ("unit", "of", "factor"), [("K", "degC", 1), ("degF", "celsius", 5 / 9), ("mm", "cm", 0.1), ("odd", "m", 1)]
)
def test_a_deviation_is_in_the_unit_of_the_data(unit: str, of: str, factor: float):
    doubt = array(0 * plane() + 2, attrs={"units": unit})
    data = Dataset(array(plane(), attrs={"units": of}), uncertainty=Uncertainty(doubt))
    found = deviations(data, read(data, GRID), GRID)
    assert found is not None
    np.testing.assert_allclose(found[1][np.isfinite(found[1])], 2 * factor, rtol=1e-6)


def test_a_deviation_of_another_kind_is_refused():
    data = Dataset(array(plane(), attrs={"units": "m"}), uncertainty=Uncertainty(array(plane(), attrs={"units": "K"})))
    with pytest.raises(ReadError, match="in K cannot be that of data in m"):
        deviations(data, read(data, GRID), GRID)


def test_empty_arrays_are_refused_in_words():
    for empty in (array(np.stack([plane()] * 2))[:0], np.zeros((0, 0))):
        with pytest.raises(UsageError, match="array is empty"):
            read(Dataset(empty), GRID)


def test_a_time_that_is_missing_is_none_of_the_times():
    hours = np.datetime64("2019-03-01T00", "ns") + np.arange(4) * np.timedelta64(6, "h")
    hours[1] = np.datetime64("NaT")
    series = array(np.stack([plane() + i for i in range(4)])).rename(member="time").assign_coords(time=hours)
    assert array_times(series) == ["2019-03-01T00:00", "", "2019-03-01T12:00", "2019-03-01T18:00"]
    between = read(Dataset(series, time="2019-03-01T03:00"), GRID)
    np.testing.assert_allclose(between.values, read(Dataset(plane_at(0.5)), GRID).values, atol=1e-4)
    all_day = read(Dataset(series, time="2019-03-01"), GRID)
    assert all_day.chosen == "mean of 3 from 2019-03-01 00:00 to 2019-03-01 18:00"
    with pytest.raises(UsageError, match=r"go from 2019-03-01T00:00 to 2019-03-01T18:00\. Give an earlier and a later"):
        read(Dataset(series, time="2019-03-02..2019-03-01"), GRID)
    assert counted("1970-01-01", np.nan, "standard") is None and counted("1970-01-01", -9e18, "standard") is None


def plane_at(more: float) -> Any:
    return array(plane() + np.float32(more))
