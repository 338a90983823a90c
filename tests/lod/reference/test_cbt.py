"""The concurrent binary tree of the paper: its leaves, its neighbours, and the mesh that its updates end at."""

from __future__ import annotations

import numpy as np
import pytest

from orograph.hierarchy import triangles
from orograph.lod.reference import cbt, children, stateless, top_down


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_nodes_and_neighbours_are_those_of_the_hierarchy(n):
    for level in range(2 * n + 1):
        for node, x, y, L, omega in zip(range(2 << level, 4 << level), *triangles.of_level(n, level)):
            t = x, y, L, omega
            found = cbt.triangle(node, n)
            assert (found.L, found.omega) == (L, omega) and (int(found.x), int(found.y)) == (x, y)
            around = (triangles.left_neighbour, triangles.right_neighbour, triangles.sibling)
            expected = [f(*t, n) for f in around]
            numbers = [int(triangles.node(*e, n)) if e[2] else 0 for e in expected]
            assert cbt.neighbors(node) == (*numbers, node)


def test_leaves_come_in_order_and_each_once():
    rng = np.random.default_rng(1)
    tree = cbt.planted(3)
    for _ in range(20):
        leaves = tree.leaves()
        assert tree.sums[1] == len(leaves)
        # They tile the unit interval, in order.
        width = [2.0 ** -(node.bit_length() - 1) for node in leaves]
        begin = [node * w - 1 for node, w in zip(leaves, width)]
        assert begin[0] == 0 and np.allclose(np.cumsum(width), [*begin[1:], 1])
        tree.split(leaves[int(rng.integers(len(leaves)))])
        tree.reduce()


def closed(bad, n):
    """A criterion made monotonic."""
    found = set(bad)
    for d in reversed(list(children.diamonds(n))):
        if found & set(children.diamond_children(d, n)):
            found.add(d)
    return found


@pytest.mark.parametrize("share", [0.05, 0.3, 0.7])
def test_updates_end_at_the_coarsest_conforming_mesh(share):
    rng, n = np.random.default_rng(int(100 * share)), 3
    every = list(children.diamonds(n))
    tree = cbt.planted(n)
    for _ in range(6):
        bad = {d for d in every if rng.random() < share * 0.8 ** children.level(children.top(d, n)[0], n)}
        # Of any criterion, from two triangles: forced splits keep the mesh whole.
        found, _ = cbt.refine(n, bad.__contains__)
        assert set(found) == top_down.refine(n, lambda t, bad=bad: t.diamond in bad)
        # Of a monotonic one, from whatever mesh was before.
        monotonic = closed(bad, n)
        found, count = cbt.refine(n, monotonic.__contains__, tree)
        assert set(found) == set(stateless.refine(n, monotonic.__contains__))
        assert count <= 2 * n + 1


def test_a_square_of_one_cell_is_never_split():
    found, count = cbt.refine(0, lambda diamond: True)
    assert len(found) == 2 and count == 1
