"""The pool of a concurrent binary tree: its triangles by slot, and the update that brings it nearer to its goal.

Dupuy 2020 keeps a bisection as the bits of its leaves in a heap, whose size grows with the finest triangle there may be
(``lod.reference.cbt``). Here, as in Benyoub & Dupuy 2024, *Concurrent Binary Trees for Large-Scale Game Components*, a
triangle is a slot of a pool that knows its neighbours, and the heap's bits say which slots are in use: its i-th set bit
is thread i's triangle, its i-th clear bit the slot for the i-th new one. The size is that of the mesh, not of the
terrain.

An update, in which every triangle looks only at what was there before it and writes only to itself
(``shaders/cbt.wgsl`` does the same, a dispatch a line):

1. *judge*: is its diamond to be split? Is its parent's not?
2. *mark*: one that is to be split walks across hypotenuses to the first pair of triangles that share theirs, and marks
   both, for they can be split. All on the way are *kept*: they are not merged.
3. *plan*: a marked pair is given slots, if there are; the two or four triangles around a vertex are merged if all
   are leaves of one level, their diamond is not to be split, and none is kept.
4. *apply*: halves of a triangle take its slot and the new one; of merged ones the left one's slot is the parent's. Who
   lies across an edge follows from what is done to that neighbour.

A mesh that conforms conforms afterwards: the two triangles of a diamond are split at once, all of its halves are merged
at once, and neither asks anything of the neighbours that the other could change.

Samples, metres; −1 is no slot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy import triangles

Slots = NDArray[np.int64]
Flags = NDArray[np.bool_]

LEFT, RIGHT, BASE = 0, 1, 2
"""The neighbours at the left leg, the right leg and the hypotenuse."""


@dataclass(slots=True)
class Pool:
    """Triangles by slot.

    Attributes:
        shape: int64 (capacity, 4): x, y, L, ω. level: int64 (capacity,). heights: float32 (capacity, 4), of the left
            end, the right end, the apex and the middle of the hypotenuse, NaN where missing.
        links: int64 (capacity, 3), the neighbours' slots. used: bool (capacity,), the bits.
    """

    shape: Slots
    level: Slots
    heights: NDArray[np.float32]
    links: Slots
    used: Flags

    @classmethod
    def planted(cls, n: int, corners: NDArray[np.float32], capacity: int = 1 << 12) -> Pool:
        """The two triangles of a square of 2^n cells a side, whose corners (2, 2) have these heights."""
        pool = cls(
            np.zeros((capacity, 4), np.int64), np.zeros(capacity, np.int64), np.zeros((capacity, 4), np.float32),
            np.full((capacity, 3), -1), np.zeros(capacity, bool),
        )  # fmt: skip
        (nw, ne), (sw, se) = corners
        pool.shape[:2] = np.stack(triangles.root(np.arange(2), n), -1)
        pool.heights[:2] = (nw, se, ne, np.nan), (se, nw, sw, np.nan)
        pool.links[:2, BASE] = 1, 0
        pool.used[:2] = True
        return pool

    @property
    def leaves(self) -> Slots:
        """The slots in use, in order: what the sums of their bits lead to."""
        return np.flatnonzero(self.used)

    def diamonds(self, slots: Slots) -> Slots:
        """Keys ``row << 32 | col`` of the diamonds that triangles are tops of; of finest ones, they mean nothing."""
        x, y = self.shape[slots, :2].T
        return np.asarray(y << 32 | x)

    def corners(self, slots: Slots) -> Slots:
        """Keys (k, 3) of the left end, the right end and the apex."""
        t = self.shape[slots].T
        ends = [f(*t) for f in (triangles.left_end, triangles.right_end, triangles.apex)]
        return np.stack([y << 32 | x for x, y in ends], -1)

    def grow(self, capacity: int) -> None:
        """More room."""
        for name in ("shape", "level", "heights", "links", "used"):
            old = getattr(self, name)
            new = np.zeros((capacity, *old.shape[1:]), old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)

    def update(self, split: Slots, merge: Slots) -> tuple[int, int]:
        """Split and merge once; how many diamonds were, each.

        Args:
            split: slots of triangles whose diamond is to be split. merge: those whose parent's is not to be.
        """
        marked, kept = self._marked(split)
        tops = np.flatnonzero(marked)
        room = len(self.used) - int(self.used.sum())
        if room < len(tops):
            self.grow(max(2 * len(self.used), len(self.used) + len(tops)))
            marked, kept = (np.concatenate([a, np.zeros(len(self.used) - len(a), bool)]) for a in (marked, kept))
        fresh = np.full(len(self.used), -1)  # where the right halves go
        fresh[tops] = np.flatnonzero(~self.used)[: len(tops)]
        lefts, rights = self._merging(merge, kept)
        split_alone = int((self.links[tops, BASE] < 0).sum())
        merged_alone = int((self.links[lefts, RIGHT] < 0).sum())
        if len(tops) or len(lefts):
            self._apply(tops, fresh, lefts, rights)
        return (len(tops) + split_alone) // 2, (len(lefts) + merged_alone) // 2

    def _marked(self, split: Slots) -> tuple[Flags, Flags]:
        """Which triangles can be split, for others to be or because they are to be; and which are kept."""
        marked, kept = np.zeros(len(self.used), bool), np.zeros(len(self.used), bool)
        t = split
        while len(t):
            kept[t] = True
            across = self.links[t, BASE]
            alone = across < 0
            pair = alone | (self.links[across, BASE] == t)
            marked[t[pair]] = True
            marked[across[pair & ~alone]] = True
            t = np.unique(across[~pair])
        return marked, kept | marked

    def _merging(self, merge: Slots, kept: Flags) -> tuple[Slots, Slots]:
        """Left and right halves of the triangles that come back: of each diamond all, or none."""
        ready = np.zeros(len(self.used), bool)
        ready[merge] = True
        ready &= ~kept
        left = np.flatnonzero(ready)
        left = left[triangles.which_child(*self.shape[left].T) == 0]
        right, far = self.links[left, LEFT], self.links[left, RIGHT]  # far: the other top's right half
        near = self.links[right, LEFT]  # and its left one
        level = self.level[left]
        good = (right >= 0) & ready[right] & (self.level[right] == level)
        for other in (far, near):
            good &= (other < 0) | (ready[other] & (self.level[other] == level))
        return left[good], right[good]

    def _apply(self, tops: Slots, fresh: Slots, lefts: Slots, rights: Slots) -> None:
        """Split ``tops``, whose right halves go to ``fresh``, and merge ``lefts`` with ``rights``."""
        old = self.links.copy()
        into = np.full(len(self.used), -1)  # the slot of the triangle that one is merged into
        into[lefts], into[rights] = lefts, lefts

        def across(t: Slots, edge: int) -> Slots:
            """Who is across an edge of triangles afterwards."""
            there = old[t, edge]
            found = np.where(into[there] >= 0, into[there], there)
            found = np.where((fresh[there] >= 0) & (old[there, RIGHT] == t), fresh[there], found)
            return np.where(there < 0, -1, found)

        live = self.leaves
        for edge in (LEFT, RIGHT, BASE):
            self.links[live, edge] = across(live, edge)
        self._halve(tops, fresh, [across(tops, LEFT), across(tops, RIGHT)], old)
        # Of the parent: across its legs lies what lies across its halves' hypotenuses.
        other = old[lefts, RIGHT]
        links = across(lefts, BASE), across(rights, BASE), np.where(other < 0, -1, into[other])
        ends, far, parent = self.heights[lefts], self.heights[rights], triangles.parent(*self.shape[lefts].T)
        self.links[lefts], self.shape[lefts] = np.stack(links, -1), np.stack(parent, -1)
        self.heights[lefts] = np.stack([ends[:, 1], far[:, 0], ends[:, 0], ends[:, 2]], -1)
        self.level[lefts] -= 1
        self.used[rights] = False

    def _halve(self, tops: Slots, fresh: Slots, legs: list[Slots], old: Slots) -> None:
        """Write the halves of ``tops``; ``legs``: who is across their legs afterwards. old: the links before."""
        new = fresh[tops]
        twin = old[tops, BASE]
        twin_new = np.where(twin < 0, -1, fresh[twin])
        (x, y, L, omega), z = self.shape[tops].T.copy(), self.heights[tops]
        for k, at in enumerate((tops, new)):
            self.shape[at] = np.stack(triangles.child(x, y, L, omega, k), -1)
            self.level[at] = self.level[tops] + (k == 0)
        left, right, apex, middle = z.T
        unknown = np.full(len(tops), np.nan, np.float32)
        self.heights[tops] = np.stack([apex, left, middle, unknown], -1)
        self.heights[new] = np.stack([right, apex, middle, unknown], -1)
        self.links[tops] = np.stack([new, twin_new, legs[0]], -1)
        self.links[new] = np.stack([twin, tops, legs[1]], -1)
        self.used[new] = True
