"""Rays in small bundles from one eye (the samples of a pixel): each bundle pushes one front, then its rays walk on alone."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel
from orograph.raycast.kernels import EAST, NORTH, SCALE, SOUTH, WEST, advance, ray

INF = np.inf


@kernel
def cast_bundles(scene, ints, floats, low, high, o, rays, bundle, t0, t1, out, which, first, last):
    """Bundles [first, last) of ``bundle`` consecutive rays of ``rays`` (n, 3) from an eye ``o`` above the surface.

    ``out`` float64 (n,): t (NaN: none), ``which`` int8 (n,): the window hit.
    """
    windows = ints.shape[0]
    spans = np.empty((windows, 2))
    finest = floats[windows - 1, SCALE]
    edge_x = max(abs(o[0] - floats[0, WEST]), abs(o[0] - floats[0, EAST]))
    edge_y = max(abs(o[1] - floats[0, NORTH]), abs(o[1] - floats[0, SOUTH]))
    edge = np.hypot(edge_x, edge_y) * (1.0 + 1e-9) + 1e-9  # beyond its farthest corner no ray is over the terrain
    for b in range(first, last):
        xa, xb, ya, yb, slope, end = INF, -INF, INF, -INF, INF, 0.0
        for i in range(b * bundle, (b + 1) * bundle):
            xa, xb = min(xa, rays[i, 0]), max(xb, rays[i, 0])
            ya, yb = min(ya, rays[i, 1]), max(yb, rays[i, 1])
            slope = min(slope, rays[i, 2])
            leaves = edge / max(np.hypot(rays[i, 0], rays[i, 1]), 1e-300)
            if rays[i, 2] < 0.0:
                leaves = min(leaves, max((low - o[2]) / rays[i, 2], 0.0))
            end = max(end, leaves)
        end = min(end, t1)
        speed = max(max(abs(xa), abs(xb)), max(abs(ya), abs(yb))) + 1e-300
        front, _, _ = advance(scene, ints, floats, high, o, xa, xb, ya, yb, slope, 0.0, end, 16.0 * finest / speed)
        for i in range(b * bundle, (b + 1) * bundle):
            t, w = INF, -1
            if front < end:
                start = max(front, t0)
                t, w = ray(
                    scene, ints, floats, low, high, o[0], o[1], o[2], rays[i, 0], rays[i, 1], rays[i, 2], start, t1,
                    1 if start == front else 0, 2, spans,
                )  # fmt: skip
            out[i] = t if t < INF else np.nan
            which[i] = w
