"""The grid of the terrain: which projection, which spacing, from where to where.

A projected lattice is kept sample for sample (rotated or not) and only extended, by whole samples, over what coarser
sources cover beyond it. Everything else is brought to square cells: their side is the geometric mean of the two sides
of a source cell at the centre of the finest source, as projected (as many samples per area as the source has), rounded
to 4 significant digits; cell edges lie on multiples of it; the extent covers every source sample. Units: metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from orograph.dem.axes import east_north
from orograph.dem.lattice import Lattice
from orograph.dem.projection import flat_crs, geodetic_base, horizontal, in_metres
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.several import numbers

MAX_SIDE = 1 << 24  # samples; beyond it sample indices no longer fit float32, which renderers use
_COUNTED = 2.0**53  # steps from the CRS's origin that float64 can distinguish
_FEWER = "Give a coarser `resolution`, another `crs`, or files that lie closer together."

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Target:
    """The terrain's grid, and the reason for it (a phrase: "UTM zone 11N", "as the source")."""

    grid: Grid
    reason: str
    kept: bool  # whether the finest lattice is kept sample for sample


def parse_crs(text: str | CRS) -> CRS:
    """A projected CRS in metres from what a user gave for --crs.

    Raises:
        UsageError: it is unknown, or not projected.
    """
    try:
        crs = horizontal(CRS.from_user_input(text))
    except CRSError as error:
        raise UsageError(
            f"{text!r} is not a known CRS ({str(error).splitlines()[0]}).", remedy="Give e.g. EPSG:32633."
        ) from None
    if not crs.is_projected:
        raise UsageError(
            f"{crs.name} is not a projected CRS, but a terrain needs metres.",
            remedy="Give a projected one, e.g. a UTM zone (EPSG:32633), or omit `crs` to have one chosen.",
        )
    return in_metres(east_north(crs)[0])[0]


def ground_spacing(grid: Grid) -> float:
    """Geometric mean of the two sides of a cell at the grid's centre, in metres on the ground."""
    a, b, _, d, e, _ = grid.transform[:6]
    area = abs(a * e - b * d)
    if grid.crs is None or not grid.crs.is_geographic:
        return math.sqrt(area)
    col, row = (grid.cols - 1) / 2, (grid.rows - 1) / 2
    unit = math.degrees(grid.crs.axis_info[0].unit_conversion_factor)
    latitude = math.radians(float(np.clip(grid.xy(col, row)[1] * unit, -89, 89)))
    radius = grid.crs.ellipsoid.semi_major_metre if grid.crs.ellipsoid else 6378137.0
    return math.sqrt(area * math.cos(latitude)) * math.radians(unit) * radius


def choose(lattices: Sequence[Lattice], *, crs: CRS | None = None, resolution: float | None = None) -> Target:
    """The target grid for some lattices, the finest first.

    Args:
        crs: a projected CRS in metres (``parse_crs``) instead of the automatic choice.
        resolution: metres between samples instead of the source's.

    Raises:
        ReadError: the area cannot be shown flat, or not in that CRS.
        UsageError: the resolution is not a length, or gives an absurd number of samples.
    """
    if resolution is not None:
        length, *more = numbers(resolution, "resolution")
        if more or not (math.isfinite(length) and length > 0):
            raise UsageError(f"`resolution` must be a length in metres, not {resolution}.")
        resolution = length
    finest = lattices[0].grid
    metric = finest.crs is None or not finest.crs.is_geographic
    if metric and resolution is None and (crs is None or crs == finest.crs):
        return Target(_extended(finest, lattices), "as the source", True)
    reason = "as requested"
    if crs is None:
        crs, reason = finest.crs, "as the source"
        if not metric:
            assert finest.crs is not None
            crs, reason = _flat(finest.crs, lattices)
    spacing = float(resolution) if resolution is not None else _projected_spacing(finest, crs)
    west, south, east, north = _extent(lattices, crs)
    if not max(map(abs, (west, south, east, north))) / spacing < _COUNTED:
        high, wide = (north - south) / spacing, (east - west) / spacing
        raise UsageError(_too_many(f"{high:.3g} × {wide:.3g}", spacing), remedy=_FEWER)
    # A small tolerance, so that an edge which is a multiple except for rounding does not add a column.
    left, right = math.floor(west / spacing + 1e-6), math.ceil(east / spacing - 1e-6)
    bottom, top = math.floor(south / spacing + 1e-6), math.ceil(north / spacing - 1e-6)
    shape = (max(1, top - bottom), max(1, right - left))
    _check_size(shape, spacing)
    if resolution is not None and min(shape) < 2:
        raise UsageError(
            f"A resolution of {spacing:g} m is coarser than the size of the terrain ({east - west:.4g} × "
            f"{north - south:.4g} m).", remedy="Give a finer `resolution`.",
        )  # fmt: skip
    return Target(Grid(shape, Affine(spacing, 0, left * spacing, 0, -spacing, top * spacing), crs), reason, False)


def _check_size(shape: tuple[int, int], spacing: float) -> None:
    if max(shape) > MAX_SIDE:
        raise UsageError(_too_many(f"{shape[0]} × {shape[1]}", spacing), remedy=_FEWER)


def _too_many(samples: str, spacing: float) -> str:
    return f"The terrain would have {samples} samples, {spacing:g} m apart."


def _extended(finest: Grid, lattices: Sequence[Lattice]) -> Grid:
    """The finest grid, enlarged by whole samples until it holds the sample positions of every lattice."""
    if len(lattices) == 1:
        return finest
    cols, rows = [-0.5, finest.cols - 0.5], [-0.5, finest.rows - 0.5]
    for lattice in lattices[1:]:
        col, row = finest.index(*_project(_rims(lattice), lattice.grid.crs, finest.crs))
        cols += [float(np.min(col)), float(np.max(col))]
        rows += [float(np.min(row)), float(np.max(row))]
    left, right = math.floor(min(cols) + 0.5 + 1e-6), math.ceil(max(cols) + 0.5 - 1e-6)
    top, bottom = math.floor(min(rows) + 0.5 + 1e-6), math.ceil(max(rows) + 0.5 - 1e-6)
    _check_size((bottom - top, right - left), finest.spacing[0])
    return finest.window(top, bottom, left, right)


def _flat(crs: CRS, lattices: Sequence[Lattice]) -> tuple[CRS, str]:
    base = geodetic_base(crs)
    points = [_project(_rims(lattice), lattice.grid.crs, base) for lattice in lattices]
    flat = flat_crs(base, np.concatenate([p[0] for p in points]), np.concatenate([p[1] for p in points]))
    return flat.crs, flat.reason


def _projected_spacing(grid: Grid, crs: CRS | None) -> float:
    """Side of a square with the area of the grid's projected cells at its centre, rounded to 4 significant digits."""
    col, row = (grid.cols - 1) / 2, (grid.rows - 1) / 2
    x, y = _project(grid.xy([col - 0.5, col + 0.5, col, col], [row, row, row - 0.5, row + 0.5]), grid.crs, crs)
    area = abs((x[1] - x[0]) * (y[3] - y[2]) - (x[3] - x[2]) * (y[1] - y[0]))
    return float(f"{math.sqrt(area):.4g}")


def _extent(lattices: Sequence[Lattice], crs: CRS | None) -> tuple[float, float, float, float]:
    points = [_project(_rims(lattice), lattice.grid.crs, crs) for lattice in lattices]
    x, y = np.concatenate([p[0] for p in points]), np.concatenate([p[1] for p in points])
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _project(points: tuple[Floats, Floats], source: CRS | None, target: CRS | None) -> tuple[Floats, Floats]:
    """Points transformed from one CRS to another, without those that the projection does not reach."""
    x, y = points
    if source is None or target is None or source == target:
        return x, y
    x, y = Transformer.from_crs(source, target, always_xy=True).transform(x, y)
    reached = np.isfinite(x) & np.isfinite(y)
    if not reached.any():
        raise ReadError(f"The raster lies outside the area of {target.name}.", remedy="Choose another `crs`.")
    return x[reached], y[reached]


def _rims(lattice: Lattice) -> tuple[Floats, Floats]:
    """CRS coordinates of samples along the borders of the members, and of some within them."""
    n = len(lattice.members)
    dense = np.linspace(0, 1, max(9, 1024 // math.isqrt(n)))
    inner = np.linspace(0, 1, 33 if n < 32 else 3)
    s, t = np.meshgrid(inner, inner)
    zero = np.zeros_like(dense)
    # Include the middle row: samples along the poles have no longitude.
    along = np.concatenate([dense, dense, zero, zero + 1, dense, s.ravel()])
    down = np.concatenate([zero, zero + 1, dense, dense, zero + 0.5, t.ravel()])
    r0, r1, c0, c1 = (lattice.corners[:, i, None].astype(np.float64) for i in range(4))
    x, y = lattice.grid.xy(c0 + along * (c1 - 1 - c0), r0 + down * (r1 - 1 - r0))
    return x.ravel(), y.ravel()
