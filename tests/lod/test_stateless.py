"""State-less refinement against the reference; budgets, ties, time, memory."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.errors import UsageError
from orograph.lod.reference.terrain import Ground
from orograph.lod.registry import method_of
from orograph.lod.soar import Soar
from orograph.lod.stateless import Stateless


@pytest.mark.cases(6)
@pytest.mark.parametrize("shape", plain.SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.15])
def test_mesh_is_the_reference_s(shape, gaps):
    rng = np.random.default_rng([*shape, int(gaps * 100), 1])
    for case in range(8):
        z = plain.rough(rng, shape, gaps=gaps)
        if np.isnan(z).all():
            continue
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
        exaggeration = float(rng.choice([1.0, 2.0]))
        view = plain.random_view(rng, t)
        tolerance = float(10 ** rng.uniform(-1, 1))
        ground = Ground.of(t, exaggeration=exaggeration)
        for cull in (True, False):
            expected = plain.sphere_mesh(ground, view, tolerance, cull=cull, exaggeration=exaggeration)
            queue = "fifo" if case % 2 else "priority"
            method = plain.refiner(
                Stateless, t, metric="anisotropic", cull=cull, queue=queue, exaggeration=exaggeration
            )
            found = method.refine(view, tolerance=tolerance)
            assert plain.triangles_of(found) == expected
            if t.n > 0:
                soar = plain.refiner(Soar, t, metric="anisotropic", cull=cull, exaggeration=exaggeration, jobs=1)
                assert plain.triangles_of(found) == plain.triangles_of(soar.refine(view, tolerance=tolerance))


@pytest.mark.stress
@pytest.mark.parametrize("shape", [(17, 17), (14, 19)])
def test_every_budget_is_kept_by_a_valid_mesh(shape):
    rng = np.random.default_rng(shape)
    t = plain.terrain(plain.rough(rng, shape))
    for view in (plain.random_view(rng, t), plain.random_view(rng, t)):
        method = plain.refiner(Stateless, t, cull=False)
        last = 0
        for budget in range(2, 2 * (shape[0] - 1) * (shape[1] - 1) + 1):
            found = method.refine(view, triangles=budget)
            report = verify.judge_mesh(found, t, view)
            assert not report.defects
            assert last <= len(found.triangles) <= budget
            assert shape != (17, 17) or len(found.triangles) > budget - 2 or found.stats["tolerance"] == 0.0
            last = len(found.triangles)
            if found.stats["conservative"]:
                assert report.ok(found.stats["tolerance"])
        assert found.stats["tolerance"] == 0.0


@pytest.mark.stress
def test_ties_are_closed_at_every_budget():
    """On a regular surface seen from straight above its middle, whole orbits of diamonds have one priority."""
    side = 17
    y, x = np.mgrid[:side, :side]
    t = plain.terrain(np.where((x + y) % 2 == 0, 10.0, 0.0).astype(np.float32), cell=1.0)
    cx, cy = t.grid.xy(8, 8)
    view = plain.View((cx, cy, 400.0), (cx, cy, 0.0), fov_y=20.0, width=100, height=100)
    method = plain.refiner(Stateless, t, cull=False)
    counts = set()
    for budget in range(2, 2 * 16 * 16 + 1):
        found = method.refine(view, triangles=budget)
        report = verify.judge_mesh(found, t, view)
        assert not report.defects, budget
        counts.add(len(found.triangles))
    assert len(counts) > 200


def test_time_is_kept_and_the_mesh_is_closed():
    rng = np.random.default_rng(10)
    t = plain.terrain(plain.rough(rng, (513, 513), amplitude=400))
    view = plain.random_view(rng, t, fov_y=60.0)
    method = plain.refiner(Stateless, t, cull=False)
    method.refine(view, tolerance=0.05)
    method.refine(view, seconds=1.0)  # (loads its kernels)
    counts = []
    for seconds in (0.0005, 0.002, 0.004, 0.008, 0.016):
        found = method.refine(view, seconds=seconds)
        counts.append(len(found.triangles))
        assert not verify.judge_mesh(found, t, view).defects
        assert found.stats["refine_ms"] < 1e3 * seconds + 60
    assert counts[0] < counts[-1]


@pytest.mark.stress
def test_little_memory_gives_the_same_mesh():
    rng = np.random.default_rng(11)
    t = plain.terrain(plain.rough(rng, (1500, 1100), amplitude=800, gaps=0.02), cell=10)
    view = plain.random_view(rng, t, fov_y=60.0)
    for queue in ("fifo", "priority"):
        much, little = (
            plain.refiner(Stateless, t, queue=queue),
            plain.refiner(Stateless, t, queue=queue, max_memory=6 << 20),
        )
        found = little.refine(view, tolerance=2.0)
        assert plain.triangles_of(found) == plain.triangles_of(much.refine(view, tolerance=2.0))
        assert little.field.resident <= 6 < much.field.resident
        assert verify.judge_mesh(found, t, view).ok(2.0)
        if queue == "priority":
            a, b = (e.refine(view, triangles=5000) for e in (much, little))
            assert plain.triangles_of(a) == plain.triangles_of(b)


def test_unusable_options_are_refused():
    t = plain.terrain(np.zeros((5, 5), np.float32))
    assert method_of("stateless") is Stateless
    for options in ({"queue": "lifo"}, {"metric": "wedgie"}):
        with pytest.raises(UsageError):
            plain.refiner(Stateless, t, **options)
