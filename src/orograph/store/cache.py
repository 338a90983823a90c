"""A memory cache of decoded chunks, limited in bytes; the least recently used is dropped first. Thread-safe."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable
from typing import Any

from numpy.typing import NDArray


class ChunkCache:
    """Arrays by key.

    Args:
        budget: bytes of array data to keep; 0 keeps nothing.
    """

    def __init__(self, budget: int) -> None:
        self.budget = budget
        self.used = 0
        self.hits = 0
        self.misses = 0
        self._lock = threading.Lock()
        self._kept: OrderedDict[Hashable, NDArray[Any]] = OrderedDict()

    def get(self, key: Hashable) -> NDArray[Any] | None:
        """The array kept under ``key``, or None."""
        with self._lock:
            array = self._kept.get(key)
            if array is None:
                self.misses += 1
            else:
                self.hits += 1
                self._kept.move_to_end(key)
            return array

    def put(self, key: Hashable, array: NDArray[Any]) -> None:
        """Keep ``array`` (which must no longer change), dropping older ones to stay within the budget."""
        if array.nbytes > self.budget:
            return
        with self._lock:
            before = self._kept.pop(key, None)
            if before is not None:
                self.used -= before.nbytes
            self._kept[key] = array
            self.used += array.nbytes
            while self.used > self.budget:
                self.used -= self._kept.popitem(last=False)[1].nbytes

    def clear(self) -> None:
        """Drop everything."""
        with self._lock:
            self._kept.clear()
            self.used = 0

    def __len__(self) -> int:
        return len(self._kept)
