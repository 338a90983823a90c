"""``orograph.contours``: contour lines as vectors."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from orograph._named import answering
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.geo.vector_files import Batch, check_vector_file, vector_file
from orograph.measuring.isolines import isolines
from orograph.output import check_folder
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.scene.contours import Contours, round_number
from orograph.several import Numbers, numbers
from orograph.store.given import check_apart
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]

SOME = 20
"""About how many levels there are if no interval is given."""
MOST = 100_000
"""Maximum number of levels."""
COLUMNS = {"height": np.float64, "is_index": np.bool_}
"""The attributes of lines in files."""


@dataclass(frozen=True)
class ContourLines:
    """Contour lines of a terrain. Shapely, geopandas and others read them through ``__geo_interface__``.

    Attributes:
        coordinates: (n, 2) float64, easting and northing of all points, line by line.
        offsets: (m + 1,) int64: line i is coordinates[offsets[i]:offsets[i + 1]]; the last point of a ring is its
            first. On the map higher ground is on a line's left.
        heights: (m,) float64, metres. is_index: (m,) bool: index contours.
        interval: metres; None where levels were given. crs: of the coordinates, or None. vertical: the datum of the
            heights, or None. name: of the terrain.
    """

    coordinates: Array
    offsets: NDArray[np.int64]
    heights: Array
    is_index: NDArray[np.bool_]
    interval: float | None
    crs: CRS | None
    vertical: str | None
    name: str

    def __len__(self) -> int:
        return len(self.heights)

    @cached_property
    def lines(self) -> list[Array]:
        """Each line's points (k, 2)."""
        return np.split(self.coordinates, self.offsets[1:-1]) if len(self) else []

    @property
    def closed(self) -> NDArray[np.bool_]:
        """(m,): whether each line is a ring; all others end at the border or at missing ground."""
        first, last = self.coordinates[self.offsets[:-1]], self.coordinates[self.offsets[1:] - 1]
        return np.asarray((first == last).all(1))

    @property
    def __geo_interface__(self) -> dict[str, Any]:
        """A GeoJSON-like FeatureCollection, in the terrain's CRS."""
        features = [
            {"type": "Feature", "properties": {"height": height, "is_index": index},
             "geometry": {"type": "LineString", "coordinates": line.tolist()}}
            for line, height, index in zip(self.lines, self.heights.tolist(), self.is_index.tolist())
        ]  # fmt: skip
        return {"type": "FeatureCollection", "features": features}

    def to_geodataframe(self) -> Any:
        """A ``geopandas.GeoDataFrame`` with the columns ``height`` (metres) and ``is_index``.

        Raises:
            UsageError: geopandas is not installed.
        """
        try:
            import geopandas
            import shapely
        except ImportError as error:
            raise UsageError("geopandas is not installed.", remedy="Run pip install geopandas.") from error
        ragged = shapely.GeometryType.LINESTRING, self.coordinates, (self.offsets,)
        shapes = shapely.from_ragged_array(*ragged) if len(self) else []
        return geopandas.GeoDataFrame(
            {"height": self.heights, "is_index": self.is_index}, geometry=shapes, crs=self.crs
        )  # fmt: skip

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the lines on matplotlib's axes, index contours twice as wide; ``style``: of ``LineCollection``."""
        from matplotlib import pyplot
        from matplotlib.collections import LineCollection

        ax = pyplot.subplots()[1] if ax is None else ax
        width = style.pop("linewidth", 0.5)
        how = {"colors": [Contours().color], "linewidths": np.where(self.is_index, 2 * width, width), **style}
        ax.add_collection(LineCollection(self.lines, **how))
        ax.autoscale_view()
        ax.set_aspect("equal")
        return ax

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write them: .gpkg, .geojson, .shp, .parquet or .fgb.

        Raises:
            UsageError: lines cannot be written to such a file. OutputError: it cannot be written.
        """
        out = Path(path)
        check_vector_file(out, self.crs)
        with vector_file(out, self.crs, dict(COLUMNS)) as write:
            if len(self):
                write(Batch(self.coordinates, self.offsets, {"height": self.heights, "is_index": self.is_index}))
        return out

    def __repr__(self) -> str:
        how = "" if self.interval is None else f" every {self.interval:g} m,"
        heights = f"{self.heights[0]:g} to {self.heights[-1]:g} m" if len(self) else "none"
        return f"<ContourLines of {self.name!r}:{how} {heights}, {len(self):,} lines, {len(self.coordinates):,} points>"


@dataclass(frozen=True, slots=True)
class Written:
    """What was written to a file: the interval (None: levels were given), number of lines and points, lowest and
    highest level."""

    path: Path
    interval: float | None
    lines: int
    points: int
    lowest: float | None
    highest: float | None


@answering
def contours(
    terrain: Any,
    interval: float | None = None,
    *,
    levels: Numbers | None = None,
    base: float = 0.0,
    index: int = 5,
    simplify: float = 0.0,
    output: str | os.PathLike[str] | None = None,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Any:
    """Contour lines of a terrain as vectors, in its CRS.

    They are isolines of the surface that pictures draw and measurements are made on, at full resolution. Rings are
    closed; other lines end at the border of the terrain or at missing ground. On the map higher ground is on a line's
    left.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        interval: distance between levels, metres; None: a round number that gives about twenty levels.
        levels: instead: heights in metres.
        base: the height that levels are counted from.
        index: every index-th level is an index contour; 0: none. With ``levels`` there are none.
        simplify: how far a line may be displaced, metres; 0: not at all. Lines closer to each other than twice that may
            meet.
        output: write them to this file instead, out of core: .gpkg, .geojson (in longitude and latitude), .shp,
            .parquet or .fgb, with the attributes ``height`` (metres) and ``is_index``.
        max_memory: bytes that heights, and lines not yet written, may take. jobs: threads. Neither changes the lines.
        progress: gets progress reports; False: silent.

    Returns:
        a ``geopandas.GeoDataFrame`` with the columns ``height`` and ``is_index`` where geopandas is installed, else
        ``ContourLines``, which has ``__geo_interface__``; with ``output`` the path.

    Raises:
        UsageError: an option makes no sense. ReadError, StoreError: the terrain cannot be read. OutputError: the file
            cannot be written.
    """
    found = traced(
        terrain, interval, levels=levels, base=base, index=index, simplify=simplify, output=output,
        max_memory=max_memory, jobs=jobs, progress=progress, **reading,
    )  # fmt: skip
    if isinstance(found, Written):
        return found.path
    try:
        return found.to_geodataframe()
    except UsageError:
        return found


def traced(
    terrain: Any, interval: float | None = None, *, levels: Numbers | None = None, base: float = 0.0, index: int = 5,
    simplify: float = 0.0, output: str | os.PathLike[str] | None = None, max_memory: Amount | None = None,
    jobs: int | None = None, progress: Progress | bool | None = None, **reading: Any,
) -> ContourLines | Written:  # fmt: skip
    """As ``contours``, whatever is installed: the lines, or a summary of the file written."""
    max_memory = bytes_of(max_memory)
    interval = None if interval is None else _number(interval, "interval")
    base, simplify = _number(base, "base"), _number(simplify, "simplify")
    if interval is not None and levels is not None:
        raise UsageError("`interval` and `levels` say the same twice: give one of them.")
    if not (math.isfinite(simplify) and simplify >= 0):
        raise UsageError(f"`simplify` must be 0 or more metres, not {simplify:g}.")
    Contours(interval, index)  # checks both
    heard = reporting(progress)
    if output is not None:
        check_folder(Path(output))
        check_apart(output, terrain)
        check_vector_file(Path(output), CRS.from_epsg(4326))
    ground = opened(terrain, heard, max_memory=max_memory, jobs=jobs, called="contours", **reading)
    chosen, marked, interval = levels_of(ground, interval, levels, base, index)
    limit = None if output is None else (max_memory or 1 << 30) // 2
    batches = isolines(ground, chosen, max_memory=limit, simplify=simplify, jobs=jobs, progress=heard)
    made: Iterator[Batch] = (
        Batch(one.points, one.offsets, {"height": chosen[one.level], "is_index": marked[one.level]}) for one in batches
    )
    if output is not None:
        return _written(ground, made, interval, Path(output))
    every = list(made) or [
        Batch(np.empty((0, 2)), np.zeros(1, np.int64), {k: np.empty(0, v) for k, v in COLUMNS.items()})
    ]
    (whole,) = every  # without a limit, all at once
    return ContourLines(
        whole.points, whole.offsets, whole.columns["height"], whole.columns["is_index"], interval, ground.grid.crs,
        ground.vertical, ground.name,
    )  # fmt: skip


def _number(value: Any, called: str) -> float:
    """A number, or the text of one.

    Raises:
        UsageError: it is not a number.
    """
    found = numbers(value, called)
    if len(found) != 1:
        raise UsageError(f"`{called}` must be a number of metres, not {value!r}.")
    return found[0]


def _written(ground: Terrain, batches: Iterator[Batch], interval: float | None, path: Path) -> Written:
    check_vector_file(path, ground.grid.crs)
    lines = points = 0
    heights: list[float] = []
    with vector_file(path, ground.grid.crs, dict(COLUMNS)) as write:
        for batch in batches:
            write(batch)
            lines, points = lines + len(batch.offsets) - 1, points + len(batch.points)
            heights += [float(batch.columns["height"][0]), float(batch.columns["height"][-1])]
    return Written(path, interval, lines, points, min(heights, default=None), max(heights, default=None))


def levels_of(
    terrain: Terrain, interval: float | None, levels: Numbers | None, base: float, index: int
) -> tuple[Array, NDArray[np.bool_], float | None]:
    """The heights of the lines, ascending; which of them are index contours; and the interval.

    Raises:
        UsageError: they are not heights, or too many.
    """
    low, high = terrain.height_range
    if levels is not None:
        chosen = np.unique(np.array(numbers(levels, "levels"), np.float64))
        if not len(chosen) or not np.isfinite(chosen).all():
            raise UsageError(f"`levels` must be heights in metres, not {levels!r}.")
        return chosen, np.zeros(len(chosen), np.bool_), None
    if not math.isfinite(base):
        raise UsageError(f"`base` must be a height in metres, not {base:g}.")
    if interval is None:
        interval = round_number((high - low) / SOME) if high > low else 1.0
    if not high >= low:
        return np.empty(0), np.empty(0, np.bool_), interval
    first, last = math.ceil((low - base) / interval), math.floor((high - base) / interval)
    if last - first >= MOST:
        raise UsageError(
            f"Between {low:g} and {high:g} m lie {last - first + 1:,} levels {interval:g} m apart; {MOST:,} are the "
            "most that are traced.", remedy="Give a larger `interval`.",
        )  # fmt: skip
    number = np.arange(first, last + 1)
    marked = np.asarray(number % index == 0) if index else np.zeros(len(number), np.bool_)
    return np.asarray(base + number * float(interval), np.float64), marked, float(interval)
