"""Compiled loops of ambient aperture lighting: caps from horizons, light through caps.

A *field* of caps is (rows, cols, 4) float32: the direction (east, north, up) and the cosine of the radius, side by side
in memory, because they are always used together. With cosines, angles are computed only where a cap's rim cuts a disc.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.lighting.caps import exact_overlap, smooth_overlap

EAST, NORTH, UP, RADIUS, COSINE, SINE, AREA, RED, GREEN, BLUE = range(10)
"""Columns of a table of suns: direction, angular radius and its cosine and sine, solid angle, irradiance of a surface
that faces it."""

X, Y, Z, LAMP_RED, LAMP_GREEN, LAMP_BLUE = range(6)
"""Columns of a table of lamps: place (metres east and north of sample (0, 0), height), irradiance at one metre."""


class LightTables(NamedTuple):
    """Suns (k, 10) and lamps (m, 6), see the columns above; ambient: (3,) irradiance of an open sky."""

    suns: NDArray[np.float64]
    lamps: NDArray[np.float64]
    ambient: NDArray[np.float64]


@kernel
def add_moments(slope, gx, gy, east, north, width, row0, col0, out):
    """Add one azimuth's visible sky to ``out`` (4, rows, cols): ∫ ω dω (east, north, up) and ∫ dω.

    slope, gx, gy: (r, c) of a window of ``out`` at (row0, col0). width: radians of azimuth that this one represents.
    """
    for i in range(slope.shape[0]):
        for j in range(slope.shape[1]):
            t = max(np.float64(slope[i, j]), np.float64(gx[i, j]) * east + np.float64(gy[i, j]) * north)
            square = 1.0 / (1.0 + t * t)
            level = 0.5 * (0.5 * np.pi - np.arctan(t) - t * square) * width
            out[0, i + row0, j + col0] += np.float32(east * level)
            out[1, i + row0, j + col0] += np.float32(north * level)
            out[2, i + row0, j + col0] += np.float32(0.5 * square * width)
            out[3, i + row0, j + col0] += np.float32((1.0 - t * np.sqrt(square)) * width)


@inlined
def illuminate(cap, rim, normal, place, lights, exact, out, k):
    """Set ``out[k]`` (3,) to the light on ground at a place through one cap; ``rim``: the cosine of its radius.

    Each sun gives the overlap of its disc and the cap, times the cosine at the middle of the overlap. Lamps are visible
    only inside the cap. The sky gives the cap's own irradiance, minus the part that suns cover.
    """
    (ce, cn, cu), (nx, ny, nz), (px, py, pz) = cap, normal, place
    suns, lamps, ambient = lights
    red = green = blue = 0.0
    straight = nx * ce + ny * cn + nz * cu
    square = max(1.0 - rim * rim, 0.0)
    sine = np.sqrt(square)
    sky = max(straight, 0.0) * square
    for s in range(suns.shape[0]):
        le, ln, lu = suns[s, EAST], suns[s, NORTH], suns[s, UP]
        cosine = ce * le + cn * ln + cu * lu
        bend = sine * suns[s, SINE]
        facing = nx * le + ny * ln + nz * lu
        part = 1.0
        # Radii are at most 90° and 45°: cosines can be compared like angles, except for a disc wider than the cap.
        if cosine < rim * suns[s, COSINE] + bend or rim > suns[s, COSINE]:
            if cosine <= rim * suns[s, COSINE] - bend:
                continue
            radius, width = np.arccos(min(max(rim, -1.0), 1.0)), suns[s, RADIUS]
            distance = np.arccos(min(max(cosine, -1.0), 1.0))
            shared = exact_overlap(distance, radius, width) if exact else smooth_overlap(distance, radius, width)
            part = shared / suns[s, AREA] if width > 0.0 else 0.0
            # The middle of the lens lies on the arc from the cap's centre to the sun's.
            along = min(max(0.5 * (radius + distance - width), 0.0), distance)
            if distance > 1e-9:
                facing = (np.sin(distance - along) * straight + np.sin(along) * facing) / np.sin(distance)
        if facing <= 0.0:
            continue
        light = part * facing
        sky -= light * suns[s, SINE] * suns[s, SINE]
        red += light * suns[s, RED]
        green += light * suns[s, GREEN]
        blue += light * suns[s, BLUE]
    for s in range(lamps.shape[0]):
        e, n, u = lamps[s, X] - px, lamps[s, Y] - py, lamps[s, Z] - pz
        away = e * e + n * n + u * u
        if away <= 0.0:
            continue
        inverse = 1.0 / np.sqrt(away)
        if (ce * e + cn * n + cu * u) * inverse < rim:
            continue
        power = max(nx * e + ny * n + nz * u, 0.0) * inverse / away
        red += power * lamps[s, LAMP_RED]
        green += power * lamps[s, LAMP_GREEN]
        blue += power * lamps[s, LAMP_BLUE]
    sky = max(sky, 0.0)
    out[k, 0] = red + sky * ambient[0]
    out[k, 1] = green + sky * ambient[1]
    out[k, 2] = blue + sky * ambient[2]


@kernel
def light_hits(points, gradient, caps, lights, exact, first, last, out):
    """Light on hits [first, last) of a picture, or on any points of the ground.

    Args:
        points: (n, 3) sample coordinates (column, row, metres); NaN rows are skipped.
        gradient: (n, 2) rise per metre east and north.
        caps: ``aperture.CapField``; NaN: open sky. lights: ``LightTables``.
        exact: the closed form of the overlap, else the smoothstep.
        out: (n, 3) float32, irradiance.
    """
    field, linear, scale, row0, col0 = caps
    rows, cols = field.shape[0], field.shape[1]
    for k in range(first, last):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        if x != x:
            continue
        u, v = (x + 0.5) / scale - 0.5 - col0, (y + 0.5) / scale - 0.5 - row0
        j = min(max(np.int64(u), 0), max(cols - 2, 0))
        i = min(max(np.int64(v), 0), max(rows - 2, 0))
        f, g = min(max(u - j, 0.0), 1.0), min(max(v - i, 0.0), 1.0)
        j1, i1 = min(j + 1, cols - 1), min(i + 1, rows - 1)
        a, b, c, d = (1.0 - f) * (1.0 - g), f * (1.0 - g), (1.0 - f) * g, f * g
        ce = a * field[i, j, 0] + b * field[i, j1, 0] + c * field[i1, j, 0] + d * field[i1, j1, 0]
        cn = a * field[i, j, 1] + b * field[i, j1, 1] + c * field[i1, j, 1] + d * field[i1, j1, 1]
        cu = a * field[i, j, 2] + b * field[i, j1, 2] + c * field[i1, j, 2] + d * field[i1, j1, 2]
        rim = a * field[i, j, 3] + b * field[i, j1, 3] + c * field[i1, j, 3] + d * field[i1, j1, 3]
        length = np.sqrt(ce * ce + cn * cn + cu * cu)
        if not length > 0.0 or rim != rim:
            ce, cn, cu, rim = 0.0, 0.0, 1.0, 0.0
        else:
            ce, cn, cu = ce / length, cn / length, cu / length
        gx, gy = gradient[k, 0], gradient[k, 1]
        up = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
        px, py = linear[0, 0] * x + linear[0, 1] * y, linear[1, 0] * x + linear[1, 1] * y
        illuminate((ce, cn, cu), rim, (-gx * up, -gy * up, up), (px, py, z), lights, exact, out, k)
