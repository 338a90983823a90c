"""The surface along lines against the definition of the surface."""

from __future__ import annotations

import brute
import numpy as np
import pytest
from closed_forms import rough, terrain_of

from orograph.measuring.ground import crossings, heights, line


@pytest.mark.parametrize("holes", [False, True])
def test_heights_are_those_of_the_triangles(holes):
    h = rough((40, 37), 3, holes)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 36, 3000), rng.uniform(0, 39, 3000)
    np.testing.assert_allclose(heights(terrain_of(h), x, y), brute._height(h, x, y), atol=1e-9)


def test_samples_have_their_own_heights_up_to_the_border():
    h = rough((7, 9))
    y, x = (a.ravel().astype(float) for a in np.mgrid[:7, :9])
    np.testing.assert_allclose(heights(terrain_of(h), x, y), h.ravel(), atol=1e-9)


def test_on_the_rim_of_a_hole_the_ground_is_known():
    h = np.full((4, 4), 5, np.float32)
    h[0, 1] = np.nan  # cell (0, 0) is even: a b d is a hole, a c d is ground
    found = heights(terrain_of(h), np.array([0.5, 0.0, 0.7, 0.3, 1.0]), np.array([0.5, 0.5, 0.3, 0.7, 1.0]))
    np.testing.assert_array_equal(found, [5, 5, np.nan, 5, 5])


@pytest.mark.parametrize("seed", range(8))
def test_between_crossings_the_ground_is_straight_and_at_crossings_it_bends(seed):
    rng = np.random.default_rng(seed)
    h = rough((25, 30), seed)
    a, b = rng.uniform(0, 24, 2), rng.uniform(0, 24, 2)
    if seed % 2:
        a, b = np.round(a), np.round(b)  # through samples, along edges now and then
    cut = line(terrain_of(h), a, b)
    assert cut.t[0] == 0 and cut.t[-1] == 1 and (np.diff(cut.t) > 0).all()
    f = np.linspace(0, 1, 7)[:, None]
    t = cut.t[:-1] + f * np.diff(cut.t)
    truth = brute._height(h, a[0] + t * (b - a)[0], a[1] + t * (b - a)[1])
    np.testing.assert_allclose(cut.before + f * (cut.after - cut.before), truth, atol=1e-6)
    np.testing.assert_allclose(cut.after[:-1], cut.before[1:], atol=1e-6)
    slopes = (cut.after - cut.before) / np.diff(cut.t)
    assert (np.abs(np.diff(slopes)) > 1e-3).mean() > 0.95  # nothing is cut in vain


def test_a_line_along_a_row_meets_only_its_samples():
    np.testing.assert_allclose(crossings(np.array([1.0, 4.0]), np.array([6.0, 4.0])), np.arange(6) / 5)
    np.testing.assert_allclose(crossings(np.array([0.5, 0.5]), np.array([2.5, 2.5])), [0, 0.25, 0.75, 1])


def test_a_line_along_the_border_of_a_hole_is_ground():
    h = rough((8, 8))
    h[3, 2:6] = np.nan
    for row in (2.0, 4.0):
        cut = line(terrain_of(h), np.array([0.0, row]), np.array([7.0, row]))
        assert cut.known.all()
        np.testing.assert_allclose(cut.heights, h[int(row)], atol=1e-4)
    across = line(terrain_of(h), np.array([3.5, 0.0]), np.array([3.5, 7.0]))
    assert not across.known.all() and np.isnan(across.heights).any() and np.isfinite(across.heights[[0, -1]]).all()
