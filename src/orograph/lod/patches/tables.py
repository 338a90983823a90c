"""A terrain whose diamonds are patch diamonds (``store.patches``), and how long the edges of their triangles can be."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from orograph.error import ErrorKind
from orograph.progress import SILENT, Progress
from orograph.store.diamond_table import DiamondTable
from orograph.store.patches import MemoryPatches, PatchTable, patch_errors
from orograph.store.terrain import Heights, Terrain


class PatchDiamonds(NamedTuple):
    """Patch diamonds as a table of diamonds: P′ (negative where mixed) and radii."""

    errors: PatchTable | MemoryPatches
    diamonds: DiamondTable

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        """See ``DiamondTable.read``."""
        window = level, row0, row1, col0, col1
        return self.errors.read(*window), self.diamonds.read(*window)[1]

    def values(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """See ``DiamondTable.values``."""
        return self.errors.read(level, row0, row1, col0, col1)


class PatchTerrain:
    """A terrain whose diamonds are patch diamonds: what ``lod.field`` makes pages of.

    Args:
        terrain: the ground.
        kind: which error decides.
        legs: segments along a leg.
        jobs, progress: see ``patch_errors``.
    """

    def __init__(
        self, terrain: Terrain, kind: ErrorKind, legs: int, *, jobs: int | None = None, progress: Progress = SILENT
    ) -> None:
        self._terrain = terrain
        if terrain.has("patches", error=kind, legs=legs):
            errors = terrain.derived("patches", error=kind, legs=legs)
        else:
            errors = MemoryPatches(terrain, patch_errors(terrain, kind, legs, jobs=jobs, progress=progress))
        self._diamonds = PatchDiamonds(errors, terrain.derived("diamonds", error=kind))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._terrain, name)

    def derived(self, name: str, **options: Any) -> PatchDiamonds:
        """The table of its diamonds."""
        return self._diamonds


def cell_size(terrain: Terrain) -> float:
    """c, metres: no edge of the hierarchy's triangles of level λ is longer than c · √2^(2n − λ + 1)."""
    (a, b), (d, e) = terrain.chart.linear.tolist()
    sides = math.hypot(a, d), math.hypot(b, e)
    diagonals = math.hypot(a + b, d + e), math.hypot(a - b, d - e)
    return max(*sides, max(diagonals) / math.sqrt(2))
