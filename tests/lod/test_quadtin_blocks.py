"""A QuadTIN's hierarchy by blocks: they agree at their sides, are the same whoever makes them, and views read few."""

from __future__ import annotations

from functools import partial

import numpy as np
import plain
import pytest
from test_quadtin import scattered

import orograph
from orograph import verify
from orograph.errors import UsageError
from orograph.lod import quadtin, quadtin_tree
from orograph.lod.hyperblock import HyperBlock
from orograph.lod.method import Goal
from orograph.lod.quadtin import QuadTin
from orograph.lod.quadtin_tree import Resident
from orograph.store.quadtin_layout import layout_of, top_of
from orograph.store.quadtin_make import make_quadtin
from orograph.store.repair import repair


def terrains():
    rng = np.random.default_rng(3)
    yield "raster", plain.terrain(plain.rough(rng, (70, 111)), stretch=2.5, angle=30)
    yield "gaps", plain.terrain(plain.rough(rng, (80, 64), gaps=0.15))
    yield "points", scattered(rng, (60, 90), 1500)
    yield "points with a rim", scattered(rng, (60, 90), 1500, whole=False)


@pytest.mark.parametrize(("name", "t"), list(terrains()), ids=lambda v: v if isinstance(v, str) else "")
def test_blocks_make_one_hierarchy(name, t):
    made = make_quadtin(t, 0.0, "nearest", side=20)
    assert made.layout.across >= 4 and not made.facts.stuck
    tree = Resident(made, t.grid, 1 << 30, name, whole=True).tree
    at = np.ldexp(tree.vertices[:, :2], made.layout.bits).astype(np.int64)
    assert len(np.unique(at, axis=0)) == len(at)  # each vertex once
    leaves, split = np.flatnonzero(tree.child < 0), np.flatnonzero(tree.child >= 0)
    a, b, c = (at[tree.corners[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert area.min() > 0 and area[leaves].sum() == area[:2].sum()  # nothing folds, all is covered once
    # Every edge has a triangle on both sides, or lies on the rectangle's border: no T-junction.
    edges = np.concatenate([tree.corners[leaves][:, [i, (i + 1) % 3]] for i in range(3)]).astype(np.int64)
    there = edges[:, 0] * len(at) + edges[:, 1]
    lone = edges[~np.isin(there, edges[:, 1] * len(at) + edges[:, 0])]
    assert len(np.unique(there)) == len(there)
    for end in at[lone].transpose(1, 0, 2):
        assert ((end == 0) | (end == at.max(0))).any(1).all()
    # Errors are closed over the hierarchy, and spheres hold those of what depends on them.
    later = np.arange(5, len(tree.vertices))
    col, row, z = tree.vertices.T
    a, b, _, d, e, _ = t.grid.samples[:6]
    places = np.column_stack([a * col + b * row, d * col + e * row, z])
    for k in (0, 1):
        p = tree.parents[later, k]
        inner = p > 3
        v, p = later[inner], p[inner]
        assert (tree.error[p] >= tree.error[v]).all()
        away = np.linalg.norm(places[p] - places[v], axis=1)
        assert (tree.radius[p] >= away + tree.radius[v] - 1e-6).all()
    assert (tree.off[split] <= tree.error[tree.node[split]]).all()
    assert tree.off[leaves].max() <= tree.finest * (1 + 2e-7)


def test_the_number_of_workers_changes_no_byte():
    for _, t in terrains():
        one, many = (make_quadtin(t, 0.0, "nearest", side=20, jobs=jobs) for jobs in (1, 4))
        assert one.facts == many.facts
        assert all(np.array_equal(a, b) for a, b in zip(one.summary, many.summary))
        for a, b in zip(one.words, many.words):
            assert all(np.array_equal(x, y) for x, y in zip(a, b))


def paged(monkeypatch, side=20):
    """Have hierarchies made in small blocks, and read by views."""
    monkeypatch.setattr(quadtin, "make_quadtin", partial(make_quadtin, side=side))
    monkeypatch.setattr(quadtin_tree, "AT_ONCE", 0)


@pytest.mark.stress
def test_what_is_in_memory_changes_nothing(monkeypatch):
    for name, t in terrains():
        monkeypatch.undo()
        monkeypatch.setattr(quadtin, "make_quadtin", partial(make_quadtin, side=20))
        whole = plain.refiner(QuadTin, t)
        paged(monkeypatch)
        some = plain.refiner(QuadTin, t)
        x, y = (float(v) for v in t.grid.xy(40, 40))
        down = plain.View((x, y, 3000.0), (x, y, 0.0), up=(0, 1, 0), fov_y=8.0, width=640, height=400)
        for view in (down, *(plain.random_view(np.random.default_rng(seed), t) for seed in range(8))):
            for tolerance in (8.0, 1.0):
                a, b = (m.refine(view, tolerance=tolerance) for m in (whole, some))
                assert np.array_equal(a.vertices, b.vertices) and np.array_equal(a.triangles, b.triangles), name
                assert np.array_equal(a.strip, b.strip)
            if view is down:
                assert 100 < len(some.method.tree.vertices) < len(whole.method.tree.vertices)


def test_a_view_of_little_reads_little(monkeypatch):
    paged(monkeypatch)
    t = plain.terrain(plain.rough(np.random.default_rng(3), (300, 300)))
    method = plain.refiner(QuadTin, t, finest=4.0)
    x, y = (float(v) for v in t.grid.xy(40, 40))
    down = plain.View((x, y, 2000.0), (x, y, 0.0), up=(0, 1, 0), fov_y=8.0, width=640, height=400)
    method.refine(down, tolerance=1.0)
    resident = method.method._resident
    assert 0 < np.count_nonzero(resident.parts) < 0.2 * resident.source.layout.blocks
    assert len(resident.tree.vertices) < 0.2 * resident.source.summary.vertices.sum()


@pytest.mark.stress
def test_the_promise_is_kept_by_parts(monkeypatch):
    paged(monkeypatch)
    promised = 0
    for name, t in terrains():
        rng = np.random.default_rng(len(name))
        method = plain.refiner(QuadTin, t)
        for _ in range(6):
            view, tolerance = plain.random_view(rng, t), float(2 ** rng.uniform(-1, 3))
            selection = method.select(method.camera(view), Goal(tolerance=tolerance))
            report = verify.judge_mesh(selection.mesh, t, view)
            assert not {"t_junctions", "overlaps", "crowded", "reversed", "flat", "bridged"} & set(report.defects)
            if selection.bound is not None:
                assert report.ok(selection.bound), (name, tolerance, selection.bound, str(report))
                promised += 1
    assert promised >= 15


@pytest.mark.stress
def test_a_store_has_the_hierarchy(tmp_path, monkeypatch):
    t = plain.terrain(plain.rough(np.random.default_rng(5), (400, 380), amplitude=200.0))
    stored = orograph.build(t, tmp_path / "a.oro", quadtin=(4.0, "nearest"), progress=False)
    assert stored.has("quadtin", finest=4.0, split="nearest") and not stored.has("quadtin", finest=1.0, split="nearest")
    again = orograph.build(t, tmp_path / "b.oro", quadtin=(4.0, "nearest"), progress=False, jobs=1)
    for file in sorted((tmp_path / "a.oro" / "quadtin").rglob("*")):
        other = tmp_path / "b.oro" / file.relative_to(tmp_path / "a.oro")
        assert file.is_dir() or file.read_bytes() == other.read_bytes()
    again.close()
    whole = plain.refiner(QuadTin, t, finest=4.0)
    monkeypatch.setattr(quadtin_tree, "AT_ONCE", 0)
    monkeypatch.setattr(quadtin, "make_quadtin", None)  # nothing is made
    some = plain.refiner(QuadTin, stored, finest=4.0)
    x, y = (float(v) for v in t.grid.xy(60, 60))
    near = plain.View((x - 900, y + 900, 900.0), (x, y, 0.0), fov_y=30.0, width=640, height=400)
    for view in (near, plain.random_view(np.random.default_rng(1), t)):
        a, b = (m.refine(view, tolerance=2.0) for m in (whole, some))
        assert np.array_equal(a.vertices, b.vertices) and np.array_equal(a.triangles, b.triangles)
    blocks = plain.refiner(HyperBlock, stored, finest=4.0).refine(near, tolerance=2.0)
    assert verify.judge_mesh(blocks, t, near).ok(max(2.0, blocks.stats["tolerance"]))
    stored.close()
    words = tmp_path / "b.oro" / "quadtin" / "part-1" / "words" / "c" / "0" / "0"
    sound = words.read_bytes()
    words.write_bytes(sound[:50] + bytes(8) + sound[58:])
    assert repair(tmp_path / "b.oro") and words.read_bytes() == sound


def test_one_view_that_needs_too_much_is_refused(monkeypatch):
    paged(monkeypatch)
    t = plain.terrain(plain.rough(np.random.default_rng(1), (120, 120)))
    method = plain.refiner(QuadTin, t, cull=False)
    method.method._resident.max_memory = 1 << 20
    with pytest.raises(UsageError, match="One view needs more than"):
        method.refine(plain.random_view(np.random.default_rng(0), t), tolerance=0.01)
    with pytest.raises(UsageError, match="which do not fit into memory"):
        Resident(make_quadtin(t, 0.0, "nearest"), t.grid, 1 << 20, "t", whole=True)


@pytest.mark.stress
def test_memory_is_what_it_says(monkeypatch):
    """Whole, with the room to refine; and by parts, which are kept as read only where there is room."""
    t = plain.terrain(plain.rough(np.random.default_rng(6), (300, 260), gaps=0.05))
    source = make_quadtin(t, 0.0, "nearest")
    view = plain.random_view(np.random.default_rng(0), t)
    method = plain.refiner(QuadTin, t, cull=False)
    wanted = method.refine(view, tolerance=0.5)
    own, tree = method.method, method.method.tree
    assert sum(a.nbytes for a in tree if isinstance(a, np.ndarray)) + sum(
        a.nbytes for a in (own._active, own._met, own._stack, own._colors)
    ) <= quadtin_tree.BYTES * len(tree.vertices)
    paged(monkeypatch)
    for each, kept in ((quadtin_tree.BYTES + quadtin_tree.HELD, True), (quadtin_tree.BYTES, False)):
        less = plain.refiner(QuadTin, t, cull=False)
        less.method._resident = resident = Resident(source, t.grid, 1 << 30, "t")
        resident.max_memory = int(source.summary.vertices.sum()) * each
        less.refine(view, tolerance=0.01)
        held = sum(a.nbytes for parts in resident._held.values() for one in parts for a in one)
        assert kept == (0 < held <= quadtin_tree.HELD * source.summary.vertices.sum())
        mesh = less.refine(view, tolerance=0.5)
        assert np.array_equal(mesh.vertices, wanted.vertices) and np.array_equal(mesh.triangles, wanted.triangles)


@pytest.mark.parametrize("across", [1, 2, 4, 8])
def test_the_top_ends_in_the_blocks(across):
    top = top_of(across)
    assert len(top.node) == 4 * across**2 - 2 and (top.node < 0).sum() == 2 * across**2
    assert sorted(map(tuple, top.order.tolist())) == [(i, j) for i in range(across + 1) for j in range(across + 1)]
    assert len(np.unique(top.roots)) == 2 * across**2 and (top.node[top.roots] == -1).all()


@pytest.mark.parametrize("shape", [(2, 2), (2, 5000), (3, 5000), (300, 300), (1201, 900), (5000, 7)])
def test_blocks_have_samples_at_their_corners(shape):
    layout = layout_of(shape)
    for lines, size in ((layout.xs, shape[1]), (layout.ys, shape[0])):
        assert (np.diff(lines) > 0).all() and (lines % (1 << layout.bits) == 0).all()
        assert lines[0] == 0 and lines[-1] == (size - 1) << layout.bits and len(lines) == layout.across + 1
