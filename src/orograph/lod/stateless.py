"""Refinement without a mesh: a queue of triangles goes in, triangles come out, and nothing else is remembered.

The lecture's *State-Less Refinement with Diamond Monotonicity* (Lindstrom & Pascucci 2002, sec. 4; Pajarola & Gobbetti
2007, sec. 3.3). A criterion is diamond monotonic if a diamond that is inaccurate has inaccurate parents only; both its
top triangles take its value. Then triangles can be judged one by one: whichever is not accurate is replaced by its
halves, and where two meet they have decided alike. No neighbours, no forced splits, no marks; the sphere metrics are
monotonic because errors are and because spheres are nested.

With a FIFO the refinement ends when the queue is empty. With a priority queue it can end at any time, if its order puts
parents before children and the two top triangles of a diamond next to each other, for then every diamond but perhaps
the last is wholly split or not at all; "before termination, process the top element if it is the long-edge neighbour of
the last processed triangle" closes that last one. The order here: larger bounds in pixels first, among equals coarser
levels first, within a level by the diamond's place. A bound counts (1 + 1e-9 · levels below it) times, so that
roundings cannot put a child before its parent. By induction: when a diamond's first top triangle is taken, everything
before the diamond has been taken, its parents among it; so the other one is in the queue, and next.
(docs/methods/stateless.md)

Diamonds that ground and missing ground share come before all others, as their parents do, and are split whatever the
budget or the time: no mesh that keeps one is sound.

Every triangle is judged when it is made. Keys: ``row << 32 | col`` of the padded square; metres, pixels.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.error.screen import color_exceeds, outside, sphere_bound, sphere_exceeds, to_camera
from orograph.lod.field import find
from orograph.lod.look_ahead import foresee
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.pages import BEYOND
from orograph.lod.queues import ORDERS, QUEUE, check_size, code_of, heap_pop, heap_push
from orograph.lod.right_triangles import UNBOUNDED, Mesh, MeshOptions, RightTriangleMeshes, by_tolerance
from orograph.viewpoint import Camera

DONE, MISSED, GROW, PAUSED, FULL = 0, 1, 2, 3, 4
"""Why the kernel returns: the queue is empty; pages are missing; no room; enough for now; budget used up."""

OUT, DRAWN, HEAD, TAIL, TAKEN, WAITING, FREE, LAST, BEGUN = range(9)
"""Counts: triangles put out; those and the drawn ones that wait; the queue's begin and end; triangles taken; those in a
row that lacked a page; free places; the diamond of the last one taken; whether the roots have been judged."""


@leaf
def refine_queue(
    pages, lens, metric, cull, pruned, ordered, budget, limit, closing, leaf_level,
    corners, heights, shown, masks, free, priorities, codes, slots, keys, zs, fresh, fresh_z, fresh_n, fresh_p, counts,
):  # fmt: skip
    """Take triangles from the queue until it is empty, or something else ends it; returns why. It can be called again.

    Args:
        pages: ``field.Pages``. lens: the camera, with the tolerance. metric: its number, of one on spheres.
        cull: whether triangles out of view are accurate and not drawn.
        pruned: int64, the table of diamonds that are not to be split for their errors (``lod.look_ahead``).
        ordered: largest bound first (a heap), else a FIFO.
        budget: most triangles drawn, but for what splits of mixed ones take. limit: most triangles taken in this call.
        closing: at the limit, still take the long-edge neighbour of the last one.
        leaf_level: 2n.
        corners: int64 (places, 3), left end, right end, apex; heights: float32 (places, 4), theirs and the middle's;
            shown: uint8 (places,), whether it is drawn if it stays; masks: int64 (places,), bits of ``lod.look_ahead``;
            free: int64 (places,), places not in use.
        priorities: float64, codes: int64, slots: int64, the queue: place of each triangle that waits.
        keys: int64 (capacity, 3), zs: float32 (capacity, 3), the triangles put out.
        fresh: int64 (2, 3), fresh_z: float32 (2, 4), fresh_n: int64 (2, 3), fresh_p: float64 (2,): triangles to be,
            with (drawn, to be split, bits) and priority.
        counts: int64 (9,).
    """
    n = leaf_level >> 1
    last_row, last_col = pages.edge[0], pages.edge[1]
    room = len(priorities)
    taken_before = counts[4]
    while True:
        # 1. The next triangle, and its halves.
        t = np.int64(-1)
        code = np.int64(-1)
        level = np.int64(0)
        mask = np.int64(64 if len(pruned) == 1 else 0)
        if counts[8]:
            if counts[2] == counts[3]:
                return 0
            at = 0 if ordered else counts[2] % room
            t, code = slots[at], codes[at]
            if counts[4] - taken_before >= limit and not (closing and code == counts[7]):
                return 3
            if counts[3] - counts[2] + 2 > room or counts[0] + 2 > len(keys) or counts[6] < 1:
                return 2
            level = (code >> 54) + 1
            mask = masks[t]
            m = (corners[t, 0] + corners[t, 1]) >> 1
            for half in range(2):
                fresh[half, 0] = corners[t, 2] if half == 0 else corners[t, 1]
                fresh[half, 1] = corners[t, 0] if half == 0 else corners[t, 2]
                fresh[half, 2] = m
                fresh_z[half, 0] = heights[t, 2] if half == 0 else heights[t, 1]
                fresh_z[half, 1] = heights[t, 0] if half == 0 else heights[t, 2]
                fresh_z[half, 2] = heights[t, 3]
        # 2. Whether they are accurate.
        missed = False
        for i in range(2):
            er, ec = fresh[i, 0] >> 32, fresh[i, 0] & 0xFFFFFFFF
            xr, xc = fresh[i, 1] >> 32, fresh[i, 1] & 0xFFFFFFFF
            ar, ac = fresh[i, 2] >> 32, fresh[i, 2] & 0xFFFFFFFF
            mr, mc = (er + xr) >> 1, (ec + xc) >> 1
            er, xr, ar = min(er, last_row), min(xr, last_row), min(ar, last_row)
            ec, xc, ac = min(ec, last_col), min(xc, last_col), min(ac, last_col)
            has_area = (xc - ec) * (ar - er) != (ac - ec) * (xr - er)
            drawn = has_area
            split = False
            inside = mask
            priority = 0.0
            if level < leaf_level:
                slot, u, v = find(pages, mr, mc, n - 1 - (level >> 1))
                if slot < 0:
                    missed = missed or slot != BEYOND
                    fresh_n[i, 0], fresh_n[i, 1], fresh_n[i, 2], fresh_p[i] = 0, 0, inside, priority
                    continue
                z = pages.data[slot, u, v, 0]
                e = np.float64(pages.data[slot, u, v, 1])
                r = np.float64(pages.data[slot, u, v, 2])
                c = np.float64(pages.data[slot, u, v, 3])
                fresh_z[i, 3] = z if c >= 0.0 else np.float32(np.nan)
                drawn = drawn and r >= 0.0
                r = abs(r) * lens[15]
                mc, mr = min(mc, last_col), min(mr, last_row)
                out = False
                if cull:
                    out, inside = outside(lens, mc, mr, np.float64(z), r, inside)
                if out:
                    drawn = False
                else:
                    x, y, w = to_camera(lens, mc, mr, np.float64(z))
                    c = c if c >= 0.0 else -1.0 - c
                    colored = color_exceeds(lens, c, w, r)
                    split = e == np.inf or colored or sphere_exceeds(lens, metric, x, y, w, e, r)
                    if inside < 64:
                        key = (fresh[i, 0] + fresh[i, 1]) >> 1
                        split, hidden, inside = foresee(pruned, key, w, r, split, inside)
                        drawn = drawn and not hidden
                    if split and ordered:
                        priority = UNBOUNDED
                        if e == np.inf:
                            priority = np.inf
                        elif not colored:
                            bound = sphere_bound(lens, metric, x, y, w, e, r) * (1.0 + 1e-9 * (leaf_level - level))
                            priority = min(bound, UNBOUNDED)
            drawn = drawn and fresh_z[i, 0] == fresh_z[i, 0] and fresh_z[i, 1] == fresh_z[i, 1]
            drawn = drawn and fresh_z[i, 2] == fresh_z[i, 2]
            fresh_n[i, 0] = 1 if drawn else 0
            fresh_n[i, 1] = 1 if split else 0
            fresh_n[i, 2] = inside
            fresh_p[i] = priority
        if missed:
            if ordered or t < 0:
                return 1
            # To the end of the queue; the others first.
            counts[2] += 1
            codes[counts[3] % room], slots[counts[3] % room] = code, t
            counts[3] += 1
            counts[5] += 1
            if counts[5] > counts[3] - counts[2]:
                counts[5] = 0
                return 1
            continue
        change = fresh_n[0, 0] + fresh_n[1, 0]
        if t >= 0:
            change -= np.int64(shown[t])
        if ordered and t >= 0 and code != counts[7] and priorities[0] < np.inf:
            # A new diamond: is there room for its other half, too? (It is second in the heap, if there is one.)
            size = counts[3]
            other = (size > 1 and codes[1] == code) or (size > 2 and codes[2] == code)
            if counts[1] + change + (1 if other else 0) > budget:
                return 4
        # 3. Put them out or into the queue.
        if t >= 0:
            if ordered:
                heap_pop(priorities, codes, slots, counts[3])
                counts[3] -= 1
            else:
                counts[2] += 1
            free[counts[6]] = t
            counts[6] += 1
            counts[4] += 1
            counts[7] = code
        counts[8] = 1
        counts[1] += change
        counts[5] = 0
        for i in range(2):
            if fresh_n[i, 1]:
                counts[6] -= 1
                place = free[counts[6]]
                for k in range(3):
                    corners[place, k], heights[place, k] = fresh[i, k], fresh_z[i, k]
                heights[place, 3] = fresh_z[i, 3]
                shown[place], masks[place] = fresh_n[i, 0], fresh_n[i, 2]
                name = code_of((fresh[i, 0] + fresh[i, 1]) >> 1, level, n)
                if ordered:
                    heap_push(priorities, codes, slots, counts[3], fresh_p[i], name, place)
                else:
                    codes[counts[3] % room], slots[counts[3] % room] = name, place
                counts[3] += 1
            elif fresh_n[i, 0]:
                for k in range(3):
                    keys[counts[0], k], zs[counts[0], k] = fresh[i, k], fresh_z[i, k]
                counts[0] += 1


class _Work:
    """Queue and output of one refinement."""

    def __init__(self, method: Stateless, capacity: int) -> None:
        n = method.field.n
        self.places: tuple[NDArray[Any], ...] = (
            np.empty((capacity, 3), np.int64), np.empty((capacity, 4), np.float32), np.empty(capacity, np.uint8),
            np.empty(capacity, np.int64), np.arange(capacity - 1, -1, -1),
        )  # fmt: skip
        self.queue: tuple[NDArray[Any], ...] = (
            np.empty(capacity), np.empty(capacity, np.int64), np.empty(capacity, np.int64)
        )  # fmt: skip
        self.keys, self.zs = np.empty((2 * capacity, 3), np.int64), np.empty((2 * capacity, 3), np.float32)
        self.counts = np.zeros(9, np.int64)
        self.counts[FREE], self.counts[LAST] = capacity, -1
        size = 1 << n
        nw, ne, sw, se = 0, size, size << 32, size << 32 | size
        z = method.field.corners
        fresh, fresh_z = np.zeros((2, 3), np.int64), np.zeros((2, 4), np.float32)
        fresh[:] = (nw, se, ne), (se, nw, sw)
        fresh_z[:, :3] = (z[0, 0], z[1, 1], z[0, 1]), (z[1, 1], z[0, 0], z[1, 0])
        self.scratch = fresh, fresh_z, np.zeros((2, 3), np.int64), np.zeros(2)

    def grow(self, ordered: bool) -> None:
        """Twice the room, of whatever is nearly full."""
        counts = self.counts
        if counts[OUT] + 2 > len(self.keys):
            self.keys, self.zs = (np.concatenate([a, np.empty_like(a)]) for a in (self.keys, self.zs))
        more = len(self.queue[0])
        if counts[TAIL] - counts[HEAD] + 2 > more or counts[FREE] < 1:
            *data, free = (np.concatenate([a, np.empty_like(a)]) for a in self.places)
            count = int(counts[FREE])
            free[count : count + more] = np.arange(2 * more - 1, more - 1, -1)
            counts[FREE] += more
            self.places = *data, free
            live = slice(0, more) if ordered else np.arange(counts[HEAD], counts[TAIL]) % more
            kept = [a[live] for a in self.queue]
            self.queue = tuple(np.concatenate([a, np.empty(2 * more - len(a), a.dtype)]) for a in kept)
            if not ordered:
                counts[HEAD], counts[TAIL] = 0, counts[TAIL] - counts[HEAD]

    def waiting(self) -> NDArray[np.int64]:
        """The places of the drawn triangles that are still in the heap."""
        places: NDArray[np.int64] = self.queue[2][: self.counts[TAIL]]
        drawn: NDArray[np.int64] = places[self.places[2][places] == 1]
        return drawn


@dataclass(frozen=True, slots=True, kw_only=True)
class StatelessOptions(MeshOptions):
    """Options of ``stateless``. See ``MeshOptions``."""

    queue: str = option("priority", QUEUE + "; budgets of the priority queue are spent by the bounds over spheres.",
                        choices=ORDERS)  # fmt: skip


class Stateless(RightTriangleMeshes):
    """Refinement with nothing but a queue.

    A tolerance needs no order and is always reached by the FIFO. See ``RightTriangles`` for the arguments.

    Raises:
        UsageError: the terrain is beyond 2^26 samples a side.
    """

    info = MethodInfo(
        "stateless", "errors made monotonic: every parent is split when its child is; a queue and no mesh",
        "Lindstrom & Pascucci 2002, sec. 4, by a queue; Pajarola & Gobbetti 2007, sec. 3.3", "triangles",
        StatelessOptions, lambda options: options.conservative,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        check_size(self.info.name, self.terrain)
        self.queue: str = self.options.queue
        self._capacity = 1 << 12

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        tolerance, triangles, seconds = goal.tolerance, goal.triangles, goal.seconds
        ordered = tolerance is None and self.queue == "priority"
        if tolerance is None and not ordered:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal)
        began = time.perf_counter()
        work = _Work(self, self._capacity)
        lens = self._lens(camera, tolerance or 0.0)
        pruned = self._pruned(lens)
        no_limit = 1 << 62
        limit, closing = no_limit if seconds is None else 1024, False
        while True:
            self.field.begin()
            why = refine_queue(
                self.field.pages, lens, self.spheres, self.cull, pruned, ordered,
                no_limit if triangles is None else triangles, limit, closing, 2 * self.field.n,
                *work.places, *work.queue, work.keys, work.zs, *work.scratch, work.counts,
            )  # fmt: skip
            if why == GROW:
                work.grow(ordered)
            elif why == MISSED:
                self.field.fetch(resumes=True)
            elif why in (DONE, FULL) or closing:
                break
            mixed = work.counts[TAIL] > 0 and work.queue[0][0] == np.inf
            if seconds is not None and time.perf_counter() - began > 0.9 * seconds and work.counts[BEGUN] and not mixed:
                limit, closing = 0, True
        return self._result(work, tolerance)

    def _result(self, work: _Work, tolerance: float | None) -> Mesh:
        self._capacity = max(self._capacity, len(work.queue[0]))
        count = int(work.counts[OUT])
        keys, zs = work.keys[:count], work.zs[:count]
        left, reached = int(work.counts[TAIL] - work.counts[HEAD]), tolerance
        if tolerance is None:
            places = work.waiting()
            keys = np.concatenate([keys, work.places[0][places]])
            zs = np.concatenate([zs, work.places[1][places, :3]])
            reached = float(work.queue[0][0]) if left else 0.0
        within = reached is not None and reached < UNBOUNDED
        return Mesh(
            keys, zs, is_strip=False, clockwise=False, triangles=len(keys), within=within,
            tolerance=reached if within else None,
            stats={"taken": int(work.counts[TAKEN]), "queue": self.queue},
        )  # fmt: skip
