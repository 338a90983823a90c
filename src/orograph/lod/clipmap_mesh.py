"""The triangles of clipmap rings: blocks of cells, and an outer row of even vertices only.

A ring of level l is cut as that level's surface is. Along its sides, but for the raster's border, the two triangles on
either side of an odd vertex are one: the ring ends in vertices of level l + 1, and no degenerate triangle is needed.
So all rings together are a conforming mesh of right triangles, and a vertex has one height: its own, or one on its way
to the coarser surface, which vertices that two rings share are never on. Triangles are (m, 3): the apex, then the ends
of the longest side, clockwise as the raster is drawn, rows downwards. Samples, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import Rectangle
from orograph.lod.clipmap_windows import borders
from orograph.lod.selection import Blend
from orograph.store.terrain import Heights

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Shape = tuple[int, int]

FIRST = {False: ((0, 0), (0, 1), (1, 0)), True: ((0, 1), (1, 1), (0, 0))}
"""The first triangle of a cell, as rows and columns from its upper left corner, by whether its cut falls."""

SECOND = {False: ((1, 1), (1, 0), (0, 1)), True: ((1, 0), (0, 0), (1, 1))}


@dataclass(frozen=True, slots=True)
class Ring:
    """What is drawn of a window.

    Attributes:
        window: as of ``ClipRings``. hole: the next finer window, None of the finest.
        seen, block: of its blocks.
    """

    window: Rectangle
    hole: Rectangle | None
    seen: Mask
    block: int

    def part(self) -> Rectangle | None:
        """The samples of its blocks in view; None if there are none."""
        rows, cols = np.flatnonzero(self.seen.any(1)), np.flatnonzero(self.seen.any(0))
        if not len(rows):
            return None
        w, b = self.window, self.block
        i, j = w.row0 // b, w.col0 // b
        return Rectangle(
            w.level, max((i + int(rows[0])) * b, w.row0), min((i + int(rows[-1]) + 1) * b + 1, w.row1),
            max((j + int(cols[0])) * b, w.col0), min((j + int(cols[-1]) + 1) * b + 1, w.col1),
        )  # fmt: skip

    def cells(self, part: Rectangle, shape: Shape) -> Mask:
        """Which cells of a part are drawn: in view, not in the hole, on the raster."""
        w, b, k = self.window, self.block, self.window.level
        rows, cols = np.arange(part.row0, part.row1 - 1), np.arange(part.col0, part.col1 - 1)
        drawn = self.seen[np.ix_(rows // b - w.row0 // b, cols // b - w.col0 // b)]
        drawn &= ((rows << k) < shape[0] - 1)[:, None] & ((cols << k) < shape[1] - 1)
        if self.hole is not None:
            inner = self.hole.around(k)
            inside = (rows >= inner.row0) & (rows < inner.row1 - 1), (cols >= inner.col0) & (cols < inner.col1 - 1)
            drawn &= ~(inside[0][:, None] & inside[1])
        return np.asarray(drawn)

    def triangles(self, shape: Shape) -> int:
        """How many there are, but for rims of holes and those that the raster's border flattens."""
        w, b, k = self.window, self.block, self.window.level
        ends = [min(last, -((1 - side) >> k)) for last, side in zip((w.row1 - 1, w.col1 - 1), shape)]
        down = _overlaps(w.row0, ends[0], b, w.row0 // b, self.seen.shape[0])
        across = _overlaps(w.col0, ends[1], b, w.col0 // b, self.seen.shape[1])
        cells = np.outer(down, across)
        if self.hole is not None:
            inner = self.hole.around(k)
            lost = _overlaps(inner.row0, min(inner.row1 - 1, ends[0]), b, w.row0 // b, self.seen.shape[0])
            cells -= np.outer(
                lost, _overlaps(inner.col0, min(inner.col1 - 1, ends[1]), b, w.col0 // b, self.seen.shape[1])
            )
        return 2 * int(cells[self.seen].sum()) - self._merged(down, across, shape)

    def _merged(self, down: Index, across: Index, shape: Shape) -> int:
        north, south, west, east = borders(self.window, shape)
        sides = ((north, self.seen[0], across), (south, self.seen[-1], across),
                 (west, self.seen[:, 0], down), (east, self.seen[:, -1], down))  # fmt: skip
        return sum(int(along[seen].sum()) // 2 for border, seen, along in sides if not border)


def _overlaps(first: int, last: int, block: int, origin: int, count: int) -> Index:
    """How many of the cells [first, last) each of ``count`` blocks from number ``origin`` on has."""
    begins = (origin + np.arange(count)) * block
    return np.asarray(np.maximum(np.minimum(begins + block, last) - np.maximum(begins, first), 0))


def triangles(ring: Ring, part: Rectangle, shape: Shape) -> Index:
    """(m, 3, 2): rows and columns of the corners of a ring's triangles in a part of it, samples of its level."""
    drawn = ring.cells(part, shape)
    w = ring.window
    last_row, last_col = w.row1 - 2, w.col1 - 2  # (cells)
    north, south, west, east = (not border for border in borders(w, shape))
    row, col = (a + b for a, b in zip(np.nonzero(drawn), (part.row0, part.col0)))
    falls = (row + col) % 2 == 0
    made = []
    for cut in (False, True):
        r, c = row[falls == cut], col[falls == cut]
        outer = (north & (r == w.row0)) | (east & (c == last_col) if cut else west & (c == w.col0))
        made.append(_placed(r[~outer], c[~outer], FIRST[cut]))
        outer = (south & (r == last_row)) | (west & (c == w.col0) if cut else east & (c == last_col))
        made.append(_placed(r[~outer], c[~outer], SECOND[cut]))
    # (Of two cells beside an odd vertex the even one tells: it is on the raster if any of the two is.)
    even_row, even_col = row % 2 == 0, col % 2 == 0
    for there, corners in (
        (north & even_col & (row == w.row0), ((1, 1), (0, 0), (0, 2))),
        (south & even_col & (row == last_row), ((0, 1), (1, 2), (1, 0))),
        (west & even_row & (col == w.col0), ((1, 1), (2, 0), (0, 0))),
        (east & even_row & (col == last_col), ((1, 0), (0, 1), (2, 1))),
    ):
        made.append(_placed(row[there], col[there], corners))
    return np.concatenate(made)


def _placed(row: Index, col: Index, corners: tuple[tuple[int, int], ...]) -> Index:
    return np.stack([row, col], -1)[:, None] + np.array(corners, np.int64)


def blended(z: Heights, part: Rectangle, blend: Blend, still: Mask) -> Heights:
    """Heights of a part, those of odd samples on their way to the next coarser surface; missing ones stay.

    Args:
        z: (rows, cols), of samples that begin and end at even ones. still: those that stay where they are.
    """
    row, col = np.arange(part.row0, part.row1)[:, None], np.arange(part.col0, part.col1)
    share = blend.at(row, col)
    share[still] = 0.0
    if not share.any():
        return z
    coarse = z[::2, ::2].astype(np.float64)
    surface = np.empty(z.shape)
    surface[::2, ::2] = coarse
    surface[::2, 1::2] = (coarse[:, :-1] + coarse[:, 1:]) / 2
    surface[1::2, ::2] = (coarse[:-1] + coarse[1:]) / 2
    falls = np.add(*np.ogrid[part.row0 // 2 : part.row1 // 2, part.col0 // 2 : part.col1 // 2]) % 2 == 0
    surface[1::2, 1::2] = np.where(falls, coarse[:-1, :-1] + coarse[1:, 1:], coarse[:-1, 1:] + coarse[1:, :-1]) / 2
    moved = share * (surface - z)
    return np.asarray(z + np.where(np.isnan(moved), 0.0, moved), np.float32)
