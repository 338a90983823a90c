"""Counts how many kernels were compiled and how long that took; ``_numba`` counts, progress shows it.

Compiling happens inside whatever needs a kernel first, once per machine: without this, its time would be attributed to
that work. This module does not import Numba, so showing the counts does not load the compiler.

Kernels are compiled by processes that do nothing else (``compiled_elsewhere``), so that their memory is not the work's.
They begin with what a work will need when it begins (``expect``). And a command that had to compile for long leaves a
process behind that compiles what the other verbs need (``compile_rest``).
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from orograph._compilers import MOST, Compilers, run
from orograph._needed import Kernel, lacking, needed, written


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

_TOLD: set[str] = set()

_OWN: dict[str, Any] = {}


_EXPECTED: dict[str, None] = {}
"""The works that have been told of and whose kernels have not been asked for."""


def expect(*works: str) -> None:
    """Tell that a work begins that ``kernels.txt`` knows.

    If the cache lacks some of its kernels, other processes compile them from now on, those that are needed last too.
    On one core, in a program that is not Python itself (its executable would start that program), and where
    ``OROGRAPH_COMPILE_AHEAD`` is 0, this does nothing.
    """
    fresh = [work for work in works if work not in _TOLD]
    if not fresh or not _worthwhile():
        return
    _TOLD.update(fresh)
    missing = lacking(needed(fresh))
    if missing:
        _compilers().expect(missing)
    else:
        _EXPECTED.update(dict.fromkeys(fresh))


def compiled_elsewhere(module: str, name: str, types: Any) -> bool:
    """Have another process compile a kernel of this package for arguments of these types; whether Numba's cache has it.

    Where no process may be started (see ``expect``; one core is enough) or it fails, nothing is done. All that work
    needs which was told of is compiled after it.
    """
    import pickle

    if not module.startswith("orograph.") or not _allowed():
        return False
    try:
        request = pickle.dumps((module, name, types))
    except Exception:  # a type that only this process knows
        return False
    try:
        kernel = Kernel(module, name, written(types))
    except ValueError:
        kernel = Kernel(module, name, str(types))
    compilers = _compilers()
    if _EXPECTED:
        compilers.expect(one for one in needed(_EXPECTED) if one != kernel)
        _EXPECTED.clear()
    return compilers.compile(kernel, request)


def _compilers() -> Compilers:
    """Those of this process: one that was forked has none of its parent's threads."""
    if _OWN.get("process") != os.getpid():
        _OWN.update(process=os.getpid(), compilers=Compilers(MOST if _worthwhile() else 1))
    found: Compilers = _OWN["compilers"]
    return found


def compile_rest() -> bool:
    """Start a process that compiles all of ``kernels.txt`` if this one spent long on compiling; whether it was started.

    The new process outlives this one, and signals that stop this one do not stop it.
    """
    if COMPILING.seconds < LONG or not _worthwhile():
        return False
    return run("orograph._compiler", "--rest", "0", start_new_session=True) is not None


def _worthwhile() -> bool:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores > 1 and _allowed()


def _allowed() -> bool:
    wanted = os.environ.get("OROGRAPH_COMPILE_AHEAD", "1") != "0"
    return wanted and Path(sys.executable or "").stem.startswith("python")
