"""A prepared example terrain: its heights as integers, smoothed level by level, and its similar places.

The Gaussian stack has every level at full resolution (Lefebvre & Hoppe 2005, §3.1): level L is the exemplar, and level
l − 1 is level l smoothed by the binomial filter 1 4 6 4 1 with its taps 2^(L − l) samples apart. The quantity compared
at level l is the height of a place above the level three octaves coarser, in 1/341 of the root mean square: the shape
of the ground at that scale, not its absolute height. Everything is integer arithmetic, and the same on every machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.synthesis.similar import similar_places

MOST = 1 << 22
"""Maximum samples of an exemplar, which takes some 100 bytes per sample."""

SMALLEST = 32
"""The fewest samples along a side of an exemplar."""

OCTAVES = 3
"""Octaves between a level and the coarser one from which its heights are measured."""

ROUNDS = 6
"""Rounds of propagation in the search for similar places."""

Integers = NDArray[np.int32]
Features = NDArray[np.int16]


@dataclass(frozen=True, slots=True, eq=False)
class Exemplar:
    """A prepared example; make one with ``Exemplar.of``.

    Attributes:
        stack: of each level, coarsest first, heights (rows, cols) int32 in ``quantum`` metres above ``base``.
        features: of each level, the compared quantity, (rows, cols) int16, within ±1023.
        similar: of each level, for each place a similar one, (rows, cols, 2) int16: x, y.
        quantum, base: metres.
    """

    stack: tuple[Integers, ...]
    features: tuple[Features, ...]
    similar: tuple[Features, ...]
    quantum: float
    base: float

    @classmethod
    def of(
        cls, heights: NDArray[np.floating], name: str = "the exemplar", jobs: int | None = None,
        progress: Progress = SILENT, *, relative: bool = True,
    ) -> Exemplar:  # fmt: skip
        """Prepare heights, (rows, cols) in metres.

        Args:
            relative: compare heights above coarser levels; otherwise compare values directly, which suits colours.

        Raises:
            UsageError: they are too few or too many, some are missing, or all are equal.
        """
        check(heights, name)
        low, high = float(heights.min()), float(heights.max())
        quantum = 2.0 ** math.ceil(math.log2((high - low) / 2**20))
        base = math.floor(low / quantum) * quantum
        stack = [np.rint((heights.astype(np.float64) - base) / quantum).astype(np.int32)]
        top = max(1, math.floor(math.log2(min(heights.shape) / 2)))
        for level in range(top, 0, -1):
            stack.insert(0, smoothed(stack[0], 1 << (top - level)))
        features = tuple(_features(stack, level, OCTAVES if relative else top) for level in range(top + 1))
        similar = []
        with progress.task(f"Searching for similar places in {name}", total=top + 1) as task:
            work = map_ordered(lambda level: _similar(features[level], 1 << (top - level)), range(top + 1), jobs)
            for found in work:
                similar.append(found)
                task.advance()
        return cls(tuple(stack), features, tuple(similar), quantum, base)

    @property
    def shape(self) -> tuple[int, int]:
        rows, cols = self.stack[0].shape
        return rows, cols

    @property
    def top(self) -> int:
        """The finest level, whose places have the spacing of the exemplar's samples."""
        return len(self.stack) - 1

    def step(self, level: int) -> int:
        """Samples of the exemplar between places of a level."""
        return 1 << (self.top - level)


def check_size(shape: tuple[int, ...], name: str) -> None:
    """Raise UsageError for an example with too few or too many samples.

    Raises:
        UsageError: see ``Exemplar.of``.
    """
    if len(shape) != 2 or min(shape) < SMALLEST:
        raise UsageError(
            f"An example needs at least {SMALLEST} × {SMALLEST} samples; this one has {' × '.join(map(str, shape))}.",
            path=name, remedy="Use a larger piece of terrain.",
        )  # fmt: skip
    if math.prod(shape) > MOST:
        raise UsageError(
            f"An example may have at most {MOST:,} samples; this one has {math.prod(shape):,}.",
            path=name, remedy="Cut out a piece, e.g. with gdal_translate -srcwin 0 0 2000 2000.",
        )  # fmt: skip


def check(heights: NDArray[np.floating], name: str) -> None:
    """Raise UsageError for heights that cannot serve as an example.

    Raises:
        UsageError: see ``Exemplar.of``.
    """
    check_size(heights.shape, name)
    missing = int(heights.size - np.isfinite(heights).sum())
    if missing:
        raise UsageError(
            f"An example must have a height everywhere; {missing:,} of its {heights.size:,} samples have none.",
            path=name, remedy="Cut out a piece without voids (gdal_translate -srcwin), or fill them.",
        )  # fmt: skip
    if heights.min() == heights.max():
        raise UsageError("Level ground cannot serve as an example.", path=name, remedy="Take another.")


def smoothed(heights: Integers, step: int) -> Integers:
    """Integers smoothed by 1 4 6 4 1 along both axes, taps ``step`` samples apart, mirrored at the borders."""
    for axis in (0, 1):
        wide = np.pad(heights, [(2 * step, 2 * step) if n == axis else (0, 0) for n in (0, 1)], mode="symmetric")
        n = heights.shape[axis]
        a, b, c, d, e = (np.take(wide, range(k * step, k * step + n), axis).astype(np.int64) for k in range(5))
        heights = ((a + 4 * b + 6 * c + 4 * d + e + 8) >> 4).astype(np.int32)
    return heights


def _features(stack: list[Integers], level: int, octaves: int) -> Features:
    """Heights of places above the level some octaves coarser; above the mean if there are no more octaves."""
    fine = stack[level].astype(np.int64)
    band = fine - (stack[max(level - octaves, 0)] if level and octaves < len(stack) - 1 else fine.sum() // fine.size)
    spread = max(1, math.isqrt(int((band * band).sum()) // band.size))
    return np.asarray(np.clip(band * 341 // spread, -1023, 1023), np.int16)


def _similar(features: Features, step: int) -> Features:
    rows, cols = features.shape
    apart = max(2, min(rows, cols) // 20)
    found = np.empty((rows, cols, 2), np.int16)
    similar_places(features, step, apart, ROUNDS, step, found)
    return found
