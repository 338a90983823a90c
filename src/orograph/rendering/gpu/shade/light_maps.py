"""Maps of light for the GPU: visibility of sky and sun, and water, over windows of a terrain.

The sky-view factor and the water are those of the CPU's pictures (``rendering.cpu.mapgrid``). For frames of the window,
the sun's visibility is a horizon towards its azimuth, swept over nested windows from the coarsest, which holds the
whole terrain, to the finest around what is in view (``lighting.nested``): shadows reach as far as the terrain does,
have the resolution of the pixels, and are as soft as the sun's disc is wide. Only the choice of windows depends on the
camera, so the maps are made in the background when the sun or the view has changed, while frames are drawn with the
current ones. Pictures cast rays instead (``shaders/rays.wgsl``), like the CPU: where the sun is low and the ground seen
from the side, a horizon interpolated between samples is off by pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lighting.gpu.aperture import packed
from orograph.lighting.nested import sunward
from orograph.lighting.sun import Sun
from orograph.memo import Memo
from orograph.progress import SILENT
from orograph.raycast.select import rectangles
from orograph.raycast.stack import HeightWindow
from orograph.rendering.cpu.lighting import SKIES, field_of
from orograph.rendering.cpu.mapgrid import MapGrid, strength_of, water_map, working_window
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]
Values = NDArray[np.float32]

WINDOW, LARGEST = 3_000_000, 6_000_000
"""Maximum samples of a window of horizons towards the sun (or an eighth of a very large picture's pixels), and of the
outermost one, or of any."""

FIELDS = {"ao": SKIES, "aperture": ("aperture",)}
"""The layers that a way of lighting looks up, the best first."""

FAR = 64.0
"""Radii of the sun's disc beyond which the horizon's distance from it does not matter."""


@dataclass(frozen=True, slots=True)
class LightMaps:
    """Maps ready for a storage buffer.

    Attributes:
        pool: float32: the sky-view factor, water (of the same size, if there is any), then the windows of the sun.
        light: offset, rows, cols, level of the sky-view factor. first: its first block (row, col).
        wet: whether there is water.
        windows: (n, 8) int32: offset, rows, cols, level, first row and column, two unused; outermost first.
        fields: (n, 8) int32: windows of a share of the sky or of caps (``lighting.field``): offset, rows, cols, level,
            first row and column, words per sample, unused; outermost first. description: their description.
        by_rays: whether rays find the sun's shadows, without windows.
        strength: factor on slopes for shading that suits the ground in view.
        water_fraction: of the map.
        searched: where it is known which ground is water; None: everywhere.
    """

    pool: Values
    light: tuple[int, int, int, int]
    first: tuple[int, int]
    wet: bool
    windows: NDArray[np.int32]
    fields: NDArray[np.int32]
    description: str
    strength: float
    water_fraction: float
    searched: Rectangle | None = None
    by_rays: bool = False


def light_maps(scene: Scene, points: Array, memo: Memo, *, detail: float | None = None) -> LightMaps:
    """Make the maps for a scene.

    Args:
        points: (n, ≥ 2) sample coordinates of the ground in view.
        memo: results of earlier maps.
        detail: maximum pixels per sample of the sun's finest window; None: rays find its shadows.
    """
    grid = MapGrid(scene, _ground(scene), _Seen(points), memo)  # type: ignore[arg-type]
    level, row0, row1, col0, col1 = grid.window
    rows, cols = row1 - row0, col1 - col0
    open_sky = np.ones(rows * cols, np.float32)  # where nothing is known, the sky is open
    parts: list[Values] = [np.nan_to_num(grid.sky_view, nan=1.0).ravel() if grid.sky_view.size else open_sky]
    wet = grid.water.size > 0
    if wet:
        parts.append(grid.water.ravel())
    offset = sum(p.size for p in parts)
    windows: NDArray[np.int32] = np.zeros((0, 8), np.int32)
    sunlit = has_sun_maps(scene)
    if sunlit and detail is not None:
        sun, stretch = scene.lighting.sun, scene.surface.exaggeration
        chosen = sun_windows(scene.terrain, scene.view, stretch, detail)
        found = memo(
            "sun", (tuple(chosen), sun, stretch),
            lambda: sun_maps(scene.terrain, chosen, sun, stretch, memo, scene.budget.jobs), scene.terrain,
        )  # fmt: skip
        windows = np.zeros((len(chosen), 8), np.int32)
        for k, (r, values) in enumerate(zip(chosen, found)):
            windows[k, :6] = offset, *values.shape, r.level, r.row0, r.col0
            offset += values.size
            parts.append(values.ravel())
    fields: NDArray[np.int32] = np.zeros((0, 8), np.int32)
    description = ""
    if scene.lighting.light in FIELDS:
        field, description = field_of(scene, _ground(scene), grid.window, FIELDS[scene.lighting.light], memo, SILENT)  # type: ignore[arg-type]
        held = field.windows
        channels = held.pool.shape[1]
        words = 2 if channels == 4 else channels
        fields = np.zeros((len(held.base), 8), np.int32)
        fields[:, 0] = offset + held.base * words
        fields[:, 1], fields[:, 2], fields[:, 3] = held.rows, held.cols, np.round(np.log2(held.size))
        fields[:, 4], fields[:, 5], fields[:, 6] = held.row0, held.col0, words
        neutral = np.array([0.0, 0.0, 1.0, 0.0] if channels == 4 else [1.0], np.float32)  # the open sky
        values = np.where(np.isnan(held.pool), neutral, held.pool).astype(np.float32)
        parts.append(packed(values) if channels == 4 else values.ravel())
    return LightMaps(
        np.concatenate(parts), (0, rows, cols, level), (row0, col0), wet, windows, fields, description, grid.strength,
        grid.water_fraction, None if detail is None else _searched(scene, grid.window), sunlit and detail is None,
    )  # fmt: skip


def _searched(scene: Scene, window: Rectangle) -> Rectangle | None:
    """The area in which a search for water over a window is conclusive."""
    if scene.data.water is None or window == Rectangle.whole(window.level, scene.terrain.mean_shape(window.level)):
        return None
    return window


def has_sun_maps(scene: Scene) -> bool:
    """Whether frames look up the shadows of a scene's light in maps."""
    return scene.lighting.shadows and scene.lighting.light in ("relief", "ao")


def quick_maps(scene: Scene, points: Array, memo: Memo, *, detail: float) -> LightMaps:
    """Quick first maps: water, and coarse shadows of the sun, under an open sky.

    Args:
        points, memo, detail: as for ``light_maps``.
    """
    plain = _watered(scene, working_window(scene.terrain, points), memo)
    if not has_sun_maps(scene):
        return plain
    strength = scene.lighting.relief
    if strength is None:
        strength = memo(
            "strength", (window := working_window(scene.terrain, points), scene.surface.exaggeration),
            lambda: strength_of(scene, window), scene.terrain,
        )  # fmt: skip
    chosen = sun_windows(scene.terrain, scene.view, scene.surface.exaggeration, detail)
    found = sun_maps(scene.terrain, chosen, scene.lighting.sun, scene.surface.exaggeration, memo, scene.budget.jobs)
    windows: NDArray[np.int32] = np.zeros((len(chosen), 8), np.int32)
    parts, offset = [plain.pool], plain.pool.size
    for k, (r, values) in enumerate(zip(chosen, found)):
        windows[k, :6] = offset, *values.shape, r.level, r.row0, r.col0
        offset += values.size
        parts.append(values.ravel())
    return replace(plain, pool=np.concatenate(parts), windows=windows, strength=strength)


def plain_maps() -> LightMaps:
    """Light before any map is ready: an open sky, no shadows; water is unknown."""
    nothing: NDArray[np.int32] = np.zeros((0, 8), np.int32)
    nowhere = Rectangle(0, 0, 0, 0, 0)
    return LightMaps(np.ones(1, np.float32), (0, 1, 1, 0), (0, 0), False, nothing, nothing, "", 1.0, 0.0, nowhere)


def _watered(scene: Scene, window: Rectangle, memo: Memo) -> LightMaps:
    """An open sky over a window, with the water in it, if there is any."""
    plain = replace(plain_maps(), searched=_searched(scene, window))
    if scene.data.water is None:
        return plain
    water, fraction = water_map(scene, _ground(scene), window, memo)  # type: ignore[arg-type]
    if not water.size:
        return plain
    level, row0, _, col0, _ = window
    pool = np.concatenate([np.ones(water.size, np.float32), water.ravel()])
    return replace(
        plain, pool=pool, light=(0, *water.shape, level), first=(row0, col0), wet=True, water_fraction=fraction
    )


def sun_windows(terrain: Terrain, view: View, exaggeration: float, detail: float) -> ClipStack:
    """Nested windows of box means, outermost first, whose samples are about ``detail`` pixels large where they show, or
    larger if there would be too many: the outermost holds the whole terrain."""
    most = min(max(WINDOW, view.width * view.height // 8), LARGEST)
    found = rectangles(terrain, view, exaggeration, detail, by="spacing")
    level = found[0].level
    while math.prod(terrain.mean_shape(level)) > LARGEST and level < terrain.levels - 1:
        level += 1
    inner = [r.cut(terrain.mean_shape(r.level)) for r in found if r.level < level]
    # A window that is too large is left to the coarser one around it, until a finer and smaller one comes.
    return ClipStack(
        [Rectangle.whole(level, terrain.mean_shape(level)), *(window for window in inner if window.samples <= most)]
    )


def sun_maps(
    terrain: Terrain, windows: Sequence[Rectangle], sun: Sun, exaggeration: float, memo: Memo, jobs: int | None
) -> list[Values]:
    """How far the horizon stands above the sun's centre, in radii of its disc, for every sample of the windows.

    It is clamped to ±``FAR``. Missing ground does not block.
    """

    def means(r: Rectangle) -> HeightWindow:
        heights = memo("means", r, lambda: terrain.read_mean(*r), terrain, 8)
        return HeightWindow(r.level, r.col0, r.row0, heights * np.float32(exaggeration))

    nested = [means(r) for r in windows]
    lowest = math.tan(math.radians(max(sun.altitude - 89.0 * sun.diameter, -89.0)))
    out = []
    radius = max(sun.diameter / 2, 1e-3)
    for slopes in sunward(nested, terrain.chart.linear, sun.azimuth, lowest=lowest, jobs=jobs):
        with np.errstate(invalid="ignore"):
            above = (np.degrees(np.arctan(slopes)) - np.float32(sun.altitude)) / np.float32(radius)
        out.append(np.clip(np.nan_to_num(above, nan=-FAR), -FAR, FAR).astype(np.float32))
    return out


class _Seen:
    """The survey that ``MapGrid`` needs: where the ground in view is."""

    def __init__(self, points: Array) -> None:
        self.hits = self
        self.points = points


class _ground:
    """The ground that ``MapGrid`` needs: its description and the spacing of samples."""

    def __init__(self, scene: Scene) -> None:
        self.rays, self.to_samples, self.bare = self, self, scene
        chart = scene.terrain.chart
        self.spacing, self.linear = chart.spacing, chart.linear


def whole(terrain: Terrain) -> Array:
    """Points that represent all of a terrain."""
    rows, cols = terrain.grid.shape
    return np.array([[0.0, 0.0], [cols - 1.0, rows - 1.0]])
