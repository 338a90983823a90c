"""The strip that all blocks of SMART share, the masks over it, and the triangles that a mask leaves.

A block of 2^m × 2^m cells is two right triangles, halved 2m times. Visit all nodes of both trees in order (a node
between the subtrees of its halves) and write down each node's apex: that is the *strip*, the same for every block but
for a reflection. A node is there if its apex is *active*, a vertex of the mesh; active vertices are closed in the
diamond DAG. So the strip of any mesh of the block is this one with the entries of inactive vertices left out: the
*mask* is a bit a vertex. What it leaves is written by SOAR's rule for generalised strips (Lindstrom & Pascucci 2001): a
vertex that is one of the last two is skipped, and one at a level of the same parity as the last is written after the
last but one.

A neighbour that is finer reaches into a block. The region of a vertex is the open square around it of radius 2s (s its
spacing; 3s if it is the centre of a square): that of a parent holds those of its children. *Zones* are the half-size
squares around a block; which of them the region of a vertex touches never changes. Vertices of a block are numbered
y · (2^m + 1) + x.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf

ZONES = tuple((y, x) for y in range(-2, 4) for x in range(-2, 4) if not (0 <= y <= 1 and 0 <= x <= 1))
"""Rows and columns, in half blocks, of the squares around a block."""

NEAR = tuple(z for z, (y, x) in enumerate(ZONES) if -1 <= y <= 2 and -1 <= x <= 2)
"""Those that touch it."""


class Shape(NamedTuple):
    """What all blocks of 2^m cells a side share.

    Attributes:
        strips: int16 (2, k), the strip of a block whose diagonal falls to the right, and to the left.
        turn: where its second triangle begins. ends: int16 (2, 2), the ends of the diagonal.
        zones: uint32 (v,), the bits of the zones that the region of a vertex touches.
        finest: uint8 (v,), whether a vertex has the finest spacing. middles: int16 (5,), of the four sides (N, E, S, W)
            and the centre.
        side: vertices along a side.
    """

    strips: NDArray[np.int16]
    turn: int
    ends: NDArray[np.int16]
    zones: NDArray[np.uint32]
    finest: NDArray[np.uint8]
    middles: NDArray[np.int16]
    side: int


@functools.cache
def shape_of(m: int) -> Shape:
    """The shape of blocks of 2^m cells a side, m at most 6."""
    cells = 1 << m
    side = cells + 1
    strips, ends = [], []
    turn = 0
    for falls in (True, False):
        nw, ne, sw, se = 0, cells, cells * side, cells * side + cells
        e, x, first, second = (nw, se, ne, sw) if falls else (ne, sw, nw, se)
        entries: list[int] = []
        _in_order(entries, e, x, first, 2 * m)
        entries.append(x)
        turn = len(entries)
        _in_order(entries, x, e, second, 2 * m)
        entries.append(e)
        strips.append(entries)
        ends.append((e, x))
    y, x_ = (v.ravel() for v in np.mgrid[:side, :side])
    spacing = np.minimum(_lowest(y, cells), _lowest(x_, cells))
    corner = (y % cells == 0) & (x_ % cells == 0)
    half = cells // 2
    middles = [half, half * side + cells, cells * side + half, half * side, half * side + half]
    return Shape(
        np.array(strips, np.int16), turn, np.array(ends, np.int16), _zones(y, x_, spacing, corner, cells),
        ((spacing == 1) & ~corner).astype(np.uint8), np.array(middles, np.int16), side,
    )  # fmt: skip


def _in_order(entries: list[int], e: int, x: int, a: int, level: int) -> None:
    """The apexes of the nodes below a triangle with the hypotenuse from e to x and the apex a, and its own."""
    if level:
        _in_order(entries, e, a, (e + x) // 2, level - 1)
    entries.append(a)
    if level:
        _in_order(entries, a, x, (e + x) // 2, level - 1)


def _lowest(v: NDArray[np.int64], cells: int) -> NDArray[np.int64]:
    """The largest power of two that divides places on a line, ``cells`` of 0."""
    return np.where(v == 0, cells, v & -v)


def _zones(
    y: NDArray[np.int64], x: NDArray[np.int64], s: NDArray[np.int64], corner: NDArray[np.bool_], cells: int
) -> NDArray[np.uint32]:
    found = np.zeros(len(y), np.uint32)
    if cells < 2:
        return found
    reach = np.where((y // s) & (x // s) & 1, 3 * s, 2 * s)
    half = cells // 2
    for z, (i, j) in enumerate(ZONES):
        meets = (y - reach < (i + 1) * half) & (y + reach > i * half)
        meets &= (x - reach < (j + 1) * half) & (x + reach > j * half)
        found |= np.where(meets & ~corner, np.uint32(1 << z), np.uint32(0))
    return found


@leaf
def mask(shape, ranks, wanted, active):
    """Which vertices of a block are active.

    Args:
        shape: ``Shape``. ranks: uint8 (v,), from which range of errors on each vertex is active.
        wanted: uint8 (1 + zones + 1,): the block's range, those of the zones (where they are not finer, the block's),
            and the bits of the sides beyond which blocks are smaller.
        active: uint8 (v,); out.
    """
    own = wanted[0]
    finer = np.uint32(0)
    for z in range(len(wanted) - 2):
        if wanted[1 + z] > own:
            finer |= np.uint32(1) << np.uint32(z)
    for v in range(len(ranks)):
        range_ = own
        touched = shape.zones[v] & finer
        if touched:
            for z in range(len(wanted) - 2):
                if touched >> np.uint32(z) & np.uint32(1):
                    range_ = max(range_, wanted[1 + z])
        active[v] = ranks[v] <= range_
    last = shape.side - 1
    for v in (0, last, last * shape.side, last * shape.side + last):
        active[v] = 1
    sides = wanted[len(wanted) - 1]
    for i in range(4):
        if sides >> i & 1:  # a smaller block has its corner there
            active[shape.middles[i]] = 1
            active[shape.middles[4]] = 1


@inlined
def _append(out, length, v, same):
    """Write a vertex behind the others, after the last but one if its parity is the ``same``; the new length."""
    if v == out[length - 1] or v == out[length - 2]:
        return length, False
    if same:
        out[length] = out[length - 2]
        length += 1
    out[length] = v
    return length + 1, True


@leaf
def masked_strip(shape, falls, active, out):
    """The block's strip where it is active; its length. Its triangles turn left (rows downwards) at even places.

    Args:
        falls: whether the diagonal falls to the right. out: int16, twice as long as the strip and 8 more.
    """
    which = 0 if falls else 1
    length = 0
    for half in range(2):
        begin, end = (0, shape.turn) if half == 0 else (shape.turn, shape.strips.shape[1])
        if length & 1:
            out[length] = out[length - 1]
            length += 1
        first = shape.ends[which, half]
        out[length], out[length + 1] = first, first
        length += 2
        parity = 1 if falls else 0
        for t in range(begin, end):
            v = shape.strips[which, t]
            if not active[v]:
                continue
            # Leaves of the full trees lie at even places, their parents two by two between them, and so on.
            depth, k = 0, t - begin + 1
            while k & 1 == 0 and t < end - 1:
                depth += 1
                k >>= 1
            level = 1 if t == end - 1 else depth & 1
            length, written = _append(out, length, v, level == parity)
            if written:
                parity = level
    return length


@inlined
def _middle(a, b, side):
    """The vertex halfway between two, −1 if there is none."""
    ay, ax, by, bx = a // side, a % side, b // side, b % side
    return -1 if (ay + by) & 1 or (ax + bx) & 1 else (a + b) >> 1


@inlined
def _square(a, b, side):
    y, x = a // side - b // side, a % side - b % side
    return y * y + x * x


@inlined
def _shown(a, b, c, empty, zs, place, side):
    """Whether a triangle has surface, no corner is missing, and it does not lie beyond the raster."""
    total = zs[a] + zs[b] + zs[c]
    if total != total:
        return False
    row, col, step, last_row, last_col = place
    if row + min(a, min(b, c)) // side * step >= last_row:
        return False
    if col + min(a % side, min(b % side, c % side)) * step >= last_col:
        return False
    ab, bc, ca = _square(a, b, side), _square(b, c, side), _square(c, a, side)
    long = max(ab, max(bc, ca))
    m = _middle(a, b, side) if long == ab else _middle(b, c, side) if long == bc else _middle(c, a, side)
    return m < 0 or not empty[m]


@leaf
def shown_strip(strip, length, empty, zs, place, side, out):
    """A strip without the triangles that are not drawn, of even length, begun and ended twice: (length, triangles).

    Args:
        strip: int16, of ``masked_strip``, so long. empty: uint8 (v,), whether a vertex has no surface around it.
        zs: float32 (v,), heights, NaN where missing.
        place: (row, column of vertex 0, samples between vertices, the raster's last row and column).
        side: of ``Shape``. out: int16, five times as long as the strip.
    """
    count = made = 0
    is_open = False
    for i in range(length - 2):
        a, b, c = np.int64(strip[i]), np.int64(strip[i + 1]), np.int64(strip[i + 2])
        if a == b or b == c or c == a:
            if is_open:
                out[count] = c
                count += 1
            continue
        if not _shown(a, b, c, empty, zs, place, side):
            is_open = False
            continue
        if is_open:
            out[count] = c
            count += 1
        else:
            if count:
                out[count], out[count + 1] = out[count - 1], a
                count += 2
            else:
                out[count] = a
                count += 1
            if count & 1 != i & 1:
                out[count] = a
                count += 1
            out[count], out[count + 1], out[count + 2] = a, b, c
            count += 3
            is_open = True
        made += 1
    if made:
        out[count] = out[count - 1]
        count += 1
        if count & 1:
            out[count] = out[count - 1]
            count += 1
    return count, made


@kernel
def triangulate(shape, falls, ranks, empty, zs, wanted, place):
    """The strip of a block: (keys int64 (k,), heights float32 (k,), triangles). See the functions above."""
    active = np.empty(len(ranks), np.uint8)
    mask(shape, ranks, wanted, active)
    whole = np.empty(2 * shape.strips.shape[1] + 8, np.int16)
    length = masked_strip(shape, falls, active, whole)
    shown = np.empty(5 * length + 8, np.int16)
    count, made = shown_strip(whole, length, empty, zs, place, shape.side, shown)
    keys, heights = np.empty(count, np.int64), np.empty(count, np.float32)
    row, col, step, _, _ = place
    for i in range(count):
        v = np.int64(shown[i])
        keys[i] = (row + v // shape.side * step) << 32 | (col + v % shape.side * step)
        heights[i] = zs[v]
    return keys, heights, made
