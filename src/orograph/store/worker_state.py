"""The work of a cluster's worker: tasks, each given by its stage and place.

Everything else comes from a *recipe*, which each process gets once: it opens what the tasks need (``build_state`` has
that of builds; light, films and pictures have theirs). A task that is already done is not repeated.

Kernels are compiled once per host: the first task of each kind runs alone there, and the others find what it compiled
in Numba's cache. The number of concurrent tasks is limited by the worker's memory, if that has a limit.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from orograph.errors import OrographError, StoreError
from orograph.folders import cache_folder
from orograph.processes import host
from orograph.store.digests import Spot
from orograph.store.executing import Stage
from orograph.store.storage import FolderStorage, Storage


class WorkerState(Protocol):
    """The state of one process for the tasks of a recipe."""

    def stage(self, name: str, number: int) -> Stage[Any]:
        """A stage, the same one every time; one call at a time."""


class Recipe(Protocol):
    """Everything that workers get once; it can be pickled.

    Attributes:
        memory: bytes a task may take, in addition to ``base`` for the process.
    """

    @property
    def memory(self) -> int: ...

    @property
    def base(self) -> int: ...

    def open(self) -> WorkerState:
        """Open what tasks need, in a worker."""


class Done(NamedTuple):
    """A worker's report on a task.

    Attributes:
        who: its host and process. seconds: the task's; 0 if it was already done. remarks: of the stage.
        failed: why it could not be done. (Dask would print a raised error with its traceback, in every worker.)
    """

    who: str
    seconds: float
    remarks: tuple[str, ...] = ()
    failed: OrographError | None = None


class _Open:
    """A recipe, as opened by this process."""

    def __init__(self, recipe: Recipe, limit: int) -> None:
        self.recipe = recipe
        free = (limit - recipe.base) // recipe.memory if limit else None
        self.room = contextlib.nullcontext() if free is None else threading.BoundedSemaphore(max(1, free))
        self._lock = threading.Lock()
        self._state: WorkerState | None = None

    def state(self) -> WorkerState:
        """This process's state for the tasks."""
        with self._lock:
            if self._state is None:
                self._state = self.recipe.open()
            return self._state

    def stage(self, name: str, number: int) -> Stage[Any]:
        state = self.state()
        with self._lock:
            return state.stage(name, number)


_open: dict[str, _Open] = {}


def learn(ident: str, recipe: Recipe, limit: int = 0) -> None:
    """Register a recipe in this process.

    Args:
        ident: its name in tasks. limit: bytes of memory that the process may take; 0: unlimited.
    """
    _open[ident] = _Open(recipe, limit)


def opened(ident: str) -> WorkerState:
    """This process's state for a registered recipe."""
    return _open[ident].state()


def forget(ident: str) -> None:
    """Close the state and forget the recipe."""
    _open.pop(ident, None)


def do(ident: str, name: str, number: int, spot: Spot) -> Done:
    """Do a task of a stage, unless it is done.

    Args:
        ident: of the recipe. name, number: of the stage. spot: of the task.
    """
    state = _open[ident]
    who = f"{host()}.{os.getpid()}"
    try:
        with state.room, _first_alone(name):
            stage = state.stage(name, number)
            if stage.found(spot) is not None:
                return Done(who, 0.0)
            began = time.perf_counter()
            found = stage.make(spot)
            return Done(who, time.perf_counter() - began, stage.remarks(found))
    except OrographError as error:
        error.__cause__ = error.__context__ = None  # which may not be picklable
        return Done(who, 0.0, failed=error.with_traceback(None))


def guarded(storage: Storage, at: str, plan: bytes) -> Storage:
    """A storage that refuses writes unless this plan lies there under the key ``at``."""
    put = storage.put
    if isinstance(storage, FolderStorage):
        storage.many = True

    def only_then(key: str, parts: Sequence[bytes]) -> None:
        if storage.get(at) != plan:
            raise StoreError("The work of this task has ended, or other work was started.", path=storage.url)
        put(key, parts)

    storage.put = only_then  # type: ignore[method-assign]
    return storage


@contextlib.contextmanager
def _first_alone(name: str) -> Iterator[None]:
    """Let one process of this machine run the first task of a kind while the others wait."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    if name in _compiled:
        yield
        return
    kernels = _kernels()
    done = cache_folder() / f".compiled.{host()}.{name}"
    try:
        done.parent.mkdir(parents=True, exist_ok=True)
        file = done.open("a+b")
    except OSError:  # then each process compiles for itself
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        if file.read() == kernels:
            fcntl.flock(file, fcntl.LOCK_UN)
            yield
        else:
            yield
            file.truncate(0)
            file.write(kernels)
    _compiled.add(name)


_compiled: set[str] = set()
"""The stages of which this process has done a task."""


@functools.cache
def _kernels() -> bytes:
    """A key that changes when kernels must be recompiled or lie elsewhere."""
    package = Path(__file__).parent.parent
    newest = max(path.stat().st_mtime_ns for path in package.rglob("*.py"))
    return f"{package} {newest}".encode()
