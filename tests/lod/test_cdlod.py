"""CDLOD: the selection of the paper, vertices that slide, where levels meet, budgets."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.lod.cdlod import STEPS
from orograph.lod.method import Goal, Resources
from orograph.lod.reference.cdlod import Selection, slid
from orograph.lod.registry import chosen
from orograph.lod.squares import Squares
from orograph.scene.camera import whole
from orograph.viewpoint import Camera


def make(t, grid=8, seams="closed", **resources):
    return chosen(f"cdlod,grid={grid},seams={seams}").make(t, Resources(**resources))


@pytest.mark.parametrize("shape", [(65, 65), (100, 77), (33, 200), (129, 40), (3, 3), (2, 2)])
def test_the_selection_is_the_reference_s(shape):
    rng = np.random.default_rng(shape)
    for k in range(8):
        t = plain.terrain(plain.rough(rng, shape), angle=float(rng.uniform(0, 360)))
        method = make(t, seams="closed" if k % 2 else "open")
        camera = Camera.over(t.grid, plain.random_view(rng, t), float(rng.choice([0.5, 1.0, 2.0])))
        tolerance = float(10 ** rng.uniform(-1, 1))
        ranges = method.ranges(camera, tolerance)

        def one(square):
            p, row, col = square
            return Squares(p, np.array([row >> p]), np.array([col >> p]))

        tree = Selection(
            method.exponent, ranges,
            lambda square, reach: bool(method._within(camera, one(square), reach)[0]),  # noqa: B023
            lambda square: bool(method._seen(camera, one(square))[0]),  # noqa: B023
            lambda square: len(method._heights.on_ground(one(square))) > 0,  # noqa: B023
        )  # fmt: skip
        tree.select((method.n, 0, 0))
        found = method.select(camera, Goal(tolerance)).instances
        got = {((int(q["level"]) + method.exponent - 1, int(q["row"]), int(q["col"])), int(q["level"])) for q in found}
        assert len(got) == len(found) and got == tree.quarters


def test_vertices_slide_as_printed():
    t = plain.terrain(plain.rough(np.random.default_rng(1), (129, 129)))
    method = make(t)
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(2), t))
    ranges = method.ranges(camera, 4.0)
    row, col = np.mgrid[0:129:4, 0:129:4].reshape(2, 1, -1)
    z = t.heights[row, col]
    got = method._slid(row, col, z, 2, camera, ranges)
    x, y = t.grid.xy(col, row)
    distance = np.sqrt(sum((a - b) ** 2 for a, b in zip((x, y, z), camera.view.eye)))
    wanted = [slid(d, ranges[1], ranges[2], 2 / 3) for d in distance.ravel()]
    np.testing.assert_allclose(got.ravel(), wanted, atol=1 / STEPS)


def test_ranges_grow_as_the_tolerance_asks():
    t = plain.terrain(plain.rough(np.random.default_rng(1), (257, 257)))
    camera = Camera.over(t.grid, whole(t, (640, 480)))
    for seams in ("closed", "open"):
        method = make(t, seams=seams)
        fine, coarse = (method.ranges(camera, tolerance) for tolerance in (0.5, 8.0))
        assert (fine >= coarse).all() and (fine[1:-1] >= 2 * fine[:-2]).all() and np.isinf(fine[-1])
        asked = method._errors[1:] / camera.view.pixel_slope / (2 / 3 * fine[:-1])
        assert (asked <= 0.5 * (1 + 1e-9)).all()
    assert (make(t).ranges(camera, 8.0) >= make(t, seams="open").ranges(camera, 8.0)).all()


def test_where_levels_meet_the_finer_has_arrived_and_the_coarser_not_begun():
    """So where both list vertices, they are the same; a T-junction is left only where vertices slide."""
    rng = np.random.default_rng(4)
    for _ in range(6):
        t = plain.terrain(plain.rough(rng, (257, 257)))
        camera = Camera.over(t.grid, plain.random_view(rng, t))
        method = make(t)
        selection = method.select(camera, Goal(8.0))
        ranges, sets = method.ranges(camera, 8.0), {}
        for level in np.unique(selection.instances["level"]).tolist():
            here = selection.instances[selection.instances["level"] == level]
            row, col, _ = method._moved(here, level, camera, ranges)
            for quarter, rows, cols in zip(here, row, col):
                sets[int(quarter["row"]), int(quarter["col"]), level] = set(zip(rows.tolist(), cols.tolist()))
        side = {level: 4 << level for *_, level in sets}
        for (r, c, k), ours in sets.items():
            for (i, j, m), theirs in sets.items():
                rows = max(r, i), min(r + side[k], i + side[m])
                cols = max(c, j), min(c + side[k], j + side[m])
                if rows[0] > rows[1] or cols[0] > cols[1] or m <= k:
                    continue
                assert m == k + 1

                def shared(points):
                    return {(y, x) for y, x in points if rows[0] <= y <= rows[1] and cols[0] <= x <= cols[1]}  # noqa: B023

                assert shared(ours) == shared(theirs)


def test_far_from_everything_it_is_a_regular_grid():
    t = plain.terrain(plain.rough(np.random.default_rng(5), (65, 65)))
    mesh = make(t, grid=64).select(Camera.over(t.grid, whole(t, (640, 480))), Goal(1.0)).tessellation()
    assert len(mesh.triangles) == 2 * 64 * 64
    report = verify.judge_mesh(mesh, t, whole(t, (640, 480)))
    assert not report.defects


def test_every_t_junction_is_filled_by_an_upright_triangle():
    rng, found = np.random.default_rng(3), 0
    for _ in range(6):
        t = plain.terrain(plain.rough(rng, (257, 257)))
        view = plain.random_view(rng, t)
        mesh = make(t).select(Camera.over(t.grid, view), Goal(4.0)).tessellation()
        defects = verify.judge_mesh(mesh, t, view).defects
        assert set(defects) <= {"t_junctions", "flat", "wrong_heights"}  # (what slides may stop on a sample)
        found += defects.get("t_junctions", 0)
        a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        assert (area <= 0).all() and (area == 0).sum() >= defects.get("t_junctions", 0)
    assert found


def test_cells_cut_by_turns_are_the_terrain_at_their_finest():
    t = plain.terrain(plain.rough(np.random.default_rng(5), (65, 50)))
    view = whole(t, (640, 480))
    camera = Camera.over(t.grid, view)
    method = chosen("cdlod,grid=8,cells=surface").make(t, Resources())
    assert verify.judge_mesh(method.select(camera, Goal(0.0)).tessellation(), t, view).ok(0.0)
    assert verify.judge_mesh(make(t).select(camera, Goal(0.0)).tessellation(), t, view).largest > 0


def test_it_promises_nothing_and_keeps_budgets():
    t = plain.terrain(plain.rough(np.random.default_rng(11), (513, 300), amplitude=500.0, gaps=0.05))
    camera = Camera.over(t.grid, whole(t, (640, 480)))
    for budget in (3000, 30_000):
        selection = make(t).select(camera, Goal(triangles=budget))
        assert selection.bound is None and not selection.stats["conservative"]
        assert selection.stats["within_budget"] and selection.stats["triangles"] <= budget
        assert 0 < len(selection.tessellation().triangles) <= budget


def test_a_store_gives_the_same(tmp_path):
    from orograph.store.build import build

    t = plain.terrain(plain.rough(np.random.default_rng(7), (600, 411), gaps=0.05))
    store = build(t, tmp_path / "a.oro")
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(8), t))
    one, two = (make(ground).select(camera, Goal(2.0)).tessellation() for ground in (t, store))
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.triangles, two.triangles)
