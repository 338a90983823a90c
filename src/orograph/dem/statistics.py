"""The lowest, the highest and the number of valid heights of a raster of any size, in bounded memory and time.

Up to ``EXACT`` samples, every one is read, in windows of whole blocks, by several threads. For larger rasters (or files
that only claim to be so large), ``WINDOWS`` windows spread evenly over the raster are read, and the result is marked
as a sample. Units: metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.dem.source import Source
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress

EXACT = 1 << 29
"""Samples up to which statistics are exact by default (23170²: a few seconds)."""

WINDOWS = 64
_SIDE = 512  # samples along a window of a sampled raster
_STRIP = 1 << 22  # samples of a window of a raster that is read whole

Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Statistics:
    """What is known of a raster's heights.

    Attributes:
        low, high: metres; NaN if no sample is valid.
        valid_fraction: of the samples read, 0 to 1.
        slope: the mean of |height difference| / spacing between neighbours in a row (of some); NaN if unknown.
        exact: whether every sample was read.
    """

    low: float
    high: float
    valid_fraction: float
    slope: float
    exact: bool


def statistics(
    source: Source, spacing: float, *, exact: bool | None = None, jobs: int | None = None, progress: Progress = SILENT
) -> Statistics:
    """Statistics of a raster.

    Args:
        spacing: metres between neighbours in a row.
        exact: read every sample; None: if there are at most ``EXACT``.
        jobs: threads.

    Raises:
        ReadError: the file is damaged.
    """
    rows, cols = source.shape
    whole = rows * cols <= EXACT if exact is None else exact
    boxes = list(_strips(source)) if whole else list(_spread(source))

    def measure(box: Box) -> tuple[float, float, int, float, int, int]:
        heights = source.read(*box)
        size = heights.size
        low, high = float(np.fmin.reduce(heights, axis=None)), float(np.fmax.reduce(heights, axis=None))
        valid = int(np.count_nonzero(heights == heights))
        steps = np.abs(np.diff(heights[: max(1, 65536 // heights.shape[1])].astype(np.float64), axis=1))
        known = ~np.isnan(steps)
        return low, high, valid, float(steps[known].sum()), int(known.sum()), size

    low, high, valid, rise, pairs, size = math.nan, math.nan, 0, 0.0, 0, 0
    with progress.task(f"Reading {source.name}", total=len(boxes)) as task:
        for found in map_ordered(measure, boxes, jobs):
            low, high = float(np.fmin(low, found[0])), float(np.fmax(high, found[1]))
            valid, rise, pairs, size = valid + found[2], rise + found[3], pairs + found[4], size + found[5]
            task.advance()
    return Statistics(low, high, valid / size, rise / pairs / spacing if pairs else math.nan, whole)


def _strips(source: Source) -> Iterator[Box]:
    """Windows of whole blocks that cover the raster."""
    (rows, cols), (high, wide) = source.shape, source.block
    across = min(cols, max(wide, _STRIP // max(1, min(high, rows)) // wide * wide)) if cols > _STRIP else cols
    down = max(high, _STRIP // across // high * high)
    for r in range(0, rows, down):
        for c in range(0, cols, across):
            yield r, min(r + down, rows), c, min(c + across, cols)


def _spread(source: Source) -> Iterator[Box]:
    """About ``WINDOWS`` windows spread evenly over the raster, first and last row and column included."""
    rows, cols = source.shape
    down = max(1, min(int(math.sqrt(WINDOWS)), rows // _SIDE))
    across = max(1, min(WINDOWS // down, cols // _SIDE))
    down = max(down, min(WINDOWS // across, rows // _SIDE, WINDOWS))
    for r in _starts(rows, down):
        for c in _starts(cols, across):
            yield r, min(r + _SIDE, rows), c, min(c + _SIDE, cols)


def _starts(length: int, count: int) -> NDArray[np.int64]:
    last = max(0, length - _SIDE)
    starts: NDArray[np.int64] = np.array(sorted({*np.linspace(0, last, max(1, count)).astype(np.int64)}))
    return starts
