"""Rasters whose samples lie on one lattice, read as one raster by exact integer copies.

Tiles of one product differ only in where their first sample lies, by a whole number of samples, whether they share an
edge row, overlap or merely touch. Joined sample by sample *before* anything is interpolated, they leave no seam.
Rasters belong together if their CRS is equal, their spacing within ``SPACING_TOLERANCE`` (relative) and their offset
within ``OFFSET_TOLERANCE`` of a whole number of samples. Where several have a valid sample the first in the list wins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.geo.grid import Grid, apply, compose

SPACING_TOLERANCE = 1e-6
OFFSET_TOLERANCE = 1e-3
FLOAT = ("float32", math.nan)

Heights = NDArray[np.float32]


class Raster(Protocol):
    """What a mosaic needs from a source (``orograph.dem.source.Source`` is one)."""

    @property
    def grid(self) -> Grid: ...
    @property
    def name(self) -> str: ...
    @property
    def vertical(self) -> str | None: ...

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights: ...


class SourceLattice(Protocol):
    """Samples on one lattice, from which a terrain is made.

    Attributes:
        grid: where they lie.
        code: (dtype, nodata) of the smallest numbers that hold all of them exactly; ("float32", nan) if none do.
    """

    @property
    def grid(self) -> Grid: ...
    @property
    def code(self) -> tuple[str, float]: ...

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """A window, which may reach beyond the grid: its shape, float32 metres, NaN where there is none."""


@dataclass(slots=True)
class Lattice:
    """Rasters of one lattice.

    Attributes:
        grid: the smallest grid that holds all members; index (0, 0) is its north-west sample.
        members: in order of precedence.
        corners: (n, 4) int64: row0, row1, col0, col1 of each member within ``grid``.
        circle: samples around the globe if the members cover all longitudes (columns then repeat), else 0.
    """

    grid: Grid
    members: list[Raster] = field(default_factory=list)
    corners: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 4), np.int64))
    circle: int = 0

    @property
    def code(self) -> tuple[str, float]:
        codes = {getattr(member, "code", FLOAT) for member in self.members}
        return codes.pop() if len(codes) == 1 else FLOAT

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Samples of a window, which may reach beyond the grid: its shape, float32, NaN where there is none."""
        out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
        shifts = (0,) if not self.circle else (0, -self.circle, self.circle)
        for shift in shifts:
            r0 = np.maximum(self.corners[:, 0], row0)
            r1 = np.minimum(self.corners[:, 1], row1)
            c0 = np.maximum(self.corners[:, 2] + shift, col0)
            c1 = np.minimum(self.corners[:, 3] + shift, col1)
            for i in np.flatnonzero((r0 < r1) & (c0 < c1)):
                top, left = int(self.corners[i, 0]), int(self.corners[i, 2]) + shift
                a, b, c, d = int(r0[i]), int(r1[i]), int(c0[i]), int(c1[i])
                place = out[a - row0 : b - row0, c - col0 : d - col0]
                missing = np.isnan(place)
                if missing.any():
                    found = self.members[i].read(a - top, b - top, c - left, d - left)
                    np.copyto(place, found, where=missing)
        return out


def _offset(of: Affine, onto: Affine) -> tuple[int, int] | None:
    """(row, col) of the first sample of one lattice within another, or None if they are different lattices."""
    size = max(abs(v) for v in (onto.a, onto.b, onto.d, onto.e))
    if any(
        abs(p - q) > SPACING_TOLERANCE * size
        for p, q in zip((of.a, of.b, of.d, of.e), (onto.a, onto.b, onto.d, onto.e))
    ):
        return None
    col, row = (float(v) for v in apply(~onto, of.c, of.f))
    if abs(col - round(col)) > OFFSET_TOLERANCE or abs(row - round(row)) > OFFSET_TOLERANCE:
        return None
    return round(row), round(col)


def offset_between(grid: Grid, onto: Grid) -> tuple[int, int] | None:
    """(row, col) of ``grid``'s first sample within ``onto``, or None if their samples do not coincide."""
    return _offset(grid.transform, onto.transform) if grid.crs == onto.crs else None


def group(rasters: Sequence[Raster], grids: Sequence[Grid]) -> list[Lattice]:
    """Sort rasters into lattices, in the order in which each lattice first appears.

    Args:
        rasters: in order of precedence.
        grids: where each lies: its own grid, or that grid in metres, or moved by whole turns of longitude.
    """
    found: list[tuple[Grid, list[int], list[tuple[int, int]]]] = []
    for i, grid in enumerate(grids):
        for first, indices, offsets in found:
            at = _offset(grid.transform, first.transform)
            if at is not None and (grid.crs is first.crs or grid.crs == first.crs):
                indices.append(i)
                offsets.append(at)
                break
        else:
            found.append((grid, [i], [(0, 0)]))
    return [_lattice(first, [rasters[i] for i in of], [grids[i] for i in of], offsets) for first, of, offsets in found]


def _lattice(first: Grid, members: list[Raster], grids: list[Grid], offsets: list[tuple[int, int]]) -> Lattice:
    corners = np.array([(r, r + g.rows, c, c + g.cols) for (r, c), g in zip(offsets, grids)], np.int64)
    top, left = int(corners[:, 0].min()), int(corners[:, 2].min())
    corners -= np.array([top, top, left, left])
    shape = (int(corners[:, 1].max()), int(corners[:, 3].max()))
    whole = Grid(shape, compose(first.transform, Affine.translation(left, top)), first.crs)
    return Lattice(whole, members, corners, around(whole))


def around(grid: Grid) -> int:
    """Samples in a full turn of longitude if a grid covers one (its columns then repeat), else 0."""
    if grid.crs is None or not grid.crs.is_geographic or grid.transform.b or grid.transform.d:
        return 0
    turn = full_turn(grid) / abs(grid.transform.a)
    whole = round(turn)
    return whole if abs(turn - whole) < 0.01 and grid.cols >= whole else 0


def full_turn(grid: Grid) -> float:
    """A full circle of longitude in the units of a geographic grid's CRS (360 for degrees)."""
    assert grid.crs is not None
    return 2 * math.pi / float(grid.crs.axis_info[0].unit_conversion_factor)
