"""SMART: blocks of a quadtree, what range of errors a view asks of each, and which vertices that makes active.

Bao, Pajarola & Shafae 2004, *SMART*. The paper was not at hand: blocks with ranges of errors, and strips with masks
over them, are its; the rules below were worked out, and read as follows.

- A *range* r ends at a threshold ε(r); thresholds fall. A view asks a block for the first range whose threshold, as an
  error anywhere in the ball of the block's diamond, is worth no more pixels than the tolerance.
- A vertex has a *region*, the open square around it of radius 2s, s its spacing, or 3s if it is the centre of a square.
  It is *active* if its error exceeds the threshold of a block that is drawn and that its region touches. The corners of
  blocks are active, and with every vertex its parents in the diamond DAG.
- A block draws vertices of twice its finest spacing, one of level 0 all. It is split where one of its finest is active
  by its own range, or by that of a square of half its size beside it (the square's finest range, all over its width);
  and where such a square is split itself.

Regions hold those of their children and errors are saturated, so hardly a parent has to be looked for: that makes masks
possible. (x, y): column and row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from orograph.lod.reference.children import Triangle, Vertex, children, corners, is_finest, parents, roots
from orograph.lod.reference.criterion import Spheres

Block = tuple[int, int, int]
"""Exponent p, row, column: a square of 2^p samples a side."""


def region(vertex: Vertex, n: int) -> tuple[Vertex, int]:
    """The centre and the radius of a vertex's region."""
    x, y = vertex
    s = (x | y) & -(x | y) if x | y else 2**n
    return vertex, 3 * s if x // s % 2 and y // s % 2 else 2 * s


@dataclass
class Smart:
    """The blocks of a view.

    Attributes:
        spheres: the criterion. m: blocks are drawn with 2^m cells a side at most. ends: ε of all ranges, (stretched)
            metres, the last one 0. tolerance: pixels.
        drawn, split: blocks with their ranges, and those that have quarters.
    """

    spheres: Spheres
    m: int
    ends: Sequence[float]
    tolerance: float
    drawn: dict[Block, int] = field(default_factory=dict)
    split: set[Block] = field(default_factory=set)

    def asked(self, block: Block) -> int | None:
        """The range that the view asks of a block; None if there is nothing to be seen."""
        p, row, col = block
        if p == 0:
            return 0
        centre = (col << p) + (1 << p - 1), (row << p) + (1 << p - 1)
        sample, camera = self.spheres.ground[centre], self.spheres.camera
        if sample.empty or self.spheres.is_out_of_view(centre):
            return None
        point = camera.to_camera(sample.point)
        bounds = (self.spheres.bound(camera, point, e, sample.radius) if e else 0.0 for e in self.ends)
        return next(r for r, pixels in enumerate(bounds) if pixels <= self.tolerance)

    def exceeds(self, vertex: Vertex, range_: int) -> bool:
        """Whether a vertex is active in a range by itself."""
        return self.spheres.ground[vertex].error > self.ends[range_]

    def finest(self, block: Block) -> Iterator[Vertex]:
        """The vertices of a block's finest spacing."""
        p, row, col = block
        g = 1 << (p - self.m)
        for j in range(2**self.m + 1):
            for i in range(2**self.m + 1):
                if (i | j) & 1:
                    yield (col << p) + i * g, (row << p) + j * g

    def touches(self, vertex: Vertex, block: Block) -> bool:
        """Whether the region of a vertex touches a block."""
        p, row, col = block
        (x, y), reach = region(vertex, self.spheres.ground.n)
        return all(v - reach < (k + 1) << p and v + reach > k << p for v, k in ((x, col), (y, row)))

    def divide(self, block: Block) -> None:
        """Add a block or its quarters."""
        range_ = self.asked(block)
        if range_ is None:
            return
        if block[0] > self.m and any(self.exceeds(v, range_) for v in self.finest(block)):
            self.cut(block)
        else:
            self.drawn[block] = range_

    def cut(self, block: Block) -> None:
        """Add the quarters of a block in its place."""
        self.drawn.pop(block, None)
        self.split.add(block)
        p, row, col = block
        for k in range(4):
            self.divide((p - 1, 2 * row + (k >> 1), 2 * col + (k & 1)))

    def range_of(self, block: Block) -> int:
        """The range of a block, of the one that it is part of, or −1."""
        while block not in self.drawn and block not in self.split and block[0] < self.spheres.ground.n:
            block = block[0] + 1, block[1] >> 1, block[2] >> 1
        return self.drawn.get(block, -1)

    def is_unfit(self, block: Block) -> bool:
        """Whether a block must be split for the sake of those beside it."""
        p, row, col = block
        around = ((i, j) for i in range(-1, 3) for j in range(-1, 3) if not (0 <= i <= 1 and 0 <= j <= 1))
        for half in ((p - 1, 2 * row + i, 2 * col + j) for i, j in around):
            range_ = self.range_of(half)
            if half in self.split:
                return True
            if range_ >= 0 and any(self.touches(v, half) and self.exceeds(v, range_) for v in self.finest(block)):
                return True
        return False

    def balance(self) -> None:
        """Split what is unfit, the smallest blocks first."""
        while unfit := [block for block in self.drawn if block[0] > self.m and self.is_unfit(block)]:
            for block in [block for block in unfit if block[0] == min(unfit)[0]]:
                self.cut(block)

    def active(self) -> set[Vertex]:
        """The vertices of the mesh."""
        wanted = {
            v for v, sample in self.spheres.ground.samples.items() if sample.radius < float("inf")
            for block, range_ in self.drawn.items() if self.touches(v, block) and self.exceeds(v, range_)
        }  # fmt: skip
        wanted |= {((c + j) << p, (r + i) << p) for p, r, c in self.drawn for i in (0, 1) for j in (0, 1)}
        more = wanted
        while more:
            more = {v for child in more for v in parents(child, self.spheres.ground.n)} - wanted
            wanted |= more
        return wanted

    def triangles(self) -> Iterator[Triangle]:
        """The triangles of the blocks that are drawn."""
        active, todo = self.active(), list(roots(self.spheres.ground.n))
        while todo:
            t = todo.pop()
            if not is_finest(t) and t.diamond in active:
                todo += children(t)
                continue
            x, y = (sum(values) / 3 for values in zip(*corners(t)))
            if any(row << p < y < (row + 1) << p and col << p < x < (col + 1) << p for p, row, col in self.drawn):
                yield t
