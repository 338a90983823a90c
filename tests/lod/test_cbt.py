"""The concurrent binary tree on the CPU: against its paper, the other methods, and the referee; from view to view."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.hierarchy import fronts, triangles
from orograph.lod.cbt import Cbt
from orograph.lod.cbt.pool import BASE, LEFT, RIGHT, Pool
from orograph.lod.reference import camera, cbt, children
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.terrain import Ground


def checked(pool: Pool, n: int) -> None:
    """Raise unless a pool holds a conforming mesh whose triangles know their neighbours."""
    slots = pool.leaves
    assert fronts.is_valid(fronts.Front.of(n, *pool.shape[slots].T))
    at = {tuple(pool.shape[s]): s for s in slots}
    for s in slots:
        t = tuple(int(v) for v in pool.shape[s])
        assert pool.level[s] == triangles.level(t[2], t[3], n)
        around = (
            (LEFT, triangles.left_neighbour(*t, n), 1, None),
            (RIGHT, triangles.right_neighbour(*t, n), 0, None),
            (BASE, triangles.sibling(*t, n), None, triangles.parent),
        )
        for edge, same, half, coarser in around:
            there = int(pool.links[s, edge])
            if same[2] == 0:
                assert there == -1
            elif same in at:
                assert there == at[same]
            else:
                assert there == at[coarser(*same) if half is None else triangles.child(*same, half)]


@pytest.mark.parametrize("share", [0.05, 0.3, 0.7])
def test_the_pool_ends_at_the_mesh_of_the_heap(share):
    """Any criterion from two triangles, and monotonic ones from whatever was before, as in the paper's tree."""
    rng, n = np.random.default_rng(int(100 * share)), 3
    every = list(children.diamonds(n))
    kept = Pool.planted(n, np.zeros((2, 2), np.float32), 8)
    for case in range(10):
        bad = {d for d in every if rng.random() < share * 0.8 ** children.level(children.top(d, n)[0], n)}
        if case % 2:
            for d in reversed(every):
                if bad & set(children.diamond_children(d, n)):
                    bad.add(d)
        pool = kept if case % 2 else Pool.planted(n, np.zeros((2, 2), np.float32), 8)
        for updates in range(8 * n):
            slots = pool.leaves
            inner = slots[pool.level[slots] < 2 * n]
            split = inner[[(int(x), int(y)) in bad for x, y in pool.shape[inner, :2]]] if len(inner) else inner
            below = slots[pool.level[slots] > 0]
            apexes = np.stack(triangles.apex(*pool.shape[below].T), -1)
            merge = below[np.array([tuple(int(v) for v in a) not in bad for a in apexes], bool)]
            if pool.update(split, merge) == (0, 0):
                break
            checked(pool, n)
            assert updates <= 4 * n + 8
        expected, _ = cbt.refine(n, bad.__contains__)
        found = {tuple(pool.shape[s]) for s in pool.leaves}
        assert found == {(int(t.x), int(t.y), t.L, t.omega) for t in expected}


@pytest.mark.cases(4)
@pytest.mark.parametrize("shape", plain.SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.15])
def test_mesh_is_the_reference_s_from_view_to_view(shape, gaps):
    rng = np.random.default_rng([*shape, int(gaps * 100), 1])
    t = plain.terrain(plain.rough(rng, shape, gaps=gaps), angle=float(rng.uniform(0, 360)), stretch=2.5)
    if np.isnan(t.heights).all():
        return
    for cull in (True, False):
        ground = Ground.of(t, exaggeration=2.0)
        method = plain.refiner(Cbt, t, cull=cull, exaggeration=2.0)
        for _ in range(6):
            view, tolerance = plain.random_view(rng, t), float(10 ** rng.uniform(-1, 1))
            found = method.refine(view, tolerance=tolerance)
            expected = plain.sphere_mesh(ground, view, tolerance, cull=cull, exaggeration=2.0)
            assert plain.triangles_of(found) == expected
            checked(method.method.pool, t.n)


def test_the_paper_s_tree_makes_the_same_mesh():
    rng = np.random.default_rng(3)
    t = plain.terrain(plain.rough(rng, (17, 14), gaps=0.1))
    ground = Ground.of(t)
    view = plain.random_view(rng, t)
    spheres = Spheres(ground, camera.Camera.of(view))
    T, _ = cbt.refine(t.n, lambda i: spheres.priority(i) > 1.0)
    assert plain.triangles_of(plain.refiner(Cbt, t).refine(view, tolerance=1.0)) == plain.drawn(ground, T, spheres)


@pytest.mark.parametrize("metric", ["anisotropic", "isotropic"])
@pytest.mark.parametrize("shape", [(257, 257), (180, 300)])
def test_the_promise_holds_and_stateless_makes_the_same_mesh(metric, shape):
    rng = np.random.default_rng(shape)
    t = plain.terrain(plain.rough(rng, shape, amplitude=300, gaps=0.05))
    method, other = plain.refiner(Cbt, t, metric=metric), plain.refiner("stateless", t, metric=metric)
    for _ in range(4):
        view = plain.random_view(rng, t)
        found = method.refine(view, tolerance=1.5)
        assert plain.triangles_of(found) == plain.triangles_of(other.refine(view, tolerance=1.5))
        report = verify.judge_mesh(found, t, view)
        assert report.ok(1.5) and not report.defects


def test_budgets_are_reached():
    rng = np.random.default_rng(7)
    t = plain.terrain(plain.rough(rng, (129, 129), amplitude=300))
    x, y = t.grid.xy(64, 64)
    view = plain.View((x, y - 9000.0, 6000.0), (x, y, 0.0), width=320, height=200)
    method = plain.refiner(Cbt, t, cull=False)
    found = method.refine(view, triangles=2000)
    assert 1500 <= len(found.triangles) <= 2000 and found.stats["within_budget"]
    assert len(method.refine(view, seconds=0.2).triangles) > 2


def test_little_memory_suffices():
    rng = np.random.default_rng(8)
    t = plain.terrain(plain.rough(rng, (600, 700), amplitude=300))
    view = plain.random_view(rng, t)
    small, large = plain.refiner(Cbt, t, max_memory=4 << 20), plain.refiner(Cbt, t)
    assert plain.triangles_of(small.refine(view)) == plain.triangles_of(large.refine(view))
