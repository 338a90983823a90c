"""One thing made at a time in a thread of its own, for a loop that must not wait."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class Aside:
    """One thing made at a time in a thread, the newest wish next.

    Attributes:
        done: the key of what was made last.
    """

    def __init__(self) -> None:
        self.done: Any = None
        self._thread: threading.Thread | None = None
        self._result: Any = None
        self._key: Any = None
        self._closed = False

    @property
    def busy(self) -> bool:
        return self._thread is not None

    def wants(self, key: Any) -> bool:
        """Whether something is to be made for ``key`` and nothing is under way."""
        return not self._closed and self._thread is None and self.done != key

    def start(self, key: Any, make: Callable[[], Any]) -> None:
        def work() -> None:
            try:
                self._result = make()
            except Exception as error:
                self._result = error

        self._key = key
        self._thread = threading.Thread(target=work, name="light", daemon=True)
        self._thread.start()

    def take(self) -> Any:
        """What was made since it was last asked for, or None."""
        if self._thread is None or self._thread.is_alive():
            return None
        self._thread.join()
        self._thread, self.done = None, self._key
        result, self._result = self._result, None
        return None if isinstance(result, Exception) else result

    def close(self) -> None:
        self._closed = True
