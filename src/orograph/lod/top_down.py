"""Top-down refinement with forced splits, on triangles that know their neighbours.

The lecture's *Top Down Refinement on Triangles* (after Duchaineau et al. 1997, *ROAMing Terrain*, sec. 4 and 5): start
with the two triangles of the square; take one from a queue; if it is not accurate, split it together with the triangle
across its hypotenuse, and where that one is coarser force its split first. Explicit neighbours make this work for any
criterion: nothing has to be monotonic, so the tightest metric can be used, one that looks at each triangle by itself.

With a FIFO the order does not matter and the result is the coarsest conforming mesh in which every triangle is
accurate. With a priority queue (largest error in pixels first; the coarser first among equals) it can stop at any
moment with a valid mesh that is about the best of its size: at a number of triangles, or at a time. Only triangles
that ground and missing ground share are split before it may stop: no mesh that keeps one is sound.

Triangles live in flat arrays by *slot*: keys of the corners (left end, right end, apex; ``row << 32 | col`` of the
padded square), their heights and that of the hypotenuse's middle, and four links: the slots of the neighbours at the
left leg, the right leg and the hypotenuse (−1: none), and the level. A split keeps the slot for the left half. Every
triangle is judged once, when it is made, with all that the judgement needs; pages may leave memory afterwards. Metres,
pixels.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.error.screen import color_exceeds, outside, sphere_bound, to_camera, triangle_bound
from orograph.errors import UsageError
from orograph.lod.field import find
from orograph.lod.localise import STACK, localised_bound, prism_outside
from orograph.lod.look_ahead import DEPTH, NEAR
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.pages import BEYOND
from orograph.lod.queues import LEVEL_SHIFT, ORDERS, QUEUE, check_size, code_of, heap_pop, heap_push
from orograph.lod.right_triangles import (
    EVERY,
    METRIC,
    UNBOUNDED,
    Mesh,
    MeshOptions,
    RightTriangleMeshes,
    by_tolerance,
)
from orograph.viewpoint import Camera

DONE, MISSED, GROW, PAUSED, FULL = 0, 1, 2, 3, 4
"""Why the kernel returns: nothing is left to split; pages are missing; no room; enough for now; budget used up."""

MADE, DRAWN, HEAD, TAIL, SPLITS, STALLED = 0, 1, 2, 3, 4, 5
"""Counts: triangles; those drawn; the queue's begin and end; splits; triangles in a row that lacked a page."""


@leaf
def refine_triangles(
    pages, lens, metric, cull, depth, near, ordered, low, budget, splits, leaf_level,
    corners, heights, links, drawn, priorities, codes, slots, chain, fresh, fresh_z, fresh_p, fresh_drawn, todo, counts,
):  # fmt: skip
    """Split triangles until none is left that should be, or something else ends it; returns why. Can be called again.

    Args:
        pages: ``field.Pages``. lens: the camera. metric: its number.
        cull: whether triangles out of view are accurate and not drawn.
        depth: of ``localised``.
        ordered: largest error first (a heap), else a FIFO.
        low: triangles with errors up to this, in pixels, are accurate.
        budget: most triangles drawn, but for what splits of mixed ones take. splits: most splits in this call.
        leaf_level: 2n.
        corners: int64 (capacity, 3); heights: float32 (capacity, 4); links: int32 (capacity, 4); drawn: uint8
            (capacity,); see the module.
        priorities: float64, codes: int64, slots: int64, (queue's capacity,).
        chain: int64 (2n + 2,), the triangles whose splits force each other.
        fresh: int64 (4, 3), fresh_z: float32 (4, 4), fresh_p: float64 (4,), fresh_drawn: uint8 (4,): triangles to be.
        todo: float64 (depth + 2, 14), of ``localised``.
        counts: int64 (6,).
    """
    n = leaf_level >> 1
    last_row, last_col = pages.edge[0], pages.edge[1]
    room = len(priorities)
    done_before = counts[4]
    waiting = 0
    while True:
        # 1. The diamond to split: triangle s and the one across its hypotenuse, b, if there is one.
        s = np.int64(-1)
        b = np.int64(-1)
        if counts[0] == 0:
            many = 2
            level = np.int64(0)
        else:
            if waiting == 0:
                if counts[2] == counts[3]:
                    return 0
                at = 0 if ordered else counts[2] % room
                t = slots[at]
                if np.int64(links[t, 3]) != codes[at] >> 54:  # split by force since
                    if ordered:
                        heap_pop(priorities, codes, slots, counts[3])
                        counts[3] -= 1
                    else:
                        counts[2] += 1
                        counts[5] = 0
                    continue
                if counts[4] - done_before >= splits:
                    return 3
                chain[0] = t
                waiting = 1
            s = chain[waiting - 1]
            b = np.int64(links[s, 2])
            if b >= 0 and links[b, 2] != s:
                chain[waiting] = b
                waiting += 1
                continue
            if counts[0] + 2 > len(drawn) or counts[3] - counts[2] + 5 > room:
                return 2
            level = np.int64(links[s, 3]) + 1
            many = 0
            for side in range(2):
                t = s if side == 0 else b
                if t >= 0:
                    m = (corners[t, 0] + corners[t, 1]) >> 1
                    for half in range(2):
                        fresh[many, 0] = corners[t, 2] if half == 0 else corners[t, 1]
                        fresh[many, 1] = corners[t, 0] if half == 0 else corners[t, 2]
                        fresh[many, 2] = m
                        fresh_z[many, 0] = heights[t, 2] if half == 0 else heights[t, 1]
                        fresh_z[many, 1] = heights[t, 0] if half == 0 else heights[t, 2]
                        fresh_z[many, 2] = heights[t, 3]
                        many += 1
        # 2. What is to be thought of the triangles that this makes.
        missed = False
        for i in range(many):
            er, ec, ez = fresh[i, 0] >> 32, fresh[i, 0] & 0xFFFFFFFF, fresh_z[i, 0]
            xr, xc, xz = fresh[i, 1] >> 32, fresh[i, 1] & 0xFFFFFFFF, fresh_z[i, 1]
            ar, ac, az = fresh[i, 2] >> 32, fresh[i, 2] & 0xFFFFFFFF, fresh_z[i, 2]
            mr, mc = (er + xr) >> 1, (ec + xc) >> 1
            whole = max(er, max(xr, ar)) <= last_row and max(ec, max(xc, ac)) <= last_col
            er, xr, ar = min(er, last_row), min(xr, last_row), min(ar, last_row)
            ec, xc, ac = min(ec, last_col), min(xc, last_col), min(ac, last_col)
            seen = (xc - ec) * (ar - er) != (ac - ec) * (xr - er)
            error = -1.0
            fresh_z[i, 3] = np.float32(np.nan)
            if level == leaf_level:
                if cull and seen:
                    seen = not prism_outside(lens, ec, er, ez, xc, xr, xz, ac, ar, az, 0.0)
            else:
                slot, u, v = find(pages, mr, mc, n - 1 - (level >> 1))
                if slot < 0:
                    missed = missed or slot != BEYOND
                    fresh_p[i], fresh_drawn[i] = error, 0
                    continue
                z = pages.data[slot, u, v, 0]
                e = np.float64(pages.data[slot, u, v, 1])
                r = np.float64(pages.data[slot, u, v, 2])
                c = np.float64(pages.data[slot, u, v, 3])
                if c < 0.0:
                    c = -1.0 - c
                else:
                    fresh_z[i, 3] = z
                seen = seen and r >= 0.0
                r = abs(r) * lens[15]
                mc, mr = min(mc, last_col), min(mr, last_row)
                if seen and cull:
                    out, _ = outside(lens, mc, mr, np.float64(z), r, 0)
                    # (A squeezed triangle cuts unit triangles: parts of them may be farther from it than its samples.)
                    if whole and not out and e < np.inf:
                        out = prism_outside(lens, ec, er, ez, xc, xr, xz, ac, ar, az, e)
                    seen = not out
                if seen:
                    x, y, w = to_camera(lens, mc, mr, np.float64(z))
                    if e == np.inf:
                        error = np.inf
                    elif color_exceeds(lens, c, w, r):
                        error = UNBOUNDED
                    elif metric != 2 and metric != 5:
                        error = sphere_bound(lens, metric, x, y, w, e, r)
                    else:
                        ex, ey, ew = to_camera(lens, ec, er, np.float64(ez))
                        xx, xy, xw = to_camera(lens, xc, xr, np.float64(xz))
                        ax, ay, aw = to_camera(lens, ac, ar, np.float64(az))
                        error = triangle_bound(lens, ex, ey, ew, xx, xy, xw, ax, ay, aw, e)
                        if metric == 5 and whole and error > low and r > near * (w - r):
                            enough = np.inf if ordered else low
                            bound, lacks = localised_bound(
                                pages, lens, er, ec, ez, xr, xc, xz, ar, ac, az, level, leaf_level, e, z, low, enough,
                                cull, depth, todo,
                            )  # fmt: skip
                            error = min(error, bound)
                            # What is known to be too much needs no further page.
                            missed = missed or (lacks and error <= enough)
                    if e < np.inf:
                        error = min(error, UNBOUNDED)
            fresh_p[i] = error
            fresh_drawn[i] = 1 if seen and ez == ez and xz == xz and az == az else 0
        if missed:
            if ordered or counts[0] == 0:
                return 1
            # To the end of the queue; the others first.
            t = chain[0]
            at = counts[2] % room
            code = codes[at]
            counts[2] += 1
            at = counts[3] % room
            codes[at], slots[at] = code, t
            counts[3] += 1
            counts[5] += 1
            waiting = 0
            if counts[5] > counts[3] - counts[2]:
                counts[5] = 0
                return 1
            continue
        # 3. The split.
        change = np.int64(0)
        for i in range(many):
            change += fresh_drawn[i]
        if s >= 0:
            change -= drawn[s]
        if b >= 0:
            change -= drawn[b]
        if s >= 0 and counts[1] + change > budget and priorities[0] < np.inf:
            return 4
        counts[1] += change
        counts[5] = 0
        made = counts[0]
        counts[0] += many >> 1 if s >= 0 else 2
        if s < 0:
            links[0, 0] = links[0, 1] = links[1, 0] = links[1, 1] = -1
            links[0, 2], links[1, 2] = 1, 0
        else:
            counts[4] += 1
            waiting -= 1
            for side in range(2):
                t = s if side == 0 else b
                if t >= 0:
                    right = np.int64(links[t, 1])
                    other = made + side
                    links[other, 0], links[other, 1], links[other, 2] = -1, t, right
                    if right >= 0:
                        for edge in range(3):
                            if links[right, edge] == t:
                                links[right, edge] = other
                    links[t, 2], links[t, 0], links[t, 1] = links[t, 0], other, -1
            if b >= 0:
                # around the new vertex: s and b keep the left halves, made and made + 1 are the right ones
                links[s, 1], links[made + 1, 0] = made + 1, s
                links[b, 1], links[made, 0] = made, b
        for i in range(many):
            t = np.int64(i)
            if s >= 0:
                t = (made if i == 1 else made + 1) if i & 1 else (s if i == 0 else b)
            for k in range(3):
                corners[t, k], heights[t, k] = fresh[i, k], fresh_z[i, k]
            heights[t, 3] = fresh_z[i, 3]
            links[t, 3] = level
            drawn[t] = fresh_drawn[i]
            if fresh_p[i] > low:
                code = code_of((fresh[i, 0] + fresh[i, 1]) >> 1, level, n)
                if ordered:
                    heap_push(priorities, codes, slots, counts[3], fresh_p[i], code, t)
                else:
                    codes[counts[3] % room], slots[counts[3] % room] = code, t
                counts[3] += 1


class _State:
    """The mesh of one refinement, and its queue."""

    def __init__(self, method: TopDown, capacity: int) -> None:
        n = method.field.n
        self.corners, self.heights = np.empty((capacity, 3), np.int64), np.empty((capacity, 4), np.float32)
        self.links, self.drawn = np.empty((capacity, 4), np.int32), np.zeros(capacity, np.uint8)
        self.queue: tuple[NDArray[Any], ...] = (
            np.empty(capacity), np.empty(capacity, np.int64), np.empty(capacity, np.int64)
        )  # fmt: skip
        self.counts = np.zeros(6, np.int64)
        size = 1 << n
        nw, ne, sw, se = 0, size, size << 32, size << 32 | size
        z = method.field.corners
        fresh, fresh_z = np.zeros((4, 3), np.int64), np.zeros((4, 4), np.float32)
        fresh[:2] = (nw, se, ne), (se, nw, sw)
        fresh_z[:2, :3] = (z[0, 0], z[1, 1], z[0, 1]), (z[1, 1], z[0, 0], z[1, 0])
        self.scratch: tuple[NDArray[Any], ...] = (
            np.empty(2 * n + 2, np.int64), fresh, fresh_z, np.empty(4), np.empty(4, np.uint8),
            np.empty((method.depth + 2, STACK)),
        )  # fmt: skip

    def grow(self, ordered: bool) -> None:
        """Twice the room."""
        more = len(self.drawn)
        self.corners, self.heights, self.links, self.drawn = (
            np.concatenate([a, np.zeros_like(a)]) for a in (self.corners, self.heights, self.links, self.drawn)
        )
        head, tail = int(self.counts[HEAD]), int(self.counts[TAIL])
        live = np.arange(head, tail) % more
        kept = [a if ordered else a[live] for a in self.queue]
        self.queue = tuple(np.concatenate([a, np.zeros(2 * more - len(a), a.dtype)]) for a in kept)
        if not ordered:
            self.counts[HEAD], self.counts[TAIL] = 0, tail - head


@dataclass(frozen=True, slots=True, kw_only=True)
class TopDownOptions(MeshOptions):
    """Options of ``top-down``. See ``MeshOptions``."""

    metric: str | None = option(None, METRIC, choices=EVERY)
    queue: str = option("priority", QUEUE + ".", choices=ORDERS)
    depth: int = option(DEPTH, "How often the metric localised halves a triangle to see where it errs.",
                        unit="halvings", least=0, most=64)  # fmt: skip
    near: float = option(NEAR, "Where it does: where a sphere's radius is more than this of its least depth.", least=0)


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
        self.queue: str = self.options.queue
        self.depth: int = self.options.depth
        self.near: float = self.options.near
        self._capacity = 1 << 12

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        tolerance, triangles, seconds = goal.tolerance, goal.triangles, goal.seconds
        ordered = tolerance is None and self.queue == "priority"
        if tolerance is None and not ordered:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal)
        began = time.perf_counter()
        state = _State(self, self._capacity)
        lens = self._lens(camera, tolerance or 0.0)
        stalls = before = 0
        while True:
            self.field.begin()
            why = refine_triangles(
                self.field.pages, lens, self.metric.number, self.cull, self.depth, self.near, ordered, tolerance or 0.0,
                (1 << 62) if triangles is None else triangles, (1 << 62) if seconds is None else 1024,
                2 * self.field.n, state.corners, state.heights, state.links, state.drawn, *state.queue, *state.scratch,
                state.counts,
            )  # fmt: skip
            if why == GROW:
                state.grow(ordered)
            elif why == MISSED:
                self.field.fetch(resumes=True)
                stalls = stalls + 1 if state.counts[SPLITS] == before else 0
                before = int(state.counts[SPLITS])
                if stalls > len(self.field.pages.used) + 8:
                    raise UsageError(
                        "One split needs more tiles than memory allows.",
                        remedy="Allow more memory (--max-memory), or a smaller depth.",
                    )
            elif why in (DONE, FULL):
                break
            mixed = state.counts[TAIL] > 0 and state.queue[0][0] == np.inf
            if seconds is not None and time.perf_counter() - began > 0.9 * seconds and state.counts[MADE] and not mixed:
                break
        return self._result(state, tolerance)

    def _result(self, state: _State, tolerance: float | None) -> Mesh:
        made, left = int(state.counts[MADE]), int(state.counts[TAIL] - state.counts[HEAD])
        self._capacity = max(self._capacity, len(state.drawn))
        reached = tolerance
        within = True
        if tolerance is None:
            # What is left in the queue (split triangles, too, but those come no later than their halves).
            reached = self._reached(state, left)
            within = reached < UNBOUNDED
        drawn = np.flatnonzero(state.drawn[:made])
        return Mesh(
            state.corners[drawn], state.heights[drawn, :3], is_strip=False, clockwise=False, triangles=len(drawn),
            within=within, tolerance=reached if within else None,
            stats={"splits": int(state.counts[SPLITS]), "front": made, "queue": self.queue},
        )  # fmt: skip

    @staticmethod
    def _reached(state: _State, left: int) -> float:
        """The largest error in the queue, pixels, of triangles that are still there."""
        priorities, codes, slots = (a[:left] for a in state.queue)
        there = state.links[slots, 3] == codes >> LEVEL_SHIFT
        return float(priorities[there].max(initial=0.0))
