"""What methods on right triangles share: options and their errors, goals, statistics, search for a budget."""

from __future__ import annotations

import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import plain
import pytest

from orograph.errors import UsageError
from orograph.lod import budget
from orograph.lod.budget import by_tolerance
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.quadtin import QuadTin
from orograph.lod.registry import chosen, method_of, names
from orograph.lod.right_triangles import Mesh, MeshOptions, RightTriangleMeshes, RightTriangles
from orograph.viewpoint import View

MESHES = tuple(name for name in names("triangles", "patches") if issubclass(method_of(name), (RightTriangles, QuadTin)))
FLAT = plain.terrain(np.zeros((9, 9), np.float32))
VIEW = View((5e5, 4e6, 900.0), (5e5 + 100, 4e6 - 100, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class PowersOptions(MeshOptions):
    metric: str | None = option(None, "", choices=("anisotropic",))


class Powers(RightTriangleMeshes):
    """As many triangles as a power law of the tolerance says."""

    info = MethodInfo("powers", "", "", "triangles", PowersOptions, lambda options: options.conservative)
    most = 5e6

    def _refine(self, camera, goal):
        tolerance = goal.tolerance
        if tolerance is None:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        self.asked = [*getattr(self, "asked", []), tolerance]
        count = int(min(self.most, 4 + 3000 * tolerance**-1.3)) if tolerance else int(self.most)
        self.keys = np.array([count]), np.zeros(1, np.float32)  # its own, used again
        return Mesh(*self.keys, is_strip=True, clockwise=False, triangles=count)


@pytest.mark.parametrize("budget", [20, 999, 30_000, 2_000_000])
def test_search_ends_close_below_the_budget(budget):
    method = plain.refiner(Powers, FLAT)
    mesh, _ = method.mesh(VIEW, triangles=budget)
    assert 0.98 * budget < mesh.triangles <= budget or budget == 20
    assert mesh.triangles <= budget and mesh.keys[0] == mesh.triangles
    assert len(method.asked) < 12
    assert mesh.triangles == int(4 + 3000 * mesh.tolerance**-1.3)


def test_search_ends_where_no_tolerance_reaches_the_budget():
    method = plain.refiner(Powers, FLAT)
    method.method.most = 1000
    mesh, _ = method.mesh(VIEW, triangles=5000)
    assert mesh.triangles == 1000 and len(method.asked) < 30
    mesh, _ = method.mesh(VIEW, triangles=3)
    assert mesh.triangles > 3 and not mesh.within


@pytest.mark.parametrize("seconds", [0.005, 0.05])
def test_a_budget_of_time_is_spent(seconds, monkeypatch):
    """A pass takes a microsecond a triangle, by a clock of its own: the first frame spends most of the time, and those
    of a flight all but a fifth of it, none more than there is."""
    now = [0.0]
    monkeypatch.setattr(budget, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    method = plain.refiner(Powers, FLAT)
    refine = method.method._refine

    def timed(camera, goal):
        mesh = refine(camera, goal)
        if goal.tolerance is not None:
            now[0] += 20e-6 + 1e-6 * mesh.triangles
        return mesh

    monkeypatch.setattr(method.method, "_refine", timed)
    for frame in range(5):
        begun = now[0]
        mesh, _ = method.mesh(VIEW, seconds=seconds)
        spent = now[0] - begun
        assert (0.5 if frame == 0 else 0.8) * seconds < spent <= seconds
        assert mesh.triangles > (0.3 if frame == 0 else 0.75) * seconds / 1e-6
        assert mesh.triangles == int(4 + 3000 * mesh.tolerance**-1.3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"error": "hausdorff"}, "error must be exact, wedgie"),
        ({"metric": "isotropic"}, "metric must be"),
        ({"metric": "nearest"}, "metric must be"),
        ({"exaggeration": 0.0}, "exaggeration"),
        ({"exaggeration": float("nan")}, "exaggeration"),
        ({"color_tolerance": 2.0}, "needs colours"),
        ({"color_tolerance": -1.0}, "ΔE"),
        ({"metric": "localised", "error": "midpoint"}, "metric must be"),
        ({"colour": 1}, "no option 'colour'; it has error, metric"),
        ({"exaggeration": "2"}, "exaggeration"),
        ({"color_tolerance": "2"}, "ΔE"),
        ({"jobs": -3}, "1 or more, not -3"),
        ({"jobs": 0}, "1 or more"),
        ({"jobs": 1.5}, "whole number"),
    ],
)
def test_options_that_make_no_sense(options, message):
    with pytest.raises(UsageError, match=message):
        plain.refiner(Powers, FLAT, **options).refine(VIEW)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ({"tolerance": 1.0, "triangles": 9}, "one goal"),
        ({"tolerance": -1.0}, "pixels"),
        ({"tolerance": float("inf")}, "pixels"),
        ({"triangles": 1}, "at least 2"),
        ({"triangles": 0}, "at least 2"),
        ({"seconds": 0.0}, "more than 0"),
        ({"seconds": -1.0}, "more than 0"),
        ({"tolerance": 0.0, "triangles": 9}, "one goal"),
        ({"tolerance": "1"}, "pixels.*'1'"),
        ({"triangles": 2.5}, "whole number"),
        ({"triangles": "9"}, "whole number"),
        ({"seconds": "1"}, "0 seconds"),
    ],
)
def test_goals_that_make_no_sense(goal, message):
    with pytest.raises(UsageError, match=message):
        plain.refiner(Powers, FLAT).mesh(VIEW, **goal)


def test_numbers_may_be_numpys():
    method = plain.refiner(Powers, FLAT, jobs=np.int64(2), exaggeration=np.float32(2))
    assert method.jobs == 2
    assert method.mesh(VIEW, triangles=np.int32(999))[0].triangles <= 999
    assert method.mesh(VIEW, tolerance=np.float32(1))[0].triangles == 3004


def fewest(name):
    """Triangles and vertices of the coarsest mesh of the plain: two triangles, a square's four, or two patches of 8
    segments a leg."""
    return {"triangle-patches": (128, 81), "restricted-quadtree": (4, 5)}.get(name, (2, 4))


@pytest.mark.stress
def test_a_budget_that_cannot_be_kept_is_recorded():
    plain_, rough = FLAT, plain.terrain(np.where(np.arange(81).reshape(9, 9) == 40, np.nan, 0).astype(np.float32))
    for name in MESHES:
        assert plain.refiner(name, plain_).refine(VIEW, triangles=fewest(name)[0]).stats["within_budget"] is True
        assert "within_budget" not in plain.refiner(name, plain_).refine(VIEW, tolerance=1).stats
        stats = plain.refiner(name, rough, cull=False).refine(VIEW, triangles=5).stats
        assert stats["triangles"] > 5 and stats["within_budget"] is False and not stats["conservative"]


def test_only_bounds_are_a_promise():
    assert plain.refiner(Powers, FLAT).conservative and plain.refiner(Powers, FLAT, error="wedgie").conservative
    assert not plain.refiner(Powers, FLAT, error="midpoint").conservative
    assert not plain.refiner("soar", FLAT, metric="isotropic-published").conservative
    with pytest.raises(UsageError, match="no method"):
        method_of("progressive")


@pytest.mark.parametrize("name", MESHES)
def test_methods_say_the_same_of_a_plain(name):
    t = plain.refiner(name, FLAT).refine(VIEW, tolerance=0.5)
    triangles, vertices = fewest(name)
    assert len(t.triangles) == triangles and len(t.vertices) == vertices
    wanted = {"method": name, "error": "exact", "tolerance": 0.5, "conservative": True, "triangles": triangles}
    assert wanted.items() <= t.stats.items()
    json.dumps(t.stats, allow_nan=False)


def test_what_a_store_lacks_is_made_and_said(tmp_path):
    from orograph.dem.raster import Dem
    from orograph.lod.method import Resources
    from orograph.progress import Progress
    from orograph.store.build import build
    from orograph.viewpoint import Camera

    class Heard(Progress):
        def __init__(self):
            self.notes = []

        def note(self, text):
            self.notes.append(text)

    t = plain.terrain(plain.rough(np.random.default_rng(3), (40, 61)))
    view, heard = plain.random_view(np.random.default_rng(4), t), Heard()
    with build(Dem(t.heights, t.grid), tmp_path / "t.oro", errors=()) as store:
        for text in ("soar", "soar,error=wedgie", "triangle-patches,legs=4", "soar"):
            camera, goal = Camera.over(t.grid, view), Goal(1.0)
            found = chosen(text).make(store, Resources(progress=heard)).select(camera, goal).tessellation()
            wanted = chosen(text).make(t).select(camera, goal).tessellation()
            assert np.array_equal(found.vertices, wanted.vertices)
        assert [note.split(":")[0] for note in heard.notes] == [
            "the store has no exact errors", "the store has no wedgie errors",
            "the store has no errors of such patches",
        ]  # fmt: skip
        with pytest.raises(UsageError, match="no midpoint errors, and making them in memory"):
            chosen("soar,error=midpoint").make(store, Resources(max_memory=1000))


@pytest.mark.parametrize(
    "text",
    [
        "roam,objects=3:4:5+6.5:7:0.125", "roam,cull=no,line-of-sight=1:2:3/4:5:6.25+7:8:9/123456.5:1:2",
        "roam,back-facing=0.2,occluded=0", "soar,geomorph=no",
    ],
)  # fmt: skip
def test_a_choice_is_told_as_it_is_given(text):
    """Windows and reports tell choices by their text."""
    choice = chosen(text, "cpu")
    again = chosen(str(choice), "cpu")
    assert again.options == choice.options and str(again) == str(choice)
    assert chosen("roam,objects=none", "cpu").options == chosen("roam", "cpu").options
