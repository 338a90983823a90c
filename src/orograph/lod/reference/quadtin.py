"""QuadTIN (Pajarola, Antonijuan & Lario 2002), in plain Python: exact numbers, no lattice, no saturation, no strip.

The hierarchy: two triangles over a rectangle. A triangle (left, right, apex) is split at a point of its base together
with the triangle across the base: the vertex of the truth nearest to the base's middle from which all corners of the
two are seen, with no half smaller than ``LEAST`` of its share; else the middle, as high as the truth is there. If the
triangle across has another base it is split first. A triangle is split if the truth is further from it than ``finest``.

The mesh of a view: ``drawn`` asks of each vertex whether it is active, and what depends on none that is not is drawn.
Coordinates are Fractions; the truth is a list of triangles of points (x, y, z).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction

Point = tuple[Fraction, Fraction, Fraction]
Face = tuple[Point, Point, Point]
LEAST = Fraction(1, 4)


def turn(a: Point, b: Point, c: Point) -> Fraction:
    """Twice the signed area."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def height(face: Face, p: Point) -> Fraction:
    """Of the plane of a face over a place."""
    a, b, c = face
    return (turn(b, c, p) * a[2] + turn(c, a, p) * b[2] + turn(a, b, p) * c[2]) / turn(a, b, c)


def covers(face: Face, p: Point) -> bool:
    """Whether a place is in a face."""
    a, b, c = face
    return min(turn(a, b, p), turn(b, c, p), turn(c, a, p)) >= 0


def crossing(a: Point, b: Point, c: Point, d: Point) -> Point | None:
    """Where two sides cross, on the first; None where they do not, or lie on one line."""
    u, v, w, x = turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)
    if u * v >= 0 or w * x > 0:
        return None
    t = w / (w - x)
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])


@dataclass(eq=False)
class Triangle:
    """A triangle of the hierarchy: positive area; ``beside``: across the base, (right, apex), (apex, left)."""

    left: Point
    right: Point
    apex: Point
    beside: list[Triangle | None] = field(default_factory=lambda: [None] * 3)
    children: tuple[Triangle, Triangle] | None = None
    node: Point | None = None

    @property
    def face(self) -> Face:
        return self.left, self.right, self.apex


class QuadTin:
    """The hierarchy over a rectangle from (0, 0) to (width, height).

    Args:
        truth: faces of positive area that cover the rectangle. finest: how far triangles may be off.
    """

    def __init__(self, truth: list[Face], width: int, height_: int, finest: float) -> None:
        self.truth, self.finest = truth, Fraction(finest)
        self.points = list(dict.fromkeys(p for face in truth for p in face))
        places = [(0, 0), (width, 0), (width, height_), (0, height_)]
        a, b, c, d = (self.on_truth(Fraction(x), Fraction(y)) for x, y in places)
        self.roots = Triangle(c, a, b), Triangle(a, c, d)
        self.roots[0].beside[0], self.roots[1].beside[0] = self.roots[1], self.roots[0]
        waiting = list(self.roots)
        while waiting:
            t = waiting.pop(0)
            if t.children is None and (t in self.roots or self.error(t) > self.finest):
                waiting += self.split(t)

    def on_truth(self, x: Fraction, y: Fraction) -> Point:
        """The point of the truth over a place."""
        at = x, y, Fraction(0)
        return x, y, next(height(face, at) for face in self.truth if covers(face, at))

    def error(self, t: Triangle) -> Fraction:
        """The largest deviation of the truth from a triangle: at its vertices, and where its sides cross the others."""
        sides = [(t.left, t.right), (t.right, t.apex), (t.apex, t.left)]
        off = [abs(height(t.face, p) - p[2]) for p in self.points if covers(t.face, p)]
        for face in self.truth:
            for c, d in zip(face, face[1:] + face[:1]):
                met = [crossing(a, b, c, d) for a, b in sides]
                off += [abs(height(face, p) - p[2]) for p in met if p is not None]
        return max(off, default=Fraction(0))

    def split(self, t: Triangle) -> list[Triangle]:
        """Split a triangle, and first what has to be; all that is new."""
        other, new = t.beside[0], []
        if other is not None and other.beside[0] is not t:
            new = self.split(other)
            other = t.beside[0]
        m = self.node(t, other)
        new += self.halve(t, m)
        if other is not None:
            new += self.halve(other, m)
            assert t.children is not None and other.children is not None
            t.children[0].beside[1], other.children[1].beside[2] = other.children[1], t.children[0]
            t.children[1].beside[2], other.children[0].beside[1] = other.children[0], t.children[1]
        return new

    def node(self, t: Triangle, other: Triangle | None) -> Point:
        """Where a diamond is split."""
        x, y = (t.left[0] + t.right[0]) / 2, (t.left[1] + t.right[1]) / 2
        ways = [t] if other is None else [t, other]

        def fits(p: Point) -> bool:
            if other is None and turn(t.left, t.right, p) != 0:
                return False
            halves = [(turn(w.apex, w.left, p), turn(w.right, w.apex, p), turn(*w.face)) for w in ways]
            return all(min(a, b) > 0 and min(a, b) >= LEAST * whole / 2 for a, b, whole in halves)

        near = sorted(self.points, key=lambda p: ((p[0] - x) ** 2 + (p[1] - y) ** 2, p[1], p[0]))
        return next((p for p in near if fits(p)), None) or self.on_truth(x, y)

    def halve(self, t: Triangle, m: Point) -> list[Triangle]:
        one, two = Triangle(t.apex, t.left, m), Triangle(t.right, t.apex, m)
        t.node, t.children = m, (one, two)
        one.beside, two.beside = [t.beside[2], None, two], [t.beside[1], one, None]
        for child in (one, two):
            if (far := child.beside[0]) is not None:
                far.beside[far.beside.index(t)] = child
        return [one, two]

    def drawn(self, active: Callable[[Point], bool]) -> Iterator[Face]:
        """The triangles of a mesh, in the order of the curve."""

        def walk(t: Triangle, forward: bool) -> Iterator[Face]:
            if t.children is None or t.node is None or not active(t.node):
                yield t.face
                return
            for child in t.children if forward else t.children[::-1]:
                yield from walk(child, not forward)

        for root in self.roots:
            yield from walk(root, True)
