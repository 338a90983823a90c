"""Flights: through their keys, smoothly, and what is said of files that are none."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from orograph.errors import ReadError, UsageError
from orograph.flight import Flight
from orograph.splines import Monotone
from orograph.viewpoint import View


def look(eye, forward, distance=1000.0, **options):
    forward = np.asarray(forward, float) / np.linalg.norm(forward)
    return View(tuple(eye), tuple(np.add(eye, distance * forward)), **options)


def flight(*keys, seconds=None, fps=60.0):
    times, views = zip(*keys)
    return Flight(
        tuple(float(t) for t in times), tuple(views), float(seconds if seconds is not None else times[-1]), fps
    )


def eyes(views):
    return np.array([v.eye for v in views])


def forwards(views):
    aim = np.array([np.subtract(v.target, v.eye) for v in views])
    return aim / np.linalg.norm(aim, axis=1)[:, None]


TOUR = flight(
    (0, look((0, 0, 500), (1, 0, -0.2), fov_y=30)),
    (1.5, look((900, 100, 600), (1, 1, -0.3), 2000, fov_y=50)),
    (2, look((1000, 800, 650), (0, 1, -1), 1500, fov_y=50)),
    (5, look((-500, 2000, 400), (-1, 1, 0.1), 300, fov_y=20)),
    seconds=6,
)


def test_it_is_at_its_keys_in_time_and_rests_at_the_end():
    for time, view in zip(TOUR.times, TOUR.views):
        assert TOUR.at(time) == view
    assert TOUR.at(5.7) == TOUR.views[-1] and TOUR.at(-1) == TOUR.views[0]
    frames = list(TOUR.frames())
    assert len(frames) == len(TOUR) == 360
    assert frames[90] == TOUR.views[1] and frames[0] == TOUR.views[0]
    assert frames[41] == TOUR.at(41 / 60)


@pytest.mark.stress
def test_nothing_jumps():
    """Eye and direction have no step in velocity anywhere: halving the step halves the change of velocity."""
    for of in (eyes, forwards):
        bends = []
        for n in (1200, 2400):
            moves = np.diff(of([TOUR.at(t) for t in np.linspace(0, 5, n + 1)]), axis=0) * n
            bends.append(np.linalg.norm(np.diff(moves, axis=0), axis=1).max())
        assert bends[1] < 0.6 * bends[0]


def test_two_keys_are_a_straight_line_and_a_turn_at_even_speed():
    one = flight((0, look((0, 0, 0), (1, 0, 0))), (2, look((100, 50, 20), (1, 2, -0.5))))
    times = np.linspace(0, 2, 21)
    views = [one.at(t) for t in times]
    np.testing.assert_allclose(eyes(views), np.outer(times / 2, [100, 50, 20]), atol=1e-9)
    turn, _ = Rotation.align_vectors([[1, 2, -0.5], np.cross([1, 0, 0], [1, 2, -0.5])],
                                     [[1, 0, 0], np.cross([1, 0, 0], [1, 2, -0.5])])  # fmt: skip
    by_scipy = Slerp([0, 2], Rotation.concatenate([Rotation.identity(), turn]))(times).apply([1, 0, 0])
    np.testing.assert_allclose(forwards(views), by_scipy, atol=1e-9)
    distance = [np.linalg.norm(np.subtract(v.target, v.eye)) for v in views]
    np.testing.assert_allclose(distance, 1000, rtol=1e-12)


def test_even_keys_are_catmull_and_roms_own_spline():
    """With keys at equal distances the centripetal spline is the uniform one, whose matrix is in every textbook."""
    corners = np.array([[0, 0, 0], [3, 4, 0], [0, 8, 0], [3, 12, 0]]) * 100.0
    way = flight(*((k, look(p, (1, 0, 0))) for k, p in enumerate(corners)))
    matrix = 0.5 * np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]])
    for t in np.linspace(0, 1, 11):
        np.testing.assert_allclose(way.at(1 + t).eye, t ** np.arange(4) @ matrix @ corners, atol=1e-9)


def test_zooming_and_nearing_go_by_equal_factors():
    one = flight((0, look((0, 0, 0), (1, 0, 0), 100, fov_y=90)), (2, look((0, 0, 0), (1, 0, 0), 10_000, fov_y=10)))
    half = one.at(1)
    assert math.dist(half.eye, half.target) == pytest.approx(1000)
    assert math.tan(math.radians(half.fov_y) / 2) ** 2 == pytest.approx(math.tan(math.radians(5)))


def test_a_camera_that_waits_stands_still():
    here, there = look((0, 0, 0), (1, 0, 0)), look((100, 0, 0), (0, 1, 0))
    way = flight((0, here), (1, there), (3, there), (4, look((0, 200, 0), (0, 1, 0.5))))
    for t in np.linspace(1, 3, 15):
        np.testing.assert_allclose(way.at(t).eye, there.eye, atol=1e-9)
        np.testing.assert_allclose(forwards([way.at(t)])[0], [0, 1, 0], atol=1e-12)
    assert flight((0, here)).at(0) == here and len(flight((0, here))) == 1


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0.05, 5), st.floats(-100, 100)), min_size=3, max_size=7))
def test_the_cubic_is_scipys_inside_and_never_overshoots(steps):
    x = np.cumsum([s[0] for s in steps])
    y = np.array([s[1] for s in steps])
    t = np.linspace(x[0], x[-1], 101)
    ours = np.array([Monotone(x, y)(v) for v in t])
    for i in range(len(x) - 1):
        part = ours[(t >= x[i]) & (t <= x[i + 1])]
        assert (part >= min(y[i : i + 2]) - 1e-9).all() and (part <= max(y[i : i + 2]) + 1e-9).all()
    inner = (t >= x[1]) & (t <= x[-2])  # at its ends scipy has other slopes
    np.testing.assert_allclose(ours[inner], PchipInterpolator(x, y)(t[inner]), atol=1e-7)


def test_there_are_no_loops_between_uneven_keys():
    """Uniform Catmull-Rom makes a loop of these; centripetal ones do not cross themselves within a span."""
    points = [(800, 750, 0), (400, 450, 0), (400, 500, 0), (200, 750, 0)]
    way = flight(*((k, look(p, (1, 0, 0))) for k, p in enumerate(points)))
    for k in range(3):
        path = eyes([way.at(k + t) for t in np.linspace(0, 1, 60)])[:, :2]
        for (a, b), (c, d) in itertools.combinations(list(itertools.pairwise(path)), 2):
            if np.shares_memory(b, c) or (b == c).all():
                continue
            side = [
                (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
                for p, q, r in ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
            ]
            assert not (side[0] * side[1] < 0 and side[2] * side[3] < 0)


def test_files(tmp_path):
    path = tmp_path / "flight.json"
    path.write_text(json.dumps(TOUR.to_dict()))
    again = Flight.load(path)
    assert again == TOUR and [again.at(t) for t in (0.3, 2.2)] == [TOUR.at(t) for t in (0.3, 2.2)]
    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    key = {"crs": "EPSG:4326", "eye": [*move.transform(400_000, 3_800_000), 900],
           "target": [*move.transform(401_000, 3_800_000), 800]}  # fmt: skip
    path.write_text(json.dumps({"keys": [{"time": 0, **key}, {"time": 2, **key}]}))
    from_degrees = Flight.load(path, crs="EPSG:32611")
    assert from_degrees.seconds == 2 and from_degrees.fps == 60
    np.testing.assert_allclose(from_degrees.at(1).eye, (400_000, 3_800_000, 900), atol=1e-3)


KEY = {"time": 0, "eye": [0, 0, 10], "target": [5, 5, 0]}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "keys"),
        ({"keys": []}, "keys"),
        ({"keys": [KEY], "speed": 3}, "speed"),
        ({"keys": [KEY, 5]}, "Key 1"),
        ({"keys": [{k: v for k, v in KEY.items() if k != "time"}]}, '"time" of key 0'),
        ({"keys": [KEY, {**KEY, "time": 1, "target": [1, 2]}]}, "Key 1: .*target"),
        ({"keys": [KEY, {**KEY, "time": 0}]}, "key 1"),
        ({"keys": [KEY, {**KEY, "time": 3}], "seconds": 2}, "ends at 2 s"),
        ({"keys": [KEY, {**KEY, "time": 3, "width": 640}]}, "same width"),
        ({"keys": [KEY], "fps": 0}, "fps"),
        ({"keys": [KEY], "fps": "many"}, "fps"),
        ({"keys": [KEY], "seconds": 1e9}, "million"),
        ({"keys": [KEY, {**KEY, "time": 1, "target": [-5, -5, 20]}]}, "180°"),
    ],
)
def test_what_is_no_flight(tmp_path, values, words):
    path = tmp_path / "flight.json"
    path.write_text(json.dumps(values))
    with pytest.raises(UsageError, match=words) as error:
        Flight.load(path)
    assert str(path) in str(error.value)


def test_what_is_no_file(tmp_path):
    path = tmp_path / "flight.json"
    with pytest.raises(ReadError, match="cannot be read"):
        Flight.load(path)
    for text in ("{", "[1]"):
        path.write_text(text)
        with pytest.raises(ReadError, match=r"flight\.json"):
            Flight.load(path)
