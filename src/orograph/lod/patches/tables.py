"""A terrain whose diamonds are patch diamonds (``store.patches``), and how long the edges of their triangles can be."""

from __future__ import annotations

import math
from typing import Any

from orograph.error import ErrorKind
from orograph.progress import SILENT, Progress
from orograph.store.patches import patch_errors
from orograph.store.terrain import Heights, Terrain


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
        self._terrain, self._kind, self._legs = terrain, kind, legs
        self._errors: list[Heights] | None = None
        if not terrain.has_patch_errors(kind, legs):
            self._errors = patch_errors(terrain, kind, legs, jobs=jobs, progress=progress)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._terrain, name)

    def diamonds(
        self, kind: ErrorKind, level: int, row0: int, row1: int, col0: int, col1: int
    ) -> tuple[Heights, Heights]:
        """P′ (negative where mixed) and radii; see ``Terrain.diamonds``."""
        _, radii = self._terrain.diamonds(self._kind, level, row0, row1, col0, col1)
        if self._errors is None:
            return self._terrain.patch_errors(self._kind, level, row0, row1, col0, col1), radii
        return self._errors[level][row0:row1, col0:col1], radii


def cell_size(terrain: Terrain) -> float:
    """c, metres: no edge of the hierarchy's triangles of level λ is longer than c · √2^(2n − λ + 1)."""
    a, b, _, d, e, _ = terrain.grid.samples[:6]
    sides = math.hypot(a, d), math.hypot(b, e)
    diagonals = math.hypot(a + b, d + e), math.hypot(a - b, d - e)
    return max(*sides, max(diagonals) / math.sqrt(2))
