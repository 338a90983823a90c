"""Horizons on nested windows: one window is ``lighting.horizon``; several lose only what coarseness loses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from orograph.lighting.horizon import horizon
from orograph.lighting.nested import sunward
from orograph.raycast.stack import HeightWindow

SQUARE = np.array([[30.0, 0.0], [0.0, -30.0]])
SHEARED = np.array([[20.0, 3.0], [1.0, -37.0]])


def rough(rows: int, cols: int, seed: int = 0) -> NDArray[np.float32]:
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(rows, cols)), 6)
    return (noise * 3000).astype(np.float32)


@pytest.mark.parametrize("linear", [SQUARE, SHEARED], ids=["square", "sheared"])
@pytest.mark.parametrize("azimuth", [0, 37, 45, 90, 135, 200, 271, 315])
def test_one_window_is_the_sweep(linear: NDArray[np.float64], azimuth: float) -> None:
    heights = rough(120, 170)
    ours = sunward([HeightWindow(0, 0, 0, heights)], linear, azimuth)[0]
    np.testing.assert_allclose(ours, horizon(heights, linear, azimuth), atol=2e-6)


@pytest.mark.parametrize("azimuth", [37, 90, 200, 315])
def test_a_wall_far_outside_the_window_is_seen(azimuth: float) -> None:
    """A level plain with a wall around it: the horizon's slope is the wall's height over its distance."""
    plain = np.zeros((512, 512), np.float32)
    plain[:24] = plain[-24:] = plain[:, :24] = plain[:, -24:] = 900.0
    coarse = plain.reshape(64, 8, 64, 8).mean((1, 3))
    inner = sunward(
        [HeightWindow(3, 0, 0, coarse), HeightWindow(0, 200, 200, plain[200:300, 200:300])], SQUARE, azimuth
    )[1]
    whole = horizon(plain, SQUARE, azimuth)[200:300, 200:300]
    assert whole.min() > 0.06
    np.testing.assert_allclose(inner, whole, rtol=0.06)  # a coarse sample in 170


def test_windows_may_leave_out_a_level_and_touch_borders() -> None:
    heights = rough(512, 512, 3)
    means = [heights.reshape(512 >> k, 1 << k, 512 >> k, 1 << k).mean((1, 3)) for k in range(6)]
    windows = [
        HeightWindow(5, 0, 0, means[5]),
        HeightWindow(2, 0, 0, means[2][:64, :64]),
        HeightWindow(0, 0, 0, heights[:100, :90]),
    ]
    for azimuth in (100.0, 170.0, 300.0):
        inner = sunward(windows, SQUARE, azimuth)[2]
        whole = horizon(heights, SQUARE, azimuth)[:100, :90]
        assert float(np.abs(inner - whole).mean()) < 0.02


def test_missing_ground_stands_in_nobodys_way() -> None:
    heights = np.zeros((60, 60), np.float32)
    heights[30] = np.nan
    heights[10] = 300.0
    out = sunward([HeightWindow(0, 0, 0, heights)], SQUARE, 0.0)[0]
    assert out[40, 30] == pytest.approx(300 / (30 * 30), rel=1e-5)


def test_threads_do_not_change_it() -> None:
    windows = [HeightWindow(2, 0, 0, rough(64, 64)), HeightWindow(0, 50, 40, rough(90, 110, 1))]
    one, two = (sunward(windows, SHEARED, 222.0, jobs=jobs) for jobs in (1, 2))
    for a, b in zip(one, two):
        np.testing.assert_array_equal(a, b)
