"""Top-down refinement against the reference; budgets against validity; the promise against the referee."""

from __future__ import annotations

from functools import partial

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.errors import UsageError
from orograph.hierarchy import diamonds, fronts
from orograph.lod.reference import top_down as reference
from orograph.lod.reference.camera import Camera
from orograph.lod.reference.criterion import Prisms, Spheres
from orograph.lod.reference.terrain import Ground
from orograph.lod.registry import method_of
from orograph.lod.top_down import TopDown


@pytest.mark.cases(2)
@pytest.mark.parametrize("shape", plain.SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.15])
def test_mesh_is_that_of_forced_splits(shape, gaps):
    rng = np.random.default_rng([*shape, int(gaps * 100)])
    for case in range(6):
        z = plain.rough(rng, shape, gaps=gaps)
        if np.isnan(z).all():
            continue
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
        exaggeration = float(rng.choice([1.0, 2.0]))
        ground = Ground.of(t, exaggeration=exaggeration)
        view = plain.random_view(rng, t)
        tolerance = float(10 ** rng.uniform(-1, 1))
        for metric in ("wedgie", "anisotropic"):
            for cull in (True, False):
                prisms = Prisms(Spheres(ground, Camera.of(view, exaggeration), cull=cull))
                T = reference.refine(ground.n, partial(inaccurate, prisms, metric, tolerance))
                expected = plain.drawn(ground, T, prisms)
                queue = "fifo" if case % 2 else "priority"
                method = plain.refiner(TopDown, t, metric=metric, cull=cull, queue=queue, exaggeration=exaggeration)
                assert plain.triangles_of(method.refine(view, tolerance=tolerance)) == expected
                assert method.refine(view, tolerance=tolerance).stats["front"] == len(T)


def inaccurate(prisms, metric, tolerance, t):
    """Whether a triangle that is in view exceeds the tolerance, by its own prism or by its diamond's sphere."""
    pixels = prisms.priority(t)
    return (pixels if metric == "wedgie" or pixels < 0 else prisms.spheres.priority(t.diamond)) > tolerance


def true_errors(p, camera, front, cull=True):
    """Largest displacement in pixels of any sample in view under each triangle of a front, by brute force."""
    rows, cols = p.corners(front)
    samples = camera.to_camera(p.at)
    planes = camera.planes()
    in_view = (samples @ planes[:, :3].T + planes[:, 3] >= 0).all(-1) if cull else np.ones(samples.shape[:2], bool)
    found = np.zeros(len(rows))
    for t, (r, c) in enumerate(zip(rows, cols)):
        A = np.array([[r[0], c[0], 1], [r[1], c[1], 1], [r[2], c[2], 1]], float)
        weights = np.stack([p.row, p.col, np.ones_like(p.row)], -1) @ np.linalg.inv(A)
        mine = (weights > -1e-9).all(-1) & in_view
        mesh = p.at.copy()
        mesh[..., 2] = weights @ p.z[r, c]
        q = camera.to_camera(mesh)
        with np.errstate(invalid="ignore", divide="ignore"):
            gap = np.hypot(*np.moveaxis((samples / samples[..., 2:] - q / q[..., 2:])[..., :2], -1, 0)) * camera.focal
        found[t] = np.where(q[..., 2] > 0, gap, np.inf)[mine].max(initial=0.0)
    return found


def localised(p, camera, front):
    """The larger of that and of the bound over finest triangles, of which parts may be in view where no sample is."""
    corners = np.stack(p.corners(front), -1)
    return np.maximum(true_errors(p, camera, front), [p.finest_bound(camera, [*map(tuple, t)]) for t in corners])


@pytest.mark.stress
def test_localised_is_exact_without_a_limit_and_between_with_one():
    rng = np.random.default_rng(5)
    for _ in range(4):
        t = plain.terrain(plain.rough(rng, (17, 17)))
        p = plain.Plain(t)
        view = plain.random_view(rng, t)
        camera = plain.Camera(view)
        for tolerance in (0.5, 2.0, 8.0):
            front = fronts.coarsest(4)
            while True:
                r, c = diamonds.of_triangle(*front.arrays)
                bad = (r >= 0) & (localised(p, camera, front) > tolerance)
                if not bad.any():
                    break
                front = fronts.split(front, r[bad], c[bad])
            counts = []
            for depth in (64, 4, 1, 0):
                method = plain.refiner(TopDown, t, metric="localised", depth=depth, near=0.0, queue="fifo")
                found = method.refine(view, tolerance=tolerance)
                counts.append(found.stats["front"])
                assert verify.judge_mesh(found, t, view).ok(tolerance)
                if depth == 64:
                    assert counts[0] == len(front)
                    assert plain.triangles_of(found) <= p.triangle_set(front, np.ones(len(front), bool))
            wedgie = (
                plain.refiner(TopDown, t, metric="wedgie", queue="fifo")
                .refine(view, tolerance=tolerance)
                .stats["front"]
            )
            assert counts == sorted(counts)
            assert counts[-1] <= wedgie


@pytest.mark.cases(1)
@pytest.mark.parametrize("shape", [(17, 17), (14, 19)])
@pytest.mark.parametrize("metric", ["wedgie", "localised"])
def test_every_budget_is_kept_by_a_valid_mesh(shape, metric):
    rng = np.random.default_rng(shape)
    t = plain.terrain(plain.rough(rng, shape))
    view = plain.random_view(rng, t)
    rows, cols = shape
    everything = 2 * (rows - 1) * (cols - 1)
    method = plain.refiner(TopDown, t, metric=metric, cull=False)
    last, reached = 0, np.inf
    for budget in range(2, everything + 1):
        found = method.refine(view, triangles=budget)
        report = verify.judge_mesh(found, t, view)
        assert not report.defects
        assert budget - 2 < len(found.triangles) <= budget or found.stats["tolerance"] == 0.0 or shape != (17, 17)
        assert len(found.triangles) >= last
        last = len(found.triangles)
        if found.stats["conservative"]:
            assert report.ok(found.stats["tolerance"])
            reached = found.stats["tolerance"]
    assert reached == 0.0


def test_fifo_reaches_a_budget_by_tolerance():
    rng = np.random.default_rng(9)
    t = plain.terrain(plain.rough(rng, (65, 65)))
    view = plain.random_view(rng, t)
    found = plain.refiner(TopDown, t, queue="fifo").refine(view, triangles=500)
    assert 250 < len(found.triangles) <= 500
    assert verify.judge_mesh(found, t, view).ok(found.stats["tolerance"])


@pytest.mark.stress
def test_time_is_kept():
    rng = np.random.default_rng(10)
    t = plain.terrain(plain.rough(rng, (1025, 1025), amplitude=800))
    view = plain.random_view(rng, t, fov_y=60.0)
    method = plain.refiner(TopDown, t)
    method.refine(view, tolerance=0.01)  # compiled, and everything in memory
    meshes = [method.refine(view, seconds=s) for s in (0.002, 0.02, 0.1)]
    counts = [len(m.triangles) for m in meshes]
    assert counts == sorted(counts) and counts[0] < counts[-1]
    for m, seconds in zip(meshes, (0.002, 0.02, 0.1)):
        assert m.stats["refine_ms"] < 1e3 * seconds + 60
        assert verify.judge_mesh(m, t, view).ok(m.stats["tolerance"] if m.stats["conservative"] else np.inf)


@pytest.mark.stress
def test_little_memory_gives_the_same_mesh():
    rng = np.random.default_rng(11)
    t = plain.terrain(plain.rough(rng, (1500, 1100), amplitude=800, gaps=0.02), cell=10)
    view = plain.random_view(rng, t, fov_y=60.0)
    for queue in ("fifo", "priority"):
        for metric in ("wedgie", "localised"):
            much = plain.refiner(TopDown, t, queue=queue, metric=metric)
            little = plain.refiner(TopDown, t, queue=queue, metric=metric, max_memory=6 << 20)
            expected = much.refine(view, tolerance=2.0)
            found = little.refine(view, tolerance=2.0)
            assert plain.triangles_of(found) == plain.triangles_of(expected)
            assert little.field.resident <= 6 < much.field.resident
            if queue == "priority":
                a, b = (e.refine(view, triangles=5000) for e in (much, little))
                assert plain.triangles_of(a) == plain.triangles_of(b)
    assert verify.judge_mesh(found, t, view).ok(2.0)


def test_plans_need_only_holes():
    rng = np.random.default_rng(14)
    whole, holes = (plain.terrain(plain.rough(rng, (65, 65), gaps=g)) for g in (0.0, 0.1))
    for t in (whole, holes):
        view = plain.random_view(rng, t, projection="plan", fov_y=170.0)
        found = plain.refiner(TopDown, t).refine(view, tolerance=1.0)
        assert verify.judge_mesh(found, t, view).ok(0.0)
        assert (len(found.triangles) <= 2) == (t is whole)


def test_unusable_options_are_refused():
    t = plain.terrain(np.zeros((5, 5), np.float32))
    assert method_of("top-down") is TopDown
    for options in (
        {"queue": "lifo"},
        {"depth": -1},
        {"near": -0.1},
        {"metric": "nearest"},
        {"metric": "localised", "error": "midpoint"},
    ):
        with pytest.raises(UsageError):
            plain.refiner(TopDown, t, **options)
