"""Updating a store in a bucket, where nothing can be renamed: all versions lie below one key.

Object keys end with their digests (``Digests.place``). So an update adds objects beside those of the version before,
leaves its readers undisturbed, and shares all objects that come out the same: the new root lists the same digests.
The root ``zarr.json`` belongs to the newest version. Before a new root replaces it, on condition that it is still the
one that was read, it is copied to ``versions/N.json``. Then ``sweep`` removes what no kept version needs.

Results of tasks lie in ``parts/SCOPE/``, where the scope is that of the build's plan (``scope_of``). Parts that an
update takes over stay where they are, and ``TAKEN`` records where. The plan lies in ``update.json`` until all is done.
An update that finds its own plan there resumes; one that finds another plan starts over, and its sweep removes what the
abandoned update wrote.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from orograph.errors import StoreError
from orograph.progress import Progress
from orograph.store.bucket import VERSIONS, BucketStorage, root_key, scope_of
from orograph.store.coding import Coding
from orograph.store.digests import SIZE
from orograph.store.lattices import SOURCE
from orograph.store.layout import Record, dumps, publish
from orograph.store.places import PARTS, PLAN, ROOT, UPDATE, begun
from orograph.store.plan import differing, plan_of
from orograph.store.registry import KINDS
from orograph.store.source import HeightSource
from orograph.store.storage import Storage
from orograph.store.stored import read_record, record_of
from orograph.store.updating import ALL_AGAIN, Begun, read_plan, seeded, sized
from orograph.store.versions import Edition

TAKEN = f"{PARTS}/taken.json"
"""Lists parts that lie below other names: that name → their keys."""

GROUPS = {"heights", "mean", "tiles", SOURCE, VERSIONS, PARTS, PLAN, *(kind.group for kind in KINDS.values())}
"""First components of the keys that a sweep may remove: it leaves foreign objects below the store's key alone."""


class BucketUpdate:
    """One update of a store in a bucket, under its lock.

    Args:
        storage: the store's storage. keep: how many versions stay, counting the new one. progress: receives progress.
    """

    def __init__(self, storage: BucketStorage, keep: int, progress: Progress) -> None:
        self.storage, self.keep, self.progress = storage, keep, progress
        self._root: bytes | None = None
        self._before: Record | None = None

    def begin(self, plan: dict[str, Any], raster: HeightSource, coding: Coding | None) -> Begun:
        """Begin an update, or resume an interrupted one; where there is no store, begin a build.

        Args:
            plan: the plan of the new version. raster, coding: its heights, and how they are stored.

        Raises:
            StoreError: something other than a store lies there.
        """
        storage = self.storage
        self._root = storage.get(ROOT)
        if self._root is not None:
            self._before = record_of(self._root, storage.url)
            if not differing(sized(plan, old := plan_of(self._before)), old):
                return Begun(plan, False, True)
        data = storage.get(UPDATE)
        if data is not None and not differing(sized(plan, old := read_plan(data)), old):
            storage.elsewhere = _taken(storage)
            return Begun(sized(plan, old), True)
        if self._before is None:
            if data is not None or begun(storage):
                storage.remove()
            found: dict[str, Any] | None = None
            taken: dict[str, str] = {}
        else:
            found, taken = self._seeded(self._before, plan, raster, coding)
        data = dumps(found or plan)
        storage.scope, storage.elsewhere = scope_of(data), taken
        self._put_taken()
        storage.put(UPDATE, [data])
        return Begun(found or plan, found is not None)

    def _seeded(
        self, before: Record, plan: dict[str, Any], raster: HeightSource, coding: Coding | None
    ) -> tuple[dict[str, Any] | None, dict[str, str]]:
        """Return the plan to resume with (None if everything is rebuilt), and where the reused parts lie."""
        storage = self.storage
        storage.scope, storage.elsewhere = "" if before.version is None else before.version.parts, {}
        there = _taken(storage)
        taken: dict[str, str] = {}

        def take(keys: Iterable[str]) -> None:
            taken.update((key, there.get(key, storage.scope)) for key in keys if key.startswith(f"{PARTS}/"))

        found = seeded(storage.url, before, before.version is not None, take, plan, raster, coding, self.progress)
        return found, taken

    def _put_taken(self) -> None:
        names: dict[str, list[str]] = {}
        for key, scope in sorted(self.storage.elsewhere.items()):
            names.setdefault(scope, []).append(key)
        self.storage.put(TAKEN, [dumps(names)])

    def publish(self, record: Record) -> None:
        """Publish the new version, keep the previous one, and remove what no version needs.

        Args:
            record: the record of the new version, whose shards are all written.

        Raises:
            StoreError: another process has published or removed the store meanwhile.
        """
        version = Edition(1, (), self.storage.scope)
        self._put_taken()  # (some parts may have been rebuilt)
        if self._before is not None:
            before = self._before.version or Edition(1, (), "")
            version = Edition(before.number + 1, (before.number, *before.kept)[: self.keep - 1], self.storage.scope)
            if version.kept:
                self.storage.put(root_key(before.number), [self._root or b""])
        publish(self.storage, replace(record, version=version))
        self._tidy()

    def prune(self) -> None:
        """When nothing has changed, reduce the versions to the number wanted and remove the traces of an interrupted
        update."""
        record = self._before
        assert record is not None
        fewer = False
        if record.version is not None:
            kept = record.version.kept[: self.keep - 1]
            fewer = kept != record.version.kept
            if fewer:
                publish(self.storage, replace(record, version=record.version._replace(kept=kept)))
        if fewer or self.storage.exists(UPDATE):
            self._tidy()

    def _tidy(self) -> None:
        try:
            sweep(self.storage)
            self.storage.remove(UPDATE)
        except StoreError as error:  # the new version is published; the next update tidies up
            self.progress.note(f"{self.storage.url}: data that no version needs stay for now: {error.what}")


def go_on(storage: Storage) -> None:
    """Tell a worker which update is under way, and where the parts lie that it takes over."""
    assert isinstance(storage, BucketStorage)
    storage.get(UPDATE)
    storage.elsewhere = _taken(storage)


def tidy(storage: BucketStorage) -> None:
    """Sweep after a bake has replaced layers, unless an interrupted update is to resume from what is there."""
    with contextlib.suppress(StoreError):  # (the next sweep does it)
        store = storage.newest()
        if not store.exists(UPDATE):
            sweep(store)


def sweep(storage: BucketStorage) -> None:
    """Remove what no kept version needs. Objects that a stale listing hides stay until the next sweep.

    Raises:
        StoreError: a root cannot be read, or objects cannot be removed.
    """
    newest = read_record(storage)
    version = newest.version or Edition(0, (), "")
    records = [newest, *(read_record(storage.older(number)) for number in version.kept)]
    listed = [data for record in records if record.digests.keyed for data in record.digests.listed.values()]
    digests = {data[at : at + SIZE].hex() for data in listed for at in range(0, len(data), SIZE)}
    plain = not all(record.digests.keyed for record in records)
    roots = set(map(root_key, version.kept))
    storage.scope, storage.elsewhere = version.parts, {}
    storage.elsewhere = _taken(storage)

    def needed(key: str) -> bool:
        group, _, rest = key.partition("/")
        if group == VERSIONS:
            return key in roots
        if group == PARTS:
            scope, _, name = rest.partition("/")
            place = storage.elsewhere.get(f"{PARTS}/{name}", version.parts)
            return scope == place and name.partition("/")[0] not in ALL_AGAIN
        digest = key.rpartition(".")[2]
        return group != PLAN and (digest in digests or (plain and len(digest) != 2 * SIZE))

    storage.remove_all([key for key in storage.listed() if key.partition("/")[0] in GROUPS and not needed(key)])


def _taken(storage: BucketStorage) -> dict[str, str]:
    """Return where the parts lie that the update has taken over, from the storage's current scope."""
    try:
        names = json.loads(storage.get(TAKEN) or b"{}")
    except ValueError:
        return {}
    return {key: scope for scope, keys in names.items() for key in keys}
