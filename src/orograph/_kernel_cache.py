"""Numba's cache of compiled kernels, for several processes at once, on disks that may be full.

Numba writes a function's index before the code that it names, and numbers the files of code: of two processes that
keep code at the same time, one forgets the other's, or calls the other's by the name of its own. And it takes a kernel
for current while its own file is unchanged, whatever has become of the functions and numbers that it has from others.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np
from numba.core.caching import IndexDataCacheFile

PATIENCE = 60.0
"""Seconds after which a process that holds a lock is taken to have stopped: a kernel compiles in less."""


class _Files(IndexDataCacheFile):
    """The index of a function's kernels and the files of their code."""

    def __init__(self, function: FunctionType, path: str, base: str, stamp: object) -> None:
        super().__init__(path, base, stamp)
        self._function, self._own_stamp = function, stamp

    def _refresh(self) -> None:
        """Let the stamp of the source be that of all that a kernel is made of. (Late: it takes a while.)"""
        if self._source_stamp is self._own_stamp:
            self._source_stamp = self._own_stamp, _made_of(self._function)

    def save(self, key: object, data: object) -> None:
        """Keep a kernel's code, then name it in the index; code that the index does not name is removed."""
        with locked(self._index_path):
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
        self._refresh()
        try:
            found: dict[object, str] = super()._load_index()
            return found
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}


def keep_safely(cache: Any) -> None:
    """Let the cache of a dispatcher be kept so."""
    file = cache._cache_file
    base = file._index_name.removesuffix(".nbi")
    cache._cache_file = _Files(cache._py_func, file._cache_path, base, file._source_stamp)
    save = cache.save_overload

    def save_overload(signature: object, made: Any) -> None:
        if made.metadata is None:  # another process has kept it
            return
        with contextlib.suppress(OSError):  # what cannot be kept is compiled again next time
            save(signature, made)

    cache.save_overload = save_overload


class _Part(NamedTuple):
    """What the code of one function names.

    Attributes:
        functions: of its package. files: where it and other objects of the package come from. values: of constants.
    """

    functions: frozenset[FunctionType]
    files: frozenset[str]
    values: frozenset[str]


def _made_of(function: FunctionType) -> str:
    """A digest of the files that a kernel comes from (names, times, sizes; the package may move) and its constants."""
    seen, todo = {function}, [function]
    files, values = set[str](), set[str]()
    while todo:
        part = _part(todo.pop())
        files |= part.files
        values |= part.values
        todo += part.functions - seen
        seen |= part.functions
    found = sorted((Path(file).name, *_stamp(file)) for file in files), sorted(values)
    return hashlib.blake2b(repr(found).encode(), digest_size=16).hexdigest()


@functools.cache
def _part(function: FunctionType) -> _Part:
    code, known, package = function.__code__, function.__globals__, function.__module__.partition(".")[0]

    def is_ours(module: str | None) -> bool:
        return module is not None and module.partition(".")[0] == package

    names = _names(code)
    found = {name: known[name] for name in names if name in known}
    found |= zip(code.co_freevars, [cell.cell_contents for cell in function.__closure__ or ()], strict=True)
    for module in [value for value in found.values() if isinstance(value, ModuleType) and is_ours(value.__name__)]:
        found |= {f"{module.__name__}.{name}": vars(module)[name] for name in names if name in vars(module)}
    functions, files, values = set[FunctionType](), {code.co_filename}, set[str]()
    for name, value in found.items():
        called = getattr(value, "py_func", value)
        if isinstance(called, FunctionType) and is_ours(called.__module__):
            functions.add(called)
        elif isinstance(value, int | float | str | bytes | tuple):
            values.add(f"{name}={value!r}")
        elif isinstance(value, np.ndarray):
            values.add(f"{name}={value.dtype}{value.shape}{value.tobytes()!r}")
        elif is_ours(getattr(value, "__module__", None)):
            files.add(str(sys.modules[value.__module__].__file__))
    return _Part(frozenset(functions), frozenset(files), frozenset(values))


def _names(code: CodeType) -> set[str]:
    """All names in a function's code and in that of the functions within it."""
    found = {*code.co_names, *code.co_freevars}
    return found.union(*(_names(inner) for inner in code.co_consts if isinstance(inner, CodeType)))


@functools.cache
def _stamp(file: str) -> tuple[int, int]:
    try:
        found = Path(file).stat()
    except OSError:  # in an archive
        return 0, 0
    return found.st_mtime_ns, found.st_size


@contextlib.contextmanager
def compiling_alone(dispatcher: Any) -> Iterator[None]:
    """Wait until no other process compiles a function: its kernels are in the cache then."""
    with contextlib.suppress(OSError):
        dispatcher._cache._impl.locator.ensure_cache_path()
    with locked(f"{dispatcher._cache._cache_file._index_path}.compiled"):
        yield


@contextlib.contextmanager
def locked(path: str) -> Iterator[None]:
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
