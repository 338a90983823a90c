"""State-less refinement against fronts: any closed set of diamonds, and any moment at which it may end."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.hierarchy import diamonds, fronts
from orograph.lod.reference import children as hrt
from orograph.lod.reference import stateless
from orograph.lod.reference.camera import Camera
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.terrain import Ground
from orograph.lod.stateless import Stateless


@pytest.mark.parametrize("n", range(6))
def test_a_monotonic_criterion_gives_its_own_front(n):
    rng = np.random.default_rng(n)
    for share in (0.0, 0.001, 0.02, 0.3, 1.0):
        active = diamonds.closure(rng.random((2**n + 1,) * 2) < share)
        T = stateless.refine(n, lambda v, active=active: bool(active[v[1], v[0]]))
        assert plain.front_of(n, T) == fronts.front_of(active)


@pytest.mark.parametrize("ties", [False, True])
def test_it_may_end_at_any_time(ties):
    n = 3
    rng = np.random.default_rng(ties)
    pi: dict = {}
    for i in reversed(list(hrt.diamonds(n))):
        below = max([pi[j] for j in hrt.diamond_children(i, n)], default=0.0)
        pi[i] = below + (float(rng.integers(0, 2)) if ties else float(rng.random()))
    last = 0
    for count in range(2, 2 * 4**n + 1, 1 + ties):
        T = stateless.refine_by_priority(n, pi.__getitem__, lambda now, count=count: now >= count, tolerance=-0.5)
        assert len(T) in (count, count + 1) and len(T) >= last
        front = plain.front_of(n, T)
        assert fronts.is_valid(front)
        split = {(int(c), int(r)) for r, c in zip(*front.vertices()) if hrt.top((int(c), int(r)), n)}
        waiting = {t.diamond for t in T if not hrt.is_finest(t)}
        assert not split or not waiting or min(pi[i] for i in split) >= max(pi[i] for i in waiting)
        last = len(T)


def test_without_a_rule_for_ties_the_mesh_breaks():
    """All priorities equal, and triangles in the order of their ω: what is printed allows it, and halves a diamond."""
    n, broken = 2, 0
    for count in range(2, 32):
        T, F = [], list(hrt.roots(n))
        while F and len(T) + len(F) < count:
            t = F.pop(0)
            if hrt.is_finest(t):
                T.append(t)
            else:
                F = [*hrt.children(t), *F]  # depth first: every parent before its children, as π ≤ min π allows
        broken += not fronts.is_valid(plain.front_of(n, T + F))
    assert broken > 10


def test_budgets_of_the_engine():
    """Whatever the budget, the engine's mesh is the reference's at that moment."""
    rng = np.random.default_rng(3)
    for _ in range(2):
        t = plain.terrain(plain.rough(rng, (17, 17)))
        view = plain.random_view(rng, t)
        ground = Ground.of(t)
        n, spheres = ground.n, Spheres(ground, Camera.of(view), cull=False)

        def priority(i, n=n, spheres=spheres):  # (the factor keeps roundings from undoing the order)
            return spheres.priority(i) * (1 + 1e-9 * (2 * n - hrt.level(hrt.top(i, n)[0], n)))

        engine = plain.refiner(Stateless, t, metric="anisotropic", cull=False)
        for budget in range(2, 513, 40):
            made = engine.refine(view, triangles=budget)
            T = stateless.refine_by_priority(n, priority, lambda now, made=made: now >= len(made.triangles))
            assert plain.drawn(ground, T, spheres) == plain.triangles_of(made)
            assert not verify.judge_mesh(made, t, view).defects
