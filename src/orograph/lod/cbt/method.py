"""The method ``cbt``: a mesh that continues from view to view by updates in which all triangles decide at once.

On the CPU, ``select`` updates the pool (``pool``) until nothing changes; with the sphere metrics, which are monotonic,
the result is the coarsest conforming mesh that keeps the tolerance, whatever came before: that of ``stateless`` with
the same metric. On the GPU the tree lives there and is updated frame by frame, without ``select``
(``rendering.gpu.surface.tree``): its shaders are tested against this.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.bits import floor_log2
from orograph.lod.budget import by_tolerance
from orograph.lod.cbt.judging import LACKING, judge_each
from orograph.lod.cbt.pool import Pool, Slots
from orograph.lod.criterion import DROP, NOTHING, SPLIT, Criterion
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.options import option
from orograph.lod.right_triangles import Mesh, MeshOptions, RightTriangleMeshes
from orograph.viewpoint import Camera

METRICS = ("anisotropic", "isotropic")
"""Metrics of spheres that bound the error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CbtOptions(MeshOptions):
    """Options of ``cbt``. See ``MeshOptions``."""

    metric: str | None = option(None, "How errors are converted to pixels; none: anisotropic.", choices=METRICS)
    updates: int = option(2, "On the GPU: updates of the tree in a frame.", unit="updates", least=1, most=32)
    slots: int = option(1 << 19, "On the GPU: maximum triangles; rounded up to a power of two.",
                        unit="triangles", least=1 << 14, most=1 << 21)  # fmt: skip


class Cbt(RightTriangleMeshes):
    """A concurrent binary tree. See ``RightTriangles`` for the arguments."""

    info = MethodInfo(
        "cbt", "a tree on the GPU whose triangles split and merge by themselves, all at once",
        "Dupuy 2020; Benyoub & Dupuy 2024", "triangles", CbtOptions, lambda options: options.conservative,
        incremental=True,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.pool = Pool.planted(self.field.n, self.field.corners)

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        if goal.tolerance is None:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        criterion = Criterion(self._lens(camera, goal.tolerance), self.spheres, self.cull, NOTHING)
        updates = splits = merges = 0
        while True:
            slots, states, merge = self._judged(criterion)
            split, merged = self.pool.update(slots[states == SPLIT], merge)
            if not split and not merged:
                break
            updates, splits, merges = updates + 1, splits + split, merges + merged
        drawn = slots[states != DROP]
        keys = self.pool.corners(drawn)
        heights = self.pool.heights[drawn, :3]
        seen = self._has_area(keys) & ~np.isnan(heights).any(1)
        stats = {"updates": updates, "splits": splits, "merges": merges, "front": len(slots)}
        return Mesh(
            keys[seen], heights[seen], is_strip=False, clockwise=False, triangles=int(seen.sum()), stats=stats
        )  # fmt: skip

    def _judged(self, criterion: Criterion) -> tuple[Slots, NDArray[np.uint8], Slots]:
        """The slots in use, what is to become of each, and those whose parent's diamond is not to be split."""
        pool = self.pool
        slots = pool.leaves
        level = pool.level[slots]
        inner = level < 2 * self.field.n
        states = np.ones(len(slots), np.uint8)  # finest triangles are drawn
        states[inner], heights = self._weighed(criterion, pool.diamonds(slots[inner]))
        pool.heights[slots[inner], 3] = heights
        below = slots[level > 0]
        apexes, place = np.unique(pool.corners(below)[:, 2], return_inverse=True)
        above, _ = self._weighed(criterion, apexes)
        return slots, states, below[above[place] != SPLIT]

    def _weighed(self, criterion: Criterion, keys: Slots) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """What becomes of the triangles over diamonds, and the heights of their vertices; reads the pages for it."""
        states, heights = np.zeros(len(keys), np.uint8), np.zeros(len(keys), np.float32)
        spread = (keys >> 32) | (keys & 0xFFFFFFFF)
        octaves = floor_log2(spread & -spread)
        self.field.begin()
        judge_each(self.field.pages, criterion, keys, octaves, states, heights)
        while self.field.fetch(resumes=True):
            left = np.flatnonzero(states == LACKING)
            again, z = np.zeros(len(left), np.uint8), np.zeros(len(left), np.float32)
            self.field.begin()
            judge_each(self.field.pages, criterion, keys[left], octaves[left], again, z)
            states[left], heights[left] = again, z
        return states, heights

    def _has_area(self, keys: Slots) -> NDArray[np.bool_]:
        """Which triangles are not squeezed to a line."""
        edge = self.field.pages.edge
        row, col = np.minimum(keys >> 32, edge[0]).T, np.minimum(keys & 0xFFFFFFFF, edge[1]).T
        area = (col[1] - col[0]) * (row[2] - row[0]) - (col[2] - col[0]) * (row[1] - row[0])
        return np.asarray(area != 0)
