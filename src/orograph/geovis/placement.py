"""Where an image lies under a terrain: positions in the terrain's CRS → pixels of the image, whatever its CRS.

Positions are projected exactly (pyproj) on a lattice over the terrain and interpolated bilinearly between, the lattice
being refined until its error, measured between its nodes, is below ``TOLERANCE`` of an image pixel. Units: the CRSs'
own; image positions in pixels from its upper left corner.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph._numba import kernel
from orograph.errors import UsageError
from orograph.geo.grid import Grid, apply, compose

Array = NDArray[np.float64]

TOLERANCE = 0.04
"""Image pixels the interpolated positions may be off by."""

MOST_NODES = 1025
"""Nodes along a side of the finest lattice."""

CELL = 4096
"""Image pixels that a cell of the lattice spans at most (unless it has ``MOST_NODES``): in single precision a position
within it is good to a thousandth of a pixel."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Where an image lies.

    Attributes:
        grid: the terrain's. image: the image's, in its own CRS (the terrain's, where it has none).
        turn: a full turn of longitude in the units of the image's x, 0 if that is no longitude.
        stretched: it has no place of its own and covers the terrain's extent.
        middle: the terrain's, as x in the image's CRS; needed where ``turn`` is not 0.
        undeclared: the image names no CRS, and its coordinates are taken as the terrain's.
    """

    grid: Grid
    image: Grid
    turn: float
    stretched: bool
    middle: float = 0.0
    undeclared: bool = False
    _local: threading.local = field(default_factory=threading.local, repr=False, compare=False)

    @classmethod
    def of(cls, grid: Grid, image: Grid, path: str, warnings: list[str]) -> Placement:
        """Place an image as its file says, or over the terrain's extent if it says nothing.

        Raises:
            UsageError: there is no way between the two CRSs (another planet).
        """
        if image.crs is None and image.transform == Affine.identity():
            rows, cols = image.shape
            fit = compose(grid.transform, Affine.scale(grid.cols / cols, grid.rows / rows))
            warnings.append(f"{path} has no georeference: it is stretched over the terrain's extent, north up.")
            return cls(grid, Grid(image.shape, fit, grid.crs), 0.0, True)
        if image.crs is None or grid.crs is None:
            whose = "The image" if image.crs is None else "The terrain"
            warnings.append(f"{whose} has no CRS: the coordinates of {path} are taken as the terrain's own.")
            own = Grid(image.shape, image.transform, grid.crs)
            return cls(grid, own, 0.0, False, undeclared=image.crs is None)
        placement = cls(grid, image, 0.0, False)
        try:
            x, _ = placement.projected(*grid.xy((grid.cols - 1) / 2, (grid.rows - 1) / 2))
        except UsageError as error:
            raise UsageError(
                f"The image cannot be laid over this terrain: {error.what}",
                path=path,
                remedy="Name an image of the same body, or give it the terrain's CRS (gdal_translate -a_srs).",
            ) from error
        if not image.crs.is_geographic:
            return placement
        turn = 2 * math.pi / float(image.crs.axis_info[0].unit_conversion_factor)
        return cls(grid, image, turn, False, float(x) if math.isfinite(float(x)) else 0.0)

    @property
    def same(self) -> bool:
        """Whether image and terrain have one CRS, so that positions go over by an affine map."""
        return self.grid.crs is None or self.image.crs is None or self.grid.crs == self.image.crs

    @property
    def cyclic(self) -> bool:
        """Whether the image goes once around the body, its right border meeting its left."""
        t = self.image.transform
        return self.turn > 0 and t.b == 0 and abs(abs(t.a) * self.image.cols - self.turn) < abs(t.a)

    def projected(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Positions in the image's CRS; in a thread's own transformer, since PROJ's are not shared."""
        if self.same:
            return x, y
        move: Callable[[Array, Array], tuple[Array, Array]] | None = getattr(self._local, "move", None)
        if move is None:
            from orograph.geo.transform import transformer

            move = self._local.move = transformer(self.grid.crs, self.image.crs)
        return move(x, y)

    def pixels(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Exact image positions (pixels from its corner) of places in the terrain's CRS; NaN where there are none."""
        px, py = self.projected(np.asarray(x, np.float64), np.asarray(y, np.float64))
        px, py = np.where(np.isfinite(px), px, np.nan), np.where(np.isfinite(py), py, np.nan)
        if self.turn:
            # Longitudes go on across the antimeridian, on the turn on which the terrain's middle lies over the image.
            west, _, east, _ = self.image.bounds()
            centre = self.middle + self.turn * round(((west + east) / 2 - self.middle) / self.turn)
            px = px + self.turn * np.round((centre - px) / self.turn)
        return apply(~self.image.transform, px, py)

    def places(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Places in the terrain's CRS of image positions (pixels from its corner); NaN where there are none."""
        x, y = apply(self.image.transform, np.asarray(u, np.float64), np.asarray(v, np.float64))
        if not self.same:
            from orograph.geo.transform import transformer

            x, y = transformer(self.image.crs, self.grid.crs)(x, y)
        return np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan)


@dataclass(frozen=True, slots=True)
class Lattice:
    """Image positions of nodes spread evenly over the terrain.

    Attributes:
        u, v: (rows, cols), pixels. index: the affine map from the terrain's CRS to (col, row) of the nodes.
        error: pixels; above ``TOLERANCE`` only if the finest lattice does not reach it.
    """

    u: Array
    v: Array
    index: Affine
    error: float

    @classmethod
    def over(cls, placement: Placement) -> Lattice:
        """The coarsest lattice that keeps ``TOLERANCE``, or the finest there is."""
        nodes = 2 if placement.same else 9
        u, v, _ = _nodes(placement, nodes)
        if np.isfinite(u).any() and np.isfinite(v).any():
            span = max(float(np.nanmax(u) - np.nanmin(u)), float(np.nanmax(v) - np.nanmin(v)))
            nodes = int(min(MOST_NODES, max(nodes, math.ceil(span / CELL) + 1)))
        while True:
            u, v, index = _nodes(placement, nodes)
            if placement.same:
                return cls(u, v, index, 0.0)
            # 33 × 33 cells at most are measured, those at the border among them.
            cells = np.unique(np.linspace(0, nodes - 2, 33).round())
            error = 0.0
            for du, dv in ((0.5, 0.5), (0.5, 0.0), (0.0, 0.5)):
                c, r = np.meshgrid(cells + du, cells + dv)
                exact = placement.pixels(*apply(~index, c, r))
                off = np.abs(np.stack(exact) - np.stack([between(u, c, r), between(v, c, r)]))
                error = max(error, float(np.nanmax(off)) if np.isfinite(off).any() else 0.0)
            if error <= TOLERANCE or nodes >= MOST_NODES:
                return cls(u, v, index, error)
            # The error falls with the square of the distance between nodes.
            nodes = int(min(MOST_NODES, max(2 * nodes - 1, math.ceil((nodes - 1) * math.sqrt(error / TOLERANCE)) + 3)))

    def bounds(self) -> tuple[float, float, float, float] | None:
        """(least u, greatest u, least v, greatest v), None if the terrain is nowhere in the image's projection."""
        u, v = self.u[np.isfinite(self.u)], self.v[np.isfinite(self.v)]
        return (float(u.min()), float(u.max()), float(v.min()), float(v.max())) if len(u) and len(v) else None

    def density(self) -> Array:
        """Image pixels per unit of the terrain's CRS, the greater of both directions, in each cell (rows−1, cols−1);
        0 where the projection is undefined."""
        steps = [(np.diff(a, axis=1)[:-1], np.diff(a, axis=0)[:, :-1]) for a in (self.u, self.v)]
        a, b, _, d, e, _ = self.index[:6]
        east = np.hypot(*(s * a + t * d for s, t in steps))
        north = np.hypot(*(s * b + t * e for s, t in steps))
        return np.ascontiguousarray(np.nan_to_num(np.maximum(east, north), nan=0.0))


def grid_of(dataset: Any) -> Grid:
    """The grid of an open rasterio dataset: by its geotransform, or the best affine map through control points."""
    transform, crs = dataset.transform, dataset.crs
    points, points_crs = dataset.gcps
    if transform == Affine.identity() and len(points) >= 3:
        from rasterio.transform import from_gcps

        transform, crs = from_gcps(points), points_crs
    return Grid((dataset.height, dataset.width), transform, CRS.from_wkt(crs.to_wkt()) if crs else None)


def extent(grid: Grid) -> str:
    """Bounds and CRS in words, for messages."""
    west, south, east, north = grid.bounds()
    name = f" in {grid.crs.name}" if grid.crs is not None else ""
    return f"{west:.8g} to {east:.8g}, {south:.8g} to {north:.8g}{name}"


def _nodes(placement: Placement, nodes: int) -> tuple[Array, Array, Affine]:
    grid = placement.grid
    to_crs = compose(grid.transform, Affine.scale(grid.cols / (nodes - 1), grid.rows / (nodes - 1)))
    c, r = np.meshgrid(np.arange(nodes, dtype=np.float64), np.arange(nodes, dtype=np.float64))
    u, v = placement.pixels(*apply(to_crs, c, r))
    return u, v, ~to_crs


def between(a: Array, c: Array, r: Array) -> Array:
    """Values of a lattice at columns and rows between its nodes, bilinear."""
    j, i = np.minimum(c.astype(int), a.shape[1] - 2), np.minimum(r.astype(int), a.shape[0] - 2)
    fc, fr = c - j, r - i
    top = a[i, j] * (1 - fc) + a[i, j + 1] * fc
    return np.asarray(top * (1 - fr) + (a[i + 1, j] * (1 - fc) + a[i + 1, j + 1] * fc) * fr)


@kernel
def interpolate(
    mesh_u: Array,
    mesh_v: Array,
    density: Array,
    index: Array,
    x: Array,
    y: Array,
    u: Array,
    v: Array,
    scale: Array,
) -> None:
    """Positions u, v (n,) of x, y (n,), bilinear in a mesh of nodes (rows, cols), and ``density`` (rows − 1, cols − 1)
    there; ``index`` is the affine map from x, y to the mesh's (col, row). Beyond the mesh its border cells go on."""
    rows, cols = mesh_u.shape
    for n in range(x.shape[0]):
        c = index[0] * x[n] + index[1] * y[n] + index[2]
        r = index[3] * x[n] + index[4] * y[n] + index[5]
        if not (c == c and r == r):
            u[n] = v[n] = np.nan
            scale[n] = 0.0
            continue
        j = np.int64(min(max(np.floor(c), 0.0), cols - 2.0))
        i = np.int64(min(max(np.floor(r), 0.0), rows - 2.0))
        c -= j
        r -= i
        a = mesh_u[i, j] + (mesh_u[i, j + 1] - mesh_u[i, j]) * c
        b = mesh_u[i + 1, j] + (mesh_u[i + 1, j + 1] - mesh_u[i + 1, j]) * c
        u[n] = a + (b - a) * r
        a = mesh_v[i, j] + (mesh_v[i, j + 1] - mesh_v[i, j]) * c
        b = mesh_v[i + 1, j] + (mesh_v[i + 1, j + 1] - mesh_v[i + 1, j]) * c
        v[n] = a + (b - a) * r
        scale[n] = density[i, j]


@kernel
def slopes_into(
    mesh_u: Array,
    mesh_v: Array,
    index: Array,
    x: Array,
    y: Array,
    ground: Array,
    least: Array,
    scale: float,
    axes: Array,
    floor: Array,
) -> None:
    """What steps on the ground are in the image: ``axes`` (n, 4), u and v of both steps of ``ground`` (n, 4), and
    ``floor`` (n,), ``least`` (n,) metres the way in which the fewest texels lie. Arguments as for ``interpolate``;
    ``scale``: texels per image pixel."""
    rows, cols = mesh_u.shape
    for n in range(x.shape[0]):
        c = index[0] * x[n] + index[1] * y[n] + index[2]
        r = index[3] * x[n] + index[4] * y[n] + index[5]
        if not (c == c and r == r):
            axes[n, :] = 0.0
            floor[n] = 0.0
            continue
        j = np.int64(min(max(np.floor(c), 0.0), cols - 2.0))
        i = np.int64(min(max(np.floor(r), 0.0), rows - 2.0))
        c -= j
        r -= i
        # Derivatives of the bilinear mesh along its columns and rows, then along east and north.
        uc = (mesh_u[i, j + 1] - mesh_u[i, j]) * (1.0 - r) + (mesh_u[i + 1, j + 1] - mesh_u[i + 1, j]) * r
        ur = (mesh_u[i + 1, j] - mesh_u[i, j]) * (1.0 - c) + (mesh_u[i + 1, j + 1] - mesh_u[i, j + 1]) * c
        vc = (mesh_v[i, j + 1] - mesh_v[i, j]) * (1.0 - r) + (mesh_v[i + 1, j + 1] - mesh_v[i + 1, j]) * r
        vr = (mesh_v[i + 1, j] - mesh_v[i, j]) * (1.0 - c) + (mesh_v[i + 1, j + 1] - mesh_v[i, j + 1]) * c
        ue, un = (uc * index[0] + ur * index[3]) * scale, (uc * index[1] + ur * index[4]) * scale
        ve, vn = (vc * index[0] + vr * index[3]) * scale, (vc * index[1] + vr * index[4]) * scale
        for k in range(2):
            e, m = ground[n, 2 * k], ground[n, 2 * k + 1]
            axes[n, 2 * k], axes[n, 2 * k + 1] = ue * e + un * m, ve * e + vn * m
        # The lesser singular value of the map from metres to texels.
        square = ue * ue + un * un + ve * ve + vn * vn
        area = abs(ue * vn - un * ve)
        greater = np.sqrt(0.5 * (square + np.sqrt(max(square * square - 4.0 * area * area, 0.0))))
        floor[n] = least[n] * area / greater if greater > 0.0 else 0.0
