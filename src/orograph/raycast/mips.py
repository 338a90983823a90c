"""Minimum and maximum mipmaps over the cells of a height field.

A *node* of level L covers 2^L × 2^L cells; its maximum bounds every sample on those cells, shared borders included, so
a ray above it meets nothing there (Tevs, Ihrke & Seidel 2008, *Maximum mipmaps for fast, accurate, and scalable dynamic
height field rendering*, §3). Maxima begin at level 1 and minima at level 2: together 5/12 of the heights' memory.
Heights are float32 metres; missing samples (NaN) take no part; a node without valid samples is (−inf, +inf).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orograph._numba import Function, kernel, read_only
from orograph.parallel import map_ordered, threads_for

MAX_LEVEL0 = 1
MIN_LEVEL0 = 2

LEAST_ROOT = MIN_LEVEL0
"""Every pyramid reaches this level, however small the field: it has a highest and a lowest height."""


@kernel
def _max_of_samples(heights, out, row0, row1):
    """Level 1: the 3 × 3 samples on 2 × 2 cells, node rows [row0, row1)."""
    rows, cols = heights.shape
    whole = (cols - 1) // 2
    for i in range(row0, row1):
        r0 = 2 * i
        r1 = min(r0 + 1, rows - 1)
        r2 = min(r0 + 2, rows - 1)
        column = np.empty(cols, np.float32)
        for c in range(cols):
            m = np.float32(-np.inf)
            a, b, d = heights[r0, c], heights[r1, c], heights[r2, c]
            m = a if a > m else m  # false for NaN
            m = b if b > m else m
            m = d if d > m else m
            column[c] = m
        for j in range(whole):
            out[i, j] = max(max(column[2 * j], column[2 * j + 1]), column[2 * j + 2])
        for j in range(whole, out.shape[1]):
            out[i, j] = max(column[2 * j], column[min(2 * j + 1, cols - 1)])


@kernel
def _min_of_samples(heights, out, row0, row1):
    """Level 2: the 5 × 5 samples on 4 × 4 cells, node rows [row0, row1)."""
    rows, cols = heights.shape
    whole = (cols - 1) // 4
    for i in range(row0, row1):
        column = np.full(cols, np.float32(np.inf))
        for r in range(4 * i, min(4 * i + 5, rows)):
            for c in range(cols):
                a = heights[r, c]
                column[c] = a if a < column[c] else column[c]
        for j in range(whole):
            m = min(min(column[4 * j], column[4 * j + 1]), min(column[4 * j + 2], column[4 * j + 3]))
            out[i, j] = min(m, column[4 * j + 4])
        for j in range(whole, out.shape[1]):
            m = np.float32(np.inf)
            for c in range(4 * j, min(4 * j + 5, cols)):
                m = min(m, column[c])
            out[i, j] = m


@kernel
def _halve(fine, coarse, sign):
    """The next level: the larger of up to four children (the smaller where ``sign`` is −1)."""
    rows, cols = fine.shape
    for i in range(coarse.shape[0]):
        r1 = min(2 * i + 1, rows - 1)
        for j in range(coarse.shape[1]):
            c1 = min(2 * j + 1, cols - 1)
            a, b = sign * fine[2 * i, 2 * j], sign * fine[2 * i, c1]
            c, d = sign * fine[r1, 2 * j], sign * fine[r1, c1]
            coarse[i, j] = sign * max(max(a, b), max(c, d))


@dataclass(frozen=True, slots=True)
class Mips:
    """Flat pyramids of one height field.

    Attributes:
        maxima, minima: float32 pools of all levels, row-major, coarsest last (the root is one node).
        max_offset, min_offset: int64 (levels,): where level L begins in its pool (−1 where it is not kept).
        cols: int64 (levels,): nodes per row at level L. ``levels`` is the root's level + 1.
    """

    maxima: NDArray[np.float32]
    minima: NDArray[np.float32]
    max_offset: NDArray[np.int64]
    min_offset: NDArray[np.int64]
    cols: NDArray[np.int64]

    @property
    def levels(self) -> int:
        return len(self.cols)

    @property
    def height_range(self) -> tuple[float, float]:
        """The lowest and the highest valid sample, metres."""
        return float(self.minima[-1]), float(self.maxima[-1])


def build_mips(heights: NDArray[np.float32], jobs: int | None = None) -> Mips:
    """Build the pyramids of ``heights`` (rows, cols), float32, C-contiguous, at least 2 × 2 samples."""
    rows, cols = heights.shape
    if rows < 2 or cols < 2:
        raise ValueError("a surface needs at least two rows and two columns of samples")
    heights = read_only(heights)
    shapes = []
    level = 0
    while True:
        nodes = (-(-(rows - 1) // 2**level), -(-(cols - 1) // 2**level))
        shapes.append(nodes)
        if nodes == (1, 1) and level >= LEAST_ROOT:
            break
        level += 1
    jobs = threads_for(jobs)

    def pyramid(first: int, sample_kernel: Function, sign: float) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        sizes = [0 if k < first else r * c for k, (r, c) in enumerate(shapes)]
        offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        pool = np.empty(sum(sizes), np.float32)
        views = [pool[o : o + s].reshape(shape) for o, s, shape in zip(offsets, sizes, shapes) if s]
        n = views[0].shape[0]
        step = max(16, -(-n // (jobs * 4)))
        blocks = [(a, min(a + step, n)) for a in range(0, n, step)]
        for _ in map_ordered(lambda b: sample_kernel(heights, views[0], *b), blocks, jobs):
            pass
        for fine, coarse in pairwise(views):
            _halve(fine, coarse, np.float32(sign))
        offsets[:first] = -1
        return pool, offsets

    maxima, max_offset = pyramid(MAX_LEVEL0, _max_of_samples, 1.0)
    minima, min_offset = pyramid(MIN_LEVEL0, _min_of_samples, -1.0)
    return Mips(maxima, minima, max_offset, min_offset, np.array([c for _, c in shapes], np.int64))
