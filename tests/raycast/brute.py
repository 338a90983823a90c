"""What the caster should find, the slow way: every ray against every triangle, in float64 NumPy.

Triangles are intersected as Möller & Trumbore (1997) do it; the diagonals come from the definition of the surface (they
join (even, even) and (odd, odd) corners), not from the caster. At exact ties (a ray along an edge, through a vertex, in
the plane of a facet) whether a triangle is hit is a matter of rounding, so a hit is *sure* only where the ray changes
its side of the surface with room to spare.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Heights = NDArray[np.float32]


def triangles(heights: Heights, flipped: bool = False) -> Array:
    """The valid triangles, (n, 3, 3) as x, y, z; ``flipped`` cuts every cell along the other diagonal."""
    rows, cols = heights.shape
    found = []
    for r in range(rows - 1):
        for c in range(cols - 1):
            a, b, d, e = ((c + i, r + j, float(heights[r + j, c + i])) for j in (0, 1) for i in (0, 1))
            even = (c + r) % 2 == 0
            halves = ((a, b, e), (a, e, d)) if even != flipped else ((a, b, d), (b, e, d))
            found += [t for t in halves if not np.isnan([p[2] for p in t]).any()]
    return np.array(found, np.float64).reshape(-1, 3, 3)


def intersections(tri: Array, origins: Array, directions: Array, grow: float = 1e-9) -> Array:
    """t of every ray with every triangle (rays, triangles), inf where they do not meet; triangles grown by ``grow``."""
    if len(tri) == 0:
        return np.full((len(origins), 1), np.inf)
    e1, e2 = tri[:, 1] - tri[:, 0], tri[:, 2] - tri[:, 0]
    p = np.cross(directions[:, None], e2[None])
    det = (e1 * p).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        s = origins[:, None] - tri[None, :, 0]
        u = (s * p).sum(-1) / det
        q = np.cross(s, e1[None])
        v = (directions[:, None] * q).sum(-1) / det
        t = (e2 * q).sum(-1) / det
        inside = (u >= -grow) & (v >= -grow) & (u + v <= 1 + grow)
        return np.where(inside & np.isfinite(t) & (det != 0), t, np.inf)


def height(heights: Heights, x: Array, y: Array) -> Array:
    """The surface at points, NaN outside and where any triangle at the point (within 1e-7) is missing."""
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    known = np.ones(x.shape, bool)
    for dx, dy in ((1, 2), (-1, 2), (1, -2), (-1, -2), (2, 1), (2, -1), (-2, 1), (-2, -1)):
        known &= np.isfinite(_height(heights, x + dx * 1e-7, y + dy * 1e-7))
    # On an edge every triangle that shares it gives the same height.
    return np.where(known, _height(heights, x, y), np.nan)


def _height(heights: Heights, x: Array, y: Array) -> Array:
    rows, cols = heights.shape
    with np.errstate(invalid="ignore"):
        c = np.clip(np.nan_to_num(np.floor(x)), 0, cols - 2).astype(int)
        r = np.clip(np.nan_to_num(np.floor(y)), 0, rows - 2).astype(int)
    u, v = x - c, y - r
    h = heights.astype(np.float64)
    a, b, d, e = h[r, c], h[r, c + 1], h[r + 1, c], h[r + 1, c + 1]
    even = (c + r) % 2 == 0
    main = np.where(u >= v, a + u * (b - a) + v * (e - b), a + v * (d - a) + u * (e - d))
    other = np.where(u + v <= 1, a + u * (b - a) + v * (d - a), e + (1 - u) * (d - e) + (1 - v) * (b - e))
    value = np.where(even, main, other)
    return np.where((x >= 0) & (y >= 0) & (x <= cols - 1) & (y <= rows - 1), value, np.nan)


def check(
    heights: Heights, origins: Array, directions: Array, t: Array, near: float = 0.0, far: float = np.inf
) -> NDArray[np.bool_]:
    """Assert that ``t`` (n,) are the first hits; returns which rays meet the surface without any tie.

    A hit lies on the surface; nothing that is surely hit was passed, and where something is, something was found.
    """
    tri = triangles(heights)
    scale = 1.0 + np.nanmax(np.abs(np.where(np.isfinite(heights), heights, 0)))
    steep = 1.0 + np.abs(directions).max(-1)
    all_t = intersections(tri, origins, directions)
    all_t[(all_t < near - 1e-9) | (all_t > far + 1e-9)] = np.inf
    i, j = np.nonzero(np.isfinite(all_t))
    meet, delta = all_t[i, j], 1e-5 / steep[i]

    def side(at: Array) -> Array:
        p = origins[i] + at[:, None] * directions[i]
        return np.asarray(p[:, 2] - height(heights, p[:, 0], p[:, 1]))

    with np.errstate(invalid="ignore"):
        before, after = side(meet - delta), side(meet + delta)
        crossed = (before * after < 0) & (np.minimum(abs(before), abs(after)) > 1e-9 * scale)
    sure = np.zeros(all_t.shape, bool)
    sure[i, j] = crossed & (meet - delta > near) & (meet + delta < far)
    first = np.where(sure, all_t, np.inf).min(-1)
    any_first = all_t.min(-1)
    for i in range(len(t)):
        note = f"ray {i}: o = {origins[i].tolist()}, d = {directions[i].tolist()}, got {t[i]}, sure {first[i]}"
        tolerance = 1e-6 * (1 + min(first[i], 1e9))
        if np.isnan(t[i]):
            assert not np.isfinite(first[i]), note
            continue
        assert near - 1e-9 <= t[i] <= far + 1e-9, note
        assert t[i] <= first[i] + tolerance, note
        meets = np.abs(all_t[i] - t[i]).min() <= 1e-6 * (1 + abs(t[i]))
        if not meets:  # in the plane of a facet, or along an edge: on the surface nevertheless
            p = origins[i] + t[i] * directions[i]
            around = [
                _height(heights, np.array(p[0] + dx), np.array(p[1] + dy))
                for dx in (-1e-7, 0, 1e-7)
                for dy in (-1e-7, 0, 1e-7)
            ]
            assert (np.abs(np.array(around) - p[2]) <= 1e-5 * scale).any(), note
    return np.asarray(np.isfinite(first) & (any_first > first - 1e-9))
