"""Charts: how a raster's samples lie in the world that a camera looks at.

A terrain is seen through charts. Each takes sample coordinates (column, row, height) to the world's, in float64, and
has a local frame, in which one step along a column, a row and a metre of height are vectors. Flat terrain has one
chart, affine: the grid's own map. A globe is several curved ones; nothing outside a chart may take the world for one
plane.
"""

from __future__ import annotations

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
        t = self.grid.samples
        linear = np.array([[t.a, t.b, 0.0], [t.d, t.e, 0.0], [0.0, 0.0, 1.0]])
        return np.broadcast_to(linear, (*np.shape(samples)[:-1], 3, 3))
