"""Work that a thread does finely while its coarse result is shown; what something newer supersedes is dropped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from orograph.gpu.background import BackgroundTask

T = TypeVar("T")


class Refining(Generic[T]):
    """What is made finely: the newest wish only. All but the making is on the thread that shows it."""

    def __init__(self) -> None:
        self._task = BackgroundTask()
        self._wish: tuple[Callable[[], T], Callable[[], None]] | None = None
        self._number = self._begun = 0

    @property
    def coming(self) -> bool:
        """Whether something finer is to come."""
        return self._wish is not None

    def wish(self, make: Callable[[], T], then: Callable[[], None]) -> None:
        """Have a thread make something, which then calls ``then``; all that was wished before is dropped."""
        self.drop()
        self._wish = make, then
        self._begin()

    def drop(self) -> None:
        """Nothing finer is wanted any more."""
        self._wish, self._number = None, self._number + 1

    def take(self) -> T | None:
        """What was wished last, once, if it is ready.

        Raises:
            What its making raised.
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
        """Begin nothing any more."""
        self.drop()
        self._task.close()

    def _begin(self) -> None:
        """Begin the wish, unless the thread is still at an older one: ``take`` begins it then."""
        if self._wish is not None and self._task.wants(self._number):
            make, then = self._wish
            self._begun = self._number
            self._task.start(self._number, lambda: _tried(make), then)


def _tried(make: Callable[[], T]) -> tuple[T | None, Exception | None]:
    try:
        return make(), None
    except Exception as error:
        return None, error
