"""ROAM's two queues: from frame to frame the mesh of the view alone; budgets; wedgies; other priorities."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import plain
import pytest

from orograph.hierarchy import fronts
from orograph.lod.reference import children as hrt
from orograph.lod.reference import stateless
from orograph.lod.reference.camera import Camera
from orograph.lod.reference.criterion import Prisms, Spheres
from orograph.lod.reference.roam import Roam, wedgies
from orograph.lod.reference.screen_error import wedgie_printed
from orograph.lod.reference.terrain import Ground


def flight(rng, t, frames: int):
    """Views along a line, turning a little."""
    view = plain.random_view(rng, t, fov_y=50.0)
    eye, target = np.array(view.eye), np.array(view.target)
    step, drift = rng.normal(size=3) * [40, 40, 5], rng.normal(size=3) * [30, 30, 0]
    for _ in range(frames):
        yield replace(view, eye=tuple(eye), target=tuple(target))
        eye, target = eye + step, target + drift


@pytest.mark.parametrize("gaps", [0.0, 0.15])
def test_the_mesh_depends_on_the_view_alone(gaps):
    rng = np.random.default_rng(int(gaps * 100))
    changes = 0
    for _ in range(2):
        t = plain.terrain(plain.rough(rng, (15, 17), gaps=gaps))
        ground = Ground.of(t)
        carried = Roam(ground.n)
        for tolerance in (0.5, 4.0):
            for number, view in enumerate(flight(rng, t, 5)):
                spheres = Spheres(ground, Camera.of(view))
                found = carried.frame(lambda t, s=spheres: s.priority(t.diamond), tolerance=tolerance)
                assert found == set(stateless.refine(ground.n, lambda i, s=spheres, tau=tolerance: s.priority(i) > tau))
                if number:
                    assert carried.splits + carried.merges < len(found) / 2 + 20
                    changes += carried.merges > 0
            carried.frame(lambda t, s=spheres: s.priority(t.diamond), tolerance=tolerance)
            assert carried.splits == carried.merges == 0  # the same view again
    assert changes > 3


def test_queues_meet_within_a_budget():
    rng = np.random.default_rng(4)
    t = plain.terrain(plain.rough(rng, (17, 17)))
    ground = Ground.of(t)
    n, carried = ground.n, Roam(ground.n)
    for budget in (2, 3, 60, 200, 200, 40, 512):
        for view in flight(rng, t, 3):
            spheres = Spheres(ground, Camera.of(view), cull=False)
            found = carried.frame(lambda t, s=spheres: s.priority(t.diamond), triangles=budget)
            assert len(found) <= budget and fronts.is_valid(plain.front_of(n, found))
            s, _ = carried.highest_split()
            m, _ = carried.lowest_merge()
            assert s <= m
            waits = [t for t in found if not hrt.is_finest(t)]
            assert s == max([spheres.priority(t.diamond) for t in waits], default=-1.0)
            whole = [hrt.apex(t) for t in found if set(hrt.bottom(hrt.apex(t), n)) <= found and hrt.top(hrt.apex(t), n)]
            assert m == min([spheres.priority(i) for i in whole], default=math.inf)
            if waits:  # what is left of the budget is less than the first split takes
                assert len(found) > budget - 4 * n or not s > 0


@pytest.mark.stress
def test_wedgies_are_the_store_s():
    """The store closes them over the diamonds besides: a diamond's is no less than its children's."""
    t = plain.unrounded(plain.terrain(plain.rough(np.random.default_rng(1), (33, 33))))
    ground = Ground.of(t, "wedgie")
    n, e, closed = ground.n, wedgies(ground), {}
    for i in reversed(list(hrt.diamonds(n))):
        closed[i] = max([e[t] for t in hrt.top(i, n)] + [closed[j] for j in hrt.diamond_children(i, n)])
        assert closed[i] <= ground[i].error * (1 + 1e-6) and ground[i].error == pytest.approx(closed[i], rel=2e-6)
    for t in e:  # they nest: a half's prism lies inside
        for half in hrt.children(t) if not hrt.is_finest(t) else ():
            assert e[half] + ground.miss(t) <= e[t] * (1 + 1e-12)


def test_priorities_of_the_paper_keep_the_tolerance():
    """Wedgies by the printed identity, and prisms, which are not monotonic: conforming, accurate, and with a memory."""
    rng = np.random.default_rng(8)
    t = plain.terrain(plain.rough(rng, (17, 17), amplitude=60.0))
    ground = Ground.of(t, "wedgie")
    thick, carried, other = wedgies(ground), Roam(ground.n), Roam(ground.n)
    for view in flight(rng, t, 5):
        prisms = Prisms(Spheres(ground, Camera.of(view), cull=False))

        def printed(t, prisms=prisms):
            return wedgie_printed(prisms.spheres.camera, prisms.points(t), thick[t])

        for roam, priority in ((carried, printed), (other, prisms.priority)):
            found = roam.frame(priority, tolerance=4.0)
            assert fronts.is_valid(plain.front_of(ground.n, found))
            assert all(hrt.is_finest(t) or priority(t) <= 4.0 for t in found)
            assert roam.lowest_merge()[0] > 4.0
            few = Roam(ground.n).frame(priority, triangles=100)
            assert len(few) <= 100 and fronts.is_valid(plain.front_of(ground.n, few))
