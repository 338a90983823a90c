"""Slopes at the scale of pixels: exact on planes whatever the footprint, means of what they cover elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.geo.grid import Grid
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lighting.relief import Relief
from orograph.store import MemoryTerrain


def terrain(heights):
    return MemoryTerrain(np.asarray(heights, np.float32), Grid(heights.shape, Affine(30, 0, 0, 0, -30, 0)), "made up")


def relief(of, *parts):
    """All levels whole, or the named windows on top of the coarsest."""
    top = of.levels - 1
    rows, cols = of.shape(top)
    outer = [Rectangle(top, 0, rows, 0, cols)]
    if not parts:
        parts = tuple(Rectangle(k, 0, of.shape(k)[0], 0, of.shape(k)[1]) for k in range(top - 1, -1, -1))
    return Relief.load(of, [*outer, *parts])


def points(n, rows, cols, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(0, cols - 1, n), rng.uniform(0, rows - 1, n), np.zeros(n)], 1)


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(258, 1100),
    cols=st.integers(258, 1100),
    a=st.integers(-8, 8),
    b=st.integers(-8, 8),
    footprint=st.floats(0.01, 64),
)
def test_gradients_of_planes_are_exact(rows, cols, a, b, footprint):
    """To the borders, where the last block of a level covers fewer samples than the others."""
    r, c = np.mgrid[:rows, :cols]
    at = points(200, rows, cols)
    at[:4, :2] = [[0, 0], [cols - 1, 0], [0, rows - 1], [cols - 1, rows - 1]]
    got = relief(terrain((a * c + b * r).astype(np.float32))).gradient(at, np.full(200, footprint))
    np.testing.assert_allclose(got, np.broadcast_to([a, b], (200, 2)), rtol=0, atol=1e-2 + 1e-3 * (abs(a) + abs(b)))


def test_central_differences_at_samples_blended_between():
    heights = np.random.default_rng(1).normal(0, 50, (40, 30)).astype(np.float32)
    lookup = relief(terrain(heights))
    down, across = np.gradient(heights.astype(np.float64))
    r, c = np.mgrid[:40, :30]
    at = np.stack([c.ravel(), r.ravel(), np.zeros(1200)], 1).astype(np.float64)
    got = lookup.gradient(at, np.ones(1200))
    np.testing.assert_allclose(got, np.stack([across.ravel(), down.ravel()], 1), atol=1e-4)
    middle = lookup.gradient(np.array([[10.5, 20.25, 0.0]]), np.ones(1))[0]
    w = np.array([[0.75 * 0.5, 0.75 * 0.5], [0.25 * 0.5, 0.25 * 0.5]])
    np.testing.assert_allclose(middle, [(w * g[20:22, 10:12]).sum() for g in (across, down)], atol=1e-4)


def differences(h, axis):
    """One-sided beside what is missing, as NumPy arrays; NaN where there is nothing."""
    before, after = np.full(h.shape, np.nan), np.full(h.shape, np.nan)
    np.moveaxis(before, axis, 0)[1:], np.moveaxis(after, axis, 0)[:-1] = (
        np.moveaxis(h, axis, 0)[:-1],
        np.moveaxis(h, axis, 0)[1:],
    )
    gap = (~np.isnan(before)).astype(float) + ~np.isnan(after)
    rise = np.where(np.isnan(after), h, after) - np.where(np.isnan(before), h, before)
    return np.where(np.isnan(h), np.nan, rise / np.maximum(gap, 1))


@pytest.mark.parametrize("gaps", [0, 60])
def test_slopes_between_samples_are_blended(gaps):
    """Everywhere: the way taken beside gaps and borders, and the short one for all other places."""
    rng = np.random.default_rng(2)
    heights = rng.normal(0, 50, (40, 30)).astype(np.float32)
    heights.ravel()[rng.choice(1200, gaps, replace=False)] = np.nan
    slopes = np.stack([differences(heights.astype(np.float64), 1), differences(heights.astype(np.float64), 0)], -1)
    at = points(3000, 40, 30)
    got = relief(terrain(heights)).gradient(at, np.full(3000, 0.5))
    c, r = np.minimum(at[:, 0].astype(int), 28), np.minimum(at[:, 1].astype(int), 38)
    f, g = at[:, 0] - c, at[:, 1] - r
    total, weight = np.zeros((3000, 2)), np.zeros(3000)
    for i, j, w in ((0, 0, (1 - f) * (1 - g)), (0, 1, f * (1 - g)), (1, 0, (1 - f) * g), (1, 1, f * g)):
        there = slopes[r + i, c + j]
        w = np.where(np.isnan(there[:, 0]), 0, w)
        total += w[:, None] * np.nan_to_num(there)
        weight += w
    expected = np.where(weight[:, None] > 0, total / np.maximum(weight, 1e-300)[:, None], 0)
    np.testing.assert_allclose(got, expected, atol=1e-3)


def test_a_pixel_of_two_samples_sees_means():
    """Footprint 2^k: central differences of box means of 2^k samples; between, a blend of both levels."""
    rng = np.random.default_rng(2)
    heights = rng.normal(0, 50, (512, 512)).astype(np.float32)
    lookup = relief(terrain(heights))
    means = heights.reshape(256, 2, 256, 2).mean((1, 3)).astype(np.float64)
    i, j = 100, 57
    x, y = 2 * j + 0.5, 2 * i + 0.5  # the block's middle
    at = np.array([[x, y, 0.0]])
    coarse = np.array([means[i, j + 1] - means[i, j - 1], means[i + 1, j] - means[i - 1, j]]) / 4
    np.testing.assert_allclose(lookup.gradient(at, np.array([2.0]))[0], coarse, rtol=1e-4, atol=1e-4)
    fine = lookup.gradient(at, np.array([1.0]))[0]
    between = lookup.gradient(at, np.array([2**0.25]))[0]
    np.testing.assert_allclose(between, 0.75 * fine + 0.25 * coarse, rtol=1e-4, atol=1e-4)


def test_missing_neighbours_are_left_out():
    heights = np.add.outer(2.0 * np.arange(20), 3.0 * np.arange(30)).astype(np.float32)
    heights[np.random.default_rng(3).random(heights.shape) < 0.2] = np.nan
    lookup = relief(terrain(heights))
    at = points(500, 20, 30)
    got = lookup.gradient(at, np.full(500, 0.5))
    assert np.isfinite(got).all()
    # A neighbour at least on one side gives the plane's slope; with none it is level: never more than the plane's.
    assert (got >= -1e-3).all() and (got[:, 0] <= 3 + 1e-3).all() and (got[:, 1] <= 2 + 1e-3).all()
    assert np.median(got[:, 0]) == pytest.approx(3, abs=1e-3) and np.median(got[:, 1]) == pytest.approx(2, abs=1e-3)
    assert np.isnan(lookup.gradient(np.array([[np.nan, 1.0, 0.0]]), np.ones(1))).all()


def test_windows_change_nothing_where_they_hold_what_is_wanted():
    rng = np.random.default_rng(4)
    heights = rng.normal(0, 50, (900, 1000)).astype(np.float32)
    ground = terrain(heights)
    whole = relief(ground)
    part = relief(ground, Rectangle(0, 256, 513, 256, 513))
    at = points(400, 900, 1000, 5)
    inside = (np.abs(at[:, 0] - 384) < 120) & (np.abs(at[:, 1] - 384) < 120)
    for footprint in (0.5, 1.7, 3.0):
        a, b = (x.gradient(at, np.full(400, footprint)) for x in (whole, part))
        np.testing.assert_array_equal(a[inside], b[inside])
    coarse = np.full(400, 4.0)
    np.testing.assert_allclose(whole.gradient(at, coarse), part.gradient(at, coarse), atol=1e-12)
