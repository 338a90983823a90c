"""Top-down refinement with forced splits, which conforms whatever the criterion says.

Lecture, slide *Top Down Refinement on Triangles*; Duchaineau et al. 1997, sec. 4. Start with the two triangles of the
square, and split what is inaccurate. The new vertex lies on the hypotenuse, so the triangle on the other side of it is
split as well. If that one is coarser it does not have this edge yet: it is split first, by the same rule. Each link of
the chain is a level coarser, so the chain ends. Corrected, in ``force_split(t, F, T)``:

- *The border.* A hypotenuse on the border of the square has no triangle on its other side; t is split alone. As printed
  there is nothing to take the level of.
- *The neighbour is looked up again* after it was split by force: what lies across the hypotenuse now is one of its
  halves. As printed, "split diamond of t" would meet a triangle that is no longer in the mesh.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Protocol

from orograph.lod.reference.children import Triangle, children, diamond_top_sibling, is_finest, level, parent, roots


class Queue(Protocol):
    """F: what waits to be looked at."""

    def append(self, t: Triangle, /) -> None:
        """Insert a triangle."""


class PriorityQueue:
    """The triangle of highest priority comes first, among equals the coarser one, then that with the smaller l."""

    def __init__(self, priority: Callable[[Triangle], float], n: int) -> None:
        self.priority, self.n = priority, n
        self.heap: list[tuple[float, int, Triangle]] = []

    def append(self, t: Triangle) -> None:
        """Insert a triangle with the priority it has now; a finest one has none."""
        pi = -1.0 if is_finest(t) else self.priority(t)
        heapq.heappush(self.heap, (-pi, level(t, self.n), t))

    def extract(self, T: set[Triangle]) -> tuple[float, Triangle] | None:
        """The highest priority and its triangle; what a forced split has taken out of the mesh is dropped."""
        while self.heap:
            pi, _, t = heapq.heappop(self.heap)
            if t in T:
                return -pi, t
        return None


def long_side_neighbor(t: Triangle, T: set[Triangle], n: int) -> Triangle | None:
    """The triangle of the mesh across the hypotenuse: the sibling or the sibling's parent; None on the border."""
    sibling = diamond_top_sibling(t, n)
    if sibling is None or sibling in T:
        return sibling
    return parent(sibling, n)


def force_split(t: Triangle, F: Queue, T: set[Triangle], n: int) -> None:
    """Split the diamond of t, and before it whatever has to be split for that.

    Args:
        t: a triangle of the mesh, not a finest one.
        F: gets the bottoms of all diamonds that are split.
        T: the mesh.
        n: exponent of the square's side.
    """
    t_n = long_side_neighbor(t, T, n)
    if t_n is not None and level(t_n, n) < level(t, n):
        force_split(t_n, F, T, n)
        t_n = long_side_neighbor(t, T, n)
    for member in (t, t_n):
        if member is not None:
            T.remove(member)
            for half in children(member):
                T.add(half)
                F.append(half)


def refine(n: int, inaccurate: Callable[[Triangle], bool]) -> set[Triangle]:
    """The coarsest conforming mesh of which no triangle is inaccurate: it is the same in whatever order they come.

    Args:
        n: exponent of the square's side.
        inaccurate: any criterion; it is not asked of the finest triangles.
    """
    T = set(roots(n))
    F = list(T)
    while F:
        t = F.pop()
        if t in T and not is_finest(t) and inaccurate(t):
            force_split(t, F, T, n)
    return T


def refine_by_priority(n: int, priority: Callable[[Triangle], float], triangles: int) -> set[Triangle]:
    """The mesh that splits by priority leave when the next one, with what it forces, would exceed a budget.

    Args:
        n: exponent of the square's side.
        priority: pixels; what has none above 0 is not split.
        triangles: the budget.
    """
    T = set(roots(n))
    F = PriorityQueue(priority, n)
    for t in roots(n):
        F.append(t)
    while (first := F.extract(T)) is not None and first[0] > 0:
        if len(T) + cost(first[1], T, n) > triangles:
            break
        force_split(first[1], F, T, n)
    return T


def cost(t: Triangle, T: set[Triangle], n: int) -> int:
    """By how many triangles the mesh grows if t is split: one for each top triangle of the diamonds that it forces."""
    t_n = long_side_neighbor(t, T, n)
    if t_n is None:
        return 1
    return 2 + (cost(t_n, T, n) if level(t_n, n) < level(t, n) else 0)
