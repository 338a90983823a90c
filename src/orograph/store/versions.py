"""Versions of a store: STORE is the newest, ``STORE@2`` an older one.

In a folder, ``STORE@2`` is a complete store beside STORE.

Updates (``updating``) number the versions. The number lies in ``parts/version.json``, outside of what builds are
compared by, so an updated store equals a new one byte for byte. Files that two versions share are hard links where the
file system supports them.

The new version and the old one swap names in one system call (Linux, macOS), so STORE is complete at every moment.
Where the system cannot do that, STORE is moved aside first, and for a moment only ``STORE@2`` exists.

In a bucket all versions lie below STORE (``bucket_updates``): objects under keys that end with their digests, and the
root of an older version in ``versions/2.json``. Each root gives its version and lists the others that are kept.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

from orograph.errors import StoreError, UsageError
from orograph.progress import Progress
from orograph.store.bucket import BucketStorage
from orograph.store.places import PARTS, PLAN, ROOT, VERSION, is_store, kept, partial, replaced
from orograph.store.places import publish as publish_alone
from orograph.store.storage import FolderStorage, Storage

KEEP = 2
"""Default number of versions that an update leaves: the new one, and the one that readers may have open."""

NUMBER = f"{PARTS}/version.json"


class Edition(NamedTuple):
    """The version of a store in a bucket, as recorded in its root.

    Attributes:
        number: the number of the version.
        kept: the older versions that are kept, newest first.
        parts: the scope of its parts (``BucketStorage.scope``).
    """

    number: int
    kept: tuple[int, ...]
    parts: str

    @classmethod
    def from_json(cls, entry: dict[str, Any]) -> Edition:
        return cls(entry["number"], tuple(entry["kept"]), entry["parts"])


def number(storage: Storage) -> int | None:
    """Return the version of a store in a folder, or of an older one at a URL; None if versions are not numbered."""
    if storage.remote or (data := storage.get(NUMBER)) is None:
        return storage.number
    try:
        found = json.loads(data)["version"]
    except (ValueError, KeyError, TypeError):
        return None
    return found if isinstance(found, int) else None


def folder_of(path: str) -> str:
    """Return the folder that a path means: ``STORE@3`` is STORE itself if that is version 3."""
    name = VERSION.fullmatch(path.rstrip("/\\"))
    if name is None or os.path.lexists(path):
        return path
    return name[1] if number(FolderStorage(name[1])) == int(name[2]) else path


def version_of(storage: BucketStorage) -> BucketStorage:
    """The store that an address in a bucket means: ``STORE@3`` is STORE if that is version 3, else an older version.

    A store that really has this name takes precedence.
    """
    url, _ = storage.named()
    name = VERSION.fullmatch(url.rpartition("/")[2]) if storage.prefix else None
    if name is None or storage.exists(ROOT):
        return storage
    store = storage.below(storage.prefix.rpartition("@")[0], url.rpartition("@")[0])
    newest = _edition(store)
    if newest is None:
        return storage
    return store if newest.number == int(name[2]) else store.older(int(name[2]))


def older(storage: Storage) -> list[tuple[int, Storage]]:
    """Return the older versions of a store that are kept, newest first."""
    if isinstance(storage, FolderStorage):
        return [(count, FolderStorage(path)) for count, path in kept(storage.home)]
    if not isinstance(storage, BucketStorage) or storage.number is not None:
        return []
    newest = _edition(storage)
    return [] if newest is None else [(count, storage.older(count)) for count in newest.kept]


def _edition(storage: BucketStorage) -> Edition | None:
    """Return the version that the root claims, unverified; None if versions are not numbered."""
    seen = storage.look(ROOT)
    try:
        return None if seen is None else Edition.from_json(json.loads(seen.data)["attributes"]["orograph"]["version"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def check_keep(keep: int | None, update: bool, final: Storage) -> int:
    """Return how many versions an update keeps.

    Raises:
        UsageError: it keeps none, nothing is updated, or the store to update is an older version.
    """
    if keep is not None and not update:
        raise UsageError("`keep` says how many versions an update leaves.", remedy="Use `update=True` with it.")
    if keep is not None and keep < 1:
        raise UsageError(f"An update keeps at least one version, the new one, not {keep}.")
    name = VERSION.fullmatch(final.url) if final.number is not None or (update and not final.remote) else None
    if name is not None and (final.remote or is_store(FolderStorage(name[1]))):
        raise UsageError(
            "This is an older version of a store, which does not change.", path=final.url,
            remedy=f"Update {name[1].rpartition('/')[2]}.",
        )  # fmt: skip
    return KEEP if keep is None else keep


def settle(final: FolderStorage) -> None:
    """Finish the exchange of versions that a killed update left undone."""
    made = FolderStorage(partial(final.path))
    if made.exists(PLAN) or not is_store(made) or (its := number(made)) is None:
        return
    if not final.path.exists():
        made.path.rename(final.path)
    elif its < (number(final) or 0):
        made.path.rename(_named(final.path, its))


def publish(built: Path, final: Path, keep: int, progress: Progress) -> None:
    """Put an updated store in the place of the previous version, and keep that one.

    Args:
        built: the new version, complete. final: the store.
        keep: how many versions stay, counting the new one.

    Raises:
        StoreError: the new version could not take its place.
    """
    before = FolderStorage(final)
    newest = max([number(before) or 0, *(count for count, _ in kept(final))])
    if not is_store(before):
        _count(FolderStorage(built), newest + 1)
        publish_alone(built, final)
        prune(final, keep, progress)
        return
    if (old := number(before)) is None:
        old = newest + 1
        _count(before, old)  # if the process is killed between the renames, this tells which version is older
    _count(FolderStorage(built), max(newest, old) + 1)
    try:
        if exchanged(built, final):
            built.rename(_named(final, old))
        else:
            final.rename(_named(final, old))
            built.rename(final)
    except OSError as error:
        raise StoreError(
            f"The finished store could not take its place: {error.strerror or error}.", path=final,
            remedy="Run the same command again.",
        ) from error  # fmt: skip
    prune(final, keep, progress)


def prune(final: Path, keep: int, progress: Progress) -> None:
    """Remove the oldest versions beyond ``keep``. A version that is being written to (a bake) stays for now."""
    from orograph.store.lock import alone

    aside = FolderStorage(replaced(final))
    if final.exists():
        aside.remove()
    for _, path in kept(final)[keep - 1 :]:
        try:
            with alone(FolderStorage(path), "removing this version"):
                path.rename(aside.path)  # (first, so that a half-removed folder never looks like a version)
        except StoreError as error:
            progress.note(f"{path} is kept for now: {error.what}")
            continue
        aside.remove()


def exchanged(one: Path, other: Path) -> bool:
    """Swap two folders in one step; return False if the system cannot do that."""
    names = os.fsencode(one.absolute()), os.fsencode(other.absolute())
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "darwin":
            return bool(libc.renamex_np(*names, 2) == 0)
        return bool(libc.renameat2(-100, names[0], -100, names[1], 2) == 0)
    except (OSError, AttributeError, TypeError):
        return False


def _named(final: Path, version: int) -> Path:
    return final.with_name(f"{final.name}@{version}")


def _count(storage: FolderStorage, version: int) -> None:
    storage.put(NUMBER, [json.dumps({"version": version}).encode()])
