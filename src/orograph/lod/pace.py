"""Learns how long work takes, so that a frame of limited time begins no more than fits into it."""

from __future__ import annotations

import time
from dataclasses import dataclass

SHORTEST, LONGEST = 1e-7, 2e-5
"""Maximum seconds counted for a unit of work: longer times are due to compiling or waiting for a disk."""

LEAST = 32
"""Minimum units for a call to count; at least as many are done between two reads of the clock, which take as long."""

EASE = 0.3
"""Weight of the last call in the average."""

END = 0.03
"""The part of the time after which nothing more begins."""


@dataclass(slots=True)
class Pace:
    """Learns the seconds per unit of work."""

    unit: float = 2e-6

    def learn(self, seconds: float, units: int) -> None:
        """Record that ``units`` took this long."""
        if units >= LEAST:
            self.unit += EASE * (min(max(seconds / units, SHORTEST), LONGEST) - self.unit)

    def fitting(self, seconds: float) -> int:
        """How many units fit."""
        return max(LEAST, int(seconds / self.unit))


@dataclass(slots=True)
class Deadline:
    """The end of a frame's time; None: no limit."""

    seconds: float | None
    began: float = 0.0

    def __post_init__(self) -> None:
        self.began = time.perf_counter()

    def left(self, taken: float = 0.0) -> float:
        """Seconds left, if the rest takes this long."""
        return float("inf") if self.seconds is None else self.seconds - (time.perf_counter() - self.began) - taken

    def is_near(self, taken: float = 0.0) -> bool:
        """Whether nothing more should begin."""
        return self.seconds is not None and self.left(taken) <= END * self.seconds
