"""One lattice of sources as a layer of a mosaic: how it is resampled to the target grid, and what a window needs.

A lattice with the target's samples is copied at a whole offset. Any other is resampled at exact coordinates, after
averaging blocks of its samples if the target is coarser. Units: samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.dem.coordinates import Coordinates, NodeMesh
from orograph.dem.lattice import Lattice, Raster, SourceLattice, offset_between
from orograph.dem.resample import box_means, sample
from orograph.geo.grid import Grid, compose

COARSER = 1.5  # from this ratio of spacings on, sources are averaged before sampling
BUDGET = 3 << 23  # source samples held at once (float32: 96 MiB)
PIECE = 1 << 22  # target samples resampled at once
STRIP = 256  # rows whose coordinates are held at once

Heights = NDArray[np.float32]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LatticeMap:
    """A lattice and its mapping to the target grid: by a whole offset, or by coordinates (with averaging before)."""

    lattice: SourceLattice
    offset: tuple[int, int] | None  # (row, col) of the target's first sample in the lattice
    coordinates: Coordinates | None
    means: tuple[int, int]  # rows, cols of the blocks averaged first
    box: tuple[int, int, int, int]  # target rows and columns it can reach

    def positions(self, col: Floats, row: Floats) -> tuple[Floats, Floats]:
        """(col, row) (n,) in the lattice of fractional samples (n,) of the target."""
        if self.offset is not None:
            return col + self.offset[1], row + self.offset[0]
        assert self.coordinates is not None
        return self.coordinates.exact(col, row)


def layer_of(lattice: SourceLattice, target: Grid, resampling: str) -> LatticeMap:
    """The mapping of ``lattice`` to ``target``."""
    everything = (0, target.rows, 0, target.cols)
    offset = offset_between(target, lattice.grid)
    if offset is not None:
        return LatticeMap(lattice, offset, None, (1, 1), everything)
    coordinates = Coordinates(target, lattice.grid)
    means = (1, 1) if resampling == "nearest" else _blocks(coordinates, lattice.grid)
    return LatticeMap(lattice, None, coordinates, means, box_of(lattice.grid, target))


def _blocks(coordinates: Coordinates, grid: Grid) -> tuple[int, int]:
    """(rows, cols) of source samples to average: those between two target samples, at the source's centre."""
    back = Coordinates(grid, coordinates.target)
    col, row = back.exact(np.array([(grid.cols - 1) / 2]), np.array([(grid.rows - 1) / 2]))
    if not np.isfinite(col + row).all():
        return 1, 1
    at = np.array([[-0.5, 0.5, 0, 0], [0, 0, -0.5, 0.5]])
    u, v = coordinates.exact(col + at[0], row + at[1])
    across, down = math.hypot(u[1] - u[0], u[3] - u[2]), math.hypot(v[1] - v[0], v[3] - v[2])
    if not math.isfinite(across + down):
        return 1, 1
    return (round(down) if down >= COARSER else 1), (round(across) if across >= COARSER else 1)


def box_of(grid: Grid, target: Grid, points: int = 65) -> tuple[int, int, int, int]:
    """Target rows and columns that may lie within a source grid, with a margin.

    Args:
        points: probes of the source along each axis.
    """
    t = np.linspace(-0.5, 0.5, points)
    s, d = np.meshgrid(t, t)
    back = Coordinates(grid, target)
    col, row = back.exact((grid.cols - 1) / 2 + s * (grid.cols + 1), (grid.rows - 1) / 2 + d * (grid.rows + 1))
    if not np.isfinite(col + row).all():
        return 0, target.rows, 0, target.cols
    slack_r = 4 + (0.05 + 3 / grid.rows) * np.ptp(row)  # (kernels read two samples of the source beyond a place)
    slack_c = 4 + (0.05 + 3 / grid.cols) * np.ptp(col)
    r0, r1 = math.floor(row.min() - slack_r), math.ceil(row.max() + slack_r)
    c0, c1 = math.floor(col.min() - slack_c), math.ceil(col.max() + slack_c)
    return max(0, r0), min(target.rows, r1), max(0, c0), min(target.cols, c1)


def reaches(layer: LatticeMap, target: Grid) -> Iterator[tuple[Raster, tuple[int, int, int, int]]]:
    """The members of a layer, with the target's rows and columns (half-open) that each may affect, with a margin."""
    lattice = layer.lattice
    assert isinstance(lattice, Lattice)
    for member, (top, bottom, left, right) in zip(lattice.members, lattice.corners.tolist(), strict=True):
        if lattice.circle:
            box = layer.box
        elif layer.offset is not None:
            r, c = layer.offset
            box = top - r, bottom - r, left - c, right - c
        else:
            place = compose(lattice.grid.transform, Affine.translation(left, top))
            box = box_of(Grid((bottom - top, right - left), place, lattice.grid.crs), target, 17)
        yield member, (max(box[0], 0), min(box[1], target.rows), max(box[2], 0), min(box[3], target.cols))


def averaged(layer: LatticeMap, row0: int, row1: int, col0: int, col1: int) -> Heights:
    """A window of the lattice, or of its block means, whose blocks are counted from the lattice's first sample."""
    k_rows, k_cols = layer.means
    if layer.means == (1, 1):
        return layer.lattice.read(row0, row1, col0, col1)
    out = np.empty((row1 - row0, col1 - col0), np.float32)
    tall = max(1, BUDGET // (k_rows * k_cols * (col1 - col0)))
    wide = max(1, min(col1 - col0, BUDGET // (k_rows * k_cols)))
    for r in range(row0, row1, tall):
        for c in range(col0, col1, wide):
            end_r, end_c = min(r + tall, row1), min(c + wide, col1)
            window = layer.lattice.read(r * k_rows, end_r * k_rows, c * k_cols, end_c * k_cols)
            part = np.empty((end_r - r, end_c - c), np.float32)
            box_means(window, k_rows, k_cols, part)
            out[r - row0 : end_r - row0, c - col0 : end_c - col0] = part
    return out


def needed(layer: LatticeMap, mesh: NodeMesh) -> tuple[int, int, int, int] | None:
    """Rows and columns of the (averaged) lattice that a window needs, including the neighbours that kernels read."""
    bounds = mesh.bounds()
    if bounds is None:
        return None
    u0, u1, v0, v1 = bounds
    k_rows, k_cols = layer.means
    rows, cols = -(-layer.lattice.grid.rows // k_rows), -(-layer.lattice.grid.cols // k_cols)
    j0, j1 = math.floor((v0 - (k_rows - 1) / 2) / k_rows) - 1, math.floor((v1 - (k_rows - 1) / 2) / k_rows) + 3
    i0, i1 = math.floor((u0 - (k_cols - 1) / 2) / k_cols) - 1, math.floor((u1 - (k_cols - 1) / 2) / k_cols) + 3
    j0, j1, i0, i1 = max(j0, -2), min(j1, rows + 2), max(i0, -2), min(i1, cols + 2)
    return (j0, j1, i0, i1) if j0 < j1 and i0 < i1 else None


def filled(method: str, layers: Sequence[LatticeMap], row0: int, row1: int, col0: int, col1: int) -> Heights:
    """A window of the target from the first lattice, its gaps filled from the next ones; NaN where none has a value."""
    out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
    for i, layer in enumerate(layers):
        a, b = max(row0, layer.box[0]), min(row1, layer.box[1])
        c, d = max(col0, layer.box[2]), min(col1, layer.box[3])
        if a < b and c < d:
            part = out[a - row0 : b - row0, c - col0 : d - col0]
            if i == 0 or np.isnan(part).any():
                fill(method, layer, a, b, c, d, part)
    return out


def fill(method: str, layer: LatticeMap, row0: int, row1: int, col0: int, col1: int, out: Heights) -> None:
    """Give the missing samples of ``out`` (that window of the target) the values of one lattice, where it has any.

    Args:
        method: one of ``resample.sample``'s.
    """
    if layer.offset is not None:
        r, c = layer.offset
        found = layer.lattice.read(row0 + r, row1 + r, col0 + c, col1 + c)
        np.copyto(out, found, where=np.isnan(out))
        return
    assert layer.coordinates is not None
    reach = mesh = None
    if (row1 - row0) * (col1 - col0) <= PIECE:
        mesh = layer.coordinates.mesh(row0, row1, col0, col1)
        reach = needed(layer, mesh)
        if reach is None:
            return
    if (
        mesh is None
        or reach is None
        or ((reach[1] - reach[0]) * (reach[3] - reach[2]) > BUDGET and max(out.shape) > 16)
    ):
        if row1 - row0 >= col1 - col0:
            middle = (row0 + row1) // 2
            fill(method, layer, row0, middle, col0, col1, out[: middle - row0])
            fill(method, layer, middle, row1, col0, col1, out[middle - row0 :])
        else:
            middle = (col0 + col1) // 2
            fill(method, layer, row0, row1, col0, middle, out[:, : middle - col0])
            fill(method, layer, row0, row1, middle, col1, out[:, middle - col0 :])
        return
    window = averaged(layer, *reach)
    k_rows, k_cols = layer.means
    for r in range(row0, row1, STRIP):
        end = min(r + STRIP, row1)
        u, v = mesh.positions(r, end, col0, col1)
        if layer.means != (1, 1):
            u, v = (u - (k_cols - 1) / 2) / k_cols, (v - (k_rows - 1) / 2) / k_rows
        sample(method, window, reach[0], reach[2], u, v, out[r - row0 : end - row0])
