"""Threads that read tiles in order of priority, in parallel with the frames that want them.

Every frame submits its requests anew; what is no longer wanted is not read. A tile that cannot be read is reported and
never ends a thread: its substitute stays, and it is retried later. Units: seconds.
"""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from orograph.errors import OrographError

K = TypeVar("K")
"""Kinds of tiles."""
T = TypeVar("T")
"""Keys of tiles."""
D = TypeVar("D")
"""Tiles as they are made."""

AHEAD = 64
"""The most tiles that are read but not yet taken; then threads wait."""

GIVEN_UP = 8
"""Consecutive failures after which nothing else is tried for a while: a broken store fails for every tile, and trying
hundreds of them would take the interpreter from the frames."""

FIRST = 0.1
"""Tiles that were not tried are requested again after this fraction of the time for failed tiles."""


class Streamer(Generic[K, T, D]):
    """Threads that read tiles in the order of their priority.

    Args:
        make: reads the tile of a kind and key; called from any thread.
        jobs: threads.

    Attributes:
        failed: tiles that could not be read, with the reason: they are not requested again for ``RETRY`` seconds.
    """

    RETRY = 5.0

    def __init__(self, make: Callable[[K, T], D], jobs: int = 2) -> None:
        self.make = make
        self.failed: dict[tuple[K, T], tuple[float, str]] = {}
        self._heap: list[tuple[float, int, K, T]] = []
        self._busy: set[tuple[K, T]] = set()
        self._ready: list[tuple[K, T, D]] = []
        self._condition = threading.Condition()
        self._closed = False
        self._failures = 0
        self._threads = [threading.Thread(target=self._work, name=f"tiles-{k}", daemon=True) for k in range(jobs)]
        for thread in self._threads:
            thread.start()

    def want(self, wanted: Sequence[tuple[float, K, T]]) -> None:
        """Replace the queue: (priority, kind, key), highest first. Reads in progress continue.

        Threads are woken only if there is something for them to do: each would take the interpreter from the frame.
        """
        if not wanted and not self._heap:
            return
        now = time.monotonic()
        with self._condition:
            skipped = self._busy | {(kind, key) for kind, key, _ in self._ready}
            skipped |= {one for one, (when, _) in self.failed.items() if when + self.RETRY >= now}
            self._heap = [
                (-priority, n, kind, key)
                for n, (priority, kind, key) in enumerate(wanted)
                if (kind, key) not in skipped
            ]
            heapq.heapify(self._heap)
            if self._heap:
                self._condition.notify_all()

    def take(self, most: int) -> list[tuple[K, T, D]]:
        """Up to ``most`` tiles that have been read."""
        if not self._ready:
            return []
        with self._condition:
            taken, self._ready = self._ready[:most], self._ready[most:]
            if len(self._ready) + len(taken) > AHEAD:  # threads were waiting for room
                self._condition.notify_all()
            return taken

    @property
    def waiting(self) -> int:
        """The number of tiles that are wanted, being read or ready."""
        with self._condition:
            return len(self._heap) + len(self._busy) + len(self._ready)

    def wait(self, seconds: float) -> None:
        """Return when something is ready, nothing is in progress, or time is up."""
        end = time.monotonic() + seconds
        with self._condition:
            while not self._ready and (self._heap or self._busy) and not self._closed:
                left = end - time.monotonic()
                if left <= 0:
                    return
                self._condition.wait(left)

    def close(self) -> None:
        """Stop the threads; one that is reading ends by itself, without being waited for."""
        with self._condition:
            self._closed = True
            self._heap.clear()
            self._condition.notify_all()

    def _work(self) -> None:
        while True:
            with self._condition:
                while not self._closed and (not self._heap or len(self._ready) > AHEAD):
                    self._condition.wait()
                if self._closed:
                    return
                _, _, kind, key = heapq.heappop(self._heap)
                self._busy.add((kind, key))
            data: D | None = None
            error = ""
            try:
                data = self.make(kind, key)
            except (OrographError, OSError) as failure:
                error = str(failure)
            except Exception as failure:  # a thread must not die silently: the tile stays coarse, and the view says so
                error = f"{type(failure).__name__}: {failure}"
            with self._condition:
                self._busy.discard((kind, key))
                if data is not None:
                    self._ready.append((kind, key, data))
                    self.failed.pop((kind, key), None)
                    self._failures = 0
                else:
                    now = time.monotonic()
                    self.failed[(kind, key)] = (now, error)
                    self._failures += 1
                    if self._failures >= GIVEN_UP:
                        untried = {(k, t): (now - FIRST * self.RETRY, error) for _, _, k, t in self._heap}
                        self.failed.update(untried)
                        self._heap.clear()
                        self._failures = 0
                self._condition.notify_all()
