"""Diamonds: the squares that are split as one, named by the vertex that the split inserts, and their dependencies.

The two triangles on either side of a hypotenuse are the *top* of a diamond; splitting both inserts its vertex, the
middle of the hypotenuse, and leaves up to four triangles around it, the *bottom* (lecture, *Diamond DAG*; Lindstrom &
Pascucci 2001, *Visualization of Large Terrains Made Easy*). Every vertex (row, col) of the square 0 … 2^n but its
four corners is the vertex of exactly one diamond. Let its octave k be the number of trailing zero bits of row | col,
and s = 2^k.

- *square* (row/s and col/s odd): the region is [row ± s] × [col ± s], and the hypotenuse one of its diagonals.
- *edge* (one of them odd, the other even): the hypotenuse lies along the axis whose index is odd, from −s to +s, and
  the apexes s beside it; the region is a square on its corner, of which the border of the terrain cuts off one half.

A vertex can be inserted once the **apexes** of its top triangles are there: they are its parents (two; one for an edge
on the border; none for the root). Seen from above: a square has four edges of the same octave as children, an edge up
to four squares of the next finer octave, an edge of octave 0 none. These arrows make the dependency graph (a DAG),
along which ``closure`` and ``ancestors`` collect what must be present.

Points are **(row, col)** here; triangles, (x, y, L, ω), have x = col and y = row. None is (−1, −1). The functions of
``row, col`` are formulas as ``orograph.hierarchy.bits`` describes, for scalars, arrays and kernels. Units: samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.hierarchy import triangles
from orograph.hierarchy.bits import Integers, floor_log2, lowest_bit
from orograph.hierarchy.triangles import IndexArray, Point, Triangle

SQUARE = 0
EDGE = 1


def spacing(row: Integers, col: Integers) -> Integers:
    """s = 2^octave: the largest power of two that divides row and col."""
    return lowest_bit(row | col)


def octave(row: Integers, col: Integers) -> Integers:
    """k: the number of trailing zero bits of row | col, 0 … n − 1."""
    return floor_log2(spacing(row, col))


def kind(row: Integers, col: Integers) -> Integers:
    """``SQUARE`` (0) or ``EDGE`` (1)."""
    return (((row ^ col) & spacing(row, col)) != 0) * 1


def level(row: Integers, col: Integers, n: Integers) -> Integers:
    """The level of the top triangles: 0 for the root … 2n − 1; even for squares, odd for edges."""
    return 2 * (n - 1 - octave(row, col)) + kind(row, col)


def is_diamond(row: Integers, col: Integers, n: Integers) -> Integers:
    """Whether (row, col) lies in the square 0 … 2^n and is none of its corners."""
    N = 1 << n
    return ((row | col | (N - row) | (N - col)) >= 0) & (((row | col) & (N - 1)) != 0)


def or_none(row: Integers, col: Integers, present: Integers) -> Point:
    """(row, col) where ``present``, elsewhere (−1, −1)."""
    return (row + 1) * present - 1, (col + 1) * present - 1


def top(row: Integers, col: Integers, k: Integers) -> Triangle:
    """Top triangle k, 0 or 1, as (x, y, L, ω): ω is 0 … 3 for k = 0 (apex W, NW, N or NE) and 4 more for k = 1.

    One of the two lies outside the square if an edge is on the border (``triangles.inside`` tells).
    """
    odd = 1 - kind(row, col)
    L = spacing(row, col) << odd
    return col, row, L, triangles.axis(col, row, L, odd) + 4 * k


def apex(row: Integers, col: Integers, k: Integers) -> Point:
    """(row, col) of p (k = 0) or q (k = 1): the apex of top triangle k, opposite the hypotenuse; may lie outside."""
    x, y = triangles.apex(*top(row, col, k))
    return y, x


def end(row: Integers, col: Integers, k: Integers) -> Point:
    """(row, col) of a (k = 0) or b (k = 1), an end of the hypotenuse: the left end of top triangle k.

    p, a, q, b run counter-clockwise on the map around the region.
    """
    x, y = triangles.left_end(*top(row, col, k))
    return y, x


def of_triangle(x: Integers, y: Integers, L: Integers, omega: Integers) -> Point:
    """(row, col) of the diamond of which this triangle is a top; none for a finest triangle."""
    mask = -triangles.is_finest(L, omega)  # all bits of −1, or none
    return y | mask, x | mask


def parent(row: Integers, col: Integers, k: Integers, n: Integers) -> Point:
    """(row, col) of parent k, 0 or 1: the diamond of which top triangle k is part of the bottom.

    None where that triangle is outside the square, and for the root.
    """
    r, c = apex(row, col, k)
    return or_none(r, c, is_diamond(r, c, n))


def child(row: Integers, col: Integers, k: Integers, n: Integers) -> Point:
    """(row, col) of child k, 0 … 3: its top triangles are in this diamond's bottom.

    Child k splits triangle k of the bottom, the left (k even) or right child of top triangle k // 2. None where that is
    outside the square, and for edges of octave 0.
    """
    x, y, L, omega = top(row, col, k >> 1)
    r, c = of_triangle(*triangles.child(x, y, L, omega, k & 1))
    return or_none(r, c, (r >= 0) & triangles.inside(x, y, L, omega, n))


FORMULAS = (spacing, octave, kind, level, is_diamond, or_none, top, apex, end, of_triangle, parent, child)
"""What kernels may call (see ``orograph.hierarchy.kernels``)."""


def of_level(n: int, level: int) -> tuple[IndexArray, IndexArray]:
    """All diamonds of a level: two int64 arrays, row and col.

    Squares by rows; then, for odd levels, the edges along columns by rows, and the edges along rows by rows.

    Args:
        n: exponent of the square's side 2^n.
        level: 0 … 2n − 1.

    Raises:
        UsageError: there is no such level.
    """
    if not 0 <= level < 2 * n:
        raise UsageError(f"A square of side 2^{n} has diamonds of levels 0 to {2 * n - 1}, not {level}.")
    s = 1 << (n - 1 - level // 2)
    odd = np.arange(s, (1 << n) + 1, 2 * s, dtype=np.int64)
    even = np.arange(0, (1 << n) + 1, 2 * s, dtype=np.int64)
    pairs = [(odd, odd)] if level % 2 == SQUARE else [(odd, even), (even, odd)]
    rows, cols = zip(*(np.meshgrid(r, c, indexing="ij") for r, c in pairs))
    return np.concatenate([r.ravel() for r in rows]), np.concatenate([c.ravel() for c in cols])


def exponent_of(active: NDArray[np.bool_]) -> int:
    """The n of an array of one entry per vertex, (2^n + 1, 2^n + 1).

    Raises:
        UsageError: it has another shape.
    """
    n = max(active.shape[0] - 1, 1).bit_length() - 1 if active.ndim == 2 else 0
    if active.shape != ((1 << n) + 1, (1 << n) + 1):
        raise UsageError(f"One entry per vertex makes an array of (2^n + 1)² entries, not {active.shape}.")
    return n


def closure(active: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which vertices must be present if the ``active`` ones are: these and all their ancestors in the DAG.

    Args:
        active: (2^n + 1, 2^n + 1) bool, one entry per vertex; those of the four corners mean nothing and are kept.

    Returns: a new array of the same shape.

    Raises:
        UsageError: the shape is not (2^n + 1)².
    """
    n, closed = exponent_of(active), active.copy()
    for at in range(2 * n - 1, 0, -1):  # from the finest level, so that each passes on what it has received
        rows, cols = of_level(n, at)
        wanted = closed[rows, cols]
        for k in (0, 1):
            r, c = parent(rows[wanted], cols[wanted], k, n)
            closed[r[r >= 0], c[r >= 0]] = True
    return closed


def is_closed(active: NDArray[np.bool_]) -> bool:
    """Whether all parents of ``active`` vertices are active; the array as for ``closure``."""
    return bool(np.array_equal(closure(active), active))


def ancestors(row: ArrayLike, col: ArrayLike, n: int) -> tuple[IndexArray, IndexArray]:
    """The diamonds (row, col) and all their ancestors, each once, by level, within a level by row and col.

    For squares too large for an array of one entry per vertex; the cost grows with the result.

    Args:
        row, col: integers, broadcast against each other.
        n: exponent of the square's side 2^n, at most 30.

    Returns: two int64 arrays, row and col.

    Raises:
        UsageError: one of them is no diamond of that square.
    """
    rows, cols = (np.ravel(v).astype(np.int64) for v in np.broadcast_arrays(row, col))
    outside = ~is_diamond(rows, cols, n)
    if outside.any():
        first = int(np.argmax(outside))
        raise UsageError(f"There is no diamond at row {rows[first]}, column {cols[first]} of a square of side 2^{n}.")
    depth, found = level(rows, cols, n), []
    carried: IndexArray = np.empty((0, 2), np.int64)
    for at in range(2 * n - 1, -1, -1):
        here = np.stack([rows[depth == at], cols[depth == at]], axis=1)
        mine = level(carried[:, 0], carried[:, 1], n) == at
        here = np.unique(np.concatenate([here, carried[mine]]), axis=0)
        found.append(here)
        above = [np.stack(parent(here[:, 0], here[:, 1], k, n), axis=1) for k in (0, 1)]
        carried = np.concatenate([carried[~mine], *(p[p[:, 0] >= 0] for p in above)])
    everything = np.concatenate([np.empty((0, 2), np.int64), *reversed(found)])
    return everything[:, 0], everything[:, 1]
