"""Ambient occlusion by shadow maps: closed forms, Monte Carlo on real ground, tiles, holes, rows that run north."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from orograph.errors import UsageError
from orograph.lighting.gpu import occlusion_maps
from orograph.lighting.gpu.occlusion_maps import Settings, directions
from orograph.lighting.occlusion import ambient_occlusion

pytestmark = pytest.mark.usefixtures("device")
CELL = np.diag([10.0, -10.0])


def maps(heights: np.ndarray, linear: np.ndarray = CELL, rays: int = 256, **how: object) -> np.ndarray:
    return ambient_occlusion(heights, linear, method="shadow-maps", rays=rays, **how)


def test_directions_have_their_density():
    """Of density (1 + z) / 4π: a share of ((1 + z) / 2)² lies below z, and weights 1 / density make the sphere."""
    omega = directions(4000)
    np.testing.assert_allclose(np.linalg.norm(omega, axis=1), 1)
    for z in (-0.5, 0.0, 0.7):
        assert (omega[:, 2] < z).mean() == pytest.approx(((1 + z) / 2) ** 2, abs=1e-3)
    weights = 4 * math.pi / (1 + omega[:, 2])
    for normal in ((0, 0, 1), (0.6, 0, 0.8), (0, -0.9, math.sqrt(0.19))):
        cosine = np.maximum(omega @ normal, 0)
        assert (cosine * weights).mean() == pytest.approx(math.pi, rel=3e-3)


def test_planes_see_all_of_their_hemisphere():
    y, x = np.mgrid[:11, :13]
    for linear in (CELL, np.diag([10.0, 10.0]), np.array([[8.0, 3.0], [2.0, -11.0]])):
        for plane in (0 * x, 3 * x, 12 * x - 7 * y):
            for how in ({"radius": 60.0, "rho": "linear"}, {}):
                np.testing.assert_allclose(maps(plane.astype(np.float32), linear, 16, **how), 1.0, atol=2e-4)


@pytest.mark.parametrize("distance", [3, 7, 15])
def test_a_tall_wall(distance):
    """The closed forms of the CPU's test: a segment of the unit disc beyond k = d / R."""
    h = np.zeros((41, 20), np.float32)
    h[:, :2] = 1e3
    radius, d = 200.0, 10.0 * distance
    k = d / radius
    root = math.sqrt(1 - k * k)
    segment = (math.acos(k) - k * root) / math.pi
    volume = segment - 2 * k / math.pi * (math.log((1 + root) / k) - root)
    for rho, lost in (("step", segment), ("linear", volume)):
        got = maps(h, rays=512, radius=radius, rho=rho)[20, 2 + distance]
        assert got == pytest.approx(1 - lost, abs=0.012)


def test_the_wall_stands_on_its_side():
    """Where a step is east, directions are not mirrored: a sample west of it sees less than one east of it."""
    h = np.zeros((40, 40), np.float32)
    h[:, 20:] = 50.0
    h[:8] += 80.0  # and in the north
    for linear in (CELL, np.diag([10.0, 10.0]), np.diag([-10.0, 10.0]), np.array([[0.0, 10.0], [10.0, 0.0]])):
        got = maps(h, linear, radius=150.0)
        expected = ambient_occlusion(h, linear, radius=150.0, azimuths=64)
        assert expected.min() < 0.7
        assert np.abs(got - expected).mean() < 0.006 and np.abs(got - expected).max() < 0.08


@pytest.mark.parametrize("slope", [0.5, 1.5])
def test_the_bottom_of_an_endless_valley(slope):
    """A = 1 / √(1 + slope²), of a valley that is endless within R."""
    x = np.abs(np.arange(41) - 20)
    h = np.tile(10 * slope * x, (41, 1)).astype(np.float32)
    # Rays that leave over the rims, 200 m away, or at the ends are free in both.
    expected = ambient_occlusion(h, CELL, radius=190.0, azimuths=180)[20, 20]
    assert expected == pytest.approx(1 / math.sqrt(1 + slope * slope), abs=0.05)
    assert maps(h, rays=512, radius=190.0)[20, 20] == pytest.approx(expected, abs=8e-3)


def test_pits_and_a_cone():
    """A cylinder's floor; a hemisphere, which by Lambert's law sees half everywhere; a cone, which is convex."""
    y, x = np.mgrid[:41, :41] - 20
    r = np.hypot(x, y)
    pit = np.where(r > 15, 250.0, 0.0).astype(np.float32)
    a = 155.0
    assert maps(pit, rays=128, radius=500.0)[20, 20] == pytest.approx(a * a / (a * a + 250.0**2), abs=0.04)
    bowl = (-np.sqrt(np.maximum(190.0**2 - (10 * r) ** 2, 0))).astype(np.float32)
    got = maps(bowl, rays=256, radius=500.0)
    assert got[20, 20] == pytest.approx(0.5, abs=0.03) and got[r < 10].mean() == pytest.approx(0.5, abs=0.03)
    cone = (200 - 8 * r).astype(np.float32)
    np.testing.assert_allclose(maps(cone, rays=64, radius=300.0), 1.0, atol=0.02)


@pytest.fixture(scope="module")
def truth(small_real_ground: tuple[np.ndarray, np.ndarray]) -> Callable[[str | Callable], np.ndarray]:
    h, linear = small_real_ground

    def cast(rho: str | Callable) -> np.ndarray:
        return ambient_occlusion(h, linear, radius=600.0, rho=rho, method="rays", rays=4096)

    return cast


@pytest.mark.cases(1)
@pytest.mark.parametrize("rho", ["step", "linear", "root"])
def test_real_ground_against_4096_rays(small_real_ground, truth, rho):
    h, linear = small_real_ground
    law = (lambda x: np.sqrt(x / 600.0)) if rho == "root" else rho
    d = (maps(h, linear, radius=600.0, rho=law) - truth(law)).astype(float)
    assert abs(d.mean()) < 2.5e-3 and np.abs(d).mean() < 6e-3 and np.abs(d).max() < 0.045


def test_more_directions_and_texels_come_closer(small_real_ground, monkeypatch):
    h, linear = small_real_ground
    h = np.ascontiguousarray(h[:32, :32])
    expected = ambient_occlusion(h, linear, radius=300.0, azimuths=64)
    errors = []
    for texels, rays in ((1.5, 24), (4.0, 128)):
        monkeypatch.setattr(occlusion_maps, "SETTINGS", Settings(texels=texels))
        errors.append(np.abs(maps(h, linear, rays, radius=300.0) - expected).mean())
    assert errors[1] < 0.6 * errors[0] and errors[1] < 8e-3


def test_nothing_depends_on_tiles_and_layers(monkeypatch):
    """Texels are the terrain's, not the tile's; layers run out and are doubled."""
    rng = np.random.default_rng(0)
    h = (2 * rng.normal(size=(30, 40)).cumsum(0).cumsum(1)).astype(np.float32)
    h[12:16, 20:22] = np.nan
    for how in ({"radius": 150.0}, {"radius": 90.0, "rho": "linear"}):
        made = []
        for tile, layers in ((128, 8), (16, 3)):
            monkeypatch.setattr(occlusion_maps, "SETTINGS", Settings(tile=tile, layers=layers))
            made.append(maps(h, rays=24, **how))
        assert (np.isnan(made[0]) == np.isnan(h)).all()
        d = np.abs(made[0] - made[1])[~np.isnan(h)]
        # A texel's border or an edge may round to the other side at single samples, for one direction of 24.
        assert d.max() < 0.1 and (d > 1e-5).mean() < 0.01


def test_cliffs_of_thousands_of_texels_get_taller_texels():
    h = np.zeros((20, 12), np.float32)
    h[:, 6:] = 5e4
    got = maps(h, rays=32, radius=100.0)
    expected = ambient_occlusion(h, CELL, radius=100.0)
    assert np.abs(got - expected)[:, :5].mean() < 0.03


def test_holes_do_not_occlude_and_ground_behind_them_does():
    h = np.zeros((30, 30), np.float32)
    h[:, 15:] = np.nan
    np.testing.assert_array_equal(maps(h, rays=64, radius=99.0)[:, :15], 1)
    h = np.zeros((41, 41), np.float32)
    h[:, 25:] = 60.0
    h[:, 24:28] = np.nan  # the wall's face is missing, the top behind it is not
    got, expected = (
        f(h, radius=150.0) for f in (maps, lambda *a, **k: ambient_occlusion(*a, CELL, method="rays", rays=1024, **k))
    )
    assert expected[20, 22] < 0.93
    assert np.nanmax(np.abs(got - expected)) < 0.06
    for size in ((1, 1), (1, 9), (9, 1), (2, 2)):
        np.testing.assert_array_equal(maps(np.ones(size, np.float32), rays=16, radius=30.0), 1)


def test_what_cannot_be():
    with pytest.raises(UsageError, match="direction"):
        maps(np.zeros((4, 4), np.float32), rays=0)
    with pytest.raises(UsageError, match="radius"):
        maps(np.zeros((4, 4), np.float32), rho="linear")


def test_ground_that_no_direction_looks_at_is_open():
    """One direction, from the north-west or so, and a slope that turns away from it."""
    omega = directions(1)[0]
    y, x = np.mgrid[:9, :9]
    away = 40.0 * (omega[0] * x - omega[1] * y)  # rises towards the light, four times as steep as cells are wide
    np.testing.assert_array_equal(maps(away.astype(np.float32), rays=1), 1.0)
