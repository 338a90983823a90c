"""One definition, three forms: every formula on Python's integers, on arrays, and compiled into a kernel."""

from __future__ import annotations

import subprocess
import sys

import numba
import numpy as np
import pytest

from orograph.hierarchy import bits, diamonds, trees, triangles


def of_triangles(x, y, L, omega, n, k):
    """All that ``triangles`` says of a triangle, in one row (for k a child or a root)."""
    i = triangles.node(x, y, L, omega, n)
    return (
        *(triangles.apex(x, y, L, omega) + triangles.left_end(x, y, L, omega) + triangles.right_end(x, y, L, omega)),
        *(triangles.towards(x, y, L, omega + k) + triangles.with_apex(x, y, L, omega) + triangles.root(k, n)),
        *(triangles.child(x, y, L, omega, k) + triangles.parent(x, y, L, omega) + triangles.or_none(x, y, L, omega, n)),
        *(triangles.sibling(x, y, L, omega, n) + triangles.left_neighbour(x, y, L, omega, n)),
        *(triangles.right_neighbour(x, y, L, omega, n) + triangles.from_node(i, n)),
        *(i, triangles.wave(omega), triangles.level(L, omega, n), triangles.is_finest(L, omega)),
        *(triangles.axis(x, y, L, omega & 1), triangles.which_child(x, y, L, omega)),
        *(triangles.inside(x, y, L, omega, n) * 1, triangles.exists(x, y, L, omega, n) * 1),
    )


def of_diamonds(row, col, n, k, x, y, L, omega):
    """All that ``diamonds`` says of a diamond (and of a triangle's)."""
    present = diamonds.is_diamond(row, col, n)
    return (
        *(diamonds.spacing(row, col), diamonds.octave(row, col), diamonds.kind(row, col), diamonds.level(row, col, n)),
        *(diamonds.top(row, col, k >> 1) + diamonds.apex(row, col, k >> 1) + diamonds.end(row, col, k >> 1)),
        *(diamonds.parent(row, col, k >> 1, n) + diamonds.child(row, col, k, n)),
        *(diamonds.of_triangle(x, y, L, omega) + diamonds.or_none(row, col, present)),
        present * 1,
    )


def of_trees(i, k, first, roots, b):
    """All that ``trees`` and ``bits`` say of a node."""
    m = trees.offset(first, roots, b)
    at = trees.level(i, first, roots, b)
    return (
        *(m, trees.child(i, k, m, b), trees.parent(i, m, b), trees.which_child(i, m, b), at),
        *(trees.level_start(at, first, roots, b), trees.tree(i, first, roots, b)),
        *(bits.floor_log2(i), bits.lowest_bit(i)),
    )


def triangle_arguments(n: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(n)
    level = rng.integers(0, 2 * n, 200)
    node = (2 << level) + (rng.random(200) * (2 << level)).astype(np.int64)
    x, y, L, omega = triangles.from_node(node, n)
    return x, y, L, omega, np.full(200, n), rng.integers(0, 2, 200)


def diamond_arguments(n: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(n)
    row, col = rng.integers(0, (1 << n) + 1, (2, 200)) & -(1 << rng.integers(0, n, 200))
    row[row == col] |= 1 << (n - 1)
    keep = diamonds.is_diamond(row, col, n)
    values = (row, col, np.full(200, n), rng.integers(0, 4, 200), *triangle_arguments(n)[:4])
    return tuple(v[keep] for v in values)


def tree_arguments() -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(1)
    first, roots, b = rng.integers(0, 9, 300), rng.integers(1, 9, 300), rng.integers(1, 3, 300)
    return first + 1 + rng.integers(0, 1 << rng.integers(1, 50, 300)), rng.integers(0, 2, 300), first, roots, b


# the formulas, the place of n among their arguments, and arguments
CASES = [
    (of_triangles, 4, [triangle_arguments(n) for n in (3, 30)]),
    (of_diamonds, 2, [diamond_arguments(n) for n in (3, 30)]),
    (of_trees, None, [tree_arguments()]),
]


@pytest.mark.parametrize(("everything", "n", "samples"), CASES)
def test_scalars_arrays_and_kernels_agree(everything, n, samples) -> None:
    from orograph.hierarchy import kernels

    assert kernels.triangles is triangles and kernels.diamonds is diamonds  # the same formulas, not copies of them
    compiled = numba.njit(everything)  # not cached: a cache would keep yesterday's formulas
    for columns in samples:
        given = [int(v[0]) if i == n else v for i, v in enumerate(columns)]  # loops are over n: it is one for all
        arrays = np.array([np.broadcast_to(v, len(columns[0])) for v in everything(*given)]).T
        assert arrays.dtype == np.int64
        for row, arguments in zip(arrays.tolist(), zip(*(v.tolist() for v in columns))):
            assert [int(v) for v in everything(*arguments)] == row
            assert [int(v) for v in compiled(*arguments)] == row


def test_every_formula_is_in_a_form_that_is_tested() -> None:
    tested = {name for f, *_ in CASES for name in f.__code__.co_names}
    for module in (bits, trees, triangles, diamonds):
        assert {f.__name__ for f in module.FORMULAS} <= tested


def test_importing_the_package_does_not_import_numba() -> None:
    code = "import sys, orograph.hierarchy; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
