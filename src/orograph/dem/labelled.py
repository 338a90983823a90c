"""Values on a grid as a DataArray: with the coordinates of their samples, and their CRS as rioxarray and CF keep it."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid


def laid_out(values: NDArray[Any], grid: Grid, name: str | None, attrs: dict[str, Any]) -> xr.DataArray:
    """Values (bands, rows, cols) or (rows, cols) as a DataArray with the coordinates of their samples and their CRS.

    Raises:
        UsageError: the grid is rotated.
    """
    if grid.transform.b or grid.transform.d:
        raise UsageError("A rotated grid has no coordinates along its rows and columns.")
    x, _ = grid.xy(np.arange(grid.cols), 0)
    _, y = grid.xy(0, np.arange(grid.rows))
    coords: dict[str, Any] = {"y": y, "x": x}
    if grid.crs is not None:
        coords["spatial_ref"] = ((), 0, {"crs_wkt": grid.crs.to_wkt(), "spatial_ref": grid.crs.to_wkt()})
    return xr.DataArray(values, coords, ("band", "y", "x")[-values.ndim :], name, attrs)
