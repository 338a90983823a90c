"""What all methods on the hierarchy of right triangles share: options, promises, and reaching budgets by tolerances.

``RightTriangles`` holds the terrain's pages (``lod.field``). Those that make single triangles are
``RightTriangleMeshes``: they refine until a goal is reached and leave a ``Mesh``, arrays that renderers and benches can
take before their vertices are numbered (``mesh``); ``select`` makes a ``TriangleMesh`` of it.
"""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import ANISOTROPIC, LOCALISED, CameraParameters, Metric, camera_parameters, metric_of
from orograph.errors import UsageError
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

COARSEST, FINEST = 1024.0, 1 / 64
"""Pixels: the range of tolerances in which budgets are searched."""

GROWTH = 1.5
"""The number of triangles falls roughly with this power of the tolerance."""

PART = 0.9
"""The share of the available time that a pass is expected to take."""

LEFT = 0.25
"""The least share of the time that passes get, however long the selection after them takes."""

WORTH = 1.4
"""Another pass starts if the time left is at least this many times that of the last pass."""

LEAP = 16.0
"""The largest factor by which a pass may be finer than the one before."""

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


class Coarsened(Protocol):
    """What a tolerance leads to: ``Mesh``, or patches."""

    within: bool
    tolerance: float | None

    @property
    def triangles(self) -> int: ...

    def kept(self) -> Self:
        """A copy that stays valid when the method selects again."""
        ...


M = TypeVar("M", bound=Coarsened)


@dataclass(slots=True)
class Pass:
    """What a budget remembers of the previous frame.

    Attributes:
        tolerance, seconds: of the last pass; 0: none yet.
        passes: seconds that all passes of the frame took.
        after: seconds that the method took after its passes, to make a selection of what they found.
    """

    tolerance: float = 0.0
    seconds: float = 0.0
    passes: float = 0.0
    after: float = 0.0

    def reaching(self, seconds: float) -> float:
        """The tolerance at which a pass takes this many seconds, if time is proportional to the number of triangles."""
        return float(self.tolerance * (self.seconds / seconds) ** (1 / GROWTH))

    def selected(self, began: float) -> None:
        """Note that the selection that began at this ``time.perf_counter`` is complete."""
        self.after = max(time.perf_counter() - began - self.passes, 0.0)


def by_tolerance(refine: Callable[[float], M], goal: Goal, last: Pass) -> M:
    """Reach a budget with a method that takes only tolerances.

    Args:
        refine: what a tolerance in pixels leads to.
        last: of the budget before, which a budget of time begins with; it is kept up to date.
    """

    def at(tolerance: float) -> M:
        began = time.perf_counter()
        found = refine(tolerance)
        found.tolerance = tolerance
        last.tolerance, last.seconds = tolerance, time.perf_counter() - began
        return found

    start = time.perf_counter()
    if goal.seconds is not None:
        found = _in_time(at, max(goal.seconds - last.after, LEFT * goal.seconds), last)
    else:
        assert goal.triangles is not None
        found = _in_number(at, goal.triangles)
    last.passes = time.perf_counter() - start
    return found


def _in_time(at: Callable[[float], M], seconds: float, last: Pass) -> M:
    """The finest tolerance that time allows.

    Passes go from coarse to fine; each is as fine as the last one lets expect in the time that is left, but at most
    ``LEAP`` times: small meshes say little about large ones. Where there were passes before, as in the frames of a
    flight, the first one has the time of all.
    """
    first = COARSEST
    if last.seconds > 0:
        first = min(max(last.reaching(PART * seconds), FINEST), COARSEST)
    else:
        at(COARSEST)  # the first pass compiles and reads: its time says nothing about the next
    began = time.perf_counter()
    best = at(first)
    while True:
        left = seconds - (time.perf_counter() - began)
        if left < WORTH * last.seconds or last.tolerance <= FINEST:
            return best
        best = at(max(last.reaching(PART * left), last.tolerance / LEAP, FINEST))


def _in_number(at: Callable[[float], M], triangles: int) -> M:
    """The smallest tolerance that at most this many triangles keep (or the largest tolerance, and not within the
    budget); where possible with at least 98 % of the budget."""
    low, high = 0.0, COARSEST  # one tolerance makes too many triangles, the other few enough
    best = at(high).kept()
    if best.triangles > triangles:
        best.within = False
        return best
    tolerance = 1.0
    for _ in range(24):
        found = at(tolerance)
        if found.triangles <= triangles:
            best, high = found.kept(), tolerance
            if found.triangles > 0.98 * triangles:
                break
        else:
            low = tolerance
        # (See ``GROWTH``; a guess near the end of the range is useless.)
        guess = tolerance * (max(found.triangles, 1) / (0.99 * triangles)) ** (1 / GROWTH)
        inner = math.log(high / low) / 8 if low > 0 else 0.0
        if low > 0 and not low * math.exp(inner) <= guess <= high / math.exp(inner):
            guess = math.sqrt(low * high)
        tolerance = min(guess, high / 1.01) if low == 0 else guess
        if tolerance < 1e-4 or (low > 0 and high / low < 1 + 1e-6):
            break
    return best
