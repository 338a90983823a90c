"""One pass of ``sweep`` over a raster: bands for several azimuths that step along one axis in one sense.

A pass determines the width of its bands and the number of azimuths that share it, so that memory suffices. For each
band it fetches the heights, and hands out the work that makes the slopes: independent pieces, for threads. Stacks of
lines wait in pools from band to band.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.lighting.sweep_hulls import PAGE, Working, working
from orograph.lighting.sweep_kernels import Course, sweep_lines, sweep_windows
from orograph.lighting.sweep_lines import Lines, Pool, taken
from orograph.lighting.sweep_profiles import GROUP, Swath, turn
from orograph.lighting.sweep_samples import Target

Values = NDArray[np.float32]
Read = Callable[[int, int, int, int], Values]
Work = Callable[[], object]

_BAND = 256
"""Steps of a band: the tiles of a store."""
_NARROW = 64
"""Steps of a band when memory is short; below this, fewer azimuths share a pass."""
_CACHE = 16 << 20
"""Slopes of two bands that fit about into the processor's cache until they are used."""
_CLASH = 128
"""Rows whose length is a multiple of this number of samples share cache sets."""


def pitch(cols: int) -> int:
    """Samples from one row to the next in memory.

    It is an odd number of cache lines, so that rows do not share cache sets, as they do a power of two apart.
    """
    return (-(-cols // GROUP) | 1) * GROUP


def aligned(samples: int) -> Values:
    """Room for so many samples (float32) that begins at a cache line."""
    space = np.empty(samples + GROUP, np.float32)
    begin = -space.ctypes.data % (4 * GROUP) // 4
    return space[begin : begin + samples]


@dataclass(frozen=True, slots=True)
class Strip:
    """Heights of a band for sweeping.

    Attributes:
        flat: steps one after the other, neighbouring lanes side by side.
        wide: samples from one step to the next.
        first: their first step.
        space: their memory, to be reused; None: the reader's own.
    """

    flat: Values
    wide: int
    first: int
    space: Values | None


class Terms(NamedTuple):
    """The kind of a horizon, as in ``sweep.horizons``."""

    lowest: float = 0.0
    below: bool = False
    radius: float | None = None
    curvature: float = 0.0


class Pass:
    """A pass over the raster for as many azimuths of a common axis and sense as memory allows, from the first on.

    Args:
        group: lines of the azimuths.
        shape: (rows, cols) of the raster.
        terms: of the horizons. jobs, memory, band: as for ``sweep.horizons``.
        span: the steps [first, last) to sweep, whose stacks are left in ``pools``; None: all of them.

    Attributes:
        lines: of the azimuths in this pass. indices: of these azimuths.
        bands: (step0, step1), away from the light.
        ahead: whether there is memory to fetch heights before the previous band is done.
        samples: of a buffer for the slopes of a band, including padding.

    Raises:
        UsageError: the radius takes more memory than there is.
    """

    def __init__(
        self,
        group: list[Lines],
        shape: tuple[int, int],
        terms: Terms,
        jobs: int,
        memory: int,
        band: int | None = None,
        span: tuple[int, int] | None = None,
    ) -> None:
        lowest, below, radius, curvature = terms
        self.shape, self.lowest, self.below, self.curvature, self.jobs = shape, float(lowest), below, curvature, jobs
        self.by_columns, self.backward = group[0].by_columns, group[0].backward
        self.lanes, self.steps = group[0].lanes, group[0].steps
        reach = 0 if radius is None else max(max(int(radius * a.scale + 1e-9), 1) for a in group)
        reach = min(reach, self.steps)
        # A third of the memory is for bands' heights and slopes, a third for stacks; the rest is for the caller.
        third, step = memory // 3, 4 * pitch(self.lanes)

        points = max(a.points for a in group)

        def needed(width: int, count: int, strips: int = 3) -> int:
            halo = min(2 * reach, self.steps)
            # Heights of a band and of the next, read and copied; slopes of a band and of the one before.
            own = jobs * (9 * points + 8) * (GROUP + 1) * (width + halo)
            return step * ((width + halo) * strips + 2 * count * width) + own

        width = band or min(max(_BAND, reach, _CACHE // (2 * step * len(group)) // _BAND * _BAND), self.steps)
        count = len(group)
        while band is None and count > 1 and needed(width, count) > third:
            if width > max(_NARROW, reach):
                width = max(width // 2, _NARROW, reach)
            else:
                count -= 1
        while band is None and width > max(16, reach // 8) and needed(width, count) > third:
            width //= 2
        self.ahead = band is not None or needed(width, count) <= third
        if reach and needed(width, count, 2) > memory:
            raise UsageError(
                f"A radius of {radius:g} m is {reach} samples of a terrain {self.lanes} samples wide, for which "
                f"{memory >> 20} MiB of memory are not enough.",
                remedy="Allow more memory (`max_memory`), or omit the radius, which takes less.",
            )
        self.lines, self.radius, self.stacks = group[:count], radius, third
        self.indices = np.array([a.index for a in self.lines])
        begin, end = span or (0, self.steps)
        self.bands = [(s, min(s + width, end)) for s in range(begin, end, width)]
        self.hands_on = span is not None
        if self.backward:
            self.bands.reverse()
        self.samples = count * min(width, self.steps) * self.pitch(self.lanes)
        # Shares of the lines, counted from line 0: small enough that all threads get some.
        share = -(-self.lanes * count // (16 * jobs))
        self.share = min(max(8 * GROUP, share + -share % GROUP), 512)
        self.pools: dict[tuple[int, int], Pool] = {}
        self._spare: list[Pool] = []
        self._working: list[Working] = []

    def pitch(self, cols: int) -> int:
        """Samples from one row of slopes to the next."""
        return cols if self.by_columns else pitch(cols)

    def begin(self, spare: list[Pool]) -> None:
        """Reuse pools of earlier passes, and leave them for later ones."""
        if sum(p.size for p in spare) > self.stacks // 2:
            spare.clear()
        self._spare = spare

    def window(self, s0: int, s1: int) -> tuple[int, int, int, int]:
        """Rows and columns (row0, row1, col0, col1) of steps."""
        return (0, self.lanes, s0, s1) if self.by_columns else (s0, s1, 0, self.lanes)

    def fetch(self, read: Read, s0: int, s1: int, spaces: list[Values]) -> Strip:
        """The heights for the slopes of a band; ``spaces`` are buffers of earlier strips."""
        first, last = s0, s1
        if self.radius is not None:
            reaches = [reach_of(a, self.radius, s0, s1) for a in self.lines]
            first, last = min(h0 for _, h0, _ in reaches), max(h1 for _, _, h1 in reaches)
        if self.backward:  # cells reach one step farther towards the light
            last = min(last + 1, self.steps)
        else:
            first = max(first - 1, 0)
        heights = read(*self.window(first, last))
        if heights.dtype != np.float32 or heights.strides[1] != 4 or heights.strides[0] < 4 * heights.shape[1]:
            heights = np.ascontiguousarray(heights, np.float32)
        rows, cols = heights.shape
        stride = heights.strides[0] // 4
        flat = np.lib.stride_tricks.as_strided(heights, ((rows - 1) * stride + cols,), (4,), writeable=False)
        if (stride % _CLASH or len(self.lines) == 1) and not self.by_columns and not self.below:
            return Strip(flat, stride, first, None)
        count, lanes = (cols, rows) if self.by_columns else (rows, cols)
        wide = pitch(lanes)
        space = taken(spaces, lambda: aligned(count * wide))
        if len(space) < count * wide:
            space = aligned(count * wide)
        steps = space[: count * wide].reshape(count, wide)[:, :lanes]
        if self.by_columns:
            turn(flat, stride, rows, cols, space, wide)
        else:
            steps[:] = heights
        if self.below:
            np.negative(steps, out=steps)
        flat = space[: count * wide].view()
        flat.flags.writeable = False  # read-only, like heights that are not copied, so that kernels are compiled once
        return Strip(flat, wide, first, space)

    def work(self, strip: Strip, s0: int, s1: int, slopes: Values) -> tuple[list[Work], list[Work]]:
        """Functions that make the slopes (k, rows, ≥ cols) of a band, in any order, in two parts.

        A part needs the result of the same part of the band before, and nothing of the other.
        """
        make = self._unlimited if self.radius is None else self._limited
        parts: tuple[list[Work], list[Work]] = [], []
        for a, s, work in make(strip, s0, s1, slopes):
            parts[(a.index + s) % 2].append(work)
        return parts

    def _shares(self, s0: int, s1: int, lines: Sequence[Lines]) -> list[tuple[Lines, int]]:
        work: list[tuple[Lines, int]] = []
        for a in lines:
            first, last = a.touched(s0, s1)
            work += [(a, s) for s in range(first // self.share, -(-last // self.share))]
        return work

    def _unlimited(self, strip: Strip, s0: int, s1: int, slopes: Values) -> list[tuple[Lines, int, Work]]:
        width = s1 - s0
        work = self._shares(s0, s1, self.lines)
        last = (s0, s1) == self.bands[-1] and not self.hands_on
        keep = {(a.index, s) for a, s in work}
        for key in list(self.pools):  # other threads may be adding theirs
            if key not in keep:  # lines that have left the raster
                del self.pools[key]
        on_disk = sum(p.size for p in list(self.pools.values())) > self.stacks
        place = {a.index: k for k, a in enumerate(self.lines)}
        longest, points = max(end - begin for begin, end in self.bands), max(a.points for a in self.lines)

        def run(a: Lines, s: int) -> None:
            pool = self.pools.get((a.index, s)) or self.pool()
            memory = taken(self._working, lambda: working(longest, points))
            swath, course = self._swath(strip, a, s0, s1), self._course(a, s0)
            target = self._target(slopes[place[a.index]])
            done = 0
            while True:
                done = sweep_lines(swath, course, s * self.share, self.share, done, pool.stacks, memory, target)
                if done >= self.share:
                    break
                pool.grow((GROUP + 1) * (a.points * width // PAGE + 2) + (0 if last else self.share), on_disk)
            self._working.append(memory)
            if last:
                self.pools.pop((a.index, s), None)
                if not pool.release:
                    self._spare.append(pool)
                return
            if pool.release:
                pool.release()
            self.pools[a.index, s] = pool

        return [(a, s, partial(run, a, s)) for a, s in work]

    def pool(self) -> Pool:
        """An empty pool, from any thread."""
        pool = taken(self._spare, Pool)
        pool.clear(self.share)
        return pool

    def _swath(self, strip: Strip, a: Lines, s0: int, s1: int) -> Swath:
        return Swath(
            strip.flat, (s0 - strip.first) * strip.wide, strip.wide, self.lanes, a.shift[s0:s1], a.part[s0:s1],
            a.own_cell(s0, self.curvature),
        )  # fmt: skip

    def _course(self, a: Lines, s0: int) -> Course:
        return Course(a.backward, a.position(s0), a.scale, self.lowest, self.curvature)

    def _target(self, slopes: Values) -> Target:
        """Room for the slopes (rows, cols) of an azimuth."""
        lane, step = (slopes.shape[1], 1) if self.by_columns else (1, slopes.shape[1])
        return Target(slopes.reshape(-1), lane, step)

    def _limited(self, strip: Strip, s0: int, s1: int, slopes: Values) -> list[tuple[Lines, int, Work]]:
        work: list[tuple[Lines, int, Work]] = []
        for k, a in enumerate(self.lines):
            assert self.radius is not None
            reach, h0, h1 = reach_of(a, self.radius, s0, s1)
            sweep = partial(
                sweep_windows, self._swath(strip, a, h0, h1), self._course(a, h0), lines=self.share, reach=reach,
                skip=s0 - h0, own=s1 - s0, target=self._target(slopes[k]),
            )  # fmt: skip
            steps = h1 - h0, a.points
            work += [(a, s, partial(_at_line, sweep, s * self.share, *steps)) for _, s in self._shares(s0, s1, [a])]
        return work


def reach_of(a: Lines, radius: float, s0: int, s1: int) -> tuple[int, int, int]:
    """A radius in steps, and the steps whose heights determine the slopes of steps [s0, s1): whole blocks of that many.

    Steps of different azimuths have different lengths in metres, so their radii differ in steps.
    """
    reach = min(max(int(radius * a.scale + 1e-9), 1), a.steps)
    first = a.position(s1 - 1 if a.backward else s0)
    begin = max((first - reach) // reach * reach, 0)  # a whole block in front of the reach
    return reach, *((s0, a.steps - begin) if a.backward else (begin, s1))


def _at_line(sweep: Callable[..., None], line0: int, steps: int, points: int) -> None:
    sweep(line0=line0, work=working(steps, points))
