"""One elevation raster in memory: heights in metres with their place, datum and name.

A sample is NaN exactly if it has no height. Units: metres, whatever the file had.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph._named import named
from orograph.cards import Row, amount, card, extent_rows, heights_row, one_line, relief
from orograph.geo.grid import Grid

if TYPE_CHECKING:
    import xarray as xr

MEANT = {
    **dict.fromkeys(("plot", "show", "render"), "orograph.render(dem)"),
    **dict.fromkeys(("save", "write", "to_file", "to_raster"), 'orograph.export(dem, "dem.tif")'),
    **dict.fromkeys(("values", "data", "array", "z"), "dem.heights"),
    **{name: f"dem.grid.{name}" for name in ("crs", "transform", "shape")},
    **dict.fromkeys(("bounds", "extent"), "dem.grid.bounds()"),
}
"""Names of attributes in other libraries, and their equivalents here."""

MAX_READ_BYTES = 2 << 30
"""Default maximum bytes of heights (float32): 536 million heights, e.g. 23170²."""


@named("A Dem")
@dataclass(frozen=True, slots=True, repr=False)
class Dem:
    """An elevation raster.

    Attributes:
        heights: (rows, cols) float32, metres, NaN where missing; row 0 is the northernmost of a raster that is not
        rotated. grid: where the samples lie; ``grid.shape == heights.shape``.
        vertical: name of the vertical datum ("EGM96 height", "ellipsoidal height"…), None if unknown.
        name: for titles (a file's stem).
        attribution: the credits that its makers ask for, a sentence each; pictures carry them.
    """

    heights: NDArray[np.float32]
    grid: Grid
    vertical: str | None = None
    name: str = "terrain"
    attribution: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.heights.dtype != np.float32:
            raise TypeError(f"heights must be float32 (metres, NaN where missing), not {self.heights.dtype}")
        if self.heights.shape != self.grid.shape:
            raise ValueError(f"heights are {self.heights.shape} but the grid is {self.grid.shape}")

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(rows, cols) bool: True where there is a height."""
        return ~np.isnan(self.heights)

    def to_xarray(self) -> xr.DataArray:
        """The heights as a DataArray with the dimensions y, x.

        Raises:
            UsageError: the grid is rotated.
        """
        from orograph.dem.labelled import laid_out

        return laid_out(self.heights, self.grid, self.name, {"units": "m", "long_name": "height"})

    def _rows(self) -> list[Row]:
        finite = self.valid.any()
        low, high = (float(f(self.heights)) for f in (np.nanmin, np.nanmax)) if finite else (np.nan, np.nan)
        return [
            *extent_rows(self.grid), heights_row(low, high, self.vertical),
            ("memory", amount(self.heights.nbytes)),
        ]  # fmt: skip

    def __repr__(self) -> str:
        return one_line("Dem", self.name, self._rows())

    def _repr_html_(self) -> str:
        return card("Dem", self.name, self._rows(), relief(self.heights, self.grid))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.heights, dtype, copy=copy)

    if not TYPE_CHECKING:  # (type checkers look for names themselves)

        def __getattr__(self, name: str) -> Any:
            remedy = f" Use {MEANT[name]}." if name in MEANT else ""
            raise AttributeError(f"A Dem has no attribute {name!r}.{remedy}", name=name, obj=self)
