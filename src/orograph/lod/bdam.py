"""BDAM: the hierarchy of right triangles with a small TIN in place of every triangle.

Cignoni, Ganovelli, Gobbetti, Marton, Ponchio & Scopigno, *BDAM – Batched Dynamic Adaptive Meshes for High Performance
Terrain Visualization* (Computer Graphics Forum 22(3), 2003). The CPU decides about a few hundred patches, as for
``triangle-patches``; but a patch's triangles are where the ground needs them. Patches were simplified bottom up, two of
a diamond at a time (``store.tin_build``): the vertices along an edge of the hierarchy were decided once, for that edge,
so adjacent patches list the same vertices, whatever their levels. The finest patches are the samples themselves.

A diamond is split if its error, measured on the surface and saturated, projected over its nested sphere, exceeds the
tolerance, or its colours are off (``tin_colors``), and its parents are split. Only unpacked patches are kept from frame
to frame. Diamonds over both ground and missing ground have no TINs: there the mesh is refined to the samples. Geomorphs
(not in the paper) are those of ``tin_morphs``. Pixels, samples, metres.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.hierarchy import diamonds, triangles
from orograph.lod.budget import by_tolerance
from orograph.lod.field import ColorErrors
from orograph.lod.method import EVERYTHING, Goal, MethodInfo, Need, Ready
from orograph.lod.options import option
from orograph.lod.patches.expand import heights_of
from orograph.lod.patches.pager import Pager
from orograph.lod.patches.shape import INSTANCE, STEPS, patch_indices, patch_vertices
from orograph.lod.right_triangles import METRIC, MeshOptions
from orograph.lod.selection import TinBatch, TinBatches
from orograph.lod.tin_colors import color_errors
from orograph.lod.tin_morphs import Morphs, Name, Separated, share_of
from orograph.lod.triangle_patches import Patches, TrianglePatches
from orograph.lod.vertex_cache import for_cache
from orograph.parallel import map_ordered
from orograph.store.patches import MemoryPatches
from orograph.store.terrain import TILE, Terrain
from orograph.store.tin_build import make_tins
from orograph.store.tin_diamonds import Workplace, tins_of
from orograph.store.tins import ALL_LEGS, LEGS, Tins
from orograph.tessellation import turn
from orograph.viewpoint import Camera

COLOR_BYTES = 12
"""Of a sample's colour."""

TRIANGLE_BYTES = 36
"""Of an unpacked patch, for each of its triangles, about: vertices and triangles."""

Diamond = tuple[int, int]
Apex = tuple[int, int, int]
"""A finest patch: its apex and ω."""
Pair = tuple[TinBatch, TinBatch]


class TinTerrain:
    """A terrain whose diamonds are those of TINs: what ``lod.field`` makes pages of."""

    def __init__(self, terrain: Terrain, tins: Tins | Separated) -> None:
        self._terrain, self._tins = terrain, tins

    def __getattr__(self, name: str) -> Any:
        return getattr(self._terrain, name)

    def derived(self, name: str, **options: Any) -> Tins | Separated:
        """The table of its diamonds."""
        return self._tins


@dataclass(frozen=True, slots=True, kw_only=True)
class BdamOptions(MeshOptions):
    """Options of ``bdam``."""

    error: str = option("exact", "Errors of TINs are measured on the surface; there are no others.", choices=("exact",))
    metric: str | None = option(None, METRIC, choices=("anisotropic", "isotropic"))
    legs: int = option(
        LEGS, "Segments along the leg of a finest patch; their square is the number of a patch's triangles.",
        choices=ALL_LEGS,
    )  # fmt: skip

    geomorph: bool = option(
        False, "Patches morph into those below them while the bound of their error grows from four fifths of the "
               "tolerance to all of it, which they always keep; morphing patches have several times the triangles.",
    )  # fmt: skip


class Bdam(TrianglePatches):
    """BDAM. See ``RightTriangles`` for the arguments.

    Attributes:
        tins: the terrain's.
    """

    info = MethodInfo(
        "bdam", "a small TIN for every triangle of the hierarchy, simplified bottom up; batches of 256 triangles",
        "Cignoni et al. 2003", "batches", BdamOptions, lambda options: options.conservative,
    )  # fmt: skip
    samples_colored = True

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self._kept: OrderedDict[Diamond, Pair] = OrderedDict()
        self._samples: OrderedDict[Apex, TinBatch] = OrderedDict()
        self._most = max(256, self.resources.max_memory // (16 * TRIANGLE_BYTES * self.legs**2))
        self._workplace = Workplace()
        self._flip = turn(self.terrain.grid) > 0
        points, corners = patch_vertices(self.legs), patch_indices(self.legs).astype(np.int32)
        points, self._corners = for_cache(points, corners[:, ::-1] if self._flip else corners)
        self._points = points.astype(np.int64)
        share = self.resources.max_memory // 8
        self._morphs = Morphs(self.terrain.grid.shape, self._meshes, flip=self._flip, most=share, jobs=self.jobs)

    def _pages(self) -> Pager:
        self.legs = min(self.options.legs, 1 << self.terrain.n)
        progress, jobs = self.resources.progress, self.jobs
        self.tins: Tins = (
            self.terrain.derived("tins", legs=self.legs)
            if self.terrain.has("tins", legs=self.legs)
            else make_tins(self.terrain, self.legs, jobs=jobs, progress=progress)
        )
        table = Separated(self.terrain, self.tins) if self.options.geomorph else self.tins
        ground: Any = TinTerrain(self.terrain, table)
        return Pager(ground, self.error, color=self._colors(), max_memory=self.resources.max_memory, jobs=jobs)

    def _colors(self) -> ColorErrors | None:
        """The color errors of the TINs, if colours count."""
        if self.color_tolerance == math.inf:
            return None
        if not hasattr(self.resources.color, "colors"):
            raise UsageError(
                "A color tolerance needs colours.", remedy="Give the colours of samples with the resources."
            )
        rows, cols = self.terrain.grid.shape
        window = self.resources.color.colors
        if COLOR_BYTES * rows * cols <= self.resources.max_memory // 4:
            whole: NDArray[np.float32] = window(0, rows, 0, cols)

            def window(row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
                return whole[row0:row1, col0:col1]

        found = color_errors(self.terrain, self.tins, window, jobs=self.jobs, progress=self.resources.progress)
        return MemoryPatches(self.terrain, found).read

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        """The TINs."""
        return (Need("tins", {"legs": options.legs}),)

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> TinBatches:  # type: ignore[override]
        """The patches of a view. What they need is read, whatever is ``ready``; ``lacking`` lists what is not.

        Raises:
            UsageError: more pages are needed than memory allows.
        """
        began = time.perf_counter()

        def at(tolerance: float, estimated: bool = False) -> Patches:
            found = self.patches(camera, tolerance, geomorph=False, estimated=estimated)
            if goal.tolerance is None:
                found.stats["triangles"] = sum(
                    len(batch.triangles) for batch in self._batches(found.instances, tolerance)
                )
            return found

        patches = at(goal.tolerance) if goal.tolerance is not None else by_tolerance(at, goal, self._last)
        bounded = goal.triangles is None or patches.within
        if not bounded:
            # Around an eye near the ground errors have no bound; refining all of these would take too many patches.
            patches = by_tolerance(partial(at, estimated=True), goal, self._last)
        tolerance = goal.tolerance if goal.tolerance is not None else patches.tolerance if bounded else None
        promised = self.conservative and patches.within and bounded
        selected = time.perf_counter()
        batches = self._batches(patches.instances, patches.tolerance if goal.tolerance is None else goal.tolerance)
        stats: dict[str, Any] = {
            "method": self.info.name, "error": self.error, "metric": self.metric.name, "tolerance": tolerance,
            "conservative": promised, "exaggeration": camera.exaggeration,
            "refine_ms": round((time.perf_counter() - began) * 1e3, 3),
            "select_ms": round((selected - began) * 1e3, 3), "tiles_read": self.field.tiles_read,
            "tiles_resident": self.field.resident, "geomorph": self.geomorph, "patches": len(batches),
            "triangles": sum(len(batch.triangles) for batch in batches),
            **{name: patches.stats[name] for name in ("split", "nodes")},
        }  # fmt: skip
        if goal.triangles is not None:
            stats["within_budget"] = patches.within
        wanted = patches.wanted
        if ready.tiles is None:
            wanted = wanted[:0]
        else:
            wanted = wanted[ready.tiles[self.tiling.places(wanted)] == 0]
        self._last.selected(began)
        return TinBatches(
            method=self.info.name, bound=tolerance if promised else None, lacking=wanted, stats=stats, batches=batches
        )

    def _batches(self, instances: NDArray[Any], tolerance: float | None = None) -> list[TinBatch]:
        """The meshes of patches, finest patches last; those without a triangle are left out.

        Args:
            tolerance: pixels, by which they grow; None: they do not.
        """
        omega = instances["omega"].astype(np.int64)
        finest = (instances["step"] == 0) & (omega & 1 == 1)
        others = instances[~finest]
        extent = np.int64(self.legs) << others["step"].astype(np.int64)
        x, y, _, _ = triangles.with_apex(
            others["col"].astype(np.int64), others["row"].astype(np.int64), extent, omega[~finest]
        )
        names = list(zip(y.tolist(), x.tolist(), (omega[~finest] >> 2).tolist()))
        found = self._tins(names)
        if self.geomorph and tolerance is not None:
            shares = [share_of(pixels, tolerance) for pixels in others["pixels"].tolist()]
            grown = [k for k, share in enumerate(shares) if share > 0.0]
            between = self._morphs.between(
                [names[k] for k in grown], [found[k] for k in grown], [shares[k] for k in grown]
            )
            for k, batch in zip(grown, between):
                found[k] = batch
        return [batch for batch in (*found, *self._finest(instances[finest])) if len(batch.triangles)]

    def _meshes(self, names: list[Name]) -> list[TinBatch]:
        """The meshes of any patches, including finest ones."""
        kinds = [int(diamonds.kind(row, col)) for row, col, _ in names]
        extents = [int(diamonds.spacing(row, col)) for row, col, _ in names]
        finest = [kind == diamonds.SQUARE and 2 * s == self.legs for kind, s in zip(kinds, extents)]
        coarse = iter(self._tins([name for name, fine in zip(names, finest) if not fine]))
        instances = np.zeros(sum(finest), INSTANCE)
        for at, (row, col, side) in enumerate(name for name, fine in zip(names, finest) if fine):
            top = diamonds.top(row, col, side)
            instances["col"][at], instances["row"][at] = triangles.apex(*top)
            instances["omega"][at] = top[3]
            corners = triangles.apex(*top), triangles.left_end(*top), triangles.right_end(*top)
            instances["tile_col"][at], instances["tile_row"][at] = (min(c) // TILE for c in zip(*corners))
        samples = iter(self._finest(instances))
        return [next(samples) if fine else next(coarse) for fine in finest]

    def _tins(self, names: list[Name]) -> list[TinBatch]:
        """The TINs of patches that have some."""
        keys = [(row, col) for row, col, _ in names]
        self._unpack(keys)
        found = [self._kept[key][name[2]] for key, name in zip(keys, names)]
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return found

    def _unpack(self, keys: list[Diamond]) -> None:
        """Prepare the TINs of diamonds, in several threads."""
        lacking = list(dict.fromkeys(key for key in keys if key not in self._kept))
        for key in keys:
            if key in self._kept:
                self._kept.move_to_end(key)
        for key, pair in zip(lacking, map_ordered(self._pair, lacking, self.jobs)):
            self._kept[key] = pair

    def _pair(self, key: Diamond) -> Pair:
        """Both patches of a diamond."""
        vertices, *patches = tins_of(self.terrain, self.tins, *key, self._workplace)
        made = []
        for corners in patches:
            used, places = np.unique(corners, return_inverse=True)
            turned = places.reshape(-1, 3).astype(np.int32)
            made.append(TinBatch(*for_cache(vertices[used], turned if self._flip else turned[:, ::-1])))
        return made[0], made[1]

    def _finest(self, instances: NDArray[Any]) -> list[TinBatch]:
        """The samples of finest patches; those beyond the raster, and triangles with a missing corner, are left out."""
        names = list(zip(*(instances[name].tolist() for name in ("row", "col", "omega"))))
        lacking = np.array([name not in self._samples for name in names], bool)
        if lacking.any():
            new = [name for name, lacks in zip(names, lacking.tolist()) if lacks]
            self._samples.update(zip(new, self._read(instances[lacking])))
        found = []
        for name in names:
            self._samples.move_to_end(name)
            found.append(self._samples[name])
        while len(self._samples) > 2 * self._most:
            self._samples.popitem(last=False)
        return found

    def _read(self, instances: NDArray[Any]) -> list[TinBatch]:
        """The meshes of finest patches."""
        e1, e2 = STEPS[instances["omega"]].astype(np.int64).transpose(1, 0, 2)
        rows = instances["row"][:, None] + self._points[:, 0] * e1[:, :1] + self._points[:, 1] * e2[:, :1]
        cols = instances["col"][:, None] + self._points[:, 0] * e1[:, 1:] + self._points[:, 1] * e2[:, 1:]
        heights = heights_of(self.terrain, instances, rows, cols)
        last_row, last_col = self.terrain.grid.rows - 1, self.terrain.grid.cols - 1
        there = (rows <= last_row) & (cols <= last_col) & ~np.isnan(heights)
        places = np.stack([cols, rows, heights], -1)
        return [self._part(place, good) for place, good in zip(places, there)]

    def _part(self, places: NDArray[np.float64], good: NDArray[np.bool_]) -> TinBatch:
        if good.all():
            return TinBatch(places, self._corners)
        corners = self._corners[good[self._corners].all(1)]
        used, at = np.unique(corners, return_inverse=True)
        return TinBatch(places[used], at.reshape(-1, 3).astype(np.int32))
