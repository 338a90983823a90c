"""Horizons of a part of a raster, equal to the bit to those of the whole: the work of a task on a cluster.

A part is a rectangle of samples. For one way (axis and sense), its horizons follow from the heights of a window, which
is wider than the part by the sideways shift of lines in it, and from the points that lines have passed before its first
step: their hulls. With a radius, all of this is in a longer window, and nothing else is needed. Without one, parts of
the same steps form a row; a row needs the hulls that the row in front of it, towards the light, left at its last step.
Each part passes on the hulls of the lines that leave it through its last step: those at the lanes of its own samples
there.

Lines, steps and positions are those of the whole raster (``sweep_lines``); within a window, lanes and thus lines are
counted from its first lane, which is even. Lines that enter a window from its sides, not from the raster's border, lack
the points they passed before; they do not cross the part.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.lighting.sweep import Block, blocks_of, fold, passes_of
from orograph.lighting.sweep_hulls import I32, PAGE
from orograph.lighting.sweep_lines import Lines
from orograph.lighting.sweep_pass import Pass, Read, Terms, Values, pitch, reach_of
from orograph.lighting.sweep_profiles import F64, I64

_LOW = PAGE - 1
_SHIFT = PAGE.bit_length() - 1

Window = tuple[int, int, int, int]
"""row0, row1, col0, col1."""


class Hulls(NamedTuple):
    """The stacks of consecutive lines, from the top (the nearest point) down.

    Attributes:
        first: the first line. counts: (n,) points of each. position: (p,) int32; height: (p,) float64, of all points.
    """

    first: int
    counts: I64
    position: I32
    height: F64

    def packed(self, index: int) -> dict[str, NDArray[Any]]:
        """As arrays, for an azimuth."""
        named = {"first": np.array([self.first]), "counts": self.counts.astype(np.int32), "position": self.position}
        return {f"{name}.{index}": values for name, values in {**named, "height": self.height}.items()}

    @classmethod
    def unpacked(cls, arrays: Mapping[str, NDArray[Any]], index: int) -> Hulls:
        first, counts, position, height = (arrays[f"{n}.{index}"] for n in ("first", "counts", "position", "height"))
        return cls(int(first[0]), counts.astype(np.int64), position, height)


class Part:
    """A part of a raster, for one way.

    Args:
        way: lines of one axis and sense (``sweep.ways``). shape: (rows, cols) of the raster. terms: of the horizons.
        window: rows and columns of the part.

    Attributes:
        steps: [first, last) of the part. lanes: [first, last) of it; around: those of the heights that it needs.
    """

    def __init__(self, way: list[Lines], shape: tuple[int, int], terms: Terms, window: Window) -> None:
        row0, row1, col0, col1 = window
        self.way, self.shape, self.terms, self.window = way, shape, terms, window
        self.by_columns, self.backward = way[0].by_columns, way[0].backward
        lanes = way[0].lanes
        self.steps, self.lanes = ((col0, col1), (row0, row1)) if self.by_columns else ((row0, row1), (col0, col1))
        aside = 0
        for a in way:
            h0, h1 = self.steps if terms.radius is None else reach_of(a, terms.radius, *self.steps)[1:]
            aside = max(aside, abs(int(a.shift[h1 - 1] - a.shift[h0])))
        self.around = max(self.lanes[0] - aside - 4, 0) & ~1, min(self.lanes[1] + aside + 4, lanes)

    def before(self, size: int) -> range:
        """The parts of the row in front, ``size`` lanes wide each, that have hulls of lines that come here."""
        return range(self.around[0] // size, (self.around[1] - 1) // size + 1)

    def sweep(
        self, read: Read, hulls: Callable[[int], list[Hulls]], add: Callable[[Block], None], jobs: int, memory: int
    ) -> Iterator[tuple[int, Hulls]]:
        """Sweep it; returns the hulls that it passes on, by azimuth. Horizons within a radius have none.

        Args:
            read: heights of a window of the raster.
            hulls: azimuth → those from the parts in front of this one; [] for the first row.
            add: receives blocks of the part's own samples, counted from its first row and column, from any thread.
        """
        first = self.around[0]
        lines = [self._within(a) for a in self.way]
        passes = passes_of(lines, self.shape, self.terms, jobs, memory, span=self.steps)
        if self.terms.radius is None:
            for each in passes:
                _seed(each, first, hulls)

        def near(row0: int, row1: int, col0: int, col1: int) -> Values:
            if self.by_columns:
                return read(row0 + first, row1 + first, col0, col1)
            return read(row0, row1, col0 + first, col1 + first)

        fold(blocks_of(passes, near), lambda block, r0, r1: self._own(block, r0, r1, add), jobs)
        for each in passes if self.terms.radius is None else ():
            for a in each.lines:
                yield a.index, self._left(each, a)

    def _within(self, a: Lines) -> Lines:
        """The lines of an azimuth that pass the part, over the lanes around it alone."""
        part, (begin, end) = copy.copy(a), self.around
        part.lanes = end - begin
        ends = int(a.shift[self.steps[0]]), int(a.shift[self.steps[1] - 1])
        part.only = self.lanes[0] - 2 - max(ends) - begin, self.lanes[1] + 2 - min(ends) - begin
        return part

    def _own(self, block: Block, r0: int, r1: int, add: Callable[[Block], None]) -> None:
        """Pass on the rows [r0, r1) of a block that belong to the part."""
        begin, end = (at - self.around[0] for at in self.lanes)
        row, col, cols = block.row0 - self.window[0], 0, slice(begin, end)
        if self.by_columns:
            r0, r1 = max(r0, begin), min(r1, end)
            row, col, cols = -begin, block.col0 - self.window[2], slice(None)
        if r0 >= r1:
            return
        slopes = block.slopes[:, r0:r1, cols]
        wide = slopes.shape[2]
        padded = np.empty((*slopes.shape[:2], wide if self.by_columns else pitch(wide)), np.float32)
        padded[:, :, :wide] = slopes
        add(replace(block, row0=row + r0, row1=row + r1, col0=col, col1=col + wide, slopes=padded[:, :, :wide],
                    padded=padded))  # fmt: skip

    def _left(self, swept: Pass, a: Lines) -> Hulls:
        """The hulls of the lines at the part's lanes at its last step, from the pools of a pass."""
        shift = int(a.shift[self.steps[0] if self.backward else self.steps[1] - 1])
        first, last = (self.lanes[0] or -1) - shift, self.lanes[1] - shift
        counts = np.zeros(last - first, np.int64)
        positions, heights = [], []
        share, offset = swept.share, self.around[0]
        for s in range((first - offset) // share, (last - 1 - offset) // share + 1):
            pool = swept.pools.get((a.index, s))
            if pool is None:  # none of these lines is on the raster
                continue
            line0 = s * share + offset
            begin, end = max(first - line0, 0), min(last - line0, share)
            top, each = pool.top[begin + 1 : end + 1], counts[line0 + begin - first : line0 + end - first]
            count_points(top, pool.link, each)
            position, height = np.empty(each.sum(), np.int32), np.empty(each.sum())
            take_points(top, pool.link, pool.position, pool.height, position, height)
            positions.append(position)
            heights.append(height)
        some = np.concatenate([np.empty(0, np.int32), *positions]), np.concatenate([np.empty(0), *heights])
        return Hulls(first, counts, *some)


def _seed(swept: Pass, offset: int, hulls: Callable[[int], list[Hulls]]) -> None:
    """Initialise the lines of a pass with the points they have passed.

    Args:
        offset: the first line that is line 0 of the pass.
    """
    for a in swept.lines:
        given = [(one, np.concatenate([[0], np.cumsum(one.counts)])) for one in hulls(a.index)]
        first, last = a.touched(*swept.bands[0]) if given else (0, 0)
        for s in range(first // swept.share, -(-last // swept.share)):
            line0 = s * swept.share + offset - 1  # the line before the share also has a stack
            pool = None
            for one, ends in given:
                begin, end = max(line0, one.first), min(line0 + swept.share + 1, one.first + len(one.counts))
                if begin >= end or ends[end - one.first] == ends[begin - one.first]:
                    continue
                counts = one.counts[begin - one.first : end - one.first]
                points = slice(ends[begin - one.first], ends[end - one.first])
                pool = pool or swept.pool()
                pool.grow(int((counts // PAGE + 1).sum()), False)
                put_points(
                    counts, one.position[points], one.height[points], pool.top[begin - line0 : end - line0],
                    pool.link, pool.position, pool.height, pool.free,
                )  # fmt: skip
            if pool is not None:
                swept.pools[a.index, s] = pool


@kernel
def count_points(top: I64, link: I64, counts: I64) -> None:
    """The numbers of points of stacks."""
    for b in range(len(top)):
        t, count = top[b], 0
        while t >= 0:
            count += 1
            t = t - 1 if t & _LOW else link[t >> _SHIFT]
        counts[b] = count


@kernel
def take_points(top: I64, link: I64, position: I32, height: F64, positions: I32, heights: F64) -> None:
    """The points of stacks, each from its top down, one stack after the other."""
    k = 0
    for b in range(len(top)):
        t = top[b]
        while t >= 0:
            positions[k], heights[k] = position[t], height[t]
            k += 1
            t = t - 1 if t & _LOW else link[t >> _SHIFT]


@kernel
def put_points(
    counts: I64, positions: I32, heights: F64, top: I64, link: I64, position: I32, height: F64, free: I64
) -> None:
    """Push points onto empty stacks, in the form of ``take_points``; there must be enough free pages."""
    begin = 0
    for b in range(len(counts)):
        t = np.int64(-1)
        for k in range(begin + counts[b] - 1, begin - 1, -1):
            u = t
            t += 1
            if u < 0 or not t & _LOW:
                page = free[free[0]]
                free[0] -= 1
                link[page] = u
                t = page << _SHIFT
            position[t], height[t] = positions[k], heights[k]
        top[b] = t
        begin += counts[b]
