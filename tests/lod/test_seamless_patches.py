"""Seamless patches: pieces, layout, edges that agree, the referee's verdict, budgets, memory, threads."""

from __future__ import annotations

import itertools

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.lod.method import Goal, Resources
from orograph.lod.reference.seamless_patches import Quadtree, vertices
from orograph.lod.registry import chosen
from orograph.lod.seamless_errors import BlockErrors
from orograph.lod.seamless_layout import Layout
from orograph.lod.seamless_pieces import SeamlessPieces, turned
from orograph.lod.squares import Squares
from orograph.viewpoint import Camera


def make(t, segments=8, strips="kept", **resources):
    return chosen(f"seamless-patches,segments={segments},strips={strips}").make(t, Resources(**resources))


def corners(topology, turns=0, side=8):
    return turned(topology.points.astype(np.int64), turns, side)[topology.triangles]


def areas(triangles):
    (a, b, c) = triangles.transpose(1, 0, 2)
    return (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]) - (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1])


def edges_of(triangles):
    """How often each edge (unordered pair of points) is a triangle's."""
    found = {}
    for triangle in triangles.tolist():
        for i in range(3):
            edge = frozenset((tuple(triangle[i]), tuple(triangle[i - 1])))
            found[edge] = found.get(edge, 0) + 1
    return found


# ---- pieces --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("big", [1, 2, 3])
def test_every_patch_is_filled_once_without_a_t_junction_or_a_flat_triangle(big):
    pieces, side = SeamlessPieces.of(big), 1 << big
    for own in itertools.product(range(1, big + 1), repeat=4):
        made = []
        for turns in range(4):
            q, last = np.array(own[turns]), np.array(own[turns - 1])
            made.append(corners(pieces.topologies[int(pieces.tile(q))], turns, side))
            made.append(corners(pieces.topologies[int(pieces.strip(q, last))], turns, side))
        check(np.concatenate(made), own, side)


def check(triangles, own, side):
    assert (areas(triangles) > 0).all() and areas(triangles).sum() == 2 * side * side
    found = edges_of(triangles)
    assert set(found.values()) <= {1, 2}
    outer = {edge for edge, times in found.items() if times == 1}
    wanted = set()
    for turns, q in enumerate(own):
        along = np.array([(0, col) for col in range(0, side + 1, side >> q)])
        points = [tuple(p) for p in turned(along, turns, side).tolist()]
        wanted |= {frozenset(pair) for pair in itertools.pairwise(points)}
    assert outer == wanted


@pytest.mark.parametrize("q", [1, 2, 3])
def test_a_patch_of_equal_edges_is_the_surface_of_a_level(q):
    """Its triangles are cells cut from (even, even) to (odd, odd) corners."""
    pieces, n, same = SeamlessPieces.of(q), 1 << q, np.array(q)
    made = [corners(pieces.topologies[int(pieces.tile(same))], turns, n) for turns in range(4)]
    made += [corners(pieces.topologies[int(pieces.strip(same, same))], turns, n) for turns in range(4)]
    wanted = set()
    for row, col in itertools.product(range(n), repeat=2):
        nw, ne, sw, se = (row, col), (row, col + 1), (row + 1, col), (row + 1, col + 1)
        cut = ((nw, ne, se), (nw, se, sw)) if (row + col) % 2 == 0 else ((nw, ne, sw), (ne, se, sw))
        wanted |= {frozenset(t) for t in cut}
    assert {frozenset(map(tuple, t)) for t in np.concatenate(made).tolist()} == wanted


# ---- the layout ----------------------------------------------------------------------------------------------------


@pytest.mark.cases(2)
@pytest.mark.parametrize("shape", [(65, 65), (100, 77), (33, 200), (129, 40)])
def test_the_layout_is_the_reference_s(shape):
    rng = np.random.default_rng(shape)
    for k in range(8):
        z = plain.rough(rng, shape, gaps=0.1 if k % 2 else 0.0)
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)))
        method = make(t)
        camera = Camera.over(t.grid, plain.random_view(rng, t), float(rng.choice([0.5, 1.0, 2.0])))
        layout = Layout(camera, float(10 ** rng.uniform(-1, 1)), method._errors)

        def wanted(edge):
            p, row, col, across = edge
            return int(layout._wanted(p, across, np.array([row >> p]), np.array([col >> p]))[0])  # noqa: B023

        def seen(square):
            p, row, col = square
            return bool(layout._seen(Squares(p, np.array([row >> p]), np.array([col >> p])))[0])  # noqa: B023

        tree = Quadtree(shape, t.n, method.big, wanted, seen)
        expected = {leaf: [tree.spacing(leaf, side) for side in range(4)] for leaf in tree.leaves()}
        found = {}
        for one in layout.patches():
            p = one.squares.p
            for row, col, spacing in zip(one.squares.row << p, one.squares.col << p, one.spacing.tolist()):
                found[p, int(row), int(col)] = spacing
        assert found == expected
        _agree(expected)


def _agree(patches):
    """Both sides of every edge list the same vertices, and neighbours differ by one level."""
    corner = {square: vertices(square, spacings) for square, spacings in patches.items()}
    for (one, ours), (two, theirs) in itertools.combinations(corner.items(), 2):
        rows = range(max(one[1], two[1]), min(one[1] + (1 << one[0]), two[1] + (1 << two[0])) + 1)
        cols = range(max(one[2], two[2]), min(one[2] + (1 << one[0]), two[2] + (1 << two[0])) + 1)
        if min(len(rows), len(cols)) == 1 < max(len(rows), len(cols)):  # an edge in common
            assert abs(one[0] - two[0]) <= 1
            shared = {(r, c) for r in rows for c in cols}
            assert ours & shared == theirs & shared


# ---- the mesh ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", plain.SHAPES)
def test_the_promise_on_any_ground(shape):
    rng = np.random.default_rng(shape)
    for k in range(6):
        z = plain.rough(rng, shape, gaps=0.15 if k % 2 else 0.0)
        if np.isnan(z).all():
            continue
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
        view, tolerance = plain.random_view(rng, t), float(10 ** rng.uniform(-1, 1))
        selection = make(t, int(rng.choice([8, 16, 64]))).select(Camera.over(t.grid, view), Goal(tolerance))
        assert selection.bound == tolerance
        report = verify.judge_mesh(selection.tessellation(), t, view)
        assert report.ok(tolerance), (k, report.defects, report.largest, tolerance)


def test_the_finest_mesh_is_the_surface():
    t = plain.terrain(np.random.default_rng(5).normal(0, 20, (33, 70)).astype(np.float32))
    view = plain.random_view(np.random.default_rng(6), t)
    mesh = make(t).select(Camera.over(t.grid, view), Goal(0.0)).tessellation()
    assert verify.judge_mesh(mesh, t, view).largest == 0.0


def test_free_strips_are_off_by_twice_the_tolerance_at_most():
    rng = np.random.default_rng(2)
    for _ in range(20):
        t = plain.terrain(plain.rough(rng, (129, 129)))
        view, tolerance = plain.random_view(rng, t), float(rng.uniform(0.5, 8))
        selection = make(t, strips="free").select(Camera.over(t.grid, view), Goal(tolerance))
        assert selection.bound is None and not selection.stats["conservative"]
        report = verify.judge_mesh(selection.tessellation(), t, view)
        assert report.ok(2 * tolerance)
        kept = make(t).select(Camera.over(t.grid, view), Goal(tolerance))
        assert selection.stats["triangles"] <= kept.stats["triangles"]


def test_budgets_are_kept():
    t = plain.terrain(plain.rough(np.random.default_rng(11), (257, 257), amplitude=500.0))
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(4), t))
    for budget in (500, 5000, 50_000):
        selection = make(t).select(camera, Goal(triangles=budget))
        assert selection.stats["within_budget"] and selection.stats["triangles"] <= budget
        assert len(selection.tessellation().triangles) <= selection.stats["triangles"]
    assert not make(t).select(camera, Goal(triangles=2)).stats["within_budget"]


def test_a_store_and_any_number_of_threads_give_the_same(tmp_path):
    from orograph.store.build import build

    z = plain.rough(np.random.default_rng(7), (300, 411), gaps=0.05)
    t = plain.terrain(z)
    store = build(t, tmp_path / "a.oro")
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(8), t))
    meshes = [
        make(ground, jobs=jobs).select(camera, Goal(2.0)).tessellation()
        for ground, jobs in ((t, 1), (t, 3), (store, 1), (store, 2))
    ]
    for mesh in meshes[1:]:
        np.testing.assert_array_equal(mesh.vertices, meshes[0].vertices)
        np.testing.assert_array_equal(mesh.triangles, meshes[0].triangles)


def test_errors_of_blocks_are_the_largest_of_their_cells():
    z = plain.rough(np.random.default_rng(9), (90, 140))
    t = plain.terrain(z)
    errors = make(t)._errors
    for level, side in ((1, 3), (2, 4), (4, 5)):
        for i, j in itertools.product(range(90 >> side), range(140 >> side)):
            rows, cols = slice(i << side, ((i + 1) << side) + 1), slice(j << side, ((j + 1) << side) + 1)
            box = errors.heights.around(
                *(np.array([v]) for v in (cols.start, rows.start, cols.stop - 1, rows.stop - 1)), side
            )
            (here,), _ = errors.around(range(level, level + 1), box, side)
            part = z[rows, cols].astype(np.float64)
            if part.shape != ((1 << side) + 1,) * 2:
                continue
            r, c = (a.ravel().astype(float) for a in np.mgrid[: 1 << side, : 1 << side])
            step = 1 << level
            coarse = plain.surface(part[::step, ::step], c / step, r / step)
            off = np.abs(coarse - part[:-1, :-1].ravel()).max()
            assert off <= here[0] * (1 + 1e-5) + 1e-6
            assert np.isfinite(box.low[0]) and box.low[0] <= part.min() and box.high[0] >= part.max()


def test_errors_of_blocks_are_those_of_cells_however_few_are_kept(monkeypatch):
    """By squares of 16 × 16 cells, of which one is kept, as by whole levels."""
    t = plain.terrain(plain.rough(np.random.default_rng(21), (300, 421), gaps=0.002))
    whole = BlockErrors(t, "exact", 3, Resources(jobs=1))
    levels = {level: whole.blocks(level, max(level, 2)) for level in range(1, t.n + 1)}
    monkeypatch.setattr("orograph.lod.seamless_errors.CELLS", 4)
    small = BlockErrors(t, "exact", 3, Resources(max_memory=1, jobs=3))
    rng = np.random.default_rng(22)
    for level, block in levels.items():
        side = max(level, 2)
        again = small.blocks(level, side)
        np.testing.assert_array_equal(again.error, block.error)
        np.testing.assert_array_equal(again.mixed, block.mixed)
        rows, cols = block.error.shape
        i, j = rng.integers(0, [[rows], [cols]], (2, 20))
        boxes = small.heights.around(j << side, i << side, (j + 1) << side, (i + 1) << side, side)
        errors, mixed = small.around(range(level, level + 1), boxes, side)
        np.testing.assert_array_equal(errors[0], block.error[i, j])
        np.testing.assert_array_equal(mixed[0], block.mixed[i, j])
        assert len(small._squares) == 1
