"""Properties of the points where rays meet the ground: position, slope at the pixel's scale, light.

Several threads call everything here with blocks of samples. Positions are kept twice: in sample coordinates (for the
caster and the rasters) and in the terrain's CRS (for drapes). Slopes and normals are those of the stretched ground,
because it is lit in the picture; heights stay true.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.layers import IMAGES, drawn
from orograph.geovis.missing import patches
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lighting.relief import Relief
from orograph.lighting.sun import Sun
from orograph.memo import Memo
from orograph.raycast.caster import Caster
from orograph.raycast.select import load, rectangles
from orograph.rendering.cpu.kernels import footprints, incidence
from orograph.rendering.cpu.raster import MeshSurface
from orograph.rendering.gbuffer import Surface
from orograph.rendering.layered import Layered
from orograph.rendering.lines.silhouettes import terrain_ends
from orograph.rendering.memory import BYTES_PER_PIXEL, band_pixels
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.rendering.rays import Hits, Rays
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera

Array = NDArray[np.float64]

COARSEST = 1000.0
"""Tolerance beyond which there is no further gain, pixels."""


FIXED_MEMORY = 300 << 20
"""Bytes that a picture takes whatever the terrain: the interpreter and its libraries, light maps, blocks of samples."""

MEAN_BYTES = 4 * 4 / 3
"""Bytes per sample of means, including the coarser levels around it."""

Cast = Callable[[Scene, "Sequence[Rectangle] | None", Projection], Surface]
"""Makes the visible surface of a scene: from these windows of heights or (None) the mesh of its method."""

LEAST_MEMORY = 24 << 20
"""Bytes of heights that are loaded even if --max-memory leaves no room for them."""


def fixed_memory(scene: Scene) -> int:
    """Bytes that drawing a scene takes in addition to its heights."""
    _, _, width, height = scene.view.frame
    pixels = width * height
    if scene.view.part is not None:  # the same for all tiles, so that all are drawn from the same heights
        pixels = min(pixels, band_pixels(scene.budget.max_memory))
    images = (scene.budget.max_memory or 0) // IMAGES if drawn(scene.data.layers) else 0
    return FIXED_MEMORY + BYTES_PER_PIXEL * pixels + images


def budget_of(scene: Scene) -> float:
    """Bytes available for heights and means."""
    most = scene.budget.max_memory
    return math.inf if most is None else max(most - fixed_memory(scene), LEAST_MEMORY)


def means_of(scene: Scene, terrain: Terrain) -> ClipStack:
    """Windows of means about as fine as pixels, outermost first.

    They are coarser if half of the memory for heights does not suffice.
    """
    pixels, most = 1.0, budget_of(scene) / 2
    while True:
        found = rectangles(terrain, scene.view.whole, scene.surface.exaggeration, pixels, by="spacing")
        fits = MEAN_BYTES * found.samples <= most
        if fits or pixels > COARSEST or found[-1].level == terrain.levels - 1:
            return found
        pixels *= 1.25


class Ground:
    """The caster and relief a scene needs, loaded within its budget of memory.

    Attributes:
        relief: of the lit surface. drawn: of the surface that rays meet. own: for a mesh with silhouettes, of the
            terrain itself, whose creases it shows; else as relief.
        bare: the scene; for a mesh, that of the terrain itself, whose tint, water and strength of relief it shares.
        under: for a mesh with contour lines, the ground of the terrain itself, to which they belong; else None.
    """

    def __init__(
        self, scene: Scene, surface: Terrain, windows: Sequence[Rectangle], tolerance: float, memo: Memo,
        mesh: Tessellation | None = None, cast: Cast | None = None,
    ) -> None:  # fmt: skip
        terrain = scene.terrain
        self.scene, self.tolerance, self._surface, self._memo = scene, tolerance, surface, memo
        self.bare = scene
        self.under: Ground | None = None
        self.windows = windows
        shape, jobs = terrain.grid.shape, scene.budget.jobs
        means = means_of(scene, terrain)
        self.relief = memo("relief", tuple(means), lambda: Relief.load(terrain, means, jobs), terrain)
        self.drawn = self.own = self.relief
        self.rays = Rays(scene, self._seen(scene, mesh, memo, cast))
        if scene.annotations.silhouettes is not None:
            self.ends = memo("ends", shape, lambda: terrain_ends(terrain), terrain)  # for silhouettes
        self.linear = linear = terrain.chart.linear  # metres east and north per column and per row
        self.to_world = np.linalg.inv(linear).T  # gradients per sample → gradients per metre
        self.to_samples = np.linalg.inv(linear)

    @cached_property
    def caster(self) -> Caster:
        """Of the windows' heights, loaded on first use."""
        jobs, windows, surface = self.scene.budget.jobs, self.windows, self._surface
        shape = self.scene.terrain.grid.shape
        return self._memo(
            "caster", (tuple(windows), jobs), lambda: Caster(load(surface, windows, jobs), shape, jobs), surface
        )

    @cached_property
    def single(self) -> Caster:
        """The same, but in the calling thread alone."""
        single = copy.copy(self.caster)
        single.jobs = 1
        return single

    def _seen(self, scene: Scene, mesh: Tessellation | None, memo: Memo, cast: Cast | None) -> Surface:
        """The visible surface: a mesh's triangles, or the caster's heights, behind patches over missing data."""
        view, jobs = scene.view.whole, scene.budget.jobs
        projection = Projection.of(Camera(view, scene.terrain.chart, scene.surface.exaggeration))
        seen: Surface
        if cast is not None:
            seen = cast(scene, self.windows, projection)
        elif mesh is None:
            seen = RaySurface(self.caster, projection)
        else:
            known = view, scene.surface.exaggeration, jobs
            seen = memo(
                "triangles", known, lambda: MeshSurface(mesh.vertices, mesh.triangles, projection, jobs), mesh
            )  # fmt: skip
        if scene.terrain.valid_fraction < 1:
            shape = scene.terrain.grid.shape
            found = memo("patches", shape, lambda: patches(self.caster.stack.windows, shape), self.caster)
            if found:
                over = memo("over", jobs, lambda: Caster(found, shape, jobs), found)
                return Layered(seen, RaySurface(over, projection))
        return seen

    @classmethod
    def load(
        cls, scene: Scene, surface: Terrain | None = None, memo: Memo | None = None, bare: Scene | None = None,
        mesh: Tessellation | None = None, cast: Cast | None = None,
    ) -> Ground:  # fmt: skip
        """Choose windows that keep the scene's tolerance, or the nearest to it that fits into the allowed memory.

        Args:
            surface: the lit surface, if not the terrain itself (on the same grid): the heights of a mesh.
            memo: results of earlier pictures.
            bare: for a mesh, the scene of the terrain itself, to which contour lines belong.
            mesh: the visible surface, if not the heights.
            cast: makes the visible surface, if it is not made here.
        """
        memo = Memo() if memo is None else memo
        if bare is not None:
            both = scene.annotations.contours is not None
            half = (
                (scene.budget.max_memory + fixed_memory(scene)) // 2
                if both and scene.budget.max_memory
                else scene.budget.max_memory
            )
            ground = cls.load(scene.but(contours=None, max_memory=half), surface, memo, mesh=mesh, cast=cast)
            ground.bare = bare
            if scene.annotations.silhouettes is not None and scene.terrain is not bare.terrain:
                means = means_of(scene, bare.terrain)
                ground.own = memo(
                    "own relief",
                    tuple(means),
                    lambda: Relief.load(bare.terrain, means, scene.budget.jobs),
                    bare.terrain,
                )
            if not both:
                return ground
            ground.under = cls.load(bare.but(max_memory=half), None, memo)
            if surface is not None and surface is not scene.terrain:
                means = means_of(scene, surface)
                ground.drawn = memo(
                    "relief", tuple(means), lambda: Relief.load(surface, means, scene.budget.jobs), surface
                )
            return ground
        terrain = scene.terrain if surface is None else surface
        rows, cols = terrain.grid.shape
        tolerance, by = scene.pixel_tolerance, "error"
        if scene.annotations.contours is not None and tolerance > 0:
            if scene.view.projection == "plan":  # in a plan, heights only move lines: use samples as fine as pixels
                tolerance, by = 0.7, "spacing"
            else:
                tolerance *= scene.annotations.contours.finer(terrain, scene.view.whole, memo)
        # Heights take 4 bytes and their pyramids 5/12 of that, and the same again while they are combined.
        bytes_per_sample = 4 * (1 + 5 / 12) + 4
        budget = budget_of(scene) - MEAN_BYTES * sum(r.samples for r in means_of(scene, terrain))
        if tolerance == 0 and rows * cols * bytes_per_sample <= budget:
            return cls(scene, terrain, [Rectangle.whole(0, (rows, cols))], 0.0, memo, mesh, cast)
        tolerance = tolerance or 0.05
        while True:
            chosen = rectangles(terrain, scene.view.whole, scene.surface.exaggeration, tolerance, by=by)
            fits = sum(r.samples for r in chosen) * bytes_per_sample <= budget
            # Ground around the eye is exact at any tolerance; it is drawn whatever the budget.
            if fits or tolerance > COARSEST or chosen[-1].level == terrain.levels - 1:
                return cls(scene, terrain, chosen, tolerance, memo, mesh, cast)
            tolerance *= 1.25

    def incidence(self, hits: Hits, to_sun: Array, strength: float) -> tuple[Array, Array]:
        """Cosine of the sun's angle of incidence (n,), not below 0, and the upward part of the normal (n,).

        Slopes are averaged over each pixel, and multiplied by the exaggeration and ``strength``.
        """
        gradient = self.relief.gradient(hits.points, hits.width)
        cosine, tilt = np.empty(len(gradient)), np.empty(len(gradient))
        incidence(gradient, self.to_world, self.scene.surface.exaggeration * strength, to_sun, cosine, tilt)
        return cosine, tilt

    def footprints(self, hits: Hits, px: Array, py: Array) -> tuple[Array, Array]:
        """The footprint of pixels on the ground (n, 4) and its smallest width (n,), metres (``kernels.footprints``)."""
        n = len(px)
        gradient = self.relief.gradient(hits.points, hits.width)
        slope = np.asarray(gradient, np.float64) @ self.to_world.T
        ground, least = np.empty((n, 4)), np.empty(n)
        footprints(px, py, hits.t, self.rays.pixels, slope, ground, least)
        return ground, least

    def skyline(self, hits: Hits, sun: Sun, which: NDArray[np.int64]) -> Array:
        """Tangent of the horizon's angle towards the sun on the stretched ground, for the hits in ``which``.

        It is clamped just around the sun's disc.
        """
        radius = sun.diameter / 2
        low = math.tan(math.radians(max(sun.altitude - radius, -89.0)))
        high = math.tan(math.radians(min(sun.altitude + radius, 89.9)))
        a = math.radians(sun.azimuth)
        step = self.to_samples @ [math.sin(a), math.cos(a)]
        x, skip = self.scene.surface.exaggeration, self.skip(hits, which)
        return self.single.skyline(hits.points[which], (step[0], step[1]), skip, low / x, high / x) * x

    def skip(self, hits: Hits, which: NDArray[np.int64]) -> Array:
        """Distance around the hits in ``which`` within which their own facet would shade them, metres.

        There, the normal decides instead; a pixel also limits detail.
        """
        x, y = hits.points[which, 0], hits.points[which, 1]
        facet = np.ones(len(which))
        for r in self.windows:  # the last one that contains a point is the finest there
            inside = (x >= r.col0 << r.level) & (x <= (r.col1 - 1) << r.level)
            facet[inside & (y >= r.row0 << r.level) & (y <= (r.row1 - 1) << r.level)] = 1 << r.level
        return np.asarray(np.maximum(facet, np.minimum(hits.width[which], 4.0)) * self.rays.to_samples.spacing)
