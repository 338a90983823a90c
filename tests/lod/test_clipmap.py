"""Clipmaps: the paper's windows, rings and transitions, toroidal updates, the promise, holes, budgets."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lod.clipmap_mesh import Ring, blended, triangles
from orograph.lod.clipmap_toroid import Toroid, Toroids
from orograph.lod.clipmap_windows import NO_BLEND, as_printed, borders, nested, whole
from orograph.lod.method import Goal, Ready, Resources
from orograph.lod.reference import clipmap as printed
from orograph.lod.registry import chosen
from orograph.viewpoint import Camera, View


def make(t, options="n=63", **resources):
    return chosen(f"clipmap,{options}").make(t, Resources(**resources))


def above(t, col, row, height, ahead=(40, 0)):
    """A view from so many metres above the highest ground, at a place in samples."""
    (x, y), (u, v) = t.grid.xy(col, row), t.grid.xy(col + ahead[0], row + ahead[1])
    top = t.height_range[1]
    return View((float(x), float(y), top + height), (float(u), float(v), top - 0.3 * height), width=320, height=200)


# ---- windows and rings ---------------------------------------------------------------------------------------------


def window_of(rectangle):
    return printed.Window(rectangle.level, rectangle.shape[0], rectangle.row0, rectangle.col0)


@pytest.mark.cases(2)
@pytest.mark.parametrize("n", [15, 31, 63])
def test_windows_rings_and_their_outer_rows_are_the_reference_s(n):
    rng, shape = np.random.default_rng(n), (1 << 14, 1 << 14)
    for _ in range(4):
        centre = tuple(rng.uniform(6000, 10_000, 2))
        stack, _ = as_printed(n, centre, shape, 0, 13)
        full = [w for w in stack if w.shape == (n, n)]
        assert [window_of(w) for w in full] == [printed.snapped(w.level, n, *centre) for w in full]
        for window, hole in zip(full, [*full[1:], None]):
            if any(borders(window, shape)):
                continue
            down = (window.row1 - 2) // 32 - window.row0 // 32 + 1
            across = (window.col1 - 2) // 32 - window.col0 // 32 + 1
            ring = Ring(window, hole, np.ones((down, across), bool), 32)
            got = {frozenset(map(tuple, corners)) for corners in triangles(ring, ring.part(), shape).tolist()}
            ours = window_of(window)
            whole_ring = printed.ring(ours, window_of(hole) if hole else None)
            assert got == printed.without_rim(whole_ring, printed.rim(ours))
            assert ring.triangles(shape) == len(got)


def test_blocks_fix_ups_and_trim_are_the_ring():
    for n in (15, 31, 63):
        for row, col in ((1000.3, 999.1), (1001.2, 1000.2), (1002.7, 1001.6), (1003.9, 1003.0)):
            outer, finer = (printed.snapped(level, n, row, col) for level in (3, 2))
            parts = printed.blocks(outer)
            m = (n + 1) // 4
            assert len(parts["blocks"]) == 12 and len(parts["fix-ups"]) == 4
            trim = printed.trim(outer, finer)
            assert len(trim) == 2 * (2 * m) - 1
            cells = 12 * (m - 1) ** 2 + 4 * 2 * (m - 1) + len(trim)
            assert cells == len(outer.cells() - outer.interior(finer))


def test_heights_blend_as_printed_onto_the_coarse_triangles():
    rng, n = np.random.default_rng(3), 63
    centre = (5000.4, 4999.3)
    stack, blends = as_printed(n, centre, (1 << 14, 1 << 14), 0, 13)
    window, blend = stack[-2], blends[-2]
    assert window.level == 1
    z = rng.normal(size=(n, n)).astype(np.float32)
    got = blended(z, window, blend, np.zeros((n, n), bool))
    rows, cols = np.mgrid[window.row0 : window.row1, window.col0 : window.col1]
    share = np.vectorize(lambda r, c: printed.alpha(r, c, centre[0] / 2, centre[1] / 2, n))(rows, cols)
    assert share[0].min() == share[-1].min() == share[:, 0].min() == share[:, -1].min() == 1.0
    assert (share == 0).mean() > 0.5
    # (The coarse surface, cut by its own diagonals: its samples count from an even or odd one on.)
    pad = window.row0 // 2 % 2, window.col0 // 2 % 2
    coarse = np.pad(z[::2, ::2].astype(float), ((pad[0], 1), (pad[1], 1)), mode="edge")
    u, v = (np.arange(n) / 2 + p for p in pad)
    below = plain.surface(coarse, *(a.astype(float) for a in np.meshgrid(v, u)))
    np.testing.assert_allclose(got, (1 - share) * z + share * below, atol=1e-6)


def test_finest_levels_are_left_out_above_four_tenths_of_their_extent():
    t = plain.terrain(plain.rough(np.random.default_rng(1), (1025, 1025)))
    method, x = make(t), 0.4 * 63 * 30.0
    flat = t.height_range[1] - t.heights[500, 500]
    for height, level in ((0.9 * x, 0), (1.1 * x, 1), (1.9 * x, 1), (2.1 * x, 2), (7.9 * x, 3), (8.1 * x, 4)):
        view = above(t, 500, 500, height - flat) if height > flat else above(t, 500, 500, 1.0)
        found = method.select(Camera.over(t.grid, view), Goal(0.0)).stats["finest_level"]
        assert found == (level if height > flat else 0)


# ---- the toroidal arrays -------------------------------------------------------------------------------------------


def test_a_moving_window_reads_an_l_and_holds_what_it_shows():
    rng, n = np.random.default_rng(2), 15
    ground = rng.normal(size=(400, 400)).astype(np.float32)
    toroid, at = Toroid(n), np.array([100, 100])
    before = None
    for _ in range(60):
        at = np.clip(at + 2 * rng.integers(-3, 4, 2), 0, 380) if rng.random() > 0.1 else 2 * rng.integers(0, 190, 2)
        window = Rectangle(0, int(at[0]), int(at[0]) + n, int(at[1]), int(at[1]) + n)
        parts = toroid.lacks(window)
        lacking = [(i, j) for p in parts for i in range(p.row0, p.row1) for j in range(p.col0, p.col1)]
        after = printed.Window(0, n, window.row0, window.col0)
        assert len(lacking) == len(set(lacking))
        assert set(lacking) == (printed.new_samples(before, after) if before else after.samples())
        assert len(parts) <= 2
        toroid.move(window, lambda r: ground[r.row0 : r.row1, r.col0 : r.col1])
        np.testing.assert_array_equal(toroid.heights(), ground[at[0] : at[0] + n, at[1] : at[1] + n])
        i, j = printed.slot(n, *map(int, at))
        assert toroid.data[i, j] == ground[at[0], at[1]]
        before = after


def test_levels_are_filled_coarse_first_within_the_budget():
    n, reads = 15, []
    windows = [Rectangle(level, 0, n, 0, n) for level in (3, 2, 1, 0)]

    def read(window):
        reads.append(window.level)
        return np.zeros(window.shape, np.float32)

    toroids = Toroids(n)
    held = [toroids.move(windows, read, n * n) for _ in range(4)]
    assert held == [1, 2, 3, 4] and reads == [3, 2, 1, 0]
    assert toroids.move(windows, read, n * n) == 4 and toroids.read == 0


def test_a_late_level_is_left_out_and_the_mesh_is_whole():
    t = plain.terrain(plain.rough(np.random.default_rng(7), (1025, 1025)))
    method, free = make(t, "n=63,update=1"), make(t)
    told = []
    for frame in range(12):
        view = above(t, 200 + 10 * frame + 500 * (frame > 7), 300, 200)
        camera = Camera.over(t.grid, view)
        selection = method.select(camera, Goal(0.0))
        report = verify.judge_mesh(selection.tessellation(), t, view)
        assert not report.defects
        assert selection.stats["samples_read"] <= 63**2
        told.append(selection.stats["late"])
        if not told[-1]:
            other = free.select(camera, Goal(0.0)).tessellation()
            np.testing.assert_array_equal(selection.tessellation().vertices, other.vertices)
    assert told[0] > 0 and told[7] == 0 and told[8] > 0 and told[8:] == sorted(told[8:], reverse=True)


def test_a_selection_stays_as_it_was_when_the_eye_moves_on():
    t = plain.terrain(plain.rough(np.random.default_rng(7), (1025, 1025)))
    cameras = [Camera.over(t.grid, above(t, col, 300, 200)) for col in (300, 600)]
    method = make(t)
    one = method.select(cameras[0], Goal(0.0))
    method.select(cameras[1], Goal(0.0))
    again = make(t).select(cameras[0], Goal(0.0))
    np.testing.assert_array_equal(one.tessellation().vertices, again.tessellation().vertices)


def test_levels_whose_tiles_are_not_there_are_left_out_and_told():
    t = plain.terrain(plain.rough(np.random.default_rng(7), (1025, 1025)))
    view = above(t, 500, 500, 100)
    counts = [t.tiles(k).error.size for k in range(t.levels)]
    there = np.ones(sum(counts), np.uint8)
    there[: counts[0] + counts[1]] = 0
    for options in ("n=63", "n=63,rings=promise"):
        method = make(t, options)
        selection = method.select(Camera.over(t.grid, view), Goal(0.1), Ready(there))
        assert selection.stack[-1].level == 2 and selection.bound is None and selection.stats["late"] == 2
        assert set(selection.lacking["level"].tolist()) == {0, 1}
        assert (np.diff(selection.lacking["pixels"]) <= 0).all()
        assert not verify.judge_mesh(selection.tessellation(), t, view).defects
        there[:] = 1
        assert not len(method.select(Camera.over(t.grid, view), Goal(0.1), Ready(there)).lacking)
        there[: counts[0] + counts[1]] = 0


# ---- the mesh ------------------------------------------------------------------------------------------------------

OPTIONS = ("n=63", "n=63,blend=no", "n=63,rings=promise", "n=63,rings=promise,blend=no")


@pytest.mark.parametrize("shape", [*plain.SHAPES, (200, 317), (392, 22), (63, 400)])
def test_no_defect_on_any_ground_and_promises_are_kept(shape):
    rng = np.random.default_rng(shape)
    for k in range(6):
        z = plain.rough(rng, shape, gaps=0.15 if k % 2 else 0.0)
        if np.isnan(z).all():
            continue
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
        view, tolerance = plain.random_view(rng, t), float(10 ** rng.uniform(-1, 1))
        for options in OPTIONS:
            selection = make(t, options).select(Camera.over(t.grid, view), Goal(tolerance))
            report = verify.judge_mesh(selection.tessellation(), t, view)
            assert not report.defects, (k, options, report.defects)
            assert (selection.bound == tolerance) is ("promise" in options)
            assert selection.bound is None or report.ok(tolerance), (k, options, report.largest, tolerance)


@pytest.mark.stress
def test_single_missing_samples_stay_holes_in_every_ring():
    """Holes that begin at a sample of a coarse level, between its samples, and on a window's side."""
    rng = np.random.default_rng(5)
    z = plain.rough(rng, (513, 300))
    for row, col in rng.integers(0, 300, (40, 2)):
        z[row : row + rng.integers(1, 4), col : col + rng.integers(1, 4)] = np.nan
    z[256, 128] = z[255, 64] = z[0, 0] = z[512, 299] = np.nan
    t = plain.terrain(z)
    for k in range(8):
        view = plain.random_view(rng, t) if k else above(t, 128, 256, 50)
        for options in OPTIONS:
            selection = make(t, options).select(Camera.over(t.grid, view), Goal(2.0))
            report = verify.judge_mesh(selection.tessellation(), t, view)
            assert not report.defects and (selection.bound is None or report.ok(2.0))


def test_with_a_tolerance_of_nothing_the_promise_is_the_surface():
    t = plain.terrain(np.random.default_rng(5).normal(0, 20, (33, 70)).astype(np.float32))
    view = plain.random_view(np.random.default_rng(6), t)
    mesh = make(t, "rings=promise").select(Camera.over(t.grid, view), Goal(0.0)).tessellation()
    assert verify.judge_mesh(mesh, t, view).largest == 0.0


def test_an_exaggerated_plan_and_an_eye_far_away():
    t = plain.terrain(plain.rough(np.random.default_rng(9), (300, 257), gaps=0.05))
    x, y = (float(v) for v in t.grid.xy(100, 100))
    far = View((x + 1e7, y, 1e6), (x, y, 0.0), width=320, height=200, fov_y=1)
    plan = View((x, y, 5000.0), (x, y, 0.0), (0, 1, 0), projection="plan", width=320, height=200)
    for view in (far, plan):
        for options in OPTIONS:
            selection = make(t, options).select(Camera.over(t.grid, view, 2.0), Goal(1.0))
            report = verify.judge_mesh(selection.tessellation(), t, view, exaggeration=2.0)
            assert not report.defects and (selection.bound is None or report.ok(1.0))


def test_nested_windows_leave_room_for_their_transitions():
    rng, shape = np.random.default_rng(8), (5000, 3111)
    for _ in range(50):
        wanted = {}
        for level in range(int(rng.integers(0, 6)), 8):
            row, col = (int(rng.integers(0, side >> level)) for side in shape)
            wanted[level] = Rectangle(level, row, row + int(rng.integers(2, 200)), col, col + int(rng.integers(2, 200)))
        stack, blends = nested(wanted, 6, shape, 12)
        assert stack[0] == whole(stack[0].level, shape)
        for outer, inner in pairwise(stack):
            hole = inner.around(outer.level)
            room = (hole.row0 - outer.row0, outer.row1 - hole.row1, hole.col0 - outer.col0, outer.col1 - hole.col1)
            for border, samples in zip(borders(outer, shape), room):
                assert border or samples >= 6 + 2
        for window, blend in zip(stack, blends):
            assert all(v % 2 == 0 for v in (window.row0, window.row1 - 1, window.col0, window.col1 - 1))
            side = blend.at(np.array([window.row0, window.row1 - 1]), np.array([window.col0, window.col1 - 1]))
            north, south, west, east = borders(window, shape)
            assert (side[0] == (0 if north and west else 1)) and (side[1] == (0 if south and east else 1))
    assert (NO_BLEND.at(np.arange(9)[:, None], np.arange(9)) == 0).all()


# ---- goals ---------------------------------------------------------------------------------------------------------


@pytest.mark.cases(1)
@pytest.mark.parametrize("gaps", [0.0, 0.05])
def test_budgets_are_kept(gaps):
    t = plain.terrain(plain.rough(np.random.default_rng(11), (1025, 700), amplitude=500.0, gaps=gaps))
    view = above(t, 300, 500, 100)
    camera = Camera.over(t.grid, view)
    for options in ("n=127", "n=63,rings=promise"):
        for budget in (24_000, 60_000):
            selection = make(t, options).select(camera, Goal(triangles=budget))
            mesh = selection.tessellation()
            assert selection.stats["within_budget"] and len(mesh.triangles) <= budget
            if gaps == 0:
                assert len(mesh.triangles) <= selection.stats["triangles"] <= budget
        few = make(t, options).select(camera, Goal(triangles=2))
        assert not few.stats["within_budget"] and few.bound is None
        assert not verify.judge_mesh(few.tessellation(), t, view).defects
    counts = [make(t, "n=127").select(camera, Goal(triangles=b)).stats["n"] for b in (4000, 8000, 16_000)]
    assert counts == sorted(counts)


def test_a_time_is_kept_and_a_tolerance_leaves_finest_levels_out():
    t = plain.terrain(plain.rough(np.random.default_rng(11), (1025, 700)))
    camera = Camera.over(t.grid, above(t, 300, 500, 100))
    for options in ("n=127", "n=63,rings=promise"):
        assert make(t, options).select(camera, Goal(seconds=0.05)).tessellation().triangles.size
    finest = [make(t).select(camera, Goal(tolerance)).stats["finest_level"] for tolerance in (0.0, 1.0, 10.0, 1000.0)]
    assert finest == sorted(finest) and finest[0] == 0 and finest[-1] > 2


def test_a_store_gives_the_same(tmp_path):
    from orograph.store.build import build

    t = plain.terrain(plain.rough(np.random.default_rng(7), (600, 411), gaps=0.05))
    store = build(t, tmp_path / "a.oro")
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(8), t))
    for options in ("n=63", "n=63,blend=no,rings=promise"):
        one, two = (make(ground, options).select(camera, Goal(2.0)).tessellation() for ground in (t, store))
        np.testing.assert_array_equal(one.vertices, two.vertices)
        np.testing.assert_array_equal(one.triangles, two.triangles)
