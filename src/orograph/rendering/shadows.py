"""Soft shadows of floating objects on the ground straight below them.

A pixel's place on the ground follows from its depth, and whether it lies below a thing from that place alone: of the
thing's shape from above, a disc, or what a disc covers that runs along a track.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.data.standing import Kind, Things
from orograph.rendering.ground_places import ground_places
from orograph.scene.scene import Scene

Array = NDArray[np.float64]

DARK, SOFT = 0.62, 0.5
"""How much light a shadow takes, and the part of its radius over which it does so by degrees, inside and outside."""

CELLS = 1 << 20
"""The most cells of the shadow lookup."""


def shade(things: Things, pixels: NDArray[np.uint8], depth: NDArray[np.floating], scene: Scene) -> None:
    """Darken pixels (height, width, 3), in place, where things of the kind SHADOW say so."""
    chosen = things.kind == Kind.SHADOW
    if not chosen.any() or things.ends is None:
        return
    x0, y0, radius, ends = things.x[chosen], things.y[chosen], things.radius[chosen], things.ends[chosen]
    found = depth_in(*ground_places(scene, depth), np.column_stack([x0, y0, ends[:, 1], ends[:, 2], radius]))
    part = np.clip(0.5 + found / SOFT, 0, 1)
    light = 1 - DARK * part * part * (3 - 2 * part)
    dark = light < 1
    lit = srgb_to_linear(pixels[dark] / np.float32(255)) * light[dark][:, None].astype(np.float32)
    pixels[dark] = np.rint(linear_to_srgb(lit) * 255)


def depth_in(x: Array, y: Array, segments: Array) -> Array:
    """How deep places are in shadow: 1 in the middle, 0 at the border, below 0 outside; −inf far away.

    Args:
        x, y: places, of any shape, NaN where there is none. segments: (m, 5) both ends' x and y, and a radius.
    """
    from orograph.rendering.shadow_kernels import deepest

    pieces = _short(segments)
    middle = (pieces[:, :2] + pieces[:, 2:4]) / 2
    reach = np.hypot(*(pieces[:, 2:4] - pieces[:, :2]).T) / 2 + 2 * pieces[:, 4]  # (soft borders lie within)
    low, high = middle.min(0), middle.max(0)
    cell = max(float(reach.max()), float(np.max(high - low)) / 1000, 1e-9)
    across, down = (int(v) + 1 for v in (high - low) // cell)
    col, row = ((middle - low) // cell).astype(np.int64).T
    number = row * across + col
    order = np.argsort(number, kind="stable")
    first = np.searchsorted(number[order], np.arange(across * down + 1))
    out = np.full(x.size, -np.inf)
    deepest(np.ravel(x), np.ravel(y), pieces, first, order, low, cell, across, down, out)
    return out.reshape(x.shape)


def _short(segments: Array) -> Array:
    """Segments cut into pieces no longer than the width of the widest: together they cover the same area."""
    long = np.hypot(*(segments[:, 2:4] - segments[:, :2]).T)
    step = max(4 * float(segments[:, 4].max()), float(long.sum()) / CELLS)
    count = np.maximum(1, np.ceil(long / step)).astype(np.int64)
    of = np.repeat(np.arange(len(count)), count)
    share = ((np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)) / count[of])[:, None]
    start, way = segments[of, :2], segments[of, 2:4] - segments[of, :2]
    return np.column_stack([start + share * way, start + (share + 1 / count[of][:, None]) * way, segments[of, 4]])
