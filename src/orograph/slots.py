"""A fixed number of slots for tiles; the least recently used one makes room.

Pages of a refinement, tiles on the GPU and tiles of images all use such slots. Time is any increasing number: frames,
rounds, uses. Not thread-safe.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

K = TypeVar("K", bound=Hashable)

HELD = np.iinfo(np.int64).max
"""The time of last use that marks a slot as held."""


class Slots(Generic[K]):
    """Maps keys to slots and tracks when each was last used.

    Args:
        capacity: how many there are.

    Iterating gives the keys that have one.

    Attributes:
        last: (capacity,) int64, when each was used last; ``HELD``: it stays; −1: it is free.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.last: NDArray[np.int64] = np.full(capacity, -1, np.int64)
        self._keys: list[K | None] = [None] * capacity
        self._of: dict[K, int] = {}
        self._free = list(range(capacity))[::-1]

    def __len__(self) -> int:
        return len(self._of)

    def __iter__(self) -> Iterator[K]:
        return iter(self._of)

    def find(self, key: K) -> int:
        """The slot of a key, −1 if it has none."""
        return self._of.get(key, -1)

    def room(self, before: int) -> int:
        """How many slots are free or were last used before a time."""
        return int((self.last < before).sum())

    def touch(self, slots: ArrayLike, now: int) -> None:
        """Note a use of slots (n,)."""
        which = np.asarray(slots)
        self.last[which] = np.maximum(self.last[which], now)

    def take(self, key: K, before: int) -> tuple[int, K | None]:
        """Take a slot for a key that has none, and hold it; returns the slot and the key that it held before, if any.

        It is a free slot, or else the least recently used one last used before a time; −1 if there is none.
        """
        gone: K | None = None
        if self._free:
            slot = self._free.pop()
        else:
            slot = int(self.last.argmin())
            if self.last[slot] >= before:
                return -1, None
            gone = self._keys[slot]
            assert gone is not None
            del self._of[gone]
        self._of[key], self._keys[slot] = slot, key
        self.last[slot] = HELD
        return slot, gone

    def release(self, key: K) -> None:
        """Free the slot of a key."""
        slot = self._of.pop(key)
        self._keys[slot], self.last[slot] = None, -1
        self._free.append(slot)
