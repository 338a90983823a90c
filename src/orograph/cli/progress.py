"""The live progress line on stderr: what is being done, how far, how long it took.

rich draws it. Only a terminal has one, so that other runs need not load rich.
"""

from __future__ import annotations

import functools
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from orograph.cli.wording import spoken
from orograph.compiling import COMPILING
from orograph.progress import Progress, Task
from orograph.reporting import bars

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

COMPILING_KERNELS = "Compiling kernels, once for this machine"


class LineTask(Task):
    """A task that is drawn while it runs if it takes long, and leaves a line with its time if it took long enough."""

    def __init__(self, owner: LineProgress, what: str, total: float | None) -> None:
        self.owner, self.what, self.total = owner, what, total
        self.remark = ""
        self.id: TaskID | None = None
        self.started = time.perf_counter()
        self.compiled = COMPILING.seconds

    def advance(self, n: float = 1) -> None:
        if self.id is not None:
            self.owner.bar.advance(self.id, n)

    def note(self, text: str) -> None:
        self.remark = text
        if self.id is not None:
            self.owner.bar.update(self.id, description=f"{self.what} — {text}")

    def __enter__(self) -> Self:
        self.started, self.compiled = time.perf_counter(), COMPILING.seconds
        if self.owner.live:
            self.id = self.owner.bar.add_task(self.what, total=self.total)
            self.owner.opened += 1
            if self.owner.opened == 1:
                self.owner.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # Compiling within a task has a line of its own.
        seconds = time.perf_counter() - self.started - (COMPILING.seconds - self.compiled)
        self.owner.tell_compiled()
        if self.id is not None:
            self.owner.bar.remove_task(self.id)
            self.owner.opened -= 1
            if self.owner.opened == 0:
                self.owner.bar.stop()
        if kind is None:
            self.owner.timings.append((self.what, seconds))
            if seconds >= self.owner.least or self.remark:
                remark = f"  {self.remark}" if self.remark else ""
                self.owner.line(self.what, seconds, remark)


class LineProgress(Progress):
    """Progress for a terminal; on a pipe only finished lines appear.

    Args:
        least: tasks shorter than this many seconds leave no line.
    """

    def __init__(self, least: float = 1.0, quiet: bool = False) -> None:
        self.quiet = quiet or sys.stderr is None
        self.live = not self.quiet and sys.stderr.isatty()
        self.least = least
        self.opened = 0
        self.warned: set[str] = set()
        self.timings: list[tuple[str, float]] = []
        self._compiled = COMPILING.count, COMPILING.seconds
        self._compiling: TaskID | None = None
        if self.live:
            COMPILING.changed.append(self._show_compiling)

    @functools.cached_property
    def bar(self) -> Bar:
        """The bars of a terminal."""
        from rich.console import Console

        return bars(Console(stderr=True))

    def task(self, what: str, total: float | None = None) -> Task:
        return LineTask(self, what, total)

    def line(self, what: str, seconds: float, remark: str = "") -> None:
        """Print a line about finished work."""
        self._print(f"{what:<44} {seconds:6.2f} s{remark}")

    def tell_compiled(self) -> None:
        """Print a line about the kernels compiled since the last such line, if that took noticeable time."""
        if self._compiling is not None:
            self.bar.remove_task(self._compiling)
            self._compiling = None
        count, seconds = COMPILING.count - self._compiled[0], COMPILING.seconds - self._compiled[1]
        if seconds >= self.least:
            self._compiled = COMPILING.count, COMPILING.seconds
            self.timings.append((COMPILING_KERNELS, seconds))
            self.line(COMPILING_KERNELS, seconds, f"  {count} kernel{'s' if count > 1 else ''}")

    def _show_compiling(self) -> None:
        if not self.opened:
            return
        count = COMPILING.count - self._compiled[0]
        if self._compiling is None:
            self._compiling = self.bar.add_task(COMPILING_KERNELS, total=None)
        self.bar.update(self._compiling, description=f"{COMPILING_KERNELS}: {count}")

    def warn(self, text: str) -> None:
        text = spoken(text)
        if text in self.warned:
            return
        self.warned.add(text)
        self._print(f"warning: {text}", "yellow")
        sys.stderr.flush()

    def note(self, text: str) -> None:
        self._print(spoken(text))

    def _print(self, text: str, style: str | None = None) -> None:
        if self.live:
            self.bar.console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
        elif not self.quiet:
            print(text, file=sys.stderr)
