"""Top-down refinement with forced splits, on triangles with links to their neighbours.

The lecture's *Top Down Refinement on Triangles* (after Duchaineau et al. 1997, *ROAMing Terrain*, sec. 4 and 5): start
with the two triangles of the square; take one from a queue; if it is not accurate, split it together with the triangle
across its hypotenuse, and where that one is coarser force its split first. Explicit neighbours make this work for any
criterion: nothing has to be monotonic, so the tightest metric can be used, one that looks at each triangle by itself.

With a FIFO the order does not matter and the result is the coarsest conforming mesh in which every triangle is
accurate. With a priority queue (largest error in pixels first; the coarser first among equals) it can stop at any
moment with a valid mesh that is about the best of its size: at a number of triangles, or at a time. Only triangles
that ground and missing ground share are split before it may stop: no mesh that keeps one is sound.

The kernel is in ``top_down_pass``. Metres, pixels.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from orograph.errors import UsageError
from orograph.lod.budget import by_tolerance
from orograph.lod.criterion import (
    NEAR,
    NOTHING,
    UNBOUNDED,
    Criterion,
)
from orograph.lod.localise import STACK
from orograph.lod.look_ahead import DEPTH
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.pace import Deadline, Pace
from orograph.lod.queues import (
    ANY,
    HEAD,
    LEVEL_SHIFT,
    ORDERS,
    QUEUE,
    TAIL,
    Queue,
    check_size,
    is_ordered,
)
from orograph.lod.right_triangles import EVERY, METRIC, Mesh, MeshOptions, RightTriangleMeshes
from orograph.lod.top_down_pass import (
    DONE,
    FULL,
    GROW,
    LEVEL,
    MADE,
    MISSED,
    SPLITS,
    Limits,
    Scratch,
    Search,
    Triangles,
    refine_triangles,
)
from orograph.viewpoint import Camera

NO_LIMIT = 1 << 62


class _State:
    """The mesh of one refinement, and its queue."""

    def __init__(self, method: TopDown, capacity: int) -> None:
        n = method.field.n
        self.triangles = Triangles(
            np.empty((capacity, 3), np.int64), np.empty((capacity, 4), np.float32), np.empty((capacity, 4), np.int32),
            np.zeros(capacity, np.uint8),
        )  # fmt: skip
        self.queue = Queue(np.empty(capacity), np.empty(capacity, np.int64), np.empty(capacity, np.int64))
        self.counts = np.zeros(6, np.int64)
        size = 1 << n
        nw, ne, sw, se = 0, size, size << 32, size << 32 | size
        z = method.field.corners
        fresh, fresh_z = np.zeros((4, 3), np.int64), np.zeros((4, 4), np.float32)
        fresh[:2] = (nw, se, ne), (se, nw, sw)
        fresh_z[:2, :3] = (z[0, 0], z[1, 1], z[0, 1]), (z[1, 1], z[0, 0], z[1, 0])
        self.scratch = Scratch(
            np.empty(2 * n + 2, np.int64), fresh, fresh_z, np.empty(4), np.empty(4, np.uint8),
            np.empty((method.depth + 2, STACK)),
        )  # fmt: skip

    def grow(self, ordered: bool) -> None:
        """Twice the room."""
        more = len(self.triangles.drawn)
        self.triangles = Triangles(*(np.concatenate([a, np.zeros_like(a)]) for a in self.triangles))
        head, tail = int(self.counts[HEAD]), int(self.counts[TAIL])
        live = np.arange(head, tail) % more
        kept = [a if ordered else a[live] for a in self.queue]
        self.queue = Queue(*(np.concatenate([a, np.zeros(2 * more - len(a), a.dtype)]) for a in kept))
        if not ordered:
            self.counts[HEAD], self.counts[TAIL] = 0, tail - head


@dataclass(frozen=True, slots=True, kw_only=True)
class TopDownOptions(MeshOptions):
    """Options of ``top-down``. See ``MeshOptions``."""

    metric: str | None = option(None, METRIC, choices=EVERY)
    queue: str | None = option(None, QUEUE + ".", choices=ORDERS, shown=ANY)
    depth: int = option(DEPTH, "How often the metric 'localised' bisects a triangle to find its largest error.",
                        unit="halvings", least=0, most=64)  # fmt: skip
    near: float = option(NEAR, "It bisects where a sphere's radius exceeds this share of its least depth.", least=0)


class TopDown(RightTriangleMeshes):
    """Top-down refinement with forced splits.

    A tolerance needs no order and is always reached by the FIFO. See ``RightTriangles`` for the arguments.

    Raises:
        UsageError: the terrain is beyond 2^26 samples a side.
    """

    info = MethodInfo(
        "top-down", "split what exceeds the tolerance, and first whatever must be split so that no crack opens",
        "Duchaineau et al. 1997 (ROAM), sec. 4 and 5: forced splits", "triangles", TopDownOptions,
        lambda options: options.conservative,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        check_size(self.info.name, self.terrain)
        self.queue: str | None = self.options.queue
        self.depth: int = self.options.depth
        self.near: float = self.options.near
        self._capacity = 1 << 12
        self._pace, self._gathering = Pace(), Pace(1e-7)

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        tolerance, triangles, seconds = goal.tolerance, goal.triangles, goal.seconds
        ordered = is_ordered(self.queue, goal)
        if tolerance is None and not ordered:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        deadline = Deadline(seconds)
        state = _State(self, self._capacity)
        criterion = Criterion(self._lens(camera, tolerance or 0.0), self.metric.number, self.cull, NOTHING)
        limits = Limits(ordered, tolerance or 0.0, NO_LIMIT if triangles is None else triangles, NO_LIMIT)
        stalls = before = 0
        while True:
            self.field.begin()
            left, done = deadline.left(self._gathering.unit * state.counts[MADE]), int(state.counts[SPLITS])
            if seconds is not None:
                limits = limits._replace(splits=self._pace.fitting(left / 2.0))
            why = refine_triangles(
                self.field.pages, criterion, Search(self.depth, self.near), limits, 2 * self.field.n, state.triangles,
                state.queue, state.scratch, state.counts,
            )  # fmt: skip
            if seconds is not None:
                after = deadline.left(self._gathering.unit * state.counts[MADE])
                self._pace.learn(left - after, int(state.counts[SPLITS]) - done)
            if why == GROW:
                state.grow(ordered)
            elif why == MISSED:
                self.field.fetch(resumes=True)
                stalls = stalls + 1 if state.counts[SPLITS] == before else 0
                before = int(state.counts[SPLITS])
                if stalls > len(self.field.pages.used) + 8:
                    raise UsageError(
                        "One split needs more tiles than memory allows.",
                        remedy="Allow more memory (`max_memory`), or a smaller depth.",
                    )
            elif why in (DONE, FULL):
                break
            mixed = state.counts[TAIL] > 0 and state.queue.priorities[0] == np.inf
            if deadline.is_near(self._gathering.unit * state.counts[MADE]) and state.counts[MADE] and not mixed:
                break
        began = time.perf_counter()
        mesh = self._result(state, tolerance)
        self._gathering.learn(time.perf_counter() - began, int(state.counts[MADE]))
        return mesh

    def _result(self, state: _State, tolerance: float | None) -> Mesh:
        made, left = int(state.counts[MADE]), int(state.counts[TAIL] - state.counts[HEAD])
        self._capacity = max(self._capacity, len(state.triangles.drawn))
        reached = tolerance
        within = True
        if tolerance is None:
            # What is left in the queue (split triangles, too, but those come no later than their halves).
            reached = self._reached(state, left)
            within = reached < UNBOUNDED
        drawn = np.flatnonzero(state.triangles.drawn[:made])
        return Mesh(
            state.triangles.corners[drawn], state.triangles.heights[drawn, :3], is_strip=False, clockwise=False,
            triangles=len(drawn), within=within, tolerance=reached if within else None,
            stats={
                "splits": int(state.counts[SPLITS]), "front": made,
                "queue": "priority" if tolerance is None else "fifo",
            },
        )  # fmt: skip

    @staticmethod
    def _reached(state: _State, left: int) -> float:
        """The largest error in the queue, pixels, of triangles that still exist."""
        queue = state.queue
        there = state.triangles.links[queue.slots[:left], LEVEL] == queue.codes[:left] >> LEVEL_SHIFT
        return float(queue.priorities[:left][there].max(initial=0.0))
