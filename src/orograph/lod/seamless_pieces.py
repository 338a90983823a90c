"""The pieces of seamless patches, made once: triangular tiles and strips.

A patch is a square of up to 2^Q segments a side. Its four *tiles* are the triangles between a side and the centre; a
side of 2^q segments has a tile of square cells as large as a segment, cut as the surface of the level of that spacing
is. Along a diagonal lie the halves of those cells that it cuts: a *strip*. Where the tiles on both sides are equally
fine these are the level's own triangles. Else both have the vertices of the finer one, and each half of a coarser cell
becomes a fan around its right angle. All that adapts lies inside a patch.

A raster's last row or column may cut a patch, which is then squeezed onto it. That turns no triangle over: each is, or
lies with its apex at the right angle of, a triangle with sides along a row and a column.

Pieces stand for the side at the top (strips: for the diagonal from the upper left corner to the centre, with the top's
tile above and the left one's below); the other three are turned.

Livny, Kogan & El-Sana, *Seamless patches for GPU-based terrain rendering* (The Visual Computer 25, 2009), sec. 3.
Lattice points are (row, col) in 2^Q-ths of a patch's side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from orograph.lod.selection import Topology

Point = tuple[int, int]
Triangle = tuple[Point, Point, Point]


def turned(points: NDArray[np.int64], times: int, side: int) -> NDArray[np.int64]:
    """Points (v, 2) of a square turned clockwise by quarters: the top becomes the right side."""
    row, col = points[:, 0], points[:, 1]
    for _ in range(times % 4):
        row, col = col, side - row
    return np.stack([row, col], 1)


def tile(q: int, big: int) -> Topology:
    """The tile of a side of 2^q segments in a patch of 2^big, 1 ≤ q ≤ big."""
    n = 1 << q
    cells = [(row, col) for row in range(n // 2) for col in range(row + 1, n - row - 1)]
    return _topology([triangle for cell in cells for triangle in _cell(*cell)], (1 << big) >> q)


def strip(top: int, left: int, big: int) -> Topology:
    """The strip along the upper left diagonal, between tiles of 2^top and 2^left segments a side."""
    fine = max(top, left)
    below = [(a[::-1], b[::-1], c[::-1]) for a, b, c in _fans(left, fine)]
    return _topology([*_fans(top, fine), *below], (1 << big) >> fine)


def _fans(q: int, fine: int) -> list[Triangle]:
    """The halves of the top's cells that the diagonal cuts, 2^q a side; of the diagonal's vertices there are 2^fine."""
    step = 1 << (fine - q)
    return [
        ((i * step, (i + 1) * step), (j + 1, j + 1), (j, j))
        for i in range((1 << q) // 2)
        for j in range(i * step, (i + 1) * step)
    ]


def _cell(row: int, col: int) -> tuple[Triangle, Triangle]:
    """A cell's two triangles: the diagonal joins its corners of even, even and of odd, odd numbers."""
    nw, ne, sw, se = (row, col), (row, col + 1), (row + 1, col), (row + 1, col + 1)
    return ((nw, ne, se), (nw, se, sw)) if (row + col) % 2 == 0 else ((nw, ne, sw), (ne, se, sw))


def _topology(triangles: Sequence[Triangle], step: int = 1) -> Topology:
    """Triangles as a topology, all clockwise as the raster is drawn, rows downwards."""
    corners = np.array(triangles, np.int64).reshape(-1, 3, 2)
    (a, b, c) = corners.transpose(1, 0, 2)
    area = (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]) - (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1])
    corners = np.where(area[:, None, None] < 0, corners[:, ::-1], corners)
    points, where = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    return Topology((points * step).astype(np.int32), where.reshape(-1, 3).astype(np.int32))


@dataclass(frozen=True, slots=True)
class SeamlessPieces:
    """All pieces of patches of 2^big segments a side: their topologies, and which is which.

    Attributes:
        big: Q. topologies: tiles by q, then strips.
    """

    big: int
    topologies: tuple[Topology, ...]

    @staticmethod
    @lru_cache(maxsize=8)
    def of(big: int) -> SeamlessPieces:
        """Those of patches of 2^big segments a side, ``big`` ≥ 1."""
        every = range(1, big + 1)
        made = [tile(q, big) for q in every]
        return SeamlessPieces(big, (*made, *(strip(top, left, big) for top in every for left in every)))

    def tile(self, q: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers of tiles."""
        return q - 1

    def strip(self, top: NDArray[np.int64], left: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers of strips."""
        return self.big * top + left - 1
