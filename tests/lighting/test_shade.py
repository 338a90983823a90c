"""Light: the sun's disc against Monte Carlo, air mass against its published table, colours that stay colours."""

from __future__ import annotations

import numpy as np
import pytest

from orograph.lighting.shade import air_mass, disc_fraction, sky_color, sun_color


def test_disc_fraction_is_the_area_above_the_horizon():
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (400_000, 2))
    points = points[(points**2).sum(1) < 1]
    for altitude, diameter in ((10.0, 0.53), (45.0, 6.0)):
        horizon = altitude + diameter / 2 * np.linspace(-1.2, 1.2, 25)
        expected = [(points[:, 1] * diameter / 2 + altitude > h).mean() for h in horizon]
        np.testing.assert_allclose(disc_fraction(horizon, altitude, diameter), expected, atol=4e-3)


def test_disc_fraction_at_its_limits():
    np.testing.assert_array_equal(disc_fraction([-90, 44, 46, 90], 45, 1.0), [1, 1, 0, 0])
    assert disc_fraction(45.0, 45, 1.0) == pytest.approx(0.5)
    # A segment of a quarter: closed form at half the radius, 1/3 − √3/(4π).
    assert disc_fraction(45.25, 45, 1.0) == pytest.approx(1 / 3 - np.sqrt(3) / (4 * np.pi))
    np.testing.assert_array_equal(disc_fraction([[44.9], [45.0], [45.1]], 45, 0.0), [[1], [0], [0]])  # a point of light
    assert disc_fraction(np.zeros((3, 4)), 45, 0.5).shape == (3, 4)


def test_air_mass_is_kasten_and_youngs():
    """Their table (1989), rounded: 1 at the zenith, 1.99 at 30°, 5.58 at 10°, 10.3 at 5°, 38 at the horizon."""
    published = {90: 1.0, 30: 1.99, 10: 5.58, 5: 10.3, 0: 38.0}
    for altitude, mass in published.items():
        assert air_mass(altitude) == pytest.approx(mass, rel=4e-3)
    assert air_mass(-20) == air_mass(0)


def test_low_suns_are_red_and_weak_and_gone_below_the_horizon():
    high, low = sun_color(60), sun_color(3)
    assert low[0] / low[2] > 1.5 * high[0] / high[2]
    assert low.sum() < high.sum()
    assert (sun_color(-1) == 0).all()
    altitudes = np.linspace(-1, 90, 4000)
    series = np.array([sun_color(a) for a in altitudes])
    assert (series >= 0).all() and np.abs(np.diff(series, axis=0)).max() < 0.06
    assert (np.diff(series[:, 1]) >= -1e-6).all()  # the higher the brighter, in green


def test_the_sky_is_blue_and_fades():
    assert sky_color(45)[2] > sky_color(45)[0]
    series = np.array([sky_color(a).sum() for a in np.linspace(-20, 90, 200)])
    assert (np.diff(series) >= -1e-12).all() and series[0] > 0
