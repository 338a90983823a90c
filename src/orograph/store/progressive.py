"""The codec *progressive*: every level of a store as its difference from a prediction from the level above it.

After the compressed pyramid of geometry clipmaps (Losasso and Hoppe 2004, section 5): a level is predicted from every
second of its samples by the tensor product of (-1, 9, 9, -1) / 16. These samples are those of the level above, *as
decoded*, and stay unchanged; for the others the difference is stored, in steps of twice the largest error. Predictions
may lie between these steps, in finer ones (``Packing.factor``). So each level is as close to the terrain as requested,
smooth ground costs next to nothing, and no sample is stored twice.

A chunk is predicted from its own samples alone, so it needs only one chunk of the level above. A shard of level 0
depends only on its own samples and the row and column that it shares with the next shards. Levels whose chunks are
larger than a shard use whole large steps.

If the index of the raster's last row is odd, the level above repeats that row (``level_shape``) and so provides it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.store.coding import MISSING, Numbers
from orograph.store.terrain import Heights


@dataclass(frozen=True, slots=True)
class Scheme:
    """How a level is predicted from the one above it.

    Attributes:
        factor: steps of heights per stored step.
        exact: whether heights and predictions are whole numbers of stored steps.
    """

    factor: int
    exact: bool


def known(shape: tuple[int, int], first: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """Whether the last row and column of a chunk are the array's and have odd indices: (1 or 0, 1 or 0).

    Args:
        shape: of the array. first, size: of the chunk.
    """
    row, col = (int(at + n == side and side % 2 == 0) for side, at, n in zip(shape, first, size, strict=True))
    return row, col


def coarse_of(numbers: Numbers, last: tuple[int, int]) -> Numbers:
    """The samples of a chunk that the level above also has."""
    rows, cols = ((n + 1) // 2 for n in numbers.shape)
    found = np.empty((rows + last[0], cols + last[1]), np.int32)
    found[:rows, :cols] = numbers[::2, ::2]
    if last[0]:
        found[rows, :cols] = numbers[-1, ::2]
    if last[1]:
        found[:rows, cols] = numbers[::2, -1]
    if last[0] and last[1]:
        found[rows, cols] = numbers[-1, -1]
    return found


def residuals(numbers: Numbers, last: tuple[int, int], scheme: Scheme) -> Numbers:
    """The stored differences of a chunk: in large steps, 0 where the level above has the sample.

    Args:
        numbers: (rows, cols), ``MISSING`` where missing. last: from ``known``.
    """
    from orograph.store.progressive_kernels import subtract

    found = np.empty(numbers.shape, np.int32)
    subtract(np.ascontiguousarray(numbers), coarse_of(numbers, last), *last, scheme.factor, scheme.exact, found)
    return found


def rebuilt(stored: Numbers, coarse: Numbers, last: tuple[int, int], scheme: Scheme) -> Numbers:
    """A chunk from its stored differences and the samples that the level above has."""
    from orograph.store.progressive_kernels import add

    found = np.empty(stored.shape, np.int32)
    add(np.ascontiguousarray(stored), np.ascontiguousarray(coarse), *last, scheme.factor, scheme.exact, found)
    return found


def closed(heights: Heights, step: float, levels: int, chunk: int, factor: int) -> Numbers:
    """The quantised heights: each level as close as possible, in large steps from its prediction.

    Args:
        heights: metres, NaN where missing; they begin at a multiple of ``chunk`` << (``levels`` - 1) samples, and end
            at such a multiple, or with the raster.
        step: the small step, metres.
        levels: the number of predicted levels; the one above them uses whole large steps.
    """
    from orograph._numba import read_only
    from orograph.store.progressive_kernels import settle

    coarse = _numbers(np.rint(_level(heights, levels).astype(np.float64) / step / factor) * factor)
    for level in range(levels - 1, -1, -1):
        here = _level(heights, level)
        found = np.empty(here.shape, np.int32)
        for row in range(0, here.shape[0], chunk):
            for col in range(0, here.shape[1], chunk):
                at = here[row : row + chunk, col : col + chunk]
                size = at.shape[0], at.shape[1]
                last = known((here.shape[0], here.shape[1]), (row, col), size)
                own = coarse[row // 2 :, col // 2 :][: (size[0] + 1) // 2 + last[0], : (size[1] + 1) // 2 + last[1]]
                part = np.empty(size, np.int32)
                given = read_only(np.ascontiguousarray(at))
                settle(given, step, np.ascontiguousarray(own), *last, factor, part)
                found[row : row + chunk, col : col + chunk] = part
        coarse = found
    return coarse


def _level(heights: Heights, level: int) -> Heights:
    """Every 2^level-th sample, and the last ones if they are others."""
    if all((n - 1) % (1 << level) == 0 for n in heights.shape):
        return heights[:: 1 << level, :: 1 << level]
    rows, cols = (np.minimum(np.arange(-((1 - n) >> level) + 1) << level, n - 1) for n in heights.shape)
    return heights[np.ix_(rows, cols)]


def _numbers(steps: NDArray[np.float64]) -> Numbers:
    return np.where(np.isnan(steps), MISSING, steps).astype(np.int32)
