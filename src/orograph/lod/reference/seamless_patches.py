"""Seamless patches, edge by edge and patch by patch (Livny, Kogan & El-Sana 2009).

What decides is given: ``wanted(edge)``, the exponent of the spacing that an edge asks for, and ``seen(square)``.
Squares are (p, row, col), of side 2^p with the upper left corner (row, col) in samples; edges are (p, row, col,
across), of length 2^p from (row, col), along the row or down the column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

Square = tuple[int, int, int]
Edge = tuple[int, int, int, bool]
Point = tuple[int, int]


@dataclass
class Quadtree:
    """The squares and spacings of a view.

    Args:
        shape: of the raster. n: the exponent of the root's side. big: that of the segments a patch has at most.
        wanted: the spacing of an edge. seen: whether a square is in view.
    """

    shape: tuple[int, int]
    n: int
    big: int
    wanted: Callable[[Edge], int]
    seen: Callable[[Square], bool]
    split: set[Square] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._refine((self.n, 0, 0))
        for square in sorted(self.split):  # small ones first
            self._balance(square)

    def _refine(self, square: Square) -> None:
        p = square[0]
        if p == self.big or not self.seen(square):
            return
        if any(self.wanted(edge) < p - self.big for edge in edges(square)):
            self.split.add(square)
            for child in self._children(square):
                self._refine(child)

    def _balance(self, square: Square) -> None:
        """The squares around one that is split are there, and so is it."""
        self.split.add(square)
        if square[0] < self.n:
            for other in (square, *filter(self.on_ground, beside(square))):
                if parent(other) not in self.split:
                    self._balance(parent(other))

    def on_ground(self, square: Square) -> bool:
        """Whether it has a cell of the raster."""
        _, row, col = square
        return 0 <= row < self.shape[0] - 1 and 0 <= col < self.shape[1] - 1

    def _children(self, square: Square) -> list[Square]:
        p, row, col = square
        half = 1 << (p - 1)
        found = [(p - 1, row + i, col + j) for i in (0, half) for j in (0, half)]
        return [child for child in found if self.on_ground(child)]

    def leaves(self, square: Square | None = None) -> Iterator[Square]:
        """The squares that are drawn."""
        square = (self.n, 0, 0) if square is None else square
        if square in self.split:
            for child in self._children(square):
                yield from self.leaves(child)
        elif self.seen(square):
            yield square

    def spacing(self, square: Square, side: int) -> int:
        """The exponent of the spacing along a side (above, right, below, left) of a leaf."""
        p = square[0]
        edge, other = edges(square)[side], beside(square)[side]
        if other in self.split:
            found = min(self.wanted(edge), p - 2)
        elif p < self.n and self.on_ground(other) and parent(other) not in self.split:
            _, row, col, across = edge
            even = 2 << p
            whole = (p + 1, row // even * even, col // even * even, across)  # the larger square's edge
            found = min(self.wanted(whole), p - 1)
        else:
            found = min(self.wanted(edge), p - 1)
        return max(found, p - self.big)


def edges(square: Square) -> list[Edge]:
    """Above, to the right, below, to the left."""
    p, row, col = square
    side = 1 << p
    return [(p, row, col, True), (p, row, col + side, False), (p, row + side, col, True), (p, row, col, False)]


def beside(square: Square) -> list[Square]:
    """The squares of the same size above, to the right, below and to the left."""
    p, row, col = square
    side = 1 << p
    return [(p, row - side, col), (p, row, col + side), (p, row + side, col), (p, row, col - side)]


def parent(square: Square) -> Square:
    """The square that it is a quarter of."""
    p, row, col = square
    return p + 1, row >> (p + 1) << (p + 1), col >> (p + 1) << (p + 1)


def vertices(square: Square, spacings: list[int]) -> set[Point]:
    """The vertices along a patch's edges."""
    found = set()
    for (p, row, col, across), k in zip(edges(square), spacings, strict=True):
        for step in range(0, (1 << p) + 1, 1 << k):
            found.add((row, col + step) if across else (row + step, col))
    return found
