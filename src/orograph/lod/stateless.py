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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.lod.bisection import copy_triangle, halve, has_area, has_heights, squeezed
from orograph.lod.budget import by_tolerance
from orograph.lod.criterion import (
    DROP,
    SPLIT,
    UNBOUNDED,
    Criterion,
    first_bits,
    judge,
    look_up,
    sphere_priority,
)
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.pages import BEYOND
from orograph.lod.queues import (
    ANY,
    HEAD,
    LEVEL_SHIFT,
    ORDERS,
    QUEUE,
    TAIL,
    Queue,
    check_size,
    code_of,
    first_place,
    is_ordered,
    put_in,
    take_out,
)
from orograph.lod.right_triangles import Mesh, MeshOptions, RightTriangleMeshes
from orograph.viewpoint import Camera

DONE, MISSED, GROW, PAUSED, FULL = 0, 1, 2, 3, 4
"""Why the kernel returns: the queue is empty; pages are missing; no room; enough for now; budget used up."""

OUT, DRAWN, TAKEN, STALLED, FREE, LAST, BEGUN = 0, 1, 4, 5, 6, 7, 8
"""Counts, with ``queues.HEAD`` and ``TAIL``: triangles put out; those and the drawn ones in the queue; triangles taken;
those in a row that lacked a page; free places; the diamond of the last one taken; whether the roots were evaluated."""


class Limits(NamedTuple):
    """When a refinement ends.

    Attributes:
        ordered: largest bound first (a heap), else a FIFO.
        budget: most triangles drawn, but for what splits of mixed ones take. limit: most triangles taken in one call.
        closing: at the limit, still take the long-edge neighbour of the last one.
    """

    ordered: bool
    budget: int
    limit: int
    closing: bool


class Places(NamedTuple):
    """The triangles in the queue, by place.

    Attributes:
        corners: int64 (places, 3), heights: float32 (places, 4): see ``lod.bisection``.
        shown: uint8 (places,), whether it is drawn if it stays. bits: int64 (places,), see ``lod.criterion``.
        free: int64 (places,), places not in use.
    """

    corners: NDArray[np.int64]
    heights: NDArray[np.float32]
    shown: NDArray[np.uint8]
    bits: NDArray[np.int64]
    free: NDArray[np.int64]


class Halves(NamedTuple):
    """The two halves of the triangle that is taken.

    Attributes:
        corners: int64 (2, 3), heights: float32 (2, 4). drawn, split: bool (2,). bits: int64 (2,).
        priorities: float64 (2,).
    """

    corners: NDArray[np.int64]
    heights: NDArray[np.float32]
    drawn: NDArray[np.bool_]
    split: NDArray[np.bool_]
    bits: NDArray[np.int64]
    priorities: NDArray[np.float64]


@inlined
def evaluate(pages, criterion, ordered, level, leaf_level, halves, i, bits):
    """Evaluate half i: whether it is drawn if it stays, whether it is split, its bits and its priority.

    Args:
        bits: of the triangle that it halves.

    Returns: whether its page is missing.
    """
    er, ec, xr, xc, ar, ac = squeezed(halves.corners, i, pages.edge)
    drawn, split, missed = has_area(er, ec, xr, xc, ar, ac), False, False
    halves.priorities[i] = 0.0
    if level < leaf_level:
        key = (halves.corners[i, 0] + halves.corners[i, 1]) >> 1
        slot, z, e, r, c = look_up(pages, key, (leaf_level >> 1) - 1 - (level >> 1))
        missed = slot < 0 and slot != BEYOND
        state, height, bits = judge(pages, criterion, key, z, e, r, c, bits)
        halves.heights[i, 3] = height
        drawn, split = drawn and state != DROP, state == SPLIT
        if split and ordered:
            # (Roundings must not put a child before its parent.)
            bound = sphere_priority(pages, criterion, key, z, e, r, c)
            halves.priorities[i] = (
                bound if bound == np.inf else min(bound * (1.0 + 1e-9 * (leaf_level - level)), UNBOUNDED)
            )
    halves.drawn[i], halves.split[i], halves.bits[i] = drawn and has_heights(halves.heights, i), split, bits
    return missed


@inlined
def put_halves(ordered, level, leaf_level, places, queue, keys, zs, halves, counts):
    """Put the halves into the queue if they are split, else out if they are drawn."""
    for i in range(2):
        if halves.split[i]:
            counts[FREE] -= 1
            place = places.free[counts[FREE]]
            copy_triangle(halves.corners, halves.heights, i, places.corners, places.heights, place)
            places.shown[place], places.bits[place] = halves.drawn[i], halves.bits[i]
            code = code_of((halves.corners[i, 0] + halves.corners[i, 1]) >> 1, level, leaf_level >> 1)
            put_in(queue, counts, ordered, halves.priorities[i], code, place)
        elif halves.drawn[i]:
            for k in range(3):
                keys[counts[OUT], k], zs[counts[OUT], k] = halves.corners[i, k], halves.heights[i, k]
            counts[OUT] += 1


@leaf
def refine_queue(pages, criterion, limits, leaf_level, places, queue, keys, zs, halves, counts):
    """Take triangles from the queue until it is empty, or something else ends it; returns why. It can be called again.

    Args:
        pages: ``field.Pages``. criterion: ``Criterion``. limits: ``Limits``. leaf_level: 2n. places: ``Places``.
            queue: ``Queue``, of places. halves: ``Halves``; at first they are the roots.
        keys: int64 (capacity, 3), zs: float32 (capacity, 3), the triangles put out.
        counts: int64 (9,).
    """
    ordered = limits.ordered
    room = len(queue.codes)
    taken_before = counts[TAKEN]
    while True:
        # 1. The next triangle, and its halves.
        t, code, level = np.int64(-1), np.int64(-1), np.int64(0)
        bits = first_bits(criterion)
        if counts[BEGUN]:
            if counts[HEAD] == counts[TAIL]:
                return DONE
            at = first_place(queue, counts, ordered)
            t, code = queue.slots[at], queue.codes[at]
            if counts[TAKEN] - taken_before >= limits.limit and not (limits.closing and code == counts[LAST]):
                return PAUSED
            if counts[TAIL] - counts[HEAD] + 2 > room or counts[OUT] + 2 > len(keys) or counts[FREE] < 1:
                return GROW
            level = (code >> LEVEL_SHIFT) + 1
            bits = places.bits[t]
            halve(places.corners, places.heights, t, halves.corners, halves.heights, 0)
        # 2. Evaluate them.
        missed = False
        for i in range(2):
            missed |= evaluate(pages, criterion, ordered, level, leaf_level, halves, i, bits)
        if missed:
            if ordered or t < 0:
                return MISSED
            # The triangle goes to the end of the queue; the others come first.
            counts[HEAD] += 1
            put_in(queue, counts, False, 0.0, code, t)
            counts[STALLED] += 1
            if counts[STALLED] > counts[TAIL] - counts[HEAD]:
                counts[STALLED] = 0
                return MISSED
            continue
        change = np.int64(halves.drawn[0]) + np.int64(halves.drawn[1])
        if t >= 0:
            change -= np.int64(places.shown[t])
        if ordered and t >= 0 and code != counts[LAST] and queue.priorities[0] < np.inf:
            # A new diamond: is there room for its other half, too? (It is second in the heap, if there is one.)
            size = counts[TAIL]
            other = (size > 1 and queue.codes[1] == code) or (size > 2 and queue.codes[2] == code)
            if counts[DRAWN] + change + (1 if other else 0) > limits.budget:
                return FULL
        # 3. Put them out or into the queue.
        if t >= 0:
            take_out(queue, counts, ordered)
            places.free[counts[FREE]] = t
            counts[FREE] += 1
            counts[TAKEN] += 1
            counts[LAST] = code
        counts[BEGUN] = 1
        counts[DRAWN] += change
        counts[STALLED] = 0
        put_halves(ordered, level, leaf_level, places, queue, keys, zs, halves, counts)


class _Work:
    """Queue and output of one refinement."""

    def __init__(self, method: Stateless, capacity: int) -> None:
        n = method.field.n
        self.places = Places(
            np.empty((capacity, 3), np.int64), np.empty((capacity, 4), np.float32), np.empty(capacity, np.uint8),
            np.empty(capacity, np.int64), np.arange(capacity - 1, -1, -1),
        )  # fmt: skip
        self.queue = Queue(np.empty(capacity), np.empty(capacity, np.int64), np.empty(capacity, np.int64))
        self.keys, self.zs = np.empty((2 * capacity, 3), np.int64), np.empty((2 * capacity, 3), np.float32)
        self.counts = np.zeros(9, np.int64)
        self.counts[FREE], self.counts[LAST] = capacity, -1
        size = 1 << n
        nw, ne, sw, se = 0, size, size << 32, size << 32 | size
        z = method.field.corners
        fresh, fresh_z = np.zeros((2, 3), np.int64), np.zeros((2, 4), np.float32)
        fresh[:] = (nw, se, ne), (se, nw, sw)
        fresh_z[:, :3] = (z[0, 0], z[1, 1], z[0, 1]), (z[1, 1], z[0, 0], z[1, 0])
        self.halves = Halves(
            fresh, fresh_z, np.zeros(2, np.bool_), np.zeros(2, np.bool_), np.zeros(2, np.int64), np.zeros(2)
        )

    def grow(self, ordered: bool) -> None:
        """Twice the room, of whatever is nearly full."""
        counts = self.counts
        if counts[OUT] + 2 > len(self.keys):
            self.keys, self.zs = (np.concatenate([a, np.empty_like(a)]) for a in (self.keys, self.zs))
        more = len(self.queue.codes)
        if counts[TAIL] - counts[HEAD] + 2 > more or counts[FREE] < 1:
            self.places = Places(*(np.concatenate([a, np.empty_like(a)]) for a in self.places))
            count = int(counts[FREE])
            self.places.free[count : count + more] = np.arange(2 * more - 1, more - 1, -1)
            counts[FREE] += more
            live = slice(0, more) if ordered else np.arange(counts[HEAD], counts[TAIL]) % more
            kept = [a[live] for a in self.queue]
            self.queue = Queue(*(np.concatenate([a, np.empty(2 * more - len(a), a.dtype)]) for a in kept))
            if not ordered:
                counts[HEAD], counts[TAIL] = 0, counts[TAIL] - counts[HEAD]

    def waiting(self) -> NDArray[np.int64]:
        """The places of the drawn triangles that are still in the heap."""
        places: NDArray[np.int64] = self.queue.slots[: self.counts[TAIL]]
        drawn: NDArray[np.int64] = places[self.places.shown[places] == 1]
        return drawn


@dataclass(frozen=True, slots=True, kw_only=True)
class StatelessOptions(MeshOptions):
    """Options of ``stateless``. See ``MeshOptions``."""

    queue: str | None = option(None, QUEUE + ". Priorities are the bounds over spheres.", choices=ORDERS, shown=ANY)


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
        self.queue: str | None = self.options.queue
        self._capacity = 1 << 12

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        tolerance, triangles, seconds = goal.tolerance, goal.triangles, goal.seconds
        ordered = is_ordered(self.queue, goal)
        if tolerance is None and not ordered:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        began = time.perf_counter()
        work = _Work(self, self._capacity)
        lens = self._lens(camera, tolerance or 0.0)
        criterion = Criterion(lens, self.spheres, self.cull, self._pruned(lens))
        no_limit = 1 << 62
        limit, closing = no_limit if seconds is None else 1024, False
        while True:
            self.field.begin()
            why = refine_queue(
                self.field.pages, criterion,
                Limits(ordered, no_limit if triangles is None else triangles, limit, closing), 2 * self.field.n,
                work.places, work.queue, work.keys, work.zs, work.halves, work.counts,
            )  # fmt: skip
            if why == GROW:
                work.grow(ordered)
            elif why == MISSED:
                self.field.fetch(resumes=True)
            elif why in (DONE, FULL) or closing:
                break
            mixed = work.counts[TAIL] > 0 and work.queue.priorities[0] == np.inf
            if seconds is not None and time.perf_counter() - began > 0.9 * seconds and work.counts[BEGUN] and not mixed:
                limit, closing = 0, True
        return self._result(work, tolerance)

    def _result(self, work: _Work, tolerance: float | None) -> Mesh:
        self._capacity = max(self._capacity, len(work.queue.codes))
        count = int(work.counts[OUT])
        keys, zs = work.keys[:count], work.zs[:count]
        left, reached = int(work.counts[TAIL] - work.counts[HEAD]), tolerance
        if tolerance is None:
            places = work.waiting()
            keys = np.concatenate([keys, work.places.corners[places]])
            zs = np.concatenate([zs, work.places.heights[places, :3]])
            reached = float(work.queue.priorities[0]) if left else 0.0
        within = reached is not None and reached < UNBOUNDED
        return Mesh(
            keys, zs, is_strip=False, clockwise=False, triangles=len(keys), within=within,
            tolerance=reached if within else None,
            stats={"taken": int(work.counts[TAKEN]), "queue": "priority" if tolerance is None else "fifo"},
        )  # fmt: skip
