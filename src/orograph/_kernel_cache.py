"""Numba's cache of compiled kernels, for several processes at once, on disks that may be full.

Numba writes a function's index before the code that it names, and numbers the files of code: of two processes that
keep code at the same time, one forgets the other's, or calls the other's by the name of its own.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

PATIENCE = 60.0
"""Seconds after which a process that holds a lock is taken to have stopped: a kernel compiles in less."""


class _Files(IndexDataCacheFile):
    """The index of a function's kernels and the files of their code."""

    def save(self, key: object, data: object) -> None:
        """Keep a kernel's code, then name it in the index; code that the index does not name is removed."""
        with alone(self._index_path):
            found = self._load_index()
            found[key] = self._data_name(int.from_bytes(os.urandom(6), "big"))
            self._save_data(found[key], data)
            self._save_index(found)
            named = set(found.values())
            pattern = self._data_name_pattern.format(number=0).removesuffix("0.nbc") + "*.nbc"
            for path in Path(self._cache_path).glob(pattern):
                if path.name not in named:
                    path.unlink(missing_ok=True)

    def _load_index(self) -> dict[object, str]:
        """The names of files by kernel; none where the index cannot be read.

        Numba reads the whole index before it notices that the source has changed. An index that names a class that no
        longer exists (an argument's type in an older version) would make every call fail.
        """
        try:
            found: dict[object, str] = super()._load_index()
            return found
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}


def keep_safely(cache: Any) -> None:
    """Let the cache of a dispatcher be kept so."""
    file = cache._cache_file
    base = file._index_name.removesuffix(".nbi")
    cache._cache_file = _Files(file._cache_path, base, file._source_stamp)
    save = cache.save_overload

    def save_overload(signature: object, made: Any) -> None:
        if made.metadata is None:  # another process has kept it
            return
        with contextlib.suppress(OSError):  # what cannot be kept is compiled again next time
            save(signature, made)

    cache.save_overload = save_overload


@contextlib.contextmanager
def compiling_alone(dispatcher: Any) -> Iterator[None]:
    """Wait until no other process compiles a function: its kernels are in the cache then."""
    with contextlib.suppress(OSError):
        dispatcher._cache._impl.locator.ensure_cache_path()
    with alone(f"{dispatcher._cache._cache_file._index_path}.compiled"):
        yield


@contextlib.contextmanager
def alone(path: str) -> Iterator[None]:
    """Hold the lock of a file; where there are no locks, or none can be made, hold none."""
    try:
        import fcntl

        lock = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT, 0o666)
    except (ImportError, OSError):
        yield
        return
    end = time.monotonic() + PATIENCE
    try:
        while time.monotonic() < end:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.01)
            except OSError:  # a disk without locks
                break
        yield
    finally:
        os.close(lock)
