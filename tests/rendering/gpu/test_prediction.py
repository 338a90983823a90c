"""Where a moving camera will be."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orograph.rendering.gpu.stream.prediction import HORIZONS, Prediction
from orograph.viewpoint import View

VIEW = View((0.0, 0.0, 2000.0), (8000.0, 0.0, 500.0), width=320, height=200)


def told(places: list[tuple[float, float, float]], step: float = 1 / 60) -> tuple[Prediction, float]:
    seen, now = Prediction(), 0.0
    for place in places:
        moved = np.subtract(place, places[0])
        seen.see(replace(VIEW, eye=tuple(np.add(VIEW.eye, moved)), target=tuple(np.add(VIEW.target, moved))), now)
        now += step
    return seen, now


@pytest.mark.parametrize("step", [1 / 240, 1 / 60, 1 / 5])
def test_a_steady_flight_goes_on(step: float) -> None:
    places = [(300.0 * k * step, 0.0, 0.0) for k in range(math.ceil(2 / step))]
    seen, now = told(places, step)
    for horizon in (*HORIZONS[1:], HORIZONS[0]):
        ahead = seen.ahead(now)
        assert ahead is not None and ahead.eye[0] == pytest.approx(places[-1][0] + 300 * horizon, rel=0.02)
        assert np.subtract(ahead.target, ahead.eye) == pytest.approx(np.subtract(VIEW.target, VIEW.eye))
        assert seen.ahead(now + 0.01) is None  # so soon again
        now += 0.2


def test_a_camera_at_rest_or_after_a_jump_has_no_future() -> None:
    seen, now = told([(0.0, 0.0, 0.0)] * 5)
    assert not seen.moving and seen.ahead(now) is None
    seen, now = told([(5.0 * k, 0.0, 0.0) for k in range(30)])
    assert seen.moving
    seen.see(replace(VIEW, eye=(90_000.0, 0.0, 2000.0), target=(98_000.0, 0.0, 500.0)), now)
    assert not seen.moving
    seen, now = told([(5.0 * k, 0.0, 0.0) for k in range(30)] + [(145.0, 0.0, 0.0)] * 200)
    assert not seen.moving  # it has come to rest
    seen, now = told([(5.0 * k, 0.0, 0.0) for k in range(30)])
    seen.see(VIEW, now + 10.0)  # nobody drew for a while
    assert not seen.moving


def test_a_turn_of_the_head_turns_on() -> None:
    seen = Prediction()
    for k in range(60):
        angle = math.radians(30) * k / 60
        seen.see(replace(VIEW, target=(8000 * math.cos(angle), 8000 * math.sin(angle), 500.0)), k / 60)
    ahead = seen.at(0.5)
    assert ahead is not None and ahead.eye == pytest.approx(VIEW.eye, abs=1e-6)
    assert math.degrees(math.atan2(ahead.target[1], ahead.target[0])) == pytest.approx(30 + 15, abs=5)


def test_nothing_beyond_the_target_is_foreseen() -> None:
    seen, _ = told([(2000.0 * k / 60, 0.0, 0.0) for k in range(60)])
    ahead = seen.at(1e6)
    assert ahead is not None and ahead.eye[0] <= 2000.0 + VIEW.distance + 1
