"""Repairing a store: damaged objects are rebuilt, from its sources or from its intact objects.

Only shards of level 0, and the samples of source lattices, need the sources; all others depend on these. A rebuilt
shard replaces a damaged one only if its digest is the one that the root lists. So a repaired store is, byte for byte,
the one that was built, and sources that have changed since cannot alter it. Readers may be at work all the time.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError, StoreError
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.store.addresses import storage_at
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.build import MEMORY
from orograph.store.cache import ChunkCache
from orograph.store.checking import Damage, check, check_shard
from orograph.store.chunked import Kind
from orograph.store.chunked_kind import CHUNKED
from orograph.store.diamond_table import DIAMONDS
from orograph.store.digests import Digests, Spot, digest_of
from orograph.store.executing import Threads
from orograph.store.inputs import changes, reopened
from orograph.store.lattices import LatticeRecord
from orograph.store.layout import Record, array_specs, derived_arrays, heights_spec, metadata, rebuild
from orograph.store.lock import alone
from orograph.store.makers import MAKERS, Work
from orograph.store.places import ROOT
from orograph.store.pyramid import Finest, Pyramid, tasks
from orograph.store.quadtin_kind import QUADTIN
from orograph.store.registry import KINDS
from orograph.store.shards import go_through
from orograph.store.source import HeightSource
from orograph.store.storage import Storage
from orograph.store.stored import StoredTerrain, open
from orograph.store.terrain import Heights
from orograph.store.tin_kind import TINS
from orograph.store.ways import sizes
from orograph.store.writer import ShardWriter

if TYPE_CHECKING:
    from orograph.dem.lattice import SourceLattice


def repair(
    url: str | os.PathLike[str],
    source: HeightSource | None = None,
    *,
    max_memory: int = MEMORY,
    jobs: int | None = None,
    progress: Progress = SILENT,
    storage_options: dict[str, Any] | None = None,
) -> list[str]:
    """Rebuild what is damaged in a store; return the keys of what was damaged.

    Args:
        url: the store's.
        source: the heights it was built from; None: the files that its record names.
        max_memory: bytes the process should stay within.
        jobs: threads (default: all processors).

    Raises:
        StoreError: something could not be repaired; the message says what, why, and what to do. The rest was repaired.
    """
    storage = storage_at(url, storage_options)
    open(url, storage_options=storage_options).close()  # fails if there is no store, before anything is written
    with alone(storage, "repairing this store"), open(url, jobs=jobs, storage_options=storage_options) as terrain:
        found = check(terrain, jobs=jobs, progress=progress)
        if found:
            _Repair(terrain, found, source, max_memory, jobs, progress).run()
        return [damage.key for damage in found]


class _Mender(ShardWriter):
    """Writes damaged shards, if they come out as they were; writes nothing else.

    Args:
        storage: the store's storage.
        digests: the digests of its shards.
        damaged: keys of shards.
    """

    def __init__(self, storage: Storage, digests: Digests, damaged: set[str]) -> None:
        super().__init__(storage)
        self.digests, self.damaged = digests, damaged
        self.differing: set[str] = set()

    def shard(self, spec: ArraySpec, spot: Spot, block: NDArray[Any]) -> bytes:
        listed = self.digests.get(spec.path, spec.shards, spot)
        key = spec.key(spot)
        if key in self.damaged:
            parts, digest = spec.encode(spot, block)
            if digest == listed:
                self.storage.put(self.digests.place(key, digest), parts)
                self.damaged.discard(key)
            else:
                self.differing.add(key)
        return listed

    def keep(self, key: str, data: bytes) -> None:
        """Keep nothing: the stored results of tasks are not needed."""


class _StoredHeights:
    """Level 0 of a store as a source."""

    def __init__(self, terrain: StoredTerrain) -> None:
        self.grid, self.name, self.vertical = terrain.grid, terrain.name, terrain.vertical
        record = terrain.record
        spec = heights_spec(terrain.grid.shape, 0, record.shard, record.chunk, record.coding)
        self._array = ShardedArray(spec, terrain.storage, record.digests, ChunkCache(0), 1)
        self._source = record.source

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        heights: Heights = self._array.read(row0, row1, col0, col1)
        return heights

    def fingerprint(self) -> str:
        return self._source


class _Repair:
    """The repair of one store."""

    def __init__(
        self, terrain: StoredTerrain, found: list[Damage], source: HeightSource | None, max_memory: int,
        jobs: int | None, progress: Progress,
    ) -> None:  # fmt: skip
        self.terrain, self.record, self.found, self.source = terrain, terrain.record, found, source
        self.progress = progress
        record = self.record
        _, self.jobs = sizes(record.grid.shape, max_memory, jobs, record.shard, len(DIAMONDS.of(record).errors))
        self.mender = _Mender(terrain.storage, record.digests, {damage.object for damage in found})
        self.why = ""

    def run(self) -> None:
        """Repair everything, in the order of dependencies.

        Raises:
            StoreError: something could not be repaired.
        """
        self._small()
        if self._any("heights/0/height/c/"):
            self._finest()
        if self._any("heights/0/height/c/"):
            raise self._left()
        if self._any("source/"):
            self._lattices()
        if self._any("heights/", "mean/", "tiles/"):
            self._coarse()
        for name, make in MAKERS.items():
            if self._any(*(f"{spec.path}/c/" for kind, spec, _ in derived_arrays(self.record) if kind.name == name)):
                errors = tuple(DIAMONDS.of(self.record).errors)
                tins = TINS.of(self.record).get("legs")
                found = CHUNKED.of(self.record)
                chunked = Kind(*(found[name] for name in Kind._fields)) if found else None
                options = QUADTIN.of(self.record).get("asked")
                quadtin = (options[0], options[1]) if options else None
                threads = Threads(self.jobs, False)
                make(self.record, Work(errors, self.mender, self.jobs, threads, self.progress, tins, chunked, quadtin))
        self._prove()
        if self.mender.damaged:
            raise self._left()

    def _any(self, *beginnings: str) -> bool:
        """Whether there is damage left below these keys."""
        return any(key.startswith(beginnings) for key in self.mender.damaged)

    def _small(self) -> None:
        """Rewrite coordinates and metadata, from the record."""
        others, root = metadata(self.record)
        digests = self.record.digests
        for key in sorted(self.mender.damaged & {*others, ROOT}):
            content = root[ROOT] if key == ROOT else others[key]
            if key == ROOT or digest_of(content) == digests.listed[key]:
                place = key if key == ROOT else digests.place(key, digest_of(content))
                self.terrain.storage.put(place, [content])
                self.mender.damaged.discard(key)
            else:
                self.mender.differing.add(key)

    def _finest(self) -> None:
        """Rebuild shards of level 0, from the source."""
        source = self._opened()
        if source is None:
            return
        record = self.record
        if source.grid.shape != record.grid.shape:
            self.why = f"{source.name} has {source.grid.shape} samples and the store {record.grid.shape}."
            return
        finest = Finest(source, self.mender, record.shard, record.chunk, record.coding)
        spec, side = finest.spec, record.shard

        def make(spot: Spot) -> None:
            self.mender.shard(spec, spot, np.ascontiguousarray(finest.read(spot)[0][:side, :side]))

        spots = [spot for spot in tasks(record.grid.shape, record.shard) if spec.key(spot) in self.mender.damaged]
        go_through("Mending heights", spots, make, self.jobs, self.progress)

    def _lattices(self) -> None:
        """Rebuild shards of source lattices, from the source."""
        source = self._opened()
        if source is None:
            return
        record, lattices = self.record, getattr(source, "resampled_from", ())
        if [each.grid.shape for each in lattices] != [each.grid.shape for each in record.lattices]:
            self.why = f"{source.name} lies on other lattices than the sources of the store."
            return
        for number, (kept, lattice) in enumerate(zip(record.lattices, lattices, strict=True)):
            spec = kept.spec(number, record.shard, record.chunk)
            spots = [spot for spot in tasks(spec.shape, spec.shard) if spec.key(spot) in self.mender.damaged]

            def make(
                spot: Spot, spec: ArraySpec = spec, kept: LatticeRecord = kept, lattice: SourceLattice = lattice
            ) -> None:
                self.mender.shard(spec, spot, kept.encode(lattice.read(*spec.window(spot))))

            go_through("Repairing samples of the source", spots, make, self.jobs, self.progress)

    def _opened(self) -> HeightSource | None:
        """The source that was given, or that the record names; None, with the reason in ``why``, if neither opens."""
        if self.source is not None:
            return self.source
        inputs = self.record.inputs
        if inputs is None:
            self.why = "It was built from heights in memory: give them again."
            return None
        self.why = " ".join(changes(inputs))
        try:
            self.source = reopened(inputs, self.progress)
        except OrographError as error:
            self.why = self.why or str(error)
        return self.source

    def _coarse(self) -> None:
        """Rebuild coarser levels, means and tables, from level 0."""
        record = self.record
        heights: HeightSource | None = _StoredHeights(self.terrain)
        if record.coding is not None and record.coding.codec == "progressive":  # its level 0 depends on those above
            heights = self._opened()
        if heights is None:
            raise self._left()
        finest = Finest(heights, self.mender, record.shard, record.chunk, record.coding)
        Threads(self.jobs, False).run(Pyramid(finest, "Mending levels"), self.progress)

    def _prove(self) -> None:
        """Read back what was written."""
        mended = {damage.object for damage in self.found} - self.mender.damaged
        shards = [
            (spec, (i, j))
            for spec in array_specs(self.record)
            for i in range(spec.shards[0])
            for j in range(spec.shards[1])
            if spec.key((i, j)) in mended
        ]
        storage, digests = self.terrain.storage.uncached(), self.record.digests
        for damage in map_ordered(lambda what: list(check_shard(storage, digests, *what)), shards, self.jobs):
            self.mender.damaged |= {each.object for each in damage}

    def _left(self) -> StoreError:
        """The error that says what could not be repaired, and what to do about it."""
        left = sorted(self.mender.damaged)
        names = ", ".join(left[:3]) + (f" and {len(left) - 3} more" if len(left) > 3 else "")
        differing = "Its sources now give other data than it held." if self.mender.differing else ""
        remedies = _remedies(left, self.record, self.terrain.url)
        return StoreError(
            " ".join(filter(None, [f"{names} could not be repaired.", self.why, differing])),
            path=self.terrain.url,
            remedy=" ".join(remedies),
        )


def _remedies(left: Iterable[str], record: Record, url: str) -> list[str]:
    """Calls that rebuild what cannot be repaired."""
    remedies, others = [], set(left)
    for kind in KINDS.values():
        keys = [key for key in left if key.partition("/")[0] == kind.group]
        remedy = kind.remedy(url, keys) if keys else None
        if remedy is not None:
            remedies.append(remedy)
            others -= set(keys)
    if others:
        remedies.append(f"Give the files it was built from, as they were, or restore those files from a copy. "
                    f"{rebuild(record.to_json(), url)}")  # fmt: skip
    return remedies
