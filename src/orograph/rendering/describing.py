"""Describe a picture in words, for people who cannot see it and for captions: the scene, the viewpoint, and the
data."""

from __future__ import annotations

import math

import numpy as np

from orograph.geovis.keys import Scale
from orograph.geovis.layers import drawn
from orograph.scene.scene import Scene

COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def describe(scene: Scene) -> str:
    """Sentences on a scene: the terrain, the camera, the light, layers and data with their values and uncertainty."""
    parts = [_terrain(scene), _camera(scene)]
    light = scene.lighting
    if light.light == "none":
        parts.append("It has no shading.")
    else:
        come = COMPASS[round(light.sun.azimuth / 45) % 8]
        parts.append(f"The light comes from the {come}, {light.sun.altitude:.0f}° high.")
    if scene.annotations.contours is not None:
        parts.append("Contour lines show the heights.")
    if scene.surface.detail is not None:
        parts.append(f"{scene.surface.detail.words.capitalize()}.")
    for key in scene.keys:
        parts += [_scale(scale) for scale in key.scales]
        for both in key.squares:
            parts.append(f"Colours show {_span(both.across, both.across_edges)} and {_span(both.up, both.up_edges)}.")
        if key.classes:
            told = f"{key.title}: " if key.title else ""
            parts.append(f"Colours show {told}{', '.join(words for words, _ in key.classes)}.")
        if key.note:
            parts.append(f"{key.note}.")
        if key.swatches:
            parts.append(f"Their uncertainty is shown, {key.swatches[0][0]} to {key.swatches[-1][0]} and beyond.")
    things = scene.theme.things
    if things is not None:
        upright = np.isfinite(things.values) & (True if things.ends is None else np.isnan(things.ends[:, 1]))
        shown = things.values[upright]
        if len(shown):
            parts.append(f"{len(shown)} places have values from {shown.min():.4g} to {shown.max():.4g}.")
        if things.ends is not None:
            floating = upright & np.isfinite(things.ends[:, 0])
            below = floating & (np.zeros(len(things)) if things.hidden is None else things.hidden > 0).astype(bool)
            if floating.sum() > below.sum():
                parts.append(f"{int(floating.sum() - below.sum())} of them float over the ground.")
            if below.any():
                parts.append(f"{int(below.sum())} of them are at their depths, and seen through the ground.")
    plain = [layer.title for layer in drawn(scene.data.layers) if layer.key is None]
    if plain:
        parts.append(f"Laid over the ground: {', '.join(plain)}.")
    return " ".join(parts)


def _terrain(scene: Scene) -> str:
    grid, (low, high) = scene.terrain.grid, scene.terrain.height_range
    west, south, east, north = grid.bounds()
    told = f"Terrain {scene.terrain.name.replace('_', ' ')}, {_length(east - west)} by {_length(north - south)}"
    if math.isfinite(low):
        told += f", {low:.0f} to {high:.0f} m high"
    stretch = scene.surface.exaggeration
    return told + (f", heights stretched {stretch:g} times." if stretch != 1 else ".")


def _camera(scene: Scene) -> str:
    view = scene.view
    if view.projection == "plan":
        return "A map, seen from straight above."
    dx, dy = view.eye[0] - view.target[0], view.eye[1] - view.target[1]
    dz = (view.eye[2] - view.target[2]) * scene.surface.exaggeration
    side = COMPASS[round(math.degrees(math.atan2(dx, dy)) / 45) % 8]
    pitch = math.degrees(math.atan2(dz, math.hypot(dx, dy)))
    return f"Seen from the {side}, {abs(pitch):.0f}° {'down' if pitch >= 0 else 'up'}."


def _scale(scale: Scale) -> str:
    unit = f" {scale.unit}" if scale.unit else ""
    more = " and beyond" if scale.below or scale.above else ""
    return f"Colours show {scale.label}, {scale.low:.4g} to {scale.high:.4g}{unit}{more}."


def _span(label: str, edges: tuple[float, ...]) -> str:
    return f"{label} in {len(edges) - 1} classes from {edges[0]:.4g} to {edges[-1]:.4g}"


def _length(metres: float) -> str:
    return f"{metres / 1000:.3g} km" if metres >= 1000 else f"{metres:.3g} m"
