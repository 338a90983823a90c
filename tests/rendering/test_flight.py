"""Scenarios that change with height and speed: each alone where it holds, smooth between, in pictures and films."""

from __future__ import annotations

import numpy as np
import pytest

import orograph
from orograph.errors import UsageError
from orograph.scene.flying import Flight
from orograph.scene.scene import Scene
from orograph.touring.film import Film
from orograph.touring.keys import Key

SIZE = (96, 72)
EDGE = Flight(500, 1500, 20, 80)


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    y, x = np.mgrid[:60, :80]
    return orograph.terrain((200 + 80 * np.sin(x / 9) * np.cos(y / 11)).astype(np.float32), spacing=100.0)


@pytest.fixture(scope="module")
def data() -> orograph.Dataset:
    members = np.random.default_rng(2).normal(0, 1, (5, 20, 30)).cumsum(2).astype(np.float32)
    return orograph.Dataset(members, band="all", uncertainty="spread", name="Field")


def above(ground: orograph.Terrain, metres: float) -> orograph.View:
    x, y = ground.grid.xy(40, 30)
    return orograph.View(
        (float(x), float(y) - 1500.0, 200.0 + metres), (float(x), float(y), 200.0), width=96, height=72
    )


def test_shares_are_those_of_the_scenarios_and_change_smoothly():
    assert EDGE.shares(100, 500) == (1, 0, 0)
    assert EDGE.shares(3000, 200) == EDGE.shares(3000, None) == (0, 1, 0)
    assert EDGE.shares(3000, 5) == (0, 0, 1)
    assert EDGE.shares(1000, 50) == pytest.approx((0.5, 0.25, 0.25))
    heights = np.linspace(0, 2000, 2001)
    found = np.array([EDGE.shares(h, 30.0) for h in heights])
    np.testing.assert_allclose(found.sum(1), 1)
    assert np.abs(np.diff(found, axis=0)).max() < 2e-3 and (np.diff(found[:, 0]) <= 0).all()


@pytest.mark.stress
@pytest.mark.parametrize(("metres", "name"), [(300, "approach"), (2500, "overflight")])
def test_a_picture_is_that_of_its_scenario(ground, data, metres, name):
    view = above(ground, metres)
    one = orograph.render(ground, view, data=data, flight="500:1500", furniture=True, progress=False)
    other = orograph.render(ground, view, data=data, priority=name, furniture=True, progress=False)
    np.testing.assert_array_equal(one.pixels[:, :40], other.pixels[:, :40])


@pytest.mark.stress
def test_a_film_changes_by_degrees(ground, data):
    """From near the ground up and away, then a stop: approach, overflight, re-planning."""
    tour = _tour(ground, [(0, -2000, 300), (4, -1200, 300), (12, 1000, 2500), (22, 1010, 2500)])
    scene = Scene.of(ground, above(ground, 300), data=data, flight=EDGE)
    film = Film(tour, scene, fps=4)
    shares = []
    for number in film.numbers:
        made = film.scene(number)
        flown = made.variants[0].weight
        shares.append(flown.filmed)
    found = np.array(shares)
    assert found[0, 0] == 1 and found[:, 1].max() > 0.8 and found[-4, 2] > 0.9
    assert np.abs(np.diff(found, axis=0)).max() <= 1 / 12 + 0.06  # at four frames a second, over three seconds
    frame = film.picture(film.numbers[-4])
    np.testing.assert_array_equal(frame.pixels, film.picture(film.numbers[-4]).pixels)


def _tour(ground, keys):
    x, y = (float(v) for v in ground.grid.xy(40, 30))
    return orograph.Tour(tuple(
        Key(orograph.View((x + east, y - 2500.0, 200.0 + up), (x, y, 200.0), width=96, height=72), time)
        for time, east, up in keys
    ))  # fmt: skip


@pytest.mark.parametrize("text", ["500", "1500:500", "1:2:3", "x:y", "500:1500:9:9"])
def test_what_makes_no_sense_is_refused(text):
    with pytest.raises(UsageError):
        Flight.parse(text)


def test_it_contradicts_a_priority(ground, data):
    with pytest.raises(UsageError, match="`flight` and `priority`"):
        orograph.render(ground, size=SIZE, data=data, flight="auto", priority="T+D+U+", progress=False)
