"""The restricted quadtree: squares, their neighbours, and three ways to cut them into triangles.

Pajarola & Gobbetti 2007, *Survey*, figures 4 and 7, after Von Herzen & Barr 1987 (neighbours differ by one level at
most; eight triangles a square), Sivan & Samet 1992 (four) and Pajarola 1998 (saturated errors choose a closed set of
vertices). What chooses squares was worked out: **a square is split if, at one of its sides, a quarter of it or of the
square next door is inaccurate**. Quarters and middles of sides are diamonds, and the parents of inaccurate diamonds are
inaccurate. So the square itself is, a quarter of the next larger one; at both sides of that one at which it lies, the
larger squares are split on either side. On all four sides there is a square of the same size. Decided, too:

- A middle is inserted where it is inaccurate, though no smaller square is next to it. ``by_sides`` is as in print: the
  square is split then. But for the smallest squares, of 2 × 2 cells, for the centre of a square must be a sample.
- A side on the border of the terrain borders nothing larger.
- Unrestricted squares are cut where the hierarchy of right triangles cuts them: from the corner that they share with
  the next larger square.

(x, y): column and row of a sample, y downwards; units are samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from orograph.lod.reference.children import Vertex, diamond_children
from orograph.lod.reference.criterion import Spheres

Corners = tuple[Vertex, Vertex, Vertex]


class Square(NamedTuple):
    """A square by its centre and half its side, a power of two."""

    x: int
    y: int
    s: int

    @property
    def corners(self) -> list[Vertex]:
        """NW, NE, SE, SW."""
        x, y, s = self
        return [(x - s, y - s), (x + s, y - s), (x + s, y + s), (x - s, y + s)]

    @property
    def middles(self) -> list[Vertex]:
        """Of its sides: N, E, S, W. Side i goes from corner i to corner i + 1."""
        x, y, s = self
        return [(x, y - s), (x + s, y), (x, y + s), (x - s, y)]

    @property
    def children(self) -> list[Square]:
        """Child i lies at corner i."""
        return [Square((self.x + x) // 2, (self.y + y) // 2, self.s // 2) for x, y in self.corners]

    @property
    def parent(self) -> Square:
        """The square of which it is a quarter."""
        x, y = (c + self.s if c // self.s % 4 == 1 else c - self.s for c in (self.x, self.y))
        return Square(x, y, 2 * self.s)

    def neighbour(self, side: int) -> Square:
        """The square of the same size across a side, perhaps outside."""
        x, y = self.middles[side]
        return Square(2 * x - self.x, 2 * y - self.y, self.s)


class Quadtree:
    """The squares of a terrain of 2^n cells a side, n at least 1; ``inaccurate``: of diamonds, monotonic. (A square
    without ground is accurate, whatever its sides say.)"""

    def __init__(self, n: int, inaccurate: Callable[[Vertex], bool], by_sides: bool = False) -> None:
        self.n, self.inaccurate, self.by_sides = n, inaccurate, by_sides
        self.root = Square(2**n // 2, 2**n // 2, 2**n // 2)

    def is_split(self, square: Square) -> bool:
        """Whether a square that is there has children."""
        if square.s == 1 or not self.inaccurate((square.x, square.y)):
            return False
        quarters = (diamond_children(m, self.n) for m in square.middles if self.inaccurate(m))
        return any(self.by_sides or any(map(self.inaccurate, at_side)) for at_side in quarters)

    def is_there(self, square: Square) -> bool:
        """Whether a square is one of the tree, split or not."""
        is_inside = 0 < square.x < 2**self.n and 0 < square.y < 2**self.n
        return is_inside and (square == self.root or (self.is_there(square.parent) and self.is_split(square.parent)))

    def leaves(self, square: Square | None = None, e: int = 0, d: int = 1) -> Iterator[tuple[Square, int, int]]:
        """The squares that are not split, along a Hilbert curve from corner e to corner e + d, with their e and d."""
        square = self.root if square is None else square
        if not self.is_split(square):
            yield square, e % 4, d
            return
        for corner, enter, way in ((e, e, -d), (e - d, e, d), (e - 2 * d, e, d), (e + d, e + 2 * d, -d)):
            yield from self.leaves(square.children[corner % 4], enter, way)

    def has_middle(self, square: Square, side: int, restricted: bool) -> bool:
        """Whether a leaf makes two triangles at a side, not one."""
        x, y = square.middles[side]
        next_door = square.neighbour(side)
        if self.inaccurate((x, y)) or not self.is_there(next_door):
            return self.inaccurate((x, y)) or (restricted and bool({x, y} & {0, 2**self.n}))
        return restricted or self.is_split(next_door)  # eight but beside a larger square; four but beside smaller ones

    def fan(self, square: Square, restricted: bool) -> list[tuple[Vertex, Corners]]:
        """The triangles of a leaf around its centre, each with the diamond that knows whether it is to be drawn."""
        found: list[tuple[Vertex, Corners]] = []
        for i, m in enumerate(square.middles):
            a, b = square.corners[i], square.corners[(i + 1) % 4]
            ends = [(a, m), (m, b)] if self.has_middle(square, i, restricted) else [(a, b)]
            of = [square.children[k] for k in (i, (i + 1) % 4)] if square.s > 1 and self.inaccurate(m) else []
            found += [((of[k].x, of[k].y) if of else m, ((square.x, square.y), *pair)) for k, pair in enumerate(ends)]
        return found


class Alone(Quadtree):
    """Squares that know nothing of each other: each is split if its own corners, middles and centre ask for it."""

    def __init__(self, n: int, spheres: Spheres, tolerance: float) -> None:
        super().__init__(n, lambda middle: False)
        self.spheres, self.tolerance = spheres, tolerance

    def is_inaccurate(self, square: Square) -> bool:
        """Whether a square in view exceeds the tolerance, or has both ground and missing ground."""
        ground, centre = self.spheres.ground, (square.x, square.y)
        sample, e = ground[centre], ground[centre].error
        if sample.empty or self.spheres.is_out_of_view(centre):
            return False
        if e < math.inf and all(ground[corner].place == corner for corner in square.corners):
            z = [ground[corner].point[2] for corner in square.corners]
            q = self.corner_of(square)
            e = abs(sample.point[2] - (z[q] + z[(q + 2) % 4]) / 2)
            e = max(e, *(abs(ground[m].point[2] - (z[i] + z[i - 3]) / 2) for i, m in enumerate(square.middles)))
        bound, camera = self.spheres.bound, self.spheres.camera
        return bound(camera, camera.to_camera(sample.point), e, sample.radius) > self.tolerance

    def is_split(self, square: Square) -> bool:
        return square.s > 1 and self.is_inaccurate(square)

    def corner_of(self, square: Square) -> int:
        """Which child of its parent a square is."""
        return 0 if square == self.root else square.parent.children.index(square)

    def cut(self, square: Square) -> list[Corners]:
        """A leaf's two triangles; the eight of a smallest square that is inaccurate."""
        centre, c, q = (square.x, square.y), square.corners, self.corner_of(square)
        if self.is_inaccurate(square):
            around = [v for pair in zip(c, square.middles) for v in pair]
            return [(centre, a, b) for a, b in zip(around, around[1:] + around[:1])]
        return [(c[q], c[(q + 1) % 4], c[(q + 2) % 4]), (c[q], c[(q + 2) % 4], c[(q + 3) % 4])]
