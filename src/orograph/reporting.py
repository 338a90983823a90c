"""Visible progress: bars in terminals and notebooks (rich), and warnings in the way that fits the place.

Functions of the package take ``progress``: a ``Progress``, True or None (``Shown``: bars and notes if a person is
watching, and Python's warnings), or False (silent). ``reporting`` converts them.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
import warnings
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from orograph.progress import SILENT, Progress, Task

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

LOG = logging.getLogger("orograph")

LASTS = 0.7
"""Seconds after which a task gets a bar."""


def reporting(progress: Progress | bool | None) -> Progress:
    """The ``Progress`` for an argument ``progress=``."""
    if isinstance(progress, Progress):
        return progress
    return SILENT if progress is False else Shown()


def bars(console: Any) -> Bar:
    """Bars on rich's console, removed when all is done."""
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    return Bars(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"), TimeRemainingColumn(),
        console=console, transient=True,
    )  # fmt: skip


class Shown(Progress):
    """Progress for Python users: bars for long tasks in a terminal or a notebook; warnings are Python's
    (``UserWarning``). Notes go to the logger ``orograph`` (INFO), and where nobody has given it a handler, to stderr if
    a person is watching."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.bar: Bar | None = None
        self.open = 0

    def task(self, what: str, total: float | None = None) -> Task:
        return _Bar(self, what, total) if _watched() else Task()

    def warn(self, text: str) -> None:
        depth, frame = 1, sys._getframe()
        while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "orograph":
            depth, frame = depth + 1, frame.f_back
        warnings.warn(text, UserWarning, stacklevel=depth)

    def note(self, text: str) -> None:
        LOG.info(text)
        if not _watched() or LOG.hasHandlers():
            return
        with self.lock:
            if self.bar is not None:
                self.bar.console.print(text, markup=False, highlight=False)
            else:
                print(text, file=sys.stderr)


def _watched() -> bool:
    """Whether bars are visible: stderr is a terminal, or this is a notebook."""
    shell = sys.modules.get("IPython")
    kernel = shell is not None and getattr(shell.get_ipython(), "kernel", None) is not None
    return kernel or (sys.stderr is not None and sys.stderr.isatty())


class _Bar(Task):
    """A task that gets a bar if it takes long."""

    def __init__(self, owner: Shown, what: str, total: float | None) -> None:
        self.owner, self.what, self.total = owner, what, total
        self.done: float = 0
        self.id: TaskID | None = None
        self.due = 0.0

    def advance(self, n: float = 1) -> None:
        with self.owner.lock:
            self.done += n
            if self.id is None and self.due and time.monotonic() >= self.due:
                self._begin()
            if self.id is not None and self.owner.bar is not None:
                self.owner.bar.update(self.id, completed=self.done)

    def note(self, text: str) -> None:
        with self.owner.lock:
            if self.id is not None and self.owner.bar is not None:
                self.owner.bar.update(self.id, description=f"{self.what} — {text}")

    def _begin(self) -> None:
        if self.owner.bar is None:
            from rich.console import Console

            self.owner.bar = bars(Console(stderr=True))
            self.owner.bar.start()
        self.owner.open += 1
        self.id = self.owner.bar.add_task(self.what, total=self.total)
        self.owner.bar.update(self.id, completed=self.done)

    def __enter__(self) -> Self:
        self.due = time.monotonic() + LASTS
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self.owner.lock:
            if self.id is None or self.owner.bar is None:
                return
            self.owner.bar.remove_task(self.id)
            self.id, self.due = None, 0.0
            self.owner.open -= 1
            if self.owner.open == 0:
                self.owner.bar.stop()
                self.owner.bar = None
