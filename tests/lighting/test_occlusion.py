"""Ambient occlusion by both methods against closed forms, against each other on real ground, and in pieces."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.errors import UsageError
from orograph.lighting import occlusion
from orograph.lighting.occlusion import ambient_occlusion, edges
from orograph.lighting.rho import transmission

CELL = np.diag([10.0, -10.0])


def both(heights: np.ndarray, linear: np.ndarray = CELL, **how: object) -> list[np.ndarray]:
    return [
        ambient_occlusion(heights, linear, method="horizon", azimuths=90, **how),
        ambient_occlusion(heights, linear, method="rays", rays=512, **how),
    ]


def test_planes_see_all_of_their_hemisphere():
    """Light also comes from below the horizon: an inclined plane's A is 1, whatever the cells."""
    y, x = np.mgrid[:11, :13]
    for linear in (CELL, np.array([[8.0, 3.0], [2.0, -11.0]])):
        for plane in (0 * x, 3 * x, 12 * x - 7 * y):
            for how in ({"radius": 60.0}, {"radius": 60.0, "rho": "linear"}):
                for a in both(plane.astype(np.float32), linear, **how):
                    np.testing.assert_allclose(a, 1.0, atol=2e-6)
            swept = ambient_occlusion(plane.astype(np.float32), linear)
            np.testing.assert_allclose(swept[2:-2, 2:-2], 1.0, atol=3e-3 if plane.any() else 1e-6)


@pytest.mark.parametrize("distance", [3, 7, 15])
def test_a_tall_wall(distance):
    """Projected on the ground, directions that reach an endless wall fill the segment x > k = d / R of the unit disc.

    Step: it is lost. Linear: ∫ (1 − k / x) over it is.
    """
    h = np.zeros((51, 24), np.float32)
    h[:, :2] = 1e5
    radius, d = 200.0, 10.0 * distance
    k = d / radius
    root = math.sqrt(1 - k * k)
    segment = (math.acos(k) - k * root) / math.pi
    volume = segment - 2 * k / math.pi * (math.log((1 + root) / k) - root)
    for rho, lost in (("step", segment), ("linear", volume)):
        walked, cast = (a[25, 2 + distance] for a in both(h, radius=radius, rho=rho))
        assert walked == pytest.approx(1 - lost, abs=2e-3)
        assert cast == pytest.approx(1 - lost, abs=0.01)


def test_a_round_pit():
    """In the middle of a level floor of radius a with a wall of height H: A = a² / (a² + H²)."""
    y, x = np.mgrid[:61, :61] - 30
    r = np.hypot(x, y)
    h = np.where(r > 20, 250.0, 0.0).astype(np.float32)
    a = 10 * np.mean([20.0, 21.0])  # the wall's facets stand between the last sample of the floor and the next
    expected = a * a / (a * a + 250.0**2)
    swept = ambient_occlusion(h, CELL, azimuths=90)[30, 30]
    assert swept == pytest.approx(expected, abs=0.03)
    for got in both(h, radius=500.0):
        assert got[30, 30] == pytest.approx(expected, abs=0.03)
        assert got[30, 30] == pytest.approx(swept, abs=0.015)


@pytest.mark.parametrize("slope", [0.3, 1.0, 3.0])
def test_the_bottom_of_an_endless_valley(slope):
    """Its horizon has the tangent slope · |cos φ|: A = 1 − mean sin² = 1 / √(1 + slope²)."""
    x = np.abs(np.arange(201) - 100)
    h = np.tile(10 * slope * x, (401, 1)).astype(np.float32)
    swept = ambient_occlusion(h, CELL, azimuths=360)[200, 100]
    # The valley is not endless: 2 km to its ends.
    assert swept == pytest.approx(1 / math.sqrt(1 + slope * slope), abs=0.01)


@pytest.mark.parametrize("rho", ["step", "linear", np.sqrt])
def test_both_methods_agree_on_real_ground(real_ground, rho):
    """The walk is exact but for the number of azimuths, rays but for their number: 2,048 leave 4e-3 at worst."""
    h, linear = real_ground
    how = {"radius": 600.0, "rho": (lambda x: np.sqrt(x / 600.0)) if rho is np.sqrt else rho}
    walked = ambient_occlusion(h, linear, azimuths=64, **how)
    cast = ambient_occlusion(h, linear, method="rays", rays=1024, **how)
    assert walked.min() < 0.93
    d = walked - cast
    assert abs(d.mean()) < 1e-4 and np.abs(d).mean() < 2e-3 and np.abs(d).max() < 0.015


def test_sweeps_and_walks_agree_where_the_radius_covers_the_terrain(real_ground):
    h, linear = real_ground
    walked = ambient_occlusion(h, linear, radius=2200.0, azimuths=64)
    swept = ambient_occlusion(h, linear, azimuths=64)
    # Sweeps interpolate heights and horizons between samples; walks meet every edge.
    assert np.abs(walked - swept).mean() < 5e-3


def test_nothing_depends_on_blocks_and_threads(monkeypatch):
    rng = np.random.default_rng(0)
    h = (rng.normal(size=(70, 90)).cumsum(0).cumsum(1)).astype(np.float32)
    h[30:34, 40:42] = np.nan
    for how in ({"radius": 150.0}, {"radius": 90.0, "rho": "linear"}, {"radius": 150.0, "method": "rays", "rays": 32}):
        monkeypatch.setattr(occlusion, "_BLOCK", 256)
        monkeypatch.setattr(occlusion, "_WIDTH", 256)
        whole = ambient_occlusion(h, CELL, jobs=1, **how)
        assert (np.isnan(whole) == np.isnan(h)).all()
        monkeypatch.setattr(occlusion, "_BLOCK", 27)
        monkeypatch.setattr(occlusion, "_WIDTH", 31)
        np.testing.assert_array_equal(ambient_occlusion(h, CELL, jobs=3, **how), whole)


@pytest.mark.stress
def test_on_rough_ground_sweeps_see_what_rays_see():
    """Noise from sample to sample: most of what hides the sky stands in a sample's own cell."""
    y, x = np.mgrid[:61, :83]
    noise = np.random.default_rng(0).normal(0, 0.06, y.shape)
    h = (250 * (np.sin(x / 9) * np.cos(y / 7) + 0.5 * np.sin(x / 3.1 + y / 4.3) + noise)).astype(np.float32)
    linear = np.diag([30.0, -30.0])
    swept = ambient_occlusion(h, linear, method="horizon", azimuths=64)[8:-8, 8:-8]
    off = swept - ambient_occlusion(h, linear, method="rays", rays=2048)[8:-8, 8:-8]
    assert abs(off.mean()) < 0.004 and np.abs(off).mean() < 0.01


def test_seeds_change_rays_and_holes_do_not_occlude():
    h = np.zeros((30, 30), np.float32)
    h[:, 15:] = 60.0
    one, two, same = (ambient_occlusion(h, CELL, radius=99.0, method="rays", rays=16, seed=s) for s in (1, 2, 1))
    np.testing.assert_array_equal(one, same)
    assert (one != two).any()
    assert ambient_occlusion(h, CELL, radius=99.0)[10, 10] < 0.95
    h[:, 15:] = np.nan
    for a in both(h, radius=99.0):
        np.testing.assert_array_equal(a[:, :15], 1)
    for size in ((1, 1), (1, 9), (9, 1), (2, 2)):
        for a in both(np.ones(size, np.float32), radius=30.0):
            np.testing.assert_array_equal(a, 1)


def test_edges_lie_on_the_triangulation():
    """Each crossing is a point of the azimuth's line on an edge between neighbours; diagonals join even samples."""
    linear = np.array([[7.0, 2.0], [1.0, -9.0]])
    for azimuth in (0.0, 45.0, 90.0, 133.0, 271.5, 359.0):
        starts, r1, c1, r2, c2, f, s = edges(linear, azimuth, 100.0)
        a = math.radians(azimuth)
        for parity in (0, 1):
            k = slice(starts[parity], starts[parity + 1])
            assert (np.diff(s[k]) > 0).all() and s[k][-1] >= 100.0
            at = np.stack([c1[k] + f[k] * (c2 - c1)[k], r1[k] + f[k] * (r2 - r1)[k]])
            np.testing.assert_allclose(linear @ at, s[k] * np.array([[math.sin(a)], [math.cos(a)]]), atol=1e-6)
            diagonal = (np.abs(r2 - r1)[k] == 1) & (np.abs(c2 - c1)[k] == 1)
            assert ((r1[k] + c1[k])[diagonal] % 2 == parity).all()
            assert (np.maximum(np.abs(r2 - r1), np.abs(c2 - c1))[k] <= 1).all()


def test_what_is_no_rho():
    assert transmission("step", None).radius == math.inf
    for rho, radius in (("cubic", 10.0), ("linear", None), ("step", -1.0), (lambda x: x, 10.0), (np.sqrt, None)):
        with pytest.raises(UsageError):
            transmission(rho, radius)
    with pytest.raises(UsageError):
        ambient_occlusion(np.zeros((4, 4)), CELL, method="voxels", radius=5.0)
    with pytest.raises(UsageError):
        ambient_occlusion(np.zeros((4, 4)), CELL, method="rays", rays=0)
    with pytest.raises(UsageError):
        ambient_occlusion(np.zeros((4, 4)), np.zeros((2, 2)))


@pytest.mark.stress
def test_what_does_not_fit_in_memory_says_so():
    from orograph.lighting.arrays import context_of
    from orograph.lighting.context import Options
    from orograph.lighting.products import product

    options = Options(radius=1e6, more={"rho": "linear"})
    context = context_of(np.zeros((1500, 1500), np.float32), CELL, options, jobs=2, max_memory=64 << 20)
    with pytest.raises(UsageError, match="`max_memory`"):
        next(product("ambient-occlusion").run(context))


def test_rays_and_walks_do_not_pretend_to_know_a_round_earth():
    from orograph.lighting.arrays import context_of
    from orograph.lighting.context import Options
    from orograph.lighting.products import product

    for name, radius, more in (
        ("ambient-occlusion", 50.0, {}),
        ("ambient-occlusion", None, {"method": "rays"}),
        ("aperture", 50.0, {"method": "rays"}),
    ):
        options = Options(radius=radius, curvature=True, more=more)
        with pytest.raises(UsageError, match="curvature"):
            next(product(name).run(context_of(np.zeros((9, 9), np.float32), CELL, options)))
