"""A raster at the samples of another's grid, window by window, for comparing two rasters.

Files are resampled once, from their own samples straight to that grid, as a mosaic is to its own: exact projection,
blocks of samples averaged first where the grid is coarser. Samples that lie on the grid are copied.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from orograph.dem.area import both, reach, whole, window_of
from orograph.dem.lattice import Raster, SourceLattice, group
from orograph.dem.layers import Heights, filled, layer_of
from orograph.dem.mosaic import Mosaic
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geo.operations import same_body
from orograph.geo.transform import transformer

KNOTS = 257
"""Places along each border of a raster that are checked to locate it on another grid."""

Window = tuple[int, int, int, int]


class Readable(Raster, Protocol):
    """A raster with a fingerprint of its samples."""

    def fingerprint(self) -> str: ...


class Aligned:
    """Part of a grid, with a raster's heights at its samples.

    Args:
        raster: a ``Mosaic``, or any other raster read by windows.
        grid: where heights are wanted. window: its rows and columns of ``grid`` (half-open).
        resampling: "nearest", "bilinear" or "cubic".
    """

    def __init__(self, raster: Readable, grid: Grid, window: Window, resampling: str = "bilinear") -> None:
        self.grid = grid.window(*window)
        self.name, self.vertical = raster.name, raster.vertical
        self.attribution: tuple[str, ...] = getattr(raster, "attribution", ())
        self._raster, self._window, self._resampling = raster, window, resampling
        self._own = raster.grid == grid
        lattices = () if self._own else lattices_of(raster)
        self._layers = [layer_of(lattice, grid, resampling) for lattice in lattices]

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Heights of a half-open window of ``grid``, float32 metres, NaN where missing.

        They do not depend on the window.
        """
        top, _, left, _ = self._window
        box = top + row0, top + row1, left + col0, left + col1
        return self._raster.read(*box) if self._own else filled(self._resampling, self._layers, *box)

    def fingerprint(self) -> str:
        grid = self.grid
        crs = "" if grid.crs is None else grid.crs.to_wkt()
        return f"{self._raster.fingerprint()} {self._resampling} {grid.shape} {grid.transform[:6]} {crs}"


def lattices_of(raster: Raster) -> tuple[SourceLattice, ...]:
    """The sources of a raster's samples: a mosaic's lattices, otherwise the raster itself."""
    return raster.lattices if isinstance(raster, Mosaic) else tuple(group([raster], [raster.grid]))


def shared(grid: Grid, raster: Raster, name: str) -> Window:
    """Rows and columns (half-open) of a grid within which a raster has samples.

    Args:
        name: of the raster that the grid is of, for errors.

    Raises:
        UsageError: they share none, lie on two bodies, or only one of them says where it is.
    """
    crs = [lattice.grid.crs for lattice in lattices_of(raster)]
    if (crs[0] is None) != (grid.crs is None):
        nameless = raster.name if crs[0] is None else name
        raise UsageError(
            f"{nameless} has no CRS but the other has one, so their overlap is unknown.",
            remedy="Give its CRS (`assume_crs`), or write one into it.",
        )
    if grid.crs is not None and crs[0] is not None and not same_body(grid.crs, crs[0]):
        raise UsageError(
            f"{name} and {raster.name} are on different planets or moons ({grid.crs.name}, {crs[0].name})."
        )
    places = []
    for lattice in lattices_of(raster):
        of, t, flat = lattice.grid, np.linspace(0.0, 1.0, KNOTS), np.zeros(KNOTS)
        across, down = np.concatenate([t, t, flat, flat + 1, t]), np.concatenate([flat, flat + 1, t, t, flat + 0.5])
        x, y = of.xy(across * (of.cols - 1), down * (of.rows - 1))
        if of.crs is not None and grid.crs is not None and of.crs != grid.crs:
            x, y = transformer(of.crs, grid.crs)(x, y)
        places.append(np.stack([x, y], axis=-1))
    window = both(whole(grid), window_of(grid, np.concatenate(places)))
    if window[0] < window[1] and window[2] < window[3]:
        return window
    where = "" if grid.crs is None else f" Of {name}{reach(grid)}; of {raster.name}{reach(raster.grid)}."
    raise UsageError(f"{name} and {raster.name} do not overlap.{where}", remedy="Give two rasters of the same place.")
