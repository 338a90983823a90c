"""Budgets of triangles and of time for methods that know tolerances only: ``by_tolerance`` searches for the tolerance.

A method calls it with a function that refines to a tolerance, and gets the finest result that keeps the budget.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, Self, TypeVar

from orograph.lod.method import Goal

COARSEST, FINEST = 1024.0, 1 / 64
"""Pixels: the range of tolerances in which budgets are searched."""

GROWTH = 1.5
"""The number of triangles falls roughly with this power of the tolerance."""

PART = 0.9
"""The share of the available time that a pass is expected to take."""

LEFT = 0.25
"""The least share of the time that passes get, however long the selection after them takes."""

WORTH = 1.4
"""Another pass starts if the time left is at least this many times that of the last pass."""

LEAP = 16.0
"""The largest factor by which a pass may be finer than the one before."""


class Coarsened(Protocol):
    """What a tolerance leads to.

    Attributes:
        triangles: how many there are.
        within: whether a tolerance asked for is kept, or a budget. tolerance: the one asked for, or reached, pixels.
    """

    within: bool
    tolerance: float | None

    @property
    def triangles(self) -> int: ...

    def kept(self) -> Self:
        """A copy that stays valid when the method selects again."""
        ...


M = TypeVar("M", bound=Coarsened)


@dataclass(slots=True)
class Pass:
    """What a budget remembers of the previous frame.

    Attributes:
        tolerance, seconds: of the last pass; 0: none yet.
        passes: seconds that all passes of the frame took.
        after: seconds that the method took after its passes, to make a selection of what they found.
    """

    tolerance: float = 0.0
    seconds: float = 0.0
    passes: float = 0.0
    after: float = 0.0

    def reaching(self, seconds: float) -> float:
        """The tolerance at which a pass takes this many seconds, if time is proportional to the number of triangles."""
        return float(self.tolerance * (self.seconds / seconds) ** (1 / GROWTH))

    def selected(self, began: float) -> None:
        """Note that the selection that began at this ``time.perf_counter`` is complete."""
        self.after = max(time.perf_counter() - began - self.passes, 0.0)


def by_tolerance(refine: Callable[[float], M], goal: Goal, last: Pass) -> M:
    """Reach a budget with a method that takes only tolerances.

    Args:
        refine: what a tolerance in pixels leads to.
        last: of the budget before, which a budget of time begins with; it is kept up to date.
    """

    def at(tolerance: float) -> M:
        began = time.perf_counter()
        found = refine(tolerance)
        found.tolerance = tolerance
        last.tolerance, last.seconds = tolerance, time.perf_counter() - began
        return found

    start = time.perf_counter()
    if goal.seconds is not None:
        found = _in_time(at, max(goal.seconds - last.after, LEFT * goal.seconds), last)
    else:
        assert goal.triangles is not None
        found = _in_number(at, goal.triangles)
    last.passes = time.perf_counter() - start
    return found


def _in_time(at: Callable[[float], M], seconds: float, last: Pass) -> M:
    """The finest tolerance that time allows.

    Passes go from coarse to fine; each is as fine as the last one lets expect in the time that is left, but at most
    ``LEAP`` times: small meshes say little about large ones. Where there were passes before, as in the frames of a
    flight, the first one has the time of all.
    """
    first = COARSEST
    if last.seconds > 0:
        first = min(max(last.reaching(PART * seconds), FINEST), COARSEST)
    else:
        at(COARSEST)  # the first pass compiles and reads: its time says nothing about the next
    began = time.perf_counter()
    best = at(first)
    while True:
        left = seconds - (time.perf_counter() - began)
        if left < WORTH * last.seconds or last.tolerance <= FINEST:
            return best
        best = at(max(last.reaching(PART * left), last.tolerance / LEAP, FINEST))


def _in_number(at: Callable[[float], M], triangles: int) -> M:
    """The smallest tolerance that at most this many triangles keep (or the largest tolerance, and not within the
    budget); where possible with at least 98 % of the budget."""
    low, high = 0.0, COARSEST  # one tolerance makes too many triangles, the other few enough
    best = at(high).kept()
    if best.triangles > triangles:
        best.within = False
        return best
    tolerance = 1.0
    for _ in range(24):
        found = at(tolerance)
        if found.triangles <= triangles:
            best, high = found.kept(), tolerance
            if found.triangles > 0.98 * triangles:
                break
        else:
            low = tolerance
        # (See ``GROWTH``; a guess near the end of the range is useless.)
        guess = tolerance * (max(found.triangles, 1) / (0.99 * triangles)) ** (1 / GROWTH)
        inner = math.log(high / low) / 8 if low > 0 else 0.0
        if low > 0 and not low * math.exp(inner) <= guess <= high / math.exp(inner):
            guess = math.sqrt(low * high)
        tolerance = min(guess, high / 1.01) if low == 0 else guess
        if tolerance < 1e-4 or (low > 0 and high / low < 1 + 1e-6):
            break
    return best
