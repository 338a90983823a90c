"""The state machine of mouse and keyboard, over a plane and over hills, with a pick in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.viewer.flying import TICK, Flying
from orograph.viewer.navigation import Limits, heading_pitch
from orograph.viewer.navigator import LEFT, MIDDLE, RIGHT, Navigator
from orograph.viewpoint import View

HOME = View((500_000.0, 4_990_000.0, 6000.0), (500_000.0, 5_000_000.0, 0.0), width=1280, height=720)


def plain(exaggeration: float = 1.0) -> Navigator:
    """Over the plane of height 0."""
    nav = Navigator(HOME, HOME, lambda x, y: None, Limits(lambda x, y: 0.0, farthest=1e6), exaggeration)

    def pick(x, y):
        o0, _, _, d0, du, dv = nav.view.ray_basis(nav.exaggeration)
        d = d0 + x * du + y * dv
        return tuple(o0 - d * (o0[2] / d[2])) if d[2] < -1e-9 else None

    nav.pick = pick
    return nav


def pixel_of(nav: Navigator, point) -> np.ndarray:
    return nav.view.project(np.array(point), nav.exaggeration)[0]


@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
def test_left_drag_pans(exaggeration):
    nav = plain(exaggeration)
    point = nav.pick(300, 500)
    nav.press(LEFT, 300, 500)
    for x, y in ((310, 505), (500, 600), (900, 650), (800, 420)):
        nav.move(x, y)
        assert pixel_of(nav, point) == pytest.approx((x, y), abs=1e-6)
    assert not nav.release(LEFT, 800, 420)
    assert nav.view.eye[2] == pytest.approx(6000.0)
    nav.move(100, 100)  # no button, nothing moves
    assert pixel_of(nav, point) == pytest.approx((800, 420), abs=1e-6)


@pytest.mark.parametrize(("button", "modifiers"), [(RIGHT, ()), (LEFT, ("Shift",))])
def test_right_drag_orbits(button, modifiers):
    nav = plain()
    point = nav.pick(300, 500)
    nav.press(button, 300, 500, modifiers)
    nav.move(420, 440)
    assert nav.pivot == pytest.approx(point)
    assert pixel_of(nav, point) == pytest.approx((300, 500), abs=1e-6)
    heading, pitch = heading_pitch(nav.view)
    assert heading == pytest.approx(120 * 0.3)
    assert pitch == pytest.approx(heading_pitch(HOME)[1] + 60 * 0.3)
    for _ in range(100):  # up to the ground and no further, the point still there
        nav.move(420, 0)
        nav.move(420, -50)
    assert pixel_of(nav, point) == pytest.approx((300, 500), abs=1e-4)
    assert nav.view.eye[2] >= 2.0 - 1e-6


def test_orbits_do_not_depend_on_how_many_events_there_are():
    once, often = plain(), plain()
    for nav, n in ((once, 1), (often, 64)):
        nav.press(RIGHT, 600, 400)
        nav.move(600 + 8, 400)  # off the threshold of a click
        for k in range(1, n + 1):
            nav.move(608 + 100 * k / n, 400 + 40 * k / n)
    assert once.view.eye == pytest.approx(often.view.eye, abs=1e-4)


def test_middle_drag_looks_and_a_click_is_a_click():
    nav = plain()
    nav.press(MIDDLE, 600, 400)
    nav.move(700, 400)
    assert nav.view.eye == pytest.approx(HOME.eye)
    assert heading_pitch(nav.view)[0] == pytest.approx(15.0)
    nav.release(MIDDLE, 700, 400)
    nav.press(LEFT, 600, 400)
    nav.move(602, 401)
    assert nav.release(LEFT, 602, 401)


def test_dragging_the_sky_turns_the_head():
    nav = plain()
    nav.view = View((500_000.0, 5e6, 100.0), (500_000.0, 5.01e6, 100.0))
    assert nav.pick(640, 100) is None
    nav.press(LEFT, 640, 100)
    nav.move(740, 100)
    assert nav.view.eye == pytest.approx((500_000.0, 5e6, 100.0))
    assert heading_pitch(nav.view)[0] > 350


@pytest.mark.parametrize("frame", [1 / 240, 1 / 60, 1 / 7])
def test_the_wheel_zooms_to_the_cursor_at_any_frame_rate(frame):
    nav = plain()
    point = nav.pick(900, 600)
    nav.wheel(900, 600, 2.0)
    nav.wheel(901, 600, 1.0)
    time = 0.0
    while nav.moving:
        nav.advance(frame)
        time += frame
        assert pixel_of(nav, point) == pytest.approx((900, 600), abs=1e-6)
    assert math.dist(nav.view.eye, point) == pytest.approx(math.dist(HOME.eye, point) / 1.25**3, rel=1e-9)
    assert time < 1.5


def test_the_wheel_in_the_sky():
    nav = plain()
    nav.view = View((500_000.0, 5e6, 100.0), (500_000.0, 5.01e6, 100.0))
    nav.wheel(640, 50, 2.0)
    for _ in range(200):
        nav.advance(1 / 60)
    assert not nav.moving
    assert nav.view.eye[1] > 5e6


def test_zooming_in_ends_above_the_ground():
    nav = plain()
    for _ in range(100):
        nav.wheel(640, 360, 3.0)
        nav.advance(0.5)
    assert nav.view.eye[2] == pytest.approx(2.0, abs=1e-3)


def hilly(x: float, y: float) -> float:
    return 300.0 * math.sin(x / 900.0) + 200.0 * math.cos(y / 700.0)


def fly(frames: list[float], keys=("w", "d", "ArrowLeft")) -> tuple[View, Flying]:
    view = View((0.0, 0.0, 700.0), (0.0, 1000.0, 600.0))
    state = Flying()
    for dt in frames:
        view = state.advance(view, keys, dt, Limits(hilly))
    return view, state


def test_flying_does_not_depend_on_the_frame_rate():
    whole, _ = fly([4.0])
    for frames in ([TICK] * 960, [4 / 37] * 37, [0.001] * 4000, [0.3, 0.01, 0.69] * 4):
        other, _ = fly(frames)
        assert other.eye == pytest.approx(whole.eye, abs=1e-6)
        assert other.target == pytest.approx(whole.target, abs=1e-6)
    assert math.dist(whole.eye, (0, 0, 700)) > 300


def test_flying_moves_evenly_between_ticks():
    """At 59.94 frames a second no frame goes farther than its neighbours."""
    view = View((0.0, 0.0, 1e5), (0.0, 1000.0, 1e5))
    state, places = Flying(), []
    for _ in range(300):
        view = state.advance(view, ("w",), 1 / 59.94, Limits(lambda x, y: 0.0))
        places.append(view.eye[1])
    steps = np.diff(places)[100:]
    assert np.ptp(steps) < 1e-3 * steps.mean()


def test_flying_over_a_plane_in_closed_form():
    """Level flight at height h: v = 0.8 h (1 − exp(−t / 0.1)), so y = 0.8 h (t − 0.1 (1 − exp(−10 t)))."""
    view = View((0.0, 0.0, 500.0), (0.0, 1000.0, 500.0))
    view = Flying().advance(view, ("w",), 2.0, Limits(lambda x, y: 0.0))
    assert view.eye[1] == pytest.approx(400.0 * (2.0 - 0.1 * (1 - math.exp(-20))), rel=2e-3)
    assert view.eye[2] == pytest.approx(500.0)


def test_flying_keeps_above_the_ground():
    view, state = View((0.0, 0.0, 300.0), (10.0, 1000.0, -600.0)), Flying()
    for _ in range(600):
        view = state.advance(view, ("w",), 1 / 60, Limits(hilly))
        assert view.eye[2] >= hilly(*view.eye[:2]) + 2.0 - 1e-6


def test_keys_and_modifiers():
    nav = plain()
    assert nav.key_down("W", ("Shift",))  # with shift the key's name is a capital
    assert nav.pace == 5.0
    nav.advance(1.0)
    far = math.dist(nav.view.eye, HOME.eye)
    assert nav.key_up("w")
    for _ in range(100):
        nav.advance(1 / 60)
    assert not nav.moving
    slow = plain()
    slow.key_down("w", ("Control",))
    slow.advance(1.0)
    assert far > 10 * math.dist(slow.view.eye, HOME.eye) > 0
    assert not slow.key_down("F1")


def arrive(nav: Navigator) -> View:
    for _ in range(2000):
        if not nav.moving:
            return nav.view
        nav.advance(1 / 60)
    raise AssertionError("the flight does not end")


def test_going_places():
    nav = plain()
    point = nav.pick(900, 500)
    far = math.dist(point, nav.view.eye)
    nav.double_click(900, 500)
    view = arrive(nav)
    assert pixel_of(nav, point) == pytest.approx((640, 360), abs=1e-5)
    assert math.dist(point, view.eye) == pytest.approx(far / 2.5)
    nav.straight_down()
    arrive(nav)
    assert heading_pitch(nav.view) == pytest.approx((0.0, -90.0), abs=1e-6)
    nav.oblique(90.0)
    arrive(nav)
    assert heading_pitch(nav.view) == pytest.approx((90.0, -40.0), abs=1e-6)
    nav.turn_quarter(1)
    arrive(nav)
    assert heading_pitch(nav.view)[0] == pytest.approx(180.0, abs=1e-6)
    nav.north_up()
    arrive(nav)
    assert math.remainder(heading_pitch(nav.view)[0], 360.0) == pytest.approx(0.0, abs=1e-6)
    nav.go_home()
    assert arrive(nav).eye == pytest.approx(HOME.eye)


def test_a_press_ends_a_flight():
    nav = plain()
    nav.double_click(900, 500)
    nav.advance(0.3)
    nav.press(LEFT, 500, 500)
    assert not nav.moving


def test_resizing_during_a_flight_keeps_the_size():
    nav = plain()
    nav.double_click(900, 500)
    nav.advance(0.1)
    nav.resize(400, 300)
    view = arrive(nav)
    assert (view.width, view.height) == (400, 300)


def test_a_new_exaggeration_keeps_the_eye_above_the_ground():
    nav = plain()
    nav.limits = Limits(lambda x, y: 5999.0)
    nav.stretch(2.0)
    assert nav.view.eye[2] == pytest.approx(6001.0)
