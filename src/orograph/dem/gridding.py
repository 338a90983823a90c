"""Scattered points as a raster: linear interpolation over their Delaunay triangulation, read by windows.

The terrain's grid is metric: points in degrees go to their UTM zone, as rasters do. Its rectangle of samples holds all
points; outside their hull, in slivers along it, and in triangles with a side longer than ``max_edge``, heights are
missing. The points stay with the terrain (``surface``): its samples are interpolated from them. Units: metres; samples.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from orograph.dem.delaunay import (
    Gridded,
    Surface,
    lattice_bits,
    on_lattice,
    sides,
    spacing_of,
    triangulate,
    without_slivers,
)
from orograph.dem.projection import flat_crs, geodetic_base, in_metres
from orograph.dem.scattered import Scattered, read_scattered
from orograph.dem.target import MAX_SIDE, parse_crs
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.progress import SILENT, Progress
from orograph.several import Numbers, numbers

LONG = 10
"""Triangle sides this many times the median are worth a warning."""

Array = NDArray[np.float64]


class PointRaster:
    """Points as a raster of heights (``store.source.HeightSource``).

    Attributes:
        grid, name, vertical: of the raster. warnings: messages for the user, full sentences.
        surface: the triangulation of the points, in sample coordinates; its triangles are those that count.
    """

    def __init__(
        self, points: Scattered, *, crs: str | CRS | None = None, resolution: float | None = None,
        max_edge: float | None = None,
    ) -> None:  # fmt: skip
        for called, length in (("resolution", resolution), ("max_edge", max_edge)):
            if length is not None and not (length > 0 and (math.isfinite(length) or called == "max_edge")):
                raise UsageError(f"`{called}` must be a length in metres, not {length}.")
        self.name, self.vertical, self.path = points.name, points.vertical, points.path
        self._options: dict[str, Any] | None = None
        self.warnings, self.notes = list(points.warnings), list[str]()
        x, y, flat = in_plane(points, None if crs is None else parse_crs(crs))
        if resolution is None:
            resolution = _usual(spacing_of(x, y), points)
            self.notes.append(
                f"{points.path}: {len(points):,} points, one to {resolution:g} × {resolution:g} m: gridded at that "
                "distance (`resolution`)"
            )
        self.grid = _grid(x, y, resolution, flat, points.path)
        self.bits = lattice_bits(*self.grid.shape)
        merged = on_lattice(*self.grid.index(x, y), points.z, self.bits)
        if merged.doubled:
            lie = "lies" if merged.doubled == 1 else "lie"
            self.warnings.append(
                f"Of its {len(points):,} points {merged.doubled:,} {lie} where another does; such points are merged "
                f"into one with their mean height (they differ by up to {merged.apart:.3g} m)."
            )
        surface = triangulate(merged, self.bits, points.path)
        self.surface = self._within(surface, max_edge)
        self._gridded = Gridded(self.surface)
        self._said = repr((self.grid.shape, tuple(self.grid.transform), self.name, self.vertical, max_edge))

    @classmethod
    def open(
        cls, path: str | os.PathLike[str], *, progress: Progress = SILENT, crs: str | CRS | None = None,
        resolution: Numbers | None = None, max_edge: Numbers | None = None, height_column: str | None = None,
        point_layer: str | None = None, point_classes: Sequence[int] | None = None, assume_crs: Any = None,
        vertical_unit: str | None = None, assume_vertical: str | None = None,
    ) -> PointRaster:  # fmt: skip
        """The points of a file as a raster.

        Args:
            crs: projected CRS of the terrain; by default the points' own, or their UTM zone.
            resolution: metres between samples; by default the mean distance of the points.
            max_edge: metres: triangles with a longer side are left out, and slivers along the rim
                (``delaunay.without_slivers``); None: slivers only; infinite: all count.
            height_column, point_layer, point_classes, assume_crs, vertical_unit, assume_vertical: as of
                ``read_scattered``.

        Raises:
            ReadError, UsageError: as ``read_scattered``; too few points, all on one line, or none left to count.
        """
        resolution, max_edge = _length(resolution, "resolution"), _length(max_edge, "max_edge")
        with progress.task("Reading points"):
            points = read_scattered(
                path, height_column=height_column, point_layer=point_layer, point_classes=point_classes,
                assume_crs=assume_crs, vertical_unit=vertical_unit, assume_vertical=assume_vertical,
            )  # fmt: skip
        with progress.task("Triangulating points"):
            made = cls(points, crs=crs, resolution=resolution, max_edge=max_edge)
        made._options = {
            "crs": _name(crs), "resolution": resolution, "max_edge": "inf" if max_edge == math.inf else max_edge,
            "height_column": height_column, "point_layer": point_layer,
            "point_classes": None if point_classes is None else list(point_classes), "assume_crs": _name(assume_crs),
            "vertical_unit": vertical_unit, "assume_vertical": assume_vertical,
        }  # fmt: skip
        for note in made.notes:
            progress.note(note)
        return made

    def made(self) -> dict[str, NDArray[Any]]:
        """The costly part of opening a file, for other processes (``taken_over``)."""
        grid = self.grid
        about = {
            "name": self.name, "vertical": self.vertical, "said": self._said, "bits": self.bits,
            "options": self._options, "shape": grid.shape, "transform": tuple(grid.transform)[:6],
            "crs": None if grid.crs is None else grid.crs.to_wkt(),
        }  # fmt: skip
        s = self.surface
        return {
            "about": np.frombuffer(json.dumps(about).encode(), np.uint8), "x": s.x, "y": s.y, "z": s.z,
            "triangles": s.triangles,
        }  # fmt: skip

    @classmethod
    def taken_over(cls, made: Mapping[str, NDArray[Any]], path: str) -> PointRaster:
        """The raster that another process made from a file, whose path in this process is ``path``."""
        about = json.loads(made["about"].tobytes())
        found = object.__new__(cls)
        found.path, found.name, found.vertical = path, about["name"], about["vertical"]
        found.bits, found._said, found._options = about["bits"], about["said"], about["options"]
        found.warnings, found.notes = [], []
        crs = None if about["crs"] is None else CRS.from_wkt(about["crs"])
        found.grid = Grid(tuple(about["shape"]), Affine(*about["transform"]), crs)
        found.surface = Surface(made["x"], made["y"], made["z"], made["triangles"], found.bits)
        found._gridded = Gridded(found.surface)
        return found

    @property
    def windows(self) -> list[tuple[int, int, int, int]]:
        """The rows and columns (half-open) that its file affects: all, since one point may change any triangle."""
        rows, cols = self.grid.shape
        return [(0, rows, 0, cols)]

    def recipe(self) -> tuple[list[str], dict[str, Any]] | None:
        """Path and options with which ``open`` makes the same raster again; None if it was made otherwise."""
        if self._options is None:
            return None
        return [self.path], {k: v for k, v in self._options.items() if v is not None}

    def _within(self, surface: Surface, max_edge: float | None) -> Surface:
        """The triangles that count."""
        whole = len(surface.triangles)
        if max_edge != math.inf:
            surface = surface._replace(triangles=without_slivers(surface))
            slivers = whole - len(surface.triangles)
            if slivers:
                self.notes.append(
                    f"{self.path}: {slivers:,} of {whole:,} triangles are slivers along the rim and left out"
                )
        longest = sides(surface, self.grid.spacing)
        usual, most = float(np.median(longest)), float(longest.max())
        if max_edge is None:
            if most > LONG * usual:
                self.notes.append(
                    f"{self.path}: triangles have sides of up to {_metres(most)}, half of them of at most "
                    f"{_metres(usual)}; `max_edge` leaves the longer ones out"
                )
            return surface
        keep = longest <= max_edge
        if not keep.any():
            raise UsageError(
                f"No triangle has sides of at most {max_edge:g} m.", path=self.path,
                remedy=f"Half of them have sides of up to {usual:.4g} m; allow longer ones (`max_edge`).",
            )  # fmt: skip
        if not keep.all():
            self.notes.append(
                f"{self.path}: {int((~keep).sum()):,} of {len(keep):,} triangles have a side longer than {max_edge:g} "
                "m and are left out"
            )
        return surface._replace(triangles=np.ascontiguousarray(surface.triangles[keep]))

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        """Heights of a half-open window, float32 metres, NaN where missing, the same whatever the window."""
        return self._gridded.read(row0, row1, col0, col1)

    def heights_at(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Heights (n,) at places (n,) in the grid's CRS: of the Delaunay surface itself; NaN where there is none."""
        return self._gridded.at(*self.grid.index(np.atleast_1d(x), np.atleast_1d(y)))

    def fingerprint(self) -> str:
        """Differs whenever any height might differ."""
        digest = hashlib.sha256(self._said.encode())
        for array in self.surface[:4]:
            digest.update(np.ascontiguousarray(array).view(np.uint8).data)
        return digest.hexdigest()[:32]


def _name(crs: Any) -> str | None:
    """A CRS as text."""
    return None if crs is None else CRS.from_user_input(crs).to_string()


def _metres(length: float) -> str:
    """A length in words, to three digits or to the metre."""
    return f"{length:,.0f} m" if length >= 100 else f"{length:.3g} m"


def in_plane(points: Scattered, wanted: CRS | None) -> tuple[Array, Array, CRS | None]:
    """Places in a projected CRS in metres, and the CRS: the requested one, else the points' own or their UTM zone."""
    from orograph.geo.transform import transformer

    own = points.crs
    if own is None:
        if wanted is not None:
            raise UsageError(
                "The points have no CRS, so they cannot be transformed to another.", path=points.path,
                remedy="Give theirs: `assume_crs`.",
            )  # fmt: skip
        return points.x, points.y, None
    if wanted is None:
        if own.is_projected:
            wanted = in_metres(own)[0]
        else:
            base = geodetic_base(own)
            wanted = flat_crs(base, *transformer(own, base)(points.x, points.y)).crs
    x, y = transformer(own, wanted)(points.x, points.y)
    if not (np.isfinite(x) & np.isfinite(y)).all():
        count = int((~(np.isfinite(x) & np.isfinite(y))).sum())
        raise ReadError(
            f"{count:,} of its points lie outside the domain of {wanted.name}.", path=points.path,
            remedy="Check that longitude and latitude are not swapped, or choose another `crs`.",
        )  # fmt: skip
    return x, y, wanted


def _usual(spacing: float, points: Scattered) -> float:
    """A distance rounded to two digits."""
    return float(f"{spacing:.2g}") if spacing > 0 else 1.0


def _length(given: Numbers | None, called: str) -> float | None:
    """A length as users give it."""
    return None if given is None else numbers(given, called)[0]


def _grid(x: Array, y: Array, resolution: float, crs: CRS | None, path: str) -> Grid:
    """The grid whose rectangle of samples holds all points, samples on multiples of the resolution."""
    left, right = math.floor(x.min() / resolution), math.ceil(x.max() / resolution)
    bottom, top = math.floor(y.min() / resolution), math.ceil(y.max() / resolution)
    shape = max(top - bottom, 1) + 1, max(right - left, 1) + 1
    if max(shape) > MAX_SIDE:
        raise UsageError(
            f"The terrain would have {shape[0]} × {shape[1]} samples, {resolution:g} m apart.", path=path,
            remedy="Give a coarser `resolution`, or leave out distant points.",
        )  # fmt: skip
    half = resolution / 2
    return Grid(
        shape,
        Affine(resolution, 0, left * resolution - half, 0, -resolution, max(top, bottom + 1) * resolution + half),
        crs,
    )
