"""Normals, slope, aspect and hillshade against closed forms and the conventions of GDAL and xDEM; pitfalls by name."""

from __future__ import annotations

import math

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

import orograph.store
from orograph.dem import Dem
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lighting.arrays import context_of
from orograph.lighting.context import Context, Options
from orograph.lighting.products import compute
from orograph.store import MemoryTerrain

THIRTY = np.array([[30.0, 0], [0, -30.0]])


def of(name: str, heights: np.ndarray, linear: np.ndarray = THIRTY, **options) -> np.ndarray:
    return compute(context_of(heights, linear, Options(**options)), name)


def plane(east: float, north: float, linear: np.ndarray = THIRTY, shape: tuple[int, int] = (9, 11)) -> np.ndarray:
    row, col = np.indices(shape)
    x, y = linear[0, 0] * col + linear[0, 1] * row, linear[1, 0] * col + linear[1, 1] * row
    return (east * x + north * y).astype(np.float32)


def test_cell_size_is_not_forgotten():
    h = np.arange(9, dtype=np.float32)[None].repeat(9, 0) * 30  # 30 m per cell of 30 m
    np.testing.assert_allclose(of("slope", h), 45.0, atol=1e-4)
    np.testing.assert_allclose(of("slope", h, THIRTY * 10), math.degrees(math.atan(0.1)), atol=1e-4)


def test_rectangular_cells_are_not_taken_for_square():
    linear = np.array([[10.0, 0], [0, -40.0]])
    np.testing.assert_allclose(of("slope", plane(0.0, 1.0, linear), linear), 45.0, atol=1e-4)
    np.testing.assert_allclose(of("aspect", plane(-1.0, -1.0, linear), linear), 45.0, atol=1e-3)


def test_azimuth_is_not_measured_from_east():
    # Ground that falls to the east faces 90°, to the north 0°: GDAL's and xDEM's aspect.
    for falls_east, falls_north, azimuth in (
        (1, 0, 90),
        (0, 1, 0),
        (-1, 0, 270),
        (0, -1, 180),
        (1, 1, 45),
        (-1, 1, 315),
    ):
        np.testing.assert_allclose(of("aspect", plane(-falls_east, -falls_north)), azimuth, atol=1e-3)


def test_rows_are_not_taken_for_north():
    falls_south = -np.arange(9, dtype=np.float32)[:, None].repeat(9, 1) * 30  # lower in later rows
    np.testing.assert_allclose(of("aspect", falls_south), 180.0)
    np.testing.assert_allclose(of("aspect", falls_south, np.array([[30.0, 0], [0, 30.0]])), 0.0)  # south-up
    shade = of("hillshade", falls_south, sun=(180.0, 45.0))
    np.testing.assert_allclose(shade, 1.0, atol=1e-6)


def test_degrees_are_not_taken_for_metres():
    # 0.001° cells at 60° north: a plane of 45° towards the east.
    cell = 0.001
    col = np.indices((80, 80))[1]
    metres = 111_412.84 * math.cos(math.radians(59.96)) * cell
    h = (col * metres).astype(np.float32)
    dem = Dem(h, Grid(h.shape, Affine(cell, 0, 9.0, 0, -cell, 60.0), CRS.from_epsg(4326)))
    slope = compute(Context(orograph.store.terrain(dem)), "slope")[0]
    inner = slope[slope.shape[0] // 2 - 5 : slope.shape[0] // 2 + 5, slope.shape[1] // 2 - 5 : slope.shape[1] // 2 + 5]
    np.testing.assert_allclose(inner, 45.0, atol=0.5)
    with pytest.raises(UsageError, match="degrees"):
        MemoryTerrain(h, dem.grid, "degrees")


def test_heights_are_not_scaled_by_accident():
    h = plane(0.2, 0.1)
    a, b = of("hillshade", h, exaggeration=1.0), of("hillshade", h * 3)
    np.testing.assert_allclose(of("hillshade", h, exaggeration=3.0), b, atol=1e-6)
    assert not np.allclose(a, b)


def test_hillshade_is_lamberts_cosine():
    h = plane(0.3, -0.4)
    n = np.array([-0.3, 0.4, 1.0]) / math.sqrt(1.25)
    for azimuth, altitude in ((315, 45), (90, 10), (200, 80), (0, 90)):
        a, t = math.radians(azimuth), math.radians(altitude)
        light = np.array([math.sin(a) * math.cos(t), math.cos(a) * math.cos(t), math.sin(t)])
        np.testing.assert_allclose(of("hillshade", h, sun=(azimuth, altitude)), max(0.0, n @ light), atol=1e-6)


def test_hillshade_is_gdals():
    """GDAL's formula (gdaldem.cpp, after Burrough 1986): sin h cos s + cos h sin s cos(azimuth − aspect)."""
    rng = np.random.default_rng(3)
    h = (rng.normal(size=(40, 50)).cumsum(0).cumsum(1) * 2).astype(np.float32)
    slope, aspect = np.radians(of("slope", h)[0]), np.radians(of("aspect", h)[0])
    altitude, azimuth = math.radians(30), math.radians(250)
    cosine = math.sin(altitude) * np.cos(slope) + math.cos(altitude) * np.sin(slope) * np.cos(azimuth - aspect)
    np.testing.assert_allclose(of("hillshade", h, sun=(250.0, 30.0))[0], np.maximum(cosine, 0), atol=2e-6)


def test_slope_and_aspect_are_zevenbergen_and_thornes():
    rng = np.random.default_rng(4)
    h = rng.normal(size=(20, 30)).cumsum(0).cumsum(1).astype(np.float32)
    down, across = np.gradient(h.astype(float), 30.0)
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(
        of("slope", h)[0][inner], np.degrees(np.arctan(np.hypot(across, down)))[inner], atol=1e-4
    )
    expected = np.degrees(np.arctan2(-across, down)) % 360
    apart = np.abs(of("aspect", h)[0] - expected)[inner]
    assert np.minimum(apart, 360 - apart).max() < 1e-2


def test_several_lights_are_their_weighted_mean():
    h = plane(0.5, 0.2)
    lights = ((315.0, 45.0, 3.0), (45.0, 30.0, 1.0))
    each = [of("hillshade", h, sun=light[:2]) for light in lights]
    np.testing.assert_allclose(of("hillshade", h, lights=lights), (3 * each[0] + each[1]) / 4, atol=1e-6)
    with pytest.raises(UsageError, match="weights"):
        of("hillshade", h, lights=((0.0, 0.0, 0.0),))


def test_normals_are_unit_and_level_ground_has_no_aspect():
    n = of("normal", plane(0.3, -0.4))
    np.testing.assert_allclose(n[:, 4, 4], np.array([-0.3, 0.4, 1]) / math.sqrt(1.25), atol=1e-6)
    assert np.isnan(of("aspect", np.zeros((4, 5), np.float32))).all()
    assert (of("slope", np.zeros((4, 5), np.float32)) == 0).all()
    north = of("aspect", plane(0.0, -0.4))  # falls due north
    assert (north == 0).all() and not np.signbit(north).any()


def test_missing_samples_stay_missing_and_blocks_leave_no_seam():
    h = np.random.default_rng(6).normal(size=(700, 300)).cumsum(1).astype(np.float32)
    h[250:260, 20:30] = np.nan
    for name in ("slope", "aspect", "normal", "hillshade"):
        got = of(name, h)
        assert np.array_equal(np.isnan(got[0]), np.isnan(h))
        part = of(name, h[200:330])
        np.testing.assert_array_equal(got[:, 201:329], part[:, 1:-1])
