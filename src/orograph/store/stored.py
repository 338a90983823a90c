"""A terrain read from a store: opened by one small read, then chunk by chunk through a cache of a fixed size."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import PurePath
from typing import Any
from urllib.parse import unquote, urlsplit

from orograph._named import answering
from orograph.cards import Row, amount
from orograph.error import ErrorKind
from orograph.errors import StoreError
from orograph.folders import Amount, bytes_of, cache_folder
from orograph.progress import SILENT, Progress
from orograph.store.addresses import storage_at
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.diamond_table import DIAMONDS
from orograph.store.lattices import StoredLattice, StoredSamples
from orograph.store.layers import LAYERS, StoredLayer
from orograph.store.layout import (
    TABLES_AND_VALID,
    Record,
    heights_spec,
    mean_spec,
    rebuild,
    table_spec,
)
from orograph.store.places import ROOT, missing
from orograph.store.points import POINTS, StoredPoints
from orograph.store.registry import kind_of
from orograph.store.storage import Storage
from orograph.store.terrain import Heights, Terrain, TileTable
from orograph.store.versions import number, older
from orograph.store.watch import Watch

Key = tuple[str, tuple[tuple[str, Any], ...]]
"""Derived data by name and the options they were made with."""

CACHE_BYTES = 256 << 20
"""Default budget of decoded chunks in bytes."""


class StoredTerrain(Terrain):
    """A terrain in a store; make it with ``open``.

    Args:
        storage: where the store lies.
        record: the store's record.
        cache_bytes: budget of decoded chunks.
        jobs: threads for large windows.
        watch: notices when the store is replaced; None: it never is.
        version: the store's version; None if versions are not numbered.

    Attributes:
        supplied: derived data that the store lacks and that were computed in memory (``supply``), by name and options.
    """

    use: object | None = None
    """Keeps it in the cache folder while it is read (``kept.Use``)."""

    def __init__(
        self, storage: Storage, record: Record, cache_bytes: int, jobs: int | None, watch: Watch | None = None,
        version: int | None = None,
    ) -> None:  # fmt: skip
        self.storage, self.record, self.watch, self.version = storage, record, watch, version
        self.grid, self.name, self.vertical = record.grid, _name(record, storage), record.vertical
        self.attribution = record.attribution
        self.remote = storage.remote
        self._last = self.levels - 1  # computed once: it would slow down reads of small windows
        self.cache = ChunkCache(cache_bytes)
        self._jobs = jobs
        self._arrays: dict[tuple[str, int], ShardedArray] = {}
        self._tables: dict[int, TileTable] = {}
        self._coarsest: Heights | None = None
        self.supplied: dict[Key, Terrain] = {}
        self._opened_data: dict[Key, Any] = {}
        self.resampled = record.resampled
        if POINTS.of(record):
            self.samples = StoredPoints(self)
        elif record.lattices:
            self.samples = StoredSamples(self.grid, [self._lattice(number) for number in range(len(record.lattices))])

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
        """The kinds of errors of its diamonds."""
        return tuple(DIAMONDS.of(self.record).errors)

    @property
    def size_bytes(self) -> int | None:
        """Bytes of the store on disk; None if the storage cannot list its objects (a web server)."""
        return self.storage.size()

    def _kept(self) -> list[Row]:
        rows = [("layers", ", ".join(self.layers))] if self.layers else []
        size = None if self.remote else self.size_bytes  # (not worth network requests)
        version = "" if self.version is None else f", version {self.version}"
        newest = ", not the newest" if version and self.watch is not None and self.watch.replaced else ""
        return [*rows, ("store", self.url + version + newest + ("" if size is None else f", {amount(size)}"))]

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        array = self._array("heights", level)
        self.check_window(array.spec.shape, row0, row1, col0, col1)
        if level < self._last:
            return array.read(row0, row1, col0, col1)
        if self.watch is not None:
            self.watch()
        # The coarsest level is small, and frames need it at once (for the range of a tint): it stays in memory.
        if self._coarsest is None:
            self._coarsest = array.read(0, array.spec.shape[0], 0, array.spec.shape[1])
        return self._coarsest[row0:row1, col0:col1].copy()

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        array = self._array("mean" if level else "heights", level)
        self.check_window(array.spec.shape, row0, row1, col0, col1)
        return array.read(row0, row1, col0, col1)

    def tiles(self, level: int) -> TileTable:
        self._check(level)
        if self.watch is not None:
            self.watch()
        table = self._tables.get(level)
        if table is None:
            once = ChunkCache(0)  # tables are kept whole, not by chunks
            shape, record = self.grid.shape, self.record
            columns: dict[str, Any] = {}
            for name in TABLES_AND_VALID:
                spec = table_spec(shape, level, name, record.shard, record.chunk)
                array = ShardedArray(spec, self.storage, record.digests, once, 1, self.watch)
                values = array.read(0, spec.shape[0], 0, spec.shape[1])
                values.flags.writeable = False
                columns[name] = values
            table = self._tables[level] = TileTable(**columns)
        return table

    def derived(self, name: str, **options: Any) -> Any:
        key = _key(name, options)
        if key not in self._opened_data:
            made = self.supplied.get(key)
            source = kind_of(name).open(self, **options) if made is None else made.derived(name, **options)
            self._opened_data[key] = source
        return self._opened_data[key]

    def has(self, name: str, **options: Any) -> bool:
        made = _key(name, options) in self.supplied
        return made or kind_of(name).has(self, **options)

    def supply(self, name: str, **options: Any) -> None:
        """Compute derived data that the store lacks, in memory: for diamonds about 19 bytes per sample.

        Raises:
            DamagedChunkError: as ``read``.
        """
        from orograph.store.memory import MemoryTerrain

        rows, cols = self.grid.shape
        made = next(iter(self.supplied.values()), None)
        made = made or MemoryTerrain(self.read(0, 0, rows, 0, cols), self.grid, self.name)
        made.derived(name, **options)
        self.supplied[_key(name, options)] = made

    @property
    def layers(self) -> tuple[str, ...]:
        return tuple(LAYERS.of(self.record))

    def layer(self, name: str, **options: Any) -> StoredLayer:
        if name not in self.layers:
            return super().layer(name)
        layer: StoredLayer = LAYERS.open(self, layer=name, **options)
        return layer

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process opens the store itself."""
        return _same, (self.storage.named(), self.cache.budget, self._jobs, self.record.source)

    def close(self) -> None:
        self.cache.clear()
        self.storage.close()

    def reopen(self) -> StoredTerrain:
        """Open the store that is there now, for example after a ``StoreReplacedError``; this terrain stays unchanged.

        Raises:
            StoreError: as ``open``.
        """
        return _open(self.storage.uncached(), self.cache.budget, self._jobs)

    def _array(self, kind: str, level: int) -> ShardedArray:
        found = self._arrays.get((kind, level))
        if found is not None:
            return found
        self._check(level)
        at = self.grid.shape, level, self.record.shard, self.record.chunk, self.record.coding
        if kind == "heights":
            return self.opened(kind, level, lambda: heights_spec(*at))
        return self.opened(kind, level, lambda: mean_spec(*at))

    def opened(self, name: str, level: int, spec: Callable[[], ArraySpec]) -> ShardedArray:
        """An array, the same one each time."""
        found = self._arrays.get((name, level))
        if found is None:
            found = ShardedArray(spec(), self.storage, self.record.digests, self.cache, self._jobs, self.watch)
            found = self._arrays.setdefault((name, level), found)
        return found

    def _lattice(self, number: int) -> StoredLattice:
        """A source lattice of the store."""
        record, sizes = self.record.lattices[number], (self.record.shard, self.record.chunk)
        return StoredLattice(record.grid, self.opened("source", number, lambda: record.spec(number, *sizes)))

    def check(self, progress: Progress = SILENT) -> list[str]:
        """Read everything, and return the keys of damaged objects (``checking.check`` also says what is wrong)."""
        from orograph.store.checking import check

        return [found.key for found in check(self, jobs=self._jobs, progress=progress)]


def _key(name: str, options: dict[str, Any]) -> Key:
    return name, tuple(sorted(options.items()))


@answering
def open(
    url: str | os.PathLike[str],
    *,
    cache_bytes: Amount = CACHE_BYTES,
    jobs: int | None = None,
    storage_options: dict[str, Any] | None = None,
) -> StoredTerrain:
    """Open a store for reading.

    Args:
        url: a folder, or a URL (``s3://``, ``gs://``, ``az://``, ``http://``, and any other that fsspec reads). If the
            store is updated, ``STORE@2`` is its second version.
        cache_bytes: how many bytes of decoded chunks to keep; 0 keeps none.
        jobs: threads for large windows (default: all processors).
        storage_options: for the bucket, in addition to the environment (obstore's: ``endpoint``, ``skip_signature``…).

    Raises:
        StoreError: there is no store, its build is not finished, this reader does not know its format, or its
            metadata is damaged.
    """
    kept = 0 if cache_bytes == 0 else bytes_of(cache_bytes, "cache_bytes")
    return _open(storage_at(url, storage_options), kept, jobs)


def _open(storage: Storage, cache_bytes: int, jobs: int | None) -> StoredTerrain:
    while True:
        # Take the stamp before the record: then the first read detects a replacement. (At a URL it compares records.)
        stamp = None if storage.remote else storage.stamp(ROOT)
        record = read_record(storage)
        version = number(storage)
        if version is None and record.version is not None:
            version = record.version.number
        if storage.remote or storage.stamp(ROOT) == stamp:
            break
    return StoredTerrain(storage, record, cache_bytes, jobs, Watch(storage, record, stamp, read_record), version)


def _same(named: tuple[str, dict[str, Any] | None], cache_bytes: int, jobs: int | None, source: str) -> StoredTerrain:
    """Open the store that another process has open, or the version of it that was kept since.

    Raises:
        StoreError: a different store is there, or none.
    """
    storage = storage_at(*named)
    found = _open(storage, cache_bytes, jobs)
    before = [] if found.record.source == source else older(storage)
    while found.record.source != source and before:
        found = _open(before.pop(0)[1], cache_bytes, jobs)
    if found.record.source != source:
        raise StoreError(
            "A worker finds a different store there than the process that started the work.", path=found.url,
            remedy="Check that all of them share one file system.",
        )  # fmt: skip
    return found


def read_record(storage: Storage) -> Record:
    """Read the record of a store.

    Raises:
        StoreError: see ``open``.
    """
    data = storage.get(ROOT)
    if data is None:
        raise missing(storage)
    return record_of(data, storage.url)


def record_of(data: bytes, url: str) -> Record:
    """Parse the record in the root of a store.

    Raises:
        StoreError: it is damaged, is not a store's, or is of a format that this reader does not know.
    """
    try:
        document = json.loads(data)
        record = document["attributes"].get("orograph") if document.get("node_type") == "group" else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise StoreError(
            f"The store's zarr.json is damaged: {error}.",
            path=url,
            remedy=rebuild({}, url),
        ) from error
    if not isinstance(record, dict):
        raise StoreError(
            "This is a Zarr hierarchy, but not an Orograph store.",
            path=url,
            remedy="Build one from the DEM: `orograph.build(dem, store)`.",
        )
    return Record.from_json(record, url)


def _name(record: Record, storage: Storage) -> str:
    """The name of a store: its folder's if it was made from files, because files are named after tiles.

    Heights in memory bring their own name; folders in the cache and of unfinished builds have none.
    """
    folder = PurePath(unquote(urlsplit(storage.url).path) if storage.remote else storage.url)
    nameless = folder.parent == cache_folder() or folder.name.startswith(".") or not folder.stem
    return record.name if record.inputs is None or nameless else folder.stem
