"""A scene's appearance for the shading shader: colours, light and air in one uniform and one table."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import Tint, tint_of
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lighting.aperture import Lights
from orograph.memo import Memo
from orograph.rendering.gpu.shade.light_maps import LightMaps
from orograph.rendering.gpu.shade.tracing import RAYS, SHADOW_RAYS
from orograph.rendering.lookup import SHORE
from orograph.rendering.palette import BOUNCE, MISSING, PAPER, WATER, illumination, ink
from orograph.rendering.sky import FADE, Atmosphere
from orograph.scene.contours import CASING, Contours
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes

SHADE = np.dtype(
    [
        ("sun", "<f4", 4), ("sunlight", "<f4", 4), ("skylight", "<f4", 4), ("water", "<f4", 4), ("paper", "<f4", 4),
        ("extinction", "<f4", 4), ("mist", "<f4", 4), ("disc", "<f4", 4), ("tint", "<f4", 4), ("contour", "<f4", 4),
        ("contour_color", "<f4", 4), ("edge", "<f4", 4), ("edge_range", "<f4", 4), ("casing", "<f4", 4),
        ("side", "<f4", 2), ("sky_at", "<u4"), ("sky_rows", "<u4"), ("sky_cols", "<u4"),
        ("ring_at", "<u4"), ("land_at", "<u4"), ("land_count", "<u4"), ("sea_at", "<u4"), ("sea_count", "<u4"),
        ("levels", "<u4"), ("flags", "<u4"), ("searched", "<i4", 4), ("light", "<i4", 4),
        ("light_first", "<i4", 2), ("windows", "<u4"), ("hatch", "<u4"), ("fields", "<u4"), ("suns", "<u4"),
        ("lamps", "<u4"), ("corner", "<u4"),
    ]
)  # fmt: skip
"""The uniform ``Shade`` of ``shaders/shade.wgsl``."""

SHADOWS, WATERS, DRAPE, WIREFRAME, LEVELS = 1, 2, 4, 8, 16
LIGHTS = {"relief": 0, "none": 32, "ao": 64, "aperture": 128, "raytraced": 32 | RAYS}
"""Flags of the shader."""

SKY, CONTOURS, VOIDS, GIVEN, LABELS, SILHOUETTES, FIELD, SMOOTH = 256, 512, 1024, 2048, 4096, 8192, 16384, 32768

LAMPS, SUNS = 1 << 17, 20
"""A flag, and the bit from which three bits give the number of discs of light (7: any number); absent loops cost
nothing."""


class Look:
    """The numbers of one scene.

    Attributes:
        lights: sources that shine through apertures or by rays. uniform: of ``SHADE``.
        tables: float32, all colours in sequence. tint: how heights become colours.
    """

    def __init__(
        self, scene: Scene, maps: LightMaps, visible_range: tuple[float, float], memo: Memo, *, wireframe: bool = False,
        levels: bool = False, contours: Contours | None = None, silhouettes: Silhouettes | None = None,
    ) -> None:  # fmt: skip
        terrain = scene.terrain
        sea = None if scene.data.water is not None else False
        self.tint: Tint = memo(
            "tint", (scene.data.colormap, sea, scene.data.range),
            lambda: tint_of(terrain, scene.data.colormap, sea, scene.data.range), terrain,
        )  # fmt: skip
        parts: list[NDArray[np.float32]] = []

        def put(values: NDArray[np.floating]) -> int:
            at = sum(p.size for p in parts)
            parts.append(np.ascontiguousarray(values, np.float32).ravel())
            return at

        u = np.zeros((), SHADE)
        to_sun, sunlight, skylight = illumination(scene.lighting.sun)
        u["sun"] = *to_sun, math.radians(scene.lighting.sun.diameter) / 2
        u["sunlight"] = *sunlight, maps.strength if scene.lighting.relief is None else scene.lighting.relief
        u["skylight"] = *skylight, BOUNCE
        u["water"] = *WATER, SHORE
        u["paper"] = *PAPER, terrain.chart.spacing
        u["tint"] = self.tint.low, self.tint.high, self.tint.floor, flooded(scene)
        u["searched"] = _samples(maps.searched if scene.data.water is not None else None)
        u["land_at"], u["land_count"] = put(self.tint.land), len(self.tint.land)
        u["sea_at"], u["sea_count"] = put(self.tint.sea), len(self.tint.sea)
        u["hatch"] = put(MISSING)
        if scene.lighting.sky:
            air = Atmosphere(scene, visible_range, memo)
            u["sky_at"] = put(air.table)
            u["sky_rows"], u["sky_cols"] = air.table.shape[:2]
            u["ring_at"] = put(air.ring)
            u["side"] = air.side
            u["mist"] = *air.mist, FADE
            u["disc"] = *air.disc, 1.0
            u["extinction"] = *air.extinction, air.near
        if contours is not None:
            u["contour"] = contours.interval, contours.index, contours.width, contours.opacity
            u["contour_color"][:3] = ink(contours)
            u["casing"][0] = contours.casing or 0.0
        if silhouettes is not None:
            near = max(visible_range[0], 1e-3)
            u["edge"] = *silhouettes.ink, silhouettes.opacity
            u["edge_range"] = near, max(visible_range[1], near * 1.001, 2e-3), silhouettes.width, silhouettes.reach
            u["casing"][1] = silhouettes.casing or 0.0
        u["casing"][2] = CASING
        u["levels"] = terrain.levels
        flags = (SHADOWS if len(maps.windows) else 0) | (SHADOWS | SHADOW_RAYS if maps.by_rays else 0)
        flags |= WATERS if maps.wet else 0
        flags |= (WIREFRAME if wireframe else 0) | (LEVELS if levels else 0)
        lamplit = scene.lighting.light in ("aperture", "raytraced")
        flags |= LIGHTS[scene.lighting.light] | (SHADOWS if scene.lighting.shadows and lamplit else 0)
        flags |= SKY if scene.lighting.sky else 0
        flags |= CONTOURS if contours is not None else 0
        flags |= SILHOUETTES if silhouettes is not None else 0
        u["light"], u["light_first"] = maps.light, maps.first
        u["windows"] = len(maps.windows)
        u["water"][3], u["fields"] = SHORE, len(maps.fields)
        discs = [(scene.lighting.sun, _color(sunlight)), *scene.lighting.discs]
        lamps = [replace(lamp, height=lamp.height * scene.surface.exaggeration) for lamp in scene.lighting.lamps]
        self.lights = Lights(discs, lamps, _color(skylight)) if lamplit else Lights()
        u["suns"], u["lamps"] = len(self.lights.suns), len(self.lights.lamps)
        u["flags"] = flags | min(len(self.lights.suns), 7) << SUNS | (LAMPS if self.lights.lamps else 0)
        self.uniform = u
        self.tables = np.concatenate(parts)


def flooded(scene: Scene) -> float:
    """The height up to which all ground is water, metres; far below all ground if water is searched for, or not
    shown."""
    return float(scene.data.water) if isinstance(scene.data.water, int | float) else -3e38


def _samples(window: Rectangle | None) -> tuple[int, int, int, int]:
    """First column and row of a window, and those after its last, in samples of level 0; None: everything."""
    if window is None:
        return -(2**30), -(2**30), 2**30, 2**30
    level, row0, row1, col0, col1 = window
    return col0 << level, row0 << level, col1 << level, row1 << level


def _color(color: NDArray[np.float32]) -> tuple[float, float, float]:
    red, green, blue = (float(c) for c in color)
    return red, green, blue
