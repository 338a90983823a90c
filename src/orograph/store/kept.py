"""Keep the cache folder within a size; the least recently used entries go first.

Entries are the stores of large DEMs (``NAME.oro``, with what is left of a build of it), the folders of coarse levels of
images (``images/NAME``), and fetched tiles (``tiles/PRODUCT/TILE``). The modification time of an entry's folder says
when it was last used. Readers of an entry hold a shared lock (``flock``) on that folder (for tiles, on ``tiles``);
entries that are locked or being built stay. Room is made after something was added, so the limit may be exceeded while
it is written. Sizes are bytes on disk as files report them.
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
"""The folder, within the cache, for coarse levels of images."""

TILES = "tiles"
"""The folder, within the cache, for fetched tiles."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of the cache.

    Attributes:
        path: of its folder. parts: the folders that it consists of. size: bytes. used: last use, seconds since 1970.
        guard: the folder that is locked during use, if not its own.
    """

    path: Path
    parts: tuple[Path, ...]
    size: int
    used: float
    guard: Path | None = None


class Use:
    """Marks an entry as in use, from ``Use(path)`` until this object or its process ends."""

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
    """The entries of the cache folder, the least recently used first."""
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
    """Remove the least recently used entries until the cache is within ``cache_limit``; entries in use stay.

    Raises:
        UsageError: ``OROGRAPH_CACHE_SIZE`` is not a size.
    """
    limit, kept = cache_limit(), entries()
    total, removed, freed = sum(entry.size for entry in kept), 0, 0
    for entry in kept:
        if total - freed <= limit:
            break
        if _remove(entry):
            removed, freed = removed + 1, freed + entry.size
    if removed:
        progress.note(f"{removed} least recently used removed from the cache ({freed / 1e6:.0f} MB)")


def _remove(entry: Entry) -> bool:
    """Remove an entry unless it is in use; returns whether it is gone."""
    try:
        with alone(FolderStorage(entry.path), "making room in the cache"):
            for part in entry.parts:
                with _unused(entry.guard or part) as free:
                    if not free:
                        return False
                    # Rename it first, so that nobody finds half of it.
                    gone = part.with_name(f".{part.name}.{os.getpid()}.gone")
                    part.rename(gone)
                shutil.rmtree(gone, ignore_errors=True)
    except (OSError, StoreError):
        return False
    return True


@contextlib.contextmanager
def _unused(path: Path) -> Iterator[bool]:
    """Whether a folder is unused; while the lock is held nobody can start using it."""
    try:
        import fcntl
    except ImportError:  # open files cannot be removed there
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
