"""Charts: how a raster's samples lie in the world that a camera looks at.

A terrain is seen through charts. Each takes sample coordinates (column, row, height) to the world's, in float64, and
has a local frame, in which one step along a column, a row and a metre of height are vectors. Flat terrain has one
chart, affine: the grid's own map. A globe is several curved ones. What holds for an affine chart only (one linear map
for the whole terrain, planes that stay planes, rays that stay straight) is asked of ``AffineChart`` by name.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.geo.grid import Grid

Array = NDArray[np.float64]


class Chart(Protocol):
    """A map from sample coordinates to the world."""

    def to_world(self, samples: ArrayLike) -> Array:
        """World positions (…, 3), metres, of sample coordinates (…, 3): column, row, height in metres."""
        ...

    def from_world(self, points: ArrayLike) -> Array:
        """Sample coordinates (…, 3) of world positions (…, 3)."""
        ...

    def frame(self, samples: ArrayLike) -> Array:
        """The local frames (…, 3, 3) at sample coordinates (…, 3): their columns are the world vectors of one column,
        one row and one metre of height there."""
        ...


@dataclass(frozen=True, slots=True)
class AffineChart:
    """The one chart of flat terrain: easting and northing are affine in column and row, height is height.

    Attributes:
        grid: of the full-resolution samples.
    """

    grid: Grid

    def to_world(self, samples: ArrayLike) -> Array:
        """As ``Chart.to_world``: easting, northing, height."""
        s = np.asarray(samples, np.float64)
        x, y = self.grid.xy(s[..., 0], s[..., 1])
        return np.stack([x, y, s[..., 2]], -1)

    def from_world(self, points: ArrayLike) -> Array:
        """As ``Chart.from_world``."""
        p = np.asarray(points, np.float64)
        col, row = self.grid.index(p[..., 0], p[..., 1])
        return np.stack([col, row, p[..., 2]], -1)

    def frame(self, samples: ArrayLike) -> Array:
        """As ``Chart.frame``: the same everywhere."""
        frame = np.eye(3)
        frame[:2, :2] = self.grid.linear
        return np.broadcast_to(frame, (*np.shape(samples)[:-1], 3, 3))

    # ---- what only an affine chart has ---------------------------------------------------------------------------

    @property
    def linear(self) -> Array:
        """(2, 2): metres east and north per column and per row."""
        return self.grid.linear

    @property
    def spacing(self) -> float:
        """Metres: the side of a square as large as a cell."""
        return math.sqrt(self.grid.cell_area)

    @property
    def least_steps(self) -> tuple[float, float]:
        """Metres per column and per row, at least: exact where they are at right angles, else the least stretch."""
        (a, b), (d, e) = linear = self.linear
        if abs(a * b + d * e) < 1e-9 * (a * a + b * b + d * d + e * e):
            return math.hypot(a, d), math.hypot(b, e)
        least = float(np.linalg.svd(linear, compute_uv=False)[1])
        return least, least

    def planes(self, planes: Iterable[Sequence[float]], exaggeration: float = 1.0) -> list[tuple[float, ...]]:
        """Planes a·x + b·y + c·z + d of the stretched world, as ones over column, row and true height."""
        a, b, c, d, e, f = self.grid.samples[:6]
        # In plain numbers: so few take NumPy five times as long, and cameras move at every frame.
        return [(p * a + q * d, p * b + q * e, r * exaggeration, s + p * c + q * f) for p, q, r, s in planes]

    def vectors_from_world(self, vectors: ArrayLike) -> Array:
        """Columns, rows and metres of height along vectors (…, 3) of the world."""
        v = np.asarray(vectors, np.float64)
        a, b, _, d, e, _ = self.grid.inverse[:6]
        return np.stack([a * v[..., 0] + b * v[..., 1], d * v[..., 0] + e * v[..., 1], v[..., 2]], -1)
