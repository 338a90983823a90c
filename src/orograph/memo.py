"""A memo of what was made for one picture and may serve the next: heights and their pyramids, light maps, tints,
images.

A movie's frames and a large picture's tiles look at the same ground. Everything is stored under what it was made from,
so a picture never depends on what was drawn before it. Only the last few of each kind are kept.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

T = TypeVar("T")


class Memo:
    """A memory of the last few things of each kind.

    Args:
        most: how many of a kind are kept.
    """

    def __init__(self, most: int = 1) -> None:
        self.most = most
        self._held: dict[str, dict[Hashable, tuple[Any, Any]]] = {}
        self._lock = threading.RLock()

    def has(self, kind: str, key: Hashable, source: Any = None) -> bool:
        """Whether the memo holds something made from ``key``."""
        with self._lock:
            return (id(source), key) in self._held.get(kind, {})

    def __call__(self, kind: str, key: Hashable, make: Callable[[], T], source: Any = None, most: int = 0) -> T:
        """The value made from ``key`` before, or ``make()``.

        Args:
            source: an object that the key names by its id; it is kept alive with the value.
            most: how many of this kind are kept, if not the usual number.
        """
        with self._lock:
            held = self._held.setdefault(kind, {})
            full = id(source), key
            if full in held:
                held[full] = held.pop(full)  # the last one used goes to the end
            else:
                while len(held) >= (most or self.most):
                    del held[next(iter(held))]  # frees memory before the new one takes it
                held[full] = make(), source
            found: T = held[full][0]
            return found
