"""Implicit complete binary and quad trees: nodes are numbers, and parent and child are arithmetic.

Nodes are numbered breadth first. Several trees share the numbers by taking turns level by level: first all roots, then
all nodes of level 1, tree by tree, and so on. With ``roots`` trees of 2^bits children per node (``bits`` is 1 for
binary trees, 2 for quad trees), whose roots are the numbers ``first`` … ``first + roots − 1``, level j begins at

    start(j) = first + roots · (2^(bits·j) − 1) / (2^bits − 1)

and start(j+1) = 2^bits · start(j) + m for every j with the one offset m = roots − (2^bits − 1)·first. Hence

    child(p, k) = 2^bits · p + k + m,    k = 0 … 2^bits − 1
    parent(c)   = ⌊(c − m) / 2^bits⌋

which is the lecture's *Implicit Binary and Quad Trees* with the offset worked out. The floor matters, and the offset is
one for all trees of a layout, not one for each tree:

====================================  =======  =====  ====
layout                                first    roots  m
====================================  =======  =====  ====
one binary tree, root 1                     1      1     0
one binary tree, root 0                     0      1     1
two binary trees, roots 2 and 3             2      2     0
two binary trees, roots 0 and 1             0      2     2
one quad tree, root 1                       1      1    −2
one quad tree, root 0                       0      1     1
two quad trees, roots 2 and 3               2      2    −4
====================================  =======  =====  ====

(4p + k without an offset, as printed, also numbers the nodes of a quad tree apart, but leaves holes: the root 1 has the
children 4 … 7, and 2, 3, 8 … 15 are no nodes.) Two binary trees with the roots 2 and 3 are the two subtrees of a tree
with the root 1; the two root triangles of a terrain are numbered so (``triangles.node``).

All functions are formulas as ``orograph.hierarchy.bits`` describes: for scalars, arrays and kernels. No units.
"""

from __future__ import annotations

from orograph.hierarchy.bits import Integers, floor_log2

BINARY = 1
QUAD = 2


def offset(first: Integers, roots: Integers, bits: Integers) -> Integers:
    """The offset m of a layout: ``roots`` trees of 2^bits children per node whose first root is ``first``."""
    return roots - ((1 << bits) - 1) * first


def child(p: Integers, k: Integers, m: Integers, bits: Integers) -> Integers:
    """Child k (0 … 2^bits − 1) of node p in a layout of offset m."""
    return (p << bits) + k + m


def parent(c: Integers, m: Integers, bits: Integers) -> Integers:
    """The parent of node c in a layout of offset m; meaningless for a root."""
    return (c - m) >> bits


def which_child(c: Integers, m: Integers, bits: Integers) -> Integers:
    """The k with c = child(parent(c), k)."""
    return (c - m) & ((1 << bits) - 1)


def level_start(level: Integers, first: Integers, roots: Integers, bits: Integers) -> Integers:
    """The smallest node of a level (roots: level 0); the level has ``roots << (bits * level)`` nodes."""
    return first + roots * (((1 << (bits * level)) - 1) // ((1 << bits) - 1))


def level(i: Integers, first: Integers, roots: Integers, bits: Integers) -> Integers:
    """The level of node i (roots: level 0): how often ``parent`` leads from it to a root."""
    return floor_log2((i - first) * ((1 << bits) - 1) // roots + 1) // bits


def tree(i: Integers, first: Integers, roots: Integers, bits: Integers) -> Integers:
    """Which tree node i belongs to, 0 … roots − 1: that of the root ``first + tree``."""
    at = level(i, first, roots, bits)
    return (i - level_start(at, first, roots, bits)) >> (bits * at)


FORMULAS = (offset, child, parent, which_child, level_start, level, tree)
"""What kernels may call (see ``orograph.hierarchy.kernels``)."""
