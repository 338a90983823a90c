"""Where contour lines could bear their height: straight places of index contours, found in the terrain, not in a view.

Index contours are traced (marching squares: contourpy) on blocks of ``BLOCK`` × ``BLOCK`` cells of a level. Every
stretch of a line gives one spot, where the line bends least. What is found depends on the block alone: spots hold still
however the camera moves, and only which of them are shown depends on the view (``rendering.lines.labels``). The line
through a spot is then moved onto the next finer level's heights, so that it lies on the line that is drawn when one
comes closer.
Levels go on beyond the finest: level −k has 2^k times as many samples a side, on the smooth surface through the
raster's own (``rendering.lines.smooth``), so that lines have as many spots on the screen however near one comes.

Units: metres in the terrain's CRS; samples of the block's level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.water import still
from orograph.rendering.lines.smooth import interpolated
from orograph.store.terrain import Terrain, level_shape

Array = NDArray[np.float64]

BLOCK = 64
MARGIN = 14
"""Samples around a block that its lines are traced through, so that spots at its border know their line."""

REACH = 12.0
"""Samples that the line through a spot is kept for, to both sides."""

POINTS = 17
"""Points it is kept by."""

STRETCH = 20.0
"""Samples of a line that give one spot."""

SHORT = 22.0
"""Samples: lines around knolls and pits that are shorter bear no height."""

BEND = 0.35
"""How far a line may deviate within half its reach, as a share of that: more is too bent for a label."""

MOST_LINES = 200
"""The most heights of index contours in a block: with more, lines merge anyway."""


@dataclass(frozen=True, slots=True)
class Spots:
    """Spots (n,).

    Attributes:
        lines: (n, POINTS, 2) easting and northing along the line through each; the spot is the middle one.
        heights: of their contours, metres. slopes: (n, 2) of the ground there, metres per metre east and north.
        bends: how far lines go aside, as a part of their length. level: of the block.
        shores: (n,) whether ground at height 0 that none is lower than is beside it: the sea, mostly.
    """

    lines: Array
    heights: Array
    slopes: Array
    bends: Array
    level: int
    shores: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.heights)


def none(level: int) -> Spots:
    """No spots."""
    return Spots(np.zeros((0, POINTS, 2)), np.zeros(0), np.zeros((0, 2)), np.zeros(0), level, np.zeros(0, bool))


def spots(terrain: Terrain, level: int, row: int, col: int, step: float) -> Spots:
    """The spots of a block.

    Args:
        row, col: of the block among those of the level. step: metres between index contours.
    """
    from contourpy import LineType, contour_generator

    rows, cols = shape_of(terrain, level)
    r0, c0 = max(row * BLOCK - MARGIN, 0), max(col * BLOCK - MARGIN, 0)
    r1, c1 = min((row + 1) * BLOCK + MARGIN + 1, rows), min((col + 1) * BLOCK + MARGIN + 1, cols)
    if r1 - r0 < 2 or c1 - c0 < 2:
        return none(level)
    heights = read(terrain, level, r0, r1, c0, c1)
    if not np.isfinite(heights).any():
        return none(level)
    low, high = math.ceil(np.nanmin(heights) / step), math.floor(np.nanmax(heights) / step)
    if high < low or high - low > MOST_LINES:
        return none(level)
    linear = terrain.chart.linear * 2.0**level  # metres east and north per column and row of the level
    spacing = math.sqrt(abs(float(np.linalg.det(linear))))
    corner = np.array([c0, r0], np.float64)
    masked = np.ma.masked_invalid(heights)
    generator = contour_generator(z=masked, name="serial", line_type=LineType.Separate)
    core = np.array([col, row]) * float(BLOCK)
    inside_of = core - [c0, r0], core - [c0, r0] + BLOCK
    found: list[tuple[Array, float, float]] = []
    for k in range(low, high + 1):
        for line in generator.lines(k * step):
            found += [(p, bend, k * step) for p, bend in _straight(np.asarray(line), linear, spacing, inside_of)]
    if not found:
        return none(level)
    lines = np.stack([f[0] for f in found])
    values = np.array([f[2] for f in found])
    lines = _finer(terrain, level, lines + corner, values) if level >= 0 else lines + corner
    middle = lines[:, POINTS // 2]
    slope = _gradient(heights, middle - corner)
    to_world = np.linalg.inv(linear)
    x, y = terrain.grid.xy(lines[..., 0] * 2.0**level, lines[..., 1] * 2.0**level)
    keep = np.isfinite(slope).all(-1)
    shores = values == 0
    shores[shores] = _by_the_sea(terrain, level, middle[shores])
    return Spots(
        np.stack([x, y], -1)[keep], values[keep], (slope @ to_world)[keep], np.array([f[1] for f in found])[keep],
        level, shores[keep],
    )  # fmt: skip


def _by_the_sea(terrain: Terrain, level: int, at: Array) -> NDArray[np.bool_]:
    """Whether a sample within two of (column, row) (n, 2) of a level is at 0 and no neighbour is lower."""
    if not len(at):
        return np.zeros(0, bool)
    at = np.rint(at * 2.0 ** min(level, 0)).astype(np.intp)  # between samples, of the raster's own
    rows, cols = shape_of(terrain, max(level, 0))
    (c0, r0), (c1, r1) = np.maximum(at.min(0) - 3, 0), np.minimum(at.max(0) + 4, [cols, rows])
    heights = read(terrain, max(level, 0), r0, r1, c0, c1).astype(np.float32)
    sea = np.pad(still(heights), 2)
    col, row = (at - [c0, r0]).T
    return np.asarray(np.logical_or.reduce([sea[row + i, col + j] for i in range(5) for j in range(5)]))


def _straight(line: Array, linear: Array, spacing: float, core: tuple[Array, Array]) -> list[tuple[Array, float]]:
    """The straightest place within the core of every stretch of a line (n, 2; columns, rows): (points, bend)."""
    if len(line) < SHORT / 2:  # lines cross a cell's edge at least every second sample of their way
        return []
    metres = line @ linear.T / spacing  # lengths in samples, whatever the cells' shape
    steps = np.linalg.norm(np.diff(metres, axis=0), axis=1)
    keep = np.concatenate([[True], steps > 1e-9])
    line, metres = line[keep], metres[keep]
    if len(line) < 3:
        return []
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(metres, axis=0), axis=1))])
    total = float(along[-1])
    if total < SHORT:
        return []
    closed = bool(np.linalg.norm(metres[0] - metres[-1]) < 1e-6)
    if closed:  # twice around: places near the seam know their line, too
        line = np.concatenate([line, line[1:]])
        along = np.concatenate([along, along[1:] + total])
    elif total < 2 * REACH:
        return []
    first, last = (REACH, total + REACH) if closed else (REACH, total - REACH)
    if closed and total < 2 * REACH:
        last = min(last, along[-1] - REACH)
    n = max(1, round((last - first) / STRETCH))
    each = max(2, round((last - first) / n / 1.5))
    at = np.linspace(first, last, n * each + 1)[: n * each]
    offsets = np.linspace(-REACH, REACH, POINTS)
    places = at[:, None] + offsets
    x, y = (np.interp(places, along, line[:, i]) for i in (0, 1))
    points = np.stack([x, y], -1)  # (n·each, POINTS, 2)
    inside = ((points[:, POINTS // 2] >= core[0]) & (points[:, POINTS // 2] < core[1])).all(-1)
    flat = points @ linear.T / spacing
    quarter = POINTS // 4
    chord = flat[:, -1 - quarter] - flat[:, quarter]
    size = np.maximum(np.linalg.norm(chord, axis=-1), 1e-9)
    rest = flat[:, quarter : POINTS - quarter] - flat[:, quarter, None]
    aside = np.abs(rest[..., 0] * chord[:, None, 1] - rest[..., 1] * chord[:, None, 0]) / size[:, None]
    bend = aside.max(-1) / (REACH / 2) + np.maximum(REACH - size, 0) / REACH
    bend[~inside] = np.inf
    best = bend.reshape(n, each).argmin(1) + np.arange(n) * each
    return [(points[k], float(bend[k])) for k in best if bend[k] < BEND]


def _gradient(heights: Array, at: Array) -> Array:
    """Gradient (n, 2) along columns and rows at fractional (column, row) (n, 2); NaN beside missing heights."""
    east, west, south, north = (_at(heights, at + np.array(step)) for step in ((1, 0), (-1, 0), (0, 1), (0, -1)))
    return np.stack([(east - west) / 2, (south - north) / 2], -1)


def _at(heights: Array, at: Array) -> Array:
    """Heights at fractional (column, row) (n, 2), bilinear; beyond the border, those on it."""
    rows, cols = heights.shape
    x, y = np.clip(at[:, 0], 0, cols - 1), np.clip(at[:, 1], 0, rows - 1)
    j, i = np.minimum(x.astype(np.intp), max(cols - 2, 0)), np.minimum(y.astype(np.intp), max(rows - 2, 0))
    u, v = x - j, y - i
    j1, i1 = np.minimum(j + 1, cols - 1), np.minimum(i + 1, rows - 1)
    top = heights[i, j] * (1 - u) + heights[i, j1] * u
    return np.asarray(top * (1 - v) + (heights[i1, j] * (1 - u) + heights[i1, j1] * u) * v)


def coarsest(terrain: Terrain) -> int:
    """The coarsest level that has spots: beyond those of the terrain, as long as lines have room on it."""
    level = terrain.levels - 1
    while max(level_shape(terrain.grid.shape, level + 1)) > 2 * REACH:
        level += 1
    return level


def shape_of(terrain: Terrain, level: int) -> tuple[int, int]:
    """Rows and columns of a level, also beyond the finest."""
    if level >= 0:
        return level_shape(terrain.grid.shape, level)
    rows, cols = terrain.grid.shape
    return ((rows - 1) << -level) + 1, ((cols - 1) << -level) + 1


def read(terrain: Terrain, level: int, row0: int, row1: int, col0: int, col1: int) -> Array:
    """Heights of a level, or of one beyond the coarsest: every second, fourth… sample of that; or beyond the finest:
    those of the smooth surface through the samples, which lines near by are of (``rendering.lines.smooth``)."""
    top = terrain.levels - 1
    if level < 0:
        return _between(terrain, -level, row0, row1, col0, col1)
    if level <= top:
        return np.asarray(terrain.read(level, row0, row1, col0, col1), np.float64)
    rows, cols = terrain.shape(top)
    step = 1 << (level - top)
    r, c = np.arange(row0, row1) * step, np.arange(col0, col1) * step
    whole = np.asarray(terrain.read(top, 0, rows, 0, cols), np.float64)
    return np.asarray(whole[np.ix_(np.minimum(r, rows - 1), np.minimum(c, cols - 1))])


def _between(terrain: Terrain, finer: int, row0: int, row1: int, col0: int, col1: int) -> Array:
    """Heights of the smooth surface at every 2^-finer-th of a sample; NaN beside missing samples."""
    rows, cols = terrain.grid.shape
    r, c = (np.arange(a, b) / 2.0**finer for a, b in ((row0, row1), (col0, col1)))
    # A sample more to every side, for slopes.
    r0, c0 = (max(int(v[0]) - 1, 0) for v in (r, c))
    r1, c1 = (min(math.ceil(v[-1]) + 2, n) for v, n in ((r, rows), (c, cols)))
    own = terrain.read(0, r0, r1, c0, c1)
    y, x = (v.ravel() for v in np.meshgrid(r - r0, c - c0, indexing="ij"))
    return interpolated(own, x, y).reshape(len(r), len(c))


def _finer(terrain: Terrain, level: int, lines: Array, values: Array) -> Array:
    """Lines (n, POINTS, 2; columns and rows of the level) moved onto the contour of the next finer level's heights: of
    level 0, that of the smooth surface.

    A few steps of Newton's method down or up the slope, of a sample at most in all; a point that does not arrive stays.
    """
    fine = 2.0 * lines
    rows, cols = shape_of(terrain, level - 1)
    r0, c0 = (max(int(v) - 4, 0) for v in (fine[..., 1].min(), fine[..., 0].min()))
    r1, c1 = min(int(fine[..., 1].max()) + 6, rows), min(int(fine[..., 0].max()) + 6, cols)
    heights = read(terrain, level - 1, r0, r1, c0, c1)
    corner = np.array([c0, r0], np.float64)
    at = fine.reshape(-1, 2) - corner
    begun, wanted = at.copy(), np.repeat(values, POINTS)
    for _ in range(4):
        slope = _gradient(heights, at)
        here = _at(heights, at)
        square = np.maximum((slope**2).sum(-1), 1e-12)
        move = ((wanted - here) / square)[:, None] * slope
        size = np.linalg.norm(move, axis=-1, keepdims=True)
        at = at + np.where(np.isfinite(size), move * np.minimum(1.0, 0.7 / np.maximum(size, 1e-9)), 0.0)
    stray = ~(np.linalg.norm(at - begun, axis=-1) < 2.0)
    at[stray] = begun[stray]
    return np.asarray((at + corner).reshape(lines.shape) / 2.0)
