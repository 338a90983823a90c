"""The hierarchy of right triangles: (l, L, ω) and the arithmetic that leads from one triangle to the next.

A square of N = 2^n cells a side is cut along north-west–south-east into two right triangles, each of these from its
apex to the middle of its hypotenuse into two smaller ones, and so on, 2n times; the triangles of level 2n are halves
of cells (Duchaineau et al. 1997, *ROAMing terrain*; the numbers (l, L, ω) are those of the lecture *Terrain
Visualization*, *Implementation – Triangle Representation*). Coordinates are sample coordinates: x is the column, y the
row, rows run *downwards*. A triangle is

- ``x, y``: the diamond point l, the middle of its hypotenuse, where it is split;
- ``L``: its extent along a coordinate axis, a power of two: the leg's length if ω is odd (legs along the axes), and
  from the apex to the hypotenuse if ω is even (hypotenuse along an axis, 2L long);
- ``omega``: which way its apex points from l, in steps of 45° *clockwise on the map* from west:
  0 W, 1 NW, 2 N, 3 NE, 4 E, 5 SE, 6 S, 7 SW.

With the vector v(L, ω) = (L, 0), (L/2, L/2), (0, L), (−L/2, L/2), (−L, 0) … the apex is l − v(L, ω). *Left* and *right*
are as one sees them with the map turned until the apex is on top, as in ROAM's figures; apex, left end, right end run
counter-clockwise on the map. Everything follows from one remark: **the children's apexes are the parent's l**. (The
lecture prints other child formulas; docs/hierarchy.md compares.)

The finest triangles (level 2n: L = 1, ω odd) are not split, and the middle of their hypotenuse is no sample: it is the
centre of a cell. Their (x, y) is that centre *rounded down*, the cell's north-west sample; the formulas round so that
this works without a special case.

Functions of ``x, y, L, omega`` are formulas as ``orograph.hierarchy.bits`` describes, for scalars, arrays and kernels,
valid for n ≤ 30 in int64. Those that may have no result return a triangle with L = 0. Units: samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.hierarchy.bits import Integers, floor_log2

Triangle = tuple[Integers, Integers, Integers, Integers]
Point = tuple[Integers, Integers]
IndexArray = NDArray[np.int64]
TriangleArrays = tuple[IndexArray, IndexArray, IndexArray, IndexArray]


def wave(k: Integers) -> Integers:
    """2, 1, 0, −1, −2, −1, 0, 1 for k = 0 … 7 and so on for any k: v(L, ω) = (wave(ω), wave(ω − 2)) · L / 2."""
    return abs((k & 7) - 4) - 2


def towards(x: Integers, y: Integers, L: Integers, direction: Integers) -> Point:
    """The point l + v(L, direction); 1/2 is added for the l of finest triangles, which are rounded down by it."""
    return x + ((1 + wave(direction) * L) >> 1), y + ((1 + wave(direction - 2) * L) >> 1)


def apex(x: Integers, y: Integers, L: Integers, omega: Integers) -> Point:
    """The corner (x, y) with the right angle: l − v(L, ω)."""
    return towards(x, y, L, omega + 4)


def left_end(x: Integers, y: Integers, L: Integers, omega: Integers) -> Point:
    """The end (x, y) of the hypotenuse that is on the left with the apex on top: l + v(L, ω + 2)."""
    return towards(x, y, L, omega + 2)


def right_end(x: Integers, y: Integers, L: Integers, omega: Integers) -> Point:
    """The end (x, y) of the hypotenuse that is on the right with the apex on top: l − v(L, ω + 2)."""
    return towards(x, y, L, omega + 6)


def with_apex(x: Integers, y: Integers, L: Integers, omega: Integers) -> Triangle:
    """The triangle whose *apex* is (x, y): its l is that plus v(L, ω), rounded down; the inverse of ``apex``."""
    return x + (wave(omega) * L >> 1), y + (wave(omega - 2) * L >> 1), L, omega & 7


def root(k: Integers, n: Integers) -> Triangle:
    """Root triangle k of the square of side 2^n: 0 is the north-eastern (ω = 3), 1 the south-western one (ω = 7)."""
    N = (1 << n) + 0 * k  # of the shape of k
    return N >> 1, N >> 1, N, 3 + 4 * k


def level(L: Integers, omega: Integers, n: Integers) -> Integers:
    """0 for the two roots … 2n for the halves of cells; ω is odd at even levels."""
    return 2 * (n - floor_log2(L)) - 1 + (omega & 1)


def is_finest(L: Integers, omega: Integers) -> Integers:
    """1 for the triangles of level 2n (half a cell, never split), else 0."""
    return (L == 1) & omega


def child(x: Integers, y: Integers, L: Integers, omega: Integers, k: Integers) -> Triangle:
    """The left (k = 0) or right (k = 1) child: its apex is l, its hypotenuse the left or right leg.

    ω′ = ω + 3 or ω + 5; L′ = L for even ω, L/2 for odd. Meaningless for a finest triangle.
    """
    return with_apex(x, y, L >> (omega & 1), omega + 3 + 2 * k)


def axis(x: Integers, y: Integers, L: Integers, odd: Integers) -> Integers:
    """ω mod 4 of the two triangles over the diamond point (x, y): which way its hypotenuse runs.

    Args:
        L: their L.
        odd: 1 if their ω is odd, else 0.

    Returns: 0 north–south, 1 north-east–south-west, 2 west–east, 3 north-west–south-east.
    """
    # Even ω: along the axis whose coordinate is an odd multiple of L. Odd ω: along the diagonal that keeps the cut of
    # the enclosing square a mirror: north-west–south-east iff x and y agree in bit L.
    return odd + 2 * (((x ^ (~y * odd)) & L) != 0)


def which_child(x: Integers, y: Integers, L: Integers, omega: Integers) -> Integers:
    """0 if the triangle is its parent's left child, 1 if it is the right one; meaningless for a root."""
    (ax, ay), even = apex(x, y, L, omega), 1 - (omega & 1)
    return ((omega - 3 - axis(ax, ay, L << even, even)) & 3) >> 1


def parent(x: Integers, y: Integers, L: Integers, omega: Integers) -> Triangle:
    """The triangle this one is a half of; meaningless for a root."""
    ax, ay = apex(x, y, L, omega)
    k = which_child(x, y, L, omega)
    return ax, ay, L << (1 - (omega & 1)), (omega - 3 - 2 * k) & 7


def inside(x: Integers, y: Integers, L: Integers, omega: Integers, n: Integers) -> Integers:
    """Whether all three corners lie in the square 0 … 2^n."""
    (ax, ay), (lx, ly) = apex(x, y, L, omega), left_end(x, y, L, omega)
    rx, ry = right_end(x, y, L, omega)
    N = 1 << n
    least = ax | ay | lx | ly | rx | ry  # negative if one of them is
    room = (N - ax) | (N - ay) | (N - lx) | (N - ly) | (N - rx) | (N - ry)
    return (least | room) >= 0


def exists(x: Integers, y: Integers, L: Integers, omega: Integers, n: Integers) -> Integers:
    """Whether these four numbers, whatever they are, make a triangle of the hierarchy of the square of side 2^n."""
    odd, turn = omega & 1, (omega >> 1) & 1
    last = (L << (1 - odd)) - 1  # l repeats with the period of the squares that the level is made of
    good_x = (x & last) == odd * (L >> 1) + (1 - odd) * L * turn
    good_y = (y & last) == odd * (L >> 1) + (1 - odd) * L * (1 - turn)
    N = 1 << n
    good_L = (L > 0) & (L <= N) & ((L & (L - 1)) == 0)
    good_omega = (omega >= 0) & (omega < 8) & (axis(x, y, L, odd) == (omega & 3))
    return good_x & good_y & good_L & good_omega & inside(x, y, L, omega, n)


def or_none(x: Integers, y: Integers, L: Integers, omega: Integers, n: Integers) -> Triangle:
    """The triangle, with L = 0 if it does not lie in the square."""
    return x, y, L * inside(x, y, L, omega, n), omega & 7


def sibling(x: Integers, y: Integers, L: Integers, omega: Integers, n: Integers) -> Triangle:
    """The triangle of the same level across the hypotenuse, with which this one is the top of a diamond.

    In a valid front the triangle there is this one or, one level coarser, its parent. L = 0 (none) where the hypotenuse
    lies on the border.
    """
    return or_none(x, y, L, omega + 4, n)


def left_neighbour(x: Integers, y: Integers, L: Integers, omega: Integers, n: Integers) -> Triangle:
    """The triangle of the same level across the left leg: this one's mirror image in that leg.

    In a valid front the triangle there is this one or, one level finer, its *right* child. L = 0 (none) where the leg
    lies on the border.
    """
    ax, ay = apex(x, y, L, omega)
    mx, my, _, mirrored = with_apex(ax, ay, L, omega + 2)
    return or_none(mx, my, L, mirrored, n)


def right_neighbour(x: Integers, y: Integers, L: Integers, omega: Integers, n: Integers) -> Triangle:
    """The triangle of the same level across the right leg: this one's mirror image in that leg.

    In a valid front the triangle there is this one or, one level finer, its *left* child. L = 0 (none) where the leg
    lies on the border.
    """
    ax, ay = apex(x, y, L, omega)
    mx, my, _, mirrored = with_apex(ax, ay, L, omega - 2)
    return or_none(mx, my, L, mirrored, n)


def node(x: Integers, y: Integers, L: Integers, omega: Integers, n: Integers) -> Integers:
    """The triangle's number in the two interleaved binary trees with the roots 2 (ω = 3) and 3 (ω = 7).

    The first triangle of level j is 2^(j+1); child k of node p is 2p + k (``trees``, m = 0).
    """
    path, depth = 0 * L, level(L, omega, n)
    for step in range(2 * n):
        climbs = depth > step  # triangles of a lower level have arrived at their root, and stay there
        path = path + climbs * (which_child(x, y, L, omega) << step)
        px, py, pL, turned = parent(x, y, L, omega)
        x, y, L = x + climbs * (px - x), y + climbs * (py - y), L + climbs * (pL - L)
        omega = omega + climbs * (turned - omega)
    return ((2 + (omega >> 2)) << depth) + path


def from_node(i: Integers, n: Integers) -> Triangle:
    """The triangle with number i ≥ 2: the inverse of ``node``."""
    depth = floor_log2(i) - 1
    x, y, L, omega = root((i >> depth) & 1, n)
    for step in range(2 * n):
        descends = depth > step
        bit = (i >> ((depth - 1 - step) * descends)) & 1
        cx, cy, cL, turned = child(x, y, L, omega, bit)
        x, y, L = x + descends * (cx - x), y + descends * (cy - y), L + descends * (cL - L)
        omega = omega + descends * (turned - omega)
    return x, y, L, omega


FORMULAS = (
    *(wave, towards, apex, left_end, right_end, with_apex, root, level, is_finest, child, axis, which_child, parent),
    *(inside, exists, or_none, sibling, left_neighbour, right_neighbour, node, from_node),
)
"""What kernels may call (see ``orograph.hierarchy.kernels``)."""


def of_level(n: int, level: int) -> TriangleArrays:
    """All triangles of a level: four int64 arrays x, y, L, ω of 2^(level+1) entries.

    They are in the order of the trees: entry i is the node 2^(level+1) + i.

    Args:
        n: exponent of the square's side 2^n.
        level: 0 … 2n.

    Raises:
        UsageError: there is no such level.
    """
    if not 0 <= level <= 2 * n:
        raise UsageError(f"A square of side 2^{n} has triangles of levels 0 to {2 * n}, not {level}.")
    return from_node(np.arange(2 << level, 4 << level, dtype=np.int64), n)
