"""From the data at a point of the ground to the colour of a pixel.

Light is a warm disc of sun, cut by the skyline (soft shadows), and blue light from the visible part of the sky
(sky-view factor by horizon sweeps). Level ground in full sun shows the map's own colour, so tints can be compared with
the legend there (except for the brightest, which ``_shoulder`` in ``kernels`` bends). Water, missing data and
background are distinct. Colours are linear light throughout.
"""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import tint_of
from orograph.geovis.layers import MOST, Layer, composite, drawn, nothing_over
from orograph.lighting.shade import disc_fraction
from orograph.memo import Memo
from orograph.progress import SILENT, Progress
from orograph.rendering.cpu.ground import Ground
from orograph.rendering.cpu.kernels import Light, compose, paint
from orograph.rendering.cpu.lighting import Lighting, Shine, field_ahead, lighting_of
from orograph.rendering.cpu.mapgrid import MapGrid
from orograph.rendering.lookup import LEAST
from orograph.rendering.palette import BOUNCE, PAPER, WATER, hatching, illumination
from orograph.rendering.rays import Hits
from orograph.rendering.sky import Atmosphere, dithered
from orograph.rendering.survey import Survey
from orograph.scene.scene import Scene

if TYPE_CHECKING:
    from orograph.geovis.drape import Drape

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

NOTHING = np.empty((0, 7), np.float32)

SMOOTH = 0.5
"""Samples that a pixel covers below which colours change so slowly that bytes would show bands."""


def drapes_of(
    scene: Scene, ground: Ground, survey: Survey, memo: Memo, progress: Progress
) -> list[tuple[Layer, Drape]]:  # fmt: skip
    """The visible layers with their loaded data, bottom to top, ready for look-ups by the picture.

    Warnings are given once.
    """
    layers = drawn(scene.data.layers)
    if not layers:
        return []
    from orograph.geovis.drape import Drape
    from orograph.geovis.laying import Laid

    terrain, view = scene.terrain, scene.view.whole
    grid = terrain.grid
    # Half the spacing that the nearest of some hits needs: other rays may meet nearer ground.
    pixel = view.pixel_metres if view.projection == "plan" else view.pixel_slope * survey.range[0]
    metres = 0.5 * LEAST * pixel
    metres = 2.0 ** math.floor(math.log2(metres)) if metres > 0 else 0.0  # the same for all frames of a slow flight
    memory = None if scene.budget.max_memory is None else scene.budget.max_memory // len(layers)

    def held(layer: Layer) -> Drape:
        """The loaded data of a layer: the same for all frames that need it no finer, or that read it on demand."""
        content = layer.content
        laid = memo("laid", content, lambda: Laid.open(content, grid), terrain, MOST)
        plan = Drape.plan(laid, memory, metres)

        def opened() -> Drape:
            drape = Drape.of(laid, *plan, progress)
            for warning in drape.warnings:
                progress.warn(warning)
            return drape

        return memo("drape", (content, plan), opened, laid, MOST)

    drapes = [(layer, held(layer)) for layer in layers]
    if any(drape.tiles is not None for _, drape in drapes):
        x, y = grid.xy(survey.hits.points[:, 0], survey.hits.points[:, 1])
        footprints = ground.footprints(survey.hits, survey.px, survey.py)
        for _, drape in drapes:
            drape.prepare(x, y, *footprints, progress=progress, jobs=scene.budget.jobs)
    return drapes


class Shader:
    """Colours samples of one scene.

    Attributes:
        shown: pixel centres coloured so far: "ground", of which "draped" (mostly covered by layers) and "water" (the
            rest of it), and "missing".
    """

    def __init__(self, scene: Scene, ground: Ground, survey: Survey, memo: Memo, progress: Progress = SILENT) -> None:
        self.scene, self.ground = scene, ground
        self.facts: dict[str, Any] = {}
        self.shown = {"ground": 0, "water": 0, "draped": 0, "missing": 0}
        self._lock = threading.Lock()
        self.to_sun, self.sunlight, self.skylight = illumination(scene.lighting.sun)
        ahead = field_ahead(scene, memo)
        self.maps = MapGrid(scene, ground, survey, memo)
        terrain, sea = ground.bare.terrain, None if scene.data.water is not None else False
        self.tint = memo(
            "tint", (scene.data.colormap, sea, scene.data.range),
            lambda: tint_of(terrain, scene.data.colormap, sea, scene.data.range), terrain,
        )  # fmt: skip
        self.air = None
        if scene.lighting.sky:
            self.air = Atmosphere(scene, scene.lighting.depths or survey.range, memo)
        self.lines = None
        if scene.annotations.contours is not None:
            from orograph.rendering.cpu.marks import Lines

            self.lines = Lines(scene, ground, self.maps, memo)
            self.facts["contours"] = self.lines.facts
        self.drapes = drapes_of(scene, ground, survey, memo, progress)
        self.strength = self.maps.strength
        self.lighting: Lighting | None = None
        if scene.lighting.light != "relief":
            bounce = np.float32(BOUNCE) * (self.sunlight + self.skylight)
            shine = Shine(self.to_sun, self.sunlight, self.skylight, bounce)
            self.lighting = lighting_of(scene, ground, shine, self.maps.window, self.strength, memo, progress, ahead)
            self.facts["light"] = self.lighting.description
        self.lower_limb = math.tan(
            math.radians(max(scene.lighting.sun.altitude - scene.lighting.sun.diameter / 2, -89.0))
        ) * (1 + 1e-9)
        self.facts["relief"] = self.strength
        self.facts["tint_from_to_m"] = [self.tint.low, self.tint.high]
        self.facts["water_fraction"] = self.maps.water_fraction

    @property
    def smooth(self) -> bool:
        """Whether colours change fast only where the ground in view does, or from land to water."""
        if self.lines is not None:
            return False
        return not self.drapes and self.lighting is not None and self.lighting.smooth

    def color(
        self, hits: Hits, px: Array, py: Array, counted: NDArray[np.bool_] | None = None,
        wet: NDArray[np.bool_] | None = None,
    ) -> Colors:  # fmt: skip
        """Linear colours (n, 3) of the samples in ``hits`` at pixel positions px, py (n,).

        ``counted`` (n,): which of them count for ``shown``; None: none. ``wet`` (n,): receives which of them are water.
        """
        out = np.empty((len(hits.t), 3), np.float32)
        missed = np.flatnonzero(np.isnan(hits.t))
        if len(missed):
            out[missed] = self.background(hits.rays[missed], px[missed], py[missed])
        if len(missed) < len(hits.t):
            self._lit(hits, px, py, out, counted)
            if wet is not None and self.maps.water.size:
                met = np.flatnonzero(~np.isnan(hits.t))
                wet[met] = self._wet(hits.points[met])
        void_filled = np.flatnonzero(~np.isnan(hits.void_fill))
        if len(void_filled):
            if counted is not None:
                self._count(missing=int(np.count_nonzero(counted[void_filled])))
            out[void_filled] = hatching(px[void_filled], py[void_filled])
            if self.air is not None:
                out[void_filled] = self.air.haze(out[void_filled], hits.rays[void_filled], hits.void_fill[void_filled])
        return out

    def _lit(self, hits: Hits, px: Array, py: Array, out: Colors, counted: NDArray[np.bool_] | None) -> None:
        """Colour the samples that met ground; count those that are ``counted``."""
        drape = NOTHING if not self.drapes else self.draped(hits, px, py)
        if self.lighting is None:
            self._relief(hits, drape, out)
        else:
            maps, tint = self.maps, self.tint
            light = self.lighting.on(hits, px, py, self.scene.surface.samples if counted is None else 1)
            paint(hits.points, light, maps.water, maps.place, tint, WATER, drape, out)
        met = np.flatnonzero(~np.isnan(hits.t))
        if counted is not None:
            bare = np.flatnonzero(counted & ~np.isnan(hits.t) & np.isnan(hits.void_fill))
            wet = self._wet(hits.points[bare])
            covered = drape[bare, 6] < 0.5 if self.drapes else np.zeros(len(bare), bool)
            self._count(ground=len(bare), water=int((wet & ~covered).sum()), draped=int(covered.sum()))
        if self.lines is not None:
            self.lines.draw(hits, px, py, out)
        if self.air is not None:
            out[met] = self.air.haze(out[met], hits.rays[met], hits.t[met])
        large = np.flatnonzero(hits.width < SMOOTH)  # false for NaN
        if len(large):
            out[large] = dithered(out[large], px[large], py[large])

    def _relief(self, hits: Hits, drape: Colors, out: Colors) -> None:
        """Light by the skyline and the sky-view factor of the working grid."""
        cosine, tilt = self.ground.incidence(hits, self.to_sun, self.strength)
        sunlit = np.ones(len(cosine))
        if self.scene.lighting.shadows:
            lit = np.flatnonzero(cosine > 0)  # false for NaN
            slopes = self.ground.skyline(hits, self.scene.lighting.sun, lit)
            shaded = np.flatnonzero(slopes > self.lower_limb)
            sunlit[lit[shaded]] = disc_fraction(
                np.degrees(np.arctan(slopes[shaded])),
                self.scene.lighting.sun.altitude,
                self.scene.lighting.sun.diameter,
            )
        maps = self.maps
        compose(
            hits.points, cosine * sunlit, tilt, maps.sky_view, maps.water, maps.place, self.tint, WATER, drape,
            Light(self.sunlight, self.skylight, BOUNCE), out,
        )  # fmt: skip

    def _wet(self, points: Array) -> NDArray[np.bool_]:
        """Which points (n, 3) are nearest to samples of water."""
        maps = self.maps
        if not maps.water.size:
            return np.zeros(len(points), bool)
        scale, row0, col0 = maps.place
        c = np.rint((points[:, 0] + 0.5) / scale - 0.5 - col0).astype(np.intp)
        r = np.rint((points[:, 1] + 0.5) / scale - 0.5 - row0).astype(np.intp)
        rows, cols = maps.water.shape
        return maps.water[np.clip(r, 0, rows - 1), np.clip(c, 0, cols - 1)] > 0.5

    def _count(self, **samples: int) -> None:
        """Add to ``shown``, from any thread."""
        with self._lock:
            for name, n in samples.items():
                self.shown[name] += n

    def draped(self, hits: Hits, px: Array, py: Array) -> Colors:
        """The layers over the ground's own colours (n, 7), see ``geovis.layers.composite``."""
        x, y = self.scene.terrain.grid.xy(hits.points[:, 0], hits.points[:, 1])
        ground, least = self.ground.footprints(hits, px, py)
        stack = nothing_over(len(x))
        for layer, drape in self.drapes:
            composite(drape.spread(x, y, ground, least), layer.opacity, layer.blend == "multiply", stack)
        return stack

    def background(self, directions: Array, px: Array, py: Array) -> Colors:
        """The colours without ground, in directions (n, 3) and at pixel positions (n,)."""
        if self.air is not None:
            return dithered(self.air.sky(directions), px, py)
        return np.broadcast_to(PAPER, (len(directions), 3)).astype(np.float32)
