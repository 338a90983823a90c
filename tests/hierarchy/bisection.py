"""The hierarchy of right triangles by geometry alone: corners, longest edges and midpoints; no index arithmetic.

Points are (x, y), y downwards. A triangle is (apex, left, right): the corner with the right angle, and the ends of the
hypotenuse such that the three run counter-clockwise on the map (y upwards there).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache

import numpy as np

Point = tuple[int, int]
Corners = tuple[Point, Point, Point]


def cross(a, b, c):
    """Twice the area of abc; positive if counter-clockwise on the map."""
    return (c[0] - a[0]) * (b[1] - a[1]) - (b[0] - a[0]) * (c[1] - a[1])


def right_triangle(points) -> Corners:
    """(apex, left, right) of three points in any order."""

    def opposite(p):
        q, r = (o for o in points if o != p)
        return (q[0] - r[0]) ** 2 + (q[1] - r[1]) ** 2

    apex = max(points, key=opposite)
    a, b = (p for p in points if p != apex)
    return (apex, a, b) if cross(apex, a, b) > 0 else (apex, b, a)


def midpoint(a, b) -> Point:
    x, y = Fraction(a[0] + b[0], 2), Fraction(a[1] + b[1], 2)
    assert x.denominator == y.denominator == 1, "not a sample"
    return int(x), int(y)


def halves(t: Corners) -> tuple[Corners, Corners]:
    """The two halves of a triangle cut from its apex to its hypotenuse: that at the left end, that at the right end."""
    apex, left, right = t
    middle = midpoint(left, right)
    return right_triangle([apex, left, middle]), right_triangle([apex, right, middle])


def roots(n: int) -> tuple[Corners, Corners]:
    """The north-eastern and the south-western half of the square."""
    N = 1 << n
    return right_triangle([(0, 0), (N, 0), (N, N)]), right_triangle([(0, 0), (0, N), (N, N)])


@dataclass(eq=False)
class Node:
    corners: Corners
    level: int
    parent: Node | None = None
    halves: list[Node] = field(default_factory=list)

    def edges(self) -> list[frozenset[Point]]:
        """Hypotenuse, left leg, right leg."""
        apex, left, right = self.corners
        return [frozenset((left, right)), frozenset((apex, left)), frozenset((apex, right))]


@cache
def hierarchy(n: int) -> list[list[Node]]:
    """All triangles by level, the left half before the right one."""
    levels = [[Node(corners, 0) for corners in roots(n)]]
    for at in range(1, 2 * n + 1):
        for node in levels[-1]:
            node.halves = [Node(half, at, node) for half in halves(node.corners)]
        levels.append([half for node in levels[-1] for half in node.halves])
    return levels


SCALE = 6
INNER = np.array([(3, 1), (5, 3), (3, 5), (1, 3)])


def points(n: int) -> np.ndarray:
    """Four points in each cell, (cells · 4, 2), in sixths of a sample: one between its diagonals on each side."""
    N = 1 << n
    corner = SCALE * np.stack(np.meshgrid(np.arange(N), np.arange(N)), -1).reshape(-1, 1, 2)
    return (corner + INNER).reshape(-1, 2)


def covers(t, where: np.ndarray) -> np.ndarray:
    """Which of the points (in sixths of a sample) lie in the triangle; none may lie on an edge."""
    a, b, c = (tuple(SCALE * int(v) for v in p) for p in t)
    sides = [cross(p, q, where.T) for p, q in ((a, b), (b, c), (c, a))]
    assert all((side != 0).all() for side in sides)
    return (sides[0] > 0) & (sides[1] > 0) & (sides[2] > 0)


def coverage(triangles, n: int) -> np.ndarray:
    """How many of the triangles lie on each of ``points(n)``."""
    where = points(n)
    return sum((covers(t, where).astype(int) for t in triangles), np.zeros(len(where), int))


def area(t) -> Fraction:
    return Fraction(cross(*t), 2)


def inside_edge(v: Point, a: Point, b: Point) -> bool:
    """Whether v lies on the segment ab, but not at an end."""
    on_line = (b[0] - a[0]) * (v[1] - a[1]) == (b[1] - a[1]) * (v[0] - a[0])
    along = (v[0] - a[0]) * (b[0] - a[0]) + (v[1] - a[1]) * (b[1] - a[1])
    return on_line and 0 < along < (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2
