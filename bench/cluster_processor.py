"""Processor time of a build by workers beside one thread, and the memory of all processes over thousands of tasks.

    python bench/cluster_processor.py [--data ../shared/data] [--tiles 12] [--workers 2]

The same build by one thread and by workers, whose start and compiling are left out: seconds that all processes were at
work, which does not depend on what else the machine does. Then builds of small shards, one after another; the memory
of every process after so many tasks.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from orograph import store
from orograph.store import clusters

ALL: dict[str, Any] = {"shard": 1024, "errors": ("exact", "midpoint"), "tins": 16, "chunked": (32, 0)}
SMALL: dict[str, Any] = {"shard": 128, "chunk": 64}


def spent(processes: list[psutil.Process]) -> float:
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def everybody(client: Any) -> list[psutil.Process]:
    """This process, and the workers'."""
    return [psutil.Process(), *(psutil.Process(pid) for pid in client.run(__import__("os").getpid).values())]


def beside_one_thread(files: list[str], folder: Path, client: Any) -> None:
    for what, how in (("one thread", {}), ("workers", {"dask": client})):
        store.build(files[:1], folder / "warm", overwrite=True, jobs=1, progress=False, **ALL, **how).close()
        processes, began = everybody(client), time.perf_counter()
        before = spent(processes)
        store.build(files, folder / what, jobs=1, progress=False, **ALL, **how).close()
        seconds = spent(processes) - before
        print(f"{what}: {seconds:.1f} s of processors ({time.perf_counter() - began:.1f} s on the clock)", flush=True)


@contextmanager
def counted() -> Iterator[list[int]]:
    """How many tasks were done."""
    done, lock, hear = [0], threading.Lock(), clusters._Round._hear

    def heard(self: Any, found: Any) -> None:
        with lock:
            done[0] += 1
        hear(self, found)

    clusters._Round._hear = heard  # type: ignore[method-assign]
    try:
        yield done
    finally:
        clusters._Round._hear = hear  # type: ignore[method-assign]


def memory(files: list[str], folder: Path, client: Any, least: int) -> None:
    processes = everybody(client)
    with counted() as done:
        while done[0] < least:
            store.build(files, folder / "small", overwrite=True, dask=client, progress=False, **SMALL).close()
            told = ", ".join(f"{process.memory_info().rss / 2**20:.0f}" for process in processes)
            print(f"after {done[0]} tasks, MiB of this process and the workers: {told}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--tiles", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--tasks", type=int, default=3000)
    given = parser.parse_args()
    files = sorted(map(str, (given.data / "california-3s-tiles").rglob("*.tif")))
    with tempfile.TemporaryDirectory() as name, clusters.workforce(given.workers, None, 1, 4 << 30, 0) as client:
        clusters.group_levels = lambda *_: 0  # shard by shard: as many tasks as there can be
        memory(files[:2], Path(name), client, given.tasks)
    with tempfile.TemporaryDirectory() as name, clusters.workforce(given.workers, None, 1, 4 << 30, 0) as client:
        beside_one_thread(files[: given.tiles], Path(name), client)


if __name__ == "__main__":
    main()
