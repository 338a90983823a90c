"""Gradients and normals against planes, whatever the cells: the pitfalls each by name."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.lighting.normal import gradient, normals


def plane(linear: np.ndarray, gx: float, gy: float, shape: tuple[int, int] = (12, 17)) -> np.ndarray:
    row, col = np.indices(shape)
    east = linear[0, 0] * col + linear[0, 1] * row
    north = linear[1, 0] * col + linear[1, 1] * row
    return (gx * east + gy * north).astype(np.float32)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(1, 100), st.floats(0.3, 3), st.floats(0, 360), st.booleans(), st.floats(-1, 1), st.floats(-1, 1)
)  # fmt: skip
def test_planes_are_exact_on_any_cells(cell, ratio, turn, south_up, gx, gy):
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    linear = np.array([[c, -s], [s, c]]) @ np.diag([cell, cell * ratio * (1 if south_up else -1)])
    east, north = gradient(plane(linear, gx, gy), linear)
    np.testing.assert_allclose(east, gx, atol=2e-4)
    np.testing.assert_allclose(north, gy, atol=2e-4)


def test_rows_run_south():
    linear = np.array([[10.0, 0], [0, -10.0]])
    _, north = gradient(np.repeat(np.arange(5.0)[:, None], 5, 1), linear)  # rises southward
    np.testing.assert_allclose(north, -0.1)


def test_missing_neighbours_leave_one_sided_differences():
    linear = np.array([[2.0, 0], [0, -2.0]])
    h = plane(linear, 0.5, -0.25)
    h[4, 5] = h[7, 7] = h[7, 9] = np.nan
    east, north = gradient(h, linear)
    assert np.isnan(east[4, 5]) and np.isnan(north[4, 5])
    ok = np.isfinite(h)
    ok[7, 8] = False
    np.testing.assert_allclose(east[ok], 0.5, atol=1e-6)
    np.testing.assert_allclose(north[np.isfinite(h)], -0.25, atol=1e-6)
    assert east[7, 8] == 0  # nothing known to either side


def test_normals_are_unit_and_lean_downhill():
    linear = np.array([[30.0, 0], [0, -30.0]])
    n = normals(plane(linear, 1.0, 0.0), linear)  # rises to the east at 45°
    np.testing.assert_allclose(n, np.broadcast_to([-np.sqrt(0.5), 0, np.sqrt(0.5)], n.shape), atol=1e-6)


def test_gdal_agrees_on_real_terrain(shared_data):
    import rasterio

    with rasterio.open(shared_data / "fortbragg-1m-dem-ortho" / "elevation_2016.tif") as dem:
        heights = dem.read(1)
    with rasterio.open(shared_data / "fortbragg-1m-dem-ortho" / "slope_2016.tif") as truth:
        slope = truth.read(1)
    east, north = gradient(heights, np.array([[1.0, 0], [0, -1.0]]))
    ours = np.degrees(np.arctan(np.hypot(east, north)))
    inner = np.s_[2:-2, 2:-2]
    # Published with GRASS's third-order (Horn) differences, ours are second-order: alike, not the same.
    assert np.nanmean(np.abs(ours - slope)[inner]) < 0.6
    assert np.corrcoef(ours[inner].ravel(), slope[inner].ravel())[0, 1] > 0.985
