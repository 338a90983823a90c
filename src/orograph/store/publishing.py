"""Copying a finished store to a URL: every object is verified before and after it is sent; the root comes last.

No folder or bucket is listed: the root of the store lists all objects and their digests. An interrupted copy resumes:
objects that are already there and correct are not sent again.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, NamedTuple

from orograph._named import answering
from orograph.errors import DamagedChunkError, StoreError, UsageError
from orograph.parallel import map_ordered
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.addresses import storage_at
from orograph.store.array_spec import ArraySpec
from orograph.store.checking import check_shard
from orograph.store.digests import Digests, Spot, digest_of, tail_length, unsealed
from orograph.store.layout import array_specs, metadata
from orograph.store.lock import alone
from orograph.store.places import PLAN, ROOT, begun, is_store
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import StoredTerrain
from orograph.store.stored import open as open_store

AT_ONCE = 16
"""Concurrent transfers: they wait for the network, not for the processor."""


class Published(NamedTuple):
    """The outcome of a copy.

    Attributes:
        objects: how many the store has. sent: how many were sent. size: bytes that were sent.
    """

    objects: int
    sent: int
    size: int


@answering
def publish(
    store: StoredTerrain | str | os.PathLike[str],
    url: str,
    *,
    overwrite: bool = False,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    storage_options: dict[str, Any] | None = None,
) -> Published:
    """Copy a finished store to a URL, where it can be opened once all of it is there and verified.

    Repeating an interrupted copy resumes it. If the store lies in a bucket and is updated, one version is
    copied, to plain keys.

    Args:
        store: opened, or its path or URL.
        url: the destination: ``s3://bucket/area.oro``, ``gs://``, ``az://``…
        overwrite: replace a store that is there; it is gone from the beginning.
        jobs: concurrent transfers; None: 16.
        progress: receives progress; None: bars in terminals and notebooks, and Python's warnings; False: silent.
        storage_options: for the bucket, in addition to the environment (obstore's: ``endpoint``, ``skip_signature``…).

    Raises:
        DamagedChunkError: the store is damaged; what was sent does not open as a store.
        StoreError: a store, or another writer, is there, or it cannot be written.
        UsageError: ``url`` is a folder (copy the store with the system's own tools), or an older version of a store.
    """
    target = storage_at(url, storage_options)
    if isinstance(target, FolderStorage):
        raise UsageError("Stores are published at URLs.", remedy="To put a store into a folder, just copy it.")
    if not isinstance(store, StoredTerrain):
        with open_store(store) as opened:
            return publish(
                opened, url, overwrite=overwrite, jobs=jobs, progress=progress, storage_options=storage_options
            )
    if target.number is not None:
        raise UsageError("This is an older version of a store, which does not change.", path=target.url)
    root = store.storage.get(ROOT)
    if root is None:
        raise StoreError("The store is gone.", path=store.url)
    if store.record.version is not None:
        record = store.record
        plain = replace(record, version=None, digests=Digests(record.digests.listed))
        root = metadata(plain)[1][ROOT]
    with alone(target, "publishing this store"):
        if is_store(target):
            if not overwrite:
                if target.get(ROOT) == root:
                    return Published(len(_Copy(store, target).objects) + 1, 0, 0)
                raise StoreError(
                    "A store is there already.", path=target.url, remedy="Use `overwrite=True` to replace it."
                )
            target.remove(ROOT)  # first, so that a half-removed store does not look complete
            target.remove()
        elif begun(target):
            raise StoreError(
                "A build of a store was begun there.", path=target.url,
                remedy="Finish it, or name another place.",
            )  # fmt: skip
        copy = _Copy(store, target)
        with reporting(progress).task("Publishing the store", total=len(copy.objects)) as task:
            sent = size = 0
            for length in map_ordered(copy.send, copy.objects, jobs or AT_ONCE):
                sent, size = sent + (length > 0), size + length
                task.advance()
        target.put(ROOT, [root])
        return Published(len(copy.objects) + 1, sent + 1, size + len(root))


class _Copy:
    """The objects of a store during a copy."""

    def __init__(self, store: StoredTerrain, target: Storage) -> None:
        self.source, self.target, self.digests = store.storage, target, store.record.digests
        specs = array_specs(store.record)
        arrays = {spec.path for spec in specs}
        self.objects: list[tuple[ArraySpec, Spot] | str] = [
            (spec, (i, j)) for spec in specs for i in range(spec.shards[0]) for j in range(spec.shards[1])
        ]
        self.objects += [key for key in sorted(self.digests.listed) if key not in arrays and key not in (ROOT, PLAN)]

    def send(self, what: tuple[ArraySpec, Spot] | str) -> int:
        """Copy an object unless it is there; return the bytes sent."""
        key = what if isinstance(what, str) else what[0].key(what[1])
        if self._is_there(what, key):
            return 0
        data = self._read(what, key)
        self.target.put(key, [data])
        if not self._is_there(what, key):
            raise StoreError(
                f"{key} differs from what was sent when read back.", path=self.target.url, remedy="Publish it again."
            )
        return len(data)

    def _read(self, what: tuple[ArraySpec, Spot] | str, key: str) -> bytes:
        """Read an object and verify that it is what the root lists."""
        data = self.source.get(self._place(what)) or b""
        if isinstance(what, str):
            causes = [] if digest_of(data) == self.digests.listed[key] else ["it is not what was written"]
        else:
            causes = [damage.cause for damage in check_shard(self.source, self.digests, *what)]
        if causes:
            raise DamagedChunkError(key, path=self.source.url, cause=causes[0])
        return data

    def _place(self, what: tuple[ArraySpec, Spot] | str) -> str:
        """The key of an object in the source."""
        if isinstance(what, str):
            return self.digests.place(what, bytes(self.digests.listed[what]))
        return what[0].place(what[1], self.digests)

    def _is_there(self, what: tuple[ArraySpec, Spot] | str, key: str) -> bool:
        """Whether the correct object is there.

        Only the end of a shard is read: writes are atomic, and the end has the checksums of all chunks.
        """
        if isinstance(what, str):
            data = self.target.get(key)
            return data is not None and digest_of(data) == self.digests.listed[key]
        spec, spot = what
        tail = self.target.tail(key, tail_length(key, spec.chunks))
        try:
            if tail is not None:
                unsealed(tail, key, spec.chunks, self.digests.get(spec.path, spec.shards, spot))
        except ValueError:
            return False
        return tail is not None
