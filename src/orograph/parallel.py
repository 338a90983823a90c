"""Threads over independent blocks of work; kernels release the GIL, so threads are enough.

Results come back in order whatever the number of workers. An error or Ctrl-C cancels what has not begun. One worker
runs in the calling thread, so "one worker equals many" depends on the blocks alone.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import islice
from numbers import Integral
from queue import SimpleQueue
from typing import Any, TypeVar, cast

from orograph.errors import UsageError

T = TypeVar("T")
R = TypeVar("R")

_NONE = object()


def cpu_count() -> int:
    """The processors this process may use (respects affinity, unlike ``os.cpu_count``)."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


def threads_for(jobs: int | None) -> int:
    """How many threads to work with: as many as asked for, or all processors.

    Raises:
        UsageError: ``jobs`` is not such a number.
    """
    given: Any = jobs
    if given is None:
        return cpu_count()
    if not isinstance(given, Integral) or int(given) < 1:
        raise UsageError(f"`jobs` must be a number of threads, 1 or more, not {given!r}.")
    return int(given)


def map_ordered(work: Callable[[T], R], items: Iterable[T], jobs: int | None = None, ahead: int = 2) -> Iterator[R]:
    """Yield ``work(item)`` in the order of ``items``.

    Args:
        work: called from ``jobs`` threads.
        items: consumed lazily; at most ``jobs * ahead`` are in flight, which bounds memory.
        jobs: threads (default: all processors); 1 runs in the calling thread.
    """
    jobs = threads_for(jobs)
    if jobs == 1:
        yield from map(work, items)
        return
    source = iter(items)
    with ThreadPoolExecutor(jobs) as pool:
        pending: list[Future[R]] = [pool.submit(work, item) for item in islice(source, jobs * ahead)]
        pending.reverse()  # pop() from the end takes the oldest
        queue = pending
        try:
            while queue:
                result = queue.pop().result()
                for item in islice(source, 1):
                    queue.insert(0, pool.submit(work, item))
                yield result
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def for_each(work: Callable[[T], object], items: Sequence[T], jobs: int | None = None) -> None:
    """Call ``work(item)`` for every item, in any order, and wait for all.

    The calling thread takes its share and the others stay awake between items, so two threads are almost twice as fast
    as one even on small items. After an error or Ctrl-C the others finish their current item.

    Args:
        work: called from ``jobs`` threads.
        jobs: threads (default: all processors).
    """
    if items:
        for_groups(work, [items], min(threads_for(jobs), len(items)))


def for_groups(work: Callable[[T], object], groups: Iterable[Sequence[T]], jobs: int | None = None) -> None:
    """``for_each`` over groups of items, one after the other, without waiting for the end of each.

    Items of a group may begin while the previous group is still running, but only once all groups before that one are
    done. Threads thus need not wait for each other where work depends on the results of two groups before.

    Args:
        work: called from ``jobs`` threads.
        groups: the next group is requested when all items of the last one have begun and all earlier ones are done;
            from any thread, one at a time.
        jobs: threads (default: all processors).
    """
    jobs = threads_for(jobs)
    source, failed, busy, ended = iter(groups), list[BaseException](), 0, False
    left: Iterator[T] = iter(())
    before, here = [0], [0]  # number of items of the last two groups still running
    lock = threading.Condition()

    def take() -> tuple[object, list[int]]:
        """The next item and its group's count; call with the lock held."""
        nonlocal left, before, here, ended
        while not failed:
            item = next(left, _NONE)
            if item is not _NONE:
                here[0] += 1
                return item, here
            if ended:
                break
            if before[0]:
                lock.wait()
                continue
            group = next(source, None)
            if group is None:
                ended = True
                break
            before, here, left = here, [0], iter(group)
        return _NONE, here

    def attend(number: int = 0) -> None:
        nonlocal busy
        with lock:
            busy += 1
        try:
            count = [1]
            while True:
                with lock:
                    count[0] -= 1
                    if not count[0]:
                        lock.notify_all()
                    item, count = take()
                if item is _NONE:
                    break
                work(cast(T, item))
                item = None  # release what it holds
        except BaseException as error:
            failed.append(error)
        finally:
            with lock:
                busy -= 1
                lock.notify_all()

    if jobs > 1:
        _crew(jobs - 1).call(attend)
    try:
        attend()
        with lock:  # a late thread finds nothing to do
            while busy:
                lock.wait()
    except BaseException as error:  # Ctrl-C between two items
        failed.append(error)
        raise
    if failed:
        raise failed[0]


def aside(work: Callable[[], R]) -> R:
    """Run the work in its own thread and wait for it.

    Ctrl-C interrupts the main thread at once. A kernel that returns arrays must not run there: an interrupt while Numba
    converts its results to Python objects would crash the interpreter.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    pool = ThreadPoolExecutor(1)
    try:
        return pool.submit(work).result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


Inbox = SimpleQueue[Callable[[], object] | None]


class Crew:
    """Threads that stay parked between calls, for work of a few milliseconds: making a pool each time would cost one
    millisecond.

    This class does not wait for them: the caller must know from the work itself when it is done, and finish it alone if
    no thread comes (threads do not survive a fork; the next call makes new ones).

    Args:
        count: threads.
    """

    def __init__(self, count: int) -> None:
        self._inboxes: list[Inbox] = [SimpleQueue() for _ in range(count)]
        self._threads: list[threading.Thread] = []
        weakref.finalize(self, _dismiss, self._inboxes)

    def call(self, work: Callable[[int], object]) -> None:
        """Have each thread call ``work`` with its number, from 0, as soon as it wakes; returns at once."""
        if not all(thread.is_alive() for thread in self._threads) or not self._threads:
            self._threads = [threading.Thread(target=_attend, args=(i,), daemon=True) for i in self._inboxes]
            for thread in self._threads:
                thread.start()
        for number, inbox in enumerate(self._inboxes):
            inbox.put(partial(work, number))


def _attend(inbox: Inbox) -> None:
    while (work := inbox.get()) is not None:
        try:
            work()
        except Exception as error:
            threading.excepthook(threading.ExceptHookArgs((type(error), error, error.__traceback__, None)))
        del work


def _dismiss(inboxes: list[Inbox]) -> None:
    for inbox in inboxes:
        inbox.put(None)


_crews: dict[int, Crew] = {}


def _crew(count: int) -> Crew:
    """The threads that help ``for_each``; ``count`` of them."""
    return _crews.setdefault(count, Crew(count))
