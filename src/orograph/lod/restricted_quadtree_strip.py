"""The strip of a quadtree's leaves, along a Hilbert curve: every leaf is a triangle fan around its centre.

The curve goes through a cell from its corner e to the next corner x = e + d, d = ±1 (corners as in
``restricted_quadtree_cells``), and through its children from e over e − d and e − 2d to x; where one child is left the
next is entered, at every mix of levels. A fan begins at e and turns away from x; its last triangle (x, e) leaves the
strip at x. Turning corners takes repeated vertices. Keys and heights as there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.hierarchy.kernels import trees
from orograph.lod.criterion import DROP, SPLIT
from orograph.lod.restricted_quadtree_cells import CENTRE, MIDDLES, OFFSET, WHOLE, corner, middle
from orograph.lod.soar_pass import draws

CONFORMING, RESTRICTED, UNRESTRICTED = 0, 1, 2

ROOM = 64
"""What one leaf may append: at most eight triangles, each after a gap."""


class Path(NamedTuple):
    """Around a leaf's pivot.

    Attributes:
        keys: int64 (9,), heights: float32 (9,): the vertices on its boundary. shown: bool (9,): whether the triangle of
            the pivot, each of them and the next one is there.
        stack: int64 (3n + 4, 3): place, e and d of cells that wait.
    """

    keys: NDArray[np.int64]
    heights: NDArray[np.float32]
    shown: NDArray[np.bool_]
    stack: NDArray[np.int64]

    @classmethod
    def of(cls, n: int) -> Path:
        """For a square of 2^n cells a side."""
        return cls(np.empty(9, np.int64), np.empty(9, np.float32), np.empty(9, np.bool_), np.empty((3 * n + 4, 3), int))


@inlined
def begin_fan(keys, zs, length, even, ak, az, pk, pz):
    """Append (a, p), a at an even or odd place, with no triangle of what was before; the new length."""
    if length:
        if keys[length - 1] != ak:
            keys[length], zs[length] = keys[length - 1], zs[length - 1]
            keys[length + 1], zs[length + 1] = ak, az
            length += 2
        keys[length], zs[length] = ak, az
        length += 1
        if ((length - 1) & 1 == 0) != even:
            keys[length], zs[length] = ak, az
            length += 1
    else:
        for _ in range(1 if even else 2):
            keys[length], zs[length] = ak, az
            length += 1
    keys[length], zs[length] = pk, pz
    return length + 1


@inlined
def fan_around(cells, p, triangulation, spacing, e, d, path):
    """The path around a leaf's centre, from e to e; how many vertices."""
    centre, border = cells.centres[p], cells.neighbours[p]
    count = 0
    for j in range(4):
        a = (e - j * d) & 3
        side = (a - d) & 3 if d > 0 else a
        path.keys[count], path.heights[count] = corner(centre, spacing, a), cells.heights[p, a]
        state = cells.states[p, side]
        path.shown[count] = state != DROP
        count += 1
        across = border[side]
        if triangulation == CONFORMING:
            inserted = across >= 0 and cells.first[across] >= 0
        elif triangulation == RESTRICTED:
            # (A border of the square borders nothing larger.)
            k = middle(centre, spacing, side)
            size = (np.int64(1) << trees.level(cells.numbers[p], 0, 1, trees.QUAD)) * 2 * spacing
            r, c = k >> 32, k & 0xFFFFFFFF
            inserted = across >= 0 or r == 0 or c == 0 or r == size or c == size
        else:
            inserted = True
        if inserted or state == SPLIT:
            path.keys[count] = middle(centre, spacing, side)
            path.heights[count] = cells.heights[p, MIDDLES + side]
            path.shown[count] = path.shown[count - 1]
            if state == SPLIT:  # its halves are of two quarters
                path.shown[count - 1] = cells.hidden[p] >> a & 1 == 0
                path.shown[count] = cells.hidden[p] >> ((a - d) & 3) & 1 == 0
            count += 1
    path.keys[count], path.heights[count] = path.keys[0], path.heights[0]
    return count + 1


@inlined
def two_triangles(cells, p, spacing, e, d, path):
    """The path of a square that is cut in two, as the hierarchy cuts it, and its pivot: (vertices, corner)."""
    quadrant = trees.which_child(cells.numbers[p], OFFSET, trees.QUAD) if p else 0
    pivot = e if (e ^ quadrant) & 1 == 0 else (e + d) & 3
    for j in range(3):
        a = (pivot - (j + 1) * d) & 3
        path.keys[j], path.heights[j] = corner(cells.centres[p], spacing, a), cells.heights[p, a]
        path.shown[j] = True
    return 3, pivot


@inlined
def append_fan(keys, zs, length, edge, squeezed, pk, pz, path, count, even, closes):
    """Append the triangles of a path around a pivot; (the new length, how many).

    Args:
        even: whether a fan must begin at an even place to turn as it should.
        closes: whether the last triangle, if nothing lies between x and e, is to leave the strip at x.
    """
    made = 0
    is_open = False
    for j in range(count - 1):
        ak, az = path.keys[j], path.heights[j]
        bk, bz = path.keys[j + 1], path.heights[j + 1]
        if not (path.shown[j] and draws(ak, bk, pk, az, bz, pz, edge[0], edge[1], squeezed)):
            is_open = False
            continue
        last = j == count - 2
        if not is_open:
            length = begin_fan(keys, zs, length, even, ak, az, pk, pz)
        elif not last:
            keys[length], zs[length] = pk, pz
            length += 1
        keys[length], zs[length] = bk, bz
        length += 1
        if last and closes and is_open:
            keys[length], zs[length] = ak, az
            length += 1
        is_open = True
        made += 1
    return length, made


@leaf
def write_strip(cells, n, triangulation, edge, path, keys, zs):
    """Write the strip of all leaves.

    Args:
        cells: ``Cells``; place 0 is the root. n: its side is 2^n samples.
        triangulation: CONFORMING, RESTRICTED or UNRESTRICTED. edge: ``Pages.edge``. path: ``Path``.
        keys, zs: the strip; out.

    Returns: its length (−1: there is no room), the triangles, the leaves that are drawn.
    """
    squeezed = edge[0] < np.int64(1) << n or edge[1] < np.int64(1) << n
    stack = path.stack
    length = triangles = leaves = 0
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, 1
    top = 1
    while top:
        top -= 1
        p, e, d = stack[top, 0], stack[top, 1], stack[top, 2]
        first = cells.first[p]
        if first >= 0:
            # Children in the order of the curve, the last one first: (corner, entered at, direction).
            x = (e + d) & 3
            stack[top, 0], stack[top, 1], stack[top, 2] = first + x, (e + 2 * d) & 3, -d
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = first + ((e - 2 * d) & 3), e, d
            stack[top + 2, 0], stack[top + 2, 1], stack[top + 2, 2] = first + ((e - d) & 3), e, d
            stack[top + 3, 0], stack[top + 3, 1], stack[top + 3, 2] = first + e, e, -d
            top += 4
            continue
        if cells.states[p, WHOLE] == DROP:
            continue
        if length + ROOM > len(keys):
            return -1, triangles, leaves
        centre = cells.centres[p]
        spacing = centre & -centre & 0xFFFFFFFF
        pk, pz = centre, cells.heights[p, CENTRE]
        if triangulation == UNRESTRICTED and (spacing > 1 or cells.states[p, WHOLE] != SPLIT):
            count, pivot = two_triangles(cells, p, spacing, e, d, path)
            pk, pz = corner(centre, spacing, pivot), cells.heights[p, pivot]
            closes = False
        else:
            count = fan_around(cells, p, triangulation, spacing, e, d, path)
            closes = path.keys[count - 2] == corner(centre, spacing, (e + d) & 3)
        length, made = append_fan(keys, zs, length, edge, squeezed, pk, pz, path, count, d < 0, closes)
        triangles += made
        leaves += made > 0
    return length, triangles, leaves
