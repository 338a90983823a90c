"""Things that stand on the ground, drawn over a finished picture: what its depth hides is hidden, or shows through.

Each thing is a solid that rays are cast at, exactly, several through each pixel that it may cover; the pictures of both
backends carry the depth that this needs. The foot of a thing is at the surface's own height; what stands is not
stretched by the exaggeration, the ground beneath it is. Units: metres, pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.data.standing import Kind, Things
from orograph.parallel import for_each
from orograph.progress import Progress
from orograph.rendering.jitter import pattern
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import RayBasis, View

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

ROWS = 32
"""Rows of a picture that a thread draws at a time."""

BLOCK, CELLS = 4096, 48
"""Things whose boxes are made at a time; of more of them, boxes are merged in so many cells along each side."""

AMBIENT = 0.45
"""The ambient share of the light on things."""


@dataclass(frozen=True, slots=True, eq=False)
class Stood:
    """A picture with things on its ground.

    Attributes:
        pixels: (height, width, 3) uint8. depth: (height, width), with theirs. which: (height, width) the thing that is
            visible, −1 for none. missing: things whose place has no ground.
    """

    pixels: NDArray[np.uint8]
    depth: Array
    which: NDArray[np.int32]
    missing: int

    def reported(self, progress: Progress) -> tuple[NDArray[np.uint8], Array]:
        """Pixels and depth; reports how many things are not drawn."""
        if self.missing:
            progress.warn(f"{self.missing} place(s) of the data have no ground: nothing is drawn there.")
        return self.pixels, self.depth


def stand(
    things: Things, pixels: NDArray[np.uint8], depth: NDArray[np.floating], scene: Scene,
    placed: tuple[Array, Array] | None = None,
) -> Stood:  # fmt: skip
    """Draw things over a picture.

    Args:
        pixels: (height, width, 3) uint8 sRGB; left as they are. depth: (height, width) metres, NaN where no ground is.
        scene: what the picture shows; its view may be a tile.
        placed: feet and other ends, if they are known (``places``).
    """
    from orograph.rendering.shadows import shade
    from orograph.rendering.standing_kernels import Eye, Light, Sheet, Solids, cast

    place, end = placed or places(things, scene.terrain, scene.surface.exaggeration)
    shadow = things.kind == Kind.SHADOW
    known = np.isfinite(place[:, 2]) | shadow
    basis, origin = _basis(scene)
    boxes = _boxes(things, place, end, scene)
    seen = known & ~shadow & (boxes[:, 0] <= boxes[:, 1]) & (boxes[:, 2] <= boxes[:, 3])
    rows, cols = depth.shape
    offsets = pattern(max(1, min(scene.surface.samples, 16)))
    far = np.where(np.isfinite(depth), depth, np.inf).astype(np.float64)
    out, nearest_depth = pixels.copy(), np.array(depth, np.float64)
    shade(things, out, depth, scene)
    which = np.full(depth.shape, -1, np.int32)
    forward = np.asarray(scene.view.axes(scene.surface.exaggeration)[2])[:2]
    flat = float(np.hypot(*forward))
    ahead = forward / flat if flat > 1e-9 else np.array([0.0, 1.0])
    hidden = np.zeros(len(things)) if things.hidden is None else things.hidden
    if flat <= 1e-9:  # seen from above, slopes hide nothing of what stands on them
        floating = False if things.ends is None else np.isfinite(things.ends).any(1)
        hidden = np.where(floating | (hidden > 0), hidden, 1.0)
    through = np.unique(hidden[hidden > 0])
    sun = np.array(scene.lighting.sun.direction)
    eye, light = Eye(basis, offsets, ahead, scene.view.near), Light(sun, AMBIENT)
    solids = Solids(things.kind, place - origin, end, things.radius, things.height, things.rgb, boxes)

    def band(top: int) -> None:
        last = min(top + ROWS, rows)
        chosen = np.flatnonzero(seen & (boxes[:, 2] < last) & (boxes[:, 3] >= top))
        if not len(chosen):
            return
        shape = last - top, cols, len(offsets)

        def draw(chosen: NDArray[np.intp], depths: Array, seen: NDArray[np.int32]) -> tuple[Colors, Array]:
            color, nearest = np.zeros((*shape, 3), np.float32), np.full(shape, np.inf)
            cast(solids, chosen, eye, light, Sheet(top, depths, color, nearest, seen))
            return color, nearest

        for opacity in through:
            below = np.full(shape[:2], -1, np.int32)
            deep = chosen[hidden[chosen] == opacity]
            color, nearest = draw(deep, np.full(shape[:2], np.inf), below)
            hit = np.isfinite(nearest) & (nearest >= far[top:last][..., None])
            _blend(out[top:last], color * hit[..., None] * np.float32(opacity), hit.sum(-1) * np.float32(opacity))
            which[top:last] = np.where(hit[..., 0], below, which[top:last])
        color, nearest = draw(chosen, far[top:last], which[top:last])
        hit = np.isfinite(nearest)
        _blend(out[top:last], color, hit.sum(-1).astype(np.float32))
        mostly = 2 * hit.sum(-1) > len(offsets)
        nearest_depth[top:last][mostly] = nearest.min(-1)[mostly]

    for_each(band, range(0, rows, ROWS), scene.budget.jobs)
    return Stood(out, nearest_depth, which, int((~known).sum()))


def _blend(pixels: NDArray[np.uint8], color: Colors, hits: Colors) -> None:
    """Lay colours (rows, cols, samples, 3), multiplied by their opacity, over pixels.

    Args:
        hits: (rows, cols) the sum of the samples' opacities.
    """
    some, samples = hits > 0, np.float32(color.shape[2])
    under = srgb_to_linear(pixels[some] / np.float32(255))
    mixed = under * (1 - hits[some][:, None] / samples) + color[some].sum(1) / samples
    pixels[some] = np.rint(linear_to_srgb(mixed) * 255)


def with_room(scene: Scene, again: Callable[..., View]) -> Scene:
    """A scene of an automatic camera, seen from so far that all that stands is in the picture, and beside its legend.

    Args:
        again: makes the camera, as ``camera.whole`` does: ``also`` are further positions (n, 3) to show.
    """
    points = extent_of(scene)
    if points is None and not (scene.annotations.furniture and scene.keys):
        return scene
    view = again(also=points)
    return scene if view == scene.view else scene.but(view=view)


def extent_of(scene: Scene) -> Array | None:
    """Positions (n, 3) around everything that stands in a scene, whatever its priority; None: nothing stands."""
    scenes = [scene, *(one.scene for one in scene.variants)]
    found = [
        extent(one.theme.things, one.terrain, one.surface.exaggeration)
        for one in scenes if one.theme.things is not None
    ]  # fmt: skip
    return np.concatenate(found) if any(map(len, found)) else None


def extent(things: Things, terrain: Terrain, exaggeration: float) -> Array:
    """Positions (m, 3) around what is visible of things, above the ground or through it: the corners of boxes.

    In the terrain's CRS, true metres. Of many things, neighbours have one box.
    """
    place, end = places(things, terrain, exaggeration)
    alone = np.full(len(things), np.nan)
    ground = _stretched(things.x, things.y, alone, np.zeros(len(things)), terrain, 1.0)[:, 2]
    through = np.zeros(len(things)) if things.hidden is None else things.hidden
    shown = np.isfinite(place[:, 2]) & (things.kind != Kind.SHADOW)
    low, high = np.empty((2, len(things), 3))
    for start in range(0, len(things), BLOCK):
        k = slice(start, start + BLOCK)
        corners = _corners(things, place, end, exaggeration, k)
        low[k], high[k] = corners.min(0), corners.max(0)
    shown &= (through > 0) | ~(high[:, 2] < ground)
    low[:, 2] = np.where(through > 0, low[:, 2], np.fmax(low[:, 2], ground))
    low, high = low[shown], high[shown]
    if len(low) > BLOCK:
        span = np.maximum(np.ptp(low[:, :2], axis=0), 1e-9)
        cell = (CELLS * (low[:, :2] - low[:, :2].min(0)) / span).astype(np.int64) @ [CELLS + 1, 1]
        order = np.argsort(cell, kind="stable")
        first = np.unique(cell[order], return_index=True)[1]
        low, high = np.minimum.reduceat(low[order], first), np.maximum.reduceat(high[order], first)
    return np.concatenate([np.where(side, high, low) for side in np.ndindex(2, 2, 2)]) if len(low) else low


def places(things: Things, terrain: Terrain, exaggeration: float) -> tuple[Array, Array]:
    """Where things stand, (n, 3), and from there to the other ends of tubes and walls, (n, 3), else 0."""
    place = feet(things, terrain, exaggeration)
    return place, np.nan_to_num(heads(things, terrain, exaggeration) - place)


def feet(things: Things, terrain: Terrain, exaggeration: float) -> Array:
    """(n, 3) where things stand: easting, northing, and the stretched height of their foot; NaN where no ground is."""
    level = np.full(len(things), np.nan) if things.ends is None else things.ends[:, 0]
    return _stretched(things.x, things.y, level, things.lift, terrain, exaggeration)


def heads(things: Things, terrain: Terrain, exaggeration: float) -> Array:
    """(n, 3) the other ends of tubes and walls, as ``feet``; NaN of what stands upright."""
    if things.ends is None:
        return np.full((len(things), 3), np.nan)
    _, x, y, level = things.ends.T
    there = np.isfinite(x)
    found = np.full((len(things), 3), np.nan)
    found[there] = _stretched(x[there], y[there], level[there], things.lift[there], terrain, exaggeration)
    return found


def _stretched(x: Array, y: Array, level: Array, lift: Array, terrain: Terrain, exaggeration: float) -> Array:
    """(n, 3) places at heights; where ``level`` is NaN, those of the ground."""
    from orograph.measuring.ground import heights

    col, row = terrain.grid.index(x, y)
    rows, cols = terrain.grid.shape
    inside = (col >= 0) & (row >= 0) & (col <= cols - 1) & (row <= rows - 1)
    z = np.where(inside, heights(terrain, np.clip(col, 0, cols - 1), np.clip(row, 0, rows - 1)), np.nan)
    return np.stack([x, y, np.where(np.isfinite(level), level, z) * exaggeration + lift], 1)


def _basis(scene: Scene) -> tuple[RayBasis, Array]:
    """Rays by pixel position, in stretched space relative to an origin, and that origin, (3,)."""
    stretch = np.array([1.0, 1.0, scene.surface.exaggeration])
    basis = RayBasis(*(one * stretch for one in scene.view.ray_basis(scene.surface.exaggeration)))
    return basis._replace(o0=np.zeros(3)), basis.o0


def _boxes(things: Things, place: Array, end: Array, scene: Scene) -> NDArray[np.int64]:
    """(n, 4) first and last column, first and last row that each may cover; of what lies around the eye, all."""
    corners = _corners(things, place, end, scene.surface.exaggeration)
    (xy, depth), view = scene.view.project(corners, scene.surface.exaggeration), scene.view
    around = (depth <= 0).any(0) & (depth > 0).any(0)
    behind = (depth <= 0).all(0) | ~np.isfinite(place[:, 2])
    xy = np.nan_to_num(xy)
    least, most = np.floor(xy.min(0)), np.floor(xy.max(0))
    boxes = np.stack([least[:, 0], most[:, 0], least[:, 1], most[:, 1]], 1)
    boxes[around] = 0, view.width - 1, 0, view.height - 1
    boxes[behind] = 0, -1, 0, -1
    size = np.array([view.width, view.width, view.height, view.height])
    clipped: NDArray[np.int64] = np.clip(boxes, -1, size).astype(np.int64)
    return clipped


def _corners(things: Things, place: Array, end: Array, exaggeration: float, some: slice = slice(None)) -> Array:
    """(k, n, 3) positions, in true metres, whose hull each of some things lies in."""
    kind, radius, place, end = things.kind[some], things.radius[some], place[some], end[some]
    wide = np.where(np.isin(kind, (Kind.FLAG, Kind.TUBE)), radius, radius * np.sqrt(2))
    flat = np.isin(kind, (Kind.PANEL, Kind.SECTION))
    wide = np.where(flat | (kind == Kind.WALL), 0.0, wide)
    tube = kind == Kind.TUBE
    low, high = np.where(tube, -wide, 0.0), np.where(tube, wide, things.height[some])
    high = np.where(kind == Kind.COLUMN, 0.0, high)
    corners = np.stack([
        foot + np.stack([i * wide, j * wide, up], 1)
        for foot in (place, place + end) for i in (-1, 1) for j in (-1, 1) for up in (low, high)
    ])  # fmt: skip
    # The other two corners of panels and sections.
    rise = np.where(flat, end[:, 2], 0.0)[:, None] * [0.0, 0.0, 1.0]
    corners = np.concatenate([corners, [place + rise, place + end - rise]])
    corners[..., 2] /= exaggeration
    return np.asarray(corners)
