"""The lecture's index arithmetic against ``orograph.hierarchy``, which is proved by geometry; and its misprints."""

from __future__ import annotations

import numpy as np
import pytest

from orograph.hierarchy import diamonds, triangles
from orograph.lod.reference import children as hrt
from orograph.lod.reference.children import Triangle


def stored(t: Triangle) -> tuple[int, int, int, int]:
    """(x, y, L, ω) as ``hierarchy.triangles`` has it: the l of a finest triangle is rounded down."""
    return int(t.x), int(t.y), t.L, t.omega


def or_none(t: tuple) -> tuple | None:
    return tuple(int(v) for v in t) if t[2] else None


@pytest.mark.parametrize("n", range(5))
def test_every_triangle_of_small_squares(n):
    front = list(hrt.roots(n))
    for level in range(2 * n + 1):
        assert [stored(t) for t in front] == list(zip(*(v.tolist() for v in triangles.of_level(n, level))))
        for t in front:
            x, y, L, omega = stored(t)
            assert hrt.level(t, n) == level and hrt.is_finest(t) == (level == 2 * n)
            expected = (f(x, y, L, omega) for f in (triangles.apex, triangles.left_end, triangles.right_end))
            assert hrt.corners(t) == tuple(expected)
            sibling = hrt.diamond_top_sibling(t, n)
            assert (sibling and stored(sibling)) == or_none(triangles.sibling(x, y, L, omega, n))
            if level:
                assert stored(hrt.parent(t, n)) == triangles.parent(x, y, L, omega)
            if level < 2 * n:
                assert [stored(half) for half in hrt.children(t)] == [
                    triangles.child(x, y, L, omega, k) for k in (0, 1)
                ]
        front = [half for t in front for half in hrt.children(t)] if level < 2 * n else front


@pytest.mark.parametrize("n", range(5))
def test_every_diamond_of_small_squares(n):
    found = list(hrt.diamonds(n))
    assert len(found) == len(set(found)) == ((2**n + 1) ** 2 - 4 if n else 0)
    levels = [hrt.level(hrt.top(i, n)[0], n) for i in found]
    assert levels == sorted(levels)
    for x, y in found:
        parents = {diamonds.parent(y, x, k, n) for k in (0, 1)} - {(-1, -1)}
        children = {diamonds.child(y, x, k, n) for k in range(4)} - {(-1, -1)}
        assert {(r, c) for c, r in hrt.parents((x, y), n)} == parents
        assert {(r, c) for c, r in hrt.diamond_children((x, y), n)} == children
        tops = [diamonds.top(y, x, k) for k in (0, 1)]
        assert {stored(t) for t in hrt.top((x, y), n)} == {t for t in tops if triangles.inside(*t, n)}
        assert all(hrt.apex(t) == (x, y) for t in hrt.bottom((x, y), n))
    for corner in ((0, 0), (0, 2**n), (2**n, 0), (2**n, 2**n)):
        assert hrt.top(corner, n) == ()


def test_children_as_printed_are_no_halves():
    """l + v(L/2, ω + 4) and l + v(L/2, ω + 6): none has the corners that halving gives, whatever ω."""
    for omega in range(8):
        t = Triangle(64, 64, 16, omega)
        apex, left, right = hrt.corners(t)
        L = 16 if omega % 2 == 0 else 8
        for half, printed, end in zip(hrt.children(t), (omega + 4, omega + 6), (left, right)):
            assert set(hrt.corners(half)) == {apex, end, t.diamond}
            step = np.array(hrt.v(8, printed))
            wrong = Triangle(*(np.array([64, 64]) + step).tolist(), L, half.omega)
            assert set(hrt.corners(wrong)) != set(hrt.corners(half))
    wrong = Triangle(4 + hrt.v(4, 7)[0], 4 + hrt.v(4, 7)[1], 4, 6)  # the printed left child of the root of 8 × 8 cells
    assert (wrong.x, wrong.y) == (6, 2) and (10, 2) in hrt.corners(wrong)


def test_the_sibling_as_printed_is_missing_where_there_is_one():
    """Undefined wherever l has a coordinate 0 or N, says the slide; a finest triangle's stored l may well have one."""
    t = Triangle(0.5, 0.5, 1, 3)
    assert stored(t)[:2] == (0, 0) and hrt.diamond_top_sibling(t, 3) == Triangle(0.5, 0.5, 1, 7)
    border = Triangle(0, 4, 4, 4)  # even, and its hypotenuse lies on the western border
    assert hrt.diamond_top_sibling(border, 3) is None
