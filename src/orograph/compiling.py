"""Counts how many kernels were compiled and how long that took; ``_numba`` counts, progress shows it.

Compiling happens inside whatever needs a kernel first, once per machine: without this, its time would be attributed to
that work. This module imports nothing of the package, so showing the counts does not load the compiler.

Kernels are compiled by a process that does nothing else (``compiled_elsewhere``), so that its memory is not the work's.
Numba compiles one kernel at a time in a process. Long work therefore has a second one compile what it needs last, while
it compiles what it needs first (``while_compiling``); each finds the other's kernels in Numba's cache. And a command
that had to compile for long leaves a process behind that compiles what the other verbs need (``compile_rest``).
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any


class Compiling:
    """The kernels that this process has compiled so far; those read from the cache do not count.

    Attributes:
        count: kernels. seconds: that they took; what one kernel compiles for itself is part of it.
        changed: called, from any thread, when another one is begun.
    """

    def __init__(self) -> None:
        self.count = 0
        self.seconds = 0.0
        self.changed: list[Callable[[], None]] = []
        self._here = threading.local()

    def begin(self) -> None:
        """Note that a kernel begins to compile."""
        self._here.depth = getattr(self._here, "depth", 0) + 1
        if self._here.depth == 1:
            self._here.began = time.perf_counter()
            self.count += 1
            for notify in self.changed:
                notify()

    def end(self) -> None:
        """Note that a kernel is compiled."""
        self._here.depth -= 1
        if self._here.depth == 0:
            self.seconds += time.perf_counter() - self._here.began  # (compilers take turns: no two times overlap)


LONG = 4.0
"""Seconds of compiling that mark a machine's first run."""

COMPILING = Compiling()
"""When this process began."""


@contextlib.contextmanager
def while_compiling(program: str, *arguments: str) -> Iterator[None]:
    """Inside this context, the first kernel that must be compiled starts ``python -m program``, once per process.

    On one core, in a program that is not Python itself (its executable would start that program), where
    ``OROGRAPH_COMPILE_AHEAD`` is 0, or without arguments, nothing is started. What is started ends by itself.
    """

    def start() -> None:
        COMPILING.changed.remove(start)
        _start(program, *arguments)

    if program in _STARTED or not arguments or not _worthwhile():
        yield
        return
    COMPILING.changed.append(start)
    try:
        yield
    finally:
        if start in COMPILING.changed:
            COMPILING.changed.remove(start)


class _Compiler:
    """The process that compiles for this one: ``python -m orograph._compiler``, started when it is needed.

    It ends by itself: when it has had nothing to do, when it has grown large, and with this process.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._useless = False
        self._lock = threading.Lock()

    def compile(self, request: bytes) -> bool:
        """Have a pickled (module, name, types) compiled; whether that was done."""
        with self._lock:
            if self._useless:
                return False
            answer = self._ask(request) or self._ask(request)  # (once more: it may just have ended)
            self._useless = not answer  # it cannot be started as this process was
        return answer == b"1"

    def _ask(self, request: bytes) -> bytes:
        if self._process is None or self._owner != os.getpid():
            self._process, self._owner = _piped("orograph._compiler"), os.getpid()
        process, self._process = self._process, None
        if process is None or process.stdin is None or process.stdout is None:
            return b"0"
        try:
            process.stdin.write(request)
            process.stdin.flush()
            answer = process.stdout.read(1)
        except OSError:
            answer = b""
        except BaseException:  # interrupted: its answer would be taken for that of the next request
            process.kill()
            raise
        if answer:
            self._process = process
        else:
            process.wait()
        return answer


_COMPILER = _Compiler()


def compiled_elsewhere(module: str, name: str, types: object) -> bool:
    """Have another process compile a kernel of this package for arguments of these types; whether Numba's cache has it.

    Where no process may be started (see ``while_compiling``; one core is enough) or it fails, nothing is done.
    """
    if not module.startswith("orograph.") or not _allowed():
        return False
    try:
        request = pickle.dumps((module, name, types))
    except Exception:  # a type that only this process knows
        return False
    return _COMPILER.compile(request)


def compile_rest(program: str) -> bool:
    """Start ``python -m program`` if this process spent long on compiling; returns whether it was started.

    The new process outlives this one, and signals that stop this one do not stop it.
    """
    if COMPILING.seconds < LONG or not _worthwhile():
        return False
    _start(program, start_new_session=True)
    return program in _STARTED


def _worthwhile() -> bool:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores > 1 and _allowed()


def _allowed() -> bool:
    wanted = os.environ.get("OROGRAPH_COMPILE_AHEAD", "1") != "0"
    return wanted and Path(sys.executable or "").stem.startswith("python")


def _start(program: str, *arguments: str, **how: Any) -> None:
    process = _run(program, *arguments, **how)
    if process is not None:
        _STARTED[program] = process


def _piped(program: str) -> subprocess.Popen[bytes] | None:
    return _run(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def _run(program: str, *arguments: str, **how: Any) -> subprocess.Popen[bytes] | None:
    """Start ``python -m program``; None if it cannot be started."""
    command = [sys.executable, "-P", "-m", program, *arguments]  # -P: modules of the folder one is in are not ours
    silent, alone = subprocess.DEVNULL, os.environ | {"OROGRAPH_COMPILE_AHEAD": "0"}
    try:
        return subprocess.Popen(command, **{"stdin": silent, "stdout": silent, **how}, stderr=silent, env=alone)
    except OSError:  # this process compiles all, then
        return None


_STARTED: dict[str, subprocess.Popen[bytes]] = {}
"""The processes that this one started, by program."""
