"""Batched right triangles: the hierarchy of right triangles with *patches* in place of triangles, for the GPU.

A patch is a right triangle of the hierarchy, regularly divided into L² small ones (``patches.shape``); every patch has
the same triangles, so that a picture is one instanced draw, and the CPU decides about a few thousand patches instead of
half a million triangles: batched dynamic adaptive meshes (Cignoni et al. 2003, BDAM; Levenberg 2002, *CABTT*). As all
patches have L segments on each side, they conform by the rule that triangles conform by: a diamond is split if the
bound of its error exceeds the tolerance and both its parents are split. No skirts, no stitching.

The promise is that of the other engines: P(D), the largest ``exact`` error among the triangles of D's patches
(``patches.tables``), projected by the conservative metric over D's nested sphere. Where ground and missing ground meet,
the mesh is refined until the edges of its triangles are shorter than the tolerance on the screen, or to the samples.

*Geomorphs.* Diamonds are split at τ/κ already, and the points that a split brings grow out of the middles of their
edges while the bound grows from τ/κ to τ: nothing pops, and as both surfaces keep the tolerance then, so does every one
between them. P is saturated so that a diamond's parents have ended their geomorph when it is split; then the new points
on a patch's legs belong to one diamond alone, and everybody agrees about them. Pixels, samples, metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import camera_parameters
from orograph.errors import UsageError
from orograph.lod.engine import Engine, Mesh, by_tolerance
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
from orograph.lod.patches.shape import INSTANCE, check_legs, patch_indices, patch_vertices
from orograph.lod.patches.tables import PatchTerrain, cell_size
from orograph.progress import SILENT, Progress
from orograph.store.patches import KAPPA, LEGS
from orograph.store.terrain import tile_shape
from orograph.viewpoint import View

__all__ = ["INSTANCE", "LEGS", "WANTED", "Batched", "Patches", "patch_indices", "patch_vertices"]

NOWHERE: NDArray[np.uint32] = np.zeros(0, np.uint32)

WANTED = np.dtype([("level", "<i4"), ("row", "<i4"), ("col", "<i4"), ("pixels", "<f4")])
"""A tile that a view needs: where it is, and the largest error in pixels that patches out of it take away."""


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


@dataclass(frozen=True, slots=True)
class Patches:
    """What a view needs.

    Attributes:
        instances: (k,) of ``INSTANCE``, coarse patches first; good until the next selection.
        tiles: int64 (t,), all tiles that the view would use if every tile was there, as places in ``tiling``;
            pixels: float32 (t,), the errors that patches out of them take away.
        stats: patches, triangles, split, nodes, blocked (diamonds that wait for tiles), pixels (the largest bound of a
            patch's error).
    """

    instances: NDArray[Any]
    tiles: NDArray[np.int64]
    pixels: NDArray[np.float32]
    tiling: Tiling
    stats: dict[str, Any] = field(default_factory=dict)

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


class Batched(Engine):
    """Batched right triangles. See ``Engine`` for the arguments; besides:

    Args:
        legs: segments along a patch's leg, L: 2, 4, 8, 16, 32 or 64 (less where the raster is smaller than a patch).
        geomorph: meshes are drawn as the GPU would draw them, vertices on their way included; else diamonds are split
            at the tolerance itself.
        rim: how much of a triangle's longest edge counts as the error where ground ends: 1 where triangles with a
            missing corner are left out, 0.5 for a renderer that fills corners whose surroundings are half there.
        progress: is told how the errors of patches come along, where they must be made (seconds for large terrains).

    Attributes:
        legs: L.
    """

    name = "batched"
    metrics = ("anisotropic", "isotropic")
    takes_colors = False

    def __init__(
        self, *args: Any, legs: int = LEGS, geomorph: bool = False, rim: float = 1.0, progress: Progress = SILENT,
        **options: Any,
    ) -> None:  # fmt: skip
        if options.get("color_tolerance") is not None:
            raise UsageError("Patches take their colours from textures: batched has no color tolerance.")
        super().__init__(*args, **options)
        n = self.field.n
        self.legs, self.geomorph = min(check_legs(legs), 1 << n), geomorph
        self._q = self.legs.bit_length() - 1
        ground: Any = PatchTerrain(self.terrain, self.field.kind, self.legs, jobs=self.jobs, progress=progress)
        self.field: Pager = Pager(ground, self.error, max_memory=options.get("max_memory", 1 << 30), jobs=self.jobs)
        shapes = [tile_shape(self.terrain.grid.shape, level) for level in range(self.field.top + 1)]
        ends = np.cumsum([rows * cols for rows, cols in shapes])
        self.tiling = Tiling(
            np.concatenate([[0], ends[:-1]]).astype(np.int64), np.array([cols for _, cols in shapes], np.int64),
            self.field.top,
        )  # fmt: skip
        self._all = np.ones(int(ends[-1]), np.uint8)
        self._priorities = np.zeros(int(ends[-1]), np.float32)
        self._touched = np.zeros(int(ends[-1]), np.int64)
        self._shapes = shapes
        size = cell_size(self.terrain)
        levels = np.arange(2 * n + 1)
        self._holes = rim * size * np.sqrt(2.0) ** (2.0 * (n - self._q) - levels + 1.0)
        self._unbounded = np.full(2 * n + 1, np.inf)
        self._room(1 << 12)

    def _room(self, size: int) -> None:
        self._table = np.empty(4 * size, np.int32)
        self._queue = (
            np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.uint8),
            np.empty((size, 2), np.float32), np.empty((size, 2), np.float32), np.empty((4, 3), np.int64),
        )  # fmt: skip
        self._instances = np.zeros(2 * size, INSTANCE)
        raw = self._instances.view(np.int32).reshape(-1, 8)
        self._words, self._floats = raw, raw.view(np.float32)

    def residency(self) -> list[NDArray[np.uint8]]:
        """For each level an array (tile rows, tile cols) of zeros, to be set where tiles are there (``select``)."""
        whole = np.zeros(len(self._all), np.uint8)
        return [
            whole[base : base + rows * cols].reshape(rows, cols)
            for base, (rows, cols) in zip(self.tiling.bases, self._shapes, strict=True)
        ]

    def select(
        self,
        view: View,
        tolerance: float = 1.0,
        *,
        resident: Sequence[NDArray[np.uint8]] | NDArray[np.uint8] | None = None,
        slots: NDArray[np.uint32] | None = None,
        cull: bool | None = None,
        frustum: NDArray[np.float64] | None = None,
        exaggeration: float | None = None,
        geomorph: bool = True,
        exact_holes: bool = False,
        wait: bool = True,
    ) -> Patches:
        """The patches of a view.

        Args:
            view: the camera whose errors count.
            tolerance: pixels.
            resident: for each level a uint8 array (tile rows, tile cols), or for all tiles in the order of ``tiling``
                one, not 0 where a tile is there; a diamond is split only if all tiles its children need are (default:
                all are). The tile of the coarsest level that holds the roots is taken to be there.
            slots: for all tiles in that order 1 + what is to be put into the patches' ``slot``.
            cull: leave out what is outside the frustum (default: as the engine does).
            frustum: (m, 4), at most 6 planes to cull with instead of the view's (``View.frustum``: stretched space,
                positive inside), a light's for example. What the eye does not see is judged by its distance.
            exaggeration: factor on heights (default: the engine's).
            geomorph: split at τ/κ already, and let new points grow until τ.
            exact_holes: keep edges of missing ground to the sample, instead of to the tolerance on the screen.
            wait: read the pages of errors that are lacking. Else threads do, and the patches are those that can be told
                without them; ``stats["absent"]`` is not 0 while more will come.

        Raises:
            UsageError: an argument makes no sense, or more pages are needed than memory allows.
        """
        if not 0 <= tolerance < math.inf:
            raise UsageError(f"The tolerance is in pixels, 0 or more, not {tolerance!r}.")
        stretch = self.exaggeration if exaggeration is None else exaggeration
        if not 0 < stretch < math.inf:
            raise UsageError(f"The exaggeration is a factor greater than 0, not {exaggeration}.")
        lens = camera_parameters(view, self.terrain.grid, exaggeration=stretch, tolerance=tolerance)
        eye = lens
        if frustum is not None:
            lens = lens._replace(planes=self._planes(frustum, stretch))
        plan = 1.0 / view.pixel_metres if lens.focal == 0.0 else 0.0
        bounds = Bounds(
            lens, eye, frustum is not None, self.metric.number, bool(self.cull if cull is None else cull),
            float(tolerance / KAPPA if geomorph else tolerance), float(tolerance), plan,
            self._unbounded if exact_holes else self._holes,
        )  # fmt: skip
        there = self._all
        if isinstance(resident, np.ndarray):
            there = resident
        elif resident is not None:
            there = np.concatenate([np.ravel(level) for level in resident])
        if there.shape != self._all.shape or there.dtype != np.uint8:
            raise UsageError("Residency is a uint8 array (tile rows, tile cols) for each level of the terrain.")
        tiling = Tiles(
            self.tiling.bases, self.tiling.widths, there, NOWHERE if slots is None else slots, self._priorities,
            self._touched,
        )  # fmt: skip
        counts = np.zeros(6, np.int64)
        if wait:
            self.field.finish()
        self.field.enter()
        while True:
            self.field.begin()
            full = select_patches(
                self.field.pages, bounds, self.field.n, self._q, tiling, Front(self._table, *self._queue),
                Instances(self._words, self._floats), counts,
            )  # fmt: skip
            tiles = self._touched[: counts[TOUCHED]].copy()
            pixels = self._priorities[tiles]
            self._priorities[tiles] = 0.0  # as it was before
            if full:
                self._room(2 * len(self._queue[0]))
            elif wait and self.field.fetch():
                continue
            else:
                break
        if not wait:
            self.field.fetch_later()
        made = self._instances[: counts[PATCHES]]
        stats = {
            "patches": len(made), "triangles": len(made) * self.legs**2, "split": int(counts[SPLIT]),
            "nodes": int(counts[NODES]), "blocked": int(counts[BLOCKED]), "absent": int(counts[ABSENT]),
            "pixels": float(made["pixels"].max()) if len(made) else 0.0,
        }  # fmt: skip
        return Patches(made, tiles, pixels, self.tiling, stats)

    def _planes(self, frustum: NDArray[np.float64], stretch: float) -> NDArray[np.float64]:
        """Planes in stretched space as kernels see them: (6, 4), over column, row and height."""
        planes = np.asarray(frustum, np.float64)
        if planes.ndim != 2 or planes.shape[1] != 4 or len(planes) > 6:
            raise UsageError(f"A frustum is at most 6 planes (m, 4), not an array of {planes.shape}.")
        a, b, c, d, e, f = self.terrain.grid.samples[:6]
        whole = np.array([[a, b, 0.0, c], [d, e, 0.0, f], [0.0, 0.0, stretch, 0.0], [0.0, 0.0, 0.0, 1.0]])
        table = np.zeros((6, 4))
        table[:, 3] = np.inf
        table[: len(planes)] = planes @ whole
        return table

    def _refine(self, view: View, tolerance: float | None, triangles: int | None, seconds: float | None) -> Mesh:
        if tolerance is None:
            return by_tolerance(self, view, triangles, seconds)
        patches = self.select(view, tolerance, geomorph=self.geomorph, exact_holes=True)
        keys, heights = expand(self.terrain, patches.instances, self.legs)
        stats = {name: patches.stats[name] for name in ("patches", "split", "nodes")} | {"geomorph": self.geomorph}
        return Mesh(keys, heights, is_strip=False, clockwise=False, triangles=len(keys), stats=stats)
