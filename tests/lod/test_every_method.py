"""What every method owes, whatever its idea: its promise in hundreds of views, sound meshes, budgets, equal workers.

All registered methods are asked; one that is added is, too, as the page's own example shows. Those that make no
triangles have tests of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cache

import numpy as np
import plain
import pytest
import toy

from orograph import verify
from orograph.errors import UsageError
from orograph.hierarchy import diamonds
from orograph.lod.method import Goal, Resources
from orograph.lod.registry import METHODS, chosen, method_of
from orograph.scene.camera import whole
from orograph.scene.methods import made
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import Camera, View

MESHES = [name for name in METHODS if method_of(name).info.kind != "rays"]

COLORED = [name for name in MESHES if "color_tolerance" in {f.name for f in fields(method_of(name).info.options)}]

UNSOUND = {"t_junctions", "overlaps", "crowded", "reversed", "flat", "bridged", "inner"}

QUADTINS = ("quadtin", "hyperblock")
"""Where samples are missing they promise nothing, and end within a sample of the rim."""

OWN = (*QUADTINS, "bdam")
"""Their triangles are not the hierarchy's, nor are their color errors."""

COARSE = (*OWN, "restricted-quadtree", "smart", "triangle-patches")
"""Their unit is larger than the two triangles of a diamond: they draw more than is asked for."""

SAMPLES = 400 * 383
"""Of a terrain, which some methods build much for in memory."""


@cache
def ground(shared_data, name):
    """The middle of a terrain of ``plain.GROUND``, in its proportions. Methods share it, and so what it has made."""
    whole = plain.ground(shared_data, name)
    part = math.sqrt(SAMPLES / math.prod(whole.grid.shape))
    rows, cols = (int(size * part) for size in whole.grid.shape)
    r, c = (whole.grid.rows - rows) // 2, (whole.grid.cols - cols) // 2
    heights = whole.read(0, r, r + rows, c, c + cols)
    return MemoryTerrain(np.array(heights), whole.grid.window(r, r + rows, c, c + cols), name)


@dataclass
class Judged:
    """The referee's findings in several views.

    Attributes:
        promised: views with a bound. worst: their largest error over the bound.
        others: views without one. over: those of them whose error exceeds the tolerance. off: their largest error over
            the tolerance.
    """

    promised: int = 0
    worst: float = 0.0
    others: int = 0
    over: int = 0
    off: float = 0.0

    def add(self, views: Judged) -> None:
        self.promised, self.worst = self.promised + views.promised, max(self.worst, views.worst)
        self.others, self.over = self.others + views.others, self.over + views.over
        self.off = max(self.off, views.off)


def judged(name, method, t, rng, views):
    """Have the referee look at random views."""
    found = Judged()
    for _ in range(views):
        view, tolerance = plain.random_view(rng, t, width=640, height=400), float(2 ** rng.uniform(-1, 3))
        selection = method.method.select(method.camera(view), Goal(tolerance=tolerance))
        mesh = selection.tessellation()
        report = verify.judge_mesh(mesh, t, view, jobs=1)
        if method.info.conforming:  # (the pages of the others count their cracks)
            rim = {"inner"} if name in QUADTINS and selection.bound is None else set()
            assert not (UNSOUND - rim) & set(report.defects), (name, view, tolerance, str(report))
        if selection.bound is not None:
            assert report.ok(selection.bound), (name, view, tolerance, str(report))
            found.add(Judged(promised=1, worst=report.largest / selection.bound))
        else:
            found.add(Judged(others=1, over=report.largest > tolerance, off=report.largest / tolerance))
    return found


@pytest.mark.parametrize("name", MESHES)
def test_a_few_views_of_small_terrains(name):
    rng = np.random.default_rng(5)
    shapes = ((60, 97), {}), ((33, 70), {"gaps": 0.1}), ((49, 49), {})
    for (shape, more), stretch in zip(shapes, (1.0, 2.5, 1.0)):
        t = plain.terrain(plain.rough(rng, shape, **more), stretch=stretch)
        method = plain.refiner(name, t)
        promised = judged(name, method, t, rng, 2).promised
        conservative = method.info.conservative(method.options)
        without = name in QUADTINS and more
        assert promised == (2 if conservative and not without else 0), name


@pytest.mark.stress
@pytest.mark.parametrize("name", MESHES)
def test_forty_two_views_of_each_of_five_terrains(shared_data, name):
    """210 views a method: oblong, a city and hills at 1 m, 90 m with voids, synthetic; 0.5 to 8 pixels."""
    total = Judged()
    for place in plain.GROUND:
        t = ground(shared_data, place)
        method = plain.refiner(name, t, jobs=1)
        found = judged(name, method, t, np.random.default_rng(len(place)), 42)
        voids = np.isnan(t.heights).any()
        if not method.info.conservative(method.options):
            assert found.promised == 0
        elif not (voids and name in QUADTINS):
            assert found.promised >= 40, (name, place, found.promised)  # (one before the eye has none)
        total.add(found)
    without = f"{total.others} | {total.over} | {total.off:.2f}" if total.others else "– | – | –"
    print(f"\n| `{name}` | {total.promised} | {total.worst:.3f} | {without} |")


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


@pytest.mark.parametrize("name", MESHES)
def test_colors_split_what_heights_do_not(name):
    """Every method that has a color tolerance draws more for a smaller one; the others refuse it."""
    t = plain.terrain(plain.rough(np.random.default_rng(10), (90, 70), amplitude=400.0))
    if name not in COLORED:
        with pytest.raises(UsageError, match="tolerance"):
            chosen(f"{name},color-tolerance=5")
        return
    camera, counts = Camera.over(t.grid, whole(t, (800, 600))), []
    for gamma in ("", ",color-tolerance=20", ",color-tolerance=5"):
        method = made(chosen(name + gamma), t, Resources(jobs=1))
        selection = method.select(camera, Goal(tolerance=64.0))
        mesh = selection.tessellation()
        assert verify.judge_mesh(mesh, t, camera.view).ok(selection.bound), (name, gamma)
        counts.append(len(mesh.triangles))
    assert counts[0] < counts[1] < counts[2], (name, counts)


class Spot:
    """The colours of a spot on plain ground, and the color errors of diamonds."""

    def __init__(self):
        self.inside = np.zeros((129, 129), bool)
        self.inside[60:72, 30:41] = True
        self.errors = np.where(diamonds.closure(self.inside), 9.0, 1.0).astype(np.float32)

    def __call__(self, level, row0, row1, col0, col1):
        return self.errors[:: 1 << level, :: 1 << level][row0:row1, col0:col1]

    def colors(self, row0, row1, col0, col1):
        return np.where(self.inside[row0:row1, col0:col1, None], [50, 9, 0], [50, 0, 0]).astype(np.float32)


@pytest.mark.parametrize("name", [*COLORED, "threshold-spheres,metric=isotropic"])
def test_in_a_plan_colors_split_what_is_larger_than_a_pixel(name):
    """On flat ground, whose heights ask for nothing, and from whatever height."""
    t, spot = plain.terrain(np.zeros((129, 129), np.float32)), Spot()
    method = made(chosen(f"{name},color-tolerance=5"), t, Resources(color=spot))
    (x, y), radii, counts = t.grid.xy(64, 64), plain.Plain(t).r, {}
    for pixel in (15.0, 60.0, 240.0, 960.0, 60.0, 8000.0, 15.0):  # metres; samples are 30 m apart
        size = math.ceil(129 * 30 / pixel)
        for fov in (90.0, 3.0):
            away = pixel * size / 2 / math.tan(math.radians(fov) / 2)
            view = View((x, y, away), (x, y, 0.0), fov_y=fov, width=size, height=size, projection="plan")
            mesh = method.select(Camera.over(t.grid, view), Goal(tolerance=1.0)).tessellation()
            assert verify.judge_mesh(mesh, t, view).ok(0.0)
            counts.setdefault(pixel, set()).add(len(mesh.triangles))
            drawn = {(int(row), int(col)) for col, row, _ in mesh.vertices}
            needed = set(map(tuple, np.argwhere((radii > pixel) & (spot.errors > 5.0)).tolist()))
            if name not in OWN:
                assert needed <= drawn, (pixel, fov)
            if name not in COARSE:
                assert drawn - needed == {(0, 0), (0, 128), (128, 0), (128, 128)}, (pixel, fov)
    assert all(len(found) == 1 for found in counts.values())
    fine, middle, *_, coarse = (min(found) for found in counts.values())
    assert fine >= middle > coarse and (coarse == 2 or name in COARSE)


@cache
def large():
    """More pages of errors than fit into 26 MiB."""
    return plain.terrain(plain.rough(np.random.default_rng(11), (1025, 900), amplitude=900.0))


@pytest.mark.parametrize("name", MESHES)
def test_little_memory_makes_the_same_mesh_or_is_refused(name):
    t, cameras = large(), []
    for k in (0, 2, 4, 0):
        x, y = (float(v) for v in t.grid.xy(100 + 160 * k, 900 - 160 * k))
        view = plain.View((x - 3000, y - 1000, 4000.0), (x, y, 0.0), fov_y=20.0, width=640, height=400)
        cameras.append(Camera.over(t.grid, view))
    if name in QUADTINS:  # (made before, they are read by parts: test_quadtin_blocks.py)
        with pytest.raises(UsageError, match="memory"):
            chosen(name).make(t, Resources(16 << 20))
        return
    tight, free = (chosen(name).make(t, Resources(memory)) for memory in (26 << 20, 1 << 30))
    for camera in cameras:
        one, other = (method.select(camera, Goal(tolerance=4.0)).tessellation() for method in (tight, free))
        assert np.array_equal(one.vertices, other.vertices) and np.array_equal(one.triangles, other.triangles), name


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
