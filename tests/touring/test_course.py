"""Tours over ground: never below what was asked, framed from every side, along lines from files."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer
from scenes import hills, terrain

from orograph.errors import ReadError, UsageError
from orograph.scene.camera import MARGIN, ground, outline
from orograph.touring import Key, Tour, make
from orograph.touring.course import Course, eased, highest
from orograph.viewpoint import View

LAND = terrain(hills(120, 160, tall=700))
SIZE = (320, 180)


def place(col, row):
    return tuple(float(v) for v in LAND.grid.xy(col, row))


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(0, 100), min_size=2, max_size=80), st.integers(1, 30), st.booleans())
def test_an_eased_lift_is_nowhere_too_low(need, reach, loop):
    need = np.array([*need, need[0]] if loop else need)
    soft = eased(need, reach, loop)
    assert soft.shape == need.shape and (soft >= need - 1e-9).all() and soft.max() <= need.max() + 1e-9
    assert not loop or soft[0] == soft[-1]


def test_an_eased_lift_is_smooth():
    need = np.zeros(400)
    need[200] = 100.0
    soft = eased(need, 60)
    assert soft[200] == pytest.approx(100) and soft[:60].max() < 1e-9
    assert np.abs(np.diff(soft)).max() < 4 and np.abs(np.diff(soft, 2)).max() < 0.2


@pytest.mark.cases(1)
@pytest.mark.parametrize("loop", [False, True])
def test_the_eye_stays_above_the_ground(loop):
    """Across the hills at a height that many of them exceed; what is below the eye is found by another way."""
    keys = tuple(Key(View((*place(*p), 750.0), (*place(80, 60), 0.0)), 2.0 * k)
                 for k, p in enumerate([(5, 10), (150, 30), (140, 110), (20, 100)]))  # fmt: skip
    tour = Tour(keys, above_ground=60.0, loop=loop, seconds=9.0)
    course = Course(tour, LAND)
    above, below = [], []
    for time in np.linspace(0, 9, 1500):
        x, y, z = course.at(time).eye
        above.append(z - ground(LAND, x, y, default=math.nan))
        below.append(tour.at(time).eye[2] - ground(LAND, x, y, default=math.nan))
        assert course.at(time).target == tour.at(time).target and z >= tour.at(time).eye[2]
    assert min(below) < -200 and min(above) >= 60 and course.lifted > 260
    assert course.at(0.0) == course.at(9.0) or not loop
    high = Course(Tour((Key(View((*place(80, 60), 9000.0), (*place(80, 61), 0.0)), 0.0),), above_ground=60.0), LAND)
    assert high.lift is None and high.lifted == 0


def test_highest_is_no_lower_than_the_surface():
    rng = np.random.default_rng(4)
    spots = np.stack([rng.uniform(-2, 161, 300), rng.uniform(-2, 121, 300)], 1)
    places = np.array([place(*s) for s in spots])
    found = highest(LAND, places)
    for (x, y), (col, row), h in zip(places, spots, found):
        inside = 0 <= col <= 159 and 0 <= row <= 119
        assert np.isfinite(h) == inside
        if inside:
            assert ground(LAND, x, y, default=math.nan) <= h + 1e-3


@pytest.mark.parametrize("pitch", [10.0, 35.0, 80.0])
@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
def test_an_orbit_shows_all_from_every_side(pitch, exaggeration):
    tour = make.orbit(LAND, SIZE, pitch=pitch, exaggeration=exaggeration)
    reach = []
    for time in np.linspace(0, tour.duration, 48, endpoint=False):
        pixels, _ = tour.at(time).project(outline(LAND), exaggeration)
        across = np.abs(pixels / [SIZE[0] / 2, SIZE[1] / 2] - 1)
        reach.append(across.max())
    assert max(reach) <= MARGIN + 0.01 and max(reach) > MARGIN - 0.02
    assert tour.at(tour.duration) == tour.at(0)


@pytest.mark.parametrize("size", [SIZE, (180, 320)])
@pytest.mark.parametrize("exaggeration", [1.0, 2.0])
def test_an_orbit_round_a_place_holds_the_ground_around_it_and_keeps_above_the_rest(size, exaggeration):
    x, y = place(100, 80)
    lonlat = Transformer.from_crs(LAND.grid.crs, "EPSG:4326", always_xy=True).transform(x, y)
    tour = make.orbit(LAND, size, around=(*lonlat, 500.0), pitch=30.0, exaggeration=exaggeration)
    z = ground(LAND, x, y, default=math.nan)
    turn = np.linspace(0, 2 * np.pi, 90)
    ring = np.stack([x + 500 * np.sin(turn), y + 500 * np.cos(turn), np.full(90, z)], 1)
    reach = []
    for time in np.linspace(0, tour.duration, 24, endpoint=False):
        view = tour.at(time)
        np.testing.assert_allclose(view.target, (x, y, z), atol=1e-3)
        pixels, depth = view.project(ring, exaggeration)
        assert (depth > 0).all()
        reach.append(np.abs(pixels / [size[0] / 2, size[1] / 2] - 1).max())
    assert max(reach) <= 1.0 + 1e-6 and max(reach) > 0.5
    near = make.orbit(LAND, size, around=lonlat, pitch=1.0, distance=900.0)
    course = Course(near, LAND)
    for time in np.linspace(0, near.duration, 24, endpoint=False):
        eye = course.at(time).eye
        below = ground(LAND, eye[0], eye[1], default=-math.inf)
        assert eye[2] >= below + 17.0
    light = make.turntable(LAND, size, around=(*lonlat, 500.0), pitch=30.0, exaggeration=exaggeration)
    np.testing.assert_allclose(light.at(3.0).eye, tour.at(3.0).eye)
    with pytest.raises(UsageError, match="km beyond the terrain's northern border"):
        make.orbit(LAND, size, around=(lonlat[0], lonlat[1] + 1))
    with pytest.raises(UsageError, match="radius"):
        make.orbit(LAND, size, around=(*lonlat, 0.0))


def test_a_turntable_s_light_turns_with_the_camera():
    tour = make.turntable(LAND, SIZE, sun=(300.0, 30.0))
    for time in (0.0, 1.3, 7.9, 11.9):
        view = tour.at(time)
        side = math.degrees(math.atan2(*np.subtract(view.eye, view.target)[:2]))
        assert (tour.sun(time).azimuth - side - 120 + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_along_a_line():
    line = np.array([place(*p) for p in [(10, 10), (80, 40), (150, 110)]])
    tour = make.flyover(LAND, SIZE, line, height=150.0, speed=200.0)
    length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    way = np.array([tour.at(t).eye for t in np.linspace(0, tour.duration, 2000)])
    assert tour.duration == pytest.approx(np.linalg.norm(np.diff(way, axis=0), axis=1).sum() / 200 + 1, rel=1e-3)
    assert np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1).sum() == pytest.approx(length, rel=0.05)
    np.testing.assert_allclose(tour.at(0).eye[:2], line[0], atol=1e-6)
    np.testing.assert_allclose(tour.at(99).eye[:2], line[-1], atol=1e-6)
    course = Course(tour, LAND)
    for time in np.linspace(0, tour.duration, 60):
        view = course.at(time)
        assert view.eye[2] - ground(LAND, *view.eye[:2], default=math.nan) >= 75
        along = np.subtract(view.target, view.eye)[:2] @ (line[-1] - line[0])
        assert along > 0  # it looks ahead
    with pytest.raises(UsageError, match="outside the terrain"):
        make.flyover(LAND, SIZE, line + 1e6)
    with pytest.raises(UsageError, match="far beyond the terrain"):  # a slip: half the Earth would be flown over
        make.flyover(LAND, SIZE, np.concatenate([line, line[-1:] + 1e7]))
    with pytest.raises(UsageError, match="two points"):
        make.flyover(LAND, SIZE, line[:1])


GPX = """<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="36.1" lon="-117.0"/><trkpt lat="36.11" lon="-116.99"/></trkseg><trkseg>
<trkpt lat="36.1" lon="-117.0"/><trkpt lat="36.11" lon="-116.99"/>
<trkpt lat="36.12" lon="-116.98"/></trkseg></trk></gpx>"""
LINE = {"type": "LineString", "coordinates": [[-117.0, 36.1, 5], [-116.99, 36.11, 6], [-116.98, 36.12, 7]]}


@pytest.mark.parametrize(
    "text",
    [GPX, json.dumps(LINE), json.dumps({"type": "FeatureCollection", "features": [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [0, 0]}},
        {"type": "Feature", "geometry": {"type": "MultiLineString", "coordinates": [LINE["coordinates"]]}}]})],
)  # fmt: skip
def test_lines_from_files(tmp_path, text):
    path = tmp_path / "line"
    path.write_text(text)
    found = make.read_line(path, LAND.grid.crs)
    from pyproj import Transformer

    there = Transformer.from_crs("EPSG:4326", "EPSG:32611", always_xy=True).transform([-117.0, -116.98], [36.1, 36.12])
    np.testing.assert_allclose(found[[0, -1]], np.transpose(there), atol=1e-3)
    assert len(found) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [("{", "neither GPX"), ("<gpx", "neither GPX"), ('{"type": "Point", "coordinates": [0, 0]}', "no line"),
     ("<gpx/>", "no line"), ("[]", "neither GPX"), ('<!DOCTYPE a [<!ENTITY b "c">]><gpx/>', "entities")],
)  # fmt: skip
def test_files_without_a_line(tmp_path, text, words):
    path = tmp_path / "line"
    path.write_text(text)
    with pytest.raises(ReadError, match=words):
        make.read_line(path, LAND.grid.crs)
    with pytest.raises(ReadError, match="cannot be read"):
        make.read_line(tmp_path / "nowhere", LAND.grid.crs)
