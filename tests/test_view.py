"""The camera's parts say the same: rays, projection, matrices and frustum; and what a view refuses to be."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.errors import ReadError, UsageError
from orograph.viewpoint import View

number = st.floats(-5000, 5000)
point = st.tuples(number, number, number)


@st.composite
def views(draw):
    eye, target = draw(point), draw(point)
    if math.dist(eye, target) < 1:
        target = (eye[0] + 7, eye[1], eye[2] - 3)
    return View(
        eye, target, draw(st.sampled_from([(0, 0, 1), (0.3, 0.2, 1), (0, 1, 0)])), draw(st.floats(5, 120)),
        draw(st.integers(1, 900)), draw(st.integers(1, 900)), draw(st.sampled_from([0.0, 5.0])),
        draw(st.sampled_from([math.inf, 9000.0])), draw(st.sampled_from(["perspective", "plan"])),
    )  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(view=views(), px=st.floats(-100, 1000), py=st.floats(-100, 1000), t=st.floats(1, 8000), x=st.floats(0.2, 5))
def test_rays_matrices_and_frustum_agree(view, px, py, t, x):
    o0, ou, ov, d0, du, dv = view.ray_basis(x)
    world = o0 + px * ou + py * ov + t * (d0 + px * du + py * dv)
    pixels, depth = view.project(world, x)
    size = max(1.0, float(np.abs(world).max()))
    np.testing.assert_allclose(pixels, [px, py], atol=1e-7 * size / view.pixel_slope / min(t, 1e3) + 1e-5)
    assert depth == pytest.approx(t, rel=1e-6, abs=1e-6 * size)

    stretched = np.append(world * [1, 1, x], 1.0)
    assert -(view.view_matrix(x) @ stretched)[2] == pytest.approx(t, rel=1e-6, abs=1e-6 * size)
    if view.projection == "perspective":
        clip = view.projection_matrix() @ view.view_matrix(x) @ stretched
        ndc = clip[:3] / clip[3]
        u, v = (ndc[0] + 1) / 2 * view.width, (1 - ndc[1]) / 2 * view.height
        np.testing.assert_allclose([u, v], [px, py], rtol=1e-5, atol=1e-2)
    inside = (view.frustum(x) @ stretched).min()
    sides = min(px, view.width - px, py, view.height - py)
    far_enough = t - view.near if math.isinf(view.far) else min(t - view.near, view.far - t)
    if min(sides, far_enough) > 1e-3:
        assert inside > -1e-4
    if min(sides, far_enough) < -1e-3:
        assert inside < 1e-4


@settings(max_examples=100, deadline=None)
@given(view=views(), x=st.floats(0.2, 5))
def test_axes_are_orthonormal_and_right_handed(view, x):
    right, up, forward = view.axes(x)
    np.testing.assert_allclose(np.stack([right, up, forward]) @ np.stack([right, up, forward]).T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(np.cross(right, up), -forward, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(view=views())
def test_views_survive_json(view):
    assert View.from_dict(json.loads(json.dumps(view.to_dict(), allow_nan=False))) == view


def test_depth_runs_from_one_at_near_to_zero_at_far():
    for projection in ("perspective", "plan"):
        view = View((0, 0, 100), (0, 0, 0), near=10, far=500, projection=projection)
        for depth, expected in ((10, 1), (500, 0)):
            clip = view.projection_matrix() @ [0, 0, -depth, 1]
            assert clip[2] / clip[3] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [{"eye": (1, 2)}, {"eye": (1, 2, math.nan)}, {"target": (0, 0, 9)}, {"up": (0, 0, 0)}, {"fov_y": 0}, {"fov_y": 180},
     {"width": 0}, {"height": 2.5}, {"near": -1}, {"near": 5, "far": 5}, {"far": math.nan}, {"projection": "fish"}],
)  # fmt: skip
def test_what_is_no_view(wrong):
    with pytest.raises(UsageError):
        View(**{"eye": (0, 0, 9), "target": (0, 0, 0), **wrong})


def test_files_that_hold_no_view(tmp_path):
    path = tmp_path / "v.json"
    with pytest.raises(ReadError, match=r"v\.json"):
        View.load(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ReadError, match="not JSON"):
        View.load(path)
    path.write_text('{"eye": [0, 0, 1], "target": [0, 0, 0], "crs": "EPSG:4326"}')
    with pytest.raises(UsageError, match=r"v\.json.*the terrain has no CRS"):
        View.load(path)
