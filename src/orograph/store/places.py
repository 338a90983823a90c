"""The folders of one store: STORE, STORE.partial during a build, and STORE.replaced for a replaced store.

A build ends with two renames, STORE to STORE.replaced and STORE.partial to STORE. If it is killed between them, all
folders are complete and nothing is lost: the next command reports which folder holds what, and how to go on.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from orograph.errors import StoreError
from orograph.store.storage import WRITING, FolderStorage, Storage

ROOT = "zarr.json"
PLAN = "build.json"
UPDATE = "update.json"
"""The plan of an update in a bucket, while it is under way: the store's root stays beside it."""
VERSION = re.compile(r"(.+)@([1-9][0-9]*)")
"""The name pattern of older versions of a store."""
PARTS = "parts"
"""Holds the results of a build's tasks, which an updated store keeps."""
HANDED = f"{PARTS}/handed"
"""Holds what the building process leaves for its workers; complete stores do not keep it."""


def partial(path: str | os.PathLike[str]) -> str:
    """The folder in which a store is built until it is complete."""
    return os.fspath(path).rstrip("/\\") + ".partial"


def replaced(path: str | os.PathLike[str]) -> str:
    """The folder to which an old store is moved while the new one takes its place."""
    return os.fspath(path).rstrip("/\\") + ".replaced"


def is_store(storage: Storage) -> bool:
    """Whether a complete store of any format lies there."""
    data = storage.get(ROOT)
    try:
        return data is not None and isinstance(json.loads(data)["attributes"]["orograph"], dict)
    except (ValueError, KeyError, TypeError, RecursionError):
        return False


def begun(storage: Storage) -> bool:
    """Whether a build has begun in this storage (that of the folder in which a store is built, or of a URL)."""
    return storage.exists(PLAN) or storage.exists(UPDATE if storage.remote else ROOT)


def remove_unbegun(storage: Storage) -> None:
    """Remove the folder in which a store is built if none of its tasks is done."""
    if not isinstance(storage, FolderStorage):
        return  # (the listing of a bucket may lack new objects)
    for path in storage.path.rglob("*"):
        key = path.relative_to(storage.path).as_posix()
        if path.is_file() and key != PLAN and not key.startswith(HANDED) and not key.endswith(WRITING):
            return
    storage.remove()


def sweep(path: Path) -> None:
    """Remove a store that has been replaced, if the process that replaced it was killed before it could."""
    old = FolderStorage(replaced(path))
    if old.path.exists() and is_store(FolderStorage(path)):
        old.remove()


def kept(path: str | os.PathLike[str]) -> list[tuple[int, Path]]:
    """The older versions beside a store (``versions``), newest first."""
    folder = Path(path)
    found = []
    for one in folder.parent.glob("*@*"):
        name = VERSION.fullmatch(one.name)
        if name and name[1] == folder.name and (one / ROOT).is_file():
            found.append((int(name[2]), one))
    return sorted(found, reverse=True)


def left_over(path: str | os.PathLike[str]) -> bool:
    """Whether builds left folders of a store that is not there itself."""
    if Path(path).exists():
        return False
    if kept(path):
        return True
    made, old = Path(partial(path)), Path(replaced(path))
    return (made / PLAN).is_file() or (made / ROOT).is_file() or (old / ROOT).is_file()


def missing(storage: Storage) -> StoreError:
    """The error that says why there is no store, which of its folders are there, and what to do."""
    if not isinstance(storage, FolderStorage):
        if storage.number is not None:
            store = storage.url.rpartition("@")[0]
            return StoreError(
                f"There is no version {storage.number} of this store.", path=store,
                remedy=f"`orograph.info({store!r})` says which versions are kept.",
            )  # fmt: skip
        if storage.exists(UPDATE):
            return interrupted(storage)
        return _unfinished(storage.url) if storage.exists(PLAN) else _none(storage.url)
    path = storage.path
    made, old = FolderStorage(partial(path)), FolderStorage(replaced(path))
    complete, old_one = is_store(made), is_store(old)
    if path.exists() and (storage.exists(PLAN) or not (complete or old_one)):
        return _unfinished(storage.url) if storage.exists(PLAN) or begun(made) else _none(storage.url)
    there = []
    if complete:
        there.append(f"{made.path.name} holds the new store, complete")
    elif begun(made):
        there.append(f"{made.path.name} holds an unfinished one")
    if old_one:
        there.append(f"{old.path.name} holds the store that was there before, complete")
    older = kept(path)
    if older:
        there.append(f"{older[0][1].name} holds version {older[0][0]}, complete")
    if not complete and not old_one and not older:
        if begun(made):
            return _unfinished(storage.url, f" It is made in {made.path.name}.")
        return _no_version(path) or StoreError("There is no such store.", path=path, remedy=_BUILD)
    ways = []
    if begun(made):
        ways.append("run the same `orograph.build(..., resume=True)` to finish")
    if complete or old_one or older:
        ways.append(f"rename the folder that you want to {path.name}")
    remedy = " or ".join(ways)
    return StoreError(
        f"The store is not there: a build was interrupted while it moved the store into place. {'; '.join(there)}.",
        path=storage.url,
        remedy=f"{remedy[0].upper()}{remedy[1:]}.",
    )


_BUILD = "Build one: `orograph.build(dem, store)`."


def _unfinished(url: str, where: str = "") -> StoreError:
    return StoreError(
        f"This store is incomplete: its build was interrupted.{where}", path=url,
        remedy="Finish it: the same `orograph.build(..., resume=True)`.",
    )  # fmt: skip


def interrupted(storage: Storage) -> StoreError:
    """The error about an unfinished update in a bucket."""
    return StoreError(
        "An update of this store was interrupted.", path=storage.url,
        remedy="Finish it with `update=True`, or start over with `overwrite=True`.",
    )  # fmt: skip


def names_version(path: Path) -> bool:
    """Whether a path is named like a version of an existing store, whether or not that version exists."""
    name = VERSION.fullmatch(path.name)
    return name is not None and (path.with_name(name[1]) / ROOT).is_file()


def _no_version(path: Path) -> StoreError | None:
    """The error about a missing version of a store; None if the path does not name a version."""
    name = VERSION.fullmatch(path.name)
    if name is None or not names_version(path):
        return None
    there = [one.name for _, one in kept(path.with_name(name[1]))]
    return StoreError(
        f"There is no version {name[2]} of {name[1]}.", path=path,
        remedy=f"There are {', '.join([name[1], *there])}." if there else f"{name[1]} is the only one that is kept.",
    )  # fmt: skip


def _none(url: str) -> StoreError:
    return StoreError("This is not an Orograph store (it has no zarr.json).", path=url, remedy=_BUILD)


def occupied(final: Storage) -> bool:
    """Whether something lies where a store is to be built."""
    if not isinstance(final, FolderStorage):
        return final.exists(ROOT)
    path = final.path
    return path.exists() and (not path.is_dir() or any(path.iterdir()))


def publish(built: Path, final: Path) -> None:
    """Move a finished store into place; only then is an old one removed."""
    old = Path(replaced(final))
    try:
        if final.exists():
            FolderStorage(old).remove()
            final.rename(old)
        built.rename(final)
    except OSError as error:
        raise StoreError(
            f"The finished store could not be moved into place: {error.strerror or error}.",
            path=final,
            remedy=f"It is complete at {built}.",
        ) from error
    FolderStorage(old).remove()
