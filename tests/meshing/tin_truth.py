"""What TINs are tested against: exact, slow, and without any of their code."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from affine import Affine

from orograph import verify
from orograph.geo.grid import Grid
from orograph.store.memory import MemoryTerrain
from orograph.tessellation import Tessellation

Point = tuple[int, int]


def terrain_of(heights: np.ndarray, transform: Affine = Affine(10, 0, 0, 0, -10, 0)) -> MemoryTerrain:  # noqa: B008
    return MemoryTerrain(heights, Grid(heights.shape, transform, None), "test")


def referee(mesh: Tessellation, terrain: MemoryTerrain) -> tuple[verify.Report, float, float]:
    """The verdict, and the largest deviations on the surface and at samples, metres."""
    report = verify.judge_mesh(mesh, terrain, verify.level_view(terrain))
    return report, report.largest, report.largest_at_samples


def turn(a: Point, b: Point, c: Point) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def in_circle(a: Point, b: Point, c: Point, d: Point) -> int:
    """Positive if d is inside the circle of a, b, c, which turn positively."""
    (p, q), (r, s), (t, u) = ((v[0] - d[0], v[1] - d[1]) for v in (a, b, c))
    pp, rr, tt = p * p + q * q, r * r + s * s, t * t + u * u
    return p * (s * tt - rr * u) - q * (r * tt - rr * t) + pp * (r * u - s * t)


def ground(heights: np.ndarray, x: Fraction, y: Fraction) -> Fraction:
    """The surface at a point, by its definition."""
    rows, cols = heights.shape
    i, j = min(int(x), cols - 2), min(int(y), rows - 2)
    u, v = x - i, y - j
    nw, ne, sw, se = (Fraction(float(heights[q, p])) for q in (j, j + 1) for p in (i, i + 1))
    if (i + j) % 2 == 0:
        return nw + u * (ne - nw) + v * (se - ne) if v <= u else nw + v * (sw - nw) + u * (se - sw)
    return nw + u * (ne - nw) + v * (sw - nw) if u + v <= 1 else se + (1 - u) * (sw - se) + (1 - v) * (ne - se)


def plane(heights: np.ndarray, t: tuple[Point, Point, Point], x: Any, y: Any) -> Fraction:
    a, b, c = t
    za, zb, zc = (Fraction(float(heights[p[1], p[0]])) for p in t)
    det = turn(a, b, c)
    u = Fraction((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / det
    v = Fraction((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / det
    return za + u * (zb - za) + v * (zc - za)


def worst_at_samples(heights: np.ndarray, t: tuple[Point, Point, Point]) -> tuple[float, float]:
    """The largest deviation at samples of a triangle, outline included, and the sum of their squares."""
    sign = 1 if turn(*t) > 0 else -1
    off = [
        abs(plane(heights, t, x, y) - Fraction(float(heights[y, x])))
        for y in range(heights.shape[0])
        for x in range(heights.shape[1])
        if all(sign * turn(t[k], t[(k + 1) % 3], (x, y)) >= 0 for k in range(3))
    ]
    return float(max(off)), float(sum(v * v for v in off))


def worst_on_edge(heights: np.ndarray, a: Point, b: Point) -> float:
    """The largest deviation on an edge: at all its crossings with grid lines and diagonals, and some more points."""
    cuts = {Fraction(k, 97) for k in range(98)}
    for p, q in ((1, 0), (0, 1), (1, 1), (1, -1)):
        start, end = p * a[0] + q * a[1], p * b[0] + q * b[1]
        cuts |= {Fraction(n - start, end - start) for n in range(min(start, end) + 1, max(start, end))}
    za, zb = (Fraction(float(heights[p[1], p[0]])) for p in (a, b))
    return float(
        max(abs(ground(heights, a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])) - za - t * (zb - za)) for t in cuts)
    )


def fewest(line: np.ndarray, limit: float) -> int:
    """The fewest samples of a line, ends included, between which all others are within the limit: all are tried."""
    inner = range(1, len(line) - 1)
    for n in range(len(line) - 1):
        for some in combinations(inner, n):
            kept = [0, *some, len(line) - 1]
            if np.abs(np.interp(np.arange(len(line)), kept, line[kept]) - line).max() <= limit:
                return len(kept)
    return len(line)


def can_be_filled(heights: np.ndarray, ring: list[Point], limit: float, surface: bool) -> bool:
    """Whether a polygon has a triangulation within the limit: all are tried."""

    @cache
    def good(a: Point, b: Point) -> bool:
        return not surface or worst_on_edge(heights, a, b) <= limit

    @cache
    def fits(i: int, j: int) -> bool:
        if j == i + 1:
            return True
        if (i, j) != (0, len(ring) - 1) and not good(ring[i], ring[j]):
            return False
        return any(
            turn(ring[i], ring[k], ring[j]) > 0
            and fits(i, k)
            and fits(k, j)
            and worst_at_samples(heights, (ring[i], ring[k], ring[j]))[0] <= limit
            for k in range(i + 1, j)
        )

    return fits(0, len(ring) - 1)
