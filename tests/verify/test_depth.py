"""The referee of depth images: its truth against every ray with every triangle, Embree and planes; known errors."""

from __future__ import annotations

import math
from dataclasses import replace

import broken_meshes as meshes
import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.verify import judge_depth
from orograph.viewpoint import View


def nothing(view: View) -> np.ndarray:
    return np.full((view.height, view.width), np.nan)


def rays_of(view: View, exaggeration: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (h, w, 3) of the pixels' centres, true space."""
    o, ou, ov, d, du, dv = view.ray_basis(exaggeration)
    y, x = (v[..., None] for v in np.indices((view.height, view.width)) + 0.5)
    return o + x * ou + y * ov, d + x * du + y * dv


def corners_of(terrain: meshes.MemoryTerrain) -> np.ndarray:
    """The unit triangles that exist, (n, 3, 3), true space."""
    made = np.array(meshes.full(terrain.heights), int).reshape(-1, 3, 2)
    x, y = terrain.grid.xy(made[..., 0], made[..., 1])
    return np.stack([x, y, terrain.heights[made[..., 1], made[..., 0]].astype(float)], -1)


def brute(terrain: meshes.MemoryTerrain, view: View, exaggeration: float) -> np.ndarray:
    """The nearest of all triangles on every ray (Möller & Trumbore), and how near a ray passes by a triangle's edge."""
    origin, direction = (v.reshape(-1, 1, 3) for v in rays_of(view, exaggeration))
    a, b, c = np.moveaxis(corners_of(terrain), 1, 0)[:, None]
    e, f = b - a, c - a
    p = np.cross(direction, f)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / (e * p).sum(-1)
        s = origin - a
        q = np.cross(s, e)
        u, v, t = (s * p).sum(-1) * scale, (direction * q).sum(-1) * scale, (f * q).sum(-1) * scale
    hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t >= view.near) & (t <= view.far)
    return np.where(hit, t, np.inf).min(1, initial=np.inf).reshape(view.height, view.width)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32), st.sampled_from([(5, 5), (6, 9), (2, 2), (3, 7)]), st.sampled_from(meshes.TRANSFORMS),
    st.sampled_from(["above", "inside", "plan", "slab", "tile"]), st.sampled_from([0.0, 0.2]),
    st.sampled_from([1.0, 0.5, 3.0]),
)  # fmt: skip
def test_the_truth_is_that_of_every_ray_with_every_triangle(seed, shape, transform, kind, missing, exaggeration):
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 10, shape)
    heights[rng.random(shape) < missing] = np.nan
    terrain = meshes.terrain_of(heights, transform)
    x, y = terrain.grid.xy(rng.uniform(0, shape[1] - 1, 2), rng.uniform(0, shape[0] - 1, 2))
    target = (float(x[0]), float(y[0]), 0.0)
    eye = (float(x[1]), float(y[1]), float(rng.normal(0, 8) if kind == "inside" else rng.uniform(20, 100)))
    view = View(eye, target, fov_y=float(rng.uniform(20, 120)), width=24, height=16)
    if kind == "plan":
        view = replace(view, projection="plan", up=(0.3, 1.0, 0.0))
    elif kind == "slab":
        view = replace(view, near=30.0, far=80.0)
    elif kind == "tile":
        view = view.resized(60, 50).tile(17, 20, 24, 16)
    expected = brute(terrain, view, exaggeration)
    report = judge_depth(nothing(view), terrain, view, exaggeration=exaggeration, jobs=1)
    np.testing.assert_allclose(
        np.where(np.isfinite(expected), expected, -1.0), np.nan_to_num(report.truth, nan=-1.0), rtol=1e-7, atol=1e-6
    )
    assert report.hits == np.isfinite(expected).sum() == report.mismatches and report.hits + report.misses == 24 * 16
    if report.misses == 0 and report.hits:
        assert report.farthest == math.inf and not report.ok(1e9)
    for dtype in (np.float64, np.float32):
        own = judge_depth(report.truth.astype(dtype), terrain, view, exaggeration=exaggeration, jobs=3)
        assert own.mismatches == 0 and own.largest < 0.05 and own.ok(0.05)
        assert own.largest < 1e-6 or dtype is np.float32 or kind == "inside"


def test_the_truth_is_embrees():
    """A terrain of several tiles, with holes, from near the ground: 100 × 60 pixels."""
    embreex = pytest.importorskip("embreex.rtcore_scene")
    mesh_construction = pytest.importorskip("embreex.mesh_construction")
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:300, :520]
    heights = (30 * np.sin(x / 23) * np.cos(y / 17) + rng.normal(0, 1, x.shape)).astype(np.float32)
    heights[100:130, 200:300] = np.nan
    terrain = meshes.terrain_of(heights, Affine(2, 0, 0, 0, -3, 0))
    r, c = np.mgrid[:299, :519]
    even = ((r + c) % 2 == 0)[..., None]
    a, b, d, e = (np.stack([c + i, r + j], -1) for j in (0, 1) for i in (0, 1))
    upper = np.stack([a, b, np.where(even, e, d)], -2).reshape(-1, 3, 2)
    lower = np.stack([np.where(even, a, b), d, e], -2).reshape(-1, 3, 2)
    made = np.concatenate([upper, lower])
    z = heights[made[..., 1], made[..., 0]]
    made, z = made[np.isfinite(z).all(1)], z[np.isfinite(z).all(1)]
    tx, ty = terrain.grid.xy(made[..., 0], made[..., 1])
    scene = embreex.EmbreeScene()
    mesh_construction.TriangleMesh(scene, np.stack([tx, ty, z], -1).astype(np.float32))
    view = View((500.0, -1100.0, 90.0), (500.0, -300.0, 0.0), fov_y=50, width=100, height=60)
    origin, direction = rays_of(view)
    flat = np.ascontiguousarray(direction.reshape(-1, 3), np.float32)
    found = scene.run(
        np.ascontiguousarray(np.broadcast_to(origin, direction.shape).reshape(-1, 3), np.float32),
        flat,
        query="DISTANCE",
    )
    length = np.where(found < 1e30, found, np.nan).reshape(view.height, view.width)
    truth = judge_depth(nothing(view), terrain, view).truth
    both = np.isfinite(truth) & np.isfinite(length)
    assert both.sum() > 2000 and (np.isfinite(truth) != np.isfinite(length)).sum() <= 3
    apart = np.abs(truth[both] - length[both]) / truth[both]
    assert np.mean(apart > 1e-4) < 0.002  # rays along outlines
    assert judge_depth(np.where(np.isnan(length), np.nan, length).astype(np.float32), terrain, view).most < 0.01


def level_plain() -> tuple[meshes.MemoryTerrain, View, np.ndarray, np.ndarray]:
    """A plain at height 7, seen from 100 m above it, at 30° down; the truth in closed form."""
    terrain = meshes.terrain_of(np.full((65, 65), 7.0), Affine(10, 0, -325, 0, -10, 325))
    view = View((0.0, -100 * math.sqrt(3), 107.0), (0.0, 0.0, 7.0), fov_y=30, width=60, height=40)
    origin, direction = rays_of(view)
    t = (7.0 - origin[..., 2]) / direction[..., 2]
    at = origin + t[..., None] * direction
    return terrain, view, np.where((t > 0) & (np.abs(at[..., :2]) <= 320).all(-1), t, np.nan), direction


def test_a_plane_and_known_errors():
    terrain, view, truth, direction = level_plain()
    report = judge_depth(truth, terrain, view)
    np.testing.assert_allclose(report.truth, truth, rtol=1e-12)
    assert (
        report.largest < 1e-9 and report.mismatches == 0 and report.ok(1e-9) and report.hits == view.width * view.height
    )
    # One pixel shows a point nearer by a tenth: that floats above the plain, and its foot lies lower on the screen.
    depth = truth.copy()
    depth[22, 31] *= 0.9
    point = np.array(view.eye) + depth[22, 31] * direction[22, 31]
    foot = [point[0], point[1], 7.0]
    expected = math.dist(view.project(foot)[0], (31.5, 22.5))
    report = judge_depth(depth, terrain, view)
    assert report.largest == pytest.approx(expected, rel=1e-9) and expected > 3 and report.worst == (31, 22)
    assert report.mismatches == 0 and report.rms == pytest.approx(expected / math.sqrt(report.hits), rel=1e-9)
    assert report.errors[22, 31] == report.largest and not report.ok(expected * 0.99) and report.ok(expected)
    assert f"{report.largest:.4g} px at most at pixel 31, 22" in str(report) and report.to_dict()["worst"] == [31, 22]
    # The plain drawn 2 m too high, everywhere: twice as high an error with twice the exaggeration, about.
    high = truth * (100 - 2) / 100
    for exaggeration in (1.0, 2.0):
        o, d = rays_of(view, exaggeration)
        high = (9.0 - o[..., 2]) / d[..., 2]
        at = o + high[..., None] * d
        inside = (np.abs(at[..., :2]) < 320).all(-1)
        low = view.project(np.concatenate([at[..., :2], np.full_like(at[..., 2:], 7.0)], -1), exaggeration)[0]
        moved = np.hypot(*np.moveaxis(low - view.project(at, exaggeration)[0], -1, 0))
        report = judge_depth(np.where(inside, high, np.nan), terrain, view, exaggeration=exaggeration)
        np.testing.assert_allclose(report.errors[inside], moved[inside], rtol=1e-9)


def test_mismatches_are_as_far_as_the_nearest_pixel_that_agrees():
    terrain, view, truth, _ = level_plain()
    depth = truth.copy()
    depth[10:15, 20:29] = np.nan  # a hole of 9 × 5 pixels: its middle row is 3 pixels from pixels that agree
    report = judge_depth(depth, terrain, view)
    assert (
        report.mismatches == 45 and report.farthest == 3.0 and report.farthest_at == (22, 12) and report.largest < 1e-9
    )
    assert report.ok(3 - math.sqrt(2)) and not report.ok(2.9 - math.sqrt(2)) and "45 pixels" in str(report)
    # Ground beyond the raster, and over a hole in it, is no ground.
    heights = terrain.heights.copy()
    heights[30:36, 30:36] = np.nan
    holed = meshes.terrain_of(heights, terrain.grid.transform)
    through = judge_depth(truth, holed, view)
    assert through.misses == through.mismatches > 20 and through.hits == report.hits - through.misses
    assert judge_depth(through.truth, holed, view).ok(1e-9)
    beyond = truth.copy()
    beyond[20, 30] = 1e5
    assert judge_depth(beyond, terrain, view).mismatches == 1
    empty = judge_depth(nothing(view), terrain, view)
    assert (
        empty.farthest == math.inf and empty.worst is None and not empty.ok(1e9) and empty.to_dict()["farthest"] is None
    )


def test_farther_ground_behind_an_outline_is_on_the_surface():
    """A picture that looks past a ridge shows true points of the ground behind it: no pixel errs, and none misses."""
    x = np.abs(np.arange(65) - 40)
    heights = np.broadcast_to(np.maximum(0.0, 30 - 10.0 * x)[:, None], (65, 65))
    ridge = meshes.terrain_of(heights, Affine(10, 0, -325, 0, -10, 325))
    plain = meshes.terrain_of(np.zeros((65, 65)), Affine(10, 0, -325, 0, -10, 325))
    view = View((0.0, -300.0, 60.0), (0.0, 0.0, 0.0), fov_y=30, width=60, height=40)
    through = judge_depth(nothing(view), plain, view).truth
    report = judge_depth(through, ridge, view)
    behind = (report.truth < through * 0.8) & (report.errors < 1e-9)
    assert behind.sum() > 20


def test_plans_judge_only_what_is_ground():
    terrain, view, _, _ = level_plain()
    plan = replace(view, projection="plan", fov_y=120)
    truth = judge_depth(nothing(plan), terrain, plan).truth
    assert np.isnan(truth).any() and np.nanmax(np.abs(truth - 100)) < 1e-9
    report = judge_depth(truth * 0.5, terrain, plan)
    assert report.largest == 0 and report.mismatches == 0
    assert judge_depth(np.full_like(truth, 100.0), terrain, plan).mismatches == np.isnan(truth).sum()


def test_what_cannot_be_judged_is_refused():
    terrain, view, truth, _ = level_plain()
    for bad in (truth[1:], truth.astype(np.int32)):
        with pytest.raises(UsageError, match="depth image"):
            judge_depth(bad, terrain, view)
    with pytest.raises(UsageError, match="exaggeration"):
        judge_depth(truth, terrain, view, exaggeration=math.nan)
    for heights in (np.zeros((1, 9)), np.full((5, 5), np.nan)):
        report = judge_depth(nothing(view), meshes.terrain_of(heights), view)
        assert report.ok(0.0) and report.hits == 0
