"""The largest error between samples: on the pieces into which mesh and full-resolution surface cut each other.

A *piece* is the visible intersection of a triangle of the mesh and a unit triangle: a convex polygon on which both
surfaces are plane. Their distance on the screen is f·g (``frustum``). On a piece f is |δ/w| / (1 + c·δ/w), and on the
screen δ/w is an affine function d, while g is the distance from the point where all verticals meet, the zenith's or
nadir's image. So, on the screen, ∇(f·g) = 0 only where ∇d points towards that point or away from it; across this
direction d is constant and g grows: a saddle. The largest value is therefore on the piece's sides, but not always at
its corners: on a side, where d is linear and g² quadratic, the derivative vanishes at the roots of a cubic
(``stationary``).

Most pieces need not be cut out. |δ|, g and 1 / (w + c·δ) are largest at corners of any polygon (δ and w are linear, g
is convex over a positive linear function), so the product of their largest values at the corners of a cell bounds f·g
in it. Pieces are cut only where that exceeds the largest error so far. Bounds below NEGLIGIBLE are ignored.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.verify.frustum import drop_factor, outcode, pixel_factor, place, side
from orograph.verify.ground import exists
from orograph.verify.strips import C0, C1, C2, R0, R1, R2, corners
from orograph.verify.sweep import Screen

NEGLIGIBLE = 1e-6
"""Pixels: errors that are not searched for."""

COLUMN, ROW, X, Y, W, DROP, PARTS = range(7)
"""Fields of a polygon's corners: place on the raster, place before the camera, metres to the mesh."""


class Cells(NamedTuple):
    """Facts about the cells of a block before any cutting, arrays of shape (rows, columns of the window).

    Attributes:
        suspects: int32, the number of cells of the row before this one in which an uncut triangle's error may exceed
            the largest so far. visible: int32, the number that may be in view.
        allowed: float64, metres between mesh and ground that do not exceed that error, −1 where unknown. It
            overwrites the depths of the block's samples.
    """

    suspects: NDArray[np.int32]
    visible: NDArray[np.int32]
    allowed: NDArray[np.float64]

    @classmethod
    def of(cls, screen: Screen) -> Cells:
        """None yet, for a block on the screen."""
        rows, columns = screen.w.shape
        suspects, visible = np.zeros((2, rows - 1, columns), np.int32)
        return cls(suspects, visible, screen.w)


class Worst(NamedTuple):
    """The largest error so far: (1,) float64 pixels, (2,) float64 its column and row."""

    pixels: NDArray[np.float64]
    place: NDArray[np.float64]


class Workspace(NamedTuple):
    """Two polygons, (16, PARTS) float64, and what ``cut_cells`` finds, (3, 2) int64."""

    polygon: NDArray[np.float64]
    other: NDArray[np.float64]
    cuts: NDArray[np.int64]

    @classmethod
    def empty(cls) -> Workspace:
        """For ``largest_on_pieces``."""
        polygon, other = np.empty((2, 16, PARTS))
        return cls(polygon, other, np.empty((3, 2), np.int64))


@leaf
def largest_on_pieces(ground, block, shift, table, planes, lens, cells, work, worst):
    """Raise ``worst`` to the largest error on the pieces in a block's cells.

    Args:
        ground, block, lens, table, planes: as for ``sweep``. cells: from ``survey_cells``.
    """
    cuts, any_suspect = work.cuts, False
    for i in range(cells.suspects.shape[0]):
        any_suspect = any_suspect or cells.suspects[i, cells.suspects.shape[1] - 1] > 0
    for k in range(table.shape[0]):
        edges = cutting_edges(table, k, shift)
        if edges == 0 and not any_suspect:
            continue
        first, last = max(table[k, R0] >> shift, block.first), min((table[k, R2] - 1) >> shift, block.last)
        a = max(min(table[k, C0], table[k, C1], table[k, C2]) >> shift, block.west) - ground.west
        b = min((max(table[k, C0], table[k, C1], table[k, C2]) - 1) >> shift, block.east - 1) - ground.west
        b = min(b, ground.heights.shape[1] - 2)
        for row in range(first, last + 1):
            i = row - block.first
            if b < a or cells.visible[i, b + 1] == cells.visible[i, a]:
                continue
            suspects = cells.suspects[i, b + 1] > cells.suspects[i, a]
            if edges != 0:
                cut_cells(table, k, edges, row, shift, ground.west + a, ground.west + b, cuts)
                for e in range(3):
                    for column in range(cuts[e, 0], cuts[e, 1] + 1):
                        if may_exceed(ground, planes, k, column, row, cells.allowed[i, column - ground.west]):
                            judge_cell(ground, table, planes, k, shift, column, row, lens, work, worst)
            if suspects:
                for j in range(a, b + 1):
                    if cells.suspects[i, j + 1] > cells.suspects[i, j]:
                        judge_cell(ground, table, planes, k, shift, ground.west + j, row, lens, work, worst)


@leaf
def survey_cells(ground, block, lens, screen, cells, limit):
    """Find the cells that may hold an error of more than ``limit`` pixels; whether any is in view."""
    codes, f, g, w = screen
    rows, width, any_visible = block.last + 1 - block.first, ground.heights.shape[1], False
    limit, c = max(limit, NEGLIGIBLE), abs(lens.matrix[2, 2])
    for i in range(min(rows, ground.rows - 1 - block.first)):
        suspects, visible = 0, 0
        for j in range(width - 1):
            allowed = np.inf
            if codes[i, j] & codes[i, j + 1] & codes[i + 1, j] & codes[i + 1, j + 1] == 0:
                visible += 1
                high = max(f[i, j], f[i, j + 1], f[i + 1, j], f[i + 1, j + 1])
                if high == np.inf:
                    suspects += 1
                    allowed = -1.0
                else:
                    fast = max(g[i, j], g[i, j + 1], g[i + 1, j], g[i + 1, j + 1])
                    near = min(w[i, j], w[i, j + 1], w[i + 1, j], w[i + 1, j + 1])
                    suspects += 1 if high * fast > limit * (1.0 + 1e-9) else 0
                    allowed = near * limit / (fast + c * limit)
            w[i, j] = allowed  # no later cell has this corner
            cells.suspects[i, j + 1], cells.visible[i, j + 1] = suspects, visible
        any_visible = any_visible or visible > 0
    return any_visible


@leaf
def cutting_edges(table, k, shift):
    """Which edges of a triangle do not run along sides of unit triangles.

    Bits 0, 1, 2 are the edges between its first and second corner, first and third, second and third.
    """
    edges, mask = 0, (1 << shift) - 1
    for e in range(3):
        x0, y0 = (table[k, C1], table[k, R1]) if e == 2 else (table[k, C0], table[k, R0])
        x1, y1 = (table[k, C1], table[k, R1]) if e == 0 else (table[k, C2], table[k, R2])
        along = (x0 == x1 and x0 & mask == 0) or (y0 == y1 and y0 & mask == 0)
        if (
            abs(x1 - x0) == y1 - y0
        ):  # diagonals run through samples whose columns and rows have even sums, and differences
            across = x0 - y0 if x1 - x0 == y1 - y0 else x0 + y0
            along = along or across & (2 * mask + 1) == 0
        edges |= 0 if along else 1 << e
    return edges


@leaf
def cut_cells(table, k, edges, row, shift, west, east, cuts):
    """Columns [first, last] of the cells of a row through which each of the given edges runs, within [west, east].

    They may be slightly too many. Columns shared with an earlier edge are left out where possible.
    """
    ticks = np.float64(1 << shift)
    for e in range(3):
        cuts[e, 0], cuts[e, 1] = 1, 0
        if edges >> e & 1 == 0:
            continue
        x0, y0 = (table[k, C1], table[k, R1]) if e == 2 else (table[k, C0], table[k, R0])
        x1, y1 = (table[k, C1], table[k, R1]) if e == 0 else (table[k, C2], table[k, R2])
        upper, lower = max(y0, row << shift), min(y1, (row + 1) << shift)
        if upper > lower or (upper == lower and y0 != y1):
            continue
        a, b = np.float64(x0), np.float64(x1)
        if y0 != y1:
            slope = (x1 - x0) / np.float64(y1 - y0)
            a, b = x0 + slope * (upper - y0), x0 + slope * (lower - y0)
        first = max(np.int64(math.floor(min(a, b) / ticks - 1e-6)), west)
        last = min(np.int64(math.ceil(max(a, b) / ticks + 1e-6)) - 1, east)
        for other in range(e):
            if cuts[other, 0] <= first <= cuts[other, 1]:
                first = cuts[other, 1] + 1
            if cuts[other, 0] <= last <= cuts[other, 1]:
                last = cuts[other, 0] - 1
        cuts[e, 0], cuts[e, 1] = first, last


@inlined
def plane_at(planes, k, column, row):
    """The height of a triangle's plane."""
    return planes[k, 0] + planes[k, 1] * (column - planes[k, 3]) + planes[k, 2] * (row - planes[k, 4])


@inlined
def may_exceed(ground, planes, k, column, row, allowed):
    """Whether triangle k's plane is farther from the ground of a cell than allowed, or this is unknown."""
    i, j, z = row - ground.top, column - ground.west, plane_at(planes, k, column, row)
    a, b = z - ground.heights[i, j], z + planes[k, 1] - ground.heights[i, j + 1]
    z += planes[k, 2]
    c, d = z - ground.heights[i + 1, j], z + planes[k, 1] - ground.heights[i + 1, j + 1]
    return not max(max(a, b, c, d), -min(a, b, c, d)) <= allowed


@leaf
def judge_cell(ground, table, planes, k, shift, column, row, lens, work, worst):
    """Raise ``worst`` to the largest error on the intersections of triangle k with a cell's two unit triangles."""
    for half in range(2):
        if exists(ground, column, row, half):
            judge_piece(ground, table, planes, k, shift, column, row, half, lens, work, worst)


@inlined
def copy(source, i, into, k):
    """into[k] = source[i], for corners."""
    for part in range(PARTS):
        into[k, part] = source[i, part]


@inlined
def cut_between(source, i, j, t, into, k):
    """into[k] = the point at t of the way from corner i to corner j."""
    for part in range(PARTS):
        into[k, part] = source[i, part] + t * (source[j, part] - source[i, part])


@leaf
def judge_piece(ground, table, planes, k, shift, column, row, half, lens, work, worst):
    """Raise ``worst`` to the largest error on the intersection of triangle k with an existing unit triangle."""
    polygon = work.polygon
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    together, beyond = 63, 0
    f, g = 0.0, 0.0
    for n in range(3):
        c, r = (c0, r0) if n == 0 else ((c1, r1) if n == 1 else (c2, r2))
        height = np.float64(ground.heights[r - ground.top, c - ground.west])
        x, y, w = place(lens, c, r, height)
        polygon[n, COLUMN], polygon[n, ROW], polygon[n, X], polygon[n, Y], polygon[n, W] = c, r, x, y, w
        polygon[n, DROP] = plane_at(planes, k, c, r) - height
        code = outcode(lens, x, y, w)
        together, beyond = together & code, beyond | code
        f, g = max(f, drop_factor(lens, w, polygon[n, DROP])), max(g, pixel_factor(lens, x, y, w))
    if together != 0:
        return
    if beyond & 16 == 0 and f < np.inf and f * g <= max(worst.pixels[0], NEGLIGIBLE):
        return
    count = clip_to_triangle(table, k, shift, work)
    if beyond != 0:
        count = clip_to_view(lens, work, count)
    judge_polygon(lens, work.polygon, count, worst)


@leaf
def clip_to_triangle(table, k, shift, work):
    """Sutherland & Hodgman's clipping of the polygon (three corners) against triangle k.

    Returns the number of corners.
    """
    polygon, other, count, ticks = work.polygon, work.other, 3, np.float64(1 << shift)
    x0, y0, x1, y1 = table[k, C0] / ticks, table[k, R0] / ticks, table[k, C1] / ticks, table[k, R1] / ticks
    x2, y2 = table[k, C2] / ticks, table[k, R2] / ticks
    turned = 1.0 if (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0) > 0.0 else -1.0
    for e in range(3):
        ax, ay, bx, by = (x0, y0, x1, y1) if e == 0 else ((x1, y1, x2, y2) if e == 1 else (x2, y2, x0, y0))
        kept = 0
        for i in range(count):
            j = i + 1 if i + 1 < count else 0
            p = turned * ((bx - ax) * (polygon[i, ROW] - ay) - (by - ay) * (polygon[i, COLUMN] - ax))
            q = turned * ((bx - ax) * (polygon[j, ROW] - ay) - (by - ay) * (polygon[j, COLUMN] - ax))
            if p >= 0.0:
                copy(polygon, i, other, kept)
                kept += 1
            if (p > 0.0 and q < 0.0) or (p < 0.0 and q > 0.0):
                cut_between(polygon, i, j, p / (p - q), other, kept)
                kept += 1
        for i in range(kept):
            copy(other, i, polygon, i)
        count = kept
    return count


@leaf
def clip_to_view(lens, work, count):
    """The same against the frustum's sides."""
    polygon, other = work.polygon, work.other
    for plane in range(6):
        if plane == 5 and lens.far == np.inf:
            break
        kept = 0
        for i in range(count):
            j = i + 1 if i + 1 < count else 0
            p = side(lens, plane, polygon[i, X], polygon[i, Y], polygon[i, W])
            q = side(lens, plane, polygon[j, X], polygon[j, Y], polygon[j, W])
            if p >= 0.0:
                copy(polygon, i, other, kept)
                kept += 1
            if (p > 0.0 and q < 0.0) or (p < 0.0 and q > 0.0):
                cut_between(polygon, i, j, p / (p - q), other, kept)
                kept += 1
        for i in range(kept):
            copy(other, i, polygon, i)
        count = kept
    return count


@leaf
def judge_polygon(lens, polygon, count, worst):
    """Raise ``worst`` to the largest error at the corners and on the sides of a piece in view."""
    for i in range(count):
        x, y, w, drop = polygon[i, X], polygon[i, Y], polygon[i, W], polygon[i, DROP]
        if w > 0.0:
            f = drop_factor(lens, w, drop)
            error = np.inf if f == np.inf else f * pixel_factor(lens, x, y, w)
            if error > worst.pixels[0]:
                worst.pixels[0], worst.place[0], worst.place[1] = error, polygon[i, COLUMN], polygon[i, ROW]
    if lens.matrix[2, 2] == 0.0:
        return  # verticals are parallel on the screen, and the error is linear
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        wi, wj = polygon[i, W], polygon[j, W]
        if wi > 0.0 and wj > 0.0:
            f = max(drop_factor(lens, wi, polygon[i, DROP]), drop_factor(lens, wj, polygon[j, DROP]))
            g = pixel_factor(lens, polygon[i, X], polygon[i, Y], wi)
            g = max(g, pixel_factor(lens, polygon[j, X], polygon[j, Y], wj))
            if f < np.inf and f * g > max(worst.pixels[0] * (1.0 + 1e-12), NEGLIGIBLE):
                judge_side(lens, polygon, i, j, worst)


@leaf
def judge_side(lens, polygon, i, j, worst):
    """Raise ``worst`` to the largest error inside the side from corner i to corner j.

    s goes from 0 to 1 along the side on the screen. There δ/w = d + s·e, and g² = q0 + q1·s + q2·s² up to a factor; the
    derivative of log(f²·g²) is that of log(d² / (1 + c·d)²) plus that of log g². Multiplied by its denominators it is a
    cubic, whose own derivative's roots cut [0, 1] into parts with at most one root each.
    """
    c, wi, wj = lens.matrix[2, 2], polygon[i, W], polygon[j, W]
    ax, ay = lens.matrix[0, 2] - c * polygon[i, X] / wi, lens.matrix[1, 2] - c * polygon[i, Y] / wi
    bx, by = lens.matrix[0, 2] - c * polygon[j, X] / wj - ax, lens.matrix[1, 2] - c * polygon[j, Y] / wj - ay
    q0, q1, q2 = ax * ax + ay * ay, 2.0 * (ax * bx + ay * by), bx * bx + by * by
    d = polygon[i, DROP] / wi
    e = polygon[j, DROP] / wj - d
    h0, h1, h2 = d + c * d * d, e * (1.0 + 2.0 * c * d), c * e * e  # (δ/w)·(1 + c·δ/w)
    p0, p1 = 2.0 * e * q0 + h0 * q1, 2.0 * e * q1 + h1 * q1 + 2.0 * h0 * q2
    p2, p3 = 2.0 * e * q2 + h2 * q1 + 2.0 * h1 * q2, 2.0 * h2 * q2
    middle = p2 * p2 - 3.0 * p1 * p3  # of the roots of p1 + 2·p2·s + 3·p3·s²
    first, second = 1.0, 1.0
    if middle >= 0.0:
        stable = -(p2 + math.copysign(math.sqrt(middle), p2))
        one = stable / (3.0 * p3) if p3 != 0.0 else 1.0
        two = p1 / stable if stable != 0.0 else 1.0
        first, second = min(one, two), max(one, two)
    first = min(max(first, 0.0), 1.0)
    second = min(max(second, first), 1.0)
    for part in range(3):
        low = 0.0 if part == 0 else (first if part == 1 else second)
        high = first if part == 0 else (second if part == 1 else 1.0)
        at_low = p0 + low * (p1 + low * (p2 + low * p3))
        at_high = p0 + high * (p1 + high * (p2 + high * p3))
        if low >= high or (at_low > 0.0) == (at_high > 0.0):
            continue
        for _ in range(52):
            s = 0.5 * (low + high)
            if (p0 + s * (p1 + s * (p2 + s * p3)) > 0.0) == (at_low > 0.0):
                low = s
            else:
                high = s
        t = low * wi / (wj + low * (wi - wj))  # of the way in space
        x = polygon[i, X] + t * (polygon[j, X] - polygon[i, X])
        y = polygon[i, Y] + t * (polygon[j, Y] - polygon[i, Y])
        w = wi + t * (wj - wi)
        error = drop_factor(lens, w, (d + low * e) * w) * pixel_factor(lens, x, y, w)
        if error > worst.pixels[0]:
            worst.pixels[0] = error
            worst.place[0] = polygon[i, COLUMN] + t * (polygon[j, COLUMN] - polygon[i, COLUMN])
            worst.place[1] = polygon[i, ROW] + t * (polygon[j, ROW] - polygon[i, ROW])
