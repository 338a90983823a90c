"""The interface of methods: a ``Method`` selects, for a camera and a goal, what to draw of a terrain.

A method knows its paper, its options, what it needs from a store, and whether its bound is conservative. Everything
after it (surfaces, light, the referee, files) sees only its ``Selection`` and never asks which method made it. A new
method of a known kind is one file and one line in ``lod.registry``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.lod.options import make
from orograph.lod.selection import Kind, Selection
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain
from orograph.viewpoint import Camera

GoalName = Literal["tolerance", "triangles", "seconds"]

GOALS: tuple[GoalName, ...] = ("tolerance", "triangles", "seconds")


@dataclass(frozen=True, slots=True)
class Goal:
    """The goal of a selection: exactly one of the three.

    Attributes:
        tolerance: pixels. triangles: the maximum number. seconds: the best that this time allows.

    Raises:
        UsageError: none or several are given, or one makes no sense.
    """

    tolerance: float | None = None
    triangles: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        given = [name for name in GOALS if getattr(self, name) is not None]
        if len(given) != 1:
            raise UsageError(f"Give one goal: {' or '.join(given or GOALS)}.")
        # (Values come from users, so types are checked.)
        tolerance: Any = self.tolerance
        triangles: Any = self.triangles
        seconds: Any = self.seconds
        if tolerance is not None and not (isinstance(tolerance, Real) and 0 <= float(tolerance) < math.inf):
            raise UsageError(f"The tolerance must be 0 or more pixels, not {tolerance!r}.")
        if triangles is not None and not (isinstance(triangles, Integral) and int(triangles) >= 2):
            raise UsageError(f"A budget must be a whole number of triangles, at least 2, not {triangles!r}.")
        if seconds is not None and not (isinstance(seconds, Real) and float(seconds) > 0):
            raise UsageError(f"The allowed time must be more than 0 seconds, not {seconds!r}.")

    @property
    def name(self) -> GoalName:
        """Which of the three it is."""
        return next(name for name in GOALS if getattr(self, name) is not None)


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """Which tiles are in memory, for methods whose surfaces draw from tiles.

    Attributes:
        tiles: (t,) uint8 over all tiles of all levels, level 0 first, each row by row: not 0 where one is there; None:
            all are.
        slots: (t,) uint32, 1 + where in an atlas each lies; None: in none.
        wait: read missing errors before selecting; otherwise threads read them, and a later selection is better.
    """

    tiles: NDArray[np.uint8] | None = None
    slots: NDArray[np.uint32] | None = None
    wait: bool = True


EVERYTHING = Ready()
"""All tiles are present, or are read on demand."""


@dataclass(frozen=True, slots=True)
class Need:
    """Derived data that a method needs from a store.

    Attributes:
        name: of the derived data: "diamonds" (of an ``error``), "patches" (of an ``error``, with ``legs``), "tins"
            (with ``legs``), or "chunked" (as ``store.chunked.Kind`` has it).
        options: the options that it must have been made with.
    """

    name: str
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Resources:
    """Resources of a method.

    Attributes:
        max_memory: bytes of tiles in memory. jobs: threads; None: all processors.
        progress: gets reports on long work. color: colour errors, for methods that refine by colour (``lod.field``), or
            colours (``Method.samples_colored``).

    Raises:
        UsageError: the number of threads makes no sense.
    """

    max_memory: int = 1 << 30
    jobs: int | None = None
    progress: Progress = SILENT
    color: Any = None

    def __post_init__(self) -> None:
        jobs: Any = self.jobs
        if jobs is not None and not (isinstance(jobs, Integral) and int(jobs) >= 1):
            raise UsageError(f"The number of threads must be a whole number, 1 or more, not {jobs!r}.")


@dataclass(frozen=True, slots=True)
class MethodInfo:
    """A method's description.

    Attributes:
        name: as on the command line. title: a one-line description.
        paper: the source, with its section. kind: of its selections. options: the dataclass of its options.
        conservative: whether its bound is promised with these options.
        incremental: whether a frame continues from the previous one. goals: those that it supports.
        conforming: whether its meshes have no T-junctions and no cracks.
        promising: the options, by key, with which it promises its tolerance, if it does not with the defaults.
        invents: whether with these options it draws detail beyond the data, whose errors nobody knows.
    """

    name: str
    title: str
    paper: str
    kind: Kind
    options: type
    conservative: Callable[[Any], bool]
    incremental: bool = False
    goals: tuple[GoalName, ...] = GOALS
    conforming: bool = True
    promising: Mapping[str, str] = field(default_factory=dict)
    invents: Callable[[Any], bool] = lambda options: False

    def check_goal(self, goal: GoalName) -> None:
        """Raise UsageError if the method does not support such a goal."""
        if goal not in self.goals:
            raise UsageError(
                f"{self.name} does not support the goal {goal}.", remedy=f"Give {' or '.join(self.goals)}."
            )


def check_surface(terrain: Terrain) -> None:
    """Raise UsageError if a raster is too small for a surface."""
    rows, cols = terrain.grid.shape
    if min(rows, cols) < 2:
        raise UsageError(
            f"{terrain.name} has {rows} × {cols} samples (rows × columns); a surface needs at least two of each."
        )


class Method(ABC):
    """A way of selecting what to draw. One terrain, many cameras: ``select`` is called by one thread at a time.

    Args:
        terrain: the terrain.
        options: of ``info.options``; None: the defaults. ``given``: some of them by name.
        resources: memory, threads, progress.

    Raises:
        UsageError: an option makes no sense, or the terrain has no surface.
    """

    info: ClassVar[MethodInfo]
    samples_colored: ClassVar[bool] = False
    """Whether it needs colours of samples (``geovis.color_errors.Colors``) where others want errors of diamonds."""

    def __init__(
        self, terrain: Terrain, options: Any = None, resources: Resources | None = None, **given: Any
    ) -> None:  # fmt: skip
        check_surface(terrain)
        self.terrain = terrain
        self.options = make(self.info.options, given, self.info.name) if options is None else replace(options, **given)
        self.resources = Resources() if resources is None else resources

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        """What it needs from a store besides heights."""
        return ()

    @classmethod
    def obstacle(cls, options: Any, terrain: Terrain) -> str:
        """What about a terrain keeps the method from the promise that its options make; "": nothing."""
        return ""

    @property
    def conservative(self) -> bool:
        """Whether the tolerance is promised for every point of the full-resolution surface in view."""
        return self.info.conservative(self.options) and not self.obstacle(self.options, self.terrain)

    @abstractmethod
    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> Selection:
        """Select what the camera sees.

        Raises:
            UsageError: the method does not support the goal, or one view needs more tiles than memory allows.
            StoreError, DamagedChunkError: as ``terrain.read``.
        """

    def close(self) -> None:  # noqa: B027 (most methods have nothing to close)
        """Release threads and tables; the method cannot be used afterwards."""
