"""Hours of direct sun against the sun's own rising and setting, over a plain, behind a wall and on rough ground."""

from __future__ import annotations

import datetime
import math

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph import lighting
from orograph.dem import Dem
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lighting.energy import Suns
from orograph.lighting.horizon import horizon
from orograph.lighting.normal import gradient
from orograph.lighting.products import product
from orograph.lighting.shade import disc_fraction
from orograph.lighting.sun import position

CELL = (30.0, 20.0)
"""Metres, along rows and columns."""


def grid_at(latitude: float, rows: int, cols: int) -> Grid:
    crs = CRS(f"+proj=tmerc +lat_0={latitude} +lon_0=7 +datum=WGS84 +units=m")
    x, y = CELL
    return Grid((rows, cols), Affine(x, 0, -cols * x / 2, 0, -y, rows * y / 2), crs)


def hours(heights: np.ndarray, latitude: float, date: str, azimuths: int = 64, **options: float) -> np.ndarray:
    dem = Dem(heights.astype(np.float32), grid_at(latitude, *heights.shape))
    return lighting.sunshine(dem, date, azimuths, **options).values[0]


@pytest.mark.parametrize(
    ("latitude", "date"), [(0, "2026-03-20"), (34, "2026-10-15"), (46, "2026-12-21"), (-52, "2026-06-21")]
)
def test_over_a_plain_the_sun_shines_from_its_rising_to_its_setting(latitude, date):
    """Astral's own search for the moments at which the disc's middle stands on the horizon (refraction: 0.567°)."""
    from astral import Observer, SunDirection
    from astral.sun import time_at_elevation

    place, day = Observer(latitude, 7.0), datetime.date.fromisoformat(date)
    up, down = (
        time_at_elevation(place, -0.567, day, way, with_refraction=False)
        for way in (SunDirection.RISING, SunDirection.SETTING)
    )
    made = hours(np.full((5, 7), 200.0), latitude, date, step=1)
    assert made.shape == (5, 7) and np.ptp(made) == 0
    assert made[2, 3] == pytest.approx((down - up).total_seconds() / 3600, abs=2.5 / 60)


def test_polar_days_and_nights_and_a_year():
    plain = np.zeros((3, 3))
    assert hours(plain, 75.0, "2026-06-21")[1, 1] == pytest.approx(24, abs=1e-3)
    assert hours(plain, 75.0, "2026-12-21")[1, 1] == 0
    # Everywhere on Earth about half of the year is day; refraction adds some days' worth.
    assert hours(plain, 46.0, "2026", step=30)[1, 1] == pytest.approx(4380, rel=0.02)


def test_behind_a_wall_the_sun_rises_later():
    """A wall in the east as long as the raster: at azimuth a its height above the horizon is atan(H sin a / d)."""
    rows, cols, at, height, latitude = 301, 70, 60, 600.0, 46.0
    heights = np.zeros((rows, cols))
    heights[:, at:] = height
    made = hours(heights, latitude, "2026-04-20", azimuths=360, step=1)
    first = datetime.datetime(2026, 4, 20, tzinfo=datetime.UTC)
    suns = [position(first + datetime.timedelta(minutes=k + 0.5), 7.0, latitude)[:2] for k in range(1440)]
    for col in (5, 20, 35):
        distance = (at - col) * CELL[0]
        wall = [math.degrees(math.atan(max(height * math.sin(math.radians(a)) / distance, 0.0))) for a, _ in suns]
        truth = sum(altitude > w for (_, altitude), w in zip(suns, wall)) / 60
        assert made[rows // 2, col] == pytest.approx(truth, abs=6 / 60)
    assert made[rows // 2, 35] < made[rows // 2, 5] - 0.5 < 12
    # On the wall's top nothing is in the way.
    assert made[rows // 2, 65] == pytest.approx(sum(altitude > 0 for _, altitude in suns) / 60, abs=4 / 60)


def test_ground_that_faces_away_has_no_sun():
    """Ground inclined to the north by 45° at 46° N in December, when the noon sun stands 20° high."""
    rises = np.arange(60)[:, None] * -CELL[1] * np.ones((1, 40))
    south, north = hours(rises, 46.0, "2026-12-21"), hours(rises[::-1], 46.0, "2026-12-21")
    assert north[30, 20] == 0
    assert south[30, 20] > 8


def test_against_every_moment_by_itself():
    """Each sun with its own horizon and its own disc, on rough ground with a hole."""
    rng = np.random.default_rng(5)
    heights = rng.normal(size=(40, 50)).cumsum(0).cumsum(1)
    heights = (heights / np.ptp(heights) * 700 + 900).astype(np.float32)
    heights[10:12, 20] = np.nan
    linear = np.diag([CELL[0], -CELL[1]])
    gx, gy = gradient(heights, linear)
    suns = Suns.over(grid_at(46.0, 40, 50), "2026-03-01", step=20)
    truth = np.zeros(heights.shape)
    for azimuth, altitude in zip(suns.azimuth, suns.altitude):
        a = math.radians(azimuth)
        skyline = np.maximum(horizon(heights, linear, azimuth), gx * math.sin(a) + gy * math.cos(a))
        truth += disc_fraction(np.degrees(np.arctan(skyline)), altitude, 0.53) * suns.hours
    made = hours(heights, 46.0, "2026-03-01", azimuths=128, step=20)
    assert (np.isnan(made) == np.isnan(heights)).all()
    apart = (made - truth)[1:-1, 1:-1]
    assert np.nanstd(truth) > 1.0
    # Suns are shared between the azimuths beside them: single samples differ by up to a step or two.
    assert np.nanmean(np.abs(apart)) < 0.2 and abs(np.nanmean(apart)) < 0.05


def test_what_it_needs():
    with pytest.raises(UsageError, match="Sunshine is over a period"):
        lighting.make(Dem(np.zeros((3, 3), np.float32), grid_at(46.0, 3, 3)), "sunshine")
    with pytest.raises(UsageError, match="where on Earth"):
        lighting.sunshine(np.zeros((3, 3)), "2026", cell=30.0)
    for other in ("sun-hours", "sunshine_duration", "Hours of sun"):
        with pytest.raises(UsageError, match="Did you mean sunshine"):
            product(other)
