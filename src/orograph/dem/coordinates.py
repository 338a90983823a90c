"""The position of each sample of the target grid in a source, without projecting every one.

Map projections are smooth, so the exact transformation (pyproj) is evaluated on a sparse mesh of target samples, every
``step``-th one counted from the target's *first* sample, and interpolated bilinearly between them. The step is the
largest power of two for which the interpolation stays within a tolerance (source samples) on probes over the whole
grid. Mesh cells that bend more than that (around a pole, across the antimeridian, at the rim of a projection) are found
by the second differences of the mesh and evaluated sample by sample. Many inverse projections also give positions
beyond the rim of the map, which belong elsewhere; where the target reaches beyond it, a sample counts only if its
position projects back to it. Mesh, step and decision depend only on the two grids, never on the window: coordinates are
identical to the bit however a raster is cut into windows. Units: samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from orograph._numba import kernel
from orograph.dem.lattice import full_turn
from orograph.geo.grid import Grid

TOLERANCE = 0.01
STEPS = (64, 32, 16, 8, 4, 2)
RETURN = 1.0  # samples, and metres: tolerances for a position that is projected back
PROBES = 65  # probes along a side of the target, to see whether it reaches beyond the projection's rim

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NodeMesh:
    """Source positions of a window of target samples, as nodes ``step`` apart and patches of single samples.

    Attributes:
        step: target samples between nodes.
        row0, col0: target sample of the first node.
        u, v: source (col, row) at the nodes, float64.
        patches: (row0, col0, u, v) of target samples whose positions replace the interpolated ones.
    """

    step: int
    row0: int
    col0: int
    u: Floats
    v: Floats
    patches: list[tuple[int, int, Floats, Floats]]

    def bounds(self) -> tuple[float, float, float, float] | None:
        """(least u, greatest u, least v, greatest v) of all positions, None if there are none."""
        us = [self.u, *(p[2] for p in self.patches)]
        vs = [self.v, *(p[3] for p in self.patches)]
        us, vs = [a[np.isfinite(a)] for a in us], [a[np.isfinite(a)] for a in vs]
        u, v = np.concatenate(us), np.concatenate(vs)
        return (float(u.min()), float(u.max()), float(v.min()), float(v.max())) if len(u) and len(v) else None

    def positions(self, row0: int, row1: int, col0: int, col1: int) -> tuple[Floats, Floats]:
        """Source (col, row) of each target sample of a part of the window: two float64 arrays of its shape."""
        if self.step == 1:
            part = (slice(row0 - self.row0, row1 - self.row0), slice(col0 - self.col0, col1 - self.col0))
            return self.u[part], self.v[part]
        u, v = np.empty((row1 - row0, col1 - col0)), np.empty((row1 - row0, col1 - col0))
        spread(self.u, self.v, self.step, row0 - self.row0, col0 - self.col0, u, v)
        for top, left, pu, pv in self.patches:
            a, b = max(row0, top), min(row1, top + pu.shape[0])
            c, d = max(col0, left), min(col1, left + pu.shape[1])
            if a < b and c < d:
                place = (slice(a - row0, b - row0), slice(c - col0, d - col0))
                part = (slice(a - top, b - top), slice(c - left, d - left))
                u[place], v[place] = pu[part], pv[part]
        return u, v


class Coordinates:
    """The map from target samples to fractional (col, row) samples of a source grid."""

    def __init__(self, target: Grid, source: Grid, tolerance: float = TOLERANCE) -> None:
        self.target, self.source, self.tolerance = target, source, tolerance
        same = target.crs is None or source.crs is None or target.crs == source.crs
        self._transformer = None if same else Transformer.from_crs(target.crs, source.crs, always_xy=True)
        self._turn = full_turn(source) if not same and source.crs is not None and source.crs.is_geographic else 0.0
        self._middle = float(source.xy(*((n - 1) / 2 for n in (source.cols, source.rows)))[0])
        self._projection: Transformer | None = None
        if not same and target.crs is not None and target.crs.is_projected:
            # The target's projection alone: shifts of datum do not return exactly, and have no rim.
            projection = Transformer.from_crs(target.crs, target.crs.geodetic_crs, always_xy=True)
            probes = np.meshgrid(
                np.linspace(-0.5, target.cols - 0.5, PROBES), np.linspace(-0.5, target.rows - 0.5, PROBES)
            )
            if _beyond_rim(projection, target, probes[0], probes[1]).any():
                self._projection = projection
        self.step = STEPS[0] if same else self._choose_step()

    def exact(self, col: Floats, row: Floats) -> tuple[Floats, Floats]:
        """Source (col, row) of target samples, projected one by one; NaN where the projection is undefined."""
        x, y = self.target.xy(col, row)
        if self._transformer is not None:
            x, y = self._transformer.transform(x, y)
            if self._projection is not None:
                x = np.where(_beyond_rim(self._projection, self.target, col, row), np.nan, x)
            if self._turn:
                x = x + self._turn * np.round((self._middle - x) / self._turn)
            x, y = np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan)
        u, v = self.source.index(x, y)
        return u, v

    def mesh(self, row0: int, row1: int, col0: int, col1: int) -> NodeMesh:
        """The part of the mesh that a window needs, with its bent cells evaluated sample by sample."""
        s = self.step
        if s == 1:
            cols, rows = np.meshgrid(np.arange(col0, col1, dtype=float), np.arange(row0, row1, dtype=float))
            return NodeMesh(1, row0, col0, *self.exact(cols, rows), [])
        # Mesh cells touched by the window, and a ring of nodes around them for the second differences.
        top, bottom, left, right = row0 // s - 1, (row1 - 1) // s + 2, col0 // s - 1, (col1 - 1) // s + 2
        cols, rows = np.meshgrid(np.arange(left, right + 1.0) * s, np.arange(top, bottom + 1.0) * s)
        u, v = self.exact(cols, rows)
        patches = []
        if self._transformer is not None:
            for j, i in np.argwhere(_bend(u, v) > self.tolerance / 2):
                r0, c0 = (top + 1 + int(j)) * s, (left + 1 + int(i)) * s
                a, b, c, d = max(r0, row0), min(r0 + s, row1), max(c0, col0), min(c0 + s, col1)
                cols, rows = np.meshgrid(np.arange(c, d, dtype=float), np.arange(a, b, dtype=float))
                patches.append((a, c, *self.exact(cols, rows)))
        return NodeMesh(s, (top + 1) * s, (left + 1) * s, u[1:-1, 1:-1], v[1:-1, 1:-1], patches)

    def _choose_step(self) -> int:
        """The largest step for which 9 in 10 mesh cells, probed all over the target, are well within the tolerance."""
        rows, cols = self.target.shape
        for s in STEPS:
            if s > 2 * max(rows, cols):
                continue
            r = np.unique(np.linspace(0, (rows - 1) // s, 13).round()) * s
            c = np.unique(np.linspace(0, (cols - 1) // s, 13).round()) * s
            cells = [
                np.stack(self.exact(*np.meshgrid(c + dc * s, r + dr * s)))
                for dr, dc in ((0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5))
            ]
            error = np.abs((cells[0] + cells[1] + cells[2] + cells[3]) / 4 - cells[4]).max(axis=0)
            if np.mean(error <= self.tolerance / 16) >= 0.9:
                return s
        return 1


def _beyond_rim(projection: Transformer, grid: Grid, col: Floats, row: Floats) -> NDArray[np.bool_]:
    """Samples beyond the rim of a projection's map: their longitude and latitude do not project back to them."""
    x, y = projection.transform(*projection.transform(*grid.xy(col, row)), direction="INVERSE")
    back_col, back_row = grid.index(np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan))
    allowed = max(RETURN, RETURN / min(grid.spacing))
    return ~(np.hypot(back_col - col, back_row - row) <= allowed)  # and where either direction is undefined


def _bend(u: Floats, v: Floats) -> Floats:
    """Bound of the bilinear interpolation error within each inner cell of a mesh, in samples (inf where undefined).

    The error of bilinear interpolation is at most (|f_xx| + |f_yy|) h² / 8; the second differences at the cell's four
    corners stand for the derivatives.
    """
    worst = np.zeros((u.shape[0] - 3, u.shape[1] - 3))
    for f in (u, v):
        across = np.abs(f[1:-1, 2:] - 2 * f[1:-1, 1:-1] + f[1:-1, :-2])
        down = np.abs(f[2:, 1:-1] - 2 * f[1:-1, 1:-1] + f[:-2, 1:-1])
        node = (across + down) / 8
        node = np.where(np.isnan(node), np.inf, node)
        cell = np.maximum(np.maximum(node[1:, 1:], node[1:, :-1]), np.maximum(node[:-1, 1:], node[:-1, :-1]))
        worst = np.maximum(worst, cell)
    return worst


@kernel
def spread(
    mesh_u: Floats,
    mesh_v: Floats,
    step: int,
    row0: int,
    col0: int,
    u: Floats,
    v: Floats,
) -> None:
    """Bilinear interpolation of a mesh with nodes ``step`` apart; ``u`` begins (row0, col0) after its first node."""
    rows, cols = u.shape
    for r in range(rows):
        j, fr = (r + row0) // step, ((r + row0) % step) / step
        for c in range(cols):
            i, fc = (c + col0) // step, ((c + col0) % step) / step
            a, b = mesh_u[j, i], mesh_u[j + 1, i]
            a += (mesh_u[j, i + 1] - a) * fc
            b += (mesh_u[j + 1, i + 1] - b) * fc
            u[r, c] = a + (b - a) * fr
            a, b = mesh_v[j, i], mesh_v[j + 1, i]
            a += (mesh_v[j, i + 1] - a) * fc
            b += (mesh_v[j + 1, i + 1] - b) * fc
            v[r, c] = a + (b - a) * fr
