"""Light on hits of a picture by rays: how much of a disc and of the sky each hit sees, and which lamps.

From a hit, ``rays`` directions spread over the disc (a Fibonacci lattice, rotated and shifted at random by a hash of
the hit's pixel, as in ``occlusion_kernels``) are traced to the surface, and the same number with density ⟨ω, n⟩/π over
the hemisphere around its normal. Small discs are first tested at their middle and at four places on the rim: only hits
whose five answers differ, in the penumbra, need more rays. Rays begin ``skip`` metres away: the hit's own facet is
nearer than that, and for it the normal decides. Directions are metres (east, north, up) on the stretched ground.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.lighting.occlusion_kernels import GOLDEN, LEVEL, _frame, _shift
from orograph.raycast.kernels import ray

SMALL = 0.9990
"""Cosine of the radius (2.5°) of discs for which five rays decide whether all or nothing is visible."""


@inlined
def _free(scene, x, y, z, e, n, up, inverse, exaggeration, skip, far, spans):
    """Whether a direction is free of ground between ``skip`` and ``far`` metres."""
    dx, dy = inverse[0, 0] * e + inverse[0, 1] * n, inverse[1, 0] * e + inverse[1, 1] * n
    t, _ = ray(scene, (x, y, z), (dx, dy, up / exaggeration), skip, far, 0, LEVEL, spans)
    return t == np.inf


@kernel
def disc_on_hits(scene, points, normals, skip, pixels, inverse, exaggeration, axis, cosine, rays, out):
    """The light of a disc on hits: the mean over it of its cosine to the normal where it is visible.

    Args:
        scene: the caster's.
        points: (n, 3) sample coordinates, true heights; NaN rows are skipped. normals: (n, 3) unit.
        skip: (n,) metres. pixels: (n, 2) int64, from which the lattice's shift is derived.
        inverse: (2, 2) samples per metre. axis: (3,) to the disc's middle. cosine: of its radius.
        out: (n,) float64.
    """
    spans = np.empty((scene.ints.shape[0], 2))
    ax, ay, az, bx, by, bz = _frame(axis[0], axis[1], axis[2])
    sine = np.sqrt(max(1.0 - cosine * cosine, 0.0))
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        out[k] = 0.0
        if x != x:
            continue
        nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
        facing = nx * axis[0] + ny * axis[1] + nz * axis[2]
        if facing <= -sine:
            continue
        u0, v0 = _shift(pixels[k, 0], pixels[k, 1], 1)
        if cosine >= SMALL:
            if facing <= 0.0:
                continue
            seen = 0
            for m in range(5):
                w = 1.0 if m == 0 else cosine
                v = 2.0 * np.pi * (0.25 * m + 0.25 * v0)
                r = 0.0 if m == 0 else sine
                p, q = r * np.cos(v), r * np.sin(v)
                e, n, up = p * ax + q * bx + w * axis[0], p * ay + q * by + w * axis[1], p * az + q * bz + w * axis[2]
                if _free(scene, x, y, z, e, n, up, inverse, exaggeration, skip[k], np.inf, spans):
                    seen += 1
                if seen != 0 and seen != m + 1:
                    break
            if seen == 0 or seen == 5:
                out[k] = facing if seen == 5 else 0.0
                continue
        total = 0.0
        for m in range(rays):
            w = 1.0 - (1.0 - cosine) * (m + u0) / rays
            v = 2.0 * np.pi * (m * GOLDEN + v0)
            r = np.sqrt(max(1.0 - w * w, 0.0))
            p, q = r * np.cos(v), r * np.sin(v)
            e, n, up = p * ax + q * bx + w * axis[0], p * ay + q * by + w * axis[1], p * az + q * bz + w * axis[2]
            share = e * nx + n * ny + up * nz
            if share > 0.0 and _free(scene, x, y, z, e, n, up, inverse, exaggeration, skip[k],
                                     np.inf, spans):  # fmt: skip
                total += share
        out[k] = total / rays


@kernel
def sky_on_hits(scene, points, normals, skip, pixels, inverse, exaggeration, rays, out):
    """Ambient occlusion of hits without limit of distance, by cosine-weighted rays; arguments: ``disc_on_hits``."""
    spans = np.empty((scene.ints.shape[0], 2))
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        out[k] = 0.0
        if x != x:
            continue
        nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
        ax, ay, az, bx, by, bz = _frame(nx, ny, nz)
        u0, v0 = _shift(pixels[k, 0], pixels[k, 1], 2)
        free = 0
        for m in range(rays):
            u, v = (m + u0) / rays, 2.0 * np.pi * (m * GOLDEN + v0)
            r, w = np.sqrt(u), np.sqrt(1.0 - u)
            p, q = r * np.cos(v), r * np.sin(v)
            e, n, up = p * ax + q * bx + w * nx, p * ay + q * by + w * ny, p * az + q * bz + w * nz
            if _free(scene, x, y, z, e, n, up, inverse, exaggeration, skip[k], np.inf, spans):
                free += 1
        out[k] = free / rays


@kernel
def lamp_on_hits(scene, points, normals, skip, inverse, exaggeration, linear, lamp, out):
    """Add the light of a lamp on hits to ``out`` (n, 3); ``lamp``: a row of ``aperture_kernels``' table, stretched."""
    spans = np.empty((scene.ints.shape[0], 2))
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        if x != x:
            continue
        e = lamp[0] - (linear[0, 0] * x + linear[0, 1] * y)
        n = lamp[1] - (linear[1, 0] * x + linear[1, 1] * y)
        up = lamp[2] - z * exaggeration
        away = np.sqrt(e * e + n * n + up * up)
        if away <= 0.0:
            continue
        e, n, up = e / away, n / away, up / away
        facing = e * normals[k, 0] + n * normals[k, 1] + up * normals[k, 2]
        if facing > 0.0 and _free(scene, x, y, z, e, n, up, inverse, exaggeration,
                                  min(skip[k], away), away, spans):  # fmt: skip
            for m in range(3):
                out[k, m] += facing / (away * away) * lamp[3 + m]
