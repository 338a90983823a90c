"""QuadTIN: the triangulation of a restricted quadtree over irregular points.

Pajarola, Antonijuan & Lario, *QuadTIN: Quadtree based Triangulated Irregular Networks* (Vis 2002). A quadtree's
hierarchy of triangles is laid over points that lie anywhere: where a regular one is split in the middle, this one is
split at a point near the middle, and at a Steiner point where there is none (``quadtin_build``). Refinement is that of
any restricted quadtree: a vertex is there if its error, saturated over the hierarchy, is beyond the tolerance on the
screen (``quadtin_pass``), and the triangles are one generalised strip.

The truth is the Delaunay surface of the points that the terrain was gridded from, or the raster's surface. The finest
triangles are within ``finest`` metres of it; where that is more than the tolerance on the screen, the bound says so.
Metres, pixels.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import CameraParameters, camera_parameters
from orograph.errors import UsageError
from orograph.lod.budget import Pass, by_tolerance
from orograph.lod.method import EVERYTHING, Goal, Method, MethodInfo, Need, Ready
from orograph.lod.options import check, option
from orograph.lod.quadtin_colors import color_errors
from orograph.lod.quadtin_pass import activate, leaves_of, strip_of
from orograph.lod.quadtin_tree import Hierarchy, Resident
from orograph.lod.selection import TriangleMesh
from orograph.store.quadtin_grow import has_points
from orograph.store.quadtin_layout import SPLITS, QuadTins
from orograph.store.quadtin_make import make_quadtin
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation, turn
from orograph.viewpoint import Camera

BYTES_PER_TRIANGLE = 24
"""Of the truth, while a hierarchy is made of it and held: about."""


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadTinOptions:
    """Options of all methods on a QuadTIN."""

    finest: float = option(
        0.0, "Maximum distance of the finest triangles from the points' surface, or the raster's; 0: a sixteenth of "
             "the spacing of samples.", unit="metres", least=0.0,
    )  # fmt: skip
    split: str = option(
        "nearest", "Which point splits a triangle: the one nearest to the middle of its longest side, as in the "
                   "paper, or the one with the largest deviation.", choices=SPLITS,
    )  # fmt: skip
    cull: bool = option(True, "Refine only what may be in view.")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ColoredOptions(QuadTinOptions):
    """Options of ``quadtin``."""

    color_tolerance: float | None = option(
        None, "Refine also where coarser triangles would change colours by more (CIELAB; 2.3 is just seen), down to "
        "the finest triangles.", unit="ΔE", least=0.0,
    )  # fmt: skip


@dataclass(slots=True)
class Refined:
    """The selection for a tolerance.

    Attributes:
        leaves: (m,) int32, triangles of the hierarchy, in the order of the curve. bound: pixels.
        strip: int32, vertices of the hierarchy, where the method keeps strips.
    """

    leaves: NDArray[np.int32]
    bound: float
    strip: NDArray[np.int32] | None = None
    within: bool = True
    tolerance: float | None = None
    stats: dict[str, Any] = field(default_factory=dict)

    @property
    def triangles(self) -> int:
        """How many there are."""
        return len(self.leaves)

    def kept(self) -> Self:
        """A copy that is good after the method has refined again."""
        return replace(self, leaves=self.leaves.copy())


class QuadTin(Method):
    """QuadTIN. See ``Method`` for the arguments.

    Attributes:
        tree: the hierarchy. truth: "points" or "raster".

    Raises:
        UsageError: the terrain has no surface, or is too large.
    """

    info = MethodInfo(
        "quadtin", "a restricted quadtree's triangles over irregular points", "Pajarola, Antonijuan & Lario 2002",
        "triangles", ColoredOptions, lambda options: True,
    )  # fmt: skip

    samples_colored = True

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        gamma = getattr(self.options, "color_tolerance", None)
        if gamma is not None and not hasattr(self.resources.color, "colors"):
            raise UsageError(
                "A color tolerance needs colours.", remedy="Give the colours of samples with the resources."
            )
        self.color_tolerance: float = math.inf if gamma is None else gamma
        self.truth = "points" if has_points(self.terrain) else "raster"
        what = {"finest": self.options.finest, "split": self.options.split}
        if self.terrain.has("quadtin", **what):
            source: QuadTins = self.terrain.derived("quadtin", **what)
        else:
            self._check_room()
            resources = self.resources
            source = make_quadtin(
                self.terrain, **what, jobs=resources.jobs, progress=resources.progress, max_memory=resources.max_memory
            )
        self._resident = Resident(
            source, self.terrain.grid, self.resources.max_memory, self.terrain.name,
            self._needs_all or gamma is not None,
        )  # fmt: skip
        self._last = Pass()
        self._prepare()

    def _check_room(self) -> None:
        """Raise UsageError where making the hierarchy takes more memory than is allowed."""
        rows, cols = self.terrain.grid.shape
        count = len(self.terrain.derived("points").triangles) if self.truth == "points" else 2 * rows * cols
        needed = count * BYTES_PER_TRIANGLE
        if needed > self.resources.max_memory:
            raise UsageError(
                f"The store has no hierarchy of a QuadTIN, and making it in memory takes {needed >> 20} MiB.",
                path=self.terrain.name,
                remedy="Allow more memory, build a store with it "
                f"(`orograph.build(..., quadtin={(self.options.finest, self.options.split)})`), or give a coarser "
                "`resolution` or a smaller area (`bbox`).",
            )  # fmt: skip

    _needs_all = False
    """Whether the whole hierarchy should be in memory."""

    @property
    def tree(self) -> Hierarchy:
        """The part of the hierarchy in memory: everything, if it is small."""
        return self._resident.tree

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        """The hierarchy."""
        return (Need("quadtin", {"finest": options.finest, "split": options.split}),)

    @classmethod
    def obstacle(cls, options: Any, terrain: Terrain) -> str:
        """A raster's cells beside missing samples are cut differently; points have no cells."""
        whole = has_points(terrain) or terrain.valid_fraction == 1
        return "" if whole else "some of its samples are missing"

    def _prepare(self) -> None:
        """Room for a refinement."""
        self._prepared = self.tree
        count = len(self.tree.vertices)
        self._colors = self._color_errors()
        self._active, self._met = np.zeros(count, np.uint8), np.zeros(count + 1, np.int32)
        self._stack, self._leaves = np.empty(count + 1, np.int32), np.empty(1 << 12, np.int32)
        self._depth = np.empty((1024, 2), np.int32)

    def _color_errors(self) -> NDArray[np.float32]:
        """Of all vertices (v,), ΔE; 0 where colors do not count."""
        if self.color_tolerance == math.inf:
            return np.zeros(len(self.tree.vertices), np.float32)
        return color_errors(self.tree, self.terrain.grid.shape, self.resources.color.colors)

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> TriangleMesh:
        """The mesh for a camera. Its bound is the tolerance, or what the finest triangles are off, if that is more; of
        a terrain with missing ground there is none, for the mesh ends within a sample of it.

        Raises:
            UsageError: the camera is over no flat terrain.
        """
        began = time.perf_counter()
        found = self.refined(camera, goal)
        took = time.perf_counter() - began
        tolerance = max(found.tolerance or 0.0, found.bound)
        within = found.within and np.isfinite(tolerance) and not self.tree.stuck
        promised = bool(within and (self.tree.whole or self.truth == "points"))
        stats: dict[str, Any] = {
            "method": self.info.name, "error": "exact", "truth": self.truth,
            "tolerance": float(tolerance) if within else None, "conservative": promised,
            "exaggeration": camera.exaggeration, "refine_ms": round(took * 1e3, 3), **found.stats,
            "points": self.tree.points, "steiner": self.tree.steiner, "finest": self.tree.finest,
            "tiles_read": 0, "tiles_resident": 0,
        }  # fmt: skip
        if goal.triangles is not None:
            stats["within_budget"] = found.triangles <= goal.triangles
        mesh = self._mesh(found, stats)
        stats["triangles"] = len(mesh.triangles)
        return TriangleMesh(
            method=self.info.name, bound=stats["tolerance"] if promised else None, stats=stats, mesh=mesh
        )

    def refined(self, camera: Camera, goal: Goal) -> Refined:
        """The result of ``select`` before its vertices are numbered. For benchmarks."""
        if goal.tolerance is None:
            return by_tolerance(lambda pixels: self._refine(camera, pixels), goal, self._last)
        found = self._refine(camera, goal.tolerance)
        found.tolerance = goal.tolerance
        return found

    def _refine(self, camera: Camera, tolerance: float) -> Refined:
        lens = self._lens(camera, tolerance)
        if self._resident.follow(lens, self.options.cull) is not self._prepared:
            self._prepare()
        active = activate(lens, self.options.cull, self.tree, self._colors, self._active, self._met, self._stack)
        while True:
            count, bound = leaves_of(lens, self.tree, self._active, self._leaves, self._depth)
            if count >= 0:
                return Refined(self._leaves[:count], float(bound), stats={"active": int(active)})
            self._leaves = np.empty(2 * len(self._leaves), np.int32)

    def _lens(self, camera: Camera, tolerance: float) -> CameraParameters:
        return camera_parameters(camera, tolerance=tolerance, color_tolerance=self.color_tolerance)

    def _mesh(self, found: Refined, stats: dict[str, Any]) -> Tessellation:
        """The triangles of a mesh, its vertices numbered, with its strip."""
        corners = self.tree.corners[found.leaves]
        numbers = np.zeros(len(self.tree.vertices), np.int32)
        _, first = np.unique(corners, return_index=True)
        which = corners.ravel()[np.sort(first)]  # in the order of the mesh, whatever else is in memory
        numbers[which] = np.arange(len(which))
        triangles, backwards = numbers[corners], turn(self.terrain.grid) < 0
        if backwards:
            triangles = triangles[:, ::-1]
        triangles = np.ascontiguousarray(triangles)
        if found.strip is None:
            strip = strip_of_all(triangles)
        else:
            strip = numbers[found.strip]
            if backwards and len(strip):  # one place on, triangles turn the other way
                strip = np.r_[strip[:1], strip]
        return Tessellation(self.tree.vertices[which], triangles, strip, stats)


def strip_of_all(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """One generalised strip of triangles (m, 3)."""
    strip = np.empty(7 * len(triangles) + 8, np.int32)
    return strip[: strip_of(triangles, strip)].copy()
