"""Adds what methods need to a complete store. ``build`` does this when a store is its own source.

Heights and everything else in the store stay as they are. New arrays are written beside them, and last the root that
lists them. Until then readers see the old store. An interrupted run leaves results in ``parts/``, from which the same
call continues.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, NamedTuple

from orograph.error import KINDS, ErrorKind
from orograph.errors import StoreError
from orograph.progress import Progress
from orograph.store.chunked import Kind
from orograph.store.executing import Threads
from orograph.store.layout import Record, dumps, publish
from orograph.store.lock import alone
from orograph.store.makers import MAKERS, Work
from orograph.store.places import PARTS
from orograph.store.plan import plan_of
from orograph.store.pyramid import part_key
from orograph.store.source import HeightSource, StoreSource
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import read_record
from orograph.store.updating import ALL_AGAIN
from orograph.store.writer import ShardWriter

ASKED = f"{PARTS}/asked.json"
"""The request that the results in ``parts/`` belong to."""


class Needs(NamedTuple):
    """Data that methods need; arguments of ``build``."""

    errors: tuple[ErrorKind, ...]
    tins: int | None
    chunked: Kind | None
    quadtin: tuple[float, str] | None


def is_itself(raster: HeightSource, storage: Storage) -> bool:
    """Whether a source reads the store at this place."""
    if not isinstance(raster, StoreSource):
        return False
    other = raster.terrain.storage
    if isinstance(storage, FolderStorage) and isinstance(other, FolderStorage):
        return os.path.realpath(storage.path) == os.path.realpath(other.path)
    return storage.url.rstrip("/") == other.url.rstrip("/")


def add(storage: Storage, needs: Needs, jobs: int, progress: Progress) -> None:
    """Add to a store what it lacks.

    Args:
        jobs: tasks at once. The store's bytes do not depend on it.

    Raises:
        StoreError: the store has such data of another kind, another process is at work there, or it cannot be written.
    """
    with alone(storage, "adding to this store"):
        before = read_record(storage)
        lacking = _lacking(before, needs, storage.url)
        if lacking == Needs((), None, None, None):
            return
        if before.digests.keyed:
            raise StoreError(
                "Nothing can be added to a store in a bucket that is updated.", path=storage.url,
                remedy="Update it from its files with these options.",
            )  # fmt: skip
        updated = storage.exists(part_key((0, 0)))  # (such a store keeps the results of its build)
        results = [f"{PARTS}/{name}" for name in (*ALL_AGAIN, "errors")] if updated else [PARTS]
        asked = dumps({**lacking._asdict(), "source": before.source, "shard": before.shard})
        if storage.get(ASKED) != asked:
            for each in results:
                storage.remove(each)
            storage.put(ASKED, [asked])
        writer = ShardWriter(storage)
        writer.digests = before.digests.joined(writer.digests)
        record = replace(before, digests=writer.digests)
        work = Work(lacking.errors, writer, jobs, Threads(jobs, True), progress, *lacking[1:])
        for make in MAKERS.values():
            record = make(record, work)
        publish(storage, record)
        for each in (*results[:-1], ASKED) if updated else results:  # (an update needs those of errors)
            storage.remove(each)


def _lacking(record: Record, needs: Needs, url: str) -> Needs:
    """What a store lacks; where it lacks a kind of errors, those that it has, too: they are made together.

    Raises:
        StoreError: it has TINs, chunks or a QuadTIN made in another way.
    """
    there = plan_of(record)
    kinds: tuple[Any, ...] = tuple(kind for kind in KINDS if kind in (*there["errors"], *needs.errors))
    found: dict[str, Any] = {"errors": kinds if len(kinds) > len(there["errors"]) else ()}
    for name in ("tins", "chunked", "quadtin"):
        wanted, has = getattr(needs, name), there[name]
        said = list(wanted) if isinstance(wanted, tuple) else wanted
        if None not in (wanted, has) and said != (list(has) if isinstance(has, list | tuple) else has):
            raise StoreError(
                f"It has `{name}` of {has}, not of {said}, and a store has one kind.", path=url,
                remedy="Build another store with these options, or replace this one (`overwrite=True`).",
            )  # fmt: skip
        found[name] = wanted if has is None else None
    return Needs(**found)
