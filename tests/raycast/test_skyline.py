"""Skylines against the exact profile: the surface is linear between its crossings with cell borders and diagonals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.raycast.caster import Caster
from orograph.raycast.stack import HeightWindow

Array = np.ndarray


def steepest(h: Array, point: Array, direction: tuple[float, float], skip: float) -> float:
    """The steepest slope from a point to the surface, from its profile's vertices; −inf if there is none."""
    rows, cols = h.shape
    x, y, z = point
    dx, dy = direction
    reach = 2.0 * (rows + cols) / max(abs(dx), abs(dy))
    # The lines that cut the surface: columns, rows, and both families of diagonals.
    crossings = [np.array([skip, reach])]
    for normal, lines in (
        ((1, 0), range(cols)),
        ((0, 1), range(rows)),
        ((1, 1), range(rows + cols)),
        ((1, -1), range(-rows, cols)),
    ):
        along = normal[0] * dx + normal[1] * dy
        if abs(along) > 1e-12:
            crossings.append((np.array(lines) - normal[0] * x - normal[1] * y) / along)
    s = np.unique(np.concatenate(crossings))
    s = s[(s >= skip) & (s <= reach)]
    best = -np.inf
    for a, b in pairwise(s):
        if b - a < 1e-9:
            continue
        u, v = x + dx * (a + b) / 2, y + dy * (a + b) / 2
        c, r = int(np.floor(u)), int(np.floor(v))
        if not (0 <= u <= cols - 1 and 0 <= v <= rows - 1 and c < cols - 1 and r < rows - 1):
            continue
        k = h[r : r + 2, c : c + 2].astype(float)
        fu, fv = u - c, v - r
        if (c + r) % 2 == 0:
            p = [(0, 0), (1, 1), (1, 0) if fu >= fv else (0, 1)]
        else:
            p = [(1, 0), (0, 1), (0, 0) if fu + fv <= 1 else (1, 1)]
        plane = (
            np.linalg.solve([[c + i, r + j, 1.0] for i, j in p], [k[j, i] for i, j in p])
            if np.isfinite([k[j, i] for i, j in p]).all()
            else None
        )
        if plane is None:
            continue
        for e in (a, b):
            if e > 0:
                best = max(best, (plane @ [x + dx * e, y + dy * e, 1.0] - z) / e)
    return best


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(2, 14),
    cols=st.integers(2, 20),
    holes=st.booleans(),
    azimuth=st.one_of(st.floats(0, 360), st.sampled_from([0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0])),
    skip=st.sampled_from([0.0, 0.4, 3.0]),
)
def test_steepest_slope(seed: int, rows: int, cols: int, holes: bool, azimuth: float, skip: float) -> None:
    rng = np.random.default_rng(seed)
    h = rng.normal(0, 5, (rows, cols)).astype(np.float32)
    if holes:
        h[rng.random(h.shape) < 0.15] = np.nan
    n = 10
    points = np.column_stack([rng.random(n) * (cols - 1), rng.random(n) * (rows - 1), rng.normal(0, 8, n)])
    a = np.radians(azimuth)
    direction = (float(np.round(np.sin(a), 12)) / 2.0, float(-np.round(np.cos(a), 12)) / 2.0)  # samples 2 m apart
    if skip == 0.0:  # from beneath the ground, the slope next to the point would have no bound
        surface = np.array([Caster.of(h, 1).surface(*p[:2]) for p in points])
        points[:, 2] = np.where(np.isfinite(surface), surface + np.abs(points[:, 2]), points[:, 2])
    expected = np.array([steepest(h, p, direction, skip) for p in points])
    got = Caster.of(h, 1).skyline(points, direction, np.full(n, skip), -1e9, 1e9)
    found = expected > -np.inf
    np.testing.assert_allclose(got[found], expected[found], rtol=1e-6, atol=1e-6)
    assert (got[~found] == -1e9).all()
    # Only slopes between ``lower`` and ``enough`` matter.
    lower, enough = -0.5, 1.0
    some = Caster.of(h, 1).skyline(points, direction, np.full(n, skip), lower, enough)
    reached = expected >= enough + 1e-9
    assert (some[reached] >= enough).all() and (some[reached] <= expected[reached] + 1e-6).all()
    below = expected < enough - 1e-9
    np.testing.assert_allclose(some[below], np.maximum(expected[below], lower), rtol=1e-6, atol=1e-6)


def test_missing_points_have_no_skyline() -> None:
    h = np.random.default_rng(0).normal(0, 1, (9, 9)).astype(np.float32)
    points = np.array([[1.0, 1.0, 3.0], [np.nan, 1.0, 2.0], [2.0, 2.0, np.nan]])
    got = Caster.of(h, 1).skyline(points, (1.0, 0.0), np.zeros(3), 0.0, 1.0)
    assert np.isfinite(got[0]) and np.isnan(got[2])


def test_nested_windows_of_a_ridge_have_its_skyline() -> None:
    """A field linear along each side of a ridge at a multiple of every spacing is the same at all levels."""
    y, x = np.mgrid[0:129, 0:161].astype(float)
    h = (200 - 2.0 * np.abs(x - 96) + 0.25 * y).astype(np.float32)
    one = Caster.of(h, 1)
    coarse = np.ascontiguousarray(h[::8, ::8])
    stack = Caster(
        [HeightWindow(3, 0, 0, coarse), HeightWindow(0, 16, 24, np.ascontiguousarray(h[24:81, 16:65]))], h.shape, 1
    )
    rng = np.random.default_rng(1)
    p = np.column_stack([rng.random(200) * 158 + 1, rng.random(200) * 126 + 1, rng.random(200) * 200])
    for a in np.radians([3, 50, 90, 133, 222, 270, 300]):
        direction = (float(np.sin(a)), float(-np.cos(a)))
        skip = np.full(200, 0.5)
        np.testing.assert_allclose(
            stack.skyline(p, direction, skip, -1e9, 1e9),
            one.skyline(p, direction, skip, -1e9, 1e9),
            rtol=1e-6,
            atol=1e-6,
        )


@pytest.mark.parametrize("jobs", [2])
def test_threads_do_not_change_anything(jobs: int) -> None:
    rng = np.random.default_rng(2)
    h = rng.normal(0, 5, (60, 70)).astype(np.float32)
    p = np.column_stack([rng.random(40000) * 69, rng.random(40000) * 59, rng.normal(0, 5, 40000)])
    results = [Caster.of(h, j).skyline(p, (0.6, -0.8), np.zeros(40000), 0.0, 3.0) for j in (1, jobs)]
    np.testing.assert_array_equal(*results)
