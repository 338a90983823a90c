"""The original samples of a resampled terrain, kept in its store: a source lattice, array ``source/{i}/height``.

A build that resamples its sources keeps the originals: the finest lattice is number 0, on its own grid and in its own
CRS, as the sources' own numbers if these are whole metres (``Lattice.code``), else as float32 metres. Places get their
``height`` from them, as from the files themselves. Units: metres; samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from orograph.geo.grid import Grid, wkt_of
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.terrain import Heights

if TYPE_CHECKING:
    from orograph.dem.lattice import SourceLattice
    from orograph.dem.layers import LatticeMap

SOURCE = "source"
"""The group of the lattices."""


@dataclass(frozen=True, slots=True)
class LatticeRecord:
    """A store's record of a source lattice.

    Attributes:
        grid: where its samples lie.
        dtype: the type of its numbers.
        nodata: the number that means "missing", nan for float32.
    """

    grid: Grid
    dtype: str
    nodata: float

    @classmethod
    def of(cls, lattice: SourceLattice) -> LatticeRecord:
        return cls(lattice.grid, *lattice.code)

    def spec(self, number: int, shard: int, chunk: int) -> ArraySpec:
        """The array of the samples."""
        return ArraySpec(f"{SOURCE}/{number}/height", self.grid.shape, shard, chunk, self.dtype, self.nodata)

    def attributes(self) -> dict[str, Any]:
        """Attributes of the array, after CF."""
        missing = {} if math.isnan(self.nodata) else {"_FillValue": self.nodata}
        return {
            "units": "m", "standard_name": "surface_altitude", "long_name": "terrain height, samples of the source",
            "grid_mapping": "spatial_ref", **missing,
        }  # fmt: skip

    def encode(self, heights: Heights) -> NDArray[Any]:
        """The numbers of heights."""
        if self.dtype == "float32":
            return np.ascontiguousarray(heights)
        return np.where(np.isnan(heights), np.float32(self.nodata), heights).astype(self.dtype)

    def to_json(self) -> dict[str, Any]:
        return {
            "shape": list(self.grid.shape), "transform": list(self.grid.transform[:6]),
            "crs": wkt_of(self.grid.crs), "dtype": self.dtype,
            "nodata": None if math.isnan(self.nodata) else self.nodata,
        }  # fmt: skip

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> LatticeRecord:
        rows, cols = record["shape"]
        crs = None if record["crs"] is None else CRS.from_wkt(record["crs"])
        nodata = math.nan if record["nodata"] is None else record["nodata"]
        return cls(Grid((rows, cols), Affine(*record["transform"]), crs), record["dtype"], nodata)


class StoredLattice:
    """An array of a store as a lattice.

    Args:
        grid: where its samples lie.
        array: of the samples; its fill value means "missing".
    """

    def __init__(self, grid: Grid, array: ShardedArray) -> None:
        from orograph.dem.lattice import around

        self.grid, self._array = grid, array
        self._circle = around(grid)
        self.code = array.spec.dtype, array.spec.fill

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Read a window, which may reach beyond the grid (around a globe, columns repeat): float32 metres, NaN where
        missing.

        Raises:
            DamagedChunkError, StoreReplacedError: as ``ShardedArray.read``.
        """
        rows, cols = self.grid.shape
        out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
        a, b = max(row0, 0), min(row1, rows)
        for shift in (0, -self._circle, self._circle) if self._circle else (0,):
            c, d = max(col0 - shift, 0), min(col1 - shift, cols)
            if a < b and c < d:
                numbers = self._array.read(a, b, c, d)
                part = out[a - row0 : b - row0, c + shift - col0 : d + shift - col0]
                np.copyto(part, numbers, casting="unsafe", where=(numbers != self._array.spec.fill) & np.isnan(part))
        return out


class StoredSamples:
    """The original samples of a terrain, from its store (``store.terrain.Samples``).

    Args:
        grid: of the terrain.
        lattices: the finest first.
    """

    def __init__(self, grid: Grid, lattices: Sequence[StoredLattice]) -> None:
        self._grid, self._lattices = grid, lattices

    @cached_property
    def _layers(self) -> list[LatticeMap]:
        from orograph.dem.layers import layer_of

        return [layer_of(lattice, self._grid, "nearest") for lattice in self._lattices]

    def heights_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Heights (n,) at places (n,) in the terrain's CRS, bilinear between the samples; NaN where there is none.

        Raises:
            DamagedChunkError, StoreReplacedError: as ``Terrain.read``.
        """
        from orograph.dem.points import heights_at

        return heights_at(self._grid, self._layers, x, y)
