"""CDLOD: a quadtree of one small grid; levels by distance alone, and vertices that slide as the next level comes near.

Strugar, *Continuous Distance-Dependent Level of Detail for Rendering Heightmaps* (Journal of Graphics, GPU, and Game
Tools 14, 2009). Level l has the range r_l. From the root down, if the sphere of the next finer level's range meets a
square's box, the quarters that it meets are drawn in the finer level and the rest in the square's own (``LODSelect``).
All are instances of one grid. In the last third of its level's range a vertex of odd number slides to the even one
before it, so that a level has become the next one where that begins.

*Ranges.* In the paper the user sets them, each twice the one before. Here they follow from the tolerance: a level ends
where the next one's largest error on the terrain, at the distance where vertices begin to slide, equals the tolerance
in pixels. Sliding vertices leave the samples, and nothing bounds their error: no promise. *Seams*: two levels meet
without one if vertices of the finer have all arrived there and none of the coarser has begun, which holds if a range is
longer than the one before by 1.5 diagonals of the finer's squares. ``seams=closed`` lengthens ranges until they are.
Metres, pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.lod.method import MethodInfo
from orograph.lod.options import check, option
from orograph.lod.quadtree_patches import Pieces, QuadtreePatches
from orograph.lod.selection import PatchSet, Topology
from orograph.lod.squares import BlockHeights, Index, Squares
from orograph.raycast.select import Boxes, distances, in_frustum
from orograph.store.terrain import Heights
from orograph.tessellation import Tessellation, turn, welded
from orograph.viewpoint import Camera

START = 2 / 3
"""The part of a level's range after which its vertices slide."""

STEPS = 4096
"""Vertices slide in this many steps, so that their places are exact numbers."""

QUARTER = np.dtype([("row", "<i4"), ("col", "<i4"), ("level", "<i4")])
"""A quarter of the grid: its upper left sample, and its level."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class CdlodOptions:
    """Options of ``cdlod``."""

    grid: int = option(
        32, "Cells along a side of the grid; fewer where the raster is smaller.", choices=(8, 16, 32, 64)
    )
    seams: str = option(
        "closed", "Ranges long enough that levels meet without a seam (closed), or no longer than the tolerance "
                  "requires (open).", choices=("closed", "open"),
    )  # fmt: skip
    cells: str = option(
        "alike", "How cells are cut: all alike, so that four become one where they slide, or alternating like the "
                 "terrain's surface (surface), so that the finest level is the terrain; cells then flip where a "
                 "level begins.",
        choices=("alike", "surface"),
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self)


class Cdlod(QuadtreePatches):
    """CDLOD. See ``Method`` for the arguments.

    Raises:
        UsageError: the terrain has no surface.
    """

    info = MethodInfo(
        "cdlod", "instances of one grid, as fine as the distance asks; vertices slide into the next level",
        "Strugar 2009", "patches", CdlodOptions, lambda options: False, conforming=False,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.n = max(self.terrain.n, 1)
        self.exponent = min(self.options.grid.bit_length() - 1, self.n)
        self.top = self.n - self.exponent
        self._heights = BlockHeights(self.terrain)
        self._errors = level_errors(self.terrain, self.top)
        self.topologies = (_quarter((1 << self.exponent) // 2, alike=self.options.cells == "alike"),)

    # ---- selecting ----

    def _pieces(self, camera: Camera, tolerance: float) -> Pieces:
        ranges = self.ranges(camera, tolerance)
        found, nodes = [], 0
        squares = Squares(self.n, np.zeros(1, np.int64), np.zeros(1, np.int64))
        for level in range(self.top, -1, -1):
            squares = squares.where(self._seen(camera, squares))
            near = self._within(camera, squares, ranges[level - 1]) if level else np.zeros(len(squares), bool)
            children, parts = squares.children(), squares.where(~near).children()
            nodes += int((~near).sum())
            if near.any():
                finer = self._heights.on_ground(squares.where(near).children())
                wanted = self._within(camera, finer, ranges[level - 1])
                left = finer.where(~wanted)
                nodes += len(np.unique(left.parents().codes))
                children = finer.where(wanted)
                parts = Squares(parts.p, np.append(parts.row, left.row), np.append(parts.col, left.col))
            found.append(_instances(self._heights.on_ground(parts), level))
            if not near.any():
                break
            squares = children
        quarters = np.concatenate(found)
        triangles = len(quarters) * len(self.topologies[0].triangles)
        return Pieces(quarters, np.zeros(len(quarters), np.uint8), nodes, triangles)

    def ranges(self, camera: Camera, tolerance: float) -> Array:
        """(top + 1,) the reach of each level, metres of stretched space; the last one reaches everywhere."""
        view, x = camera.view, camera.exaggeration
        if view.projection == "plan":
            return np.append(np.zeros(self.top), np.inf)
        found = np.full(self.top + 1, np.inf)
        before = 0.0
        for level in range(self.top):
            with np.errstate(divide="ignore"):
                asked = x * self._errors[level + 1] / (START * view.pixel_slope * np.float64(tolerance))
            least = 2 * before
            if self.options.seams == "closed" and level:
                least = max(least, before + self._diagonal(level - 1, x) / START)
            found[level] = before = max(least, float(asked))
        return found

    def _diagonal(self, level: int, exaggeration: float) -> float:
        """The longest diagonal of a level's squares, metres of stretched space."""
        p = level + self.exponent
        rows, cols = (-((1 - side) >> p) for side in self.terrain.grid.shape)
        row, col = (a.ravel() for a in np.mgrid[: max(rows, 1), : max(cols, 1)])
        boxes = self._heights.of(Squares(p, row, col))
        (a, b), (d, e) = self.terrain.chart.linear
        wide, high = boxes.east - boxes.west, boxes.south - boxes.north
        flat = np.maximum(np.hypot(a * wide + b * high, d * wide + e * high),
                          np.hypot(a * wide - b * high, d * wide - e * high))  # fmt: skip
        return float(np.nanmax(np.hypot(flat, exaggeration * (boxes.high - boxes.low)), initial=0.0))

    def _seen(self, camera: Camera, squares: Squares) -> NDArray[np.bool_]:
        return in_frustum(self.terrain, camera.view, camera.exaggeration, self._heights.of(squares))

    def _within(self, camera: Camera, squares: Squares, reach: float) -> NDArray[np.bool_]:
        """Which boxes a sphere around the eye meets."""
        boxes: Boxes = self._heights.of(squares)
        return np.asarray(distances(self.terrain, camera.view, camera.exaggeration, boxes) < reach)

    # ---- triangles ----

    def _expand(self, selection: PatchSet, camera: Camera, tolerance: float) -> Tessellation:
        ranges = self.ranges(camera, tolerance)
        rows, cols, heights = list[Array](), list[Array](), list[Array]()
        for level in np.unique(selection.instances["level"]).tolist():
            here = selection.instances[selection.instances["level"] == level]
            for name, part in zip((rows, cols, heights), self._moved(here, level, camera, ranges)):
                name.append(part)
        nothing = np.zeros((0, len(self.topologies[0].points)))
        row, col, height = (np.concatenate([nothing, *parts]) for parts in (rows, cols, heights))
        vertices, where = welded(np.stack([col, row, height], -1).reshape(-1, 3))
        triangles = where.reshape(height.shape)[:, self.topologies[0].triangles].reshape(-1, 3)
        triangles = triangles[~np.isnan(vertices[:, 2])[triangles].any(1)]
        one, two, three = triangles.T  # (vertical ones stay: they fill the gaps beside a vertex that slides on alone)
        triangles = triangles[(one != two) & (two != three) & (three != one)]
        if turn(self.terrain.grid) < 0:  # rows run southwards: clockwise as drawn is clockwise from above
            triangles = triangles[:, ::-1]
        stats = selection.stats | {"triangles": len(triangles)}
        used, places = np.unique(triangles, return_inverse=True)
        return Tessellation(vertices[used], places.reshape(-1, 3).astype(np.int32), None, stats)

    def _moved(self, quarters: NDArray[Any], level: int, camera: Camera, ranges: Array) -> tuple[Array, Array, Array]:
        """Rows, columns and heights (k, points) of the vertices of a level's quarters, where they have slid to."""
        i = (quarters["row"][:, None] >> level) + self.topologies[0].points[:, 0].astype(np.int64)
        j = (quarters["col"][:, None] >> level) + self.topologies[0].points[:, 1].astype(np.int64)
        last_row, last_col = self.terrain.grid.rows - 1, self.terrain.grid.cols - 1
        row, col = np.minimum(i << level, last_row), np.minimum(j << level, last_col)
        own = self._at_level(level, i, j)
        slid = self._slid(row, col, own, level, camera, ranges)
        down, right = slid * (i & 1), slid * (j & 1)
        row_, col_ = np.minimum((i - (i & 1)) << level, last_row), np.minimum((j - (j & 1)) << level, last_col)
        height = np.zeros(own.shape)
        for di in (0, 1):
            for dj in (0, 1):
                weight = (down if di else 1 - down) * (right if dj else 1 - right)
                z = self._at_level(level, i - di * (i & 1), j - dj * (j & 1))
                height += np.where(weight > 0, weight * z, 0.0)
        return row + (row_ - row) * down, col + (col_ - col) * right, height

    def _slid(self, row: Index, col: Index, height: Heights, level: int, camera: Camera, ranges: Array) -> Array:
        """How far vertices have slid, 0 to 1, by their distance from the eye where they came from."""
        if not np.isfinite(ranges[level]):
            return np.zeros(row.shape)
        x, y = self.terrain.grid.xy(col, row)
        view, z = camera.view, np.nan_to_num(height.astype(np.float64))
        d = np.sqrt((x - view.eye[0]) ** 2 + (y - view.eye[1]) ** 2 + (camera.exaggeration * (z - view.eye[2])) ** 2)
        begin = ranges[level - 1] if level else 0.0
        start = begin + START * (ranges[level] - begin)
        slid = np.clip((d - start) / max(ranges[level] - start, 1e-300), 0.0, 1.0)
        return np.asarray(np.rint(slid * STEPS) / STEPS)

    def _at_level(self, level: int, i: Index, j: Index) -> Heights:
        """Heights of entries of a level (those beyond the last repeat it); also for levels coarser than stored ones."""
        stored = min(level, self.terrain.levels - 1)
        rows, cols = self.terrain.shape(stored)
        up = level - stored
        i, j = np.minimum(i << up, rows - 1), np.minimum(j << up, cols - 1)
        row0, row1, col0, col1 = int(i.min()), int(i.max()) + 1, int(j.min()), int(j.max()) + 1
        return self.terrain.read(stored, row0, row1, col0, col1)[i - row0, j - col0]


def level_errors(terrain: Any, top: int) -> Array:
    """(top + 1,) metres: the largest error of each level on the terrain; of levels that are not stored what their
    bilinear surface is off by at the samples of the last one that is, and that one's."""
    last = terrain.levels - 1
    found = [float(np.nanmax(terrain.tiles(k).error, initial=0.0)) for k in range(min(top, last) + 1)]
    rows, cols = terrain.shape(last)
    samples = terrain.read(last, 0, rows, 0, cols).astype(np.float64)
    for level in range(last + 1, top + 1):
        step = 1 << (level - last)
        i, j = (np.minimum(np.arange(-(-side // step) + 1) * step, side - 1) for side in (rows, cols))
        coarse = samples[np.ix_(i, j)]
        u, v = np.arange(rows) / step, np.arange(cols) / step
        a, b = np.minimum(u.astype(int), len(i) - 2), np.minimum(v.astype(int), len(j) - 2)
        s, t = (u - a)[:, None], (v - b)[None]
        smooth = (1 - s) * ((1 - t) * coarse[np.ix_(a, b)] + t * coarse[np.ix_(a, b + 1)])
        smooth += s * ((1 - t) * coarse[np.ix_(a + 1, b)] + t * coarse[np.ix_(a + 1, b + 1)])
        found.append(found[last] + float(np.nanmax(np.abs(smooth - samples), initial=0.0)))
    return np.maximum.accumulate(found)


def _quarter(side: int, *, alike: bool) -> Topology:
    """A quarter of the grid, of ``side`` cells a side, cut alike, or by turns."""
    points = np.mgrid[: side + 1, : side + 1].reshape(2, -1).T.copy()
    row, col = np.mgrid[:side, :side].reshape(2, -1)
    nw = row * (side + 1) + col
    ne, sw, se = nw + 1, nw + side + 1, nw + side + 2
    falling = ((row + col) % 2 == 0)[:, None] | alike
    one = np.where(falling, np.stack([nw, ne, se], 1), np.stack([nw, ne, sw], 1))
    two = np.where(falling, np.stack([nw, se, sw], 1), np.stack([ne, se, sw], 1))
    return Topology(points.astype(np.int32), np.concatenate([one, two]).astype(np.int32))


def _instances(quarters: Squares, level: int) -> NDArray[Any]:
    found = np.zeros(len(quarters), QUARTER)
    found["row"], found["col"] = quarters.row << quarters.p, quarters.col << quarters.p
    found["level"] = level
    return found
