"""The renderer's inner loops over samples: what a pixel covers, how light falls there, what colour results.

All arrays run over the samples of a block; a sample that met no ground has NaN in its depth and position and is passed
over. Colours are linear light, float32.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.rendering.lookup import LEAST, SHORE, bilinear

GRAZING = 0.02
"""Cosine of the angle between a ray and the ground's normal below which a pixel's footprint grows no longer."""


@kernel
def footprints(px, py, t, o0, ou, ov, d0, du, dv, exaggeration, metres, parallel, slope, ground, least):
    """What pixels cover of the ground: ``ground`` (n, 4), metres east and north from where a ray meets it to where the
    next pixel's to the right (0, 1) and to below (2, 3) meet its tangent plane; ``least`` (n,) metres of a footprint's
    minor axis, so that ground which is steep in the map does not want endless detail.

    Args:
        slope: (n, 2) metres per metre east and north, of the true ground. metres, parallel: as for ``ends``.
    """
    for i in range(len(px)):
        # In stretched space, where distances are those of the picture.
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
        least[i] = LEAST * (metres if parallel else metres * t[i] * length)


@kernel
def incidence(gradient, to_world, stretch, sun, cosine, tilt):
    """Cosine of the light's angle to the normal (not below 0), upward part of the normal, of ``stretch``-ed slopes."""
    for i in range(len(gradient)):
        a, b = gradient[i, 0], gradient[i, 1]
        gx = (to_world[0, 0] * a + to_world[0, 1] * b) * stretch
        gy = (to_world[1, 0] * a + to_world[1, 1] * b) * stretch
        up = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
        cosine[i] = max((sun[2] - gx * sun[0] - gy * sun[1]) * up, 0.0)
        tilt[i] = up


@kernel
def _shoulder(x):
    """Bend what is brighter than 0.82 smoothly towards 1, so that sunlit snow keeps its relief; linear below."""
    return x if x < 0.82 else 0.82 + 0.18 * (1.0 - np.exp((0.82 - x) / 0.18))


@inlined
def _albedo(points, i, wet_map, water_map, u, v, land, low, high, sea, floor):
    """Where in which table a sample's tint lies (below the sea's level?, entry, how far to the next), and its water."""
    below = sea.shape[0] > 0 and points[i, 2] < 0.0
    last = (sea.shape[0] if below else land.shape[0]) - 1
    z = (points[i, 2] - floor) / -floor if below else (points[i, 2] - low) / (high - low)
    z = min(max(z * last, 0.0), last - 1e-6)
    k = np.int64(z)
    wet = 0.0
    if wet_map:
        wet = min(max((bilinear(water_map, u, v) - (0.5 - SHORE)) / (2.0 * SHORE), 0.0), 1.0)
        wet = wet * wet * (3.0 - 2.0 * wet)
    return below, k, z - k, wet


@kernel
def paint(points, light, water_map, scale, row0, col0, land, low, high, sea, floor, drape, water, out):
    """Colours (n, 3) of ground under a light (n, 3) float32; other arguments as for ``compose``."""
    wet_map, draped = water_map.shape[0] > 0, drape.shape[0] > 0
    for i in range(len(points)):
        if points[i, 0] != points[i, 0]:
            continue
        u = (points[i, 0] + 0.5) / scale - 0.5 - col0
        v = (points[i, 1] + 0.5) / scale - 0.5 - row0
        below, k, f, wet = _albedo(points, i, wet_map, water_map, u, v, land, low, high, sea, floor)
        table = sea if below else land
        for c in range(3):
            albedo = table[k, c] * (1.0 - f) + table[k + 1, c] * f
            albedo = albedo * (1.0 - wet) + water[c] * wet
            if draped:
                albedo = albedo * drape[i, 3 + c] + drape[i, c]
            out[i, c] = _shoulder(albedo * light[i, c])


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
def compose(
    points,
    cosine,
    tilt,
    sunlit,
    sky_map,
    water_map,
    scale,
    row0,
    col0,
    land,
    low,
    high,
    sea,
    floor,
    drape,
    water,
    sunlight,
    skylight,
    bounce,
    out,
):
    """Colours (n, 3) of lit ground.

    Args:
        sunlit: (n,) part of the sun seen. sky_map, water_map: fields over samples of 2^level = ``scale``, first
            (row0, col0); water_map is 0.5 on the shore and may have no samples.
        land: (k, 3) tint from height ``low`` to ``high``; sea: (m, 3) from ``floor`` to 0 m, or (0, 3).
        drape: (n, 7) what layers make of tint and water (``geovis.layers.composite``), or (0, 7).
        water, sunlight, skylight: (3,) colours; bounce: part of all light that ground sees instead of hidden sky.
    """
    wet_map, draped = water_map.shape[0] > 0, drape.shape[0] > 0
    for i in range(len(points)):
        if points[i, 0] != points[i, 0]:
            continue
        u = (points[i, 0] + 0.5) / scale - 0.5 - col0
        v = (points[i, 1] + 0.5) / scale - 0.5 - row0
        sky = bilinear(sky_map, u, v)
        if sky != sky:
            sky = 1.0
        below, k, f, wet = _albedo(points, i, wet_map, water_map, u, v, land, low, high, sea, floor)
        table = sea if below else land
        lit = cosine[i] * sunlit[i]
        # Light from the sky comes from around the zenith: what leans away sees less of it besides its horizon.
        open_sky = sky * (0.5 + 0.5 * tilt[i])
        for c in range(3):
            albedo = table[k, c] * (1.0 - f) + table[k + 1, c] * f
            albedo = albedo * (1.0 - wet) + water[c] * wet
            if draped:
                albedo = albedo * drape[i, 3 + c] + drape[i, c]
            light = lit * sunlight[c] + open_sky * skylight[c] + (1.0 - sky) * bounce * (sunlight[c] + skylight[c])
            out[i, c] = _shoulder(albedo * light)
