"""Fronts against geometry: coverage of points, vertices inside edges, and the lecture's recursive forced split."""

from __future__ import annotations

import time
from fractions import Fraction

import bisection
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.hierarchy import diamonds, fronts, triangles
from orograph.hierarchy.fronts import Front, front_of

SIZES = st.integers(1, 4)


def meshed(front: Front) -> list[bisection.Corners]:
    """The corners of each triangle of a front."""
    corners = (triangles.apex, triangles.left_end, triangles.right_end)
    points = [np.stack(corner(*front.arrays), -1).tolist() for corner in corners]
    return [tuple(map(tuple, t)) for t in zip(*points)]


def hanging(mesh) -> dict[tuple[int, int], set]:
    """(triangle, edge) → the vertices of the mesh inside that edge; edges: hypotenuse, left leg, right leg."""
    vertices = {v for t in mesh for v in t}
    found: dict[tuple[int, int], set] = {}
    for i, (apex, left, right) in enumerate(mesh):
        for edge, (a, b) in enumerate([(left, right), (apex, left), (apex, right)]):
            inside = {v for v in vertices if bisection.inside_edge(v, a, b)}
            if inside:
                found[i, edge] = inside
    return found


def is_valid(front: Front) -> bool:
    mesh = meshed(front)
    return bool((bisection.coverage(mesh, front.n) == 1).all()) and not hanging(mesh)


@st.composite
def closed_sets(draw, n: int, most: int = 8) -> np.ndarray:
    """Active vertices that are closed in the DAG."""
    active = np.zeros(((1 << n) + 1,) * 2, bool)
    at = st.tuples(st.integers(0, 1 << n), st.integers(0, 1 << n))
    for row, col in draw(st.lists(at, max_size=most)):
        active[row, col] = diamonds.is_diamond(row, col, n)
    return diamonds.closure(active)


@st.composite
def partitions(draw) -> Front:
    """Triangles halved one by one: a front, seldom a valid one."""
    n = draw(SIZES)
    parts = [triangles.root(k, n) for k in (0, 1)]
    for pick in draw(st.lists(st.integers(0, 10**6), max_size=25)):
        t = parts.pop(pick % len(parts))
        halvable = not triangles.is_finest(*t[2:])
        parts += [triangles.child(*t, k) for k in (0, 1)] if halvable else [t]
    return Front.of(n, *zip(*parts))


# ---- construction ------------------------------------------------------------------------------------------------


@settings(max_examples=50)
@given(SIZES, st.data())
def test_front_of_active_vertices(n: int, data) -> None:
    active = data.draw(closed_sets(n))
    front = front_of(active)
    assert is_valid(front) and fronts.is_valid(front)
    corners = np.ix_([0, -1], [0, -1])
    expected = active.copy()
    expected[corners] = True
    assert np.array_equal(front.active(), expected)
    assert front_of(front.active()) == front
    order = data.draw(st.permutations(range(len(front))))
    assert Front.of(n, *(v[list(order)] for v in front.arrays)) == front


@pytest.mark.parametrize("n", range(5))
def test_uniform_fronts(n: int) -> None:
    for level in range(2 * n + 1):
        front = fronts.uniform(n, level)
        assert fronts.is_valid(front) and len(front) == 2 << level and (front.levels() == level).all()
    assert fronts.coarsest(n) == fronts.uniform(n, 0)
    assert front_of(np.ones(((1 << n) + 1,) * 2, bool)) == fronts.uniform(n, 2 * n)


def test_what_is_no_front_is_refused() -> None:
    with pytest.raises(UsageError, match=r"\(2, 2, 2, 3\) is not a triangle"):
        Front.of(2, [2, 2], [2, 2], [4, 2], [3, 3])
    active = np.zeros((9, 9), bool)
    active[1, 1] = True
    with pytest.raises(UsageError, match="parents"):
        front_of(active)
    with pytest.raises(UsageError, match="4, 9"):
        front_of(np.zeros((4, 9), bool))


# ---- validity ----------------------------------------------------------------------------------------------------


@settings(max_examples=100)
@given(partitions())
def test_t_junctions_of_partitions(front: Front) -> None:
    """Edges with a vertex inside are found, all of them and no other, by a vertex inside; and so are cracks."""
    mesh = meshed(front)
    truth = hanging(mesh)
    found = fronts.t_junctions(front)
    assert sorted(zip(found.triangle.tolist(), found.edge.tolist())) == sorted(truth)
    assert not fronts.partition_faults(front)
    assert fronts.is_valid(front) == is_valid(front)
    heights = np.random.default_rng(0).normal(size=((1 << front.n) + 1,) * 2)
    widths = fronts.cracks(front, heights)
    for i, edge, row, col, width in zip(found.triangle, found.edge, found.row, found.col, widths):
        assert (col, row) in truth[i, edge]
        apex, left, right = mesh[i]
        (ax, ay), (bx, by) = [(left, right), (apex, left), (apex, right)][edge]
        assert (2 * col, 2 * row) == (ax + bx, ay + by)
        assert width == pytest.approx(abs(heights[row, col] - (heights[ay, ax] + heights[by, bx]) / 2))
    row, col = np.indices(heights.shape)
    assert (fronts.cracks(front, 3.0 * row - 2.0 * col) == 0).all()  # a plane hides its T-junctions


@settings(max_examples=100)
@given(partitions(), st.data())
def test_overlaps_and_gaps(front: Front, data) -> None:
    """Some triangles left out, some put in twice, some with a descendant on top."""
    picks = st.lists(st.integers(0, len(front) - 1), max_size=4)
    dropped, doubled, topped = data.draw(picks), data.draw(picks), data.draw(picks)
    parts = [tuple(t) for t in zip(*(v.tolist() for v in front.arrays))]
    extra = [parts[i] for i in doubled]
    for i in topped:
        t = parts[i]
        for k in data.draw(st.lists(st.integers(0, 1), min_size=1, max_size=3)):
            t = t if triangles.is_finest(*t[2:]) else triangles.child(*t, k)
        extra.append(t)
    parts = [t for i, t in enumerate(parts) if i not in dropped] + extra
    broken = Front.of(front.n, *(zip(*parts) if parts else [[]] * 4))
    faults = fronts.partition_faults(broken)
    mesh, where = meshed(broken), bisection.points(front.n)
    count = bisection.coverage(mesh, front.n)
    assert bool(faults) == bool((count != 1).any())
    assert not (faults and fronts.is_valid(broken))
    gaps = meshed(Front(front.n, *faults.gaps))
    assert np.array_equal(bisection.coverage(gaps, front.n), count == 0)
    for t, up in zip(zip(*faults.gaps), (triangles.parent(*t) for t in zip(*faults.gaps))):
        if triangles.level(*t[2:], front.n):  # the largest: its parent would hold covered ground
            parent = tuple(c(*up) for c in (triangles.apex, triangles.left_end, triangles.right_end))
            assert (count[bisection.covers(parent, where)] > 0).any()
    for later, earlier in faults.overlaps:
        inner, outer = (bisection.covers(mesh[i], where) for i in (later, earlier))
        assert later != earlier and (inner <= outer).all()
    alone = [t for i, t in enumerate(mesh) if i not in set(faults.overlaps[:, 0].tolist())]
    assert np.array_equal(bisection.coverage(alone, front.n), count > 0)


# ---- splits and merges -------------------------------------------------------------------------------------------


def force_split(mesh: set, t) -> None:
    """The lecture's ``force_split``: the triangle across the long side, if it is larger, goes first."""
    apex, left, right = t
    middle = bisection.midpoint(left, right)
    beyond = [Fraction(101 * m - a, 100) for m, a in zip(middle, apex)]  # a little across the long side

    def holds(u) -> bool:
        return all(bisection.cross(a, b, beyond) > 0 for a, b in zip(u, (*u[1:], u[0])))

    across = next((u for u in mesh if holds(u)), None)
    while across and set(across[1:]) != {left, right}:
        force_split(mesh, across)
        across = next(u for u in mesh if holds(u))
    for u in (t, across):
        if u:
            mesh.remove(u)
            mesh.update(bisection.halves(u))


@settings(max_examples=50)
@given(SIZES, st.data())
def test_split_forces_as_the_lecture_does(n: int, data) -> None:
    front = front_of(data.draw(closed_sets(n, 4)))
    at = list(zip(*(v.tolist() for v in fronts.splittable(front))))
    mesh = set(meshed(front))
    tops = {bisection.midpoint(*t[1:])[::-1]: t for t in mesh if bisection.area(t) > Fraction(1, 2)}
    assert set(at) == set(tops)
    if at:
        row, col = data.draw(st.sampled_from(at))
        force_split(mesh, tops[row, col])
        finer = fronts.split(front, row, col)
        assert set(meshed(finer)) == mesh
        assert is_valid(finer)


@settings(max_examples=50)
@given(SIZES, st.data())
def test_split_is_the_coarsest_refinement(n: int, data) -> None:
    """Any diamonds, also several at once, also such that are split: the result has their closure and nothing else."""
    active = data.draw(closed_sets(n))
    more = np.argwhere(data.draw(closed_sets(n, 3)))
    more = more[diamonds.is_diamond(more[:, 0], more[:, 1], n)]
    if len(more):
        both = active.copy()
        both[tuple(more.T)] = True
        assert fronts.split(front_of(active), *more.T) == front_of(diamonds.closure(both))


@pytest.mark.stress
@settings(max_examples=50)
@given(SIZES, st.data())
def test_merge_only_when_legal(n: int, data) -> None:
    """A vertex can go exactly if what is left is closed, and a merge undoes a split."""
    active = data.draw(closed_sets(n))
    front = front_of(active)
    legal = set(zip(*(v.tolist() for v in fronts.mergeable(front))))
    row, col = np.indices(active.shape)
    for at in np.argwhere(diamonds.is_diamond(row, col, n)).tolist():
        less = active.copy()
        less[tuple(at)] = False
        if active[tuple(at)] and diamonds.is_closed(less):
            assert tuple(at) in legal
            assert fronts.merge(front, *at) == front_of(less)
            assert fronts.split(fronts.merge(front, *at), *at) == front
        else:
            assert tuple(at) not in legal
            if data.draw(st.booleans()):
                with pytest.raises(UsageError, match=f"row {at[0]}, column {at[1]} cannot be merged"):
                    fronts.merge(front, *at)
    if legal:
        less = active.copy()
        less[tuple(zip(*legal))] = False
        assert fronts.merge(front, *zip(*legal)) == front_of(less)  # all at once


@settings(max_examples=40)
@given(SIZES, st.data())
def test_any_valid_front_leads_to_any_other(n: int, data) -> None:
    """The theorem: by splits and merges of one diamond each, none of them forced, over valid fronts only."""
    front, goal = (front_of(data.draw(closed_sets(n, 5))) for _ in range(2))
    for kind, row, col in fronts.steps(front, goal):
        vertices = len(front.vertices()[0])
        front = (fronts.split if kind == "split" else fronts.merge)(front, row, col)
        assert len(front.vertices()[0]) - vertices == (1 if kind == "split" else -1)
        assert fronts.is_valid(front)
    assert is_valid(front) and front == goal


def test_steps_stay_in_one_square() -> None:
    with pytest.raises(UsageError, match="cannot be transformed"):
        fronts.steps(fronts.coarsest(2), fronts.coarsest(3))


def test_a_grid_of_65_samples_is_quick() -> None:
    """A thousand steps there and back over fronts of thousands of triangles, and the finest front of 4225 vertices."""
    rng = np.random.default_rng(3)
    begun = time.perf_counter()
    start, goal = (front_of(diamonds.closure(rng.random((65, 65)) < 0.1)) for _ in range(2))
    path = fronts.steps(start, goal)
    assert len(path) > 500
    for kind, row, col in path:
        start = (fronts.split if kind == "split" else fronts.merge)(start, row, col)
    assert start == goal and fronts.is_valid(goal)
    assert time.perf_counter() - begun < 60  # about 2 s; a guard against cost by squares, not a benchmark


@pytest.mark.parametrize("n", [12, 30])
def test_large_squares(n: int) -> None:
    """One sample's worth of detail in a square of a thousand million: forced splits, validity and the way back."""
    row, col = (1 << n) // 3 | 1, (1 << n) // 5 & ~1  # an edge of octave 0
    front = fronts.split(fronts.coarsest(n), row, col)
    assert front.levels().max() == 2 * n and fronts.is_valid(front)
    rows, cols = diamonds.ancestors(row, col, n)
    N = 1 << n
    expected = {*zip(rows.tolist(), cols.tolist()), (0, 0), (0, N), (N, 0), (N, N)}
    assert set(zip(*(v.tolist() for v in front.vertices()))) == expected
    assert sum(Fraction(bisection.area(t)) for t in meshed(front)) == 4**n
    for r, c in zip(rows[::-1].tolist(), cols[::-1].tolist()):
        front = fronts.merge(front, r, c)
    assert front == fronts.coarsest(n)
