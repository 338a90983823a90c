"""Any window of an endless terrain by example, at any level: the same to the bit however it is made.

From the coarsest level down, coordinates are doubled, moved at random by a hash of their place, and corrected
(``kernels``). A place depends on others at most ``MARGIN`` away on its own level. So a window needs a margin on each
level, which stays below twice ``MARGIN`` for any number of levels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.several import numbers
from orograph.synthesis.exemplar import Exemplar, Integers
from orograph.synthesis.kernels import MARGIN, PASSES, corrected, order, raised, upsampled

JITTER = 0.5
"""Jitter of the coarser levels, in their steps; the finest three have none: see ``Endless``."""

UNCORRECTED = 2
"""Number of finest levels without correction by default: it is nine tenths of the work, and would only smooth them."""

UNSTEERED = np.zeros((1, 1, 0), np.int16)


class Range(NamedTuple):
    """Half-open ranges of rows and columns of a level, which may be negative."""

    row0: int
    row1: int
    col0: int
    col1: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.row1 - self.row0, self.col1 - self.col0

    def wider(self, by: int) -> Range:
        return Range(self.row0 - by, self.row1 + by, self.col0 - by, self.col1 + by)

    def parents(self) -> Range:
        """The places of the coarser level from which these are made."""
        return Range(self.row0 >> 1, ((self.row1 - 1) >> 1) + 1, self.col0 >> 1, ((self.col1 - 1) >> 1) + 1)

    def within(self, outer: Range) -> tuple[slice, slice]:
        """The position of these in an array of ``outer``."""
        rows = slice(self.row0 - outer.row0, self.row1 - outer.row0)
        return rows, slice(self.col0 - outer.col0, self.col1 - outer.col0)


class Endless:
    """The endless terrain of an exemplar and a seed.

    Args:
        jitter: how far coordinates are moved at random, in each level's steps: one number, or one for each level, the
            coarsest first (the last is repeated); each 0 to 1. A larger number gives more variety, a smaller one longer
            coherent pieces. The default moves all but the three finest levels, where it would only roughen.
        kappa: 0 or 1: whether a place that continues its neighbours is preferred to one that is only similar.
        passes: of correction, 0 to 2: one number, or one for each level, as for ``jitter``. The default corrects twice,
        but not the finest two levels, which are nine tenths of the work: there, correction only smooths.
    """

    def __init__(
        self, exemplar: Exemplar, seed: int = 1, *, jitter: float | Sequence[float] | None = None, kappa: int = 1,
        passes: float | Sequence[float] | None = None,
    ) -> None:  # fmt: skip
        levels = exemplar.top + 1
        if jitter is None:
            jitter = [JITTER] * max(1, levels - 3) + [0.0]
        shaken = _of_levels(numbers(jitter, "jitter"), levels)
        if shaken is None or not all(0 <= r <= 1 for r in shaken):
            raise UsageError(
                f"The jitter must be a number from 0 to 1, or up to {levels} of them, one for each level, not "
                f"{jitter!r}."
            )
        if passes is None:
            passes = [PASSES] * max(1, levels - UNCORRECTED) + [0]
        turns = _of_levels(numbers(passes, "passes"), levels)
        if turns is None or not all(n in range(PASSES + 1) for n in turns):
            raise UsageError(
                f"The passes must be a number from 0 to {PASSES}, or up to {levels} of them, one for each level, not "
                f"{passes!r}."
            )
        if kappa not in (0, 1):
            raise UsageError(f"kappa must be 0 or 1, not {kappa!r}.")
        self.exemplar, self.kappa = exemplar, kappa
        self.seed = seed & 0x7FFFFFFF
        self.reach, self.passes = [round(256 * r) for r in shaken], [int(n) for n in turns]

    def ranges(self, window: Range, level: int) -> list[Range]:
        """The range needed of each level, coarsest first, for a window of ``level``."""
        found = [window]
        for n in range(level, 0, -1):
            found.insert(0, found[0].wider(self.margin(n)).parents())
        return found

    def margin(self, level: int) -> int:
        """Places around a window of a level that are made with it, because correction and doubled heights read them."""
        return max(MARGIN // PASSES * self.passes[level], 2)

    def coordinates(self, window: Range, level: int | None = None) -> NDArray[np.int32]:
        """(rows, cols, 2) int32: x, y in the exemplar's plane of each place of a level's window (None: the finest)."""
        level = self.check(level)
        return self._levels(window, level)[level]

    def heights(self, window: Range, level: int | None = None) -> Integers:
        """(rows, cols) int32: heights in the exemplar's quanta above its base."""
        level = self.check(level)
        ranges, chosen, e = self.ranges(window, level), self._levels(window, level), self.exemplar
        x, y = (_folded(chosen[0][..., n], e.shape[1 - n]) for n in (0, 1))
        heights: Integers = e.stack[0][y, x]
        for n in range(1, level + 1):
            r, above = ranges[n], ranges[n - 1]
            out = np.empty(r.shape, np.int32)
            raised(
                heights, above.row0, above.col0, chosen[n], r.row0, r.col0, e.stack[n], e.stack[n - 1], e.step(n), out
            )
            heights = out
        return heights

    def metres(self, heights: Integers) -> NDArray[np.float32]:
        """Heights in metres, float32."""
        return (self.exemplar.base + heights * self.exemplar.quantum).astype(np.float32)

    def check(self, level: int | None) -> int:
        """Check a level; returns the finest one if it is None.

        Raises:
            UsageError: there is no such level.
        """
        top = self.exemplar.top
        if level is not None and not 0 <= level <= top:
            raise UsageError(f"The levels are 0 to {top}, not {level}.")
        return top if level is None else level

    def _levels(self, window: Range, level: int) -> list[NDArray[np.int32]]:
        """The coordinates of each level up to ``level``, on its range."""
        e = self.exemplar
        rows, cols = e.shape
        found = [self.first(self.ranges(window, level)[0])]
        ranges = self.ranges(window, level)
        for n in range(1, level + 1):
            wide, above, step = ranges[n].wider(self.margin(n)), ranges[n - 1], e.step(n)
            chosen = np.empty((*wide.shape, 2), np.int32)
            upsampled(
                found[-1], above.row0, above.col0, wide.row0, wide.col0, step, self.reach[n], n, self.seed, rows,
                cols, chosen,
            )  # fmt: skip
            other = np.empty_like(chosen)
            for k, (row, col) in enumerate(order(self.passes[n])):
                corrected(
                    chosen, e.features[n], e.similar[n], step, self.kappa, UNSTEERED, UNSTEERED,
                    (row + wide.row0) & 1, (col + wide.col0) & 1, 2 * (k + 1), other,
                )  # fmt: skip
                chosen, other = other, chosen
            found.append(np.ascontiguousarray(chosen[ranges[n].within(wide)]))
        return found

    def first(self, r: Range) -> NDArray[np.int32]:
        """Coordinates of the coarsest level: anywhere in the exemplar's plane."""
        rows, cols = self.exemplar.shape
        parent = np.zeros((*r.parents().shape, 2), np.int32)
        out = np.empty((*r.shape, 2), np.int32)
        # Moved at random over the whole plane: twice the longer side, in steps of one sample.
        upsampled(
            parent, r.parents().row0, r.parents().col0, r.row0, r.col0, 2 * max(rows, cols), 256, 0, self.seed, rows,
            cols, out,
        )  # fmt: skip
        return out


def _of_levels(some: tuple[float, ...], levels: int) -> tuple[float, ...] | None:
    """One number for each level: the last of the given ones is repeated; None if there are too many or none."""
    return some + some[-1:] * (levels - len(some)) if 0 < len(some) <= levels else None


def _folded(x: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    x = x % (2 * size)
    return np.where(x < size, x, 2 * size - 1 - x)
