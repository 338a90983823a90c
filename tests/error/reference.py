"""Errors, spheres and states of diamonds straight from their definitions, in plain Python and NumPy, for small rasters.

A diamond is named by its vertex (row, col) in the square of 2^n + 1 samples. Vertices beyond the raster are squeezed
onto its border and have the height there.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from orograph.error.diamonds import Surface, diamonds, halve

Vertex = tuple[int, int]


class Reference:
    """All diamonds of a raster.

    Args:
        heights: (rows, cols), NaN where missing.
        spacing: metres between samples.
    """

    def __init__(self, heights: np.ndarray, spacing: float = 1.0) -> None:
        self.z, self.spacing = heights.astype(np.float64), spacing
        self.rows, self.cols = heights.shape
        self.n = max(max(heights.shape) - 2, 0).bit_length()
        self.side = 1 << self.n

    def squeezed(self, v: Vertex) -> Vertex:
        return min(v[0], self.rows - 1), min(v[1], self.cols - 1)

    def height(self, v: Vertex) -> float:
        return float(self.z[self.squeezed(v)])

    def inside(self, v: Vertex) -> bool:
        return 0 <= v[0] <= self.side and 0 <= v[1] <= self.side

    @staticmethod
    def octave(v: Vertex) -> int:
        bits = v[0] | v[1]
        return (bits & -bits).bit_length() - 1

    def is_square(self, v: Vertex) -> bool:
        k = self.octave(v)
        return bool((v[0] >> k) & (v[1] >> k) & 1)

    def reaches_in(self, v: Vertex) -> bool:
        """Whether the diamond's box has samples of the raster on both sides of its first row and column."""
        s = 1 << self.octave(v)
        return (v[0] - s < self.rows - 1 or v[0] == 0) and (v[1] - s < self.cols - 1 or v[1] == 0)

    @cached_property
    def diamonds(self) -> list[Vertex]:
        """From the finest to the coarsest: children come before their parents."""
        every = [(r, c) for r in range(self.side + 1) for c in range(self.side + 1) if r % self.side or c % self.side]
        return sorted((v for v in every if self.reaches_in(v)), key=lambda v: 2 * self.octave(v) + self.is_square(v))

    def corners(self, v: Vertex) -> tuple[Vertex, Vertex, Vertex, Vertex]:
        """The ends of the hypotenuse and the two apexes (one may lie outside the square)."""
        (r, c), s = v, 1 << self.octave(v)
        if self.is_square(v):
            nw, ne, sw, se = (r - s, c - s), (r - s, c + s), (r + s, c - s), (r + s, c + s)
            falling = ((r - s) // (2 * s) + (c - s) // (2 * s)) % 2 == 0
            return (nw, se, ne, sw) if falling else (ne, sw, nw, se)
        if (c // s) % 2:
            return (r, c - s), (r, c + s), (r - s, c), (r + s, c)
        return (r - s, c), (r + s, c), (r, c - s), (r, c + s)

    def triangles(self, v: Vertex) -> list[tuple[Vertex, Vertex, Vertex]]:
        a, b, p, q = self.corners(v)
        return [(a, b, apex) for apex in (p, q) if self.inside(apex)]

    def children(self, v: Vertex) -> list[Vertex]:
        (r, c), s = v, 1 << self.octave(v)
        if self.is_square(v):
            found = [(r - s, c), (r + s, c), (r, c - s), (r, c + s)]
        elif s > 1:
            found = [(r + a * s // 2, c + b * s // 2) for a in (-1, 1) for b in (-1, 1)]
        else:
            found = []
        return [u for u in found if self.inside(u) and self.reaches_in(u)]

    # ---- errors ------------------------------------------------------------------------------------------------------

    def plane(self, triangle: tuple[Vertex, Vertex, Vertex], at: tuple[float, float]) -> float | None:
        """Height of a (squeezed) triangle there; None if it has no area or the point lies outside."""
        corners = [self.squeezed(v) for v in triangle]
        matrix = np.array([[c, r, 1.0] for r, c in corners])
        if abs(np.linalg.det(matrix)) < 0.5:
            return None
        weights = np.linalg.solve(matrix.T, np.array([at[1], at[0], 1.0]))
        return None if weights.min() < -1e-9 else float(weights @ [self.height(v) for v in triangle])

    def deviation(self, v: Vertex) -> float:
        """The largest distance of the surface from the diamond's two triangles: at samples, and where sides cross."""
        worst = 0.0
        for triangle in self.triangles(v):
            rows, cols = zip(*(self.squeezed(corner) for corner in triangle), strict=True)
            for r in range(min(rows), max(rows) + 1):
                for c in range(min(cols), max(cols) + 1):
                    on = self.plane(triangle, (r, c))
                    if on is not None and not np.isnan(on - self.z[r, c]):
                        worst = max(worst, abs(on - self.z[r, c]))
            for at, height in self.crossings(triangle):
                on = self.plane(triangle, at)
                if on is not None and not np.isnan(on - height):
                    worst = max(worst, abs(on - height))
        return worst

    def crossings(self, triangle: tuple[Vertex, Vertex, Vertex]) -> Iterator[tuple[tuple[float, float], float]]:
        """Where sides of a triangle cross sides of unit triangles: (row, column) and the surface's height there."""
        corners = [self.squeezed(v) for v in triangle]
        for p, q in zip(corners, corners[1:] + corners[:1], strict=True):
            if p[0] == q[0] or p[1] == q[1]:
                continue
            for a, b in self.unit_sides:
                if max(a[0], b[0]) < min(p[0], q[0]) or min(a[0], b[0]) > max(p[0], q[0]):
                    continue
                matrix = np.array([[q[0] - p[0], a[0] - b[0]], [q[1] - p[1], a[1] - b[1]]], float)
                if abs(np.linalg.det(matrix)) < 0.5:
                    continue  # parallel
                s, t = np.linalg.solve(matrix, [a[0] - p[0], a[1] - p[1]])
                if min(s, t) >= -1e-9 and max(s, t) <= 1 + 1e-9:
                    at = p[0] + s * (q[0] - p[0]), p[1] + s * (q[1] - p[1])
                    yield at, float((1 - t) * self.z[a] + t * self.z[b])

    @cached_property
    def unit_sides(self) -> list[tuple[Vertex, Vertex]]:
        """The sides of all unit triangles."""
        found = []
        for r, c in np.ndindex(self.rows, self.cols):
            falling = (r + c) % 2 == 0
            found += [((r, c), (r, c + 1)), ((r, c), (r + 1, c))]
            found.append(((r, c), (r + 1, c + 1)) if falling else ((r, c + 1), (r + 1, c)))
        return [(a, b) for a, b in found if max(a[0], b[0]) < self.rows and max(a[1], b[1]) < self.cols]

    def local(self, v: Vertex) -> float:
        """The distance of the vertex from the middle of the hypotenuse (not squeezed)."""
        a, b, _, _ = self.corners(v)
        d = abs(self.height(v) - (self.height(a) + self.height(b)) / 2)
        return 0.0 if np.isnan(d) else d

    def closed(self, error: dict[Vertex, float]) -> dict[Vertex, float]:
        """Each no less than its children's."""
        result: dict[Vertex, float] = {}
        for v in self.diamonds:
            result[v] = max([error[v], *(result[u] for u in self.children(v))])
        return result

    # ---- holes -------------------------------------------------------------------------------------------------------

    @cached_property
    def units(self) -> tuple[np.ndarray, np.ndarray]:
        """Centroids of all unit triangles (times 3, integers) and whether each exists."""
        centres, there = [], []
        for r in range(self.rows - 1):
            for c in range(self.cols - 1):
                a, b = ((r, c), (r + 1, c + 1)) if (r + c) % 2 == 0 else ((r, c + 1), (r + 1, c))
                for apex in {(r, c), (r + 1, c), (r, c + 1), (r + 1, c + 1)} - {a, b}:
                    corners = (a, b, apex)
                    centres.append([sum(v[0] for v in corners), sum(v[1] for v in corners)])
                    there.append(not any(np.isnan(self.z[v]) for v in corners))
        return np.array(centres).reshape(-1, 2), np.array(there, bool)

    def state(self, v: Vertex) -> str:
        """ "whole", "mixed" or "empty", by the unit triangles in the diamond's region of the unsqueezed square."""
        (r, c), s = v, 1 << self.octave(v)
        centres, there = self.units
        y, x = np.abs(centres[:, 0] - 3 * r), np.abs(centres[:, 1] - 3 * c)
        under = (np.maximum(y, x) < 3 * s) if self.is_square(v) else (y + x < 3 * s)
        exists = there[under]
        if not exists.any():
            return "empty"
        return "whole" if exists.all() else "mixed"

    def straddles(self, v: Vertex) -> bool:
        """Whether the border squeezes it."""
        s = 1 << self.octave(v)
        return v[0] + s > self.rows - 1 or v[1] + s > self.cols - 1


def surface(z: np.ndarray, spacing: float = 1.0) -> Surface:
    """The terrain around a raster of at most 257 samples: one tile."""
    lowest = np.nanmin(z) if not np.isnan(z).all() else np.nan
    metric = np.array([[spacing, 0.0], [0.0, -spacing]])
    tiles = tuple(max(1, -(-(side - 1) // 256)) for side in z.shape)
    return Surface(z.shape, metric, np.full(tiles, lowest, np.float32), 0.0 if np.isnan(lowest) else float(lowest))


def nested(z: np.ndarray) -> np.ndarray:
    """Every 16th sample."""
    for _ in range(4):
        z = halve(z)
    return z


def found(z: np.ndarray, kinds=("exact",), spacing: float = 1.0, **options) -> dict[str, dict[Vertex, float]]:
    """What ``diamonds`` finds: for each kind, and for "radius", the values by vertex."""
    z = np.ascontiguousarray(z, np.float32)
    values: dict[str, dict[Vertex, float]] = {name: {} for name in (*kinds, "radius")}
    options = {"block": 64, "jobs": 1, **options}
    for part in diamonds(lambda a, b, c, d: z[a:b, c:d], nested(z), surface(z, spacing), kinds, **options):
        rows, cols = part.errors[kinds[0]].shape
        for i in range(rows):
            for j in range(cols):
                if (part.i + i | part.j + j) & 1:
                    v = (part.i + i) << part.octave, (part.j + j) << part.octave
                    for kind in kinds:
                        values[kind][v] = float(part.errors[kind][i, j])
                    if part.radii is not None:
                        values["radius"][v] = float(part.radii[i, j])
    return values
