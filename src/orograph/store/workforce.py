"""The workers of a Dask cluster: an existing one, or processes of this machine that end with the work."""

from __future__ import annotations

import contextlib
import os
import signal
import warnings
from collections.abc import Iterator
from typing import Any

from orograph.errors import StoreError, UsageError

CALM = {
    "distributed.admin.tick.interval": "500ms",
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.system-monitor.disk": False,
    "distributed.scheduler.active-memory-manager.start": False,
}
"""Dask's self-monitoring in clusters of this machine. By default its processes wake up to a hundred times a second,
whatever tasks do; with two workers, that takes eight times the processor time of these settings."""

TRIES = 3
"""How often processes are started before they are given up."""


@contextlib.contextmanager
def workforce(workers: int | None, dask: Any, jobs: int, max_memory: int, needed: int) -> Iterator[Any]:
    """Enter a client of a cluster: an existing one, or processes of this machine, which end with it.

    Args:
        workers: processes to start. dask: instead, a client, or the address of a scheduler.
        jobs: threads of each process. max_memory: bytes of all of them together. needed: bytes that each must have.

    Raises:
        UsageError: Dask is not installed, or the scheduler does not answer. StoreError: no processes can be started.
    """
    try:
        import dask as own
        import distributed
    except ImportError as error:
        raise UsageError(
            f"Clusters need Dask, which is not installed ({error}).", remedy="pip install 'orograph[cluster]'."
        ) from error
    made: Any = distributed.Client
    if isinstance(dask, distributed.Client):
        yield dask
        return
    if dask is not None:
        try:
            client = made(dask)
        except (OSError, ValueError, TypeError) as error:
            raise UsageError(
                f"No scheduler of Dask answers at {dask!r}: {error}.", remedy="Give its address, tcp://HOST:8786."
            ) from error
        with client:
            yield client
        return
    limit = max((max_memory // (workers or 1)), needed * 5 // 4)  # Dask ends processes that come near their limit
    with (
        own.config.set(CALM),
        _quiet_tracker(),
        _loop_apart() as loop,
        _started(workers, threads_per_worker=jobs, memory_limit=limit, loop=loop) as cluster,
        made(cluster) as client,
    ):
        cluster.adapt(minimum=workers, maximum=workers)  # otherwise workers that die at start-up are not restarted
        yield client


def _started(workers: int | None, **options: Any) -> Any:
    """A cluster of processes. Dask gives up if one of them dies as it starts: then it is started again.

    Raises:
        StoreError: they died ``TRIES`` times.
    """
    from distributed import LocalCluster

    made: Any = LocalCluster
    failed = None
    for _ in range(TRIES):
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "(?s).*Port .* is already in use")  # of another cluster's monitor
            try:
                return made(n_workers=workers, processes=True, dashboard_address=None, **options)
            except RuntimeError as error:
                failed = error
    raise StoreError(
        f"The workers died as they started: {str(failed).rstrip('.')}.", remedy="Check the free memory, and try again."
    ) from failed


@contextlib.contextmanager
def _quiet_tracker() -> Iterator[None]:
    """If Python's tracker of semaphores starts within, it does not report what a process ended by Ctrl-C leaves."""
    name = "PYTHONWARNINGS"
    before = os.environ.get(name)
    os.environ[name] = ",".join(filter(None, (before, "ignore:resource_tracker")))
    try:
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
    yield


@contextlib.contextmanager
def _loop_apart() -> Iterator[Any]:
    """A Dask event loop whose thread, and all threads and processes begun from there, ignore Ctrl-C.

    A terminal sends it to all processes of a command. Workers would each print a traceback, above all those
    that are still starting; they end with this process instead.
    """
    from distributed.utils import LoopRunner

    runner: Any = LoopRunner(asynchronous=False)
    masks = getattr(signal, "pthread_sigmask", None)  # threads and processes inherit blocked signals
    before = None if masks is None else masks(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        runner.start()
    finally:
        if masks is not None:
            masks(signal.SIG_SETMASK, before)
    try:
        yield runner.loop
    finally:
        runner.stop()
