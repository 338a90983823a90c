"""The resampling kernels against SciPy's spline interpolation, plain NumPy and hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from orograph.dem.resample import box_means, sample

NAN = float("nan")


def resample(method: str, window: NDArray, u: NDArray, v: NDArray, row0: int = 0, col0: int = 0) -> NDArray:
    u, v = np.atleast_2d(np.asarray(u, float)), np.atleast_2d(np.asarray(v, float))
    out = np.full(u.shape, np.nan, np.float32)
    sample(method, np.asarray(window, np.float32), row0, col0, u, v, out)
    return out


def catmull_rom(window: NDArray, u: float, v: float) -> float:
    """The reference: Keys' kernel with a = -1/2, 16 weights."""

    def weight(t: float) -> float:
        t = abs(t)
        if t < 1:
            return 1.5 * t**3 - 2.5 * t**2 + 1
        return -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2 if t < 2 else 0.0

    j, i = int(np.floor(v)), int(np.floor(u))
    return sum(
        weight(v - r) * weight(u - c) * float(window[r, c]) for r in range(j - 1, j + 3) for c in range(i - 1, i + 3)
    )


@pytest.fixture
def rough() -> NDArray:
    return np.random.default_rng(1).normal(1000, 300, (40, 50)).astype(np.float32)


@pytest.mark.parametrize(("method", "order"), [("nearest", 0), ("bilinear", 1)])
def test_equals_scipy_inside(rough: NDArray, method: str, order: int) -> None:
    rng = np.random.default_rng(2)
    u, v = rng.uniform(0, 49, (60, 70)), rng.uniform(0, 39, (60, 70))
    truth = map_coordinates(rough.astype(float), [v, u], order=order)
    assert np.abs(resample(method, rough, u, v) - truth).max() < 1e-3  # float32 of heights below 4096


def test_cubic_equals_keys_kernel(rough: NDArray) -> None:
    rng = np.random.default_rng(3)
    u, v = rng.uniform(1, 47, 200), rng.uniform(1, 37, 200)
    truth = [catmull_rom(rough, a, b) for a, b in zip(u, v)]
    assert np.abs(resample("cubic", rough, u, v)[0] - truth).max() < 1e-3


@pytest.mark.parametrize("method", ["nearest", "bilinear", "cubic"])
@given(height=st.floats(-11000, 9000, width=32), seed=st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_constant_stays_constant_to_the_bit(method: str, height: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    window = np.full((9, 11), height, np.float32)
    window[rng.random(window.shape) < 0.3] = np.nan
    u, v = rng.uniform(-1, 11, (20, 20)), rng.uniform(-1, 9, (20, 20))
    got = resample(method, window, u, v)
    assert set(np.unique(got[~np.isnan(got)])) <= {np.float32(height)}


@pytest.mark.parametrize("method", ["nearest", "bilinear", "cubic"])
def test_value_exactly_where_the_nearest_sample_is_valid(method: str) -> None:
    rng = np.random.default_rng(4)
    window = rng.normal(size=(12, 15)).astype(np.float32)
    window[rng.random(window.shape) < 0.4] = np.nan
    u, v = rng.uniform(-1.5, 16, (80, 80)), rng.uniform(-1.5, 13, (80, 80))
    j, i = np.floor(v + 0.5).astype(int), np.floor(u + 0.5).astype(int)
    inside = (i >= 0) & (i < 15) & (j >= 0) & (j < 12)
    valid = np.zeros(u.shape, bool)
    valid[inside] = ~np.isnan(window[j[inside], i[inside]])
    assert np.array_equal(~np.isnan(resample(method, window, u, v)), valid)


def test_missing_neighbours_by_hand() -> None:
    # one missing: it takes the value beside it in its row
    assert resample("bilinear", [[10, NAN], [30, 40]], [0.25], [0.25])[0, 0] == 10 + (32.5 - 10) * 0.25
    # the other row missing: the value of the nearest row
    assert resample("bilinear", [[10, 20], [NAN, NAN]], [0.25], [0.25])[0, 0] == 12.5
    # only the nearest valid
    assert resample("bilinear", [[10, NAN], [NAN, NAN]], [0.25], [0.25])[0, 0] == 10
    # the nearest missing
    assert np.isnan(resample("bilinear", [[NAN, 20], [30, 40]], [0.25], [0.25])[0, 0])
    # half a sample beyond the rim counts as the rim
    assert resample("bilinear", [[10, 20], [30, 40]], [-0.4], [0.5])[0, 0] == 20


@pytest.mark.parametrize("method", ["nearest", "bilinear", "cubic"])
def test_keeps_what_is_there_and_ignores_nowhere(method: str, rough: NDArray) -> None:
    out = np.array([[5.0, np.nan, np.nan]], np.float32)
    sample(method, rough, 0, 0, np.array([[3.0, 3.0, np.nan]]), np.array([[4.0, 4.0, 4.0]]), out)
    assert out[0, 0] == 5 and out[0, 1] == rough[4, 3] and np.isnan(out[0, 2])


@pytest.mark.stress
@given(st.integers(0, 20), st.integers(0, 25), st.sampled_from(["nearest", "bilinear", "cubic"]))
@settings(max_examples=30, deadline=None)
def test_window_origin_does_not_matter(row0: int, col0: int, method: str) -> None:
    """A window that holds all neighbours gives the same bits as the whole raster."""
    rng = np.random.default_rng(5)
    whole = rng.normal(1000, 300, (40, 50)).astype(np.float32)
    u, v = rng.uniform(col0 + 1, col0 + 20, (9, 9)), rng.uniform(row0 + 1, row0 + 15, (9, 9))
    part = whole[row0 : row0 + 19, col0 : col0 + 24]
    assert np.array_equal(resample(method, part, u, v, row0, col0), resample(method, whole, u, v))


@given(st.integers(1, 6), st.integers(1, 6), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_box_means_equal_numpy(rows: int, cols: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    window = rng.normal(500, 100, (4 * rows, 5 * cols)).astype(np.float32)
    window[rng.random(window.shape) < 0.4] = np.nan
    out = np.empty((4, 5), np.float32)
    box_means(window, rows, cols, out)
    blocks = window.astype(float).reshape(4, rows, 5, cols).swapaxes(1, 2).reshape(4, 5, -1)
    valid = (~np.isnan(blocks)).sum(axis=2)
    truth = np.where(valid * 2 >= rows * cols, np.nansum(blocks, axis=2) / np.maximum(valid, 1), np.nan)
    assert np.allclose(out, truth, rtol=1e-6, equal_nan=True)
