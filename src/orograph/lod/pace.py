"""How long work takes, learnt as it is done, so that a frame of limited time begins no more than fits into it."""

from __future__ import annotations

import time
from dataclasses import dataclass

SHORTEST, LONGEST = 1e-7, 2e-5
"""Seconds that a unit of work may be taken for: what compiles or waits for a disk tells nothing of it."""

LEAST = 32
"""Units of work from which on a call tells how long one takes; as many are done at least between two looks at the
clock, which take as long."""

EASE = 0.3
"""The share of what is learnt of the last call."""

END = 0.03
"""The share of the time in which nothing more is begun."""


@dataclass(slots=True)
class Pace:
    """Seconds that a unit of work takes, whatever the unit is."""

    unit: float = 2e-6

    def learn(self, seconds: float, units: int) -> None:
        """So many units took so long."""
        if units >= LEAST:
            self.unit += EASE * (min(max(seconds / units, SHORTEST), LONGEST) - self.unit)

    def fitting(self, seconds: float) -> int:
        """How many units fit."""
        return max(LEAST, int(seconds / self.unit))


@dataclass(slots=True)
class Deadline:
    """The end of a frame's time; None: there is none."""

    seconds: float | None
    began: float = 0.0

    def __post_init__(self) -> None:
        self.began = time.perf_counter()

    def left(self, taken: float = 0.0) -> float:
        """Seconds that are left, if the rest takes so many."""
        return float("inf") if self.seconds is None else self.seconds - (time.perf_counter() - self.began) - taken

    def is_near(self, taken: float = 0.0) -> bool:
        """Whether nothing more should begin."""
        return self.seconds is not None and self.left(taken) <= END * self.seconds
