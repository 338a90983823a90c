"""The cells of a restricted quadtree, level by level: which are there, which are split, and who is next to whom.

A cell is named by its centre, a *square* diamond of octave k, 0 and up; its side is 2^(k+1) samples. Its corners and
sides are numbered clockwise: corners from the north-western one, side i from corner i to corner i + 1 (north, east,
south, west). The middles of its sides are the *edge* diamonds of the same octave, which two cells share. Child i lies
at corner i; its centre is the diamond of a *quarter*. A cell is split if the middle of one of its sides is active
(``lod.criterion``), or only if one of the quarters at that side is, of this cell or the one across.

Cells are made breadth first, in arrays by *place*; the number of a cell is the one that it has in the implicit quadtree
with the root 0 (``hierarchy.trees``), of which these are some. Vertices are keys ``row << 32 | col`` of the padded
square. Metres, NaN where missing.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.error.screen import outside
from orograph.hierarchy.kernels import bits as integers
from orograph.hierarchy.kernels import trees
from orograph.lod.criterion import (
    DROP,
    LEAF,
    SPLIT,
    ZERO,
    colored,
    exceeds,
    look_up,
    place_of,
    weigh,
    weigh_both,
)

OFFSET = trees.offset(0, 1, trees.QUAD)
"""m of the quadtree with the root 0."""

CENTRE, MIDDLES = 8, 4
"""Heights of a cell: four corners, the middles of four sides, the centre."""


WHOLE, BITS = 4, 5
"""States of a cell, after those of its four sides."""


class Cells(NamedTuple):
    """Cells by place; those of a level follow each other, as do the four children of a cell.

    Attributes:
        numbers: int64 (capacity,), in the implicit quadtree.
        centres: int64 (capacity,), keys.
        heights: float32 (capacity, 9): corners, middles of the sides, centre.
        states: uint8 (capacity, 6): what becomes of the triangles at each side, of the whole cell, and its bits
            (``criterion``). hidden: uint8 (capacity,), bit i: what quarter i has of a side that is active is left out.
        bits: int64 (capacity,), the bits that it inherits.
        neighbours: int32 (capacity, 4), places of the cells of the same level across each side; −1: there is none.
        first: int32 (capacity,), the place of child 0 of a cell that is split, −1 of a leaf.
        split: uint8 (capacity,), whether it is to be split.
    """

    numbers: NDArray[np.int64]
    centres: NDArray[np.int64]
    heights: NDArray[np.float32]
    states: NDArray[np.uint8]
    hidden: NDArray[np.uint8]
    bits: NDArray[np.int64]
    neighbours: NDArray[np.int32]
    first: NDArray[np.int32]
    split: NDArray[np.uint8]

    @classmethod
    def room_for(cls, count: int) -> Self:
        """Cells of which none is filled."""
        return cls(
            np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros((count, 9), np.float32),
            np.zeros((count, 6), np.uint8), np.zeros(count, np.uint8), np.zeros(count, np.int64),
            np.zeros((count, 4), np.int32), np.zeros(count, np.int32), np.zeros(count, np.uint8),
        )  # fmt: skip

    def grown(self, count: int) -> Self:
        """A copy with room for so many."""
        more = type(self).room_for(count)
        for name in self._fields:
            getattr(more, name)[: len(self.numbers)] = getattr(self, name)
        return more


def begin(cells: Cells, n: int, corners: NDArray[np.float32], bits: int) -> None:
    """Place 0 becomes the root of a square of 2^n cells a side, n at least 1.

    Args:
        corners: (2, 2), the heights of the square's corners. bits: of the criterion.
    """
    half = 1 << (n - 1)
    cells.numbers[0], cells.centres[0], cells.bits[0] = 0, half << 32 | half, bits
    cells.heights[0, :4] = corners[0, 0], corners[0, 1], corners[1, 1], corners[1, 0]
    cells.neighbours[0], cells.first[0] = -1, -1


@inlined
def middle(centre, spacing, side):
    """The key of the middle of a side of a cell."""
    down = (side == 2) - (side == 0)
    right = (side == 1) - (side == 3)
    return centre + ((down * spacing) << 32) + right * spacing


@inlined
def corner(centre, spacing, number):
    """The key of a corner of a cell."""
    down = -1 if number < 2 else 1
    right = 1 if number == 1 or number == 2 else -1
    return centre + ((down * spacing) << 32) + right * spacing


@leaf
def weigh_two(pages, criterion, first, second, octave, bits):
    """``weigh_both``, compiled once."""
    return weigh_both(pages, criterion, first, second, octave, bits)


@inlined
def across(pages, criterion, centre, spacing, side, size, bits):
    """Whether one of the quarters beyond a side of a cell is active; ``bits``: of the side's middle."""
    octave_below = integers.floor_log2(spacing) - 1
    half = spacing >> 1
    m = middle(centre, spacing, side)
    row, col = m >> 32, m & 0xFFFFFFFF
    if row == 0 or col == 0 or row == size or col == size:
        return False
    m = middle(m, half, side)
    one, _, _, two, _, _ = weigh_two(
        pages, criterion, middle(m, half, (side + 1) & 3), middle(m, half, (side + 3) & 3), octave_below, bits
    )
    return one == SPLIT or two == SPLIT


@leaf
def weigh_quarters(pages, criterion, cells, p, spacing, size, bits, side_bits):
    """Whether a quarter at an active side of cell p is active; notes which of its own are left out."""
    centre, half = cells.centres[p], spacing >> 1
    octave_below = integers.floor_log2(spacing) - 1
    found = False
    for i in range(2):
        one, _, _, two, _, _ = weigh_two(
            pages, criterion, corner(centre, half, i), corner(centre, half, i + 2), octave_below, bits
        )
        found |= one == SPLIT or two == SPLIT
        cells.hidden[p] |= (one == DROP) << i | (two == DROP) << (i + 2)
    for side in range(4):
        if not found and cells.states[p, side] == SPLIT:
            found = across(pages, criterion, centre, spacing, side, size, side_bits >> (8 * side) & 255)
    return found


@leaf
def weigh_cells(pages, criterion, by_sides, cells, start, end, octave):
    """Weigh the cells of places [start, end), of an octave; how many are to be split.

    Args:
        by_sides: whether a cell is split by its sides, not by the quarters at them.
    """
    heights, states = cells.heights, cells.states
    size = cells.centres[0] >> 32 << 1
    spacing = np.int64(1) << octave
    splits = 0
    for p in range(start, end):
        centre = cells.centres[p]
        state, z, bits = weigh(pages, criterion, centre, octave, cells.bits[p])
        cells.hidden[p] = 0
        states[p, WHOLE], states[p, BITS], heights[p, CENTRE], cells.split[p] = state, bits, z, 0
        if state == DROP:
            continue
        active, side_bits = False, np.int64(0)
        for i in range(2):
            one, z1, bits1, two, z2, bits2 = weigh_two(
                pages, criterion, middle(centre, spacing, i), middle(centre, spacing, i + 2), octave, bits
            )
            states[p, i], states[p, i + 2] = one, two
            heights[p, MIDDLES + i], heights[p, MIDDLES + i + 2] = z1, z2
            active |= one == SPLIT or two == SPLIT
            side_bits |= bits1 << (8 * i) | bits2 << (8 * (i + 2))
        if active and octave > 0:
            cells.split[p] = by_sides or weigh_quarters(pages, criterion, cells, p, spacing, size, bits, side_bits)
            splits += cells.split[p]
    return splits


@inlined
def own_error(heights, p, quadrant):
    """How far the middles of the sides and the centre of cell p are from the two triangles of its corners; metres."""
    worst = abs(heights[p, CENTRE] - 0.5 * (heights[p, quadrant] + heights[p, quadrant ^ 2]))
    for i in range(4):
        worst = max(worst, abs(heights[p, MIDDLES + i] - 0.5 * (heights[p, i] + heights[p, (i + 1) & 3])))
    return worst


@leaf
def weigh_cells_alone(pages, criterion, by_sides, cells, start, end, octave):
    """``weigh_cells``, each by what it would change itself, whatever lies next to it or below it.

    Of a cell that the raster's border squeezes, the error is the stored one.
    """
    camera, heights, states = criterion.camera, cells.heights, cells.states
    spacing = np.int64(1) << octave
    splits = 0
    for p in range(start, end):
        centre = cells.centres[p]
        col, row = place_of(pages, centre)
        _, filled, stored, r, c = look_up(pages, centre, octave)
        missing = np.float32(0.0)
        for i in range(4):
            _, z, _, _, m = look_up(pages, middle(centre, spacing, i), octave)
            heights[p, MIDDLES + i] = z if m >= ZERO else np.float32(np.nan)
            states[p, i] = LEAF
            missing += heights[p, MIDDLES + i]
        radius = np.float64(r) * camera.stretch
        out, bits = r < ZERO, np.int64(0)
        if criterion.cull and not out:
            out, bits = outside(camera, col, row, np.float64(filled), radius, cells.bits[p])
        states[p, BITS], cells.hidden[p] = bits, 0
        heights[p, CENTRE] = filled if c >= ZERO else np.float32(np.nan)
        e = np.float64(stored)
        inside = (centre >> 32) + spacing <= pages.edge[0] and (centre & 0xFFFFFFFF) + spacing <= pages.edge[1]
        if e < np.inf and inside:
            e = np.float64(own_error(heights, p, trees.which_child(cells.numbers[p], OFFSET, trees.QUAD) if p else 0))
        found, w = exceeds(camera, criterion.metric, col, row, np.float64(filled), e, radius)
        found, _ = colored(camera, found, filled, c, w, radius)
        states[p, WHOLE] = DROP if out else SPLIT if found else LEAF
        cells.split[p] = found and not out and octave > 0
        splits += cells.split[p]
    return splits


@leaf
def split_cells(cells, start, end, octave):
    """Make the children of those of places [start, end) that are to be split, from place ``end`` on; there is room."""
    numbers, centres, heights, neighbours, first = (
        cells.numbers, cells.centres, cells.heights, cells.neighbours, cells.first
    )  # fmt: skip
    half = (np.int64(1) << octave) >> 1
    count = end
    for p in range(start, end):
        first[p] = -1
        if not cells.split[p]:
            continue
        first[p] = count
        for i in range(4):
            c = count + i
            numbers[c], bits = trees.child(numbers[p], i, OFFSET, trees.QUAD), np.int64(cells.states[p, BITS])
            centres[c], cells.bits[c], first[c] = corner(centres[p], half, i), bits, -1
            heights[c, i] = heights[p, i]
            heights[c, (i + 1) & 3] = heights[p, MIDDLES + i]
            heights[c, (i + 2) & 3] = heights[p, CENTRE]
            heights[c, (i + 3) & 3] = heights[p, MIDDLES + ((i + 3) & 3)]
        count += 4
    for p in range(start, end):
        if first[p] < 0:
            continue
        for i in range(4):
            c, before = first[p] + i, (i + 3) & 3
            neighbours[c, (i + 1) & 3] = first[p] + ((i + 1) & 3)
            neighbours[c, (i + 2) & 3] = first[p] + before
            # Across the parent's sides: the parent's neighbours' children, mirrored.
            here, there = neighbours[p, i], neighbours[p, before]
            neighbours[c, i] = first[here] + before if here >= 0 and first[here] >= 0 else -1
            neighbours[c, before] = first[there] + ((i + 1) & 3) if there >= 0 and first[there] >= 0 else -1
