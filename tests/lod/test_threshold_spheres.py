"""Threshold spheres: what they promise, whether they nest, and whether a flight ends where a fresh start does."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import plain
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph import verify
from orograph.error.screen import camera_parameters
from orograph.errors import UsageError
from orograph.lod.pace import Deadline
from orograph.lod.reference.camera import Camera as ReferenceCamera
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.terrain import Ground
from orograph.lod.reference.threshold_spheres import ThresholdSpheres as Reference
from orograph.lod.reference.threshold_spheres import threshold
from orograph.lod.registry import method_of
from orograph.lod.soar import Soar
from orograph.lod.threshold_spheres import ThresholdSpheres
from orograph.lod.threshold_spheres_pass import decide
from orograph.viewpoint import Camera


@pytest.mark.cases(2)
@pytest.mark.parametrize("shape", plain.SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.15])
def test_mesh_is_that_of_the_spheres_and_flights_lead_to_it(shape, gaps):
    rng = np.random.default_rng([*shape, int(gaps * 100), 2])
    for _ in range(4):
        z = plain.rough(rng, shape, gaps=gaps)
        if np.isnan(z).all():
            continue
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
        exaggeration, tolerance = float(rng.choice([1.0, 2.0])), float(10 ** rng.uniform(-0.5, 1.5))
        ground, spheres = Ground.of(t, exaggeration=exaggeration), None
        for cull in (True, False):
            options = {"cull": cull, "exaggeration": exaggeration}
            method, other = (
                plain.refiner(ThresholdSpheres, t, metric=metric, **options) for metric in ("isotropic", "anisotropic")
            )
            for _ in range(4):  # jumps: everything may change
                view = plain.random_view(rng, t, fov_y=40.0)
                camera = ReferenceCamera.of(view, exaggeration)
                spheres = spheres or Reference(ground, threshold(camera, tolerance))
                found = method.refine(view, tolerance=tolerance)
                expected = plain.drawn(ground, spheres.update(camera.eye), Spheres(ground, camera, cull=cull))
                assert plain.triangles_of(found) == expected
                found = other.refine(view, tolerance=tolerance)
                assert plain.triangles_of(found) == plain.sphere_mesh(ground, view, tolerance, **options)


def flight(rng, t, frames, step):
    """Views along a smooth random way, turning."""
    view = plain.random_view(rng, t, fov_y=50.0)
    eye, target = np.array(view.eye), np.array(view.target)
    speed, turn = rng.normal(size=3), rng.normal(size=3)
    for _ in range(frames):
        speed += 0.3 * rng.normal(size=3)
        turn += 0.3 * rng.normal(size=3)
        eye = eye + step * speed * [1, 1, 0.2]
        target = target + step * turn * [1, 1, 0.2]
        yield replace(view, eye=tuple(eye), target=tuple(target))


@pytest.mark.stress
@pytest.mark.parametrize("metric", ["anisotropic", "isotropic"])
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.1]), st.sampled_from([0.5, 30.0, 400.0]), st.booleans())
def test_random_flights_equal_fresh_starts(metric, seed, gaps, step, cull):
    rng = np.random.default_rng(seed)
    t = plain.terrain(plain.rough(rng, (129, 100), amplitude=300, gaps=gaps))
    method = plain.refiner(ThresholdSpheres, t, metric=metric, cull=cull)
    for view in flight(rng, t, 12, step):
        found = method.refine(view, tolerance=2.0)
        fresh = plain.refiner(ThresholdSpheres, t, metric=metric, cull=cull).refine(view, tolerance=2.0)
        assert plain.triangles_of(found) == plain.triangles_of(fresh)
    same = plain.refiner(Soar, t, metric=metric, cull=cull).refine(view, tolerance=2.0)
    if metric == "anisotropic":
        assert plain.triangles_of(found) == plain.triangles_of(same)


@pytest.mark.cases(2)
@pytest.mark.parametrize("metric", ["anisotropic", "isotropic"])
@pytest.mark.parametrize("gaps", [0.0, 0.1])
def test_trees_that_grow_from_frame_to_frame_equal_fresh_starts(metric, gaps, monkeypatch):
    """With a budget of time: few steps a frame, while the camera moves on; then their mesh is shown."""
    grow, frames = ThresholdSpheres._grow, []

    def once(self, state, camera, seconds):
        self._pace.unit = seconds / 600  # some 300 steps
        monkeypatch.setattr(Deadline, "is_near", lambda deadline, taken=0.0: next(frames[-1]))
        frames.append(iter([False, True]))
        return grow(self, state, camera, seconds)

    monkeypatch.setattr(ThresholdSpheres, "_grow", once)
    rng = np.random.default_rng(31)
    t = plain.terrain(plain.rough(rng, (65, 50), amplitude=300, gaps=gaps))
    method = plain.refiner(ThresholdSpheres, t, metric=metric)
    view = plain.random_view(rng, t, fov_y=50.0)
    method.refine(view, tolerance=20.0)
    tolerances = set()
    for view in flight(rng, t, 60, 0.02):
        found = method.refine(view, seconds=1.0)
        tolerances.add(found.stats["tolerance"])
        fresh = plain.refiner(ThresholdSpheres, t, metric=metric).refine(view, tolerance=found.stats["tolerance"])
        assert plain.triangles_of(found) == plain.triangles_of(fresh)
    assert 20.0 in tolerances and len(tolerances) > 1 and len(frames) > 3 * len(tolerances)


def decided(grid, exaggeration, gamma, cull, diamond, view, share=0.5):
    """(whether a diamond is split, for how large a motion)"""
    camera = camera_parameters(Camera.over(grid, view, exaggeration), tolerance=1.0, color_tolerance=gamma)
    secant = np.hypot(1, view.pixel_slope * np.hypot(view.width, view.height) / 2)
    col, row, z, e, r, color = diamond
    return decide(camera, cull, col, row, z, e, r * camera.stretch, color, secant, share)


@pytest.mark.stress
def test_nothing_is_decided_otherwise_within_the_motion_it_was_decided_for():
    """Random diamonds and motions of the camera: moved and turned within the slack, the answer is the same."""
    rng = np.random.default_rng(21)
    near_the_end = waited = 0
    for _ in range(3000):
        up = rng.normal(size=3) * [1, 1, 2]
        options = {
            "fov_y": float(rng.choice([30, 60, 110])),
            "width": 400,
            "height": 300,
            "up": tuple(up / np.linalg.norm(up)),
        }
        view = plain.View(
            (0.0, 0.0, float(rng.uniform(10, 500))), (*map(float, rng.normal(size=2) * 300), 0.0),
            near=float(rng.choice([0.0, 3.0])), **options,
        )  # fmt: skip
        exaggeration, cull = float(rng.choice([1.0, 2.5])), bool(rng.random() < 0.6)
        col, row = rng.uniform(-400, 400, 2)
        z, r = rng.uniform(-50, 50), 10 ** rng.uniform(-1, 2)
        e = 10 ** rng.uniform(-3, 1) if rng.random() < 0.95 else np.inf
        color, gamma = float(rng.choice([0.0, 5.0])), float(rng.choice([1.0, 9.0]))
        grid = plain.Grid((9, 9), plain.Affine.translation(-0.5, 0.5) @ plain.Affine.scale(1, -1))

        asked = partial(decided, grid, exaggeration, gamma, cull, (col, row, z, e, r, color))
        share = rng.uniform(0.1, 0.9)
        split, motion = asked(view, share)
        if not 0 < motion < 1e6:
            continue
        waited += 1
        to_eye = (np.array(view.eye) - [col, -row, z]) * [1, 1, exaggeration]
        away = np.linalg.norm(to_eye)
        for _ in range(6):
            step = rng.normal(size=3)
            if rng.random() < 0.5:
                step = to_eye * rng.choice([-1.0, 1.0])  # straight to it, or away
            step *= share * motion / np.linalg.norm(step) * rng.choice([1.0, rng.random()])
            chord = (1 - share) * motion / (away + share * motion) * rng.choice([1.0, rng.random()])
            angle = 2 * np.arcsin(min(chord / 2, 1.0))
            axis = rng.normal(size=3)
            turn = rotation(axis / np.linalg.norm(axis), angle)
            _, high, forward = view.axes(exaggeration)
            stretch = np.array([1.0, 1.0, exaggeration])
            eye = np.array(view.eye) + step / stretch
            moved = replace(view, eye=tuple(eye), target=tuple(eye + 300 * (turn @ forward) / stretch),
                            up=tuple(turn @ high))  # fmt: skip
            np.testing.assert_allclose(moved.axes(exaggeration)[2], turn @ forward, atol=1e-9)
            assert asked(moved)[0] == split
        # Much farther, it is not always: the slack is no idle number.
        step = -to_eye if not split else to_eye
        eye = np.array(view.eye) + 4 * motion * step / np.linalg.norm(step) / [1, 1, exaggeration]
        shift = eye - view.eye
        near_the_end += asked(replace(view, eye=tuple(eye), target=tuple(np.add(view.target, shift))))[0] != split
    assert waited > 2000 and near_the_end > 300


def rotation(axis, angle):
    """Rodrigues' matrix."""
    k = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def test_a_frame_costs_what_changes():
    rng = np.random.default_rng(3)
    t = plain.terrain(plain.rough(rng, (1025, 1025), amplitude=1500))
    method = plain.refiner(ThresholdSpheres, t, metric="isotropic", cull=False)
    views = list(flight(rng, t, 30, 5.0))
    first = method.refine(views[0], tolerance=0.5).stats
    assert first["splits"] > 10_000
    for view in views[1:]:
        stats = method.refine(view, tolerance=0.5).stats
        assert stats["splits"] + stats["merges"] < 0.03 * stats["front"]
        assert stats["visits"] < 0.1 * stats["front"]
    turned = replace(views[-1], target=tuple(2 * np.array(views[-1].eye) - views[-1].target))
    stats = method.refine(turned, tolerance=0.5).stats
    assert stats["visits"] == stats["splits"] == stats["merges"] == 0
    # Where the axis matters, turning is work, but a camera at rest is none.
    method = plain.refiner(ThresholdSpheres, t)
    method.refine(views[0], tolerance=0.5)
    at_rest = method.refine(views[0], tolerance=0.5).stats
    assert at_rest["visits"] == at_rest["splits"] == at_rest["merges"] == 0
    eye, target = np.array(views[0].eye), np.array(views[0].target)
    for number in range(1, 20):
        away = eye + rotation(np.array([0.0, 0.0, 1.0]), np.radians(0.02 * number)) @ (target - eye)
        view = replace(views[0], eye=tuple(eye + number * (target - eye) / 20_000), target=tuple(away))
        stats = method.refine(view, tolerance=0.5).stats
        assert 0 < stats["visits"] < 0.1 * stats["front"]
        assert stats["splits"] + stats["merges"] < 0.03 * stats["front"]


def test_spheres_nest_and_bound_away_from_the_axis(shared_data):
    with rasterio.open(shared_data / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif") as file:
        t = plain.terrain(file.read(1)[:500, :700].astype(np.float32))
    rng = np.random.default_rng(13)
    methods = {metric: plain.refiner(ThresholdSpheres, t, metric=metric) for metric in ("anisotropic", "isotropic")}
    made = dict.fromkeys(methods, 0)
    for _ in range(8):
        view = plain.random_view(rng, t)
        for tolerance in (0.5, 2.0, 8.0):
            for metric, method in methods.items():
                found = method.refine(view, tolerance=tolerance)
                report = verify.judge_mesh(found, t, view)
                assert report.ok(tolerance), report
                made[metric] += len(found.triangles)
    assert made["isotropic"] > 1.5 * made["anisotropic"]


def test_a_turning_flight_keeps_the_tolerance():
    rng = np.random.default_rng(17)
    t = plain.terrain(plain.rough(rng, (257, 257), amplitude=900))
    method = plain.refiner(ThresholdSpheres, t)
    for number, view in enumerate(flight(rng, t, 40, 15.0)):
        found = method.refine(view, tolerance=1.5)
        if number % 5 == 4:
            report = verify.judge_mesh(found, t, view)
            assert report.ok(1.5), report


def test_published_spheres_exceed_the_tolerance_off_the_axis():
    """A spike at the picture's corner, seen wide: λ = f / τ leaves it out though it is many pixels high."""
    z = np.zeros((65, 65), np.float32)
    z[1, 1] = 10.0
    t = plain.terrain(z, cell=10.0)
    x, y = t.grid.xy(1, 1)
    # The spike lies far to the side: much nearer in depth than in distance.
    worst = {"isotropic": 0.0, "isotropic-published": 0.0}
    for distance in np.geomspace(400, 60_000, 60):
        view = plain.View(
            (float(x) + distance, float(y), 50.0), (float(x) + 0.94 * distance, float(y) + 0.33 * distance, 50.0),
            fov_y=100.0, width=600, height=100,
        )  # fmt: skip
        for metric in worst:
            found = plain.refiner(ThresholdSpheres, t, metric=metric, cull=False).refine(view, tolerance=1.0)
            worst[metric] = max(worst[metric], verify.judge_mesh(found, t, view).largest_at_samples)
    assert worst["isotropic"] <= 1.0 < worst["isotropic-published"]


def test_budgets():
    rng = np.random.default_rng(9)
    t = plain.terrain(plain.rough(rng, (129, 129)))
    view = plain.random_view(rng, t)
    method = plain.refiner(ThresholdSpheres, t)
    # (Whatever the tolerance, diamonds are split while the eye is inside their nested sphere.)
    coarsest = len(method.refine(view, tolerance=1e9).triangles)
    assert coarsest < 200
    for budget in (200, 500, 3000):
        found = method.refine(view, triangles=budget)
        assert len(found.triangles) <= budget
        assert verify.judge_mesh(found, t, view).ok(found.stats["tolerance"])
    assert not verify.judge_mesh(method.refine(view, seconds=0.05), t, view).defects


@pytest.mark.stress
def test_little_memory_gives_the_same_mesh():
    rng = np.random.default_rng(11)
    t = plain.terrain(plain.rough(rng, (1500, 1100), amplitude=800, gaps=0.02), cell=10)
    much, little = plain.refiner(ThresholdSpheres, t), plain.refiner(ThresholdSpheres, t, max_memory=6 << 20)
    for view in flight(rng, t, 5, 200.0):
        found = little.refine(view, tolerance=2.0)
        assert plain.triangles_of(found) == plain.triangles_of(much.refine(view, tolerance=2.0))
    assert little.field.resident <= 6 < much.field.resident
    assert verify.judge_mesh(found, t, view).ok(2.0)


def test_colors_force_splits():
    rng = np.random.default_rng(12)
    t = plain.terrain(np.zeros((65, 65), np.float32))
    view = plain.random_view(rng, t)

    def color(level, row0, row1, col0, col1):
        return np.full((row1 - row0, col1 - col0), 5.0, np.float32)

    flat = plain.refiner(ThresholdSpheres, t).refine(view, tolerance=1.0)
    coarse = plain.refiner(ThresholdSpheres, t, color=color, color_tolerance=6.0).refine(view, tolerance=1.0)
    fine = plain.refiner(ThresholdSpheres, t, color=color, color_tolerance=4.0).refine(view, tolerance=1.0)
    assert len(flat.triangles) == len(coarse.triangles) == 2
    assert len(fine.triangles) > 2
    assert verify.judge_mesh(fine, t, view).ok(0.0)


def test_plans_keep_holes():
    """In a plan spheres have no radius (λ = 0), and yet diamonds that are part ground, part hole are split."""
    rng = np.random.default_rng(14)
    t = plain.terrain(plain.rough(rng, (60, 45), gaps=0.05))
    x, y = (float(v) for v in t.grid.xy(22, 30))
    view = plain.View((x, y, 9000.0), (x, y, 0.0), projection="plan")
    for cull in (True, False):
        found = plain.refiner(ThresholdSpheres, t, cull=cull).refine(view, tolerance=1.0)
        assert len(found.triangles) > 2
        assert verify.judge_mesh(found, t, view).ok(0.0)


def test_unusable_options_are_refused():
    t = plain.terrain(np.zeros((5, 5), np.float32))
    assert method_of("threshold-spheres") is ThresholdSpheres
    with pytest.raises(UsageError):
        plain.refiner(ThresholdSpheres, t, metric="wedgie")
