"""Screen-space metrics against brute force: points of the volume, moved along the vertical, projected by ``View``."""

from __future__ import annotations

import math

import numpy as np
import pytest
from affine import Affine

from orograph._numba import kernel
from orograph.error import screen
from orograph.error.screen import (
    ANISOTROPIC,
    ANISOTROPIC_PUBLISHED,
    ISOTROPIC,
    ISOTROPIC_PUBLISHED,
    camera_parameters,
    metric_of,
)
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.viewpoint import Camera, View

to_camera, sphere_bound, sphere_exceeds, triangle_bound, color_exceeds, color_slack = (
    getattr(screen, name).py_func
    for name in ("to_camera", "sphere_bound", "sphere_exceeds", "triangle_bound", "color_exceeds", "color_slack")
)
GRID = Grid((101, 101), Affine.translation(1000, 2000) @ Affine.rotation(25) @ Affine.scale(30, -30), None)


def random_view(rng: np.random.Generator) -> View:
    eye = (*map(float, GRID.xy(*rng.uniform(0, 100, 2))), float(rng.uniform(0, 900)))
    target = (*map(float, GRID.xy(*rng.uniform(-50, 150, 2))), float(rng.uniform(-300, 300)))
    options = {"fov_y": float(rng.choice([20, 60, 120, 160])), "width": 400, "height": 300}
    up = tuple(float(v) for v in rng.normal(size=3))
    view = View(eye, target, up=up, near=float(rng.choice([0.0, 5.0])), **options)
    if rng.random() < 0.3:  # a part of the picture, with the frustum to one side
        return view.tile(int(rng.integers(0, 200)), int(rng.integers(0, 150)), 200, 150)
    return view


def positions(col, row, z):
    x, y = GRID.xy(col, row)
    return np.stack(np.broadcast_arrays(x, y, z), -1)


def moved_pixels(view: View, points, delta, exaggeration: float):
    """How far points in view move on the screen if their heights change by delta; NaN for points out of view."""
    at, depth = view.project(points, exaggeration)
    to, depth2 = view.project(points + np.stack([0 * delta, 0 * delta, delta], -1), exaggeration)
    inside = (depth > view.near) & (at >= 0).all(-1) & (at[..., 0] <= view.width) & (at[..., 1] <= view.height)
    distance = np.where(depth2 > 0, np.hypot(*np.moveaxis(to - at, -1, 0)), np.inf)
    return np.where(inside, distance, np.nan)


def ball(rng, count):
    p = rng.normal(size=(count, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    return p * np.where(rng.random(count) < 0.5, 1.0, rng.random(count))[:, None]


@pytest.mark.parametrize("metric", [ANISOTROPIC, ISOTROPIC])
def test_bounds_over_spheres_hold_for_every_point_in_view(metric):
    rng = np.random.default_rng(metric)
    tested, tightest = 0, 0.0
    for _ in range(1500):
        view, exaggeration = random_view(rng), float(rng.choice([0.4, 1.0, 3.0]))
        camera = camera_parameters(Camera.over(GRID, view, exaggeration))
        col, row, z = *rng.uniform(0, 100, 2), rng.uniform(-200, 600)
        if rng.random() < 0.2:  # the eye within the sphere or beside it
            col, row = (float(v) for v in ~GRID.samples @ view.eye[:2])
            z = view.eye[2]
        r, e = 10 ** rng.uniform(0, 2.7), 10 ** rng.uniform(-1, 2)
        points = positions(col, row, z) + r * ball(rng, 200)
        delta = e * rng.choice([-1.0, 1.0], 200) * np.where(rng.random(200) < 0.7, 1.0, rng.random(200))
        found = moved_pixels(view, points, delta, exaggeration)
        bound = sphere_bound(camera, metric, *to_camera(camera, col, row, z), e, r * camera.stretch)
        seen = found[~np.isnan(found)]
        assert (seen <= bound * (1 + 1e-9)).all()
        tested += len(seen)
        if len(seen) and math.isfinite(bound):
            tightest = max(tightest, float(seen.max()) / bound)
    assert tested > 50_000
    assert tightest > (0.99 if metric == ANISOTROPIC else 0.6)  # it is no idle bound


@pytest.mark.stress
def test_bounds_over_prisms_hold_and_are_extreme_at_corners():
    rng = np.random.default_rng(3)
    tested, tightest = 0, 0.0
    for _ in range(1500):
        view, exaggeration = random_view(rng), float(rng.choice([0.4, 1.0, 3.0]))
        camera = camera_parameters(Camera.over(GRID, view, exaggeration))
        a = np.array([*rng.uniform(0, 100, 2), rng.uniform(-200, 600)])
        corners = a + rng.normal(size=(3, 3)) * 10 ** rng.uniform(0, 1.5) * [1, 1, 10]
        e = 10 ** rng.uniform(-1, 2)
        shares = rng.dirichlet([0.4] * 3, 200)
        shares[:3] = np.eye(3)
        on = shares @ corners
        delta = e * rng.choice([-1.0, 1.0], 200) * np.where(rng.random(200) < 0.7, 1.0, rng.random(200))
        # The sample is in view; the mesh, a triangle's point, is within e of it on the vertical.
        samples = positions(*on.T)
        samples[:, 2] += delta
        found = moved_pixels(view, samples, -delta, exaggeration)
        at = [to_camera(camera, *corner) for corner in corners]
        bound = triangle_bound(camera, *at[0], *at[1], *at[2], e)
        seen = found[~np.isnan(found)]
        assert (seen <= bound * (1 + 1e-9)).all()
        tested += len(seen)
        if len(seen) and math.isfinite(bound):
            tightest = max(tightest, float(seen.max()) / bound)
        # ROAM's claims: the vector in the numerator does not change along the vertical, its norm is greatest at a
        # corner, and so is nearness.
        p = np.array([to_camera(camera, *point) for point in on])
        up = [camera.right[2], camera.up[2], camera.depth[2]]
        norm = np.hypot(up[0] * p[:, 2] - up[2] * p[:, 0], up[1] * p[:, 2] - up[2] * p[:, 1])
        assert norm.max() <= norm[:3].max() * (1 + 1e-9) and p[:, 2].min() >= p[:3, 2].min() - 1e-9
        lifted = p + delta[:, None] * up
        norm2 = np.hypot(up[0] * lifted[:, 2] - up[2] * lifted[:, 0], up[1] * lifted[:, 2] - up[2] * lifted[:, 1])
        np.testing.assert_allclose(norm2, norm, rtol=1e-9, atol=1e-7)
    assert tested > 30_000 and tightest > 0.95


def test_a_prism_that_reaches_the_eyes_plane_has_no_bound():
    x, y = GRID.samples.c, GRID.samples.f
    view = View((x, y, 100.0), (x + 500.0, y, -400.0), fov_y=60)  # the first sample is right below the eye
    camera = camera_parameters(Camera.over(GRID, view))
    at = [to_camera(camera, *c) for c in ((0, 0, 0.0), (1, 0, 0.0), (0, 1, 0.0))]
    assert math.isfinite(triangle_bound(camera, *at[0], *at[1], *at[2], 10.0))
    assert triangle_bound(camera, *at[0], *at[1], *at[2], 200.0) == math.inf


@pytest.mark.parametrize("metric", [ANISOTROPIC, ISOTROPIC, ISOTROPIC_PUBLISHED])
def test_bounds_of_nested_spheres_are_monotonic(metric):
    rng = np.random.default_rng(9)
    finite = 0
    for _ in range(4000):
        view, exaggeration = random_view(rng), float(rng.choice([0.4, 1.0, 3.0]))
        camera = camera_parameters(Camera.over(GRID, view, exaggeration))
        parent, big = np.array([*rng.uniform(0, 100, 2), rng.uniform(-200, 600)]), 10 ** rng.uniform(0, 2.7)
        small = big * rng.random()
        apart = rng.normal(size=3)
        apart *= (big - small) * rng.choice([1.0, rng.random()]) / np.linalg.norm(apart)
        x, y, z = positions(*parent) + apart
        col, row = ~GRID.samples @ (x, y)
        e = 10 ** rng.uniform(-1, 2)
        of_parent = sphere_bound(camera, metric, *to_camera(camera, *parent), e, big * camera.stretch)
        of_child = sphere_bound(camera, metric, *to_camera(camera, col, row, z), e * rng.choice([1.0, rng.random()]),
                                small * camera.stretch)  # fmt: skip
        assert of_child <= of_parent * (1 + 1e-9)
        finite += math.isfinite(of_parent)
    assert finite > 1000


@kernel
def compiled(camera, metric, col, row, z, e, r):
    """What kernels make of a sphere: both tests and the bound."""
    x, y, w = screen.to_camera(camera, col, row, z)
    exceeds = screen.sphere_exceeds(camera, metric, x, y, w, e, r)
    straight, depth = screen.anisotropic_exceeds(camera, col, row, z, e, r)
    return exceeds, straight, depth, screen.sphere_bound(camera, metric, x, y, w, e, r)


@pytest.mark.stress
def test_tests_without_division_agree_with_the_bounds():
    rng = np.random.default_rng(5)
    both = set()
    for _ in range(3000):
        view, exaggeration = random_view(rng), float(rng.choice([0.4, 1.0, 3.0]))
        tolerance = 10 ** rng.uniform(-1, 1.5)
        camera = camera_parameters(Camera.over(GRID, view, exaggeration), tolerance=tolerance)
        at = (*rng.uniform(0, 100, 2), rng.uniform(-200, 600))
        e = float(rng.choice([0.0, 10 ** rng.uniform(-3, 2), np.inf]))
        r = 10 ** rng.uniform(0, 2.7)
        for metric in (ANISOTROPIC, ISOTROPIC, ISOTROPIC_PUBLISHED, ANISOTROPIC_PUBLISHED):
            exceeds, straight, depth, bound = compiled(camera, metric, *at, e, r)
            assert exceeds == (bound > tolerance) or math.isclose(bound, tolerance, rel_tol=1e-9)
            if metric == ANISOTROPIC:
                assert straight == exceeds
                assert math.isclose(depth, to_camera(camera, *at)[2], rel_tol=1e-9, abs_tol=1e-6)
            both.add((metric, bool(exceeds)))
    assert len(both) == 8


def test_a_plan_displaces_nothing_but_splits_holes():
    plan = View((0.0, 0.0, 900.0), (0.0, 0.0, 0.0), projection="plan")
    camera = camera_parameters(Camera.over(GRID, plan), tolerance=0.0)
    assert compiled(camera, ANISOTROPIC, 5.0, 5.0, 0.0, 50.0, 10.0)[:2] == (False, False)
    assert compiled(camera, ANISOTROPIC, 5.0, 5.0, 0.0, np.inf, 10.0)[:2] == (True, True)


@pytest.mark.parametrize("projection", ["perspective", "plan"])
def test_what_is_larger_than_a_pixel(projection):
    """A sphere whose nearest point is on the axis: as large as its radius is there, across, on the screen."""
    rng = np.random.default_rng(6)
    both, high = set(), np.array([0, 0, 900])
    for _ in range(100):
        eye, depth = high + rng.uniform(-500, 500, 3), float(rng.uniform(10, 800))
        view = View(tuple(eye), tuple(eye - high), width=400, height=300, projection=projection)
        r = float(10 ** rng.uniform(-1, 2))
        centre = eye - [0, 0, depth + r]
        camera = camera_parameters(Camera.over(GRID, view), color_tolerance=2.0)
        (middle, edge), _ = view.project(np.array([eye - [0, 0, depth], eye - [-r, 0, depth]]))
        larger = bool(np.hypot(*(edge - middle)) > 1)
        w = to_camera(camera, *(~GRID.samples @ tuple(map(float, centre[:2]))), float(centre[2]))[2]
        assert color_exceeds(camera, 3.0, w, r) == larger and not color_exceeds(camera, 1.0, w, r)
        slack = color_slack(camera, 3.0, w, r)
        if projection == "plan":
            assert slack == np.inf
        else:
            assert color_exceeds(camera, 3.0, w - 0.999 * slack, r) == color_exceeds(camera, 3.0, w + 0.999 * slack, r)
            assert color_exceeds(camera, 3.0, w + (1.001 if larger else -1.001) * slack, r) != larger
        both.add(larger)
    assert both == {True, False}


# ---- counter-examples (docs/metrics.md quotes their numbers) -------------------------------------------------------


def ground_below(view: View, px: float, py: float) -> tuple[float, float, float]:
    """(col, row, 0): where the ray through a pixel position meets height 0."""
    o, _, _, d, du, dv = view.ray_basis()
    ray = d + du * px + dv * py
    x, y, _ = o - ray * o[2] / ray[2]
    col, row = ~GRID.samples @ (float(x), float(y))
    return col, row, 0.0


def test_the_published_isotropic_metric_fails_off_the_axis():
    view = View((0.0, 0.0, 1000.0), (1000.0, 0.0, 0.0), fov_y=90, width=1600, height=900)
    camera, e = camera_parameters(Camera.over(GRID, view)), 2.0
    at = ground_below(view, 0.0, 700.0)
    true = float(moved_pixels(view, positions(*at)[None], np.array([e]), 1.0)[0])
    published = sphere_bound(camera, ISOTROPIC_PUBLISHED, *to_camera(camera, *at), e, 0.0)
    assert true > 1.3 * published
    assert sphere_bound(camera, ISOTROPIC, *to_camera(camera, *at), e, 0.0) >= true
    assert sphere_bound(camera, ANISOTROPIC, *to_camera(camera, *at), e, 0.0) == pytest.approx(true, rel=1e-9)
    # On the axis of view it holds.
    at = ground_below(view, 800.0, 450.0)
    true = float(moved_pixels(view, positions(*at)[None], np.array([e * 0.01]), 1.0)[0])
    assert true <= sphere_bound(camera, ISOTROPIC_PUBLISHED, *to_camera(camera, *at), e * 0.01, 0.0)


@pytest.mark.parametrize(("tilt", "ratio"), [(10.0, 11.43), (30.0, 3.732), (60.0, 1.732), (89.0, 1.0176)])
def test_the_lectures_factor_is_smaller_than_the_foreshortening(tilt, ratio):
    """On the axis of view, ``tilt`` degrees from straight down: sin against 1 − cos."""
    eye = (0.0, 0.0, 1000.0)
    reach = 1000.0 * math.tan(math.radians(tilt))
    view = View(eye, (reach, 0.0, 0.0), fov_y=40, width=800, height=800)
    camera, e = camera_parameters(Camera.over(GRID, view)), 1e-3
    at = ground_below(view, 400.0, 400.0)
    true = float(moved_pixels(view, positions(*at)[None], np.array([e]), 1.0)[0])
    published = sphere_bound(camera, ANISOTROPIC_PUBLISHED, *to_camera(camera, *at), e, 0.0)
    assert true / published == pytest.approx(ratio, rel=1e-3)
    assert sphere_bound(camera, ANISOTROPIC, *to_camera(camera, *at), e, 0.0) == pytest.approx(true, rel=1e-3)


def test_metrics_by_name():
    assert metric_of("wedgie").conservative and not metric_of("isotropic-published").conservative
    with pytest.raises(UsageError, match="no metric"):
        metric_of("nearest")
