"""The surface at single places and along lines: exact, reading no more tiles than necessary.

The surface is Orograph's own: each cell is cut along the diagonal that joins its (even, even) and (odd, odd) corners
and is plane on either side; a triangle with a missing corner is a hole. All edges of this triangulation lie on four
families of straight lines, x ∈ ℤ, y ∈ ℤ, x − y ∈ 2ℤ and x + y ∈ 2ℤ (columns x, rows y), so that where a line crosses
edges is known in closed form, and between two crossings the ground is straight.

Units: sample coordinates, metres. Arrays are float64; a height that is missing is NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.dem.points import heights_between
from orograph.store.terrain import TILE, Terrain

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME = 1e-12
"""Crossings of a line nearer to each other than this fraction count as one."""
ASIDE = 1e-7
"""Offset in samples from a place on an edge to find its other triangle, if one is missing."""


@dataclass(frozen=True, slots=True)
class Facets:
    """The plane under each of n places: height = base + p·(x − col) + q·(y − row).

    Attributes:
        col, row: (n,) int64, the cell's first sample.
        base, p, q: (n,); NaN in a hole. p and q are metres per sample.
    """

    col: Integers
    row: Integers
    base: Array
    p: Array
    q: Array

    def heights(self, x: Array, y: Array) -> Array:
        """Heights (n,) of the planes at places (n,)."""
        return np.asarray(self.base + self.p * (x - self.col) + self.q * (y - self.row))


def corners(terrain: Terrain, col: Integers, row: Integers) -> Array:
    """Heights (n, 4) of cells: samples (col, row), (col + 1, row), (col, row + 1), (col + 1, row + 1).

    Places are processed tile by tile; only the rectangle that holds its places is read of a tile.
    """
    out = np.empty((len(col), 4))
    key = (row // TILE << 32) | col // TILE
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    for first, last in zip(starts, [*starts[1:], len(order)]):
        which = order[first:last]
        r, c = row[which], col[which]
        r0, c0 = int(r.min()), int(c.min())
        part = terrain.read(0, r0, int(r.max()) + 2, c0, int(c.max()) + 2)
        r, c = r - r0, c - c0
        for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
            out[which, k] = part[r + i, c + j]
    return out


def facets(terrain: Terrain, x: Array, y: Array) -> Facets:
    """The triangles at places (n,) on the terrain; on an edge or a sample, one that is not missing if there is any."""
    found = _facets(terrain, x, y)
    rows, cols = terrain.grid.shape
    for dx, dy in ((1, 2), (-1, 2), (1, -2), (-1, -2), (2, 1), (2, -1), (-2, 1), (-2, -1)):
        lost = np.flatnonzero(np.isnan(found.base))
        if not len(lost):
            break
        u, v = np.clip(x[lost] + dx * ASIDE, 0, cols - 1), np.clip(y[lost] + dy * ASIDE, 0, rows - 1)
        other = _facets(terrain, u, v)
        for name in ("col", "row", "base", "p", "q"):
            getattr(found, name)[lost] = getattr(other, name)
    return found


def _facets(terrain: Terrain, x: Array, y: Array) -> Facets:
    rows, cols = terrain.grid.shape
    col = np.clip(np.floor(x), 0, cols - 2).astype(np.int64)
    row = np.clip(np.floor(y), 0, rows - 2).astype(np.int64)
    a, b, c, d = corners(terrain, col, row).T
    u, v = x - col, y - row
    even = (col + row) % 2 == 0
    upper = np.where(even, u >= v, u + v <= 1)
    # Even cells are cut from a to d (a b d and a c d), odd ones from b to c (a b c and b c d).
    base = np.where(even | upper, a, b + c - d)
    p = np.where(upper, b - a, d - c)
    q = np.where(even == upper, d - b, c - a)
    missing = np.isnan(base) | np.isnan(p) | np.isnan(q)
    return Facets(col, row, np.where(missing, np.nan, base), p, q)


def heights(terrain: Terrain, x: Array, y: Array) -> Array:
    """The surface at places (n,) on the terrain; NaN in holes."""
    return facets(terrain, x, y).heights(x, y)


def own_heights(terrain: Terrain, points: Array) -> Array:
    """Heights (n,) at points (n, 2) = easting, northing from the terrain's original samples; NaN where there are none.

    They are bilinear. Without original samples, they come from the surface if it was resampled, with an error of up to
    ``height_error``, and otherwise from the terrain's own samples.
    """
    x, y = points[:, 0], points[:, 1]
    if terrain.samples is not None:
        return terrain.samples.heights_at(x, y)
    col, row = terrain.grid.index(x, y)
    if terrain.resampled is not None:
        rows, cols = terrain.grid.shape
        return heights(terrain, np.clip(col, 0, cols - 1), np.clip(row, 0, rows - 1))
    return heights_between(lambda *window: terrain.read(0, *window), terrain.grid.shape, col, row)


def height_error(terrain: Terrain) -> float | None:
    """Maximum error of ``own_heights`` at the original samples, metres; None if they are those samples' own."""
    lost = terrain.resampled
    return None if lost is None or terrain.samples is not None or np.isnan(lost.largest) else lost.largest


def crossings(start: Array, end: Array) -> Array:
    """Fractions, from 0 to 1 inclusive, at which a line (2,) → (2,) crosses edges of the triangulation."""
    found = [np.array([0.0, 1.0])]
    forms = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    for (f0, f1), step in zip(np.stack([forms @ start, forms @ end], axis=-1), (1.0, 1.0, 2.0, 2.0)):
        if f0 != f1:
            low, high = sorted((f0 / step, f1 / step))
            found.append((np.arange(np.floor(low) + 1, np.ceil(high)) * step - f0) / (f1 - f0))
    t = np.sort(np.concatenate(found))
    t = t[(t >= 0.0) & (t <= 1.0)]
    keep = np.append(np.diff(t) > SAME, True)  # of a cluster the last, so that the end stays exactly 1
    t = t[keep]
    t[0] = 0.0
    return np.asarray(t)


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line over the surface, cut where it crosses edges: n + 1 places, n pieces that are straight in space.

    Attributes:
        t: (n + 1,) fractions of the line.
        x, y: (n + 1,) sample coordinates.
        before, after: (n,) heights at the beginning and the end of each piece; NaN over a hole.
    """

    t: Array
    x: Array
    y: Array
    before: Array
    after: Array

    @property
    def known(self) -> NDArray[np.bool_]:
        """(n,): whether pieces are ground."""
        return ~np.isnan(self.before)

    @property
    def heights(self) -> Array:
        """(n + 1,) heights at the places; NaN where there is ground on neither side."""
        left, right = np.append(np.nan, self.after), np.append(self.before, np.nan)
        return np.where(np.isnan(right), left, right)


def line(terrain: Terrain, start: Array, end: Array) -> Line:
    """The surface along a line between two places (2,) in sample coordinates, on the terrain."""
    rows, cols = terrain.grid.shape
    t = crossings(start, end)
    x = np.clip(start[0] + t * (end[0] - start[0]), 0.0, cols - 1.0)
    y = np.clip(start[1] + t * (end[1] - start[1]), 0.0, rows - 1.0)
    under = facets(terrain, 0.5 * (x[:-1] + x[1:]), 0.5 * (y[:-1] + y[1:]))
    return Line(t, x, y, under.heights(x[:-1], y[:-1]), under.heights(x[1:], y[1:]))
