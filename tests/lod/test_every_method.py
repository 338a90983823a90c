"""What every method owes, whatever its idea: its promise in hundreds of views, sound meshes, budgets, equal workers.

All registered methods are asked; one that is added is, too, as the page's own example shows. Those that make no
triangles have tests of their own.
"""

from __future__ import annotations

import numpy as np
import plain
import pytest
import toy

from orograph import verify
from orograph.errors import UsageError
from orograph.lod.method import Goal
from orograph.lod.registry import METHODS, method_of
from orograph.store.memory import MemoryTerrain

MESHES = [name for name in METHODS if method_of(name).info.kind != "rays"]

UNSOUND = {"t_junctions", "overlaps", "crowded", "reversed", "flat", "bridged", "inner"}

QUADTINS = ("quadtin", "hyperblock")
"""Where samples are missing they promise nothing, and end within a sample of the rim."""

LARGEST = 400
"""Samples a side of what is looked at of large terrains by methods that build much for it in memory."""


def ground(shared_data, name):
    """A terrain of ``plain.GROUND``, or the part in its middle that a test can build for in seconds."""
    whole = plain.ground(shared_data, name)
    rows, cols = (min(size, LARGEST - 17 * k) for k, size in enumerate(whole.grid.shape))
    r, c = (whole.grid.rows - rows) // 2, (whole.grid.cols - cols) // 2
    heights = whole.read(0, r, r + rows, c, c + cols)
    return MemoryTerrain(np.array(heights), whole.grid.window(r, r + rows, c, c + cols), name)


def judged(name, method, t, rng, views):
    """Have the referee look at random views; how many had a bound, and how many were over the tolerance without one."""
    promised = over = 0
    for _ in range(views):
        view, tolerance = plain.random_view(rng, t, width=640, height=400), float(2 ** rng.uniform(-1, 3))
        selection = method.method.select(method.camera(view), Goal(tolerance=tolerance))
        mesh = selection.tessellation()
        report = verify.judge_mesh(mesh, t, view)
        if method.info.conforming:  # (the pages of the others count their cracks)
            rim = {"inner"} if name in QUADTINS and selection.bound is None else set()
            assert not (UNSOUND - rim) & set(report.defects), (name, view, tolerance, str(report))
        if selection.bound is not None:
            assert report.ok(selection.bound), (name, view, tolerance, str(report))
            promised += 1
        else:
            over += report.largest > tolerance
    return promised, over


@pytest.mark.parametrize("name", MESHES)
def test_a_few_views_of_small_terrains(name):
    rng = np.random.default_rng(5)
    shapes = ((60, 97), {}), ((33, 70), {"gaps": 0.1}), ((49, 49), {})
    for (shape, more), stretch in zip(shapes, (1.0, 2.5, 1.0)):
        t = plain.terrain(plain.rough(rng, shape, **more), stretch=stretch)
        method = plain.refiner(name, t)
        promised, _ = judged(name, method, t, rng, 2)
        conservative = method.info.conservative(method.options)
        without = name in QUADTINS and more
        assert promised == (2 if conservative and not without else 0), name


@pytest.mark.stress
@pytest.mark.parametrize("place", plain.GROUND)
@pytest.mark.parametrize("name", MESHES)
def test_forty_two_views_of_each_of_five_terrains(shared_data, name, place):
    """210 views a method: oblong, a city and hills at 1 m, 90 m with voids, synthetic; 0.5 to 8 pixels."""
    t = ground(shared_data, place)
    method = plain.refiner(name, t)
    promised, over = judged(name, method, t, np.random.default_rng(len(place)), 42)
    voids = np.isnan(t.heights).any()
    if method.info.conservative(method.options) and not (voids and name in QUADTINS):
        assert promised >= 40, (name, place, promised)  # (one before the eye has none)
    elif not method.info.conservative(method.options):
        assert promised == 0
        print(f"{name}, {place}: {over} of 42 views over the tolerance")


@pytest.mark.parametrize("name", MESHES)
def test_any_number_of_workers_makes_the_same_mesh(name):
    t = plain.terrain(plain.rough(np.random.default_rng(8), (150, 120), gaps=0.02))
    found = []
    for jobs in (1, 3):
        method = plain.refiner(name, t, jobs=jobs)
        views = [plain.random_view(np.random.default_rng(seed), t) for seed in range(3)]
        found.append([method.refine(view, tolerance=1.0) for view in views])
    for one, other in zip(*found):
        assert np.array_equal(one.vertices, other.vertices) and np.array_equal(one.triangles, other.triangles)


@pytest.mark.parametrize("name", MESHES)
def test_budgets_of_triangles_and_of_time(name):
    t = plain.terrain(plain.rough(np.random.default_rng(9), (150, 120), amplitude=400.0))
    method = plain.refiner(name, t)
    view = plain.random_view(np.random.default_rng(4), t)
    for goal in ({"triangles": 12_000}, {"seconds": 0.05}):
        (what,) = goal
        if what not in method.info.goals:
            with pytest.raises(UsageError, match=name):
                method.refine(view, **goal)
            continue
        selection = method.method.select(method.camera(view), Goal(**goal))
        mesh = selection.tessellation()
        assert len(mesh.triangles) > 2
        if what == "triangles" and selection.stats.get("within_budget", True):
            assert len(mesh.triangles) <= goal["triangles"]
        if selection.bound is not None:
            assert verify.judge_mesh(mesh, t, view).ok(selection.bound), name


def test_the_method_of_the_page_owes_the_same(tmp_path):
    """The example of docs/methods/adding.md, registered as the page says."""
    with toy.added(tmp_path):
        test_a_few_views_of_small_terrains(toy.NAME)
        test_any_number_of_workers_makes_the_same_mesh(toy.NAME)
        test_budgets_of_triangles_and_of_time(toy.NAME)
        for stretch, seed in ((1.0, 1), (3.0, 2)):
            rng = np.random.default_rng(seed)
            t = plain.terrain(plain.rough(rng, (97, 130), gaps=0.1, amplitude=400.0), angle=30.0, stretch=stretch)
            judged(toy.NAME, plain.refiner(toy.NAME, t), t, rng, 6)
