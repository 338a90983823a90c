"""The geometry of a diamond on a lattice of samples: its region, its edges cut by the raster, samples on its legs.

A *window* is the part of a lattice of every ``step``-th sample that holds the diamond's region, cut by the raster's
last row and column, which belong to every lattice. Columns and rows are samples from the window's first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._numba import inlined, kernel, leaf


class Window(NamedTuple):
    """The position of a diamond.

    Attributes:
        cx, cy: its vertex. s: its extent along an axis. shape: 0 a square, 1 an edge (``hierarchy.diamonds.kind``).
        axis: the direction of its hypotenuse (``hierarchy.triangles.axis``).
        width, height: the window's last column and row. step: between samples of the lattice.
        sparse: the spacing, in steps, of samples on the hypotenuse that may be vertices. first_i, first_j: the
            lattice's row and column, counted from the raster's, of the window's first sample.
    """

    cx: int
    cy: int
    s: int
    shape: int
    axis: int
    width: int
    height: int
    step: int
    sparse: int
    first_i: int
    first_j: int


@inlined
def place(index, step, last):
    """The column or row of a line of the lattice."""
    return min(index * step, last)


@inlined
def line_at(at, step, last):
    """The line of the lattice at a column or row, −1: none."""
    if at % step == 0:
        return at // step
    return last // step + 1 if at == last else np.int64(-1)


@leaf
def region_corner(w, k):
    """The corners of a diamond: the ends of its hypotenuse (k = 0, 1), the apexes of its patches (2, 3)."""
    s, sign = w.s, 1 - 2 * (k & 1)
    if w.shape == 1:
        along = (w.axis == 2) == (k < 2)
        return (w.cx + sign * s, w.cy) if along else (w.cx, w.cy + sign * s)
    falling = (w.axis == 3) == (k < 2)
    return (w.cx + sign * s, w.cy + sign * s) if falling else (w.cx + sign * s, w.cy - sign * s)


@leaf
def clipped(w, edge):
    """An edge of a diamond on the raster: its first column and row, its direction, first and last step.

    Edge 0 is the hypotenuse, 1 … 4 are the legs. The first step is after the last if none of it is on the raster.
    """
    a = 0 if edge == 0 else (edge - 1) & 1
    b = 1 if edge == 0 else 2 + ((edge - 1) >> 1)
    ax, ay = region_corner(w, a)
    bx, by = region_corner(w, b)
    long = max(abs(bx - ax), abs(by - ay))
    dx, dy = (bx - ax) // long, (by - ay) // long
    low, high = np.int64(0), np.int64(long)
    for way in range(2):
        at, d, last = (ax, dx, w.width) if way == 0 else (ay, dy, w.height)
        if d == 0:
            if at < 0 or at > last:
                high = np.int64(-1)
        elif d > 0:
            low, high = max(low, -at), min(high, last - at)
        else:
            low, high = max(low, at - last), min(high, at)
    return ax, ay, dx, dy, low, high


@leaf
def is_whole(w):
    """Whether a diamond lies wholly on the raster."""
    return min(w.cx, w.cy) >= w.s and w.cx + w.s <= w.width and w.cy + w.s <= w.height


@inlined
def in_region(w, x, y):
    """Whether a sample is in the closed region of a diamond (that of a square is the whole window)."""
    return w.shape == 0 or abs(x - w.cx) + abs(y - w.cy) <= w.s


@leaf
def across(w, x, y, times):
    """The side of the hypotenuse on which a place (scaled by ``times``) lies: negative for top triangle 0, 0 on it."""
    dx, dy = x - times * w.cx, y - times * w.cy
    if w.axis == 0:
        return dx
    if w.axis == 2:
        return dy
    return dy - dx if w.axis == 3 else dx + dy


@leaf
def on_leg(w, x, y):
    """Whether a sample in the region lies on a leg."""
    if w.shape == 1:
        return abs(x - w.cx) + abs(y - w.cy) == w.s
    return abs(x - w.cx) == w.s or abs(y - w.cy) == w.s


@leaf
def mark_leg(w, source, ratio, bit, marks, i, j, away):
    """Mark a sample on a leg if it is a vertex; ``away``: rows from the diamond's."""
    aside = abs(place(j, w.step, w.width) - w.cx)
    corner = aside == 0 or away == 0 if w.shape == 1 else aside == w.s and away == w.s
    given = np.uint8(1)
    if bit != 0 and not corner:
        last_i, last_j = source.shape[0] - 1, source.shape[1] - 1
        given = source[min((w.first_i + i) * ratio, last_i), min((w.first_j + j) * ratio, last_j)] & bit
    marks[i, j] = given != 0


@kernel
def legs_of(w, source, ratio, bit, marks):
    """Mark the vertices on a diamond's legs: those on the hypotenuses of its children.

    Args:
        source: uint8, the marks of the children's lattice on the whole raster; ratio: its steps per step of this
            lattice; bit: of the children's kind, 0: all samples are vertices.
    """
    rows, cols = marks.shape
    for i in range(rows):
        y = place(i, w.step, w.height)
        away = abs(y - w.cy)
        if away > w.s:
            continue
        if w.shape == 0 and away == w.s:
            for j in range(cols):
                mark_leg(w, source, ratio, bit, marks, i, j, away)
            continue
        reach = w.s - away if w.shape == 1 else w.s
        for x in (w.cx - reach, w.cx + reach):
            if 0 <= x <= w.width:
                j = line_at(x, w.step, w.width)
                if j >= 0:
                    mark_leg(w, source, ratio, bit, marks, i, j, away)


@kernel
def look(heights, row0, rows, cols, s, fill, metric):
    """Count valid and missing samples in the regions of edge diamonds, and find the squared radii around them.

    Args:
        heights: (h, w) float32, rows of the raster from row0 on, all columns. rows, cols: (d,) of the diamonds. s:
            their extent. fill: (d,) heights of vertices that are missing. metric: (4,) metres of a column's step (x, y)
            and a row's.

    Returns: (d, 2) int64 counts, (d,) float64.
    """
    count, found = np.zeros((len(rows), 2), np.int64), np.zeros(len(rows))
    high, wide = heights.shape
    for d in range(len(rows)):
        last = row0 + high - 1
        cy, cx = min(rows[d], last), min(cols[d], wide - 1)
        z = np.float64(heights[cy - row0, cx])
        if np.isnan(z):
            z = fill[d]
        for y in range(max(rows[d] - s, row0), min(rows[d] + s, last) + 1):
            reach = s - abs(y - rows[d])
            for x in range(max(cols[d] - reach, 0), min(cols[d] + reach, wide - 1) + 1):
                off = heights[y - row0, x] - z
                if np.isnan(off):
                    count[d, 1] += 1
                    continue
                count[d, 0] += 1
                u, v = x - cx, y - cy
                east, north = metric[0] * u + metric[2] * v, metric[1] * u + metric[3] * v
                found[d] = max(found[d], east * east + north * north + off * off)
    return count, found
