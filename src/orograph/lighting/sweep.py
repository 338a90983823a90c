"""Horizons of a whole raster, out of core: sweeps over bands of rows or of columns, several azimuths at a time.

For one azimuth the raster is covered by parallel lines in that direction, one sample apart. A line steps along the axis
it is closer to (its *major* axis: columns for light from the east, rows from the north) one sample at a time; across
it, heights are interpolated linearly between the two samples on either side. The horizon at each point of such a line
is exact for the profile through that line's points. A sample lies between two lines, on the same major step and less
than one sample from either; its horizon is interpolated linearly between theirs (this is exact on a plane, which the
nearest line alone would not be). Where a line runs through the samples themselves (azimuths along rows, columns and
diagonals), nothing is interpolated. Missing samples (NaN) are transparent; beside one, the other sample counts for
both.

Azimuths that step along the same axis in the same sense share a pass over the raster, away from the light: a band of
rows or columns is read once, swept for all of them, and handed on before the next. The next band needs only the stack
of each line from everything before (``sweep_kernels``): usually a few points. If there are many (a sea on a round body,
where every sample is on the hull) and memory is short, stacks go to a scratch file.

Slopes are tangents of elevation angles above the raster's plane. The terrain ends at the raster's border, and behind it
the horizon is level. Azimuths are degrees clockwise from (grid) north towards the light. Nothing depends on bands,
threads or memory, to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from orograph.errors import UsageError
from orograph.geo.ellipsoid import Ellipsoid
from orograph.lighting.sweep_lines import Lines, Pool
from orograph.lighting.sweep_pass import Pass, Read, Strip, Terms, Values, Work, aligned
from orograph.parallel import for_groups, threads_for
from orograph.progress import SILENT, Progress

EARTH = 6_371_008.8
"""Mean radius of the Earth, metres (IUGG), for terrain without a CRS."""

_STRIP = 1 << 16
"""Samples of a strip of rows."""


@dataclass(frozen=True, slots=True)
class Block:
    """The horizons of a window of samples, in some of the azimuths.

    Attributes:
        row0, row1, col0, col1: the window: whole rows or whole columns.
        azimuths: (k,) indices into the requested azimuths.
        slopes: (k, rows, cols) float32, tangents of the horizon's elevation; NaN where heights are. Valid until the
            work of the next block but one begins.
        ends: whether it is the last of its pass: these azimuths are complete.
        padded: (k, rows, ≥ cols) the same slopes with the padding of their rows, C-contiguous, for kernels.
        work: functions that make the slopes (``swept`` and ``fold`` call them), in any order, in two parts: each part
            continues the same part of the block before, and may begin before the other part of that one is done.
        ahead: functions that fetch heights for the next block; call them after all work of the block before, and before
            requesting the next block. () if there is too little memory: then all of a block's work must be done before
            the next one is requested.
    """

    row0: int
    row1: int
    col0: int
    col1: int
    azimuths: NDArray[np.int64]
    slopes: Values
    ends: bool
    padded: Values
    work: tuple[Sequence[Work], Sequence[Work]]
    ahead: Sequence[Work]


def curvature_of(crs: CRS | None, refraction: float = 0.13) -> float:
    """Curvature, per metre, of a body's surface relative to the rays of light above it: (1 − k) / r.

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
    """Sweep a raster in every azimuth, in blocks whose work is left to the caller (``fold``, ``swept``).

    Args:
        read: (row0, row1, col0, col1) → heights of a window, float32 metres, NaN where missing; from any thread.
        shape: (rows, cols) of the raster.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.
        azimuths: degrees clockwise from north.
        lowest: the smallest slope: 0 is a level horizon, -inf allows negative slopes (-inf at the border).
        below: use the terrain turned upside down.
        radius: metres beyond which nothing occludes; None: unlimited. Counted in whole steps of a line, at least one.
        curvature: of the body, relative to rays of light, per metre (``curvature_of``); 0: flat.
        jobs: threads that will share the work; None: all processors.
        memory: bytes for bands, slopes and stacks.
        what: its name on the progress line.
        skip: indices of azimuths to leave out.
        band: steps of a band, in samples (default: chosen from ``memory``).

    Yields:
        Blocks: every sample once with every azimuth. Azimuths come in the same order at each sample, whatever the bands
        and the passes.

    Raises:
        UsageError: the shape is empty, the cells degenerate, or the radius takes more memory than there is.
    """
    cells = np.asarray(linear, np.float64)
    if min(shape) < 1:
        raise UsageError(f"Horizons need heights of shape (rows, cols), not {shape}.")
    if cells.shape != (2, 2) or not np.isfinite(cells).all() or abs(np.linalg.det(cells)) == 0:
        raise UsageError("Horizons need the 2 × 2 linear part of a geotransform, in metres, that can be inverted.")
    jobs = threads_for(jobs)
    passes: list[Pass] = []
    for group in ways(azimuths, cells, shape, skip):
        passes += passes_of(group, shape, Terms(lowest, below, radius, curvature), jobs, memory, band)
    yield from blocks_of(passes, read, progress, what)


def ways(
    azimuths: NDArray[np.float64], linear: NDArray[np.float64], shape: tuple[int, int], skip: Collection[int] = ()
) -> list[list[Lines]]:
    """The lines of all azimuths, by axis and sense, in the order in which every sample gets their horizons."""
    lines = [Lines(k, float(a), linear, shape) for k, a in enumerate(azimuths) if k not in skip]
    # Always the same order, so that sums over azimuths are the same to the bit.
    lines.sort(key=lambda a: (a.by_columns, a.backward, a.index))
    return [list(group) for _, group in groupby(lines, key=lambda a: (a.by_columns, a.backward))]


def passes_of(
    group: list[Lines], shape: tuple[int, int], terms: Terms, jobs: int, memory: int, band: int | None = None,
    span: tuple[int, int] | None = None,
) -> list[Pass]:  # fmt: skip
    """Passes for lines of one axis and sense, each of as many azimuths as memory allows; ``span``: as for ``Pass``."""
    passes: list[Pass] = []
    while group:
        made = Pass(group, shape, terms, jobs, memory, band, span)
        passes.append(made)
        group = group[len(made.lines) :]
    return passes


def blocks_of(passes: Sequence[Pass], read: Read, progress: Progress = SILENT, what: str = "") -> Iterator[Block]:
    """The blocks of passes, one after the other."""
    stages = [(each, band) for each in passes for band in each.bands]
    # Reused memory causes no page faults, in which threads would wait for each other.
    largest = max((p.samples for p in passes), default=0)
    slopes = [aligned(largest) for _ in stages[:2]]
    spare: list[Pool] = []
    spaces: list[Values] = []
    fetched: list[Strip] = []

    ahead = all(p.ahead for p in passes)

    def fetch(stage: int) -> None:
        while len(fetched) > 1:  # of the last block, which is being swept, and of those before it
            done = fetched.pop(0)
            if done.space is not None:
                spaces.append(done.space)
        each, (s0, s1) = stages[stage]
        fetched.append(each.fetch(read, s0, s1, spaces))

    with progress.task(what, total=sum(len(p.bands) * len(p.lines) for p in passes)) as task:
        for k, (each, (s0, s1)) in enumerate(stages):
            if not ahead:
                fetched.clear()
            if not ahead or not k:
                fetch(k)
            if (s0, s1) == each.bands[0]:
                each.begin(spare)
            r0, r1, c0, c1 = each.window(s0, s1)
            size = len(each.lines), r1 - r0, each.pitch(c1 - c0)
            padded = slopes[k % 2][: math.prod(size)].reshape(size)
            yield Block(
                r0, r1, c0, c1, each.indices, padded[:, :, : c1 - c0], (s0, s1) == each.bands[-1], padded,
                each.work(fetched[-1], s0, s1, padded),
                [partial(fetch, k + 1)] if ahead and k + 1 < len(stages) else (),
            )  # fmt: skip
            task.advance(len(each.lines))


def swept(blocks: Iterator[Block], jobs: int | None = None) -> Iterator[Block]:
    """The blocks of ``horizons`` with their work done, each valid until the next one is asked for."""
    for block in blocks:
        for_groups(_do, [*block.work, (), block.ahead], jobs)
        yield _done(block)


def _do(work: Work) -> None:
    work()


def _done(block: Block) -> Block:
    """A block without its work, and without the data it holds."""
    return replace(block, work=((), ()), ahead=())


def fold(
    blocks: Iterator[Block],
    add: Callable[[Block, int, int], None],
    jobs: int | None = None,
    after: Callable[[Block], None] = lambda block: None,
) -> None:
    """Make the slopes of the blocks of ``horizons`` and use them: ``add(block, first, last)`` for strips of its rows.

    Strips are rows [first, last) of the block's window; those of one block come before those of the next, with
    ``after(block)`` in between. A block is used while the next one is swept, and threads do not wait for each other.
    """

    def groups() -> Iterator[Sequence[Work]]:
        # A group begins when all but the one before it are done (``for_groups``). So the strips of a block come after
        # both parts of its work, the parts after those of the block before, and memory is used up before it is reused.
        strips: Sequence[Work] = ()
        before: Block | None = None
        for block in blocks:
            yield block.work[0]
            yield [*block.ahead, *strips]
            yield block.work[1]
            if not block.ahead:  # there is no next block, or no memory for both
                yield ()
            if before is not None:
                after(before)
            rows, cols = block.row1 - block.row0, block.col1 - block.col0
            height = max(8, _STRIP // cols)
            before = block = _done(block)
            strips = [partial(add, block, r, min(r + height, rows)) for r in range(0, rows, height)]
        yield ()
        yield strips
        yield ()
        if before is not None:
            after(before)

    for_groups(_do, groups(), jobs)
