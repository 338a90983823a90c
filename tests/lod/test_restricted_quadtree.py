"""The restricted quadtree: mesh and promise, levels and closure, strip, threads, memory."""

from __future__ import annotations

import functools

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.errors import UsageError
from orograph.hierarchy import diamonds, trees
from orograph.lod.reference.camera import Camera
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.restricted_quadtree import Alone, Quadtree
from orograph.lod.reference.terrain import Ground
from orograph.lod.registry import chosen
from orograph.lod.restricted_quadtree import RestrictedQuadtree

KEPT = ("conforming", "restricted")


def make(t, triangulation="conforming", **options):
    return plain.refiner(RestrictedQuadtree, t, triangulation=triangulation, **options)


def case(rng, shape, gaps):
    """A terrain, an exaggeration, a view, a tolerance; None where there is no ground."""
    z = plain.rough(rng, shape, gaps=gaps)
    if np.isnan(z).all():
        return None
    t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
    return t, float(rng.choice([0.5, 1.0, 2.0])), plain.random_view(rng, t), float(10 ** rng.uniform(-1, 1))


def reference(ground, view, exaggeration, tolerance, triangulation, cull, by_sides):
    """What is drawn of the reference: the corners (col, row) of its triangles."""
    spheres = Spheres(ground, Camera.of(view, exaggeration), cull=cull)
    shown = set()

    def is_shown(diamond):
        return not ground[diamond].empty and not spheres.is_out_of_view(diamond)

    def draw(t):
        places = [ground[v].place for v in t]
        (ax, ay), (bx, by), (cx, cy) = places
        if all(ground[v].known for v in t) and (bx - ax) * (cy - ay) != (cx - ax) * (by - ay):
            shown.add(frozenset(places))

    if triangulation == "unrestricted":
        alone = Alone(ground.n, spheres, tolerance)
        for square, _, _ in alone.leaves():
            if is_shown((square.x, square.y)):
                for t in alone.cut(square):
                    draw(t)
        return shown
    tree = Quadtree(ground.n, lambda i: not ground[i].empty and spheres.priority(i) > tolerance, by_sides)
    for square, _, _ in tree.leaves():
        for middle, t in tree.fan(square, triangulation == "restricted"):
            if is_shown((square.x, square.y)) and is_shown(middle):
                draw(t)
    return shown


# ---- the reference -------------------------------------------------------------------------------------------------


@pytest.mark.cases(3)
@pytest.mark.parametrize("triangulation", [*KEPT, "unrestricted"])
@pytest.mark.parametrize("shape", [s for s in plain.SHAPES if max(s) > 2])
def test_mesh_is_the_reference_s(shape, triangulation):
    rng = np.random.default_rng([*shape, len(triangulation)])
    for k in range(6):
        found = case(rng, shape, 0.15 if k % 2 else 0.0)
        if found is None:
            continue
        t, exaggeration, view, tolerance = found
        ground = Ground.of(t, exaggeration=exaggeration)
        for cull in (True, False):
            for split_by in ("quarters", "sides"):
                method = make(
                    t, triangulation, split_by=split_by, metric="anisotropic", cull=cull, exaggeration=exaggeration,
                    jobs=1,
                )  # fmt: skip
                mesh = method.refine(view, tolerance=tolerance)
                by_sides = split_by == "sides"
                wanted = reference(ground, view, exaggeration, tolerance, triangulation, cull, by_sides)
                assert plain.triangles_of(mesh) == wanted


def test_the_finest_mesh_is_the_surface():
    t = plain.terrain(np.random.default_rng(5).normal(0, 20, (33, 33)).astype(np.float32))
    view = plain.random_view(np.random.default_rng(6), t)
    for triangulation in (*KEPT, "unrestricted"):
        mesh = make(t, triangulation, cull=False).refine(view, tolerance=0.0)
        assert len(mesh.triangles) == 2 * 32 * 32
        assert verify.judge_mesh(mesh, t, view).ok(0.0)


def test_two_samples_by_two_are_two_triangles():
    for missing, left in (((), 2), (((0, 0),), 0), (((1, 0),), 1), (((0, 1),), 1)):
        z = np.array([[1, 2], [3, 4]], np.float32)
        for at in missing:
            z[at] = np.nan
        t = plain.terrain(z)
        view = plain.random_view(np.random.default_rng(1), t)
        mesh = make(t).refine(view, tolerance=1.0)
        assert len(mesh.triangles) == left
        assert not verify.judge_mesh(mesh, t, view).defects


# ---- the level rule ------------------------------------------------------------------------------------------------


@functools.cache
def hilly():
    return plain.terrain(plain.rough(np.random.default_rng(11), (257, 257), amplitude=500.0))


@pytest.mark.parametrize("tolerance", [0.5, 2.0, 8.0])
def test_vertices_are_their_closure_and_squares_differ_by_one_level(tolerance):
    t = hilly()
    method = make(t, cull=False)
    differing = 0
    for seed in range(4):
        mesh = method.refine(plain.random_view(np.random.default_rng(seed), t), tolerance=tolerance)
        col, row, _ = mesh.vertices.astype(int).T
        active = np.zeros((257, 257), bool)
        active[row, col] = True
        assert diamonds.is_closed(active)
        cells, count = method.cells, method.count
        leaves = np.flatnonzero(cells.first[:count] < 0)
        levels = np.full((256, 256), -1)
        for p in leaves:
            r, c = divmod(int(cells.centres[p]), 1 << 32)
            s = int(diamonds.spacing(r, c))
            assert (levels[r - s : r + s, c - s : c + s] == -1).all()
            levels[r - s : r + s, c - s : c + s] = trees.level(int(cells.numbers[p]), 0, 1, trees.QUAD)
            assert 256 >> levels[r, c] == 2 * s
        steps = np.concatenate([np.abs(np.diff(levels, axis=a)).ravel() for a in (0, 1)])
        assert levels.min() >= 0 and steps.max() <= 1
        differing += int(steps.sum())
    assert differing > 100


def test_numbers_are_those_of_the_implicit_quadtree():
    method = make(hilly(), cull=False)
    method.refine(plain.random_view(np.random.default_rng(2), hilly()), tolerance=1.0)
    cells, count = method.cells, method.count
    numbers, first = cells.numbers[:count], cells.first[:count]
    assert (np.diff(numbers) > 0).all()  # breadth first
    parents = np.flatnonzero(first >= 0)
    for k in range(4):
        below = numbers[first[parents] + k]
        assert (trees.parent(below, 1, trees.QUAD) == numbers[parents]).all()
        assert (trees.which_child(below, 1, trees.QUAD) == k).all()
    for side in range(4):  # neighbours know each other
        there = np.flatnonzero(cells.neighbours[:count, side] >= 0)
        assert (cells.neighbours[cells.neighbours[there, side], (side + 2) % 4] == there).all()


# ---- the promise ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("split_by", ["quarters", "sides"])
@pytest.mark.parametrize("triangulation", KEPT)
def test_promise_and_no_defect(triangulation, split_by):
    rng = np.random.default_rng(21)
    for k in range(12):
        shape = tuple(int(v) for v in rng.integers(2, 90, 2))
        found = case(rng, shape, float(rng.choice([0, 0.03, 0.3])))
        if found is None:
            continue
        t, exaggeration, _, _ = found
        method = make(t, triangulation, split_by=split_by, exaggeration=exaggeration, cull=k != 3)
        for _ in range(3):
            near, far = float(rng.choice([0, 0, 50])), float(rng.choice([np.inf, np.inf, 3000]))
            view = plain.random_view(rng, t, near=near, far=far)
            tolerance = float(rng.choice([0.5, 1, 2, 4, 8]))
            mesh = method.refine(view, tolerance=tolerance)
            assert mesh.stats["conservative"]
            report = verify.judge_mesh(mesh, t, view, exaggeration=exaggeration)
            assert report.ok(tolerance), (shape, report)


def test_unrestricted_squares_crack_and_promise_nothing():
    t = hilly()
    cracked = exceeded = 0
    method = make(t, "unrestricted")
    for seed in range(6):
        view = plain.random_view(np.random.default_rng(seed), t)
        mesh = method.refine(view, tolerance=4.0)
        assert not mesh.stats["conservative"] and method.select(method.camera(view), _goal(4.0)).bound is None
        report = verify.judge_mesh(mesh, t, view)
        cracked += bool(report.defects)
        exceeded += not report.ok(4.0)
        for other in KEPT:
            assert verify.judge_mesh(make(t, other).refine(view, tolerance=4.0), t, view).ok(4.0)
    assert cracked >= 5 and exceeded >= 5
    assert not chosen("restricted-quadtree,triangulation=unrestricted").conservative
    assert chosen("restricted-quadtree").conservative
    with pytest.raises(UsageError, match="anisotropic"):
        make(t, "unrestricted", metric="localised")


def _goal(tolerance):
    from orograph.lod.method import Goal

    return Goal(tolerance)


def test_four_triangles_are_fewer_than_eight():
    counts = []
    view = plain.random_view(np.random.default_rng(3), hilly())
    for triangulation in KEPT:
        mesh = make(hilly(), triangulation, cull=False).refine(view, tolerance=2.0)
        counts.append((len(mesh.triangles), mesh.stats["squares"]))
    assert counts[0][1] == counts[1][1] and 1.2 * counts[0][0] < counts[1][0] <= 2 * counts[0][0]


# ---- the strip -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("triangulation", [*KEPT, "unrestricted"])
def test_strip_and_triangles_are_the_same_set(triangulation):
    rng = np.random.default_rng(8)
    for gaps in (0.0, 0.1):
        t = plain.terrain(plain.rough(rng, (100, 129), amplitude=300.0, gaps=gaps))
        method = make(t, triangulation, jobs=1)
        mesh = method.refine(plain.random_view(rng, t), tolerance=1.0)
        made, _ = method.mesh(plain.random_view(rng, t), tolerance=1.0)
        assert made.is_strip
        strip, found = mesh.strip, []
        for k in range(len(strip) - 2):
            a, b, c = strip[k : k + 3]
            if len({a, b, c}) == 3:
                found.append(tuple(sorted((a, b, c))))
        assert sorted(found) == sorted(tuple(sorted(t)) for t in mesh.triangles.tolist())
        assert len(strip) < 2.9 * len(mesh.triangles) + 3
        assert mesh.stats["fans"] < mesh.stats["squares"]


def test_the_strip_goes_along_the_curve():
    t = plain.terrain(plain.rough(np.random.default_rng(4), (33, 33)))
    view = plain.random_view(np.random.default_rng(4), t)
    ground = Ground.of(t)
    spheres = Spheres(ground, Camera.of(view, 1.0), cull=False)
    tree = Quadtree(5, lambda i: spheres.priority(i) > 1.0)
    made, _ = make(t, metric="anisotropic", cull=False, jobs=1).mesh(view, tolerance=1.0)
    strip = [(int(k) & 0xFFFFFFFF, int(k) >> 32) for k in made.keys]
    centres = [(square.x, square.y) for square, _, _ in tree.leaves()]
    assert len(centres) > 30
    firsts = [strip.index(centre) for centre in centres]
    assert firsts == sorted(firsts)
    # From one square to the next without a jump: at most one vertex is repeated, and one more to turn the other way.
    triangles = sum(len({a, b, c}) == 3 for a, b, c in zip(strip, strip[1:], strip[2:]))
    assert len(strip) <= 2 * triangles + 3 * len(centres)


# ---- threads, memory, budgets, colours -----------------------------------------------------------------------------


def test_threads_change_nothing(monkeypatch):
    monkeypatch.setattr("orograph.lod.restricted_quadtree.SHARE", 16)
    for triangulation in (*KEPT, "unrestricted"):
        for seed in range(3):
            view = plain.random_view(np.random.default_rng(seed), hilly())
            one, *others = (make(hilly(), triangulation, jobs=jobs).refine(view, tolerance=1.0) for jobs in (1, 2, 5))
            for other in others:
                assert np.array_equal(one.strip, other.strip) and np.array_equal(one.vertices, other.vertices)
                assert np.array_equal(one.triangles, other.triangles)


def test_memory_changes_what_is_read_but_not_the_mesh():
    rng = np.random.default_rng(12)
    t = plain.terrain(plain.rough(rng, (1025, 900), amplitude=900.0, gaps=0.01))
    free, tight = make(t, jobs=2), make(t, jobs=2, max_memory=13 << 20)
    for k in (*range(5), 0):
        x, y = (float(v) for v in t.grid.xy(100 + 160 * k, 900 - 160 * k))
        view = plain.View((x - 3000, y - 1000, 4000.0), (x, y, 0.0), fov_y=20.0, width=640, height=400)
        a, b = free.refine(view, tolerance=2.0), tight.refine(view, tolerance=2.0)
        assert np.array_equal(a.strip, b.strip) and np.array_equal(a.vertices, b.vertices)
    assert tight.field.resident <= 13 < free.field.resident
    assert tight.field.tiles_read > free.field.tiles_read
    wide = plain.random_view(rng, t, fov_y=120.0)
    with pytest.raises(UsageError, match="tiles"):
        make(t, max_memory=13 << 20, cull=False).refine(wide, tolerance=0.001)


def test_budgets():
    t = hilly()
    method, view = make(t), plain.random_view(np.random.default_rng(5), t)
    for budget in (500, 3000, 20_000):
        found = method.refine(view, triangles=budget)
        assert 0.8 * min(budget, len(method.refine(view, tolerance=0.02).triangles)) < len(found.triangles) <= budget
        assert verify.judge_mesh(found, t, view).ok(found.stats["tolerance"])
    slow = method.refine(view, seconds=0.1)
    assert verify.judge_mesh(slow, t, view).ok(slow.stats["tolerance"])


def test_colors_split_what_is_large_enough_to_be_seen():
    rng = np.random.default_rng(8)
    t = plain.terrain(plain.rough(rng, (33, 33), amplitude=1.0))
    patch = np.zeros((33, 33), bool)
    patch[20:25, 7:12] = True
    table = np.where(diamonds.closure(patch), 9.0, 1.0).astype(np.float32)

    def color(level, row0, row1, col0, col1):
        return table[row0:row1, col0:col1]

    view = plain.View((*t.grid.xy(16, 16), 900.0), (*t.grid.xy(16, 16), 0.0), up=(0.0, 1.0, 0.0), fov_y=60.0)
    for triangulation in KEPT:
        plainly = make(t, triangulation).refine(view, tolerance=50.0)
        for gamma, finer in ((0.5, "all"), (5.0, "there"), (10.0, "none")):
            mesh = make(t, triangulation, color=color, color_tolerance=gamma).refine(view, tolerance=50.0)
            assert verify.judge_mesh(mesh, t, view).ok(50.0)
            if finer == "none":
                assert np.array_equal(mesh.strip, plainly.strip)
            elif finer == "all":
                assert len(mesh.triangles) == 2 * 32 * 32
            else:
                assert len(plainly.triangles) < len(mesh.triangles) < 2 * 32 * 32
                at = {(int(c), int(r)) for c, r, _ in mesh.vertices}
                assert {(c, r) for r, c in np.argwhere(patch).tolist()} <= at


@pytest.mark.stress
@pytest.mark.parametrize("name", plain.GROUND)
def test_the_referee_finds_the_promise_kept(shared_data, name):
    """42 views of each of five terrains, of each triangulation."""
    t = plain.ground(shared_data, name)
    rng = np.random.default_rng(1)
    methods = [make(t, triangulation) for triangulation in KEPT]
    for _ in range(42):
        view = plain.random_view(rng, t, width=1280, height=720)
        tolerance = float(2 ** rng.uniform(-1, 3))
        for method in methods:
            mesh = method.refine(view, tolerance=tolerance)
            report = verify.judge_mesh(mesh, t, view)
            assert report.ok(tolerance), (method.options.triangulation, view, tolerance, report)
