"""The layout of seamless patches: which squares of the quadtree are drawn, and the resolution of each edge.

*The spacing of an edge is a function of the edge alone*: the coarsest level whose surface keeps the tolerance on the
screen everywhere in the square box around the edge, half of it on either side; that of the samples where ground and
missing ground meet. A square is split where one of its edges wants more than 2^Q segments. Squares beside each other
differ by one level at most. Where they do, the edge is the
larger square's, and the smaller ones take its spacing. It is at most half of the smaller side: so an edge has two
segments at least, and on both sides of it there are the same vertices. Levels, samples, pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orograph.lod.seamless_errors import BlockErrors
from orograph.lod.squares import Index, Squares
from orograph.raycast.select import Boxes, in_frustum, moved
from orograph.viewpoint import Camera

SIDES = ((0, 0), (0, 1), (1, 0), (0, 0))
"""Of the edges above, to the right, below and to the left of a square: rows and columns on from its corner's."""


@dataclass(frozen=True, slots=True)
class Patches:
    """The patches of a view that are of one size.

    Attributes:
        squares: where they are. spacing: (m, 4) int64, the level of the edge above, to the right, below, to the left.
    """

    squares: Squares
    spacing: Index


@dataclass(slots=True)
class Layout:
    """What a view needs. Made by ``laid_out``.

    Attributes:
        camera, tolerance: of the view. errors: of its terrain.
        times: what is drawn may be off by this many times a level's error.
        split: by exponent, the sorted numbers of the squares that are split.
    """

    camera: Camera
    tolerance: float
    errors: BlockErrors
    times: float = 1.0
    split: dict[int, Index] = field(default_factory=dict)

    def patches(self) -> list[Patches]:
        """The patches, from large to small."""
        self._split_wanted()
        self._restrict()
        found, squares = [], self._root()
        while len(squares):
            is_split = self._is_split(squares)
            leaves = squares.where(~is_split)
            leaves = leaves.where(self._seen(leaves))
            if len(leaves):
                sides = [self._spacing(leaves, side) for side in range(4)]
                found.append(Patches(leaves, np.stack(sides, 1)))
            if squares.p == self.errors.big:
                break
            squares = self.errors.heights.on_ground(squares.where(is_split).children())
        return found

    def _root(self) -> Squares:
        return Squares(self.errors.terrain.n, np.zeros(1, np.int64), np.zeros(1, np.int64))

    def _split_wanted(self) -> None:
        """Split what is in view from the root down, where an edge requires it."""
        squares, big = self._root(), self.errors.big
        while squares.p > big and len(squares):
            squares = squares.where(self._seen(squares))
            wants = np.zeros(len(squares), bool)
            for side in range(4):
                wants |= self._wanted(*_edges(squares, side)) < squares.p - big
            squares = squares.where(wants)
            self.split[squares.p] = np.sort(squares.codes)
            squares = self.errors.heights.on_ground(squares.children())

    def _restrict(self) -> None:
        """Split squares adjacent to ones of less than half their side, from small to large."""
        for p in range(self.errors.big + 1, self.errors.terrain.n):
            codes = self.split.get(p, np.zeros(0, np.int64))
            split = Squares(p, codes >> 32, codes & 0xFFFFFFFF)
            around = [self.errors.heights.on_ground(split.beside(side)).parents().codes for side in range(4)]
            more = np.concatenate([split.parents().codes, *around, self.split.get(p + 1, np.zeros(0, np.int64))])
            self.split[p + 1] = np.unique(more)

    def _is_split(self, squares: Squares) -> NDArray[np.bool_]:
        return np.isin(squares.codes, self.split.get(squares.p, np.zeros(0, np.int64)))

    def _spacing(self, leaves: Squares, side: int) -> Index:
        """The level of the spacing of their edges on a side."""
        p, beside = leaves.p, leaves.beside(side)
        across, row, col = _edges(leaves, side)[1:]
        found = self._wanted(p, across, row, col)
        found = np.where(self._is_split(beside), np.minimum(found, p - 2), np.minimum(found, p - 1))
        if p < self.errors.terrain.n:
            ground = np.isin(beside.codes, self.errors.heights.on_ground(beside).codes)
            larger = ground & ~self._is_split(beside.parents())
            found[larger] = np.minimum(self._wanted(p + 1, across, row[larger] >> 1, col[larger] >> 1), p - 1)
        return np.maximum(found, p - self.errors.big)

    def _seen(self, squares: Squares) -> NDArray[np.bool_]:
        """Which are at least partly in view."""
        boxes = self.errors.heights.of(squares)
        return in_frustum(self.errors.terrain, self.camera.view, self.camera.exaggeration, boxes)

    def _wanted(self, p: int, across: bool, row: Index, col: Index) -> Index:
        """The coarsest level that keeps the tolerance around edges (m,); p − Q − 1 where even the finest does not.

        Args:
            p: the exponent of their length. across: whether they run along a row. row, col: of their beginnings, in
                lengths.
        """
        boxes = self._around(p, across, row, col)
        levels = range(max(p - self.errors.big, 0), p + 1)
        errors, mixed = self.errors.around(levels, boxes, p - 1)
        view, exaggeration = self.camera.view, self.camera.exaggeration
        fits = ~mixed & (moved(self.errors.terrain, view, exaggeration, self.times * errors, boxes) <= self.tolerance)
        coarsest: Index = np.where(fits, np.array(levels)[:, None], p - self.errors.big - 1).max(0)
        return coarsest

    def _around(self, p: int, across: bool, row: Index, col: Index) -> Boxes:
        """The boxes around edges: half a length on either side."""
        half, side = (1 << p) >> 1, 1 << p
        north, west = (row << p) - (half if across else 0), (col << p) - (0 if across else half)
        return self.errors.heights.around(west, north, west + side, north + side, p - 1)


def _edges(squares: Squares, side: int) -> tuple[int, bool, Index, Index]:
    """Their edges on a side: the exponent of their length, whether they run along a row, and where they begin."""
    down, right = SIDES[side]
    return squares.p, side % 2 == 0, squares.row + down, squares.col + right
