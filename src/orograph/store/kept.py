"""The cache folder keeps within a size: what was used longest ago goes first.

Entries are the stores of large DEMs (``NAME.oro``, with what is left of a build of it), the folders of coarse levels
of images (``images/NAME``), and fetched tiles (``tiles/PRODUCT/TILE``). The time of an entry's folder says when it was
last used; whoever draws from an entry holds a shared lock (``flock``) on that folder (of all tiles on ``tiles``), and
one that is held stays, as does one that is being built. Room is made when something was added: the limit may be passed
while that is written. Sizes are bytes on disk as files say them.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from orograph.errors import StoreError
from orograph.folders import cache_folder, cache_limit
from orograph.progress import SILENT, Progress
from orograph.store.lock import alone
from orograph.store.places import partial
from orograph.store.storage import FolderStorage

IMAGES = "images"
"""The folder, within the cache, of coarse levels of images."""

TILES = "tiles"
"""The folder, within the cache, of tiles that were fetched."""


@dataclass(frozen=True, slots=True)
class Entry:
    """Something that is kept.

    Attributes:
        path: of its folder. parts: the folders it consists of. size: bytes. used: when, seconds since 1970.
        guard: the folder that is locked while it is used, if not its own.
    """

    path: Path
    parts: tuple[Path, ...]
    size: int
    used: float
    guard: Path | None = None


class Use:
    """An entry that is in use, from ``Use(path)`` until this object is gone or its process ends."""

    def __init__(self, path: Path) -> None:
        self._fd: int | None = None
        with contextlib.suppress(OSError):
            os.utime(path)
        with contextlib.suppress(OSError, ImportError):
            import fcntl

            self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            fcntl.flock(self._fd, fcntl.LOCK_SH | fcntl.LOCK_NB)

    def release(self) -> None:
        """End the use."""
        fd, self._fd = self._fd, None
        if fd is not None:
            os.close(fd)

    def __del__(self) -> None:
        self.release()


def entries() -> list[Entry]:
    """What is kept in the cache folder, the longest unused first."""
    folder = cache_folder()
    found = []
    stores = {Path(str(p).removesuffix(".partial")) for p in (*folder.glob("*.oro"), *folder.glob("*.oro.partial"))}
    for path in (*stores, *(folder / IMAGES).glob("*")):
        parts = tuple(p for p in (path, Path(partial(path))) if p.is_dir())
        if parts:
            used = max(_stamps(parts), default=0.0)
            found.append(Entry(path, parts, sum(_size(p) for p in parts), used))
    for path in (folder / TILES).glob("*/*"):
        if path.is_dir() and not path.name.startswith("."):
            found.append(Entry(path, (path,), _size(path), max(_stamps((path,)), default=0.0), folder / TILES))
    return sorted(found, key=lambda entry: (entry.used, entry.path))


def make_room(progress: Progress = SILENT) -> None:
    """Remove what was used longest ago until the cache keeps within ``cache_limit``; what is in use stays.

    Raises:
        UsageError: ``OROGRAPH_CACHE_SIZE`` is no size.
    """
    limit, kept = cache_limit(), entries()
    total, removed, freed = sum(entry.size for entry in kept), 0, 0
    for entry in kept:
        if total - freed <= limit:
            break
        if _remove(entry):
            removed, freed = removed + 1, freed + entry.size
    if removed:
        progress.note(f"{removed} kept, least recently used, removed from the cache ({freed / 1e6:.0f} MB)")


def _remove(entry: Entry) -> bool:
    """Remove an entry unless it is in use; whether it is gone."""
    try:
        with alone(FolderStorage(entry.path), "making room in the cache"):
            for part in entry.parts:
                with _unused(entry.guard or part) as free:
                    if not free:
                        return False
                    # First it has another name: nobody finds half of it.
                    gone = part.with_name(f".{part.name}.{os.getpid()}.gone")
                    part.rename(gone)
                shutil.rmtree(gone, ignore_errors=True)
    except (OSError, StoreError):
        return False
    return True


@contextlib.contextmanager
def _unused(path: Path) -> Iterator[bool]:
    """Whether nobody uses a folder; nobody begins to while it is held."""
    try:
        import fcntl
    except ImportError:  # there files that are open cannot be removed
        yield True
        return
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
        else:
            yield True
    finally:
        os.close(fd)


def _size(folder: Path) -> int:
    total = 0
    for root, _, files in os.walk(folder):
        for name in files:
            with contextlib.suppress(OSError):
                total += Path(root, name).lstat().st_size
    return total


def _stamps(parts: tuple[Path, ...]) -> Iterator[float]:
    for part in parts:
        with contextlib.suppress(OSError):
            yield part.stat().st_mtime
