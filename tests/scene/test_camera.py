"""Cameras made from words: whole terrains fill the picture and no more, places are where pyproj puts them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from affine import Affine
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyproj import Transformer
from scenes import NORTH_UP, ROTATED, hills, surface, terrain

from orograph.errors import NothingInViewError, UsageError
from orograph.scene import camera
from orograph.scene.camera import MARGIN

SIZE = (160, 90)
CLOUD = np.random.default_rng(5).normal(0, 1, (200, 3)) * [4000, 2500, 300] + [500_000, 4_000_000, 1200]


def spread(points, view, exaggeration=1.0):
    """How far points reach towards the picture's sides, (n, 2): 1 at the border."""
    pixels, depth = view.project(points, exaggeration)
    assert (depth > 0).all()
    return np.abs(pixels / [view.width / 2, view.height / 2] - 1)


@settings(max_examples=80, deadline=None)
@given(
    azimuth=st.floats(-360, 360),
    pitch=st.floats(-90, 90),
    exaggeration=st.floats(0.1, 20),
    width=st.integers(20, 4000),
    height=st.integers(20, 4000),
    fov_y=st.floats(2, 120),
    zero=st.booleans(),
)
def test_fit_holds_every_point_and_fills_the_picture(azimuth, pitch, exaggeration, width, height, fov_y, zero):
    points = CLOUD * [1, 1, 0 if zero else 1]
    view = camera.fit(points, camera.direction(azimuth, pitch), fov_y, (width, height), exaggeration)
    reach = spread(points, view, exaggeration)
    assert reach.max() <= MARGIN * (1 + 1e-6)
    pixels, _ = view.project(points, exaggeration)
    # Both ways as near to one side as to the other.
    assert np.abs(pixels.min(0) + pixels.max(0) - [width, height]).max() < 1e-3 * max(width, height)
    close = view.axes(exaggeration)[2]
    depths = (points - view.eye) * [1, 1, exaggeration] @ close
    # Full on one axis, unless the nearest point is at the lens already.
    assert reach.max() >= 0.98 * MARGIN or depths.min() < 2e-3 * np.linalg.norm(
        np.ptp(points, axis=0) * [1, 1, exaggeration]
    )


@settings(max_examples=60, deadline=None)
@given(azimuth=st.floats(0, 360), pitch=st.floats(1, 89), exaggeration=st.floats(0.2, 10))
def test_fit_looks_the_way_it_was_told(azimuth, pitch, exaggeration):
    view = camera.fit(CLOUD, camera.direction(azimuth, pitch), 30, SIZE, exaggeration)
    back = -view.axes(exaggeration)[2]  # from the target towards the eye, as it is seen
    assert math.degrees(math.asin(back[2])) == pytest.approx(pitch, abs=1e-6)
    assert (math.degrees(math.atan2(back[0], back[1])) - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=1e-5)


def test_fit_of_one_axis_leaves_the_other_centred():
    points = CLOUD.copy()
    view = camera.fit(points, camera.direction(180, 30), 30, (400, 90))  # a wide picture: height decides
    pixels, _ = view.project(points)
    x = pixels[:, 0] - 200
    y = pixels[:, 1] - 45
    assert y.max() == pytest.approx(-y.min(), abs=1e-6) and y.max() == pytest.approx(45 * MARGIN)
    assert x.max() == pytest.approx(-x.min(), abs=1e-6)


@pytest.mark.parametrize("azimuth", [0, 45, 140, 225])
@pytest.mark.parametrize("pitch", [1, 5, 18, 20, 42, 70, 90])
@pytest.mark.parametrize("exaggeration", [0.5, 1, 5])
@pytest.mark.parametrize(("size", "fov"), [((1280, 720), 30), ((400, 2000), 30), ((3000, 300), 60), ((900, 900), 5)])
def test_whole_terrain_touches_two_opposite_margins_and_stands_in_the_middle(azimuth, pitch, exaggeration, size, fov):
    ground = terrain(hills(40, 60, tall=700))
    view = camera.whole(ground, size, azimuth=azimuth, pitch=pitch, fov_y=fov, exaggeration=exaggeration)
    r, c = np.mgrid[:40, :60]
    points = np.stack([*ground.grid.xy(c, r), ground.read(0, 0, 40, 0, 60)], -1).reshape(-1, 3)
    pixels, depth = view.project(points, exaggeration)
    assert (depth > 0).all()
    low, high = pixels.min(0) / size * 2 - 1, pixels.max(0) / size * 2 - 1
    assert max(np.abs(low).max(), np.abs(high).max()) < MARGIN + 1e-9
    np.testing.assert_allclose(low, -high, atol=1e-6)
    assert high.max() > MARGIN - 1e-6 or depth.min() < 2e-3 * np.ptp(points * [1, 1, exaggeration], axis=0).max()


@pytest.mark.parametrize("spacing", [1e-4, 0.01, 1.0, 1e5])
def test_terrain_of_any_size_is_framed(spacing):
    ground = terrain(hills(9, 12, tall=spacing), Affine(spacing, 0, 5e5, 0, -spacing, 4e6))
    view = camera.whole(ground, SIZE, azimuth=140, pitch=18)
    c, r = np.meshgrid([0, 11], [0, 8])
    pixels, _ = view.project(np.stack([*ground.grid.xy(c, r), ground.read(0, 0, 9, 0, 12)[r, c]], -1).reshape(-1, 3))
    assert np.ptp(pixels[:, 0]) > 0.8 * MARGIN * SIZE[0]


def test_whole_terrain_is_in_the_picture():
    for transform in (NORTH_UP, ROTATED):
        ground = terrain(hills(300, 520, tall=900), transform)
        r, c = np.mgrid[:300, :520]
        x, y = ground.grid.xy(c, r)
        points = np.stack([x, y, ground.read(0, 0, 300, 0, 520)], -1).reshape(-1, 3)
        for azimuth, pitch, exaggeration in ((180, 42, 1), (30, 5, 3), (300, 90, 1), (123, 60, 0.3)):
            view = camera.whole(ground, SIZE, azimuth=azimuth, pitch=pitch, exaggeration=exaggeration)
            reach = spread(points, view, exaggeration)
            assert reach.max() < 1.0 and reach.max() > 0.9 * MARGIN


def test_straight_down_has_north_up():
    ground = terrain(hills())
    view = camera.whole(ground, SIZE, pitch=90)
    right, up, forward = view.axes()
    np.testing.assert_allclose(forward, [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(up, [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(right, [1, 0, 0], atol=1e-9)


@pytest.mark.parametrize("distance", [None, 5000.0])
def test_straight_down_from_the_east_has_the_east_at_its_foot(distance):
    # As a plan has it, and as the pictures on the way there have it.
    for pitch in (89.9, 90):
        view = camera.around(terrain(hills()), SIZE, azimuth=90, pitch=pitch, distance=distance)
        np.testing.assert_allclose(view.axes()[1], [-1, 0, 0], atol=2e-3)
        np.testing.assert_allclose(view.axes()[0], [0, 1, 0], atol=1e-9)


def test_small_and_scattered_ground_is_held_too():
    heights = np.full((700, 700), np.nan, np.float32)  # three levels: the coarsest has every fourth sample
    heights[301:303, 409:412] = 55
    ground = terrain(heights)
    view = camera.whole(ground, SIZE)
    x, y = ground.grid.xy(410, 301.5)
    (u, v), _ = view.project([x, y, 55.0])
    assert 0 < u < 160 and 0 < v < 90

    heights[100:400, 100:400] = 500  # and beside a large piece of ground a spit between the coarse samples
    heights[553, 200:697] = heights[554, 200:697] = 20
    ground = terrain(heights)
    view = camera.whole(ground, SIZE)
    c, r = np.meshgrid(np.arange(200, 697), [553, 554])
    points = np.stack([*ground.grid.xy(c, r), np.full(c.shape, 20.0)], -1).reshape(-1, 3)
    assert spread(points, view).max() < 1


def test_plan_is_a_map():
    ground = terrain(hills(200, 300), NORTH_UP)
    for size in ((160, 90), (90, 160), (100, 100)):
        view = camera.plan(ground, size)
        assert view.projection == "plan"
        # Corner samples: west is left, north is up, one scale both ways, and the longer side reaches the margin.
        (x0, x1), (y0, y1) = ground.grid.xy([0, 299], [0, 199])
        pixels, depth = view.project(np.array([[x0, y0, 900.0], [x1, y1, 900.0]]))
        (u0, v0), (u1, v1) = pixels
        assert (u1 - u0) / (x1 - x0) == pytest.approx((v1 - v0) / (y0 - y1)) == pytest.approx(1 / view.pixel_metres)
        assert max((u1 - u0) / size[0], (v1 - v0) / size[1]) == pytest.approx(MARGIN)
        assert u0 + u1 == pytest.approx(size[0]) and v0 + v1 == pytest.approx(size[1])
        np.testing.assert_allclose(depth, view.eye[2] - 900)
        assert view.eye[2] > ground.height_range[1]


def test_plan_turned_to_be_seen_from_the_east():
    view = camera.plan(terrain(hills(200, 300)), SIZE, azimuth=90)
    right, up, forward = view.axes()
    np.testing.assert_allclose(up, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(right, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(forward, [0, 0, -1], atol=1e-12)


def test_around_keeps_its_distance():
    ground = terrain(hills())
    for exaggeration in (1.0, 2.5):
        view = camera.around(ground, SIZE, azimuth=30, pitch=20, distance=7000, exaggeration=exaggeration)
        line = np.subtract(view.eye, view.target) * [1, 1, exaggeration]
        assert np.linalg.norm(line) == pytest.approx(7000)
        assert math.degrees(math.asin(line[2] / 7000)) == pytest.approx(20)
        assert math.degrees(math.atan2(line[0], line[1])) == pytest.approx(30)
        # The middle of the terrain, on the ground.
        col, row = ground.grid.index(*view.target[:2])
        assert (col, row) == pytest.approx((41, 30))
        assert view.target[2] == pytest.approx(surface(ground, col, row), abs=1e-3)


@pytest.mark.parametrize("wrong", [{"pitch": 91}, {"pitch": math.nan}, {"distance": 0}, {"distance": -5},
                                   {"distance": math.nan}, {"distance": math.inf}, {"azimuth": math.inf},
                                   {"azimuth": math.nan}, {"azimuth": math.nan, "distance": None}])  # fmt: skip
def test_around_refuses_nonsense(wrong):
    with pytest.raises(UsageError, match=r"`pitch`|`distance`|`azimuth`"):
        camera.around(terrain(hills()), SIZE, **{"azimuth": 30, "pitch": 20, "distance": 7000, **wrong})


def test_standing_at_a_place():
    ground = terrain(hills())
    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    there = Transformer.from_crs("EPSG:4326", "EPSG:32611", always_xy=True)
    (west, east), (north, south) = move.transform(*ground.grid.xy([10.0, 60.0], [12.0, 40.0]))
    view = camera.standing(ground, SIZE, (west, north, 2222.0), (east, south))
    np.testing.assert_allclose(view.eye, (*there.transform(west, north), 2222.0), rtol=0, atol=1e-4)
    np.testing.assert_allclose(view.target[:2], there.transform(east, south), rtol=0, atol=1e-4)
    assert view.target[2] == pytest.approx(surface(ground, np.float64(60), np.float64(40)), abs=0.05)
    middle = camera.standing(ground, SIZE, (west, north, 2222.0), None)
    np.testing.assert_allclose(ground.grid.index(*middle.target[:2]), (41, 30), atol=1e-6)


def test_standing_where_there_is_no_such_place():
    with pytest.raises(UsageError, match="Longitude"):
        camera.standing(terrain(hills()), SIZE, (400.0, 95.0, 1.0), None)
    with pytest.raises(UsageError, match="Longitude"):
        camera.standing(terrain(hills()), SIZE, (-117.0, 36.0, 1.0), (0.0, math.nan))
    with pytest.raises(UsageError, match="no CRS"):
        camera.standing(terrain(hills(), crs=None), SIZE, (-117.0, 36.0, 1.0), None)


def test_ground_is_the_triangulated_surface():
    rng = np.random.default_rng(3)
    for transform in (NORTH_UP, ROTATED):
        heights = hills(9, 8)
        heights[3, 4] = np.nan
        ground = terrain(heights, transform)
        col, row = rng.uniform(-0.4, 7.4, 300), rng.uniform(-0.4, 8.4, 300)
        expected = surface(ground, col, row)
        got = [camera.ground(ground, *(float(v) for v in ground.grid.xy(c, r)), default=-1) for c, r in zip(col, row)]
        np.testing.assert_allclose(got, np.where(np.isnan(expected), -1, expected), rtol=0, atol=1e-3)


def test_nothing_valid():
    ground = terrain(np.full((300, 20), np.nan, np.float32))
    for make in (lambda: camera.whole(ground, SIZE), lambda: camera.plan(ground, SIZE), lambda: camera.outline(ground)):
        with pytest.raises(NothingInViewError, match="None of the samples"):
            make()


def test_flat_and_tiny_terrain_can_be_looked_at():
    for heights in (np.zeros((2, 2), np.float32), np.full((2, 200), 7, np.float32)):
        ground = terrain(heights, Affine(1, 0, 0, 0, -1, 0), None)
        for pitch in (0, 42, 90):
            view = camera.whole(ground, SIZE, pitch=pitch)
            assert np.isfinite(view.eye).all() and view.distance > 0
        assert camera.plan(ground, SIZE).pixel_metres > 0


@settings(max_examples=60, deadline=None)
@given(
    insets=st.tuples(*[st.floats(0, 0.4)] * 4),
    azimuth=st.floats(0, 360),
    pitch=st.floats(1, 90),
    exaggeration=st.floats(0.2, 10),
    size=st.tuples(st.integers(50, 2000), st.integers(50, 2000)),
)
@example(insets=(0, 0, 0, 0), azimuth=293, pitch=1, exaggeration=1, size=(197, 50))
def test_insets_are_left_free(insets, azimuth, pitch, exaggeration, size):
    left, right, top, bottom = (max(part, (1 - MARGIN) / 2) for part in insets)
    view = camera.fit(CLOUD, camera.direction(azimuth, pitch), 30, size, exaggeration, insets)
    places, depth = view.project(CLOUD, exaggeration)
    u, v = (places / size).T
    room = np.array([u.min() - left, 1 - right - u.max(), v.min() - top, 1 - bottom - v.max()])
    assert room.min() >= -1e-6
    nearest = camera.NEAREST * np.ptp(CLOUD * (1, 1, exaggeration), axis=0).max()
    full = min(room[:2].max(), room[2:].max()) < 1e-6  # one axis is full to both its sides
    assert full or depth.min() < 1.5 * nearest  # or the eye cannot come nearer

    ground = terrain(hills(200, 300))
    plan = camera.plan(ground, size, azimuth=azimuth, insets=insets)
    points = camera.outline(ground)
    u, v = (plan.project(points)[0] / size).T
    room = np.array([u.min() - left, 1 - right - u.max(), v.min() - top, 1 - bottom - v.max()])
    assert room.min() >= -1e-6 and min(room[:2].max(), room[2:].max()) < 1e-6
    np.testing.assert_allclose(room[::2], room[1::2], atol=1e-6)  # and the other centred in what is free


def test_insets_that_leave_nothing():
    for wrong in ((0.5, 0, 0, 0), (0, 0, -0.1, 0), (0, math.nan, 0, 0)):
        with pytest.raises(UsageError, match="Insets"):
            camera.plan(terrain(hills()), SIZE, insets=wrong)
