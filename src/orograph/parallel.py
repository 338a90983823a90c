"""Threads over independent blocks of work; kernels release the GIL, so threads are all that is needed.

Results come back in order whatever the number of workers, an error or Ctrl-C cancels what has not begun, and one worker
runs in the calling thread, so that "one worker equals many" is a matter of the blocks alone.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def cpu_count() -> int:
    """The processors this process may use (respects affinity, unlike ``os.cpu_count``)."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


def map_ordered(work: Callable[[T], R], items: Iterable[T], jobs: int | None = None, ahead: int = 2) -> Iterator[R]:
    """Yield ``work(item)`` in the order of ``items``.

    Args:
        work: called from ``jobs`` threads.
        items: consumed lazily; at most ``jobs * ahead`` are in flight, which bounds memory.
        jobs: threads (default: all processors); 1 runs in the calling thread.
    """
    jobs = jobs or cpu_count()
    if jobs == 1:
        yield from map(work, items)
        return
    source = iter(items)
    with ThreadPoolExecutor(jobs) as pool:
        pending: list[Future[R]] = [pool.submit(work, item) for item in islice(source, jobs * ahead)]
        pending.reverse()  # pop() from the end is the oldest
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


def aside(work: Callable[[], R]) -> R:
    """Do the work in a thread of its own and wait for it.

    Ctrl-C interrupts the main thread at once. A kernel that returns arrays must not run there: an interrupt while Numba
    makes Python objects of its results would crash the interpreter.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    pool = ThreadPoolExecutor(1)
    try:
        return pool.submit(work).result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
