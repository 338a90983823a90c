"""Heights of a mesh at points: which triangle, seen from above, each lies in.

Points are sorted into square buckets; every triangle looks at those of the buckets that it may cover. With a few
thousand points and a million triangles that is a few hundredths of a second, and nothing of the size of the raster is
made. Heights in metres; positions in samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.tessellation import Tessellation

Array = NDArray[np.float64]

BUCKETS = 128
"""A side."""


@kernel
def _heights(vertices, triangles, x, y, first, order, west, north, size, out):
    """Heights ``out`` (n,) at points (n,); ``order``: points by bucket, ``first`` where each bucket's begin."""
    side = BUCKETS
    for k in range(len(triangles)):
        p, q, r = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        ax, ay, az = vertices[p, 0], vertices[p, 1], vertices[p, 2]
        ux, uy = vertices[q, 0] - ax, vertices[q, 1] - ay
        vx, vy = vertices[r, 0] - ax, vertices[r, 1] - ay
        area = ux * vy - vx * uy
        if area == 0.0:
            continue
        left, right = ax + min(0.0, ux, vx), ax + max(0.0, ux, vx)
        top, bottom = ay + min(0.0, uy, vy), ay + max(0.0, uy, vy)
        c0, c1 = int(np.floor((left - west) / size)), int(np.floor((right - west) / size))
        r0, r1 = int(np.floor((top - north) / size)), int(np.floor((bottom - north) / size))
        for row in range(max(r0, 0), min(r1, side - 1) + 1):
            for col in range(max(c0, 0), min(c1, side - 1) + 1):
                for n in range(first[row * side + col], first[row * side + col + 1]):
                    i = order[n]
                    dx, dy = x[i] - ax, y[i] - ay
                    s, t = (dx * vy - vx * dy) / area, (ux * dy - dx * uy) / area
                    if s >= -1e-9 and t >= -1e-9 and s + t <= 1.0 + 1e-9:
                        out[i] = az + s * (vertices[q, 2] - az) + t * (vertices[r, 2] - az)


def mesh_heights(mesh: Tessellation, x: Array, y: Array) -> Array:
    """Heights (n,) of a mesh at columns and rows (n,), metres; NaN where it has no triangle."""
    out = np.full(len(x), np.nan)
    if not len(x) or not len(mesh.triangles):
        return out
    west, north = float(np.min(x)), float(np.min(y))
    size = max(float(np.ptp(x)), float(np.ptp(y)), 1e-6) / BUCKETS * (1 + 1e-9)
    bucket = (((y - north) / size).astype(np.int64)) * BUCKETS + ((x - west) / size).astype(np.int64)
    order = np.argsort(bucket, kind="stable")
    first = np.searchsorted(bucket[order], np.arange(BUCKETS * BUCKETS + 1))
    _heights(mesh.vertices, mesh.triangles, x, y, first, order, west, north, size, out)
    return out
