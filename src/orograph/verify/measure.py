"""All methods measured in the same way: time, triangles, change between frames, tiles read, and the referee's error.

Here, a method is only something that selects (``Selector``). *Views* are taken one by one, twice: first for the
referee, which also compiles kernels and reads tiles; then for the clock, three times each, of which the fastest counts.
Before each of these, the method is moved far away and looks the other way, so that one that keeps its mesh between
views starts with very little. A *flight* is taken frame by frame, and every frame is timed, which shows the gain from
keeping data between frames. Tiles are counted from the method's creation.

A mesh is judged by its triangles (``judge_mesh``). A selection without triangles, for rays, is drawn (by the CPU, if it
can) and judged by the depth of its picture (``judge_depth``); if it also has patches, both are judged.

Units: milliseconds; pixels; fractions of a mesh.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError
from orograph.lod.method import Goal
from orograph.lod.selection import PatchesAndRays, RaySurface, RayWindows, Selection
from orograph.progress import Task
from orograph.rendering.backends import backend_of
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.verify.depth import DepthReport, judge_depth
from orograph.verify.judge import judge_mesh
from orograph.verify.report import ROUNDING, Report
from orograph.viewpoint import Camera, View

ROUNDS = 3
"""How often a view is timed."""


class Selector(Protocol):
    """What can be measured: a ``lod.method.Method``."""

    def select(self, camera: Camera, goal: Goal) -> Selection:
        """Select for a camera.

        ``stats`` may have ``refine_ms``, if only a part of the time counts, ``tiles_read`` and ``within_budget``.
        """
        ...


@dataclass(frozen=True, slots=True)
class Measurement:
    """How a method performs on views or a flight.

    Attributes:
        frames: views or frames selected for.
        triangles: of a mesh, the mean; None if there are none.
        ms: to select, the median; ``ms_worst``: the largest.
        mtri_per_s: millions of triangles per second, over all; None if there are none.
        conservative: whether the method promises the tolerance for everything in view, in every frame.
        tolerance: pixels, the largest that was requested, or reached under a budget.
        largest: of meshes, pixels, by the referee, over the full-resolution surface in view of the frames judged; None:
            beyond any bound, or none was judged.
        largest_at_samples, rms: the same over samples.
        largest_in_picture: of rays, pixels between the points that the pictures' pixels show and the full-resolution
            surface on their verticals; None: as ``largest``.
        mismatches: of rays, pixels that show ground where there is none, or none where there is some.
        farthest: of rays, the largest distance in pixels from such a pixel to one that agrees; None: as ``largest``.
        judged: the number of judged frames.
        changes: triangles that a frame and the one before do not share, over the frame's own, both summed over frames.
            None without a flight.
        tiles_read: in all.
        defects: of the meshes, found by the referee, summed.
        beyond: triangles of the largest mesh that exceeds its budget; None if there is none.
    """

    frames: int
    triangles: float | None
    ms: float
    ms_worst: float
    mtri_per_s: float | None
    conservative: bool
    tolerance: float | None
    largest: float | None
    largest_at_samples: float | None
    rms: float | None
    largest_in_picture: float | None
    mismatches: int | None
    farthest: float | None
    judged: int
    changes: float | None
    tiles_read: int
    defects: dict[str, int]
    beyond: int | None = None

    @property
    def kept(self) -> bool | None:
        """Whether the promise holds; None if there is none, or nothing was judged."""
        if not self.conservative or self.tolerance is None or not self.judged:
            return None
        bound = self.tolerance * (1 + ROUNDING)
        if self.mismatches is not None:  # (an outline moved by the tolerance changes whole pixels: ``DepthReport.ok``)
            near = self.farthest is not None and self.farthest <= bound + math.sqrt(2)
            return near and self.largest_in_picture is not None and self.largest_in_picture <= bound
        return self.largest is not None and self.largest <= bound and not self.defects


def measure_views(
    method: Selector, terrain: Terrain, views: Sequence[View], goal: Goal, *, exaggeration: float = 1.0,
    jobs: int | None = None, task: Task | None = None,
) -> Measurement:  # fmt: skip
    """Measure a method on separate views (see the module's text).

    Args:
        goal: tolerance or triangles.
        task: is advanced by one for each view.
    """
    tally = _Tally(terrain, exaggeration, jobs)
    for view in views:
        tally.judge(_selected(method, terrain, view, goal, exaggeration)[0], view)
    for view in views:
        found = []
        for _ in range(ROUNDS):
            _selected(method, terrain, elsewhere(view), goal, exaggeration)
            found.append(_selected(method, terrain, view, goal, exaggeration))
        tally.timed(*min(found, key=lambda one: one[1]))
        tally.tiles = int(found[-1][0].stats.get("tiles_read", 0))
        if task is not None:
            task.advance()
    return tally.result(None)


def measure_flight(
    method: Selector, terrain: Terrain, frames: Sequence[View], goal: Goal, *, judged: int | None = None,
    exaggeration: float = 1.0, jobs: int | None = None, task: Task | None = None,
) -> Measurement:  # fmt: skip
    """Measure a method on the frames of a flight (see the module's text).

    Args:
        goal: tolerance or triangles.
        judged: how many frames the referee sees, evenly spread (default: all).
        task: is advanced by one for each frame.
    """
    count = len(frames) if judged is None else min(judged, len(frames))
    seen = set(np.linspace(0, len(frames) - 1, count).round().astype(int).tolist())
    tally = _Tally(terrain, exaggeration, jobs)
    for view in [*frames[:2], frames[0]]:  # compile what the first moves need
        _selected(method, terrain, view, goal, exaggeration)
    before: NDArray[np.uint64] | None = None
    changed = own = 0
    for k, view in enumerate(frames):
        selection, ms = _selected(method, terrain, view, goal, exaggeration)
        mesh = tally.timed(selection, ms)
        if mesh is not None:
            now = fingerprints(mesh)
            if before is not None:
                shared = len(np.intersect1d(before, now, assume_unique=True))
                changed += len(before) + len(now) - 2 * shared
                own += len(now)
            before = now
        if k in seen:
            tally.judge(selection, view)
        if task is not None:
            task.advance()
    return tally.result(changed / max(1, own) if len(frames) > 1 and before is not None else None)


def _selected(
    method: Selector, terrain: Terrain, view: View, goal: Goal, exaggeration: float
) -> tuple[Selection, float]:  # fmt: skip
    """A selection, and the milliseconds it took."""
    began = time.perf_counter()
    selection = method.select(Camera.over(terrain.grid, view, exaggeration), goal)
    took = (time.perf_counter() - began) * 1e3
    return selection, float(selection.stats.get("refine_ms", took))


class _Tally:
    """Sums over frames."""

    def __init__(self, terrain: Terrain, exaggeration: float, jobs: int | None) -> None:
        self.terrain, self.exaggeration, self.jobs = terrain, exaggeration, jobs
        self.triangles: list[int] = []
        self.ms: list[float] = []
        self.bounds: list[float | None] = []
        self.within: list[bool] = []
        self.reached: list[float | None] = []
        self.reports: list[Report] = []
        self.depths: list[DepthReport] = []
        self.tiles = 0

    def timed(self, selection: Selection, ms: float) -> Tessellation | None:
        """Record a selection; returns its triangles, if it has any."""
        mesh = None if isinstance(selection, RayWindows) else selection.tessellation()
        if mesh is not None:
            self.triangles.append(len(mesh.triangles))
            self.within.append(selection.stats.get("within_budget") is not False)
        self.ms.append(ms)
        self.bounds.append(selection.bound)
        self.reached.append(selection.stats.get("tolerance", selection.bound))
        self.tiles = int(selection.stats.get("tiles_read", 0))
        return mesh

    def judge(self, selection: Selection, view: View) -> None:
        """Let the referee judge a selection: its triangles, or the depth of its picture."""
        about: dict[str, Any] = {"exaggeration": self.exaggeration, "jobs": self.jobs}
        if isinstance(selection, RayWindows):
            depth = ray_depth(self.terrain, view, selection.bound or 0.0, selection.surface, **about)
            self.depths.append(judge_depth(depth, self.terrain, view, **about))
            if isinstance(selection, PatchesAndRays):
                mesh = selection.select_patches().tessellation()
                self.reports.append(judge_mesh(mesh, self.terrain, view, **about))
        else:
            self.reports.append(judge_mesh(selection.tessellation(), self.terrain, view, **about))

    def result(self, changes: float | None) -> Measurement:
        covered = [r.samples - r.uncovered for r in self.reports]
        squares = sum(r.rms**2 * n for r, n in zip(self.reports, covered))
        rms = math.sqrt(squares / max(1, sum(covered)))
        defects: dict[str, int] = {}
        for report in self.reports:
            for name, n in report.defects.items():
                defects[name] = defects.get(name, 0) + n
        tolerances = [t for t in self.reached if t is not None]
        return Measurement(
            frames=len(self.ms),
            triangles=float(np.mean(self.triangles)) if self.triangles else None,
            ms=float(np.median(self.ms)),
            ms_worst=max(self.ms),
            mtri_per_s=sum(self.triangles) / max(sum(self.ms), 1e-9) / 1e3 if self.triangles else None,
            conservative=None not in self.bounds,
            tolerance=None if len(tolerances) < len(self.reached) else max(tolerances),
            largest=_most([r.largest for r in self.reports]),
            largest_at_samples=_most([r.largest_at_samples for r in self.reports]),
            rms=rms if math.isfinite(rms) and self.reports else None,
            largest_in_picture=_most([r.largest for r in self.depths]),
            mismatches=sum(r.mismatches for r in self.depths) if self.depths else None,
            farthest=_most([r.farthest for r in self.depths]),
            judged=max(len(self.reports), len(self.depths)),
            changes=changes,
            tiles_read=self.tiles,
            defects=defects,
            beyond=max((n for n, within in zip(self.triangles, self.within) if not within), default=None),
        )


def _most(values: Sequence[float]) -> float | None:
    """The largest; None if that is infinite, or there is none."""
    most = max(values, default=math.inf)
    return most if math.isfinite(most) else None


def ray_depth(
    terrain: Terrain, view: View, tolerance: float, surface: RaySurface = "exact", *, exaggeration: float = 1.0,
    jobs: int | None = None,
) -> NDArray[np.float32]:  # fmt: skip
    """The depth (height, width) of the picture of a terrain by rays, metres; NaN where they meet nothing.

    The CPU draws it, or the GPU if the surface is not the exact one.
    """
    exact = surface == "exact"
    scene = Scene.of(
        terrain, view, tolerance=tolerance, exaggeration=exaggeration, jobs=jobs, samples=1, light="none", water=None,
        method="auto" if exact else f"raycast,surface={surface}",
    )  # fmt: skip
    try:
        return backend_of("cpu" if exact else "gpu")(scene).depth
    except NothingInViewError:
        return np.full((view.height, view.width), np.nan, np.float32)


def elsewhere(view: View) -> View:
    """An eye five times as far from the target, looking the opposite way."""
    eye, target = np.array(view.eye), np.array(view.target)
    back = eye - target
    return replace(view, eye=tuple(target + 5 * back), target=tuple(target + 6 * back), projection="perspective")


def fingerprints(mesh: Tessellation) -> NDArray[np.uint64]:
    """A number (m,) for each triangle, sorted: the same for the same three samples, whatever the mesh.

    64 bits of a sum of mixed corners: among a million triangles, two collide with a probability of 10^-7.
    """
    key = mesh.vertices[:, 0].astype(np.uint64) << np.uint64(32) | mesh.vertices[:, 1].astype(np.uint64)
    return np.sort(_mixed(_mixed(key)[mesh.triangles].sum(axis=1, dtype=np.uint64)))


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """SplitMix64's finaliser (Steele, Lea & Flood 2014): every bit depends on every other."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))
