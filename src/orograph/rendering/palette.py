"""The colours and the light that both backends give a picture: paper, water, missing data, sun and sky.

Colours are linear light, float32.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import srgb_to_linear
from orograph.lighting.shade import sky_color, sun_color
from orograph.lighting.sun import Sun
from orograph.scene.contours import Contours

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

PAPER = srgb_to_linear(np.array([0.965, 0.958, 0.937], np.float32))
MISSING = srgb_to_linear(np.array([[0.83, 0.845, 0.87], [0.50, 0.52, 0.56]], np.float32))
"""Ground and lines of the hatching over missing data: lighter and cooler than shadow, since the smallest voids are all
ground, and darker than snow and paper, since the largest are seen as a whole."""

HATCH, LINE = 7, 2.0
"""Pixels from line to line of the hatching (across the picture, not the line), and of a line's width."""

VISIBLE = 9
"""Samples of water or of missing data that are visible as such: a spot of three by three."""

WATER = srgb_to_linear(np.array([0.44, 0.60, 0.70], np.float32))
AMBIENT = 0.27
"""The share of the light on level ground, under a 45° sun and an open sky, that comes from the sky."""

BOUNCE = 0.10
"""The share of all light that ground without a view of the sky gets from lit ground instead."""


LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
LIFTED, LETTERED = np.float32(0.2), np.float32(0.3)
"""The least luminance of what is around a contour line and around a label, which are so as legible in shadow as in
light."""


def illumination(sun: Sun) -> tuple[Array, Colors, Colors]:
    """The unit vector (3,) towards the sun (east, north, up), the colours (3,) of its light and of the sky's.

    Exposure is set for level ground under a sun at 45°, which shows its own colour there, and opens for lower ones, by
    half only: evening is darker.
    """
    a, h = math.radians(sun.azimuth), math.radians(sun.altitude)
    to_sun = np.array([math.sin(a) * math.cos(h), math.cos(a) * math.cos(h), math.sin(h)])
    direct, sky = sun_color(sun.altitude), sky_color(sun.altitude)
    high = math.sin(math.radians(45))
    white = (1 - AMBIENT) * sun_color(45.0) + AMBIENT * sky_color(45.0)
    opened = (1 - AMBIENT) / high * (high / max(to_sun[2], 0.03)) ** 0.55
    return to_sun, (opened * direct / white).astype(np.float32), (AMBIENT * sky / white).astype(np.float32)


def hatching(px: Array, py: Array) -> Colors:
    """Linear colours (n, 3) over missing data at pixel positions: lines at 45°, the cartographer's sign for what is not
    known."""
    return MISSING[((px + py) % HATCH < LINE).astype(np.intp)]


def lifting(ground: Colors, least: np.float32) -> Colors:
    """How much paper (n,), 0 to 1, ground of these colours (n, 3) needs to have the luminance ``least``; in light
    none."""
    bright = ground @ LUMINANCE
    return np.asarray(np.maximum(least - bright, 0) / np.maximum(PAPER @ LUMINANCE - bright, least), np.float32)


def ink(contours: Contours) -> Colors:
    """The lines' colour (3,), linear light."""
    return np.asarray(srgb_to_linear(np.array(contours.color, np.float32)), np.float32)
