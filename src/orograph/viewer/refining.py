"""Refine in a thread while the coarse result is shown; newer requests supersede older ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from orograph.gpu.background import BackgroundTask

T = TypeVar("T")


class Refining(Generic[T]):
    """Fine results: only the newest request counts. Everything but the computation runs in the thread that shows it."""

    def __init__(self) -> None:
        self._task = BackgroundTask()
        self._wish: tuple[Callable[[], T], Callable[[], None]] | None = None
        self._number = self._begun = 0

    @property
    def coming(self) -> bool:
        """Whether a finer result is pending."""
        return self._wish is not None

    def wish(self, make: Callable[[], T], then: Callable[[], None]) -> None:
        """Compute something in a thread, which then calls ``then``; earlier requests are dropped."""
        self.drop()
        self._wish = make, then
        self._begin()

    def drop(self) -> None:
        """Drop all requests."""
        self._wish, self._number = None, self._number + 1

    def take(self) -> T | None:
        """The newest result, once, if it is ready.

        Raises:
            What its computation raised.
        """
        made = self._task.take()
        if made is None or self._begun != self._number:
            self._begin()
            return None
        self._wish = None
        found, error = made
        if error is not None:
            raise error
        result: T = found
        return result

    def close(self) -> None:
        """Start no more work."""
        self.drop()
        self._task.close()

    def _begin(self) -> None:
        """Start the request, unless the thread still works on an older one; then ``take`` starts it."""
        if self._wish is not None and self._task.wants(self._number):
            make, then = self._wish
            self._begun = self._number
            self._task.start(self._number, lambda: _tried(make), then)


def _tried(make: Callable[[], T]) -> tuple[T | None, Exception | None]:
    try:
        return make(), None
    except Exception as error:
        return None, error
