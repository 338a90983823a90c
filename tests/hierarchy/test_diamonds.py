"""Diamonds and their dependencies against pairs of triangles that share a hypotenuse, found by geometry."""

from __future__ import annotations

import bisection
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.hierarchy import diamonds, triangles
from orograph.hierarchy.diamonds import EDGE, SQUARE

SMALL = range(1, 6)
NONE = (-1, -1)


def built(n: int) -> dict[tuple[int, int], list[bisection.Node]]:
    """(row, col) → the one or two triangles split there."""
    found: dict[tuple[int, int], list[bisection.Node]] = {}
    for level in bisection.hierarchy(n):
        for node in level:
            if node.halves:
                x, y = bisection.midpoint(*node.corners[1:])
                found.setdefault((y, x), []).append(node)
    return found


def corner_set(t) -> frozenset:
    return frozenset(tuple(map(int, c(*t))) for c in (triangles.apex, triangles.left_end, triangles.right_end))


@pytest.mark.parametrize("n", SMALL)
def test_every_vertex_but_four_is_one_diamond(n: int) -> None:
    row, col = np.indices(((1 << n) + 1,) * 2)
    found = diamonds.is_diamond(row, col, n)
    assert set(zip(row[found].tolist(), col[found].tolist())) == set(built(n))
    assert np.argwhere(~found).tolist() == [[r, c] for r in (0, 1 << n) for c in (0, 1 << n)]
    for r, c in [(-1, 1), (1, -1), ((1 << n) + 1, 1), (1, (1 << n) + 1)]:
        assert not diamonds.is_diamond(r, c, n)


@pytest.mark.parametrize("n", SMALL)
def test_tops_corners_kind_and_level(n: int) -> None:
    for (row, col), nodes in built(n).items():
        tops = [diamonds.top(row, col, k) for k in (0, 1)]
        inner = [bool(triangles.inside(*t, n)) for t in tops]
        assert {corner_set(t) for t, here in zip(tops, inner) if here} == {frozenset(node.corners) for node in nodes}
        assert all(triangles.exists(*t, n) == here for t, here in zip(tops, inner))
        for k, (t, here) in enumerate(zip(tops, inner)):
            assert t[3] // 4 == k
            assert diamonds.of_triangle(*t) == (row, col)
            if here:
                (node,) = (node for node in nodes if frozenset(node.corners) == corner_set(t))
                apex, left, right = ((y, x) for x, y in node.corners)
                assert diamonds.apex(row, col, k) == apex
                assert (diamonds.end(row, col, k), diamonds.end(row, col, 1 - k)) == (left, right)
        assert diamonds.level(row, col, n) == nodes[0].level
        apex, left, right = nodes[0].corners
        along_axis = left[0] == right[0] or left[1] == right[1]
        assert diamonds.kind(row, col) == (EDGE if along_axis else SQUARE)
        half = max(abs(left[0] - right[0]), abs(left[1] - right[1])) // 2
        assert diamonds.spacing(row, col) == half == 1 << diamonds.octave(row, col)


@pytest.mark.parametrize("n", SMALL)
def test_finest_triangles_have_no_diamond(n: int) -> None:
    row, col = diamonds.of_triangle(*triangles.of_level(n, 2 * n))
    assert (row == -1).all() and (col == -1).all()


@pytest.mark.parametrize("n", SMALL)
def test_every_parent_and_child(n: int) -> None:
    """A child splits what its parent's split leaves: a half of a top triangle of the parent is a top of the child."""
    home = {id(node): at for at, nodes in built(n).items() for node in nodes}
    for (row, col), nodes in built(n).items():
        parents = {home[id(node.parent)] for node in nodes if node.parent}
        found = [diamonds.parent(row, col, k, n) for k in (0, 1)]
        assert {p for p in found if p != NONE} == parents
        count = 0 if diamonds.level(row, col, n) == 0 else len(nodes)
        assert len([p for p in found if p != NONE]) == count
        children = {home[id(half)] for node in nodes for half in node.halves if half.halves}
        below = [diamonds.child(row, col, k, n) for k in range(4)]
        assert {c for c in below if c != NONE} == children
        finest_edge = diamonds.kind(row, col) == EDGE and diamonds.octave(row, col) == 0
        assert len([c for c in below if c != NONE]) == (0 if finest_edge else 2 * len(nodes))


@pytest.mark.parametrize("n", SMALL)
def test_children_are_where_the_octave_says(n: int) -> None:
    """Squares: the edges (row ± s, col), (row, col ± s). Edges: the squares (row ± s/2, col ± s/2) in the terrain."""
    N = 1 << n
    for row, col in built(n):
        s = diamonds.spacing(row, col)
        if diamonds.kind(row, col) == SQUARE:
            expected = {(row + s, col), (row - s, col), (row, col + s), (row, col - s)}
        else:
            h = s // 2
            expected = {(row + a, col + b) for a in (h, -h) for b in (h, -h)} if h else set()
            expected = {(r, c) for r, c in expected if 0 <= r <= N and 0 <= c <= N}
        assert {diamonds.child(row, col, k, n) for k in range(4)} - {NONE} == expected


@pytest.mark.parametrize("n", SMALL)
def test_of_level(n: int) -> None:
    at = {(r, c): nodes[0].level for (r, c), nodes in built(n).items()}
    for level in range(2 * n):
        row, col = diamonds.of_level(n, level)
        assert row.dtype == col.dtype == np.int64
        found = list(zip(row.tolist(), col.tolist()))
        assert len(set(found)) == len(found)
        assert set(found) == {v for v, of in at.items() if of == level}
    with pytest.raises(UsageError, match="levels"):
        diamonds.of_level(n, 2 * n)


@settings(max_examples=60)
@given(st.integers(1, 5), st.data())
def test_closure_by_walking_up(n: int, data) -> None:
    everything = built(n)
    home = {id(node): at for at, nodes in everything.items() for node in nodes}
    chosen = data.draw(st.sets(st.sampled_from(sorted(everything)), max_size=6))
    needed, todo = set(), list(chosen)
    while todo:
        at = todo.pop()
        if at not in needed:
            needed.add(at)
            todo += [home[id(node.parent)] for node in everything[at] if node.parent]
    active = np.zeros(((1 << n) + 1,) * 2, bool)
    for at in chosen:
        active[at] = True
    closed = diamonds.closure(active)
    assert {tuple(at) for at in np.argwhere(closed).tolist()} == needed
    assert diamonds.is_closed(closed) and diamonds.is_closed(active) == (needed == chosen)
    rows, cols = diamonds.ancestors([r for r, _ in chosen], [c for _, c in chosen], n)
    found = list(zip(rows.tolist(), cols.tolist()))
    assert set(found) == needed and len(found) == len(needed)
    assert (np.diff(diamonds.level(rows, cols, n)) >= 0).all()


def test_closure_needs_one_entry_per_vertex() -> None:
    for shape in [(4, 4), (5, 9), (5,), (0, 0)]:
        with pytest.raises(UsageError, match="One entry per vertex"):
            diamonds.closure(np.zeros(shape, bool))
    assert diamonds.closure(np.ones((2, 2), bool)).all()


def test_ancestors_are_of_diamonds() -> None:
    with pytest.raises(UsageError, match="no diamond at row 0, column 8"):
        diamonds.ancestors([1, 0], [1, 8], 3)


@given(st.integers(1, 30), st.data())
def test_large_squares(n: int, data) -> None:
    """Parents and children are each other's, one level apart, and int64 arrays say what Python's integers say."""
    at = st.integers(0, 1 << n)
    row, col = data.draw(at), data.draw(at)
    if row in (0, 1 << n) and col in (0, 1 << n):
        row, col = 1 << n - 1, 1 << n - 1
    level = diamonds.level(row, col, n)
    assert 0 <= level < 2 * n
    on_border = row in (0, 1 << n) or col in (0, 1 << n)
    parents = [diamonds.parent(row, col, k, n) for k in (0, 1)]
    assert sum(p != NONE for p in parents) == (0 if level == 0 else 1 if on_border else 2)
    for p in parents:
        if p != NONE:
            assert diamonds.level(*p, n) == level - 1
            assert (row, col) in [diamonds.child(*p, k, n) for k in range(4)]
    for k in range(4):
        c = diamonds.child(row, col, k, n)
        if c != NONE:
            assert diamonds.level(*c, n) == level + 1
            assert (row, col) in [diamonds.parent(*c, j, n) for j in (0, 1)]
        wide = diamonds.child(np.array([row]), np.array([col]), np.array([k]), n)
        assert tuple(int(v[0]) for v in wide) == c
    rows, cols = diamonds.ancestors(row, col, n)
    assert (row, col) == (rows[-1], cols[-1]) and diamonds.level(rows[0], cols[0], n) == 0
    for k in (0, 1):  # closed upwards
        r, c = diamonds.parent(rows, cols, k, n)
        assert set(zip(r.tolist(), c.tolist())) - {NONE} <= set(zip(rows.tolist(), cols.tolist()))
