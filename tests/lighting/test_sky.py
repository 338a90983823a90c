"""Sky-view factor and visible sky as products: closed forms on tilted ground, published maps, any shape of cells."""

from __future__ import annotations

import math

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph.geo.grid import Grid
from orograph.lighting.arrays import context_of
from orograph.lighting.context import Context, Options
from orograph.lighting.products import compute
from orograph.lighting.sky import arctangent
from orograph.store.memory import MemoryTerrain

SQUARE = np.array([[1.0, 0.0], [0.0, -1.0]])


def of(name: str, h: np.ndarray, linear: np.ndarray = SQUARE, **options) -> np.ndarray:
    return compute(context_of(h.astype(np.float32), linear, Options(**options)), name)[0]


def test_the_arctangent_is_one():
    import numba

    kernel = numba.njit(lambda t: arctangent(t), error_model="numpy")
    t = np.concatenate([np.linspace(0, 3, 2000), np.geomspace(1e-6, 1e6, 500), [0.0, 1.0, np.inf]]).astype(np.float32)
    got = np.array([kernel(v) for v in t])
    assert np.abs(got - np.arctan(t.astype(float))).max() < 3e-7


@pytest.mark.parametrize("year", [2004, 2012, 2016])
def test_published_visible_sky(shared_data, year):
    """GRASS r.skyview, 16 directions, 1 − mean sin h, of three surveys of Fort Bragg at 1 m."""
    import rasterio

    folder = shared_data / "fortbragg-1m-dem-ortho"
    with rasterio.open(folder / f"elevation_{year}.tif") as dem, rasterio.open(folder / f"skyview_{year}.tif") as sky:
        h, truth = dem.read(1), sky.read(1)
    apart = np.abs(of("visible-sky", h, azimuths=16) - truth)[40:-40, 40:-40]
    assert np.nanmean(apart) < 0.003


@pytest.mark.parametrize("linear", [SQUARE, [[2.0, 0], [0, -0.7]], [[0.8, 0.6], [0.6, -0.8]], [[1.0, 0], [0, 1.0]]])
def test_tilted_planes_on_any_cells(linear):
    linear = np.asarray(linear, float)
    row, col = np.indices((41, 41))
    x, y = linear[0, 0] * col + linear[0, 1] * row, linear[1, 0] * col + linear[1, 1] * row
    for p, q in ((0.4, 0.0), (0.5, -0.8)):
        own = of("sky-view-factor", p * x + q * y, linear, azimuths=32)[20, 20]
        assert own == pytest.approx((1 + math.cos(math.atan(math.hypot(p, q)))) / 2, abs=3e-4)


def test_planes_seen_from_a_horizontal_surface():
    # On a plane of 45° the horizon rises as tan h = |sin φ| over half of the azimuths: mean sin² h = (1 − √½) / 2.
    h = np.indices((61, 61))[1]
    assert of("sky-view-horizontal", h, azimuths=64)[30, 30] == pytest.approx((1 + math.sqrt(0.5)) / 2, abs=1e-3)


@pytest.mark.stress
def test_floor_and_walls_of_an_infinite_valley():
    # In an endless trench an element sees (sin b − sin a) / 2 of what lies between the angles a and b from its normal.
    h = np.abs(np.arange(-200, 201))[None].repeat(2401, 0)  # walls of 45°, rims 200 m away
    for name in ("sky-view-horizontal", "sky-view-factor"):
        assert of(name, h, azimuths=64)[1200, 200] == pytest.approx(math.sin(math.radians(45)), abs=3e-3)
    # Half-way up a wall: from its own plane down to the other rim, 300 m across and 100 m up.
    far = math.radians(45) - math.atan2(100, 300)
    assert of("sky-view-factor", h, azimuths=64)[1200, 300] == pytest.approx((1 + math.sin(far)) / 2, abs=3e-3)


def test_the_horizon_in_degrees_and_on_a_round_body():
    h = np.zeros((5, 400))
    h[2, 399] = 1000.0
    linear = np.array([[100.0, 0], [0, -100.0]])
    east = compute(context_of(h, linear, Options(azimuths=4)), "horizon")[1]
    assert east[2, 0] == pytest.approx(math.degrees(math.atan(1000 / 39_900)), abs=1e-4)
    bent = compute(context_of(h, linear, Options(azimuths=4, curvature=True)), "horizon")[1]
    dropped = 1000 - 0.87 * 39_900**2 / (2 * 6_371_008.8)
    assert bent[2, 0] == pytest.approx(math.degrees(math.atan(dropped / 39_900)), abs=1e-3)


@pytest.mark.parametrize(("ball", "k"), [(6_371_000, 0.13), (1_737_400, 0.0), (3_389_500, 0.0)])
def test_there_is_no_air_on_the_moon(ball, k):
    h = np.zeros((3, 400), np.float32)
    h[1, 399] = 1000.0
    terrain = MemoryTerrain(
        h, Grid(h.shape, Affine(30, 0, 0, 0, -30, 0), CRS.from_proj4(f"+proj=eqc +R={ball}")), "ball"
    )
    for given, expected in ((None, k), (0.2, 0.2)):
        context = Context(terrain, Options(azimuths=4, curvature=True, refraction=given))
        dropped = 1000 - (1 - expected) * 11_970**2 / (2 * ball)
        found = compute(context, "horizon")[1, 1, 0]
        assert found == pytest.approx(math.degrees(math.atan(dropped / 11_970)), abs=2e-4)


def test_a_radius_sees_more_sky():
    rng = np.random.default_rng(0)
    h = rng.normal(size=(80, 90)).cumsum(0).cumsum(1)
    near, far = of("visible-sky", h, azimuths=8, radius=5.0), of("visible-sky", h, azimuths=8)
    assert (near >= far - 1e-6).all() and (near > far + 1e-3).any()
