"""The search for the best views: best first by upper bounds, so that few lines of sight are tested.

Every camera begins with an upper bound of its gain: everything in its picture if nothing were hidden. A place has the
bound of its best camera, and the place with the highest bound is always visited next: lines of sight are tested from it
to some more pieces, those that count most first, and hidden pieces are subtracted from the bounds of its cameras. A
place whose pieces are all known and whose bound is still the highest has the best camera of all, because no other can
exceed it. So the result is the same as that of testing everything from everywhere.

The next view is the one with the largest gain over those before (greedy cover). The gain of a camera can only fall as
views are added, so old bounds stay valid, and are updated when their place comes to the top (Minoux 1978); together k
such views see at least 1 − 1/e of what the best k could (Nemhauser, Wolsey & Fisher 1978).

Source: best first with bounds is branch and bound (Land & Doig 1960) on Σ over pieces.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.lighting.sun import Sun
from orograph.measuring.viewshed_kernels import MISSING, Pyramid, first_level, ground_at, next_level
from orograph.parallel import for_each
from orograph.progress import SILENT, Progress
from orograph.store.terrain import EXACT_SAMPLES, Terrain
from orograph.touring.best_cameras import Cameras
from orograph.touring.best_kernels import Pieces, ceilings, lit, look, qualities, values
from orograph.touring.best_target import AREA, Target

Array = NDArray[np.float64]

PLACES = 64
"""Places that a thread judges at a time."""
WIDER = 1 + 1e-4
"""How much bounds in single precision are widened."""
ADDS = 1e-9
"""A gain below this counts as none."""
AMBIENT = 0.5
"""The weight of a piece without sun, relative to one that faces the sun."""


@dataclass(frozen=True, slots=True)
class Ground:
    """The surface between a target and its cameras, for lines of sight.

    Attributes:
        level: of the terrain, 0 unless the ground is too large for memory.
        pyramid: of float32 heights.
        row, col: the first sample, at that level.
    """

    level: int
    pyramid: Pyramid
    row: int
    col: int

    @classmethod
    def between(cls, terrain: Terrain, places: Array) -> Ground:
        """The ground around places (n, 2) of the terrain's CRS, wherever it is known."""
        at = np.stack(terrain.grid.index(places[:, 0], places[:, 1]), -1)
        level = 0
        while True:
            rows, cols = terrain.shape(level)
            # (A line along the border of the window would leave it by rounding.)
            (left, top), (right, bottom) = at.min(0) / 2**level - 2, at.max(0) / 2**level + 2
            col, row = (max(min(math.floor(v), n - 2), 0) & ~1 for v, n in ((left, cols), (top, rows)))
            end = min(max(math.ceil(right) + 1, col + 2), cols), min(max(math.ceil(bottom) + 1, row + 2), rows)
            if (end[0] - col) * (end[1] - row) <= EXACT_SAMPLES or level == terrain.levels - 1:
                break
            level += 1
        z = terrain.read(level, row, end[1], col, end[0])
        return cls(level, pyramid_of(z), row, col)

    def samples(self, terrain: Terrain, places: Array) -> Array:
        """(n, 2) column and row in the pyramid of places (n, 2)."""
        at = np.stack(terrain.grid.index(places[:, 0], places[:, 1]), -1)
        return np.asarray(at / 2**self.level - [self.col, self.row])


def pyramid_of(z: NDArray[np.float32]) -> Pyramid:
    """The pyramid of heights (rows, cols), NaN where missing."""
    z = np.where(np.isnan(z), np.float32(MISSING), z)
    levels: list[NDArray[np.float32]] = []
    nodes = z.shape[0] - 1, z.shape[1] - 1
    while max(nodes) > 1 or not levels:
        nodes = -(-nodes[0] // 2), -(-nodes[1] // 2)
        made = np.empty(nodes, np.float32)
        (next_level if levels else first_level)(levels[-1] if levels else z, made, 0, nodes[0])
        levels.append(made)
    sizes = np.array([one.size for one in levels])
    offset = np.concatenate([[-1, 0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    per_row = np.array([z.shape[1] - 1, *(one.shape[1] for one in levels)], np.int64)
    return Pyramid(z, np.concatenate([one.ravel() for one in levels]), offset, per_row)


@dataclass(frozen=True, slots=True)
class Found:
    """A chosen view.

    Attributes:
        camera: its number. score: of this view alone; gain: over those before; both 0 to 1.
        quality: (n,) q of the pieces it sees, with their light; NaN for hidden ones.
    """

    camera: int
    score: float
    gain: float
    quality: Array


class Search:
    """The search for views of a target.

    Args:
        terrain, target, cams: see their classes. lift: metres above the ground of the points to see.
        sun: lights the pieces; None: all equally. jobs: threads.

    Attributes:
        looks: the number of tested lines of sight.
    """

    def __init__(
        self, terrain: Terrain, target: Target, cams: Cameras, *, lift: float = 0.0, sun: Sun | None = None,
        jobs: int | None = None, progress: Progress = SILENT,
    ) -> None:  # fmt: skip
        self.target, self.cams, self.jobs, self.progress = target, cams, jobs, progress
        shade = _shade(terrain, target, sun)
        here = target.points[:, :2]
        self.ground = Ground.between(terrain, np.concatenate([here, cams.place, here + shade[:2]]))
        g = self.ground
        self._at, self._place = g.samples(terrain, target.points[:, :2]), g.samples(terrain, cams.place)
        self._points = target.points + np.array([0.0, 0.0, lift])
        self._heights = np.ascontiguousarray(self._points[:, 2])
        if g.level:
            self._above()
        self.light = np.ones(len(self._points)) if sun is None else self._lit(terrain, sun, shade)
        weight = target.weight * self.light
        spans = np.searchsorted(target.kind, np.arange(4))
        points, axis = np.ascontiguousarray(self._points.T), np.ascontiguousarray(target.axis.T)
        self._pieces = Pieces(points, spans, axis, weight)
        self._cameras = cams.numbers()
        self._order: dict[int, NDArray[np.int64]] = {}
        self._needed: dict[int, Array] = {}
        self._done: dict[int, int] = {}
        self._hidden_nothing = np.full(len(self._points), -np.inf)
        self.looks = 0

    def views(self, k: int, apart: float) -> list[Found]:
        """Up to k views: the best, then each with the largest gain, at least ``apart`` degrees from each other.

        Directions are as seen from the target. When there is no more gain, the best of the remaining views follow.
        """
        found: list[Found] = []
        best = np.zeros(len(self._points))
        allowed = np.ones(len(self.cams), bool)
        forward = self._cameras[8:11]
        bounds = self._bounds()
        with self.progress.task("Searching for views", total=k) as task:
            while len(found) < k:
                chosen = self._next(best, allowed, bounds)
                if chosen is None and best.any():  # all that is visible is seen: continue with the best single views
                    best = np.zeros(len(best))
                    bounds = self._bounds()
                    continue
                if chosen is None:
                    break
                q = np.nan_to_num(self._seen(chosen))
                before = np.nanmax([np.zeros(len(q)), *(one.quality for one in found)], axis=0)
                gain = float((self.target.weight * np.maximum(q - before, 0.0)).sum())
                found.append(Found(chosen, float((self.target.weight * q).sum()), gain, self._seen(chosen)))
                best = np.maximum(best, q)
                allowed &= forward[:, chosen] @ forward < math.cos(math.radians(apart))
                allowed[chosen] = False
                task.advance()
        return found

    def _bounds(self) -> list[float]:
        """Upper bounds of the gain of each place's best camera, whatever is already visible, in single precision."""
        cams, middle = self.cams, self.cams.middle
        points, spans, axis, weight = self._pieces
        cameras = self._cameras.copy()
        cameras[:3] -= middle[:, None]
        cameras[-3:] *= WIDER
        cameras = cameras.astype(np.float32)
        moved = points - middle[:, None]
        pieces = Pieces(moved.astype(np.float32), spans, axis.astype(np.float32), weight.astype(np.float32))
        out = np.empty(len(cams.place))
        with self.progress.task("Judging cameras", total=len(out)) as task:

            def judge(a: int) -> None:
                b = min(a + PLACES, len(out))
                ceilings(cameras, pieces, cams.first[a : b + 1], out[a:b])
                task.advance(b - a)

            for_each(judge, range(0, len(out), PLACES), self.jobs)
        return list(out * WIDER + ADDS)

    def _bound(self, p: int, unlit: Array, allowed: NDArray[np.bool_]) -> Array:
        """The known upper bound of the gain of each camera of a place; −1 for those that are not allowed."""
        first, last = int(self.cams.first[p]), int(self.cams.first[p + 1])
        out = np.empty(last - first)
        if not allowed[first:last].any():
            return np.full(last - first, -1.0)
        needed = self._needed.get(p, self._hidden_nothing)
        values(self._cameras, self._pieces, unlit, needed, first, last, out)
        return np.where(allowed[first:last], out, -1.0)

    def _next(self, best: Array, allowed: NDArray[np.bool_], bounds: list[float]) -> int | None:
        """The camera with the largest gain; None if none has any. Tightens ``bounds``."""
        first = self.cams.first
        heap = [(-bound, p) for p, bound in enumerate(bounds)]
        heapq.heapify(heap)
        new: dict[int, Array] = {}
        n = len(self._points)
        unlit = best / self.light  # a view's q includes its light, which kernels put into the weight
        while heap:
            bound, p = heap[0]
            if bound >= -ADDS:
                return None
            if p not in new:
                new[p] = self._bound(p, unlit, allowed)
                bounds[p] = float(new[p].max())
            elif self._done.get(p, 0) == n:
                return int(first[p]) + int(new[p].argmax())
            else:
                bounds[p] = self._look(p, unlit, -min(heap[1:3])[0] if len(heap) > 1 else 0.0, new[p])
            heapq.heapreplace(heap, (-bounds[p], p))
        return None

    def _look(self, p: int, unlit: Array, rival: float, out: Array) -> float:
        """A place's bound after lines of sight are tested, until all are or the bound is below a rival's."""
        done = self._done.get(p, 0)
        first, last = int(self.cams.first[p]), int(self.cams.first[p + 1])
        if p not in self._needed:
            self._needed[p] = np.full(len(self._points), -np.inf)
            q = np.empty(len(self._points))
            qualities(self._cameras, first + int(out.argmax()), self._pieces, q)
            self._order[p] = np.argsort(-self._pieces.weight * q, kind="stable")
        self._done[p], bound = look(
            self.ground.pyramid, self._at, self._heights, self._order[p], done, self._place[p], self._cameras,
            self._pieces, unlit, self._needed[p], first, last, rival, out,
        )  # fmt: skip
        self.looks += self._done[p] - done
        return float(bound)

    def _seen(self, camera: int) -> Array:
        """(n,) q with its light of the pieces that a camera sees, all of which were tested; NaN for others."""
        p = int(np.searchsorted(self.cams.first, camera, "right")) - 1
        out = np.empty(len(self._points))
        qualities(self._cameras, camera, self._pieces, out)
        out[self.cams.eyes[camera, 2] < self._needed[p]] = 0.0
        return np.where(out > 0.0, out * self.light, np.nan)

    def _above(self) -> None:
        """Raise targets onto a level's ground if that is above them."""
        for i, (x, y) in enumerate(self._at):
            self._heights[i] = max(self._heights[i], ground_at(self.ground.pyramid.z, x, y))

    def _lit(self, terrain: Terrain, sun: Sun, shade: Array) -> Array:
        """(n,) AMBIENT to 1: the light on each piece."""
        towards, target = np.array(sun.direction), self.target
        if towards[2] <= 0.0:
            return np.full(len(self._points), AMBIENT)
        step = np.linalg.solve(terrain.grid.linear, shade[:2]) / 2**self.ground.level
        out = np.empty(len(self._points))
        lit(self.ground.pyramid, self._at, self._heights, step, float(shade[2]), out)
        facing = np.where(target.kind == AREA, np.maximum(target.axis @ towards, 0.0), 1.0)
        return np.asarray(AMBIENT + (1.0 - AMBIENT) * facing * out)


def _shade(terrain: Terrain, target: Target, sun: Sun | None) -> Array:
    """(3,) metres towards the sun, from the lowest piece to as high as the highest ground; 0 without a sun."""
    towards = np.zeros(3) if sun is None else np.array(sun.direction)
    if towards[2] <= 0.0:
        return np.zeros(3)
    return np.asarray(towards / towards[2] * max(terrain.height_range[1] - float(target.points[:, 2].min()), 1.0))
