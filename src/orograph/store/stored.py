"""A terrain read from a store: opened by one small read, then chunk by chunk through a cache of a fixed size."""

from __future__ import annotations

import json
import os
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error import KINDS, ErrorKind
from orograph.error.quantise import RadiusCode
from orograph.errors import DamagedChunkError, StoreError, UsageError
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.diamonds import place
from orograph.store.layers import LayerBand, LayerRecord, StoredLayer, layer_spec
from orograph.store.layout import (
    PLAN,
    ROOT,
    TABLES_AND_VALID,
    Record,
    diamond_spec,
    heights_spec,
    mean_spec,
    table_spec,
)
from orograph.store.patches import KAPPA, stored_levels
from orograph.store.patches import spec as patch_spec
from orograph.store.storage import FolderStorage, Storage, storage_at
from orograph.store.terrain import Heights, Terrain, TileTable

CACHE_BYTES = 256 << 20
"""Decoded chunks a terrain keeps unless told otherwise."""


class StoredTerrain(Terrain):
    """A terrain in a store; make it with ``open``.

    Args:
        storage: where the store lies.
        record: what it says of itself.
        cache_bytes: budget of decoded chunks.
        jobs: threads for large windows.

    Attributes:
        supplied: errors of diamonds that the store lacks and that were made in memory (``supply``), by their kind.
    """

    def __init__(self, storage: Storage, record: Record, cache_bytes: int, jobs: int | None) -> None:
        self.storage, self.record = storage, record
        self.grid, self.name, self.vertical = record.grid, record.name, record.vertical
        self.remote = storage.remote
        self.cache = ChunkCache(cache_bytes)
        self._jobs = jobs
        self._lock = threading.Lock()
        self._arrays: dict[tuple[str, int], ShardedArray] = {}
        self._tables: dict[int, TileTable] = {}
        self._top: Heights | None = None
        self._coarsest: Heights | None = None
        self.supplied: dict[ErrorKind, Terrain] = {}

    @property
    def url(self) -> str:
        """Path or URL of the store."""
        return self.storage.url

    @property
    def height_range(self) -> tuple[float, float]:
        return self.record.height_range

    @property
    def valid_fraction(self) -> float:
        return self.record.valid_fraction

    @property
    def errors(self) -> tuple[ErrorKind, ...]:
        """The kinds of errors it has of its diamonds."""
        return tuple(self.record.errors)

    @property
    def size_bytes(self) -> int | None:
        """Bytes of the store on disk; None where the storage cannot list what it has (a web server)."""
        return self.storage.size()

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        array = self._array("heights", level)
        self._inside(array.spec.shape, row0, row1, col0, col1)
        if level < self.levels - 1:
            return array.read(row0, row1, col0, col1)
        # The coarsest level is small, and what frames ask for on the spot (the range of a tint): it stays.
        if self._coarsest is None:
            self._coarsest = array.read(0, array.spec.shape[0], 0, array.spec.shape[1])
        return self._coarsest[row0:row1, col0:col1].copy()

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        array = self._array("mean" if level else "heights", level)
        self._inside(array.spec.shape, row0, row1, col0, col1)
        return array.read(row0, row1, col0, col1)

    def tiles(self, level: int) -> TileTable:
        self._check(level)
        table = self._tables.get(level)
        if table is None:
            once = ChunkCache(0)  # tables are kept whole, not by chunks
            shape, record = self.grid.shape, self.record
            columns: dict[str, Any] = {}
            for name in TABLES_AND_VALID:
                spec = table_spec(shape, level, name, record.shard, record.chunk)
                values = ShardedArray(spec, self.storage, once, 1).read(0, spec.shape[0], 0, spec.shape[1])
                values.flags.writeable = False
                columns[name] = values
            table = self._tables[level] = TileTable(**columns)
        return table

    def diamonds(
        self, kind: ErrorKind, level: int, row0: int, row1: int, col0: int, col1: int
    ) -> tuple[Heights, Heights]:
        if kind not in KINDS:
            raise UsageError(f"There is no error called {kind!r}; there are {', '.join(KINDS)}.")
        self._inside(self.diamond_shape(level), row0, row1, col0, col1)
        if kind in self.supplied:
            return self.supplied[kind].diamonds(kind, level, row0, row1, col0, col1)
        code, radius = self.record.errors.get(kind), self.record.radius
        if code is None or radius is None:
            wanted = ",".join([*self.record.errors, kind])
            raise StoreError(
                f"This store has no {kind} errors.",
                path=self.url,
                remedy=f"Build it again with them (orograph build --errors {wanted} --overwrite).",
            )
        window = row0, row1, col0, col1
        errors = code.decode(self._array(kind, level).read(*window))
        if level == self.levels - 1:
            return errors, self._top_radii(radius)[row0:row1, col0:col1]
        return errors, radius.decode(self._array("radius", level).read(*window), row0, col0, level)

    def supply(self, kind: ErrorKind) -> None:
        """Make errors of diamonds that the store lacks, in memory: about 19 bytes per sample.

        Raises:
            DamagedChunkError: as ``read``.
        """
        from orograph.store.memory import MemoryTerrain

        rows, cols = self.grid.shape
        made = next(iter(self.supplied.values()), None)
        made = made or MemoryTerrain(self.read(0, 0, rows, 0, cols), self.grid, self.name)
        made.diamonds(kind, 0, 0, 1, 0, 1)
        self.supplied[kind] = made

    def color_codes(self, level: int, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.uint8]:
        """The codes of color errors of diamonds (see ``geovis.color_store``), a window of ``diamond_shape(level)``.

        Raises:
            StoreError: the store has none.
        """
        if not self.record.colors:
            raise StoreError(
                "This store has no color errors.", path=self.url, remedy="Build it with them (--color-errors)."
            )
        self._inside(self.diamond_shape(level), row0, row1, col0, col1)
        codes: NDArray[np.uint8] = self._array("color", level).read(row0, row1, col0, col1)
        return codes

    def has_patch_errors(self, kind: ErrorKind, legs: int) -> bool:
        said = self.record.patches
        return said == {"legs": legs, "kappa": KAPPA} and kind in self.record.errors

    def patch_errors(self, kind: ErrorKind, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        if not self.record.patches or kind not in self.record.errors:
            return super().patch_errors(kind, level, row0, row1, col0, col1)
        self._inside(self.diamond_shape(level), row0, row1, col0, col1)
        return self._patches(kind, level).read(row0, row1, col0, col1)

    def _patches(self, kind: ErrorKind, level: int) -> ShardedArray:
        key = f"patches/{kind}", level
        found = self._arrays.get(key)
        if found is None:
            spec = patch_spec(self.grid.shape, level, kind, self.record.shard, self.record.chunk)
            with self._lock:
                found = self._arrays.setdefault(key, ShardedArray(spec, self.storage, self.cache, self._jobs))
        return found

    def _top_radii(self, radius: RadiusCode) -> Heights:
        """The decoded radii of the top level, several octaves."""
        if self._top is None:
            level = self.levels - 1
            side, _ = self.diamond_shape(level)
            codes = self._array("radius", level).read(0, side, 0, side)
            radii = np.zeros((side, side), np.float32)
            for octave in range(level, self.n):
                step = 1 << (octave - level)
                place(radii, radius.decode(codes[::step, ::step], 0, 0, octave), octave, 0, 0, level)
            radii.flags.writeable = False
            self._top = radii
        return self._top

    @property
    def layers(self) -> tuple[str, ...]:
        return tuple(self.record.layers)

    def layer(self, name: str, **options: Any) -> StoredLayer:
        record = self.record.layers.get(name)
        if record is None:
            return super().layer(name)
        again = f"Bake it again (orograph bake {self.url} --products {name})."
        if record.source != self.record.source:
            raise StoreError(f"Its layer {name!r} was made from other heights.", path=self.url, remedy=again)
        for key, wanted in options.items():
            if key not in record.options:
                raise UsageError(f"Layer {name!r} is not made with {key!r}, but {', '.join(record.options)}.")
            if record.options[key] != wanted:
                raise StoreError(
                    f"Its layer {name!r} was made with {key} {_said(record.options[key])}, not {_said(wanted)}.",
                    path=self.url,
                    remedy=again,
                )
        return StoredLayer(record, self.grid.shape, lambda band, level: self._coded(record, band, level))

    def _coded(self, record: LayerRecord, band: LayerBand, level: int) -> ShardedArray:
        key = f"{record.name}/{band.name}", level
        found = self._arrays.get(key)
        if found is None:
            spec = layer_spec(self.grid.shape, record.name, level, band, self.record.shard, self.record.chunk)
            with self._lock:
                found = self._arrays.setdefault(key, ShardedArray(spec, self.storage, self.cache, self._jobs))
        return found

    def close(self) -> None:
        self.cache.clear()
        self.storage.close()

    def _array(self, kind: str, level: int) -> ShardedArray:
        found = self._arrays.get((kind, level))
        if found is None:
            self._check(level)
            at = self.grid.shape, level
            sizes = self.record.shard, self.record.chunk
            if kind == "heights":
                spec = heights_spec(*at, *sizes)
            elif kind == "mean":
                spec = mean_spec(*at, *sizes)
            else:
                spec = diamond_spec(*at, kind, *sizes)
            with self._lock:
                found = self._arrays.setdefault((kind, level), ShardedArray(spec, self.storage, self.cache, self._jobs))
        return found

    def check(self) -> list[str]:
        """Read every chunk and return the keys of the damaged ones."""
        damaged: list[str] = []
        kinds = ["heights", "mean", *self.record.errors, *(["radius"] if self.record.radius else []),
                 *(["color"] if self.record.colors else [])]  # fmt: skip
        for level in range(self.levels):
            arrays = [self._array(kind, level) for kind in kinds if level or kind != "mean"]
            arrays += [self._coded(layer, b, level) for layer in self.record.layers.values() for b in layer.bands]
            if self.record.patches and level in stored_levels(self.grid.shape, int(self.record.patches["legs"])):
                arrays += [self._patches(kind, level) for kind in self.record.errors]
            for spec in (array.spec for array in arrays):
                array = ShardedArray(spec, self.storage, ChunkCache(0), self._jobs)
                for row in range(0, spec.shape[0], spec.chunk):
                    for col in range(0, spec.shape[1], spec.chunk):
                        rows, cols = min(row + spec.chunk, spec.shape[0]), min(col + spec.chunk, spec.shape[1])
                        try:
                            array.read(row, rows, col, cols)
                        except DamagedChunkError as error:
                            if error.chunk not in damaged:
                                damaged.append(error.chunk)
            try:
                self.tiles(level)
            except DamagedChunkError as error:
                damaged.append(error.chunk)
        return damaged


def _said(value: Any) -> str:
    return "unlimited" if value is None else str(value)


def open(
    url: str | os.PathLike[str],
    *,
    cache_bytes: int = CACHE_BYTES,
    jobs: int | None = None,
    storage_options: dict[str, Any] | None = None,
) -> StoredTerrain:
    """Open a store for reading.

    Args:
        url: a folder, or any URL fsspec reads (``file://``, ``memory://``, ``s3://``, ``http://``…).
        cache_bytes: how many bytes of decoded chunks to keep; 0 keeps none.
        jobs: threads for large windows (default: all processors).
        storage_options: for the fsspec file system (``endpoint_url``, ``anon``…).

    Raises:
        StoreError: there is no store, its build is not finished, it has another format than this reader, or its
            metadata is damaged.
    """
    storage = storage_at(url, storage_options)
    return StoredTerrain(storage, read_record(storage), cache_bytes, jobs)


def partial(path: str | os.PathLike[str]) -> str:
    """The folder in which a store is built until it is complete."""
    return os.fspath(path).rstrip("/\\") + ".partial"


def read_record(storage: Storage) -> Record:
    """What the store says of itself.

    Raises:
        StoreError: see ``open``.
    """
    url = storage.url
    data = storage.get(ROOT)
    if data is None:
        begun = storage.exists(PLAN)
        if not begun and isinstance(storage, FolderStorage):
            begun = FolderStorage(partial(storage.path)).exists(PLAN)
        if begun:
            raise StoreError(
                "This store is incomplete: its build was interrupted.",
                path=url,
                remedy="Finish it by running the same orograph build with --resume.",
            )
        missing = isinstance(storage, FolderStorage) and not storage.path.exists()
        raise StoreError(
            "There is no such store." if missing else "This is not an Orograph store (it has no zarr.json).",
            path=url,
            remedy="Build one with orograph build DEM... -o STORE.",
        )
    try:
        document = json.loads(data)
        record = document["attributes"].get("orograph") if document.get("node_type") == "group" else None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreError(
            f"The store's zarr.json is damaged: {error}.",
            path=url,
            remedy="Build the store again (orograph build --overwrite).",
        ) from error
    if not isinstance(record, dict):
        raise StoreError(
            "This is a Zarr hierarchy, but not an Orograph store.",
            path=url,
            remedy="Build one from the DEM with orograph build DEM... -o STORE.",
        )
    return Record.from_json(record, url)


def is_store(storage: Storage) -> bool:
    """Whether a complete store of any format lies there."""
    data = storage.get(ROOT)
    try:
        return data is not None and isinstance(json.loads(data)["attributes"]["orograph"], dict)
    except (ValueError, KeyError, TypeError):
        return False
