"""Where a store's bytes lie: a folder, or another place (``addresses``).

A store needs very little of its storage: whole objects by key, ranges of them, and an atomic put, after which the
object is there entirely or not at all. A folder does this by writing a file beside its place and renaming it; object
stores do it by nature. Keys are paths with ``/``. Every failure other than absence is a StoreError that says where.

A web server that accepts a connection and never answers must not hold a reader for long: ``SILENCE`` seconds without
a byte are an error. If a server reports that it is busy, or drops the connection, the request is retried after
``AGAIN`` seconds; for a bucket, more often.
"""

from __future__ import annotations

import errno
import os
import shutil
import threading
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orograph.errors import StoreError
from orograph.output import remove
from orograph.processes import host
from orograph.servers import SILENCE as SILENCE
from orograph.store.ranges import Range

OPEN_FILES = 128
WRITING = ".writing"  # suffix of the names of incomplete files
AGAIN = (0.25, 1.0)  # seconds of back-off before retries of transient failures
LONGER = (2.0, 4.0, 8.0, 16.0)  # further retries, for a bucket


class Storage(ABC):
    """Objects by key. Reading is safe from any thread, and so is writing different keys."""

    url: str
    remote: bool
    number: int | None = None
    """The version, if it is an older one of a store whose versions lie below one key (``versions``); else None."""

    @abstractmethod
    def get(self, key: str) -> bytes | None:
        """The whole object, or None if there is none."""

    @abstractmethod
    def tail(self, key: str, length: int) -> bytes | None:
        """The object's last ``length`` bytes (fewer if it is shorter), or None if there is none."""

    @abstractmethod
    def ranges(self, wanted: Sequence[Range]) -> list[bytes]:
        """Ranges of objects, fetched concurrently where that is faster; short or empty if an object is truncated or
        gone."""

    @abstractmethod
    def put(self, key: str, parts: Sequence[bytes]) -> None:
        """Write an object, atomically: it appears whole or not at all."""

    @abstractmethod
    def exists(self, key: str) -> bool:
        """Whether the object is there."""

    def renewed(self, key: str) -> None:  # noqa: B027 (only buckets remember where an object lies)
        """Note that another process has written an object."""

    @abstractmethod
    def remove(self, key: str = "") -> None:
        """Remove an object or everything below a key (all of it: ""); nothing happens if it is not there."""

    @abstractmethod
    def size(self) -> int | None:
        """Bytes of all objects together; None if the storage cannot tell."""

    def stamp(self, key: str) -> tuple[Any, ...] | None:
        """A value that changes when an object is replaced, found with one request; None if there is none."""
        return None

    def uncached(self) -> Storage:
        """The same place, with nothing cached."""
        return self

    def follow(self, other: Storage) -> None:
        """Continue reading from another place, to which the store has moved."""
        raise NotImplementedError

    def named(self) -> tuple[str, dict[str, Any] | None]:
        """The URL and options with which other processes open it (``storage_at``)."""
        return self.url, None

    def close(self) -> None:  # noqa: B027 (only folders hold files open)
        """Close open files."""


class _File:
    """An open file descriptor, closed when its last user releases it."""

    __slots__ = ("fd",)

    def __init__(self, path: Path) -> None:
        self.fd = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))

    def __del__(self) -> None:
        if hasattr(self, "fd"):
            os.close(self.fd)


class FolderStorage(Storage):
    """A folder on a local disk; the files read last stay open.

    Args:
        path: the folder's path.
        many: whether several processes may write the same objects (with the same bytes) at once. Then only ``sweep``
            removes the incomplete files that a killed process leaves.

    Attributes:
        home: the original folder, even if the store has moved (``follow``).
    """

    remote = False

    def __init__(self, path: str | os.PathLike[str], many: bool = False) -> None:
        self.path, self.many = Path(path), many
        self.home = self.path
        self.url = str(self.path)
        self._lock = threading.Lock()
        self._open: OrderedDict[str, _File] = OrderedDict()

    def _file(self, key: str) -> _File:
        with self._lock:
            file = self._open.get(key)
            if file is None:
                file = self._open[key] = _File(self.path / key)
                if len(self._open) > OPEN_FILES:
                    self._open.popitem(last=False)
            else:
                self._open.move_to_end(key)
            return file

    def get(self, key: str) -> bytes | None:
        try:
            return (self.path / key).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise self._failed("read", key, error) from error

    def tail(self, key: str, length: int) -> bytes | None:
        try:
            file = self._file(key)
            size = os.fstat(file.fd).st_size
            return _pread(file.fd, min(length, size), max(0, size - length))
        except (FileNotFoundError, NotADirectoryError):
            self.must_stand()
            return None
        except OSError as error:
            raise self._failed("read", key, error) from error

    def ranges(self, wanted: Sequence[Range]) -> list[bytes]:
        found = []
        for key, start, stop in wanted:
            try:
                file = self._file(key)  # held by name: another thread may drop it from the cache meanwhile
                found.append(_pread(file.fd, stop - start, start))
            except FileNotFoundError:
                self.must_stand()
                found.append(b"")
            except OSError as error:
                raise self._failed("read", key, error) from error
        return found

    def put(self, key: str, parts: Sequence[bytes]) -> None:
        path = self.path / key
        own = f".{host()}.{os.getpid()}.{threading.get_ident()}" if self.many else ""
        beside = path.with_name(f".{path.name}{own}{WRITING}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                with beside.open("wb") as file:
                    file.writelines(parts)
                with self._lock:
                    self._open.pop(key, None)  # later reads must open the new file
                beside.replace(path)
            except BaseException:
                remove(beside)
                raise
        except OSError as error:
            raise self._failed("written", key, error) from error

    def exists(self, key: str) -> bool:
        return (self.path / key).exists()

    def remove(self, key: str = "") -> None:
        path = self.path / key if key else self.path
        try:
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise self._failed("removed", key, error) from error

    def rename(self, key: str, to: str) -> None:
        """Move everything below a key to another one, which must be free."""
        try:
            (self.path / key).rename(self.path / to)
        except OSError as error:
            raise self._failed("moved", key, error) from error
        with self._lock:
            self._open.clear()

    def sweep(self) -> None:
        """Remove the incomplete files that killed processes left."""
        for path in self.path.rglob(f".*{WRITING}"):
            remove(path)

    def stamp(self, key: str) -> tuple[Any, ...] | None:
        try:
            found = (self.path / key).stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns, found.st_size

    def uncached(self) -> Storage:
        return FolderStorage(self.home)

    def follow(self, other: Storage) -> None:
        assert isinstance(other, FolderStorage)
        with self._lock:
            self.path, self.url = other.path, other.url
            self._open.clear()

    def named(self) -> tuple[str, dict[str, Any] | None]:
        return str(self.path.absolute()), None

    def size(self) -> int | None:
        return sum(entry.stat().st_size for entry in self.path.rglob("*") if entry.is_file())

    def close(self) -> None:
        with self._lock:
            self._open.clear()

    def must_stand(self) -> None:
        """Raise StoreError if the folder is gone: then it was moved or removed. (A missing file is damage.)"""
        if not self.path.exists():
            raise StoreError(
                "The folder no longer exists.", path=self.path,
                remedy="Put it back, or open the store where it is now.",
            )  # fmt: skip

    def _failed(self, what: str, key: str, error: OSError) -> StoreError:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        return StoreError(
            f"{key or 'The folder'} could not be {what}: {error.strerror or error}.",
            path=self.path,
            remedy="Make room, and run it again: a build with `resume=True`, an update unchanged." if full else "",
        )


if hasattr(os, "pread"):

    def _pread(fd: int, length: int, start: int) -> bytes:
        return os.pread(fd, length, start)

else:  # Windows has no pread
    _seek_lock = threading.Lock()

    def _pread(fd: int, length: int, start: int) -> bytes:
        with _seek_lock:
            os.lseek(fd, start, os.SEEK_SET)
            return os.read(fd, length)
