"""What stateless and top-down refinement have in common: budgets where ground is missing, colours, the promise."""

from __future__ import annotations

import numpy as np
import plain
import pytest
import rasterio

from orograph import verify
from orograph.lod.stateless import Stateless
from orograph.lod.top_down import TopDown

METHODS = pytest.mark.parametrize("make", [Stateless, TopDown])


@METHODS
def test_budgets_with_holes_and_culling_keep_the_mesh_conforming(make):
    rng = np.random.default_rng(8)
    t = plain.terrain(plain.rough(rng, (33, 29), gaps=0.1))
    view = plain.random_view(rng, t)
    method = plain.refiner(make, t)
    least = len(method.refine(view, triangles=2).triangles)
    assert 50 < least < 550
    for budget in range(2, 600, 7):
        found = method.refine(view, triangles=budget)
        report = verify.judge_mesh(found, t, view)
        assert not report.defects
        assert len(found.triangles) <= max(budget, least)
        assert found.stats["within_budget"] is (budget >= least)
        assert budget >= least or not found.stats["conservative"]
        if found.stats["conservative"]:
            assert report.ok(found.stats["tolerance"])


@METHODS
def test_no_budget_stops_before_all_edges_of_missing_ground(shared_data, make):
    with rasterio.open(shared_data / "osgearth-srtm90m-volcano-voids" / "mt_everest_90m.tif") as file:
        z = file.read(1)[300:700, 300:700].astype(np.float32)
        t = plain.terrain(np.where(z == file.nodata, np.nan, z), cell=90)
    rng = np.random.default_rng(15)
    method = plain.refiner(make, t, cull=False)
    for view in (plain.random_view(rng, t), plain.random_view(rng, t, projection="plan")):
        for goal in ({"triangles": 1000}, {"seconds": 1e-6}):
            found = method.refine(view, **goal)
            assert not verify.judge_mesh(found, t, view).defects
            assert len(found.triangles) > 1000
        assert method.refine(view, triangles=1000).stats["within_budget"] is False


@METHODS
def test_colors_do_not_exceed_a_budget(make):
    rng = np.random.default_rng(16)
    t = plain.terrain(plain.rough(rng, (65, 65)))
    view = plain.random_view(rng, t)

    def color(level, row0, row1, col0, col1):
        return np.full((row1 - row0, col1 - col0), 5.0, np.float32)

    found = plain.refiner(make, t, color=color, color_tolerance=1.0).refine(view, triangles=300)
    assert len(found.triangles) <= 300 and found.stats["within_budget"] is True
    assert not found.stats["conservative"] and not verify.judge_mesh(found, t, view).defects


@METHODS
def test_colors_force_splits(make):
    rng = np.random.default_rng(12)
    t = plain.terrain(np.zeros((65, 65), np.float32))
    view = plain.random_view(rng, t)

    def color(level, row0, row1, col0, col1):
        return np.full((row1 - row0, col1 - col0), 5.0, np.float32)

    flat = plain.refiner(make, t).refine(view, tolerance=1.0)
    coarse = plain.refiner(make, t, color=color, color_tolerance=6.0).refine(view, tolerance=1.0)
    fine = plain.refiner(make, t, color=color, color_tolerance=4.0).refine(view, tolerance=1.0)
    assert len(flat.triangles) == len(coarse.triangles) == 2
    assert len(fine.triangles) > 2
    assert verify.judge_mesh(fine, t, view).ok(0.0)


@METHODS
def test_promise_on_mountains(shared_data, make):
    with rasterio.open(shared_data / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif") as file:
        t = plain.terrain(file.read(1)[:500, :700].astype(np.float32))
    rng = np.random.default_rng(13)
    for metric in {Stateless: ("anisotropic", "isotropic"), TopDown: ("wedgie", "localised")}[make]:
        method = plain.refiner(make, t, metric=metric)
        for _ in range(8):
            view = plain.random_view(rng, t)
            for tolerance in (0.5, 2.0, 8.0):
                report = verify.judge_mesh(method.refine(view, tolerance=tolerance), t, view)
                assert report.ok(tolerance), report
