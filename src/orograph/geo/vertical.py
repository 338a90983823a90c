"""Vertical datums: from heights above a geoid to heights above the ellipsoid and back, by a geoid grid that is named.

h = H + N: the ellipsoidal height h is the height H above the geoid plus the geoid's undulation N, which a grid file
gives (GTX, GeoTIFF, anything GDAL reads: EGM96, EGM2008…). The conversion is never made unasked, and never without a
grid: PROJ and GDAL leave heights as they are, without a word, when they miss one. Here the file is opened and
interpolated by this module, bilinearly between its samples as PROJ's ``vgridshift`` does, so that a missing grid, a
point beyond it and a hole in it are errors. Units: degrees and metres, float64.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from orograph.errors import ReadError
from orograph.geo.grid import Grid

F64 = NDArray[np.float64]

ELLIPSOIDAL = "ellipsoidal height"

_KNOWN = (
    ("egm96", "EGM96 height"),
    ("egm2008", "EGM2008 height"),
    ("egm08", "EGM2008 height"),
    ("egm84", "EGM84 height"),
)


KNOWN_DATUMS = frozenset({ELLIPSOIDAL, *(name for _, name in _KNOWN)})


def known_datum(name: str) -> str:
    """One spelling of a vertical datum's name: "EGM96 height" of "egm96", "ellipsoidal height" of "… (WGS 84)"."""
    plain = name.lower().replace(" ", "").replace("-", "")
    if plain.startswith("ellipsoid"):
        return ELLIPSOIDAL
    return next((known for key, known in _KNOWN if key in plain), name)


@dataclass(frozen=True, slots=True, eq=False)
class Geoid:
    """Undulations of a geoid above an ellipsoid on a geographic grid. Make one with ``Geoid.open``.

    Attributes:
        path: the grid file.
        values: (rows, cols) float64, metres, NaN in holes.
        grid: where the values lie; geographic, not rotated, north up.
        datum: what heights above this geoid are called ("EGM96 height").
    """

    path: str
    values: F64
    grid: Grid
    datum: str

    @property
    def ellipsoidal_datum(self) -> str:
        """The name of heights above the grid's ellipsoid: "ellipsoidal height (WGS 84)"."""
        crs = self.grid.crs
        return f"{ELLIPSOIDAL} ({'WGS 84' if crs is None else crs.name})"

    @classmethod
    def open(cls, path: str | os.PathLike[str], *, latitudes: tuple[float, float] | None = None) -> Geoid:
        """Read a geoid grid.

        Args:
            latitudes: south and north of what is needed (degrees); None reads the whole (EGM2008 at 1′: 1.8 GB).

        Raises:
            ReadError: the file is missing or damaged, or is not a north-up geographic grid.
        """
        import rasterio
        from rasterio.errors import RasterioError

        text = os.fspath(path)
        remedy = "Name a geoid grid file (e.g. egm96_15.gtx or us_nga_egm08_25.tif, from cdn.proj.org)."
        if "://" not in text and not text.startswith("/vsi") and not Path(text).is_file():
            raise ReadError("There is no such geoid grid.", path=text, remedy=remedy)
        try:
            with rasterio.open(text) as dataset:
                transform = dataset.transform
                height, width = dataset.shape
                first, last = 0, height
                if latitudes is not None and transform.e < 0:
                    rows = [(lat - transform.f) / transform.e for lat in latitudes]
                    first = min(max(math.floor(min(rows)) - 2, 0), last - 1)
                    last = max(min(math.ceil(max(rows)) + 3, last), first + 1)
                values = dataset.read(1, window=((first, last), (0, width))).astype(np.float64)
                if dataset.nodata is not None:
                    values[values == np.float64(np.float32(dataset.nodata))] = np.nan
                    values[values == dataset.nodata] = np.nan
                crs = None if not dataset.crs else CRS.from_wkt(dataset.crs.to_wkt())
        except RasterioError as error:
            raise ReadError(f"The geoid grid cannot be read: {error}", path=text, remedy=remedy) from None
        if transform.b or transform.d or transform.e >= 0 or (crs is not None and not crs.is_geographic):
            raise ReadError("A geoid grid must be geographic and north up; this one is not.", path=text, remedy=remedy)
        stem = Path(text).stem
        datum = known_datum(f"height above {stem}")
        grid = Grid((height, width), transform, crs).window(first, last, 0, width)
        return cls(text, values, grid, datum)

    def undulation(self, lon: ArrayLike, lat: ArrayLike) -> F64:
        """N in metres at longitudes and latitudes in degrees, bilinear, of the broadcast shape; NaN where those are
        NaN.

        Longitudes are taken modulo 360°.

        Raises:
            ReadError: a point lies off the grid or in a hole of it.
        """
        lon, lat = np.broadcast_arrays(np.asarray(lon, np.float64), np.asarray(lat, np.float64))
        rows, cols = self.grid.shape
        dx, dy = self.grid.transform.a, -self.grid.transform.e
        west, north = self.grid.xy(0, 0)
        around = 360 / dx
        col = np.mod((lon - west) / dx, around)
        row = (north - lat) / dy
        closed = cols >= around - 1e-6
        # Rounding may put a point on the border a little beyond it: a hundred-thousandth of a cell is on it.
        col = np.where(~closed & (col > cols - 1 + 1e-5) & (col > around - 1e-5), 0.0, col)
        beyond = (row < -1e-5) | (row > rows - 1 + 1e-5)
        if not closed:
            beyond |= col > cols - 1 + 1e-5
        self._refuse(beyond, lon, lat, "lies off the geoid grid")
        known = ~(np.isnan(lon) | np.isnan(lat))
        row, col = np.clip(np.where(known, row, 0), 0, rows - 1), np.where(known, col, 0)
        col = col if closed else np.clip(col, 0, cols - 1)
        row0 = np.minimum(row.astype(np.int64), max(rows - 2, 0))
        col0 = np.floor(col).astype(np.int64) if closed else np.minimum(col.astype(np.int64), max(cols - 2, 0))
        row1, col1 = np.minimum(row0 + 1, rows - 1), col0 + 1
        t, s = row - row0, col - col0
        wrap = round(around) if closed else cols
        col0, col1 = (col0 % wrap, col1 % wrap) if closed else (col0, np.minimum(col1, cols - 1))
        v = self.values
        upper = _mix(v[row0, col0], v[row0, col1], s)
        lower = _mix(v[row1, col0], v[row1, col1], s)
        result = _mix(upper, lower, t)
        self._refuse(np.isnan(result) & known, lon, lat, "lies in a hole of the geoid grid")
        return np.where(known, result, np.nan)

    def ellipsoidal(self, heights: ArrayLike, lon: ArrayLike, lat: ArrayLike) -> F64:
        """Heights above the ellipsoid, metres, of heights above this geoid."""
        return np.asarray(heights, np.float64) + self.undulation(lon, lat)

    def orthometric(self, heights: ArrayLike, lon: ArrayLike, lat: ArrayLike) -> F64:
        """Heights above this geoid, metres, of heights above the ellipsoid."""
        return np.asarray(heights, np.float64) - self.undulation(lon, lat)

    def _refuse(self, bad: NDArray[np.bool_], lon: F64, lat: F64, why: str) -> None:
        if not np.any(bad):
            return
        first = tuple(int(i[0]) for i in np.nonzero(np.atleast_1d(bad)))
        x, y = float(np.atleast_1d(lon)[first]), float(np.atleast_1d(lat)[first])
        raise ReadError(
            f"The point {x:.6f}° E, {y:.6f}° N {why}.",
            path=self.path,
            remedy="Use a geoid grid that covers the terrain.",
        )


def _mix(first: F64, second: F64, t: F64) -> F64:
    """Linear interpolation that does not need the neighbour where its weight is 0 (a hole there does no harm)."""
    return np.where(t == 0, first, np.where(t == 1, second, first * (1 - t) + second * t))
