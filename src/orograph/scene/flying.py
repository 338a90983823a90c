"""Scenarios of a flight that change gradually with the camera's height above ground and its speed.

Dübel et al. (2017, section 4) have three: near the ground, in take-off and approach, the terrain comes first; in
overflight the data; in re-planning, where a pilot stops to think, their uncertainty. Here the first holds below a
height ``low``, the others above ``high``: overflight where the camera is faster than ``fast``, re-planning where it is
slower than ``slow``. Between, the pictures are blended, by smooth steps of the height and the speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geovis.data.focus import Weight, smooth_step
from orograph.measuring.ground import heights
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]

BASE, OTHERS = "approach", ("overflight", "replanning")

LOW, HIGH = 0.5, 1.5
"""Default heights, as parts of the terrain's range of heights."""

SLOW, FAST = 240.0, 60.0
"""Default speeds, as seconds in which the terrain's longer side is passed."""


@dataclass(frozen=True, slots=True)
class Flight:
    """When scenarios change; None: by the terrain's size.

    Attributes:
        low, high: metres above ground. slow, fast: metres per second.

    Raises:
        UsageError: they are negative, or not in order.
    """

    low: float | None = None
    high: float | None = None
    slow: float | None = None
    fast: float | None = None

    def __post_init__(self) -> None:
        for a, b in ((self.low, self.high), (self.slow, self.fast)):
            if (a is None) != (b is None) or (a is not None and b is not None and not 0 <= a < b < math.inf):
                raise UsageError(f"Scenarios must change from a lower to a higher value, not from {a:g} to {b:g}.")

    @classmethod
    def parse(cls, text: str) -> Self:
        """``auto``, ``LOW:HIGH`` or ``LOW:HIGH:SLOW:FAST``.

        Raises:
            UsageError: it is none of these.
        """
        if text == "auto":
            return cls()
        try:
            found = [float(part) for part in text.split(":")]
        except ValueError:
            found = []
        if len(found) not in (2, 4):
            raise UsageError(f"A flight must be auto, LOW:HIGH or LOW:HIGH:SLOW:FAST, not {text!r}.")
        return cls(*found)

    def over(self, terrain: Terrain) -> Flight:
        """The same with missing numbers filled in by a terrain's size."""
        low, high = terrain.height_range
        tall = max(high - low, 1.0)
        grid = terrain.grid
        longer = max(grid.cols * grid.spacing[0], grid.rows * grid.spacing[1])
        made = self if self.low is not None else replace(self, low=LOW * tall, high=HIGH * tall)
        return made if made.slow is not None else replace(made, slow=longer / SLOW, fast=longer / FAST)

    def shares(self, height: float, speed: float | None) -> tuple[float, float, float]:
        """The weights of approach, overflight and re-planning, which sum to 1.

        Args:
            height: metres above ground. speed: metres per second; None: unknown, taken as fast as in overflight.
        """
        high = _between(height, self.low, self.high)
        fast = 1.0 if speed is None else _between(speed, self.slow, self.fast)
        return 1 - high, high * fast, high * (1 - fast)


def _between(value: float, low: float | None, high: float | None) -> float:
    assert low is not None and high is not None
    return float(smooth_step(np.array(value - (low + high) / 2), high - low))


@dataclass(frozen=True, slots=True)
class Flown(Weight):
    """The weight of a scenario, the same everywhere.

    Attributes:
        flight: with all its numbers. which: 0 overflight, drawn over approach; 1 re-planning, drawn over both.
        filmed: the weights of the three, in a film; None: computed from the eye's height.
    """

    terrain: Terrain
    flight: Flight
    which: int
    filmed: tuple[float, float, float] | None = None

    def __call__(self, eye: Array, places: Array, pixels: tuple[Array, Array], aspect: float) -> Array:
        approach, overflight, replanning = self.shares(eye)
        if self.which:
            return np.full(places.shape[:2], replanning)
        below = approach + overflight
        return np.full(places.shape[:2], overflight / below if below > 0 else 0.0)

    def shows(self, eye: Array) -> bool:
        return self.shares(eye)[1 + self.which] > 0

    def shares(self, eye: Array) -> tuple[float, float, float]:
        """The weights of approach, overflight and re-planning."""
        return self.flight.shares(self.height(eye), None) if self.filmed is None else self.filmed

    def height(self, eye: Array) -> float:
        """Height of the eye above the ground under it, metres.

        Outside the terrain it is above the border, over holes above the terrain's middle.
        """
        rows, cols = self.terrain.grid.shape
        col, row = self.terrain.grid.index(eye[0], eye[1])
        x, y = np.clip(col, 0, cols - 1).reshape(1), np.clip(row, 0, rows - 1).reshape(1)
        ground = float(heights(self.terrain, x, y)[0])
        return float(eye[2]) - (float(np.mean(self.terrain.height_range)) if math.isnan(ground) else ground)
