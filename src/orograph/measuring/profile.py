"""Profiles along the ground, and the length of a line on the grid, on the ellipsoid, in space, and on foot.

A profile is cut wherever its line crosses an edge of the triangulated surface (``ground.line``); in between the ground
is straight, so its length is exact. True metres: a step d on the grid at height h is sqrt(dᵀ G d)·(1 + h/R) metres long
(``places``), with G taken at most ``KNOT`` metres apart and linear between (an error below 1e-8), so that

    ground = Σ sqrt((1 + h/R)² dᵀ G d + Δh²)   over all pieces;   horizontal = Σ sqrt(dᵀ G d).

Straight is the chord in space between the ends (geocentric), geodesic the shortest path on the ellipsoid from vertex to
vertex (Karney 2013). Holes are bridged from rim to rim along the line, because otherwise a line over a hole could be
shorter than the straight distance; the bridged length is reported. Units: metres, degrees.
"""

from __future__ import annotations

import csv
import json
import math
import os
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.measuring.geojson import Geometry, is_geometry, read_geojson
from orograph.measuring.ground import Line, height_error, line, own_heights
from orograph.measuring.ground import heights as surface
from orograph.measuring.places import Places, lift
from orograph.output import Beside
from orograph.store.opening import takes_terrain
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]

KNOT = 2000.0
"""Metres on the grid between the points where the projection's stretch is evaluated."""

COLUMNS = ("distance_m", "ground_m", "easting", "northing", "longitude", "latitude", "height_m",
           "surface_height_m")  # fmt: skip


@dataclass(frozen=True, repr=False)
class Profile:
    """The surface along a polyline, at every crossing of an edge; n places.

    Attributes:
        points: (n, 2) easting, northing.
        surface_heights: (n,) metres, of the surface that is drawn; NaN over holes.
        distance: (n,) metres from the start along the line, true, on the ellipsoid.
        ground: (n,) metres from the start along the surface, true; holes are bridged from rim to rim.
        known: (n − 1,) whether there is ground between a place and the next.
        vertices: (v,) indices of the polyline's own vertices.
        grid: metres of the line on the grid; ground_grid: along the surface as if grid metres were true.
        straight: metres between the ends in a straight line through space; None if one of them is in a hole.
        geodesic: metres on the ellipsoid from vertex to vertex; None without a CRS.
        climb, descent: metres up and down along the surface.
        missing: metres of the line over holes; bridged: the part of the length along the ground that bridges them.
    """

    points: Array
    surface_heights: Array
    distance: Array
    ground: Array
    known: NDArray[np.bool_]
    vertices: NDArray[np.int64]
    grid: float
    ground_grid: float
    straight: float | None
    geodesic: float | None
    climb: float
    descent: float
    missing: float
    bridged: float
    places: Places

    def __repr__(self) -> str:
        low, high = (f"{v:.6g}" if v is not None else "none" for v in (self.lowest, self.highest))
        return (
            f"<Profile over {self.places.terrain.name!r}: {self.length:,.0f} m along the ground, "
            f"{self.distance[-1]:,.0f} m across, {low} to {high} m, {len(self.points):,} places>"
        )

    def plot(self, ax: Any = None) -> Any:
        """Draw it on matplotlib's axes (None: new ones); returns the axes."""
        if ax is None:
            from matplotlib import pyplot

            _, ax = pyplot.subplots(figsize=(9, 3.6), layout="constrained")
        unit, scale = ("km", 1000.0) if self.distance[-1] >= 2000 else ("m", 1.0)
        breaks = np.flatnonzero(~self.known)  # the ground is open over holes
        s = np.insert(self.distance / scale, breaks + 1, self.distance[breaks] / scale)
        z = np.insert(self.surface_heights, breaks + 1, np.nan)
        ax.plot(s, z, color="#5b4a32", linewidth=1.0)
        ax.set_xlabel(f"distance ({unit})")
        ax.set_ylabel("height (m)")
        return ax

    def to_dataframe(self, every: float | None = None) -> Any:
        """``rows`` as a DataFrame of pandas."""
        import importlib

        return importlib.import_module("pandas").DataFrame(self.rows(every), columns=list(COLUMNS))

    @property
    def length(self) -> float:
        """Metres along the ground, true."""
        return float(self.ground[-1])

    @property
    def scale(self) -> float:
        """Grid metres per metre on the ellipsoid, over the whole line."""
        return self.grid / float(self.distance[-1]) if self.distance[-1] > 0 else 1.0

    @cached_property
    def lonlat(self) -> Array | None:
        """(n, 2) longitude and latitude of the places, degrees; None without a CRS."""
        return self.places.lonlat(self.points)

    @cached_property
    def heights(self) -> Array:
        """(n,) metres at the places, bilinear between the terrain's original samples (``own_heights``)."""
        return own_heights(self.places.terrain, self.points)

    @property
    def height_error(self) -> float | None:
        """Maximum error of ``heights``, metres; None if they are the source's own (``Hit.height_error``)."""
        return height_error(self.places.terrain)

    @property
    def lowest(self) -> float | None:
        """The lowest ground on the line, metres; None if there is none."""
        return None if self._extremes is None else self._extremes[0]

    @property
    def highest(self) -> float | None:
        """The highest ground on the line, metres; None if there is none."""
        return None if self._extremes is None else self._extremes[1]

    @cached_property
    def _extremes(self) -> tuple[float, float] | None:
        """The lowest and the highest of ``heights``, including between places.

        Along a line, bilinear ground is a parabola, which may have its extremum there. For resampled terrain, it is
        that of the parabola through three places.
        """
        if np.isnan(self.heights).all():
            return None
        terrain, step = self.places.terrain, np.diff(self.points, axis=0)
        start, end = self.heights[:-1], self.heights[1:]
        middle = own_heights(terrain, self.points[:-1] + 0.5 * step)
        bend, slope = 2 * (start + end) - 4 * middle, 4 * middle - 3 * start - end
        with np.errstate(invalid="ignore", divide="ignore"):
            turn = -0.5 * slope / bend
        inside = (turn > 0) & (turn < 1)
        turning = own_heights(terrain, self.points[:-1][inside] + turn[inside, None] * step[inside])
        found = np.concatenate([self.heights, turning])
        return float(np.nanmin(found)), float(np.nanmax(found))

    def at(self, distance: ArrayLike) -> tuple[Array, Array, Array]:
        """Points (k, 2), surface heights (k,) and ground (k,) at distances (k,) along the line.

        They are exact: the surface is straight between its places.

        Raises:
            UsageError: a distance is not on the line.
        """
        s = np.atleast_1d(np.asarray(distance, np.float64))
        if not ((s >= 0) & (s <= self.distance[-1])).all():
            raise UsageError(f"Distances along this line go from 0 to {self.distance[-1]:.10g} m.")
        i = np.clip(np.searchsorted(self.distance, s, side="right") - 1, 0, len(self.distance) - 2)
        gap = self.distance[i + 1] - self.distance[i]
        f = np.divide(s - self.distance[i], gap, out=np.zeros_like(s), where=gap > 0)
        ends = f <= 0, f >= 1
        heights = (1 - f) * self.surface_heights[i] + f * self.surface_heights[i + 1]
        heights[~self.known[i]] = np.nan
        for exact, k in zip(ends, (0, 1)):  # a place itself may be on the rim of a hole
            heights[exact] = self.surface_heights[i + k][exact]
        points = (1 - f)[:, None] * self.points[i] + f[:, None] * self.points[i + 1]
        return points, heights, (1 - f) * self.ground[i] + f * self.ground[i + 1]

    def rows(self, every: float | None = None) -> list[dict[str, float | None]]:
        """The profile as records of ``COLUMNS``: at every crossing, or every ``every`` metres (and at the end)."""
        distance, points, surface, ground = self.distance, self.points, self.surface_heights, self.ground
        if every is not None:
            if not (every > 0 and math.isfinite(every)):
                raise UsageError(f"The distance between places must be a positive number of metres, not {every!r}.")
            if self.distance[-1] / every > 1e7:
                raise UsageError(f"A place every {every:g} m would be more than ten million places.")
            distance = np.append(np.arange(0.0, self.distance[-1], every), self.distance[-1])
            points, surface, ground = self.at(distance)
        own = self.heights if every is None else own_heights(self.places.terrain, points)
        degrees = self.places.lonlat(points)
        lonlat = np.full((len(points), 2), np.nan) if degrees is None else degrees
        table = np.column_stack([distance, ground, points, lonlat, own, surface])
        return [dict(zip(COLUMNS, (None if math.isnan(v) else float(v) for v in row))) for row in table]

    def save(self, path: str | os.PathLike[str], every: float | None = None) -> Path:
        """Write it by the file's ending.

        Args:
            path: .csv: a table of ``rows``, unknown values empty; .geojson: the line, with longitude, latitude and
                surface height at every crossing (no height over holes) and ``to_dict`` as properties; .png, .svg, .pdf:
                a plot.
            every: metres between the rows of a table; None: a row at every crossing.

        Raises:
            UsageError: another ending, or GeoJSON of a terrain without a CRS. ReadError: a plot needs matplotlib.
            OutputError: the file cannot be written.
        """
        ending = Path(path).suffix.lower()
        if ending == ".csv":
            self._save_csv(path, every)
        elif ending == ".geojson":
            self._save_geojson(path)
        else:
            from orograph.measuring.plot import ENDINGS, save_profile

            if ending not in ENDINGS:
                raise UsageError(f"A profile must be written as .csv, .geojson, {', '.join(ENDINGS)}.", path=path)
            save_profile(self, path)
        return Path(path)

    def _save_geojson(self, path: str | os.PathLike[str]) -> None:
        if self.lonlat is None:
            raise UsageError("GeoJSON needs longitudes and latitudes, but the terrain has no CRS.", path=path)
        places = [
            [*at, *([] if math.isnan(z) else [z])]
            for at, z in zip(np.round(self.lonlat, 9).tolist(), self.surface_heights.tolist())
        ]
        line = {"type": "LineString", "coordinates": places}
        feature = {"type": "Feature", "properties": self.to_dict(), "geometry": line}
        with Beside(Path(path)) as part:
            part.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}, allow_nan=False))

    def _save_csv(self, path: str | os.PathLike[str], every: float | None) -> None:
        places = (3, 3, 4, 4, 8, 8, 3, 3)
        with Beside(Path(path)) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            for row in self.rows(every):
                writer.writerow(
                    "" if row[name] is None else f"{row[name]:.{digits}f}" for name, digits in zip(COLUMNS, places)
                )

    def to_dict(self) -> dict[str, Any]:
        """A summary for JSON."""
        first, last = self.heights[0], self.heights[-1]
        return {
            "ground_m": self.length, "horizontal_m": float(self.distance[-1]), "straight_m": self.straight,
            "geodesic_m": self.geodesic, "grid_m": self.grid, "ground_grid_m": self.ground_grid,
            "grid_scale": self.scale, "climb_m": self.climb, "descent_m": self.descent, "lowest_m": self.lowest,
            "highest_m": self.highest, "first_m": None if math.isnan(first) else float(first),
            "last_m": None if math.isnan(last) else float(last), "missing_m": self.missing, "bridged_m": self.bridged,
            "places": len(self.heights), "height_error_m": self.height_error,
        }  # fmt: skip


@takes_terrain
def profile(terrain: Terrain, polyline: ArrayLike | Geometry, *, lonlat: bool = False) -> Profile:
    """The surface along a polyline, exact.

    Args:
        polyline: (v, 2) easting, northing, at least two points, in the terrain's CRS; straight on the grid from
            vertex to vertex; or GeoJSON with one line: a file, a mapping, or an object with ``__geo_interface__``.
        lonlat: the points are longitude and latitude, degrees.

    Raises:
        UsageError: a point is not on the terrain, or the line has no length.
        ReadError: the GeoJSON cannot be read, or does not hold one line.
        DamagedChunkError: a chunk of a store fails its checksum.
    """
    places = Places(terrain)
    if is_geometry(polyline):
        polyline, lonlat = read_geojson(polyline, "LineString", places)[0], False
    given = places.points(polyline, least=2, what="A line", lonlat=lonlat)
    corners = places.samples(given)
    moves = np.append(True, (np.diff(given, axis=0) != 0).any(axis=1))
    given, corners = given[moves], corners[moves]
    if len(given) < 2:
        raise UsageError("The line has no length: its points are identical.")
    cuts = [line(terrain, a, b) for a, b in pairwise(corners)]
    points, flat, flat_grid = [given[:1]], [], []
    for cut, p, q in zip(cuts, given[:-1], given[1:]):
        step = np.diff(cut.t)
        points.append(p + cut.t[1:, None] * (q - p))
        flat.append(step * stretch(places, p, q, 0.5 * (cut.t[:-1] + cut.t[1:])))
        flat_grid.append(step * math.hypot(*(q - p)))
    across, across_grid = np.concatenate(flat), np.concatenate(flat_grid)
    known = np.concatenate([cut.known for cut in cuts])
    distance = np.append(0.0, np.cumsum(across))
    z = _heights(terrain, cuts)
    over = _bridged(distance, z)
    before, after = (
        np.where(known, np.concatenate([getattr(cut, name) for cut in cuts]), bridge)
        for name, bridge in (("before", over[:-1]), ("after", over[1:]))
    )
    rise = after - before
    foot = np.hypot(across * lift(places, 0.5 * (before + after)), rise)
    straight = None
    if not (math.isnan(z[0]) or math.isnan(z[-1])):
        ends = places.ecef(given[[0, -1]], z[[0, -1]])
        straight = float(np.linalg.norm(ends[1] - ends[0]))
    return Profile(
        np.concatenate(points), z, distance, np.append(0.0, np.cumsum(foot)), known,
        np.append(0, np.cumsum([len(part) for part in flat])), float(np.hypot(*np.diff(given, axis=0).T).sum()),
        float(np.hypot(across_grid, rise).sum()), straight, _geodesic(places, given), float(rise[rise > 0].sum()),
        float((-rise[rise < 0]).sum()), float(across[~known].sum()), float(foot[~known].sum()), places,
    )  # fmt: skip


def _heights(terrain: Terrain, cuts: list[Line]) -> Array:
    """Heights at all places of lines that follow each other, NaN over holes."""
    parts, last = [], math.nan
    for cut in cuts:
        here = cut.heights
        for end in (0, -1):  # on the rim of a hole that the line crosses
            if math.isnan(here[end]):
                here[end] = surface(terrain, cut.x[[end]], cut.y[[end]])[0]
        parts += [np.atleast_1d(last if math.isnan(here[0]) else here[0]), here[1:-1]]
        last = float(here[-1])
    return np.append(np.concatenate(parts), last)


def _bridged(distance: Array, heights: Array) -> Array:
    """Heights with holes bridged straight from rim to rim, level if there is only one rim, at 0 if there is none."""
    there = ~np.isnan(heights)
    if not there.any():
        return np.zeros(len(heights))
    return np.asarray(np.interp(distance, distance[there], heights[there]))


def stretch(places: Places, start: Array, end: Array, t: Array) -> Array:
    """Metres on the ellipsoid per unit of a straight line on the grid, at fractions t of it."""
    step = end - start
    if places.ellipsoid is None:
        return np.full(len(t), math.hypot(*step))
    knots = np.linspace(0.0, 1.0, max(2, math.ceil(math.hypot(*step) / KNOT) + 1))
    metric = places.metric(start + knots[:, None] * step)
    return np.asarray(np.interp(t, knots, np.sqrt(np.einsum("i,nij,j->n", step, metric, step))))


def _geodesic(places: Places, points: Array) -> float | None:
    """Metres on the ellipsoid from point to point; None without a CRS."""
    geod = places.geod
    return None if geod is None else float(geod.line_length(*places.geodetic(points).T))
