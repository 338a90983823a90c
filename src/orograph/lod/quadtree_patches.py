"""What methods share that draw instances of a few pieces as the squares of a quadtree: they know tolerances only, and a
selection is which piece lies where."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph.lod.budget import Pass, by_tolerance
from orograph.lod.method import EVERYTHING, Goal, Method, Ready
from orograph.lod.selection import PatchSet, Topology
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera


@dataclass(slots=True)
class Pieces:
    """The selection for a tolerance.

    Attributes:
        instances: (k,), where each piece lies. shapes: (k,) uint8, which of the topologies it is.
        patches: squares that they are parts of. triangles: of all pieces.
        within, tolerance: as of ``budget.Coarsened``.
    """

    instances: NDArray[Any]
    shapes: NDArray[np.uint8]
    patches: int
    triangles: int
    within: bool = True
    tolerance: float | None = None

    def kept(self) -> Self:
        """Itself: nothing of it is used again."""
        return self


class QuadtreePatches(Method):
    """A method whose selections are pieces. See ``Method`` for the arguments.

    Attributes:
        topologies: of the pieces.

    Raises:
        UsageError: the terrain has no surface.
    """

    topologies: Sequence[Topology]

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self._last = Pass()

    @abstractmethod
    def _pieces(self, camera: Camera, tolerance: float) -> Pieces:
        """The pieces that a camera sees within a tolerance in pixels."""

    @abstractmethod
    def _expand(self, selection: PatchSet, camera: Camera, tolerance: float) -> Tessellation:
        """The triangles of a selection."""

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> PatchSet:
        """The pieces of a view."""
        self.info.check_goal(goal.name)
        began = time.perf_counter()
        at = partial(self._pieces, camera)
        found = at(goal.tolerance) if goal.tolerance is not None else by_tolerance(at, goal, self._last)
        tolerance = goal.tolerance if goal.tolerance is not None else found.tolerance
        assert tolerance is not None
        promised = self.conservative and found.within
        stats: dict[str, Any] = {
            "method": self.info.name, "tolerance": tolerance, "conservative": promised,
            "exaggeration": camera.exaggeration, "refine_ms": round((time.perf_counter() - began) * 1e3, 3),
            "patches": found.patches, "pieces": len(found.instances), "triangles": found.triangles,
        }  # fmt: skip
        if goal.triangles is not None:
            stats["within_budget"] = found.within
        return PatchSet(
            method=self.info.name, bound=tolerance if promised else None, stats=stats, topologies=self.topologies,
            instances=found.instances, shapes=found.shapes,
            expand=partial(self._expand, camera=camera, tolerance=tolerance),
        )  # fmt: skip
