"""Errors conditioned on check points: against Gaussian conditional distributions, computed directly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.transform import from_origin

import orograph
from orograph import measuring
from orograph.errors import ReadError, UsageError
from orograph.measuring.conditioning import MOST, corner_weights, read_checks
from orograph.measuring.ground import heights
from orograph.measuring.height_error import Drawn, ErrorField, HeightError

UTM = "EPSG:32630"


def land(rows=40, cols=50, hole=False):
    """Ground with oblong cells of 20 by 10 m."""
    y, x = np.mgrid[:rows, :cols]
    z = (100 + 3 * np.sin(x / 5) + 2 * np.cos(y / 7)).astype(np.float32)
    if hole:
        z[5:9, 5:9] = np.nan
    return orograph.terrain(z, transform=from_origin(500_000, 5_600_000, 20, 10), crs=UTM)


def checks_on(terrain, places, errors):
    """Check points at sample coordinates whose heights are off the surface by so much."""
    x, y = np.array(places, float).T
    east, north = terrain.grid.xy(x, y)
    return np.stack([east, north, heights(terrain, x, y) + np.array(errors, float)], 1)


PLACES = [(10.0, 12.0), (10.6, 12.3), (31.25, 7.75), (42.5, 33.5)]
ERRORS = [4.0, 3.5, -5.0, 1.0]


@settings(deadline=None, max_examples=100)
@given(st.floats(0, 48.999), st.floats(0, 38.999))
def test_weights_of_corners_make_the_surface(x, y):
    terrain = land()
    row, col, weights = corner_weights(np.array([x]), np.array([y]), terrain.grid.shape)
    z = terrain.read(0, 0, 40, 0, 50)
    assert (weights * z[row, col]).sum() == pytest.approx(heights(terrain, np.array([x]), np.array([y]))[0], abs=1e-4)
    assert weights.sum() == pytest.approx(1)


@pytest.mark.parametrize("reach", [0.0, 80.0, 600.0])
def test_every_draw_passes_through_the_check_points(reach):
    terrain = land()
    checks = checks_on(terrain, PLACES, ERRORS)
    field = ErrorField(terrain, HeightError(3.0, reach, checks=checks), seed=5)
    x, y = np.array(PLACES).T
    for draw in range(4):
        found = heights(Drawn(terrain, field, draw), x, y)
        np.testing.assert_allclose(found, checks[:, 2], atol=0.03)
    # Far from them, and with another seed, draws are what they were.
    free = ErrorField(terrain, HeightError(3.0, reach), seed=5)
    if reach == 80.0:
        far = field.window(0, 30, 40, 0, 5), free.window(0, 30, 40, 0, 5)
        np.testing.assert_array_equal(*far)
    assert np.abs(field.window(0, 10, 14, 9, 12) - free.window(0, 10, 14, 9, 12)).max() > 0.1


def test_windows_of_a_draw_are_parts_of_the_whole_to_the_bit():
    terrain = land()
    error = HeightError(np.linspace(1, 4, 2000).reshape(40, 50).astype(np.float32), 200.0,
                        checks=checks_on(terrain, PLACES, ERRORS), check_sigma=0.5)  # fmt: skip
    whole = ErrorField(terrain, error).window(3, 0, 40, 0, 50)
    again = ErrorField(terrain, error)
    for window in ((0, 13, 0, 50), (13, 40, 0, 17), (13, 40, 17, 50), (12, 13, 10, 11)):
        r0, r1, c0, c1 = window
        np.testing.assert_array_equal(again.window(3, *window), whole[r0:r1, c0:c1])


@pytest.mark.parametrize("tau", [0.0, 1.5])
def test_means_and_deviations_are_those_of_the_conditional_distribution(tau):
    """Σ₁₁ − Σ₁₂ Σ₂₂⁻¹ Σ₂₁, written out over all samples, for check points on samples."""
    terrain, sigma, reach = land(12, 15), 2.0, 160.0
    places, errors = [(3.0, 4.0), (9.0, 6.0), (10.0, 7.0)], [3.0, -2.0, -1.0]
    field = ErrorField(terrain, HeightError(sigma, reach, checks=checks_on(terrain, places, errors), check_sigma=tau))
    row, col = (v.ravel() for v in np.mgrid[:12, :15])
    d2 = ((col[:, None] - col) * 20.0) ** 2 + ((row[:, None] - row) * 10.0) ** 2
    covariance = sigma**2 * np.exp(-3 * d2 / reach**2)
    at = [int(y) * 15 + int(x) for x, y in places]
    gain = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)] + (tau**2 + 1e-6 * sigma**2) * np.eye(3))
    mean = gain @ np.array(errors)
    left = np.sqrt(np.clip(np.diag(covariance - gain @ covariance[at]), 0, None))
    np.testing.assert_allclose(field.mean(0, 12, 0, 15).ravel(), mean, atol=2e-3)
    np.testing.assert_allclose(field.deviations(0, 12, 0, 15).ravel(), left, atol=4e-3)
    # And so are many draws.
    draws = np.stack([field.window(k, 0, 12, 0, 15).ravel() for k in range(400)])
    assert np.abs(draws.mean(0) - mean).max() < 4.5 * sigma / 20
    np.testing.assert_allclose(draws.std(0), left, atol=0.35)


@pytest.mark.stress
def test_a_flood_hears_check_points_in_closed_form_and_in_draws():
    terrain = orograph.terrain(np.full((30, 30), 10, np.float32), transform=from_origin(500_000, 5_600_000, 10, 10),
                               crs=UTM)  # fmt: skip
    x, y = terrain.grid.xy(15.0, 15.0)
    error = HeightError(2.0, 120.0, checks=np.array([[x, y, 14.0]]))  # 4 m too low
    found = measuring.flood(terrain, 11.0, error=error).values()[0]
    bare = measuring.flood(terrain, 11.0, error=HeightError(2.0, 120.0)).values()[0]
    assert found[15, 15] < 1e-6 and bare[15, 15] == pytest.approx(0.6915, abs=1e-3)
    assert found[0, 0] == pytest.approx(bare[0, 0], abs=0.02)
    drawn = measuring.flood(terrain, 11.0, [terrain.grid.xy(1.0, 1.0)], error, draws=60).values()[0]
    assert drawn[15, 15] == 0


def test_check_points_of_files(tmp_path):
    terrain = land()
    (row,) = checks_on(terrain, [(10.0, 12.0)], [2.0])
    file = tmp_path / "gcp.csv"
    file.write_text(f"x,y,height,sd\n{row[0]},{row[1]},{row[2]},0.2\n{row[0]},{row[1] + 1e6},5,0.2\n")
    found = read_checks(str(file), 0.1, terrain)
    np.testing.assert_allclose([found.found[0], found.tau[0]], [2.0, 0.1], atol=1e-4)
    named = read_checks(orograph.Dataset(str(file), variable="height", uncertainty="sd"), 0.1, terrain)
    assert named.tau.tolist() == [0.2]
    assert "gcp.csv" in HeightError(1.0, checks=str(file)).tags["check_points"]


def test_what_are_no_check_points_is_refused(tmp_path):
    terrain = land(hole=True)
    x, y = terrain.grid.xy(6.0, 6.0)
    for wrong, words in ((np.zeros((3, 2)), "array"), (np.array([[0.0, 0.0, 1.0]]), "on the ground"),
                         (np.array([[x, y, 1.0]]), "on the ground")):  # fmt: skip
        with pytest.raises((UsageError, ReadError), match=words):
            ErrorField(terrain, HeightError(1.0, checks=wrong))
    many = checks_on(land(), np.random.default_rng(0).uniform(0, 38, (MOST + 1, 2)), np.zeros(MOST + 1))
    with pytest.raises(UsageError, match="at most"):
        ErrorField(land(), HeightError(1.0, checks=many))
    file = tmp_path / "c.csv"
    file.write_text("x,y,a,b\n1,2,3,4\n")
    with pytest.raises(UsageError, match="which column"):
        read_checks(str(file), 0.0, terrain)
    with pytest.raises(UsageError, match="check points"):
        HeightError(1.0, check_sigma=-1.0)
