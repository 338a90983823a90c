"""How long work reports on itself: a silent default for libraries, a live line on stderr for the command line.

Functions that may take over a second accept ``progress: Progress = SILENT`` and write::

    with progress.task("Building level 0", total=n_shards) as task:
        for shard in shards:
            ...
            task.advance()
"""

from __future__ import annotations

from types import TracebackType
from typing import Self


class Task:
    """One piece of work; a context manager. The base class says nothing."""

    def advance(self, n: float = 1) -> None:
        """Say that ``n`` more units (of the task's total) are done. Safe from any thread."""

    def note(self, text: str) -> None:
        """A short remark shown beside the task (what is being waited for, where the result lies)."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


class Progress:
    """Makes tasks. The base class is silent; ``orograph.reporting`` has the one that draws."""

    def task(self, what: str, total: float | None = None) -> Task:
        """Begin a task called ``what`` of ``total`` units (None: unknown)."""
        return Task()

    def warn(self, text: str) -> None:
        """A thing the user should know that does not stop the work (one sentence)."""

    def note(self, text: str) -> None:
        """A thing worth knowing that is no cause for concern (one line)."""


SILENT = Progress()


class Within(Progress):
    """Reports of several tasks as of one."""

    def __init__(self, progress: Progress, task: Task) -> None:
        self._progress, self._task = progress, task

    def task(self, what: str, total: float | None = None) -> Task:
        return _Same(self._task)

    def warn(self, text: str) -> None:
        self._progress.warn(text)

    def note(self, text: str) -> None:
        self._progress.note(text)


class _Same(Task):
    """Another task, which neither begins nor ends."""

    def __init__(self, task: Task) -> None:
        self._task = task

    def advance(self, n: float = 1) -> None:
        self._task.advance(n)

    def note(self, text: str) -> None:
        self._task.note(text)
