"""Refinement that remembers nothing: what the lecture calls state-less, for criteria that are diamond monotonic.

Lecture, slides *Diamond Monotonicity* and *State-Less Refinement with Diamond Monotonicity*; Lindstrom & Pascucci 2002,
sec. 4; Pajarola & Gobbetti 2007, sec. 3.3. A criterion is diamond monotonic if an inaccurate diamond has inaccurate
parents only. Both top triangles of a diamond ask the diamond, so on both sides of every hypotenuse the answer is the
same, and the mesh conforms although no triangle knows of any other.

With a priority queue refinement may end at any time, if π(i) < min π(j) for all parents j of i: a child then comes
after its parents, and the two top triangles of a diamond come one after the other. Corrected:

- *Ties.* The strict inequality does not hold for errors in pixels: near the eye many are infinite. Among equals the
  coarser diamond comes first, and of one level the one farther north, then farther west: both top triangles of a
  diamond come together.
- *The end.* "Before termination, process the top element in queue if it is long edge neighbor of last processed
  triangle": of a *split* triangle. An accurate one leaves nothing to be closed.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable

from orograph.lod.reference.children import Triangle, Vertex, children, diamond_top_sibling, is_finest, level, roots


def refine(n: int, inaccurate: Callable[[Vertex], bool]) -> list[Triangle]:
    """The mesh of a square of 2^n cells a side, by a fifo queue.

    Args:
        n: exponent of the square's side.
        inaccurate: a diamond monotonic criterion.
    """
    T: list[Triangle] = []
    F = deque(roots(n))
    while F:
        t = F.popleft()
        if is_finest(t) or not inaccurate(t.diamond):
            T.append(t)
        else:
            F.extend(children(t))
    return T


def refine_by_priority(
    n: int, priority: Callable[[Vertex], float], is_over: Callable[[int], bool], tolerance: float = 0.0
) -> list[Triangle]:
    """The mesh when time is over, or nothing exceeds the tolerance.

    Args:
        n: exponent of the square's side.
        priority: of a diamond, pixels; no larger than that of its parents.
        is_over: asked before each split, with the number of triangles that there are.
        tolerance: pixels.
    """

    def entry(t: Triangle) -> tuple[float, int, tuple[float, float], Triangle]:
        pi = -1.0 if is_finest(t) else priority(t.diamond)
        return -pi, level(t, n), (t.y, t.x), t

    T: list[Triangle] = []
    F = [entry(t) for t in roots(n)]
    heapq.heapify(F)
    last: Triangle | None = None
    while F:
        pi, _, _, t = F[0]
        is_neighbour = last is not None and t == diamond_top_sibling(last, n)
        if not is_neighbour and is_over(len(T) + len(F)):
            break
        heapq.heappop(F)
        if is_finest(t) or -pi <= tolerance:
            T.append(t)
        else:
            for half in children(t):
                heapq.heappush(F, entry(half))
            last = t
    return T + [t for *_, t in F]
