"""What was made for one picture and may serve the next: heights and their pyramids, maps of light, tints, images.

A movie's frames and a large picture's tiles look at the same ground. Everything is kept under what it was made from, so
that a picture is the same whatever was drawn before it. Of each kind only the last few are kept.
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
        """Whether something was made of ``key`` before."""
        with self._lock:
            return (id(source), key) in self._held.get(kind, {})

    def __call__(self, kind: str, key: Hashable, make: Callable[[], T], source: Any = None, most: int = 0) -> T:
        """What was made of ``key`` before, or ``make()``.

        Args:
            source: an object that the key names by its id; it is held as long as what was made of it.
            most: how many of this kind are kept, if not as many as of others.
        """
        with self._lock:
            held = self._held.setdefault(kind, {})
            full = id(source), key
            if full in held:
                held[full] = held.pop(full)  # the last one used goes last
            else:
                while len(held) >= (most or self.most):
                    del held[next(iter(held))]  # before the new one takes memory
                held[full] = make(), source
            found: T = held[full][0]
            return found
