"""Engines measured alike: time, triangles, change from frame to frame, tiles read, and the error the referee finds.

Of an engine nothing is known here but that it refines (``Refiner``). *Views* are taken one by one, twice: first for the
referee, which also compiles kernels and reads tiles; then for the clock, three times each, of which the fastest counts.
Before each of these the engine is taken far away and looks the other way, so that one that keeps its mesh between views
has to come back from little. A *flight*
is taken frame by frame, and the clock runs for each: what an engine saves from frame to frame, it saves here. Tiles are
counted from the engine's making.

Units: milliseconds; pixels; fractions of a mesh.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.progress import Task
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.verify.judge import judge_mesh
from orograph.verify.report import ROUNDING, Report
from orograph.view import View

ROUNDS = 3
"""How often the clock is run for a view."""


class Refiner(Protocol):
    """What can be measured."""

    def refine(self, view: View, *, tolerance: float | None = None, triangles: int | None = None) -> Tessellation:
        """The mesh for a view; ``stats`` hold refine_ms, tiles_read and conservative."""
        ...


@dataclass(frozen=True, slots=True)
class Measurement:
    """What an engine does on some views or a flight.

    Attributes:
        frames: views or frames refined.
        triangles: of a mesh, the mean.
        ms: to refine, the median; ``ms_worst``: the largest.
        mtri_per_s: millions of triangles per second, over all.
        conservative: whether the engine promises the tolerance for every sample in view, in every frame.
        tolerance: pixels, the largest that was asked for, or reached under a budget.
        largest, rms: pixels, by the referee, over all samples in view of the frames judged; None: beyond any bound.
        largest_on_surface: the same over all points of the full-resolution surface.
        judged: how many frames were.
        changes: triangles that a frame and the one before do not share, over the frame's own, both summed over frames.
            None without a flight.
        tiles_read: in all.
        defects: what the referee found wrong with the meshes, summed.
        beyond: triangles of the largest mesh that has more than its budget; None if there is none.
    """

    frames: int
    triangles: float
    ms: float
    ms_worst: float
    mtri_per_s: float
    conservative: bool
    tolerance: float | None
    largest: float | None
    largest_on_surface: float | None
    rms: float | None
    judged: int
    changes: float | None
    tiles_read: int
    defects: dict[str, int]
    beyond: int | None = None

    @property
    def kept(self) -> bool | None:
        """Whether what was promised holds; None if nothing was promised."""
        if not self.conservative or self.tolerance is None:
            return None
        return self.largest is not None and self.largest <= self.tolerance * (1 + ROUNDING) and not self.defects


def measure_views(
    engine: Refiner, terrain: Terrain, views: Sequence[View], goal: dict[str, Any], *, exaggeration: float = 1.0,
    jobs: int | None = None, task: Task | None = None,
) -> Measurement:  # fmt: skip
    """Measure an engine on separate views (see the module's text).

    Args:
        goal: keyword arguments of ``refine``: tolerance or triangles.
        task: is advanced by one for each view.
    """
    tally = _Tally()
    for view in views:
        tally.judged(judge_mesh(engine.refine(view, **goal), terrain, view, exaggeration=exaggeration, jobs=jobs))
    for view in views:
        meshes = []
        for _ in range(ROUNDS):
            engine.refine(elsewhere(view), **goal)
            meshes.append(engine.refine(view, **goal))
        tally.timed(min(meshes, key=lambda mesh: float(mesh.stats["refine_ms"])))
        tally.tiles = int(meshes[-1].stats["tiles_read"])
        if task is not None:
            task.advance()
    return tally.result(None)


def measure_flight(
    engine: Refiner, terrain: Terrain, frames: Sequence[View], goal: dict[str, Any], *, judged: int | None = None,
    exaggeration: float = 1.0, jobs: int | None = None, task: Task | None = None,
) -> Measurement:  # fmt: skip
    """Measure an engine on the frames of a flight (see the module's text).

    Args:
        goal: keyword arguments of ``refine``: tolerance or triangles.
        judged: how many frames the referee sees, evenly spread (default: all).
        task: is advanced by one for each frame.
    """
    count = len(frames) if judged is None else min(judged, len(frames))
    seen = set(np.linspace(0, len(frames) - 1, count).round().astype(int).tolist())
    tally = _Tally()
    for view in [*frames[:2], frames[0]]:  # whatever the first moves compile
        engine.refine(view, **goal)
    before: NDArray[np.uint64] | None = None
    changed = own = 0
    for k, view in enumerate(frames):
        mesh = engine.refine(view, **goal)
        tally.timed(mesh)
        now = fingerprints(mesh)
        if before is not None:
            shared = len(np.intersect1d(before, now, assume_unique=True))
            changed += len(before) + len(now) - 2 * shared
            own += len(now)
        before = now
        if k in seen:
            tally.judged(judge_mesh(mesh, terrain, view, exaggeration=exaggeration, jobs=jobs))
        if task is not None:
            task.advance()
    return tally.result(changed / max(1, own) if len(frames) > 1 else None)


class _Tally:
    """What is summed up over frames."""

    def __init__(self) -> None:
        self.triangles: list[int] = []
        self.ms: list[float] = []
        self.stats: list[dict[str, Any]] = []
        self.reports: list[Report] = []
        self.tiles = 0

    def timed(self, mesh: Tessellation) -> None:
        self.triangles.append(len(mesh.triangles))
        self.ms.append(float(mesh.stats["refine_ms"]))
        self.stats.append(mesh.stats)
        self.tiles = int(mesh.stats["tiles_read"])

    def judged(self, report: Report) -> None:
        self.reports.append(report)

    def result(self, changes: float | None) -> Measurement:
        covered = [r.samples - r.uncovered for r in self.reports]
        squares = sum(r.rms**2 * n for r, n in zip(self.reports, covered))
        rms = math.sqrt(squares / max(1, sum(covered)))
        largest = max((r.largest_at_samples for r in self.reports), default=0.0)
        on_surface = max((r.largest for r in self.reports), default=0.0)
        defects: dict[str, int] = {}
        for report in self.reports:
            for name, n in report.defects.items():
                defects[name] = defects.get(name, 0) + n
        tolerances = [s["tolerance"] for s in self.stats]
        return Measurement(
            frames=len(self.ms),
            triangles=float(np.mean(self.triangles)),
            ms=float(np.median(self.ms)),
            ms_worst=max(self.ms),
            mtri_per_s=sum(self.triangles) / max(sum(self.ms), 1e-9) / 1e3,
            conservative=all(s["conservative"] for s in self.stats),
            tolerance=None if None in tolerances else max(tolerances),
            largest=largest if math.isfinite(largest) else None,
            largest_on_surface=on_surface if math.isfinite(on_surface) else None,
            rms=rms if math.isfinite(rms) else None,
            judged=len(self.reports),
            changes=changes,
            tiles_read=self.tiles,
            defects=defects,
            beyond=max(
                (n for n, s in zip(self.triangles, self.stats) if s.get("within_budget") is False), default=None
            ),
        )


def elsewhere(view: View) -> View:
    """An eye five times as far from the target, looking the opposite way."""
    eye, target = np.array(view.eye), np.array(view.target)
    back = eye - target
    return replace(view, eye=tuple(target + 5 * back), target=tuple(target + 6 * back), projection="perspective")


def fingerprints(mesh: Tessellation) -> NDArray[np.uint64]:
    """A number (m,) for each triangle, sorted: the same for the same three samples, whatever the mesh.

    64 bits of a sum of mixed corners: of a million triangles two are confused with a chance of 10^-7.
    """
    key = mesh.vertices[:, 0].astype(np.uint64) << np.uint64(32) | mesh.vertices[:, 1].astype(np.uint64)
    return np.sort(_mixed(_mixed(key)[mesh.triangles].sum(axis=1, dtype=np.uint64)))


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """SplitMix64's finaliser (Steele, Lea & Flood 2014): every bit depends on every other."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))
