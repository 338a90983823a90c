"""The sun against published positions (NREL's SPA, almanacs, Meeus), grid north against PROJ and the series for UTM."""

from __future__ import annotations

import datetime
import math

import click
import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS, Proj

from orograph.cli.scenes import scene_option
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lighting.sun import (
    Moment,
    Placed,
    Sun,
    grid_azimuth,
    parse,
    place,
    position,
    positions,
    refracted,
    sun_of,
)

UTC = datetime.UTC


def utc(*parts: int) -> datetime.datetime:
    return datetime.datetime(*parts, tzinfo=UTC)  # type: ignore[arg-type, misc]


def grid_at(x: float, y: float, crs: str, cell: float = 10.0, size: int = 21) -> Grid:
    half = cell * size / 2
    return Grid((size, size), Affine(cell, 0, x - half, 0, -cell, y + half), CRS(crs))


def test_the_worked_example_of_the_solar_position_algorithm():
    """Reda & Andreas 2004, appendix A.5: azimuth 194.34024°, altitude without refraction 39.872046°."""
    when = datetime.datetime(2003, 10, 17, 12, 30, 30, tzinfo=datetime.timezone(datetime.timedelta(hours=-7)))
    azimuth, geometric = position(when, -105.1786, 39.742476, refraction=False)
    assert azimuth == pytest.approx(194.34024, abs=0.005)
    assert geometric == pytest.approx(39.872046, abs=0.005)
    # Their refraction, 0.016332° at 820 hPa and 11 °C, brought to sea level: · 1010 / 820 · (273 + 11) / 283.
    lift = position(when, -105.1786, 39.742476)[1] - geometric
    assert lift == pytest.approx(0.016332 * 1010 / 820 * 284 / 283, abs=0.001)


@pytest.mark.parametrize(
    ("when", "declination"),
    [
        (utc(2026, 6, 21, 8, 24), 23.436),  # the solstice: the obliquity of the ecliptic
        (utc(2026, 12, 21, 20, 50), -23.436),
        (utc(2026, 3, 20, 14, 46), 0.0),  # the equinox
        (utc(2026, 9, 23, 0, 5), 0.0),
        (utc(1992, 10, 13, 0, 0), -7.78507),  # Meeus, example 25.a (Terrestrial Time, a minute later than UTC)
    ],
)
def test_declination_as_the_altitude_seen_along_the_polar_circle(when, declination):
    """The mean of the sun's altitudes at upper and lower culmination is fixed by the declination."""
    noon = max(position(when, lon, 60.0, refraction=False)[1] for lon in np.arange(-180, 180, 0.25))
    assert noon == pytest.approx(90 - 60 + declination, abs=0.006)


def towards(when: datetime.datetime, lon: float, lat: float) -> np.ndarray:
    """The sun's direction in the Earth's own axes, out of azimuth and altitude at a place."""
    azimuth, altitude = np.radians(position(when, lon, lat, refraction=False))
    x, y = np.radians([lon, lat])
    east = np.array([-np.sin(x), np.cos(x), 0.0])
    north = np.array([-np.sin(y) * np.cos(x), -np.sin(y) * np.sin(x), np.cos(y)])
    up = np.array([np.cos(y) * np.cos(x), np.cos(y) * np.sin(x), np.sin(y)])
    return np.cos(altitude) * (np.sin(azimuth) * east + np.cos(azimuth) * north) + np.sin(altitude) * up


@pytest.mark.parametrize("latitude", [89.0, 89.81, 89.95, 89.9999, 90.0, -89.81, -89.99, -90.0])
def test_near_the_poles_the_sun_is_the_one_that_the_equator_sees(latitude):
    rng = np.random.default_rng(5)
    for lon in (-170.0, -30.0, 0.0, 77.0, 180.0):
        when = utc(2026, 1, 1) + datetime.timedelta(days=float(rng.uniform(0, 365)))
        cosine = float(towards(when, lon, latitude) @ towards(when, 10.0, 0.0))
        assert math.degrees(math.acos(min(cosine, 1.0))) < 0.001
        if abs(latitude) == 90.0:
            declination = math.degrees(math.asin(towards(when, 10.0, 0.0)[2]))
            assert position(when, lon, latitude, refraction=False)[1] == pytest.approx(
                math.copysign(declination, declination * latitude), abs=1e-4
            )


@pytest.mark.parametrize("crs", ["EPSG:3995", "EPSG:3031"])
def test_over_a_grid_on_the_pole_the_sun_stands_above_its_meridian(crs):
    when = utc(2026, 6, 21, 9, 20) if crs == "EPSG:3995" else utc(2026, 12, 21, 9, 20)
    sun = sun_of(when, grid_at(0.0, 0.0, crs))
    x, y, _ = towards(when, 10.0, 0.0)
    ends = Proj(CRS(crs))(math.degrees(math.atan2(y, x)), 80.0 if crs == "EPSG:3995" else -80.0)
    assert sun.azimuth == pytest.approx(math.degrees(math.atan2(*ends)) % 360.0, abs=0.02)


def test_sunrise_and_sunset_of_the_almanac():
    """Greenwich, 21 June 2026: the upper limb on the horizon at 03:43 and 20:21 UTC (HM Nautical Almanac Office)."""
    for when in (utc(2026, 6, 21, 3, 43), utc(2026, 6, 21, 20, 21)):  # to the minute: 0.11° of altitude
        assert position(when, 0.0, 51.4779, refraction=False)[1] == pytest.approx(-0.833, abs=0.06)
        assert position(when, 0.0, 51.4779)[1] == pytest.approx(-0.265, abs=0.1)


def test_refraction_of_the_tables():
    """Mean refraction by apparent altitude (Allen, *Astrophysical Quantities*): 34.5′ at 0°, 5.3′ at 10°, 1′ at 45°."""
    for geometric, minutes in ((-0.575, 34.5), (10 - 5.3 / 60, 5.3), (45 - 1 / 60, 1.0)):
        assert refracted(geometric) * 60 == pytest.approx(minutes, rel=0.04)
    assert refracted(90.0) == 0.0
    lifted = [h + refracted(h) for h in np.arange(-10, 90, 0.01)]
    assert (np.diff(lifted) > 0).all()


def test_the_zone_is_part_of_the_time_and_longitudes_wrap():
    here = datetime.datetime(2026, 6, 21, 14, 0, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
    assert position(here, 10.0, 46.0) == position(utc(2026, 6, 21, 12, 0), 10.0, 46.0)
    assert position(here, 190.0, 46.0) == pytest.approx(position(here, -170.0, 46.0))
    whole, fraction = utc(2026, 6, 21, 12, 0, 1), utc(2026, 6, 21, 12, 0, 0) + datetime.timedelta(milliseconds=999)
    assert position(whole, 10.0, 46.0) == pytest.approx(position(fraction, 10.0, 46.0), abs=2e-5)


def test_many_moments_at_once():
    times = [utc(2026, 5, 1, h) for h in range(24)]
    table = positions(times, 7.0, 46.0)
    assert table.shape == (24, 3)
    for row, when in zip(table, times, strict=True):
        assert tuple(row[:2]) == position(when, 7.0, 46.0)
    assert (table[:, 1] >= table[:, 2]).all()
    assert positions([], 7.0, 46.0).shape == (0, 3)


@pytest.mark.parametrize("easting", [250_000.0, 400_000.0, 500_000.0, 730_000.0])
def test_grid_north_in_utm(easting):
    """Convergence by the series tan γ = tan Δλ · sin φ (exact on the sphere), and PROJ's own."""
    grid = grid_at(easting, 5_100_000.0, "EPSG:32632")
    longitude, latitude = place(grid)
    series = math.degrees(math.atan(math.tan(math.radians(longitude - 9.0)) * math.sin(math.radians(latitude))))
    ours = -((grid_azimuth(grid, 0.0) + 180.0) % 360.0 - 180.0)
    assert ours == pytest.approx(series, abs=0.003)
    assert ours == pytest.approx(Proj("EPSG:32632").get_factors(longitude, latitude).meridian_convergence, abs=1e-4)
    assert grid_azimuth(grid, 75.0) - 75.0 == pytest.approx(-ours, abs=1e-4)  # conformal


def test_grid_north_of_other_projections():
    polar = grid_at(1_000_000.0, 0.0, "EPSG:3995")  # 90° east on the map: there the pole lies to the west
    assert grid_azimuth(polar, 0.0) == pytest.approx(270.0, abs=1e-6)
    degrees = Grid((11, 11), Affine(0.01, 0, 7, 0, -0.01, 47), CRS("EPSG:4326"))
    assert grid_azimuth(degrees, 123.0) == 123.0
    # Plate carrée stretches east–west by 1/cos φ: azimuths bend, and the walked step knows.
    plate = grid_at(0.0, 60 * 111_319.49, "EPSG:4087")
    assert grid_azimuth(plate, 45.0) == pytest.approx(math.degrees(math.atan2(2.0, 1.0)), abs=0.2)


def test_a_moment_over_a_terrain_counts_from_grid_north():
    grid = grid_at(250_000.0, 5_100_000.0, "EPSG:32632")
    source = parse("2026-06-21T12:00+02:00")
    sun = source.over(grid)
    azimuth, altitude = position(datetime.datetime.fromisoformat("2026-06-21T12:00+02:00"), *place(grid))
    assert sun.altitude == altitude and sun.diameter == 0.53
    # West of the central meridian grid north points west of true north, by (9° − λ) sin φ: azimuths grow.
    longitude, latitude = place(grid)
    assert sun.azimuth - azimuth == pytest.approx((9.0 - longitude) * math.sin(math.radians(latitude)), abs=0.005)
    assert sun.azimuth - azimuth > 2.3
    assert parse("2026-06-21T10:00Z").over(grid) == sun


def test_a_placed_sun_is_left_alone():
    assert parse("200, 12.5") == Placed(200.0, 12.5)
    assert Placed(200.0, 12.5).over(grid_at(250_000.0, 5_100_000.0, "EPSG:32632")) == Sun(200.0, 12.5)
    assert Sun(90.0, 30.0).direction == pytest.approx((math.cos(math.pi / 6), 0.0, 0.5))


@pytest.mark.parametrize(
    "text", ["", "noon", "1,2,3", "a,b", "10,91", "inf,3", "2026-06-21T12:00", "2026-13-01T00:00Z"]
)
def test_what_is_no_sun_says_so(text):
    with pytest.raises(UsageError):
        parse(text)


def test_a_time_needs_a_place_on_earth():
    moment = Moment(utc(2026, 6, 21, 12))
    with pytest.raises(UsageError, match="where on Earth"):
        moment.over(Grid((5, 5), Affine(1, 0, 0, 0, -1, 0), None))
    moon = CRS("+proj=stere +lat_0=90 +R=1737400 +units=m +no_defs")
    with pytest.raises(UsageError, match="not on the Earth"):
        moment.over(Grid((5, 5), Affine(1, 0, 0, 0, -1, 0), moon))


def test_the_option():
    @click.command()
    @scene_option("sun")
    def verb(sun):
        click.echo(repr(sun))

    assert CliRunner().invoke(verb, []).output == "None\n"  # the scene's own
    assert "Placed(azimuth=315.0, altitude=45.0)" in CliRunner().invoke(verb, ["--sun", "315,45"]).output
    assert "Moment" in CliRunner().invoke(verb, ["--sun", "2026-06-21T12:00+02:00"]).output
    wrong = CliRunner().invoke(verb, ["--sun", "2026-06-21T12:00"])
    assert wrong.exit_code == 2 and "no time zone" in wrong.output


def test_one_sun_however_it_is_said():
    grid = grid_at(250_000.0, 5_100_000.0, "EPSG:32632")
    text = "2026-06-21T12:00+02:00"
    moment = Moment(datetime.datetime.fromisoformat(text)).over(grid)
    assert sun_of(text, grid) == sun_of(datetime.datetime.fromisoformat(text), grid) == moment
    assert sun_of((200.0, 12.5), grid) == sun_of("200,12.5", grid) == Sun(200.0, 12.5)
    assert sun_of(Sun(10.0, 20.0, 5.0), grid).diameter == 5.0
    for wrong in ((1.0,), (1.0, 2.0, 3.0), 7, None, ("a", "b")):
        with pytest.raises(UsageError, match="is not a sun"):
            sun_of(wrong, grid)
    with pytest.raises(UsageError, match="no time zone"):
        sun_of(datetime.datetime(2026, 6, 21, 12), grid)


def test_a_sun_says_where_it_stands_and_the_time_that_was_asked_for():
    moment = sun_of("2026-09-21T18:30-06:00", grid_at(330_000.0, 4_120_000.0, "EPSG:32612"))
    assert moment.when == datetime.datetime.fromisoformat("2026-09-21T18:30-06:00")
    assert moment == Sun(moment.azimuth, moment.altitude)  # (what is drawn is the same)
    assert Sun(263.14, 11.24, when=moment.when).words == "21 Sep 2026 18:30 −06:00, sun 263°, 11.2° high"
    utc = datetime.datetime(2026, 1, 2, 3, 4, tzinfo=datetime.UTC)
    assert Sun(359.7, -5.0, when=utc).words == "2 Jan 2026 03:04 UTC, sun 0°, 5° below the horizon"
    assert Sun(315.0, 45.0).words == "Light from 315°, 45° high"
