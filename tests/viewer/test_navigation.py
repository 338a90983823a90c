"""Moves of the camera against the camera's own projection (``View.project``), which navigation does not use."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from orograph.viewer.navigation import Grab, Limits, heading_pitch, kept_above, look, orbit, towards, zoom
from orograph.viewpoint import View

PIXEL = 1e-6
"""Pixels by which what is held may move: rounding of UTM coordinates."""

UTM = np.array([412_345.6, 4_987_654.3, 0.0])


def rolling(x: float, y: float) -> float:
    """Hills of 300 m around 1000 m."""
    return 1000.0 + 300.0 * math.sin((x - UTM[0]) / 1700.0) * math.cos((y - UTM[1]) / 2300.0)


LIMITS = Limits(rolling)


def height(view: View) -> float:
    return view.eye[2] - rolling(view.eye[0], view.eye[1])


def seen(view: View, point, exaggeration=1.0) -> np.ndarray:
    return view.project(np.array(point), exaggeration)[0]


def no_roll(view: View, exaggeration: float = 1.0) -> None:
    right, up, _ = view.axes(exaggeration)
    assert abs(right[2]) < 1e-9
    assert up[2] > -1e-9


@st.composite
def cases(draw):
    """A view above the hills that sees a ground point at a pixel, and that point."""
    heading = draw(st.floats(0, 2 * math.pi))
    pitch = math.radians(draw(st.floats(-89.9, -12.0)))
    distance = draw(st.floats(50.0, 30_000.0))
    exaggeration = draw(st.sampled_from([1.0, 1.0, 0.5, 3.0]))
    pixel = draw(st.floats(100, 1180)), draw(st.floats(60, 660))
    x, y = UTM[0] + draw(st.floats(-2000, 2000)), UTM[1] + draw(st.floats(-2000, 2000))
    point = np.array([x, y, rolling(x, y)])
    forward = np.array([math.sin(heading) * math.cos(pitch), math.cos(heading) * math.cos(pitch), math.sin(pitch)])
    unstretch = np.array([1, 1, 1 / exaggeration])
    view = View(tuple(UTM), tuple(UTM + forward * unstretch * 1000.0))
    if pitch < math.radians(-80):
        view = replace(view, up=(math.sin(heading), math.cos(heading), 0.0))
    _, _, _, d0, du, dv = view.ray_basis(exaggeration)
    eye = point - (d0 + pixel[0] * du + pixel[1] * dv) * distance
    view = replace(view, eye=tuple(eye), target=tuple(eye + forward * unstretch * distance))
    assume(height(view) > 3.0)
    return view, point, pixel, exaggeration


@given(cases(), st.floats(100, 1180), st.floats(60, 660))
def test_a_pan_holds_the_ground_point(case, x, y):
    view, point, pixel, exaggeration = case
    assert np.abs(seen(view, point, exaggeration) - pixel).max() < 1e-5  # the case is what it says
    grab = Grab.take(view, tuple(point), exaggeration)
    assert np.abs(seen(grab.to(pixel, LIMITS), point, exaggeration) - pixel).max() < PIXEL
    moved = grab.to((x, y), LIMITS)
    no_roll(moved, exaggeration)
    assert height(moved) > 2.0 - 1e-5
    ray = moved.ray_basis(exaggeration)
    d = (ray[3] + x * ray[4] + y * ray[5]) * [1, 1, exaggeration]
    down = -math.degrees(math.atan2(d[2], math.hypot(d[0], d[1])))
    if not grab.level or down > 4.1:
        assert np.abs(seen(moved, point, exaggeration) - (x, y)).max() < PIXEL
        old, new = heading_pitch(view, exaggeration), heading_pitch(moved, exaggeration)
        assert math.remainder(old[0] - new[0], 360) == pytest.approx(0, abs=1e-6)
        assert old[1] == pytest.approx(new[1], abs=1e-6)
    if grab.level and height(moved) > 2.1:
        assert moved.eye[2] == pytest.approx(view.eye[2], abs=1e-6)


@given(cases(), st.lists(st.floats(0.3, 3.0), min_size=1, max_size=6))
def test_a_zoom_holds_the_ground_point(case, factors):
    view, point, pixel, exaggeration = case
    pixel = seen(view, point, exaggeration)
    for factor in factors:
        before = np.linalg.norm(point - view.eye)
        view = zoom(view, tuple(point), factor, LIMITS, exaggeration)
        after = np.linalg.norm(point - view.eye)
        assert np.abs(seen(view, point, exaggeration) - pixel).max() < PIXEL * max(1.0, 50 / after)
        assert height(view) > 2.0 - 1e-5
        assert (after < before + 1e-6) if factor > 1 else (after > before - 1e-6)
        no_roll(view, exaggeration)


def test_a_zoom_is_the_factor_it_was_asked_for():
    view = View((0.0, -1000.0, 2000.0), (0.0, 0.0, 1000.0))
    near = zoom(view, (0.0, 0.0, 1000.0), 4.0)
    assert np.allclose(near.eye, (0.0, -250.0, 1250.0))
    far = zoom(view, (0.0, 0.0, 1000.0), 0.5, Limits(farthest=2000.0))
    assert math.dist(far.eye, (0, 0, 1000)) == pytest.approx(2000.0)


@given(cases(), st.floats(-180, 180), st.floats(-90, 90))
def test_an_orbit_holds_the_pivot(case, turn, tilt):
    view, point, _, exaggeration = case
    before, depth = view.project(point, exaggeration)
    moved = orbit(view, tuple(point), turn, tilt, LIMITS, exaggeration)
    after, new_depth = moved.project(point, exaggeration)
    assert np.abs(after - before).max() < PIXEL
    assert new_depth == pytest.approx(depth, rel=1e-9)
    assert height(moved) > 2.0 - 1e-5
    no_roll(moved, exaggeration)
    old, new = heading_pitch(view, exaggeration), heading_pitch(moved, exaggeration)
    if abs(math.remainder(new[0] - old[0] - turn, 360)) > 1e-6:  # turned less: only where the ground forbids
        blocked = orbit(view, tuple(point), turn, -90.0, Limits(), exaggeration)
        assert height(blocked) < 2.0 + 1e-5


@given(cases(), st.floats(-180, 180), st.floats(-90, 90))
def test_looking_around_leaves_the_eye(case, turn, tilt):
    view, *_, exaggeration = case
    moved = look(view, turn, tilt, exaggeration)
    assert moved.eye == pytest.approx(view.eye, abs=1e-8)
    no_roll(moved, exaggeration)
    old, new = heading_pitch(view, exaggeration), heading_pitch(moved, exaggeration)
    assert math.remainder(new[0] - old[0] - turn, 360) == pytest.approx(0, abs=1e-5)
    assert -90.0 - 1e-9 <= new[1] <= 85.0 + 1e-9


@given(cases(), st.floats(0, 360), st.floats(-90, -20))
def test_towards_puts_the_point_in_the_middle(case, heading, pitch):
    view, point, _, exaggeration = case
    moved = towards(view, tuple(point), Limits(), exaggeration, heading=heading, pitch=pitch)
    assert np.abs(seen(moved, point, exaggeration) - (640, 360)).max() < PIXEL
    new = heading_pitch(moved, exaggeration)
    assert math.remainder(new[0] - heading, 360) == pytest.approx(0, abs=1e-6)
    assert new[1] == pytest.approx(pitch, abs=1e-6)


def test_straight_down_has_a_heading():
    view = View((0.0, -1000.0, 2000.0), (0.0, 0.0, 1000.0))
    down = towards(view, (0.0, 0.0, 1000.0), heading=30.0, pitch=-90.0)
    assert heading_pitch(down) == pytest.approx((30.0, -90.0))
    _, up, forward = down.axes()
    assert np.allclose(forward, (0, 0, -1))
    assert np.allclose(up, (math.sin(math.pi / 6), math.cos(math.pi / 6), 0))
    turned = orbit(down, (0.0, 0.0, 1000.0), 0.0, 45.0)  # and comes up again the way it went down
    assert heading_pitch(turned) == pytest.approx((30.0, -45.0))


def test_a_camera_under_the_ground_is_lifted():
    low = View((*UTM[:2], 500.0), (UTM[0], UTM[1] + 1000.0, 500.0))
    lifted = kept_above(low, LIMITS)
    assert height(lifted) == pytest.approx(2.0, abs=1e-6)
    assert heading_pitch(lifted) == pytest.approx(heading_pitch(low))
    high = replace(low, eye=(*UTM[:2], 5000.0))
    assert kept_above(high, LIMITS) is high


def test_a_plan_becomes_a_perspective_of_the_same_scale():
    plan = View((100.0, 200.0, 5000.0), (100.0, 200.0, 1000.0), up=(1.0, 0.0, 0.0), projection="plan")
    view = kept_above(plan)
    assert view.projection == "perspective"
    points = np.array([[100.0, 200.0, 1000.0], [900.0, 500.0, 1000.0]])
    assert np.allclose(view.project(points)[0], plan.project(points)[0], atol=1e-6)


def test_the_sky_end_of_a_pan_is_limited():
    """A level pan towards the horizon does not fly to infinity."""
    view = View((0.0, -1000.0, 300.0), (0.0, 0.0, 0.0))
    grab = Grab.take(view, (0.0, 0.0, 0.0))
    assert grab.level
    moved = grab.to((640.0, -2000.0))
    assert math.dist(moved.eye, view.eye) < 300.0 / math.tan(math.radians(3.9)) + 1000
