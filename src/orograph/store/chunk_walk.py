"""The triangles of a chunk in runs, as ``chunk_code`` encodes them: writing and reading.

The *walk* goes through the binary tree of right triangles in the order of the Sierpinski curve. A *node* is a triangle:
its apex, and the ends of its hypotenuse where the curve enters and leaves. The vertex b in the middle of the hypotenuse
splits (a, e, f) into (b, e, a) and (b, a, f); so the hypotenuses of nodes of even depth lie on one side of the curve,
those of odd depth on the other. Vertices on one side are met again in reverse order: a vertex is met twice, at the two
nodes whose hypotenuse it splits, so a stack for each side holds the vertices that will be met again (Bader & Zenger).
After the first meeting it is pushed once its node is done; at the second it is on top. One bit for each edge of a node
says whether it is *new*, that is, met again within the walk. If an edge is not new and the vertex is not on its stack,
it lies between two runs, and each has its own copy. (Vertices remain on a stack only where a triangle beyond the raster
is not split although its neighbour is; then the wanted one is below them.)

Vertices are numbered within a run, from 0, its three corners first.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined
from orograph.store.chunked import MISSING

ABOUT = 11
ROW, COL, SIDE, LAST_ROW, LAST_COL, LEVELS, HOLES, DROP, BASE, HIGH, MOVED = range(ABOUT)
"""Facts about a chunk: its first row and column, its side, the raster's last row and column, how often
its triangles may be halved, whether heights may be missing; bits of the skirt's depths, the lowest height, bits of
heights above it and of targets' differences."""

APEX, ENTRY, EXIT, NEW, NEW_FIRST, NEW_SECOND, DEEP = range(7)
"""Fields of a node: its corners; which edges are new: the hypotenuse, the leg at the entry and that at the exit; its
depth."""


@inlined
def begin(node, a, e, f, depth):
    """Begin a walk at a node none of whose edges is new."""
    node[APEX], node[ENTRY], node[EXIT], node[DEEP] = a, e, f, depth
    node[NEW] = node[NEW_FIRST] = node[NEW_SECOND] = 0


@inlined
def met(node, waiting, counts, places, names, first, row, col):
    """The vertex on the node's hypotenuse, if the run has it, or −1.

    Args:
        places, names, first: vertex v of the run is at ``places[names[v] + first]``. row, col: the hypotenuse's middle.
    """
    side = node[DEEP] & 1
    if not node[NEW]:
        for k in range(counts[side] - 1, -1, -1):
            v = waiting[side, k]
            at = names[v] + first
            if places[at, 0] == row and places[at, 1] == col:
                counts[side] = k
                return v
    return np.int64(-1)


@inlined
def halve(node, b, over, stack, top):
    """Go to the first half of a node, or skip it and go to the second.

    Returns: the top of the stack: of the halves that follow (b, a, f, whether its hypotenuse and its second leg are
    new, depth), and of vertices (b, b, …) whose node is then complete.
    """
    a, e, f, new, first, second = node[0], node[1], node[2], node[3], node[4], node[5]
    node[APEX] = b
    node[DEEP] += 1
    if over:
        if new:
            stack[top] = pending(b, b, 0, 0, 0, node[DEEP])
            top += 1
        node[ENTRY], node[EXIT] = a, f
        node[NEW], node[NEW_FIRST], node[NEW_SECOND] = second, 0, new
        return top
    stack[top] = pending(b, a, f, second, new, node[DEEP])
    node[ENTRY], node[EXIT] = e, a
    node[NEW], node[NEW_FIRST], node[NEW_SECOND] = first, new, 1
    return top + 1


@inlined
def pending(b, a, f, new, second, depth):
    return b | a << 8 | f << 16 | new << 24 | second << 25 | depth << 26


@inlined
def onward(node, stack, top, waiting, counts):
    """Go from a leaf to the next node.

    Returns: the top of the stack, −1 if there is no next node.
    """
    while top > 0:
        entry = stack[top - 1]
        b, a, depth, new = entry & 255, entry >> 8 & 255, entry >> 26, entry >> 25 & 1
        if a != b:
            if new:
                stack[top - 1] = pending(b, b, 0, 0, 0, depth)
            else:
                top -= 1
            node[APEX], node[ENTRY], node[EXIT], node[DEEP] = b, a, entry >> 16 & 255, depth
            node[NEW], node[NEW_FIRST], node[NEW_SECOND] = entry >> 24 & 1, 0, new
            return top
        side = (depth - 1) & 1
        waiting[side, counts[side]] = b
        counts[side] += 1
        top -= 1
    return -1


@inlined
def drawn(places, heights, a, e, f, about):
    """Whether a triangle has three heights and, if vertices beyond the raster lie on its border, an area."""
    if heights[a] == MISSING or heights[e] == MISSING or heights[f] == MISSING:
        return False
    row, col = min(places[a, 0], about[LAST_ROW]), min(places[a, 1], about[LAST_COL])
    u, v = min(places[e, 0], about[LAST_ROW]) - row, min(places[e, 1], about[LAST_COL]) - col
    x, y = min(places[f, 0], about[LAST_ROW]) - row, min(places[f, 1], about[LAST_COL]) - col
    return u * y != v * x


@inlined
def beside(places, v, about):
    """The chunk's sides on which a vertex lies, as bits."""
    row, col = places[v, 0] - about[ROW], places[v, 1] - about[COL]
    side = about[SIDE]
    return (row == 0) | (col == 0) << 1 | (row == side) << 2 | (col == side) << 3


@inlined
def hangs(places, low, p, q, about):
    """Whether an edge has a skirt."""
    return low[p] != MISSING and low[q] != MISSING and (beside(places, p, about) & beside(places, q, about)) != 0


@inlined
def parameter(rices, depth, shift):
    """The Rice parameter of a run at a depth."""
    return max(np.int64(rices[depth]) + shift, 0)


# ---- heights --------------------------------------------------------------------------------------------------------


@inlined
def guess(a, b):
    """The predicted height of a vertex between two others, in steps."""
    if a == MISSING and b == MISSING:
        return 0
    if a == MISSING:
        return b
    return a if b == MISSING else (a + b) >> 1


@inlined
def halfway(places, targets, e, f, own, about):
    """``chunked_kernels.middle`` of two vertices in integers."""
    lr, lc, rr, rc = places[e, 0], places[e, 1], places[f, 0], places[f, 1]
    left, right = np.int64(targets[e]), np.int64(targets[f])
    if left == MISSING or right == MISSING:
        return own
    if max(lr, rr) <= about[LAST_ROW] and max(lc, rc) <= about[LAST_COL]:
        return (left + right) >> 1
    if lr == rr:
        return part(lc, rc, left, right, own, about[LAST_COL])
    if lc == rc:
        return part(lr, rr, left, right, own, about[LAST_ROW])
    return own


@inlined
def part(a, b, left, right, own, last):
    """How high the line between two ends is above the raster between them.

    An end beyond the raster counts as its last sample. Numbers stay within 32 bits.
    """
    low, high = min(a, b), max(a, b)
    under, over = (left, right) if a < b else (right, left)
    whole, done = min(high, last) - min(low, last), min((a + b) >> 1, last) - min(low, last)
    if whole == 0:
        return own
    while whole > 1 << 15:
        whole, done = whole >> 1, done >> 1
    rise = over - under
    sign = -1 if rise < 0 else 1
    size = sign * rise
    return under + sign * (size // whole * done + size % whole * done // whole)
