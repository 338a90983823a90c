"""Which windows of which levels a view needs: nested rectangles, each as coarse as the tolerance in pixels allows.

From the coarsest level down, the tiles of a level that lie in the view's frustum and whose error, projected, exceeds
the tolerance must be drawn finer; the rectangle of the next finer level is the smallest that holds them. So every tile
in view is drawn at a level whose projected error keeps the tolerance, and windows nest by construction.

The projected error of a vertical displacement e (metres, stretched) at depth z and radius r from the optical axis is at
most f·e/z · sqrt(1 + (r/z)²) pixels, f = 1/pixel_slope; with z = d·cos θ, d the distance from the eye, that is at most
f·e / ((d − e)·cos² θ), θ the angle to the corner of the picture: the factor 1/cos² is what distance-based metrics
forget. A tile that is only partly valid is held to samples of at most a pixel besides, since its error says nothing of
its rim.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import read_only
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.parallel import map_ordered
from orograph.raycast.finer import Eye, needed
from orograph.raycast.stack import HeightWindow
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Boxes:
    """The tiles of one level: extents (ty, tx) in sample coordinates and heights, NaN where a tile is empty."""

    west: Array
    east: Array
    north: Array
    south: Array
    low: Array
    high: Array


def tile_boxes(terrain: Terrain, level: int) -> Boxes:
    """Bounding boxes of a level's tiles."""
    table = terrain.tiles(level)
    (ty, tx), step = table.minimum.shape, float(TILE << level)
    west, north = np.meshgrid(np.arange(tx) * step, np.arange(ty) * step)
    last_col, last_row = terrain.grid.cols - 1.0, terrain.grid.rows - 1.0
    east, south = np.minimum(west + step, last_col), np.minimum(north + step, last_row)
    return Boxes(west, east, north, south, table.minimum.astype(np.float64), table.maximum.astype(np.float64))


Planes = Sequence[tuple[float, ...]]
"""a·column + b·row + c·height + d ≥ 0 of what is inside each."""


def frustum_planes(terrain: Terrain, view: View, exaggeration: float) -> Planes:
    """The planes of a view's frustum in sample coordinates."""
    return terrain.chart.planes(view.frustum(exaggeration).tolist(), exaggeration)


def in_frustum(terrain: Terrain, view: View, exaggeration: float, boxes: Boxes) -> NDArray[np.bool_]:
    """Tiles whose box is not wholly outside one plane of the view's frustum (conservative)."""
    inside = np.isfinite(boxes.high)
    for px, py, pz, p0 in frustum_planes(terrain, view, exaggeration):
        # The box's most positive corner decides.
        reach = p0 + px * (boxes.east if px > 0 else boxes.west) + py * (boxes.south if py > 0 else boxes.north)
        inside &= reach + pz * (boxes.high if pz > 0 else boxes.low) >= 0
    return inside


def distances(terrain: Terrain, view: View, exaggeration: float, boxes: Boxes) -> Array:
    """A lower bound of the distance from the eye to each box, metres of stretched space."""
    col, row = terrain.grid.index(view.eye[0], view.eye[1])
    sx, sy = terrain.chart.least_steps
    dx = np.maximum(np.maximum(boxes.west - col, col - boxes.east), 0) * sx
    dy = np.maximum(np.maximum(boxes.north - row, row - boxes.south), 0) * sy
    dz = np.maximum(np.maximum(boxes.low - view.eye[2], view.eye[2] - boxes.high), 0) * exaggeration
    return np.asarray(np.sqrt(dx * dx + dy * dy + dz * dz))


def off_axis(view: View) -> float:
    """cos² of the angle between the viewing direction and the picture's corner."""
    half = math.tan(math.radians(view.fov_y) / 2)
    _, _, width, height = view.frame
    return 1.0 / (1.0 + half * half * (1.0 + (width / height) ** 2))


def moved(terrain: Terrain, view: View, exaggeration: float, error: Array, boxes: Boxes) -> Array:
    """An upper bound, in pixels, of what vertical distances (metres) within boxes displace on the screen.

    Distances are of the shape of the boxes, or stacks of such arrays.
    """
    if view.projection == "plan":
        return np.zeros(error.shape)
    error, focal = error * exaggeration, 1.0 / view.pixel_slope
    d = np.maximum(distances(terrain, view, exaggeration, boxes), view.near)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(d > error, focal * error / ((d - error) * off_axis(view)), np.inf)
    return np.where(error > 0, found, 0.0)


def spacing_error(terrain: Terrain, view: View, exaggeration: float, level: int, boxes: Boxes) -> Array:
    """Samples of ``level`` in pixels (at most): above 1 they can be drawn finer."""
    spacing = max(terrain.grid.spacing) * 2.0**level
    if view.projection == "plan":
        return np.full(boxes.low.shape, spacing / view.pixel_metres)
    d = np.maximum(distances(terrain, view, exaggeration, boxes), max(view.near, 1e-9))
    return spacing / view.pixel_slope / d


def rectangles(terrain: Terrain, view: View, exaggeration: float, tolerance: float, *, by: str = "error") -> ClipStack:
    """The windows a view needs, outermost first; the outermost covers the whole terrain at its coarsest level.

    Args:
        tolerance: pixels.
        by: "error": displacement on the screen (the surface), or "spacing": size of samples (its light).
    """
    top, eye = terrain.levels - 1, _eye(terrain, view, exaggeration, tolerance, by)
    found = [Rectangle.whole(top, terrain.shape(top))]
    last, spacing = (terrain.grid.rows - 1.0, terrain.grid.cols - 1.0), max(terrain.grid.spacing)
    for level in range(top, 0, -1):
        # Only tiles within the window above count: what it left out was fine enough there already.
        outer, table = found[-1], terrain.tiles(level)
        part = outer.row0 // TILE, -(-(outer.row1 - 1) // TILE), outer.col0 // TILE, -(-(outer.col1 - 1) // TILE)
        tables = (read_only(np.ascontiguousarray(a)) for a in (table.minimum, table.maximum, table.error, table.valid))
        row0, row1, col0, col1 = needed(*tables, part, float(TILE << level), spacing * 2.0**level, last, eye)
        if row0 < 0:
            break
        window = Rectangle(
            level - 1, 2 * TILE * row0, 2 * TILE * (row1 + 1) + 1, 2 * TILE * col0, 2 * TILE * (col1 + 1) + 1
        )
        found.append(window.cut(terrain.shape(level - 1)))
    return ClipStack(found).visible(terrain.shape)


def _eye(terrain: Terrain, view: View, exaggeration: float, tolerance: float, by: str) -> Eye:
    col, row = terrain.grid.index(view.eye[0], view.eye[1])
    plan = view.projection == "plan"
    return Eye(
        np.array(frustum_planes(terrain, view, exaggeration)), (float(col), float(row), view.eye[2]),
        (*terrain.chart.least_steps, float(exaggeration)), view.pixel_metres if plan else view.pixel_slope,
        off_axis(view), float(view.near), plan, by == "error", float(tolerance),
    )  # fmt: skip


def load(terrain: Terrain, found: Sequence[Rectangle], jobs: int | None = None) -> list[HeightWindow]:
    """Read nested heights for the caster."""
    return [
        HeightWindow(r.level, r.col0, r.row0, h)
        for r, h in zip(found, map_ordered(lambda r: terrain.read(*r), found, jobs))
    ]
