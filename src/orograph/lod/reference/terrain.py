"""The terrain as the pages read it: the vertices of a small raster, each with what is stored of its diamond.

All algorithms live on a square of 2^n + 1 samples a side. A raster of another size is thought of in the smallest square
that holds it, and the square is *squeezed* onto the raster: a vertex beyond the last row or column lies on it. So no
mesh needs a special case at the border; triangles that lose their area by it are not drawn. Of the diamonds

- a *mixed* one has surface and missing ground under it. Its error is infinite: it is split down to the samples;
- an *empty* one has no surface under it, and is never drawn.

Errors are closed over the diamond DAG (a parent's is no less than a child's) and spheres nested, as Lindstrom &
Pascucci 2001 want them; ``terrain.derived("diamonds")`` has both. Metres; an exaggeration stretches heights and errors
here, once, and nothing else has to know of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from orograph.error import ErrorKind
from orograph.lod.reference.children import Triangle, Vertex, apex, corners, diamond_children, diamonds, is_finest
from orograph.store.terrain import Terrain

Point = tuple[float, float, float]
"""Easting, northing, height in (stretched) metres."""


class Sample(NamedTuple):
    """A vertex of the square, and the diamond that is named by it.

    Attributes:
        place: (x, y), squeezed onto the raster.
        point: where it lies; a missing height is replaced by the lowest in the neighbourhood.
        known: whether the height is not missing.
        error: of the diamond's two coarse triangles, metres; infinite for a mixed diamond, 0 for corners of the square.
        radius: of the nested sphere around the point, metres; infinite for the corners, which are no diamonds.
        empty: whether the diamond has no surface under it.
    """

    place: Vertex
    point: Point
    known: bool
    error: float
    radius: float
    empty: bool


def points_of(terrain: Terrain, exaggeration: float) -> tuple[dict[Vertex, Point], dict[Vertex, bool]]:
    """Where the samples of a raster lie, missing ones as low as the lowest of their tile; and which are not missing."""
    (rows, cols), lowest = terrain.grid.shape, terrain.tiles(0).minimum
    heights = terrain.read(0, 0, rows, 0, cols)
    points, known = {}, {}
    for x, y in np.ndindex(cols, rows):
        z, low = float(heights[y, x]), float(lowest[min(y >> 8, len(lowest) - 1), min(x >> 8, len(lowest[0]) - 1)])
        known[x, y] = not math.isnan(z)
        if not known[x, y]:
            z = terrain.height_range[0] if math.isnan(low) else low
        east, north = terrain.grid.samples @ (x, y)
        points[x, y] = east, north, z * exaggeration
    return points, known


def diamonds_of(terrain: Terrain, error: ErrorKind) -> dict[Vertex, tuple[float, float]]:
    """Error and radius of the diamonds that a terrain stores, those of octave k = the trailing zero bits of x | y."""
    found, highest = {}, terrain.levels - 1
    for level in range(terrain.levels):
        rows, cols = terrain.diamond_shape(level)
        errors, radii = terrain.derived("diamonds", error=error).read(level, 0, rows, 0, cols)
        for i, j in np.ndindex(rows, cols):
            if level == highest or i % 2 or j % 2:
                found[j << level, i << level] = float(errors[i, j]), float(radii[i, j])
    return found


@dataclass(frozen=True)
class Ground:
    """The vertices of a square of 2^n cells a side, by (x, y)."""

    n: int
    samples: dict[Vertex, Sample]

    @classmethod
    def of(cls, terrain: Terrain, error: ErrorKind = "exact", exaggeration: float = 1.0) -> Self:
        """Read a whole terrain, which should be small."""
        rows, cols = terrain.grid.shape
        points, known = points_of(terrain, exaggeration)
        squeezed = {(x, y): (min(x, cols - 1), min(y, rows - 1)) for x, y in np.ndindex(terrain.side, terrain.side)}
        ground = cls(
            terrain.n, {v: Sample(at, points[at], known[at], 0.0, math.inf, False) for v, at in squeezed.items()}
        )
        stored = diamonds_of(terrain, error)
        for i in reversed(list(diamonds(terrain.n))):
            e, r = stored.get(i, (0.0, -1e-30))
            e, radius = e * exaggeration, abs(r) * max(1.0, exaggeration)
            if r < 0:  # empty, perhaps beyond the raster, where nothing is stored that would hold the children's
                children = [ground[j] for j in diamond_children(i, terrain.n)]
                e = max([e, *(c.error for c in children)])
                radius = max([radius, *(math.dist(ground[i].point, c.point) + c.radius for c in children)])
            ground.samples[i] = ground[i]._replace(error=e, radius=radius, empty=r < 0)
        return ground

    def __getitem__(self, vertex: Vertex) -> Sample:
        return self.samples[vertex]

    def places(self, t: Triangle) -> tuple[Vertex, Vertex, Vertex]:
        """The corners of a triangle on the raster."""
        a, b, c = (self[corner].place for corner in corners(t))
        return a, b, c

    def miss(self, t: Triangle) -> float:
        """|z(v_c) − z_T(v_c)|: how far the vertex that splits a triangle is from the middle of its hypotenuse."""
        _, a, b = (self[corner].point[2] for corner in corners(t))
        return abs(self[t.diamond].point[2] - (a + b) / 2)

    def has_ground(self, t: Triangle) -> bool:
        """Whether a triangle has area on the raster, and surface under it or under its sibling."""
        (ax, ay), (bx, by), (cx, cy) = self.places(t)
        has_area = (bx - ax) * (cy - ay) != (cx - ax) * (by - ay)
        return has_area and (is_finest(t) or not self[t.diamond].empty)

    def is_known(self, t: Triangle) -> bool:
        """Whether no corner of a triangle is missing."""
        return all(self[corner].known for corner in corners(t))


def diamond_of(t: Triangle) -> Vertex:
    """The diamond that a triangle is a top of; of a finest one, that which it is a bottom of."""
    return apex(t) if is_finest(t) else t.diamond
