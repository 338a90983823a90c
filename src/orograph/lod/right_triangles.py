"""What all methods on the hierarchy of right triangles share: options and promises.

``RightTriangles`` holds the terrain's pages (``lod.field``). Those that make single triangles are
``RightTriangleMeshes``: they refine until a goal is reached and leave a ``Mesh``, arrays that renderers and benches can
take before their vertices are numbered (``mesh``); ``select`` makes a ``TriangleMesh`` of it.
"""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import ANISOTROPIC, LOCALISED, CameraParameters, Metric, camera_parameters, metric_of
from orograph.errors import UsageError
from orograph.lod.budget import Pass
from orograph.lod.criterion import NOTHING
from orograph.lod.field import Field
from orograph.lod.look_ahead import Ahead
from orograph.lod.method import EVERYTHING, Goal, Method, Need, Ready, Resources
from orograph.lod.options import check, described, option
from orograph.lod.selection import TriangleMesh
from orograph.parallel import threads_for
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera

ERRORS = ("exact", "wedgie", "midpoint")
"""Object-space errors."""

BOUNDS = ("exact", "wedgie")
"""Those that bound every sample's."""

SPHERES = ("localised", "anisotropic", "isotropic", "isotropic-published")
"""Metrics of methods that decide for a whole diamond."""

EVERY = ("localised", "wedgie", "anisotropic", "isotropic", "isotropic-published", "anisotropic-published")
"""Metrics of methods that look at triangles one by one."""

METRIC = "How errors become pixels; default: the tightest metric that the error allows."


@dataclass(frozen=True, slots=True, kw_only=True)
class RightTriangleOptions:
    """Options of all methods on right triangles.

    Raises:
        UsageError: an option is out of its range, or two exclude each other.
    """

    error: str = option(
        "exact", "Object-space errors: exact (the tightest bound), wedgie (ROAM's), midpoint (not a bound).",
        choices=ERRORS,
    )  # fmt: skip
    metric: str | None = option(None, METRIC, choices=SPHERES)
    cull: bool = option(True, "Omit what lies outside the view frustum.")

    def __post_init__(self) -> None:
        check(self)
        if self.metric == "localised" and self.error not in BOUNDS:
            raise UsageError(f"The metric 'localised' needs an error that is a bound, not {self.error!r}.")

    @property
    def metric_used(self) -> Metric:
        """The metric asked for, or the first that the error allows."""
        if self.metric is not None:
            return metric_of(self.metric)
        names = next(one.choices for one in described(type(self)) if one.name == "metric")
        return metric_of(next(name for name in names if name != "localised" or self.error in BOUNDS))

    @property
    def conservative(self) -> bool:
        """Whether a tolerance is promised for every full-resolution sample in view."""
        return self.metric_used.conservative and self.error in BOUNDS


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshOptions(RightTriangleOptions):
    """Options of the methods that also refine by colours."""

    color_tolerance: float | None = option(
        None, "Also refine where coarser triangles would change colours by more than this (CIELAB; 2.3 is just "
              "noticeable).",
        unit="ΔE", least=0.0,
    )  # fmt: skip


@dataclass(slots=True)
class Mesh:
    """The result of a refinement, before vertices are numbered.

    Attributes:
        keys: int64, ``row << 32 | col`` of the padded square: (k,) of a strip or (m, 3) of triangles.
        heights: float32, the same shape, metres.
        is_strip: whether keys are a generalised strip.
        clockwise: how triangles (of a strip: the one at place 0) turn as the raster is drawn, rows downwards.
        triangles: how many the method made.
        within: whether the tolerance asked for was reached, or some tolerance within the budget.
        tolerance: that was asked for, or reached; pixels.
        stats: what else the method says.
    """

    keys: NDArray[np.int64]
    heights: NDArray[np.float32]
    is_strip: bool
    clockwise: bool
    triangles: int
    within: bool = True
    tolerance: float | None = None
    stats: dict[str, Any] = field(default_factory=dict)

    def kept(self) -> Self:
        """A copy that stays valid when the method refines again."""
        return replace(self, keys=self.keys.copy(), heights=self.heights.copy())


class RightTriangles(Method):
    """A method on the hierarchy of right triangles. See ``Method`` for the arguments.

    Attributes:
        field: the terrain's pages.
        error, cull: as in the options. metric: in use. jobs: threads.

    Raises:
        UsageError: an option is not usable, or the terrain has no surface.
        StoreError: the store lacks the errors of diamonds.
    """

    options: Any

    def __init__(
        self, terrain: Terrain, options: Any = None, resources: Resources | None = None, **given: Any
    ) -> None:  # fmt: skip
        super().__init__(terrain, options, resources, **given)
        self.error: str = self.options.error
        self.cull: bool = self.options.cull
        self.metric: Metric = self.options.metric_used
        self.jobs = threads_for(self.resources.jobs)
        gamma = getattr(self.options, "color_tolerance", None)
        if gamma is not None and self.resources.color is None:
            raise UsageError("A color tolerance needs colours.", remedy="Give color errors with the resources.")
        self.color_tolerance: float = math.inf if gamma is None else gamma
        self._ahead: Ahead | None = None
        self._last = Pass()
        self.field = self._pages()

    def _pages(self) -> Field:
        return Field(
            self.terrain, self.error, color=self.resources.color, max_memory=self.resources.max_memory, jobs=self.jobs
        )

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        return (Need("diamonds", {"error": options.error}),)

    @property
    def spheres(self) -> int:
        """Number of the metric of diamonds' spheres: for ``localised`` the one that bounds its search, otherwise its
        own."""
        return ANISOTROPIC if self.metric.number == LOCALISED else self.metric.number

    def _pruned(self, lens: CameraParameters) -> NDArray[np.int64]:
        """The table of diamonds that ``localised`` does not split (``lod.look_ahead``); pages may be read for it."""
        if self.metric.number != LOCALISED:
            return NOTHING
        if self._ahead is None:
            self._ahead = Ahead()
        return self._ahead.table(self.field, lens, self.cull)

    def _lens(self, camera: Camera, tolerance: float) -> CameraParameters:
        return camera_parameters(camera, tolerance=tolerance, color_tolerance=self.color_tolerance)


class RightTriangleMeshes(RightTriangles):
    """A method that makes single triangles: a mesh of the samples."""

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> TriangleMesh:
        """The mesh for a camera.

        If a valid mesh needs more triangles than the budget (edges of missing ground are always kept, and some methods
        have no coarser mesh), it has more, and ``stats["within_budget"]`` is false.

        Raises:
            UsageError: more tiles than memory allows.
        """
        mesh, took = self.mesh(camera, goal)
        began = time.perf_counter()
        promised = self.conservative and mesh.within
        stats: dict[str, Any] = {
            "method": self.info.name, "error": self.error, "metric": self.metric.name,
            "tolerance": None if mesh.tolerance is None else float(mesh.tolerance), "conservative": promised,
            "exaggeration": camera.exaggeration, "refine_ms": round(took * 1e3, 3), "tiles_read": self.field.tiles_read,
            "tiles_resident": self.field.resident, **mesh.stats,
        }  # fmt: skip
        make = Tessellation.from_strip if mesh.is_strip else Tessellation.from_triangles
        made = make(self.terrain.grid, mesh.keys, mesh.heights, clockwise=mesh.clockwise, stats=stats)
        stats["triangles"] = len(made.triangles)
        stats["index_ms"] = round((time.perf_counter() - began) * 1e3, 3)
        return TriangleMesh(
            method=self.info.name, bound=stats["tolerance"] if promised else None, stats=stats, mesh=made
        )

    def mesh(self, camera: Camera, goal: Goal) -> tuple[Mesh, float]:
        """What ``select`` makes, before its vertices are numbered, and the seconds it took. For renderers and
        benchmarks.

        The arrays of the mesh may be the method's own: they are valid until it refines again.
        """
        began = time.perf_counter()
        mesh = self._refine(camera, goal)
        if mesh.tolerance is None:
            mesh.tolerance = goal.tolerance
        took = time.perf_counter() - began
        if goal.triangles is not None:
            kept = mesh.triangles <= goal.triangles
            mesh.within = mesh.within and kept
            mesh.stats["within_budget"] = kept
        return mesh, took

    @abstractmethod
    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        """Refine until the goal is reached."""
