"""Chunked LOD in plain Python: meshes of chunks, heights of levels, skirts, and which chunks are drawn (Ulrich 2002).

The square has 2^n cells a side; a chunk of level l is named by its upper left corner and has a side of 2^(p + l) cells.
Vertices are (row, col). ``error`` tells how far a vertex is from the middle of its hypotenuse, inf where ground and
missing ground meet; ``ground``, whether there is any around it. Metres, pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from orograph.hierarchy import diamonds

Vertex = tuple[int, int]
Name = tuple[int, int, int]
"""Of a chunk: level, row and column, counted in chunks."""

Triangle = tuple[Vertex, Vertex, Vertex]
"""Apex, and the two ends of the hypotenuse."""


@dataclass
class Chunks:
    """The meshes.

    Args:
        n, p: exponents of the sides of the square and of the finest chunks. finest: metres, the error of level 0.
        height: of a vertex.
    """

    n: int
    p: int
    finest: float
    error: Callable[[Vertex], float]
    ground: Callable[[Vertex], bool]
    height: Callable[[Vertex], float]
    levels: dict[Vertex, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Give every vertex the coarsest level that has it (−1: none has), and the vertices it needs no less."""
        for level in range(2 * self.n - 1, -1, -1):
            for row, col in zip(*(a.tolist() for a in diamonds.of_level(self.n, level))):
                own, e = -1, self.error((row, col))
                if e >= self.finest:
                    own = 255 if math.isinf(e) else math.floor(math.log2(e / self.finest) + 0.5)
                self.levels[row, col] = max(own, self.levels.get((row, col), -1))
                for k in (0, 1):
                    above = diamonds.parent(row, col, k, self.n)
                    if above[0] >= 0:
                        self.levels[above] = max(self.levels.get(above, -1), self.levels[row, col])

    def side(self, level: int) -> int:
        """Cells along a side of a chunk."""
        return 1 << (self.p + level)

    def has(self, level: int, at: Vertex) -> bool:
        """Whether a level's meshes have a vertex; corners of its chunks are always there."""
        side = self.side(level)
        return (at[0] % side == 0 and at[1] % side == 0) or self.levels.get(at, -1) >= level

    def mesh(self, name: Name) -> Iterator[Triangle]:
        """The triangles of a chunk that have ground."""
        level, row, col = name
        half = self.side(level) // 2
        middle = (2 * row + 1) * half, (2 * col + 1) * half
        a, b = (diamonds.end(*middle, k) for k in (0, 1))
        for apex, left, right in ((diamonds.apex(*middle, 0), a, b), (diamonds.apex(*middle, 1), b, a)):
            yield from self._below((apex, left, right), level)

    def _below(self, triangle: Triangle, level: int) -> Iterator[Triangle]:
        apex, left, right = triangle
        if max(abs(left[0] - right[0]), abs(left[1] - right[1])) > 1:
            base = (left[0] + right[0]) // 2, (left[1] + right[1]) // 2
            if self.levels[base] >= level:
                yield from self._below((base, apex, left), level)
                yield from self._below((base, right, apex), level)
                return
            if not self.ground(base):
                return
        yield triangle

    def height_at(self, level: int, at: Vertex) -> float:
        """The height of a level's mesh at a vertex: its own, or that of the middle of its hypotenuse there."""
        if self.has(level, at):
            return self.height(at)
        return sum(self.height_at(level, diamonds.end(*at, k)) for k in (0, 1)) / 2

    def skirt(self, level: int, side: list[Vertex], coarsest: int) -> dict[Vertex, float]:
        """How low the skirt of a side reaches at each of its vertices.

        Args:
            side: all vertices of full resolution on it, from corner to corner. coarsest: no level that a neighbour's
                edge is of, or is moving to, is coarser.
        """
        own = [k for k, at in enumerate(side) if self.has(level, at)]
        low = {side[k]: math.inf for k in own}
        for a, b in pairwise(own):
            least = min(self.height(at) for at in side[a : b + 1])
            least = min([least, *(self.height_at(m, side[k]) for m in range(level, coarsest + 1) for k in (a, b))])
            for k in (a, b):
                low[side[k]] = min(low[side[k]], least)
        return low


@dataclass
class Selection:
    """Which chunks are drawn.

    Args:
        top: the coarsest level, of one chunk. apart: levels by which chunks beside each other may differ.
        pixels: what a chunk's error is worth. on_ground: whether it has a cell of the raster.
    """

    top: int
    apart: int
    pixels: Callable[[Name], float]
    on_ground: Callable[[Name], bool]
    split: set[Name] = field(default_factory=set)

    def divide(self, name: Name, tolerance: float) -> None:
        """Split a chunk, and those below it, while their errors are worth more than the tolerance."""
        if name[0] and self.pixels(name) > tolerance:
            self._split(name)
            for child in filter(self.on_ground, children(name)):
                self.divide(child, tolerance)

    def _split(self, name: Name) -> None:
        """Split a chunk, its parent before it, and those around it that would be left too coarse."""
        if name in self.split:
            return
        self.split.add(name)
        level, row, col = name
        if level < self.top:
            self._split((level + 1, row >> 1, col >> 1))
        if level + self.apart <= self.top:
            for r, c in ((row - 1, col), (row, col - 1), (row + 1, col), (row, col + 1)):
                if self.on_ground((level, r, c)):
                    self._split((level + self.apart, r >> self.apart, c >> self.apart))

    def drawn(self, name: Name) -> Iterator[Name]:
        """The chunks that are not split."""
        if name not in self.split:
            yield name
            return
        for child in filter(self.on_ground, children(name)):
            yield from self.drawn(child)


def children(name: Name) -> list[Name]:
    """The four chunks below a chunk."""
    level, row, col = name
    return [(level - 1, 2 * row + i, 2 * col + j) for i in (0, 1) for j in (0, 1)]


def morph(pixels: float, tolerance: float) -> float:
    """How far a chunk's vertices have left its parent's mesh: 0 to 1."""
    return min(max(2 * pixels / tolerance - 1, 0.0), 1.0)
