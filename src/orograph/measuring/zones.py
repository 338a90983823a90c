"""Zonal statistics: areas, heights and slopes of all polygons of a file, one after the other.

Areas are those of ``area``, on the true surface. Heights and slopes are those of the terrain's samples whose place lies
in the polygon, as zonal statistics of GIS are; a sample stands for its cell. Slopes are central differences, as for
``light`` ("slope"), in true metres: with the grid's gradient g and the projection's metric G, tan² slope = gᵀ G⁻¹ g,
G bilinear on a lattice of at most ``LATTICE`` metres. Windows of samples are read one by one; quantiles are exact
(``order``), so memory grows with nothing. Units: metres, metres², degrees.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.geo.geojson import crs_name, lines, load
from orograph.lighting.normal import gradient
from orograph.lighting.raster import rectangles
from orograph.measuring.area import LATTICE, Area, area, split
from orograph.measuring.geojson import Geometry, is_geometry, moved
from orograph.measuring.height_error import around
from orograph.measuring.order import Floats, quantiles, upper_counts
from orograph.measuring.places import Places
from orograph.output import Beside
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.opening import takes_terrain
from orograph.store.terrain import TILE, Terrain

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]

STEEP = 30.0
"""Default slope that ``Zone.steeper`` counts from, degrees."""
NODES = 33
"""Maximum nodes of the metric's lattice along a window."""
ENDINGS = (".csv", ".geojson", ".json")
NAMES = ("name", "label", "title", "id")
"""Properties that may name a polygon, in lower case, the first that there is."""


@dataclass(frozen=True, slots=True)
class Zone:
    """The statistics of a polygon.

    Attributes:
        name: its name in the file, else its number, from 1. properties: those of the file.
        area: its areas, and volumes; of several parts the sums. None if it cannot be measured: ``problem`` says why.
        samples: how many of them are in it; known: how many have a height.
        lowest, highest, mean, std: of their heights, metres. None without any.
        slope_mean, slope_median, slope_90: of their slopes, degrees; the last is the 90th percentile.
        steeper: the share of them above ``steeper_than`` degrees, 0 to 1.
    """

    name: str
    properties: dict[str, Any]
    area: Area | None
    samples: int = 0
    known: int = 0
    lowest: float | None = None
    highest: float | None = None
    mean: float | None = None
    std: float | None = None
    slope_mean: float | None = None
    slope_median: float | None = None
    slope_90: float | None = None
    steeper: float | None = None
    steeper_than: float = STEEP
    problem: str = ""

    def to_dict(self) -> dict[str, Any]:
        """For JSON: names with units."""
        none: dict[str, Any] = dict.fromkeys(Area(0, 0, 0, 0, 0, 0, 0, None).to_dict())
        measured = none if self.area is None else self.area.to_dict()
        own = {"lowest_m": self.lowest, "highest_m": self.highest, "sample_mean_m": self.mean, "sample_std_m": self.std,
               "slope_mean_deg": self.slope_mean, "slope_median_deg": self.slope_median,
               "slope_90_deg": self.slope_90, "steeper_share": self.steeper, "steeper_than_deg": self.steeper_than,
               "samples": self.samples, "samples_known": self.known}  # fmt: skip
        return {"name": self.name, **measured, **own, **({"problem": self.problem} if self.problem else {})}


class Zones(Sequence[Zone]):
    """The polygons of a file, measured: a sequence of ``Zone``."""

    def __init__(self, found: Sequence[Zone], geometries: Sequence[dict[str, Any]]) -> None:
        self._found, self._geometries = tuple(found), tuple(geometries)

    def __getitem__(self, k: Any) -> Any:
        return self._found[k]

    def __len__(self) -> int:
        return len(self._found)

    def __repr__(self) -> str:
        polygons = "1 polygon" if len(self) == 1 else f"{len(self)} polygons"
        return f"<Zones: {polygons}, {sum(one.area is not None for one in self)} measured>"

    def rows(self) -> list[dict[str, Any]]:
        """A record for each polygon: its name, the file's properties (unless named alike), and the measures."""
        made = [{**one.properties, **one.to_dict()} for one in self]
        names = dict.fromkeys(name for row in made for name in ("name", *row))
        return [{name: row.get(name) for name in names} for row in made]

    def to_dataframe(self) -> Any:
        """``rows`` as a DataFrame of pandas."""
        import importlib

        return importlib.import_module("pandas").DataFrame(self.rows())

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write ``rows``: .csv; .json, a list; .geojson, with the polygons as longitude and latitude.

        Raises:
            UsageError: another ending. OutputError: the file cannot be written.
        """
        out = Path(path)
        check_zones_file(out)
        rows = self.rows()
        with Beside(out) as part, part.open("w", encoding="utf-8", newline="") as file:
            if out.suffix.lower() == ".csv":
                table = csv.DictWriter(file, list(rows[0]))
                table.writeheader()
                table.writerows(rows)
            else:
                document: Any = rows
                if out.suffix.lower() == ".geojson":
                    pairs = zip(rows, self._geometries)
                    shapes = [{"type": "Feature", "properties": row, "geometry": one} for row, one in pairs]
                    document = {"type": "FeatureCollection", "features": shapes}
                json.dump(document, file, allow_nan=False)
        return out


def check_zones_file(path: str | os.PathLike[str]) -> None:
    """Raise UsageError unless zones can be written to such a file."""
    if Path(path).suffix.lower() not in ENDINGS:
        raise UsageError("Areas are written as .csv, .geojson or .json.", path=path)


@takes_terrain
def areas(
    terrain: Terrain, zones: Geometry, *, level: float | None = None, steeper_than: float = STEEP,
    lonlat: bool = False, jobs: int | None = None, progress: Progress | bool | None = None,
) -> Zones:  # fmt: skip
    """Areas, heights and slopes of every polygon of a file: zonal statistics.

    Args:
        zones: GeoJSON with polygons: a file, a mapping, or an object with ``__geo_interface__`` (a GeoDataFrame); or
            one polygon, as for ``area``, with its ``lonlat``.
        level: also find volumes above and below it, metres.
        steeper_than: degrees; the share of samples with a steeper slope is found.
        jobs: threads. progress: gets progress reports, and warnings of polygons that cannot be measured.

    Returns:
        a ``Zones``: a ``Zone`` for each feature with a polygon, in the file's order; ``rows()``, ``to_dataframe()``,
        ``save(path)``.

    Raises:
        ReadError: the GeoJSON cannot be read, or has no polygon.
        UsageError: no polygon can be measured, for instance because none lies on the terrain; an option makes no sense.
        DamagedChunkError: a chunk of a store fails its checksum.
    """
    if not 0 <= steeper_than < 90:
        raise UsageError(f"`steeper_than` must be from 0 to 90 degrees, not {steeper_than:g}.")
    places, heard = Places(terrain), reporting(progress)
    shapes = list(_shapes(zones, places)) if is_geometry(zones) else [_drawn(zones, places, lonlat)]
    found: list[Zone] = []
    for shape in shapes:
        try:
            parts = [area(terrain, rings, level=level, jobs=jobs, progress=heard) for rings in shape.parts]
        except UsageError as error:
            found.append(Zone(shape.name, shape.properties, None, steeper_than=steeper_than, problem=error.what))
            continue
        found.append(_zone(places, shape, _together(parts), steeper_than, jobs))
    wrong = [one for one in found if one.problem]
    if len(wrong) == len(found):
        raise UsageError(f"{wrong[0].name}: {wrong[0].problem}", remedy="Give polygons that lie on the terrain.")
    for one in wrong:
        heard.warn(f"{one.name} is not measured: {one.problem}")
    return Zones(found, [shape.geometry for shape in shapes])


class Shape(NamedTuple):
    """A feature: its polygons' rings in the terrain's CRS, and its geometry in degrees."""

    name: str
    properties: dict[str, Any]
    parts: list[list[Array]]
    geometry: dict[str, Any]


def _shapes(zones: Geometry, places: Places) -> Iterator[Shape]:
    data, called = load(zones)
    features = data.get("features") if data.get("type") == "FeatureCollection" else [data]
    count = 0
    for feature in features if isinstance(features, list) else []:
        own = feature.get("geometry") if feature.get("type") == "Feature" else feature
        kind = (own or {}).get("type")
        if kind not in ("Polygon", "MultiPolygon"):
            continue
        count += 1
        try:
            several = [own["coordinates"]] if kind == "Polygon" else own["coordinates"]
            plain = [lines(one) for one in several]
        except (KeyError, TypeError, ValueError) as error:
            raise ReadError(f"Polygon {count} has no list of coordinates.", path=called) from error
        parts = [moved(rings, data, places) for rings in plain]
        properties = dict(feature.get("properties") or {}) if feature.get("type") == "Feature" else {}
        geometry = own
        if crs_name(data) is not None:
            rings = [[np.asarray(places.lonlat(ring)).tolist() for ring in part] for part in parts]
            geometry = {"type": kind, "coordinates": rings[0] if kind == "Polygon" else rings}
        yield Shape(_name(properties, feature.get("id"), count), properties, parts, geometry)
    if not count:
        raise ReadError("It holds no polygon.", path=called, remedy="Give GeoJSON with polygons.")


def _drawn(polygon: Any, places: Places, lonlat: bool) -> Shape:
    """A polygon as ``area`` takes it."""
    rings = [places.points(ring, what="A polygon", lonlat=lonlat) for ring in split(polygon)]
    degrees = [places.lonlat(np.vstack([ring, ring[:1]])) for ring in rings]
    shown = [(rings[k] if ring is None else ring).tolist() for k, ring in enumerate(degrees)]
    return Shape("polygon", {}, [rings], {"type": "Polygon", "coordinates": shown})


def _name(properties: dict[str, Any], number: Any, count: int) -> str:
    lower = {str(key).lower(): value for key, value in properties.items()}
    named = next((lower[name] for name in NAMES if lower.get(name) not in (None, "")), number)
    return str(count if named is None else named)


def _together(parts: list[Area]) -> Area:
    """The sums of parts; their mean height by plan area of known ground."""
    if len(parts) == 1:
        return parts[0]
    sums = {one.name: sum(getattr(p, one.name) or 0.0 for p in parts) for one in fields(Area)}
    ground = [p.plan_grid - p.missing_grid for p in parts]
    heights = sum((p.mean_height or 0.0) * g for p, g in zip(parts, ground))
    sums |= {"mean_height": heights / sum(ground) if sum(ground) > 0 else None, "level": parts[0].level}
    if parts[0].level is None:
        sums |= {"above": None, "below": None}
    return Area(**sums)


def _zone(places: Places, shape: Shape, measured: Area, steep: float, jobs: int | None) -> Zone:
    """The statistics of the samples in a polygon."""
    terrain = places.terrain
    rings = [[places.samples(ring) for ring in part] for part in shape.parts]
    corners = np.concatenate([ring for part in rings for ring in part])
    (left, top), (right, bottom) = np.floor(corners.min(0)).astype(int), np.ceil(corners.max(0)).astype(int) + 1
    rows, cols = terrain.grid.shape
    windows = rectangles((min(bottom, rows) - top, min(right, cols) - left), TILE, TILE)
    boxes = [(r0 + top, r1 + top, c0 + left, c1 + left) for r0, r1, c0, c1 in windows]

    def slopes(box: Any) -> Floats:
        return _slopes(places, box, _inside(rings, box))

    samples, heights, upper = 0, Sums(), np.zeros(1 << 16, np.int64)
    total, over, sloped = 0.0, 0, 0
    for box in boxes:
        inside = _inside(rings, box)
        samples += int(inside.sum())
        z = terrain.read(0, *box)[inside]
        heights = heights.and_(z[~np.isnan(z)].astype(np.float64))
        slope = _slopes(places, box, inside)
        upper += upper_counts(slope)
        total += float(slope.sum(dtype=np.float64))
        over, sloped = over + int((slope > steep).sum()), sloped + len(slope)
    if not heights.known:
        return Zone(shape.name, shape.properties, measured, samples, steeper_than=steep)
    median, ninety = quantiles(boxes, slopes, upper, (0.5, 0.9), jobs)
    return Zone(
        shape.name, shape.properties, measured, samples, heights.known, heights.low, heights.high, heights.mean,
        math.sqrt(heights.squares / heights.known), total / sloped, median, ninety, over / sloped, steep,
    )  # fmt: skip


class Sums(NamedTuple):
    """Of numbers, block by block: their count, mean, sum of squared deviations from it, and extremes."""

    known: int = 0
    mean: float = 0.0
    squares: float = 0.0
    low: float = math.inf
    high: float = -math.inf

    def and_(self, more: Array) -> Sums:
        """With further numbers (Chan, Golub & LeVeque 1983)."""
        if not len(more):
            return self
        n, mean = len(more), float(more.mean())
        both, step = self.known + n, mean - self.mean
        squares = self.squares + float(((more - mean) ** 2).sum()) + step**2 * self.known * n / both
        low, high = min(self.low, float(more.min())), max(self.high, float(more.max()))
        return Sums(both, self.mean + step * n / both, squares, low, high)


def _inside(parts: list[list[Array]], box: Box) -> NDArray[np.bool_]:
    """Whether samples of a window lie in polygons given in sample coordinates."""
    from affine import Affine
    from rasterio.features import rasterize

    row0, row1, col0, col1 = box
    closed = [[[*ring.tolist(), ring[0].tolist()] for ring in part] for part in parts]
    shapes = [{"type": "Polygon", "coordinates": part} for part in closed]
    # (A pixel's middle is its sample; rasterize wants corners of pixels.)
    place = Affine.translation(col0 - 0.5, row0 - 0.5)
    found = rasterize(shapes, (row1 - row0, col1 - col0), transform=place, dtype=np.uint8)
    return np.asarray(found, bool)


def _slopes(places: Places, box: Box, inside: NDArray[np.bool_]) -> Floats:
    """The slopes (n,) of a window's samples in a polygon, degrees, without those of unknown height."""
    if not inside.any():
        return np.empty(0, np.float32)
    terrain = places.terrain
    heights, inner = around(terrain, *box)
    east, north = (part[inner].astype(np.float64) for part in gradient(heights, terrain.grid.linear, 1))
    a, b, c = _inverse(places, box)
    tangent = np.sqrt(np.maximum(a * east * east + 2 * b * east * north + c * north * north, 0.0)) + 0.0  # (no −0)
    found = np.degrees(np.arctan(tangent[inside])).astype(np.float32)
    return np.asarray(found[~np.isnan(found)])


def _inverse(places: Places, box: Box) -> tuple[Any, Any, Any]:
    """G⁻¹ at a window's samples: its entries 00, 01 and 11, (rows, cols) each."""
    if places.ellipsoid is None:
        return 1.0, 0.0, 1.0
    axes = []
    for start, stop, step in ((*box[:2], places.grid.spacing[1]), (*box[2:], places.grid.spacing[0])):
        nodes = np.linspace(start, stop - 1, min(max(2, math.ceil((stop - start) * step / LATTICE) + 1), NODES))
        at = np.interp(np.arange(start, stop), nodes, np.arange(len(nodes))) if stop - start > 1 else np.zeros(1)
        axes.append((nodes, np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(len(nodes))))))
    (down, by_row), (across, by_col) = axes
    x, y = places.grid.xy(*np.meshgrid(across, down))
    g = np.linalg.inv(places.metric(np.stack([x.ravel(), y.ravel()], -1))).reshape(*x.shape, 2, 2)
    return tuple(by_row @ g[..., i, j] @ by_col.T for i, j in ((0, 0), (0, 1), (1, 1)))
