"""The input of a build: anything with a grid that reads windows of heights (a Mosaic, or a wrapped Dem)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from orograph.geo.grid import Grid
from orograph.store.terrain import Heights

if TYPE_CHECKING:
    from orograph.store.stored import StoredTerrain


@runtime_checkable
class HeightSource(Protocol):
    """A raster of heights in a projected metric CRS (or none) that is read by windows, from any thread."""

    @property
    def grid(self) -> Grid: ...

    @property
    def name(self) -> str: ...

    @property
    def vertical(self) -> str | None: ...

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Heights of a half-open window, float32 metres, NaN where missing, the same whatever the window."""

    def fingerprint(self) -> str:
        """Differs whenever any height might differ; --resume compares it."""


class ArraySource:
    """Heights in memory as a source.

    Args:
        heights: (rows, cols) float32, metres, NaN where missing.
        grid: where they lie.
        name, vertical, attribution: as for a ``Dem``.
    """

    def __init__(
        self, heights: Heights, grid: Grid, name: str, vertical: str | None = None, attribution: tuple[str, ...] = ()
    ) -> None:
        self.heights, self.grid, self.name, self.vertical = heights, grid, name, vertical
        self.attribution = attribution

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        return self.heights[row0:row1, col0:col1]

    def fingerprint(self) -> str:
        digest = hashlib.sha256(repr((self.grid.shape, tuple(self.grid.transform), self.name, self.vertical)).encode())
        digest.update(np.ascontiguousarray(self.heights).view(np.uint8).data)
        return digest.hexdigest()[:32]


class StoreAgain(NamedTuple):
    """Opens a store as a source in another process (``store.handing``).

    Attributes:
        url: the store's. storage_options: for its bucket.
    """

    url: str
    storage_options: dict[str, Any] | None

    def open(self, made: Mapping[str, Any]) -> StoreSource:
        """The source."""
        from orograph.store.stored import open

        return StoreSource(open(self.url, storage_options=self.storage_options))


class StoreSource:
    """The full resolution of a store as a source."""

    def __init__(self, terrain: StoredTerrain) -> None:
        self.terrain, self.grid, self.name = terrain, terrain.grid, terrain.name
        self.vertical, self.attribution = terrain.vertical, terrain.attribution

    def again(self) -> tuple[StoreAgain, dict[str, Any]]:
        """An opener for other processes, and the arrays that it needs: none."""
        return StoreAgain(*self.terrain.storage.named()), {}

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        return self.terrain.read(0, row0, row1, col0, col1)

    def fingerprint(self) -> str:
        record = self.terrain.record
        return record.source if record.coding is None else f"{record.source} {record.coding.asked()}"
