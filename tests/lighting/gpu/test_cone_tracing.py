"""Ambient occlusion by voxel cone tracing: closed forms, Monte Carlo on real ground, tiles, holes. Bounds are the
method's: an approximation, a few hundredths at worst on terrain, more where walls are thinner than voxels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.errors import UsageError
from orograph.lighting.gpu import cone_tracing
from orograph.lighting.gpu.cone_tracing import cones
from orograph.lighting.occlusion import ambient_occlusion

pytestmark = pytest.mark.usefixtures("device")
CELL = np.diag([10.0, -10.0])


def traced(heights: np.ndarray, linear: np.ndarray = CELL, **how: object) -> np.ndarray:
    return ambient_occlusion(heights, linear, method="cone-tracing", **how)


@pytest.mark.parametrize("about", [3, 10, 24, 40, 100])
def test_cones_fill_the_hemisphere(about):
    table, tangent = cones(about)
    assert len(table) == pytest.approx(about, abs=0.3 * about + 1)
    np.testing.assert_allclose(np.linalg.norm(table[:, :3], axis=1), 1, atol=1e-6)
    assert table[:, 3].sum() == pytest.approx(1, abs=1e-6)
    # The weights are the cosine's: the mean direction of light that arrives has the cosine 2 / 3 to the normal.
    assert (table[:, 3] * table[:, 2]).sum() == pytest.approx(2 / 3, abs=0.06)
    assert tangent > 0


def test_planes_are_open_but_for_what_filters_leave():
    y, x = np.mgrid[:25, :25]
    for linear in (CELL, np.diag([10.0, 10.0]), np.array([[8.0, 6.0], [6.0, -8.0]])):
        for plane in (3 * x, 12 * x - 7 * y):
            a = traced(plane.astype(np.float32), linear, radius=80.0)
            assert a.max() <= 1 and a[9:-9, 9:-9].min() > 0.998
    np.testing.assert_allclose(traced(np.zeros((20, 20), np.float32), radius=100.0), 1.0, atol=1e-6)


@pytest.mark.parametrize("distance", [3, 7, 15])
def test_a_tall_wall(distance):
    h = np.zeros((61, 44), np.float32)
    h[:, :22] = 1e3
    radius, d = 200.0, 10.0 * distance
    k = d / radius
    root = math.sqrt(1 - k * k)
    segment = (math.acos(k) - k * root) / math.pi
    volume = segment - 2 * k / math.pi * (math.log((1 + root) / k) - root)
    for rho, lost in (("step", segment), ("linear", volume)):
        assert traced(h, radius=radius, rho=rho)[30, 22 + distance] == pytest.approx(1 - lost, abs=0.03)


@pytest.mark.parametrize("slope", [0.5, 1.0, 1.5, 2.5])
def test_the_bottom_of_an_endless_valley(slope):
    """A = 1 / √(1 + slope²): its crease is narrower than any voxel."""
    x = np.abs(np.arange(61) - 30)
    h = np.tile(10 * slope * x, (61, 1)).astype(np.float32)
    assert traced(h, radius=190.0)[30, 30] == pytest.approx(1 / math.sqrt(1 + slope * slope), abs=0.05)


@pytest.mark.cases(3)
@pytest.mark.parametrize(("radius", "depth"), [(15, 200), (15, 100), (8, 80), (25, 300), (5, 100)])
def test_cylindrical_pits(radius, depth):
    """A = a² / (a² + H²) in the middle of the floor, its edge midway between samples. A cliff's top fills no more
    than half of a voxel that is as deep as wide, and hides all behind it."""
    y, x = np.mgrid[:81, :81] - 40
    pit = np.where(np.hypot(x, y) > radius, float(depth), 0.0).astype(np.float32)
    a = 10 * radius + 5
    expected = a * a / (a * a + depth**2)
    assert expected == pytest.approx(ambient_occlusion(pit, CELL, radius=600.0, azimuths=90)[40, 40], abs=0.02)
    assert traced(pit, radius=600.0)[40, 40] == pytest.approx(expected, abs=0.055)


def test_a_hemisphere_and_a_cone():
    y, x = np.mgrid[:81, :81] - 40
    r = np.hypot(x, y)
    # What lies outside is solid, but the raster's end is not: voxels want some ground behind the rim.
    bowl = (-np.sqrt(np.maximum(190.0**2 - (10 * r) ** 2, 0))).astype(np.float32)
    got = traced(bowl, radius=500.0)
    assert got[40, 40] == pytest.approx(0.5, abs=0.02) and got[r < 10].mean() == pytest.approx(0.5, abs=0.03)
    cone = (300 - 6 * r).astype(np.float32)
    assert traced(cone, radius=300.0)[r < 25].min() > 0.998


@pytest.mark.parametrize("rho", ["step", "linear"])
def test_real_ground_against_4096_rays(small_real_ground, rho):
    h, linear = small_real_ground
    expected = ambient_occlusion(h, linear, radius=600.0, rho=rho, method="rays", rays=4096)
    got = traced(h, linear, radius=600.0, rho=rho)
    d = (got - expected)[2:-2, 2:-2].astype(float)
    assert abs(d.mean()) < 3e-3 and np.abs(d).mean() < 4e-3 and np.abs(d).max() < 0.03
    assert np.corrcoef(got.ravel(), expected.ravel())[0, 1] > 0.97


def test_nothing_depends_on_tiles(monkeypatch):
    rng = np.random.default_rng(0)
    h = (rng.normal(size=(40, 50)).cumsum(0).cumsum(1)).astype(np.float32)
    h[20:24, 30:32] = np.nan
    for how in ({"radius": 150.0}, {"radius": 90.0, "rho": "linear"}):
        made = []
        for tile in (128, 22):
            monkeypatch.setattr(cone_tracing, "TILE", tile)
            made.append(traced(h, **how))
        assert (np.isnan(made[0]) == np.isnan(h)).all()
        assert np.nanmax(np.abs(made[0] - made[1])) < 4e-3


def test_holes_do_not_occlude():
    h = np.zeros((30, 30), np.float32)
    h[:, 15:] = np.nan
    np.testing.assert_allclose(traced(h, radius=99.0)[:, :15], 1, atol=1e-6)
    for size in ((1, 1), (1, 9), (9, 1), (2, 2)):
        np.testing.assert_allclose(traced(np.ones(size, np.float32), radius=30.0), 1, atol=1e-6)


def test_what_cannot_be():
    with pytest.raises(UsageError, match="cones"):
        traced(np.zeros((4, 4), np.float32), cones=2)
