"""One thing made at a time in a thread of its own, for a loop that must not wait."""

from __future__ import annotations

import _thread
import atexit
import threading
import time
from collections.abc import Callable
from typing import Any

PATIENCE = 2.0
"""Seconds that an ending program waits for its threads: one that is in a native library when the interpreter is gone
may crash."""

_RUNNING: set[threading.Event] = set()


class BackgroundTask:
    """One thing made at a time in a thread, the newest wish next.

    Attributes:
        done: the key of what was made last.
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
        """Whether something is to be made for ``key`` and nothing is under way."""
        return not self._closed and self._ended is None and self.done != key

    def start(self, key: Any, make: Callable[[], Any], then: Callable[[], None] = lambda: None) -> None:
        """Begin to make something; the program waits for it ``PATIENCE`` seconds when it ends.

        Args:
            then: called by the thread when there is something to take.
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
        _thread.start_new_thread(work, ())  # (Thread.start waits until the thread has had the interpreter)

    def take(self) -> Any:
        """What was made since it was last asked for, or None."""
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
