"""Counts how many kernels were compiled and how long that took; ``_numba`` counts, progress shows it.

Compiling happens inside whatever needs a kernel first, once per machine: without this, its time would be attributed to
that work. This module imports nothing of the package, so showing the counts does not load the compiler.

Numba compiles one kernel at a time in a process. Long work therefore starts a second process that compiles the kernels
needed last, while it compiles those needed first (``while_compiling``); each finds the other's kernels in Numba's
cache. A command that spent long on compiling also leaves a process behind that compiles what the other verbs need
(``compile_rest``).
"""

from __future__ import annotations

import contextlib
import os
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

    On one core, in a program that is not Python itself (its executable would start that program), or where
    ``OROGRAPH_COMPILE_AHEAD`` is 0, nothing is started. The started process ends by itself.
    """

    def start() -> None:
        COMPILING.changed.remove(start)
        _start(program, *arguments)

    if program in _STARTED or not _worthwhile():
        yield
        return
    COMPILING.changed.append(start)
    try:
        yield
    finally:
        if start in COMPILING.changed:
            COMPILING.changed.remove(start)


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
    wanted = os.environ.get("OROGRAPH_COMPILE_AHEAD", "1") != "0"
    return wanted and cores > 1 and Path(sys.executable or "").stem.startswith("python")


def _start(program: str, *arguments: str, **how: Any) -> None:
    command = [sys.executable, "-P", "-m", program, *arguments]  # -P: keep the current folder's modules out of sys.path
    silent, alone = subprocess.DEVNULL, os.environ | {"OROGRAPH_COMPILE_AHEAD": "0"}
    with contextlib.suppress(OSError):  # one process compiles everything, and then
        _STARTED[program] = subprocess.Popen(command, stdin=silent, stdout=silent, stderr=silent, env=alone, **how)


_STARTED: dict[str, subprocess.Popen[bytes]] = {}
"""The processes that this one started, by program."""
