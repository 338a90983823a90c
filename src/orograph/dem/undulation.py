"""A terrain's heights converted to another vertical datum window by window, with a given geoid grid.

h = H + N (``orograph.geo.vertical``). The position of a terrain's sample in the geoid grid is found like that in a
source (``coordinates``), within ``TOLERANCE`` of a cell of the grid; N is then interpolated bilinearly at that
position, including kinks at the borders of the grid's cells, and added in float64. Nothing depends on the window. The
terrain's own longitudes and latitudes are used: a shift of some 100 m between its datum and the grid's changes N by a
few millimetres. Units: metres, degrees; positions in samples of the geoid grid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from orograph._numba import kernel
from orograph.dem.coordinates import Coordinates
from orograph.dem.lattice import FLOAT, Lattice
from orograph.dem.projection import geodetic_base
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geo.vertical import ELLIPSOIDAL, KNOWN_DATUMS, Geoid, known_datum

TOLERANCE = 2e-5  # cells of the geoid grid: 0.2 mm where a 15′ geoid is steepest (8 m in a cell)
SLACK = 1e-5  # cells: rounding may put a point on the grid's border slightly outside
STRIP = 256  # rows whose positions are held at once

Direction = Literal["ellipsoidal", "orthometric"]
DIRECTIONS: tuple[Direction, ...] = ("ellipsoidal", "orthometric")


class Undulation:
    """The change of heights over a terrain's grid from one vertical datum to another.

    Attributes:
        geoid: the grid used.
        vertical: what the heights are called afterwards.
    """

    def __init__(self, geoid: Geoid, to: Direction, grid: Grid, lattices: Sequence[Lattice]) -> None:
        """Check that the geoid grid covers every source to its outermost corner.

        Args:
            grid: of the terrain.
            lattices: what it is made of.

        Raises:
            ReadError: it does not, or the terrain has no CRS or lies on another body.
        """
        if grid.crs is None:
            raise ReadError(
                "The terrain has no CRS, so its longitudes and latitudes are unknown and its heights cannot be "
                "converted.",
                path=geoid.path,
                remedy="Give the CRS of the files: `assume_crs`.",
            )
        base = geodetic_base(grid.crs)
        if base.ellipsoid is not None and abs(base.ellipsoid.semi_major_metre - 6.378e6) > 2e4:
            raise ReadError(f"The terrain lies on another body ({base.name}), not on the Earth.", path=geoid.path)
        self.geoid, self._sign = geoid, 1.0 if to == "ellipsoidal" else -1.0
        self.vertical = geoid.ellipsoidal_datum if to == "ellipsoidal" else geoid.datum
        self._around = 360 / geoid.grid.transform.a
        self._closed = geoid.grid.cols >= self._around - 1e-6
        placed = Grid(geoid.grid.shape, geoid.grid.transform, base)
        for lattice in lattices:
            self._check(lattice, placed)
        self._coordinates = Coordinates(grid, placed, TOLERANCE)

    def apply(self, row0: int, col0: int, heights: NDArray[np.float32]) -> None:
        """Convert a window of heights, whose first sample is (row0, col0), in place; missing ones stay missing.

        Raises:
            ReadError: a sample lies off the geoid grid, or in a hole of it.
        """
        rows, cols = heights.shape
        mesh = self._coordinates.mesh(row0, row0 + rows, col0, col0 + cols)
        for r in range(0, rows, STRIP):
            end = min(r + STRIP, rows)
            u, v = mesh.positions(row0 + r, row0 + end, col0, col0 + cols)
            bad = add(self.geoid.values, self._around, self._closed, self._sign, u, v, heights[r:end])
            if bad >= 0:
                x, y = self.geoid.grid.xy(u.ravel()[bad], v.ravel()[bad])
                raise self._off(float(x), float(y), "lies off the geoid grid, or in a hole of it")

    def _check(self, lattice: Lattice, geoid: Grid) -> None:
        """The borders of every member of a lattice, half a sample beyond its outermost samples, lie on the grid."""
        lon, lat = _rims(lattice, geoid.crs)
        u, v = geoid.index(lon, lat)
        u = u - self._around * np.floor((u + SLACK) / self._around)
        off = (v < -SLACK) | (v > geoid.rows - 1 + SLACK)
        if not self._closed:
            off |= u > geoid.cols - 1 + SLACK
        if off.any():
            first = int(np.argmax(off))
            raise self._off(
                float(lon[first]), float(lat[first]), "at the border of the terrain lies off the geoid grid"
            )

    def _off(self, lon: float, lat: float, why: str) -> ReadError:
        return ReadError(
            f"The point {(lon + 180) % 360 - 180:.6f}° E, {lat:.6f}° N {why}.",
            path=self.geoid.path,
            remedy="Use a geoid grid that covers the terrain.",
        )


class ConvertedLattice:
    """A lattice with its heights converted to another datum.

    Attributes:
        lattice: of the sources.
        geoid, to: as for ``Undulation``.
    """

    code = FLOAT

    def __init__(self, lattice: Lattice, geoid: Geoid, to: Direction) -> None:
        self.grid, self._lattice = lattice.grid, lattice
        self._undulation = Undulation(geoid, to, lattice.grid, [lattice])

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        heights = self._lattice.read(row0, row1, col0, col1)
        self._undulation.apply(row0, col0, heights)
        return heights


def latitudes_of(lattices: Sequence[Lattice]) -> tuple[float, float] | None:
    """The southernmost and northernmost latitude of a terrain's sources; None if they have no CRS."""
    lats = []
    for lattice in lattices:
        if lattice.grid.crs is None:
            return None
        lats.append(_rims(lattice, geodetic_base(lattice.grid.crs))[1])
    every = np.concatenate(lats)
    if not len(every):
        return None
    # A pole inside a raster is not on its border, and a straight border there does not follow a parallel.
    south, north = float(every.min()), float(every.max())
    margin = 0.1 * (north - south) + 0.1
    return (-90.0 if south < -60 else south - margin), (90.0 if north > 60 else north + margin)


def _rims(lattice: Lattice, crs: CRS | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Longitudes and latitudes along the borders of all members, half a sample beyond their outermost samples."""
    dense = np.linspace(0, 1, 33 if len(lattice.members) < 256 else 5)
    zero = np.zeros_like(dense)
    along, down = np.concatenate([dense, dense, zero, zero + 1]), np.concatenate([zero, zero + 1, dense, dense])
    r0, r1, c0, c1 = (lattice.corners[:, i, None].astype(np.float64) for i in range(4))
    lon, lat = lattice.grid.xy(c0 - 0.5 + along * (c1 - c0), r0 - 0.5 + down * (r1 - r0))
    if lattice.grid.crs != crs:
        lon, lat = Transformer.from_crs(lattice.grid.crs, crs, always_xy=True).transform(lon, lat)
    known = np.isfinite(lon) & np.isfinite(lat)
    return lon[known], np.clip(lat[known], -90, 90)


def check_request(to: str | None, geoid: object | None) -> None:
    """Refuse an incomplete request for a conversion.

    Raises:
        UsageError: one without the other, or an unknown direction.
    """
    if to is None and geoid is not None:
        raise UsageError(
            "A geoid grid is given, but not what to convert to.",
            remedy=f"Give {' or '.join(f'`to_vertical={d!r}`' for d in DIRECTIONS)}.",
        )
    if to is not None and to not in DIRECTIONS:
        raise UsageError(f"Heights can be made {' or '.join(DIRECTIONS)}, not {to!r}.")
    if to is not None and geoid is None:
        raise UsageError(
            f"Heights cannot be made {to} without a geoid grid.",
            remedy='Name one: `geoid="egm96_15.gtx"` (from cdn.proj.org).',
        )


class Named(Protocol):
    """Heights with a name, and a vertical datum or None."""

    @property
    def name(self) -> str: ...
    @property
    def vertical(self) -> str | None: ...


def check_datums(sources: Sequence[Named], to: Direction, geoid: Geoid) -> None:
    """Refuse sources whose heights do not have the datum that the conversion starts from.

    Raises:
        UsageError: one has another datum, or already the requested one, or declares none.
    """
    target = geoid.datum if to == "orthometric" else ELLIPSOIDAL
    origin = ELLIPSOIDAL if to == "orthometric" else geoid.datum
    for source in sources:
        if source.vertical is None:
            name = origin.split()[0] if origin in KNOWN_DATUMS else "NAME"
            raise UsageError(
                f"{source.name} does not declare the datum of its heights, so they cannot be converted.",
                remedy=f"If you know it, give it: `assume_vertical={name!r}`.",
            )
        found = known_datum(source.vertical)
        if found == target:
            raise UsageError(f"The heights of {source.name} are of {found!r} already.", remedy="Omit `to_vertical`.")
        # A geoid grid of a name that says nothing is taken to be of the datum that the heights are declared to be of.
        matches = found == origin or (origin not in KNOWN_DATUMS and found not in KNOWN_DATUMS)
        if not matches:
            raise UsageError(
                f"The heights of {source.name} are of {source.vertical!r}, and cannot be converted with {geoid.path}, "
                f"which is between {geoid.datum!r} and the ellipsoid.",
                remedy="Name the geoid grid of that datum.",
            )


@kernel
def add(
    values: NDArray[np.float64],
    around: float,
    closed: bool,
    sign: float,
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    heights: NDArray[np.float32],
) -> int:
    """Add the bilinear undulation to heights in place; the index of the first sample that has none, or -1.

    Args:
        values: of the geoid grid, NaN in holes; ``around``: columns in a full turn; ``closed``: it has them all.
        u, v: (col, row) in the geoid grid of each height, col up to whole turns.
    """
    rows, cols = values.shape
    turn = round(around)
    for r in range(heights.shape[0]):
        for c in range(heights.shape[1]):
            index: int = r * heights.shape[1] + c
            height = np.float64(heights[r, c])
            if math.isnan(height):
                continue
            x, y = u[r, c] - around * math.floor((u[r, c] + SLACK) / around), v[r, c]
            if not (-SLACK <= y <= rows - 1 + SLACK) or not (closed or x <= cols - 1 + SLACK):
                return index
            x, y = max(x, 0.0), min(max(y, 0.0), rows - 1.0)
            if not closed:
                x = min(x, cols - 1.0)
            j, i = math.floor(y), math.floor(x)
            t, s = y - j, x - i
            below, right = min(j + 1, rows - 1), i + 1
            if closed:
                i, right = i % turn, right % turn
            else:
                right = min(right, cols - 1)
            # A neighbour of weight 0 is not needed: a hole there does no harm.
            a, b = values[j, i], values[j, right] if s > 0 else 0.0
            n = a * (1 - s) + b * s
            if t > 0:
                a, b = values[below, i], values[below, right] if s > 0 else 0.0
                n = n * (1 - t) + (a * (1 - s) + b * s) * t
            if math.isnan(n):
                return index
            heights[r, c] = height + sign * n
    return -1
