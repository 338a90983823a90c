"""Water is what is exactly level, large, compact and lies lower than its banks; areas by SciPy's labelling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from orograph.geovis.water import LEAST_SAMPLES, find_water


def level_areas(heights):
    """Connected areas of one height without missing neighbours, grown to their shores: label by label."""
    padded = np.pad(heights, 1, mode="edge")
    shifts = [padded[i : i + heights.shape[0], j : j + heights.shape[1]] for i in range(3) for j in range(3)]
    level = np.all([s == heights for s in shifts], axis=0)  # false for NaN
    for value in np.unique(heights[level]):
        labels, n = ndimage.label(level & (heights == value), np.ones((3, 3)))
        for k in range(1, n + 1):
            area = labels == k
            yield int(area.sum()), ndimage.binary_dilation(area, np.ones((3, 3))) & (heights == value)


def slope(rows=90, cols=120, rise=0.7):
    return np.add.outer(np.arange(float(rows)), rise * np.arange(float(cols)) + 0.3).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_water_is_whole_level_areas(seed):
    rng = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(rng.normal(size=(120, 150)), 6)
    heights = (np.round(smooth / smooth.std() * 1.5) * 7.3).astype(np.float32)  # terraces
    heights[rng.random(heights.shape) < 0.002] = np.nan
    heights[80:, 100:] = -30.5
    found = find_water(heights.copy())
    whole = np.zeros_like(found)
    for size, area in level_areas(heights):
        part = found[area]
        if size < LEAST_SAMPLES:
            continue
        assert part.all() or not part.any() or part.mean() < 0.2  # shores touch a neighbour's at most
        if part.all():
            whole |= area
    np.testing.assert_array_equal(found, whole)
    assert found[81:, 101:].all() and not found.all()


def test_the_sea_and_its_shore():
    heights = slope() + 1
    heights[:, :40] = 0
    expected = np.zeros(heights.shape, bool)
    expected[:, :40] = True
    np.testing.assert_array_equal(find_water(heights), expected)


@pytest.mark.parametrize("level", [-40.0, -40.25])
def test_lakes_beneath_their_banks(level):
    heights = slope(rise=2) * 5
    heights[10:40, 10:40] = level
    heights[10:40, 50:80] = level + 1
    heights[60:66, 60:66] = level  # a pond: too small to be told from chance
    expected = np.zeros(heights.shape, bool)
    expected[10:40, 10:40] = expected[10:40, 50:80] = True
    np.testing.assert_array_equal(find_water(heights, 30.0), expected)


def test_plateaus_are_no_lakes():
    heights = slope()
    heights[20:60, 30:70] = heights.max() + 50.5
    assert not find_water(heights).any()


def test_plains_of_whole_metres_are_no_lakes():
    rng = np.random.default_rng(0)
    x = np.arange(300)
    rough = np.round(50 + x / 60 + rng.normal(0, 0.4, (300, 300))).astype(np.float32)
    assert not find_water(rough).any()
    steps = np.broadcast_to(np.floor(50 + x / 40), (300, 300)).astype(np.float32)  # seven large level steps
    assert not find_water(steps, 30.0).any()


def test_heights_are_left_alone_and_none_is_none():
    heights = np.zeros((40, 40), np.float32)
    before = heights.copy()
    assert find_water(heights).all()
    np.testing.assert_array_equal(heights, before)
    assert not find_water(np.full((40, 40), np.nan, np.float32)).any()
    assert not find_water(slope()).any()
    assert find_water(np.zeros((2, 2), np.float32)).shape == (2, 2)
