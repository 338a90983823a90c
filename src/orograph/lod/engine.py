"""What every engine has in common: its arguments, what it promises, and the way from refinement to ``Tessellation``."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import ANISOTROPIC, LOCALISED, CameraParameters, Metric, camera_parameters, metric_of
from orograph.errors import UsageError
from orograph.lod.criterion import NOTHING
from orograph.lod.field import ColorErrors, Field
from orograph.lod.look_ahead import Ahead
from orograph.parallel import cpu_count
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

BOUNDS = ("exact", "wedgie")
"""Object-space errors that bound every sample's."""


@dataclass(slots=True)
class Mesh:
    """What a refinement leaves, before vertices are numbered.

    Attributes:
        keys: int64, ``row << 32 | col`` of the padded square: (k,) of a strip or (m, 3) of triangles.
        heights: float32, the same shape, metres.
        is_strip: whether keys are a generalised strip.
        clockwise: how triangles (of a strip: the one at place 0) turn as the raster is drawn, rows downwards.
        triangles: how many the engine made.
        within: whether the tolerance asked for was reached, or some tolerance within the budget.
        stats: what else the engine says.
    """

    keys: NDArray[np.int64]
    heights: NDArray[np.float32]
    is_strip: bool
    clockwise: bool
    triangles: int
    within: bool = True
    tolerance: float | None = None
    stats: dict[str, Any] = field(default_factory=dict)


def _is_number(value: object) -> bool:
    return isinstance(value, Real)


def _is_whole(value: object) -> bool:
    return isinstance(value, Integral)


class Engine(ABC):
    """A method of view-dependent refinement.

    Args:
        terrain: what is drawn.
        error: object-space error: exact, wedgie, midpoint.
        metric: screen-space metric, one of ``metrics`` (default: the first that the error allows).
        cull: leave out what is outside the frustum.
        exaggeration: factor on heights on the way to the screen.
        color: color errors (see ``error.color``), with color_tolerance γ in ΔE: a diamond is also split where coarser
            triangles would change colours by more.
        max_memory: bytes of tiles in memory.
        jobs: threads (default: all processors).

    Attributes:
        field: the terrain's pages.

    Raises:
        UsageError: an option makes no sense, or the terrain has no surface.
        StoreError: the store was built without this error.
    """

    name: ClassVar[str]
    metrics: ClassVar[tuple[str, ...]]
    takes_colors: ClassVar[bool] = True

    def __init__(
        self,
        terrain: Terrain,
        *,
        error: str = "exact",
        metric: str | None = None,
        cull: bool = True,
        exaggeration: float = 1.0,
        color: ColorErrors | None = None,
        color_tolerance: float | None = None,
        max_memory: int = 1 << 30,
        jobs: int | None = None,
    ) -> None:
        if error not in ("exact", "wedgie", "midpoint"):
            raise UsageError(f"There is no error {error!r}; there are exact, wedgie and midpoint.")
        if not _is_number(exaggeration) or not 0 < exaggeration < math.inf:
            raise UsageError(f"The exaggeration is a factor greater than 0, not {exaggeration}.")
        if color_tolerance is not None and not (_is_number(color_tolerance) and color_tolerance >= 0):
            raise UsageError(f"The color tolerance is a difference of colours (ΔE), 0 or more, not {color_tolerance}.")
        if color_tolerance is not None and color is None:
            raise UsageError("A color tolerance needs colours.", remedy="Give an image with --drape.")
        if jobs is not None and (not _is_whole(jobs) or jobs < 1):
            raise UsageError(f"Jobs are threads, a whole number from 1, not {jobs!r}.")
        self.metric = self.usable_metric(metric, error)
        self.terrain, self.error, self.cull, self.exaggeration = terrain, error, cull, exaggeration
        self.color_tolerance = math.inf if color_tolerance is None else color_tolerance
        self.jobs = cpu_count() if jobs is None else int(jobs)
        self._ahead: Ahead | None = None
        self.field = Field(terrain, error, color=color, max_memory=max_memory, jobs=self.jobs)

    @classmethod
    def usable_metric(cls, name: str | None, error: str = "exact") -> Metric:
        """The metric of that name, or the engine's own for an object-space error.

        Raises:
            UsageError: there is none, or the engine cannot use it, or not with this error.
        """
        if name is None:
            name = next(m for m in cls.metrics if m != "localised" or error in BOUNDS)
        metric = metric_of(name)
        if metric.name not in cls.metrics:
            raise UsageError(f"{cls.name} cannot use the metric {metric.name!r}; it can use {', '.join(cls.metrics)}.")
        if metric.number == LOCALISED and error not in BOUNDS:
            raise UsageError(f"The metric 'localised' needs an error that is a bound, not {error!r}.")
        return metric

    @property
    def spheres(self) -> int:
        """Number of the metric of diamonds' spheres: the one within whose bounds ``localised`` looks, or its own."""
        return ANISOTROPIC if self.metric.number == LOCALISED else self.metric.number

    def _pruned(self, lens: CameraParameters) -> NDArray[np.int64]:
        """The table of diamonds that ``localised`` does not split (``lod.look_ahead``); pages may be read for it."""
        if self.metric.number != LOCALISED:
            return NOTHING
        if self._ahead is None:
            self._ahead = Ahead()
        return self._ahead.table(self.field, lens, self.cull)

    @property
    def conservative(self) -> bool:
        """Whether a tolerance is a promise for every full-resolution sample in view."""
        return self.metric.conservative and self.error in BOUNDS

    def refine(
        self, view: View, *, tolerance: float | None = None, triangles: int | None = None, seconds: float | None = None
    ) -> Tessellation:
        """The mesh for a view.

        Args:
            tolerance: pixels (default 1 if nothing else is given).
            triangles: instead: at most so many. Where a sound mesh takes more (edges of missing ground are always kept,
                and some engines know no coarser mesh), it has more, and ``stats["within_budget"]`` is false.
            seconds: instead: what can be done in so much time.

        Raises:
            UsageError: more than one of the three, or one that makes no sense; or more tiles than memory allows.
        """
        mesh, took = self.mesh(view, tolerance=tolerance, triangles=triangles, seconds=seconds)
        began = time.perf_counter()
        stats: dict[str, Any] = {
            "engine": self.name, "error": self.error, "metric": self.metric.name,
            "tolerance": None if mesh.tolerance is None else float(mesh.tolerance),
            "conservative": self.conservative and mesh.within, "exaggeration": self.exaggeration,
            "refine_ms": round(took * 1e3, 3), "tiles_read": self.field.tiles_read,
            "tiles_resident": self.field.resident, **mesh.stats,
        }  # fmt: skip
        make = Tessellation.from_strip if mesh.is_strip else Tessellation.from_triangles
        t = make(self.terrain.grid, mesh.keys, mesh.heights, clockwise=mesh.clockwise, stats=stats)
        t.stats["triangles"] = len(t.triangles)
        t.stats["index_ms"] = round((time.perf_counter() - began) * 1e3, 3)
        return t

    def mesh(
        self, view: View, *, tolerance: float | None = None, triangles: int | None = None, seconds: float | None = None
    ) -> tuple[Mesh, float]:
        """What ``refine`` makes, before its vertices are numbered, and the seconds it took. For renderers and benches.

        The arrays of the mesh may be the engine's own: they are good until it refines again.
        """
        goals = {"tolerance": tolerance, "triangles": triangles, "seconds": seconds}
        given = [name for name, value in goals.items() if value is not None]
        if not given:
            tolerance = 1.0
        if len(given) > 1:
            raise UsageError(f"Give one goal: {' or '.join(given)}.")
        if tolerance is not None and not (_is_number(tolerance) and 0 <= tolerance < math.inf):
            raise UsageError(f"The tolerance is in pixels, 0 or more, not {tolerance!r}.")
        if triangles is not None and not _is_whole(triangles):
            raise UsageError(f"A budget is a whole number of triangles, not {triangles!r}.")
        if triangles is not None and triangles < 2:
            raise UsageError(f"A mesh has at least 2 triangles, so {triangles} is no budget.")
        if seconds is not None and not (_is_number(seconds) and seconds > 0):
            raise UsageError(f"The time allowed is in seconds, more than 0, not {seconds!r}.")
        began = time.perf_counter()
        mesh = self._refine(view, tolerance, triangles, seconds)
        if mesh.tolerance is None:
            mesh.tolerance = tolerance
        took = time.perf_counter() - began
        if triangles is not None:
            kept = mesh.triangles <= triangles
            mesh.within = mesh.within and kept
            mesh.stats["within_budget"] = kept
        return mesh, took

    @abstractmethod
    def _refine(self, view: View, tolerance: float | None, triangles: int | None, seconds: float | None) -> Mesh:
        """Refine until one of the three goals (exactly one is given)."""

    def _lens(self, view: View, tolerance: float) -> CameraParameters:
        return camera_parameters(
            view, self.terrain.grid, exaggeration=self.exaggeration, tolerance=tolerance,
            color_tolerance=self.color_tolerance,
        )  # fmt: skip


def by_tolerance(engine: Engine, view: View, triangles: int | None, seconds: float | None) -> Mesh:
    """Reach a budget with an engine that knows only tolerances: search for the smallest tolerance that keeps it.

    The result has at most ``triangles`` triangles (or it is the mesh of the largest tolerance, not within) and, where
    the count allows it, 98 % of that; with ``seconds`` the tolerance is halved from coarse to fine while the next pass
    can be expected to fit.
    """
    began = time.perf_counter()
    low, high = 0.0, 1024.0  # tolerances that make too many triangles, and few enough
    best = engine._refine(view, high, None, None)
    best = replace(best, keys=best.keys.copy(), heights=best.heights.copy(), tolerance=high)
    if seconds is not None:
        tolerance, last = high, time.perf_counter() - began
        while time.perf_counter() - began + 2.2 * last < seconds and tolerance > 1 / 64:
            start = time.perf_counter()
            tolerance /= 2
            best = replace(engine._refine(view, tolerance, None, None), tolerance=tolerance)
            last = time.perf_counter() - start
        return best
    assert triangles is not None
    if best.triangles > triangles:
        best.within = False
        return best
    tolerance = 1.0
    for _ in range(24):
        mesh = engine._refine(view, tolerance, None, None)
        if mesh.triangles <= triangles:
            best, high = (
                replace(mesh, keys=mesh.keys.copy(), heights=mesh.heights.copy(), tolerance=tolerance),
                tolerance,
            )
            if mesh.triangles > 0.98 * triangles:
                break
        else:
            low = tolerance
        # The count falls about with the 1.5th power of the tolerance; a guess near the end of the range is no guess.
        guess = tolerance * (max(mesh.triangles, 1) / (0.99 * triangles)) ** (1 / 1.5)
        inner = math.log(high / low) / 8 if low > 0 else 0.0
        if low > 0 and not low * math.exp(inner) <= guess <= high / math.exp(inner):
            guess = math.sqrt(low * high)
        tolerance = min(guess, high / 1.01) if low == 0 else guess
        if tolerance < 1e-4 or (low > 0 and high / low < 1 + 1e-6):
            break
    return best
