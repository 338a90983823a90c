"""The horizon towards one azimuth on nested windows, fine nearby and coarse far away, in one sweep per window.

Every sample of a window sees the terrain towards the light at the window's own resolution within the window, and beyond
it at the resolution of the windows around, out to the border of the outermost. A line of samples is walked from its far
end away from the light; the upper convex hull of the passed points holds every possible horizon (Timonen & Westerholm
2010, §4), so a sample costs amortised constant time. Lines are one sample apart; a sample's value is interpolated
between the two lines beside it, and a line's profile between the two samples beside it. The ground in a sample's own
cell comes from the surface, and so do the points that diagonal lines cross between samples (``own_cell``). Heights are
metres, NaN where missing (no ground); slopes are tangents of elevation angles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.lighting.own_cell import OwnCell, cell_slope
from orograph.parallel import map_ordered
from orograph.raycast.stack import HeightWindow

Heights = NDArray[np.float32]

_LINES = 64
"""Lines swept at a time by a thread."""


class Turned(NamedTuple):
    """How lines run towards a light.

    Attributes:
        major_is_col: whether steps are columns, or rows. forward: whether the light lies towards larger major indices.
        slant: minor steps per major step towards larger indices. metres: length of a step along a line.
    """

    major_is_col: bool
    forward: bool
    slant: float
    metres: float


class Outer(NamedTuple):
    """The windows around one, from the nearest to the outermost.

    Attributes:
        pool: their heights, flat. ints: (w, 3) offset in it, rows, columns.
        floats: (w, 5) scale in the inner window's samples, first row and column of their samples' middles in its
            coordinates, and the major range [from, to] of the part that lies beyond the windows inside.
    """

    pool: Heights
    ints: NDArray[np.int64]
    floats: NDArray[np.float64]


@kernel
def _profile(heights, major_is_col, j, y):
    """Height between the two samples beside a line at major index ``j`` and minor position ``y``; NaN if none."""
    count = heights.shape[0] if major_is_col else heights.shape[1]
    y = min(max(y, 0.0), count - 1.0)
    i = min(np.int64(y), max(count - 2, 0))
    f = y - i
    k = min(i + 1, count - 1)
    if major_is_col:
        a, b = np.float64(heights[i, j]), np.float64(heights[k, j])
    else:
        a, b = np.float64(heights[j, i]), np.float64(heights[j, k])
    if a != a:
        return b if f > 0.5 else a
    if b != b:
        return a if f < 0.5 else b
    return a + (b - a) * f


@inlined
def _middle(heights, major_is_col, j, i, cell):
    """The height in the middle of a cell that is cut the other way, on a diagonal line; NaN if there is none.

    The cell is on the light's side of major index j and minor index i (``OwnCell.points``).
    """
    count = heights.shape[0] if major_is_col else heights.shape[1]
    beside, ahead = i + cell.side, j + cell.toward
    if not (cell.odd + i + j) & 1 or i < 0 or i >= count or beside < 0 or beside >= count:
        return np.nan
    if major_is_col:
        a, b = np.float64(heights[beside, j]), np.float64(heights[i, ahead])
    else:
        a, b = np.float64(heights[j, beside]), np.float64(heights[ahead, i])
    if a != a:
        return b
    return a if b != b else 0.5 * (a + b)


@inlined
def _seen(hull_t, hull_z, size, s, z):
    """The number of points left on a hull after removing those that a new point at s of height z hides."""
    while size > 1 and (hull_z[size - 2] - z) * (s - hull_t[size - 1]) >= (hull_z[size - 1] - z) * (
        s - hull_t[size - 2]
    ):
        size -= 1
    return size


@kernel
def _sweep(heights, turned, cell, own, outer, lowest, first, last, line0, out):
    """Lines [first, last) of a window: ``out[line - line0, j]`` is the slope towards the light at major index j.

    Args:
        turned: ``Turned``. outer: ``Outer``.
        cell: samples' own cells. own: their reach in metres, which ``_gather`` covers.
    """
    major_is_col, forward, slant, metres = turned
    outer_pool, outer_ints, outer_floats = outer
    majors = heights.shape[1] if major_is_col else heights.shape[0]
    minors = heights.shape[0] if major_is_col else heights.shape[1]
    capacity = cell.points * majors + 8
    for w in range(outer_ints.shape[0]):
        capacity += max(outer_ints[w, 1], outer_ints[w, 2]) + 4
    hull_t, hull_z = np.empty(capacity), np.empty(capacity)
    way = 1.0 if forward else -1.0
    for line in range(first, last):
        size = 0
        # Far terrain: from the outermost window's far border to this window's.
        for w in range(outer_ints.shape[0] - 1, -1, -1):
            scale, row_first, col_first = outer_floats[w, 0], outer_floats[w, 1], outer_floats[w, 2]
            base, rows, cols = outer_ints[w, 0], outer_ints[w, 1], outer_ints[w, 2]
            begin, end = outer_floats[w, 3], outer_floats[w, 4]
            steps = np.int64(np.floor(abs(begin - end) / scale + 1e-9))
            for k in range(steps + 1):
                t = begin - way * k * scale  # walking against the light's direction
                if (t - end) * way < 0.0:
                    break
                y = line + slant * t
                r, c = (
                    ((y - row_first) / scale, (t - col_first) / scale)
                    if major_is_col
                    else ((t - row_first) / scale, (y - col_first) / scale)
                )
                if r < -0.5 or c < -0.5 or r > rows - 0.5 or c > cols - 0.5:
                    continue
                r, c = min(max(r, 0.0), rows - 1.0), min(max(c, 0.0), cols - 1.0)
                i, j = min(np.int64(r), max(rows - 2, 0)), min(np.int64(c), max(cols - 2, 0))
                i1, j1 = min(i + 1, rows - 1), min(j + 1, cols - 1)
                fr, fc = r - i, c - j
                z = (outer_pool[base + i * cols + j] * (1 - fc) + outer_pool[base + i * cols + j1] * fc) * (1 - fr) + (
                    outer_pool[base + i1 * cols + j] * (1 - fc) + outer_pool[base + i1 * cols + j1] * fc
                ) * fr
                if z != z:
                    continue
                s = -way * t * metres
                size = _seen(hull_t, hull_z, size, s, z)
                hull_t[size], hull_z[size] = s, z
                size += 1
        for k in range(majors):
            j = majors - 1 - k if forward else k
            y = line + slant * j
            if y < -1.0 or y > minors:
                out[line - line0, j] = lowest
                continue
            z = _profile(heights, major_is_col, j, y)
            if z != z:
                out[line - line0, j] = np.nan
                continue
            s = -way * j * metres
            if cell.points > 1 and k > 0:
                middle = _middle(heights, major_is_col, j, np.int64(np.round(y)), cell)
                if middle == middle:
                    size = _seen(hull_t, hull_z, size, s - 0.5 * metres, middle)
                    hull_t[size], hull_z[size] = s - 0.5 * metres, middle
                    size += 1
            size = _seen(hull_t, hull_z, size, s, z)
            top = size - 1
            if k > 0 and top >= 0 and s - hull_t[top] <= own:
                top -= 1
            slope = (hull_z[top] - z) / (s - hull_t[top]) if top >= 0 else lowest
            out[line - line0, j] = max(slope, lowest)
            if -1.0 + 1e-6 < y < minors - 1e-6:  # lines beside the border use its samples, but none beyond the next one
                hull_t[size], hull_z[size] = s, z
                size += 1


@kernel
def _gather(lines, line0, major_is_col, slant, heights, cell, out, first, last):
    """Values at samples in rows [first, last), from the lines beside each and from its own cell."""
    rows, cols = out.shape
    for i in range(first, last):
        for k in range(cols):
            j, y = (k, i) if major_is_col else (i, k)
            at = y - slant * j - line0
            n = min(max(np.int64(np.floor(at)), 0), lines.shape[0] - 2)
            f = min(max(at - n, 0.0), 1.0)
            a, b = lines[n, j], lines[n + 1, j]
            if a != a:
                a = b
            if b != b:
                b = a
            if cell.reach > 0.0:
                down, across = (cell.side, cell.toward) if major_is_col else (cell.toward, cell.side)
                i1, k1 = i + down, k + across
                if (0 <= k1 < cols) if major_is_col else (0 <= i1 < rows):
                    nan = np.float32(np.nan)
                    inside = 0 <= i1 < rows and 0 <= k1 < cols
                    major = heights[i, k1] if major_is_col else heights[i1, k]
                    minor = (heights[i1, k] if major_is_col else heights[i, k1]) if inside else nan
                    both = heights[i1, k1] if inside else nan
                    near = cell_slope(heights[i, k], major, both, minor, cell.odd + i + k, cell)
                    a = near if near > a else a
                    b = near if near > b else b
            out[i, k] = a + (b - a) * f


def sunward(
    windows: list[HeightWindow],
    linear: NDArray[np.float64],
    azimuth: float,
    *,
    lowest: float = 0.0,
    jobs: int | None = None,
) -> list[Heights]:  # fmt: skip
    """The slope of the horizon towards one azimuth, for every sample of nested windows.

    Args:
        windows: of box means, outermost first, each inside the one before.
        linear: (2, 2) linear part of the geotransform at full resolution: metres east and north per column and per row.
        azimuth: degrees clockwise from grid north, towards the light.
        lowest: the smallest slope.
        jobs: threads.

    Returns:
        for each window (rows, cols) float32; NaN where a sample's surroundings are unknown.
    """
    a = math.radians(azimuth)
    step = np.linalg.solve(np.asarray(linear, np.float64), [math.sin(a), math.cos(a)])  # columns, rows per metre
    major_is_col = abs(step[0]) >= abs(step[1])
    major, minor = (step[0], step[1]) if major_is_col else (step[1], step[0])
    forward, slant = bool(major > 0), float(minor / major)
    return [
        _one(
            window, windows[:number][::-1],
            Turned(bool(major_is_col), forward, slant, float(1 << window.level) / abs(float(major))), lowest, jobs,
        )
        for number, window in enumerate(windows)
    ]  # fmt: skip


def _one(
    window: HeightWindow, outer: list[HeightWindow], turned: Turned, lowest: float, jobs: int | None
) -> Heights:  # fmt: skip
    """The slopes of one window, ``outer`` around it, nearest first."""
    major_is_col, forward, slant, metres = turned
    heights = np.ascontiguousarray(window.heights, np.float32)
    rows, cols = heights.shape
    majors, minors = (cols, rows) if major_is_col else (rows, cols)
    around = _around(outer, window, majors, major_is_col, forward)
    places = slant * np.arange(majors)
    toward = 1 if forward else -1
    through = np.abs(places - np.round(places)).max(initial=0.0) <= 1e-6
    cell = OwnCell(
        np.float64(not through), toward, -1, int(np.sign(slant * toward)), np.float32(abs(slant)),
        (window.row0 + window.col0) & 1, 2 if through and abs(slant) > 0.5 else 1, np.float32(1.0 / metres),
        np.float32(0.0),
    )  # fmt: skip
    low = min(0.0, -slant * (majors - 1))
    high = minors - 1 + max(0.0, -slant * (majors - 1))
    line0, count = math.floor(low), math.ceil(high) - math.floor(low) + 2
    lines = np.full((count, majors), lowest, np.float32)

    def some(first: int) -> None:
        own, last = cell.reach * metres * (1.0 + 1e-9), min(first + _LINES, line0 + count)
        _sweep(heights, turned, cell, own, around, lowest, first, last, line0, lines)

    for _ in map_ordered(some, range(line0, line0 + count, _LINES), jobs):
        pass
    result = np.empty(heights.shape, np.float32)
    _gather(lines, line0, major_is_col, slant, heights, cell, result, 0, rows)
    return result


def _around(outer: list[HeightWindow], window: HeightWindow, majors: int, major_is_col: bool, forward: bool) -> Outer:
    """The windows around one (nearest first), in its own sample coordinates."""
    scale = float(1 << window.level)
    ints, floats = np.zeros((len(outer), 3), np.int64), np.zeros((len(outer), 5))
    arrays, base = [np.zeros(1, np.float32)], 1
    edge = float(majors) if forward else -1.0  # the first place beyond the window
    for k, o in enumerate(outer):
        ratio = float(1 << o.level) / scale
        rows, cols = o.heights.shape
        # Middles of blocks: full-resolution (index + first + 0.5) · 2^level − 0.5.
        row_first = ((o.row0 + 0.5) * ratio - 0.5) - window.row0
        col_first = ((o.col0 + 0.5) * ratio - 0.5) - window.col0
        first, count = (col_first, cols) if major_is_col else (row_first, rows)
        far = first + (count - 1) * ratio if forward else first
        if (far - edge) * (1.0 if forward else -1.0) < 0:
            begin, end = edge, edge + (1.0 if forward else -1.0)  # reaches no further: an empty range
        else:
            begin, end = far, edge
        ints[k] = base, rows, cols
        floats[k] = ratio, row_first, col_first, begin, end
        arrays.append(np.ascontiguousarray(o.heights, np.float32).ravel())
        base += o.heights.size
        if (far - edge) * (1.0 if forward else -1.0) > 0:
            edge = far + (ratio / 2 if forward else -ratio / 2)
    return Outer(np.concatenate(arrays), ints, floats)
