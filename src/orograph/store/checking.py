"""Checking a store: read every byte of it and compare it with what its root lists."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.store.array_spec import ArraySpec
from orograph.store.digests import CRC, Digests, Spot, crc32c, digest_of, tail_length, unsealed
from orograph.store.layout import array_specs, root_digest
from orograph.store.places import ROOT
from orograph.store.storage import Storage

if TYPE_CHECKING:
    from orograph.store.stored import StoredTerrain

GONE = "the file is not there"


class Damage(NamedTuple):
    """Something that is damaged.

    Attributes:
        key: the key of an object, or of a chunk (``heights/0/height/c/3/4[1,7]``).
        cause: what is wrong with it.
    """

    key: str
    cause: str

    @property
    def object(self) -> str:
        """The key of the object."""
        return self.key.partition("[")[0]


def check(terrain: StoredTerrain, *, jobs: int | None = None, progress: Progress = SILENT) -> list[Damage]:
    """Read everything: heights, means, tables, errors, layers, coordinates and metadata.

    Args:
        terrain: an opened store.
        jobs: threads (default: all processors). progress: receives progress by shards.

    Raises:
        StoreReplacedError: the store was replaced meanwhile.
        StoreError: it cannot be read.
    """
    storage, digests, place = terrain.storage, terrain.record.digests, terrain.url
    specs = array_specs(terrain.record)
    shards = [(spec, (i, j)) for spec in specs for i in range(spec.shards[0]) for j in range(spec.shards[1])]
    found: list[Damage] = []
    with progress.task("Checking the store", total=len(shards)) as task:
        for damage in map_ordered(lambda what: list(check_shard(storage, digests, *what)), shards, jobs):
            found += damage
            task.advance()
    found += _others(storage, digests, {spec.path for spec in specs})
    if found and terrain.watch is not None:
        terrain.watch.explain(found[0].key.partition("/c/")[0])
        if terrain.url != place:  # an update kept this version elsewhere
            return check(terrain, jobs=jobs, progress=progress)
    return found


def check_shard(storage: Storage, digests: Digests, spec: ArraySpec, spot: Spot) -> Iterator[Damage]:
    """Yield the faults of a shard."""
    key = spec.key(spot)
    data = storage.get(spec.place(spot, digests))
    if data is None:
        yield Damage(key, GONE)
        return
    try:
        places = unsealed(
            data[-tail_length(key, spec.chunks) :], key, spec.chunks, digests.get(spec.path, spec.shards, spot)
        )
    except ValueError as error:
        yield Damage(key, str(error))
        return
    wanted = max(start + length for start, length, _ in places) + tail_length(key, spec.chunks)
    if len(data) != wanted:
        yield Damage(key, f"it has {len(data):,} bytes where {wanted:,} were written")
    side = spec.shard // spec.chunk
    for number, (start, length, check_) in enumerate(places):
        if length:
            chunk = data[start : start + length]
            if crc32c(chunk[:-CRC]) != check_ or int.from_bytes(chunk[-CRC:], "little") != check_:
                yield Damage(f"{key}[{number // side},{number % side}]", "it fails its checksum")


def _others(storage: Storage, digests: Digests, arrays: Iterable[str]) -> Iterator[Damage]:
    """Yield the faults of coordinates and metadata."""
    for key in sorted(set(digests.listed) - set(arrays)):
        data = storage.get(key if key == ROOT else digests.place(key, bytes(digests.listed[key])))
        if data is None:
            yield Damage(key, GONE)
            continue
        try:
            digest = root_digest(json.loads(data)) if key == ROOT else digest_of(data)
        except (ValueError, KeyError, TypeError, RecursionError):
            digest = b""
        if digest != digests.listed[key]:
            yield Damage(key, "it is not what was written")
