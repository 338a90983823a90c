"""The clip stack: nested windows of a pyramid's levels, fine around a place, coarse far away.

Level k of a pyramid holds every 2^k-th sample of the raster (or the mean of 2^k × 2^k samples). A window is a rectangle
of one level's samples; a stack is a list of windows, outermost (coarsest) first, each inside the one before. What a
window shows beside the next finer one is its ring, what the finer one shows instead is the ring's hole. Rays, light and
void fill look the ground up in such stacks; clipmaps draw them (Tanner, Migdal & Jones 1998; Losasso & Hoppe 2004).

Index arithmetic only: shapes of levels come from a function of the level, (rows, cols).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

Shapes = Callable[[int], tuple[int, int]]


class Rectangle(NamedTuple):
    """Samples ``[row0, row1) × [col0, col1)`` of a level."""

    level: int
    row0: int
    row1: int
    col0: int
    col1: int

    @classmethod
    def whole(cls, level: int, shape: tuple[int, int]) -> Rectangle:
        """All samples of a level of this shape."""
        return cls(level, 0, shape[0], 0, shape[1])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.row1 - self.row0, self.col1 - self.col0

    @property
    def samples(self) -> int:
        return (self.row1 - self.row0) * (self.col1 - self.col0)

    def around(self, level: int) -> Rectangle:
        """The fewest samples of a coarser level whose cells hold this window."""
        k = level - self.level
        return Rectangle(
            level, self.row0 >> k, -(-(self.row1 - 1) >> k) + 1, self.col0 >> k, -(-(self.col1 - 1) >> k) + 1
        )

    def inside(self, level: int) -> Rectangle:
        """The most samples of a coarser level whose cells lie within this window; there may be none."""
        k = level - self.level
        return Rectangle(
            level, -(-self.row0 >> k), ((self.row1 - 1) >> k) + 1, -(-self.col0 >> k), ((self.col1 - 1) >> k) + 1
        )

    def grown(self, samples: int) -> Rectangle:
        """The window grown by a number of samples on every side."""
        return Rectangle(self.level, self.row0 - samples, self.row1 + samples, self.col0 - samples, self.col1 + samples)

    def joined(self, other: Rectangle) -> Rectangle:
        """The smallest window that holds this one and another of its level."""
        return Rectangle(
            self.level, min(self.row0, other.row0), max(self.row1, other.row1),
            min(self.col0, other.col0), max(self.col1, other.col1),
        )  # fmt: skip

    def cut(self, shape: tuple[int, int], *, least: int = 1, even: bool = False) -> Rectangle:
        """What of it lies within a level of this shape, at least ``least`` samples each way if there are so many.

        Args:
            even: begin at an even row and column, so that the diagonals of its cells are the raster's.
        """
        sides: list[int] = []
        for first, end, most in ((self.row0, self.row1, shape[0]), (self.col0, self.col1, shape[1])):
            first = max(min(first, most - least), 0)
            first -= first % 2 if even else 0
            sides += [first, max(min(end, most), min(first + least, most))]
        return Rectangle(self.level, *sides)

    def covers(self, outer: Rectangle, shape: tuple[int, int]) -> bool:
        """Whether nothing of a coarser window around it shows.

        Args:
            shape: of this window's level: a coarser level may reach a cell farther than the raster does.
        """
        k = outer.level - self.level
        last_row, last_col = min((outer.row1 - 1) << k, shape[0] - 1), min((outer.col1 - 1) << k, shape[1] - 1)
        begins = self.row0 <= outer.row0 << k and self.col0 <= outer.col0 << k
        return begins and self.row1 - 1 >= last_row and self.col1 - 1 >= last_col


@dataclass(frozen=True, slots=True)
class Ring:
    """What is shown of one window.

    Attributes:
        where: its samples. hole: what finer windows show, in this level's samples, (first row, last row, first column,
            last column); None of the finest.
    """

    where: Rectangle
    hole: tuple[int, int, int, int] | None

    def open_sides(self) -> tuple[bool, bool, bool, bool]:
        """On which sides of its hole (first row, last row, first column, last column) the ring goes on."""
        if self.hole is None:
            return False, False, False, False
        r, (a, b, c, d) = self.where, self.hole
        return a > r.row0, b < r.row1 - 1, c > r.col0, d < r.col1 - 1


class ClipStack(tuple[Rectangle, ...]):
    """Windows, outermost first, each inside the one before."""

    __slots__ = ()

    @property
    def samples(self) -> int:
        """Of all windows together."""
        return sum(window.samples for window in self)

    def rings(self) -> tuple[Ring, ...]:
        """What is shown of each window, outermost first."""
        holes = [_sides(inner.around(outer.level)) for outer, inner in pairwise(self)]
        return tuple(Ring(window, hole) for window, hole in zip(self, [*holes, None], strict=True))

    def visible(self, shape: Shapes) -> ClipStack:
        """The stack without the windows that a finer one hides."""
        hidden = {outer for outer, inner in pairwise(self) if inner.covers(outer, shape(inner.level))}
        return ClipStack(window for window in self if window not in hidden)

    def filled(self, shape: Shapes, levels: int, margin: int) -> ClipStack:
        """The stack with a window of every level, from its finest to one that holds the whole raster.

        Each holds what the stack has of its level and reaches ``margin`` of its samples beyond the finer one in it;
        windows begin at even samples and are at least 2 × 2.

        Args:
            levels: of the pyramid.
        """
        wanted = {window.level: window for window in self}
        out: list[Rectangle] = []
        for level in range(self[-1].level, levels):
            inner = out[-1].around(level).grown(margin) if out else wanted[level]
            window = inner.joined(wanted.get(level, inner)).cut(shape(level), least=2, even=True)
            out.append(window)
            if window == Rectangle.whole(level, shape(level)):
                break
        return ClipStack(reversed(out))


def _sides(window: Rectangle) -> tuple[int, int, int, int]:
    """The first and the last row and column of a window."""
    return window.row0, window.row1 - 1, window.col0, window.col1 - 1
