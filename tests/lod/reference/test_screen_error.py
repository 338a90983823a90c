"""Pixels against the projection of points and against the kernels' metrics; how wrong the printed forms are."""

from __future__ import annotations

import math

import numpy as np
import plain
import pytest

from orograph._numba import kernel
from orograph.error import screen
from orograph.lod.reference import screen_error
from orograph.lod.reference.camera import Camera as ReferenceCamera
from orograph.viewpoint import Camera


def cases(seed: int, count: int):
    """(view, camera, point, e, r): volumes around places in front of random cameras, mostly."""
    rng = np.random.default_rng(seed)
    t = plain.terrain(np.zeros((101, 101), np.float32))
    for _ in range(count):
        view = plain.random_view(rng, t)
        col, row = rng.uniform(0, 100, 2)
        east, north = (float(v) for v in t.grid.xy(col, row))
        e, r = 10 ** rng.uniform(-3, 1.5), rng.choice([0.0, 10 ** rng.uniform(0, 2.5)])
        yield t, view, ReferenceCamera.of(view), (col, row, rng.uniform(-50, 50)), (east, north), float(e), float(r)


def test_displacement_is_what_the_projection_moves():
    seen = 0
    for _, view, camera, (_, _, z), place, e, _ in cases(1, 400):
        for delta in (e, -e):
            (a, b), _ = view.project(np.array([[*place, z], [*place, z + delta]]))
            expected = math.dist(a, b)
            if math.isfinite(expected):
                seen += 1
                found = screen_error.displacement(camera, camera.to_camera((*place, z)), delta)
                assert found == pytest.approx(expected, rel=1e-6, abs=1e-7)
    assert seen > 300


@kernel
def bound(camera, metric, col, row, z, e, r):
    x, y, w = screen.to_camera(camera, col, row, z)
    return screen.sphere_bound(camera, metric, x, y, w, e, r)


@pytest.mark.parametrize(
    "function, metric",
    [
        (screen_error.anisotropic, screen.ANISOTROPIC),
        (screen_error.isotropic, screen.ISOTROPIC),
        (screen_error.isotropic_printed, screen.ISOTROPIC_PUBLISHED),
    ],
)
def test_bounds_are_those_of_the_kernels(function, metric):
    finite = 0
    for t, view, camera, (col, row, z), place, e, r in cases(metric, 400):
        expected = bound(screen.camera_parameters(Camera.over(t.grid, view)), metric, col, row, z, e, r)
        found = function(camera, camera.to_camera((*place, z)), e, r)
        assert found == pytest.approx(expected, rel=1e-7)
        assert function(camera, camera.to_camera((*place, z)), 0.0, r) == 0.0
        assert function(camera, camera.to_camera((*place, z)), math.inf, r) == math.inf
        finite += math.isfinite(expected)
    assert finite > 100


def test_the_factor_of_the_lecture_is_too_small():
    """The kernels have the printed 1 − |⟨ẑ, v̂⟩| (``anisotropic-published``), the reference the sine."""
    for t, view, camera, (col, row, z), place, e, r in cases(9, 300):
        p = camera.to_camera((*place, z))
        cosine = abs(np.dot(camera.vertical, p)) / np.linalg.norm(p)
        parameters = screen.camera_parameters(Camera.over(t.grid, view))
        printed = bound(parameters, screen.ANISOTROPIC_PUBLISHED, col, row, z, e, r)
        found = screen_error.anisotropic_printed(camera, p, e, r)
        if math.isfinite(printed):
            assert found == pytest.approx(printed * math.sqrt(1 - cosine**2) / (1 - cosine), rel=1e-6)
    tilt = math.radians(10)  # from straight down, on the axis of view: what moves is told by the sine
    view = plain.View((0, 0, 1000), (1000 * math.tan(tilt), 0, 0))
    camera = ReferenceCamera.of(view)
    p = camera.to_camera((1000 * math.tan(tilt), 0.0, 0.0))
    truth = screen_error.displacement(camera, p, 1e-3)
    assert screen_error.anisotropic_printed(camera, p, 1e-3, 0.0) == pytest.approx(truth, rel=1e-5)
    assert math.sin(tilt) / (1 - math.cos(tilt)) == pytest.approx(11.43, abs=0.01)


def test_distance_is_right_on_the_axis_only():
    """At 45° a flat screen stretches 1/cos² = 2 times; the bound that divides by depths has it."""
    camera = ReferenceCamera.of(plain.View((0, 0, 0), (1, 0, 0), fov_y=120))
    for angle in (0.0, 45.0):  # above the axis; a short vertical, turned across the ray, would be stretched 1/cos²
        w = 1000.0
        p = (0.0, w * math.tan(math.radians(angle)), w)
        across = camera.focal * 1e-3 / math.hypot(*p) / math.cos(math.radians(angle)) ** 2
        assert screen_error.isotropic(camera, p, 1e-3, 0.0) == pytest.approx(across, rel=1e-5)
        ratio = across / screen_error.isotropic_printed(camera, p, 1e-3, 0.0)
        assert ratio == pytest.approx(2.0 if angle else 1.0)


def test_bounds_hold_for_points_in_the_ball():
    rng = np.random.default_rng(3)
    tight, checked = 0.0, 0
    for _, _, camera, (_, _, z), place, e, r in cases(5, 150):
        e = min(e, 3.0)
        p = np.array(camera.to_camera((*place, z)))
        steps = rng.normal(size=(60, 3))
        for step in steps / np.linalg.norm(steps, axis=1)[:, None] * r * rng.uniform(0, 1, 60)[:, None] ** (1 / 3):
            q = tuple(p + step)
            if min(camera.depths(q)) < 0:
                continue
            for delta in (e, -e):
                moved = screen_error.displacement(camera, q, delta)
                for function in (screen_error.anisotropic, screen_error.isotropic):
                    found = function(camera, tuple(p), e, r)
                    assert moved <= found * (1 + 1e-9)
                    tight = max(tight, moved / found if function is screen_error.anisotropic else 0.0)
                checked += 1
    assert checked > 2000 and tight > 0.9


@kernel
def of_triangle(camera, a, b, c, e):
    ax, ay, aw = screen.to_camera(camera, a[0], a[1], a[2])
    bx, by, bw = screen.to_camera(camera, b[0], b[1], b[2])
    cx, cy, cw = screen.to_camera(camera, c[0], c[1], c[2])
    return screen.triangle_bound(camera, ax, ay, aw, bx, by, bw, cx, cy, cw, e)


def test_wedgies():
    finite = 0
    for t, view, camera, (col, row, z), _, e, _ in cases(11, 300):
        vertices = np.array([[col, row, z], [col + 8, row, z + 5], [col, row + 8, z - 5]])
        places = np.stack([*t.grid.xy(vertices[:, 0], vertices[:, 1]), vertices[:, 2]], 1)
        points = [camera.to_camera(tuple(p)) for p in places.tolist()]
        found = screen_error.wedgie(camera, points, e)
        expected = of_triangle(screen.camera_parameters(Camera.over(t.grid, view)), *vertices, e)
        assert found == pytest.approx(expected, rel=1e-7)
        printed = screen_error.wedgie_printed(camera, points, e)
        if math.isfinite(printed):
            # Both faces of the wedgie at a corner, by projecting them: the thickness there is no larger.
            for place in places:
                (upper, lower), _ = view.project(place + np.array([[0, 0, e], [0, 0, -e]]))
                assert math.dist(upper, lower) <= printed * (1 + 1e-6)
            one = screen_error.wedgie_printed(camera, points[:1], e)
            (upper, lower), _ = view.project(places[0] + np.array([[0, 0, e], [0, 0, -e]]))
            assert one == pytest.approx(math.dist(upper, lower), rel=1e-6)
            finite += 1
        reach = e * abs(camera.vertical[2])
        if min(p[2] for p in points) <= reach:
            assert printed == math.inf  # r > |c| does not hold
    assert finite > 100
