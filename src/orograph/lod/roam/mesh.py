"""The triangle bintree of ROAM with explicit neighbours, in flat arrays: nodes, their links, splits and merges.

Duchaineau et al. 1997, *ROAMing Terrain*, sec. 4. A triangle (v0, v1, apex v2) with hypotenuse v0–v1 has the children
(v2, v0, m) and (v1, v2, m), m the middle of the hypotenuse, so that all triangles turn alike. Its neighbours are *base*
(across the hypotenuse), *left* (across v2–v0, the first child's hypotenuse) and *right* (across v1–v2). Two triangles
of one level that share their hypotenuse are a *diamond*; it splits as a whole. If the base neighbour is coarser it is
split first (*forced split*). A diamond all of whose four children are leaves is *mergeable*.

The whole tree above the leaves is kept: a node holds its corners' heights and its diamond's values, copied from the
field's pages when it was made, so that no page has to stay. Nodes come in pairs of siblings (2i, 2i + 1); freed pairs
are chained through ``child``. Rows and columns are of the padded square, heights metres.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.lod.field import Pages
from orograph.lod.roam.terms import Terms

FREE, LEAF, INNER = 0, 1, 2

LOADED, OUT, EXCEEDS, PENDING, MERGEABLE, EMPTY, PINNED, LOOSELY = 1, 2, 4, 8, 16, 32, 64, 128
"""Flags of a node: its diamond's values are known; outside the frustum; over the tolerance; waits for a page; both it
and its base neighbour have two leaves as children; no surface under it; some term demands that it be split; it is in
the list of those that look for a strip."""

NODE = np.dtype(
    [
        # corners (two ends of the hypotenuse, apex), and their heights (NaN: missing)
        ("r0", "i4"), ("c0", "i4"), ("r1", "i4"), ("c1", "i4"), ("r2", "i4"), ("c2", "i4"),
        ("z0", "f4"), ("z1", "f4"), ("z2", "f4"),
        # the diamond: height of its vertex (filled where missing), error, radius, color error (−1 − c: missing)
        ("height", "f4"), ("error", "f4"), ("radius", "f4"), ("color", "f4"),
        # all ground under the triangle, and all its descendants, lie between these heights
        ("low", "f4"), ("high", "f4"),
        ("parent", "i4"), ("child", "i4"), ("base", "i4"), ("left", "i4"), ("right", "i4"),
        # the split or the merge queue: the list of a bucket (−1: in none)
        ("priority", "f4"), ("bucket", "i4"), ("before", "i4"), ("after", "i4"),
        # the list of those whose priority has to be computed again at the same time; the frame in which it was computed
        ("due", "f8"), ("due_list", "i4"), ("due_before", "i4"), ("due_after", "i4"), ("frame", "i4"),
        # frustum labels: the planes it is wholly inside of, until when
        ("label_until", "f8"), ("inside", "u1"), ("label_class", "u1"),
        ("level", "u1"), ("state", "u1"), ("flags", "u1"), ("reach", "u1"),
        # places in the output
        ("slot", "i4"), ("strip", "i4"),
    ],
    align=True,
)  # fmt: skip

# What ``State.counts`` counts.
TOP, FREED, LEAVES, DRAWN, WAITING, STAGE, RENEW, QUEUED_SPLITS, QUEUED_MERGES = range(9)
SPLITS, MERGES, COMPUTED, SHOWN, LABELS = range(9, 14)
LOOSE, DIRTY, BLOCKS, UNUSED, RELABELLED, FRAME, SWEPT = range(14, 21)
COUNTS = 24

# What ``State.options`` holds.
TOLERANCE, LOW, HIGH, CULL, EVERY, BOUND, METRIC, N, RATE, LEAST, MOST, NEARNESS = range(12)
"""Pixels that have priority 1; the thresholds, pixels, below and above which nothing is computed again; whether what is
out of view is left out; whether everything is computed in every frame; whether errors are bounds; the metric's number;
the exponent of the square; how many priority units a color error of γ is worth; between which pixels all priorities are
known (``LOW`` and ``HIGH``, but for a while after those have changed); the ratio from which on spheres are near (0: no
looking ahead, ``lookahead``)."""
OPTIONS = 16

FAMILY = 128
"""Room for a triangle and those below it that wait to be looked at, two on each level."""


class Scratch(NamedTuple):
    """What a priority is computed with.

    Attributes:
        stack: int32 (256,), nodes that wait. work: float64 (16,), what ``frustum`` leaves.
        family: NODE (FAMILY,), todo: float64 (DEPTH + 2, STACK): triangles that ``lookahead`` takes apart.
    """

    stack: NDArray[np.int32]
    work: NDArray[np.float64]
    family: NDArray[np.void]
    todo: NDArray[np.float64]


class State(NamedTuple):
    """All that kernels carry from frame to frame.

    Attributes:
        nodes: NODE (capacity,).
        heads: int32 (2, BUCKETS), first node of each bucket of the split queue and of the merge queue.
        occupied: uint64 (2, BUCKETS / 64), a bit for each bucket that is not empty.
        lists: int32 (CLASSES × SLOTS,), first node of each list of due nodes; clock: float64 (CLASSES,); passed: int64
            (CLASSES,), the slot up to which each class's lists were emptied (see ``queues``).
        waiting: int32 (capacity,), nodes that wait for pages.
        keys: int64, zs: float32, the output: three corners for each triangle, or the blocks of the strips; members:
            int32, the nodes drawn, in the order of the triangles or of each strip; strips: int32 (blocks, 4), dirty:
            int32 (blocks,), loose: int32 (capacity,): see ``strips``. Without strips there is one of them.
        scratch: ``Scratch``.
        counts: int64 (COUNTS,).
        cameras: CAMERA (1,), the camera (``error.screen``). options: float64 (OPTIONS,).
        pages: ``field.Pages``. terms: ``terms.Terms``.
    """

    nodes: NDArray[np.void]
    heads: NDArray[np.int32]
    occupied: NDArray[np.uint64]
    lists: NDArray[np.int32]
    clock: NDArray[np.float64]
    passed: NDArray[np.int64]
    waiting: NDArray[np.int32]
    keys: NDArray[np.int64]
    zs: NDArray[np.float32]
    members: NDArray[np.int32]
    strips: NDArray[np.int32]
    dirty: NDArray[np.int32]
    loose: NDArray[np.int32]
    scratch: Scratch
    counts: NDArray[np.int64]
    cameras: NDArray[np.void]
    options: NDArray[np.float64]
    pages: Pages
    terms: Terms


@intrinsic
def _touch(typing, nodes, i):
    """Ask the processor to bring node i's cache lines (LLVM's ``prefetch``, for writing, to be used soon)."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        size, number = NODE.itemsize, ir.IntType(32)
        byte = ir.IntType(8)
        begin = builder.gep(builder.bitcast(data, byte.as_pointer()), [builder.mul(args[1], args[1].type(size))])
        kind = ir.FunctionType(ir.VoidType(), [byte.as_pointer(), number, number, number])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")  # type: ignore[no-untyped-call]
        for line in (*range(0, size - 1, 64), size - 1):
            place = builder.gep(begin, [args[1].type(line)])
            builder.call(function, [place, number(1), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(nodes, types.int64), generate


touch: Any = _touch  # (Numba passes the first argument.)


@leaf
def new_pair(nodes, counts):
    """The first of two fresh nodes; there must be room (``room``)."""
    first = counts[FREED]
    if first >= 0:
        counts[FREED] = nodes[first].child
    else:
        first = counts[TOP]
        counts[TOP] = first + 2
    return first


@leaf
def free_pair(nodes, counts, first):
    """Give two nodes back."""
    nodes[first].state = FREE
    nodes[first + 1].state = FREE
    nodes[first].child = counts[FREED]
    counts[FREED] = first


@leaf
def begin_node(nodes, i, parent):
    """A leaf without neighbours, in no list, its diamond unknown; all it inherits from its parent."""
    node = nodes[i]
    node.parent = parent
    node.child = node.base = node.left = node.right = -1
    node.priority = 0.0
    node.bucket = node.due_list = node.slot = -1
    node.label_until = -1.0
    node.inside = 0
    node.state = LEAF
    node.flags &= LOOSELY
    if parent >= 0:
        above = nodes[parent]
        node.flags |= above.flags & EMPTY
        node.level = above.level + 1
        node.low, node.high = above.low, above.high


@leaf
def relink(nodes, i, old, new):
    """In leaf i the neighbour ``old`` is now ``new``."""
    if i >= 0:
        node = nodes[i]
        if node.base == old:
            node.base = new
        elif node.left == old:
            node.left = new
        elif node.right == old:
            node.right = new


@leaf
def begin_pair(nodes, first, i, z):
    """Let two nodes be the children of node i, without neighbours; z is their apex's height."""
    begin_node(nodes, first, i)
    begin_node(nodes, first + 1, i)
    node, a, b = nodes[i], nodes[first], nodes[first + 1]
    row, col = (node.r0 + node.r1) >> 1, (node.c0 + node.c1) >> 1
    a.r0, a.c0, a.z0 = node.r2, node.c2, node.z2
    a.r1, a.c1, a.z1 = node.r0, node.c0, node.z0
    a.r2, a.c2, a.z2 = row, col, z
    b.r0, b.c0, b.z0 = node.r1, node.c1, node.z1
    b.r1, b.c1, b.z1 = node.r2, node.c2, node.z2
    b.r2, b.c2, b.z2 = row, col, z


@leaf
def halve(nodes, counts, i, z):
    """Give leaf i its two children, linked to each other and to their outer neighbours; z is their apex's height."""
    first = new_pair(nodes, counts)
    second = first + 1
    begin_pair(nodes, first, i, z)
    node, a, b = nodes[i], nodes[first], nodes[second]
    a.base, a.left = node.left, second
    b.base, b.right = node.right, first
    relink(nodes, node.left, i, first)
    relink(nodes, node.right, i, second)
    node.child = first
    node.state = INNER
    counts[LEAVES] += 1


@leaf
def split_links(nodes, counts, i, z):
    """Split the diamond of leaf i, whose base neighbour is of its level or absent; z is the height of its vertex."""
    halve(nodes, counts, i, z)
    j = np.int64(nodes[i].base)
    if j >= 0:
        halve(nodes, counts, j, z)
        p, q = nodes[i].child, nodes[j].child
        # Halves of one half of the hypotenuse: (first of one, second of the other).
        nodes[p].right, nodes[q + 1].left = q + 1, p
        nodes[q].right, nodes[p + 1].left = p + 1, q


@leaf
def rejoin(nodes, counts, i):
    """Take the two children, leaves, from node i, which is a leaf again."""
    node = nodes[i]
    first = node.child
    node.left, node.right = nodes[first].base, nodes[first + 1].base
    relink(nodes, node.left, first, i)
    relink(nodes, node.right, first + 1, i)
    free_pair(nodes, counts, first)
    node.child = -1
    node.state = LEAF
    counts[LEAVES] -= 1


@leaf
def has_leaves(nodes, i):
    """Whether node i is split and both its children are leaves."""
    node = nodes[i]
    return node.state == INNER and nodes[node.child].state == LEAF and nodes[node.child + 1].state == LEAF


@leaf
def is_mergeable(nodes, i):
    """Whether the diamond of node i can be merged."""
    if not has_leaves(nodes, i):
        return False
    base = np.int64(nodes[i].base)
    return base < 0 or has_leaves(nodes, base)


@leaf
def coarser_base(nodes, i):
    """The base neighbour of leaf i if it has to be split before (its own base is another triangle), or −1."""
    base = np.int64(nodes[i].base)
    return base if base >= 0 and nodes[base].base != i else -1


def plant(n: int, corners: NDArray[np.float32], low: float, high: float, capacity: int) -> NDArray[np.void]:
    """Nodes with the two roots of a square of side 2^n, each other's base neighbours.

    Args:
        n: exponent of the side.
        corners: (2, 2) float32, heights of the square's corners, NaN where missing.
        low, high: heights between which all ground lies.
        capacity: how many nodes to make room for.
    """
    nodes = np.zeros(capacity, NODE)
    size = 1 << n
    nw, ne, sw, se = (0, 0), (0, size), (size, 0), (size, size)
    z = corners
    for i, ((p, q, r), heights) in enumerate(
        [((nw, se, ne), (z[0, 0], z[1, 1], z[0, 1])), ((se, nw, sw), (z[1, 1], z[0, 0], z[1, 0]))]
    ):
        node = nodes[i]
        (node["r0"], node["c0"]), (node["r1"], node["c1"]), (node["r2"], node["c2"]) = p, q, r
        node["z0"], node["z1"], node["z2"] = heights
        node["state"], node["base"], node["low"], node["high"] = LEAF, 1 - i, low, high
        for name in ("parent", "child", "left", "right", "bucket", "due_list", "slot", "strip"):
            node[name] = -1
        node["label_until"] = -1.0
    return nodes
