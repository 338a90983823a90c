"""Another time or priority of data: what was read is not read again, unless it has changed."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio.io
from rasterio.transform import from_bounds

from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.shared import Kept
from orograph.geovis.placement import Lattice
from orograph.scene import theming
from orograph.store.prepare import prepare
from orograph.viewer import settings as settings_module
from orograph.viewer.settings import Settings

TIMES = [f"2019-03-01T{hour:02d}:00" for hour in range(0, 24, 6)]
WEST, SOUTH, EAST, NORTH = 13.5, 44.7, 14.5, 45.4
"""Degrees around the test terrain."""


@pytest.fixture(scope="module")
def terrain(dem: Any) -> Any:
    return prepare([str(dem)])


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Data are painted with few texels."""
    monkeypatch.setattr(theming, "LEAST", 64)
    monkeypatch.setattr(settings_module, "PAINTED", (60, 40))
    monkeypatch.setattr(settings_module, "PLAYED", (45, 30))


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What is read of rasters, and what is reprojected, from now on."""
    told: list[Any] = []
    read, over = rasterio.io.DatasetReader.read, Lattice.over.__func__  # type: ignore[attr-defined]

    def reading(self: Any, *args: Any, **named: Any) -> Any:
        if "out_shape" in named:  # (others are of coordinates)
            told.append(args[0])
        return read(self, *args, **named)

    def reprojecting(cls: Any, placement: Any) -> Any:
        told.append((placement.grid, placement.image))
        return over(cls, placement)

    monkeypatch.setattr(rasterio.io.DatasetReader, "read", reading)
    monkeypatch.setattr(Lattice, "over", classmethod(reprojecting))
    return told


def bands_of(reads: list[Any]) -> list[int]:
    return [one for one in reads if isinstance(one, int)]


def values(*shape: int) -> np.ndarray:
    return np.random.default_rng(2).normal(10, 1, shape).astype(np.float32)


@pytest.fixture
def series(tmp_path: Any) -> str:
    """Four times as NetCDF, in degrees."""
    xarray = pytest.importorskip("xarray")
    lat, lon = np.linspace(NORTH, SOUTH, 8), np.linspace(WEST, EAST, 10)
    times = np.array([f"{one}:00" for one in TIMES], "M8[ns]")
    array = xarray.DataArray(
        values(4, 8, 10), dims=("time", "lat", "lon"), coords={"time": times, "lat": lat, "lon": lon}, name="t",
        attrs={"units": "degC", "long_name": "Temperature"},
    )  # fmt: skip
    array.lat.attrs["units"], array.lon.attrs["units"] = "degrees_north", "degrees_east"
    path = tmp_path / "series.nc"
    array.to_dataset().to_netcdf(path, engine="scipy")
    return str(path)


@pytest.fixture
def members(tmp_path: Any) -> str:
    """Five members as GeoTIFF, in degrees."""
    path = tmp_path / "members.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=10, height=8, count=5, dtype="float32", crs="EPSG:4326",
        transform=from_bounds(WEST, SOUTH, EAST, NORTH, 10, 8),
    ) as file:  # fmt: skip
        file.write(values(5, 8, 10))
    return str(path)


def test_priorities_probabilities_and_members_read_nothing_again(terrain, members, reads):
    settings = Settings(terrain, data=Dataset(members, uncertainty=Uncertainty("spread")), priority="T+D+U+")
    assert sorted(bands_of(reads)) == [1, 2, 3, 4, 5]
    for marks in ("T-D+U+", "T-D-U-", "T+D-U+"):
        settings.show(terrain, priority=Priority.parse(marks))
    settings.shown.exceeds = 10.0
    settings.show(terrain)
    settings.shown.exceeds, settings.shown.turns.on = None, True
    settings.show(terrain)
    settings.shown.turns.advance(1.0)
    settings.show(terrain)
    assert len(bands_of(reads)) == 5
    places = [one for one in reads if isinstance(one, tuple)]
    assert len(places) == len(set(places))  # (the image is smaller while members take turns)


def test_a_time_is_read_once_however_often_it_is_shown(terrain, series, reads):
    settings = Settings(terrain, data=Dataset(series, time="T06"), priority="T+D+U-")
    settings.show(terrain, time=TIMES[2])
    assert sorted(bands_of(reads)) == [1, 2, 3, 4]  # (the scale is that of all times)
    done = len(reads)
    for time in (*TIMES, "2019-03-01T03:00", "2019-03-01T14:20", ""):
        settings.show(terrain, time=time)
    assert len(reads) == done
    # The picture is that of a window that is opened anew.
    settings.show(terrain, time="2019-03-01T14:20")
    fresh = Settings(terrain, data=Dataset(series, time="T06"), priority="T+D+U-")
    fresh.show(terrain, time="2019-03-01T14:20")
    for one, other in zip(settings.shown.painted, fresh.shown.painted, strict=True):
        np.testing.assert_array_equal(one.values, other.values)


def test_the_old_picture_stays_until_the_new_one_is_made(terrain, series):
    settings = Settings(terrain, data=Dataset(series, time="T06"), priority="T+D+U-")
    before, layers = settings.shown.painted, tuple(settings.layers)
    ready = threading.Event()
    Path(series).rename(series + ".gone")
    settings.show(terrain, time=TIMES[3], finer=ready.set)
    with pytest.raises(Exception, match="series"):
        assert ready.wait(300) and settings.finish()
    assert settings.shown.painted is before and tuple(settings.layers) == layers and settings.shown.time == ""


def test_what_has_changed_is_read_again(terrain, members, reads):
    settings = Settings(terrain, data=Dataset(members), priority="T+D+U-")
    first, done = settings.shown.painted[0].values.copy(), len(reads)
    with rasterio.open(members, "r+") as file:
        file.write(values(5, 8, 10) + 5)
    os.utime(members, ns=(1, 1))
    settings.show(terrain, priority=Priority.parse("T-D+U-"))
    assert len(reads) > done
    np.testing.assert_allclose(settings.shown.painted[0].values, first + 5, atol=1e-4)


def test_only_the_last_used_is_kept():
    kept = Kept(most=4000)
    made: list[str] = []

    def thing(name: str, size: int = 1000) -> Any:
        return kept(name, None, lambda: (made.append(name), np.zeros(size, np.uint8))[1])

    for name in "abcdabea":
        thing(name)
    assert made == list("abcde")  # (the fifth takes the place of c)
    thing("c")
    assert made == list("abcdec")
    for _ in range(2):
        thing("large", 1001)
    assert made[-2:] == ["large", "large"] and thing("a") is thing("a")
