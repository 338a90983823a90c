"""(l, L, ω) against triangles bisected by geometry: all of them in small squares, paths of them in large ones."""

from __future__ import annotations

from fractions import Fraction

import bisection
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.hierarchy import trees, triangles

SMALL = range(6)


def corners(t) -> bisection.Corners:
    """(apex, left, right) of one triangle by the formulas."""
    return tuple(tuple(map(int, c(*t))) for c in (triangles.apex, triangles.left_end, triangles.right_end))


def rows(arrays) -> list[tuple[int, ...]]:
    return list(zip(*(v.tolist() for v in arrays)))


def named(n: int) -> dict[bisection.Corners, tuple[int, ...]]:
    """Corners → (x, y, L, ω) of all triangles of all levels."""
    return {corners(t): t for level in range(2 * n + 1) for t in rows(triangles.of_level(n, level))}


@pytest.mark.parametrize("n", SMALL)
def test_every_level_is_the_bisection_in_order(n: int) -> None:
    for level, nodes in enumerate(bisection.hierarchy(n)):
        arrays = triangles.of_level(n, level)
        assert all(v.dtype == np.int64 for v in arrays)
        assert [corners(t) for t in rows(arrays)] == [node.corners for node in nodes]
        assert (triangles.level(arrays[2], arrays[3], n) == level).all()
        assert (triangles.is_finest(arrays[2], arrays[3]) == (level == 2 * n)).all()
        assert (arrays[3] % 2 == (level + 1) % 2).all()


@pytest.mark.parametrize("n", SMALL)
def test_every_level_tiles_the_square(n: int) -> None:
    """Areas sum to the square's, and each of four points per cell lies in exactly one triangle."""
    for level in range(2 * n + 1):
        found = [corners(t) for t in rows(triangles.of_level(n, level))]
        assert {bisection.area(t) for t in found} == {Fraction(4**n, 2 << level)}
        assert len(found) == 2 << level
        assert (bisection.coverage(found, n) == 1).all()


@pytest.mark.parametrize("n", SMALL)
def test_the_finest_level_is_the_surface(n: int) -> None:
    """Each cell is cut along the diagonal that joins its (even, even) to its (odd, odd) corner."""
    surface = set()
    for y in range(1 << n):
        for x in range(1 << n):
            square = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)]
            cut = [p for p in square if p[0] % 2 == p[1] % 2]
            surface |= {frozenset([*cut, p]) for p in square if p not in cut}
    finest = triangles.of_level(n, 2 * n)
    if n:  # with one cell, (odd, odd) and (even, even) name its two ends all the same
        assert {frozenset(corners(t)) for t in rows(finest)} == surface
    else:
        assert {frozenset(corners(t)) for t in rows(finest)} == {frozenset(t) for t in bisection.roots(0)} == surface


@pytest.mark.parametrize("n", SMALL)
def test_diamond_points_are_middles_of_hypotenuses(n: int) -> None:
    for level in range(2 * n + 1):
        for x, y, L, omega in rows(triangles.of_level(n, level)):
            apex, left, right = corners((x, y, L, omega))
            middle = Fraction(left[0] + right[0], 2), Fraction(left[1] + right[1], 2)
            assert (x, y) == tuple(v.__floor__() for v in middle)
            if level < 2 * n:
                assert (x, y) == middle
            # ω: the apex's direction in steps of 45° clockwise from west, y downwards
            dx, dy = apex[0] - middle[0], apex[1] - middle[1]
            compass = [(-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1)]
            assert compass[omega] == ((dx > 0) - (dx < 0), (dy > 0) - (dy < 0))
            leg = left[0] - apex[0], left[1] - apex[1]
            extent = max(map(abs, leg)) if omega % 2 else max(abs(dx), abs(dy))
            assert extent == L


@pytest.mark.parametrize("n", SMALL)
def test_every_parent_and_child(n: int) -> None:
    name = named(n)
    for level in bisection.hierarchy(n):
        for node in level:
            t = name[node.corners]
            for k, half in enumerate(node.halves):
                assert triangles.child(*t, k) == name[half.corners]
                assert triangles.parent(*name[half.corners]) == t
                assert triangles.which_child(*name[half.corners]) == k
                assert triangles.apex(*name[half.corners]) == t[:2]


@pytest.mark.parametrize("n", SMALL)
def test_every_neighbour(n: int) -> None:
    """Across each edge lies the one other triangle of the level with that edge, and L = 0 where there is none."""
    name = named(n)
    across = [triangles.sibling, triangles.left_neighbour, triangles.right_neighbour]
    for level in bisection.hierarchy(n):
        sharing: dict[frozenset, list[bisection.Node]] = {}
        for node in level:
            for edge in node.edges():
                sharing.setdefault(edge, []).append(node)
        for node in level:
            t = name[node.corners]
            for neighbour, edge in zip(across, node.edges()):
                others = [name[other.corners] for other in sharing[edge] if other is not node]
                found = neighbour(*t, n)
                assert [found] == others if others else found[2] == 0


@pytest.mark.parametrize("n", range(1, 6))
def test_neighbours_of_other_levels(n: int) -> None:
    """Across a leg, a child of the neighbour has it as hypotenuse; across a hypotenuse, the sibling's parent as leg."""
    for level in bisection.hierarchy(n):
        for node in level:
            t = name_of(node)
            hypotenuse, left_leg, right_leg = node.edges()
            left, right = triangles.left_neighbour(*t, n), triangles.right_neighbour(*t, n)
            if node.halves and left[2]:
                assert frozenset(corners(triangles.child(*left, 1))[1:]) == left_leg
            if node.halves and right[2]:
                assert frozenset(corners(triangles.child(*right, 0))[1:]) == right_leg
            sibling = triangles.sibling(*t, n)
            if node.parent and sibling[2]:
                apex, *ends = corners(triangles.parent(*sibling))
                assert hypotenuse in [frozenset((apex, end)) for end in ends]


def name_of(node: bisection.Node) -> tuple[int, ...]:
    """(x, y, L, ω) by geometry."""
    apex, left, right = node.corners
    dx, dy = left[0] + right[0] - 2 * apex[0], left[1] + right[1] - 2 * apex[1]
    compass = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]
    omega = compass.index(((dx > 0) - (dx < 0), (dy > 0) - (dy < 0)))
    L = max(abs(dx), abs(dy)) if omega % 2 else max(abs(dx), abs(dy)) // 2
    return (left[0] + right[0]) // 2, (left[1] + right[1]) // 2, L, omega


@pytest.mark.parametrize("n", range(4))
def test_exists_knows_exactly_the_triangles_of_the_square(n: int) -> None:
    N = 1 << n
    tried = np.meshgrid(*(np.arange(-2, N + 3),) * 2, np.arange(-2, 2 * N + 2), np.arange(-2, 10), indexing="ij")
    x, y, L, omega = (v.ravel() for v in tried)
    found = triangles.exists(x, y, L, omega, n)
    everything = {name_of(t) for level in bisection.hierarchy(n) for t in level}
    assert set(rows(v[found] for v in (x, y, L, omega))) == everything


@pytest.mark.parametrize("n", SMALL)
def test_numbers_in_the_trees(n: int) -> None:
    """Level j is 2^(j+1) …, in order; the roots are 2 and 3; parent and child are those of the implicit tree, m = 0."""
    for level in range(2 * n + 1):
        arrays = triangles.of_level(n, level)
        numbers = triangles.node(*arrays, n)
        assert numbers.tolist() == list(range(2 << level, 4 << level))
        if level < 2 * n:
            for k in (0, 1):
                assert (triangles.node(*triangles.child(*arrays, k), n) == trees.child(numbers, k, 0, 1)).all()


@st.composite
def deep(draw) -> tuple[int, int]:
    """n and the number of a triangle in a square of side up to 2^30."""
    n = draw(st.integers(0, 30))
    level = draw(st.integers(0, 2 * n))
    return n, draw(st.integers(2 << level, (4 << level) - 1))


@given(deep())
def test_deep_triangles_lie_where_bisection_leads(at: tuple[int, int]) -> None:
    n, number = at
    bits = [int(b) for b in f"{number:b}"[1:]]
    t = bisection.roots(n)[bits[0]]
    for bit in bits[1:]:
        t = bisection.halves(t)[bit]
    found = triangles.from_node(number, n)
    assert corners(found) == t
    assert triangles.node(*found, n) == number
    assert triangles.exists(*found, n)
    wide = tuple(v[0] for v in triangles.from_node(np.array([number]), n))
    assert wide == found
    assert triangles.node(*(np.array([v]) for v in found), n).tolist() == [number]


@given(deep())
def test_deep_neighbours_are_mutual_and_share_the_edge(at: tuple[int, int]) -> None:
    n, number = at
    t = triangles.from_node(number, n)
    apex, left, right = corners(t)
    N = 1 << n

    def border(a, b) -> bool:
        return any(a[i] == b[i] and a[i] in (0, N) for i in (0, 1))

    cases = [
        (triangles.sibling, triangles.sibling, left, right, 1, 2),
        (triangles.left_neighbour, triangles.right_neighbour, apex, left, 0, 2),
        (triangles.right_neighbour, triangles.left_neighbour, apex, right, 0, 1),
    ]
    for across, back, a, b, i, j in cases:
        other = across(*t, n)
        assert (other[2] == 0) == border(a, b)
        if other[2]:
            assert triangles.exists(*other, n) and triangles.level(*other[2:], n) == triangles.level(*t[2:], n)
            assert back(*other, n) == t
            shared = corners(other)
            assert {shared[i], shared[j]} == {a, b}
            assert set(shared) != {apex, left, right}


def test_unknown_levels() -> None:
    for level in (-1, 5):
        with pytest.raises(UsageError, match="levels 0 to 4"):
            triangles.of_level(2, level)


def test_the_children_printed_in_the_lecture_do_not_tile() -> None:
    """Whichever end of v is the apex; L′ as printed, l′ = l + v(L/2, ω+4) and l + v(L/2, ω+6), ω′ = ω+3 and ω+5."""

    def v(L, omega):
        return Fraction(triangles.wave(omega) * L, 2), Fraction(triangles.wave(omega - 2) * L, 2)

    def plus(p, w, sign=1):
        return p[0] + sign * w[0], p[1] + sign * w[1]

    for sign in (1, -1):
        for omega in range(8):
            middle, L = (Fraction(8), Fraction(8)), 8
            whole = {plus(middle, v(L, omega), sign), plus(middle, v(L, omega + 2)), plus(middle, v(L, omega - 2))}
            for turn, shift in ((3, 4), (5, 6)):
                smaller = L // 2 if omega % 2 else L
                point = plus(middle, v(Fraction(L, 2), omega + shift))
                around = v(smaller, omega + turn + 2)
                part = {plus(point, v(smaller, omega + turn), sign), plus(point, around), plus(point, around, -1)}
                assert len(part & whole) < 2  # a half would share two corners with the whole
