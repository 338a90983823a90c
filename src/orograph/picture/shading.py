"""From what is known at a point of the ground to the colour of a pixel.

Light is a warm disc of sun, cut by the skyline (soft shadows), and blue light from as much of the sky as the place sees
(sky-view factor by horizon sweeps). Level ground in full sun shows the map's own colour: tints can be read off the
legend there. Water, missing data and background are each told apart. Colours are linear light throughout.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.colour import colour_table, height_span, srgb_to_linear
from orograph.light.shade import disc_fraction, shoulder, sky_colour, sun_colour
from orograph.picture.ground import Ground, Hits
from orograph.picture.mapgrid import MapGrid
from orograph.picture.scene import Scene
from orograph.progress import SILENT, Progress

Array = NDArray[np.float64]
Colours = NDArray[np.float32]

PAPER = srgb_to_linear(np.array([0.965, 0.958, 0.937], np.float32))
MISSING = srgb_to_linear(np.array([0.62, 0.62, 0.62], np.float32))
WATER = srgb_to_linear(np.array([0.44, 0.60, 0.70], np.float32))
AMBIENT = 0.34
"""The part of the light on level ground, under a 45° sun and an open sky, that comes from the sky."""


class Shader:
    """Colours samples of one scene."""

    def __init__(self, scene: Scene, ground: Ground, depth: Array, progress: Progress = SILENT) -> None:
        self.scene, self.ground = scene, ground
        self.facts: dict[str, Any] = {}
        a, h = math.radians(scene.sun.azimuth), math.radians(scene.sun.altitude)
        self.to_sun = np.array([math.sin(a) * math.cos(h), math.cos(a) * math.cos(h), math.sin(h)])
        sun, sky = sun_colour(scene.sun.altitude), sky_colour(scene.sun.altitude)
        # Exposure is set once, for level ground under a sun at 45°, then follows the sun's strength as an eye would.
        level = max(self.to_sun[2], 0.08)
        self.sunlight = ((1 - AMBIENT) / level * sun).astype(np.float32)
        self.skylight = (AMBIENT * sky).astype(np.float32)
        self.maps = MapGrid(scene, ground, depth, progress)
        self.span = height_span(scene.terrain)
        self.table = colour_table(scene.colormap)
        self.air = None
        if scene.sky:
            from orograph.picture.sky import Atmosphere

            self.air = Atmosphere(scene, self.maps.visible_range)
        self.drape = None
        if scene.drape is not None:
            from orograph.geovis.drape import Drape

            self.drape = Drape.open(scene.drape, scene.terrain.grid, scene.max_memory)
        self.facts["height_span"] = self.span
        self.facts["water_fraction"] = self.maps.water_fraction

    def colour(self, hits: Hits, px: Array, py: Array) -> Colours:
        """Linear colours (n, 3) of the samples in ``hits`` at pixel positions px, py (n,)."""
        out = np.empty((len(hits.hit), 3), np.float32)
        out[~hits.hit] = self.background(hits.directions[~hits.hit])
        if not hits.hit.any():
            return out
        normals = self.ground.normals(hits)
        towards = normals @ self.to_sun
        sky_view, water = self.maps.look_up(hits.points)
        albedo = self.albedo(hits)
        if water is not None:
            wet = water[:, None].astype(np.float32)
            albedo = albedo * (1 - wet) + WATER * wet
        lit = np.maximum(towards, 0.0)
        if self.scene.shadows:
            shone = lit > 0
            if shone.any():
                slopes = self.ground.skyline(hits, self.scene.sun, shone)
                lit[shone] *= disc_fraction(np.degrees(np.arctan(slopes)), self.scene.sun.altitude, self.scene.sun.diameter)
        # Light from the sky comes from around the zenith: what leans away from it sees less of it besides its horizon.
        open_sky = sky_view * (0.5 + 0.5 * normals[:, 2])
        light = lit[:, None].astype(np.float32) * self.sunlight + open_sky[:, None].astype(np.float32) * self.skylight
        # Ground that does not see the sky sees lit ground instead.
        light += ((1.0 - sky_view) * 0.10)[:, None].astype(np.float32) * (self.sunlight + self.skylight)
        colour = shoulder(albedo * light)
        if self.air is not None:
            colour = self.air.haze(colour, hits.directions[hits.hit], hits.depth)
        out[hits.hit] = colour
        return out

    def albedo(self, hits: Hits) -> Colours:
        """The ground's own colour: the drape where it is, else the tint of the height."""
        low, high = self.span
        z = (hits.points[:, 2] - low) / max(high - low, 1e-9) * (len(self.table) - 1)
        i = np.clip(z, 0, len(self.table) - 1.001)
        k = i.astype(np.int64)
        f = (i - k)[:, None].astype(np.float32)
        colour: Colours = self.table[k] * (1 - f) + self.table[k + 1] * f
        if self.drape is not None:
            rgba = self.drape.sample(hits.x, hits.y, hits.footprint * self.ground.rays.spacing)
            alpha = rgba[:, 3:]
            colour = colour * (1 - alpha) + rgba[:, :3] * alpha
        return colour

    def background(self, directions: Array) -> Colours:
        """What is seen where no ground is."""
        if self.air is not None:
            return self.air.sky(directions)
        return np.broadcast_to(PAPER, (len(directions), 3)).astype(np.float32)
