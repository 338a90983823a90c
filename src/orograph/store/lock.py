"""One writer at a time: a lock on a name beside the store, which no build ever renames or replaces.

A writer to the store ``area.oro`` (a build, a bake, a repair) holds ``.area.oro.lock`` from before it examines what is
there until after its last rename. The lock is ``flock``: the system releases it when its process ends, however it ends,
so a leftover lock file locks nothing. A sole holder removes the file, and a lock counts only if the name still denotes
the locked file; so there is never a second lock under the same name.

Parts of one build share it: ``shared`` identifies the build, and others are refused.

On a network file system this relies on ``flock`` reaching all machines: NFS from version 3 with its lock manager or 4,
SMB, CephFS, GPFS, and Lustre mounted with ``-o flock`` do that. If the system reports that it has no such locks, a file
``.area.oro.owner`` that only one process can create takes their place. It names its process and is taken over if that
process, on this machine, has ended. In buckets a lock is an object (``bucket_lock``); at other addresses nothing keeps
two builds apart.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orograph.errors import StoreBusyError, StoreError
from orograph.output import beside, remove
from orograph.processes import host, running
from orograph.store.places import sweep
from orograph.store.storage import FolderStorage, Storage

TRIES = 100
"""How often a lock may prove to be on a file just removed, or may change hands among processes that share it."""

PAUSE = 0.02
"""Seconds between such attempts."""

BUSY = frozenset({errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES})
UNSUPPORTED = frozenset({errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL})
NO_LINKS = frozenset({errno.EPERM, errno.EMLINK}) | UNSUPPORTED
"""Error codes of systems without hard links."""


@contextmanager
def alone(storage: Storage, doing: str, shared: str | None = None) -> Iterator[Callable[[], bool]]:
    """Keep all other processes and threads from writing to a store.

    Args:
        storage: the store's, not that of the folder in which it is made.
        doing: what other processes are told: "building this store".
        shared: the digest of the plan of the processes that may work at the same time; None: the lock is exclusive.

    Yields:
        Whether this process is the only one that holds it; if so, no other can take it any more.

    Raises:
        StoreError: another process is at work, or no lock can be created there.
    """
    if not isinstance(storage, FolderStorage):
        with _in_bucket(storage, doing, shared):
            yield lambda: shared is None
        return
    real = Path(os.path.realpath(storage.path))
    path = real.with_name(f".{real.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = _take(path, storage.url, doing, shared)
    except OSError as error:
        raise StoreError(
            f"Nothing can be written beside it: {error.strerror or error}.", path=storage.url,
            remedy=f"A lock {path.name} is kept there while it is written.",
        ) from error  # fmt: skip
    try:
        sweep(real)
        yield lock.last
    finally:
        lock.release()


@contextmanager
def _in_bucket(storage: Storage, doing: str, shared: str | None) -> Iterator[None]:
    """The lock of a store in a bucket; at other addresses there are no locks."""
    from orograph.store.bucket import BucketStorage
    from orograph.store.bucket_lock import Lease

    if not isinstance(storage, BucketStorage):
        yield
        return
    storage.may_write()
    lease = Lease(storage, doing, shared)
    lease.take()
    storage.lease = lease
    try:
        yield
    finally:
        storage.lease = None
        lease.release()


class _Flock:
    """A lock that is held."""

    def __init__(self, path: Path, fd: int, shared: bool) -> None:
        self.path, self.fd, self.shared = path, fd, shared

    def last(self) -> bool:
        """Whether no other process holds it: then it is exclusive from now on. Otherwise it may be lost."""
        import fcntl

        return (not self.shared or _locked(self.fd, fcntl.LOCK_EX)) and _named(self.path, self.fd)

    def release(self) -> None:
        import fcntl

        try:
            with contextlib.suppress(OSError):
                if self.last():
                    self.path.unlink()
            with contextlib.suppress(OSError):
                fcntl.flock(self.fd, fcntl.LOCK_UN)  # explicitly, because a forked child may hold a copy of it
        finally:
            os.close(self.fd)


class _Owner:
    """The file that replaces a lock where there are none."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def last(self) -> bool:
        return True

    def release(self) -> None:
        remove(self.path)


def _take(path: Path, url: str, doing: str, shared: str | None) -> _Flock | _Owner:
    try:
        import fcntl  # noqa: F401
    except ImportError:
        return _own(path.with_suffix(".owner"), url, doing, shared)
    for _ in range(TRIES):
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        lock = None
        try:
            lock = _try(path, fd, url, doing, shared)
        except OSError as error:
            if error.errno not in UNSUPPORTED:
                raise
            remove(path)
            return _own(path.with_suffix(".owner"), url, doing, shared)
        finally:
            if lock is None:
                os.close(fd)
        if lock is not None:
            return lock
    raise _busy(url, {})


def _try(path: Path, fd: int, url: str, doing: str, shared: str | None) -> _Flock | None:
    """Lock an open file; None if it should be retried.

    Raises:
        StoreError: another process holds it.
    """
    import fcntl

    if _locked(fd, fcntl.LOCK_EX):
        if not _named(path, fd):
            return None
        _write(fd, doing, shared)
        if shared is None:
            return _Flock(path, fd, False)
    elif shared is None:
        raise _busy(url, _read(fd))
    # Changing from an exclusive to a shared lock releases it for a moment: another process may take it in between.
    locked = _locked(fd, fcntl.LOCK_SH)
    content = _read(fd)
    if content.get("shared", shared) != shared:
        raise _busy(url, content, "Its plan is different.")
    if locked and _named(path, fd):
        return _Flock(path, fd, True)
    time.sleep(PAUSE)  # another part of this build holds it exclusively while it begins or ends
    return None


def _locked(fd: int, how: int) -> bool:
    """Take the lock without waiting; return whether that succeeded."""
    import fcntl

    try:
        fcntl.flock(fd, how | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in BUSY:
            return False
        raise
    return True


def _named(path: Path, fd: int) -> bool:
    """Whether the name still refers to this file."""
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    mine = os.fstat(fd)
    return (there.st_ino, there.st_dev) == (mine.st_ino, mine.st_dev)


def _said(doing: str, shared: str | None) -> bytes:
    return json.dumps({"doing": doing, "host": host(), "pid": os.getpid(), "shared": shared}).encode()


def _write(fd: int, doing: str, shared: str | None) -> None:
    os.ftruncate(fd, 0)
    os.pwrite(fd, _said(doing, shared), 0)


def _read(fd: int) -> dict[str, Any]:
    """What the holder wrote; empty if nothing yet."""
    try:
        content = json.loads(os.pread(fd, 4096, 0))
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def _busy(url: str, content: dict[str, Any], why: str = "", remedy: str = "") -> StoreBusyError:
    doing = content.get("doing", "at work on this store")
    who = f" (process {content['pid']} on {content['host']})" if "pid" in content and "host" in content else ""
    what = f"Another process is {doing}{who}. {why}".strip()
    return StoreBusyError(what, path=url, remedy=f"Wait until it is done. {remedy}".strip())


def _own(path: Path, url: str, doing: str, shared: str | None) -> _Owner:
    """Lock by a name that only one process can create."""
    if shared is not None:
        raise StoreError(
            "This file system has no locks, which the parts of one build need to share.", path=url,
            remedy="Build on another file system (or mount Lustre with -o flock), or in one part.",
        )  # fmt: skip
    for _ in range(2):
        try:
            _create(path, _said(doing, None))
        except FileExistsError:
            if _given_up(path):
                continue
            ended = f"If that process has ended, remove {path.name} beside the store."
            raise _busy(url, _owner(path), remedy=ended) from None
        return _Owner(path)
    raise _busy(url, _owner(path))


def _create(path: Path, data: bytes) -> None:
    """Create a file that must not exist, complete from the first moment.

    Raises:
        FileExistsError: it exists.
    """
    whole = Path(f"{beside(path, 'part')}.{threading.get_ident()}")
    try:
        whole.write_bytes(data)
        os.link(whole, path)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        with os.fdopen(fd, "wb") as file:
            file.write(data)
    finally:
        remove(whole)


def _owner(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _given_up(path: Path) -> bool:
    """Whether the owner has ended, in which case its file is removed. Only one process at a time may decide this."""

    def ended() -> bool:
        content = _owner(path)
        return content.get("host") == host() and isinstance(content.get("pid"), int) and not running(content["pid"])

    if not ended():
        return False
    guard = path.with_suffix(".taking")
    try:
        os.close(os.open(guard, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    except FileExistsError:
        return False
    try:
        if ended():  # nobody else has taken it over since
            path.unlink()
            return True
        return False
    finally:
        remove(guard)
