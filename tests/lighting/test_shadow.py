"""Shadows against closed forms (steps, walls), the horizon itself, and rays over the disc on the surface."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.errors import UsageError
from orograph.lighting.shade import disc_fraction
from orograph.lighting.shadow import CAST, LIT, MISSING, PENUMBRA, SELF, shadow, shadow_rays, strips_of
from orograph.lighting.sun import Sun

CELL = np.array([[1.0, 0.0], [0.0, -1.0]])


def wall(height: float = 20.0, at: int = 100, cols: int = 260, rows: int = 41) -> np.ndarray:
    h = np.zeros((rows, cols), np.float32)
    h[:, at - 2 : at + 1] = height
    return h


@pytest.mark.parametrize("altitude", [12.0, 30.0, 45.0])
@pytest.mark.parametrize("cell", [1.0, 2.5])
def test_the_shadow_of_a_wall_is_as_long_as_its_cotangent(altitude, cell):
    f, code = shadow(wall(), np.diag([cell, -cell]), Sun(270.0, altitude, 0.0))
    length = 20.0 / math.tan(math.radians(altitude)) / cell
    beyond = np.arange(1, 100)
    np.testing.assert_array_equal(f[20, 100 + beyond], (beyond > length).astype(np.float32))
    assert code[20, 100 + math.ceil(length)] == LIT and code[20, 100 + math.floor(length)] == CAST
    assert (f[20, :98] == 1).all()


def test_the_shadow_slants_with_the_azimuth():
    """Sun in the south-west: the shadow runs north-east, √2 of its length across the wall's own direction."""
    h = wall(rows=200)
    f, _ = shadow(h, CELL, Sun(225.0, 30.0, 0.0))
    length = 20.0 / math.tan(math.radians(30.0)) / math.sqrt(2.0)
    beyond = np.arange(1, 60)
    np.testing.assert_array_equal(f[60, 100 + beyond], (beyond > length).astype(np.float32))


def test_penumbra_of_a_wall():
    """Beyond a long wall the disc is cut by a level line: the segment's area, between two closed-form limbs."""
    sun = Sun(270.0, 20.0)
    h = wall(60.0, cols=400)
    f, code = shadow(h, CELL, sun)
    d = np.arange(1, 290)
    expected = disc_fraction(np.degrees(np.arctan2(60.0, d)), 20.0, 0.53)
    np.testing.assert_allclose(f[20, 100 + d], expected, atol=2e-6)
    first, last = (60.0 / math.tan(math.radians(20.0 + s * 0.265)) for s in (1, -1))
    partial = 100 + np.arange(math.ceil(first), math.floor(last) + 1)
    assert (code[20, partial] == PENUMBRA).all() and len(partial) == 5
    assert code[20, partial[0] - 1] == CAST and code[20, partial[-1] + 1] == LIT


def test_ground_that_faces_away_is_in_its_own_shadow():
    x = np.arange(60) * 1.0
    east_slope = np.tile(-x, (40, 1)).astype(np.float32)  # falls to the east by 45°
    f, code = shadow(east_slope, CELL, Sun(270.0, 30.0))
    assert (code[5:-5, 5:-5] == SELF).all() and (f[5:-5, 5:-5] == 0).all()
    f, code = shadow(east_slope, CELL, Sun(90.0, 30.0))
    assert (code == LIT).all() and (f == 1).all()


def test_missing_samples_have_no_shadow_and_cast_none():
    h = wall()
    h[20, 120] = np.nan
    h[5:9, 96:104] = np.nan
    f, code = shadow(h, CELL, Sun(270.0, 30.0))
    assert code[20, 120] == MISSING and np.isnan(f[20, 120])
    assert code[7, 110] == LIT and code[12, 110] == CAST
    assert (np.isnan(f) == (code == MISSING)).all()


def test_strips_weigh_the_disc():
    for n in (1, 2, 5, 16):
        azimuths, halves, weights = strips_of(Sun(100.0, 60.0, 2.0), n)
        assert weights.sum() == pytest.approx(1.0)
        assert ((azimuths - 100.0) * math.cos(math.radians(60.0))) ** 2 + halves**2 == pytest.approx(np.ones(n))


def test_an_upright_edge_halves_the_disc_of_many_strips():
    """A wall that ends just where the sun stands: one strip sees all or nothing, many see half, as rays do."""
    h = np.zeros((61, 81), np.float32)
    h[:31, 10:13] = 400.0  # towards the north, up to the middle sample's own row
    sun = Sun(270.0, 10.0, 20.0)
    many, _ = shadow(h, CELL, sun, strips=24)
    truth = shadow_rays(h, CELL, sun, rays=400)
    assert truth[30, 70] == pytest.approx(0.5, abs=0.08)  # the wall's foot takes a row more
    assert many[30, 70] == pytest.approx(truth[30, 70], abs=0.03)
    assert truth[15, 70] == 0 and truth[48, 70] == 1


def test_against_rays_on_hills():
    y, x = np.mgrid[:60, :70]
    h = (12 * np.sin(x / 5.0 + 0.4) * np.cos(y / 7.0) + 5 * np.cos((x + 2 * y) / 9.0)).astype(np.float32)
    linear = np.array([[3.0, 0.4], [0.4, -4.0]])
    sun = Sun(230.0, 25.0, 6.0)
    f, _ = shadow(h, linear, sun, strips=9)
    truth = shadow_rays(h, linear, sun, rays=1024)
    inner = np.s_[3:-3, 3:-3]
    assert 0.1 < truth[inner].mean() < 0.97
    # The horizon is that of profiles between samples, rays meet facets: a fraction of the disc at the edges of shadows.
    assert np.abs(f - truth)[inner].mean() < 0.01


def test_rays_against_every_triangle_of_real_ground(real_ground):
    """Shadow of a point: every sample's ray with every triangle (Möller & Trumbore), on 20 × 20 samples."""
    from brute import intersections, triangles

    h, linear = real_ground[0][:20, :20], real_ground[1]
    sun = Sun(310.0, 12.0, 1e-4)
    row, col = np.indices(h.shape)
    origins = np.stack([col.ravel(), row.ravel(), h.ravel() + 3e-3], 1).astype(float)
    east, north, up = sun.direction
    towards = np.array([*np.linalg.solve(linear, [east, north]), up])
    free = np.array(
        [~np.isfinite(t[t > 1e-9]).any() for t in intersections(triangles(h), origins, np.tile(towards, (400, 1)))]
    )
    seen = shadow_rays(h, linear, sun, rays=1).ravel()
    assert 0.2 < free.mean() < 0.8
    np.testing.assert_array_equal(seen, free)


def test_nothing_depends_on_threads_and_few_strips_are_refused():
    h = wall()
    sun = Sun(250.0, 20.0)
    for a, b in zip(shadow(h, CELL, sun, strips=3, jobs=1), shadow(h, CELL, sun, strips=3, jobs=3)):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(shadow_rays(h, CELL, sun, jobs=1), shadow_rays(h, CELL, sun, jobs=3))
    with pytest.raises(UsageError):
        shadow(h, CELL, sun, strips=0)
    with pytest.raises(UsageError):
        shadow_rays(h, CELL, sun, rays=0)
