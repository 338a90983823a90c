"""Horizons of a whole raster, out of core: sweeps over bands of rows or of columns, several azimuths at a time.

For one azimuth the raster is covered by parallel lines in that direction, one sample apart. A line steps along the axis
it is closer to (its *major* axis: columns for light from the east, rows from the north) one sample at a time; across it
heights are interpolated linearly between the two samples on either side. Exact is the horizon at each point of such a
line for the profile through that line's points. A sample lies between two lines, on the same major step and less than
one sample from either; its horizon is interpolated linearly between theirs (on a plane that is exact again, which the
nearest line alone would not be). Where a line runs through the samples themselves (azimuths along rows, columns and
diagonals) there is nothing to interpolate. Missing samples (NaN) are transparent; beside one, the other sample stands
for both.

Azimuths that step along the same axis in the same sense share a pass over the raster, away from the light: a band of
rows or columns is read once, swept for all of them, and handed on before the next. What the next band must know of all
that went before is the stack of each line (``sweep_kernels``): a few points as a rule. Where they are many (a sea on a
round body, where every sample is on the hull) and memory is short, stacks go to a scratch file.

Slopes are tangents of elevation angles above the plane the raster lies in. The terrain ends at the raster's border, and
behind it lies a level horizon. Azimuths are degrees clockwise from (grid) north towards the light. Nothing depends on
bands, threads or memory, to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from orograph.errors import UsageError
from orograph.geo.ellipsoid import Ellipsoid
from orograph.light.sweep_kernels import GROUP, PAGE, sweep_lines, sweep_windows, working
from orograph.light.sweep_lines import Lines, Pool, taken
from orograph.parallel import cpu_count, for_each
from orograph.progress import SILENT, Progress

Values = NDArray[np.float32]
Read = Callable[[int, int, int, int], Values]

EARTH = 6_371_008.8
"""Mean radius, metres (IUGG), where no CRS names a body."""

_BAND = 256
"""Steps of a band: the tiles of a store."""
_CACHE = 16 << 20
"""Slopes of a band that are still in the processor's cache, more or less, when they are used."""
_CLASH = 128
"""Rows that are a multiple of so many samples long share their places in the cache."""
_COPIED = 16
"""Rows that are copied at a time."""


@dataclass(frozen=True, slots=True)
class Block:
    """The horizons of a window of samples, in some of the azimuths.

    Attributes:
        row0, row1, col0, col1: the window: whole rows or whole columns.
        azimuths: (k,) indices into the azimuths asked for.
        slopes: (k, rows, cols) float32, tangents of the horizon's elevation; NaN where heights are. Valid until the
            next block is asked for.
        ends: whether it is the last of its pass: these azimuths are complete.
        padded: (k, rows, ≥ cols) the same slopes and what lies between their rows in memory, C-contiguous, for kernels.
    """

    row0: int
    row1: int
    col0: int
    col1: int
    azimuths: NDArray[np.int64]
    slopes: Values
    ends: bool
    padded: Values


def pitch(cols: int) -> int:
    """Samples from one row to the next in memory: an odd number of cache lines, so that rows do not share their places
    in the cache, as they do a power of two apart."""
    return (-(-cols // GROUP) | 1) * GROUP


def aligned(samples: int) -> Values:
    """Room for so many samples (float32) that begins with a cache line."""
    space = np.empty(samples + GROUP, np.float32)
    begin = -space.ctypes.data % (4 * GROUP) // 4
    return space[begin : begin + samples]


def curvature_of(crs: CRS | None, refraction: float = 0.13) -> float:
    """Curvature, per metre, of a body's surface relative to the rays of light over it: (1 − k) / r.

    Args:
        crs: whose ellipsoid's mean radius (2a + b) / 3 is r; None, or one without an ellipsoid: the Earth's.
        refraction: k, the curvature of a ray of light relative to that of the ground: 0.13 in survey practice (Gauss);
            0 where there is no air.
    """
    radius = EARTH
    if crs is not None and crs.ellipsoid is not None:
        body = Ellipsoid.of(crs)
        radius = (2 * body.a + body.b) / 3
    return (1.0 - refraction) / radius


def horizons(
    read: Read,
    shape: tuple[int, int],
    linear: NDArray[np.float64],
    azimuths: NDArray[np.float64],
    *,
    lowest: float = 0.0,
    below: bool = False,
    radius: float | None = None,
    curvature: float = 0.0,
    jobs: int | None = None,
    memory: int = 1 << 30,
    progress: Progress = SILENT,
    what: str = "Sweeping horizons",
    skip: Collection[int] = (),
    band: int | None = None,
) -> Iterator[Block]:
    """Sweep a raster in every azimuth.

    Args:
        read: (row0, row1, col0, col1) → heights of a window, float32 metres, NaN where missing.
        shape: (rows, cols) of the raster.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.
        azimuths: degrees clockwise from north.
        lowest: slopes are at least this: 0 is a level horizon, -inf keeps what looks down (-inf at the border).
        below: of the terrain turned upside down.
        radius: metres beyond which nothing occludes; None: unlimited. Counted in whole steps of a line, at least one.
        curvature: of the body, relative to rays of light, per metre (``curvature_of``); 0: flat.
        jobs: threads; None: all processors.
        memory: bytes for bands, slopes and stacks.
        what: to call it on the progress line.
        skip: indices of azimuths to leave out.
        band: steps of a band, in samples (default: chosen from ``memory``).

    Yields:
        Blocks: every sample once with every azimuth. At each sample azimuths come in the same order, whatever the bands
        and however many share a pass.

    Raises:
        UsageError: the shape is empty, the cells degenerate, or the radius takes more memory than there is.
    """
    cells = np.asarray(linear, np.float64)
    if min(shape) < 1:
        raise UsageError(f"Horizons need heights of shape (rows, cols), not {shape}.")
    if cells.shape != (2, 2) or not np.isfinite(cells).all() or abs(np.linalg.det(cells)) == 0:
        raise UsageError("Horizons need the 2 × 2 linear part of a geotransform, in metres, that can be inverted.")
    jobs = jobs or cpu_count()
    lines = [Lines(k, float(a), cells, shape) for k, a in enumerate(azimuths) if k not in skip]
    # The same order in all cases: sums over azimuths are the same to the bit.
    lines.sort(key=lambda a: (a.by_columns, a.backward, a.index))
    passes: list[_Pass] = []
    for by_columns in (False, True):
        for backward in (False, True):
            group = [a for a in lines if (a.by_columns, a.backward) == (by_columns, backward)]
            while group:
                made = _Pass(group, shape, lowest, below, radius, curvature, jobs, memory, band)
                passes.append(made)
                group = group[len(made.lines) :]
    # Memory that is used again costs no page faults, which threads wait for one another in.
    slopes = aligned(max((p.samples for p in passes), default=0))
    spare: list[Pool] = []
    with progress.task(what, total=sum(len(p.bands) * len(p.lines) for p in passes)) as task:
        for each in passes:
            for block in each.run(read, slopes, spare):
                yield block
                task.advance(len(each.lines))


class _Pass:
    """A pass over the raster for the first of some azimuths with a common axis and sense, as many as memory allows."""

    def __init__(
        self,
        group: list[Lines],
        shape: tuple[int, int],
        lowest: float,
        below: bool,
        radius: float | None,
        curvature: float,
        jobs: int,
        memory: int,
        band: int | None,
    ) -> None:
        self.shape, self.lowest, self.below, self.curvature, self.jobs = shape, float(lowest), below, curvature, jobs
        self.by_columns, self.backward = group[0].by_columns, group[0].backward
        self.lanes, self.steps = group[0].lanes, group[0].steps
        reach = 0 if radius is None else max(max(int(radius * a.scale + 1e-9), 1) for a in group)
        reach = min(reach, self.steps)
        # A third of the memory for a band's heights and slopes, a third for stacks; the rest is what their user needs.
        third, step = memory // 3, 4 * self._pitch(self.lanes)

        def needed(width: int, count: int) -> int:
            halo = min(2 * reach, self.steps)
            return step * ((width + halo) * 2 + count * width) + jobs * 12 * (GROUP + 1) * (width + halo)

        width = band or min(max(_BAND, reach, _CACHE // (step * len(group)) // _BAND * _BAND), self.steps)
        count = len(group)
        while band is None and count > 1 and needed(width, count) > third:
            if width > max(_BAND, reach):
                width = max(width // 2, _BAND, reach)
            else:
                count -= 1
        while band is None and width > max(16, reach // 8) and needed(width, count) > third:
            width //= 2
        if reach and needed(width, count) > memory:
            raise UsageError(
                f"A radius of {radius:g} m is {reach} samples of a terrain {self.lanes} samples wide, for which "
                f"{memory >> 20} MiB of memory are not enough.",
                remedy="Allow more memory (--max-memory), or leave the radius unlimited, which takes less.",
            )
        self.lines, self.radius, self.stacks = group[:count], radius, third
        self.bands = [(s, min(s + width, self.steps)) for s in range(0, self.steps, width)]
        if self.backward:
            self.bands.reverse()
        # Shares of the lines, counted from line 0: small enough for all threads to have some.
        share = -(-self.lanes * count // (16 * jobs))
        self.share = min(max(4 * GROUP, share + -share % GROUP), 512)
        self.pools: dict[tuple[int, int], Pool] = {}
        self._spare: list[Pool] = []
        self._rows: list[tuple[NDArray[np.float64], Values]] = []
        self._heights: Values | None = None
        self._scarce = 2 * needed(width, count) > third

    @property
    def samples(self) -> int:
        """Of a buffer that has room for the slopes of a band, padding included."""
        longest = max(end - begin for begin, end in self.bands)
        return len(self.lines) * longest * self._pitch(self.lanes)

    def _pitch(self, cols: int) -> int:
        return cols if self.by_columns else pitch(cols)  # columns are swept along rows, one after the other

    def run(self, read: Read, buffer: Values, spare: list[Pool]) -> Iterator[Block]:
        """Sweep band by band, away from the light.

        ``buffer`` has room for ``samples``; ``spare`` are pools of passes before, and gets those of this one.
        """
        if sum(p.size for p in spare) > self.stacks // 2:
            spare.clear()
        self._spare = spare
        indices = np.array([a.index for a in self.lines])
        for s0, s1 in self.bands:
            r0, r1, c0, c1 = (0, self.lanes, s0, s1) if self.by_columns else (s0, s1, 0, self.lanes)
            shape = len(self.lines), r1 - r0, self._pitch(c1 - c0)
            padded = buffer[: math.prod(shape)].reshape(shape)
            if self.radius is None:
                self._unlimited(read(r0, r1, c0, c1), s0, s1, padded)
            else:
                self._limited(read, s0, s1, padded)
            if self._scarce:
                self._heights = None
            slopes = padded[:, :, : c1 - c0]
            yield Block(r0, r1, c0, c1, indices, slopes, (s0, s1) == self.bands[-1], padded)
        self._rows.clear()
        self._heights = None

    def _flat(self, heights: Values, uses: int) -> tuple[Values, int]:
        """Heights as they are swept ``uses`` times, flat, and the distance between their rows."""
        rows, cols = heights.shape
        wide = self._pitch(cols)
        stride = heights.strides[0] // 4
        apart = self.by_columns or stride % _CLASH or uses == 1
        in_rows = heights.dtype == np.float32 and heights.strides[1] == 4 and heights.strides[0] >= 4 * cols
        if apart and in_rows and not self.below:
            span = (rows - 1) * stride + cols
            return np.lib.stride_tricks.as_strided(heights, (span,), (4,), writeable=False), stride
        if self._heights is None or len(self._heights) < rows * wide:
            self._heights = aligned(rows * wide)
        flat = self._heights[: rows * wide]
        padded = flat.reshape(rows, wide)[:, :cols]

        def copy(row: int) -> None:
            part = np.s_[row : row + _COPIED]
            (np.negative if self.below else np.positive)(heights[part], out=padded[part])

        for_each(copy, range(0, rows, _COPIED), self.jobs)
        flat = flat.view()
        flat.flags.writeable = False  # as heights that are not copied: kernels are compiled once
        return flat, wide

    def _shares(self, s0: int, s1: int, lines: list[Lines]) -> list[tuple[Lines, int]]:
        work = []
        for a in lines:
            first, last = a.touched(s0, s1)
            work += [(a, s) for s in range(first // self.share, -(-last // self.share))]
        return work

    def _unlimited(self, heights: Values, s0: int, s1: int, slopes: Values) -> None:
        (flat, wide), width = self._flat(heights, len(self.lines)), s1 - s0
        lane, step = (wide, 1) if self.by_columns else (1, wide)
        out_lane, out_step = (slopes.shape[2], 1) if self.by_columns else (1, slopes.shape[2])
        work = self._shares(s0, s1, self.lines)
        last = (s0, s1) == self.bands[-1]
        keep = {(a.index, s) for a, s in work}
        self.pools = {key: pool for key, pool in self.pools.items() if key in keep}  # lines that left the raster
        on_disk = sum(p.size for p in self.pools.values()) > self.stacks
        place = {a.index: k for k, a in enumerate(self.lines)}
        longest = max(end - begin for begin, end in self.bands)

        def run(item: tuple[Lines, int]) -> None:
            a, s = item
            pool = self.pools.get((a.index, s)) or self._pool()
            rows = taken(self._rows, lambda: working(longest))
            profile, slope = rows
            out = slopes[place[a.index]].reshape(-1)
            done = 0
            while True:
                done = sweep_lines(
                    flat, lane, step, self.lanes, a.shift[s0:s1], a.part[s0:s1], a.backward, a.position(s0), a.scale,
                    self.lowest, self.curvature, s * self.share, self.share, done, pool.top, pool.position,
                    pool.height, pool.link, pool.free, profile, slope, out_lane, out_step, out,
                )  # fmt: skip
                if done >= self.share:
                    break
                pool.grow((GROUP + 1) * (width // PAGE + 2) + (0 if last else self.share), on_disk)
            self._rows.append(rows)
            if last:
                self.pools.pop((a.index, s), None)
                if not pool.release:
                    self._spare.append(pool)
                return
            if pool.release:
                pool.release()
            self.pools[a.index, s] = pool

        for_each(run, work, self.jobs)

    def _pool(self) -> Pool:
        """An empty pool, from any thread."""
        pool = taken(self._spare, Pool)
        pool.clear(self.share)
        return pool

    def _limited(self, read: Read, s0: int, s1: int, slopes: Values) -> None:
        rows, cols = self.shape
        assert self.radius is not None
        windows = []
        # Azimuths have steps of different lengths in metres, hence radii of different numbers of steps.
        for a in self.lines:
            reach = min(max(int(self.radius * a.scale + 1e-9), 1), self.steps)
            first = a.position(s1 - 1 if a.backward else s0)
            begin = max((first - reach) // reach * reach, 0)  # a whole block in front of what is in reach
            windows.append((reach, *((s0, self.steps - begin) if a.backward else (begin, s1))))
        least, most = min(h0 for _, h0, _ in windows), max(h1 for _, _, h1 in windows)
        heights = read(0, rows, least, most) if self.by_columns else read(least, most, 0, cols)
        for k, (a, (reach, h0, h1)) in enumerate(zip(self.lines, windows)):
            part = np.s_[h0 - least : h1 - least]
            flat, wide = self._flat(heights[:, part] if self.by_columns else heights[part], 1)
            lane, step = (wide, 1) if self.by_columns else (1, wide)
            out_lane, out_step = (slopes.shape[2], 1) if self.by_columns else (1, slopes.shape[2])
            sweep = partial(
                sweep_windows, flat, lane, step, self.lanes, a.shift[h0:h1], a.part[h0:h1], a.backward, a.position(h0),
                a.scale, self.lowest, self.curvature, lines=self.share, reach=reach, skip=s0 - h0, own=s1 - s0,
                out_lane=out_lane, out_step=out_step, out=slopes[k].reshape(-1),
            )  # fmt: skip
            first_lines = [share * self.share for _, share in self._shares(s0, s1, [a])]
            for_each(partial(_at_line, sweep), first_lines, self.jobs)


def _at_line(sweep: Callable[..., None], line0: int) -> None:
    sweep(line0=line0)


def fold(
    blocks: Iterator[Block],
    add: Callable[[Block, int, int], None],
    jobs: int | None = None,
    after: Callable[[Block], None] = lambda block: None,
) -> None:
    """Use blocks as they come: ``add(block, first, last)`` for strips of a block's rows, in threads.

    Strips are rows [first, last) of the block's window; those of one block come before those of the next, and
    ``after(block)`` between them.
    """
    for block in blocks:
        rows, cols = block.row1 - block.row0, block.col1 - block.col0
        height = max(8, (1 << 16) // cols)

        def strip(first: int, block: Block = block, height: int = height, rows: int = rows) -> None:
            add(block, first, min(first + height, rows))

        for_each(strip, range(0, rows, height), jobs)
        after(block)
