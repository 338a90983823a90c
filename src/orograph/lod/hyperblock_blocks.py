"""The blocks of a HyperBlock-QuadTIN: parts of a QuadTIN's hierarchy, and their triangulations by error level.

A block is a square of the quadtree that a QuadTIN's hierarchy is: two triangles of an even depth with one base, and all
that lies below them. Error level 0 splits nothing; level k splits the vertices whose error exceeds ε(k − 1). The *rank*
of a vertex is the first level that splits it.

A vertex on a block's border belongs to two blocks, and what it depends on may lie at another border. So a vertex is
split if its rank is within the level of **any block that has a part of its diamond, or of a diamond that depends on
it**: the *blocks of* a vertex. Those of a parent hold those of its children, and its rank is no larger, so what is
split is closed, and both blocks at a border agree. They are in the 3 × 3 squares around the vertex's own; squares have
one of 16 colours, by their row and column modulo 4, so that 16 bits name them. Sample coordinates, metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.error.screen import larger_than_pixel
from orograph.lod.block_boxes import nearest
from orograph.lod.quadtin_pass import finest_bound, strip_of
from orograph.lod.quadtin_tree import Hierarchy
from orograph.store.quadtin_build import LIVE

MOST = 10
"""There are at most 2 to this power blocks along a side."""

OWN = 4
"""The place of a block among the 3 × 3 around it."""

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int32]
Floats = NDArray[np.float64]


class Blocks(NamedTuple):
    """The blocks of a hierarchy, and what its vertices have to do with them.

    Attributes:
        roots: (b, 2) int32, the triangles that a block is. near: (b, 9) int32, the blocks around it, −1: none.
        color: (b,) uint8. boxes: (b, 6) float64: west, east, north, south, and the lowest and highest ground.
        off: (b,) float64, metres: how far those of its triangles are off that are not split any further.
        steps: (b, 9, levels) uint8: to each level of a block around it the coarsest one that asks the same of it.
        rest: (r,) int32, triangles on ground that lie in no block: their squares are not split that far.
        rank: (v,) uint8. blocks: (v,) uint16, a bit for each colour.
        sizes: (b,) int32, triangles at the finest level.
        reach: (b, levels) float64, metres: the largest radius of the block's vertices that a level leaves out though
            their colors are off by more than γ; 0 where there are none.
    """

    roots: Integers
    near: Integers
    color: Bytes
    boxes: Floats
    off: Floats
    steps: Bytes
    rest: Integers
    rank: Bytes
    blocks: NDArray[np.uint16]
    sizes: Integers
    reach: Floats


class Triangulation(NamedTuple):
    """One of a block.

    Attributes:
        leaves: (m,) int32, triangles of the hierarchy, in the order of the curve. finest: those of them that are not
            split any further. strip: int32, vertices of the hierarchy; strips make one when they are put in a row.
    """

    leaves: Integers
    finest: Integers
    strip: Integers

    @property
    def nbytes(self) -> int:
        """Of its arrays."""
        return self.leaves.nbytes + self.finest.nbytes + self.strip.nbytes


def ranks_of(error: Floats, thresholds: Floats) -> Bytes:
    """The first level (v,) at which vertices are split; one more than there are where that is never.

    Args:
        thresholds: ε, metres, falling.
    """
    return np.asarray(1 + len(thresholds) - np.searchsorted(thresholds[::-1], error, side="left"), np.uint8)


def depth_for(vertices: int, cells: int) -> int:
    """The depth of blocks that have some ``cells`` vertices along a side."""
    return 2 * min(max(round(float(np.log2(max(vertices, 1) ** 0.5 / cells))), 0), MOST)


def blocks_of(tree: Hierarchy, depth: int, thresholds: Floats, colored: NDArray[np.bool_]) -> Blocks:
    """The blocks that the triangles of an even depth are.

    Args:
        thresholds: ε of the levels from 1 on, metres, falling.
        colored: (v,), whether a vertex's colors are off by more than γ. What counts then is how large it is seen, so
            it is split as if its heights were off by its radius.
    """
    fronts = _by_depth(tree.child)
    at, ids = _places(tree, fronts[: depth + 1])
    owner = np.full(len(tree.child), -1, np.int32)
    owner[fronts[depth] if depth < len(fronts) else []] = ids
    for front in fronts[depth:-1]:
        child = tree.child[front]
        for step in (0, 1):
            owner[child[child >= 0] + step] = owner[front[child >= 0]]
    count, side = len(at), 1 << depth // 2
    grid = np.full((side + 2, side + 2), -1, np.int32)
    row, col = at.T
    grid[row + 1, col + 1] = np.arange(count)
    near = np.stack([grid[row + 1 + i, col + 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)], -1).astype(np.int32)
    color = ((row & 3) << 2 | (col & 3)).astype(np.uint8)
    roots = np.full((count, 2), -1, np.int32)
    first = fronts[depth] if depth < len(fronts) else np.zeros(0, np.int32)
    first = first[ids >= 0]
    order = np.argsort(owner[first], kind="stable")
    roots[:] = first[order].reshape(count, 2)

    split = np.flatnonzero((owner >= 0) & (tree.node >= 0))
    of = owner[split]
    reached = _reached(tree, fronts[depth:], owner, color)
    rank = ranks_of(np.maximum(tree.error, np.where(colored, tree.radius, 0.0)), thresholds)
    present = np.zeros((count, 9, len(thresholds) + 2), np.uint8)
    v = tree.node[split]
    for place in range(9):
        other = near[of, place]
        there = (other >= 0) & (reached[v] >> color[other] & 1 == 1)
        present[of[there], place, rank[v[there]]] = rank[v[there]]
    steps = np.maximum.accumulate(present, axis=2)[:, :, :-1]
    left_out = np.zeros((count, len(thresholds) + 2))  # by the first level that has them, then by those that have not
    np.maximum.at(left_out, (of, rank[v]), np.where(colored[v], tree.radius[v], 0.0))
    reach = np.maximum.accumulate(left_out[:, ::-1], axis=1)[:, ::-1][:, 1:]

    mine = np.flatnonzero(owner >= 0)
    ends = tree.child < 0
    leaf = mine[ends[mine] & (tree.state[mine] == LIVE)]
    off = np.zeros(count)
    np.maximum.at(off, owner[leaf], tree.off[leaf])
    room = np.bincount(owner[mine[ends[mine]]], minlength=count).astype(np.int32)
    rest = np.flatnonzero((owner < 0) & ends & (tree.state == LIVE)).astype(np.int32)
    boxes = _boxes(tree, owner, mine, count)
    return Blocks(roots, near, color, boxes, off, np.ascontiguousarray(steps), rest, rank, reached, room,
                  np.ascontiguousarray(reach))  # fmt: skip


def _by_depth(child: Integers) -> list[Integers]:
    """Triangles, depth by depth."""
    fronts, front = [], np.array([0, 1], np.int32)
    while len(front):
        fronts.append(front)
        below = child[front]
        below = below[below >= 0]
        front = np.concatenate([below, below + 1])
    return fronts


def _places(tree: Hierarchy, fronts: list[Integers]) -> tuple[NDArray[np.int64], Integers]:
    """Row and column (b, 2) of the squares that the last front's triangles halve, and to each of these its square,
    −1 where it is not split.

    A vertex's place is where it would be if all bases were halved in the middle.
    """
    side = 2.0 ** ((len(fronts) - 1) // 2)
    place = np.zeros((len(tree.vertices), 2))
    place[:4] = side * np.array([(0, 0), (0, 1), (1, 1), (1, 0)])
    for front in fronts:
        split = front[tree.node[front] >= 0]
        place[tree.node[split]] = place[tree.corners[split, :2]].mean(axis=1)
    last = fronts[-1]
    node = tree.node[last]
    centres, ids = np.unique(node[node >= 0], return_inverse=True)
    found = np.full(len(last), -1, np.int32)
    found[node >= 0] = ids
    return np.floor(place[centres]).astype(np.int64), found


def _reached(tree: Hierarchy, fronts: list[Integers], owner: Integers, color: Bytes) -> NDArray[np.uint16]:
    """The blocks (v,) of vertices, by colours, from the deepest up.

    Args:
        fronts: triangles of blocks, depth by depth.
    """
    reached = np.zeros(len(tree.vertices), np.uint16)
    for front in reversed(fronts):
        split = front[(tree.node[front] >= 0) & (owner[front] >= 0)]
        v = tree.node[split]
        np.bitwise_or.at(reached, v, np.left_shift(1, color[owner[split]], dtype=np.uint16))
        for side in (0, 1):
            np.bitwise_or.at(reached, tree.parents[v, side], reached[v])
    return reached


def _boxes(tree: Hierarchy, owner: Integers, mine: NDArray[np.int64], count: int) -> Floats:
    """What holds all triangles of a block and the ground under them."""
    boxes = np.tile([np.inf, -np.inf], (count, 3))
    of = owner[mine]
    for axis in (0, 1):
        at = tree.vertices[tree.corners[mine], axis]
        np.minimum.at(boxes[:, 2 * axis], of, at.min(axis=1))
        np.maximum.at(boxes[:, 2 * axis + 1], of, at.max(axis=1))
    z = tree.vertices[tree.corners[mine], 2]
    np.minimum.at(boxes[:, 4], of, z.min(axis=1) - tree.off[mine])
    np.maximum.at(boxes[:, 5], of, z.max(axis=1) + tree.off[mine])
    return boxes


def triangulate(tree: Hierarchy, blocks: Blocks, block: int, levels: Bytes) -> Triangulation:
    """The triangles of a block.

    Args:
        levels: (16,) uint8, of the blocks of each colour.
    """
    out, stack = np.empty(blocks.sizes[block], np.int32), np.empty((256, 2), np.int32)
    size = leaves_of_block(
        tree.node, tree.child, tree.state, blocks.rank, blocks.blocks, levels, blocks.roots[block], out, stack
    )
    leaves = out[:size].copy()
    return Triangulation(leaves, leaves[tree.node[leaves] < 0], joined(tree.corners[leaves]))


def joined(triangles: Integers) -> Integers:
    """A strip of triangles that can be put behind others of the kind: of an even length, its first two triangles and
    its last ones without area."""
    strip = np.empty(7 * len(triangles) + 12, np.int32)
    size = strip_of(np.ascontiguousarray(triangles), strip[2:]) + 2
    if size == 2:
        return np.zeros(0, np.int32)
    strip[:2] = strip[2]
    even = size + 1 + (size + 1) % 2
    strip[size:even] = strip[size - 1]
    return strip[:even].copy()


@kernel
def leaves_of_block(node, child, state, rank, blocks, levels, roots, out, stack):
    """The triangles on ground of a block, in the order of the curve; how many.

    Args:
        levels: (16,) uint8, of the blocks of each colour. out: (m,) int32, filled. stack: (k, 2) int32.
    """
    most = levels.max()
    stack[0, 0], stack[0, 1] = roots[1], 1
    stack[1, 0], stack[1, 1] = roots[0], 1
    depth, count = 2, 0
    while depth:
        depth -= 1
        t, forward = stack[depth, 0], stack[depth, 1]
        v = node[t]
        split = False
        if v >= 0 and rank[v] <= most:
            bits, color = np.int64(blocks[v]), 0
            while bits and not split:
                split = bits & 1 == 1 and rank[v] <= levels[color]
                bits, color = bits >> 1, color + 1
        if split:
            one = child[t]
            first, second = (one, one + 1) if forward else (one + 1, one)
            stack[depth, 0], stack[depth, 1] = second, 1 - forward
            stack[depth + 1, 0], stack[depth + 1, 1] = first, 1 - forward
            depth += 2
        elif state[t] == LIVE:
            out[count] = t
            count += 1
    return count


@kernel
def bound_of(camera, tree, leaves):
    """The largest bound in pixels of triangles that are not split any further."""
    worst = 0.0
    for t in leaves:
        worst = max(worst, finest_bound(camera, tree, t))
    return worst


@kernel
def weigh_colors(camera, boxes, away, cosine, reach, ranges):
    """Raise ranges until their levels leave out no vertex that ``color_exceeds``.

    A vertex out of view whose sphere is in view may be nearer than all of its block that is in view, by a radius.

    Args:
        boxes: float64 (k, 6), away (k,) and cosine: as ``block_boxes.nearest`` has them. reach: (k, levels), of
            ``Blocks``. ranges: int16 (k,), one less than the levels; in and out.
    """
    for i in range(len(ranges)):
        box = (boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3], boxes[i, 4], boxes[i, 5])
        w = nearest(camera, box, away[i], cosine, 0.0)
        level = np.int64(ranges[i]) + 1
        while reach[i, level] > 0.0:
            r = reach[i, level] * camera.stretch
            if not larger_than_pixel(camera, w - 2.0 * r, r):
                break
            level += 1
        ranges[i] = level - 1
