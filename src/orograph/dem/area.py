"""The part of rasters to read: a box in degrees, polygons, or their intersection.

A raster is cut before anything is chosen for it (``Mosaic``): the projection, spacing and memory of a terrain follow
from its area, and files outside the area are not read. For a box, the smallest window that contains it is kept; samples
outside polygons are missing. Units: degrees; samples.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.lattice import Raster, full_turn
from orograph.errors import UsageError
from orograph.geo import geojson
from orograph.geo.grid import Grid, compose
from orograph.geo.operations import same_body
from orograph.geo.transform import transformer

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]
Heights = NDArray[np.float32]

WGS84 = CRS.from_epsg(4326)
LATTICE = 65
"""Points along each side of a box that are transformed to another CRS."""
STEPS = 64
"""Pieces into which each edge of a polygon is divided for the transformation to another CRS."""
SAME = 1e-6
"""Tolerance in samples for a border that lies on a sample."""


@dataclass(frozen=True, slots=True)
class Area:
    """The part of the ground to read.

    Attributes:
        box: west, south, east, north, degrees; west > east lies across the 180th meridian. None: no box.
        polygons: rings (n, 2) of each, the outer one first, in ``crs`` (None: longitude and latitude).
        called: what to call the polygons.
    """

    box: Box | None
    polygons: tuple[tuple[Array, ...], ...] = ()
    crs: str | None = None
    called: str = ""

    @classmethod
    def of(cls, bbox: Sequence[float] | str | None, clip: Any) -> Area | None:
        """The area from two options; None if neither is given.

        Args:
            bbox: west, south, east, north, degrees.
            clip: polygons: a GeoJSON file, or an object of GeoJSON or with ``__geo_interface__`` (shapely, geopandas).

        Raises:
            UsageError: the box is not a box. ReadError: the file cannot be read, or holds no polygon.
        """
        if bbox is None and clip is None:
            return None
        area = cls(None if bbox is None else checked(bbox))
        if clip is None:
            return area
        data, called = geojson.load(clip)
        polygons = tuple(tuple(rings) for rings in geojson.polygons(data, called))
        return replace(area, polygons=polygons, crs=geojson.crs_name(data), called=called)

    def fingerprint(self) -> str:
        """Differs whenever the area does."""
        digest = hashlib.sha256(repr((self.box, self.crs, [len(p) for p in self.polygons])).encode())
        for rings in self.polygons:
            for ring in rings:
                digest.update(np.ascontiguousarray(ring).tobytes())
        return digest.hexdigest()[:32]

    def cut(self, rasters: Sequence[Raster]) -> list[Raster]:
        """The parts of rasters that lie in the area; rasters outside it are left out.

        Raises:
            UsageError: no sample lies in it, or a raster has no CRS.
        """
        found: list[Raster] = []
        for raster in rasters:
            found += self._parts(raster)
        if not found:
            where = "the polygons" if self.box is None else ", ".join(f"{v:g}" for v in self.box)
            raise UsageError(
                f"No sample lies within {where}{reach(rasters[0].grid) if len(rasters) == 1 else ''}.",
                path=getattr(rasters[0], "path", rasters[0].name),
                remedy="An area is west, south, east, north in degrees; check where the file lies with orograph info.",
            )  # fmt: skip
        return found

    def _parts(self, raster: Raster) -> list[Raster]:
        grid = raster.grid
        if grid.crs is None:
            raise UsageError(
                "It has no CRS, so an area in degrees cannot be located.", path=getattr(raster, "path", raster.name),
                remedy="Give the CRS with `assume_crs`.",
            )  # fmt: skip
        parts: list[Raster] = []
        rings = self._rings(grid)
        for turn in turns(grid):
            window = whole(grid)
            if self.box is not None:
                window = both(window, box_window(grid, self.box, turn))
            if self.polygons:
                every = [ring - [turn, 0.0] for one in rings for ring in one]
                window = both(window, window_of(grid, np.concatenate([np.empty((0, 2)), *every])))
            if window[1] > window[0] and window[3] > window[2]:
                parts.append(Cut(raster, window, turn, tuple(rings), self.fingerprint()))
        return parts

    def _rings(self, grid: Grid) -> list[list[Array]]:
        """The polygons in a grid's CRS."""
        if not self.polygons:
            return []
        move = transformer(self.crs or degrees_of(grid), grid.crs)
        found = []
        for rings in self.polygons:
            moved = [np.stack(move(*_dense(ring).T), axis=-1) for ring in rings]
            found.append([ring[np.isfinite(ring).all(1)] for ring in moved])
        return [[ring for ring in one if len(ring) >= 3] for one in found if len(one[0]) >= 3]


class Cut:
    """A part of a raster: a window of it, with only the samples in polygons.

    Args:
        window: first row, row after the last, first column, column after the last. turn: its shift in longitude
            (in its CRS's unit). rings: of polygons in the shifted CRS; none: all samples. area: its fingerprint.
    """

    def __init__(
        self, raster: Raster, window: tuple[int, int, int, int], turn: float, rings: tuple[list[Array], ...], area: str
    ) -> None:
        self.raster, self.window, self._rings, self._area = raster, window, rings, area
        grid = raster.grid.window(*window)
        self.grid = Grid(grid.shape, compose(Affine.translation(turn, 0.0), grid.transform), grid.crs)

    def __getattr__(self, name: str) -> Any:
        """Attributes come from the raster."""
        if name == "raster":  # (while it is unpickled)
            raise AttributeError(name)
        return getattr(self.raster, name)

    @property
    def shape(self) -> tuple[int, int]:
        return self.grid.shape

    def read(self, row0: int, row1: int, col0: int, col1: int, **how: int) -> Heights:
        """A window of the part, as the raster reads it; NaN outside the polygons."""
        top, _, left, _ = self.window
        heights = self.raster.read(top + row0, top + row1, left + col0, left + col1, **how)
        if not self._rings:
            return heights
        step = how.get("step", 1)
        transform = compose(self.grid.transform, Affine.translation(col0 + 0.5, row0 + 0.5), Affine.scale(step),
                            Affine.translation(-0.5, -0.5))  # fmt: skip
        return np.where(inside(self._rings, transform, heights.shape), heights, np.float32(np.nan))

    def turned(self, row0: int, row1: int, col0: int, col1: int) -> tuple[int, int, int, int]:
        """Convert a window of the file's own rows and columns to those of ``read``."""
        top, _, left, _ = self.window
        r0, r1, c0, c1 = self.raster.turned(row0, row1, col0, col1)  # type: ignore[attr-defined]
        return r0 - top, r1 - top, c0 - left, c1 - left

    def fingerprint(self) -> str:
        own = getattr(self.raster, "fingerprint", None)
        return f"{self._area} {self.window} {'' if own is None else own()}"


def recorded(clip: Any) -> Any:
    """Polygons as JSON for a store's record; a file is recorded by its path."""
    if clip is None:
        return None
    return str(Path(clip).absolute()) if isinstance(clip, str | os.PathLike) else geojson.load(clip)[0]


def checked(bbox: Sequence[float] | str) -> Box:
    """West, south, east, north from numbers, or from their text ("7.5,45.9,7.8,46.1").

    Raises:
        UsageError: they are not such numbers.
    """
    try:
        west, south, east, north = (float(v) for v in (bbox.split(",") if isinstance(bbox, str) else bbox))
    except (TypeError, ValueError):
        raise UsageError(f"An area must be west, south, east, north in degrees, not {bbox!r}.") from None
    if not (all(map(math.isfinite, (west, south, east, north))) and south < north and west != east):
        raise UsageError(
            f"An area must be west, south, east, north in degrees, not {west:g},{south:g},{east:g},{north:g}."
        )
    return west, south, east, north


def degrees_of(grid: Grid) -> CRS:
    """Longitude and latitude as an area uses them: WGS 84, or another body's own."""
    assert grid.crs is not None
    geodetic = grid.crs.geodetic_crs
    return WGS84 if geodetic is None or same_body(grid.crs, WGS84) else geodetic


def reach(grid: Grid) -> str:
    """A raster's location, as the end of a message; "" if unknown."""
    found = lonlat_bounds(grid)
    if found is None:
        return ""
    west, south, east, north = found
    return f": it reaches from {west:.5g}, {south:.4g} to {east:.5g}, {north:.4g} (longitude, latitude)"


def lonlat_bounds(grid: Grid) -> Box | None:
    """West, south, east, north of a raster's samples in degrees; None if unknown.

    West > east across the 180th meridian, as for an area.
    """
    if grid.crs is None:
        return None
    x, y = grid.xy(*np.meshgrid(np.linspace(0, grid.cols - 1, 9), np.linspace(0, grid.rows - 1, 9)))
    try:
        lon, lat = transformer(grid.crs, degrees_of(grid))(np.ravel(x), np.ravel(y))
    except UsageError:  # a CRS that is not on any body
        return None
    if not (np.isfinite(lon).all() and np.isfinite(lat).all()):
        return None
    west, east = (lon.min(), lon.max()) if grid.crs.is_geographic else _arc(lon.reshape(x.shape))
    south, north = np.clip((lat.min(), lat.max()), -90, 90)
    if (west, east) == (-180, 180) and _turns_around(lon.reshape(x.shape)):
        south, north = (south, 90) if south + north > 0 else (-90, north)
    return float(west), float(south), float(east), float(north)


def _turns_around(lon: Array) -> bool:
    """Whether the border of a lattice of longitudes (rows, cols) runs around a pole."""
    ring = np.concatenate([lon[0, :-1], lon[:-1, -1], lon[-1, :0:-1], lon[:0:-1, 0]])
    return bool(abs(np.unwrap([*ring, ring[0]], period=360)[-1] - ring[0]) > 180)


def _arc(lon: Array) -> tuple[float, float]:
    """West and east of a lattice of longitudes (rows, cols), from -180 to 180; west > east across 180°."""
    rows = np.unwrap(lon, period=360, axis=1)
    rows += (np.unwrap(rows[:, 0], period=360) - rows[:, 0])[:, None]
    west, east = rows.min(), rows.max()
    if east - west >= 360 or _turns_around(lon):
        return -180.0, 180.0
    return float((west + 180) % 360 - 180), float(180 - (180 - east) % 360)


def turns(grid: Grid) -> tuple[float, ...]:
    """Offsets of the copies of a globe in a grid's CRS: a raster may begin at any meridian."""
    if grid.crs is None or not grid.crs.is_geographic:
        return (0.0,)
    turn = full_turn(grid)
    return -turn, 0.0, turn


def whole(grid: Grid) -> tuple[int, int, int, int]:
    """The window of all samples."""
    return 0, grid.rows, 0, grid.cols


def both(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The intersection of two windows; empty if they do not meet."""
    return max(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), min(a[3], b[3])


def box_window(grid: Grid, box: Box, turn: float = 0.0) -> tuple[int, int, int, int]:
    """The smallest window with all samples of a box in degrees."""
    west, south, east, north = box
    east = east if east > west else east + 360.0
    lon, lat = np.meshgrid(np.linspace(west, east, LATTICE), np.linspace(south, north, LATTICE))
    x, y = transformer(degrees_of(grid), grid.crs)(lon.ravel(), lat.ravel())
    if grid.crs is not None and grid.crs.is_geographic:  # unwrap longitudes
        full = full_turn(grid)
        x = x + np.round((lon.ravel() / 360.0 * full - x) / full) * full
    return window_of(grid, np.stack([x - turn, y], axis=-1))


def window_of(grid: Grid, points: Array) -> tuple[int, int, int, int]:
    """The smallest window with all samples between places (n, 2) in a grid's CRS; it may reach beyond the grid."""
    known = points[np.isfinite(points).all(1)]
    if not len(known):
        return 0, 0, 0, 0
    col, row = grid.index(known[:, 0], known[:, 1])
    return (
        math.ceil(row.min() - SAME), math.floor(row.max() + SAME) + 1,
        math.ceil(col.min() - SAME), math.floor(col.max() + SAME) + 1,
    )  # fmt: skip


def inside(polygons: Sequence[Sequence[Array]], transform: Affine, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which samples (rows, cols) have their centre in polygons."""
    from rasterio.features import rasterize

    shapes = [{"type": "Polygon", "coordinates": [ring.tolist() for ring in rings]} for rings in polygons]
    return np.asarray(rasterize(shapes, out_shape=shape, transform=transform, dtype="uint8"), bool)


def _dense(ring: Array) -> Array:
    """A closed ring with places between its corners, since straight lines are bent by projections."""
    closed = ring if np.array_equal(ring[0], ring[-1]) else np.concatenate([ring, ring[:1]])
    part = np.arange(STEPS)[:, None] / STEPS
    pieces = closed[:-1, None] + part * (closed[1:] - closed[:-1])[:, None]
    return np.concatenate([pieces.reshape(-1, 2), closed[-1:]])
