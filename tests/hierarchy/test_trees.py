"""Implicit trees against trees that are really built, breadth first."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orograph.hierarchy import trees
from orograph.hierarchy.bits import floor_log2, lowest_bit
from orograph.hierarchy.trees import BINARY, QUAD

LAYOUTS = list(product([0, 1, 2, 3, 7], [1, 2, 3], [BINARY, QUAD]))


def numbered(first: int, roots: int, bits: int, depth: int) -> list[tuple[int, int | None, int, int, int]]:
    """(node, parent, which child, level, tree) of every node: each level is numbered when the one before it is."""
    found = [(first + t, None, 0, 0, t) for t in range(roots)]
    row = found
    for at in range(1, depth):
        children = [(p, k, t) for p, _, _, _, t in row for k in range(1 << bits)]
        row = [(found[-1][0] + 1 + i, p, k, at, t) for i, (p, k, t) in enumerate(children)]
        found = found + row
    return found


@pytest.mark.parametrize(("first", "roots", "bits"), LAYOUTS)
def test_every_node_of_small_forests(first: int, roots: int, bits: int) -> None:
    m = trees.offset(first, roots, bits)
    nodes = numbered(first, roots, bits, depth=6)
    assert [node for node, *_ in nodes] == list(range(first, first + len(nodes)))  # none left out, none given twice
    starts: dict[int, int] = {}
    for node, parent, k, level, tree in nodes:
        starts.setdefault(level, node)
        if parent is not None:
            assert trees.child(parent, k, m, bits) == node
            assert trees.parent(node, m, bits) == parent
            assert trees.which_child(node, m, bits) == k
        assert trees.level(node, first, roots, bits) == level
        assert trees.tree(node, first, roots, bits) == tree
        assert trees.level_start(level, first, roots, bits) == starts[level]
    everything = np.array([node for node, *_ in nodes])
    assert trees.level(everything, first, roots, bits).tolist() == [level for _, _, _, level, _ in nodes]
    assert trees.tree(everything, first, roots, bits).tolist() == [tree for *_, tree in nodes]


def test_offsets_of_the_usual_layouts() -> None:
    """The table in the module, and the lecture's trees with the roots 2 and 3."""
    table = {(1, 1): (0, -2), (0, 1): (1, 1), (2, 2): (0, -4), (0, 2): (2, 2)}
    for (first, roots), offsets in table.items():
        assert (trees.offset(first, roots, BINARY), trees.offset(first, roots, QUAD)) == offsets
    assert [trees.child(p, k, 0, BINARY) for p in (2, 3) for k in (0, 1)] == [4, 5, 6, 7]
    assert [trees.child(p, k, -4, QUAD) for p in (2, 3) for k in range(4)] == list(range(4, 12))


ARITY = st.sampled_from([BINARY, QUAD])


@given(st.integers(0, 100), st.integers(1, 100), ARITY, st.integers(0, 2**52), st.integers(0, 3))
def test_large_nodes(first: int, roots: int, bits: int, beyond: int, k: int) -> None:
    m, p, k = trees.offset(first, roots, bits), first + beyond, k & ((1 << bits) - 1)
    c = trees.child(p, k, m, bits)
    assert trees.parent(c, m, bits) == p
    assert trees.which_child(c, m, bits) == k
    level = trees.level(p, first, roots, bits)
    assert trees.level_start(level, first, roots, bits) <= p < trees.level_start(level + 1, first, roots, bits)
    assert trees.level(c, first, roots, bits) == level + 1
    assert trees.tree(c, first, roots, bits) == trees.tree(p, first, roots, bits)
    wide = np.array([p, c], np.int64)
    assert trees.tree(wide, first, roots, bits).tolist() == [trees.tree(int(v), first, roots, bits) for v in wide]


@given(st.integers(1, 2**63 - 1))
def test_logarithm_and_lowest_bit(v: int) -> None:
    assert floor_log2(v) == v.bit_length() - 1 == floor_log2(np.array([v]))[0]
    assert v % lowest_bit(v) == 0 and (v // lowest_bit(v)) % 2 == 1
