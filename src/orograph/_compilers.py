"""The processes that compile kernels for this one: ``python -m orograph._compiler``, started when they are needed.

Numba compiles one kernel at a time in a process, so two of them share what is asked for. What this process waits for
goes first, then what it will need (``Compilers.expect``). They end by themselves: when they have had nothing to do,
when they have grown large, and with this process.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from orograph._needed import Kernel

if TYPE_CHECKING:
    import subprocess  # loaded late, as pickle is: the command line starts without them

MOST = 2 if (os.cpu_count() or 1) < 4 else 3
"""Processes at once: each takes up to 350 MiB."""


class Compilers:
    """Compilers, the kernels that wait for them, and what came of those that were begun."""

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._turn = threading.Condition()
        self._waiting: dict[Kernel, bytes] = {}
        self._begun: set[Kernel] = set()
        self._made: dict[Kernel, bool] = {}
        self._idle = self._threads = 0

    def expect(self, kernels: Iterable[Kernel]) -> None:
        """Compile these, one after the other, as soon as nothing is waited for."""
        import pickle

        with self._turn:
            for kernel in kernels:
                if kernel not in self._made and kernel not in self._begun:
                    self._waiting.setdefault(kernel, pickle.dumps(tuple(kernel)))
            self._call()

    def compile(self, kernel: Kernel, request: bytes) -> bool:
        """Have a kernel compiled, before all others; whether that was done."""
        with self._turn:
            if kernel not in self._made and kernel not in self._begun:
                self._waiting.pop(kernel, None)
                self._waiting = {kernel: request, **self._waiting}
                self._call()
            while kernel not in self._made:
                self._turn.wait(1.0)  # (without a limit, Ctrl-C would wait, too, on Windows)
            return self._made[kernel]

    def _call(self) -> None:
        """Wake as many threads as have something to do, and start those that there are not yet."""
        while self._threads < self._most and self._idle < len(self._waiting):
            self._threads += 1
            self._idle += 1
            threading.Thread(target=self._serve, daemon=True).start()
        self._turn.notify_all()

    def _next(self) -> Kernel | None:
        """The first kernel that may be begun: Numba keeps a function's kernels in one file, so only one at a time."""
        busy = {kernel[:2] for kernel in self._begun}
        return next((kernel for kernel in self._waiting if kernel[:2] not in busy), None)

    def _serve(self) -> None:
        """What a thread does: pass kernels to a process of its own."""
        compiler = _Compiler()
        while True:
            with self._turn:
                while (kernel := self._next()) is None:
                    self._turn.wait()
                request = self._waiting.pop(kernel)
                self._begun.add(kernel)
                self._idle -= 1
            made = compiler.compile(request)
            with self._turn:
                self._begun.remove(kernel)
                self._made[kernel] = made
                self._idle += 1
                self._turn.notify_all()


class _Compiler:
    """One of the processes."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._useless = False

    def compile(self, request: bytes) -> bool:
        """Have a pickled (module, name, types) compiled; whether that was done."""
        if self._useless:
            return False
        answer = self._ask(request) or self._ask(request)  # (once more: it may just have ended)
        self._useless = not answer  # it cannot be started as this process was
        return answer == b"1"

    def _ask(self, request: bytes) -> bytes:
        process = self._process or piped("orograph._compiler")
        if process is None or process.stdin is None or process.stdout is None:
            return b"0"
        try:
            process.stdin.write(request)
            process.stdin.flush()
            answer = process.stdout.read(1)
        except OSError:
            answer = b""
        self._process = process if answer else None
        if not answer:
            process.wait()
        return answer


def piped(program: str) -> subprocess.Popen[bytes] | None:
    """Start ``python -m program`` to ask and to answer."""
    import subprocess

    return run(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def run(program: str, *arguments: str, **how: Any) -> subprocess.Popen[bytes] | None:
    """Start ``python -m program``; None if it cannot be started."""
    import subprocess

    command = [sys.executable, "-P", "-m", program, *arguments]  # -P: modules of the folder one is in are not ours
    silent, alone = subprocess.DEVNULL, os.environ | {"OROGRAPH_COMPILE_AHEAD": "0"}
    try:
        return subprocess.Popen(command, **{"stdin": silent, "stdout": silent, **how}, stderr=silent, env=alone)
    except OSError:  # this process compiles all, then
        return None
