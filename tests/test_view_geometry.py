"""The camera in numbers: many points at once against frustum and matrices, plans, orientation, what errors say."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from orograph.errors import OrographError
from orograph.viewpoint import View

coordinate = st.floats(-5e5, 5e5)
far_off = st.tuples(coordinate, coordinate, st.floats(-500, 9000))
exaggerations = st.sampled_from([1.0, 0.5, 3.0])


@st.composite
def cameras(draw: st.DrawFn) -> View:
    eye = draw(far_off)
    offset = draw(st.tuples(*[st.floats(-1e4, 1e4)] * 3).filter(lambda v: np.linalg.norm(v) > 1.0))
    view = View(
        eye,
        tuple(np.add(eye, offset)),  # type: ignore[arg-type]
        up=draw(st.sampled_from([(0.0, 0.0, 1.0), (1.0, 0.2, 0.5), (0.0, 1.0, 0.0)])),
        fov_y=draw(st.floats(1, 150)),
        width=draw(st.integers(1, 2000)),
        height=draw(st.integers(1, 1200)),
        near=draw(st.sampled_from([0.0, 10.0])),
        far=draw(st.sampled_from([math.inf, 5e4])),
        projection=draw(st.sampled_from(["perspective", "perspective", "plan"])),
    )
    if draw(st.booleans()):  # a tile of it: whatever holds of views holds of tiles
        left, top = draw(st.integers(0, view.width - 1)), draw(st.integers(0, view.height - 1))
        width, height = draw(st.integers(1, view.width - left)), draw(st.integers(1, view.height - top))
        view = view.tile(left, top, width, height)
    return view


@settings(deadline=None)
@given(cameras(), exaggerations, st.tuples(st.floats(0, 1), st.floats(0, 1)), st.floats(1, 1e5))
def test_a_ray_projects_to_its_pixel(view: View, exaggeration: float, at: tuple[float, float], depth: float) -> None:
    px, py = at[0] * view.width, at[1] * view.height
    o0, ou, ov, d0, du, dv = view.ray_basis(exaggeration)
    point = o0 + px * ou + py * ov + depth * (d0 + px * du + py * dv)
    pixel, found = view.project(point, exaggeration)
    # Positions are half a million metres from the origin: 1e-9 of that against the size of a pixel there.
    slack = 1e-6 + 1e-8 / (view.pixel_metres if view.projection == "plan" else view.pixel_slope * depth)
    np.testing.assert_allclose(pixel, [px, py], atol=slack * 10, rtol=1e-9)
    np.testing.assert_allclose(found, depth, rtol=1e-6, atol=1e-6)


@settings(deadline=None)
@given(cameras(), exaggerations, st.integers(0, 2**32 - 1))
@example(View((0.0, 0.0, 0.0), (1.4e-8, 15.0, 0.0), up=(0.0, 1.0, 0.0), fov_y=1.0, width=1, height=1), 1.0, 0)
@example(View((0.0, 0.0, 0.0), (0.0, -15.0, 0.0), up=(0.0, 1.0, 0.0), fov_y=9.0, width=8, height=6), 1.0, 0)
def test_frustum_and_matrices_agree_with_the_projection(view: View, exaggeration: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    reach = view.distance * 3
    points = np.array(view.eye) + rng.uniform(-reach, reach, (200, 3))
    stretched = points * [1, 1, exaggeration]
    pixel, depth = view.project(points, exaggeration)
    planes = view.frustum(exaggeration)
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0, rtol=1e-12)
    distance = stretched @ planes[:, :3].T + planes[:, 3]
    inside = (distance >= 0).all(1)
    expected = (pixel >= 0).all(1) & (pixel <= [view.width, view.height]).all(1) & (depth >= view.near)
    expected &= (depth <= view.far) & (np.isfinite(pixel).all(1))
    clear = (np.abs(distance) > 1e-5 * reach).all(1)
    np.testing.assert_array_equal(inside[clear], expected[clear])
    # Clip space: x and y as pixels, depth reversed.
    seen = expected & clear & (depth > 1e-3 * reach)
    clip = np.column_stack([stretched, np.ones(200)]) @ (view.projection_matrix() @ view.view_matrix(exaggeration)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        ndc = clip[:, :3] / clip[:, 3:]
    x, y = (ndc[:, 0] + 1) * view.width / 2, (1 - ndc[:, 1]) * view.height / 2
    np.testing.assert_allclose(np.stack([x, y], 1)[seen], pixel[seen], rtol=1e-5, atol=1e-4)
    if view.near > 0:
        assert ((ndc[seen, 2] >= -1e-9) & (ndc[seen, 2] <= 1 + 1e-9)).all()


def test_up_in_the_picture_and_east_to_the_right() -> None:
    level = View((0, 0, 100), (0, 1000, 100), width=200, height=100)
    (x, y), depth = level.project((0, 1000, 100))
    assert (x, y, depth) == (100, 50, 1000)
    assert level.project((50, 1000, 100))[0][0] > 100  # looking north, east is right
    assert level.project((0, 1000, 150))[0][1] < 50  # higher is up
    down = View((0, 0, 100), (0, 0, 0), width=200, height=100)
    assert down.project((10, 0, 0))[0][0] > 100 and down.project((0, 10, 0))[0][1] < 50  # north is up


def test_what_is_seen_does_not_depend_on_the_zero_of_heights() -> None:
    a = View((10, 20, 500), (400, 900, 100))
    b = View((10, 20, 5500), (400, 900, 5100))
    points = np.random.default_rng(0).uniform(0, 1000, (50, 3))
    np.testing.assert_allclose(
        a.project(points, 3.0)[0], b.project(points + np.array([0.0, 0.0, 5000.0]), 3.0)[0], rtol=1e-9
    )
    # Exaggeration moves neither the eye nor what lies at its height on the axis.
    np.testing.assert_array_equal(a.ray_basis(3.0)[0], a.eye)


def test_points_behind_the_eye_have_no_pixel() -> None:
    view = View((0, 0, 0), (0, 1, 0))
    pixel, depth = view.project([(0.0, -5.0, 0.0), (0.0, 0.0, 0.0)])
    assert np.isnan(pixel).all() and (depth <= 0).all()


def test_a_plan_has_one_scale_and_can_be_turned() -> None:
    view = View((100, 200, 900), (100, 200, 0), fov_y=40, width=300, height=200, projection="plan")
    m = view.pixel_metres
    assert m == pytest.approx(2 * 900 * math.tan(math.radians(20)) / 200)
    pixel, _ = view.project([(100, 200, 0), (100 + m, 200, 50), (100, 200 + m, 700)])
    np.testing.assert_allclose(pixel, [(150, 100), (151, 100), (150, 99)], atol=1e-9)
    turned = View((100, 200, 900), (100, 200, 0), up=(1, 0, 0), width=300, height=200, projection="plan")
    assert turned.project((200, 200, 0))[0][1] < 100  # east is up
    np.testing.assert_array_equal(view.ray_basis()[4:], np.zeros((2, 3)))


def test_reads_a_file_and_longitudes(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "view.json"
    path.write_text(json.dumps({"eye": [9.0, 0.0, 3000], "target": [9.0, 0.5, 10], "crs": "EPSG:4326", "far": None}))
    view = View.load(path, crs="EPSG:32632")
    assert view.eye == pytest.approx((500000, 0, 3000), abs=1e-3)  # zone 32's central meridian, on the equator
    assert view.target[1] == pytest.approx(55265.2, rel=1e-4)  # 0.5° × 110 574 m × 0.9996
    assert view.far == math.inf and (view.width, view.height) == (1280, 720)
    assert view.resized(10, 20).width == 10


@pytest.mark.parametrize(
    "values, says",
    [
        ({"target": [0, 0, 0]}, "eye"),
        ({"eye": [0, 0], "target": [0, 0, 0]}, "three"),
        ({"eye": "abc", "target": [0, 0, 0]}, "eye"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "fovy": 3}, "fovy"),
        ({"eye": [0, 0, 1], "target": [0, 0, 1]}, "same"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "fov_y": 180}, "fov_y"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "fov_y": "wide"}, "fov_y"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "width": 0}, "pixels"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "width": 10.5}, "width"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "near": 5, "far": 5}, "near"),
        ({"eye": [0, 0, float("nan")], "target": [0, 0, 0]}, "eye"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "projection": "fisheye"}, "fisheye"),
        ({"eye": [0, 0, 1], "target": [0, 0, 0], "crs": "EPSG:nonsense"}, "nonsense"),
    ],
)
def test_what_is_wrong_with_a_view_is_said(values: dict[str, object], says: str) -> None:
    with pytest.raises(OrographError, match=says):
        View.from_dict(values, crs="EPSG:32632")


@settings(deadline=None)
@given(cameras(), exaggerations)
def test_a_tile_shows_what_the_whole_shows_there(view: View, exaggeration: float) -> None:
    left, top, width, height = view.frame
    whole = view.whole
    assert (whole.width, whole.height, whole.part) == (width, height, None)
    assert whole.pixel_slope == view.pixel_slope
    points = np.array(view.eye) + np.random.default_rng(0).uniform(-1, 1, (50, 3)) * view.distance * 3
    here, depth = view.project(points, exaggeration)
    there, same = whole.project(points, exaggeration)
    np.testing.assert_array_equal(depth, same)
    finite = np.isfinite(there).all(1) & (np.abs(there) < 1e6).all(1)
    np.testing.assert_allclose(here[finite] + [left, top], there[finite], atol=1e-6)
    assert View.from_dict(json.loads(json.dumps(view.to_dict()))) == view
    inner = view.tile(0, 0, 1, 1)
    assert inner.frame == (left, top, width, height) and inner.whole == whole


def test_a_tile_lies_inside_its_picture() -> None:
    view = View((0, 0, 100), (0, 1000, 100), width=200, height=100)
    with pytest.raises(OrographError, match="not inside the picture of 200 × 100"):
        view.tile(150, 0, 60, 100)
    with pytest.raises(OrographError, match="part"):
        View.from_dict({"eye": [0, 0, 1], "target": [1, 1, 0], "part": [1, 2]})
