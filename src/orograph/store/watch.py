"""Noticing when an open store has been replaced.

A store may be replaced while a reader has it open. The reader always gets data of the store that it opened: the
digests in that store's record ensure this (``digests``). The watch reports a replacement early: before a read, but at
most every ``EVERY`` seconds, it checks whether the root is still the same file, and reads it if not. If an update has
kept the version that was opened (``versions``), reading continues there. A bake that only changes layers does not
count. At a URL each check is a request, made at most every ``EVERY_REMOTE`` seconds; a shard that has changed triggers
one sooner.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from orograph.errors import StoreError, StoreReplacedError
from orograph.store.layout import Record
from orograph.store.places import ROOT, left_over, missing
from orograph.store.registry import KINDS
from orograph.store.storage import FolderStorage, Storage
from orograph.store.versions import older

EVERY, EVERY_REMOTE = 0.02, 30.0
"""Seconds between two checks."""


class Watch:
    """Called before a read.

    Args:
        storage: the store's storage.
        record: as it was when the store was opened.
        stamp: the root's stamp, from before the record was read.
        read: reads the record.

    Attributes:
        replaced: whether the store is known to have been replaced; if reading continues, it is from a version that
            is kept.
    """

    def __init__(self, storage: Storage, record: Record, stamp: Any, read: Callable[[Storage], Record]) -> None:
        self.storage, self.record, self.stamp, self._read = storage, record, stamp, read
        self._due = time.monotonic() + EVERY_REMOTE if storage.remote else 0.0
        self.replaced = False

    def __call__(self) -> None:
        """Raise StoreReplacedError if the store has been replaced, StoreError if it is gone.

        A server that does not answer is no reason to fail: the reader may use what it already holds.
        """
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + (EVERY_REMOTE if self.storage.remote else EVERY)  # other threads do not wait for the check
        try:
            stamp = self.storage.stamp(ROOT)
            if stamp != self.stamp:
                self._look()
                self.stamp = stamp
        except StoreError as error:
            if self.storage.remote and not isinstance(error, StoreReplacedError):
                return
            self._due = 0.0
            raise

    def _look(self) -> None:
        if isinstance(self.storage, FolderStorage) and not self.storage.path.exists():
            if self._follows():
                return
            if self.replaced:  # the kept version is gone, too
                raise self._replaced()
            if left_over(self.storage.path):
                raise missing(self.storage)
            self.storage.must_stand()
        if self.storage.remote and not self.storage.exists(ROOT):  # it is built in place, and the root comes last
            raise self._replaced()
        if _ground(self._read(self.storage)) != _ground(self.record) and not self._follows():
            raise self._replaced()

    def _follows(self) -> bool:
        """Continue with the version that was opened, if it is kept."""
        for _, place in older(self.storage):
            try:
                same = _ground(self._read(place)) == _ground(self.record)
            except StoreError:  # (it is being removed)
                continue
            if same:
                self.storage.follow(place)
                self.replaced = True
                return True
        return False

    def explain(self, path: str) -> None:
        """Raise StoreReplacedError if an array differs because the store, or the layer, was replaced."""
        try:
            now = self._read(self.storage)
        except StoreError as error:
            if self._follows():
                return
            raise self._replaced() from error
        if _ground(now) != _ground(self.record) and self._follows():
            return
        if now.digests.listed.get(path) != self.record.digests.listed.get(path):
            raise self._replaced()

    def _replaced(self) -> StoreReplacedError:
        self.replaced = True
        return StoreReplacedError(
            "The store was replaced since it was opened.", path=self.storage.url,
            remedy="Open it again (in Python: terrain.reopen()).",
        )  # fmt: skip


def _ground(record: Record) -> dict[str, Any]:
    """The part of a record that stays the same as long as the terrain does."""
    json = record.to_json()
    groups = {kind.group for kind in KINDS.values() if kind.later}
    digests = {
        path: digest
        for path, digest in json["digests"].items()
        if path.partition("/")[0] not in groups and not path.endswith("zarr.json")
    }
    derived = {name: entry for name, entry in json["derived"].items() if not KINDS[name].later}
    return {**json, "digests": digests, "derived": derived, "checksum": None, "version": None}
