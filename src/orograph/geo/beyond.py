"""How far a place lies outside a grid, in words: "412 km beyond the terrain's northern border"."""

from __future__ import annotations

import math
from dataclasses import dataclass

from orograph.geo.grid import Grid
from orograph.geo.transform import transformer

SIDES = ("northern", "eastern", "southern", "western")
CORNERS = ("north-eastern", "south-eastern", "south-western", "north-western")


@dataclass(frozen=True, slots=True)
class Beyond:
    """A place outside a grid. ``metres``: to its nearest sample; ``border``: which that is of, in words."""

    metres: float
    border: str

    def __str__(self) -> str:
        far = f"{self.metres:,.0f} m" if self.metres < 10_000 else f"{self.metres / 1000:,.0f} km"
        return f"{far} beyond the terrain's {self.border}"


def beyond(grid: Grid, x: float, y: float) -> Beyond | None:
    """How far a place in the grid's CRS (metres) lies outside; None for one that lies within its samples.

    The distance is the geodesic's, where the CRS knows its place on an ellipsoid: a projection far from its middle is
    not true to scale.
    """
    col, row = (float(v) for v in grid.index(x, y))
    near = min(max(col, 0.0), grid.cols - 1.0), min(max(row, 0.0), grid.rows - 1.0)
    if near == (col, row):
        return None
    u, v = (float(n) for n in grid.xy(*near))
    middle = [float(n) for n in grid.xy((grid.cols - 1) / 2, (grid.rows - 1) / 2)]
    if col != near[0] and row != near[1]:
        azimuth = math.degrees(math.atan2(u - middle[0], v - middle[1])) % 360.0
        border = f"{CORNERS[int(azimuth // 90)]} corner"
    else:
        azimuth = math.degrees(math.atan2(x - u, y - v)) % 360.0
        border = f"{SIDES[round(azimuth / 90) % 4]} border"
    return Beyond(_metres(grid, (u, v), (x, y)), border)


def _metres(grid: Grid, a: tuple[float, float], b: tuple[float, float]) -> float:
    """From a place to another, both in the grid's CRS."""
    plain = math.dist(a, b)
    geodetic = None if grid.crs is None else grid.crs.geodetic_crs
    geod = None if geodetic is None else geodetic.get_geod()
    if geod is None:
        return plain
    (lon0, lon1), (lat0, lat1) = transformer(grid.crs, geodetic)([a[0], b[0]], [a[1], b[1]])
    if not all(map(math.isfinite, (lon0, lon1, lat0, lat1))):
        return plain
    return float(geod.inv(lon0, lat0, lon1, lat1)[2])
