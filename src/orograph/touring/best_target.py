"""The target of a best view: points, tracks and areas on the ground, in small *pieces*.

An area is a lattice of places, each with its share of the ground; a track is cut into short lines; a point is one
piece. Every geometry counts equally, whatever its size: its pieces share a weight of 1 by surface area, by length, or
evenly. Pieces outside the terrain or in its holes count as never visible and are left out, with a warning.

Units: metres in the terrain's CRS, float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.geo.geojson import crs_name, geometries, lines, load
from orograph.geo.transform import transformer
from orograph.measuring.ground import facets
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]

POINT, TRACK, AREA = 0, 1, 2
"""Kinds of pieces: their dimension, which is the power of the distance by which they shrink in a picture (for a point
1, as for a track)."""

KINDS = {"Point": POINT, "LineString": TRACK, "Polygon": AREA}

MOST_EDGES = 1 << 22
"""Products of places and edges that are tested at a time."""


@dataclass(frozen=True, slots=True)
class Target:
    """The pieces of a target.

    Attributes:
        points: (n, 3) easting, northing and height of each.
        kind: (n,) int64, ``POINT``, ``TRACK`` or ``AREA``; points are first, areas last.
        axis: (n, 3) the unit normal of an area's piece, the unit direction of a track's; zero for a point's.
        weight: (n,) of each, 1 in all (less the part outside the terrain).
        owner: (n,) int64, the number of its geometry. count: the number of geometries.
    """

    points: Array
    kind: NDArray[np.int64]
    axis: Array
    weight: Array
    owner: NDArray[np.int64]
    count: int

    @property
    def middle(self) -> Array:
        """(3,): the middle of all pieces' extent, which cameras look at."""
        return np.asarray((self.points.min(0) + self.points.max(0)) / 2)

    @property
    def radius(self) -> float:
        """From the middle to the farthest piece, metres."""
        return float(np.linalg.norm(self.points - self.middle, axis=1).max())


@dataclass(frozen=True, slots=True)
class _Flat:
    """Pieces in the plan: places (n, 2), directions (n, 2) of tracks, sizes (n,)."""

    kind: int
    places: Array
    along: Array
    size: Array


def read_target(terrain: Terrain, given: Any, pieces: int, progress: Progress = SILENT) -> Target:
    """The pieces of a target on the terrain's surface.

    Args:
        given: a GeoJSON file or object, or what has ``__geo_interface__``; or places (n, 2) or a pair of arrays
            (x, y) in the terrain's CRS, each of them a point.
        pieces: about how many in all.

    Raises:
        ReadError: the file cannot be read, or holds no geometry. UsageError: none of it lies on the terrain.
    """
    shapes, called = _shapes(terrain, given)
    each = max(pieces // len(shapes), 1)
    flat = [_flat(kind, parts, each) for kind, parts in shapes]
    owner = np.concatenate([np.full(len(f.places), i) for i, f in enumerate(flat)])
    kind = np.concatenate([np.full(len(f.places), f.kind) for f in flat])
    places = np.concatenate([f.places for f in flat])
    along = np.concatenate([f.along for f in flat])
    size = np.concatenate([f.size for f in flat])
    heights, slopes = _ground(terrain, places)
    axis = np.zeros((len(places), 3))
    axis[kind == AREA] = np.column_stack([-slopes, np.ones(len(places))])[kind == AREA]
    axis[kind == TRACK] = np.column_stack([along, (along * slopes).sum(1)])[kind == TRACK]
    length = np.linalg.norm(axis, axis=1)
    length[~(length > 0)] = 1.0  # of points, and of pieces without ground
    size, axis = size * length, axis / length[:, None]  # of the ground, not in plan
    known = np.isfinite(heights)
    if not known.any():
        raise UsageError(
            f"No part of the target lies on the ground of {terrain.name}. {_where(terrain, places)}",
            path=called, remedy="GeoJSON is longitude and latitude, arrays are in the terrain's CRS.",
        )  # fmt: skip
    shared = np.bincount(owner, size)
    if not known.all():
        progress.warn(f"{100 * (~known).mean():.3g} % of the target lies outside the terrain or in its holes.")
    weight = size[known] / shared[owner[known]] / len(shapes)
    points = np.column_stack([places, heights])[known]
    order = np.argsort(kind[known], kind="stable")
    points, weight, owner = points[order], weight[order], owner[known][order]
    return Target(points, kind[known][order], axis[known][order], weight, owner, len(shapes))


def _shapes(terrain: Terrain, given: Any) -> tuple[list[tuple[int, list[Array]]], str | None]:
    """Each geometry's kind and its lines (of polygons, all rings) in the terrain's CRS; the file's name."""
    if (
        not isinstance(given, str | dict)
        and not hasattr(given, "__geo_interface__")
        and not hasattr(given, "__fspath__")
    ):
        return [(POINT, [place[None]]) for place in _places(given)], None
    data, called = load(given)
    found: list[tuple[int, list[Array]]] = []
    for geometry in geometries(data):
        several = str(geometry.get("type")).startswith("Multi")
        name = str(geometry.get("type")).removeprefix("Multi")
        if name not in KINDS:
            if geometry:
                raise ReadError(f"A target must have points, lines and polygons, not {name!r}.", path=called)
            continue
        try:
            parts = geometry["coordinates"] if several else [geometry["coordinates"]]
            parts = [ring for part in parts for ring in part] if name == "Polygon" else parts
            parts = [[part] for part in parts] if name == "Point" else parts
            parts = [part for part in parts if part]
            if parts:
                found.append((KINDS[name], lines(parts)))
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise ReadError(f"The {geometry.get('type')} has no list of coordinates.", path=called) from error
    if not found:
        raise ReadError("The target is empty: it holds no points, lines or polygons.", path=called,
                        remedy="Give GeoJSON with the features to show.")  # fmt: skip
    move = transformer(crs_name(data) or "EPSG:4326", terrain.grid.crs)
    moved = [(kind, [np.stack(move(p[:, 0], p[:, 1]), -1) for p in parts]) for kind, parts in found]
    if not all(np.isfinite(part).all() for _, parts in moved for part in parts):
        raise UsageError("A point of the target cannot be transformed to the terrain's CRS.", path=called)
    return moved, called


def _places(given: Any) -> Array:
    """Places (n, 2) of an array of them, or of (x, y)."""
    try:
        found = np.asarray(given, np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(
            "A target must be GeoJSON, points (n, 2), or a pair of arrays (x, y) in the terrain's CRS."
        ) from error
    if isinstance(given, tuple) and found.ndim == 2 and len(found) == 2:
        found = found.T
    found = np.atleast_2d(found)
    if found.ndim != 2 or found.shape[1] != 2 or not np.isfinite(found).all():
        raise UsageError(
            f"A target's points must be finite numbers (n, 2), or a pair (x, y), not of shape {found.shape}."
        )
    if not len(found):
        raise UsageError("The target is empty: it has no points.")
    return found


def _flat(kind: int, parts: list[Array], pieces: int) -> _Flat:
    """A geometry in about ``pieces`` pieces."""
    if kind == POINT:
        places = np.concatenate(parts)
        return _Flat(kind, places, np.zeros_like(places), np.ones(len(places)))
    if kind == TRACK:
        return _track(parts, pieces)
    return _area(parts, pieces)


def _track(parts: list[Array], pieces: int) -> _Flat:
    """Short lines of equal length, given by their middles."""
    ends = np.concatenate([np.stack([part[:-1], part[1:]], 1) for part in parts])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    ends, length = ends[length > 0], length[length > 0]
    if not len(ends):
        return _flat(POINT, [part[:1] for part in parts], pieces)
    far = np.cumsum(length)
    station = (np.arange(pieces) + 0.5) / pieces * far[-1]
    which = np.minimum(np.searchsorted(far, station, "right"), len(far) - 1)
    along = (ends[which, 1] - ends[which, 0]) / length[which, None]
    places = ends[which, 1] - (far[which] - station)[:, None] * along
    return _Flat(TRACK, places, along, np.full(pieces, far[-1] / pieces))


def _area(rings: list[Array], pieces: int) -> _Flat:
    """A lattice of places within rings (even-odd), each the middle of a square."""
    low, high = np.min([r.min(0) for r in rings], 0), np.max([r.max(0) for r in rings], 0)
    wide = high - low
    if wide.min() <= 1e-6 * wide.max():  # no area
        return _track(rings, pieces)
    step = math.sqrt(float(wide.prod()) / pieces)
    inside = np.zeros((0, 2))
    for _ in range(8):  # a thin area fills only a small part of its rectangle
        n = np.maximum(np.ceil(wide / step).astype(int), 1)
        x, y = (low[i] + (np.arange(n[i]) + 0.5) * wide[i] / n[i] for i in (0, 1))
        lattice = np.stack([a.ravel() for a in np.meshgrid(x, y)], -1)
        inside = lattice[_within(lattice, rings)]
        if len(inside) >= 0.7 * pieces or len(lattice) > 64 * pieces:
            break
        step *= math.sqrt(max(len(inside), 1) / pieces) if len(inside) > pieces / 16 else 0.5
    if not len(inside):  # too thin for any place
        return _track(rings, pieces)
    return _Flat(AREA, inside, np.zeros_like(inside), np.full(len(inside), float((wide / n).prod())))


def _within(places: Array, rings: list[Array]) -> NDArray[np.bool_]:
    """(n,): whether places are inside rings, by the number of edges to their east."""
    a = np.concatenate(rings)
    b = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    out = np.zeros(len(places), bool)
    block = max(MOST_EDGES // len(a), 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(0, len(places), block):
            x, y = places[k : k + block, 0, None], places[k : k + block, 1, None]
            crosses = (a[:, 1] > y) != (b[:, 1] > y)
            east = x < a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
            out[k : k + block] = (crosses & east).sum(1) % 2 == 1
    return out


def _ground(terrain: Terrain, places: Array) -> tuple[Array, Array]:
    """Heights (n,) of the surface, NaN beside it, and its slopes (n, 2) per metre east and north."""
    rows, cols = terrain.grid.shape
    col, row = terrain.grid.index(places[:, 0], places[:, 1])
    on = (col >= 0) & (col <= cols - 1) & (row >= 0) & (row <= rows - 1)
    found = facets(terrain, np.where(on, col, 0.0), np.where(on, row, 0.0))
    heights = np.where(on, found.heights(np.where(on, col, 0.0), np.where(on, row, 0.0)), np.nan)
    back = np.linalg.inv(terrain.grid.linear)  # metres to samples
    return heights, np.column_stack([found.p, found.q]) @ back


def _where(terrain: Terrain, places: Array) -> str:
    """The extents of the target and of the terrain, as text."""
    rows, cols = terrain.grid.shape
    x, y = terrain.grid.xy(np.array([0, cols - 1, 0, cols - 1]), np.array([0, 0, rows - 1, rows - 1]))
    (w, s), (e, n) = places.min(0), places.max(0)
    return (f"The target extends from {w:.10g}, {s:.10g} to {e:.10g}, {n:.10g}, the terrain from {np.min(x):.10g}, "
            f"{np.min(y):.10g} to {np.max(x):.10g}, {np.max(y):.10g} in its CRS.")  # fmt: skip
