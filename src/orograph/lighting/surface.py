"""Properties of the ground itself: normals, slope, aspect, and hillshades by Lambert's cosine law.

All come from one gradient (``normal``): central differences between a sample's neighbours along its row and its column
(Zevenbergen & Thorne 1987), one-sided beside missing samples and at the border, turned into metres per metre towards
east and north by the cells' own geometry. With p, q the rise per metre east and north:

- normal (−p, −q, 1) / sqrt(1 + p² + q²): east, north, up;
- slope arctan sqrt(p² + q²), degrees;
- aspect, the azimuth in which the ground falls: degrees clockwise from north of (−p, −q), in [0, 360); NaN where level;
- hillshade max(0, n · l) for light from the unit vector l: azimuth clockwise from north, altitude above the horizon.
  Of several lights the mean by their weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.lighting.context import Blocks, Context, Options
from orograph.lighting.products import Product

Values = NDArray[np.float32]
Light = tuple[float, ...]


def normal_of(east: Values, north: Values) -> Values:
    """Unit normals (3, rows, cols) float32, east, north, up, of gradients (rows, cols)."""
    length = np.sqrt(np.float32(1.0) + east * east + north * north)
    return np.stack([-east / length, -north / length, np.float32(1.0) / length])


def slope_of(east: Values, north: Values) -> Values:
    """Slopes (1, rows, cols), degrees."""
    return np.degrees(np.arctan(np.hypot(east, north)))[None]


def aspect_of(east: Values, north: Values) -> Values:
    """Azimuths (1, rows, cols) in which the ground falls, degrees clockwise from north; NaN where it is level."""
    azimuth = np.degrees(np.arctan2(-east, -north))
    azimuth[azimuth < 0] += np.float32(360.0)
    azimuth[azimuth >= 360.0] = 0.0  # -0.000001 after rounding
    azimuth += np.float32(0.0)  # no -0
    azimuth[(east == 0) & (north == 0)] = np.nan
    return azimuth[None]


def hillshade_of(east: Values, north: Values, lights: Sequence[Light], exaggeration: float = 1.0) -> Values:
    """Brightness (1, rows, cols) in [0, 1] under lights (azimuth, altitude, weight)."""
    total = sum(weight for _, _, weight in lights)
    if not lights or total <= 0 or any(weight < 0 for _, _, weight in lights):
        raise UsageError("Weights of lights must not be negative, nor all 0.")
    factor = np.float32(exaggeration)
    p, q = east * factor, north * factor
    out = np.zeros_like(p)
    for azimuth, altitude, weight in lights:
        a, h = math.radians(azimuth), math.radians(altitude)
        x, y, z = (np.float32(v) for v in (math.sin(a) * math.cos(h), math.cos(a) * math.cos(h), math.sin(h)))
        out += np.float32(weight / total) * np.maximum(z - p * x - q * y, np.float32(0.0))
    out /= np.sqrt(np.float32(1.0) + p * p + q * q)
    return np.minimum(out, np.float32(1.0))[None]


def _normal(context: Context) -> Blocks:
    return context.blocks(lambda *window: normal_of(*context.gradient(*window)), "Finding normals")


def _slope(context: Context) -> Blocks:
    return context.blocks(lambda *window: slope_of(*context.gradient(*window)), "Finding slopes")


def _aspect(context: Context) -> Blocks:
    return context.blocks(lambda *window: aspect_of(*context.gradient(*window)), "Finding aspects")


def _hillshade(context: Context) -> Blocks:
    options = context.options
    lights = options.lights or ((*options.sun, 1.0),)
    return context.blocks(
        lambda *window: hillshade_of(*context.gradient(*window), lights, options.exaggeration), "Shading"
    )


def _normals(options: Options) -> list[str]:
    return ["normal east", "normal north", "normal up"]


PRODUCTS = (
    Product("normal", _normals, "1", "unit normal of the ground: east, north, up", _normal, (-1.0, 1.0)),
    Product("slope", lambda _: ["slope"], "degrees", "steepness of the ground", _slope, (0.0, 90.0)),
    Product(
        "aspect",
        lambda _: ["aspect"],
        "degrees",
        "azimuth in which the ground falls, clockwise from grid north; missing where it is level",
        _aspect,
        (0.0, 360.0),
    ),
    Product(
        "hillshade",
        lambda _: ["hillshade"],
        "1",
        "cosine of the angle between light and normal, at least 0",
        _hillshade,
    ),
)
