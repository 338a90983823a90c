"""The program that compiles kernels for another process: ``python -m orograph._compiler`` (see ``compiling``).

It reads (module, name, types) as pickles, and answers each with a byte: 1 if Numba's cache has the kernel now, else 0.
With ``--rest`` it compiles whatever the cache lacks of ``kernels.txt``.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import sys
import threading
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from orograph._hastened import hasten
from orograph._needed import lacking, lines, types_of

IDLE = 10.0
"""Seconds without work after which it ends: starting another takes a second and a half of a processor."""

LARGEST = 320 << 20
"""Bytes of memory after which it ends, for another to begin small."""


def compile_kernel(module: str, name: str, types: str | tuple[object, ...]) -> None:
    """Compile a kernel for arguments of these types (or their names), and keep it."""
    found = getattr(importlib.import_module(module), name.removesuffix(".alone"))
    found = getattr(found, "alone", found)
    from orograph._kernel_cache import compiling_alone

    with compiling_alone(found):
        found.compile(types_of(types) if isinstance(types, str) else types)


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


def compile_rest(begin: int) -> None:
    """Compile what the cache lacks of ``kernels.txt``, from its line ``begin`` on; begin anew when grown large."""
    if hasattr(os, "nice"):
        os.nice(19 if begin == 0 else 0)
    hasten()
    for number, (_, kernel) in enumerate(lines()[begin:], begin + 1):
        if lacking([kernel]):
            with contextlib.suppress(Exception):  # nobody reads this: the verb itself will report what is wrong
                compile_kernel(*kernel)
        if _resident() > LARGEST:
            os.execv(sys.executable, [sys.executable, "-P", "-m", "orograph._compiler", "--rest", str(number)])


def _resident() -> int:
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


if __name__ == "__main__":
    if "--rest" in sys.argv:
        compile_rest(int(sys.argv[-1]))
    else:
        answers = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # what imports may print is no answer
        serve(sys.stdin.buffer, answers)  # type: ignore[arg-type]
