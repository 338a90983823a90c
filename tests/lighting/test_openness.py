"""Openness against closed forms and a search along the eight directions of Yokoyama's paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.lighting.arrays import context_of
from orograph.lighting.context import Options
from orograph.lighting.products import compute

SQUARE = np.array([[1.0, 0.0], [0.0, -1.0]])


def openness(h: np.ndarray, negative: bool = False, linear: np.ndarray = SQUARE, **options) -> np.ndarray:
    name = "openness-negative" if negative else "openness"
    return compute(context_of(h, linear, Options(**options)), name)[0]


def test_planes_are_open_by_a_right_angle():
    row, col = np.indices((31, 31))
    for h in (np.zeros((31, 31)), 0.5 * col - 0.3 * row):
        for negative in (False, True):
            got = openness(h.astype(np.float32), negative, azimuths=8)
            np.testing.assert_allclose(got[10:21, 10:21], 90.0, atol=1e-3)


def test_cones():
    row, col = np.indices((201, 201)) - 100
    pit = np.hypot(row, col).astype(np.float32)
    # From the bottom of a cone of 45° the sky begins 45° from the zenith; the nadir angle looks along its wall upward.
    # (Its tip is round, for the finest triangles would make a pyramid of a sharp one.)
    smooth = np.minimum(pit, pit**2 / 10)
    assert openness(smooth, azimuths=32)[100, 100] == pytest.approx(45, abs=0.1)
    # A line beside a peak passes below it: on the eight azimuths whose lines run through samples it is sharp.
    assert openness(-pit, azimuths=8)[100, 100] == pytest.approx(135, abs=0.1)
    assert openness(pit, True, azimuths=8)[100, 100] == pytest.approx(135, abs=0.1)
    assert openness(-pit, True, azimuths=8)[100, 100] == pytest.approx(45, abs=0.1)


def test_infinite_valley():
    col = np.abs(np.arange(-300, 301))
    h = np.repeat(0.8 * col[None], 601, 0).astype(np.float32)
    angle = np.degrees(np.arctan(0.8 * np.abs(np.sin(np.radians(np.arange(32) * 11.25)))))
    assert openness(h, azimuths=32)[300, 300] == pytest.approx(90 - angle.mean(), abs=0.1)


def eight(h: np.ndarray, reach: int, row: int, col: int, sign: int) -> float:
    """Yokoyama's definition, one sample at a time: of the surface, whose cells are cut through even row + column."""

    def height(r: float, c: float) -> float:
        if r % 1 == 0:
            return float(h[int(r), int(c)])
        r0, c0 = math.floor(r), math.floor(c)  # the middle of a cell
        ends = [h[r0, c0], h[r0 + 1, c0 + 1]] if (r0 + c0) % 2 == 0 else [h[r0, c0 + 1], h[r0 + 1, c0]]
        corners = [float(z) for z in ends if not math.isnan(z)]
        along = (row + col) % 2 == 0  # the diagonal itself, which adds nothing
        return math.nan if along or not corners else sum(corners) / len(corners)

    angles = []
    for dr, dc in ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1)):
        best = -math.inf
        for k in np.arange(0.5, reach + 1, 0.5) if dr and dc else range(1, reach + 1):
            r, c, d = row + k * dr, col + k * dc, k * math.hypot(dr, dc)
            inside = 0 <= r <= h.shape[0] - 1 and 0 <= c <= h.shape[1] - 1
            if inside and math.ceil(k) * math.hypot(dr, dc) <= reach and not math.isnan(height(r, c)):
                best = max(best, math.atan2(sign * (height(r, c) - float(h[row, col])), d))
        if best > -math.inf:
            angles.append(90 - math.degrees(best))
    return sum(angles) / len(angles) if angles else math.nan


@pytest.mark.cases(1)
@pytest.mark.parametrize("radius", [12, 1000])
@pytest.mark.parametrize("negative", [False, True])
def test_eight_directions_of_the_paper(radius, negative):
    rng = np.random.default_rng(5)
    h = rng.normal(size=(33, 41)).cumsum(0).cumsum(1).astype(np.float32)
    h[rng.random(h.shape) < 0.05] = np.nan
    got = openness(h, negative, azimuths=8, radius=float(radius))
    expected = np.full(h.shape, np.nan)
    for row, col in zip(*np.nonzero(~np.isnan(h))):
        expected[row, col] = eight(h, radius, row, col, -1 if negative else 1)
    np.testing.assert_allclose(got, expected, atol=2e-3)
    if radius == 1000:
        unlimited = openness(h, negative, azimuths=8)
        np.testing.assert_allclose(unlimited, got, atol=1e-4)
