"""The renderer's inner loops over samples: a pixel's footprint, its light, and its colour.

All arrays run over the samples of a block; a sample that met no ground has NaN in its depth and position and is
skipped. Colours are linear light, float32.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.rendering.lookup import LEAST, SHORE, bilinear, within_map

GRAZING = 0.02
"""Cosine of the angle between a ray and the ground's normal below which a pixel's footprint stops growing."""


class Light(NamedTuple):
    """The light of a picture with the light "relief".

    Attributes:
        sun, sky: (3,) colours. bounce: the part of all light that comes from ground in place of hidden sky.
    """

    sun: NDArray[np.float32]
    sky: NDArray[np.float32]
    bounce: float


@kernel
def footprints(px, py, t, pixels, slope, ground, least):
    """The footprints of pixels on the ground.

    ``ground`` (n, 4): metres east and north from where a ray meets the ground to where the rays of the next pixel to
    the right (0, 1) and below (2, 3) meet its tangent plane. ``least`` (n,): metres of a footprint's minor axis, so
    that ground which is steep in the map does not need endless detail.

    Args:
        pixels: ``PixelRays``; px, py, t: (n,) pixel positions and depths.
        slope: (n, 2) metres per metre east and north, of the true ground.
    """
    _, ou, ov, d0, du, dv = pixels.basis
    exaggeration = pixels.exaggeration
    for i in range(len(px)):
        # In stretched space, whose distances are the picture's.
        x = d0[0] + px[i] * du[0] + py[i] * dv[0]
        y = d0[1] + px[i] * du[1] + py[i] * dv[1]
        z = (d0[2] + px[i] * du[2] + py[i] * dv[2]) * exaggeration
        a, b = -slope[i, 0] * exaggeration, -slope[i, 1] * exaggeration
        length = np.sqrt(x * x + y * y + z * z)
        facing = min(a * x + b * y + z, -GRAZING * length * np.sqrt(a * a + b * b + 1.0))
        for k in range(2):
            ex = (ou[0] if k == 0 else ov[0]) + t[i] * (du[0] if k == 0 else dv[0])
            ey = (ou[1] if k == 0 else ov[1]) + t[i] * (du[1] if k == 0 else dv[1])
            ez = ((ou[2] if k == 0 else ov[2]) + t[i] * (du[2] if k == 0 else dv[2])) * exaggeration
            along = (a * ex + b * ey + ez) / facing
            ground[i, 2 * k] = ex - along * x
            ground[i, 2 * k + 1] = ey - along * y
        least[i] = LEAST * (pixels.pixel if pixels.parallel else pixels.pixel * t[i] * length)


@kernel
def incidence(gradient, to_world, stretch, sun, cosine, tilt):
    """Cosine of the light's angle to the normal (at least 0), and the normal's upward part, after ``stretch``."""
    for i in range(len(gradient)):
        a, b = gradient[i, 0], gradient[i, 1]
        gx = (to_world[0, 0] * a + to_world[0, 1] * b) * stretch
        gy = (to_world[1, 0] * a + to_world[1, 1] * b) * stretch
        up = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
        cosine[i] = max((sun[2] - gx * sun[0] - gy * sun[1]) * up, 0.0)
        tilt[i] = up


@kernel
def _shoulder(x):
    """Bend values above 0.82 smoothly towards 1, so that sunlit snow keeps its relief; linear below."""
    return x if x < 0.82 else 0.82 + 0.18 * (1.0 - np.exp((0.82 - x) / 0.18))


@inlined
def _albedo(height, u, v, water_map, tint, water, drape, i):
    """The ground's own colour: its tint, then water, then layers."""
    below = tint.sea.shape[0] > 0 and height < 0.0
    table = tint.sea if below else tint.land
    last = table.shape[0] - 1
    z = (height - tint.floor) / -tint.floor if below else (height - tint.low) / (tint.high - tint.low)
    z = min(max(z * last, 0.0), last - 1e-6)
    k = np.int64(z)
    f = z - k
    wet = 0.0
    if water_map.shape[0] > 0:
        wet = min(max((bilinear(water_map, u, v) - (0.5 - SHORE)) / (2.0 * SHORE), 0.0), 1.0)
        wet = wet * wet * (3.0 - 2.0 * wet)
    red = (table[k, 0] * (1.0 - f) + table[k + 1, 0] * f) * (1.0 - wet) + water[0] * wet
    green = (table[k, 1] * (1.0 - f) + table[k + 1, 1] * f) * (1.0 - wet) + water[1] * wet
    blue = (table[k, 2] * (1.0 - f) + table[k + 1, 2] * f) * (1.0 - wet) + water[2] * wet
    if drape.shape[0] > 0:
        red = red * drape[i, 3] + drape[i, 0]
        green = green * drape[i, 4] + drape[i, 1]
        blue = blue * drape[i, 5] + drape[i, 2]
    return red, green, blue


@kernel
def paint(points, light, water_map, place, tint, water, drape, out):
    """Colours (n, 3) of ground under a light (n, 3) float32; other arguments as for ``compose``."""
    for i in range(len(points)):
        if points[i, 0] != points[i, 0]:
            continue
        u, v = within_map(place, points[i, 0], points[i, 1])
        albedo = _albedo(points[i, 2], u, v, water_map, tint, water, drape, i)
        for c in range(3):
            out[i, c] = _shoulder(albedo[c] * light[i, c])


@kernel
def normals(gradient, to_world, stretch, out):
    """Unit normals (n, 3), east, north, up, of gradients (n, 2) in metres per sample, ``stretch``-ed."""
    for i in range(len(gradient)):
        a, b = gradient[i, 0], gradient[i, 1]
        gx = (to_world[0, 0] * a + to_world[0, 1] * b) * stretch
        gy = (to_world[1, 0] * a + to_world[1, 1] * b) * stretch
        up = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
        out[i, 0], out[i, 1], out[i, 2] = -gx * up, -gy * up, up


@kernel
def compose(points, lit, tilt, sky_map, water_map, place, tint, water, drape, light, out):
    """Colours (n, 3) of lit ground.

    Args:
        points: (n, 3) sample coordinates and height, metres.
        lit: (n,) cosine of the sun's angle to the normal, times the visible part of the sun. tilt: from ``incidence``.
        sky_map, water_map: fields over the samples of a ``MapPlace``; water_map is 0.5 on the shore and may have no
            samples.
        tint: ``geovis.color.Tint``. water: (3,) its colour. light: ``Light``.
        drape: (n, 7) layers over tint and water (``geovis.layers.composite``), or (0, 7).
    """
    sunlight, skylight, bounce = light
    for i in range(len(points)):
        if points[i, 0] != points[i, 0]:
            continue
        u, v = within_map(place, points[i, 0], points[i, 1])
        sky = bilinear(sky_map, u, v)
        if sky != sky:
            sky = 1.0
        albedo = _albedo(points[i, 2], u, v, water_map, tint, water, drape, i)
        # Light from the sky comes from around the zenith: inclined ground sees less of it, in addition to its horizon.
        open_sky = sky * (0.5 + 0.5 * tilt[i])
        for c in range(3):
            whole = lit[i] * sunlight[c] + open_sky * skylight[c] + (1.0 - sky) * bounce * (sunlight[c] + skylight[c])
            out[i, c] = _shoulder(albedo[c] * whole)
