"""Triangles (l, L, ω) and diamonds: the lecture's index arithmetic, corrected.

Lecture *Terrain Visualization*, slides *Implementation – Triangle Representation* and *– Navigation*; the hierarchy is
that of Duchaineau et al. 1997 (ROAM). A square of 2^n cells a side is cut into two right triangles, and every triangle
is split from its apex to the middle of its hypotenuse. A triangle is its *diamond point* l = (x, y), the middle of its
hypotenuse; its extent L along a coordinate axis; and ω = 0 … 7, where its apex lies as seen from l: W, NW, N, NE, E,
SE, S, SW. Units are samples, x counts columns, y rows, *downwards*. ω is taken modulo 8.

Corrected:

- *Children.* Printed: l + v(L/2, ω + 4) and l + v(L/2, ω + 6). Right: l + v(L′, ω + 3) and l + v(L′, ω + 5), with the
  printed L′ and ω′. For the root ((4, 4), 8, 3) of 8 × 8 cells, the north-eastern half, the left child's l is (4, 0),
  the middle of the northern leg. Printed: (6, 2), of which a corner, (10, 2), lies outside the square.
- *The sibling* is undefined on the border of the square for even ω only. Printed: wherever l has a coordinate 0 or N.

The finest triangles are halves of cells: L = 1, ω odd, and l is the middle of a cell, no sample.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

Vertex = tuple[int, int]
"""(x, y): column and row of a sample."""


class Triangle(NamedTuple):
    """(l, L, ω), with l = (x, y); x and y are whole numbers but for the finest triangles."""

    x: float
    y: float
    L: int
    omega: int

    @property
    def diamond(self) -> Vertex:
        """l as a vertex, which names the diamond that the triangle is a top of; the finest have none."""
        return int(self.x), int(self.y)


def v(L: float, omega: int) -> tuple[float, float]:
    """The vector from the apex to l."""
    h = L / 2
    return ((L, 0), (h, h), (0, L), (-h, h), (-L, 0), (-h, -h), (0, -L), (h, -h))[omega % 8]


def moved(t: Triangle, direction: int) -> Vertex:
    """l + v(L, direction): a corner."""
    dx, dy = v(t.L, direction)
    return int(t.x + dx), int(t.y + dy)


def apex(t: Triangle) -> Vertex:
    """The corner with the right angle: l − v(L, ω)."""
    return moved(t, t.omega + 4)


@cache
def corners(t: Triangle) -> tuple[Vertex, Vertex, Vertex]:
    """The apex, and the left and right end of the hypotenuse (left and right with the apex on top)."""
    return apex(t), moved(t, t.omega + 2), moved(t, t.omega - 2)


def child(t: Triangle, omega: int) -> Triangle:
    """The half whose apex is l and whose ω is given: leftChild has ω + 3, rightChild ω + 5."""
    L = t.L if t.omega % 2 == 0 else t.L // 2
    dx, dy = v(L, omega)
    return Triangle(t.x + dx, t.y + dy, L, omega % 8)


def children(t: Triangle) -> tuple[Triangle, Triangle]:
    """leftChild and rightChild."""
    return child(t, t.omega + 3), child(t, t.omega + 5)


def is_finest(t: Triangle) -> bool:
    """Whether the triangle is half a cell, and never split."""
    return t.L == 1 and t.omega % 2 == 1


def level(t: Triangle, n: int) -> int:
    """0 for the two roots … 2n for halves of cells."""
    return 2 * (n - t.L.bit_length() + 1) - (1 - t.omega % 2)


def roots(n: int) -> tuple[Triangle, Triangle]:
    """The north-eastern and the south-western half of the square."""
    half = 2**n / 2
    return Triangle(half, half, 2**n, 3), Triangle(half, half, 2**n, 7)


def diamond_top_sibling(t: Triangle, n: int) -> Triangle | None:
    """The triangle of the same level across the hypotenuse: (l, L, ω + 4); None if that is beyond the square."""
    sibling = Triangle(t.x, t.y, t.L, (t.omega + 4) % 8)
    return sibling if all(0 <= c <= 2**n for c in apex(sibling)) else None


def parent(t: Triangle, n: int) -> Triangle | None:
    """The triangle that this one is a half of: the top of the diamond at its apex that has it as a child."""
    return next((p for p in top(apex(t), n) if t in children(p)), None)


@cache
def top(diamond: Vertex, n: int) -> tuple[Triangle, ...]:
    """The one or two triangles over a diamond point, which are split together; none for the corners of the square."""
    (x, y), N = diamond, 2**n
    if x % N == 0 and y % N == 0:
        return ()
    s = (x | y) & -(x | y)  # the largest power of two that divides both
    if x // s % 2 and y // s % 2:  # a square whose diagonal is cut; the cuts of neighbouring squares are mirrored
        L, omega = 2 * s, 3 if x // (2 * s) % 2 == y // (2 * s) % 2 else 1
    else:  # a square on its corner around an edge along the axis in which s goes an odd number of times
        L, omega = s, 2 if x // s % 2 else 0
    first = Triangle(x, y, L, omega)
    second = diamond_top_sibling(first, n)
    inside = all(0 <= c <= N for c in apex(first))
    return (first,) * inside + ((second,) if second else ())


def bottom(diamond: Vertex, n: int) -> list[Triangle]:
    """What a diamond's top becomes when it is split: the two or four triangles whose apex is its point."""
    return [half for t in top(diamond, n) for half in children(t)]


def parents(diamond: Vertex, n: int) -> list[Vertex]:
    """The diamonds that must be split before this one can be: those at the apexes of its top."""
    return [apex(t) for t in top(diamond, n) if top(apex(t), n)]


def diamond_children(diamond: Vertex, n: int) -> list[Vertex]:
    """C_i: the diamonds of which this one is a parent."""
    return [t.diamond for t in bottom(diamond, n) if not is_finest(t)]


def diamonds(n: int) -> Iterator[Vertex]:
    """All diamonds, the coarsest first: children come after their parents."""
    level_of = [roots(n)[0].diamond] if n else []
    while level_of:
        yield from level_of
        level_of = sorted({child for diamond in level_of for child in diamond_children(diamond, n)})
