"""Files opened at once: by threads or, if they are many, by processes (``python -m orograph.dem.openers``).

Opening a file takes Python longer than GDAL, and Python uses one processor per process. So child processes open the
files and answer with lines of a manifest (``dem.describing``), from which the parent makes its sources without opening
anything. They end after the last file. If one fails, the parent opens its remaining files.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any, NamedTuple

from orograph._compilers import piped
from orograph.dem.describing import Described, described
from orograph.dem.folders import taken
from orograph.dem.manifest import Line, is_manifest, line_of, open_named, read, unusual_of
from orograph.dem.remote import is_remote
from orograph.dem.source import Source
from orograph.errors import OrographError, ReadError
from orograph.parallel import cpu_count, map_ordered
from orograph.progress import SILENT, Progress

MANY = 1000
"""Number of files from which processes are worth starting: each start takes as long as opening some hundred files."""

MOST = 8
"""Processes at once: each takes some 100 MiB."""

CHUNK = 32
"""Files per request to a process."""

AT_ONCE = 16
"""Files on servers opened at once."""

Answer = Described | OrographError


class Named(NamedTuple):
    """The result of ``opened``.

    Attributes:
        sources, damaged: the files that could be opened, in order, and the errors of the others. files: their number in
        all.
        manifests: whether any name was that of a manifest.
    """

    sources: list[Source]
    damaged: list[ReadError]
    files: int
    manifests: bool


def opened(
    names: Sequence[str | os.PathLike[str] | Line], options: Mapping[str, Any], progress: Progress = SILENT
) -> Named:
    """Open files, those in folders, and those that manifests list (only if they have changed).

    Args:
        names: also lines of manifests. options: of ``Source.open``. progress: gets reports on the files.

    Raises:
        ReadError: a manifest cannot be read.
    """
    lines: list[Line] = []
    for name in names:
        if isinstance(name, Line):
            lines.append(name)
        else:
            lines += read(name) if is_manifest(name) else [Line(f, {}, None) for f in taken(name, progress)]
    unusual = unusual_of(options)

    def one(line: Line | ReadError) -> Source | ReadError:
        try:
            if isinstance(line, ReadError):
                return line
            return line.source(unusual) or open_named(line.path, options, whole=len(lines) > 1)
        except ReadError as error:
            return error

    found = Named([], [], len(lines), any(is_manifest(name) for name in names if not isinstance(name, Line)))
    with progress.task("Opening files", total=len(lines)) as task:
        for each in map_ordered(one, _heard(lines, options), _threads(lines)):
            found.damaged.append(each) if isinstance(each, ReadError) else found.sources.append(each)
            task.advance()
    return found


def _threads(lines: Sequence[Line]) -> int:
    """How many files to open at once."""
    return AT_ONCE if any(is_remote(line.path) for line in lines[:64]) else cpu_count()


def _worthwhile(lines: Sequence[Line], jobs: int) -> bool:
    """Whether processes pay off: there are many files, on this disk, and several may be opened at once."""
    return jobs > 1 and len(lines) >= MANY and not any(is_remote(line.path) for line in lines)


def _heard(lines: Sequence[Line], options: Mapping[str, Any]) -> Iterator[Line | ReadError]:
    """Complete lines of a manifest, and the errors of files that cannot be opened.

    If many lines have only a path, other processes complete them.

    Args:
        options: of ``Source.open``.
    """
    bare = [line for line in lines if not line.said]
    if not _worthwhile(bare, _threads(lines)):
        yield from lines
        return
    answers = rows(bare, options, None)
    with contextlib.closing(answers):
        for line in lines:
            row, error = ("", None) if line.said else next(answers)
            yield error or (line_of(row, None) if row else line)


def rows(
    lines: Sequence[Line], options: Mapping[str, Any], folder: Path | None, jobs: int | None = None
) -> Generator[Described, None, None]:
    """``described`` for many files, in order.

    Args:
        jobs: files opened at once; None: as many as there are processors, or ``AT_ONCE`` for files on servers.
    """
    jobs = jobs or _threads(lines)
    if not _worthwhile(lines, jobs):
        yield from map_ordered(lambda line: described(line, options, folder), lines, jobs)
        return
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
    """A child process that opens files."""

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

    def ask(self, *arguments: object) -> list[Answer]:
        """Call ``_answers`` in the process; none if it has ended."""
        process: subprocess.Popen[bytes] | None = self._process
        if process is None or process.stdin is None or process.stdout is None:
            return []
        try:
            pickle.dump(arguments, process.stdin)
            process.stdin.flush()
            found: list[Answer] = pickle.load(process.stdout)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):
            return []
        return found


def _answers(lines: Sequence[Line], options: Mapping[str, Any], folder: Path | None) -> list[Answer]:
    """The lines or errors of files; any other error ends the answers."""
    found: list[Answer] = []
    for line in lines:
        try:
            found.append(described(line, options, folder))
        except OrographError as error:
            return [*found, error]
    return found


def _serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer requests until there are no more."""
    with contextlib.suppress(EOFError, BrokenPipeError, KeyboardInterrupt):
        while True:
            pickle.dump(_answers(*pickle.load(requests)), answers)
            answers.flush()


if __name__ == "__main__":
    _serve(sys.stdin.buffer, sys.stdout.buffer)
