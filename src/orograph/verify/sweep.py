"""One pass over a block of the terrain: every sample against the mesh, every strip for overlaps and gaps.

A sweep (Wylie et al. 1967's scan lines, made exact): going down the rows of ticks that hold a sample or a vertex, the
triangles that meet the strip below a row are kept from west to east. They overlap nowhere iff each lies east of its
western neighbour at both rows of the strip; where it does not touch it there is a gap, and the unit triangles of the
full-resolution surface in the gap are not covered. On a row of samples each triangle spans an interval of them; its
height there is compared with theirs on the screen. All decisions about overlap, gaps and edges are made with integers
(``strips``), heights and pixels are float64.

Blocks are independent, so that a terrain larger than memory is judged block by block, in any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.verify.frustum import drop_factor, outcode, pixel_factor, place
from orograph.verify.gaps import sweep_strip
from orograph.verify.ground import existing_units, on_surface, unit_in_view
from orograph.verify.spans import Line, find_junctions, sort_by, sort_west_to_east, span_row, west_of
from orograph.verify.strips import R0, R2, Strip, sides

SAMPLES, UNCOVERED, HOLES, BRIDGED, DUPLICATES, WRONG_HEIGHTS, COUNTS = range(7)
"""The counts of a block."""

MISSING = 255
"""The outcode of missing samples."""


class Block(NamedTuple):
    """The part of the terrain judged at once: samples and cells [west, east) of rows first … last, with its vertices.

    Attributes:
        rows: (r,) int64, the rows of ticks with a sample or a vertex, down to the last of the cells below row ``last``.
        vertices: (v,) int64, the used vertices here, by row, then column. start: (r + 1,) int64: those of rows[i] are
            ``vertices[start[i]:start[i + 1]]``.
        members: (k,) int64, the triangles that touch the block, by row, then roughly by column of their first corner.
        interpolating: whether vertices on samples must have the samples' heights.
    """

    first: int
    last: int
    west: int
    east: int
    rows: NDArray[np.int64]
    vertices: NDArray[np.int64]
    start: NDArray[np.int64]
    members: NDArray[np.int64]
    interpolating: bool


class Screen(NamedTuple):
    """The samples of a block on the screen, arrays of shape (rows of the block + 1, columns of the window).

    Attributes:
        codes: uint8 outcodes, MISSING where there is no sample.
        f, g, w: float64, of samples in view: the factors of their error (``frustum``; f the largest, 0 where there is
            no mesh) and their depth. f is infinite where a sample is out of view.
    """

    codes: NDArray[np.uint8]
    f: NDArray[np.float64]
    g: NDArray[np.float64]
    w: NDArray[np.float64]


class Found(NamedTuple):
    """The findings of a sweep.

    Attributes:
        counts, places: (COUNTS,) and (COUNTS, 2) int64, places in ticks.
        pixels: (2,) float64, largest error at a sample, −1 if there is none, and sum of squares; sample: (2,) int64.
    """

    counts: NDArray[np.int64]
    places: NDArray[np.int64]
    pixels: NDArray[np.float64]
    sample: NDArray[np.int64]

    @classmethod
    def nothing(cls) -> Found:
        """Before the sweep."""
        pixels = np.array([-1.0, 0.0])
        return cls(np.zeros(COUNTS, np.int64), np.zeros((COUNTS, 2), np.int64), pixels, np.zeros(2, np.int64))


class Memory(NamedTuple):
    """Working memory of a sweep. (A kernel that makes no arrays compiles in three quarters of the time.)

    Attributes:
        active, merged (k,) int64, middle (k,) float64: triangles that meet a strip, and their middles.
        lowest, highest: (w,) float64, the mesh's heights at the samples of a row.
        over, under: (w + 1,) uint8, which unit triangles exist above and below a row.
        marks: (w,) uint8, of the cells below a row. before: (w + 1,) int64, see ``Line``.
        points, scratch: (16, 3) float64, polygons.
    """

    active: NDArray[np.int64]
    merged: NDArray[np.int64]
    middle: NDArray[np.float64]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    over: NDArray[np.uint8]
    under: NDArray[np.uint8]
    marks: NDArray[np.uint8]
    before: NDArray[np.int64]
    points: NDArray[np.float64]
    scratch: NDArray[np.float64]

    @classmethod
    def of(cls, count: int, width: int) -> Memory:
        """For ``count`` triangles in a window of ``width`` columns."""
        over, under = np.zeros((2, width + 1), np.uint8)
        points, scratch = np.empty((2, 16, 3))
        return cls(
            np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count), np.full(width, np.inf),
            np.full(width, -np.inf), over, under, np.zeros(width, np.uint8), np.zeros(width + 1, np.int64),
            points, scratch,
        )  # fmt: skip


@inlined
def note(found, what, x, y):
    """Count a finding, and keep the first one's place."""
    if found.counts[what] == 0:
        found.places[what, 0], found.places[what, 1] = x, y
    found.counts[what] += 1


@leaf
def project_row(ground, row, first, lens, screen):
    """Fill a row of ``screen``, except for the mesh."""
    i, k = row - ground.top, row - first
    for j in range(ground.heights.shape[1]):
        height = ground.heights[i, j]
        screen.f[k, j] = np.inf
        if height != height:
            screen.codes[k, j] = MISSING
            continue
        x, y, w = place(lens, ground.west + j, row, np.float64(height))
        screen.codes[k, j] = outcode(lens, x, y, w)
        if screen.codes[k, j] == 0:
            screen.f[k, j], screen.g[k, j], screen.w[k, j] = 0.0, pixel_factor(lens, x, y, w), w


@leaf
def judge_samples(ground, block, row, over, under, lowest, highest, lens, screen, found, shift):
    """Compare the samples of a row with the mesh's lowest and highest there, which are reset."""
    i, k = row - ground.top, row - block.first
    for j in range(ground.heights.shape[1]):
        if screen.codes[k, j] == 0 and on_surface(over, under, j, (row + ground.west + j) & 1):
            column = ground.west + j
            own = row <= block.last and block.west <= column < block.east
            covered = lowest[j] <= highest[j]
            if covered:
                height = np.float64(ground.heights[i, j])
                f = drop_factor(lens, screen.w[k, j], lowest[j] - height)
                if highest[j] != lowest[j]:
                    f = max(f, drop_factor(lens, screen.w[k, j], highest[j] - height))
                screen.f[k, j] = f
                error = np.inf if f == np.inf else f * screen.g[k, j]
                if own:
                    found.pixels[1] += error * error
                    if error > found.pixels[0]:
                        found.pixels[0], found.sample[0], found.sample[1] = error, column, row
            if own:
                note(found, SAMPLES, column << shift, row << shift)
                if not covered:
                    note(found, UNCOVERED, column << shift, row << shift)
        lowest[j], highest[j] = np.inf, -np.inf


@leaf
def judge_vertices(ground, corners, block, r, line, found):
    """Check the vertices of a row of ticks, and set up their index by cells."""
    y, shift = block.rows[r], corners.shift
    at = block.start[r]
    for j in range(line.before.shape[0] - 1):
        line.before[j] = at
        while at < block.start[r + 1] and (corners.x[block.vertices[at]] >> shift) - line.west == j:
            at += 1
    line.before[line.before.shape[0] - 1] = at
    for i in range(block.start[r], block.start[r + 1]):
        v = block.vertices[i]
        x, z = corners.x[v], corners.vertices[v, 2]
        if i > block.start[r] and corners.x[block.vertices[i - 1]] == x:
            note(found, DUPLICATES, x, y)
        wrong = not abs(z) < np.inf
        if block.interpolating and x & ((1 << shift) - 1) == 0 and y & ((1 << shift) - 1) == 0:
            wrong = wrong or z != np.float64(ground.heights[(y >> shift) - ground.top, (x >> shift) - ground.west])
        if wrong:
            note(found, WRONG_HEIGHTS, x, y)


@leaf
def begin(table, block, active, middle):
    """Put the triangles that meet the strip below the block's first row into ``active``, from west to east.

    ``middle`` becomes the sum of their west sides' columns at both rows of the strip.

    Returns: their number, and the first triangle that begins on or below that row.
    """
    y, n, head = block.rows[0], 0, 0
    while head < table.shape[0] and table[head, R0] < y:
        if table[head, R2] > y:
            active[n] = head
            n += 1
        head += 1
    if n > 0:
        for i in range(n):
            wn, wstep, wd, _, _, _ = sides(table, active[i], y, block.rows[1])
            middle[i] = (2 * wn + wstep) / (2.0 * wd)
        sort_by(middle, active, n)
        sort_west_to_east(table, active, 0, n, y, block.rows[1])
    return n, head


@leaf
def next_strip(table, active, n, merged, new, head, y0, y1):
    """Drop the triangles that end at row y0, and merge in those that begin there, new … head − 1.

    The result is in ``merged``, from west to east in the strip [y0, y1]. Returns their number.
    """
    end = table.shape[0]
    fresh = end - (head - new)
    for k in range(new, head):  # at the end of ``merged``, as scratch
        merged[fresh + k - new] = k
    sort_west_to_east(table, merged, fresh, end, y0, y1)
    kept = 0
    for j in range(n):
        if table[active[j], R2] > y0:
            active[kept] = active[j]
            kept += 1
    j, f, out = 0, fresh, 0
    while j < kept or f < end:
        if f == end or (j < kept and west_of(table, active[j], merged[f], y0, y1)):
            merged[out] = active[j]
            j += 1
        else:
            merged[out] = merged[f]
            f += 1
        out += 1
    return out


@leaf
def count_marks(ground, block, row, marks, lens, points, scratch, found, shift):
    """Count the holes and bridges marked in the cells below a row, and remove the marks."""
    for j in range(marks.shape[0] - 1):
        column = ground.west + j
        if marks[j] != 0 and block.west <= column < block.east:
            for half in range(2):
                if marks[j] >> half & 1 and unit_in_view(ground, column, row, half, lens, points, scratch):
                    note(found, HOLES, column << shift, row << shift)
                if marks[j] >> half & 4:
                    note(found, BRIDGED, column << shift, row << shift)
        marks[j] = 0


@leaf
def sweep(ground, corners, block, table, planes, lens, screen, memory, found, junctions, overlapping):
    """Judge a block of the terrain.

    Args:
        ground: the samples of the block, and those of the rows and columns beside it.
        corners, block, lens: see their classes. table, planes: of the block's members (``spans.tabulate``).
        screen, found: to be filled.
        junctions (n,), overlapping (m,): uint8 flags of vertices and triangles, set to 1.
    """
    shift, count = corners.shift, block.members.shape[0]
    active, merged, middle, lowest, highest, over, under, marks, before, points, scratch = memory
    line = Line(corners.x, block.vertices, before, ground.west, shift)
    missing, projected = 0, block.first
    n, head = begin(table, block, active, middle)
    if block.first > 0:
        existing_units(ground, block.first - 1, over)
    for r in range(block.rows.shape[0]):
        y = block.rows[r]
        row, on_samples = y >> shift, y & ((1 << shift) - 1) == 0
        if on_samples:
            missing = 0
            for j in range(under.shape[0]):
                under[j] = 0
            if row + 1 < ground.rows:
                missing = existing_units(ground, row, under)
        while projected <= row + (on_samples and row + 1 < ground.rows and row <= block.last):
            project_row(ground, projected, block.first, lens, screen)
            projected += 1
        # The triangles that touch this row: those of the strip above, and those that begin here.
        new = head
        while head < count and table[head, R0] == y:
            head += 1
        with_vertices = row <= block.last and block.start[r + 1] > block.start[r]
        if with_vertices:
            judge_vertices(ground, corners, block, r, line, found)
        if on_samples or with_vertices:
            touching = n + head - new if r > 0 else head  # on the first row, also those that end there
            for t in range(touching):
                k = t if r == 0 else active[t] if t < n else new + t - n
                if table[k, R2] >= y:
                    if on_samples:
                        span_row(table, planes, k, row, shift, ground.west, lowest, highest)
                    if with_vertices:
                        find_junctions(table, k, y, line, junctions)
        if on_samples:
            judge_samples(ground, block, row, over, under, lowest, highest, lens, screen, found, shift)
            over, under = under, over
        if r + 1 == block.rows.shape[0]:
            break
        n = next_strip(table, active, n, merged, new, head, y, block.rows[r + 1])
        active, merged = merged, active
        strip, k = Strip(row, y, block.rows[r + 1], shift), row - block.first
        sweep_strip(
            table, block.members, active, n, strip, ground.west, over, missing, screen.codes, k, marks, overlapping
        )
        if strip.y1 == (row + 1) << shift:
            count_marks(ground, block, row, marks, lens, points, scratch, found, shift)
