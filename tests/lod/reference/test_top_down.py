"""Forced splits against fronts: the coarsest valid mesh without an inaccurate triangle, for any criterion."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph.hierarchy import diamonds, fronts
from orograph.lod.reference import children as hrt
from orograph.lod.reference import top_down


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4])
def test_any_criterion_gives_the_coarsest_valid_mesh(n):
    rng = np.random.default_rng(n)
    for share in (0.0, 0.02, 0.1, 0.5, 1.0):
        for _ in range(4):
            value = {}

            def inaccurate(t, value=value, share=share):
                key = int(t.x), int(t.y), t.L, t.omega
                return value.setdefault(key, rng.random() < share or hrt.level(t, n) < 2)

            found = plain.front_of(n, top_down.refine(n, inaccurate))
            expected = fronts.coarsest(n)
            while True:
                row, col = diamonds.of_triangle(*expected.arrays)
                bad = [
                    r >= 0 and inaccurate(hrt.Triangle(*t))
                    for r, t in zip(row, zip(*(v.tolist() for v in expected.arrays)))
                ]
                if not any(bad):
                    break
                expected = fronts.split(expected, row[bad], col[bad])
            assert found == expected and fronts.is_valid(found)


def test_a_chain_of_forced_splits_reaches_the_border_and_the_roots():
    """One small triangle on the border of 16 × 16 cells, in a corner: nothing else is as small; each is split once."""
    n, seen = 4, []

    class Splits(list):
        def append(self, t):
            seen.append(t)
            super().append(t)

    T = set(hrt.roots(n))
    while not (small := [t for t in T if t.diamond == (0, 1) and not hrt.is_finest(t)]):
        t = next(t for t in T if not hrt.is_finest(t) and (0, 1) in _inside(t))
        top_down.force_split(t, Splits(), T, n)
        assert fronts.is_valid(plain.front_of(n, T))
    assert top_down.long_side_neighbor(small[0], T, n) is None  # the border case
    before = len(T)
    cost = top_down.cost(small[0], T, n)
    top_down.force_split(small[0], Splits(), T, n)
    assert len(T) == before + cost == before + 1
    assert fronts.is_valid(plain.front_of(n, T)) and len(seen) == len(set(seen))


def _inside(t):
    (ax, ay), (bx, by), (cx, cy) = hrt.corners(t)
    xs, ys = (ax, bx, cx), (ay, by, cy)
    return {(x, y) for x in range(min(xs), max(xs) + 1) for y in range(min(ys), max(ys) + 1) if _holds(t, x, y)}


def _holds(t, x, y):
    a, b, c = (np.array(v, float) for v in hrt.corners(t))
    u, v = np.linalg.solve(np.stack([b - a, c - a], 1), np.array([x, y]) - a)
    return u > -1e-9 and v > -1e-9 and u + v < 1 + 1e-9


@pytest.mark.parametrize("n", [1, 3])
def test_budgets_are_kept_by_valid_meshes_of_the_highest_priorities(n):
    rng = np.random.default_rng(n)
    value: dict = {}

    def priority(t):
        return value.setdefault((t.diamond, t.L, t.omega), float(rng.random()))

    last = 0
    for budget in range(2, 2 * 4**n + 1):
        T = top_down.refine_by_priority(n, priority, budget)
        assert last <= len(T) <= budget and fronts.is_valid(plain.front_of(n, T))
        if len(T) < 2 * 4**n:
            worst = max((t for t in T if not hrt.is_finest(t)), key=priority)
            assert len(T) + top_down.cost(worst, T, n) > budget
        last = len(T)
    assert last == 2 * 4**n
