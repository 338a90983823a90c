"""The arithmetic of the pyramid on blocks in memory: subsampling, box means, tile extrema, and the error of a level.

*The error of a level.* Both surfaces are the right-triangle hierarchy's (every cell cut from its (even, even) to its
(odd, odd) corner). The two by two cells under a coarse cell meet in an (odd, odd) sample, so all four of their
diagonals end there and together contain both diagonals of the coarse cell: the fine triangulation refines the coarse
one, whichever way that is cut. On a fine triangle both surfaces are thus linear, and their distance is largest at a
corner, a full-resolution sample. The error of a tile is therefore exactly the largest distance of a full-resolution
sample from the coarse triangles it lies in (in their closure: a sample on an edge belongs to both sides, of which one
may be a hole). It is computed in float64 and rounded up to float32.

Where a level's cells outgrow the block in memory, the nested sum of Lindstrom & Pascucci (2002) takes over: the error
of the level below plus the distance between the two levels. That sum is undefined where the level below has a hole, so
a tile with missing samples gets its height range instead, which bounds every distance within it.

Heights in metres; every kernel releases the GIL.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, read_only, shared
from orograph.error.deviation import bits, distance
from orograph.error.diamonds import halve
from orograph.store.terrain import TILE, Heights, Shape

F64 = NDArray[np.float64]
Counts = NDArray[np.int32]


def subsample(heights: Heights, level: int, end: tuple[bool, bool] = (True, True)) -> Heights:
    """Every 2^level-th sample along each axis, the last one repeated where the step passes an ``end`` of the raster."""
    for _ in range(level):
        heights = halve(heights, end)
    return heights


@kernel
def box_sums(heights: Heights, total: F64, count: Counts) -> None:
    """Sum and number of the valid samples of each 2 × 2 block into ``total`` and ``count``."""
    rows, cols = heights.shape
    for i in range(rows // 2):
        for j in range(cols // 2):
            a = np.float64(heights[2 * i, 2 * j])
            b = np.float64(heights[2 * i, 2 * j + 1])
            c = np.float64(heights[2 * i + 1, 2 * j])
            d = np.float64(heights[2 * i + 1, 2 * j + 1])
            above = (a if a == a else 0.0) + (b if b == b else 0.0)
            total[i, j] = above + ((c if c == c else 0.0) + (d if d == d else 0.0))
            count[i, j] = int(a == a) + int(b == b) + int(c == c) + int(d == d)
    for i in range(total.shape[0]):  # an odd last row or column
        for j in range(0 if 2 * i + 1 == rows else cols // 2, total.shape[1]):
            s = 0.0
            n = 0
            for r in range(2 * i, min(2 * i + 2, rows)):
                for k in range(2 * j, min(2 * j + 2, cols)):
                    v = heights[r, k]
                    if v == v:
                        s += v
                        n += 1
            total[i, j] = s
            count[i, j] = n


@kernel
def halve_sums(fine_total: F64, fine_count: Counts, total: F64, count: Counts) -> None:
    """Add up sums and counts 2 × 2."""
    rows, cols = fine_total.shape
    for i in range(total.shape[0]):
        r1 = min(2 * i + 2, rows)
        for j in range(total.shape[1]):
            s = 0.0
            n = 0
            for r in range(2 * i, r1):
                for c in range(2 * j, min(2 * j + 2, cols)):
                    s += fine_total[r, c]
                    n += fine_count[r, c]
            total[i, j] = s
            count[i, j] = n


@kernel
def divide(total: F64, count: Counts, mean: Heights) -> None:
    """``mean = total / count``, NaN where nothing was counted."""
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            mean[i, j] = total[i, j] / count[i, j] if count[i, j] else np.nan


class BoxMeans:
    """The box means of a block, level after level: ``next()`` goes one level up and returns its means.

    Args:
        heights: the block; or its (rows, cols), if ``add`` gives it strip by strip before the first ``next()``.
    """

    def __init__(self, heights: Heights | Shape) -> None:
        rows, cols = heights if isinstance(heights, tuple) else heights.shape
        self.total: F64 = np.empty(((rows + 1) // 2, (cols + 1) // 2))
        self.count: Counts = np.empty(self.total.shape, np.int32)
        self._summed = False
        if not isinstance(heights, tuple):
            self.add(0, heights)

    def add(self, row: int, heights: Heights) -> None:
        """Sum up rows, the first of which is ``row``, an even number."""
        strip = slice(row // 2, row // 2 + (len(heights) + 1) // 2)
        box_sums(read_only(heights), self.total[strip], self.count[strip])

    @classmethod
    def of_sums(cls, total: F64, count: Counts) -> BoxMeans:
        """Box means whose next ``next()`` uses these sums."""
        made = cls((0, 0))
        made.total, made.count = total, count
        return made

    def ahead(self) -> None:
        """Compute ``total`` and ``count`` of the next means."""
        if self._summed:
            rows, cols = self.total.shape
            total = np.empty(((rows + 1) // 2, (cols + 1) // 2))
            count = np.empty(total.shape, np.int32)
            halve_sums(self.total, self.count, total, count)
            self.total, self.count = total, count
        self._summed = False

    def next(self) -> Heights:
        self.ahead()
        self._summed = True
        mean = np.empty(self.total.shape, np.float32)
        divide(self.total, self.count, mean)
        return mean


@kernel
def tile_extrema(heights: Heights, tile: int, low: Heights, high: Heights, count: Counts) -> None:
    """Lowest, highest and number of valid samples of each tile, both borders included."""
    rows, cols = heights.shape
    for ty in range(low.shape[0]):
        for tx in range(low.shape[1]):
            mn = np.float32(np.inf)
            mx = np.float32(-np.inf)
            n = 0
            for r in range(ty * tile, min(ty * tile + tile + 1, rows)):
                for c in range(tx * tile, min(tx * tile + tile + 1, cols)):
                    v = heights[r, c]
                    if v == v:
                        n += 1
                        if v < mn:
                            mn = v
                        if v > mx:
                            mx = v
            low[ty, tx] = mn if n else np.nan
            high[ty, tx] = mx if n else np.nan
            count[ty, tx] = n


@inlined
def _off(row: Heights, u0: int, u1: int, base: float, slope: float, worst: np.int64) -> np.int64:
    """The larger of ``worst`` and the distances (as bits) of ``row[u0..u1)`` from base + u·slope; NaNs do not count."""
    for u in range(u0, u1):
        worst = max(worst, bits(abs(row[u] - (base + np.float64(np.int32(u)) * slope))))
    return worst


@shared
def _off_cell(heights: Heights, r0: int, c0: int, r1: int, c1: int, step: int, even: bool, largest: float) -> float:
    """The larger of ``largest`` and the distances of the samples [r0, r1] × [c0, c1] from the cell's two triangles."""
    scale = 1.0 / step
    m = bits(largest)
    a = np.float64(heights[r0, c0])
    b = np.float64(heights[r0, c1])
    c = np.float64(heights[r1, c0])
    d = np.float64(heights[r1, c1])
    width = c1 - c0 + 1
    if even:
        for v in range(r1 - r0 + 1):
            row = heights[r0 + v, c0 : c1 + 1]
            m = _off(row, 0, min(v + 1, width), a + v * (c - a) * scale, (d - c) * scale, m)
            m = _off(row, v, width, a + v * (d - b) * scale, (b - a) * scale, m)
    else:
        for v in range(r1 - r0 + 1):
            row = heights[r0 + v, c0 : c1 + 1]
            m = _off(row, 0, min(step - v + 1, width), a + v * (c - a) * scale, (b - a) * scale, m)
            m = _off(row, step - v, width, c + (step - v) * (b - d) * scale, (d - c) * scale, m)
    off: float = distance(m)
    return off


@kernel
def deviations(heights: Heights, step: int, tile: int, parity: int, worst: F64) -> None:
    """For each tile of ``tile`` cells of ``step`` samples, the largest distance of a sample from the cells' surface.

    Args:
        heights: a block that begins at a cell's corner; beyond its end its last samples are repeated.
        step: any power of two; ``deviations_of_two`` is the fast one for 2.
        parity: cell (i, j) is cut from its upper left to its lower right corner if i + j + parity is even.
        worst: the result, shape (tile rows, tile cols); 0 where nothing can be compared.
    """
    rows, cols = heights.shape
    for ty in range(worst.shape[0]):
        for tx in range(worst.shape[1]):
            m = 0.0
            for i in range(ty * tile, (ty + 1) * tile):
                r0 = i * step
                if r0 >= rows - 1:
                    break
                r1 = min(r0 + step, rows - 1)
                for j in range(tx * tile, (tx + 1) * tile):
                    c0 = j * step
                    if c0 >= cols - 1:
                        break
                    c1 = min(c0 + step, cols - 1)
                    m = _off_cell(heights, r0, c0, r1, c1, step, (i + j + parity) & 1 == 0, m)
            worst[ty, tx] = m


@kernel
def deviations_of_two(heights: Heights, tile: int, parity: int, worst: F64) -> None:
    """``deviations`` for cells of 2 × 2: only the midpoints of the four edges and the centre can differ."""
    rows, cols = heights.shape
    for ty in range(worst.shape[0]):
        for tx in range(worst.shape[1]):
            m = 0.0
            top = 0.0
            bottom = 0.0
            left = 0.0
            right = 0.0
            centre = 0.0
            for i in range(ty * tile, (ty + 1) * tile):
                r = 2 * i
                if r >= rows - 1:
                    break
                for j in range(tx * tile, (tx + 1) * tile):
                    k = 2 * j
                    if k >= cols - 1:
                        break
                    even = (i + j + parity) & 1 == 0
                    if r + 2 >= rows or k + 2 >= cols:
                        m = _off_cell(heights, r, k, min(r + 2, rows - 1), min(k + 2, cols - 1), 2, even, m)
                        continue
                    a = np.float64(heights[r, k])
                    b = np.float64(heights[r, k + 2])
                    c = np.float64(heights[r + 2, k])
                    d = np.float64(heights[r + 2, k + 2])
                    # Each triangle has two edges; its third corner adds nothing but may make it a hole.
                    x1 = abs(heights[r, k + 1] - 0.5 * (a + b) + 0.0 * (d if even else c))
                    x2 = abs(heights[r + 2, k + 1] - 0.5 * (c + d) + 0.0 * (a if even else b))
                    x3 = abs(heights[r + 1, k] - 0.5 * (a + c) + 0.0 * (d if even else b))
                    x4 = abs(heights[r + 1, k + 2] - 0.5 * (b + d) + 0.0 * (a if even else c))
                    middle = 0.5 * (a + d) if even else 0.5 * (b + c)
                    p = b if even else a
                    q = c if even else d
                    x5 = abs(heights[r + 1, k + 1] - middle) + 0.0 * (p if p == p else q)  # either side will do
                    top = x1 if x1 > top else top
                    bottom = x2 if x2 > bottom else bottom
                    left = x3 if x3 > left else left
                    right = x4 if x4 > right else right
                    centre = x5 if x5 > centre else centre
            worst[ty, tx] = max(max(max(top, left), max(bottom, right)), max(centre, m))


def extrema(heights: Heights) -> tuple[Heights, Heights, NDArray[np.uint8]]:
    """Lowest, highest and validity (0, 1, 2) of the level-0 tiles of a block that includes its shared border."""
    rows, cols = heights.shape
    shape = max(1, -(-(rows - 1) // TILE)), max(1, -(-(cols - 1) // TILE))
    low, high, count = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.int64)
    tile_extrema(read_only(heights), TILE, low, high, count)
    down = np.minimum(np.arange(shape[0]) * TILE + TILE + 1, rows) - np.arange(shape[0]) * TILE
    across = np.minimum(np.arange(shape[1]) * TILE + TILE + 1, cols) - np.arange(shape[1]) * TILE
    valid = np.where(count == np.outer(down, across), 2, np.minimum(count, 1)).astype(np.uint8)
    return low, high, valid


def reduce_tiles(low: Heights, high: Heights, valid: NDArray[np.uint8]) -> tuple[Heights, Heights, NDArray[np.uint8]]:
    """The same tables one level up, where a tile lies over 2 × 2 of these."""
    none = (valid == 0).all()
    if none:
        shape = (low.shape[0] + 1) // 2, (low.shape[1] + 1) // 2
        return np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32), np.zeros(shape, np.uint8)
    all_valid, any_valid = quarter(valid, np.minimum), quarter(valid, np.maximum)
    combined = np.where(all_valid == 2, 2, np.minimum(any_valid, 1)).astype(np.uint8)
    return quarter(low, np.fmin), quarter(high, np.fmax), combined


def quarter(table: NDArray[Any], combine: np.ufunc) -> NDArray[Any]:
    """Combine 2 × 2 entries of a table into one; an odd last row or column stays uncombined."""
    rows = combine(table[0::2], table[np.minimum(np.arange(1, table.shape[0] + 1, 2), table.shape[0] - 1)])
    result: NDArray[Any] = combine(
        rows[:, 0::2], rows[:, np.minimum(np.arange(1, rows.shape[1] + 1, 2), rows.shape[1] - 1)]
    )
    return result


def round_up(worst: F64, magnitude: float) -> Heights:
    """Distances as float32, never smaller: float64's own rounding at heights of ``magnitude`` is added first."""
    worst = np.where(worst > 0, worst + magnitude * 2.0**-50, 0.0)
    result = worst.astype(np.float32)
    return np.where(result < worst, np.nextafter(result, np.float32(np.inf)), result)


def magnitude(low: Heights, high: Heights) -> float:
    """The largest absolute height in the tables, 0 if nothing is valid."""
    return float(max(np.nanmax(np.abs(low), initial=0), np.nanmax(np.abs(high), initial=0)))


def tile_errors(heights: Heights, level: int, origin: Shape = (0, 0)) -> F64:
    """The largest distances of ``deviations`` for tiles of ``level`` over a block; at level 0 all are 0.

    Args:
        heights: the block with its shared border; it begins at a multiple of 2^level samples.
        origin: the block's first sample (row, col) in the raster, which decides how cells are cut.
    """
    step = 1 << level
    shape = tuple(max(1, -(-(side - 1) // (TILE * step))) for side in heights.shape)
    worst = np.zeros((shape[0], shape[1]))
    parity = (origin[0] // step + origin[1] // step) & 1
    if level == 1:
        deviations_of_two(read_only(heights), TILE, parity, worst)
    elif level:
        deviations(read_only(heights), step, TILE, parity, worst)
    return worst
