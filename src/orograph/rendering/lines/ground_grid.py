"""Lines of easting and northing on the ground, of equal width near and far, with their values at the border.

A pixel's easting follows from its depth, and how fast it changes from pixel to pixel from the depths beside it (of the
two neighbours the one on the same surface: in perspective 1 / depth is linear over a plane). So no line is traced;
lines lie on exactly what is drawn, and fade where they would run together. A value stands where its line leaves the
terrain or the picture, at the nearer end that is not hidden. Units: pixels, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.data.sampling import bilinear
from orograph.geovis.data.standing import Mark
from orograph.rendering.furniture.lettering import Color, Style, length, set_type
from orograph.rendering.ground_places import rays_of
from orograph.scene.aids import interval_of
from orograph.scene.scene import Scene

Array = NDArray[np.float64]

WIDTH, OPACITY, USUAL = 1.3, 0.6, 1100
"""Of lines; their width grows with pictures whose shorter side has more pixels."""

NONE, ALL = 4.0, 14.0
"""Pixels from line to line at which lines are invisible, and at which they are fully visible."""

COLOR = (0.016, 0.026, 0.055)
"""Linear."""

TYPE: Color = (34, 44, 66)
HALO: Color = (246, 244, 239)

COARSE, STEPS = 512, 256
"""Samples a side of the ground by which values are placed, and places along a line or a sight."""

HIDDEN = 0.004
"""Of the terrain's longer side: how far ground must stand above a sight to hide a value."""


def coverage(scene: Scene, depth: NDArray[np.floating]) -> Array | None:
    """(height, width) how much of each pixel grid lines cover; None: there are none.

    Args:
        depth: (height, width) of the scene's view; pixels at its edge, unless it is the picture's own, are approximate.
    """
    step = interval_of(scene.annotations.aids, scene.view)
    if step is None:
        return None
    width = WIDTH * max(1.0, min(scene.view.frame[2:]) / USUAL)
    origins, ways = rays_of(scene, depth.shape)
    _, ou, ov, _, du, dv = scene.view.whole.ray_basis(scene.surface.exaggeration)
    t = np.where(np.isfinite(depth), depth, np.nan).astype(np.float64)
    perspective = scene.view.projection == "perspective"
    with np.errstate(invalid="ignore", divide="ignore"):
        slopes = [_slope(1 / t if perspective else t, axis) for axis in (1, 0)]
        if perspective:
            slopes = [-(t * t) * s for s in slopes]
        found = np.zeros(depth.shape)
        for k in (0, 1):
            value = origins[..., k] + t * ways[..., k]
            moved = [o[k] + t * d[k] + s * ways[..., k] for o, d, s in ((ou, du, slopes[0]), (ov, dv, slopes[1]))]
            per_pixel = np.hypot(*moved)
            away = np.abs(value - step * np.rint(value / step)) / per_pixel
            seen = np.clip((step / per_pixel - NONE) / (ALL - NONE), 0, 1)
            found = np.fmax(found, np.clip(width / 2 + 0.5 - away, 0, min(width, 1.0)) * seen)
    return OPACITY * np.nan_to_num(found)


def _slope(values: Array, axis: int) -> Array:
    """Change from pixel to pixel along an axis: the smaller of those to both sides, NaN where there are none."""
    change = np.diff(values, axis=axis)
    none = np.full_like(np.take(values, [0], axis), np.nan)
    back, ahead = np.concatenate([none, change], axis), np.concatenate([change, none], axis)
    return np.where(~(np.abs(back) < np.abs(ahead)) & np.isfinite(ahead), ahead, back)


def lay(scene: Scene, linear: NDArray[np.float32], depth: NDArray[np.floating]) -> None:
    """Lay the grid over linear colours (height, width, 3), in place."""
    part = coverage(scene, depth)
    if part is not None:
        linear += part[..., None].astype(np.float32) * (np.asarray(COLOR, np.float32) - linear)


def lay_on_bytes(scene: Scene, pixels: NDArray[np.uint8], depth: NDArray[np.floating]) -> None:
    """Lay the grid over sRGB pixels (height, width, 3), in place."""
    part = coverage(scene, depth)
    if part is None:
        return
    some = part > 0
    under = srgb_to_linear(pixels[some] / np.float32(255))
    mixed = under + part[some][:, None].astype(np.float32) * (np.asarray(COLOR, np.float32) - under)
    pixels[some] = np.rint(linear_to_srgb(mixed) * 255)


@dataclass(frozen=True, slots=True)
class Value:
    """A line's value: where its middle is in the whole picture, and its words."""

    x: float
    y: float
    words: str


def label(scene: Scene, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The pixels of a scene's view with the grid's values and what is written beside things; the same pixels where
    nothing is."""
    step = interval_of(scene.annotations.aids, scene.view)
    marks = () if scene.theme.things is None else scene.theme.things.marks
    if step is None and not marks:
        return pixels
    from PIL import Image

    left, top, width, height = scene.view.frame
    style = Style.of((width, height), "0 km E N")
    font = style.font(0.85)
    sheet = Image.fromarray(np.ascontiguousarray(pixels))
    for one in (*(() if step is None else values(scene, step)), *_beside(scene, marks, style)):
        x, y = one.x - left, one.y - top
        for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)):
            set_type(sheet, (x + dx, y + dy), one.words, font, HALO, "mm")
        set_type(sheet, (x, y), one.words, font, TYPE, "mm")
    return np.asarray(sheet, np.uint8).copy()


def values(scene: Scene, step: float) -> list[Value]:
    """Values of the grid's lines and where they stand: so that none meets another, nearer ones first."""
    _, _, width, height = scene.view.frame
    style = Style.of((width, height), "0 km E N")
    font, ground = style.font(0.85), _Ground.of(scene)
    ends = []
    for axis in (0, 1):
        low, high = ground.low[axis], ground.high[axis]
        for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1):
            end = ground.end(axis, k * step)
            if end is not None:
                ends.append((*end, _words(k * step, step, axis)))
    placed: list[tuple[float, float, float]] = []
    found = []
    for _, x, y, dx, dy, words in sorted(ends):
        long = length(font, words)
        # Beyond the end, as far as the words reach in that direction; within the picture.
        off = 0.55 * min(long / max(abs(dx), 1e-9), style.unit / max(abs(dy), 1e-9)) + 0.5 * style.unit
        x, y = x + off * dx, y + off * dy
        # As far from the picture's edge as furniture stands, which then hides a value wholly or not at all.
        half, edge = long / 2 + style.margin + style.pad / 2, style.margin + style.unit
        x, y = float(np.clip(x, half, width - half)), float(np.clip(y, edge, height - edge))
        if all(abs(x - a) > (long + b) / 2 + 0.4 * style.unit or abs(y - c) > 1.3 * style.unit for a, c, b in placed):
            placed.append((x, y, long))
            found.append(Value(round(x), round(y), words))
    return found


def _beside(scene: Scene, marks: tuple[Mark, ...], style: Style) -> list[Value]:
    """Where marks are written: to the left of their places, where these are in the picture; of those that would meet
    the first."""
    if not marks:
        return []
    _, _, width, height = scene.view.frame
    places = np.array([[one.x, one.y, one.level] for one in marks])
    xy, depth = scene.view.whole.project(places, scene.surface.exaggeration)
    font = style.font(0.85)
    found: list[Value] = []
    for one, (x, y), far in zip(marks, xy, depth):
        long = length(font, one.words)
        x -= long / 2 + 0.8 * style.unit
        free = all(abs(y - other.y) > 1.2 * style.unit for other in found)
        if far > scene.view.near and x - long / 2 > 0 and x < width and 0 < y < height and free:
            found.append(Value(round(x), round(y), one.words))
    return found


def _words(value: float, step: float, axis: int) -> str:
    kilometres = step >= 1000 and step % 100 == 0
    return f"{value / 1000:g} km {'EN'[axis]}" if kilometres else f"{value:.10g} m {'EN'[axis]}"


@dataclass(frozen=True, slots=True)
class _Ground:
    """A coarse level of a terrain, and how its places appear."""

    scene: Scene
    heights: Any
    step: float
    low: tuple[float, float]
    high: tuple[float, float]

    @classmethod
    def of(cls, scene: Scene) -> _Ground:
        terrain, level = scene.terrain, 0
        while level < terrain.levels - 1 and max(terrain.shape(level)) > COARSE:
            level += 1
        rows, cols = terrain.shape(level)
        grid = terrain.grid
        right, bottom = grid.cols - 1.0, grid.rows - 1.0
        corners = grid.xy(np.array([0.0, right, 0.0, right]), np.array([0.0, 0.0, bottom, bottom]))
        low, high = ((float(f(corners[0])), float(f(corners[1]))) for f in (np.min, np.max))
        return cls(scene, terrain.read(level, 0, rows, 0, cols), 2.0**level, low, high)

    def at(self, x: Array, y: Array) -> Array:
        """Heights (n,); NaN where there is no ground."""
        grid, (rows, cols) = self.scene.terrain.grid, self.heights.shape
        col, row = grid.index(x, y)
        inside = (col >= -0.01) & (row >= -0.01) & (col <= grid.cols - 0.99) & (row <= grid.rows - 0.99)
        col, row = np.clip(col / self.step, 0, cols - 1), np.clip(row / self.step, 0, rows - 1)
        return np.where(inside, bilinear(self.heights, col, row), np.nan)

    def end(self, axis: int, value: float) -> tuple[float, float, float, float, float] | None:
        """Of a line its end that is nearest and not hidden: depth, place, and direction outwards in the picture."""
        view = self.scene.view.whole
        along = np.linspace(self.low[1 - axis], self.high[1 - axis], STEPS)
        x, y = (np.full(STEPS, value), along) if axis == 0 else (along, np.full(STEPS, value))
        z = self.at(x, y)
        xy, depth = view.project(np.stack([x, y, z], 1), self.scene.surface.exaggeration)
        with np.errstate(invalid="ignore"):
            seen = (depth > view.near) & np.isfinite(z) & (xy >= 0).all(1) & (xy <= [view.width, view.height]).all(1)
        there = np.flatnonzero(seen)
        if len(there) < 2:
            return None
        found = []
        for end, inner in ((there[0], there[1]), (there[-1], there[-2])):
            if self._hidden(np.array([x[end], y[end], z[end]])):
                continue
            way = xy[end] - xy[inner]
            size = float(np.hypot(*way))
            if size > 0:
                # In a plan values stand below and to the left, as on a map sheet.
                plan = -xy[end][1] if axis == 0 else xy[end][0]
                near = depth[end] if view.projection == "perspective" else plan
                (a, b), (dx, dy) = xy[end], way / size
                found.append((float(near), float(a), float(b), float(dx), float(dy)))
        return min(found, default=None)

    def _hidden(self, place: Array) -> bool:
        """Whether ground stands between the eye and a place."""
        view = self.scene.view.whole
        if view.projection != "perspective":
            return False
        part = np.linspace(0, 0.985, STEPS)[:, None]
        sight = np.asarray(view.eye) + part * (place - np.asarray(view.eye))
        z = self.at(sight[:, 0], sight[:, 1])
        allowed = HIDDEN * max(self.high[0] - self.low[0], self.high[1] - self.low[1]) * (1 - part[:, 0])
        with np.errstate(invalid="ignore"):
            return bool((z - sight[:, 2] > allowed).any())
