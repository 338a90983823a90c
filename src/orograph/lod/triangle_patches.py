"""Triangle patches: the hierarchy of right triangles with *patches* in place of triangles, for the GPU.

A patch is a right triangle of the hierarchy, regularly divided into L² small ones (``patches.shape``); every patch has
the same triangles, so that a picture is one instanced draw, and the CPU decides about a few thousand patches instead of
half a million triangles. (Levenberg 2002, *CABTT*, puts cached aggregates in the place of triangles in this way; these
patches are regular and share one topology.) As all patches have L segments on each side,
they conform by the rule that triangles conform by: a diamond is split if the bound of its error exceeds the tolerance
and both its parents are split. No skirts, no stitching.

The promise is that of the other methods: P(D), the largest ``exact`` error among the triangles of D's patches
(``patches.tables``), projected by the conservative metric over D's nested sphere. Where ground and missing ground meet,
the mesh is refined until the edges of its triangles are shorter than the tolerance on the screen, or to the samples.

*Geomorphs.* Diamonds are split at τ/κ already, and the points that a split brings grow out of the middles of their
edges while the bound grows from τ/κ to τ: nothing pops, and as both surfaces keep the tolerance then, so does every one
between them. P is saturated so that a diamond's parents have ended their geomorph when it is split; then the new points
on a patch's legs belong to one diamond alone, and everybody agrees about them. Pixels, samples, metres.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import Frustum
from orograph.errors import UsageError
from orograph.lod.budget import by_tolerance
from orograph.lod.method import EVERYTHING, Goal, MethodInfo, Need, Ready
from orograph.lod.options import option
from orograph.lod.patches.expand import expand
from orograph.lod.patches.pager import Pager
from orograph.lod.patches.selection import (
    ABSENT,
    BLOCKED,
    NODES,
    PATCHES,
    SPLIT,
    TOUCHED,
    Bounds,
    Front,
    Instances,
    Tiles,
    select_patches,
)
from orograph.lod.patches.shape import ALL_LEGS, INSTANCE, patch_indices, patch_vertices
from orograph.lod.patches.tables import PatchTerrain, cell_size
from orograph.lod.right_triangles import METRIC, MeshOptions, RightTriangles
from orograph.lod.selection import WANTED, PatchSet, Topology
from orograph.store.patches import KAPPA, LEGS, MemoryPatches, patch_colors
from orograph.store.terrain import tile_shape
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera

__all__ = ["INSTANCE", "LEGS", "Patches", "TrianglePatches", "patch_indices", "patch_vertices"]

NOWHERE: NDArray[np.uint32] = np.zeros(0, np.uint32)


@dataclass(frozen=True, slots=True)
class Tiling:
    """The tiles of all levels in one row: level 0 first, each level row by row.

    Attributes:
        bases, widths: int64 (levels,): where a level's tiles begin, and how many are in a row. top: the last level.
    """

    bases: NDArray[np.int64]
    widths: NDArray[np.int64]
    top: int

    def where(self, tiles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Level, row and column of tiles."""
        level = np.searchsorted(self.bases, tiles, side="right") - 1
        row, col = np.divmod(tiles - self.bases[level], self.widths[level])
        return level, row, col

    def places(self, wanted: NDArray[Any]) -> NDArray[np.int64]:
        """Where the tiles of an array of ``WANTED`` are in the row."""
        level = wanted["level"].astype(np.int64)
        return np.asarray(self.bases[level] + wanted["row"] * self.widths[level] + wanted["col"])


@dataclass(slots=True)
class Patches:
    """What a view needs.

    Attributes:
        instances: (k,) of ``INSTANCE``, coarse patches first; spans: float32 (k, 2), metres between which all heights
            of each lie, infinite where that is not known; both good until the next selection.
        tiles: int64 (t,), all tiles that the view would use if every tile was there, as places in ``tiling``;
            pixels: float32 (t,), the errors that patches out of them take away.
        stats: patches, triangles, split, nodes, blocked (diamonds that wait for tiles), pixels (the largest bound of a
            patch's error).
        within, tolerance: as of ``budget.Coarsened``.
    """

    instances: NDArray[Any]
    spans: NDArray[np.float32]
    tiles: NDArray[np.int64]
    pixels: NDArray[np.float32]
    tiling: Tiling
    stats: dict[str, Any] = field(default_factory=dict)
    within: bool = True
    tolerance: float | None = None

    @property
    def triangles(self) -> int:
        """Of all patches."""
        return int(self.stats["triangles"])

    def kept(self) -> Self:
        """A copy that stays valid after the next selection."""
        return replace(self, instances=self.instances.copy(), spans=self.spans.copy())

    @property
    def wanted(self) -> NDArray[Any]:
        """(w,) of ``WANTED``: the tiles, largest error first, the roots' before all others."""
        order = np.argsort(-self.pixels, kind="stable")
        level, row, col = self.tiling.where(self.tiles[order])
        below = level < self.tiling.top
        found = np.zeros(1 + int(below.sum()), WANTED)
        found[0] = self.tiling.top, 0, 0, np.inf
        for name, values in (("level", level), ("row", row), ("col", col), ("pixels", self.pixels[order])):
            found[name][1:] = values[below]
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class TrianglePatchesOptions(MeshOptions):
    """Options of ``triangle-patches``. See ``RightTriangleOptions``."""

    metric: str | None = option(None, METRIC, choices=("anisotropic", "isotropic"))
    legs: int = option(LEGS, "Segments along a patch's leg; fewer where the raster is smaller than a patch.",
                       choices=ALL_LEGS)  # fmt: skip
    geomorph: bool = option(
        False, "Vertices grow out of their edges (for GPUs); otherwise patches are split at the tolerance itself."
    )


class TrianglePatches(RightTriangles):
    """Triangle patches. See ``RightTriangles`` for the arguments.

    Attributes:
        legs: L.
    """

    info = MethodInfo(
        "triangle-patches", "regular patches of 256 triangles in place of triangles, instanced by the GPU; geomorphs",
        "Orograph's own; patches in place of triangles as in Levenberg 2002 (CABTT)", "patches", TrianglePatchesOptions,
        lambda options: options.conservative,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.geomorph: bool = self.options.geomorph
        self._q = self.legs.bit_length() - 1
        self.field: Pager
        shapes = [tile_shape(self.terrain.grid.shape, level) for level in range(self.field.top + 1)]
        ends = np.cumsum([rows * cols for rows, cols in shapes])
        self.tiling = Tiling(
            np.concatenate([[0], ends[:-1]]).astype(np.int64), np.array([cols for _, cols in shapes], np.int64),
            self.field.top,
        )  # fmt: skip
        self._all = np.ones(int(ends[-1]), np.uint8)
        self._priorities = np.zeros(int(ends[-1]), np.float32)
        self._touched = np.zeros(int(ends[-1]), np.int64)
        size, n = cell_size(self.terrain), self.field.n
        self._holes = size * np.sqrt(2.0) ** (2.0 * (n - self._q) - np.arange(2 * n + 1) + 1.0)
        self._unbounded = np.full(2 * n + 1, np.inf)
        self._room(1 << 12)

    def _pages(self) -> Pager:
        self.legs: int = min(self.options.legs, 1 << self.terrain.n)
        ground: Any = PatchTerrain(
            self.terrain, self.options.error, self.legs, jobs=self.jobs, progress=self.resources.progress
        )
        color = None
        if self.color_tolerance < math.inf:
            found = patch_colors(
                self.terrain, self.resources.color, self.legs, jobs=self.jobs, progress=self.resources.progress
            )
            color = MemoryPatches(self.terrain, found).read
        return Pager(ground, self.error, color=color, max_memory=self.resources.max_memory, jobs=self.jobs)

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        return *super().needs(options), Need("patches", {"error": options.error, "legs": options.legs})

    def _room(self, size: int) -> None:
        self._table = np.empty(4 * size, np.int32)
        self._queue = (
            np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.uint8),
            np.empty((size, 2), np.float32), np.empty((size, 2), np.float32), np.empty((4, 3), np.int64),
        )  # fmt: skip
        self._instances = np.zeros(2 * size, INSTANCE)
        raw = self._instances.view(np.int32).reshape(-1, 8)
        self._words, self._floats = raw, raw.view(np.float32)
        self._spans = np.zeros((2 * size, 2), np.float32)

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> PatchSet:
        """The patches of a view; edges of missing ground are kept to the sample.

        Raises:
            UsageError: more pages are needed than memory allows.
        """
        began = time.perf_counter()

        def at(tolerance: float, estimated: bool = False) -> Patches:
            return self.patches(camera, tolerance, ready, geomorph=self.geomorph, estimated=estimated)

        patches = at(goal.tolerance) if goal.tolerance is not None else by_tolerance(at, goal, self._last)
        bounded = goal.triangles is None or patches.within
        if not bounded:
            # Around an eye near the ground errors have no bound: where they count for all that, it takes too many.
            patches = by_tolerance(partial(at, estimated=True), goal, self._last)
        tolerance = goal.tolerance if goal.tolerance is not None else patches.tolerance if bounded else None
        promised = self.conservative and patches.within and bounded
        stats: dict[str, Any] = {
            "method": self.info.name, "error": self.error, "metric": self.metric.name, "tolerance": tolerance,
            "conservative": promised, "exaggeration": camera.exaggeration,
            "refine_ms": round((time.perf_counter() - began) * 1e3, 3), "tiles_read": self.field.tiles_read,
            "tiles_resident": self.field.resident, "geomorph": self.geomorph,
            **{name: patches.stats[name] for name in ("patches", "triangles", "split", "nodes")},
        }  # fmt: skip
        if goal.triangles is not None:
            stats["within_budget"] = patches.within
        wanted = patches.wanted
        lacking = wanted[:0]
        if ready.tiles is not None:
            lacking = wanted[ready.tiles[self.tiling.places(wanted)] == 0]
            promised = promised and not (len(lacking) or patches.stats["absent"])
        instances = patches.instances.copy()
        self._last.selected(began)
        return PatchSet(
            method=self.info.name, bound=tolerance if promised else None, lacking=lacking, stats=stats,
            topologies=(_topology(self.legs),),
            instances=instances, shapes=np.zeros(len(instances), np.uint8), expand=self._expand,
        )  # fmt: skip

    def _expand(self, selection: PatchSet) -> Tessellation:
        keys, heights = expand(self.terrain, selection.instances, self.legs)
        stats = dict(selection.stats)
        made = Tessellation.from_triangles(self.terrain.grid, keys, heights, clockwise=False, stats=stats)
        stats["triangles"] = len(made.triangles)
        return made

    def patches(
        self,
        camera: Camera,
        tolerance: float,
        ready: Ready = EVERYTHING,
        *,
        cull: bool | None = None,
        frustum: NDArray[np.float64] | None = None,
        geomorph: bool = True,
        rim: float | None = None,
        estimated: bool = False,
    ) -> Patches:
        """The patches of a view, for renderers and benchmarks.

        Args:
            camera: whose errors count.
            tolerance: pixels.
            ready: a diamond is split only if all tiles its children need are there (the tile of the coarsest level that
                holds the roots is taken to be), in the order of ``tiling``. ``slots`` go into the patches' ``slot``.
                Without ``wait`` the patches are those that can be told without the pages of errors that are lacking;
                ``stats["absent"]`` is not 0 while more will come.
            cull: leave out what is outside the frustum (default: as the method does).
            frustum: (m, 4), at most 6 planes to cull with instead of the view's (``View.frustum``: stretched space,
                positive inside), a light's for example. What the eye does not see is judged by its distance.
            geomorph: split at τ/κ already, and let new points grow until τ.
            rim: how much of a triangle's longest edge counts as the error where ground ends: 1 where triangles with a
                missing corner are left out, 0.5 for a renderer that fills corners whose surroundings are half there,
                more for edges right to a part of a pixel; None: edges of missing ground are kept to the sample.
            estimated: take a guess at errors that have no bound, for budgets that no tolerance keeps: diamonds around
                an eye near the ground are else split to the end.

        Raises:
            UsageError: an argument makes no sense, or more pages are needed than memory allows.
        """
        if not 0 <= tolerance < math.inf:
            raise UsageError(f"The tolerance must be 0 or more pixels, not {tolerance!r}.")
        view, lens = camera.view, self._lens(camera, tolerance)
        eye = Frustum(lens.planes)
        if frustum is not None:
            lens = lens._replace(planes=self._planes(frustum, camera.exaggeration))
        plan = 1.0 / view.pixel_metres if lens.focal == 0.0 else 0.0
        bounds = Bounds(
            lens, eye, frustum is not None, self.metric.number, bool(self.cull if cull is None else cull),
            float(tolerance / KAPPA if geomorph else tolerance), float(tolerance), plan,
            self._unbounded if rim is None else rim * self._holes,
            self.legs * cell_size(self.terrain) if estimated else 0.0,
        )  # fmt: skip
        there = self._all if ready.tiles is None else ready.tiles
        if there.shape != self._all.shape or there.dtype != np.uint8:
            raise UsageError("Readiness of tiles must be a uint8 array over all tiles of all levels of the terrain.")
        tiling = Tiles(
            self.tiling.bases, self.tiling.widths, there, NOWHERE if ready.slots is None else ready.slots,
            self._priorities, self._touched,
        )  # fmt: skip
        counts = np.zeros(6, np.int64)
        if ready.wait:
            self.field.finish()
        self.field.enter()
        while True:
            self.field.begin()
            full = select_patches(
                self.field.pages, bounds, self.field.n, self._q, tiling, Front(self._table, *self._queue),
                Instances(self._words, self._floats, self._spans), counts,
            )  # fmt: skip
            tiles = self._touched[: counts[TOUCHED]].copy()
            pixels = self._priorities[tiles]
            self._priorities[tiles] = 0.0  # as it was before
            if full:
                self._room(2 * len(self._queue[0]))
            elif ready.wait and self.field.fetch():
                continue
            else:
                break
        if not ready.wait:
            self.field.fetch_later()
        made = self._instances[: counts[PATCHES]]
        stats = {
            "patches": len(made), "triangles": len(made) * self.legs**2, "split": int(counts[SPLIT]),
            "nodes": int(counts[NODES]), "blocked": int(counts[BLOCKED]), "absent": int(counts[ABSENT]),
            "pixels": float(made["pixels"].max()) if len(made) else 0.0,
        }  # fmt: skip
        return Patches(made, self._spans[: len(made)], tiles, pixels, self.tiling, stats)

    def _planes(self, frustum: NDArray[np.float64], stretch: float) -> NDArray[np.float64]:
        """Planes in stretched space as kernels see them: (24,), over column, row and height."""
        planes = np.asarray(frustum, np.float64)
        if planes.ndim != 2 or planes.shape[1] != 4 or len(planes) > 6:
            raise UsageError(f"A frustum must be at most 6 planes (m, 4), not an array of {planes.shape}.")
        table = np.zeros((6, 4))
        table[:, 3] = np.inf
        table[: len(planes)] = self.terrain.chart.planes(planes.tolist(), stretch)
        flat: NDArray[np.float64] = table.ravel()
        return flat


@lru_cache(maxsize=8)
def _topology(legs: int) -> Topology:
    return Topology(patch_vertices(legs).astype(np.int32), patch_indices(legs).astype(np.int32))
