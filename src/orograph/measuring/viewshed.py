"""Viewsheds: what an eye sees of the terrain, sample by sample, each with its own line of sight; exact, out of core.

Every sample within the radius is tested along the straight line from the eye, over the triangulated surface, at every
edge that the line crosses: R3 in the terms of Franklin & Ray (1994, *Higher isn't necessarily better*), but with a
pyramid of maxima (Tevs, Ihrke & Seidel 2008) that skips all ground well below the line, so that the cost of a line
grows with the roughness along it, not with its length. No line is interpolated from others (R2, XDraw, horizon sweeps).

The body is round and its air refracts as for a line of sight (``sight``): the apparent height of a sample d metres away
is z − c d²/2. d² is a quadratic form of the step in samples, by the projection's metric at the eye, times the ratio of
geodesic distance to that form, r, looked up on a lattice of ``LATTICE``² places over the window and bilinear between.
Heights are counted from the eye and divided by √r: light, whose height is proportional to true distance, then also runs
straight over the grid, where metres vary in length. Lines are straight on the grid (not geodesics), like those of
``sight``. Apparent heights are linear between samples: within c·cell²/8 (16 µm for cells of 30 m) of ground that is
straight on the round body. If they do not fit in a third of the allowed memory they go to a mapped scratch file, 5.4
bytes per sample; other memory does not depend on the terrain's size.

Units: metres above the ground for eye and targets. Results: 1 visible, 0 hidden, NaN unknown (missing, or too far); or
with ``heights`` how many metres above the ground a target must be to be visible (0 where the ground is visible).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.cards import extent_rows, one_line
from orograph.compiling import expect
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.geo.grid import Grid
from orograph.lighting.raster import Band, rectangles, write
from orograph.measuring.ground import heights as surface
from orograph.measuring.places import Places
from orograph.measuring.sight import LEAST, REFRACTION, bend_of, check_heights
from orograph.measuring.viewshed_scene import Scene, scene_of, window_within
from orograph.parallel import map_ordered, threads_for
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.opening import takes_terrain
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    import xarray as xr

Values = NDArray[np.float32]

BLOCK = 256
RELEASE = 8
"""Blocks after which the scratch file's pages are released (they stay in the system's cache)."""
MEMORY = 1 << 30
SEEN = Band("visible", "1", "1: seen from the eye, 0: hidden; missing where no height is known or beyond the radius")
NEEDED = Band("height needed", "m", "how high above the ground a target must be to be seen; 0: the ground itself is")


@dataclass(frozen=True, repr=False)
class Viewshed:
    """What an eye sees; made with ``viewshed``, computed on demand.

    Attributes:
        grid: of the result: the terrain's, or its part within the radius.
        row, col: the first sample of ``grid`` in the terrain.
        point: (easting, northing) of the eye; ground: the height of the ground there; eye, target: metres above it.
        radius: metres, true; None: no limit. bend: c, per metre.
        heights: whether the values are heights needed instead of 0 and 1.
        quantum: resolution of apparent heights, metres.
        on_disk: whether they are in a scratch file.
    """

    grid: Grid
    row: int
    col: int
    point: tuple[float, float]
    ground: float
    eye: float
    target: float
    radius: float | None
    bend: float
    heights: bool
    quantum: float
    on_disk: bool
    _scene: Scene = field(repr=False)

    def __repr__(self) -> str:
        x, y = self.point
        return one_line(
            "Viewshed", f"from {x:.10g}, {y:.10g}", [("eye", f"eye {self.eye:g} m"), *extent_rows(self.grid)]
        )

    def summary(self, progress: Progress | bool | None = None) -> dict[str, float]:
        """How much is visible, without keeping the values (see ``Summary.result``)."""
        counted = Summary(self)
        for _ in counted.over(self.blocks(progress)):
            pass
        return counted.result()

    def to_xarray(self) -> xr.DataArray:
        """``values`` as a DataArray with the dimensions y, x."""
        from orograph.lighting.api import Map

        return Map(self.values()[None], self.grid, (self.band,)).to_xarray()

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draw ``values`` on matplotlib's axes, where they lie in their CRS (``Map.plot``)."""
        from orograph.lighting.api import Map

        return Map(self.values()[None], self.grid, (self.band,)).plot(ax, **options)

    @property
    def band(self) -> Band:
        """The meaning of the values, for a file."""
        return NEEDED if self.heights else SEEN

    def blocks(self, progress: Progress | bool | None = None) -> Iterator[tuple[int, int, Values]]:
        """Compute the samples block by block: (first row, first column, values (rows, cols) float32), once each."""
        windows = list(rectangles(self.grid.shape, BLOCK, BLOCK))
        with reporting(progress).task("Looking at the ground", total=len(windows)) as task:
            for k, made in enumerate(map_ordered(self._block, windows, self._scene.jobs)):
                yield made
                task.advance()
                if self._scene.release is not None and k % RELEASE == RELEASE - 1:
                    self._scene.release()

    def values(self, progress: Progress | bool | None = None) -> Values:
        """All of it in memory: (rows, cols) float32."""
        out = np.empty(self.grid.shape, np.float32)
        for row, col, values in self.blocks(progress):
            out[row : row + values.shape[0], col : col + values.shape[1]] = values
        return out

    def save(self, path: str | os.PathLike[str], progress: Progress | bool | None = None) -> dict[str, float]:
        """Write it, and return how much is visible (``summary``).

        Args:
            path: .tif: a Cloud Optimized GeoTIFF of float32. .gpkg, .geojson, .shp, .parquet, .fgb: the visible ground
                as polygons, with their areas on the grid (``grid_m2``).

        Raises:
            UsageError: there is another ending, or ``heights`` are to be polygons. OutputError: it cannot be written.
        """
        from orograph.lighting.sweep import curvature_of
        from orograph.measuring.viewshed_polygons import check_polygons, save_polygons

        counted = Summary(self)
        if check_polygons(Path(path), self.heights, self.grid.crs):
            save_polygons(Path(path), self.grid, counted.over(self.blocks(progress)))
            return counted.result()
        tags = {
            "software": "orograph", "measure": "viewshed", "eye": f"{self.point[0]:.10g}, {self.point[1]:.10g}",
            "eye_height": f"{self.eye:g} m", "target_height": f"{self.target:g} m",
            "radius": "unlimited" if self.radius is None else f"{self.radius:g} m",
            "refraction": f"{1 - self.bend / curvature_of(self.grid.crs, 0.0):.3f}" if self.bend else "flat",
        }  # fmt: skip
        blocks = ((0, row, col, values[None]) for row, col, values in counted.over(self.blocks(progress)))
        overviews = "average" if self.heights else "nearest"
        write(path, self.grid, [self.band], blocks, overviews=overviews, tags=tags, jobs=self._scene.jobs,
              progress=reporting(progress))  # fmt: skip
        return counted.result()

    def beyond(self, row: int, col: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Which samples of a block of ``grid`` lie beyond the radius."""
        if self.radius is None:
            return np.zeros(shape, np.bool_)
        r, c = row + self.row - self._scene.row, col + self.col - self._scene.col
        return np.asarray(self._scene.distance2(r, r + shape[0], c, c + shape[1]) > self.radius**2)

    def _block(self, window: tuple[int, int, int, int]) -> tuple[int, int, Values]:
        from orograph.measuring.viewshed_kernels import look

        row, _, col, _ = window
        s = self._scene
        dr, dc = self.row - s.row, self.col - s.col
        window = (window[0] + dr, window[1] + dr, window[2] + dc, window[3] + dc)
        out = np.empty((window[1] - window[0], window[3] - window[2]), np.float32)
        per = 1.0 / self.quantum
        far = None
        if self.radius is not None:
            far = self.beyond(row, col, out.shape)
            if far.all():
                out[:] = np.nan
                return row, col, out
        look(
            s.pyramid, s.x, s.y, 0.0 if self.heights else self.target * per, np.sqrt(s.ratios(*window)),
            max(LEAST * per, 4.0), not self.heights, window, out,
        )  # fmt: skip
        if self.heights:
            out *= np.float32(self.quantum)
        if far is not None:
            out[far] = np.nan
        return row, col, out


class Summary:
    """Counts visible samples while blocks pass by."""

    def __init__(self, shed: Viewshed) -> None:
        self.cell = shed.grid.cell_area
        self.heights = shed.heights
        self.seen = self.known = 0

    def over(self, blocks: Iterator[tuple[int, int, Values]]) -> Iterator[tuple[int, int, Values]]:
        """The same blocks, counted."""
        for row, col, values in blocks:
            self.known += int(np.isfinite(values).sum())
            self.seen += int((values <= 0).sum() if self.heights else (values > 0).sum())
            yield row, col, values

    def result(self) -> dict[str, float]:
        """Number of samples tested and visible, the visible fraction, and the visible area on the grid, m²."""
        return {
            "samples": self.known, "seen": self.seen, "seen_fraction": self.seen / max(self.known, 1),
            "seen_grid_m2": self.seen * self.cell,
        }  # fmt: skip


@takes_terrain
def viewshed(
    terrain: Terrain,
    point: ArrayLike,
    eye: float = 1.7,
    target: float = 0.0,
    *,
    radius: float | None = None,
    flat: bool = False,
    refraction: float = REFRACTION,
    heights: bool = False,
    lonlat: bool = False,
    max_memory: Amount = MEMORY,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
) -> Viewshed:
    """The samples that are visible from a point.

    Args:
        point: easting and northing of the eye, anywhere on the terrain.
        eye, target: metres above the ground.
        radius: true metres beyond which samples are ignored; None: all of the terrain.
        flat, refraction: as for ``line_of_sight``.
        heights: find the height that a target needs to be visible at each sample, instead of whether it is.
        lonlat: the point is longitude and latitude, degrees.
        max_memory: bytes; apparent heights that take more than a third of them go to a scratch file.

    Returns:
        a ``Viewshed``; ``values()`` or ``save(path)`` compute it.

    Raises:
        UsageError: the point is not on the terrain or in a hole; a height or the radius is negative.
        OutputError: the temporary folder has no room. DamagedChunkError: a chunk of a store fails its checksum.
    """
    max_memory = bytes_of(max_memory)
    check_heights(**{"eye's height": eye, "target's height": target})
    if radius is not None and not (radius > 0 and math.isfinite(radius)):
        raise UsageError(f"The radius must be a positive number of metres, not {radius!r}.")
    if heights and target:
        raise UsageError(
            "With `heights`, which asks for the heights that targets need, a target's height has no meaning."
        )
    expect("viewshed")
    places = Places(terrain)
    points = places.points(point, lonlat=lonlat)
    if len(points) != 1:
        raise UsageError(f"A viewshed takes one point, not {len(points)}.")
    x, y = places.samples(points)[0]
    ground = float(surface(terrain, np.array([x]), np.array([y]))[0])
    if math.isnan(ground):
        raise UsageError(
            f"The point {points[0][0]:.10g}, {points[0][1]:.10g} is in a hole: no ground is known there.",
            remedy="Choose another point.",
        )
    bend = bend_of(places, points[0], flat, refraction)
    row0, row1, col0, col1 = window_within(places, points[0], x, y, radius)
    frame = (row0 & ~1, min(row1 + 1, terrain.grid.rows), col0 & ~1, min(col1 + 1, terrain.grid.cols))
    heard, threads = reporting(progress), threads_for(jobs)
    scene, quantum, on_disk = scene_of(places, points[0], (x, y), ground, eye, bend, frame, max_memory, threads, heard)
    return Viewshed(
        terrain.grid.window(row0, row1, col0, col1), row0, col0, (float(points[0][0]), float(points[0][1])), ground,
        float(eye), float(target), radius, bend, heights, quantum, on_disk, scene,
    )  # fmt: skip
