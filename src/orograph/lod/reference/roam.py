"""ROAM: the mesh of the last frame, a queue of what to split and a queue of what to merge.

Duchaineau, Wolinsky, Sigeti, Miller, Aldrich & Mineev-Weinstein 1997, *ROAMing Terrain: Real-time Optimally Adapting
Meshes*, sec. 4 (queues) and 6 (wedgies); lecture, slides *Incremental* and *ROAM 1997*. From one frame to the next the
camera moves little and so the mesh changes little. Q_s holds the triangles of the mesh by how much they need to be
split, Q_m its mergeable diamonds by how much they would be missed. Splits and merges alternate until the queues meet:
no triangle needs a split more than a merge would be missed. What "until the queues meet" leaves open:

- *A tolerance.* Queues that meet say that no swap is worth while; a mesh that is finer than the tolerance asks for
  would stay. So merges go on as long as what they miss is within the tolerance.
- *A budget.* The target size is hardly ever hit, for a forced split brings several triangles. The loop ends when the
  queues have met and the first split does not fit.
- *A memory.* If priorities never grow from parents to children the mesh is a function of the view alone, however the
  camera came there. The paper nests its wedgies for that. With other priorities the tolerance is kept as well, but the
  mesh depends on its past.
"""

from __future__ import annotations

import functools
import heapq
import math
from collections.abc import Callable

from orograph.lod.reference.children import Triangle, Vertex, apex, bottom, children, is_finest, level, roots, top
from orograph.lod.reference.terrain import Ground
from orograph.lod.reference.top_down import PriorityQueue, cost, force_split

Priority = Callable[[Triangle], float]


def wedgies(ground: Ground) -> dict[Triangle, float]:
    """e_T of all triangles: e_T = max(e_T0, e_T1) + |z(v_c) − z_T(v_c)|, metres, from the bottom to the top."""
    e: dict[Triangle, float] = {}

    def thickness(t: Triangle) -> float:
        e[t] = 0.0
        if not is_finest(t):
            e[t] = max(thickness(half) for half in children(t)) + ground.miss(t)
        return e[t]

    for root in roots(ground.n):
        thickness(root)
    return e


class Roam:
    """The mesh T of a square of 2^n cells a side, from frame to frame.

    Attributes:
        T: the triangles.
        Q_m: mergeable diamonds by the larger priority of their two tops, the least first, among equals the finer one.
        splits, merges: how many diamonds the last frame split and merged.
    """

    def __init__(self, n: int) -> None:
        self.n, self.T = n, set(roots(n))
        self.Q_m: list[tuple[float, int, Vertex]] = []
        self.splits = self.merges = 0

    def frame(self, priority: Priority, *, tolerance: float = 0.0, triangles: float = math.inf) -> set[Triangle]:
        """Bring the mesh to what a view wants, and return it.

        Args:
            priority: of a triangle in pixels, seen from this frame's camera.
            tolerance: the largest priority that may stay unsplit.
            triangles: the budget, at least 2.
        """
        self.start(priority)
        while True:
            s, t = self.highest_split()
            m, diamond = self.lowest_merge()
            if len(self.T) > triangles:
                self.merge(diamond)
            elif s > tolerance and (s > m or len(self.T) + cost(t, self.T, self.n) <= triangles):
                self.split(t)
            elif m <= tolerance:
                self.merge(diamond)
            else:
                return self.T

    def start(self, priority: Priority) -> None:
        """Compute the priorities of all elements of both queues anew."""
        self.priority = functools.cache(priority)
        self.Q_s, self.Q_m = PriorityQueue(self.priority, self.n), []
        self.splits = self.merges = 0
        for t in self.T:
            self.Q_s.append(t)
        for diamond in {apex(t) for t in self.T}:
            self.offer(diamond)

    def is_mergeable(self, diamond: Vertex) -> bool:
        """Whether the whole bottom of a diamond is in the mesh."""
        below = bottom(diamond, self.n)
        return bool(below) and self.T.issuperset(below)

    def offer(self, diamond: Vertex) -> None:
        """Put a diamond into Q_m if it is mergeable."""
        if self.is_mergeable(diamond):
            tops = top(diamond, self.n)
            entry = max(self.priority(t) for t in tops), -level(tops[0], self.n), diamond
            heapq.heappush(self.Q_m, entry)

    def highest_split(self) -> tuple[float, Triangle]:
        """The first of Q_s, which stays there; what has left the mesh is dropped."""
        while self.Q_s.heap[0][2] not in self.T:
            heapq.heappop(self.Q_s.heap)
        pi, _, t = self.Q_s.heap[0]
        return -pi, t

    def lowest_merge(self) -> tuple[float, Vertex]:
        """The first of Q_m, which stays there; infinite if there is none."""
        while self.Q_m and not self.is_mergeable(self.Q_m[0][2]):
            heapq.heappop(self.Q_m)
        return (self.Q_m[0][0], self.Q_m[0][2]) if self.Q_m else (math.inf, (0, 0))

    def split(self, t: Triangle) -> None:
        """Force split t; its halves and those of what it forced enter Q_s, the diamonds that are whole now Q_m."""
        added: list[Triangle] = []
        force_split(t, added, self.T, self.n)
        for half in added:
            self.Q_s.append(half)
        changed = {apex(half) for half in added}
        self.splits += len(changed)
        for diamond in changed:
            self.offer(diamond)

    def merge(self, diamond: Vertex) -> None:
        """Take the bottom of a diamond back; its top enters Q_s, and the diamonds that are whole by it Q_m."""
        self.merges += 1
        self.T.difference_update(bottom(diamond, self.n))
        for t in top(diamond, self.n):
            self.T.add(t)
            self.Q_s.append(t)
            self.offer(apex(t))
