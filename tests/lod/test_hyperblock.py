"""HyperBlock-QuadTIN: blocks agree at their borders by construction, strips are the triangles, the promise holds."""

from __future__ import annotations

import numpy as np
import plain
import pytest
from test_quadtin import ground, scattered

from orograph import verify
from orograph.lod import hyperblock
from orograph.lod.hyperblock import HyperBlock
from orograph.lod.hyperblock_blocks import depth_for
from orograph.lod.method import Goal
from orograph.lod.reference.hyperblock import HyperBlock as Reference
from orograph.store.memory import MemoryTerrain


def reference(method, depth):
    """The reference over a method's hierarchy."""
    tree = method.tree
    split = np.flatnonzero(tree.child >= 0).tolist()
    children = {t: (int(tree.child[t]), int(tree.child[t]) + 1) for t in split}
    node = {t: int(tree.node[t]) for t in split}
    return Reference(children, node, dict(enumerate(tree.error.tolist())), method._ends.tolist(), depth)


@pytest.mark.parametrize("points", [True, False])
def test_levels_as_they_come_make_the_mesh_of_the_rule(points):
    rng = np.random.default_rng(3)
    t = scattered(rng, (40, 57), 700) if points else plain.terrain(plain.rough(rng, (40, 57)))
    method = plain.refiner(HyperBlock, t, cells=6).method
    tree, blocks = method.tree, method.blocks
    plainly = reference(method, depth_for(len(tree.vertices), 6))
    names = tree.node[blocks.roots[:, 0]].tolist()
    assert set(names) == set().union(*plainly.blocks.values())
    for name, around in zip(names, blocks.near.tolist()):
        assert plainly.blocks[name] <= {names[k] for k in around if k >= 0}
    for _ in range(5):
        method.levels[:] = rng.integers(20, 40, len(method.levels))
        method._follow(method._demands())
        levels = dict(zip(names, method.levels.tolist()))
        active = plainly.active(levels)
        for v in active:
            assert plainly.parents[v] & plainly.blocks.keys() <= active  # closed
        drawn = np.concatenate([method._rest.leaves, *(one.leaves for one in method._drawn)])
        assert len(drawn) == len(set(drawn.tolist())) and set(drawn.tolist()) == plainly.drawn(levels)


def test_the_strip_is_the_triangles_and_keeping_strips_changes_nothing(monkeypatch):
    t = scattered(np.random.default_rng(3), (50, 40), 700)
    kept, made = plain.refiner(HyperBlock, t, cells=8), plain.refiner(HyperBlock, t, cells=8, cache=False)
    monkeypatch.setattr(hyperblock, "READY", 1 << 40)
    late = plain.refiner(HyperBlock, t, cells=8)  # no room for what is made ahead
    assert kept.method.ready and not late.method.ready
    for seed in (0, 1, 2, 1, 0):
        view = plain.random_view(np.random.default_rng(seed), t)
        mesh, *others = (m.refine(view, tolerance=2.0) for m in (kept, made, late))
        for other in others:
            assert np.array_equal(mesh.triangles, other.triangles) and np.array_equal(mesh.strip, other.strip)
        found = []
        for i in range(len(mesh.strip) - 2):
            a, b, c = mesh.strip[i : i + 3]
            if a != b and b != c and a != c:
                found.append((a, b, c) if i % 2 == 0 else (b, a, c))
        turned = [tuple(np.roll(f, -int(np.argmin(f)))) for f in found]
        assert sorted(turned) == sorted(tuple(np.roll(f, -int(np.argmin(f)))) for f in mesh.triangles)
    assert kept.select(kept.camera(view), Goal(tolerance=2.0)).stats["triangulated"] == 0


def kept(t, views, seed, **options):
    """Whether the bound holds in random views; how many were promised."""
    rng = np.random.default_rng(seed)
    method = plain.refiner(HyperBlock, t, **options)
    promised = 0
    for _ in range(views):
        view, tolerance = plain.random_view(rng, t), float(10 ** rng.uniform(-0.3, 0.9))
        selection = method.select(method.camera(view), Goal(tolerance=tolerance))
        report = verify.judge_mesh(selection.mesh, t, view)
        assert not {"t_junctions", "overlaps", "crowded", "reversed", "flat", "bridged"} & set(report.defects)
        if selection.bound is not None:
            assert report.ok(selection.bound), (seed, tolerance, selection.bound, str(report))
            promised += 1
    return promised


def test_the_promise_is_kept():
    assert sum(kept(ground(k, np.random.default_rng(k)), 4, k, cells=4 + 4 * (k % 3)) for k in range(6)) > 15


@pytest.mark.stress
def test_the_promise_is_kept_in_hundreds_of_views():
    assert sum(kept(ground(k, np.random.default_rng(k)), 8, k, cells=4 + 4 * (k % 3)) for k in range(40)) >= 250


@pytest.mark.stress
@pytest.mark.parametrize("name", plain.GROUND)
def test_the_promise_is_kept_on_real_ground(shared_data, name):
    """12 views each of two parts of five terrains; where samples are missing nothing is promised."""
    whole = plain.ground(shared_data, name)
    rows, cols = whole.grid.shape
    for k in (0, 1):
        r, c = rows * (2 + 3 * k) // 8, cols * (2 + 3 * k) // 8
        heights = np.array(whole.heights[r : r + 90, c : c + 140])
        grid = whole.grid.window(r, r + len(heights), c, c + heights.shape[1])
        part = MemoryTerrain(heights, grid, name)
        assert kept(part, 12, k, cells=8 + 8 * k) == (0 if np.isnan(heights).any() else 12)
