"""Ways of lighting a picture's ground: ambient occlusion, ambient apertures, rays, or none, besides the default.

A ``Lighting`` gives the light on hits (irradiance per colour; 1 is that of level ground that shows the map's own
colours). Light that depends only on the ground comes baked from the store, in windows about as fine as the pixels
(``lighting.field``); if it is not baked, or heights are stretched, it is swept for the picture on its working grid.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import cos, radians
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.lighting.shade import disc_fraction
from orograph.lighting.sun import Sun
from orograph.memo import Memo
from orograph.progress import Progress
from orograph.raycast.select import rectangles
from orograph.rendering.cpu.ground import Ground
from orograph.rendering.rays import Hits
from orograph.scene.scene import Scene

if TYPE_CHECKING:
    from orograph.lighting.field import LightField

Array = NDArray[np.float64]
Colors = NDArray[np.float32]
Window = tuple[int, int, int, int, int]

AZIMUTHS = 32
"""Number of horizon directions swept for a picture."""

SKIES = ("ambient-occlusion", "sky-view-factor")
"""Layers that give the share of the sky's light on the ground, the best first."""

BAKED: dict[str, tuple[str, ...]] = {"ao": SKIES, "aperture": ("aperture",)}
"""The layers that a light uses, the best first."""

Ahead = Callable[[], "LightField"]
"""Waits for a field that is being read."""


@dataclass(frozen=True, slots=True)
class Shine:
    """The light sources of a scene.

    Attributes:
        to_sun: (3,) unit vector. sunlight, skylight: (3,) colours of the sun's light and of the sky's.
        bounce: (3,) light from ground in place of hidden sky.
    """

    to_sun: Array
    sunlight: Colors
    skylight: Colors
    bounce: Colors


class Lighting(Protocol):
    """A way of lighting; called from several threads.

    Attributes:
        description: its description, for the picture's facts.
        smooth: whether it is as smooth as the ground's slope at the scale of a pixel (no shadow edges).
    """

    description: str
    smooth: bool

    def on(self, hits: Hits, px: Array, py: Array, part: int = 1) -> Colors:
        """Light (n, 3) on hits, seen at positions px, py (n,) of the whole picture; ``part`` of them share a pixel."""


def lighting_of(
    scene: Scene, ground: Ground, shine: Shine, window: Window, strength: float, memo: Memo, progress: Progress,
    ahead: Ahead | None = None,
) -> Lighting:  # fmt: skip
    """The scene's light.

    Args:
        window: the working grid (``mapgrid.working_window``). strength: factor on slopes for shading.
        ahead: the result of ``field_ahead``.
    """
    if scene.lighting.light == "none":
        return Bare()
    if scene.lighting.light == "raytraced":
        return Raytraced(scene, ground, shine, strength)
    if scene.lighting.light == "aperture":
        field, description = field_of(scene, ground, window, BAKED["aperture"], memo, progress, ahead)
        return Apertures(scene, ground, shine, strength, field, description)
    field, description = field_of(scene, ground, window, SKIES, memo, progress, ahead)
    return Occlusion(scene, ground, shine, strength, field, description)


def field_ahead(scene: Scene, memo: Memo) -> Ahead | None:
    """Start reading the baked layer for the scene's light in a background thread; None if there is nothing to read."""
    from orograph.lighting.field import PIXELS, LightField

    terrain = scene.terrain
    baked = [name for name in BAKED.get(scene.lighting.light, ()) if name in terrain.layers]
    if not baked or scene.surface.exaggeration != 1 or scene.budget.jobs == 1:
        return None
    layer = terrain.layer(baked[0])
    chosen = rectangles(terrain, scene.view.whole, 1.0, PIXELS, by="spacing")
    if memo.has("field", (baked[0], tuple(chosen)), terrain):
        return None
    pool = ThreadPoolExecutor(1)
    begun = pool.submit(LightField.load, layer, terrain, chosen, scene.budget.jobs)
    pool.shutdown(wait=False)
    return begun.result


def field_of(
    scene: Scene, ground: Ground, window: Window, names: tuple[str, ...], memo: Memo, progress: Progress,
    ahead: Ahead | None = None,
) -> tuple[LightField, str]:  # fmt: skip
    """The first of the layers that is baked; otherwise the first of the products, swept."""
    from orograph.lighting.field import PIXELS, LightField

    terrain = scene.terrain
    baked = [name for name in names if name in terrain.layers]
    if baked and scene.surface.exaggeration != 1:
        progress.warn(f"{baked[0]} is baked for true heights; for stretched heights it is swept for the picture.")
    elif baked:
        layer = terrain.layer(baked[0])
        chosen = rectangles(terrain, scene.view.whole, 1.0, PIXELS, by="spacing")
        read = ahead or (lambda: LightField.load(layer, terrain, chosen, scene.budget.jobs))
        field = memo("field", (baked[0], tuple(chosen)), read, terrain)
        return field, f"baked {baked[0]}"

    def sweep() -> LightField:
        from orograph.lighting.aperture import field as caps_of
        from orograph.lighting.arrays import context_of
        from orograph.lighting.context import Options
        from orograph.lighting.products import compute

        level, row0, row1, col0, col1 = window
        heights = terrain.read_mean(level, row0, row1, col0, col1) * np.float32(scene.surface.exaggeration)
        options = Options(azimuths=AZIMUTHS)
        context = context_of(heights, ground.linear * 2.0**level, options, jobs=scene.budget.jobs, progress=progress)
        values = compute(context, names[0])
        return LightField.of(caps_of(values) if len(values) == 4 else values[0], level, row0, col0)

    return memo("field", (names[0], window, scene.surface.exaggeration), sweep, terrain), f"swept {names[0]}"


class Bare:
    """No light: ground shows the map's own colours."""

    description = "none"
    smooth = True

    def on(self, hits: Hits, px: Array, py: Array, part: int = 1) -> Colors:
        return np.ones((len(hits.t), 3), np.float32)


class Occlusion:
    """The sun, cut off by the skyline, and ambient light by ambient occlusion or a sky-view factor."""

    smooth = False

    def __init__(
        self, scene: Scene, ground: Ground, shine: Shine, strength: float, field: LightField, description: str
    ) -> None:
        self.scene, self.ground, self.shine, self.strength = scene, ground, shine, strength
        self.field, self.description = field, description

    def on(self, hits: Hits, px: Array, py: Array, part: int = 1) -> Colors:
        sun, shine = self.scene.lighting.sun, self.shine
        cosine, _ = self.ground.incidence(hits, shine.to_sun, self.strength)
        if self.scene.lighting.shadows:
            lit = np.flatnonzero(cosine > 0)
            horizon = np.degrees(np.arctan(self.ground.skyline(hits, sun, lit)))
            cosine[lit] *= disc_fraction(horizon, sun.altitude, sun.diameter)
        share = self.field.values(hits.points, hits.width)
        share[np.isnan(share)] = 1.0
        direct = cosine[:, None].astype(np.float32) * shine.sunlight
        return np.asarray(direct + share * shine.skylight + (1 - share) * shine.bounce)


class Apertures:
    """Sun, sky and lamps through ambient apertures."""

    smooth = True

    def __init__(
        self, scene: Scene, ground: Ground, shine: Shine, strength: float, field: LightField, description: str
    ) -> None:
        from orograph.lighting.aperture import Lamp, Lights

        self.scene, self.ground, self.shine, self.strength = scene, ground, shine, strength
        self.field, self.description = field, description
        x = scene.surface.exaggeration
        lamps = [Lamp(lamp.col, lamp.row, lamp.height * x, lamp.color) for lamp in scene.lighting.lamps]
        suns = [(sun, color) for sun, color in _discs(scene, shine) if scene.lighting.shadows]
        self.tables = Lights(suns, lamps, _color(shine.skylight)).tables(ground.linear)

    def on(self, hits: Hits, px: Array, py: Array, part: int = 1) -> Colors:
        from orograph.lighting.field import light_caps

        ground, field, relief, x = self.ground, self.field, self.ground.relief, self.scene.surface.exaggeration
        out = np.zeros((len(hits.t), 3), np.float32)
        light_caps(
            field.windows, relief.windows, hits.points, hits.width, ground.to_world, x * self.strength, x,
            self.tables, self.shine.bounce, ground.linear, out,
        )  # fmt: skip
        if not self.scene.lighting.shadows:
            gradient = relief.gradient(hits.points, hits.width)
            out += _unhidden(self.scene, ground, self.shine, gradient, self.strength)
        return out


class Raytraced:
    """Suns by rays to their discs, the sky by cosine-weighted rays, lamps by one ray each."""

    smooth = False

    def __init__(self, scene: Scene, ground: Ground, shine: Shine, strength: float) -> None:
        self.scene, self.ground, self.shine, self.strength = scene, ground, shine, strength
        self.description = f"{scene.lighting.rays} rays"

    def on(self, hits: Hits, px: Array, py: Array, part: int = 1) -> Colors:
        from orograph.lighting.aperture import Lights
        from orograph.lighting.hit_rays import disc_on_hits, lamp_on_hits, sky_on_hits
        from orograph.rendering.cpu.kernels import normals

        scene, ground, shine, x = self.scene, self.ground, self.shine, self.scene.surface.exaggeration
        n, rays = len(hits.t), max(-(-scene.lighting.rays // part), min(scene.lighting.rays, 8))
        gradient = ground.relief.gradient(hits.points, hits.width)
        true, shaded = np.empty((n, 3)), np.empty((n, 3))
        normals(gradient, ground.to_world, x, true)
        normals(gradient, ground.to_world, x * self.strength, shaded)
        pixels = np.stack([np.floor(px * 64), np.floor(py * 64)], 1).astype(np.int64)
        skip = ground.skip(hits, np.arange(n))
        around = ground.caster.stack.scene, hits.points
        amount = np.empty(n)
        sky_on_hits(*around, true, skip, pixels, ground.to_samples, x, rays, amount)
        share = amount.astype(np.float32)[:, None]
        out = share * shine.skylight + (1 - share) * shine.bounce
        if scene.lighting.shadows:
            for sun, color in _discs(scene, shine):
                disc_on_hits(
                    *around, shaded, skip, pixels, ground.to_samples, x, np.array(sun.direction),
                    cos(radians(sun.diameter / 2)), rays, amount,
                )  # fmt: skip
                out += amount.astype(np.float32)[:, None] * np.array(color, np.float32)
        else:
            out += _unhidden(scene, ground, shine, gradient, self.strength)
        _, lamps, _ = Lights(lamps=scene.lighting.lamps).tables(ground.linear)
        for lamp in lamps:
            lamp[2] *= x
            lamp_on_hits(*around, shaded, skip, ground.to_samples, x, ground.linear, lamp, out)
        return np.asarray(out, np.float32)


def _discs(scene: Scene, shine: Shine) -> list[tuple[Sun, tuple[float, float, float]]]:
    """The sun and the scene's other discs, with their colours."""
    return [(scene.lighting.sun, _color(shine.sunlight)), *scene.lighting.discs]


def _color(color: Any) -> tuple[float, float, float]:
    red, green, blue = (float(c) for c in color)
    return red, green, blue


def _unhidden(scene: Scene, ground: Ground, shine: Shine, gradient: Array, strength: float) -> Colors:
    """Light of all discs without shadows: Lambert's cosine."""
    from orograph.rendering.cpu.kernels import incidence

    out = np.zeros((len(gradient), 3), np.float32)
    cosine, tilt = np.empty(len(gradient)), np.empty(len(gradient))
    for sun, color in _discs(scene, shine):
        incidence(
            gradient, ground.to_world, scene.surface.exaggeration * strength, np.array(sun.direction), cosine, tilt
        )
        out += cosine.astype(np.float32)[:, None] * np.array(color, np.float32)
    return out
