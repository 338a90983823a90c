"""How many kernels were compiled, and how long that took: counted by ``_numba``, shown by progress.

Compiling happens within whatever needs a kernel first, once on a machine: without this the time would be put down to
that work. It imports nothing of its own, so that whoever only wants to show it need not load the compiler.

Numba compiles one kernel at a time in a process. Long work therefore has a second one compile what it needs last, while
it compiles what it needs first (``while_compiling``); each finds the other's kernels in Numba's cache. And a command
that had to compile for long leaves a process behind that compiles what the other verbs need (``compile_rest``).
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
        """A kernel is being compiled."""
        self._here.depth = getattr(self._here, "depth", 0) + 1
        if self._here.depth == 1:
            self._here.began = time.perf_counter()
            self.count += 1
            for notify in self.changed:
                notify()

    def end(self) -> None:
        """It is compiled."""
        self._here.depth -= 1
        if self._here.depth == 0:
            self.seconds += time.perf_counter() - self._here.began  # (compilers take turns: no two times overlap)


LONG = 4.0
"""Seconds of compiling that mark a machine's first run."""

COMPILING = Compiling()
"""Of this process."""


@contextlib.contextmanager
def while_compiling(program: str, *arguments: str) -> Iterator[None]:
    """Within it, the first kernel that has to be compiled starts ``python -m program``, once in this process.

    On one core, in a program that is not Python itself (its executable would start that program), or where
    ``OROGRAPH_COMPILE_AHEAD`` is 0, nothing is started. What is started ends by itself.
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
    """Start ``python -m program`` if this process had to compile for long; whether it was started.

    It goes on when this process ends, and is not stopped by what stops this one.
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
    command = [sys.executable, "-P", "-m", program, *arguments]  # -P: modules of the folder one is in are not ours
    silent, alone = subprocess.DEVNULL, os.environ | {"OROGRAPH_COMPILE_AHEAD": "0"}
    with contextlib.suppress(OSError):  # one process compiles all, then
        _STARTED[program] = subprocess.Popen(command, stdin=silent, stdout=silent, stderr=silent, env=alone, **how)


_STARTED: dict[str, subprocess.Popen[bytes]] = {}
"""What was started by this process, by program."""
