"""Screen-space occlusion: closed forms seen from straight above, real ground, and what it must not see."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.errors import UsageError
from orograph.lighting.normal import normals
from orograph.lighting.occlusion import ambient_occlusion
from orograph.rendering.gpu.shade.ssao import Quality, screen_occlusion

pytestmark = pytest.mark.usefixtures("device")
FINE = Quality(slices=16, steps=64, falloff=0.02, blur=False)
CELL = 10.0


def from_above(h: np.ndarray, radius: float, quality: Quality = FINE) -> np.ndarray:
    """A map view: one pixel per sample, orthographic, up is north."""
    n = normals(h, np.diag([CELL, -CELL]))
    return screen_occlusion(1e4 - h, n * [1, 1, -1], CELL, radius, perspective=False, quality=quality)


def test_planes_are_open_however_they_lie():
    y, x = np.mgrid[:40, :50]
    for plane in (0 * x, 5 * x, 12 * x - 17 * y):
        for quality in (FINE, Quality()):
            np.testing.assert_allclose(from_above(plane.astype(np.float32), 150.0, quality), 1.0, atol=2e-3)


def test_an_inclined_plane_in_perspective_is_open():
    """Ground seen by a pinhole at height 100 that looks down at 10°."""
    height, width, slope = 60, 80, 0.01
    a = math.radians(10)
    row, col = np.mgrid[:height, :width]
    x, y = (col + 0.5 - width / 2) * slope, -(row + 0.5 - height / 2) * slope
    down = math.sin(a) - y * math.cos(a)  # how far a ray of unit depth falls
    z = np.where(down > 0.05, 100 / np.maximum(down, 0.05), 0)
    normal = np.broadcast_to([0.0, math.cos(a), -math.sin(a)], (height, width, 3))
    got = screen_occlusion(z, normal, slope, 30.0, quality=FINE)
    np.testing.assert_allclose(got, 1.0, atol=5e-3)
    assert (z == 0).any() and (got[z == 0] == 1).all() and x.shape == z.shape


@pytest.mark.parametrize("slope", [0.5, 1.0, 2.0])
def test_the_bottom_of_an_endless_valley(slope):
    """A = 1 / √(1 + slope²)."""
    x = np.abs(np.arange(121) - 60)
    h = np.tile(CELL * slope * x, (121, 1)).astype(np.float32)
    got = from_above(h, 500.0)[60, 60]
    # Along the valley's axis nothing rises: in the plan R covers fewer pixels up the slopes.
    assert got == pytest.approx(1 / math.sqrt(1 + slope * slope), abs=0.02)


def test_real_ground_seen_from_above_against_walks(small_real_ground):
    """From straight above all of the ground is seen, and screen space is as good as object space."""
    h, linear = small_real_ground
    n = normals(h, linear)
    expected = ambient_occlusion(h, linear, radius=600.0, azimuths=64)
    for quality, mean, largest in ((FINE, 0.012, 0.07), (Quality(slices=8, falloff=0.1), 0.03, 0.15)):
        got = screen_occlusion(9e3 - h, n * [1, 1, -1], 30.0, 600.0, perspective=False, quality=quality)
        d = np.abs(got - expected)
        assert d.mean() < mean and d.max() < largest
    assert expected.min() < 0.93


def test_what_is_hidden_or_out_of_the_picture_does_not_occlude():
    """Where it fails, and must: a wall beyond the border, which object space knows."""
    h = np.zeros((40, 60), np.float32)
    h[:, 40:] = 60.0
    beside = from_above(h, 150.0)
    cut = from_above(h[:, :40], 150.0)
    assert beside[20, 37] < 0.8 and cut[20, 37] == pytest.approx(1.0, abs=1e-3)


def test_the_blur_keeps_to_a_surface():
    """Noise goes, the step between two levels stays."""
    h = np.zeros((60, 60), np.float32)
    h[:, 30:] = 50.0
    coarse, smooth = (from_above(h, 100.0, Quality(slices=2, steps=4, blur=b)) for b in (False, True))
    dark = np.s_[10:50, 26]
    assert smooth[dark].std() < 0.6 * coarse[dark].std()
    assert smooth[10:50, 33:50].min() > 0.97 and smooth[dark].mean() < 0.95


def test_what_cannot_be():
    with pytest.raises(UsageError, match="normals"):
        screen_occlusion(np.ones((3, 4)), np.ones((3, 4)), 1.0, 1.0)
    with pytest.raises(UsageError, match="radius"):
        screen_occlusion(np.ones((3, 4)), np.ones((3, 4, 3)), 1.0, 0.0)
