"""Apertures against closed forms; light through them against a plain reference and rays on real ground."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.errors import UsageError
from orograph.lighting.aperture import CapField, Lamp, Lights, aperture, light, shade
from orograph.lighting.caps import exact_overlap
from orograph.lighting.shadow import shadow_rays
from orograph.lighting.sun import Sun

CELL = np.diag([10.0, -10.0])
WHITE = (1.0, 1.0, 1.0)


def angle(a: np.ndarray, b: tuple[float, float, float]) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(np.tensordot(np.asarray(b), a.astype(float), 1), -1, 1)))


def test_level_ground_sees_the_hemisphere():
    for how in ({}, {"method": "rays"}):
        caps = aperture(np.full((9, 9), 7.0, np.float32), CELL, **how)
        assert angle(caps[:3], (0, 0, 1)).max() < 0.1  # float32
        np.testing.assert_allclose(caps[3], 90.0, atol=0.01)


@pytest.mark.parametrize("beta", [10.0, 30.0, 60.0])
def test_an_inclined_plane_sees_a_lune(beta):
    """Between its own plane and the horizon, π − β wide: the mean leans by β / 2, and cos r = β / π."""
    x = np.mgrid[:41, :41][1]
    h = (x * 10 * math.tan(math.radians(beta))).astype(np.float32)  # rises to the east: the sky leans west
    caps = aperture(h, CELL, azimuths=180)[:, 20, 20]
    expected = math.radians(beta)
    assert math.degrees(math.atan2(-caps[0], caps[2])) == pytest.approx(beta / 2, abs=0.3)
    assert caps[3] == pytest.approx(math.degrees(math.acos(expected / math.pi)), abs=0.2)


def test_a_pit_and_a_wall():
    y, x = np.mgrid[:61, :61] - 30
    h = np.where(np.hypot(x, y) > 20, 250.0, 0.0).astype(np.float32)
    up = math.atan2(250.0, 205.0)
    for how in ({"azimuths": 90}, {"method": "rays", "rays": 4096}):
        caps = aperture(h, CELL, **how)[:, 30, 30] if "azimuths" in how else aperture(h[20:41, 9:52], CELL)[:, 10, 21]
        if "azimuths" in how:
            assert caps[2] > 0.999
            assert caps[3] == pytest.approx(math.degrees(math.acos(math.sin(up))), abs=1.5)
    tall = np.zeros((201, 41), np.float32)
    tall[:, :10] = 1e6
    for how in ({"azimuths": 180}, {"method": "rays", "rays": 2048}):
        caps = aperture(tall[::4] if "rays" in how else tall, CELL, **how)[:, 25 if "rays" in how else 100, 11]
        # A quarter of the sphere: the mean leans by 45°, and Ω = π makes the radius 60°.
        assert math.degrees(math.atan2(caps[0], caps[2])) == pytest.approx(45.0, abs=1.5)
        assert caps[3] == pytest.approx(60.0, abs=1.0)


def test_horizons_and_rays_make_the_same_caps(real_ground):
    h, linear = real_ground
    a, b = aperture(h, linear, azimuths=64), aperture(h, linear, method="rays", rays=512)
    inner = np.s_[:, 2:-2, 2:-2]
    apart = np.degrees(np.arccos(np.clip((a[:3] * b[:3]).sum(0), -1, 1)))[2:-2, 2:-2]
    # A ray sees over its own facet, a horizon not over the plane of the gradient: some degrees on sharp ridges.
    assert np.median(apart) < 1.2 and np.abs(a - b)[inner][3].mean() < 1.0


def plain(caps: np.ndarray, normal: np.ndarray, sun: Sun) -> float:
    """One sun through one cap, as the module's text says it, with vectors."""
    c, s = caps[:3].astype(float), np.array(sun.direction)
    r, b = math.radians(caps[3]), math.radians(sun.diameter / 2)
    d = math.acos(min(max(float(c @ s), -1), 1))
    whole = 2 * math.pi * (1 - math.cos(b))
    if d >= r + b:
        return 0.0
    along = min(max((r + d - b) / 2, 0), d)
    side = s - (c @ s) * c
    middle = c * math.cos(along) + side / max(float(np.linalg.norm(side)), 1e-12) * math.sin(along)
    return exact_overlap(d, r, b) / whole * max(float(normal @ middle), 0.0)


@pytest.mark.parametrize("diameter", [0.53, 12.0, 60.0])
def test_the_kernel_says_what_the_text_says(diameter):
    rng = np.random.default_rng(1)
    n = 200
    direction = rng.normal(size=(3, n)) + np.array([[0], [0], [2.0]])
    caps = np.concatenate([direction / np.linalg.norm(direction, axis=0), rng.uniform(5, 90, (1, n))]).astype(
        np.float32
    )
    slopes = rng.normal(size=(n, 2)) * 0.5
    normals = np.stack([-slopes[:, 0], -slopes[:, 1], np.ones(n)]) / np.sqrt(1 + (slopes**2).sum(1))
    points = np.stack([np.arange(n), np.zeros(n), np.zeros(n)], 1).astype(float)
    sun = Sun(70.0, 30.0, diameter)
    lights = Lights([(sun, (1.0, 0.5, 0.0)), (sun, (0.0, 0.5, 0.0))])
    got = light(CapField.of(caps[:, None], CELL), points, slopes, lights, exact=True)
    expected = [plain(caps[:, k], normals[:, k], sun) for k in range(n)]
    np.testing.assert_allclose(got[:, 0], expected, atol=3e-4)
    np.testing.assert_allclose(got[:, 0], got[:, 1], atol=1e-6)  # two suns add up
    assert (got[:, 2] == 0).all() and 20 < np.count_nonzero(got[:, 0]) < 200
    np.testing.assert_array_equal(
        light(CapField.of(caps[:, None], CELL), points, slopes, lights, exact=True, jobs=3), got
    )


def test_level_ground_under_sun_and_sky():
    h = np.zeros((5, 5), np.float32)
    h[0, 0] = np.nan
    caps = aperture(h, CELL)
    got = shade(caps, h, CELL, Lights([(Sun(200.0, 30.0), (2.0, 1.0, 0.0))], ambient=(0.0, 0.0, 1.0)))
    assert np.isnan(got[0, 0]).all() and np.isfinite(got[1:]).all()
    # The sky gives what the sun leaves: its disc covers sin² 0.265° · sin 30° of the level ground's light.
    np.testing.assert_allclose(got[3, 3], [1.0, 0.5, 1 - math.sin(math.radians(0.265)) ** 2 / 2], atol=1e-6)
    wide = shade(caps, h, CELL, Lights([(Sun(0.0, 90.0, 80.0), (0.0, 0.0, 0.0))], ambient=WHITE))
    np.testing.assert_allclose(wide[3, 3], 1 - math.sin(math.radians(40.0)) ** 2, atol=1e-5)


def test_lamps_fall_off_and_are_clipped():
    y, x = np.mgrid[:61, :61] - 30
    h = np.where(np.hypot(x, y) > 10, 200.0, 0.0).astype(np.float32)
    caps = aperture(h, CELL, azimuths=90)
    above = shade(caps, h, CELL, Lights(lamps=[Lamp(30, 30, 400.0, (1.6e5, 0, 0))]))
    assert above[30, 30, 0] == pytest.approx(1.0, rel=1e-5)
    assert (above[..., 1:] == 0).all()
    beside = Lights(lamps=[Lamp(60, 30, 60.0, WHITE)])  # behind the pit's wall
    assert shade(caps, h, CELL, beside)[30, 30].max() == 0
    assert shade(aperture(0 * h, CELL), 0 * h, CELL, beside)[30, 30, 0] == pytest.approx(60 / math.hypot(300, 60) ** 3)


def test_missing_caps_are_open_sky_and_bands_interpolate():
    caps = np.full((4, 3, 3), np.nan, np.float32)
    points, slopes = np.array([[1.2, 1.7, 5.0], [np.nan, 0, 0]]), np.zeros((2, 2))
    got = light(CapField.of(caps, CELL), points, slopes, Lights(ambient=WHITE))
    assert got[0] == pytest.approx(WHITE) and np.isnan(got[1]).all()
    caps[:] = np.array([0, 0, 1, 60.0])[:, None, None]
    caps[3, :, 2] = 30.0
    middle = light(CapField.of(caps, CELL), np.array([[1.5, 1.0, 0.0]]), slopes[:1], Lights(ambient=WHITE))
    rim = (math.cos(math.radians(60.0)) + math.cos(math.radians(30.0))) / 2
    assert middle[0, 0] == pytest.approx(1 - rim**2, abs=1e-6)


@pytest.mark.parametrize(("altitude", "diameter", "mean", "rms"), [(45, 0.53, 0.001, 0.02), (25, 10, 0.012, 0.05)])
def test_against_soft_shadows_by_rays(real_ground, altitude, diameter, mean, rms):
    """One cap per sample is an approximation; on Big Tujunga's slopes it is a good one but for low suns."""
    h, linear = real_ground
    sun = Sun(300.0, altitude, diameter)
    truth = shadow_rays(h, linear, sun, rays=64, cosine=True)
    caps = aperture(h, linear, azimuths=64)
    d = shade(caps, h, linear, Lights([(sun, WHITE)]))[..., 0] - truth
    assert np.abs(d).mean() < mean and np.sqrt((d**2).mean()) < rms
    assert truth.std() > 0.1


def test_blocks_threads_and_refusals():
    rng = np.random.default_rng(0)
    h = rng.normal(size=(40, 50)).cumsum(0).cumsum(1).astype(np.float32)
    h[3, 4] = np.nan
    for how in ({}, {"method": "rays", "rays": 16}):
        one = aperture(h, CELL, jobs=1, **how)
        np.testing.assert_array_equal(one, aperture(h, CELL, jobs=3, **how))
        assert np.isnan(one[:, 3, 4]).all() and np.isfinite(np.delete(one.reshape(4, -1), 3 * 50 + 4, 1)).all()
        np.testing.assert_allclose((one[:3].reshape(3, -1) ** 2).sum(0)[:100], 1, atol=1e-5)
        break
    for how in ({"method": "cones"}, {"method": "rays", "rays": 0}):
        with pytest.raises(UsageError):
            aperture(h, CELL, **how)


def test_a_radius_limits_rays():
    from orograph.lighting.arrays import context_of
    from orograph.lighting.context import Options
    from orograph.lighting.products import compute

    h = np.zeros((11, 41), np.float32)
    h[:, 30:] = 300.0
    radii = []
    for radius in (60.0, 200.0, None):
        context = context_of(h, CELL, Options(radius=radius, rays=500, more={"method": "rays"}))
        radii.append(compute(context, "aperture")[3, 5, 20])
    assert radii[0] == pytest.approx(90.0, abs=0.1) and radii[0] > radii[1] > radii[2]


@pytest.mark.parametrize("name", ["aperture", "insolation", "shadow", "ambient-occlusion"])
def test_products_are_the_same_on_disk_as_in_memory(name, real_ground, monkeypatch):
    from affine import Affine
    from pyproj import CRS

    from orograph.geo.grid import Grid
    from orograph.lighting.context import Context, Options
    from orograph.lighting.products import compute
    from orograph.lighting.raster import Canvas
    from orograph.store.memory import MemoryTerrain

    h, ((a, b), (d, e)) = real_ground
    terrain = MemoryTerrain(h, Grid(h.shape, Affine(a, b, 4e5, d, e, 3.8e6), CRS("EPSG:32611")), "ground")
    options = Options(azimuths=8, sun=(315.0, 18.0), more={"date": "2026-06-21", "strips": 2})
    whole = compute(Context(terrain, options, jobs=1), name)
    monkeypatch.setattr(Context, "canvas", lambda self, bands: Canvas(bands, self.shape, True))
    np.testing.assert_array_equal(compute(Context(terrain, options, jobs=3), name), whole)
    assert np.isfinite(whole).all() and whole.std() > 0
