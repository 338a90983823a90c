"""CDLOD's selection as it is printed (Strugar 2009, ``LODSelect``), and how far a vertex has slid.

Squares are (p, row, col), of side 2^p with the upper left corner (row, col) in samples; those of level l have
p = exponent + l.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

Square = tuple[int, int, int]


@dataclass
class Selection:
    """The quarters of squares that are drawn, each with its level.

    Args:
        exponent: of the cells along a side of the grid. ranges: by level.
        within: whether a square's box meets the sphere of a range. seen: whether it is in view.
        on_ground: whether a square has a cell of the raster.
    """

    exponent: int
    ranges: Sequence[float]
    within: Callable[[Square, float], bool]
    seen: Callable[[Square], bool]
    on_ground: Callable[[Square], bool]
    quarters: set[tuple[Square, int]] = field(default_factory=set)

    def select(self, square: Square) -> bool:
        """Select a square, or squares below it; False: its parent has to cover its area."""
        level = square[0] - self.exponent
        if not self.within(square, self.ranges[level]):
            return False
        if not self.seen(square):
            return True  # (nothing of it is drawn, and its parent need not be)
        if level == 0 or not self.within(square, self.ranges[level - 1]):
            self._add(quarters(square), level)
            return True
        for child in filter(self.on_ground, quarters(square)):
            if not self.select(child):
                self._add([child], level)
        return True

    def _add(self, parts: list[Square], level: int) -> None:
        self.quarters |= {(part, level) for part in parts if self.on_ground(part)}


def quarters(square: Square) -> list[Square]:
    """The four squares that a square consists of."""
    p, row, col = square
    half = 1 << (p - 1)
    return [(p - 1, row + i, col + j) for i in (0, half) for j in (0, half)]


def slid(distance: float, begin: float, end: float, start: float) -> float:
    """How far vertices of odd number have slid to the even ones before them: 0 to 1.

    Args:
        distance: from the eye. begin, end: of the level's range. start: the part of it after which they slide.
    """
    first = begin + start * (end - begin)
    return min(max((distance - first) / (end - first), 0.0), 1.0)
