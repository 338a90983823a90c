"""What lies under the cursor: a ray cast at the full-resolution surface, and properties of the ground at a place.

The ray is the one with which the picture was drawn (``View.ray_basis``), in true space whatever the exaggeration. It is
followed over the terrain's tiles of 256 × 256 cells; a tile whose lowest and highest full-resolution samples are on one
side of it is skipped without being read, so a pick in a store of any size reads only a few tiles. Within a tile, the
ray uses the caster's own traversal (``raycast.traverse``), and tracks its side of the surface from tile to tile: the
answer is the full-resolution surface's, never a drawn mesh's.

Slope and aspect are those of ``orograph light``: central differences at the samples, linear over the triangle between
them, converted to true metres (``places``). Units: metres, degrees.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.measuring.ground import facets, height_error, own_heights
from orograph.measuring.places import Places, lift
from orograph.output import Beside
from orograph.store.opening import takes_terrain
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]

SLAB = 1e-3
"""Margin of the slab of heights, metres, so that a level plain does not give a slab of zero thickness."""


@dataclass(frozen=True, slots=True)
class Hit:
    """A place on the ground.

    Attributes:
        easting, northing: in the terrain's CRS, metres.
        height: metres, bilinear between the terrain's original samples, as in its files; None where there are none. If
            they are not available after resampling, it is the surface's.
        surface_height: metres, of the surface that is drawn; None in a hole.
        longitude, latitude: degrees, WGS 84 (the body's own if it is not the Earth); None without a CRS.
        column, row: sample coordinates, fractional.
        slope: degrees, in true metres; aspect: the azimuth in which the ground falls, clockwise from grid north;
            true_aspect: from true north. None in a hole, aspects also where it is level.
        depth: view-space depth in metres; distance: from the eye in a straight line, metres. None without a view.
        height_error: maximum error of ``height`` at the samples of the source, metres, if these were resampled and are
            not available; else None.
    """

    easting: float
    northing: float
    height: float | None
    surface_height: float | None
    longitude: float | None
    latitude: float | None
    column: float
    row: float
    slope: float | None
    aspect: float | None
    true_aspect: float | None
    depth: float | None = None
    distance: float | None = None
    height_error: float | None = None

    @property
    def point(self) -> tuple[float, float]:
        """(easting, northing)."""
        return self.easting, self.northing

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@takes_terrain
def pick(
    terrain: Terrain, view: View | ArrayLike, pixel: tuple[float, float] | None = None, exaggeration: float = 1.0, *,
    lonlat: bool = False,
) -> Hit | None:  # fmt: skip
    """The ground at a point, or what a picture shows at a pixel.

    Args:
        view: a point (easting, northing; with ``lonlat`` longitude, latitude in degrees), or a picture's camera.
        pixel: position in the picture: (0.5, 0.5) is the middle of the upper left pixel.
        exaggeration: of the picture; the answer is in true metres.

    Returns:
        the ground at the point; or the first hit of the pixel's ray with the full-resolution surface, None if there is
        none (sky, a hole).

    Raises:
        UsageError: the terrain has no surface, the point is not on it, or the pixel is not two finite numbers.
        DamagedChunkError: a chunk of a store fails its checksum.
    """
    if not isinstance(view, View):
        if pixel is not None:
            raise UsageError("A pixel needs the camera of its picture, not a point.", remedy="Give an orograph.View.")
        return place(terrain, view, lonlat=lonlat)
    if pixel is None:
        raise UsageError("A camera needs a pixel of its picture.", remedy="Give a point instead, or the pixel, too.")
    try:
        px, py = (float(v) for v in pixel)
    except (TypeError, ValueError):
        px = py = math.nan
    if not (math.isfinite(px) and math.isfinite(py)):
        raise UsageError(f"A pixel must be two finite numbers, not {pixel!r}.")
    if not (exaggeration > 0 and math.isfinite(exaggeration)):
        raise UsageError(f"The exaggeration must be a positive number, not {exaggeration!r}.")
    places = Places(terrain)
    o0, ou, ov, d0, du, dv = view.ray_basis(exaggeration)
    origin, direction = o0 + px * ou + py * ov, d0 + px * du + py * dv
    depth = cast(terrain, origin, direction, view.near, view.far)
    if depth is None:
        return None
    meets = origin + depth * direction
    return _at(places, meets[:2], float(meets[2]), depth, float(np.linalg.norm(meets - np.array(view.eye))))


@takes_terrain
def heights(terrain: Terrain, points: ArrayLike, *, lonlat: bool = False) -> Array:
    """Heights (n,) at points, metres: bilinear between the samples of the files, as ``Hit.height``; NaN where missing.

    Args:
        points: (n, 2) easting, northing. lonlat: they are longitude, latitude in degrees.

    Raises:
        UsageError: a point is not on the terrain. DamagedChunkError: as ``pick``.
    """
    places = Places(terrain)
    return own_heights(places.terrain, places.points(points, lonlat=lonlat))


@takes_terrain
def place(terrain: Terrain, point: ArrayLike, *, lonlat: bool = False) -> Hit:
    """The ground at a point (easting, northing; with ``lonlat`` longitude, latitude in degrees).

    Raises:
        UsageError: the point is not on the terrain. DamagedChunkError: as ``pick``.
    """
    places = Places(terrain)
    points = places.points(point, lonlat=lonlat)
    if len(points) != 1:
        raise UsageError(
            f"This takes one point, not {len(points)}.",
            remedy="For heights of many points use `orograph.measure.heights`.",
        )
    return _at(places, points[0])


def save_hits(hits: Sequence[Hit], path: str | os.PathLike[str]) -> None:
    """Write places with all their properties: a table (.csv, unknown values empty) or points (.geojson).

    Raises:
        UsageError: a .geojson of places without longitude and latitude. OutputError: the file cannot be written.
    """
    digits = {"longitude": 9, "latitude": 9}
    rows = [
        {k: v if v is None else round(v, digits.get(k, 4)) for k, v in hit.to_dict().items()} for hit in hits
    ]  # fmt: skip
    with Beside(Path(path)) as part, part.open("w", newline="", encoding="utf-8") as file:
        if Path(path).suffix.lower() == ".csv":
            writer = csv.DictWriter(file, [one.name for one in fields(Hit)])
            writer.writeheader()
            writer.writerows(rows)
            return
        if any(row["longitude"] is None for row in rows):
            raise UsageError("GeoJSON needs longitudes and latitudes, but the terrain has no CRS.", path=path)
        features = [
            {"type": "Feature", "properties": row,
             "geometry": {"type": "Point", "coordinates": [row["longitude"], row["latitude"]]}}
            for row in rows
        ]  # fmt: skip
        json.dump({"type": "FeatureCollection", "features": features}, file, allow_nan=False)


def _at(
    places: Places,
    point: Array,
    surface: float | None = None,
    depth: float | None = None,
    distance: float | None = None,
) -> Hit:
    """Properties of the ground at a point (2,); the surface is looked up unless a ray has found it."""
    rows, cols = places.grid.shape
    x, y = np.clip(np.stack(places.grid.index(*point)), 0.0, [cols - 1.0, rows - 1.0])
    if surface is None:
        surface = _known(facets(places.terrain, x[None], y[None]).heights(x[None], y[None]))
    slope, aspect, true_aspect = (None, None, None) if surface is None else _inclination(places, x, y, point, surface)
    height = _known(own_heights(places.terrain, point[None]))
    degrees = places.lonlat(point[None])
    lon, lat = (None, None) if degrees is None else (float(v) for v in degrees[0])
    return Hit(
        float(point[0]), float(point[1]), height, surface, lon, lat, float(x), float(y), slope, aspect, true_aspect,
        depth, distance, height_error(places.terrain),
    )  # fmt: skip


def _known(heights: Array) -> float | None:
    """The one height (1,) as a number, or None."""
    return None if math.isnan(heights[0]) else float(heights[0])


@takes_terrain
def slope_aspect(terrain: Terrain, point: ArrayLike, *, lonlat: bool = False) -> tuple[float, float]:
    """Slope and aspect at a point (as for ``place``), degrees; NaN in a hole, the aspect also where it is level.

    Raises:
        UsageError: the point is not on the terrain.
    """
    hit = place(terrain, point, lonlat=lonlat)
    return (math.nan if hit.slope is None else hit.slope, math.nan if hit.aspect is None else hit.aspect)


def _inclination(
    places: Places, x: float, y: float, point: Array, height: float
) -> tuple[float | None, float | None, float | None]:
    """(slope, aspect from grid north, aspect from true north) at a place that is not in a hole."""
    from orograph.lighting.normal import gradient

    rows, cols = places.grid.shape
    under = facets(places.terrain, np.array([x]), np.array([y]))
    c, r = int(under.col[0]), int(under.row[0])
    r0, c0 = max(r - 1, 0), max(c - 1, 0)
    part = places.terrain.read(0, r0, min(r + 3, rows), c0, min(c + 3, cols))
    corner = np.s_[:, r - r0 : r - r0 + 2, c - c0 : c - c0 + 2]
    east, north = np.stack(gradient(part, places.linear, 1)).astype(np.float64)[corner].reshape(2, 4)
    u, v = x - c, y - r
    if (c + r) % 2 == 0:
        weights = (1 - u, u - v, 0.0, v) if u >= v else (1 - v, 0.0, v - u, u)
    else:
        weights = (1 - u - v, u, v, 0.0) if u + v <= 1 else (0.0, 1 - v, 1 - u, u + v - 1)
    known = [k for k, w in enumerate(weights) if w > 1e-6]  # a missing sample has weight 0, up to rounding
    slopes = np.array([sum(weights[k] * float(g[k]) for k in known) for g in (east, north)])
    if not np.isfinite(slopes).all():
        return None, None, None
    # Heights rise by g_grid · d for a grid step d, which is J d true metres: g_true = J⁻ᵀ g_grid.
    true = np.linalg.solve(places.jacobian(point).T, slopes) / float(lift(places, np.array(height)))
    steep = math.degrees(math.atan(math.hypot(*true)))
    if slopes[0] == 0.0 and slopes[1] == 0.0:
        return steep, None, None
    return steep, _falls(slopes), _falls(true)


def _falls(slopes: Array) -> float:
    """The azimuth in [0, 360) in which ground with these slopes towards east and north falls."""
    azimuth = math.degrees(math.atan2(-slopes[0], -slopes[1])) % 360.0
    return 0.0 if azimuth >= 360.0 else azimuth


def cast(terrain: Terrain, origin: Array, direction: Array, near: float = 0.0, far: float = math.inf) -> float | None:
    """The first hit of a ray with the full-resolution surface.

    Args:
        origin, direction: (3,) easting, northing, height.
        near, far: the range of t, in lengths of ``direction``, that counts.

    Returns:
        t of the hit; None if there is none.
    """
    from orograph.raycast.stack import HeightWindow, Stack
    from orograph.raycast.traverse import cast as walk

    rows, cols = terrain.grid.shape
    o, v = terrain.chart.from_world(origin), terrain.chart.vectors_from_world(direction)
    table = terrain.tiles(0)
    low, high = terrain.height_range
    if math.isnan(low):
        return None
    t0, t1 = _clip(o[2], v[2], low - SLAB, high + SLAB, near, far)
    # A ray that enters through the top of the slab of heights is above the surface; otherwise the first cell tells.
    began = t0
    side = 0 if t0 == near else 1 if v[2] < 0 else -1
    for axis, last in enumerate((cols - 1.0, rows - 1.0)):
        t0, t1 = _clip(o[axis], v[axis], 0.0, last, t0, t1)
    if not t0 <= t1 < math.inf:
        return None
    side = side if t0 == began else 0
    cuts = _borders(o, v, t0, t1, (cols, rows))
    middle = 0.5 * (cuts[:-1] + cuts[1:])
    tile_rows, tile_cols = table.minimum.shape
    j = np.clip(np.floor(o[0] + middle * v[0]) // TILE, 0, tile_cols - 1).astype(int)
    i = np.clip(np.floor(o[1] + middle * v[1]) // TILE, 0, tile_rows - 1).astype(int)
    z = o[2] + cuts * v[2]
    lowest, highest = np.minimum(z[:-1], z[1:]), np.maximum(z[:-1], z[1:])
    for k in range(len(middle)):
        bottom, top = float(table.minimum[i[k], j[k]]), float(table.maximum[i[k], j[k]])
        if math.isnan(top):  # only a hole
            side = 0
            continue
        if lowest[k] > top and side >= 0:
            side = 1
            continue
        if highest[k] < bottom and side <= 0:
            side = -1
            continue
        r0, c0 = int(i[k]) * TILE, int(j[k]) * TILE
        part = terrain.read(0, r0, min(r0 + TILE + 1, rows), c0, min(c0 + TILE + 1, cols))
        scene = Stack.build([HeightWindow(0, 0, 0, np.ascontiguousarray(part))], part.shape, 1).scene
        begin = o[0] - c0, o[1] - r0, o[2]
        t, side = walk(scene, 0, begin, (v[0], v[1], v[2]), cuts[k], cuts[k + 1], side, 6)
        if t < math.inf:
            return float(t)
    return None


def _clip(start: float, step: float, low: float, high: float, t0: float, t1: float) -> tuple[float, float]:
    """The part of [t0, t1] in which start + t·step lies in [low, high]; an empty interval such as (1, 0) if none."""
    if step == 0.0:
        return (t0, t1) if low <= start <= high else (1.0, 0.0)
    first, last = sorted(((low - start) / step, (high - start) / step))
    return max(t0, float(first)), min(t1, float(last))


def _borders(o: Array, v: Array, t0: float, t1: float, size: tuple[int, int]) -> Array:
    """t0, the parameters at which a ray crosses borders of tiles, and t1."""
    found = [np.array([t0, t1])]
    for axis, samples in enumerate(size):
        if v[axis] != 0.0:
            t = (np.arange(TILE, samples - 1, TILE) - o[axis]) / v[axis]
            found.append(t[(t > t0) & (t < t1)])
    return np.sort(np.concatenate(found))
