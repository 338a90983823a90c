"""Meshes to be judged: hierarchies of right triangles refined at random, Delaunay triangulations, and broken ones."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from affine import Affine
from scipy.spatial import Delaunay

from orograph.geo.grid import Grid
from orograph.store import MemoryTerrain
from orograph.tessellation import Tessellation

Corner = tuple[int, int]
Triangle = tuple[Corner, Corner, Corner]

TRANSFORMS = [
    Affine(10, 0, 5e5, 0, -10, 4e6), Affine(10, 0, 5e5, 0, 15, 4e6), Affine(8, 6, 5e5, 6, -8, 4e6),
    Affine(0, 7, 100, 12, 0, -50), Affine(-9, 0, 0, 0, -11, 0),
]  # fmt: skip


def terrain_of(heights: np.ndarray, transform: Affine = TRANSFORMS[0]) -> MemoryTerrain:
    return MemoryTerrain(heights.astype(np.float32), Grid(heights.shape, transform), "test")


def area(t: Triangle) -> int:
    """Twice the signed area in (column, row)."""
    (a, b), (c, d), (e, f) = t
    return (c - a) * (f - b) - (e - a) * (d - b)


def tessellation(triangles: list[Triangle], terrain: MemoryTerrain) -> Tessellation:
    """A mesh of triangles of (column, row), turned as they should be, at the raster's heights."""
    places = sorted({p for t in triangles for p in t})
    index = {p: i for i, p in enumerate(places)}
    sign = 1 if terrain.grid.transform.determinant > 0 else -1
    turned = [t if area(t) * sign > 0 else (t[0], t[2], t[1]) for t in triangles]
    vertices = np.array([(c, r, terrain.heights[r, c]) for c, r in places], np.float64).reshape(-1, 3)
    return Tessellation(vertices, np.array([[index[p] for p in t] for t in turned], np.int32).reshape(-1, 3))


def units(heights: np.ndarray) -> dict[tuple[int, int, int], tuple[Triangle, bool]]:
    """The unit triangles, (column, row, half) → (corners, whether it exists)."""
    found = {}
    rows, cols = heights.shape
    for r in range(rows - 1):
        for c in range(cols - 1):
            a, b, d, e = (c, r), (c + 1, r), (c, r + 1), (c + 1, r + 1)
            halves = ((a, b, e), (a, d, e)) if (c + r) % 2 == 0 else ((a, b, d), (b, d, e))
            for half, t in enumerate(halves):
                found[c, r, half] = t, bool(np.isfinite([heights[q, p] for p, q in t]).all())
    return found


def full(heights: np.ndarray) -> list[Triangle]:
    return [t for t, exists in units(heights).values() if exists]


def right_triangles(heights: np.ndarray, rng: np.random.Generator, some: float) -> list[Triangle]:
    """A conforming refinement of the square around the raster, squeezed onto it, keeping holes to the sample."""
    rows, cols = heights.shape
    n = max(max(rows, cols) - 2, 0).bit_length()
    side = 1 << n

    def squeeze(p: Corner) -> Corner:
        return min(p[0], cols - 1), min(p[1], rows - 1)

    ground = units(heights).values()
    known: dict[Triangle, set[bool]] = {}

    def under(t: Triangle) -> set[bool]:
        """What ground there is under the squeezed triangle: existing, missing or both."""
        if t not in known:
            s = squeeze(t[0]), squeeze(t[1]), squeeze(t[2])
            known[t] = {exists for u, exists in ground if share_area(s, u)}
        return known[t]

    active: set[Corner] = {(int(c), int(r)) for c, r in rng.integers(0, side + 1, (int(some * side * side), 2))}

    def visit(t: Triangle, level: int, ancestors: tuple[Corner, ...], out: list[Triangle] | None) -> None:
        apex, a, b = t
        middle = (a[0] + b[0]) // 2, (a[1] + b[1]) // 2
        if level < 2 * n and out is None:
            if middle in active or len(under(t)) == 2:
                active.update((*ancestors, middle))
            visit((middle, apex, a), level + 1, (*ancestors, middle), out)
            visit((middle, apex, b), level + 1, (*ancestors, middle), out)
        elif level < 2 * n and middle in active:
            assert out is not None
            visit((middle, apex, a), level + 1, (), out)
            visit((middle, apex, b), level + 1, (), out)
        elif out is not None:
            out.append(t)

    roots: list[Triangle] = [((side, 0), (0, 0), (side, side)), ((0, side), (0, 0), (side, side))]
    if n == 0:
        return [t for t in roots if area(t)]
    before = -1
    while before != len(active):
        before = len(active)
        for t in roots:
            visit(t, 0, (), None)
    leaves: list[Triangle] = []
    for t in roots:
        visit(t, 0, (), leaves)
    drawn = [t for t in leaves if under(t) == {True}]
    return [(squeeze(a), squeeze(b), squeeze(c)) for a, b, c in drawn]


def share_area(s: Triangle, t: Triangle) -> bool:
    """Whether two triangles share some area: unless one lies beyond a side of the other (or they are lines)."""
    if area(s) == 0 or area(t) == 0:
        return False
    for p, q in ((s, t), (t, s)):
        sign = 1 if area(p) > 0 else -1
        if any(all(sign * area((p[i], p[(i + 1) % 3], v)) <= 0 for v in q) for i in range(3)):
            return False
    return True


def delaunay(heights: np.ndarray, rng: np.random.Generator) -> list[Triangle]:
    """Triangles of every slope, over the whole raster (without missing data)."""
    rows, cols = heights.shape
    corners = {(0, 0), (cols - 1, 0), (0, rows - 1), (cols - 1, rows - 1)}
    places = corners | {(int(rng.integers(cols)), int(rng.integers(rows))) for _ in range(rows * cols // 3)}
    points = np.array(sorted(places))
    made = [tuple(tuple(map(int, points[i])) for i in s) for s in Delaunay(points).simplices]
    return [t for t in made if area(t)]  # type: ignore[arg-type, misc]


def delaunay_between(shape: tuple[int, int], rng: np.random.Generator, fraction: int) -> list[Triangle]:
    """Over the whole raster, with vertices at multiples of 2^-fraction of a cell; some on samples and grid lines."""
    rows, cols = shape
    size = 1 << fraction
    last = (cols - 1) * size, (rows - 1) * size
    points = {(0, 0), (last[0], 0), (0, last[1]), last}
    for _ in range(rows * cols // 3):
        c, r = (int(rng.integers(side + 1)) for side in last)
        on = rng.random(2) < 0.2
        points.add((c // size * size if on[0] else c, r // size * size if on[1] else r))
    ordered = np.array(sorted(points))
    made = [tuple(tuple(map(int, ordered[i])) for i in s) for s in Delaunay(ordered).simplices]
    scaled = [tuple((exact(c / size), exact(r / size)) for c, r in t) for t in made]
    return [t for t in scaled if area(t)]  # type: ignore[arg-type, misc]


def exact(value: float) -> Any:
    """A float as an int or a fraction."""
    return int(value) if float(value).is_integer() else Fraction(float(value))


def tessellation_between(triangles: list[Triangle], terrain: MemoryTerrain, rng: np.random.Generator) -> Tessellation:
    """As ``tessellation``; vertices between samples get any height."""
    whole = {p for t in triangles for p in t if all(isinstance(v, int) for v in p)}
    places = sorted({p for t in triangles for p in t})
    index = {p: i for i, p in enumerate(places)}
    sign = 1 if terrain.grid.transform.determinant > 0 else -1
    turned = [t if area(t) * sign > 0 else (t[0], t[2], t[1]) for t in triangles]
    z = [float(terrain.heights[p[1], p[0]]) if p in whole else rng.normal(0, 10) for p in places]
    vertices = np.array([(float(c), float(r), h) for (c, r), h in zip(places, z)]).reshape(-1, 3)
    return Tessellation(vertices, np.array([[index[p] for p in t] for t in turned], np.int32).reshape(-1, 3))


Break = Callable[[list[Triangle], np.random.Generator, Corner], list[Triangle]]


def remove(mesh: list[Triangle], rng: np.random.Generator, last: Corner) -> list[Triangle]:
    k = int(rng.integers(len(mesh)))
    return mesh[:k] + mesh[k + 1 :]


def repeat(mesh: list[Triangle], rng: np.random.Generator, last: Corner) -> list[Triangle]:
    return [*mesh, mesh[int(rng.integers(len(mesh)))]]


def stray(mesh: list[Triangle], rng: np.random.Generator, last: Corner) -> list[Triangle]:
    """Any triangle more."""
    while True:
        p = [(int(rng.integers(last[0] + 1)), int(rng.integers(last[1] + 1))) for _ in range(3)]
        if area((p[0], p[1], p[2])):
            return [*mesh, (p[0], p[1], p[2])]


def split_one_side(mesh: list[Triangle], rng: np.random.Generator, last: Corner) -> list[Triangle]:
    """Split one triangle at the middle of an edge, its neighbour not: a T-junction."""
    found = [(k, i) for k, t in enumerate(mesh) for i in range(3)
             if all((t[i][j] + t[(i + 1) % 3][j]) % 2 == 0 for j in range(2))]  # fmt: skip
    if not found:
        return mesh
    k, i = found[int(rng.integers(len(found)))]
    a, b, c = (mesh[k][(i + j) % 3] for j in range(3))
    m = (a[0] + b[0]) // 2, (a[1] + b[1]) // 2
    return [*mesh[:k], (a, m, c), (m, b, c), *mesh[k + 1 :]]


def flatten(mesh: list[Triangle], rng: np.random.Generator, last: Corner) -> list[Triangle]:
    """A triangle more, without area, along an edge of the mesh or from corner to corner of the raster."""
    a, b, _ = mesh[int(rng.integers(len(mesh)))]
    return [*mesh, (a, b, b) if rng.random() < 0.5 else ((0, 0), last, (0, 0))]


BREAKS: list[Break] = [remove, repeat, stray, split_one_side, flatten]
