"""The program that compiles kernels for another process: ``python -m orograph._compiler`` (see ``compiling``).

It reads (module, name, types) as pickles, and answers each with a byte: 1 if Numba's cache has the kernel now, else 0.
"""

from __future__ import annotations

import gc
import importlib
import os
import pickle
import sys
import threading
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO, cast

IDLE = 1.0
"""Seconds without work after which it ends."""

LARGEST = 320 << 20
"""Bytes of memory after which it ends, for another to begin small."""


def compile_kernel(module: str, name: str, types: tuple[object, ...]) -> None:
    """Compile a kernel for arguments of these types, and keep it."""
    found = getattr(importlib.import_module(module), name)
    getattr(found, "alone", found).compile(types)


def hasten() -> None:
    """Spare a process that compiles and ends what takes Numba a sixth of its time."""
    from numba.core.targetconfig import TargetConfig

    def equal(self: Any, other: Any) -> bool:  # (Numba's reads each of 30 options, and is called 500 times a kernel)
        return isinstance(other, TargetConfig) and bool(self._values == other._values)

    gc.set_threshold(100_000, 20, 20)  # a compiler's objects live long
    cast(Any, TargetConfig).__eq__ = equal


def serve(requests: BufferedReader, answers: BinaryIO) -> None:
    """Answer requests until there are no more, or there is a reason to end."""
    hasten()
    while True:
        idle = threading.Timer(IDLE, os._exit, [0])
        idle.daemon = True
        idle.start()
        more = requests.peek(1)
        idle.cancel()
        if not more:
            return
        try:
            compile_kernel(*pickle.load(requests))
            answer = b"1"
        except Exception:  # the process that asked compiles it itself, and tells what is wrong
            answer = b"0"
        answers.write(answer)
        answers.flush()
        if _resident() > LARGEST:
            return


def _resident() -> int:
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what imports may print is no answer
    serve(sys.stdin.buffer, answers)  # type: ignore[arg-type]
