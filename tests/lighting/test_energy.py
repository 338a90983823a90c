"""Insolation against closed forms without air, textbook values, and brute force over all moments."""

from __future__ import annotations

import datetime
import math

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS, Transformer

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lighting.clearsky import air_mass, beam, diffuse, extraterrestrial, rayleigh
from orograph.lighting.energy import Suns, insolation, period
from orograph.lighting.horizon import horizon
from orograph.lighting.normal import gradient
from orograph.lighting.shade import disc_fraction
from orograph.lighting.sun import position

CELL = 30.0


def grid_at(latitude: float, rows: int = 9, cols: int = 9) -> Grid:
    crs = CRS(f"+proj=tmerc +lat_0={latitude} +lon_0=7 +datum=WGS84 +units=m")
    return Grid((rows, cols), Affine(CELL, 0, -cols * CELL / 2, 0, -CELL, rows * CELL / 2), crs)


def level_day(latitude: float, declination: float, normal: float) -> float:
    """Wh/m² on a level plane outside the atmosphere (Duffie & Beckman, eq. 1.10.3)."""
    p, d = math.radians(latitude), math.radians(declination)
    w = math.acos(min(max(-math.tan(p) * math.tan(d), -1.0), 1.0))
    return 24 / math.pi * normal * (math.cos(p) * math.cos(d) * math.sin(w) + w * math.sin(p) * math.sin(d))


@pytest.mark.parametrize(
    ("latitude", "date"), [(0, "2026-03-20"), (43, "2026-04-15"), (43, "2026-12-21"), (65, "2026-06-21")]
)
def test_a_level_plane_without_air(latitude, date):
    noon = datetime.datetime.fromisoformat(f"{date}T11:32Z")
    declination = position(noon, 7.0, latitude, refraction=False)[1] + latitude - 90.0
    got = insolation(np.zeros((9, 9), np.float32), grid_at(latitude), date, turbidity=0, step=2)[:, 4, 4]
    assert got[1] == 0 and got[2] == got[0]
    # Refraction lifts the sun, a little: some minutes of day more.
    assert got[0] == pytest.approx(level_day(latitude, declination, extraterrestrial(noon)), rel=0.006, abs=40)


def test_the_textbook_day():
    """Duffie & Beckman, example 1.10.1: 43° N, 15 April: 33.8 MJ/m² (with their coarser declination, no refraction)."""
    got = insolation(np.zeros((9, 9), np.float32), grid_at(43.0), "2026-04-15", turbidity=0)[0, 4, 4]
    assert got * 3600 / 1e6 == pytest.approx(33.8, rel=0.015)


def test_a_plane_inclined_to_the_equator_is_a_level_one_further_south():
    """At the equinox a plane tilted south by its latitude receives what the equator does: G · 24 / π."""
    rows = cols = 61
    y = -np.arange(rows)[:, None] * CELL * math.tan(math.radians(40.0)) * np.ones((1, cols))
    got = insolation(y.astype(np.float32), grid_at(40.0, rows, cols), "2026-03-20", turbidity=0, azimuths=128, step=2)
    normal = extraterrestrial(datetime.datetime(2026, 3, 20))
    assert got[0, 30, 30] == pytest.approx(normal * 24 / math.pi, rel=0.006)


def test_the_clear_sky_of_the_atlas():
    """Rayleigh's optical thickness as Kasten 1996 gives it; air masses of Kasten & Young 1989's table."""
    assert 1 / rayleigh(1.0) == pytest.approx(8.2673, abs=1e-3)
    assert rayleigh(20.0) == pytest.approx(1 / (10.4 + 0.718 * 20), rel=0.01)  # the two pieces meet
    for altitude, mass in ((90, 0.9997), (30, 1.9943), (10, 5.5841), (5, 10.3164), (0, 37.9196)):
        assert air_mass(altitude, 0.0) == pytest.approx(mass, rel=0.005)
    assert air_mass(90.0, 5500.0) == pytest.approx(0.52, abs=0.01)  # half of the air lies below
    assert beam(1367.0, 90.0, 0.0, 3.0) == pytest.approx(1367.0 * math.exp(-0.8662 * 3.0 / 8.2673), rel=1e-3)
    assert beam(1367.0, 40.0, 3000.0, 3.0) > beam(1367.0, 40.0, 0.0, 3.0) > beam(1367.0, 40.0, 0.0, 5.0)
    assert diffuse(1367.0, 40.0, 5.0) > diffuse(1367.0, 40.0, 2.0) > 0 == diffuse(1367.0, -1.0, 3.0)
    assert 60 < diffuse(1367.0, 60.0, 3.0) < 130


def test_against_every_moment_by_itself():
    """The tables against the sum over all suns, each with its own horizon, on rough ground with all effects."""
    rng = np.random.default_rng(2)
    rows, cols = 40, 50
    h = rng.normal(size=(rows, cols)).cumsum(0).cumsum(1)
    h = (h / np.ptp(h) * 700 + 900).astype(np.float32)
    h[10:12, 20] = np.nan
    grid = grid_at(46.0, rows, cols)
    linear = np.diag([CELL, -CELL])
    gx, gy = gradient(h, linear)
    suns = Suns.over(grid, "2026-03-01", step=20)
    truth = np.zeros(h.shape)
    for azimuth, altitude, normal in zip(suns.azimuth, suns.altitude, suns.normal):
        seen = disc_fraction(np.degrees(np.arctan(horizon(h, linear, azimuth))), altitude, 0.53)
        a, e = math.radians(azimuth), math.radians(altitude)
        s = math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)
        cosine = np.maximum((s[2] - gx * s[0] - gy * s[1]) / np.sqrt(1 + gx**2 + gy**2), 0.0)
        truth += seen * cosine * beam(normal, altitude, h, 3.0) * suns.hours
    inner = np.s_[1:-1, 1:-1]
    worst = []
    for azimuths in (32, 128):
        got = insolation(h, grid, "2026-03-01", azimuths=azimuths, step=20)
        assert (np.isnan(got) == np.isnan(h)).all()
        d = (got[0] - truth)[inner]
        worst.append(np.nanmean(np.abs(d)) / np.nanmean(truth))
        np.testing.assert_array_equal(got[2], got[0] + got[1])
    assert np.ptp(truth[inner][np.isfinite(truth[inner])]) > 1000
    # A sun each 20 minutes, seen or not: the difference of two quadratures, without a bias.
    assert worst[1] < 0.015 and worst[0] < 0.025
    assert abs(np.nanmean(d)) < 0.006 * np.nanmean(truth)


def test_the_sky_is_uniform():
    """In the middle of a flat floor below walls all around: diffuse is the sky's times cos² of their height."""
    n = 81
    y, x = np.mgrid[:n, :n] - n // 2
    r = np.hypot(x, y)
    h = np.where(r > 30, 2000.0, 0.0).astype(np.float32)
    grid = grid_at(46.0, n, n)
    pit = insolation(h, grid, "2026-06-21", azimuths=64)[1, n // 2, n // 2]
    open_ground = insolation(np.zeros_like(h), grid, "2026-06-21", azimuths=64)[1, n // 2, n // 2]
    angle = math.atan(2000.0 / (30.6 * CELL))
    assert pit / open_ground == pytest.approx(math.cos(angle) ** 2, rel=0.03)
    assert 500 < open_ground < 2000


def test_periods():
    assert period("2024") == (datetime.datetime(2024, 1, 1), datetime.datetime(2025, 1, 1))
    assert period("2024-02")[1] == datetime.datetime(2024, 3, 1)
    assert period("2024-12")[1] == datetime.datetime(2025, 1, 1)
    assert period("2024-02-29")[1] - period("2024-02-29")[0] == datetime.timedelta(days=1)
    for text in ("", "24", "2024-13", "2023-02-29", "2024-1-1", "summer"):
        with pytest.raises(UsageError):
            period(text)


def test_a_year_is_its_days():
    flat, grid = np.zeros((3, 3), np.float32), grid_at(46.0, 3, 3)
    month = insolation(flat, grid, "2026-02", azimuths=4, step=30)
    days = sum(insolation(flat, grid, f"2026-02-{d:02}", azimuths=4, step=30) for d in range(1, 29))
    np.testing.assert_allclose(month, days, rtol=1e-4)
    night = insolation(flat, grid_at(75.0, 3, 3), "2026-12-21", azimuths=4)
    np.testing.assert_array_equal(night, 0)


def test_what_cannot_be():
    flat = np.zeros((3, 3), np.float32)
    for how in ({"date": "now"}, {"date": "2026", "step": 0}, {"date": "2026", "turbidity": -1}):
        with pytest.raises(UsageError):
            insolation(flat, grid_at(46.0, 3, 3), **how)
    with pytest.raises(UsageError, match="where on Earth"):
        insolation(flat, Grid((3, 3), Affine(1, 0, 0, 0, -1, 0)), "2026")


@pytest.mark.cases(1)
@pytest.mark.parametrize("latitude", [-89.0, -45.0, 0.0, 30.0, 60.0])
def test_no_ground_gets_more_than_codes_can_say(latitude):
    """8-bit files and stores would clip it: without air, in the best month, on planes of all kinds."""
    from orograph.lighting.context import Options
    from orograph.lighting.products import product

    grid = Grid((9, 9), Affine(CELL, 0, -4 * CELL, 0, -CELL, 4 * CELL), CRS.from_proj4(f"+proj=laea +lat_0={latitude}"))
    row, col = np.mgrid[:9, :9] * CELL
    for date in ("2026-12-21", "2026-06-21", "2026-12", "2026"):
        _, most = product("insolation").described(Options(more={"date": date}))[2].byte
        for east, north in ((0, 0), (0, 0.3), (0, -1), (0, 1), (0.5, 0.5), (0, math.tan(math.radians(latitude)))):
            z = np.clip(east * col - north * row, -5e4, 5e4).astype(np.float32)
            got = insolation(z, grid, date, step=30.0, turbidity=0.0, azimuths=8)[2, 4, 4]
            assert got < most, (date, east, north)
            if (east, north, latitude, date) == (0, 0, -89.0, "2026-12-21"):
                assert got > 0.95 * 13_500


@pytest.mark.parametrize("lon_0", [9.0, -40.0, 100.0])
def test_suns_count_from_the_grids_own_north(lon_0):
    """The same slope in a polar projection, where the pole is what true north is towards: the energy is the slope's."""
    fall, tilt = math.radians(110.0), math.tan(math.radians(30.0))  # towards the winter's morning sun
    got = []
    for crs in ("+proj=tmerc +lat_0=47 +lon_0=9", f"+proj=stere +lat_0=90 +lat_ts=47 +lon_0={lon_0}"):
        x, y = Transformer.from_crs(4326, crs, always_xy=True).transform(9.0, 47.0)
        north = 0.0 if "tmerc" in crs else math.atan2(-x, -y)
        grid = Grid((9, 9), Affine(CELL, 0, x - 4.5 * CELL, 0, -CELL, y + 4.5 * CELL), CRS.from_user_input(crs))
        row, col = np.mgrid[:9, :9] * CELL
        plane = -tilt * (math.sin(fall + north) * col - math.cos(fall + north) * row)
        got.append(insolation(plane.astype(np.float32), grid, "2026-12-21", turbidity=0.0, azimuths=64)[0, 4, 4])
    assert got[1] == pytest.approx(got[0], rel=0.004) and got[0] > 3000
    west = insolation(-plane.astype(np.float32), grid, "2026-12-21", turbidity=0.0)[0, 4, 4]
    assert west < 0.5 * got[0]  # the direction matters


def test_insolation_says_what_it_lacks_on_the_moon():
    moon = Grid((4, 4), Affine(CELL, 0, 0, 0, -CELL, 0), CRS.from_user_input("+proj=eqc +R=1737400"))
    with pytest.raises(UsageError, match="not on the Earth") as told:
        insolation(np.zeros((4, 4), np.float32), moon, "2026")
    assert "azimuth,altitude" not in str(told.value)
