"""The restricted quadtree over any closed set of diamonds: the oracle is the closure in the diamond DAG."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph.hierarchy import diamonds, fronts
from orograph.lod.reference import children as hrt
from orograph.lod.reference import stateless
from orograph.lod.reference.restricted_quadtree import Quadtree, Square


def squares(n):
    """All squares there can be."""
    for k in range(n):
        s = 1 << k
        yield from (Square(x, y, s) for x in range(s, 1 << n, 2 * s) for y in range(s, 1 << n, 2 * s))


def sizes(n, leaves):
    """(2^n, 2^n): half the side of the leaf that each cell lies in; every cell lies in one."""
    found = np.zeros((1 << n, 1 << n), int)
    for x, y, s in leaves:
        assert not found[y - s : y + s, x - s : x + s].any()
        found[y - s : y + s, x - s : x + s] = s
    assert found.all()
    return found


def differences(found):
    """By how many levels cells that share a side differ at most."""
    levels = np.log2(found)
    return max(np.abs(np.diff(levels, axis=axis)).max(initial=0.0) for axis in (0, 1))


@pytest.mark.parametrize("by_sides", [False, True])
@pytest.mark.parametrize("n", range(1, 6))
def test_its_vertices_are_a_closure_and_its_mesh_is_the_closure_s(n, by_sides):
    rng = np.random.default_rng(n)
    seen = set()
    for share in (0.0, 0.001, 0.005, 0.02, 0.1, 0.5, 1.0):
        active = diamonds.closure(rng.random((2**n + 1,) * 2) < share)
        active[:: 1 << n, :: 1 << n] = False  # corners are no diamonds
        tree = Quadtree(n, lambda v, active=active: bool(active[v[1], v[0]]), by_sides)
        wanted = active.copy()
        wanted[1 << (n - 1), 1 << (n - 1)] = True
        for square in squares(n):
            # A square is split whole: the others of its quarters are wanted, too.
            below = [hrt.diamond_children(m, n) for m in square.middles if active[m[1], m[0]]]
            if square.s > 1 and any(by_sides or any(active[y, x] for x, y in quarters) for quarters in below):
                for x, y, _ in square.children:
                    wanted[y, x] = True
        closed = diamonds.closure(wanted)
        fans = [t for square, _, _ in tree.leaves() for _, t in tree.fan(square, False)]
        vertices = np.zeros_like(active)
        for t in fans:
            for x, y in t:
                vertices[y, x] = True
        vertices[:: 1 << n, :: 1 << n] = closed[:: 1 << n, :: 1 << n]
        assert np.array_equal(vertices, closed)
        assert (closed | ~active).all()
        T = stateless.refine(n, lambda v, closed=closed: bool(closed[v[1], v[0]]))
        assert {frozenset(t) for t in fans} == {frozenset(hrt.corners(t)) for t in T}
        assert len(fans) == len(T)
        seen.add(differences(sizes(n, [square for square, _, _ in tree.leaves()])))
    assert max(seen) <= 1 and (n < 4 or max(seen) == 1)


@pytest.mark.parametrize("n", range(1, 6))
def test_the_restricted_triangulation_conforms_with_eight_triangles_or_fewer(n):
    rng = np.random.default_rng(n)
    for share in (0.0, 0.003, 0.02, 0.2):
        active = diamonds.closure(rng.random((2**n + 1,) * 2) < share)
        tree = Quadtree(n, lambda v, active=active: bool(active[v[1], v[0]]), bool(n & 1))
        leaves = [square for square, _, _ in tree.leaves()]
        size = sizes(n, leaves)
        by_corners = {frozenset(hrt.corners(t)): t for k in range(2 * n + 1) for t in level(n, k)}
        T = []
        for square in leaves:
            fan = tree.fan(square, True)
            # One triangle at a side that borders a larger square, else two.
            larger = 0
            for x, y in (square.neighbour(side)[:2] for side in range(4)):
                larger += 0 < x < 2**n and 0 < y < 2**n and size[y, x] > square.s
            assert len(fan) == 8 - larger
            T += [by_corners[frozenset(t)] for _, t in fan]
        assert fronts.is_valid(plain.front_of(n, T))


def level(n, k):
    """All triangles of a level."""
    found = list(hrt.roots(n))
    for _ in range(k):
        found = [half for t in found for half in hrt.children(t)]
    return found


def test_an_open_set_makes_no_restricted_quadtree():
    """The level rule is the closure's doing: vertices without their ancestors break it."""
    n = 4
    active = np.zeros((17, 17), bool)
    for x, y in ((8, 8), (8, 0), (4, 4), (8, 4), (6, 6), (8, 6)):
        active[y, x] = True
    tree = Quadtree(n, lambda v: bool(active[v[1], v[0]]), True)
    assert differences(sizes(n, [square for square, _, _ in tree.leaves()])) > 1


def test_the_curve_leaves_each_square_where_it_enters_the_next():
    rng = np.random.default_rng(3)
    active = diamonds.closure(rng.random((33, 33)) < 0.02)
    tree = Quadtree(5, lambda v: bool(active[v[1], v[0]]))
    at = (0, 0)
    for square, e, d in tree.leaves():
        assert square.corners[e] == at
        at = square.corners[(e + d) % 4]
    assert at == (32, 0)


def test_parents_and_children():
    for square in squares(4):
        for child in square.children if square.s > 1 else []:
            assert child.parent == square
