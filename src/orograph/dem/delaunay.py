"""The Delaunay surface of scattered points: a triangulation on a fine lattice, and its heights at samples.

Points lie on a *lattice* of 2^-``bits`` of a sample, ``bits`` such that the lattice has fewer than 2^30 places a side:
whether a place is inside a triangle, and how triangles turn, are exact in int64. Moving a point there moves it by less
than a hundred-thousandth of a sample (a hundredth on the largest grids). Triangles are Qhull's (Barber, Dobkin &
Huhdanpaa 1996, by SciPy). Units: samples; metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.errors import UsageError

MOST_BITS = 18
"""Maximum bits of fractions of a sample."""

SIDE_BITS = 30
"""Places along the lattice's side, as a power of two: products of differences fit int64."""

SLIVER = 160.0
"""Degrees: a triangle whose corner opposite a side on the rim is wider than this is a sliver."""

Ints = NDArray[np.int64]


def lattice_bits(rows: int, cols: int) -> int:
    """Bits of fractions on a grid of that size."""
    return min(MOST_BITS, SIDE_BITS - max(rows, cols).bit_length())


class Surface(NamedTuple):
    """A triangulated surface.

    Attributes:
        x, y: (n,) int64, column and row on the lattice. z: (n,) float32, metres.
        triangles: (m, 3) int32, of positive area in (column, row).
        bits: of the lattice: a sample is 2^bits places wide.
    """

    x: Ints
    y: Ints
    z: NDArray[np.float32]
    triangles: NDArray[np.int32]
    bits: int


class Merged(NamedTuple):
    """Points on the lattice, each place once, and counts of the merged ones.

    Attributes:
        doubled: points at the place of another.
        apart: largest difference of heights at one place, metres.
    """

    x: Ints
    y: Ints
    z: NDArray[np.float32]
    doubled: int
    apart: float


def on_lattice(col: NDArray[np.float64], row: NDArray[np.float64], z: NDArray[np.float64], bits: int) -> Merged:
    """Points moved to the nearest places of the lattice; those at one place become one, of their mean height."""
    x, y = (np.rint(np.ldexp(v, bits)).astype(np.int64) for v in (col, row))
    key = y << 32 | x
    places, first, counts = np.unique(key, return_inverse=True, return_counts=True)
    sums = np.bincount(first, weights=z, minlength=len(places))
    low, high = np.full(len(places), np.inf), np.full(len(places), -np.inf)
    np.minimum.at(low, first, z)
    np.maximum.at(high, first, z)
    apart = float((high - low).max())
    return Merged(places & 0xFFFFFFFF, places >> 32, (sums / counts).astype(np.float32), len(z) - len(places), apart)


def triangulate(points: Merged, bits: int, path: str) -> Surface:
    """The Delaunay triangulation of points.

    Raises:
        UsageError: fewer than three points, or all on one line.
    """
    from scipy.spatial import Delaunay, QhullError

    if len(points.z) < 3:
        raise UsageError(
            f"A surface needs three points; it has {len(points.z)}{' at different places' if points.doubled else ''}.",
            path=path, remedy="Name a file with more points.",
        )  # fmt: skip
    line = UsageError(
        f"All its {len(points.z)} points lie on one line: there is no surface between them.", path=path,
        remedy="Name points that cover an area.",
    )  # fmt: skip
    x0, y0 = points.x - points.x[0], points.y - points.y[0]
    far = int(np.argmax(np.abs(x0) + np.abs(y0)))
    if not (x0[far] * y0 - y0[far] * x0).any():
        raise line
    centred = np.stack([points.x - points.x.mean(), points.y - points.y.mean()], -1)
    try:
        found = Delaunay(centred).simplices
    except QhullError as error:
        raise line from error
    a, b, c = found.T
    area = (points.x[b] - points.x[a]) * (points.y[c] - points.y[a]) - (points.y[b] - points.y[a]) * (
        points.x[c] - points.x[a]
    )
    turned = np.where((area > 0)[:, None], found, found[:, ::-1])[area != 0]
    return Surface(points.x, points.y, points.z, np.ascontiguousarray(turned, np.int32), bits)


def sides(surface: Surface, across: tuple[float, float]) -> NDArray[np.float64]:
    """The longest side (m,) of each triangle, metres.

    Args:
        across: metres between columns, and between rows.
    """
    x, y = (np.ldexp(v.astype(np.float64), -surface.bits) * s for v, s in zip((surface.x, surface.y), across))
    t = surface.triangles
    lengths = [np.hypot(x[t[:, i]] - x[t[:, i - 1]], y[t[:, i]] - y[t[:, i - 1]]) for i in range(3)]
    return np.asarray(np.max(lengths, axis=0))


def without_slivers(surface: Surface) -> NDArray[np.int32]:
    """The triangles (m, 3) of a surface without the slivers along its rim.

    A sliver has a side on the rim, and an opposite corner wider than ``SLIVER``. It joins unrelated points of the hull,
    and stands like a wall. The triangles behind a removed sliver are then tested in turn. Long triangles between the
    tracks of a survey are not slivers: their corners opposite the rim are about right angles.
    """
    t = surface.triangles
    ends = np.stack([t[:, [1, 2]], t[:, [2, 0]], t[:, [0, 1]]], 1)  # (m, 3, 2): the sides opposite the corners
    _, side, count = np.unique(
        ends.min(-1).astype(np.int64) << 32 | ends.max(-1), return_inverse=True, return_counts=True
    )  # fmt: skip
    side = side.reshape(-1, 3)
    x, y = surface.x.astype(np.float64)[t], surface.y.astype(np.float64)[t]
    ux, uy = np.roll(x, -1, 1) - x, np.roll(y, -1, 1) - y
    vx, vy = np.roll(x, -2, 1) - x, np.roll(y, -2, 1) - y
    wide = ux * vx + uy * vy < math.cos(math.radians(SLIVER)) * np.hypot(ux, uy) * np.hypot(vx, vy)
    left = np.ones(len(t), bool)
    near = np.flatnonzero(wide.any(1))
    while True:
        peel = near[(wide[near] & (count[side[near]] == 1)).any(1)]
        if not len(peel) or len(peel) == left.sum():
            return np.ascontiguousarray(t[left])
        left[peel] = False
        np.subtract.at(count, side[peel], 1)
        near = near[left[near]]


class Gridded:
    """A triangulated surface at the samples of a grid, by windows.

    Args:
        surface: the triangles.
    """

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        rows = surface.y[surface.triangles]
        half = (1 << surface.bits) - 1
        self._first = (rows.min(axis=1) + half) >> surface.bits  # of the rows of samples that a triangle meets
        self._last = rows.max(axis=1) >> surface.bits

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        """Heights of a half-open window; NaN outside of the triangles. The same to the bit whatever the window."""
        out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
        s = self.surface
        which = np.flatnonzero((self._first < row1) & (self._last >= row0))
        _fill(s.x, s.y, s.z, s.triangles, which, s.bits, row0, col0, out)
        return out

    def at(self, col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights (n,) at places (n,) in sample coordinates; NaN outside of the triangles."""
        s = self.surface
        out = np.full(len(col), np.nan)
        order = np.argsort(row, kind="stable")
        for part in _parts(order):
            inside = np.isfinite(col[part]) & np.isfinite(row[part])
            if not inside.any():
                continue
            low, high = row[part][inside].min(), row[part][inside].max()
            which = np.flatnonzero((self._first <= high + 1) & (self._last >= low - 1))
            out[part] = _look(s.x, s.y, s.z, s.triangles, which, float(1 << s.bits), col[part], row[part])
        return out


def _parts(order: Ints) -> Iterator[Ints]:
    yield from np.array_split(order, max(1, len(order) // 256))


def spacing_of(col: NDArray[np.float64], row: NDArray[np.float64]) -> float:
    """The side of the square that a point has to itself, on average, within the points' hull; 0 on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        area = ConvexHull(np.stack([col - col.mean(), row - row.mean()], -1)).volume
    except (QhullError, ValueError):
        return 0.0
    return math.sqrt(area / len(col))


@kernel
def _fill(x, y, z, triangles, which, bits, row0, col0, out):
    """The heights of the samples in triangles; where two meet, that of the first."""
    one = np.int64(1) << bits
    for t in which:
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = x[a], y[a], x[b], y[b], x[c], y[c]
        top, bottom = min(ay, min(by, cy)), max(ay, max(by, cy))
        left, right = min(ax, min(bx, cx)), max(ax, max(bx, cx))
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        for row in range(max((top + one - 1) >> bits, row0), min(bottom >> bits, row0 + out.shape[0] - 1) + 1):
            py = np.int64(row) << bits
            for col in range(max((left + one - 1) >> bits, col0), min(right >> bits, col0 + out.shape[1] - 1) + 1):
                px = np.int64(col) << bits
                u = (cx - bx) * (py - by) - (cy - by) * (px - bx)
                v = (ax - cx) * (py - cy) - (ay - cy) * (px - cx)
                if u < 0 or v < 0 or u + v > area or not np.isnan(out[row - row0, col - col0]):
                    continue
                w = area - u - v
                out[row - row0, col - col0] = (
                    u * np.float64(z[a]) + v * np.float64(z[b]) + w * np.float64(z[c])
                ) / area


@kernel
def _look(x, y, z, triangles, which, one, col, row):
    """The heights of places in some of the triangles."""
    out = np.full(len(col), np.nan)
    for t in which:
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by, cx, cy = x[a] / one, y[a] / one, x[b] / one, y[b] / one, x[c] / one, y[c] / one
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        rim = 1e-9 * abs(area)
        for i in range(len(col)):
            if not np.isnan(out[i]):
                continue
            u = (cx - bx) * (row[i] - by) - (cy - by) * (col[i] - bx)
            v = (ax - cx) * (row[i] - cy) - (ay - cy) * (col[i] - cx)
            w = area - u - v
            if u >= -rim and v >= -rim and w >= -rim:
                out[i] = (u * np.float64(z[a]) + v * np.float64(z[b]) + w * np.float64(z[c])) / area
    return out
