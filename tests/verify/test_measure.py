"""Measuring methods: what is counted, by methods that are made up."""

from __future__ import annotations

import itertools
import math

import numpy as np
import plain
import pytest
from affine import Affine

from orograph.geo.grid import Grid
from orograph.lod.method import Goal
from orograph.lod.raycast import RayCast
from orograph.lod.selection import TriangleMesh
from orograph.lod.soar import Soar
from orograph.store import MemoryTerrain
from orograph.tessellation import Tessellation
from orograph.verify import measure
from orograph.verify.measure import elsewhere, fingerprints, measure_flight, measure_views
from orograph.viewpoint import View

SIZE = 17
VIEW = View((700, -900, 900), (240, -240, 0), fov_y=40, width=200, height=120)


@pytest.fixture(scope="module")
def ground():
    y, x = np.mgrid[:SIZE, :SIZE]
    heights = (40 * np.sin(x / 3) * np.cos(y / 4)).astype(np.float32)
    return MemoryTerrain(heights, Grid(heights.shape, Affine(30, 0, 0, 0, -30, 0)), "made up")


class Scripted:
    """A method whose every mesh and time are known beforehand: the finest ones by turns, or the coarsest."""

    def __init__(self, terrain, *, slow=(1.0,), promises=True, tolerance=1.0, pattern=(0.0,)):
        self.method = plain.refiner(Soar, terrain, cull=False)
        self.times, self.pattern = itertools.cycle(slow), itertools.cycle(pattern)
        self.promises, self.tolerance = promises, tolerance
        self.seen = []

    def select(self, camera, goal):
        self.seen.append(camera.view)
        mesh = self.method.refine(VIEW, tolerance=next(self.pattern))
        stats = {"refine_ms": next(self.times), "tiles_read": len(self.seen), "tolerance": self.tolerance}
        bound = self.tolerance if self.promises else None
        return TriangleMesh(method="scripted", bound=bound, stats=stats, mesh=mesh)


def test_views(ground):
    rounds = [[5.0, 2.0, 3.0], [4.0, 6.0, 7.0], [9.0, 9.5, 20.0]]
    method = Scripted(ground, slow=[1000, 1000, 1000, *(t for r in rounds for ms in r for t in (0.1, ms))])
    m = measure_views(method, ground, [VIEW, VIEW, VIEW], Goal(1.0))
    # Three for the referee, and three times three for the clock, the eye taken away before each.
    assert method.seen == [VIEW] * 3 + [elsewhere(VIEW), VIEW] * 9
    assert (m.ms, m.ms_worst, m.frames, m.judged) == (4.0, 9.0, 3, 3)
    assert m.triangles == len(method.method.refine(VIEW, tolerance=0.0).triangles) > 500
    assert m.mtri_per_s == pytest.approx(3 * m.triangles / 15e-3 / 1e6)
    assert m.largest == pytest.approx(0, abs=1e-9) and m.changes is None and m.kept is True and not m.defects
    assert m.tiles_read == 21


def test_promises(ground):
    assert measure_views(Scripted(ground, pattern=[30.0]), ground, [VIEW], Goal(1.0)).kept is False
    assert measure_views(Scripted(ground, pattern=[30.0], promises=False), ground, [VIEW], Goal(1.0)).kept is None
    within = measure_views(Scripted(ground, pattern=[30.0], tolerance=30.0), ground, [VIEW], Goal(1.0))
    assert within.kept is True and 1 < within.largest <= 30 and 0 < within.rms < within.largest


def test_a_flight_counts_what_changes(ground):
    """Against sets of triangles: fine and coarse meshes by turns, and the same one again."""
    pattern = [0.0, 4.0, 0.0, 0.0, 4.0, 4.0, 12.0]  # the first three warm up
    method = Scripted(ground, pattern=pattern)
    m = measure_flight(method, ground, [VIEW] * 4, Goal(1.0), judged=2)
    sets = []
    for tolerance in pattern[3:]:
        mesh = plain.refiner(Soar, ground, cull=False).refine(VIEW, tolerance=tolerance)
        sets.append({frozenset(map(tuple, mesh.vertices[t, :2].tolist())) for t in mesh.triangles})
    truth = [(len(a ^ b), len(b)) for a, b in itertools.pairwise(sets)]
    assert truth[1][0] == 0 and truth[0][0] > 0.3 * truth[0][1]
    changed, own = np.sum(truth, axis=0)
    assert m.changes == pytest.approx(changed / own)
    assert (m.frames, m.judged) == (4, 2)
    assert m.triangles == np.mean([len(s) for s in sets])


def test_rays_are_judged_by_their_picture(ground):
    for m in (
        measure_views(RayCast(ground), ground, [VIEW], Goal(1.0)),
        measure_flight(RayCast(ground), ground, [VIEW] * 3, Goal(1.0)),
    ):
        assert m.triangles is m.mtri_per_s is m.largest is m.rms is m.changes is None
        assert m.ms > 0 and m.conservative and m.tolerance == 1.0 and m.judged == m.frames and m.kept is True
        assert 0 <= m.largest_in_picture <= 1 and m.farthest <= 1 + math.sqrt(2)


def test_rays_that_break_their_promise_are_found(ground, monkeypatch):
    depth = measure.ray_depth(ground, VIEW, 1.0)
    for spoilt in (np.where(np.isfinite(depth), depth * 0.9, depth), np.full_like(depth, np.nan)):
        monkeypatch.setattr(measure, "ray_depth", lambda *_, told=spoilt, **__: told.astype(np.float32))
        m = measure_views(RayCast(ground), ground, [VIEW], Goal(1.0))
        assert m.kept is False
    assert m.mismatches == np.isfinite(depth).sum()


def test_fingerprints_are_of_samples_not_of_numbers(ground):
    mesh = plain.refiner(Soar, ground).refine(VIEW, tolerance=0.5)
    order = np.random.default_rng(1).permutation(len(mesh.vertices))
    place = np.argsort(order)
    turned_over = np.roll(place[mesh.triangles][::-1], 1, axis=1).astype(np.int32)
    again = Tessellation(mesh.vertices[order], turned_over)
    np.testing.assert_array_equal(fingerprints(mesh), fingerprints(again))
    assert len(np.unique(fingerprints(mesh))) == len(mesh.triangles)
    moved = Tessellation(mesh.vertices + np.array([1, 0, 0]), mesh.triangles)
    assert len(np.intersect1d(fingerprints(mesh), fingerprints(moved))) < len(mesh.triangles)


def test_elsewhere_is_far_and_sees_nothing(ground):
    here, there = VIEW.axes()[2], elsewhere(VIEW).axes()[2]
    np.testing.assert_allclose(here, -there, atol=1e-12)
    assert np.isnan(elsewhere(VIEW).project((*ground.grid.xy(8, 8), 0.0))[0]).all()
    assert len(plain.refiner(Soar, ground).refine(elsewhere(VIEW), tolerance=1.0).triangles) <= 2
