"""Geometry clipmaps as they are printed (Losasso & Hoppe 2004; Asirvatham & Hoppe 2005), cell by cell.

Places are (row, col). A ring is drawn here as in print: all its cells, the odd vertices of its outer row among them,
and along that row a triangle without area for each of them, which closes what the rasteriser would leave open beside
the coarser ring's longer edges. ``without_rim`` takes both away: what is left are edges between even vertices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

Point = tuple[int, int]
Triangle = frozenset[Point]
Cells = set[Point]


@dataclass(frozen=True)
class Window:
    """n × n samples of a level, from (row, col) on, in the level's samples."""

    level: int
    n: int
    row: int
    col: int

    def cells(self) -> Cells:
        """Their upper left corners."""
        side = range(self.n - 1)
        return {(self.row + i, self.col + j) for i in side for j in side}

    def samples(self) -> set[Point]:
        return {(self.row + i, self.col + j) for i in range(self.n) for j in range(self.n)}

    def interior(self, finer: Window) -> Cells:
        """The cells that a finer window covers."""
        return {(row // 2, col // 2) for row, col in finer.cells()}


def snapped(level: int, n: int, row: float, col: float) -> Window:
    """The window around a full-resolution place: at even samples, its middle within one of the place."""

    def first(place: float) -> int:
        return 2 * round((place / 2.0**level - (n - 1) / 2) / 2)

    return Window(level, n, first(row), first(col))


def alpha(row: float, col: float, eye_row: float, eye_col: float, n: int) -> float:
    """The share of the coarser heights at a sample; all in the level's samples (2004, section 4.3)."""
    w = n / 10

    def along(x: float, eye: float) -> float:
        return min(max((abs(x - eye) - ((n - 1) / 2 - w - 1)) / w, 0.0), 1.0)

    return max(along(row, eye_row), along(col, eye_col))


def new_samples(before: Window, after: Window) -> set[Point]:
    """What a window that moves has to read: an L, or all of it."""
    return after.samples() - before.samples()


def slot(n: int, row: int, col: int) -> Point:
    """Where a sample lies in the toroidal array."""
    return row % n, col % n


def cell_triangles(row: int, col: int) -> Iterator[Triangle]:
    """A cell, cut from its (even, even) to its (odd, odd) corner."""
    nw, ne, sw, se = (row, col), (row, col + 1), (row + 1, col), (row + 1, col + 1)
    cut = ((nw, ne, se), (nw, sw, se)) if (row + col) % 2 == 0 else ((nw, ne, sw), (ne, sw, se))
    yield from map(frozenset, cut)


def ring(window: Window, finer: Window | None) -> set[Triangle]:
    """The triangles of a ring, but for those without area."""
    cells = window.cells() - (window.interior(finer) if finer else set())
    return {triangle for cell in cells for triangle in cell_triangles(*cell)}


def rim(window: Window) -> set[Triangle]:
    """The triangles without area around a ring: an odd vertex and the even ones beside it."""
    last_row, last_col = window.row + window.n - 1, window.col + window.n - 1
    found = set()
    for step in range(1, window.n - 1, 2):
        for row in (window.row, last_row):
            col = window.col + step
            found.add(frozenset([(row, col - 1), (row, col), (row, col + 1)]))
        for col in (window.col, last_col):
            row = window.row + step
            found.add(frozenset([(row - 1, col), (row, col), (row + 1, col)]))
    return found


def without_rim(triangles: set[Triangle], degenerate: set[Triangle]) -> set[Triangle]:
    """The same surface with even vertices only on the outer row: the two triangles on either side of an odd vertex
    become one."""
    found = set(triangles)
    for flat in degenerate:
        odd = sorted(flat)[1]
        ends = flat - {odd}
        beside = {triangle for triangle in found if odd in triangle}
        found -= beside
        (apex,) = frozenset.union(*beside) - flat
        found.add(ends | {apex})
    return found


def blocks(window: Window) -> dict[str, list[tuple[int, int, int, int]]]:
    """The ring of a window in full as the GPU draws it (2005): (row, col, rows, cols) of samples of twelve blocks of
    m × m, m = (n + 1) / 4, and of four fix-ups of 3 × m or m × 3; the interior trim is what is left."""
    m = (window.n + 1) // 4
    at = (0, m - 1, 2 * m, 3 * m - 1)
    outer = [(i, j) for i in at for j in at if i in (0, at[3]) or j in (0, at[3])]
    middle = 2 * m - 2
    return {
        "blocks": [(window.row + i, window.col + j, m, m) for i, j in outer],
        "fix-ups": [
            *((window.row + i, window.col + middle, m, 3) for i in (0, at[3])),
            *((window.row + middle, window.col + j, 3, m) for j in (0, at[3])),
        ],
    }


def trim(window: Window, finer: Window) -> Cells:
    """The cells between a ring's blocks and the next finer window: an L, a cell wide."""
    parts = [part for some in blocks(window).values() for part in some]
    covered = {(i + r, j + c) for r, c, h, w in parts for i in range(h - 1) for j in range(w - 1)}
    return window.cells() - covered - window.interior(finer)
