"""A terrain's place in another CRS, so that distant data are neither read nor projected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geo.transform import crs_of, transformer

Array = NDArray[np.float64]

ALONG = 65
"""Places along each side of the terrain, and across it, that are projected."""

BEYOND = 0.1
"""Of the box's size, the margin around it: what lies within may still be seen at the border."""


@dataclass(frozen=True, slots=True)
class Reach:
    """A box around a terrain in another CRS.

    Attributes:
        low, high: (2,) its corners, infinite where the terrain holds a pole. turn: a full turn of longitude in its
            units, 0 if x is no longitude; x of the box may lie beyond half a turn, where the terrain lies across the
            antimeridian.
        move: (x, y) of that CRS → those of the terrain's, longitudes beyond half a turn included.
    """

    low: Array
    high: Array
    turn: float
    move: Callable[[ArrayLike, ArrayLike], tuple[Array, Array]]

    @classmethod
    def of(cls, grid: Grid, crs: Any, name: str) -> Reach:
        """Around a terrain with this grid; of a CRS that is None, the terrain's own.

        Raises:
            UsageError: there is no way between the two (another planet).
        """
        try:
            same = crs is None or grid.crs is None
            back = (lambda x, y: (x, y)) if same else transformer(grid.crs, crs)
            move = (lambda x, y: (np.asarray(x), np.asarray(y))) if same else transformer(crs, grid.crs)
        except UsageError as error:
            raise UsageError(
                f"The data cannot be laid over this terrain: {error.what}", path=name,
                remedy="Give data of the same body and with a known CRS.",
            ) from error  # fmt: skip
        t = np.linspace(0, 1, ALONG)
        col, row = np.meshgrid(t * grid.cols - 0.5, t * grid.rows - 0.5)
        x, y = (np.asarray(v, np.float64) for v in back(*grid.xy(col, row)))
        turn = 0.0
        if not same and crs_of(crs).is_geographic:
            turn = 2 * np.pi / float(crs_of(crs).axis_info[0].unit_conversion_factor)
            middle = x[ALONG // 2, ALONG // 2]
            x = x - turn * np.round((x - (middle if np.isfinite(middle) else 0.0)) / turn)
        known = np.isfinite(x) & np.isfinite(y)
        if not known.any():
            raise UsageError("The terrain lies outside the data's projection.", path=name)
        low = np.array([x[known].min(), y[known].min()])
        high = np.array([x[known].max(), y[known].max()])
        margin = BEYOND * (high - low)
        low, high = low - margin, high + margin
        if turn:
            for pole in (turn / 4, -turn / 4):
                if _holds(grid, *move(0.0, pole)):
                    low, high = np.full(2, -np.inf), np.full(2, np.inf)
        return cls(low, high, turn, move)

    @property
    def plain(self) -> tuple[float, float, float, float] | None:
        """(x, y, x, y) to ask a file for; None where it would have to be asked for two boxes."""
        half = self.turn / 2 if self.turn else np.inf
        if not np.isfinite(self.low).all() or self.low[0] < -half or self.high[0] > half:
            return None
        return float(self.low[0]), float(self.low[1]), float(self.high[0]), float(self.high[1])

    def unwrapped(self, part: Array) -> Array:
        """A line or ring (n, 3) whose longitudes go on across the antimeridian, on the turn nearest the terrain: two
        neighbours farther apart than half a turn are meant the short way."""
        if not self.turn:
            return part
        x = np.unwrap(part[:, 0], period=self.turn)
        middle = (self.low[0] + self.high[0]) / 2 if np.isfinite(self.low[0]) else 0.0
        out = part.copy()
        out[:, 0] = x + self.turn * np.round((middle - (x.min() + x.max()) / 2) / self.turn)
        return out


def _holds(grid: Grid, x: Any, y: Any) -> bool:
    if not (np.isfinite(x) and np.isfinite(y)):
        return False
    col, row = grid.index(x, y)
    return bool(-0.5 <= col <= grid.cols - 0.5 and -0.5 <= row <= grid.rows - 0.5)
