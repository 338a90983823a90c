"""The smooth surface of contour lines: through the samples, with the light's slopes, no bend, true on quadrics."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from orograph.lighting.relief import Relief, Windows
from orograph.rendering.lines.smooth import CLEAR, SMALL, interpolated, smoothed

Array = NDArray[np.float64]


def field(rows: int = 12, cols: int = 15, seed: int = 3) -> NDArray[np.float32]:
    return (1000 + 40 * np.random.default_rng(seed).normal(size=(rows, cols))).astype(np.float32)


def test_it_passes_through_the_samples() -> None:
    z = field()
    y, x = (a.ravel().astype(float) for a in np.indices(z.shape))
    np.testing.assert_allclose(interpolated(z, x, y), z.ravel(), atol=1e-9)


def test_quadrics_are_what_they_are() -> None:
    """Away from the border, where slopes are one-sided."""
    y, x = np.mgrid[:20, :20].astype(float)

    def quadric(x: Array, y: Array) -> Array:
        return 0.5 * x * x - 0.75 * x * y + 0.25 * y * y + 3.0 * x - 2.0 * y + 100.0  # exact in float32

    at = np.random.default_rng(0).uniform(1, 18, (2000, 2))
    found = interpolated(quadric(x, y).astype(np.float32), at[:, 0], at[:, 1])
    np.testing.assert_allclose(found, quadric(at[:, 0], at[:, 1]), atol=1e-9)


def test_it_has_no_bend_between_cells_and_the_slope_of_the_light_across_their_edges() -> None:
    z = field().astype(np.float64)
    rng = np.random.default_rng(1)
    e = 1e-5
    for _ in range(300):
        col, row = int(rng.integers(2, 13)), rng.uniform(2, 9)
        west, here, east = interpolated(z.astype(np.float32), col + np.array([-e, 0.0, e]), np.full(3, row))
        before, after = (here - west) / e, (east - here) / e
        i, g = int(row), row - int(row)
        central = [(z[r, col + 1] - z[r, col - 1]) / 2 for r in (i, i + 1)]
        slope = (1 - g) * central[0] + g * central[1]
        assert abs(before - slope) < 0.02 and abs(after - slope) < 0.02  # (the slopes themselves are about 30)
    for _ in range(300):
        col, row = rng.uniform(2, 12), int(rng.integers(2, 10))
        north, here, south = interpolated(z.astype(np.float32), np.full(3, col), row + np.array([-e, 0.0, e]))
        assert abs((here - north) / e - (south - here) / e) < 0.02


def test_beside_missing_samples_heights_are_the_grounds() -> None:
    z = field()
    z[5, 5] = np.nan
    rows, cols = z.shape
    relief = Relief(Windows.one(z.ravel(), (rows, cols)))
    x, y = (a.ravel() + 0.5 for a in np.indices((cols - 1, rows - 1)))
    points = np.stack([x, y, 0 * x], -1)
    found = smoothed(relief, points, np.zeros(len(x)), np.full(len(x), 7.0))
    beside = (np.abs(x - 5) < 1) & (np.abs(y - 5) < 1)
    assert (found[beside] == 7.0).all() and (found[~beside] > 500).all() and np.isfinite(found).all()


def test_where_pixels_cover_samples_heights_are_the_grounds() -> None:
    z = field()
    rows, cols = z.shape
    relief = Relief(Windows.one(z.ravel(), (rows, cols)))
    wide = np.linspace(0.0, 1.0, 201)
    points = np.tile([6.3, 5.6, 0.0], (len(wide), 1))
    found = smoothed(relief, points, wide, np.full(len(wide), 2000.0))
    assert (found[wide >= SMALL[1]] == 2000.0).all() and (np.diff(found) >= 0).all() and found[0] < 1500
    assert np.abs(np.diff(found)).max() < 30  # by degrees


def test_a_coast_is_one_line() -> None:
    """The sea is level: the surface dips below it beside the land, and heights say how far away the coast is."""
    z = np.zeros((9, 12), np.float32)
    z[:, 6:] = 30.0 * np.arange(1, 7)
    x = np.linspace(4.01, 4.99, 99)
    height = interpolated(z, x, np.full(len(x), 4.3))
    slope = 15.0 * (x - 4)  # the light's
    away = np.abs(height) / slope
    assert (height < 0).all() and (np.abs(away - np.minimum(5 - x, CLEAR[0])) < 1e-6).all()
    assert (interpolated(z, np.linspace(0, 4, 20), np.full(20, 4.3)) == 0).all()


@pytest.mark.parametrize("turns", range(4))
def test_where_a_coast_turns_it_is_straight_from_sample_to_sample(turns: int) -> None:
    """Two rows of land and a third that is shorter: a cell with one corner of land, and one beside it with two."""
    z = np.zeros((12, 12), np.float32)
    z[7:, :] = 30
    z[6, 6:] = 20
    z = np.rot90(z, turns).copy()
    t = np.linspace(0.02, 0.98, 25)

    def height(x: Array, y: Array) -> Array:
        for _ in range(turns):
            x, y = y, 11 - x
        return interpolated(z, x, y)

    np.testing.assert_allclose(height(5 + t, 6 - t), 0, atol=1e-6)  # across the cell whose corner is land
    np.testing.assert_allclose(height(6 + t, np.full(25, 5 + 1e-7)), 0, atol=1e-5)  # along the edge of the sea
    np.testing.assert_allclose(height(4 + t, np.full(25, 6 + 1e-7)), 0, atol=1e-5)
    assert (height(5 + t, 6.2 - t) > 0).all() and (height(5 + t[:-4], 5.8 - t[:-4]) < 0).all()
    assert (height(6.5 + t, np.full(25, 5.1)) > 0).all()
