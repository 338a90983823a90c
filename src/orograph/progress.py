"""How long work reports its progress: silent by default for libraries, a live line on stderr for the command line."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class Task:
    """One piece of work; a context manager. The base class reports nothing."""

    def advance(self, n: float = 1) -> None:
        """Report that ``n`` more units (of the task's total) are done. Safe from any thread."""

    def note(self, text: str) -> None:
        """A short remark shown beside the task (what it waits for, where the result is)."""

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
        """Warn the user of something that does not stop the work (one sentence)."""

    def note(self, text: str) -> None:
        """Tell the user something worth knowing that is no cause for concern (one line)."""


SILENT = Progress()


class Within(Progress):
    """Combine the reports of several tasks into one."""

    def __init__(self, progress: Progress, task: Task) -> None:
        self._progress, self._task = progress, task

    def task(self, what: str, total: float | None = None) -> Task:
        return _Same(self._task)

    def warn(self, text: str) -> None:
        self._progress.warn(text)

    def note(self, text: str) -> None:
        self._progress.note(text)


class _Same(Task):
    """Report to an existing task without beginning or ending it."""

    def __init__(self, task: Task) -> None:
        self._task = task

    def advance(self, n: float = 1) -> None:
        self._task.advance(n)

    def note(self, text: str) -> None:
        self._task.note(text)
