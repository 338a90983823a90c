"""HyperBlock-QuadTIN: blocks agree at their borders by construction, strips are the triangles, the promise holds."""

from __future__ import annotations

import numpy as np
import plain
import pytest
from test_quadtin import ground, scattered

from orograph import verify
from orograph.lod.hyperblock import HyperBlock
from orograph.lod.method import Goal


def sets_of(method):
    """For each vertex in blocks, those that have a part of its diamond, or of one that depends on it; by walking."""
    tree, blocks = method.tree, method.blocks
    found = {}

    def walk(t, block):
        v = int(tree.node[t])
        if v >= 0:
            found.setdefault(v, set()).add(block)
            for step in (0, 1):
                walk(int(tree.child[t]) + step, block)

    for block, roots in enumerate(blocks.roots.tolist()):
        for t in roots:
            walk(t, block)
    for v in sorted(found, reverse=True):  # those that depend on others are made after them
        for p in set(tree.parents[v].tolist()) & set(found):
            found[p] |= found[v]
    return found


@pytest.mark.parametrize("points", [True, False])
def test_levels_as_they_come_make_the_mesh_of_the_rule(points):
    rng = np.random.default_rng(3)
    t = scattered(rng, (40, 57), 700) if points else plain.terrain(plain.rough(rng, (40, 57)))
    method = plain.refiner(HyperBlock, t, cells=6).method
    tree, blocks, ends = method.tree, method.blocks, np.append(np.inf, method._ends)
    found = sets_of(method)
    for block, around in enumerate(blocks.near.tolist()):
        mine = [v for v, of in found.items() if block in of]
        assert all(found[v] <= set(around) for v in mine if v in set(tree.node[blocks.roots[block]]))
    for _ in range(5):
        method.levels[:] = rng.integers(20, 40, len(method.levels))
        method._follow(method._demands())
        active = {v for v, of in found.items() if any(tree.error[v] > ends[method.levels[b]] for b in of)}
        for v in active:
            assert set(tree.parents[v].tolist()) & set(found) <= active  # closed
        stack, wanted = [0, 1], set()
        while stack:
            s = stack.pop()
            v = int(tree.node[s])
            if v >= 0 and (v in active or v not in found):
                stack += [int(tree.child[s]), int(tree.child[s]) + 1]
            else:
                wanted.add(s)
        drawn = np.concatenate([method._rest.leaves, *(one.leaves for one in method._drawn)])
        assert len(drawn) == len(set(drawn.tolist())) and set(drawn.tolist()) == wanted


def test_the_strip_is_the_triangles_and_keeping_strips_changes_nothing():
    t = scattered(np.random.default_rng(3), (50, 40), 700)
    kept, made = plain.refiner(HyperBlock, t, cells=8), plain.refiner(HyperBlock, t, cells=8, cache=False)
    for seed in (0, 1, 2, 1, 0):
        view = plain.random_view(np.random.default_rng(seed), t)
        mesh, other = (m.refine(view, tolerance=2.0) for m in (kept, made))
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
