"""Many files opened by several processes, ``python -m orograph.dem.openers``.

Opening a file takes Python longer than GDAL, and Python has one processor in each process. So these processes open the
files and answer with lines of a manifest (``dem.describing``), from which this one makes its sources without opening
anything. They end when all files are told of; what one of them leaves undone is opened here.
"""

from __future__ import annotations

import contextlib
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from orograph._compilers import piped
from orograph.dem.describing import Described, described
from orograph.dem.manifest import Line, line_of, threads
from orograph.dem.remote import is_remote
from orograph.errors import OrographError, ReadError
from orograph.parallel import map_ordered

MANY = 1000
"""Files for which it is worth starting processes, which takes each of them as long as opening some hundred files."""

MOST = 8
"""Processes at once: each takes some 100 MiB."""

CHUNK = 32
"""Files that a process is asked for at once."""

Answer = Described | OrographError


def worthwhile(lines: Sequence[Line], jobs: int) -> bool:
    """Whether files are many, on this disk, and may be opened at once."""
    return jobs > 1 and len(lines) >= MANY and not any(is_remote(line.path) for line in lines)


def heard(lines: Sequence[Line], options: Mapping[str, Any]) -> Iterator[Line | ReadError]:
    """Lines, of which those that say nothing yet are told by other processes if they are many, and the errors of files
    that cannot be opened.

    Args:
        options: of ``Source.open``.
    """
    bare = [line for line in lines if not line.said]
    jobs = threads(lines)
    if not worthwhile(bare, jobs):
        yield from lines
        return
    told = rows(bare, options, None, jobs)
    with contextlib.closing(told):
        for line in lines:
            row, error = ("", None) if line.said else next(told)
            yield error or (line_of(row, None) if row else line)


def rows(lines: Sequence[Line], options: Mapping[str, Any], folder: Path | None, jobs: int) -> Iterator[Described]:
    """``describing.described`` for many files, in order, by up to ``jobs`` processes."""
    count = min(jobs, MOST)
    chunks = [lines[i : i + CHUNK] for i in range(0, len(lines), CHUNK)]
    with contextlib.ExitStack() as stack:
        idle = SimpleQueue[_Opener]()
        for _ in range(count):
            idle.put(stack.enter_context(_Opener()))

        def one(chunk: Sequence[Line]) -> list[Answer]:
            opener = idle.get()
            try:
                return opener.ask(chunk, options, folder) or _answers(chunk, options, folder)
            finally:
                idle.put(opener)

        for answers in map_ordered(one, chunks, count):
            for answer in answers:
                if isinstance(answer, OrographError):
                    raise answer
                yield answer


class _Opener:
    """One of the processes."""

    def __enter__(self) -> _Opener:
        self._process = piped("orograph.dem.openers")
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            for pipe in (self._process.stdin, self._process.stdout):
                with contextlib.suppress(OSError):
                    assert pipe is not None
                    pipe.close()
            self._process.wait()

    def ask(self, *asked: object) -> list[Answer]:
        """The answers to the arguments of ``_answers``; none if the process has ended."""
        process: subprocess.Popen[bytes] | None = self._process
        if process is None or process.stdin is None or process.stdout is None:
            return []
        try:
            pickle.dump(asked, process.stdin)
            process.stdin.flush()
            found: list[Answer] = pickle.load(process.stdout)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):
            return []
        return found


def _answers(lines: Sequence[Line], options: Mapping[str, Any], folder: Path | None) -> list[Answer]:
    """What is said of files; an error that is not of the file ends the answers."""
    found: list[Answer] = []
    for line in lines:
        try:
            found.append(described(line, options, folder))
        except OrographError as error:
            return [*found, error]
    return found


def _serve(asked: IO[bytes], answers: IO[bytes]) -> None:
    """Answer until nothing more is asked."""
    with contextlib.suppress(EOFError, BrokenPipeError, KeyboardInterrupt):
        while True:
            pickle.dump(_answers(*pickle.load(asked)), answers)
            answers.flush()


if __name__ == "__main__":
    _serve(sys.stdin.buffer, sys.stdout.buffer)
