"""Areas of polygons on the terrain: in plan, of the surface, and the volume between it and a level.

The surface area is exact for the triangulated surface: triangles inside count whole, those on the border are clipped
(``area_kernels``). Tiles are read one by one, each only if the polygon meets it. True metres: on a triangle at height h
with gradient g (per grid metre) a grid metre² is f² sqrt(|G| (1 + gᵀ G⁻¹ g / f²)) metres² of ground, f = 1 + h / R and
G the projection's metric (``places``), taken every ``LATTICE`` metres and bilinear between (an error below 1e-7). The
plan area is that of the polygon on the ellipsoid (Karney 2013, its edges followed every ``KNOT`` metres, as they are
straight on the grid, not geodesics). A surface is the plan area times the ratio of two sums, over the ground and over
the same triangles at height 0, so that level ground at height 0 has exactly its plan area and no ground above has less.
Rings close by themselves; a polygon with holes is its border, then the holes.

Units: metres², metres³, metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.measuring.geojson import Geometry, is_geometry, read_geojson
from orograph.measuring.places import Places
from orograph.parallel import map_ordered
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.opening import takes_terrain
from orograph.store.terrain import TILE, Terrain

Array = NDArray[np.float64]

KNOT = 250.0
"""Metres between points of an edge on the ellipsoid."""
MOST_KNOTS = 4096
"""Maximum points of one edge."""
LATTICE = 2000.0
"""Metres between the points of a tile where the projection's metric is evaluated."""


@dataclass(frozen=True, slots=True)
class Area:
    """The measures of a polygon.

    Attributes:
        plan: of the polygon on the ellipsoid; plan_grid: on the grid, metres² (without a CRS the same).
        surface: of the ground in it, true; surface_grid: as if grid metres were true. Holes are not in them.
        missing_grid: of the holes in the data, in plan on the grid.
        perimeter: of all rings on the ellipsoid, metres; perimeter_grid.
        mean_height: of the ground in plan, metres; None if there is none.
        level: metres; above, below: metres³ of ground above the level and of space below it, true in plan; None without
            a level.
    """

    plan: float
    plan_grid: float
    surface: float
    surface_grid: float
    missing_grid: float
    perimeter: float
    perimeter_grid: float
    mean_height: float | None
    level: float | None = None
    above: float | None = None
    below: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        units = {"mean_height": "_m", "level": "_m", "perimeter": "_m", "perimeter_grid": "_m", "above": "_m3",
                 "below": "_m3"}  # fmt: skip
        return {name + units.get(name, "_m2"): value for name, value in asdict(self).items()}


@takes_terrain
def area(
    terrain: Terrain,
    polygon: ArrayLike | Sequence[ArrayLike] | Geometry,
    *,
    level: float | None = None,
    lonlat: bool = False,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
) -> Area:
    """Areas of a polygon, and volumes.

    Args:
        polygon: (n, 2) easting, northing of its corners in either sense, or a sequence of such rings: the first is the
            border, the others are cut out of it; or GeoJSON with one polygon: a file, a mapping, or an object with
            ``__geo_interface__`` (``areas`` measures several).
        level: also find how much ground lies above this height and how much space below it, metres.
        lonlat: the corners are longitude and latitude, degrees.
        jobs: threads.

    Raises:
        UsageError: a corner is not on the terrain, the polygon has no area, or its edges cross each other.
        ReadError: the GeoJSON cannot be read, or does not hold one polygon.
        DamagedChunkError: a chunk of a store fails its checksum.
    """
    if level is not None and not math.isfinite(level):
        raise UsageError(f"The level must be a height in metres, not {level!r}.")
    places = Places(terrain)
    if is_geometry(polygon):
        polygon, lonlat = read_geojson(polygon, "Polygon", places), False
    rings = [_ring(places, ring, lonlat) for ring in split(polygon)]
    samples = [places.samples(ring) for ring in rings]
    _check_crossings(samples)
    signed = [_shoelace(ring) for ring in samples]
    # The border is positive in sample coordinates, and holes are negative.
    turned = [ring if (a > 0) == (k == 0) else ring[::-1] for k, (ring, a) in enumerate(zip(samples, signed))]
    cells = abs(signed[0]) - sum(abs(a) for a in signed[1:])
    cell = terrain.grid.cell_area
    sums = _sum(places, turned, math.nan if level is None else level, jobs, reporting(progress))
    ground, missing, surface, flat, surface_grid, heights, above, below = (float(v) for v in sums)
    plan_grid = cells * cell
    plan, perimeter = _on_ellipsoid(places, rings)
    perimeter_grid = sum(float(np.hypot(*(np.roll(r, -1, axis=0) - r).T).sum()) for r in rings)
    if plan is None:
        plan, perimeter = plan_grid, perimeter_grid
    true = cell * plan / plan_grid
    return Area(
        plan, plan_grid, plan * (surface / flat), plan_grid * (surface_grid / (ground + missing)), missing * cell,
        perimeter, perimeter_grid,
        heights / ground if ground > 0 else None, level, None if level is None else above * true,
        None if level is None else below * true,
    )  # fmt: skip


def split(polygon: Any) -> list[Any]:
    """The rings of a polygon: one (n, 2), or several."""
    try:
        if np.ndim(polygon) == 2:
            return [polygon]
    except ValueError:
        pass  # rings of different lengths
    return list(polygon)


def _ring(places: Places, ring: ArrayLike, lonlat: bool) -> Array:
    points = places.points(ring, what="A polygon", lonlat=lonlat)
    if len(points) > 1 and (points[0] == points[-1]).all():
        points = points[:-1]
    points = points[(points != np.roll(points, 1, axis=0)).any(axis=1)]
    if len(points) < 3:
        raise UsageError(f"A polygon needs at least three corners, not {len(points)}.")
    return np.asarray(points)


def _shoelace(ring: Array) -> float:
    x, y = (ring - ring[0]).T
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def _check_crossings(rings: list[Array]) -> None:
    """Raise UsageError if a ring has no area, or edges cross."""
    p = np.concatenate(rings)
    q = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])

    def turn(a: Array, b: Array, c: Array) -> Array:
        return np.asarray(np.sign((b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1])
                                  - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])))  # fmt: skip

    for k in range(len(p) - 1):  # row by row: memory does not grow with the square of the corners
        a, b, c, d = p[k], q[k], p[k + 1 :], q[k + 1 :]
        crossing = (turn(a, b, c) * turn(a, b, d) < 0) & (turn(c, d, a) * turn(c, d, b) < 0)
        if crossing.any():
            raise UsageError(
                f"The polygon's edges cross: edge {k + 1} and edge {k + 2 + int(np.argmax(crossing))}.",
                remedy="Give its corners in order along the border.",
            )
    # (After the crossings: a bow tie has no area either.)
    for ring in rings:
        if abs(_shoelace(ring)) < 1e-9:
            raise UsageError("The polygon has no area: its corners lie on a line.")
    border = rings[0]
    for k, ring in enumerate(rings[1:], 2):
        if not _inside(border, ring.mean(axis=0)) and not _inside(border, ring[0]):
            raise UsageError(f"Ring {k} is not inside the first one, from which it should be cut out.")


def _inside(ring: Array, point: Array) -> bool:
    a, b = ring, np.roll(ring, -1, axis=0)
    spans = (a[:, 1] <= point[1]) != (b[:, 1] <= point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool((spans & (x > point[0])).sum() % 2)


def _on_ellipsoid(places: Places, rings: list[Array]) -> tuple[float | None, float]:
    """Area and perimeter of rings on the ellipsoid; (None, 0) without a CRS."""
    geod = places.geod
    if geod is None:
        return None, 0.0
    total = perimeter = 0.0
    for k, ring in enumerate(rings):
        dense = []
        for a, b in zip(ring, np.roll(ring, -1, axis=0)):
            n = min(max(1, math.ceil(math.hypot(*(b - a)) / KNOT)), MOST_KNOTS)
            dense.append(a + np.arange(n)[:, None] / n * (b - a))
        size, length = geod.polygon_area_perimeter(*places.geodetic(np.concatenate(dense)).T)
        total += abs(size) if k == 0 else -abs(size)
        perimeter += length
    return total, perimeter


def _sum(places: Places, rings: list[Array], level: float, jobs: int | None, progress: Progress) -> Array:
    """The kernel's sums over all tiles that the polygon meets."""
    from orograph.measuring.area_kernels import ROOM, SUMS, clip_ring, measure

    terrain = places.terrain
    rows, cols = terrain.grid.shape
    low, high = rings[0].min(axis=0), rings[0].max(axis=0)
    inverse = np.linalg.inv(places.linear)

    def tile(at: tuple[int, int]) -> Array:
        sums = np.zeros(SUMS)
        r0, c0 = at
        r1, c1 = min(r0 + TILE, rows - 1), min(c0 + TILE, cols - 1)
        parts = []
        for ring in rings:
            one, two = np.empty((2, ROOM * len(ring), 2))
            n = clip_ring(np.ascontiguousarray(ring), c0, r0, c1, r1, one, two)
            if n > 2:
                parts.append(two[:n])
        if not parts:
            return sums
        counts = np.array([len(part) for part in parts])
        padded = np.zeros((len(parts), int(counts.max()), 2))
        for k, part in enumerate(parts):
            padded[k, : len(part)] = part
        down, across = (
            np.linspace(a, b, max(2, math.ceil((b - a) * step / LATTICE) + 1))
            for a, b, step in ((r0, r1, places.grid.spacing[1]), (c0, c1, places.grid.spacing[0]))
        )
        x, y = places.grid.xy(*np.meshgrid(across, down))
        g = places.metric(np.stack([x.ravel(), y.ravel()], axis=-1))
        metrics = np.stack([g[:, 0, 0], g[:, 0, 1], g[:, 1, 1]], axis=-1).reshape(*x.shape, 3)
        part = np.ascontiguousarray(terrain.read(0, r0, r1 + 1, c0, c1 + 1))
        measure(part, r0, c0, padded, counts, level, metrics, places.radius, inverse, sums)
        return sums

    spans = [range(int(low[k]) // TILE * TILE, max(math.ceil(high[k]), 1), TILE) for k in (1, 0)]
    tiles = [(r, c) for r in spans[0] for c in spans[1] if r < rows - 1 and c < cols - 1]
    total = np.zeros(SUMS)
    with progress.task("Measuring", total=len(tiles)) as task:
        for sums in map_ordered(tile, tiles, jobs):
            total += sums
            task.advance()
    return total
