"""The part of a mosaic's grid that none of its files cover: a warning if it is most of it, an error if a build is huge.

The covered area is the sum of the members' areas, counting overlaps twice, so the result is a lower bound of the void.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from orograph.dem.lattice import Lattice
from orograph.dem.target import ground_spacing
from orograph.errors import UsageError
from orograph.geo.grid import Grid

VOID, MOSTLY = 0.75, 0.9
"""Parts of the whole that cause a warning, and an error."""
LARGE, HUGE = 1 << 24, 2 << 30
"""Minimum samples of the whole for each."""


def void_of(lattices: Sequence[Lattice], grid: Grid) -> float:
    """Lower bound of the part of a terrain's grid that lies in no source, 0 to 1."""
    covered = 0.0
    for lattice in lattices:
        rows, cols = lattice.corners[:, 1] - lattice.corners[:, 0], lattice.corners[:, 3] - lattice.corners[:, 2]
        covered += float((rows * cols).sum()) * ground_spacing(lattice.grid) ** 2
    return max(0.0, 1.0 - covered / (grid.rows * grid.cols * ground_spacing(grid) ** 2))


def void_warning(void: float, grid: Grid) -> str | None:
    """A warning if most of a large terrain is void; None otherwise."""
    if void < VOID or grid.rows * grid.cols < LARGE:
        return None
    return f"{_said(void, grid)} (name fewer files, or give a `bbox`)."


def check_void(void: float, grid: Grid, meant: bool) -> None:
    """Raise UsageError if nearly all of a huge terrain is void, unless that was requested."""
    if void >= MOSTLY and grid.rows * grid.cols >= HUGE and not meant:
        raise UsageError(
            f"{_said(void, grid)}; building it would take long.",
            remedy="Name only files that lie together. If this is intended, give the sample spacing: "
            f"`resolution={grid.spacing[0]:g}`, or more.",
        )


def _said(void: float, grid: Grid) -> str:
    return (
        f"The files lie far apart: {math.floor(1000 * void) / 10:.3g} % of the terrain of {grid.rows:,} × "
        f"{grid.cols:,} samples that holds them lies in none of them"
    )
