"""SOAR: the mesh as one triangle strip, written by ten lines of recursion.

Lindstrom & Pascucci 2001, *Visualization of Large Terrains Made Easy*, sec. 3; lecture, slides *Implementation –
Stripification*. The errors of diamonds never grow on the way down, and their balls nest. So ``active``, the criterion,
is monotonic; each triangle decides alone, and nothing is remembered. The Sierpinski curve runs through all triangles;
the vertices that it passes make a generalised strip, in which a repeated vertex turns a corner (*swap*). Corrected:

- *submesh-refine(V, i, j, l) → inaccurate*: it returns nothing, the arrow is a slip.
- *Left and right swap at every level*: the slide says so beside the code and the code does not. c_l is the half that
  the curve enters first; it turns one way round in a triangle and the other way round in its halves. Without the swap
  the strip of 9² samples, all active, has 159 triangles, of which 64 are right; with it the 128 that there are. It has
  5/3 vertices for each of them in the limit.
- *n in mesh-refine* is the number of levels of diamonds: 2n for a square of 2^n cells a side. It is even, so that the
  parity l mod 2 of the first call is 0 and the corners' is 1.
- The start is the north-western corner here, not the south-western one: so the root is cut as the square is.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from orograph.lod.reference.children import Vertex, corners, diamond_children, diamonds, top
from orograph.lod.reference.terrain import Ground


class Strip:
    """V: the vertices so far, and the parity of the last one."""

    def __init__(self, first: Vertex) -> None:
        self.V = [first, first]
        self.parity = 0

    def tstrip_append(self, v: Vertex, p: int) -> None:
        """Append v, of a triangle of parity p, unless it is one of the last two."""
        if v != self.V[-2] and v != self.V[-1]:
            if p != self.parity:
                self.parity = p
            else:
                self.V.append(self.V[-2])
            self.V.append(v)

    def triangles(self) -> list[tuple[Vertex, Vertex, Vertex]]:
        """The triangles with area: each vertex with the two before it."""
        found = zip(self.V, self.V[1:], self.V[2:])
        return [(a, b, c) for a, b, c in found if len({a, b, c}) == 3]


def c_l(i: Vertex, j: Vertex) -> Vertex:
    """The middle of a leg of the triangle with apex i and hypotenuse around j: half-way to j, and half-way aside."""
    dx, dy = i[0] - j[0], i[1] - j[1]
    return j[0] + (dx + dy) // 2, j[1] + (dy - dx) // 2


def c_r(i: Vertex, j: Vertex) -> Vertex:
    """The middle of the other leg."""
    dx, dy = i[0] - j[0], i[1] - j[1]
    return j[0] + (dx - dy) // 2, j[1] + (dy + dx) // 2


def submesh_refine(V: Strip, i: Vertex, j: Vertex, l: int, active: Callable[[Vertex], bool]) -> None:  # noqa: E741
    """Pass through the triangle with apex i and hypotenuse around j."""
    if l > 0 and active(i):
        first, second = (c_l, c_r) if l % 2 == 0 else (c_r, c_l)
        submesh_refine(V, j, first(i, j), l - 1, active)
        V.tstrip_append(i, l % 2)
        submesh_refine(V, j, second(i, j), l - 1, active)


def mesh_refine(n: int, active: Callable[[Vertex], bool]) -> Strip:
    """The strip of a square of 2^n cells a side.

    Args:
        n: exponent of the square's side.
        active: the criterion of diamonds; it must be monotonic.
    """
    N = 2**n
    i_c, i_w, i_s, i_e, i_n = (N // 2, N // 2), (0, N // 2), (N // 2, N), (N, N // 2), (N // 2, 0)
    i_nw, i_sw, i_se, i_ne = (0, 0), (0, N), (N, N), (N, 0)
    V = Strip(i_nw)
    for j, k in ((i_w, i_sw), (i_s, i_se), (i_e, i_ne), (i_n, i_nw)):
        submesh_refine(V, i_c, j, 2 * n, active)
        V.tstrip_append(k, 1)
    return V


def nested_errors(ground: Ground) -> dict[Vertex, float]:
    """e_i: how far the vertex is from the middle of the hypotenuse, and no less than any child's; metres.

    This is the paper's error of a diamond, and no bound of what its triangles miss.
    """
    e: dict[Vertex, float] = {}
    for i in reversed(list(diamonds(ground.n))):
        e[i] = max([ground.miss(top(i, ground.n)[0]), *(e[j] for j in diamond_children(i, ground.n))])
    return e


def nested_radii(ground: Ground) -> dict[Vertex, float]:
    """r_i: that of the ball around vertex i that holds its children's; metres.

    Printed: 0 if i is a leaf. Then it does not hold its triangles, and culling leaves out some that are in view; here
    every ball holds the corners of its diamond.
    """
    r: dict[Vertex, float] = {}
    for i in reversed(list(diamonds(ground.n))):
        p_i = ground[i].point
        rim = [math.dist(p_i, ground[corner].point) for t in top(i, ground.n) for corner in corners(t)]
        r[i] = max(rim + [math.dist(p_i, ground[j].point) + r[j] for j in diamond_children(i, ground.n)])
    return r
