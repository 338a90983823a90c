"""The xarray accessor ``da.orograph``: a DataArray of heights as a Dem, a Terrain, a picture.

Importing this module registers it (``import orograph.accessor``; ``import orograph`` does so too where xarray is
imported already); every method forwards to a plain function. ``dem.dataarray`` says what is read from the array.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import xarray as xr

from orograph.dem.dataarray import from_xarray
from orograph.dem.raster import Dem

if TYPE_CHECKING:
    from pyproj import CRS

    from orograph.store import Terrain


@xr.register_dataarray_accessor("orograph")  # type: ignore[no-untyped-call]
class OrographAccessor:
    """``da.orograph``: the array seen as elevation."""

    def __init__(self, array: xr.DataArray) -> None:
        self._array = array

    def to_dem(self, *, crs: str | CRS | None = None, name: str | None = None) -> Dem:
        """The array as a Dem; see ``from_xarray``."""
        return from_xarray(self._array, crs=crs, name=name)

    def to_terrain(self, *, crs: str | CRS | None = None, name: str | None = None) -> Terrain:
        """The array as a terrain in memory, brought to a projected metric CRS if it is not in one (``Mosaic``)."""
        from orograph.store import terrain

        return terrain(self._array, crs=crs, name=name)

    def light(self, products: str, **options: Any) -> xr.DataArray:
        """Light products of the array's ground by name; see ``orograph.light``."""
        from orograph.lighting import make

        made: xr.DataArray = make(self._array, products, **options)
        return made

    def render(self, view: Any = None, *, crs: str | CRS | None = None, name: str | None = None, **options: Any) -> Any:
        """A picture of the array; see ``orograph.render(terrain, view, **options)``."""
        from orograph.rendering.api import render

        return render(self.to_terrain(crs=crs, name=name), view, **options)
