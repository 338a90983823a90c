"""For each place of an exemplar, a similar one: the second candidates of k-coherent search.

The field of nearest neighbourhoods is found by propagation and random search (C. Barnes et al., *PatchMatch*, SIGGRAPH
2009) in integers and a fixed order, so that it is the same on every machine. A match is at least ``apart`` samples
away, because everything next to a place is similar to it (Lefebvre & Hoppe 2005, §3.3).
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.dem.noise import hashed


@inlined
def mirrored(x, size):
    """A coordinate at most ``size`` beyond a border, mirrored there."""
    return -1 - x if x < 0 else (2 * size - 1 - x if x >= size else x)


@inlined
def between(features, x, y, u, v, step, most):
    """The squared distance of the neighbourhoods of 5 × 5 at two places, or any value above ``most``."""
    rows, cols = features.shape
    total = np.int64(0)
    for di in range(-2, 3):
        if total > most:
            break
        r, s = mirrored(y + step * di, rows), mirrored(v + step * di, rows)
        for dj in range(-2, 3):
            c, d = mirrored(x + step * dj, cols), mirrored(u + step * dj, cols)
            e = np.int64(features[r, c]) - features[s, d]
            total += e * e
    return total


@inlined
def allowed(u, v, x, y, reach, rows, cols, apart):
    """Whether (u, v) may be the match of (x, y): its neighbourhood is inside, and it is far enough away."""
    inside = reach <= u < cols - reach and reach <= v < rows - reach
    return inside and max(abs(u - x), abs(v - y)) >= apart


@kernel
def similar_places(features, step, apart, rounds, seed, out):
    """Fill ``out`` (rows, cols, 2) int16 with the matches (x, y) of all places.

    Args:
        features: (rows, cols) int16. step: samples between those of a neighbourhood; at most half of each side.
        apart: minimum samples between a place and its match along an axis.
        rounds: of propagation, in alternating directions.
    """
    rows, cols = features.shape
    reach = min(2 * step, min(rows, cols) // 4)
    found = np.empty((rows, cols), np.int64)
    most = np.int64(1) << 40
    for y in range(rows):
        for x in range(cols):
            u, v, salt = -1, -1, 0
            while not allowed(u, v, x, y, reach, rows, cols, apart):
                h = hashed(x, y, seed + salt)
                u = reach + ((h & 0xFFFF) * (cols - 2 * reach) >> 16)
                v = reach + ((h >> 16) * (rows - 2 * reach) >> 16)
                salt += 1
            out[y, x, 0], out[y, x, 1] = u, v
            found[y, x] = between(features, x, y, u, v, step, most)
    for n in range(rounds):
        way = 1 if n % 2 == 0 else -1
        for i in range(rows):
            y = i if way > 0 else rows - 1 - i
            for j in range(cols):
                x = j if way > 0 else cols - 1 - j
                best, bu, bv = found[y, x], out[y, x, 0], out[y, x, 1]
                for axis in range(2):
                    px, py = (x - way, y) if axis == 0 else (x, y - way)
                    if 0 <= px < cols and 0 <= py < rows:
                        u, v = out[py, px, 0] + x - px, out[py, px, 1] + y - py
                        if allowed(u, v, x, y, reach, rows, cols, apart):
                            d = between(features, x, y, u, v, step, best)
                            if d < best:
                                best, bu, bv = d, u, v
                radius, salt = max(rows, cols), 0
                while radius >= 1:
                    h = hashed(x, y, seed + 104729 * (n + 1) + salt)
                    u = bu + (((h & 0xFFFF) * (2 * radius + 1)) >> 16) - radius
                    v = bv + (((h >> 16) * (2 * radius + 1)) >> 16) - radius
                    if allowed(u, v, x, y, reach, rows, cols, apart):
                        d = between(features, x, y, u, v, step, best)
                        if d < best:
                            best, bu, bv = d, u, v
                    radius >>= 1
                    salt += 1
                found[y, x], out[y, x, 0], out[y, x, 1] = best, bu, bv
