"""Tours: through their keys in time, smoothly, on circles where circles are said; what is said of wrong files."""

from __future__ import annotations

import datetime
import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer
from scipy.integrate import quad
from scipy.optimize import minimize

from orograph.errors import ReadError, UsageError
from orograph.flight import Flight
from orograph.geovis.layers import Layer
from orograph.lighting.sun import Moment, Passage, Placed, passage
from orograph.touring import Key, Tour, moves
from orograph.touring.ways import RHO, zoom_path
from orograph.viewpoint import View

TARGET = (500.0, -300.0, 120.0)


def look(eye, target=TARGET, **options):
    return View(tuple(map(float, eye)), tuple(map(float, target)), **options)


def around(azimuth, pitch=30.0, distance=1000.0, target=TARGET):
    a, p = math.radians(azimuth), math.radians(pitch)
    arm = np.array([math.sin(a) * math.cos(p), math.cos(a) * math.cos(p), math.sin(p)]) * distance
    return look(np.add(target, arm), target)


def eyes(tour, times):
    return np.array([tour.at(t).eye for t in times])


def spline(**options):
    points = [(0, 0, 500), (900, 100, 800), (1000, 800, 650), (1100, 900, 640), (-500, 2000, 900)]
    times = (0.0, 1.5, 2.0, 3.0, 6.0)
    return Tour(tuple(Key(look(p), t) for p, t in zip(points, times)), **options)


# ---- where the camera is ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"ease": False}, {"loop": True, "seconds": 9.0}, {"aim": "direction"}])
def test_it_is_at_its_keys_in_time(options):
    tour = spline(**options)
    for key, time in zip(tour.keys, tour.times):
        assert tour.at(time) == key.view
        near = tour.at(time + 1e-7)
        np.testing.assert_allclose(near.eye, key.view.eye, atol=1e-3)
        np.testing.assert_allclose(near.target, key.view.target, atol=1e-3)
    assert len(tour) == round(tour.duration * 30) and tour.duration == options.get("seconds", 6.0)
    assert list(tour.frames())[45] == tour.at(1.5) == tour.keys[1].view
    if tour.loop:
        assert tour.at(tour.duration) == tour.keys[0].view and tour.at(10.0) == tour.at(1.0)
    else:
        assert tour.at(-1) == tour.keys[0].view and tour.at(99) == tour.keys[-1].view


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    "tour",
    [
        spline(),
        spline(loop=True, seconds=9.0),
        spline(aim="direction"),
        Tour((Key(around(0), 0.0, path="orbit"), Key(around(90, 50, 400), 2.0, hold=1.0, path="orbit", turns=-1),
              Key(around(200), 5.0, path="spline"), Key(look((3000, 0, 900)), 7.0, path="zoom"),
              Key(look((9000, 500, 700), (9500, 0, 0)), 10.0), Key(look((9900, 900, 900), (9500, 0, 0)), 12.0))),
    ],
)  # fmt: skip
def test_nothing_jumps(tour):
    """Position and direction have no step in velocity anywhere: halving the step halves the change of velocity."""

    def forwards(times):
        aim = np.array([np.subtract(v.target, v.eye) for v in map(tour.at, times)])
        return aim / np.linalg.norm(aim, axis=1)[:, None]

    span = (0, 2 * tour.duration) if tour.loop else (-0.5, tour.duration + 0.5)
    for of in (lambda times: eyes(tour, times), forwards):
        bends = []
        for n in (1000, 2000):
            times = np.linspace(*span, n + 1)
            moves = np.diff(of(times), axis=0) / (times[1] - times[0])
            bends.append(np.linalg.norm(np.diff(moves, axis=0), axis=1).max())
        assert bends[1] < 0.65 * bends[0]


def test_a_tour_without_ease_is_on_its_way_at_once():
    tour = spline(ease=False)
    started = np.linalg.norm(eyes(tour, [0.0, 0.01])[1] - eyes(tour, [0.0])[0]) / 0.01
    eased = np.linalg.norm(eyes(spline(), [0.0, 0.01])[1] - eyes(tour, [0.0])[0]) / 0.01
    assert started > 200 and eased < 20


@pytest.mark.parametrize("turns", [1, -2])
def test_an_orbit_is_a_circle_gone_round_at_even_speed(turns):
    tour = Tour((Key(around(40), 0.0, path="orbit", turns=turns),), seconds=12.0, loop=True)
    times = np.linspace(0, 12, 97)
    arm = eyes(tour, times) - TARGET
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), 1000, rtol=1e-12)
    np.testing.assert_allclose(arm[:, 2], 500, rtol=1e-12)
    azimuth = np.degrees(np.unwrap(np.arctan2(arm[:, 0], arm[:, 1])))
    np.testing.assert_allclose(azimuth, 40 + 360 * turns * times / 12, atol=1e-9)
    assert all(tour.at(t).target == pytest.approx(TARGET, abs=1e-9) for t in times)


def test_keys_on_a_circle_are_nearly_one_for_a_spline():
    """Catmull-Rom through every 15° of a circle: its largest error is in closed form 1.06e-4 of the radius."""
    keys = tuple(Key(around(15.0 * k), 0.5 * k) for k in range(24))
    tour = Tour(keys, seconds=12.0, loop=True)
    radius = np.linalg.norm(eyes(tour, np.linspace(0, 12, 481)) - TARGET, axis=1)
    middle = (18 * math.cos(math.radians(7.5)) - 2 * math.cos(math.radians(22.5))) / 16  # of the points mirrored
    ring = 1000 * math.cos(math.radians(30))
    least = math.hypot(ring * middle, 500)
    assert radius.max() <= 1000 + 1e-9 and radius.min() == pytest.approx(least, abs=1e-6)
    gone = np.linalg.norm(np.diff(eyes(tour, np.linspace(0, 12, 4801)), axis=0), axis=1) * 400
    assert gone.min() == pytest.approx(ring * math.sin(math.radians(15)) / 0.5, rel=1e-3)  # at the keys
    assert gone.max() / gone.min() < 1.02


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(-2e3, 2e3), st.floats(-2e3, 2e3), st.floats(100, 3e3)), min_size=2, max_size=7,
                unique=True), st.booleans(), st.booleans())  # fmt: skip
def test_heights_stay_between_those_of_the_keys(points, loop, ease):
    far = (0.0, 1e5, 0.0)
    tour = Tour(tuple(Key(look(p, far), 1.0 * k) for k, p in enumerate(points)), ease=ease, loop=loop,
                seconds=float(len(points)))  # fmt: skip
    order = [*points, points[0]] if loop else points
    for k, (a, b) in enumerate(pairwise(order)):
        heights = eyes(tour, np.linspace(k, k + 1, 40)[1:-1])[:, 2]
        assert heights.min() >= min(a[2], b[2]) - 1e-6 and heights.max() <= max(a[2], b[2]) + 1e-6


@pytest.mark.stress
def test_a_speed_is_kept():
    keys = tuple(Key(around(70.0 * k, 30.0, 2000.0), stop=k == 2, hold=1.5 * (k == 3)) for k in range(5))
    tour = Tour(keys, speed=150.0)
    times = np.linspace(0, tour.duration, 20_001)
    speed = np.linalg.norm(np.diff(eyes(tour, times), axis=0), axis=1) / (times[1] - times[0])
    middle = (times[1:] + times[:-1]) / 2
    rests = [0.0, tour.times[2], tour.times[3], tour.times[3] + 1.5, tour.times[4]]
    away = np.min([np.abs(middle - r) for r in rests], axis=0) > 1.001
    away &= ~((middle > tour.times[3]) & (middle < tour.times[3] + 1.5))
    np.testing.assert_allclose(speed[away], 150.0, rtol=1e-3)
    assert away.mean() > 0.3 and speed.max() < 150.2
    for rest in rests:
        assert speed[np.argmin(np.abs(middle - rest))] < 1.0
    for key, time in zip(tour.keys, tour.times):
        np.testing.assert_allclose(tour.at(time - 1e-9).eye, key.view.eye, atol=1e-2)


def test_a_speed_gives_an_orbit_its_time():
    keys = (Key(around(0, 0.0), path="orbit"), Key(around(120, 0.0), path="orbit"), Key(around(240, 0.0), path="orbit"))
    tour = Tour(keys, speed=100.0, loop=True)
    assert tour.duration == pytest.approx(2 * math.pi * 1000 / 100, rel=1e-4)
    gone = np.linalg.norm(np.diff(eyes(tour, np.linspace(0, tour.duration, 1001)), axis=0), axis=1)
    np.testing.assert_allclose(gone, gone.mean(), rtol=1e-3)


def test_it_holds_and_stops():
    tour = Tour((Key(look((0, 0, 900)), 0.0), Key(look((900, 0, 900)), 2.0, hold=1.0), Key(look((900, 900, 900)), 5.0,
                 stop=True), Key(look((0, 900, 950)), 7.0, hold=2.0)))  # fmt: skip
    assert tour.duration == 9.0
    for t in np.linspace(2, 3, 9):
        assert tour.at(t) == tour.keys[1].view
    assert tour.at(8) == tour.keys[3].view
    h = 1e-4
    for t in (2.0, 3.0, 5.0, 7.0):
        assert np.linalg.norm(eyes(tour, [t + h])[0] - eyes(tour, [t - h])[0]) / (2 * h) < 0.5
    assert np.linalg.norm(eyes(tour, [1 + h])[0] - eyes(tour, [1 - h])[0]) / (2 * h) > 100


# ---- zooming ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("w0", "w1", "u1"), [(100, 100, 5000), (5000, 100, 300), (50, 2000, 40), (80, 90, 0)])
def test_the_way_of_a_zoom_is_the_shortest_and_gone_at_even_speed(w0, w1, u1):
    """van Wijk & Nuij's metric: ds² = (ρ² du² + dw²/ρ²) / w². No way that we try beside theirs is shorter."""
    path = zoom_path(w0, w1, u1)
    assert path(0)[1] == pytest.approx(w0) and path(1)[1] == pytest.approx(w1)
    assert path(0)[0] == pytest.approx(0, abs=1e-9) and path(1)[0] == pytest.approx(1)

    def length(us, ws):
        u, w = np.asarray(us), np.asarray(ws)
        return (np.sqrt(RHO**2 * np.diff(u) ** 2 + np.diff(w) ** 2 / RHO**2) / ((w[1:] + w[:-1]) / 2)).sum()

    parts = np.linspace(0, 1, 401)
    u, w = (np.array(v) for v in zip(*(path(p) for p in parts)))
    u = u * u1
    steps = np.sqrt(RHO**2 * np.diff(u) ** 2 + np.diff(w) ** 2 / RHO**2) / ((w[1:] + w[:-1]) / 2)
    np.testing.assert_allclose(steps, steps.mean(), rtol=2e-3)
    ours, pick = length(u, w), slice(None, None, 20)
    start = np.concatenate([u[pick][1:-1], np.log(w[pick])[1:-1]])
    k = len(start) // 2

    def tried(x):
        us = np.interp(parts, parts[pick], np.concatenate([[0], x[:k], [u1]]))
        return length(us, np.exp(np.interp(parts, parts[pick], np.concatenate([[np.log(w0)], x[k:], [np.log(w1)]]))))

    best = minimize(tried, start, method="L-BFGS-B", options={"maxiter": 60})
    assert ours <= best.fun * (1 + 1e-3)
    for scale in (0.7, 1.4):  # and ways that are another are longer
        assert u1 == 0 or length(u, w * np.exp(np.log(scale) * np.sin(np.pi * parts))) > ours


def test_a_zoom_flight_rises_and_comes_down():
    a, b = look((0, -500, 500), (0, 0, 0)), look((40_000, -500, 500), (40_000, 0, 0))
    tour = Tour((Key(a, 0.0, path="zoom"), Key(b, 8.0)))
    heights = eyes(tour, np.linspace(0, 8, 81))[:, 2]
    assert heights.argmax() == 40 and heights.max() > 10_000
    assert (np.diff(heights[:41]) > 0).all() and (np.diff(heights[40:]) < 0).all()
    views = [tour.at(t) for t in np.linspace(0, 8, 9)]
    for view in views:  # the camera keeps its direction
        aim = np.subtract(view.target, view.eye)
        np.testing.assert_allclose(aim / np.linalg.norm(aim), [0, math.sqrt(0.5), -math.sqrt(0.5)], atol=1e-9)
    with pytest.raises(UsageError, match='"zoom" has no speed'):
        Tour((Key(a, path="zoom"), Key(b)), speed=5.0)


# ---- light and numbers -----------------------------------------------------------------------------------------------


def test_numbers_change_between_the_keys_that_say_them():
    tour = Tour((Key(look((0, 0, 900)), 0.0, exaggeration=1.0, sun=Placed(350, 20)), Key(look((900, 0, 900)), 2.0),
                 Key(look((900, 900, 900)), 4.0, exaggeration=3.0, hold=1.0, sun=Placed(10, 40))))  # fmt: skip
    values = [tour.settings(t)["exaggeration"] for t in np.linspace(0, 5, 51)]
    assert values[0] == 1 and 1.5 < values[20] < 2.5 and values[40] == values[50] == 3
    assert (np.diff(values) >= 0).all() and set(tour.settings(1.0)) == {"exaggeration"}
    turned = [(tour.sun(t).azimuth + 180) % 360 - 180 for t in np.linspace(0, 5, 51)]  # by way of north
    assert turned[0] == pytest.approx(-10) and turned[40] == pytest.approx(10) and (np.diff(turned) > -1e-9).all()
    assert 25 < tour.sun(2.0).altitude < 35


def test_a_day_passes():
    start = datetime.datetime.fromisoformat("2026-06-21T06:00+02:00")
    end = datetime.datetime.fromisoformat("2026-06-21T18:00+02:00")
    tour = Tour((Key(look((0, 0, 900)), 0.0, sun=Moment(start)), Key(look((9, 0, 900)), 10.0, sun=Moment(end))))
    noon = tour.sun(5.0)
    assert isinstance(noon, Moment) and noon.when == datetime.datetime.fromisoformat("2026-06-21T12:00+02:00")
    with pytest.raises(UsageError, match="directions or all times"):
        Tour((Key(look((0, 0, 900)), 0.0, sun=Moment(start)), Key(look((9, 0, 900)), 10.0, sun=Placed(0, 10))))


def test_a_turning_sun_goes_on_where_a_loop_closes():
    keys = tuple(Key(around(60.0 * k), 2.0 * k, path="orbit", sun=Placed((300 + 60.0 * k) % 360, 30)) for k in range(6))
    tour = Tour(keys, seconds=12.0, loop=True)
    for t in np.linspace(0, 11.9, 60):
        eye = np.subtract(tour.at(t).eye, TARGET)
        camera = math.degrees(math.atan2(eye[0], eye[1]))
        assert (tour.sun(t).azimuth - camera - 300 + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_layers_fade_between_the_keys_that_say_them():
    low, high, old = Layer("low.tif"), Layer("high.tif", 0.8, blend="multiply"), Layer("old.tif")
    tour = Tour((Key(look((0, 0, 900)), 0.0, layers=(low, replace(high, visible=False))), Key(look((900, 0, 900)), 2.0),
                 Key(look((900, 900, 900)), 4.0, layers=(old, high), hold=1.0)))  # fmt: skip
    assert tour.layers(0.0) == (low,)
    assert tour.layers(5.0) == (old, high)
    found = [{layer.path: layer.opacity for layer in tour.layers(t)} for t in np.linspace(0, 4, 41)]
    assert set(found[20]) == {"low.tif", "high.tif", "old.tif"}
    assert [layer.path for layer in tour.layers(2.0)] == ["old.tif", "low.tif", "high.tif"]
    for path, up in (("low.tif", False), ("high.tif", True), ("old.tif", True)):
        steps = np.diff([f.get(path, 0.0) for f in found])
        assert ((steps >= 0) if up else (steps <= 0)).all() and np.abs(steps).max() < 0.1
    assert Tour((Key(look((0, 0, 900)), 0.0),)).layers(0.0) is None


# ---- files -----------------------------------------------------------------------------------------------------------


def test_a_files_layers_are_found_beside_it(tmp_path):
    (tmp_path / "map.tif").touch()
    key = {**KEY, "layers": ["map.tif,opacity=0.5", {"path": "far.tif", "colormap": "viridis", "range": [0, 5]}]}
    (tmp_path / "tour.json").write_text(json.dumps({"keys": [key]}))
    tour = Tour.load(tmp_path / "tour.json")
    expected = (Layer(str(tmp_path / "map.tif"), 0.5), Layer("far.tif", colormap="viridis", range=(0, 5)))
    assert tour.layers(0.0) == expected
    assert Tour.from_dict(tour.to_dict()).layers(0.0) == expected


def test_files(tmp_path):
    path = tmp_path / "tour.json"
    tour = Tour(
        (Key(look((0, 0, 900)), 0.0, hold=1.0, sun=Placed(315, 30), exaggeration=1.5, path="orbit", turns=1),
         Key(look((900, 0, 900)), 4.0, stop=True, path="zoom"), Key(look((4000, 0, 900)), 9.0, water=12.0)),
        seconds=11.0, fps=24.0, aim="direction", above_ground=20.0,
    )  # fmt: skip
    path.write_text(json.dumps(tour.to_dict()))
    again = Tour.load(path)
    assert again == tour and [again.at(t) for t in (0.3, 6.2)] == [tour.at(t) for t in (0.3, 6.2)]
    fast = Tour((Key(look((0, 0, 900))), Key(look((900, 0, 900)))), speed=100.0)
    assert Tour.from_dict(fast.to_dict()) == fast
    assert fast.resized(64, 32).duration == replace(fast, fps=5.0).duration == fast.duration
    assert fast.duration == pytest.approx(10.0)  # 9 s, and half a second for each ramp


def test_ways_to_say_a_camera():
    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    there = [*move.transform(400_000, 3_800_000), 900]
    common = {"crs": "EPSG:4326", "fov_y": 30, "exaggeration": 2}
    tour = Tour.from_dict(
        {**common, "keys": [
            {"time": 0, "target": there, "azimuth": 90, "pitch": 30, "distance": 2000},
            {"time": 3, "eye": there, "heading": 270, "pitch": 0, "fov_y": 50},
            {"time": 5, "eye": there, "target": [there[0], there[1], 0], "exaggeration": 1},
        ]}, crs="EPSG:32611",
    )  # fmt: skip
    first, second, third = (key.view for key in tour.keys)
    np.testing.assert_allclose(first.target, (400_000, 3_800_000, 900), atol=1e-3)
    np.testing.assert_allclose(first.eye, (400_000 + 2000 * math.cos(math.pi / 6), 3_800_000, 1900), atol=1e-3)
    np.testing.assert_allclose(second.eye, (400_000, 3_800_000, 900), atol=1e-3)
    np.testing.assert_allclose(second.target, (399_000, 3_800_000, 900), atol=1e-3)
    np.testing.assert_allclose(third.target, (400_000, 3_800_000, 0), atol=1e-3)
    assert [first.fov_y, second.fov_y] == [30, 50] and [k.exaggeration for k in tour.keys] == [2, 2, 1]


def test_a_flight_is_a_tour():
    flight = Flight((0.0, 2.0, 3.0), (look((0, 0, 900)), look((900, 0, 900)), look((900, 800, 700))), 4.0, 25.0)
    tour = Tour.from_dict(flight.to_dict())
    assert len(tour) == len(flight) and tour.fps == 25
    assert [tour.at(t) for t in (0, 2, 3)] == [flight.at(t) for t in (0, 2, 3)]


def test_a_tour_can_stand_where_a_flight_does(tmp_path):
    flight = Flight((0.0, 2.0), (look((0, 0, 900)), look((900, 0, 900))), 2.0, 25.0)
    path = tmp_path / "way.json"
    path.write_text(json.dumps(flight.to_dict()))
    assert moves(path) == flight
    path.write_text(json.dumps({**flight.to_dict(), "ease": False}))
    assert isinstance(moves(path), Tour) and len(list(moves(path).frames())) == 50
    path.write_text(json.dumps({"keys": []}))
    with pytest.raises(UsageError, match="keys"):
        moves(path)


KEY = {"time": 0, "eye": [0, 0, 10], "target": [5, 5, 0]}
NEXT = {"time": 1, "eye": [9, 0, 10], "target": [5, 5, 0]}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, 'lacks "keys"'),
        ({"keys": []}, "is empty"),
        ({"keys": "no"}, "must be a list"),
        ({"keys": [KEY], "velocity": 3}, "velocity"),
        ({"keys": [KEY, 5]}, "Key 1"),
        ({"keys": [KEY, {**NEXT, "roll": 2}]}, "Key 1: There is no 'roll'"),
        ({"keys": [KEY, {**NEXT, "time": None}]}, '"time" of key 1 is missing'),
        ({"keys": [KEY, {**NEXT, "time": "soon"}]}, 'Key 1: The "time" must be a number'),
        ({"keys": [KEY, {**NEXT, "target": [1, 2]}]}, "Key 1: .*target"),
        ({"keys": [KEY, {**NEXT, "time": 0}]}, "key 1"),
        ({"keys": [{**KEY, "hold": 2}, NEXT]}, "hold of 2 s"),
        ({"keys": [KEY, {**NEXT, "time": 3}], "seconds": 2}, "ends at 2 s"),
        ({"keys": [KEY, {**NEXT, "width": 640}]}, "same width"),
        ({"keys": [KEY], "fps": 0}, "fps"),
        ({"keys": [KEY], "seconds": 1e9}, "million"),
        ({"keys": [KEY, NEXT], "loop": True}, 'loop needs "seconds"'),
        ({"keys": [KEY, NEXT], "loop": True, "seconds": 1}, "for the way back"),
        ({"keys": [KEY, NEXT], "loop": 1}, '"loop" must be true or false'),
        ({"keys": [KEY, NEXT], "speed": 10}, 'Key 0 has a "time"'),
        ({"keys": [{**KEY, "time": None}] * 2, "speed": 10}, "does not move from key 0"),
        ({"keys": [KEY, NEXT], "speed": -1}, "speed"),
        ({"keys": [{**KEY, "path": "teleport"}, NEXT]}, "Key 0: .*spline, orbit, zoom"),
        ({"keys": [{**KEY, "turns": 2}, NEXT]}, "Key 0: .*orbit"),
        ({"keys": [{**KEY, "exaggeration": 0}, NEXT]}, "Key 0: .*exaggeration"),
        ({"keys": [{**KEY, "sun": [1, 2, 3]}, NEXT]}, 'Key 0: The "sun"'),
        ({"keys": [{**KEY, "sun": "2026-06-21T12:00"}, NEXT]}, "Key 0: .*time zone"),
        ({"keys": [{"time": 0, "target": [5, 5, 0], "azimuth": 3, "distance": 9}]}, 'lacks "pitch"'),
        ({"keys": [{"time": 0, "eye": [5, 5, 0], "azimuth": 3, "pitch": 9}]}, 'lacks "heading"'),
        ({"keys": [{**KEY, "heading": 3, "pitch": 9}]}, "either"),
        ({"keys": [{"time": 0, "eye": [5, 5, 0]}]}, "'target'"),
        ({"keys": [KEY, {**NEXT, "target": [-5, -5, 20], "eye": [0, 0, 10]}], "aim": "direction"}, "0 to 1: .*180°"),
        ({"keys": [KEY], "tour": 2}, "format 2"),
        ({"keys": [KEY], "aim": "high"}, "aim"),
        ({"keys": [{**KEY, "layers": [{"path": "a.tif", "opacity": 2}]}]}, "Key 0: .*0 to 1"),
        ({"keys": [{**KEY, "layers": "a.tif"}]}, "Key 0: .*list"),
    ],
)
def test_what_is_no_tour(tmp_path, values, words):
    path = tmp_path / "tour.json"
    path.write_text(json.dumps(values))
    with pytest.raises(UsageError, match=words) as error:
        Tour.load(path)
    assert str(path) in str(error.value)


def test_what_is_no_file(tmp_path):
    path = tmp_path / "tour.json"
    with pytest.raises(ReadError, match="cannot be read"):
        Tour.load(path)
    for text in ("{", "[1]"):
        path.write_text(text)
        with pytest.raises(ReadError, match=r"tour\.json"):
            Tour.load(path)


def test_flying_through_what_is_looked_at_is_said():
    tour = Tour((Key(look((0, 0, 100), (500, 0, 100)), 0.0), Key(look((1000, 0, 100), (500, 0, 100)), 2.0)))
    with pytest.raises(UsageError, match="flies through"):
        tour.at(1.0)


def test_the_length_of_a_ramp():
    from orograph.touring.schedule import Cruise

    leg = Cruise(500.0, 100.0, True, False)
    distance, _ = quad(lambda t: (leg(t + 1e-5) - leg(t - 1e-5)) / 2e-5, 1e-4, leg.seconds - 1e-4, limit=200)
    assert distance == pytest.approx(500, rel=1e-3) and leg.seconds == pytest.approx(5.5)
    for speed, seconds in ((100.0, 5.5), (100.0, 1.2), (7.0, 2.0)):
        length = Cruise.length_of(seconds, speed)
        assert Cruise(length, speed, True, True).seconds == pytest.approx(seconds)
        assert Cruise.speed_for(length, seconds) == pytest.approx(speed)
    short = Cruise(10.0, 100.0, True, True)
    assert short(short.seconds / 2) == pytest.approx(5.0) and short(short.when(3.0)) == pytest.approx(3.0)


DAY = "2026-10-15T06:00-07:00..2026-10-15T18:00-07:00"


def test_a_passage_of_the_sun_is_even_in_time_and_goes_through_files(tmp_path):
    keys = [{"time": 0, "eye": [0, 0, 9], "target": [5, 5, 0], "sun": "2020-01-01T00:00Z"}, {"time": 6}]
    tour = Tour.from_dict({"sun": DAY, "seconds": 8, "keys": keys})
    for time, hour in ((0, 6), (2, 9), (4, 12), (8, 18)):
        assert tour.sun(time).when.isoformat() == f"2026-10-15T{hour:02}:00:00-07:00"
    tour.save(tmp_path / "t.json")
    back = Tour.load(tmp_path / "t.json")
    assert back.passage == tour.passage == passage(DAY) and back.sun(4) == tour.sun(4)


@pytest.mark.parametrize(
    ("given", "ends"),
    [
        ("2026-10-15T06:00-07:00..18:00", ("2026-10-15T13:00+00:00", "2026-10-16T01:00+00:00")),
        ("2026-10-15T06:00Z..18:00+02:00", ("2026-10-15T06:00+00:00", "2026-10-15T16:00+00:00")),
        (("2026-10-15T06:00Z", "2026-10-16T06:00Z"), ("2026-10-15T06:00+00:00", "2026-10-16T06:00+00:00")),
        (
            (datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC), datetime.datetime(2026, 1, 2, tzinfo=datetime.UTC)),
            ("2026-01-01T00:00+00:00", "2026-01-02T00:00+00:00"),
        ),
        ((315.0, 45.0), None),
        ("2026-10-15T06:00Z", None),
        (None, None),
    ],
)
def test_what_a_passage_may_be_given_as(given, ends):
    found = passage(given)
    if ends is None:
        assert found is None
    else:
        assert isinstance(found, Passage)
        assert (found.begin.when, found.end.when) == tuple(map(datetime.datetime.fromisoformat, ends))


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("2026-10-15T18:00Z..06:00", "not after its beginning"),
        ("315,45..330,20", "'315,45' is not a time"),
        ("2026-10-15T06:00..18:00", "no time zone"),
        ("2026-10-15T06:00Z..noon", "'noon' is not a sun"),
        ((datetime.datetime(2026, 1, 1), datetime.datetime(2026, 1, 2)), "no time zone"),
    ],
)
def test_what_is_no_passage(given, says):
    with pytest.raises(UsageError, match=says):
        passage(given)


def test_a_key_without_a_camera_has_that_of_the_key_before():
    first = {"time": 0, "target": [-71.3, 44.27, 1500], "azimuth": 20, "pitch": 30, "distance": 900, "fov_y": 33}
    values = {"crs": "EPSG:4326", "keys": [first, {"time": 1}, {"time": 2, "azimuth": 80}]}
    a, b, c = (key.view for key in Tour.from_dict(values, crs="EPSG:32619").keys)
    assert b == a and b.fov_y == 33
    assert c.target == pytest.approx(a.target) and c.distance == pytest.approx(900) and c.eye[0] > a.eye[0] + 400
    assert Tour.from_dict({"keys": [{**first, "crs": "EPSG:4326"}, {"time": 1}]}, crs="EPSG:32619").keys[1].view == a
    seen = look((0, -900, 500), width=320, height=200)
    asked = []

    def whole(width, height):
        asked.append((width, height))
        return seen

    values = {"crs": "EPSG:4326", "width": 320, "height": 200, "keys": [{"time": 0}, {"time": 1, "fov_y": 20}]}
    views = [key.view for key in Tour.from_dict(values, crs="EPSG:32619", whole=whole).keys]
    assert views == [seen, replace(seen, fov_y=20.0)] and asked == [(320, 200)]
    with pytest.raises(UsageError, match="Key 0: The camera lacks 'eye'"):
        Tour.from_dict({"keys": [{"time": 0}]})
