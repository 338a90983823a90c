"""Geometry clipmaps: nested rings around the eye, each twice as coarse as the one within, that move with it.

Losasso & Hoppe, *Geometry clipmaps: terrain rendering using nested regular grids* (SIGGRAPH 2004); Asirvatham & Hoppe
in GPU Gems 2 (2005). Every level has a window of n × n samples around the eye, snapped to even samples; the part
outside finer windows is drawn. Over the outer tenth of a ring heights blend into the next coarser one's, so that
nothing pops; rings end only in even vertices, so that nothing cracks (``clipmap_mesh``). Heights are held in toroidal
arrays, filled coarse first, within a budget per frame; a late level is left out (``clipmap_toroid``). The finest levels
are left out if the eye is high, or the tolerance does not need them. Distance alone decides: no promise.

``rings=promise`` chooses windows by the errors of the blocks they cover: outside of level l's window level l + 1 keeps
the tolerance, and in its transition, where heights are off by both levels' errors at most, it keeps it with their sum.
Metres, samples, pixels.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lod.budget import Pass, by_tolerance
from orograph.lod.clipmap_errors import Blocks, LevelErrors
from orograph.lod.clipmap_holes import Limit, Rims
from orograph.lod.clipmap_mesh import Ring, blended, triangles
from orograph.lod.clipmap_toroid import Toroids
from orograph.lod.clipmap_windows import NO_BLEND, around, as_printed, nested, whole
from orograph.lod.method import EVERYTHING, Goal, Method, MethodInfo, Need, Ready
from orograph.lod.options import check, option
from orograph.lod.selection import Blend, ClipRings
from orograph.lod.squares import BlockHeights
from orograph.raycast.select import in_frustum
from orograph.store.terrain import TILE, Heights
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera

BLOCK = 16
"""Side of the blocks that are culled, cells."""

HIGH = 0.4
"""A level is left out from this height above the ground on, as a part of its window's extent."""

LEAST = 15
"""Minimum samples along a side of a window, for small budgets."""

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipmapOptions:
    """Options of ``clipmap``."""

    n: int = option(255, "Samples along a side of a window.", choices=(63, 127, 255, 511))
    rings: str = option(
        "printed", "Windows of n × n samples around the eye (printed), or as large as the tolerance requires by the "
                   "errors of blocks (promise), which keeps the tolerance.", choices=("printed", "promise"),
    )  # fmt: skip
    blend: bool = option(True, "Heights blend into the next coarser ring's over the outer tenth of a ring.")
    update: float | None = option(
        None, "Samples that a frame may read, in windows (1: n²); late levels are left out. None: all that it needs. "
              "For rings as printed.", least=1.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self)


@dataclass(slots=True)
class Found:
    """The selection for a tolerance.

    Attributes:
        stack, blends, seen: as of ``ClipRings``. n: samples along a side of windows as printed.
        triangles: of all rings. within, tolerance: as of ``budget.Coarsened``.
    """

    stack: ClipStack
    blends: Sequence[Blend]
    seen: Sequence[Mask]
    n: int
    triangles: int = 0
    within: bool = True
    tolerance: float | None = None

    def kept(self) -> Self:
        """Itself: no part of it is reused."""
        return self

    def first(self, count: int) -> Found:
        """Without the levels after the ``count`` coarsest."""
        return replace(
            self, stack=ClipStack(self.stack[:count]), blends=self.blends[:count], seen=self.seen[:count]
        )  # fmt: skip

    def rings(self) -> list[Ring]:
        """What is drawn of each window."""
        holes = [*self.stack[1:], None]
        return [Ring(*of, BLOCK) for of in zip(self.stack, holes, self.seen, strict=True)]


class Clipmap(Method):
    """Geometry clipmaps. See ``Method`` for the arguments.

    Raises:
        UsageError: the terrain has no surface.
        StoreError: the store lacks the errors of diamonds.
    """

    info = MethodInfo(
        "clipmap", "nested rings around the eye, each twice as coarse as the one within it, filled as it moves",
        "Losasso & Hoppe 2004; Asirvatham & Hoppe 2005", "rings", ClipmapOptions,
        lambda options: options.rings == "promise", incremental=True, promising={"rings": "promise"},
        invents=lambda options: options.rings != "promise",
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.shape = self.terrain.grid.shape
        self.coarsest = max(self.terrain.n - 1, 0)
        self._heights = BlockHeights(self.terrain)
        self._errors = LevelErrors(self.terrain, self.coarsest)
        self._blocks: Blocks | None = None
        if self.conservative:
            self._blocks = Blocks(self.terrain, self.coarsest, self._heights, self.resources)
        voids = bool((self.terrain.tiles(0).valid != 2).any())
        self._rims = Rims(self.terrain) if voids else None
        self._toroids = Toroids(self.options.n)
        self._last = Pass()

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        """The exact errors of diamonds: where ground is missing, and of the coarsest levels."""
        return (Need("diamonds", {"error": "exact"}),)

    # ---- selecting ----

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> ClipRings:
        """The rings of a view.

        Raises:
            UsageError: the ground is not flat.
        """
        self.info.check_goal(goal.name)
        camera.affine  # noqa: B018 (it raises where the chart is curved)
        began = time.perf_counter()
        found = self._found(camera, goal)
        tolerance = goal.tolerance if goal.tolerance is not None else found.tolerance
        if ready.tiles is not None:
            found = self._below(camera, found)
        there, lacking = self._errors.ready(found.stack, camera, ready)
        read = self._stored
        if not self.conservative:
            there, read = self._moved(found, there)
        late = len(found.stack) - there
        found = self._counted(camera, found.first(there)) if late else found
        promised = self.conservative and found.within and not late
        stats: dict[str, Any] = {
            "method": self.info.name, "tolerance": tolerance, "conservative": promised,
            "exaggeration": camera.exaggeration, "geomorph": self.options.blend,
            "refine_ms": round((time.perf_counter() - began) * 1e3, 3), "rings": len(found.stack),
            "finest_level": found.stack[-1].level, "late": late, "triangles": found.triangles,
        }  # fmt: skip
        if not self.conservative:
            stats |= {"n": found.n, "samples_read": self._toroids.read}
        if goal.triangles is not None:
            stats["within_budget"] = found.within
        return ClipRings(
            method=self.info.name, bound=tolerance if promised else None, lacking=lacking, stats=stats,
            stack=found.stack, blends=found.blends if self.options.blend else [NO_BLEND] * len(found.stack),
            seen=found.seen, block=BLOCK, read=None if self._rims else read,
            expand=partial(self._expand, found=found, read=read, limit=self._limit(camera, tolerance)),
        )  # fmt: skip

    def _found(self, camera: Camera, goal: Goal) -> Found:
        """The windows for a goal, with all levels that it needs."""
        if self.conservative:
            at = partial(self._promised, camera)
            return at(goal.tolerance) if goal.tolerance is not None else by_tolerance(at, goal, self._last)
        found = self._printed(camera, goal.tolerance or 0.0, self.options.n)
        if goal.triangles is not None and found.triangles > goal.triangles:
            found = self._small(camera, goal.triangles)
        found.tolerance = goal.tolerance
        return found

    def _printed(self, camera: Camera, tolerance: float, n: int, finest: int = 0) -> Found:
        """Windows of n × n samples around the eye.

        Args:
            finest: of the levels that may be there.
        """
        view, grid = camera.view, self.terrain.grid
        place = view.target if view.projection == "plan" else view.eye
        col, row = (float(v) for v in grid.index(*place[:2]))
        centre = row, col
        high = HIGH * n * max(grid.spacing)
        above = camera.exaggeration * (view.eye[2] - self._ground(row, col))
        while finest < self.coarsest and (
            above > high * 2**finest or self._errors.keeps(camera, tolerance, around(finest, n, centre, self.shape))
        ):
            finest += 1
        stack, blends = as_printed(n, centre, self.shape, finest, self.coarsest)
        return self._counted(camera, self._culled(camera, stack, blends, n))

    def _ground(self, row: float, col: float) -> float:
        """The height of the ground below the eye, or the lowest there is."""
        i, j = (min(max(round(v), 0), side - 1) for v, side in zip((row, col), self.shape))
        found = float(self.terrain.read(0, i, i + 1, j, j + 1)[0, 0])
        return found if np.isfinite(found) else float(np.nan_to_num(self.terrain.height_range[0]))

    def _small(self, camera: Camera, budget: int) -> Found:
        """The largest windows that a budget of triangles allows; where none does, the finest levels are left out."""
        low, high = 0, (self.options.n - LEAST) // 4  # (n is LEAST + 4 × one of them)
        best = None
        while low <= high:
            middle = (low + high) // 2
            found = self._printed(camera, 0.0, LEAST + 4 * middle)
            if found.triangles <= budget:
                best, low = found, middle + 1
            else:
                high = middle - 1
        while best is None:
            finest = min(found.stack[-1].level + 1, self.coarsest)
            found = self._printed(camera, 0.0, LEAST, finest)
            if found.triangles <= budget or finest == self.coarsest:
                best, found.within = found, found.triangles <= budget
        return best

    def _promised(self, camera: Camera, tolerance: float) -> Found:
        """Windows as large as a tolerance asks."""
        width = self.options.n // 10 if self.options.blend else 0
        assert self._blocks is not None
        wanted = self._blocks.wanted(camera, tolerance, blended=width > 0)
        stack, blends = nested(wanted, width, self.shape, self.coarsest)
        return self._counted(camera, self._culled(camera, stack, blends, self.options.n, tolerance))

    def _below(self, camera: Camera, found: Found) -> Found:
        """With the whole windows of all coarser levels, which are drawn where finer ones are absent."""
        coarser = [whole(k, self.shape) for k in range(self.coarsest, found.stack[0].level, -1)]
        stack, blends = ClipStack([*coarser, *found.stack]), [*[NO_BLEND] * len(coarser), *found.blends]
        return replace(self._culled(camera, stack, blends, found.n, found.tolerance), triangles=found.triangles)

    def _culled(
        self, camera: Camera, stack: ClipStack, blends: Sequence[Blend], n: int, tolerance: float | None = None
    ) -> Found:
        seen = []
        for w in stack:
            i, j = (np.arange(first // BLOCK, (end - 2) // BLOCK + 1)
                    for first, end in ((w.row0, w.row1), (w.col0, w.col1)))  # fmt: skip
            side = BLOCK << w.level
            north, west = (v.ravel() * side for v in np.meshgrid(i, j, indexing="ij"))
            boxes = self._heights.around(west, north, west + side, north + side, side.bit_length() - 1)
            seen.append(in_frustum(self.terrain, camera.view, camera.exaggeration, boxes).reshape(len(i), len(j)))
        return Found(stack, blends, seen, n, tolerance=tolerance)

    def _counted(self, camera: Camera, found: Found) -> Found:
        if self._rims is None:
            found.triangles = sum(ring.triangles(self.shape) for ring in found.rings())
        else:  # (the number for the rims of holes is known once they are made)
            found.triangles = len(self._corners(found, self._stored, self._limit(camera, found.tolerance))[0])
        return found

    def _limit(self, camera: Camera, tolerance: float | None) -> Limit | None:
        return Limit(camera, tolerance) if self.conservative and tolerance is not None else None

    # ---- heights ----

    def _stored(self, window: Rectangle) -> Heights:
        """Heights of a window of any level, which may reach beyond the level's last sample."""
        k, up = min(window.level, self.terrain.levels - 1), max(window.level - self.terrain.levels + 1, 0)
        rows, cols = self.terrain.shape(k)
        i = np.minimum(np.arange(window.row0, window.row1) << up, rows - 1)
        j = np.minimum(np.arange(window.col0, window.col1) << up, cols - 1)
        read = self.terrain.read(k, int(i[0]), int(i[-1]) + 1, int(j[0]), int(j[-1]) + 1)
        return np.asarray(read[np.ix_(i - i[0], j - j[0])])

    def _moved(self, found: Found, there: int) -> tuple[int, Any]:
        """Move the toroidal arrays: returns how many levels are held now, and a reader of their heights."""
        if found.n != self._toroids.n:
            self._toroids = Toroids(found.n)
        budget = sys.maxsize if self.options.update is None else int(self.options.update * found.n**2)
        there = self._toroids.move(found.stack[:there], self._stored, budget)
        held = {w.level: (w, self._toroids.heights(w.level)) for w in found.stack[:there]}

        def read(part: Rectangle) -> Heights:
            window, heights = held[part.level]
            i, j = part.row0 - window.row0, part.col0 - window.col0
            return heights[i : i + part.shape[0], j : j + part.shape[1]]

        return there, read

    # ---- triangles ----

    def _expand(self, selection: ClipRings, found: Found, read: Any, limit: Limit | None) -> Tessellation:
        keys, heights = self._corners(found, read, limit)
        stats = dict(selection.stats)
        made = Tessellation.from_triangles(self.terrain.grid, keys, heights, clockwise=True, stats=stats)
        stats["triangles"] = len(made.triangles)
        return made

    def _corners(self, found: Found, read: Any, limit: Limit | None) -> tuple[Index, Heights]:
        """Keys and heights of the corners of all triangles."""
        keys, heights = [np.zeros((0, 3), np.int64)], [np.zeros((0, 3), np.float32)]
        for ring, blend in zip(found.rings(), found.blends, strict=True):
            part = ring.part()
            if part is None:
                continue
            z = read(part)
            if self.options.blend and blend is not NO_BLEND:
                z = blended(z, part, blend, self._still(ring, part))
            corners = triangles(ring, part, self.shape)
            key = corners[..., 0] << (32 + ring.window.level) | corners[..., 1] << ring.window.level
            tall = z[corners[..., 0] - part.row0, corners[..., 1] - part.col0]
            if self._rims is not None:
                cell = corners.min(1)
                rim = self._rims.beside(ring.window.level, cell[:, 0], cell[:, 1]) | (limit is not None)
                for some, high in ((key[~rim], tall[~rim]), self._rims.split(key[rim], tall[rim], limit)):
                    whole = ~np.isnan(high).any(1)
                    keys.append(some[whole])
                    heights.append(high[whole])
            else:
                keys.append(key)
                heights.append(tall)
        return np.concatenate(keys), np.concatenate(heights)

    def _still(self, ring: Ring, part: Rectangle) -> Mask:
        """Which samples of a part keep their heights: those that finer rings share, those beside the raster's last
        row and column, and with a promise those beside missing ground."""
        k = part.level
        rows, cols = np.arange(part.row0, part.row1), np.arange(part.col0, part.col1)
        last = (rows + 1) << k >= self.shape[0], (cols + 1) << k >= self.shape[1]
        still: Mask = last[0][:, None] | last[1]
        if ring.hole is not None:
            h = ring.hole.around(k)
            still |= ((rows >= h.row0) & (rows < h.row1))[:, None] & (cols >= h.col0) & (cols < h.col1)
        if self._rims is not None and self.conservative:
            still |= self._beside_missing(k, rows, cols)
        return still

    def _beside_missing(self, level: int, rows: Index, cols: Index) -> Mask:
        assert self._rims is not None
        if level >= self.terrain.levels:
            return np.ones((len(rows), len(cols)), bool)
        near = self._rims.partial(level)
        found = np.zeros((len(rows), len(cols)), bool)
        for i in (rows // TILE, np.maximum(rows - 1, 0) // TILE):
            for j in (cols // TILE, np.maximum(cols - 1, 0) // TILE):
                found |= near[np.ix_(np.minimum(i, near.shape[0] - 1), np.minimum(j, near.shape[1] - 1))]
        return found
