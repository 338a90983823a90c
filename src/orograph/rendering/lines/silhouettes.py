"""Silhouettes: lines where a ridge stands in front of another or of the sky, and creases, as in drawn panoramas.

Along a row or a column of pixels 1/depth is linear on any plane, however slanted, so its steps are equal there. Where
the step between two pixels is larger than those beside it account for, ground is hidden between them: the surface has
turned away from the eye and begins again farther off. What is hidden, as a part of the distance, is the line's weight:
plains seen at a grazing angle, whose steps are large and alike, have no lines, and a ridge hardly before the next slope
has a faint one. Lines lie on the borders between such pixels, are ``width`` pixels wide, fade and become thinner with
distance, as drawn panoramas have them, and lie as far away as the nearer ground does: haze comes before them. Where the
terrain ends, at its raster's border or at missing data open to it, there is none: that is no ridge.

Ridges that hide next to nothing are found by the normal instead: n · v, the cosine between the ground's normal and the
direction to the eye, falls towards 0 where ground turns away, and rises again where it turns back. Its valleys on the
screen are the image-space form of suggestive contours (DeCarlo et al. 2003, section 5). They are drawn fainter, where
they are deep (``silhouette_kernels.PROMINENT``) and near 0 (``GRAZING``); slopes are means over ``SMOOTH`` pixels, so
that relief finer than that gives no lines that come and go. Within some pixels of a break there is no crease beside it.
On a method's mesh creases are the terrain's own, as contour lines are: a mesh has one at every edge.

A map seen from straight above has no silhouettes. Units: pixels; metres of depth; colours are sRGB from 0 to 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.parallel import map_ordered
from orograph.rendering.lines.silhouette_kernels import WALK
from orograph.rendering.palette import PAPER
from orograph.scene.contours import CASING
from orograph.scene.silhouettes import Silhouettes
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    from orograph.rendering.cpu.ground import Ground
    from orograph.rendering.gbuffer import Area

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

SMOOTH = 2.5
"""Pixels that slopes are averaged over for creases."""

BLOCK = 1 << 15
"""Pixels at a time."""


def rim(lines: Silhouettes) -> int:
    """Pixels around a tile that its silhouettes depend on."""
    return lines.reach + (WALK + 1 if lines.creases > 0 else 3)


def terrain_ends(terrain: Terrain) -> tuple[NDArray[np.float32], int]:
    """The distance to where a terrain ends within its raster, as rotated ones do after projection.

    Returns:
        away: (rows, cols), samples from those of the coarsest level to the nearest missing one that is open to the
            border, 1e9 if there is none. step: samples between those of that level, what ``away`` is good to.
    """
    from scipy.ndimage import distance_transform_edt, label

    level = terrain.levels - 1
    rows, cols = terrain.shape(level)
    away = np.full((rows, cols), 1e9, np.float32)
    if terrain.valid_fraction < 1:
        missing = np.isnan(terrain.read(level, 0, rows, 0, cols))
        parts, _ = label(np.pad(missing, 1, constant_values=True), np.ones((3, 3)))
        outside = (parts == parts[0, 0])[1:-1, 1:-1]
        if outside.any():
            away = (distance_transform_edt(~outside) * 2**level).astype(np.float32)
    return away, 2**level


class Outlines:
    """The silhouettes of one picture, or of an area of it.

    Args:
        lines: ``fitted``. area: pixels of the whole picture. depths: nearest and farthest in view, metres.
    """

    def __init__(self, lines: Silhouettes, ground: Ground, area: Area, depths: tuple[float, float]) -> None:
        self.lines, self.ground, self.area = lines, ground, area
        self.depths = max(depths[0], 1e-3), max(depths[1], depths[0] * 1.001, 2e-3)

    def draw(self, linear: Colors, depth: Array, samples: Array, air: Any) -> None:
        """Draw over a picture.

        Args:
            linear: (rows, cols, 3) of the area. depth: of the ground or the void fill at pixel centres, NaN: none.
            samples: (n, 2) positions in a pixel that its coverage is averaged over.
            air: what comes before lines (``rendering.sky.Atmosphere``), or None.
        """
        middle: Colors = np.zeros((0, 0), np.float32)
        if self.lines.creases > 0:
            i, j = (a.ravel().astype(np.float64) for a in np.indices(depth.shape))
            middle = self._facing(j + (self.area[2] + 0.5), i + (self.area[0] + 0.5), depth.ravel())
            middle = middle.reshape(depth.shape)
        cover, near = self._cover(depth, middle, 0.5, 0.5)
        if len(samples) > 1:
            from scipy.ndimage import binary_dilation

            touched = binary_dilation(cover.max(0) > 0, iterations=1)
            asked = binary_dilation(touched, iterations=rim(self.lines))
            mean, nearest = np.zeros(cover.shape, np.float32), np.full(depth.shape, np.inf)
            rows, cols = np.nonzero(asked)

            def at(place: Array) -> tuple[Colors, Array]:
                moved = depth.copy()
                seen = self.ground.rays.surface.at(cols + self.area[2] + place[0], rows + self.area[0] + place[1])
                moved[rows, cols] = np.where(np.isfinite(seen.void_fill), seen.void_fill, seen.depth)
                facing = middle
                if facing.size:
                    facing = facing.copy()
                    facing[rows, cols] = self._facing(
                        cols + (self.area[2] + place[0]), rows + (self.area[0] + place[1]), moved[rows, cols]
                    )
                return self._cover(moved, facing, *place)

            for one, z in map_ordered(at, list(samples), self.ground.scene.budget.jobs):
                mean += one
                nearest = np.fmin(nearest, np.where(one.max(0) > 0, z, np.inf))
            cover, near = np.where(touched, mean / np.float32(len(samples)), np.float32(0)), nearest
        rows, cols = np.nonzero(cover.max(0) > 0)
        if not len(rows):
            return
        px, py = cols + (self.area[2] + 0.5), rows + (self.area[0] + 0.5)
        t = near[rows, cols]
        hits = None if air is None else self.ground.rays.meet(px.astype(np.float64), py.astype(np.float64), t)
        over = np.float32(self.lines.casing or 0) * np.isfinite(depth[rows, cols])  # no casing on the sky
        opaque = np.float32(self.lines.opacity)
        for color, part in ((PAPER, cover[1][rows, cols] * over), (self.lines.ink, cover[0][rows, cols] * opaque)):
            shade = np.broadcast_to(color, (len(rows), 3)).astype(np.float32)
            if hits is not None:
                shade = air.haze(shade, hits.rays, t)
            linear[rows, cols] += part[:, None].astype(np.float32) * (shade - linear[rows, cols])

    def _facing(self, px: Array, py: Array, depth: Array) -> Colors:
        """n · v of the ground at pixel positions (n,) and depths; NaN where there is none."""
        ground, out = self.ground, np.empty(len(px), np.float32)

        def some(start: int) -> None:
            k = slice(start, start + BLOCK)
            hits = ground.rays.meet(px[k], py[k], depth[k])
            slope = ground.own.gradient(hits.points, SMOOTH * hits.width) @ ground.to_world.T
            slope *= ground.scene.surface.exaggeration
            toward = (slope * hits.rays[:, :2]).sum(-1) - hits.rays[:, 2]
            out[k] = toward / np.sqrt(1 + (slope * slope).sum(-1))

        for _ in map_ordered(some, range(0, len(px), BLOCK), ground.scene.budget.jobs):
            pass
        return out

    def _cover(self, depth: Array, facing: Colors, x: float, y: float) -> tuple[Colors, Array]:
        """Coverage (2, rows, cols) by lines and by their casing where depths are those at (x, y) in each pixel, and
        depths (rows, cols) of the lines."""
        from orograph.rendering.lines.silhouette_kernels import Border, breaks, creases, gather

        rays, grid = self.ground.rays, self.ground.scene.terrain.grid
        rows, cols = depth.shape
        strong, near = np.empty((2, rows, cols), np.float32), np.empty((2, rows, cols))
        border = Border(float(grid.cols - 1), float(grid.rows - 1), *self.ground.ends)
        left, top = self.area[2] + x, self.area[0] + y
        breaks(depth, left, top, rays.pixels, rays.to_samples, border, self.depths, strong, near)
        if facing.size:
            creases(facing, depth, self.depths, self.lines.creases, strong, near)
        cover, nearest = np.zeros((2, rows, cols), np.float32), np.empty((rows, cols))
        for k, casing in enumerate((0.0, CASING) if self.lines.casing else (0.0,)):
            gather(strong, near, self.depths, self.lines.width, casing, self.lines.reach, cover[k], nearest)
        return cover, nearest
