"""The sky against published values (CIE sky, air mass), and what a picture asks of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from orograph.lighting.sun import Sun
from orograph.rendering import scattering
from orograph.rendering.cpu.draw import encode
from orograph.rendering.sky import LOSS, Atmosphere, dithered

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def atmosphere(
    azimuth: float = 315.0, altitude: float = 45.0, seen: tuple[float, float] = (0.0, 30_000.0)
) -> Atmosphere:
    scene = cast(Any, SimpleNamespace(lighting=SimpleNamespace(sun=Sun(azimuth, altitude))))
    return Atmosphere(scene, seen)


def towards(azimuth: Any, elevation: Any) -> np.ndarray:
    a, e = np.broadcast_arrays(np.radians(azimuth), np.radians(elevation))
    return np.stack([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)], -1).reshape(-1, 3)


def test_optical_depth_follows_kasten_and_young() -> None:
    """Relative air mass of Kasten and Young (1989), for air alone: their table's 1.0, 1.993, 5.58 and 10.3."""
    saved, scattering.MIE_EXTINCTION = scattering.MIE_EXTINCTION, 0.0
    try:
        zenith = np.array([0.0, 60.0, 80.0, 85.0])
        depth = scattering.optical_depth(0.0, np.cos(np.radians(zenith)), 400)[:, 2]
    finally:
        scattering.MIE_EXTINCTION = saved
    mass = 1 / (np.cos(np.radians(zenith)) + 0.50572 * (96.07995 - zenith) ** -1.6364)
    np.testing.assert_allclose(depth / depth[0], mass, rtol=0.02)


def test_transmittance_table_agrees_with_integration() -> None:
    table = scattering.Transmittance()
    rng = np.random.default_rng(1)
    height, mu = rng.uniform(0, 40, 300), rng.uniform(0.02, 1, 300)
    truth = np.exp(-scattering.optical_depth(height, mu, 600))
    np.testing.assert_allclose(table(height, mu), truth, atol=0.01)
    assert table(np.array([1.0]), np.array([-0.2])).max() == 0  # the ground is in the way


def test_distribution_resembles_the_cie_clear_sky() -> None:
    """ISO 15469 / CIE S 011 sky type 12 (clear, low turbidity): luminance relative to the zenith's, sun at 45°."""
    zenith_angle = np.radians(45)
    air, haze = scattering.sky_table(np.radians(45))
    z = (np.linspace(0, 1, scattering.ELEVATIONS) ** 2)[:, None]
    half = np.linspace(0, 1, scattering.AZIMUTHS)[None]
    cosine = np.clip(z * np.cos(zenith_angle) + np.sqrt(1 - z * z) * (1 - 2 * half**2) * np.sin(zenith_angle), -1, 1)
    ours = (air + haze * scattering.mie_phase(cosine)[..., None]) @ LUMINANCE
    a, b, c, d, e = -1.0, -0.32, 10.0, -3.0, 0.45

    def indicatrix(chi: Any) -> Any:
        return 1 + c * (np.exp(d * chi) - np.exp(d * np.pi / 2)) + e * np.cos(chi) ** 2

    cie = (1 + a * np.exp(b / np.maximum(z, 1e-3))) * indicatrix(np.arccos(cosine))
    usual = (np.broadcast_to(z, cosine.shape) > np.sin(np.radians(10))) & (cosine < np.cos(np.radians(20)))
    ratio = (ours / ours[-1, 0])[usual] / (cie / cie[-1, 0])[usual]
    # Ours is the sky of one atmosphere, theirs the mean of many: a factor of two, and the same order of brightness.
    assert np.percentile(ratio, 5) > 0.7 and np.percentile(ratio, 95) < 1.95
    assert np.corrcoef(np.log(ours[usual]), np.log(cie[usual]))[0, 1] > 0.87


def test_day_is_blue_above_and_pale_below() -> None:
    sky = atmosphere()
    zenith, horizon = sky.sky(towards(0, [90.0, 1.0]))
    assert zenith[2] > 2 * zenith[0] > 0
    assert horizon @ LUMINANCE > 2 * (zenith @ LUMINANCE)
    assert horizon.max() / horizon.min() < 1.35
    assert sky.sky(towards(*np.meshgrid(np.arange(0, 360, 5), np.arange(-90, 91, 5)))).max() <= 1.0


def test_brightest_at_the_sun_and_the_same_on_both_sides() -> None:
    sky = atmosphere(120.0, 30.0)
    azimuth, elevation = np.meshgrid(np.arange(0.0, 360.0, 2.0), np.arange(0.0, 90.0, 2.0))
    directions = towards(azimuth, elevation)
    light = sky.sky(directions) @ LUMINANCE
    brightest = directions[np.argmax(light)]
    assert brightest @ towards(120.0, 30.0)[0] > np.cos(np.radians(2))
    np.testing.assert_allclose(sky.sky(towards(120 + 50, 20)), sky.sky(towards(120 - 50, 20)), atol=1e-5)
    # The disc has the sun's size.
    across = sky.sky(towards(120.0, 30.0 + np.array([0.0, 0.24, 0.30])))
    assert across[1, 1] == pytest.approx(across[0, 1], abs=2e-3)
    assert across[2, 1] < across[0, 1] - 0.02


def test_low_sun_is_warm_and_dusk_is_dark() -> None:
    evening = atmosphere(270.0, 2.0).sky(towards(270.0, 4.0))[0]
    assert evening[0] > 1.1 * evening[2]
    day, civil, nautical = (atmosphere(0, h).sky(towards(90.0, 45.0))[0] @ LUMINANCE for h in (45.0, -4.0, -10.0))
    assert day > 2 * civil > 4 * nautical > 0


def test_no_line_at_the_horizon_and_mist_beneath() -> None:
    sky = atmosphere()
    azimuth = np.arange(0.0, 360.0, 10.0)
    above, below = sky.sky(towards(azimuth, 1e-4)), sky.sky(towards(azimuth, -1e-4))
    np.testing.assert_allclose(above, below, atol=5e-3)
    mist = sky.sky(towards(azimuth, -60.0)) @ LUMINANCE
    horizon = above @ LUMINANCE
    assert (mist > 0.4 * horizon).all() and (mist < horizon).all()
    assert np.ptp(mist) < 0.1 * mist.mean()  # no image of the sky in it


def test_haze_takes_the_stated_share_and_most_of_the_blue() -> None:
    sky = atmosphere(seen=(0.0, 20_000.0))
    directions = towards([10.0, 10.0, 10.0], [-5.0, -5.0, -5.0])
    depth = np.array([0.0, 10_000.0, 20_000.0])
    black, white = (sky.haze(np.full((3, 3), v, np.float32), directions, depth) for v in (0.0, 1.0))
    left = white - black
    assert left[0] == pytest.approx(1)
    assert left[2, 1] == pytest.approx(1 - LOSS, abs=1e-4)
    np.testing.assert_allclose(left[1] ** 2, left[2], rtol=1e-4)  # Beer's law
    assert left[2, 2] < left[2, 1] < left[2, 0]
    assert black[2, 2] > black[2, 0]  # far dark ground turns blue
    np.testing.assert_allclose(black[2] / (1 - left[2]), sky.horizon(directions[:1])[0], rtol=1e-4)


def test_overviews_and_plans_get_little_haze() -> None:
    def loss(near: float, far: float) -> float:
        sky = atmosphere(seen=(near, far))
        return 1 - float(np.exp(-sky.extinction[1] * (far - near)))

    assert 0.08 < loss(80e3, 140e3) < 0.15  # a terrain looked at from outside
    assert loss(2e3, 140e3) > 0.95 * LOSS  # a panorama from within
    assert loss(100e3, 102e3) < 0.08
    assert loss(5e3, 5e3) == 0
    assert atmosphere(seen=(5e3, 5e3)).haze(np.ones((1, 3), np.float32), towards(0, -90), np.array([5e3])).min() == 1


def test_empty_and_vertical_directions() -> None:
    sky = atmosphere(0.0, 90.0)
    assert sky.sky(np.empty((0, 3))).shape == (0, 3)
    straight = np.array([[0, 0, 1.0], [0, 0, -1.0]])
    out = sky.sky(straight)
    assert out.dtype == np.float32 and np.isfinite(out).all()
    assert np.isfinite(sky.haze(out, straight, np.array([1.0, 2.0]))).all()


def test_a_sky_has_no_bands() -> None:
    """Bytes of a calm gradient, averaged over squares of 8 × 8 pixels, are what they stand for to a tenth of a step;
    not dithered they are off by half a step, in bands."""
    rows, cols = 64, 640
    ramp = np.linspace(0.70, 0.72, cols)  # sRGB: five steps in 640 pixels
    color = np.repeat(((ramp + 0.055) / 1.055) ** 2.4, 3).reshape(-1, 3).astype(np.float32)
    py, px = (a.ravel() + 0.5 for a in np.mgrid[:rows, :cols])
    plain = np.tile(color, (rows, 1))
    means = []
    for linear in (plain, dithered(plain, px, py)):
        bytes_ = encode(linear.reshape(rows, cols, 3)).astype(float)
        means.append(bytes_.reshape(rows // 8, 8, cols // 8, 8, 3).mean((1, 3)))
    wanted = (ramp * 255).reshape(-1, 8).mean(1)[None, :, None]
    assert np.abs(means[0] - wanted).max() > 0.4
    assert np.abs(means[1] - wanted).max() < 0.1
