"""ROAM's bintree under random splits and merges, against fronts (nothing incremental) and plain geometry."""

from __future__ import annotations

import numpy as np
import plain
import pytest
from affine import Affine

from orograph.geo.grid import Grid
from orograph.hierarchy import fronts
from orograph.lod.roam import Roam, bounds, frame, mesh, queues
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import View


def make(n: int, seed: int = 0) -> Roam:
    heights = np.random.default_rng(seed).normal(size=((1 << n) + 1,) * 2).astype(np.float32)
    terrain = MemoryTerrain(heights, Grid(heights.shape, Affine(10, 0, 0, 0, -10, 0)), "random")
    method = plain.refiner(Roam, terrain, cull=False, strips=None)
    method.mesh(View((80.0, -80.0, 5e4), (80.0, -80.0, 0.0)), tolerance=1e6)  # reads the pages
    return method


def corners(nodes: np.ndarray, i: int) -> list[tuple[int, int]]:
    return [(int(nodes[i][f"r{k}"]), int(nodes[i][f"c{k}"])) for k in range(3)]


def check(method: Roam) -> None:
    """Every invariant of the mesh and of its queues, from the nodes' places alone."""
    s = method._state
    nodes = s.nodes[: s.counts[mesh.TOP]]
    leaves = np.flatnonzero(nodes["state"] == mesh.LEAF)
    assert len(leaves) == s.counts[mesh.LEAVES]
    across: dict[tuple[tuple[int, int], tuple[int, int]], int] = {}
    for i in leaves:
        p, q, r = corners(nodes, i)
        for edge in ((p, q), (q, r), (r, p)):
            assert edge not in across  # all turn alike, and none overlaps another
            across[edge] = i
    twice_area = 0
    for i in leaves:
        p, q, r = corners(nodes, i)
        area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        assert area > 0
        twice_area += area
        neighbours = [across.get((q, p), -1), across.get((p, r), -1), across.get((r, q), -1)]
        assert [int(nodes[i][name]) for name in ("base", "left", "right")] == neighbours
        size = 1 << method.field.n
        for (a, b), there in zip(((p, q), (r, p), (q, r)), neighbours):
            on_border = any(a[k] == b[k] and a[k] in (0, size) for k in range(2))
            assert (there < 0) == on_border  # conforming: an inner edge is shared as a whole
    assert twice_area == 2 * 4**method.field.n
    inner = np.flatnonzero(nodes["state"] == mesh.INNER)
    mergeable = set()
    for i in inner:
        child, base = int(nodes[i]["child"]), int(nodes[i]["base"])
        assert nodes["parent"][child] == nodes["parent"][child + 1] == i
        assert nodes["level"][child] == nodes["level"][i] + 1
        assert base < 0 or (nodes["base"][base] == i and nodes["state"][base] == mesh.INNER)
        below = [k for j in (i, base) if j >= 0 for k in (nodes["child"][j], nodes["child"][j] + 1)]
        if all(nodes["state"][k] == mesh.LEAF for k in below):
            mergeable.add(i)
    assert set(np.flatnonzero((nodes["flags"] & mesh.MERGEABLE) > 0)) == mergeable
    queued = set()
    for queue in (queues.SPLIT, queues.MERGE):
        for bucket in range(queues.BUCKETS):
            i = int(s.heads[queue, bucket])
            filled = bool(int(s.occupied[queue, bucket >> 6]) >> (bucket & 63) & 1)
            assert filled == (i >= 0)
            while i >= 0:
                assert nodes["bucket"][i] == bucket and nodes["state"][i] == (mesh.INNER if queue else mesh.LEAF)
                queued.add(i)
                i = int(nodes["after"][i])
    assert queued & set(inner) == {min(i, nodes["base"][i]) if nodes["base"][i] >= 0 else i for i in mergeable}
    assert queued & set(leaves) == {i for i in leaves if nodes["priority"][i] > 0}
    free, at = set(), int(s.counts[mesh.FREED])
    while at >= 0:
        free |= {at, at + 1}
        at = int(nodes["child"][at])
    assert free == set(np.flatnonzero(nodes["state"] == mesh.FREE))


@pytest.mark.stress
@pytest.mark.parametrize("n", [1, 3, 5])
def test_random_splits_and_merges_keep_the_mesh_sound_and_follow_fronts(n: int) -> None:
    method = make(n)
    rng = np.random.default_rng(n)
    front = fronts.coarsest(n)
    check(method)
    for step in range(120):
        s = method._state
        nodes = s.nodes[: s.counts[mesh.TOP]]
        mergeable = np.flatnonzero((nodes["flags"] & mesh.MERGEABLE) > 0)
        leaves = np.flatnonzero((nodes["state"] == mesh.LEAF) & (nodes["level"] < 2 * n))
        do_split = len(mergeable) == 0 or (len(leaves) > 0 and rng.random() < 0.55)
        i = int(rng.choice(leaves if do_split else mergeable))
        row, col = int(nodes["r0"][i] + nodes["r1"][i]) // 2, int(nodes["c0"][i] + nodes["c1"][i]) // 2
        if do_split:
            assert frame.force_split(s, i)
            front = fronts.split(front, row, col)
        else:
            frame.merge_diamond(s, i)
            front = fronts.merge(front, row, col)
        if step % 10 == 0 or n < 5:
            check(method)
        nodes = s.nodes[: s.counts[mesh.TOP]]
        leaves = np.flatnonzero(nodes["state"] == mesh.LEAF)
        assert len(leaves) == len(front)
        # A conforming mesh is known by its vertices.
        rows, cols = front.vertices()
        assert {v for j in leaves for v in corners(nodes, j)} == set(zip(rows.tolist(), cols.tolist()))
        drawn = int(s.counts[mesh.DRAWN])
        assert drawn == len(leaves) and len(np.unique(s.members[:drawn])) == drawn
    check(method)


def test_buckets_order_priorities_and_one_lies_at_the_edge() -> None:
    rng = np.random.default_rng(0)
    p = np.sort(np.float32(2.0) ** rng.uniform(-28, 28, 400).astype(np.float32))
    buckets = [int(queues.bucket_of(v)) for v in p]
    assert buckets == sorted(buckets)
    for v, bucket in zip(p, buckets):
        assert v <= queues.largest_in(bucket) <= v * (1 + 1 / 63)
        assert (bucket >= queues.UNITY) == (v > 1)
    one = np.float32(1)
    assert queues.bucket_of(one) == queues.UNITY - 1
    assert queues.bucket_of(np.nextafter(one, np.float32(2))) == queues.UNITY
    assert queues.bucket_of(np.float32(0)) == 0 and queues.bucket_of(np.float32(np.inf)) == queues.BUCKETS - 1


def test_slack_is_the_largest_motion_that_cannot_cross() -> None:
    """Against the definition: the bound at the worst motion x is at the threshold, and before it is not yet."""
    rng = np.random.default_rng(1)
    for _ in range(300):
        e, n, m, up, t = rng.uniform(0.1, 10, 5) * (1, 1, 5, 0.3, 1)
        if e * n <= t * m * m:
            x = bounds.below(e, n, m, up, t)
            assert 0 <= x <= m
            assert e * (n + up * x) == pytest.approx(t * (m - x) ** 2, rel=1e-9)
        else:
            x = bounds.above(e, n, m, up, t)
            assert x >= 0
            assert e * (n - up * x) == pytest.approx(t * (m + x) ** 2, rel=1e-9)
