"""The heights of a clipmap's windows, held in arrays that are addressed toroidally and filled as the eye moves.

Sample (i, j) of a level lies at (i mod n, j mod n) of its array, so that a window that moves keeps what it had in place
and only what is new is read: an L-shaped region (Losasso & Hoppe 2004, section 4.2). Levels are filled from coarse to
fine; one that a frame's budget does not fill is late, and goes on in the next frame. Metres, samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import Rectangle
from orograph.store.terrain import Heights

Read = Callable[[Rectangle], Heights]


@dataclass(slots=True)
class Toroid:
    """The array of one level, n × n; what it holds, or None."""

    n: int
    holds: Rectangle | None = None
    data: Heights = field(init=False)

    def __post_init__(self) -> None:
        self.data = np.full((self.n, self.n), np.nan, np.float32)

    def lacks(self, window: Rectangle) -> list[Rectangle]:
        """What of a window it does not hold."""
        return lacking(self.holds, window)

    def affordable(self, window: Rectangle, budget: int) -> Rectangle | None:
        """The part of a window that so many samples to read allow to hold: what it holds already, as wide as the
        window, and rows beside that; None if that is nothing."""
        old = self.holds
        level, a, b, c, d = window
        if old is None or not _meet(old, window):
            first, end = a, a
        else:
            first, end = max(a, old.row0), min(b, old.row1)
        budget -= sum(part.samples for part in self.lacks(Rectangle(level, first, end, c, d))) if end > first else 0
        rows = budget // (d - c)
        if rows < 0:
            return None
        down = min(rows, b - end)
        first, end = max(a, first - (rows - down)), end + down
        return Rectangle(level, first, end, c, d) if end > first else None

    def move(self, window: Rectangle, read: Read) -> None:
        """Hold another window; what is new of it is read."""
        for part in self.lacks(window):
            self.data[self._at(part)] = read(part)
        self.holds = window

    def heights(self) -> Heights:
        """A copy of what it holds."""
        assert self.holds is not None
        return np.asarray(self.data[self._at(self.holds)])

    def _at(self, window: Rectangle) -> tuple[NDArray[np.int64], ...]:
        rows, cols = np.arange(window.row0, window.row1), np.arange(window.col0, window.col1)
        return np.ix_(rows % self.n, cols % self.n)


@dataclass(slots=True)
class Toroids:
    """Those of all levels.

    Attributes:
        n: samples along a side.
        read: in the last frame.
    """

    n: int
    read: int = 0
    _levels: dict[int, Toroid] = field(default_factory=dict)

    def move(self, windows: Sequence[Rectangle], read: Read, budget: int) -> int:
        """Move windows, coarsest first, to other places.

        Args:
            read: the heights of a window. budget: samples that may be read; the coarsest window is always.

        Returns:
            How many of them, from the first, are held now; the others are late.
        """
        self.read = 0
        for k, window in enumerate(windows):
            toroid = self._levels.setdefault(window.level, Toroid(self.n))
            part = toroid.affordable(window, budget - self.read) if k else window
            if part is not None:
                self.read += sum(lacking.samples for lacking in toroid.lacks(part))
                toroid.move(part, read)
            if part != window:
                return k
        return len(windows)

    def heights(self, level: int) -> Heights:
        """A copy of what a level holds."""
        return self._levels[level].heights()


def lacking(held: Rectangle | None, window: Rectangle) -> list[Rectangle]:
    """What of a window is not held: rectangles that do not overlap, two of an L, one after a leap."""
    if held is None or not _meet(held, window):
        return [window]
    level, a, b, c, d = window
    top, bottom = max(a, held.row0), min(b, held.row1)
    left, right = max(c, held.col0), min(d, held.col1)
    parts = [(a, top, c, d), (bottom, b, c, d), (top, bottom, c, left), (top, bottom, right, d)]
    return [Rectangle(level, *part) for part in parts if part[0] < part[1] and part[2] < part[3]]


def _meet(one: Rectangle, two: Rectangle) -> bool:
    rows = max(one.row0, two.row0) < min(one.row1, two.row1)
    return rows and max(one.col0, two.col0) < min(one.col1, two.col1)
