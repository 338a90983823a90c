"""Threshold spheres: nested, crossed when they should be, few looked at; a flight ends where a fresh start does."""

from __future__ import annotations

import math

import numpy as np
import plain
import pytest

from orograph.hierarchy import fronts
from orograph.lod.reference import children as hrt
from orograph.lod.reference.camera import Camera
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.screen_error import displacement
from orograph.lod.reference.terrain import Ground
from orograph.lod.reference.threshold_spheres import ThresholdSpheres, nested_spheres, threshold, threshold_printed
from orograph.lod.threshold_spheres import ThresholdSpheres as Fast


@pytest.mark.parametrize("shape", [(17, 17), (20, 31)])
def test_a_flight_splits_what_brute_force_says_and_the_engine_draws(shape):
    rng = np.random.default_rng(shape)
    for metric, of in (("isotropic", threshold), ("isotropic-published", threshold_printed)):
        t = plain.terrain(plain.rough(rng, shape))
        ground = Ground.of(t)
        view = plain.random_view(rng, t, fov_y=40.0)
        tolerance = 2.0
        radii = nested_spheres(ground, of(Camera.of(view), tolerance))
        carried, engine = (
            ThresholdSpheres(ground, of(Camera.of(view), tolerance)),
            plain.refiner(Fast, t, metric=metric),
        )
        for i, r in radii.items():
            for j in hrt.diamond_children(i, ground.n):
                assert radii[j] == 0 or r >= math.dist(ground[i].point, ground[j].point) + radii[j]
        for _ in range(5):  # jumps
            view = plain.random_view(rng, t, fov_y=40.0)
            camera = Camera.of(view)
            T = carried.update(camera.eye)
            assert carried.split == {i for i, r in radii.items() if math.dist(ground[i].point, camera.eye) < r}
            assert fronts.is_valid(plain.front_of(ground.n, T))
            spheres = Spheres(ground, camera)
            assert plain.drawn(ground, T, spheres) == plain.triangles_of(engine.refine(view, tolerance=tolerance))


def test_a_small_step_looks_at_few_spheres():
    rng = np.random.default_rng(5)
    t = plain.terrain(plain.rough(rng, (33, 33)))
    ground = Ground.of(t)
    carried = ThresholdSpheres(ground, 300.0)
    x, y, z = ground[16, 16].point
    carried.update((x, y, z + 3e3))
    everything = len(ground.samples)
    before, looked = set(carried.split), []
    for k in range(20):
        carried.update((x + 2.0 * k, y, z + 3e3 - 2.0 * k))
        looked.append(carried.looked_at)
    assert before and carried.split != before
    assert max(looked[1:]) < 0.25 * everything
    carried.update((x, y, z + 1e9))  # far away: all are left
    assert not carried.split and set(hrt.roots(ground.n)) == carried.T


def test_spheres_hold_the_samples_under_a_diamond():
    """With λ·e alone, as printed, a diamond's sphere may be left while a sample under it is off by more than τ."""
    rng = np.random.default_rng(6)
    missed, tolerance = [], 20.0
    t = plain.terrain(plain.rough(rng, (17, 17), amplitude=60.0))
    ground = Ground.of(t)
    camera = Camera.of(plain.random_view(rng, t, fov_y=20.0))
    points = Ground(ground.n, {v: sample._replace(radius=0.0) for v, sample in ground.samples.items()})
    radii = nested_spheres(ground, threshold(camera, tolerance))
    printed = nested_spheres(points, threshold_printed(camera, tolerance))
    for i in hrt.diamonds(ground.n):
        a, b, c = (np.array(v) for v in hrt.corners(hrt.top(i, ground.n)[0]))
        share = rng.dirichlet((1, 1, 1), 8) @ np.stack([a, b, c])
        for v in {tuple(v) for v in np.rint(share).astype(int).tolist()}:
            u, w = np.linalg.solve(np.stack([b - a, c - a], 1), v - a)
            sample = ground[v]
            flat = np.dot((1 - u - w, u, w), [ground[tuple(q)].point[2] for q in (a, b, c)])
            # An eye level with the sample and a little nearer than its own threshold, on the far side of it.
            distance = 0.99 * camera.focal * abs(flat - sample.point[2]) / tolerance
            away = np.subtract(sample.point, ground[i].point) * [1, 1, 0]
            if min(u, w, 1 - u - w) < 0 or distance < 1.0 or not away.any():
                continue
            eye = sample.point + distance * away / np.linalg.norm(away)
            seen = Camera.of(plain.View(tuple(eye), sample.point, fov_y=20.0, width=320, height=200))
            assert displacement(seen, seen.to_camera(sample.point), flat - sample.point[2]) > tolerance
            assert math.dist(eye, ground[i].point) < radii[i]
            missed.append(math.dist(eye, ground[i].point) >= printed[i])
    assert len(missed) > 200 and sum(missed) > 0
