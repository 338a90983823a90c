"""Where a bake is made, its plan, and how its layers are moved into place in the store.

The folder ``layers/.partial`` holds a plan (the layers, and the number of parts, if any) and all finished work. The
plan is written first and removed last, so everything beside it belongs to it. Parts and the workers of a remote cluster
have such a folder in a bucket too; what parts sweep stays on their own machines.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from typing import Any

from orograph.errors import OutputError, StoreError
from orograph.folders import cache_folder
from orograph.lighting.raster_resume import PLAN, Checkpoint, clear, text_of
from orograph.parallel import map_ordered
from orograph.progress import Progress
from orograph.store.bucket import BucketStorage
from orograph.store.bucket_updates import tidy
from orograph.store.derived import At
from orograph.store.digests import Digests
from orograph.store.in_parts import count_of
from orograph.store.layers import GROUP, LAYERS, PARTIAL, LayerRecord
from orograph.store.layout import Record
from orograph.store.layout import publish as publish_record
from orograph.store.publishing import AT_ONCE
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import read_record

Place = FolderStorage | BucketStorage

KEY = f"{PARTIAL}/{PLAN}"
"""The key of its plan."""


def plan_of(made: list[LayerRecord], count: int | None = None) -> dict[str, Any]:
    """The plan of a bake of layers, in ``count`` parts."""
    layers = {layer.name: layer.to_json() for layer in made}
    return {"layers": layers} if count is None else {"layers": layers, "parts": count}


def plan_text(made: list[LayerRecord], count: int | None = None) -> bytes:
    """The plan as it is stored."""
    return text_of(plan_of(made, count)).encode()


def kept(storage: FolderStorage, record: Record, made: list[LayerRecord], overwrite: bool) -> Checkpoint:
    """The folder of the bake: one that was interrupted with the same plan, or a new one.

    Raises:
        StoreError: another bake was interrupted there, or it cannot be written.
    """
    if overwrite or finished(storage, record):
        clear(storage.path / PARTIAL)
    group(storage)
    try:
        return Checkpoint(storage.path / PARTIAL, plan_of(made))
    except OutputError as error:
        there = storage.get(KEY)
        if there is None:
            raise
        raise another(storage, there, "begin anew with `overwrite=True`") from error


def another(storage: Storage, there: bytes, anew: str) -> StoreError:
    """The error that another bake has begun.

    Args:
        there: its plan. anew: how to restart.
    """
    count = count_of(there)
    state, again = "was interrupted", "Run it again with the same products and options to finish it"
    if count is not None:
        state = f"was begun in {count} parts"
        again = f"Run the parts of {count}, with the products and options of those before, and then finish"
    elif isinstance(storage, BucketStorage):  # nobody else leaves a plan there
        state = "by the workers of a cluster was interrupted"
        again = "Run it again with the same products and options, and with `dask`, to finish it"
    return StoreError(f"Another bake into this store {state}.", path=storage.url, remedy=f"{again}, or {anew}.")


def group(storage: FolderStorage) -> None:
    """Create the group for layers if there is none."""
    try:
        (storage.path / GROUP).mkdir(exist_ok=True)
    except OSError as error:
        raise StoreError(f"Nothing can be written there: {error.strerror}.", path=storage.url) from error


def finished(storage: Storage, record: Record) -> bool:
    """Whether everything is already in the store: the bake was interrupted just before its end."""
    try:
        plan: dict[str, Any] = json.loads(storage.get(KEY) or b"")["layers"]
    except (ValueError, KeyError):
        return False
    there = LAYERS.of(record)
    return all(name in there and there[name].to_json() == layer for name, layer in plan.items())


def removed(storage: Storage, before: Record, gone: set[str]) -> Record:
    """The record without these layers, which are removed where new ones would take their place."""
    there = LAYERS.of(before)
    record = LAYERS.put(before, {name: layer for name, layer in there.items() if name not in gone})
    if not gone & set(there) or before.digests.keyed:
        return record
    publish_record(storage, record)
    for name in gone & set(there):
        storage.remove(f"{GROUP}/{name}")
    return read_record(storage)


def publish(storage: Storage, before: Record, made: list[LayerRecord], gone: set[str], digests: Digests) -> None:
    """Move layers into place: the old ones go first, and the record that names the new ones is written last."""
    record = removed(storage, before, gone)
    if isinstance(storage, FolderStorage):
        for layer in made:
            storage.remove(f"{GROUP}/{layer.name}")
            storage.rename(f"{PARTIAL}/{GROUP}/{layer.name}", f"{GROUP}/{layer.name}")
    layers = dict(sorted({**LAYERS.of(record), **{layer.name: layer for layer in made}}.items()))
    publish_record(storage, replace(LAYERS.put(record, layers), digests=record.digests.joined(digests)))
    if isinstance(storage, BucketStorage) and before.digests.keyed:
        tidy(storage)


def partial_of(storage: Storage) -> Place:
    """Where parts or workers make layers."""
    if isinstance(storage, FolderStorage):
        return FolderStorage(storage.path / PARTIAL, many=True)
    assert isinstance(storage, BucketStorage)
    found = storage.below(f"{storage.prefix}/{PARTIAL}".strip("/"), f"{storage.url}/{PARTIAL}")
    found.scope, found.elsewhere = "", {}  # the store's own parts belong to its updates
    return found


def begin(storage: Place, plan: bytes, anew: str) -> None:
    """Write the plan where layers are made, or check that the plan there is the same.

    Args:
        anew: how to restart.

    Raises:
        StoreError: another bake was begun.
    """
    there = storage.get(KEY)
    if there is not None and there != plan:
        raise another(storage, there, anew)
    if there is None:
        if isinstance(storage, FolderStorage):
            group(storage)
        partial_of(storage).put(PLAN, [plan])


def take_place(
    storage: Place, before: Record, made: list[LayerRecord], digests: Digests, progress: Progress
) -> None:  # fmt: skip
    """Move layers into place that were made where ``partial_of`` says, and remove everything else there."""
    partial, names = partial_of(storage), {layer.name for layer in made}
    if isinstance(partial, FolderStorage):
        partial.sweep()
    else:
        before = removed(storage, before, names)
        send(partial, storage, LAYERS.put(before, {layer.name: layer for layer in made}), digests, progress)
    publish(storage, before, made, names, digests)
    discard(storage)


def discard(storage: Place) -> None:
    """Remove what was made of a bake, if anything; nobody else may be working there."""
    if isinstance(storage, FolderStorage):
        clear(storage.path / PARTIAL)
    elif storage.exists(KEY):
        made = partial_of(storage)
        assert isinstance(made, BucketStorage)
        made.remove_all([name for name in made.listed() if name != PLAN])
        storage.remove(KEY)


def scratch(storage: Storage, *more: bytes) -> FolderStorage:
    """The folder on this machine for a bake into a bucket: the same for each bake, or each value of ``more``."""
    name = hashlib.blake2b(b"\0".join([storage.url.encode(), *more]), digest_size=10).hexdigest()
    folder = FolderStorage(cache_folder() / "bakes" / name)
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"Nothing can be written there: {error.strerror}.", path=folder.url) from error
    return folder


def send(
    made: Place, storage: Storage, record: Record, digests: Digests, progress: Progress
) -> None:  # fmt: skip
    """Send the shards of the record's layers to a bucket, whose own record does not name them yet.

    The server copies those that are already in the bucket.
    """
    at, keyed = At(record.grid, record.shard, record.chunk), record.digests.joined(digests)
    shards = [
        (spec.key((i, j)), spec.place((i, j), keyed))
        for spec, _ in LAYERS.arrays(LAYERS.of(record), at)
        for i in range(spec.shards[0]) for j in range(spec.shards[1])
    ]  # fmt: skip

    def put(each: tuple[str, str]) -> None:
        if isinstance(made, BucketStorage) and isinstance(storage, BucketStorage):
            storage.copy(made, *each)
        else:
            storage.put(each[1], [made.get(each[0]) or b""])

    with progress.task("Sending layers", total=len(shards)) as task:
        for _ in map_ordered(put, shards, AT_ONCE):
            task.advance()
