"""Labels of index contours: which spots of the terrain (``label_spots``) carry a height in a view, and how.

A label stands on its line, turned along it, the line left out beneath; its type has a size in pixels. It is never
upside down, as on the maps of the U.S. Geological Survey; where there is a choice it stands where its head points
uphill, too (surveys that set all heads uphill count on a sheet being turned by hand, and a picture is not). It stands
where the line bends little, away from others (and farther from those of the same height, so that labels spread along
and across lines), inside the picture, and where the ground is seen.

Nothing of this depends on what was shown before: the opacity of a label is a continuous function of the camera. It
changes from 0 to 1 over a narrow range of each condition, so that labels fade in and out of a film and of the window
without flicker; a single picture rounds it. Spots of coarser levels go first, and so stay as one comes closer.

Units: pixels; metres.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import Rectangle
from orograph.raycast.caster import Caster
from orograph.raycast.select import Boxes, distances, in_frustum, load, rectangles
from orograph.rendering.lines.label_kernels import lie, stand
from orograph.rendering.lines.label_spots import BLOCK, POINTS, Spots, coarsest, shape_of, spots
from orograph.rendering.lines.label_type import NOTHING, Labels, measured
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.scene.contours import USUAL, Contours
from orograph.scene.scene import Scene
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import Camera, View

Array = NDArray[np.float64]
Drawn = Callable[[Array, Array], Array]
"""Columns and rows (n,) to heights (n,), metres, NaN where nothing is."""

NEAREST, FARTHEST = 6.0, 1.5
"""Pixels that a sample of a spot's level is large: spots of a level are shown between these."""

APART, SAME = 70.0, 260.0
"""Pixels between two labels, and between two of the same height."""

BENT = 0.5, 0.75
"""Shares of a label's height by which the line may deviate under it: harmless, too much."""

CLEAR = 2.0, 5.0
"""Pixels above the ground that must also be visible for the ground to count as clearly seen."""

COARSE = 2.0
"""Pixels within which visibility is tested on the ground."""

DEEP = 0.15
"""How much deeper or nearer than its middle (as a part of the depth) ground under a label's corners may be."""

FINEST = -6
"""The finest level of spots: 64 to a sample of the raster."""

MOST = 4096
"""Blocks whose spots are remembered."""


class Placer:
    """Finds the labels of view after view of a terrain; spots are kept. May be asked from one thread at a time."""

    def __init__(self, terrain: Terrain) -> None:
        self.terrain = terrain
        self._spots: OrderedDict[tuple[int, int, int, float], Spots] = OrderedDict()
        self._caster: tuple[tuple[Rectangle, ...], Caster | None] = ((), None)
        self._lock = threading.Lock()

    def place(self, scene: Scene, contours: Contours, drawn: Drawn | None = None) -> Labels:
        """The labels of a scene's (whole) view.

        Args:
            contours: with an interval, ``fitted``.
            drawn: heights at sample coordinates of what lines are laid over, if that is not the terrain but a mesh of
                it: labels stand on that.
        """
        view = scene.view.whole
        if contours.step <= 0 or not contours.labels:
            return NOTHING
        with self._lock:
            return self._place(scene.but(view=view), contours, drawn)

    def _place(self, scene: Scene, contours: Contours, drawn: Drawn | None) -> Labels:
        view, step = scene.view, contours.step
        large = max(1.0, min(view.width, view.height) / USUAL)
        found = [s for s in self._wanted(scene, step, large) if len(s)]
        if not found:
            return NOTHING
        lines = np.concatenate([s.lines for s in found])
        heights = np.concatenate([s.heights for s in found])
        slopes = np.concatenate([s.slopes for s in found])
        bends = np.concatenate([s.bends for s in found])
        levels = np.concatenate([np.full(len(s), s.level) for s in found])
        bare = np.concatenate([s.shores for s in found]) & (scene.data.water is not None)  # the sea's edge is no line
        lines = np.concatenate([lines, np.broadcast_to(heights[:, None, None], (*lines.shape[:2], 1))], -1)
        middle = lines[:, POINTS // 2]
        pixels, depth = view.project(middle, scene.surface.exaggeration)
        size = view.pixel_metres if view.projection == "plan" else view.pixel_slope * depth
        spacing = float(np.mean(self.terrain.grid.spacing)) * 2.0**levels
        margin = 2.0  # (nearer to the edge no label has room)
        with np.errstate(invalid="ignore", divide="ignore"):
            inside = (pixels > margin).all(-1) & (pixels < [view.width - margin, view.height - margin]).all(-1)
            per_sample = spacing / (size * large)
            keep = inside & ~bare & (depth > view.near) & (per_sample > 0.9 * FARTHEST)
        kept = np.flatnonzero(keep)
        if not len(kept):
            return NOTHING
        lines, heights, slopes, bends, levels = (v[kept] for v in (lines, heights, slopes, bends, levels))
        pixels, depth, per_sample = pixels[kept], depth[kept], per_sample[kept]
        if drawn is not None:
            lines = self._laid(lines, drawn)
            pixels, depth = view.project(lines[:, POINTS // 2], scene.surface.exaggeration)
        opacity = _ramp(0.9 * FARTHEST, 1.1 * FARTHEST, per_sample)
        opacity *= np.where(levels > FINEST, 1 - _ramp(0.85 * NEAREST, NEAREST, per_sample), 1.0)
        rate = _rates(view, scene.surface.exaggeration, pixels, depth, slopes)
        least = max(8.0, 1.15 * contours.type_size)
        opacity *= _ramp(0.8 * least, least, step / np.maximum(rate, 1e-9))
        opacity *= _ramp(3e-4, 6e-4, np.hypot(slopes[:, 0], slopes[:, 1]))
        widths, tall = measured(heights, contours.type_size)
        places, bent = np.zeros((len(heights), 3)), np.zeros(len(heights))
        lie(view.project(lines, scene.surface.exaggeration)[0], widths, tall, places, bent)
        opacity *= 1 - _ramp(*BENT, np.minimum(bent, 1.0))
        across = np.abs(np.cos(places[:, 2])) * widths + np.abs(np.sin(places[:, 2])) * tall
        down = np.abs(np.sin(places[:, 2])) * widths + np.abs(np.cos(places[:, 2])) * tall
        room = np.minimum.reduce(
            [places[:, 0] - across / 2, view.width - places[:, 0] - across / 2, places[:, 1] - down / 2,
             view.height - places[:, 1] - down / 2]
        )  # fmt: skip
        opacity *= _ramp(2.0, 8.0, room)
        some = np.flatnonzero(opacity > 0.02)
        if len(some) and view.projection != "plan":
            opacity[some] *= self._seen(scene, lines[some], depth[some], places[some], widths[some], tall, large)
        if not contours.fading:
            opacity = np.where(opacity > 0.5, 1.0, 0.0)
        # Coarser levels first; among them those whose heads point uphill, then the straightest.
        uphill = _uphill(view, scene.surface.exaggeration, lines[:, POINTS // 2], slopes, places[:, 2])
        order = np.lexsort((bends - 0.1 * uphill, -levels))
        order = order[opacity[order] > 0.02]
        stand(order, places, widths, heights, opacity, APART * large, SAME * large)
        if not contours.fading:
            opacity = np.where(opacity > 0.5, 1.0, 0.0)
        shown = np.flatnonzero(opacity > 0)
        return Labels(lines[shown], heights[shown], opacity[shown])

    def _wanted(self, scene: Scene, step: float, large: float) -> Iterator[Spots]:
        """The spots of all blocks in view whose level suits the scale there."""
        terrain, view = self.terrain, scene.view
        blocks: NDArray[np.int64] | None = None
        for level in range(coarsest(terrain), FINEST - 1, -1):
            if blocks is None or level >= 0:
                blocks = _all_blocks(terrain, level)
            else:  # the quarters of those that are near enough
                quarters = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.int64)
                blocks = (2 * blocks[:, None] + quarters).reshape(-1, 2)
                rows, cols = shape_of(terrain, level)
                blocks = blocks[(blocks * BLOCK < [rows - 1, cols - 1]).all(-1)]
            boxes = _blocks(terrain, level, blocks)
            near = in_frustum(terrain, view, scene.surface.exaggeration, boxes)
            spacing = float(np.mean(terrain.grid.spacing)) * 2.0**level
            if view.projection == "plan":
                least = most = np.full(boxes.low.shape, spacing / (view.pixel_metres * large))
            else:
                away = distances(terrain, view, scene.surface.exaggeration, boxes)
                reach = spacing * BLOCK * 1.5 + scene.surface.exaggeration * np.nan_to_num(boxes.high - boxes.low)
                # Depths are distances times the cosine to the axis, which is not less than the corner's.
                with np.errstate(divide="ignore"):
                    most = spacing / (view.pixel_slope * large) / np.maximum(0.5 * away, 1e-9)
                    least = spacing / (view.pixel_slope * large) / (away + reach)
            near &= most > 0.9 * FARTHEST
            blocks = blocks[near]
            for row, col in blocks[least[near] < NEAREST].tolist() if level > FINEST else blocks.tolist():
                yield self._spots_of(level, row, col, step)
            if not len(blocks) and level <= 0:
                return

    def _spots_of(self, level: int, row: int, col: int, step: float) -> Spots:
        key = level, row, col, step
        found = self._spots.get(key)
        if found is None:
            found = self._spots[key] = spots(self.terrain, level, row, col, step)
            while len(self._spots) > MOST:
                self._spots.popitem(last=False)
        else:
            self._spots.move_to_end(key)
        return found

    def _laid(self, lines: Array, drawn: Drawn) -> Array:
        """Lines (n, POINTS, 3) at the heights of what is drawn there, where there is something."""
        col, row = self.terrain.grid.index(lines[..., 0].ravel(), lines[..., 1].ravel())
        found = drawn(col, row).reshape(lines.shape[:2])
        return np.concatenate([lines[..., :2], np.where(np.isfinite(found), found, lines[..., 2])[..., None]], -1)

    def _seen(
        self, scene: Scene, lines: Array, depth: Array, places: Array, widths: Array, tall: float, large: float
    ) -> Array:
        """How visible the ground under labels is (n,), 0 to 1: rays to points slightly above its middle and ends, and
        through the label's corners, where the same slope must continue."""
        view, terrain = scene.view, self.terrain
        chosen = tuple(rectangles(terrain, view, scene.surface.exaggeration, COARSE * large))
        if self._caster[0] != chosen:
            self._caster = chosen, Caster(load(terrain, list(chosen), 1), terrain.grid.shape, 1)
        assert self._caster[1] is not None
        surface = RaySurface(self._caster[1], Projection.of(Camera(view, terrain.chart, scene.surface.exaggeration)))
        middle = lines[:, POINTS // 2]
        tangent = lines[:, POINTS // 2 + 1] - lines[:, POINTS // 2 - 1]
        tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
        half = 0.5 * widths * view.pixel_slope * depth  # metres, where the line is not foreshortened
        seen = np.zeros(len(lines))
        for side in (-1.0, 0.0, 1.0):
            for lift in CLEAR:
                at = middle + side * half[:, None] * tangent
                # What lines are of may lie under the triangles that the ground is.
                over = self._laid(at[:, None], self._caster[1].surfaces)[:, 0, 2]
                at[:, 2] = np.maximum(at[:, 2], over)
                at[:, 2] += lift * large * view.pixel_slope * depth / scene.surface.exaggeration
                pixels, far = view.project(at, scene.surface.exaggeration)
                t = surface.at(pixels[:, 0], pixels[:, 1]).depth
                seen += ~(t < far * (1 - 1e-6))
        held = np.zeros(len(lines))
        c, s = np.cos(places[:, 2]), np.sin(places[:, 2])
        for u, v in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
            x = places[:, 0] + u * widths * c - v * tall * s
            y = places[:, 1] + u * widths * s + v * tall * c
            t = surface.at(x, y).depth
            held += np.abs(np.log(np.nan_to_num(t, nan=1e-9) / depth)) < DEEP
        return np.asarray(_ramp(0.55, 0.95, seen / (3 * len(CLEAR))) * _ramp(0.7, 0.95, held / 4))


def _all_blocks(terrain: Terrain, level: int) -> NDArray[np.int64]:
    """Row and column (n, 2) of a level's blocks."""
    rows, cols = shape_of(terrain, level)
    n_rows, n_cols = max(1, -(-(rows - 1) // BLOCK)), max(1, -(-(cols - 1) // BLOCK))
    return np.stack([a.ravel() for a in np.indices((n_rows, n_cols))], -1)


def _blocks(terrain: Terrain, level: int, blocks: NDArray[np.int64]) -> Boxes:
    """The boxes (n,) of blocks (n, 2) of a level, heights being those of the tiles they lie in."""
    side = BLOCK * 2.0**level
    north, west = blocks.T.astype(np.float64) * side
    last_col, last_row = terrain.grid.cols - 1.0, terrain.grid.rows - 1.0
    east, south = np.minimum(west + side, last_col), np.minimum(north + side, last_row)
    table = terrain.tiles(max(min(level, terrain.levels - 1), 0))
    tile = TILE << max(min(level, terrain.levels - 1), 0)  # samples of the raster
    tile_row = np.minimum((north // tile).astype(np.intp), table.minimum.shape[0] - 1)
    tile_col = np.minimum((west // tile).astype(np.intp), table.minimum.shape[1] - 1)
    low, high = (t[tile_row, tile_col].astype(np.float64) for t in (table.minimum, table.maximum))
    return Boxes(west, east, north, south, low, high)


def _ramp(low: float, high: float, x: Array) -> Array:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def _rates(view: View, exaggeration: float, pixels: Array, depth: Array, slopes: Array) -> Array:
    """Metres of height from pixel to pixel (n,), across the contour, on tangent planes: as ``contour_kernels``."""
    _, ou, ov, d0, du, dv = view.ray_basis(exaggeration)
    ray = d0 + pixels[:, :1] * du + pixels[:, 1:] * dv
    normal = np.concatenate([-slopes, np.ones((len(slopes), 1))], -1)
    facing = (normal * ray).sum(-1)
    facing = np.where(np.abs(facing) < 1e-12, 1e-12, facing)
    change = []
    for o, d in ((ou, du), (ov, dv)):
        u = o + depth[:, None] * d
        change.append(u[:, 2] - (normal * u).sum(-1) / facing * ray[:, 2])
    return np.asarray(np.hypot(*change))


def _uphill(view: View, exaggeration: float, middle: Array, slopes: Array, angle: Array) -> Array:
    """1 where the heads of labels point uphill, −1 where downhill (n,)."""
    size = np.maximum(np.linalg.norm(slopes, axis=-1, keepdims=True), 1e-12)
    step = view.pixel_metres * np.concatenate([slopes / size, size], -1)
    here, there = view.project(middle, exaggeration)[0], view.project(middle + step, exaggeration)[0]
    up = np.stack([np.sin(angle), -np.cos(angle)], -1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sign(np.nan_to_num(((there - here) * up).sum(-1))))
