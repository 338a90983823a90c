"""Orders for a GPU's cache: the same triangles, and fewer misses, beside meshoptimizer's."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph.lod.method import Goal
from orograph.lod.vertex_cache import CACHE, for_cache, misses, reordered


def plainly(triangles, cache):
    """Misses by the definition: a queue."""
    queue, found = [], 0
    for corner in triangles.ravel().tolist():
        if corner not in queue:
            found += 1
            queue = [*queue, corner][-cache:]
    return found


def grid(side):
    at = np.arange(side * side).reshape(side, side)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel()
    return np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.int32)


def turned(triangles):
    """Each triangle from its smallest corner on, sorted."""
    first = triangles.argmin(1)
    return sorted(map(tuple, triangles[np.arange(len(triangles))[:, None], (first[:, None] + [0, 1, 2]) % 3].tolist()))


@pytest.mark.parametrize("cache", [3, 16, 32])
def test_the_same_triangles_with_fewer_misses(cache):
    rng = np.random.default_rng(1)
    for triangles, count in ((grid(24), 576), (rng.permutation(grid(24)), 576), (grid(2), 4), (grid(2)[:0], 0)):
        ordered = reordered(triangles, count, cache)
        assert turned(ordered) == turned(triangles)
        assert misses(triangles, count, cache) == plainly(triangles, cache)
        if count > 4 and cache > 3:
            assert misses(ordered, count, cache) <= misses(triangles, count, cache)
    shuffled = rng.permutation(grid(24))
    assert misses(reordered(shuffled, 576, 16), 576, 16) < 0.8 * len(shuffled) < 0.5 * misses(shuffled, 576, 16)


@pytest.mark.stress
def test_patches_of_bdam_are_in_the_order_of_a_cache():
    """About as good as meshoptimizer's order, and vertices come in the order in which they are met."""
    t = plain.terrain(plain.rough(np.random.default_rng(3), (513, 513), amplitude=300.0))
    method = plain.refiner("bdam", t)
    chosen = method.method.select(method.camera(plain.random_view(np.random.default_rng(1), t)), Goal(4.0))
    found = theirs = count = 0
    for batch in chosen.batches:
        corners = batch.triangles
        assert len(np.unique(corners)) == len(batch.vertices)
        firsts = np.unique(corners, return_index=True)[1]
        assert (np.diff(firsts) > 0).all()
        found += misses(corners, len(batch.vertices), CACHE)
        theirs += misses(by_meshoptimizer(corners, len(batch.vertices)), len(batch.vertices), CACHE)
        count += len(corners)
    assert count > 5000 and found < 0.85 * count
    assert found < 1.15 * theirs


def by_meshoptimizer(triangles, count):
    meshoptimizer = pytest.importorskip("meshoptimizer")
    flat = np.ascontiguousarray(triangles.ravel(), np.uint32)
    out = np.zeros_like(flat)
    meshoptimizer.optimize_vertex_cache(out, flat, len(flat), count)
    return out.reshape(-1, 3).astype(np.int32)


def test_a_mesh_stays_what_it_is():
    rng = np.random.default_rng(2)
    vertices = rng.normal(size=(576, 3))
    triangles = rng.permutation(grid(24))
    moved, ordered = for_cache(vertices, triangles)
    before, after = vertices[triangles].reshape(-1, 9), moved[ordered]
    rolled = [np.roll(after, k, axis=1).reshape(-1, 9) for k in range(3)]
    known = {row.tobytes() for one in rolled for row in np.ascontiguousarray(one)}
    assert all(row.tobytes() in known for row in np.ascontiguousarray(before))
