"""Fronts: sets of triangles of the hierarchy, when they are valid, and how splits and merges change them.

A *front* has exactly one triangle on each path from a root to a leaf, so its triangles are a partition of the square. A
front is *valid* (conforming) if two of its triangles meet in nothing, a corner or a whole edge: no vertex lies inside
an edge (a T-junction; a *crack* opens where its height differs from the edge's). Any valid front leads to any other by
splits and merges of diamonds (Duchaineau et al. 1997, *ROAMing terrain*; lecture, *Conditions for valid
triangulation*); ``steps`` says which.

This is the model that methods are tested against: whole arrays, every step a new ``Front``, nothing incremental. Its
cost is of the order of the front's size for each step. Coordinates are samples, heights metres; see ``triangles`` and
``diamonds`` for the names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.hierarchy import diamonds, triangles
from orograph.hierarchy.bits import lowest_bit
from orograph.hierarchy.triangles import IndexArray, TriangleArrays


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """A set of triangles of the square of side 2^n, valid or not, made by ``Front.of``.

    Attributes:
        n: exponent of the square's side.
        x, y, L, omega: (m,) int64, the triangles by their place in the trees: along the finest level, left to right,
            the coarser first where two overlap.
    """

    n: int
    x: IndexArray
    y: IndexArray
    L: IndexArray
    omega: IndexArray

    @classmethod
    def of(cls, n: int, x: ArrayLike, y: ArrayLike, L: ArrayLike, omega: ArrayLike) -> Self:
        """A front of any triangles, in any order.

        Raises:
            UsageError: one of them is not a triangle of the hierarchy.
        """
        gx, gy, gL, gomega = (np.ravel(v).astype(np.int64) for v in np.broadcast_arrays(x, y, L, omega))
        given = gx, gy, gL, gomega
        wrong = ~triangles.exists(*given, n)
        if wrong.any():
            first = tuple(int(v[np.argmax(wrong)]) for v in given)
            raise UsageError(f"(x, y, L, ω) = {first} is not a triangle of a square of side 2^{n}.")
        unordered = cls(n, *given)
        begin, end = unordered.spans()
        order = np.lexsort((-end, begin))
        return cls(n, *(v[order] for v in given))

    @property
    def arrays(self) -> TriangleArrays:
        """(x, y, L, ω), as the formulas of ``triangles`` take them."""
        return self.x, self.y, self.L, self.omega

    def __len__(self) -> int:
        return len(self.x)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Front):
            return NotImplemented
        return self.n == other.n and all(np.array_equal(a, b) for a, b in zip(self.arrays, other.arrays))

    __hash__ = None  # type: ignore[assignment]  # arrays have none

    def levels(self) -> IndexArray:
        """The level of each triangle, 0 … 2n."""
        level: IndexArray = triangles.level(self.L, self.omega, self.n)
        return level

    def spans(self) -> tuple[IndexArray, IndexArray]:
        """Which finest triangles each one holds: [begin, end) of the finest level's order, out of 2 · 4^n."""
        level = self.levels()
        size = np.int64(1) << (2 * self.n - level)
        begin = (triangles.node(*self.arrays, self.n) - (np.int64(2) << level)) * size
        return begin, begin + size

    def vertices(self) -> tuple[IndexArray, IndexArray]:
        """Every corner of a triangle once, (row, col), by row and column; the square's four corners are among them."""
        corners = (triangles.apex, triangles.left_end, triangles.right_end)
        ids = np.unique(np.concatenate([_id(self.n, y, x) for x, y in (corner(*self.arrays) for corner in corners)]))
        rows, cols = np.divmod(ids, (1 << self.n) + 1)
        return rows, cols

    def active(self) -> NDArray[np.bool_]:
        """The vertices as an array of one entry per vertex, (2^n + 1, 2^n + 1): what ``front_of`` takes."""
        present = np.zeros(((1 << self.n) + 1,) * 2, bool)
        present[self.vertices()] = True
        return present


def coarsest(n: int) -> Front:
    """The two root triangles."""
    return uniform(n, 0)


def uniform(n: int, level: int) -> Front:
    """All triangles of a level, 0 … 2n.

    Raises:
        UsageError: there is no such level.
    """
    return Front(n, *triangles.of_level(n, level))


def front_of(active: NDArray[np.bool_]) -> Front:
    """The valid front whose vertices are the ``active`` ones.

    Args:
        active: (2^n + 1, 2^n + 1) bool, one entry per vertex; those of the four corners mean nothing.

    Raises:
        UsageError: the shape is another, or a vertex lacks a parent in the DAG (``diamonds.closure`` adds them).
    """
    n = diamonds.exponent_of(active)
    missing = diamonds.closure(active) & ~active
    if missing.any():
        row, col = np.argwhere(missing)[0]
        raise UsageError(f"Active vertices need active parents: the one at row {row}, column {col} is not active.")
    front = coarsest(n)
    for _ in range(2 * n):
        row, col = diamonds.of_triangle(*front.arrays)
        front = _halved(front, (row >= 0) & active[row, col])
    return front


# ---- validity ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PartitionFaults:
    """Where a set of triangles fails to partition the square.

    Attributes:
        overlaps: (k, 2) int64, pairs of triangles of the front (by index) with one inside the other or equal to it:
            each triangle on ground that an earlier one has, and the earlier one.
        gaps: the largest triangles that hold nothing but uncovered ground: arrays x, y, L, ω.
    """

    overlaps: IndexArray
    gaps: TriangleArrays

    def __bool__(self) -> bool:
        return bool(len(self.overlaps) or len(self.gaps[0]))


def partition_faults(front: Front) -> PartitionFaults:
    """Check that each path from a root to a leaf has exactly one triangle of the front; false if so.

    Along the finest level, every triangle of the hierarchy is an interval: the front's must follow one on another.
    """
    begin, end = front.spans()
    reach = np.maximum.accumulate(np.concatenate([[0], end]))  # how far the triangles before the i-th have come
    double = np.flatnonzero(begin < reach[:-1])
    # The first of those before that reaches beyond its begin: they reach ever further, so a search finds it.
    earlier = np.searchsorted(reach[1:], begin[double], side="right")
    stops = np.append(begin, 2 << 2 * front.n)
    nodes = [node for i in np.flatnonzero(stops > reach) for node in _nodes_of(int(reach[i]), int(stops[i]), front.n)]
    gaps = triangles.from_node(np.array(nodes, np.int64), front.n)
    return PartitionFaults(np.stack([double, earlier], axis=1), gaps)


def _nodes_of(begin: int, end: int, n: int) -> Iterator[int]:
    """The fewest triangles (by node) that hold the finest triangles [begin, end)."""
    while begin < end:
        size = min(lowest_bit(begin) or 1 << 2 * n, 1 << 2 * n)
        while begin + size > end:
            size >>= 1
        yield ((2 << 2 * n) + begin) // size
        begin += size


@dataclass(frozen=True, slots=True)
class TJunctions:
    """Vertices of a front that lie inside an edge of one of its triangles; arrays (k,), int64.

    Attributes:
        triangle: the index of that triangle in the front.
        edge: which edge: 0 hypotenuse, 1 left leg, 2 right leg.
        row, col: the vertex, in the middle of the edge (the other side of an edge is split there first: an edge with
            any vertex inside has one in its middle).
    """

    triangle: IndexArray
    edge: IndexArray
    row: IndexArray
    col: IndexArray

    def __len__(self) -> int:
        return len(self.triangle)


def t_junctions(front: Front) -> TJunctions:
    """The T-junctions of a partition, by edge, then triangle; none if it is conforming.

    The middle of a hypotenuse is the triangle's own diamond, the middle of a leg that of a child.
    """
    ids = _id(front.n, *front.vertices())
    inner = np.flatnonzero(triangles.is_finest(front.L, front.omega) == 0)  # the edges of finest ones have no middle
    parts = front.x[inner], front.y[inner], front.L[inner], front.omega[inner]
    found = []
    for edge, part in enumerate([parts, triangles.child(*parts, 0), triangles.child(*parts, 1)]):
        row, col = diamonds.of_triangle(*part)
        hit = (row >= 0) & np.isin(_id(front.n, row, col), ids)
        found.append((inner[hit], np.full(int(hit.sum()), edge), row[hit], col[hit]))
    return TJunctions(*(np.concatenate(v) for v in zip(*found)))


def cracks(front: Front, heights: NDArray[np.floating]) -> NDArray[np.float64]:
    """How wide the mesh gapes at each of ``t_junctions(front)``: |height of the vertex − height of the edge's middle|.

    Args:
        heights: (2^n + 1, 2^n + 1) metres.

    Returns: (k,) metres; 0 where the vertex lies on the edge (still a T-junction).
    """
    at = t_junctions(front)
    on = tuple(v[at.triangle] for v in front.arrays)
    z = np.asarray(heights, np.float64)
    za, zl, zr = (
        z[y, x] for x, y in (corner(*on) for corner in (triangles.apex, triangles.left_end, triangles.right_end))
    )
    middle = np.choose(at.edge, [(zl + zr) / 2, (za + zl) / 2, (za + zr) / 2])
    width: NDArray[np.float64] = np.abs(z[at.row, at.col] - middle)
    return width


def is_valid(front: Front) -> bool:
    """Whether the front is a partition of the square without T-junctions."""
    return not partition_faults(front) and not len(t_junctions(front))


# ---- splits and merges -------------------------------------------------------------------------------------------


def split(front: Front, row: ArrayLike, col: ArrayLike) -> Front:
    """Split diamonds, and before them every ancestor that is not split yet (*forced splits*).

    Args:
        front: a valid front.
        row, col: one diamond or arrays of them; those that are split already stay so.

    Returns: the coarsest valid front that refines ``front`` and has these vertices.

    Raises:
        UsageError: one of them is no diamond.
    """
    wanted = _id(front.n, *diamonds.ancestors(row, col, front.n))
    while True:
        top = np.isin(_id(front.n, *diamonds.of_triangle(*front.arrays)), wanted)
        if not top.any():
            return front
        front = _halved(front, top)


def merge(front: Front, row: ArrayLike, col: ArrayLike) -> Front:
    """Undo the split of diamonds whose bottom triangles are all in the front.

    Args:
        front: a valid front.
        row, col: one diamond or arrays of them, all ``mergeable``.

    Raises:
        UsageError: one of them is not: it is not split, or a child of it is (merge that first).
    """
    asked = np.unique(_id(front.n, *np.broadcast_arrays(row, col)))
    illegal = np.setdiff1d(asked, _id(front.n, *mergeable(front)))
    if len(illegal):
        r, c = divmod(int(illegal[0]), (1 << front.n) + 1)
        raise UsageError(f"The diamond at row {r}, column {c} cannot be merged: not all of its bottom triangles exist.")
    x, y = triangles.apex(*front.arrays)
    return _joined(front, np.isin(_id(front.n, y, x), asked))


def splittable(front: Front) -> tuple[IndexArray, IndexArray]:
    """The diamonds with a top triangle in the front, (row, col) by row and column; splits of some force others."""
    row, col = diamonds.of_triangle(*front.arrays)
    ids = np.unique(_id(front.n, row[row >= 0], col[row >= 0]))
    rows, cols = np.divmod(ids, (1 << front.n) + 1)
    return rows, cols


def mergeable(front: Front) -> tuple[IndexArray, IndexArray]:
    """The diamonds that may be merged, (row, col) by row and column: all of the bottom, 4 triangles or 2, is there.

    A diamond's bottom triangles are those whose apex is its vertex.
    """
    n = front.n
    x, y = triangles.apex(*front.arrays)
    ids, count = np.unique(_id(n, y, x), return_counts=True)
    row, col = np.divmod(ids, (1 << n) + 1)
    tops = sum(triangles.inside(*diamonds.top(row, col, k), n) * 1 for k in (0, 1))
    whole = diamonds.is_diamond(row, col, n) & (count == 2 * tops)
    return row[whole], col[whole]


def steps(start: Front, goal: Front) -> list[tuple[Literal["merge", "split"], int, int]]:
    """The steps from one valid front to another: merges and splits of one diamond (row, col) each, in a legal order.

    First what only ``start`` has is merged, from the finest level; then what only ``goal`` has is split, from the
    coarsest: no merge is illegal, no split forces another, every front on the way is valid.

    Raises:
        UsageError: the two are fronts of different squares.
    """
    if start.n != goal.n:
        raise UsageError(f"Fronts of squares of side 2^{start.n} and 2^{goal.n} cannot be transformed into each other.")
    ours, theirs = (_id(front.n, *front.vertices()) for front in (start, goal))
    surplus = _by_level(np.setdiff1d(ours, theirs), start.n)
    lacking = _by_level(np.setdiff1d(theirs, ours), start.n)
    return [("merge", r, c) for r, c in reversed(surplus)] + [("split", r, c) for r, c in lacking]


def _by_level(ids: IndexArray, n: int) -> list[tuple[int, int]]:
    """Diamonds (row, col) of these numbers, from the coarsest level to the finest."""
    row, col = np.divmod(ids, (1 << n) + 1)
    order = np.argsort(diamonds.level(row, col, n), kind="stable")
    return [(int(r), int(c)) for r, c in zip(row[order], col[order])]


def _id(n: int, row: ArrayLike, col: ArrayLike) -> IndexArray:
    """One number per vertex, in the order of rows; less than 0 for none."""
    return np.asarray(row, np.int64) * ((1 << n) + 1) + np.asarray(col, np.int64)


def _halved(front: Front, these: NDArray[np.bool_]) -> Front:
    """The front with both children in the place of each of ``these`` (m,) triangles, which keeps its order."""
    times = 1 + these
    x, y, L, omega = (np.repeat(v, times) for v in front.arrays)
    half = np.repeat(these, times)
    k = np.arange(len(x)) - np.repeat(np.cumsum(times) - times, times)
    x[half], y[half], L[half], omega[half] = triangles.child(x[half], y[half], L[half], omega[half], k[half])
    return Front(front.n, x, y, L, omega)


def _joined(front: Front, these: NDArray[np.bool_]) -> Front:
    """The front with the parent in the place of each pair of children among ``these`` (m,), which keeps its order."""
    x, y, L, omega = (v.copy() for v in front.arrays)
    x[these], y[these], L[these], omega[these] = triangles.parent(x[these], y[these], L[these], omega[these])
    kept = ~these | (triangles.which_child(*front.arrays) == 0)
    return Front(front.n, x[kept], y[kept], L[kept], omega[kept])
