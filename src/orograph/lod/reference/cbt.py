"""A concurrent binary tree: a heap of bits and their sums that holds a bisection, and longest-edge bisection on it.

Dupuy 2020, *Concurrent Binary Trees (with application to longest edge bisection)*. A binary tree of depth at most D is
the bits of its leaves: one bit for each of the 2^D places of depth D, set where a leaf's leftmost descendant lies. Bits
are set and cleared one by one, in any order and by any number of threads. Their *sum reduction*, a full binary tree of
counts, tells how many leaves there are, and leads to the i-th one from the top in D steps, so that thread i has leaf i.

Nodes are heap numbers: 1 the root, 2k and 2k + 1 the children of k. Node 1 stands for the square, 2 and 3 for its two
right triangles (``orograph.hierarchy.triangles.node``), and D is 2n + 1. An update is as in the paper: one pass in
which every leaf that is not accurate is split together with whatever must be for the mesh to conform, a reduction, one
pass in which every diamond that is accurate is merged if its triangles are leaves, and a reduction again. Passes read
the sums, which do not change meanwhile, and write bits: it makes no difference which leaf comes first.

With its sums a tree takes about 2^(D − 1) bytes: for 16,385² samples (D = 29) 256 MiB, for 65,537² (D = 33) 4 GiB. So
``orograph.lod.cbt`` keeps triangles in a pool, whose places in use are the bits (Benyoub & Dupuy 2024).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from orograph.lod.reference.children import Triangle, Vertex, children, is_finest, roots


class Cbt:
    """A binary tree in a heap; ``depth``: D, ``sums``: by heap number, those of depth D are the bits."""

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.sums = [0] * (2 << depth)

    def bit(self, node: int) -> int:
        """The heap number of a node's leftmost descendant of depth D."""
        return node << (self.depth + 1 - node.bit_length())

    def split(self, node: int) -> None:
        """Make a leaf an inner node with two leaves; an inner node stays as it is."""
        if node.bit_length() <= self.depth:
            self.sums[self.bit(2 * node + 1)] = 1

    def merge(self, node: int) -> None:
        """Make a node whose children are leaves a leaf."""
        self.sums[self.bit(2 * node + 1)] = 0

    def reduce(self) -> None:
        """Add the bits up, depth by depth: within one, all at once."""
        for node in reversed(range(1, 1 << self.depth)):
            self.sums[node] = self.sums[2 * node] + self.sums[2 * node + 1]

    def leaf(self, i: int) -> int:
        """The i-th leaf, of ``sums[1]``."""
        node = 1
        while self.sums[node] > 1:
            left = self.sums[2 * node]
            node, i = (2 * node, i) if i < left else (2 * node + 1, i - left)
        return node

    def leaves(self) -> list[int]:
        return [self.leaf(i) for i in range(self.sums[1])]


class Neighbors(NamedTuple):
    """The nodes of the same depth across the left leg, the right leg and the hypotenuse (0: none), and the node."""

    left: int
    right: int
    base: int
    node: int


def neighbors(node: int) -> Neighbors:
    """What lies around a triangle, by the bits of its number from the top (the paper's algorithm 4)."""
    found = Neighbors(0, 0, 5 - (node >> (node.bit_length() - 2)), node >> (node.bit_length() - 2))
    for place in reversed(range(node.bit_length() - 2)):
        left, right, base, at = found
        if node >> place & 1:
            found = Neighbors(2 * base, 2 * at, 2 * right, 2 * at + 1)
        else:
            found = Neighbors(2 * at + 1, base and 2 * base + 1, left and 2 * left + 1, 2 * at)
    return found


def triangle(node: int, n: int) -> Triangle:
    """The triangle of a node of the square of 2^n cells a side."""
    found = roots(n)[node >> (node.bit_length() - 2) & 1]
    for place in reversed(range(node.bit_length() - 2)):
        found = children(found)[node >> place & 1]
    return found


def split(tree: Cbt, node: int) -> None:
    """Split a triangle, and what it takes for the mesh to conform: across its hypotenuse, up to the coarsest."""
    tree.split(node)
    across = neighbors(node).base
    while across > 1:
        tree.split(across)  # (it may not be there yet: its bit belongs to a place that is the parent's until …)
        across >>= 1
        if across > 1:
            tree.split(across)  # (… the parent is split, here.)
            across = neighbors(across).base


def merge(tree: Cbt, node: int) -> None:
    """Merge the diamond that two leaves' parent is a top of, if all its two or four triangles are leaves."""
    top = [k for k in (node, neighbors(node).base) if k]
    if all(tree.sums[child] == 1 for k in top for child in (2 * k, 2 * k + 1)):
        for k in top:
            tree.merge(k)


def update(tree: Cbt, n: int, inaccurate: Callable[[Vertex], bool]) -> None:
    """Split where a criterion of diamonds says so, and merge where it does not: the two passes of a frame."""

    def wants(node: int) -> bool:
        t = triangle(node, n)
        return not is_finest(t) and inaccurate(t.diamond)

    for node in tree.leaves():
        if wants(node):
            split(tree, node)
    tree.reduce()
    for node in tree.leaves():
        if node > 3 and not wants(node >> 1):
            merge(tree, node >> 1)
    tree.reduce()


def planted(n: int) -> Cbt:
    """The tree of the two triangles of a square."""
    tree = Cbt(2 * n + 1)
    tree.split(1)
    tree.sums[tree.bit(1)] = 1
    tree.reduce()
    return tree


def refine(n: int, inaccurate: Callable[[Vertex], bool], tree: Cbt | None = None) -> tuple[list[Triangle], int]:
    """The mesh that updates end at, and how many it took; ``tree``: of an earlier mesh, which is gone on from.

    From two triangles it is the coarsest conforming mesh in which nothing is inaccurate; from another mesh it is, too,
    if the criterion is monotonic, else a diamond may stay split because of what is inaccurate below it.
    """
    tree = planted(n) if tree is None else tree
    for count in range(1, 8 * n + 8):
        before = tree.sums[:]
        update(tree, n, inaccurate)
        if tree.sums == before:
            return [triangle(node, n) for node in tree.leaves()], count
    raise AssertionError("The tree does not settle.")
