"""One task at a time in a background thread, for a loop that must not wait."""

from __future__ import annotations

import _thread
import atexit
import threading
import time
from collections.abc import Callable
from typing import Any

PATIENCE = 2.0
"""Seconds that an ending program waits for its threads: one still in a native library after the interpreter ends may
crash."""

_RUNNING: set[threading.Event] = set()


class BackgroundTask:
    """Makes one thing at a time in a thread; the newest request is next.

    Attributes:
        done: the key of the last result.
    """

    def __init__(self) -> None:
        self.done: Any = None
        self._ended: threading.Event | None = None
        self._result: Any = None
        self._key: Any = None
        self._closed = False

    @property
    def busy(self) -> bool:
        return self._ended is not None

    def wants(self, key: Any) -> bool:
        """Whether to make something for ``key``, with no task running."""
        return not self._closed and self._ended is None and self.done != key

    def start(self, key: Any, make: Callable[[], Any], then: Callable[[], None] = lambda: None) -> None:
        """Start a task; the program waits for it up to ``PATIENCE`` seconds when it ends.

        Args:
            then: called by the thread when there is a result.
        """
        ended = threading.Event()
        _RUNNING.add(ended)

        def work() -> None:
            try:
                self._result = make()
            except Exception as error:
                self._result = error
            finally:
                ended.set()
                _RUNNING.discard(ended)
                if not self._closed:
                    then()

        self._key, self._ended = key, ended
        _thread.start_new_thread(work, ())  # (Thread.start waits until the thread has held the interpreter lock)

    def take(self) -> Any:
        """The result since the last call, or None."""
        if self._ended is None or not self._ended.is_set():
            return None
        self._ended, self.done = None, self._key
        result, self._result = self._result, None
        return None if isinstance(result, Exception) else result

    def close(self) -> None:
        self._closed = True


@atexit.register
def _wait_for_threads() -> None:
    until = time.monotonic() + PATIENCE
    for ended in list(_RUNNING):
        ended.wait(max(0.0, until - time.monotonic()))
