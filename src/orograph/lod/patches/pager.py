"""Pages of patch diamonds, read in the background: requested in one frame, present in a later one.

``Field`` reads what a refinement lacks and restarts it. An interactive view must not wait for a disk or a network: here
threads read pages into slots that kernels do not know yet, and the next selection first enters those that have arrived.
Until then diamonds of absent pages count as accurate, and their patches are drawn as they are.

A page that cannot be read is requested again after a while; ``failure`` keeps the error.
"""

from __future__ import annotations

import threading
import time
import weakref
from queue import SimpleQueue
from typing import Any

import numpy as np

from orograph.errors import OrographError
from orograph.lod.field import Field

AGAIN = 2.0
"""Seconds after which an unreadable page is requested again."""

READERS, REMOTE_READERS = 2, 8
"""Threads that read from a disk, and over a network."""


Asks = SimpleQueue[tuple[int, int] | None]
"""Pages and their slots; None ends a reader."""

Answers = SimpleQueue[tuple[int, int, OrographError | None]]


class Pager(Field):
    """A field whose pages can be read in the background. See ``Field`` for the arguments.

    Attributes:
        failure: the last error met while reading in the background, None if all is well.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.failure: OrographError | None = None
        self._asks: Asks = SimpleQueue()
        self._answers: Answers = SimpleQueue()
        self._pending: set[int] = set()
        self._not_before: dict[int, float] = {}
        self._readers: list[threading.Thread] = []

    @property
    def pending(self) -> int:
        """Pages that are being read."""
        return len(self._pending)

    def enter(self) -> int:
        """Enter the pages that have arrived; returns how many."""
        count = 0
        while not self._answers.empty():
            page, slot, failure = self._answers.get()
            self._pending.discard(page)
            self.slots.last[slot] = self._round
            if failure is None:
                self.pages.table[page] = slot
                self.tiles_read += 1
                count += 1
                self.failure = None
            else:
                self.slots.release(page)
                self._not_before[page] = time.monotonic() + AGAIN
                self.failure = failure
        return count

    def fetch_later(self) -> int:
        """Read the pages missed since ``begin`` in the background; returns how many are under way."""
        wanted = [int(page) for page in self._asked() if int(page) not in self._pending]
        self.slots.touch(np.flatnonzero(self.pages.used == 1), self._round)
        now = time.monotonic()
        wanted = [page for page in wanted if self._not_before.get(page, 0.0) <= now]
        if not wanted:
            return self.pending
        for page in wanted:
            slot = self._take(page, self._round)
            if slot < 0:
                break
            self._pending.add(page)
            self._asks.put((page, slot))
        self._hire()
        return self.pending

    def finish(self) -> None:
        """Wait for running reads (before pages are read at once: a page must not arrive twice)."""
        while self._pending:
            answer = self._answers.get()
            self._answers.put(answer)
            self.enter()

    def _hire(self) -> None:
        """Start the readers; they end with the field."""
        if not any(reader.is_alive() for reader in self._readers):  # none yet, or lost by a fork
            count = REMOTE_READERS if self.terrain.remote else READERS
            known = self._asks, self._answers, weakref.ref(self)
            self._readers = [threading.Thread(target=_read, args=known, daemon=True) for _ in range(count)]
            for reader in self._readers:
                reader.start()
            weakref.finalize(self, _dismiss, self._asks, count)


def _read(asks: Asks, answers: Answers, field: weakref.ref[Pager]) -> None:
    """Read pages until the field is gone: a thread that held it would keep its memory for ever."""
    while (asked := asks.get()) is not None and (pager := field()) is not None:
        page, slot = asked
        failure: OrographError | None = None
        try:
            pager._load((page, slot))
        except OrographError as error:
            failure = error
        except Exception as error:
            failure = OrographError(f"A page could not be read: {error}.")
        del pager
        answers.put((page, slot, failure))


def _dismiss(asks: Asks, count: int) -> None:
    for _ in range(count):
        asks.put(None)
